"""Scene: what is simulated and nothing more; and what comes out of it."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Annotated, Literal, NamedTuple, cast, get_args

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from annotated_types import Interval, Unit

from difftrb import direct, effects, geometry, pitch, ring, status, table
from difftrb import law as laws
from difftrb.effects import Effect, Raceways, Results, SeriesRaceways, Through
from difftrb.geometry import LineContact, Raceway, Real, Spall, TaperedBearing, as_floats
from difftrb.law import Law
from difftrb.nodes import Progress
from difftrb.ring import Load

Definition = Literal["tangent", "secant"]
DesignLoad = Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]
Accuracy = Annotated[float, Interval(ge=1e-4, le=1e-2)]
Phase = Annotated[Real, Interval(ge=-6.2832, le=6.2832), Unit("rad")]


SEVERAL_SHAPES = (
    "law = 'power' is fitted for spalls of one width, depth and axial offset; make them equal, use another law, "
    "or give the scene a law prepared with power_law"
)


BY_NODES = ("table", "direct")
TRACED = (
    "law = 'table' and law = 'direct' need numbers: prepare the scene first, difftrb.prepare(scene), and "
    "differentiate, jit or batch what comes out; derivatives stay complete"
)


@partial(jax.tree_util.register_dataclass, data_fields=[], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class PitchMean:
    """In place of a phase: the mean over one roller pitch."""


@partial(jax.tree_util.register_dataclass, data_fields=[], meta_fields=["name"])
@dataclasses.dataclass(frozen=True)
class LawName:
    """A law that is not prepared yet: `solve` builds it from the scene."""

    name: str


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["bearing", "load", "spalls", "law", "design_load", "phase", "effects"],
    meta_fields=["accuracy", "definition"],
)
@dataclasses.dataclass(frozen=True)
class Scene:
    """A bearing, its load and its spalls, and how to compute with them. A pytree: every number is a leaf.

    Attributes:
      bearing: from `difftrb.bearing("32008J")` or your own `TaperedBearing`.
      load: radial and axial [N].
      spalls: on the outer raceway, or with the effect `Raceways` on the inner one and on roller 0, too; empty is
        healthy.
      law: "power" (default), "liu2018", "palmgren", "table", "direct", or a law made before (then nothing is fitted
        here). "table" and "direct" need `prepare` before the scene is differentiated, jitted or batched.
      design_load: Q_d of the rollers' crown [N], 0…1e7. Default 6500, with which Liu et al. 2018, Table 2 comes out.
      accuracy: relative accuracy of the contact solves behind the law, 1e-2…1e-4. Default 1e-3: a power law is not
        worth more.
      definition: of stiffness, "tangent" (dF/du, default) or "secant" (F/u, as in Liu et al. 2018, Fig. 17).
      phase: angle of roller 0 from the load line [rad], −2π…2π, or "mean": everything is averaged over one roller
        pitch of cage phases.
      effects: what else acts, from `difftrb.effects`; empty is the plain ring.
    """

    bearing: TaperedBearing
    load: Load
    spalls: tuple[Spall, ...] = ()
    law: Law | LawName | str = "power"
    design_load: DesignLoad = 6500.0
    accuracy: Accuracy = 1e-3
    definition: Definition = "tangent"
    phase: Phase | PitchMean | Literal["mean"] = 0.0
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", effects.in_order(self.effects))
        if isinstance(self.phase, str):
            if self.phase != "mean":
                raise ValueError(f"phase = {self.phase!r} is unknown; give an angle [rad] or 'mean'")
            object.__setattr__(self, "phase", PitchMean())
        if isinstance(self.law, str):
            object.__setattr__(self, "law", LawName(self.law))


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["angles", "displacement", "approach", "loads", "stiffness", "load_span", "stiffness_span", "law",
                 "residual", "iterations", "status_code", "effects"],
    meta_fields=["definition"],
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
      definition: "tangent" or "secant".
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
    definition: Definition

    @property
    def radial_stiffness(self) -> jax.Array:
        """Radial force per radial displacement [N/mm]."""
        return self.stiffness[0, 0]

    @property
    def axial_stiffness(self) -> jax.Array:
        """Axial force per axial displacement [N/mm]."""
        return self.stiffness[2, 2]


def prepared_law(scene: Scene, progress: Progress | None = None, raceway: Raceway = "outer") -> Law:
    """The roller law on one of the scene's raceways, built from contact solves if it is only named.

    The power law is fitted from a sixth of the largest roller load that the scene lets expect to 1.2 times it, with
    the spalls' width, depth and axial offset, which must be one for all (else ValueError).
    """
    contact = _contact(scene, raceway)
    if not isinstance(scene.law, LawName):
        return cast(Law, scene.law).at(contact)
    spalls = ring.spalls_on(scene.spalls, raceway)
    if scene.law.name == "power" and not _of_one_shape(spalls):
        raise ValueError(SEVERAL_SHAPES)
    largest = ring.largest_load(scene.bearing, scene.load)
    if scene.law.name in BY_NODES:
        return _by_nodes(scene, raceway, largest, progress)
    spall = spalls[0] if spalls else None
    return laws.named(scene.law.name, contact, (largest / 6.0, 1.2 * largest), spall, scene.accuracy)


def _contact(scene: Scene, raceway: Raceway) -> LineContact:
    """Of the rollers with one raceway."""
    design_load = scene.design_load
    for effect in scene.effects:
        if raceway == "inner" and isinstance(effect, Raceways) and effect.inner_design_load is not None:
            design_load = effect.inner_design_load
    return LineContact.of(scene.bearing, raceway, design_load)


def _by_nodes(scene: Scene, raceway: Raceway, largest: Real, progress: Progress | None) -> Law:
    """A law from contact solves that are made one by one, outside of jit."""
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(scene)):
        raise ValueError(TRACED)
    name = cast(LawName, scene.law).name
    contact, spalls = _contact(scene, raceway), ring.spalls_on(scene.spalls, raceway)
    if name == "table" and spalls:
        return table.table_law(contact, float(largest), spalls, scene.accuracy, progress)
    law = direct.without_edges(contact, float(largest), spalls, scene.accuracy, progress)
    return direct.with_edges(law, _at_edges(scene, raceway, law), progress) if spalls else law


def _at_edges(scene: Scene, raceway: Raceway, law: direct.DirectLaw) -> list[list[tuple[float, float]]]:
    """For every spall the distances [mm] at which rollers stand on its ramps, in any phase, and their approaches [mm]
    on the healthy ring."""
    phases = _phases(scene, (pitch.Met(raceway, ring.spalls_on(scene.spalls, raceway), law),))[0]

    def healthy(phase: jax.Array) -> tuple[jax.Array, jax.Array]:
        angles = ring.roller_angles(scene.bearing, phase)
        rest = ring.equilibrium(scene.bearing, scene.load, (), law, phase)
        return ring.distances(scene.bearing, law.spalls, angles, raceway), rest.approach

    distances, approaches = map(np.asarray, jax.jit(jax.vmap(healthy))(phases))
    return [
        sorted({(abs(float(d)), max(float(a), 0.1 * float(approaches.max())))  # out of the load zone: as good as any
                for d, a in zip(distances[:, i].ravel(), approaches.ravel(), strict=True)
                if low <= 0.5 * float(spall.width) - abs(d) <= high})
        for i, spall in enumerate(law.spalls)
        for low, high in [map(float, law.ramp(i, spall, law.full[i, -1]))]
    ]  # fmt: skip


def _phases(scene: Scene, met: tuple[pitch.Met, ...], terms: ring.Terms = ring.PLAIN) -> tuple[jax.Array, jax.Array]:
    """The phases to solve at [rad] and their weights."""
    if isinstance(scene.phase, PitchMean):
        return pitch.phases(scene.bearing, scene.load, met, terms)
    return jnp.reshape(jnp.asarray(scene.phase, float), (1,)), jnp.ones(1)


def _of_one_shape(spalls: tuple[Spall, ...]) -> bool:
    """Whether all spalls are known to have one width, depth and axial offset; traced numbers are not known."""
    shapes = [(spall.width, spall.depth, spall.axial_offset) for spall in spalls]
    if len(shapes) < 2 or any(isinstance(value, jax.core.Tracer) for shape in shapes for value in shape):
        return len(shapes) < 2
    return len({tuple(float(value) for value in shape) for shape in shapes}) == 1


def prepare(scene: Scene, progress: Progress | None = None) -> Scene:
    """The scene with its law built, so that solving it again costs microseconds. Errors as in `solve`.

    A prepared "power" law is frozen: bearing, crown, and a spall's width, depth and axial offset no longer act through
    it; for complete derivatives by those, differentiate the scene with its law by name. "table" and "direct" stay
    complete, and hold for neighbours of the scene. `progress` is told how many of how many contacts are solved.
    """
    status.require_float64()
    scene = as_floats(scene)
    if scene.definition not in get_args(Definition):
        raise ValueError(f"definition = {scene.definition!r} is unknown; use one of {', '.join(get_args(Definition))}")
    if (sentence := unmet(scene)) is not None:
        raise ValueError(sentence)
    acting = tuple(
        SeriesRaceways(effect.inner_design_load, _inner_law(scene, effect, progress))
        if isinstance(effect, Raceways) else effect
        for effect in scene.effects
    )  # fmt: skip
    return dataclasses.replace(scene, law=prepared_law(scene, progress), effects=acting)


def _inner_law(scene: Scene, effect: Raceways, progress: Progress | None) -> Law:
    """Of the inner raceway: as prepared before, or named as the outer one's."""
    if isinstance(effect, SeriesRaceways):
        return cast(Law, effect.law).at(_contact(scene, "inner"))
    if not isinstance(scene.law, LawName):
        raise ValueError(
            "effects.raceways needs a law for the inner raceway: give the scene its law by name, or the effect as "
            "difftrb.effects.SeriesRaceways(law=...)"
        )
    return prepared_law(scene, progress, "inner")


def unmet(scene: Scene) -> str | None:
    """What keeps the scene's spalls and effects from being had together, in one sentence; None if nothing does."""
    keys = {effect.key for effect in scene.effects}
    name = scene.law.name if isinstance(scene.law, LawName) else None
    for i, spall in enumerate(scene.spalls):
        if spall.surface != "outer" and "raceways" not in keys:
            return (
                f"spall.{i}.surface = {spall.surface!r}: the plain ring meets spalls on the 'outer' raceway only; name "
                "effects.raceways"
            )
        if spall.surface == "roller" and isinstance(scene.phase, PitchMean):
            return (
                f"spall.{i}.surface = 'roller' belongs to one roller, so phase = 'mean' has no meaning for it; give a "
                "phase in rad"
            )
    if "raceways" in keys and name in ("palmgren", "liu2018"):
        return (
            f"contact.law = {name!r} does not know the inner raceway alone: with effects.raceways use 'power', 'table' "
            "or 'direct'"
        )
    if "tilt" in keys and not isinstance(scene.law, laws.Palmgren) and name != "palmgren":
        return "effects.tilt carries by slices of ISO/TS 16281: set contact.law = 'palmgren'"
    for effect in scene.effects:
        try:
            effect.check(scene.bearing, scene.load)
        except ValueError as error:
            return str(error)
    return None


def healthy(scene: Scene) -> Scene:
    """The same scene without spalls. Prepare first, so that both share one law."""
    return dataclasses.replace(scene, spalls=())


def solve(scene: Scene) -> Solution:
    """Load distribution and stiffness of a scene.

    Differentiable by every leaf of the scene: `jax.grad(lambda s: solve(s).stiffness[0, 0])(scene)` is a scene of
    gradients. `jit` and `vmap` as you like. Raises SolveError without float64 and ValueError for spalls, effects or a
    law that cannot be had (together); everything else ends as a status in the result.
    """
    return _solve(prepare(scene))


@jax.jit
def _solve(scene: Scene) -> Solution:
    roller_law = prepared_law(scene)
    acting = law_in_effect(scene, roller_law)

    def there(spalls: tuple[Spall, ...], phase: Real) -> effects.Ring:
        return effects.Ring(scene.bearing, scene.load, spalls, acting, _contact(scene, "outer"), phase)

    def at(phase: Real) -> tuple[ring.Equilibrium, jax.Array, Results]:
        here = there(scene.spalls, phase)
        terms = effects.terms(scene.effects, here)
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
        phases, weights = _phases(scene, _met(scene, acting), effects.terms(scene.effects, there((), 0.0)))
        every, stiffness, more = jax.vmap(at)(phases)
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
        rest.residual, rest.iterations, rest.status_code, more, scene.definition,
    )  # fmt: skip


def law_in_effect(scene: Scene, roller_law: Law) -> Law:
    """The outer raceway's law as the scene's effects have it."""
    return laws.Through(roller_law) if any(isinstance(effect, Through) for effect in scene.effects) else roller_law


def _met(scene: Scene, outer: Law) -> tuple[pitch.Met, ...]:
    """The spalls on every raceway, with the laws of rollers there."""
    met = [pitch.Met("outer", ring.spalls_on(scene.spalls, "outer"), outer)]
    for effect in scene.effects:
        if isinstance(effect, SeriesRaceways):
            met.append(pitch.Met("inner", ring.spalls_on(scene.spalls, "inner"), cast(Law, effect.law)))
    return tuple(met)


def _secant(load: Load, displacement: jax.Array) -> jax.Array:
    """Force over displacement [N/mm] on a diagonal of the displacement's size; 0 and NaN as in `Solution`."""
    force = jnp.zeros_like(displacement).at[0].set(load.radial).at[2].set(load.axial)
    loaded = jnp.arange(displacement.size) % 2 == 0
    defined = loaded & (force > 0.0) & (displacement != 0.0)
    secant = force / jnp.where(defined, displacement, 1.0)
    return jnp.diag(jnp.where(defined, secant, jnp.where(jnp.arange(displacement.size) == 1, 0.0, jnp.nan)))


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
    loss: jax.Array
    by_length: jax.Array
    by_width: jax.Array


def assess(scene: Scene) -> Assessment:
    """Solve a scene with and without its spalls, and how stiffness changes with their sizes.

    As differentiable as `solve`, and the same errors.
    """
    return _assess(prepare(scene))


@jax.jit
def _assess(scene: Scene) -> Assessment:
    sizes = jnp.array([[spall.length, spall.width] for spall in scene.spalls]).reshape(-1, 2)

    def sized(sizes: jax.Array) -> Scene:
        spalls = (dataclasses.replace(s, length=v[0], width=v[1]) for s, v in zip(scene.spalls, sizes, strict=True))
        return dataclasses.replace(scene, spalls=tuple(spalls))

    def both(sizes: jax.Array) -> tuple[jax.Array, Solution]:
        solution = _solve(sized(sizes))
        return _stiffness(solution), solution

    slopes, spalled = jax.jacfwd(both, has_aux=True)(sizes)
    slopes = jnp.where(jnp.isnan(_stiffness(spalled))[:, None, None], jnp.nan, slopes)
    sound = _solve(healthy(scene))
    loss = 1.0 - _stiffness(spalled) / _stiffness(sound)
    return Assessment(spalled, sound, 100.0 * loss, slopes[..., 0], slopes[..., 1])


def _stiffness(solution: Solution) -> jax.Array:
    return jnp.stack([solution.radial_stiffness, solution.axial_stiffness])
