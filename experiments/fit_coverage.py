"""Whether the intervals of a fit can be trusted: many data sets made by a finer model than the one that fits.

python experiments/fit_coverage.py [SETS] [raceways | outer] [FOLDER]   (default 200 raceways out)

The truth is the law "direct" at 1e-4: contact solves for exactly the states the rollers are in, with the true ramp at
the spall's edges, on both raceways in series ("outer": on the outer one alone). The fit has the same raceways by the
law "table" at 1e-3, with nodes and grids of its own. Noise is 1 % of every loss. The design that is recommended: two
loads, both directions, with a roller in the middle of the spall and as the mean over phases. A quarter of the sets is
fitted by halves of it, too. Prints and writes (FOLDER/fit_coverage_….json, .png, .svg) how often 95 % intervals hold
the truth, and the errors of length and width by design. What is in the file is not computed again, so a run that was
stopped goes on.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib.pyplot as plt
import numpy as np

import difftrb as trb
from difftrb.fits import fitting
from difftrb.report import plot

SPALL = trb.Spall(4.0, 7.0)
LOADS = ((9000.0, 4500.0), (3000.0, 4500.0))
PHASES = (0.0, "mean")
NOISE = 0.01
ACCURACY = 1e-4
UNKNOWN = 1e4
"""By what factor sigma grows of rows that a design leaves out: so all designs are one program."""
DESIGNS: dict[str, tuple[float | str, ...]] = {"recommended": PHASES, "means alone": ("mean",), "one phase": (0.0,)}
NAMES = ("length", "width")

Losses = dict[tuple[float, float, float | str], np.ndarray]


def truth(accuracy: float, effects: tuple[trb.effects.Effect, ...] = ()) -> Losses:
    """Radial and axial loss [%] by load and phase, of contact solves for exactly these states."""
    losses = {}
    for radial, axial in LOADS:
        for phase in PHASES:
            scene = trb.Scene(trb.bearing("32008J"), trb.Load(radial, axial), (SPALL,), "direct", phase=phase,
                              accuracy=accuracy, effects=effects)  # fmt: skip
            losses[radial, axial, phase] = np.asarray(trb.assess(trb.prepare(scene)).loss)
    return losses


def noisy(losses: Losses, seed: int) -> list[trb.Measurement]:
    """One data set: the truth with independent noise of `NOISE` of each value."""
    rng = np.random.default_rng(seed)
    rows = []
    for (radial, axial, phase), pair in losses.items():
        for quantity, value in zip(("radial_loss", "axial_loss"), pair, strict=True):
            measured = float(value * (1.0 + NOISE * rng.standard_normal()))
            rows.append(trb.Measurement(radial, axial, quantity, measured, NOISE * float(value), None, phase))  # type: ignore[arg-type]
    return rows


def of_design(rows: list[trb.Measurement], phases: tuple[float | str, ...]) -> list[trb.Measurement]:
    """The rows, those at other phases as good as unknown."""
    return [row if row.phase in phases else dataclasses.replace(row, sigma=UNKNOWN * row.sigma) for row in rows]  # type: ignore[operator]


def fitted(scene: trb.Scene, rows: list[trb.Measurement]) -> dict[str, Any]:
    """Values and intervals [mm], with the law's own error and without, what is determined, and seconds."""
    began = time.perf_counter()
    found = trb.fit(scene, rows)
    seconds = time.perf_counter() - began
    alone = trb.fit(found.scene, rows, model_error=0.0, starts=1)
    return {
        "values": found.values.tolist(),
        "intervals": found.intervals.tolist(),
        "values_without_own_error": alone.values.tolist(),
        "intervals_without_own_error": alone.intervals.tolist(),
        "determined": found.determined,
        "seconds": seconds,
    }


def summary(record: dict[str, Any]) -> dict[str, Any]:
    """By design: coverage and errors [%] of length and width."""
    size = np.array([float(SPALL.length), float(SPALL.width)])
    told = {}
    for design, sets in record["sets"].items():
        if not sets:
            continue
        values = np.array([one["values"] for one in sets.values()])
        errors = 100.0 * (values / size - 1.0)
        own = {
            "sets": len(values),
            "determined": 100.0 * float(np.mean([one["determined"] for one in sets.values()])),
            "median_error": dict(zip(NAMES, np.median(np.abs(errors), axis=0).tolist(), strict=True)),
            "mean_error": dict(zip(NAMES, np.mean(errors, axis=0).tolist(), strict=True)),
        }
        for key in ("intervals", "intervals_without_own_error"):
            ends = np.array([one[key] for one in sets.values()])
            inside = (ends[..., 0] <= size) & (size <= ends[..., 1])
            own[f"coverage_of_{key}"] = dict(zip(NAMES, (100.0 * inside.mean(axis=0)).tolist(), strict=True))
        told[design] = own
    return told


def figure(record: dict[str, Any], told: dict[str, Any]) -> None:
    """Coverage by parameter, with what chance lets expect of so many sets, and errors by design."""
    _, (left, right) = plt.subplots(1, 2, figsize=(8.4, 3.4), layout="constrained")
    own = told["recommended"]
    chance = 196.0 * np.sqrt(0.95 * 0.05 / own["sets"])
    left.axhspan(95.0 - chance, min(95.0 + chance, 100.0), color=plot.ACCENT, alpha=0.35, lw=0)
    left.axhline(95.0, color="black", lw=0.8)
    for key, label, marker, colour, aside in (
        ("coverage_of_intervals", "with the law's own error", "o", plot.HEALTHY, -0.06),
        ("coverage_of_intervals_without_own_error", "without", "s", plot.SPALLED, 0.06),
    ):
        left.plot([aside, 1.0 + aside], [own[key][name] for name in NAMES], marker, color=colour, label=label)
    left.set(xlim=(-0.6, 1.6), ylabel="95 % intervals that hold the truth [%]", title=f"{own['sets']} data sets")
    left.set_xticks(range(len(NAMES)), list(NAMES))
    left.legend(frameon=False, title="band: chance, 95 %", loc="lower right")
    size = np.array([float(SPALL.length), float(SPALL.width)])
    for i, (name, marker, colour) in enumerate(zip(NAMES, "os", (plot.HEALTHY, plot.SPALLED), strict=True)):
        for k, design in enumerate(told):
            values = np.array([one["values"][i] for one in record["sets"][design].values()])
            off = 100.0 * np.abs(values / size[i] - 1.0)
            low, middle, high = np.percentile(off, [25.0, 50.0, 75.0])
            right.errorbar(k + 0.2 * i - 0.1, middle, [[middle - low], [high - middle]], fmt=marker, color=colour,
                           capsize=3, label=name if k == 0 else None)  # fmt: skip
    right.set(yscale="log", ylabel="error [%], quartiles", title="Error by design (noise 1 %)")
    right.set_xticks(range(len(told)), list(told))
    right.legend(frameon=False)


def main() -> None:
    """Measure, print, write."""
    sets = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    case = sys.argv[2] if len(sys.argv) > 2 else "raceways"
    folder = Path(sys.argv[3] if len(sys.argv) > 3 else "out")
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"fit_coverage_{case}.json"
    effects = (trb.effects.Raceways(),) if case == "raceways" else ()
    if file.exists():
        record = json.loads(file.read_text(encoding="utf-8"))
    else:
        losses = truth(ACCURACY, effects)
        record = {"truth": [[*key, value.tolist()] for key, value in losses.items()], "sets": {d: {} for d in DESIGNS}}
        file.write_text(json.dumps(record), encoding="utf-8")
    losses = {(r, a, phase): np.array(value) for r, a, phase, value in record["truth"]}
    print("truth: losses [%]", {key: np.round(value, 3).tolist() for key, value in losses.items()}, flush=True)
    rough = trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(3.0, 5.0),), "table", effects=effects)
    scene = fitting.prepare_fit(rough, noisy(losses, 0))
    record["own_error_of_the_law"] = float(scene.law.error)  # type: ignore[union-attr]
    for design, phases in DESIGNS.items():
        for seed in range(sets if design == "recommended" else sets // 4):
            if str(seed) not in record["sets"][design]:
                record["sets"][design][str(seed)] = fitted(scene, of_design(noisy(losses, seed), phases))
                file.write_text(json.dumps(record), encoding="utf-8")
    record["summary"] = told = summary(record)
    file.write_text(json.dumps(record, indent=1), encoding="utf-8")
    print(json.dumps(told, indent=1))
    figure(record, told)
    plot.save(plt.gca(), folder, f"fit_coverage_{case}")


if __name__ == "__main__":
    main()
