"""Whether the answers of a fit can be trusted: many spalls, measured by a finer model than the one that fits.

python -m experiments.fit_coverage [SETS] [FOLDER] [k/n] [LAW] [DESIGN]   (default 300 out 0/1 direct asked)

Of n processes the k-th takes every n-th set. With the law "auto" the truth is the fit's own law: a tenth of the time.
With the design "phases" there are twelve rows, at three phases of the cage, and no more are asked for: a spall's edges
are then told by rollers that stand on them, and by nothing else. It takes a twentieth of the time.

Every set has a spall of its own, drawn at random: length, width and angle, the other sizes as in the default scene;
every other one has both raceways in series. The truth is the law "direct": contact solves for exactly the states in
which the rollers are. First two loads are measured in both directions, with a roller at the bottom and as the mean over
phases; then, twice, the three measurements that the fit asks for next. Noise is 1 % of every value. Length, width and
angle are fitted, by the default law.

Prints and keeps (FOLDER/fit_coverage_LAW_DESIGN.jsonl, a line a set): how often 95 % intervals hold the truth, how many
sets are called determined, and which of those are wrong by more than twice the interval. A set that is there is not
computed again.
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import difftrb as trb
from experiments.random_sets import computed

LOADS = ((9000.0, 4500.0), (3000.0, 4500.0))
PHASES = {"asked": (0.0, "mean"), "phases": (0.0, 0.09, 0.18)}
NOISE = 0.01
ACCURACY = {"direct": 1e-4, "auto": 1e-3}
"""Of the truth by its law: a tenth of the noise, or less."""
NAMES = ("length", "width", "angle")
RANGES = {"length": (1.5, 7.0), "width": (2.0, 9.0), "angle": (-0.5, 0.5)}
ROUNDS, ASKED = {"asked": 2, "phases": 0}, 3


def measured(scene: trb.Scene, row: trb.Measurement, known: dict[tuple, np.ndarray]) -> float:
    """What a row would read without noise; `known` keeps what is solved, by load and phase."""
    phase: Any = row.phase
    key = float(row.radial), float(row.axial), phase
    if key not in known:
        at = scene.replace(load=trb.Load(*key[:2]), phase=phase)
        known[key] = np.asarray(trb.assess(trb.prepare(at)).loss)
    return float(known[key][0 if row.quantity.startswith("radial") else 1])


def one(seed: int, law: str = "direct", design: str = "asked") -> dict[str, Any]:
    """A set: its truth, the fit of its first rows and of all."""
    rng = np.random.default_rng([seed, 33])
    truth = {name: float(rng.uniform(*RANGES[name])) for name in NAMES}
    effects = (trb.effects.Raceways(),) if seed % 2 else ()
    spall = trb.Spall(truth["length"], truth["width"], angle=truth["angle"])
    world = trb.Scene(trb.bearing("32008J"), trb.Load(*LOADS[0]), (spall,), law, accuracy=ACCURACY[law],
                      effects=effects)  # fmt: skip
    known: dict[tuple, np.ndarray] = {}

    def read(row: trb.Measurement) -> trb.Measurement:
        exact = measured(world, row, known)
        sigma = NOISE * abs(exact) + 1e-3
        return trb.Measurement(row.radial, row.axial, row.quantity, exact + sigma * float(rng.standard_normal()), sigma,
                               row.definition, row.phase)  # fmt: skip

    blank = [trb.Measurement(*load, quantity, 1.0, 1.0, None, phase)  # type: ignore[arg-type]
             for load in LOADS for phase in PHASES[design] for quantity in ("radial_loss", "axial_loss")]  # fmt: skip
    rows = [read(row) for row in blank]
    guess = trb.Scene(trb.bearing("32008J"), trb.Load(*LOADS[0]), (trb.Spall(3.0, 5.0),), effects=effects)
    record: dict[str, Any] = {"seed": seed, "truth": truth, "raceways": bool(effects), "fits": []}
    for step in range(ROUNDS[design] + 1):
        began = time.perf_counter()
        fit = trb.fit(guess, rows, NAMES)
        record["fits"].append(told(fit) | {"seconds": time.perf_counter() - began})
        if step < ROUNDS[design]:
            asked = trb.next_measurements(fit, count=ASKED)
            rows += [read(suggestion.row) for suggestion in asked]
    return record


def told(fit: trb.Fit) -> dict[str, Any]:
    """What a fit says, for the record."""
    return {
        "rows": len(fit.rows),
        "values": fit.values.tolist(),
        "intervals": fit.intervals.tolist(),
        "own": fit.own_intervals.tolist(),
        "determined": fit.determined_each.tolist(),
        "alternatives": [[*other.values.tolist(), other.weight] for other in fit.alternatives],
        "chi2": fit.chi2,
        "chance": fit.chance,
        "status": int(fit.status_code),
        "remarks": list(fit.remarks),
    }


def inside(fit: dict[str, Any], truth: np.ndarray) -> np.ndarray:
    """Whether the intervals hold the truth, by parameter."""
    ends = np.array(fit["intervals"])
    return (ends[:, 0] <= truth) & (truth <= ends[:, 1])


def answered(fit: dict[str, Any], truth: np.ndarray) -> bool:
    """Whether the truth is what the fit says, within its intervals, or so near to another answer that it names."""
    ends = np.array(fit["own"])
    named = [np.array(fit["values"]), *(np.array(other[:-1]) for other in fit["alternatives"])]
    return any(bool(np.all(np.abs(truth - values) <= np.ptp(ends, axis=1))) for values in named)


def wrong(fit: dict[str, Any], truth: np.ndarray) -> np.ndarray:
    """What is called determined and misses the truth by more than twice the interval's width, by parameter."""
    ends = np.array(fit["intervals"])
    off = np.maximum(ends[:, 0] - truth, truth - ends[:, 1])
    return np.array(fit["determined"]) & (off > 2.0 * (ends[:, 1] - ends[:, 0]))


def summary(records: list[dict[str, Any]], step: int) -> dict[str, Any]:
    """Of the fits after so many rounds of further measurements."""
    fits = [record["fits"][step] for record in records]
    truths = [np.array([record["truth"][name] for name in NAMES]) for record in records]
    held = np.array([inside(*pair) for pair in zip(fits, truths, strict=True)])
    bad = np.array([wrong(*pair) for pair in zip(fits, truths, strict=True)])
    sure = np.array([fit["determined"] for fit in fits])
    told = np.array([answered(*pair) for pair in zip(fits, truths, strict=True)])
    return {
        "rows": fits[0]["rows"],
        "sets": len(fits),
        "intervals that hold the truth [%]": shares(held),
        "of those determined [%]": shares(held & sure, sure),
        "determined [%]": shares(sure),
        "the truth is an answer [%]": round(100.0 * float(told.mean()), 1),
        "determined and wrong": [records[k]["seed"] for k in np.flatnonzero(bad.any(axis=1))],
        "median seconds": round(float(np.median([fit["seconds"] for fit in fits])), 2),
    }


def shares(those: np.ndarray, among: np.ndarray | None = None) -> dict[str, float]:
    """Of sets, by parameter [%]."""
    every = np.ones_like(those) if among is None else among
    found = 100.0 * those.sum(axis=0) / np.maximum(every.sum(axis=0), 1)
    return dict(zip(NAMES, found.round(1).tolist(), strict=True))


def main() -> None:
    """Measure, keep, print."""
    law, design = (*sys.argv[4:6], *("direct", "asked")[len(sys.argv[4:6]) :])

    def say(record: dict[str, Any]) -> str:
        last, truth = record["fits"][-1], [round(value, 3) for value in record["truth"].values()]
        found = np.round(last["values"], 3), np.round(last["intervals"], 3).tolist(), last["determined"]
        return " ".join(map(str, (record["seed"], truth, *found)))

    records = computed(f"fit_coverage_{law}_{design}", 300, partial(one, law=law, design=design), say)
    for step in range(ROUNDS[design] + 1):
        print(json.dumps(summary(records, step), indent=1))


if __name__ == "__main__":
    main()
