"""What fits say where the model is wrong: of how many they are sure, and wrong.

python -m experiments.fit_of_wrong_models [SETS] [FOLDER] [k/n]   (default 120 out 0/1)

Of n processes the k-th takes every n-th set. Every set has a spall of its own, at random as in `fit_coverage`, measured
at two loads, three phases of the cage and in their mean, in both directions, with 1 % noise; and one thing of `WRONG`
that the fit of length, width and angle does not know of. The truth is the fit's own law.

Prints and keeps (FOLDER/fit_of_wrong_models.jsonl, a line a set) by what was wrong: how often the data are not
explained, how often the truth lies in all intervals or is an answer, and the sets in which something is called
determined and is off by more than twice its interval. A set that is there is not computed again.
"""

from __future__ import annotations

import dataclasses
import json
import time
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import difftrb as trb
from experiments.fit_coverage import LOADS, NAMES, NOISE, RANGES, answered, inside, told, wrong
from experiments.random_sets import computed

PHASES = (0.0, 0.09, 0.18, "mean")
WRONG = ("crown", "axial load", "outlier", "two spalls", "housing", "heavy tails")
"""Rollers crowned for 30 % more or less; axial loads 10 % off; a row 25 % off; a second spall on another roller; a
housing as soft as the healthy bearing; noise of Student's t of two degrees of freedom."""


def one(seed: int) -> dict[str, Any]:
    """A set: what is wrong, its truth, and the fit."""
    rng, kind = np.random.default_rng([seed, 120]), WRONG[seed % len(WRONG)]
    sign = 1.0 if rng.uniform() < 0.5 else -1.0
    truth = {name: float(rng.uniform(*RANGES[name])) for name in NAMES}
    spall = trb.Spall(truth["length"], truth["width"], angle=truth["angle"])
    guess = trb.Scene(trb.bearing("32008J"), trb.Load(*LOADS[0]), (trb.Spall(3.0, 5.0),))
    world = dataclasses.replace(guess, spalls=(spall,))
    if kind == "crown":
        world = dataclasses.replace(world, design_load=(1.0 + 0.3 * sign) * float(world.design_load))
    if kind == "two spalls":
        second = trb.Spall(float(rng.uniform(*RANGES["length"])), 5.0, angle=truth["angle"] + 0.6 * sign)
        world = dataclasses.replace(world, spalls=(spall, second))
    rows = []
    for radial, axial in LOADS:
        for phase in PHASES:
            load = trb.Load(radial, axial * (1.0 + 0.1 * sign if kind == "axial load" else 1.0))
            at = dataclasses.replace(world, load=load, phase=phase)
            for k, quantity in enumerate(("radial_loss", "axial_loss")):
                rows.append(trb.Measurement(radial, axial, quantity, float(_loss(at, kind)[k]), 1.0, None, phase))  # type: ignore[arg-type]
    deviations = rng.standard_t(2.0, len(rows)) if kind == "heavy tails" else rng.standard_normal(len(rows))
    sigma = np.array([NOISE * abs(row.value) + 1e-3 for row in rows])
    values = np.array([row.value for row in rows]) + sigma * deviations
    if kind == "outlier":
        values[rng.integers(len(values))] *= 1.0 + 0.25 * sign
    rows = [
        dataclasses.replace(row, value=float(v), sigma=float(s)) for row, v, s in zip(rows, values, sigma, strict=True)
    ]
    began = time.perf_counter()
    fit = trb.fit(guess, rows, NAMES)
    return {"seed": seed, "wrong": kind, "truth": truth, "explained": bool(fit.explained),
            "seconds": time.perf_counter() - began, "fit": told(fit)}  # fmt: skip


def _loss(scene: trb.Scene, kind: str) -> np.ndarray:
    """Radial and axial loss [%], in a housing as soft as the healthy bearing if that is what is wrong."""
    loss = np.asarray(trb.assess(scene).loss)
    if kind != "housing":
        return loss
    added = 1.0 / (1.0 - 0.01 * loss) - 1.0
    return 100.0 * (1.0 - 1.0 / (1.0 + 0.5 * added))


def summary(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Of the sets in which one thing was wrong."""
    truths = [np.array([record["truth"][name] for name in NAMES]) for record in records]
    pairs = [(record["fit"], truth) for record, truth in zip(records, truths, strict=True)]
    return {
        "sets": len(records),
        "not explained": sum(not record["explained"] for record in records),
        "in all intervals": sum(bool(inside(*pair).all()) for pair in pairs),
        "an answer": sum(answered(*pair) for pair in pairs),
        "determined and wrong": {record["seed"]: [name for name, bad in zip(NAMES, wrong(*pair), strict=True) if bad]
                                 for record, pair in zip(records, pairs, strict=True) if wrong(*pair).any()},
    }  # fmt: skip


def main() -> None:
    """Measure, keep, print."""

    def say(record: dict[str, Any]) -> str:
        return f"{record['seed']} {record['wrong']} {record['fit']['determined']} {record['explained']}"

    records = computed("fit_of_wrong_models", 120, one, say)
    for kind in WRONG:
        print(kind, json.dumps(summary([record for record in records if record["wrong"] == kind])))


if __name__ == "__main__":
    main()
