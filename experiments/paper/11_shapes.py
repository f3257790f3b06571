"""Beyond the paper: a spall as it is measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import difftrb as trb
from difftrb.contact.contact_solution import Defect
from experiments.paper import common
from experiments.paper.common import Progress, Result

LOAD = 3000.0
PLACES = np.concatenate([np.linspace(0.0, 0.25, 3), np.linspace(0.3, 0.65, 8), [0.75]])
ACCURACY = 1e-2
TOP = 4000.0
"""Of the scale of pressures [MPa]."""
DEEP = 0.01
"""Depth [mm] from which a point of the map counts as spall: about what a roller sinks."""


def approach(spall: Defect, place: float = 0.0, **options: Any) -> float:
    """Of one contact [mm]."""
    contact = common.contact()
    return float(trb.solve_contact(contact, LOAD, spall, place, ACCURACY, **options).check().approach)


def run(out: Path, progress: Progress) -> Result:
    """A map across the contact."""
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
        progress(k + 1, 4)
    onto = trb.solve_contact(common.contact(), LOAD, measured, 0.0, ACCURACY).check()
    figure, (left, middle, right) = common.axes(1, 3, height=2.8, width=8.6)
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
    middle.set_ylabel("approach by healthy, δ/δ₀")
    middle.legend(fontsize=6.5, loc="lower left", handlelength=1.2)
    pressure = np.asarray(onto.pressure)
    mesh = right.pcolormesh(
        np.asarray(onto.cells.y), np.asarray(onto.cells.x), np.ma.masked_where(pressure <= 0.0, pressure).T,
        vmin=0.0, vmax=TOP, cmap="viridis", rasterized=True,
    )  # fmt: skip
    right.contour(
        np.linspace(-reach_y, reach_y, height.shape[0]), np.linspace(-reach_x, reach_x, height.shape[1]), height.T,
        [-1e3 * DEEP], colors=[common.HUES[1]], linewidths=1.0, linestyles="--",
    )  # fmt: skip
    figure.colorbar(mesh, ax=right, label="pressure [MPa]", extend="max")
    right.set_xlim(-2.5, 2.5)
    right.set_ylim(-0.25, 0.25)
    right.set_xlabel("along the roller [mm]")
    right.set_ylabel("rolling direction [mm]")
    right.set_title("pressure over its middle")
    right.grid(visible=False)
    picture = common.save(figure, out, "shapes")
    half = int(np.argmin(np.abs(PLACES - 0.5)))
    text = common.page(
        f"The packaged height map: {length:.2f} × {width:.2f} mm are deeper than {1e3 * DEEP:g} "
        f"µm "
        f"somewhere, {100 * share:.0f} % of that area is, with rounded corners, sloped walls and a dented rim; against "
        f"rectangles with vertical walls, by contact solves at {LOAD / 1e3:g} kN (accuracy {ACCURACY:g}; the map on a "
        "lattice of 256 × 32 cells):",
        common.picture(picture, "The packaged height map; approach over its place; pressure over its middle"),
        f"(Right, dashed: where the map is {1e3 * DEEP:g} µm deep. Dents in its rim leave holes in the pressure.)",
        common.grid(
            ["shape", "δ/δ₀ in the middle", "at 0.5 mm"],
            [[name, f"{v[0]:.3f}", f"{v[half]:.3f}"] for name, v in ratio.items()],
        ),
    )  # fmt: skip
    numbers = {"places": PLACES, "ratio": ratio, "share_deep": share}
    progress(4, 4)
    return Result("A measured spall", text, numbers, beyond=True)
