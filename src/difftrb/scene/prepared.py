"""The solution of a scene whose laws are built: loads, stiffness, and what spalls take of it.

A plain ring in numbers is solved at once, in numpy; what is traced, and what needs effects, by a program of JAX.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry, implicit, status
from difftrb.core.geometry import Real, Spall
from difftrb.core.taylor import Taylor
from difftrb.law.base import Law
from difftrb.ring import effects, plain_ring, ring
from difftrb.ring.effects import Results
from difftrb.ring.ring import Load
from difftrb.scene import checks
from difftrb.scene.scene import (
    Definition,
    Picked,
    PitchMean,
    Scene,
    healthy,
    is_plain,
    law_in_effect,
    outer_law,
    phases,
    raceway_contact,
)

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float, Int


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
        return xp.stack([self.radial_stiffness, self.axial_stiffness])


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


def assess_prepared(scene: Scene) -> Assessment:
    """`assess` of a scene whose laws are built: of a plain ring's numbers at once, else by a program."""
    if is_plain(scene) and xp.are_numbers(scene):
        with np.errstate(all="ignore"):
            return jax.device_put(_assess_numbers(xp.numbers(scene)))
    return assess_by_program(scene)


def _assess_numbers(scene: Scene) -> Assessment:
    count = len(scene.spalls)
    seeds = np.eye(2 * count).reshape(count, 2, 2 * count)
    spalls = tuple(
        dataclasses.replace(spall, length=Taylor(spall.length, by=rows[0]), width=Taylor(spall.width, by=rows[1]))
        for spall, rows in zip(scene.spalls, seeds, strict=True)
    )
    spalled = _expanded(dataclasses.replace(scene, spalls=spalls))
    slopes = np.zeros((2, count, 2))
    stiffness = spalled.stiffness
    if isinstance(stiffness, Taylor) and stiffness.by is not None:
        slopes = np.stack([stiffness.by[:, k, k] for k in (0, 2)]).reshape(slopes.shape)
    spalled, whole = xp.values((spalled, _expanded(healthy(scene))))
    return _assessed(spalled, whole, slopes)


def _assessed(spalled: Solution, whole: Solution, slopes: Any) -> Assessment:
    """From both solutions, and the derivatives of radial and axial stiffness by length and width, shape (2, spalls,
    2)."""
    of = xp.of(spalled.stiffness)
    ours, theirs = (of.diagonal(each.stiffness)[np.array([0, 2])] for each in (spalled, whole))
    slopes = of.where(of.isnan(ours)[:, None, None], np.nan, slopes)
    return Assessment(spalled, whole, 100.0 * (1.0 - ours / theirs), slopes[..., 0], slopes[..., 1])


@jax.jit
def assess_by_program(scene: Scene) -> Assessment:
    sizes = jnp.array([[spall.length, spall.width] for spall in scene.spalls]).reshape(-1, 2)

    def sized(sizes: jax.Array) -> tuple[jax.Array, Solution]:
        spalls = (dataclasses.replace(s, length=v[0], width=v[1]) for s, v in zip(scene.spalls, sizes, strict=True))
        solution = solve_prepared(dataclasses.replace(scene, spalls=tuple(spalls)))
        return solution.both_stiffnesses, solution

    slopes, spalled = jax.jacfwd(sized, has_aux=True)(sizes)
    return _assessed(spalled, solve_prepared(healthy(scene)), slopes)


def solve_prepared(scene: Scene) -> Solution:
    """The solution of a scene whose laws are built: of a plain ring's numbers at once, else by a program."""
    return solve_plain(_as_it_is, scene) if is_plain(scene) else _by_program(_as_it_is, scene)


def _as_it_is(scene: Scene) -> Scene:
    return scene


Build = Callable[[Scene], Scene]
"""What builds a scene's laws, in any arithmetic."""


def solve_plain(build: Build, scene: Scene) -> Solution:
    """A plain ring: numbers at once, also those that `jax.grad` differentiates outside `jit`; else by a program. Its
    derivatives are those of its expansion."""
    if not xp.are_numbers(scene):
        return implicit.expanded(partial(_at_once_or_by_program, build), scene)
    solution = xp.values(_at_once_or_by_program(build, scene))
    with jax.ensure_compile_time_eval():  # numbers stay numbers where a program closes over them
        return jax.device_put(solution)


def _at_once_or_by_program(build: Build, scene: Scene) -> Solution:
    if not xp.are_numbers(scene):
        return _by_program(build, scene)
    with np.errstate(all="ignore"):
        return _solution(build, xp.numbers(scene))


def _solution(build: Build, scene: Scene) -> Solution:
    ready = build(scene)
    at_once = is_plain(ready) and (xp.are_numbers(ready) or xp.expands(ready))
    return _expanded(ready) if at_once else _traced(ready)


_by_program = jax.jit(_solution, static_argnums=0)


def _expanded(scene: Scene) -> Solution:
    """A plain ring's solution in any arithmetic."""
    acting = outer_law(scene)
    each, weights = phases(scene)
    within = checks.code(xp.fixed(scene))
    rest = plain_ring.equilibrium(scene.bearing, scene.load, scene.spalls, acting, each, within)
    stiffness = rest.tangent if scene.definition == "tangent" else secant(scene.load, rest.displacement)
    return _of_phases(scene, rest, stiffness, weights, {})


def _of_phases(scene: Scene, every: ring.Equilibrium, stiffness: Any, weights: Any, more: Results) -> Solution:
    """The solution, of rings at rest at all phases."""

    def mean(value: Any) -> Any:
        rows = value.reshape(value.shape[0], -1)
        return xp.einsum("p,pi->i", weights, rows).reshape(*value.shape[1:])

    def span(value: Any) -> Any:
        of = xp.of(value)
        return xp.stack([xp.taken(value, pick(xp.value(value), axis=0)) for pick in (of.argmin, of.argmax)])

    if isinstance(scene.phase, PitchMean):
        middle: Any = 0.5 * geometry.roller_pitch(scene.bearing)
        of_every = mean
    else:
        middle = scene.phase
        of_every = operator.itemgetter(0)
    of = xp.of(every.residual)
    return Solution(
        angles=ring.roller_angles(scene.bearing, middle),
        displacement=of_every(every.displacement),
        approach=of_every(every.approach),
        loads=of_every(every.loads),
        stiffness=of_every(stiffness),
        load_span=span(every.loads),
        stiffness_span=span(stiffness),
        law=outer_law(scene),
        residual=of.max(every.residual),
        iterations=of.max(every.iterations),
        status_code=of.max(every.status_code),
        effects=jax.tree.map(of_every, more),
        picked=scene.picked,
        definition=scene.definition,
        remarks=effects.remarks(scene.effects, scene.spalls),
    )


def _traced(scene: Scene) -> Solution:
    """The solution of a scene in arrays of JAX, with all its effects."""
    acting = law_in_effect(scene, outer_law(scene))
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
        return rest, secant(dataclasses.replace(scene.load, axial=axial), rest.displacement), more

    if isinstance(scene.phase, PitchMean):
        each, weights = phases(scene)
        every, stiffness, more = jax.vmap(at)(each)
    else:
        weights = np.ones(1)
        every, stiffness, more = jax.tree.map(lambda v: jnp.asarray(v)[None], at(cast(Real, scene.phase)))
    return _of_phases(scene, every, stiffness, weights, more)


def _ring(scene: Scene, acting: Law, spalls: tuple[Spall, ...], phase: Real) -> effects.Ring:
    return effects.Ring(scene.bearing, scene.load, spalls, acting, raceway_contact(scene, "outer"), phase)


def secant(load: Load, displacement: Any) -> Any:
    """Force over displacement [N/mm] on a diagonal of the displacement's size, shape (…, n, n); 0 and NaN as in
    `Solution`."""
    count, parts = displacement.shape[-1], []
    for k in range(count):
        force, way = {0: load.radial, 2: load.axial}.get(k, 0.0), displacement[..., k]
        defined = (force > 0.0) & (way != 0.0)
        parts.append(xp.where(defined, force / xp.where(defined, way, 1.0), 0.0 if k == 1 else np.nan))
    diagonal = xp.stack(parts, axis=-1)[..., None, :]
    own = np.eye(count, dtype=bool).reshape((1,) * (diagonal.ndim - 2) + (count, count))
    return xp.where(own, diagonal, 0.0)
