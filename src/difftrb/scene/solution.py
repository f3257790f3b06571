"""What comes out of a prepared scene: loads and stiffness."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import cast

import jax
import jax.core
import jax.numpy as jnp

from difftrb.core import geometry, status
from difftrb.core.geometry import Real, Spall
from difftrb.law.base import Law
from difftrb.ring import effects, ring
from difftrb.ring.effects import Results
from difftrb.ring.ring import Load
from difftrb.scene import checks
from difftrb.scene.preparation import law_in_effect, met, phases_of, prepared_law, raceway_contact
from difftrb.scene.scene import Definition, Picked, PitchMean, Scene


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["angles", "displacement", "approach", "loads", "stiffness", "load_span", "stiffness_span", "law",
                 "residual", "iterations", "status_code", "effects", "picked"],
    meta_fields=["definition", "remarks"],
)  # fmt: skip
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

    angles: jax.Array
    displacement: jax.Array
    approach: jax.Array
    loads: jax.Array
    stiffness: jax.Array
    load_span: jax.Array
    stiffness_span: jax.Array
    law: Law
    residual: jax.Array
    iterations: jax.Array
    status_code: jax.Array
    effects: Results
    picked: Picked | None
    definition: Definition
    remarks: tuple[str, ...] = ()

    @property
    def radial_stiffness(self) -> jax.Array:
        """Radial force per radial displacement [N/mm]."""
        return self.stiffness[0, 0]

    @property
    def axial_stiffness(self) -> jax.Array:
        """Axial force per axial displacement [N/mm]."""
        return self.stiffness[2, 2]


@jax.jit
def solved(scene: Scene) -> Solution:
    """A prepared scene's solution: what `difftrb.solve` does once the law is made."""
    roller_law = prepared_law(scene)
    acting = law_in_effect(scene, roller_law)
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
    return Solution(
        angles, rest.displacement, rest.approach, rest.loads, stiffness, load_span, stiffness_span, roller_law,
        rest.residual, rest.iterations, rest.status_code, more, scene.picked, scene.definition,
        effects.remarks(scene.effects, scene.spalls),
    )  # fmt: skip


def _ring(scene: Scene, acting: Law, spalls: tuple[Spall, ...], phase: Real) -> effects.Ring:
    return effects.Ring(scene.bearing, scene.load, spalls, acting, raceway_contact(scene, "outer"), phase)


def phases(scene: Scene) -> tuple[jax.Array, jax.Array]:
    """Cage phases at which a prepared scene is solved [rad] and their weights in its mean, shape (phases,) each."""
    acting = law_in_effect(scene, prepared_law(scene))
    return phases_of(scene, met(scene, acting), effects.terms(scene.effects, _ring(scene, acting, (), 0.0)))


def _secant(load: Load, displacement: jax.Array) -> jax.Array:
    """Force over displacement [N/mm] on a diagonal of the displacement's size; 0 and NaN as in `Solution`."""
    force = jnp.zeros_like(displacement).at[0].set(load.radial).at[2].set(load.axial)
    loaded = jnp.arange(displacement.size) % 2 == 0
    defined = loaded & (force > 0.0) & (displacement != 0.0)
    secant = force / jnp.where(defined, displacement, 1.0)
    return jnp.diag(jnp.where(defined, secant, jnp.where(jnp.arange(displacement.size) == 1, 0.0, jnp.nan)))
