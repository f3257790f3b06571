"""What law "auto" is: the table where that knows the scene and is exact enough, else contact solves of its states."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import cast

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.status import SceneError
from difftrb.law.samples import Progress
from difftrb.law.table import TableLaw
from difftrb.ring.effect_base import among
from difftrb.ring.effects import Tilt
from difftrb.scene import checks, scene_laws
from difftrb.scene.prepared_scene import solve_prepared
from difftrb.scene.scene import Finer, Picked, Scene, has_map, is_auto, laws_error, named, raceway_laws
from difftrb.scene.solution import Solution

LADDER = (1e-2, 1e-3, 1e-4)
"""Accuracies of the contact solves of "auto", the cheapest first."""
UNKNOWN = (status.SLIVER, status.OTHER_CONTACT, status.SEVERAL, status.BOTTOM, status.OUTSIDE, status.UNKNOWN_LENGTH,
           status.TILTS)  # fmt: skip
"""What the table does not know, and contact solves may."""
PREPARED = 1e-3
"""`accuracy` of every scene that "auto" has prepared. It no longer matters; one value is one program for all."""
NARROW = 3.5
"""How many times as far off the worst of 400 narrow spalls is as what nine in ten keep, which the table says: 6.1e-3
for 2.0e-3 (docs/evidence.md); of wide ones few are, and less."""
TILTED = (
    "effects.tilt: contacts of rollers that tilt are solved for one scene at a time, in numbers: prepare the scene "
    "first, difftrb.prepare(scene), or take contact.law = 'palmgren', slices of ISO/TS 16281"
)
DELICATE = 0.1
"""Share of the larger displacement of two below which the other's stiffness is judged by two accuracies."""


def prepared(scene: Scene, progress: Progress | None = None) -> Scene:
    """A checked scene with law "auto" prepared by "table" where that knows the scene and keeps `accuracy`, here
    1e-3…1e-1, else by "direct" with contacts as exact as that needs, see `refined`. A traced scene, and one without a
    solution, becomes "table", whose status says why."""
    if has_map(scene) or (xp.are_numbers(scene) and _tilts(scene)):
        return refined(scene, progress)
    ready = tabled(scene)
    if not xp.are_numbers(scene):
        return ready
    unknown = int(solve_prepared(ready).status_code) in UNKNOWN
    every = cast(tuple[TableLaw, ...], raceway_laws(ready))
    coarse = any(law.error * (NARROW if _of_narrow(law) else 1.0) > scene.accuracy for law in every)
    return refined(scene, progress) if unknown or coarse else ready


def _of_narrow(law: TableLaw) -> bool:
    """Whether its error is that of spalls with both edges in reach; one without width has none."""
    return law.narrow and bool(law.error >= law.atlas.narrow_error)


def by_table(scene: Scene) -> Scene:
    """A scene with law "auto" prepared by "table", traced or not, whatever `accuracy` it asks for: `picked` says what
    the table keeps. Raises `SceneError` as `solve` does, and for height maps, which the table does not know."""
    if has_map(scene):
        raise SceneError("spall: contacts on a height map are solved for one scene at a time (difftrb run, difftrb "
                         "stiffness); sweeps and fits take rectangular spalls")  # fmt: skip
    return tabled(checks.checked(scene))


def tabled(scene: Scene) -> Scene:
    """A checked scene with the table of its contact, in any arithmetic. Raises `SceneError` for rings that tilt, of
    which it does not know."""
    if _tilts(scene):
        raise SceneError(TILTED)
    ready = scene_laws.with_laws(named(scene, "table", PREPARED))
    if not is_auto(scene):
        return dataclasses.replace(ready, accuracy=scene.accuracy)
    return dataclasses.replace(ready, picked=Picked("table", PREPARED, scene.accuracy, laws_error(ready), None))


def _tilts(scene: Scene) -> bool:
    return among(scene.effects, Tilt) is not None


def refined(scene: Scene, progress: Progress | None = None) -> Scene:
    """A checked scene with law "auto" prepared by "direct" with contacts as exact as its `accuracy` needs.

    Contacts at 1e-2 keep 1e-2 of the results (experiments/accuracy_promise.py), so no more is made where that is
    enough. Else the next accuracy of `LADDER` is made until two results are no farther apart than asked. The error of
    the finest is the larger of its contacts' accuracy and this difference, which alone may be small by chance.
    """
    ready, before = scene, None
    for accuracy, following in zip(LADDER, (*LADDER[1:], None), strict=True):
        started = time.perf_counter()
        made = jax.block_until_ready(scene_laws.with_laws(checks.checked(named(scene, "direct", accuracy)), progress))
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
