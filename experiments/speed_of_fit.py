"""How long a fit takes beside scipy's least squares with finite differences, on the same residuals in the same run.

python experiments/speed_of_fit.py [LAW] [REPEATS]   (default table, 5 repeats; medians are printed)

Twelve rows (three loads, both directions, one phase and the mean over phases), 16 starts. Both sides call residuals
that jit has compiled before; compiling has a row of its own. scipy solves from each start in turn, as it has to.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from scipy import optimize

import difftrb as trb
from difftrb.fits import batched_misfit, conditions, parameters, predicted, search, stiffness_of_rows
from difftrb.fits.fit_problem import Problem
from difftrb.ring.phase_quadrature import POINTS_IN_FITS, ROUGH_POINTS

LOADS = ((9000.0, 4500.0), (6000.0, 4500.0), (3000.0, 4500.0))
TRUTH = trb.Spall(5.0, 9.0)
NOISE = 0.01
STARTS = 16


def problem_of(scene: trb.Scene) -> tuple[Problem, list[trb.Measurement]]:
    """Twelve rows of the prepared scene with the true spall, with noise, and their least squares."""
    rows = [
        trb.Measurement(radial, axial, quantity, 1.0, 1.0, None, phase)  # type: ignore[arg-type]
        for radial, axial in LOADS
        for phase in (0.0, "mean")
        for quantity in ("radial_loss", "axial_loss")
    ]
    at, rough = (conditions.conditions(scene, rows, points) for points in (POINTS_IN_FITS, ROUGH_POINTS))
    sought = parameters.named(("length", "width"))
    bounds, blank = parameters.bounds(sought, scene, rows), np.ones(len(rows))
    healthy = stiffness_of_rows.healthy_stiffness(scene, at)
    exact = Problem(sought, bounds, scene, at, rough, blank, blank, healthy, 0.0, 0)  # type: ignore[arg-type]
    there = bounds.coordinates(np.array([[TRUTH.length, TRUTH.width]]))  # type: ignore[arg-type]
    true = batched_misfit.evaluated(exact, np.asarray(there)).beside[0][0]
    sigma = NOISE * true
    seen = true + sigma * np.random.default_rng(1).standard_normal(true.size)
    rows = [
        dataclasses.replace(row, value=float(v), sigma=float(s)) for row, v, s in zip(rows, seen, sigma, strict=True)
    ]
    return dataclasses.replace(exact, measured=seen, sigma=sigma), rows


def ours(problem: Problem, starts: np.ndarray) -> np.ndarray:
    """The best values of all starts here."""
    found = search.minima(problem, search.scanned(problem, starts))
    return np.asarray(problem.bounds.values(found.points[np.argmin(found.cost)]))


_residual = jax.jit(predicted.residual)


def compiled(problem: Problem) -> Callable[[np.ndarray], np.ndarray]:
    """The residuals by coordinates, for scipy."""
    return lambda u: np.asarray(_residual(problem, u))


def scipys(problem: Problem, starts: np.ndarray, residual: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """The best values of all starts by scipy."""

    def one(start: np.ndarray) -> optimize.OptimizeResult:
        return optimize.least_squares(residual, start, bounds=(-14.0, 14.0), xtol=1e-10, ftol=1e-10, gtol=1e-10)

    best = min((one(start) for start in starts), key=lambda found: found.cost)
    return np.asarray(problem.bounds.values(best.x))


def timed(work: Callable[[], object]) -> float:
    """Seconds."""
    began = time.perf_counter()
    jax.block_until_ready(work())
    return time.perf_counter() - began


def compared(law: str, repeats: int) -> dict[str, float]:
    """Seconds of each way by name, and by how much their answers differ."""
    rough = trb.Scene(trb.bearing("32008J"), trb.Load(*LOADS[0]), (trb.Spall(3.0, 5.0),), law)
    scene = trb.prepare(rough)
    found: list[tuple[Problem, list[trb.Measurement]]] = []
    first = timed(lambda: found.append(problem_of(scene)))
    problem, rows = found[0]
    starts = search.scan_points(problem, STARTS)
    theirs_first = timed(lambda: compiled(problem)(starts[0]))
    ways = {
        "a fit with its intervals": lambda: trb.fit(scene, rows, model_error=0.0),
        "its 16 starts": lambda: ours(problem, starts),
        "scipy, 16 starts": lambda: scipys(problem, starts, compiled(problem)),
    }
    seconds = {name: float(np.median([timed(work) for _ in range(repeats)])) for name, work in ways.items()}
    apart = np.max(np.abs(ours(problem, starts) / scipys(problem, starts, compiled(problem)) - 1.0))
    return {
        **seconds,
        "compiling, here": first,
        "compiling, scipy's residual": theirs_first,
        "answers differ by": float(apart),
    }


def main() -> None:
    """Measure and print."""
    law = sys.argv[1] if len(sys.argv) > 1 else "table"
    told = compared(law, int(sys.argv[2]) if len(sys.argv) > 2 else 5)
    print(f"law {law}, 12 rows, length and width")
    for name, value in told.items():
        print(f"{name:30s}{value:10.2g}{'' if 'differ' in name else ' s'}")
    print(f"scipy takes {told['scipy, 16 starts'] / told['its 16 starts']:.1f} times as long")


if __name__ == "__main__":
    main()
