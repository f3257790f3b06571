"""Whether the intervals of a fit can be trusted: many data sets made by a finer model than the one that fits.

python experiments/fit_coverage.py [SETS] [ACCURACY]   (default 200 data sets, truth from contacts at 1e-4)

The truth is the law "direct": contact solves for exactly the states the rollers are in. The fit uses "table" at 1e-3.
Noise is 1 % of every loss. The design: two loads, both directions, with a roller in the middle of the spall and as the
mean over phases. Prints how often 95 % intervals hold the truth, the middle error of length and width, and the time of
a fit beside scipy's least squares with finite differences from the same starts.
"""

from __future__ import annotations

import sys
import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
from scipy import optimize  # noqa: E402

import difftrb as trb  # noqa: E402
from difftrb import fitting as fits  # noqa: E402

SPALL = trb.Spall(4.0, 7.0)
LOADS = ((9000.0, 4500.0), (3000.0, 4500.0))
PHASES = (0.0, "mean")
NOISE = 0.01


def truth(accuracy: float) -> dict[tuple[float, float, float | str], np.ndarray]:
    """Radial and axial loss [%] by load and phase, of contact solves for exactly these states."""
    losses = {}
    for radial, axial in LOADS:
        for phase in PHASES:
            scene = trb.Scene(trb.bearing("32008J"), trb.Load(radial, axial), (SPALL,), "direct", phase=phase,
                              accuracy=accuracy)  # fmt: skip
            losses[radial, axial, phase] = np.asarray(trb.assess(trb.prepare(scene)).loss)
    return losses


def noisy(losses: dict[tuple[float, float, float | str], np.ndarray], seed: int) -> list[trb.Measurement]:
    """One data set: the truth with independent noise of `NOISE` of each value."""
    rng = np.random.default_rng(seed)
    rows = []
    for (radial, axial, phase), pair in losses.items():
        for quantity, value in zip(("radial_loss", "axial_loss"), pair, strict=True):
            measured = float(value * (1.0 + NOISE * rng.standard_normal()))
            rows.append(trb.Measurement(radial, axial, quantity, measured, NOISE * float(value), None, phase))  # type: ignore[arg-type]
    return rows


def against_scipy(found: trb.Fit) -> tuple[float, float, float]:
    """Seconds of all starts here and by scipy with finite differences on the same residuals, one start after the other;
    and the largest relative difference of the best values."""
    problem = found.problem
    starts = fits.start_places(problem.unknowns, found.scene, 16)
    every = np.ones_like(starts, bool)
    began = time.perf_counter()
    ours = fits.solved(problem, starts, every, fits.SEARCH, 40)
    own = time.perf_counter() - began

    from difftrb import observed

    residual = jax.jit(observed.residual)
    residual(problem, starts[0]).block_until_ready()
    began = time.perf_counter()
    theirs = [
        optimize.least_squares(lambda u: np.asarray(residual(problem, u)), start, bounds=(-14.0, 14.0), xtol=1e-10,
                               ftol=1e-10, gtol=1e-10)
        for start in starts
    ]  # fmt: skip
    scipy = time.perf_counter() - began
    best = min(theirs, key=lambda result: result.cost)
    values = np.asarray(problem.unknowns.values(best.x))
    here = np.asarray(problem.unknowns.values(ours.place[int(np.argmin(ours.cost))]))
    return own, scipy, float(np.max(np.abs(here / values - 1.0)))


def main() -> None:
    """Measure and print."""
    sets = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    accuracy = float(sys.argv[2]) if len(sys.argv) > 2 else 1e-4
    losses = truth(accuracy)
    rough = trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(3.0, 5.0),), "table")
    scene = fits.prepare_fit(rough, noisy(losses, 0))
    report(scene, losses, sets)


def report(scene: trb.Scene, losses: dict, sets: int) -> None:
    """Fit all data sets with the prepared scene and print what came out."""
    size = np.array([float(SPALL.length), float(SPALL.width)])
    errors, inside, alone, seconds = [], [], [], []
    for seed in range(sets):
        rows = noisy(losses, seed)
        began = time.perf_counter()
        found = trb.fit(scene, rows)
        seconds.append(time.perf_counter() - began)
        plain = trb.fit(scene, rows, model_error=0.0)
        errors.append(found.values / size - 1.0)
        for kept, one in ((inside, found), (alone, plain)):
            kept.append((one.intervals[:, 0] <= size) & (size <= one.intervals[:, 1]))
    cover, cover_alone = 100.0 * np.mean(inside, axis=0), 100.0 * np.mean(alone, axis=0)
    middle, mean = 100.0 * np.median(np.abs(errors), axis=0), 100.0 * np.mean(errors, axis=0)
    print(f"{sets} data sets, noise {100.0 * NOISE:g} %, law's error {100.0 * float(scene.law.error):.2f} %")  # type: ignore[union-attr]
    for i, name in enumerate(("length", "width")):
        print(f"{name}: 95 % intervals hold the truth in {cover[i]:.1f} % ({cover_alone[i]:.1f} % without the model's "
              f"own error), middle error {middle[i]:.2f} %, mean error {mean[i]:+.2f} %")  # fmt: skip
    own, scipy, apart = against_scipy(found)
    print(f"one fit with its profiles {np.median(seconds):.2f} s; 16 starts {own:.2f} s, scipy {scipy:.2f} s "
          f"({scipy / own:.1f} times), best values differ by {apart:.1e}")  # fmt: skip


if __name__ == "__main__":
    main()
