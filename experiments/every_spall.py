"""Every surface that a roller may meet, in every bearing: is it solved, and how far are loads off contacts solved anew?

    python -m experiments.every_spall [--columns "plain,two rows"] [--rows "a map,shallow"] [--derivatives]
    python -m experiments.every_spall --figure docs

Law `direct` at 1e-2, the mean at 1e-3, audited by `difftrb.verify` with contacts ten times as exact. A row a surface, a
column a bearing; what is refused is listed below the table in the program's own words. Commas within a name are
semicolons in options: "plain; mean".

With `--derivatives` a cell is how far two routes to a derivative are apart: through the prepared law, and differences
of scenes prepared anew, contacts at 1e-3. Of the logarithm of every stiffness on the diagonal, by the logarithm of the
radial load, and by that of the spall's length (a map: its scale); the worst entry, relative, to one in a hundred at
least.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib.pyplot as plt
import numpy as np

import difftrb as trb
from difftrb.report import figure_style, pressure_figure

BEARING, LOAD = trb.bearing("32008J"), trb.Load(9000.0, 4500.0)
ONE = trb.Spall(4.0, 3.0)
SURFACES: dict[str, tuple[Any, ...]] = {
    "one": (ONE,),
    "narrow": (dataclasses.replace(ONE, width=0.1),),
    "off the middle": (dataclasses.replace(ONE, axial_offset=2.5),),
    "at the roller's end": (dataclasses.replace(ONE, axial_offset=5.0),),
    "shallow, 4 µm": (dataclasses.replace(ONE, depth=4e-3),),
    "two under one roller": (dataclasses.replace(ONE, length=3.0, axial_offset=-3.0),
                             dataclasses.replace(ONE, length=3.0, axial_offset=3.0, angle=0.02)),
    "two that touch": (dataclasses.replace(ONE, width=1.5, angle=-0.75 / 28.65),
                       dataclasses.replace(ONE, width=1.5, angle=0.75 / 28.65)),
    "inner raceway": (dataclasses.replace(ONE, surface="inner"),),
    "roller": (dataclasses.replace(ONE, surface="roller"),),
    "a map": (trb.load_height_map(trb.example_map()),),
    "a map, inner": (trb.load_height_map(trb.example_map(), surface="inner"),),
}  # fmt: skip
E = trb.effects
HELD = trb.Load(2000.0, 0.0)
BEARINGS: dict[str, dict[str, Any]] = {
    "plain": {},
    "plain, mean": {"phase": "mean", "accuracy": 1e-3},
    "both raceways, flange": {"effects": (E.Raceways(), E.Flange())},
    "both raceways, speed": {"effects": (E.Raceways(), E.Centrifugal(speed_rpm=3000.0))},
    "two rows": {"effects": (E.DoubleRow(),)},
    "mounting": {"load": HELD, "effects": (E.Mounting(preload=0.01),)},
    "tilting rings": {"effects": (E.Tilt(moment_lateral=1e4),)},
    "tilting rings, both raceways, flange, speed": {
        "effects": (E.Tilt(moment_lateral=1e4), E.Raceways(), E.Flange("hertz", 100.0), E.Centrifugal(3000.0))
    },
}


def cell(spalls: tuple[Any, ...], change: dict[str, Any]) -> str:
    """What becomes of one scene: the error of its loads, or why there is none."""
    of = {"load": LOAD, "accuracy": 1e-2} | change
    scene = trb.Scene(BEARING, spalls=spalls, law="direct", **of)
    try:
        ready = trb.prepare(scene)
        found = trb.solve(ready)
        if not bool(found.converged):
            return found.status
        audit = trb.verify(ready, found)
    except trb.DifftrbError as error:
        return str(error)
    return f"{audit.load_error:.0e}" if audit.rollers else audit.remark


STEP = {"load": 0.01, "size": 0.04}
LEAST_SLOPE = 0.01


def slopes(spalls: tuple[Any, ...], change: dict[str, Any]) -> str:
    """How far derivatives of one scene's stiffness are off differences, by load and by size, or why there are none."""
    of: dict[str, Any] = {"load": LOAD} | change | {"accuracy": 1e-3}
    scene = trb.Scene(BEARING, spalls=spalls, law="direct", **of)
    apart = []
    try:
        ready = trb.prepare(scene)
        here = trb.solve(ready).check().stiffness

        def direct(factor: Any, name: str) -> Any:
            return trb.solve(changed(ready, name, factor)).stiffness

        def afresh(factor: float, name: str) -> Any:
            return trb.solve(trb.prepare(changed(scene, name, factor))).check().stiffness

        for name, step in STEP.items():
            one = jax.jacfwd(lambda factor, name=name: direct(factor, name))(1.0)
            other = (afresh(1.0 + step, name) - afresh(1.0 - step, name)) / (2.0 * step)
            one, other = (np.diag(np.asarray(slope)) / np.diag(np.asarray(here)) for slope in (one, other))
            print(f"{name}: {one.round(4)} {other.round(4)}", file=sys.stderr)
            apart.append(np.max(np.abs(one - other) / np.maximum(np.abs(other), LEAST_SLOPE)))
    except trb.DifftrbError as error:
        return str(error)
    return ",".join(f"{each:.0e}" for each in apart)


def changed(scene: trb.Scene, name: str, factor: Any) -> trb.Scene:
    """With a radial load, or a first spall, so many times as large."""
    if name == "load":
        return dataclasses.replace(scene, load=dataclasses.replace(scene.load, radial=scene.load.radial * factor))
    first, *others = scene.spalls
    field = "length" if isinstance(first, trb.Spall) else "scale"
    first = dataclasses.replace(first, **{field: getattr(first, field) * factor})
    return dataclasses.replace(scene, spalls=(first, *others))


def drawn(folder: Path, phases: int = 96) -> None:
    """Radial and axial stiffness over one pitch of the cage, of surfaces whose contacts are solved at every phase."""
    _, axes = plt.subplots(2, 1, figsize=(7.5, 5.5), sharex=True, layout="constrained")
    looks = {"one": "-", "two under one roller": "--", "a map": ":"}
    for name, look in looks.items():
        scene = trb.Scene(BEARING, LOAD, SURFACES[name], law="direct", accuracy=1e-3)
        turn = trb.stiffness(scene, phases)
        degrees = np.degrees(np.asarray(turn.cage))
        for ax, k in zip(axes, (0, 2), strict=True):
            ax.plot(degrees, np.asarray(turn.stiffness[:, k, k]) / 1e6, look, label=name)
    whole = trb.stiffness(trb.Scene(BEARING, LOAD), phases)
    for ax, k, title in zip(axes, (0, 2), ("radial", "axial"), strict=True):
        ax.plot(np.degrees(np.asarray(whole.cage)), np.asarray(whole.stiffness[:, k, k]) / 1e6,
                color=figure_style.ACCENT, label="healthy", zorder=0)  # fmt: skip
        ax.set_ylabel(f"{title} stiffness [10⁶ N/mm]")
    axes[0].set_title("32008J under 9000 N radial and 4500 N axial; tangent dF/du")
    axes[1].set_xlabel("cage's angle over one pitch [°]")
    axes[0].legend(fontsize=9)
    figure_style.save(axes[0], folder, "every_spall")
    ends = trb.Spall(8.0, 6.0, axial_offset=2.83)
    acting = (E.Tilt(moment_lateral=1e4), E.Raceways())
    scene = trb.prepare(trb.Scene(BEARING, LOAD, (ends,), law="direct", accuracy=1e-2, effects=acting))
    pressed = pressure_figure.contacts_at_spall(scene, trb.solve(scene).check())
    figure_style.save(pressure_figure.pressures(pressed), folder, "tilting_roller")


def main() -> None:
    reader = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    reader.add_argument("--columns", default=",".join(BEARINGS).replace(", ", "; "))
    reader.add_argument("--rows", default=",".join(SURFACES).replace(", ", "; "))
    reader.add_argument("--figure", type=Path, help="draw stiffness over the cage's angle into this folder, instead")
    reader.add_argument("--derivatives", action="store_true", help="of stiffness, by two routes, instead of loads")
    asked = reader.parse_args()
    told = slopes if asked.derivatives else cell
    if asked.figure is not None:
        drawn(asked.figure)
        return
    columns, rows = ([name.replace("; ", ", ") for name in given.split(",")] for given in (asked.columns, asked.rows))
    refused: dict[str, list[str]] = {}
    print("# Every spall in every bearing\n")
    print(f"| | {' | '.join(columns)} |\n|---|{'---|' * len(columns)}", flush=True)
    for row in rows:
        texts = []
        for column in columns:
            started = time.perf_counter()
            text = told(SURFACES[row], BEARINGS[column])
            print(f"{row}; {column}: {text} ({time.perf_counter() - started:.1f} s)", file=sys.stderr, flush=True)
            if " " in text:
                refused.setdefault(text, []).append(f"{row}; {column}")
                text = f"({1 + list(refused).index(text)})"
            texts.append(text)
        print(f"| {row} | {' | '.join(texts)} |", flush=True)
    print()
    for number, (text, _) in enumerate(refused.items(), 1):
        print(f"{number}. {text}")


if __name__ == "__main__":
    main()
