"""From a scene to numbers: `prepare` builds its laws, `solve` gives loads and stiffness, `assess` what spalls take."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import cast

import jax
import numpy as np

from difftrb.core import status
from difftrb.core.geometry import Real
from difftrb.law.base import AUTO, LAWS, Law
from difftrb.law.samples import Progress
from difftrb.ring import effect_base
from difftrb.ring.effects import Raceways
from difftrb.scene import checks, scene_laws
from difftrb.scene.prepared import assess_prepared, solve_plain, solve_prepared
from difftrb.scene.scene import Finer, LawName, Picked, PitchMean, Scene, is_auto, named
from difftrb.scene.solution import Assessment, Solution

LADDER = (1e-2, 1e-3, 1e-4)
"""Accuracies of the contact solves of "auto", the cheapest first."""
UNKNOWN = (status.SLIVER, status.OTHER_CONTACT, status.SEVERAL, status.BOTTOM, status.OUTSIDE, status.UNKNOWN_LENGTH,
           status.TILTS)  # fmt: skip
"""What the table does not know, and contact solves may."""
PREPARED = 1e-3
"""`accuracy` of every scene that "auto" has prepared. It no longer matters; one value is one program for all."""
DELICATE = 0.1
"""Share of the larger displacement of two below which the other's stiffness is judged by two accuracies."""


def prepare(scene: Scene, progress: Progress | None = None, least: Real | None = None) -> Scene:
    """The scene with its laws built, so that solving it again costs milliseconds, or microseconds in a jitted batch.
    Errors as in `solve`.

    A prepared "power" law is frozen: bearing, crown, and a spall's width, depth and axial offset no longer act through
    it. For complete derivatives by those, differentiate the scene with its law by name. "table" needs no preparing.
    "direct" stays complete, and holds for neighbours of the scene. `progress` is told how many of how many contacts are
    solved. `least` is the largest roller load [N] of the lightest loaded scene that a "power" law is to serve; default:
    of this one.

    "auto" becomes "table" where that knows the scene and keeps `accuracy`, here 1e-3…1e-1, else "direct" with contacts
    as exact as that needs, see `refined`. A traced scene, and one without a solution, becomes "table", whose status
    says why. `picked` of the result, and of its solutions, says what was chosen.
    """
    scene = checks.checked(scene)
    if not is_auto(scene):
        return scene_laws.with_laws(scene, progress, least)
    ready = by_table(scene)
    if scene_laws.is_traced(scene):
        return ready
    unknown = int(solve_prepared(ready).status_code) in UNKNOWN
    coarse = cast(Picked, ready.picked).error > scene.accuracy
    return refined(scene, progress) if unknown or coarse else ready


def by_table(scene: Scene) -> Scene:
    """A scene with law "auto" prepared by "table", traced or not. Errors as in `solve`."""
    return _tabled(checks.checked(scene))


def _tabled(scene: Scene) -> Scene:
    """A checked scene with the table of its contact, in any arithmetic."""
    ready = scene_laws.with_laws(named(scene, "table", PREPARED))
    if not is_auto(scene):
        return dataclasses.replace(ready, accuracy=scene.accuracy)
    return dataclasses.replace(
        ready, picked=Picked("table", PREPARED, scene.accuracy, cast(Law, ready.law).error, None)
    )


def solve(scene: Scene) -> Solution:
    """Load distribution and stiffness of a scene.

    Differentiable by every leaf of the scene: `jax.grad(lambda s: solve(s).stiffness[0, 0])(scene)` is a scene of
    gradients. `jit` and `vmap` as you like. Raises `SolveError` without float64, `SceneError` (a ValueError) for what a
    scene file would refuse, see `Scene`, and for a law that needs `prepare` first; everything else ends as a status in
    the result.
    """
    if isinstance(scene.law, LawName) and scene.law.name in (AUTO, "table") and not scene.effects:
        scene = checks.checked(scene)
        if scene_laws.is_traced(scene):
            return solve_plain(_tabled, scene)
    if isinstance(scene.law, LawName) or effect_base.among(scene.effects, Raceways) is not None:
        return solve_prepared(prepare(scene))
    return solve_prepared(checks.checked(scene))  # the law is carried to the bearing in the compiled program: faster


def assess(scene: Scene) -> Assessment:
    """Solve a scene with and without its spalls, and how stiffness changes with their sizes.

    As differentiable as `solve`, and the same errors.
    """
    return assess_prepared(prepare(scene))


def assess_mean(scene: Scene) -> Assessment | None:
    """As `assess` of a prepared scene at one phase, in the mean over all phases of the cage: there stiffness changes
    with a spall's width, whether or not a roller stands on its edge at this phase. None for a scene that is a mean
    already, has no spalls, or whose law or spalls are known at one phase only."""
    kind = LAWS.get(cast(Law, scene.law).name)  # None: a law of the user's own
    if isinstance(scene.phase, PitchMean) or not scene.spalls or (kind is not None and kind.one_scene):
        return None
    try:
        return assess_prepared(checks.checked(dataclasses.replace(scene, phase="mean")))
    except status.SceneError:
        return None


def refined(scene: Scene, progress: Progress | None = None) -> Scene:
    """A checked scene with law "auto" prepared by "direct" with contacts as exact as its `accuracy` needs.

    Contacts at 1e-2 keep 1e-2 of the results (experiments/accuracy_promise.py), so no more is made where that is
    enough. Else the next accuracy of `LADDER` is made until two results are no farther apart than asked. The error of
    the finest is the larger of its contacts' accuracy and this difference, which alone may be small by chance.
    """
    ready, before = scene, None
    for accuracy, following in zip(LADDER, (*LADDER[1:], None), strict=True):
        started = time.perf_counter()
        made = jax.block_until_ready(prepare(named(scene, "direct", accuracy), progress))
        seconds = time.perf_counter() - started
        finer = None if following is None else Finer("direct", following, seconds)
        picked = Picked("direct", accuracy, scene.accuracy, math.nan, finer)
        made = dataclasses.replace(made, accuracy=PREPARED, picked=picked)
        solution = solve_prepared(made)
        now = main_values(solution)
        error = float(np.maximum(accuracy, apart(now if before is None else before, now)))  # NaN stays NaN
        ready = dataclasses.replace(made, picked=dataclasses.replace(picked, error=error))
        if error <= scene.accuracy and not (before is None and _is_delicate(solution)):
            break
        before = now
    return ready


def _is_delicate(solution: Solution) -> bool:
    """Whether a secant stiffness is by a displacement that is a small difference of large ones: errors of contacts grow
    in it, so that one accuracy alone does not tell the error."""
    u = np.abs(np.asarray(solution.displacement))
    return solution.definition == "secant" and bool(np.min(u[[0, 2]]) < DELICATE * np.max(u[[0, 2]]))


def main_values(solution: Solution) -> np.ndarray:
    """Radial stiffness, axial stiffness [N/mm] and the largest roller load [N], shape (3,); NaN without a solution."""
    values = np.array([solution.radial_stiffness, solution.axial_stiffness, np.max(solution.loads)], float)
    return values if bool(solution.converged) else np.full(3, np.nan)


def apart(values: np.ndarray, truth: np.ndarray) -> float:
    """Largest relative difference of two `main_values` [-], where `truth` is known: there is no secant stiffness of a
    direction without load. NaN if `truth` is all NaN, or a value is NaN where it is not."""
    known = np.isfinite(truth)
    if not known.any() or np.isnan(values[known]).any():
        return math.nan
    return float(np.max(np.abs(values[known] / truth[known] - 1.0)))
