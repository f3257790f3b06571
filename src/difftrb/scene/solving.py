"""From a scene to numbers: `prepare` builds its laws, `solve` gives loads and stiffness, `assess` what spalls take."""

from __future__ import annotations

import dataclasses
from typing import cast

from difftrb.core import arrays as xp
from difftrb.core.geometry import Real
from difftrb.law import base
from difftrb.law.base import AUTO, Law
from difftrb.law.samples import Progress
from difftrb.ring import effect_base
from difftrb.ring.effects import Raceways
from difftrb.scene import auto_law, checks, scene_laws
from difftrb.scene.prepared_scene import assess_prepared, solve_prepared
from difftrb.scene.scene import LawName, PitchMean, Scene, is_auto
from difftrb.scene.solution import Assessment, Solution


def prepare(scene: Scene, progress: Progress | None = None, least: Real | None = None) -> Scene:
    """The scene with its laws built, so that solving it again costs milliseconds, or microseconds in a jitted batch.
    Errors as in `solve`.

    A prepared "power" law is frozen: bearing, crown, and a spall's width, depth and axial offset no longer act through
    it. For complete derivatives by those, differentiate the scene with its law by name. "table" needs no preparing.
    "direct" stays complete, and holds for neighbours of the scene. `progress` is told how many of how many contacts are
    solved. `least` is the largest roller load [N] of the lightest loaded scene that a "power" law is to serve; default:
    of this one.

    "auto" becomes what `auto_law.prepared` chooses; `picked` of the result, and of its solutions, says what that was.
    """
    scene = checks.checked(scene)
    return auto_law.prepared(scene, progress) if is_auto(scene) else scene_laws.with_laws(scene, progress, least)


def solve(scene: Scene) -> Solution:
    """Load distribution and stiffness of a scene.

    Differentiable by every leaf of the scene: `jax.grad(lambda s: solve(s).stiffness[0, 0])(scene)` is a scene of
    gradients. `jit` and `vmap` as you like. Raises `SolveError` without float64, `SceneError` (a ValueError) for what a
    scene file would refuse, see `Scene`, and for a law that needs `prepare` first; everything else ends as a status in
    the result.
    """
    law = getattr(scene, "law", None)  # `checked` says what is no scene
    if isinstance(law, LawName) and law.name in (AUTO, "table"):
        scene = checks.checked(scene)
        if not xp.are_numbers(scene):
            return solve_prepared(scene, auto_law.tabled)
    if law is None or isinstance(law, LawName) or effect_base.among(scene.effects, Raceways) is not None:
        return solve_prepared(prepare(scene))
    return solve_prepared(checks.checked(scene))  # the law is carried to the bearing in the compiled program: faster


def assess(scene: Scene) -> Assessment:
    """Solve a scene with and without its spalls, and how stiffness changes with their sizes.

    As differentiable as `solve`, and the same errors.
    """
    return assess_prepared(prepare(scene))


def assess_mean(scene: Scene, anew: Scene | None = None, progress: Progress | None = None) -> Assessment | None:
    """As `assess` of a prepared scene at one phase, in the mean over all phases of the cage: there stiffness changes
    with a spall's width, whether or not a roller stands on its edge at this phase.

    A law that is made for one phase is prepared for all of them, from `anew`, the scene as it was before; that takes as
    long as `prepare` of a mean. None without it, for a scene that is a mean already or has no spalls, and for a spall
    on a roller, which belongs to that one.
    """
    no_mean = isinstance(scene.phase, PitchMean) or any(spall.surface == "roller" for spall in scene.spalls)
    if no_mean or not scene.spalls:
        return None
    if not base.kind(cast(Law, scene.law).name).one_scene:
        return assess_prepared(checks.checked(dataclasses.replace(scene, phase="mean")))
    return None if anew is None else assess_prepared(prepare(dataclasses.replace(anew, phase="mean"), progress))
