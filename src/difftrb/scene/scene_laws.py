"""The roller laws of a scene, for every raceway that gives way; `with_laws` is the way in.

All but "direct" are made at once, also inside jit. "direct" is made from contacts solved one by one, which needs
numbers. At one phase it is a `LocalLaw`: contacts are solved around the rollers' loads, and the ring on them, until the
loads stay. In the mean it is a `DirectLaw`, of curves over all loads.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import cast

import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap
from difftrb.core import geometry
from difftrb.core.geometry import LineContact, Raceway, Real, Spall
from difftrb.core.status import SceneError
from difftrb.law import base as laws
from difftrb.law import direct, local
from difftrb.law.base import Law, Rest
from difftrb.law.direct import DirectLaw
from difftrb.law.local import LocalLaw, Reached
from difftrb.law.samples import Progress
from difftrb.ring import effects, ring, roller_balance
from difftrb.ring.effects import DoubleRow, Raceways, SeriesRaceways, Through
from difftrb.scene import expected_loads
from difftrb.scene.scene import LawName, PitchMean, Scene, phases, raceway_contact

NOT_IN_THE_MEAN = (
    "stiffness.phase = 'mean': several spalls under one roller, or a bottom that rollers may meet, are known at one "
    "phase only; give the phase a number"
)
TRACED = (
    "law = 'direct' needs numbers: prepare the scene first, difftrb.prepare(scene), and differentiate, jit or batch "
    "what comes out; derivatives stay complete"
)
NO_INNER_LAW = (
    "effects.raceways needs a law for the inner raceway: give the scene its law by name, or the effect as "
    "difftrb.effects.SeriesRaceways(law=...)"
)
DEEP = 5.0
"""A spall deeper than Palmgren's approach so many times is deeper than a roller sinks: more than crowns make of it."""
ROUNDS = 8
"""Of contact solves around the rollers' loads, at most."""
STAYS = 0.1
"""Change of a load, in its logarithm, below which it stays."""
FARTHER = 1.05
"""By how much more than it approaches its raceway a roller is taken to reach for spalls."""
LEAST_SHARE = 0.15
"""Least share of a healthy roller's load that one over a spall is taken to carry at first."""


def with_laws(scene: Scene, progress: Progress | None = None, least: Real | None = None) -> Scene:
    """A checked scene with a law on every raceway that gives way; arguments as in `difftrb.prepare`.

    A law that is there is carried to its contact. Raises SceneError for a traced scene whose law needs numbers, where
    only the inner raceway's law is missing, and for a mean over phases that needs a `LocalLaw`.
    """
    if isinstance(scene.law, LawName) and scene.law.name == "direct" and not is_traced(scene):
        if not isinstance(scene.phase, PitchMean):
            bases = _healthy_laws(scene, progress)
            through = any(isinstance(effect, Through) for effect in scene.effects)
            return _holding(scene, bases if through else _local_laws(scene, bases, progress))
        if _may_meet_more(scene) and any(
            _meet_more(scene, raceway, base) for raceway, base in _healthy_laws(scene, progress).items()
        ):
            raise SceneError(NOT_IN_THE_MEAN)
    made: dict[Raceway, Law] = {raceway: _law(scene, raceway, progress, least) for raceway in _raceways(scene)}
    return _with_edges(scene, made, progress)


def _healthy_laws(scene: Scene, progress: Progress | None) -> dict[Raceway, DirectLaw]:
    """The curves of healthy rollers on every raceway, by contact solves."""
    largest = expected_loads.largest_for_curves(scene)
    return {
        raceway: direct.without_edges(raceway_contact(scene, raceway), largest, (), scene.accuracy, progress)
        for raceway in _lacking(scene)
    }


def is_traced(scene: Scene) -> bool:
    """Whether some of the scene's numbers are not known yet."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(scene))


def _raceways(scene: Scene) -> tuple[Raceway, ...]:
    """Those that give way."""
    return ("outer", "inner") if any(isinstance(effect, Raceways) for effect in scene.effects) else ("outer",)


def _lacking(scene: Scene) -> tuple[Raceway, ...]:
    """Those of them for which a law is to be made: the inner raceway's may be there."""
    there = any(isinstance(effect, SeriesRaceways) for effect in scene.effects)
    return ("outer",) if there else _raceways(scene)


def _holding(scene: Scene, made: Mapping[Raceway, Law]) -> Scene:
    """The scene with these laws on its raceways."""
    acting = tuple(
        SeriesRaceways(effect.inner_design_load, made["inner"])
        if isinstance(effect, Raceways) and "inner" in made
        else effect
        for effect in scene.effects
    )
    return dataclasses.replace(scene, law=made["outer"], effects=acting)


def _law(scene: Scene, raceway: Raceway, progress: Progress | None, least: Real | None) -> Law:
    """The law on one raceway, carried to its contact, or built.

    `least` is the largest roller load [N] of the lightest loaded scene that the law is to serve; default: of this one.
    """
    contact, spalls = raceway_contact(scene, raceway), ring.spalls_on(scene.spalls, raceway)
    given = scene.law
    if raceway == "inner":
        series = next((effect for effect in scene.effects if isinstance(effect, SeriesRaceways)), None)
        if series is None and not isinstance(given, LawName):
            raise SceneError(NO_INNER_LAW)
        given = given if series is None else cast(Law, series.law)
    if not isinstance(given, LawName):
        return cast(Law, given).at(contact)
    by_samples = laws.by_samples(given.name)
    if by_samples and is_traced(scene):
        raise SceneError(TRACED)
    largest = expected_loads.largest_for_curves(scene) if by_samples else expected_loads.largest_load(scene)
    request = laws.Request(contact, largest if least is None else least, largest, spalls, scene.accuracy, progress)
    return laws.made(given.name, request)


def _with_edges(scene: Scene, made: Mapping[Raceway, Law], progress: Progress | None) -> Scene:
    """The scene with these laws; those just made by "direct" get the contacts at edges that the ring will ask for.

    The phases of a mean hang on all laws, so all are made before the first edge is solved.
    """
    ready = _holding(scene, made)
    lacking: dict[Raceway, DirectLaw] = {
        raceway: law for raceway in _lacking(scene) if isinstance(law := made.get(raceway), DirectLaw) and law.spalls
    }
    if not lacking or not isinstance(scene.law, LawName):
        return ready
    every = _phases(ready)
    edged: dict[Raceway, Law] = dict(made)
    for raceway, law in lacking.items():
        edged[raceway] = direct.with_edges(law, _at_edges(scene, raceway, law, every), progress)
    return _holding(scene, edged)


@jax.jit
def _phases(scene: Scene) -> jax.Array:
    return phases(scene)[0]


def _at_edges(scene: Scene, raceway: Raceway, law: DirectLaw, every: jax.Array) -> list[list[tuple[float, float]]]:
    """For every spall the distances [mm] at which rollers stand on its ramps, in any of these phases [rad], and their
    approaches [mm] on the healthy ring."""
    distances, approaches = map(np.asarray, _healthy_approaches(expected_loads.single(scene, law), raceway, every))
    if np.isnan(approaches).any():  # no equilibrium, as the ring's status will say
        return [[] for _ in law.spalls]
    return [
        sorted({(abs(float(d)), max(float(a), 0.1 * float(approaches.max())))  # out of the load zone: as good as any
                for d, a in zip(distances[:, i].ravel(), approaches.ravel(), strict=True)
                if low <= 0.5 * float(spall.width) - abs(d) <= high})
        for i, spall in enumerate(law.spalls)
        for low, high in [map(float, law.ramp(i, spall, law.full[i, -1]))]
    ]  # fmt: skip


def _healthy_ring(scene: Scene, contact: LineContact, phase: Real) -> tuple[effects.Ring, ring.Terms]:
    """The ring of a scene with one law, without spalls, and what its effects add."""
    here = effects.Ring(scene.bearing, scene.load, (), cast(Law, scene.law), contact, phase)
    return here, effects.terms(scene.effects, here)


@partial(jax.jit, static_argnames="raceway")
def _healthy_approaches(scene: Scene, raceway: Raceway, phases: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Distances from the spalls on a raceway [mm] and approaches there on the healthy ring [mm], at every phase."""
    law = cast(DirectLaw, scene.law)

    def at(phase: jax.Array) -> tuple[jax.Array, jax.Array]:
        here, terms = _healthy_ring(scene, law.contact, phase)
        return ring.distances(scene.bearing, law.spalls, here.angles, raceway), here.equilibrium(terms).approach

    return jax.vmap(at)(phases)


def _may_meet_more(scene: Scene) -> bool:
    """Whether to ask `_meet_more`, for which contacts are solved: of several spalls, or one that is not surely deep."""
    if len(scene.spalls) > 1:
        return True
    largest = expected_loads.largest_for_curves(scene)
    deep = DEEP * float(gap.palmgren_approach(largest, float(scene.bearing.roller_length)))
    return any(float(spall.depth) < deep for spall in scene.spalls)


def _meet_more(scene: Scene, raceway: Raceway, base: DirectLaw) -> bool:
    """Whether rollers may meet several of the scene's spalls at once, or a spall's bottom, while the cage turns."""
    spalls = ring.spalls_on(scene.spalls, raceway)
    if any(isinstance(effect, Through) for effect in scene.effects) or not spalls:
        return False
    deepest = float(base.healthy[-1])
    if min(float(spall.depth) for spall in spalls) < deepest:
        return True
    reach = np.sqrt(2.0 * float(base.contact.radius) * deepest)
    half = np.array([0.5 * float(spall.width) for spall in spalls]) + reach
    turn = 2.0 * np.pi * float(geometry.arc_radius(scene.bearing, raceway))
    shares = np.array([float(spall.angle) % (2.0 * np.pi) for spall in spalls]) / (2.0 * np.pi)
    order = np.argsort(shares)
    places = np.sort(shares * turn)
    apart = np.diff(places, append=places[0] + turn)
    return bool(len(spalls) > 1 and np.any(apart < half[order] + np.roll(half[order], -1)))


def _local_laws(scene: Scene, bases: Mapping[Raceway, DirectLaw], progress: Progress | None) -> dict[Raceway, LocalLaw]:
    """The laws of every raceway for a scene at one phase, from those of healthy rollers.

    A scene whose loads do not stay keeps the last laws, and its own status says that rollers are elsewhere.
    """
    spalls: dict[Raceway, tuple[Spall, ...]] = {raceway: ring.spalls_on(scene.spalls, raceway) for raceway in bases}
    made: dict[Raceway, LocalLaw] = {raceway: LocalLaw(base, None, settling=True) for raceway, base in bases.items()}
    loads, reached = _at_rest(scene, made, spalls)
    centres = {raceway: [_guess(scene, spalls[raceway], each, loads[raceway]) for each in reached[raceway]]
               for raceway in bases}  # fmt: skip
    found = False
    for _ in range(ROUNDS):
        made = {
            raceway: local.around(base, spalls[raceway], reached[raceway], np.array(centres[raceway]), found, progress)
            for raceway, base in bases.items()
        }
        loads, now = _at_rest(scene, made, spalls)
        following = {
            raceway: [
                max(float(loads[raceway][each.roller]), float(jnp.exp(base.log_loads[0]))) for each in now[raceway]
            ]
            for raceway, base in bases.items()
        }
        same = all([each[:2] for each in now[raceway]] == [each[:2] for each in reached[raceway]] for raceway in bases)
        stays = same and all(
            abs(np.log(a / b)) < STAYS
            for raceway in bases for a, b in zip(following[raceway], centres[raceway], strict=True)
        )  # fmt: skip
        if stays and found:
            break
        found, centres, reached = stays, following, now
    return {raceway: dataclasses.replace(law, settling=False) for raceway, law in made.items()}


def _guess(scene: Scene, spalls: tuple[Spall, ...], reached: Reached, loads: np.ndarray) -> float:
    """About the load [N] of a roller, from that on a healthy ring: by the land that is left."""
    length = float(scene.bearing.roller_length)
    land = 1.0 - sum(min(float(spalls[i].length), length) for i in reached.under) / length
    return float(loads[reached.roller]) * max(land, LEAST_SHARE) + 1e-3 * float(loads.max())


def _at_rest(
    scene: Scene, made: Mapping[Raceway, LocalLaw], spalls: Mapping[Raceway, tuple[Spall, ...]]
) -> tuple[dict[Raceway, np.ndarray], dict[Raceway, list[Reached]]]:
    """What rollers carry on every raceway [N], and the spalls that they may meet there."""
    loads, away, approach = _rest(_holding(scene, made))
    rollers = scene.bearing.rollers * (2 if any(isinstance(effect, DoubleRow) for effect in scene.effects) else 1)
    share = FARTHER * (ring.OWN if len(_raceways(scene)) > 1 else 1.0)
    reached: dict[Raceway, list[Reached]] = {}
    for raceway, law in made.items():
        rest = Rest(float(law.contact.radius), share * approach, loads[raceway])
        distances = np.asarray(away[raceway])
        met = np.array([np.asarray(rest.in_reach(s, d)) for s, d in zip(spalls[raceway], distances, strict=True)])
        reached[raceway] = [
            Reached(int(j), tuple(np.flatnonzero(met[:, j]).tolist()), tuple(distances[met[:, j], j].tolist()), rollers)
            for j in (np.flatnonzero(met.any(axis=0)) if met.size else ())
        ]
    return {raceway: np.asarray(own) for raceway, own in loads.items()}, reached


@jax.jit
def _rest(scene: Scene) -> tuple[dict[Raceway, jax.Array], dict[Raceway, jax.Array], jax.Array]:
    """First row's loads on every raceway [N], distances from the spalls there [mm], and approaches [mm]."""
    law = cast(LocalLaw, scene.law)
    here = effects.Ring(scene.bearing, scene.load, scene.spalls, law, law.contact, cast(Real, scene.phase))
    terms = effects.terms(scene.effects, here)
    rest = here.equilibrium(terms)
    loads: dict[Raceway, jax.Array] = {"outer": rest.loads}
    if terms.facing is not None and terms.seat is not None:
        loads["inner"] = roller_balance.inner_load(terms.seat, rest.loads)
    away: dict[Raceway, jax.Array] = {raceway: here.distances(raceway, ring.PLAIN) for raceway in loads}
    return loads, away, rest.approach
