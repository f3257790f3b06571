"""From a scene to numbers: `prepare` builds its laws, `solve` gives loads and stiffness, `assess` what spalls take."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import TYPE_CHECKING, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import geometry, status
from difftrb.core.geometry import Real, Spall
from difftrb.law.base import LAWS, Law
from difftrb.law.samples import Progress
from difftrb.ring import effects, ring
from difftrb.ring.effects import Raceways, Results
from difftrb.ring.ring import Load
from difftrb.scene import checks, scene_laws
from difftrb.scene.scene import (
    Definition,
    Finer,
    LawName,
    Picked,
    PitchMean,
    Scene,
    healthy,
    is_auto,
    law_in_effect,
    named,
    outer_law,
    phases,
    raceway_contact,
)

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float, Int

LADDER = (1e-2, 1e-3, 1e-4)
"""Accuracies of the contact solves of "auto", the cheapest first."""
UNKNOWN = (status.SLIVER, status.OTHER_CONTACT, status.SEVERAL, status.BOTTOM, status.OUTSIDE, status.UNKNOWN_LENGTH)
"""What the table does not know, and contact solves may."""
PREPARED = 1e-3
"""`accuracy` of every scene that "auto" has prepared. It no longer matters; one value is one program for all."""
DELICATE = 0.1
"""Share of the larger displacement of two below which the other's stiffness is judged by two accuracies."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Solution(status.Judged):
    """A solved scene.

    Attributes:
      angles: of the rollers from the load line [rad], shape (rollers,); with phase "mean" at its middle, half a pitch
        on. All else is then the mean over the phases: of one roller as it rolls on to the next one's place.
      displacement: radial, lateral, axial [mm], shape (3,); with the effect `Tilt` also about the radial and the
        lateral axis [rad], shape (5,), and stiffness of shape (5, 5).
      approach: of every roller [mm], shape (rollers,). loads: on the outer raceway [N], shape (rollers,).
      stiffness: [N/mm], shape (3, 3) over radial, lateral, axial: dF/du if `definition` is "tangent"; the diagonal of
        F/u if "secant" (0 for the lateral direction, which has no load; NaN for a direction without load).
      load_span, stiffness_span: least and largest over the phases, shapes (2, rollers) and (2, 3, 3); the same twice
        at one phase.
      law: the roller law that was used, with its range and error.
      residual: largest unbalanced force relative to the load. iterations: Newton steps.
      status_code: see `difftrb.status`; `status` is its sentence.
      effects: what the scene's effects add, by name; empty without.
      picked: what the law "auto" became; None if the law was named.
      definition: "tangent" or "secant".
      remarks: what is to be said of these numbers, in sentences; mostly none.
    """

    angles: Float[Array, " rollers"]
    displacement: Float[Array, " axes"]
    approach: Float[Array, " rollers"]
    loads: Float[Array, " rollers"]
    stiffness: Float[Array, "axes axes"]
    load_span: Float[Array, "2 rollers"]
    stiffness_span: Float[Array, "2 axes axes"]
    law: Law
    residual: Float[Array, ""]
    iterations: Int[Array, ""]
    status_code: Int[Array, ""]
    effects: Results
    picked: Picked | None
    definition: Definition = dataclasses.field(metadata={"static": True})
    remarks: tuple[str, ...] = dataclasses.field(default=(), metadata={"static": True})

    @property
    def radial_stiffness(self) -> jax.Array:
        """Radial force per radial displacement [N/mm]."""
        return self.stiffness[0, 0]

    @property
    def axial_stiffness(self) -> jax.Array:
        """Axial force per axial displacement [N/mm]."""
        return self.stiffness[2, 2]

    @property
    def both_stiffnesses(self) -> jax.Array:
        """Radial and axial [N/mm], shape (2,)."""
        return jnp.stack([self.radial_stiffness, self.axial_stiffness])


class Assessment(NamedTuple):
    """A spalled bearing beside its healthy self.

    Attributes:
      spalled, healthy: the two solutions.
      loss: of radial and axial stiffness by the spalls [%], shape (2,).
      by_length, by_width: derivatives of radial and axial stiffness by every spall's length and width, the roller law
        held as prepared [N/mm per mm], shape (2, number of spalls); NaN where the stiffness is.
    """

    spalled: Solution
    healthy: Solution
    loss: Float[Array, " directions"]
    by_length: Float[Array, "directions spalls"]
    by_width: Float[Array, "directions spalls"]


def prepare(scene: Scene, progress: Progress | None = None, least: Real | None = None) -> Scene:
    """The scene with its laws built, so that solving it again costs microseconds. Errors as in `solve`.

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
    ready = scene_laws.with_laws(named(checks.checked(scene), "table", PREPARED))
    picked = Picked("table", PREPARED, scene.accuracy, cast(Law, ready.law).error, None)
    return dataclasses.replace(ready, picked=picked)


def solve(scene: Scene) -> Solution:
    """Load distribution and stiffness of a scene.

    Differentiable by every leaf of the scene: `jax.grad(lambda s: solve(s).stiffness[0, 0])(scene)` is a scene of
    gradients. `jit` and `vmap` as you like. Raises `SolveError` without float64, `SceneError` (a ValueError) for what a
    scene file would refuse, see `Scene`, and for a law that needs `prepare` first; everything else ends as a status in
    the result.
    """
    if isinstance(scene.law, LawName) or any(isinstance(effect, Raceways) for effect in scene.effects):
        return solve_prepared(prepare(scene))
    return solve_prepared(checks.checked(scene))  # the law is carried to the bearing in the compiled program: faster


def assess(scene: Scene) -> Assessment:
    """Solve a scene with and without its spalls, and how stiffness changes with their sizes.

    As differentiable as `solve`, and the same errors.
    """
    return _assess(prepare(scene))


def assess_mean(scene: Scene) -> Assessment | None:
    """As `assess` of a prepared scene at one phase, in the mean over all phases of the cage: there stiffness changes
    with a spall's width, whether or not a roller stands on its edge at this phase. None for a scene that is a mean
    already, has no spalls, or whose law or spalls are known at one phase only."""
    kind = LAWS.get(cast(Law, scene.law).name)  # None: a law of the user's own
    if isinstance(scene.phase, PitchMean) or not scene.spalls or (kind is not None and kind.one_scene):
        return None
    try:
        return _assess(checks.checked(dataclasses.replace(scene, phase="mean")))
    except status.SceneError:
        return None


@jax.jit
def _assess(scene: Scene) -> Assessment:
    sizes = jnp.array([[spall.length, spall.width] for spall in scene.spalls]).reshape(-1, 2)

    def sized(sizes: jax.Array) -> tuple[jax.Array, Solution]:
        spalls = (dataclasses.replace(s, length=v[0], width=v[1]) for s, v in zip(scene.spalls, sizes, strict=True))
        solution = solve_prepared(dataclasses.replace(scene, spalls=tuple(spalls)))
        return solution.both_stiffnesses, solution

    slopes, spalled = jax.jacfwd(sized, has_aux=True)(sizes)
    slopes = jnp.where(jnp.isnan(spalled.both_stiffnesses)[:, None, None], jnp.nan, slopes)
    whole = solve_prepared(healthy(scene))
    loss = 1.0 - spalled.both_stiffnesses / whole.both_stiffnesses
    return Assessment(spalled, whole, 100.0 * loss, slopes[..., 0], slopes[..., 1])


@jax.jit
def solve_prepared(scene: Scene) -> Solution:
    """The solution of a scene whose laws are built."""
    law = outer_law(scene)
    acting = law_in_effect(scene, law)
    within = checks.code(scene)

    def at(phase: Real) -> tuple[ring.Equilibrium, jax.Array, Results]:
        here = _ring(scene, acting, scene.spalls, phase)
        terms = effects.terms(scene.effects, here)
        terms = terms._replace(known=within if terms.known is None else status.worst(within, terms.known))
        rest = here.equilibrium(terms)
        more = effects.results(scene.effects, rest, terms, here)
        if scene.definition == "tangent":
            return rest, rest.tangent, more
        axial = more["axial_force"] if terms.axial is not None else scene.load.axial
        return rest, _secant(dataclasses.replace(scene.load, axial=axial), rest.displacement), more

    if not isinstance(scene.phase, PitchMean):
        rest, stiffness, more = at(cast(Real, scene.phase))
        load_span, stiffness_span = jnp.stack([rest.loads] * 2), jnp.stack([stiffness] * 2)
        angles = ring.roller_angles(scene.bearing, cast(Real, scene.phase))
    else:
        each, weights = phases(scene)
        every, stiffness, more = jax.vmap(at)(each)
        load_span, stiffness_span = (jnp.stack([jnp.min(v, 0), jnp.max(v, 0)]) for v in (every.loads, stiffness))
        rest = ring.Equilibrium(
            *(jnp.tensordot(weights, v, 1) for v in (every.displacement, every.approach, every.loads, every.tangent)),
            residual=jnp.max(every.residual),
            iterations=jnp.max(every.iterations),
            status_code=jnp.max(every.status_code),
        )
        stiffness, more = jax.tree.map(lambda v: jnp.tensordot(weights, v, 1), (stiffness, more))
        angles = ring.roller_angles(scene.bearing, 0.5 * geometry.roller_pitch(scene.bearing))
    told = getattr(law, "light", law)
    return Solution(
        angles, rest.displacement, rest.approach, rest.loads, stiffness, load_span, stiffness_span, told,
        rest.residual, rest.iterations, rest.status_code, more, scene.picked, scene.definition,
        effects.remarks(scene.effects, scene.spalls),
    )  # fmt: skip


def _ring(scene: Scene, acting: Law, spalls: tuple[Spall, ...], phase: Real) -> effects.Ring:
    return effects.Ring(scene.bearing, scene.load, spalls, acting, raceway_contact(scene, "outer"), phase)


def _secant(load: Load, displacement: jax.Array) -> jax.Array:
    """Force over displacement [N/mm] on a diagonal of the displacement's size; 0 and NaN as in `Solution`."""
    force = jnp.zeros_like(displacement).at[0].set(load.radial).at[2].set(load.axial)
    loaded = jnp.arange(displacement.size) % 2 == 0
    defined = loaded & (force > 0.0) & (displacement != 0.0)
    secant = force / jnp.where(defined, displacement, 1.0)
    return jnp.diag(jnp.where(defined, secant, jnp.where(jnp.arange(displacement.size) == 1, 0.0, jnp.nan)))


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
    values = np.array([solution.radial_stiffness, solution.axial_stiffness, jnp.max(solution.loads)], float)
    return values if bool(solution.converged) else np.full(3, np.nan)


def apart(values: np.ndarray, truth: np.ndarray) -> float:
    """Largest relative difference of two `main_values` [-], where `truth` is known: there is no secant stiffness of a
    direction without load. NaN if `truth` is all NaN, or a value is NaN where it is not."""
    known = np.isfinite(truth)
    if not known.any() or np.isnan(values[known]).any():
        return math.nan
    return float(np.max(np.abs(values[known] / truth[known] - 1.0)))
