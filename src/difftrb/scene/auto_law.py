"""The law "auto": which law, and how exact contacts, keep a scene's stiffness and peak load within what is asked."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core.geometry import Real
from difftrb.core.status import SceneError
from difftrb.law import base as laws
from difftrb.law.direct import DirectLaw
from difftrb.law.samples import Progress
from difftrb.scene import preparation
from difftrb.scene.scene import Finer, LawName, Picked, Scene
from difftrb.scene.solution import Solution, solved

LEAST = 1e-3
"""`accuracy` of every scene that "auto" has prepared: it no longer matters, and one is one program for all."""
LADDER = (1e-2, 1e-3, 1e-4)
"""Accuracies of the contact solves of `direct`, the cheapest first."""
DELICATE = 0.1
"""Share of the larger displacement of two below which the other's stiffness is judged by two accuracies."""
Made = tuple[str, float]
"""A law's name and its contacts' accuracy."""
SOFT: tuple[Made, ...] = (("table", 1e-3), ("table", 1e-4))
"""Laws that many scenes can share, the cheapest first: with ramps, so that edges may move."""
SHARED: tuple[Made, ...] = (("liu2018", 1e-3), ("power", 1e-2), *SOFT)
"""The same with those of a hard window, in which a roller is over a spall or not."""


def prepare(scene: Scene, progress: Progress | None = None, least: Real | None = None) -> Scene:
    """The scene with its law built, so that solving it again costs microseconds. Errors as in `solve`.

    A prepared "power" law is frozen: bearing, crown, and a spall's width, depth and axial offset no longer act through
    it; for complete derivatives by those, differentiate the scene with its law by name. "table" and "direct" stay
    complete, and hold for neighbours of the scene. `progress` is told how many of how many contacts are solved. `least`
    is the largest roller load [N] of the lightest loaded scene that a "power" law is to serve; default: of this one.

    "auto" becomes the cheapest law that is known to keep radial stiffness, axial stiffness and the largest roller load
    of this scene within `accuracy`, here 1e-3…1e-1, relative to exact contacts. For one scene that is always "direct":
    how far a cheaper law is off is known only once "direct" is there, and then that is the better answer, with complete
    derivatives. What is chosen is its contacts' accuracy. Contacts at 1e-2 keep 1e-2 of what comes out
    (experiments/accuracy_promise.py), so no more is made where that is enough. Else it is made at 1e-3, too, and at
    1e-4 if these two are farther apart than asked. The finest one is taken. Its error is the larger of its contacts'
    accuracy and of its difference from the one before, which alone may be small by chance. Cheap laws pay where many
    scenes share one: `difftrb.sweep` chooses among them, `difftrb.fit` among tables. `picked` of what comes out, and of
    its solutions, says what was chosen.
    """
    if not is_auto(scene):
        return preparation.with_law(scene, progress, least)
    return _direct(preparation.checked(scene), progress)[0]


def _direct(scene: Scene, progress: Progress | None = None) -> tuple[Scene, float]:
    """The scene with contacts as exact as needed, and about how many seconds one of them took."""
    if preparation.is_traced(scene):
        raise SceneError(preparation.TRACED)
    ready, before, seconds = scene, None, math.nan
    for number, accuracy in enumerate(LADDER):
        started = time.perf_counter()
        made = jax.block_until_ready(by_name(scene, "direct", accuracy, progress))
        seconds = time.perf_counter() - started
        finer = None
        if number + 1 < len(LADDER):
            finer = Finer("direct", LADDER[number + 1], seconds)
        picked = Picked("direct", accuracy, scene.accuracy, math.nan, finer)
        solution = solved(_told(made, picked))
        now = promised(solution)
        error = float(np.maximum(accuracy, apart(now if before is None else before, now)))  # NaN stays NaN
        ready = _told(made, dataclasses.replace(picked, error=error))
        if error <= scene.accuracy and not (before is None and _is_delicate(solution)):
            break
        before = now
    return ready, seconds / cast(DirectLaw, ready.law).contacts


def _is_delicate(solution: Solution) -> bool:
    """Whether a secant stiffness is by a displacement that is a small difference of large ones: errors of contacts grow
    in it, so that one accuracy alone does not tell how far it is off."""
    u = np.abs(np.asarray(solution.displacement))
    return solution.definition == "secant" and bool(np.min(u[[0, 2]]) < DELICATE * np.max(u[[0, 2]]))


def by_name(scene: Scene, law: str, accuracy: float, progress: Progress | None = None) -> Scene:
    """The scene prepared by a named law."""
    return preparation.with_law(named(scene, law, accuracy), progress)


def named(scene: Scene, law: str, accuracy: float) -> Scene:
    """The scene with a law by name and the accuracy of its contacts."""
    return dataclasses.replace(scene, law=LawName(law), accuracy=accuracy)


def _told(made: Scene, picked: Picked) -> Scene:
    """`made` with what was picked for it."""
    return dataclasses.replace(made, accuracy=LEAST, picked=picked)


def is_auto(scene: Scene) -> bool:
    """Whether the scene leaves its law to be chosen."""
    return isinstance(scene.law, LawName) and scene.law.name == laws.AUTO


def promised(solution: Solution) -> np.ndarray:
    """Radial stiffness, axial stiffness [N/mm] and the largest roller load [N], shape (3,); NaN without a solution."""
    values = np.array([solution.radial_stiffness, solution.axial_stiffness, jnp.max(solution.loads)], float)
    return values if bool(solution.converged) else np.full(3, np.nan)


def apart(values: np.ndarray, truth: np.ndarray) -> float:
    """Largest relative difference of two `promised` [-]; of a direction without load there is no secant stiffness, and
    NaN if one of both is nothing else."""
    told = np.isfinite(truth)
    if not told.any() or np.isnan(values[told]).any():
        return math.nan
    return float(np.max(np.abs(values[told] / truth[told] - 1.0)))


def shared(scenes: Sequence[Scene], make: Callable[[str, float], Scene], among: Sequence[Made] = SHARED) -> Scene:
    """What `make(law, accuracy)` returns for the cheapest law that keeps `accuracy` in all of some `scenes` of "auto".

    Each of them is solved by "direct" first, see `prepare`, to a tenth of `accuracy` if it can; those without a
    solution do not count. A law's error is the largest difference from these, plus what they themselves are known to.
    If none keeps what is asked, the most exact one is taken, and `picked` says its error. Left out are laws for other
    bearings, and those for which `make` raises `SceneError`; if that leaves none, the last one's is raised.
    """
    among = [made for made in among if laws.LAWS[made[0]].is_for(scenes[0].bearing)]
    scenes = [preparation.checked(scene) for scene in scenes]
    asked = scenes[0].accuracy
    exact = [(scene, *_direct(dataclasses.replace(scene, accuracy=0.1 * asked))) for scene in scenes]
    best: Scene | None = None
    for number, (law, accuracy) in enumerate(among):
        try:
            made = make(law, accuracy)
        except ValueError:
            if best is None and number + 1 == len(among):
                raise
            continue
        errors = [_error(made, scene, truth) for scene, truth, _ in exact if bool(solved(truth).converged)]
        finer = None
        if number + 1 < len(among):
            following, its = among[number + 1]
            effort = laws.LAWS[following].effort(its)
            finer = Finer(following, its, effort * min(seconds for *_, seconds in exact))
        picked = Picked(law, accuracy, asked, max(errors, key=_size, default=math.nan), finer)
        made = _told(made, picked)
        if best is None or _size(picked.error) < _size(cast(Picked, best.picked).error):
            best = made
        if picked.error <= picked.asked:
            return made
    return cast(Scene, best)


def _error(made: Scene, scene: Scene, truth: Scene) -> float:
    """Of a scene by the law of another one that was prepared."""
    by_law = dataclasses.replace(scene, law=made.law, effects=made.effects)
    off = apart(promised(solved(preparation.with_law(by_law))), promised(solved(truth)))
    return off + float(cast(Picked, truth.picked).error)


def _size(error: Real) -> float:
    """For comparing: what is not known is larger than all that is."""
    return math.inf if math.isnan(error) else float(error)
