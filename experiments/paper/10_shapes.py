"""Beyond the paper: a spall as it is measured, and several spalls."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import difftrb as trb
from difftrb import geometry
from difftrb.given import Defect
from experiments.paper import common
from experiments.paper.common import Progress, Result

LOAD = 3000.0
PLACES = np.concatenate([np.linspace(0.0, 0.25, 3), np.linspace(0.3, 0.65, 8), [0.75]])
APART = (2.0, 2.2, 2.5, 3.0, 4.0, 6.0, 8.0)
"""Distance of the middles of two spalls of 2 mm, one behind the other along the roller [mm]."""
ACCURACY = 1e-2
DEEP = 0.01
"""Depth [mm] from which a point of the map counts as spall: about what a roller sinks."""


def approach(spall: Defect, place: float = 0.0, **options: Any) -> float:
    """Of one contact [mm]."""
    contact = common.contact()
    return float(trb.solve_contact(contact, LOAD, spall, place, ACCURACY, **options).check().approach)


def around(pitches: Sequence[int]) -> np.ndarray:
    """Secant loss of spalls of 4 × 7 mm under rollers so many `pitches` from the one at the load line [%]."""
    law = common.table_law()
    law = dataclasses.replace(law, which=law.which * len(pitches))
    angle = float(geometry.roller_pitch(common.bearing()))
    spalls = tuple(trb.Spall(4.0, 7.0, common.DEPTH, angle=k * angle) for k in pitches)
    return np.asarray(common.losses(dataclasses.replace(common.scene(law, 4.0, 7.0), spalls=spalls)))


def run(out: Path, progress: Progress) -> Result:
    """A map across the contact, spalls in a row, spalls around the ring."""
    measured = trb.load_height_map(trb.example_map())
    deep = np.asarray(measured.height) < -DEEP
    length = float(deep.any(axis=1).sum()) * float(measured.pitch_y)
    width = float(deep.any(axis=0).sum()) * float(measured.pitch_x)
    share = float(deep.sum()) * float(measured.pitch_x) * float(measured.pitch_y) / (length * width)
    shapes = {
        "measured map": measured,
        "box around it": trb.Spall(length, width, common.DEPTH),
        "box of its area": trb.Spall(np.sqrt(share) * length, np.sqrt(share) * width, common.DEPTH),
    }
    healthy = {"lattice": approach(None, method="lattice"), "auto": approach(None)}
    ratio = {}
    for k, (name, shape) in enumerate(shapes.items()):
        base = healthy["lattice" if k == 0 else "auto"]
        ratio[name] = np.array([approach(shape, float(place)) for place in PLACES]) / base
        progress(k + 1, 6)
    side = approach(None, method="cells")
    one, two = (approach(trb.Spall(v, 50.0, common.DEPTH), method="cells") / side for v in (2.0, 4.0))
    pairs = [
        approach(tuple(trb.Spall(2.0, 50.0, common.DEPTH, axial_offset=s * 0.5 * apart) for s in (-1.0, 1.0))) / side
        for apart in APART
    ]
    progress(4, 6)
    alone = {k: around([k]) for k in (0, 1, 2, 4, 8)}
    rows_of = {(count, step): [k * step for k in range(count)] for count in (2, 3) for step in (1, 2, 4)}
    together = {row: around(pitches) for row, pitches in rows_of.items()}
    progress(5, 6)
    figure, (left, middle, right) = common.axes(1, 3, height=2.8, width=8.0)
    height = np.asarray(measured.height) * 1e3
    reach_y, reach_x = (0.5 * float(v) for v in measured.extent)
    shown = left.imshow(
        height.T, extent=(-reach_y, reach_y, -reach_x, reach_x), aspect="auto", cmap="cividis", origin="lower"
    )
    figure.colorbar(shown, ax=left, label="height [µm]")
    left.set_xlabel("along the roller [mm]")
    left.set_ylabel("rolling direction [mm]")
    left.set_title("the packaged map")
    left.grid(visible=False)
    for (name, values), style in zip(ratio.items(), ("o-", "s--", "^:"), strict=True):
        middle.plot(PLACES, values, style, ms=3, lw=1.2, label=name)
    middle.set_xlabel("place of its middle [mm]")
    middle.set_ylabel("approach by healthy")
    middle.legend(fontsize=6.5, loc="lower left", handlelength=1.2)
    right.plot(APART, pairs, "o-", ms=4, lw=1.2, label="two of 2 mm")
    for value, name, style in ((one, "one of 2 mm", ":"), (two, "one of 4 mm", "--")):
        right.axhline(value, color="black", lw=0.9, ls=style, label=name)
    right.set_xlabel("middles apart [mm]")
    right.set_ylabel("approach by healthy")
    right.legend(fontsize=7, loc="center right")
    picture = common.save(figure, out, "shapes")
    rows = [
        [f"{row[0]} spalls, {row[1]} rollers apart", *(f"{v:.2f}" for v in loss),
         *(f"{v:.2f}" for v in np.sum([alone[k] for k in rows_of[row]], axis=0))]
        for row, loss in together.items()
    ]  # fmt: skip
    half = int(np.argmin(np.abs(PLACES - 0.5)))
    text = common.page(
        f"**A measured shape.** The packaged height map: {length:.2f} × {width:.2f} mm are deeper than {1e3 * DEEP:g} "
        f"µm "
        f"somewhere, {100 * share:.0f} % of that area is, with rounded corners, sloped walls and a dented rim; against "
        f"rectangles with vertical walls, by contact solves at {LOAD / 1e3:g} kN (accuracy {ACCURACY:g}; the map on a "
        "lattice of 256 × 32 cells):",
        common.picture(picture, "The packaged height map; approach over its place; two spalls in a row"),
        common.grid(
            ["shape", "δ/δ₀ in the middle", "at 0.5 mm"],
            [[name, f"{v[0]:.3f}", f"{v[half]:.3f}"] for name, v in ratio.items()],
        ),
        f"**Two spalls in a row** of 2 mm each: touching, they are one of 4 mm (δ/δ₀ {pairs[0]:.3f}, one of 4 mm "
        f"{two:.3f}); a narrow bridge between them carries at once ({pairs[1]:.3f} with 0.2 mm of land, {pairs[2]:.3f} "
        f"with 0.5 mm), and {APART[-1]:g} mm apart they are at {pairs[-1]:.3f}; one of 2 mm alone {one:.3f}.",
        "**Several spalls around the ring**, 4 × 7 mm each, table law, secant loss [%]; beside it the sum of what each "
        f"costs alone (one at the load line: {alone[0][0]:.2f} / {alone[0][1]:.2f}):",
        common.grid(["", "radial", "axial", "sum, radial", "axial"], rows),
    )  # fmt: skip
    numbers = {
        "places": PLACES, "ratio": ratio, "share_deep": share, "apart": APART, "pairs": pairs, "one": one, "two": two,
        "around": {f"{c} spalls, {p} apart": v for (c, p), v in together.items()},
    }  # fmt: skip
    progress(6, 6)
    return Result("Beyond the paper: measured shapes and several spalls", text, numbers)
