"""Whether posteriors say how sure they are: ranks of the truth among draws are even if they do (Talts et al. 2018).

python -m experiments.posterior_calibration [SETS] [FOLDER] [k/n]   (default 500 out 0/1)

Of n processes the k-th takes every n-th set. Every set's spall is drawn from the prior: length, width and angle. Twelve
losses are measured with it: two loads, three phases of the cage, both directions; noise is 2 % of them and 0.02 %. From
the rows alone comes the posterior, under the same prior. Prints and keeps (FOLDER/posterior_calibration.jsonl) the rank
of every truth among 199 draws; in the end the chance of ranks as uneven as these, and how many 95 % intervals hold.
"""

from __future__ import annotations

import dataclasses
import json
import time
from functools import partial
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from scipy import stats

import difftrb as trb
from difftrb.fits import fit_problem
from difftrb.fits import posterior as posteriors
from difftrb.fits.batched_misfit import rows_at
from difftrb.fits.fit_problem import Problem
from difftrb.fits.least_squares import at_shares
from experiments.random_sets import computed

NAMES = ("length", "width", "angle")
LOADS, PHASES, QUANTITIES = ((9000.0, 4500.0), (3000.0, 4500.0)), (0.0, 0.09, 0.18), ("radial_loss", "axial_loss")
DRAWS, LIVE = 199, 200


def problem() -> Problem:
    """Of rows that say nothing yet."""
    rows = [trb.Measurement(*load, quantity, 1.0, 1.0, None, phase)  # type: ignore[arg-type]
            for load in LOADS for phase in PHASES for quantity in QUANTITIES]  # fmt: skip
    scene = trb.Scene(trb.bearing("32008J"), trb.Load(*LOADS[0]), (trb.Spall(3.0, 5.0),))
    return fit_problem.problem_of(fit_problem.prepare_fit(scene, rows), tuple(rows), NAMES, "squares", 0.0)[0]


def one(seed: int, blank: Problem) -> dict[str, Any]:
    """A set: its truth, and the rank of each value among draws from the posterior."""
    rng, prior = np.random.default_rng([seed, 51]), posteriors.once_round(blank)
    inside = False
    while not inside:  # a fit searches more than a turn of angles, a prior is of one
        place = at_shares(rng.uniform(0.0, 1.0, len(NAMES)))
        values = np.asarray(blank.bounds.values(place))
        inside = bool(np.all((prior.low <= values) & (values <= prior.high)))
    exact = rows_at(blank, place[None], many=True)[0]
    sigma = 0.02 * np.abs(exact) + 0.02
    own = dataclasses.replace(blank, measured=exact + sigma * rng.standard_normal(len(exact)), sigma=sigma)
    began = time.perf_counter()
    found = posteriors.posterior_of(own, 1.0, LIVE, DRAWS, seed, 10.0, None)
    truth = np.asarray(blank.bounds.values(place))
    ends = found.intervals()
    return {
        "seed": seed,
        "truth": truth.tolist(),
        "ranks": np.sum(found.values < truth, axis=0).tolist(),
        "held": ((ends[:, 0] <= truth) & (truth <= ends[:, 1])).tolist(),
        "seconds": time.perf_counter() - began,
        "evaluations": found.evaluations,
    }


def summary(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Of all sets: by parameter, and time."""
    ranks = (np.array([record["ranks"] for record in records]) + 0.5) / (DRAWS + 1)
    held = np.mean([record["held"] for record in records], axis=0)
    return {
        "sets": len(records),
        "chance of ranks as uneven": {n: round(float(stats.kstest(own, "uniform").pvalue), 3)
                                      for n, own in zip(NAMES, ranks.T, strict=True)},
        "95 % intervals that hold [%]": {n: round(100.0 * float(own), 1) for n, own in zip(NAMES, held, strict=True)},
        "median seconds": round(float(np.median([record["seconds"] for record in records])), 1),
        "median evaluations": int(np.median([record["evaluations"] for record in records])),
    }  # fmt: skip


def main() -> None:
    """Measure, keep, print."""
    print(json.dumps(summary(computed("posterior_calibration", 500, partial(one, blank=problem()))), indent=1))


if __name__ == "__main__":
    main()
