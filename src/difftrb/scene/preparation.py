"""A scene made ready to be solved: its roller laws built, from contact solves if they are only named."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import cast

import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap
from difftrb.core import geometry, status
from difftrb.core.geometry import LineContact, Raceway, Real, as_floats
from difftrb.law import base as laws
from difftrb.law import direct, power
from difftrb.law.base import Law
from difftrb.law.samples import Progress
from difftrb.ring import effects, phase_average, ring
from difftrb.ring.effects import Raceways, SeriesRaceways, Through
from difftrb.scene import checks, settling
from difftrb.scene.scene import LawName, PitchMean, Scene

NOT_IN_THE_MEAN = (
    "stiffness.phase = 'mean': several spalls under one roller, or a bottom that rollers may meet, are known at one "
    "phase only; give the phase a number"
)
WIDE, SPARE = 1.0, 2.5
"""From a spall this wide on, by the rollers' pitch, with through spalls, or where effects press, curves reach so many
times farther."""
DEEP = 5.0
"""By how many times Palmgren's approach a spall is surely deeper than a roller sinks: more than crowns make of it."""
TRACED = (
    "law = 'table', 'direct' and 'auto' need numbers: prepare the scene first, difftrb.prepare(scene), and "
    "differentiate, jit or batch what comes out; derivatives stay complete"
)


def is_traced(scene: Scene) -> bool:
    """Whether some of the scene's numbers are not known yet."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(scene))


def prepared_law(
    scene: Scene, progress: Progress | None = None, raceway: Raceway = "outer", least: Real | None = None
) -> Law:
    """The roller law on one of the scene's raceways, built from contact solves if it is only named.

    `least` is the largest roller load [N] of the lightest loaded scene that the law is to serve; default: of this one.
    """
    contact = raceway_contact(scene, raceway)
    if not isinstance(scene.law, LawName):
        return cast(Law, scene.law).at(contact)
    spalls, by_samples = ring.spalls_on(scene.spalls, raceway), laws.by_samples(scene.law.name)
    if by_samples and is_traced(scene):
        raise status.SceneError(TRACED)
    largest = _largest_for_curves(scene) if by_samples else _largest_load(scene)
    request = laws.Request(contact, largest if least is None else least, largest, spalls, scene.accuracy, progress)
    law = laws.made(scene.law.name, request)
    if isinstance(law, direct.DirectLaw) and spalls:
        return direct.with_edges(law, _at_edges(scene, raceway, law), progress)
    return law


def _largest_load(scene: Scene) -> Real:
    """A first estimate of the most loaded roller's load [N], by the load and by what else presses."""
    largest = ring.largest_load(scene.bearing, scene.load)
    if not any(effect.presses for effect in scene.effects):
        return largest
    pressed = _pressed(dataclasses.replace(scene, law=power.Palmgren(scene.bearing.roller_length), spalls=()))
    return jnp.maximum(largest, pressed)


def _largest_for_curves(scene: Scene) -> float:
    """The same for laws that know nothing beyond their loads: more, where spalls may take their load from several
    rollers, or all of it from one."""
    pitch = float(geometry.roller_pitch(scene.bearing) * geometry.arc_radius(scene.bearing))
    wide = any(float(spall.width) > WIDE * pitch for spall in scene.spalls)
    through = scene.spalls and any(isinstance(effect, Through) for effect in scene.effects)
    plain, largest = float(ring.largest_load(scene.bearing, scene.load)), float(_largest_load(scene))
    # in steps: what presses a little more shares the nodes, so that neighbouring scenes differ by physics alone
    halves = max(math.ceil(2.0 * math.log2(largest / plain)), 0) if plain > 0.0 else 0
    pressed = plain * 2.0 ** (0.5 * halves) if plain > 0.0 else largest
    return pressed * (SPARE if wide or through or halves else 1.0)


@jax.jit
def _pressed(scene: Scene) -> jax.Array:
    """The largest load [N] on the healthy ring, by Palmgren's law: by a third or so too large for one contact alone,
    and by more if the inner one gives way, too."""
    acting = tuple(effect for effect in scene.effects if not isinstance(effect, Raceways))  # its law is not made yet
    contact = raceway_contact(scene, "outer")
    here = effects.Ring(scene.bearing, scene.load, (), cast(Law, scene.law), contact, 0.0)
    rest = here.equilibrium(effects.terms(acting, here))
    loads = rest.loads if rest.second_loads is None else jnp.concatenate([rest.loads, rest.second_loads])
    return jnp.nan_to_num(jnp.max(loads))


def raceway_contact(scene: Scene, raceway: Raceway) -> LineContact:
    """Of the rollers with one raceway."""
    design_load = scene.design_load
    for effect in scene.effects:
        if raceway == "inner" and isinstance(effect, Raceways) and effect.inner_design_load is not None:
            design_load = effect.inner_design_load
    return LineContact.of(scene.bearing, raceway, design_load)


def _at_edges(scene: Scene, raceway: Raceway, law: direct.DirectLaw) -> list[list[tuple[float, float]]]:
    """For every spall the distances [mm] at which rollers stand on its ramps, in any phase, and their approaches [mm]
    on the healthy ring."""
    acting = tuple(effect for effect in scene.effects if not isinstance(effect, Raceways))  # its law is not made yet
    bare = dataclasses.replace(scene, law=law, effects=acting, accuracy=1e-3)  # one program for all
    met = (phase_average.Met(raceway, ring.spalls_on(scene.spalls, raceway), law),)
    phases = phases_of(scene, met, _healthy_ring(bare, 0.0)[1])[0]
    distances, approaches = map(np.asarray, _healthy_approaches(bare, raceway, phases))
    if np.isnan(approaches).any():  # no equilibrium, as the ring's status will say
        return [[] for _ in law.spalls]
    return [
        sorted({(abs(float(d)), max(float(a), 0.1 * float(approaches.max())))  # out of the load zone: as good as any
                for d, a in zip(distances[:, i].ravel(), approaches.ravel(), strict=True)
                if low <= 0.5 * float(spall.width) - abs(d) <= high})
        for i, spall in enumerate(law.spalls)
        for low, high in [map(float, law.ramp(i, spall, law.full[i, -1]))]
    ]  # fmt: skip


def _healthy_ring(scene: Scene, phase: Real) -> tuple[effects.Ring, ring.Terms]:
    """Without spalls, by the scene's direct law, and what its effects add."""
    law = cast(direct.DirectLaw, scene.law)
    here = effects.Ring(scene.bearing, scene.load, (), law, law.contact, phase)
    return here, effects.terms(scene.effects, here)


@partial(jax.jit, static_argnames="raceway")
def _healthy_approaches(scene: Scene, raceway: Raceway, phases: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Distances from the spalls on a raceway [mm] and approaches there on the healthy ring [mm], at every phase."""
    spalls = cast(direct.DirectLaw, scene.law).spalls

    def at(phase: jax.Array) -> tuple[jax.Array, jax.Array]:
        here, terms = _healthy_ring(scene, phase)
        return ring.distances(scene.bearing, spalls, here.angles, raceway), here.equilibrium(terms).approach

    return jax.vmap(at)(phases)


def phases_of(
    scene: Scene, met: tuple[phase_average.Met, ...], terms: ring.Terms = ring.PLAIN
) -> tuple[jax.Array, jax.Array]:
    """The phases to solve at [rad] and their weights."""
    if isinstance(scene.phase, PitchMean):
        return phase_average.phases(scene.bearing, scene.load, met, terms)
    return jnp.reshape(jnp.asarray(scene.phase, float), (1,)), jnp.ones(1)


def has_its_laws(scene: Scene) -> bool:
    """Whether nothing has to be built for the scene, nor carried to its inner raceway."""
    return not isinstance(scene.law, LawName) and not any(isinstance(effect, Raceways) for effect in scene.effects)


def checked(scene: Scene) -> Scene:
    """The scene in floats. Raises `SolveError` without float64, `SceneError` for what cannot be had."""
    status.require_float64()
    checks.refuse(scene)
    return as_floats(scene)


def with_law(scene: Scene, progress: Progress | None = None, least: Real | None = None) -> Scene:
    """The scene with its law built, unless that is to be chosen: see `difftrb.prepare`."""
    scene = checked(scene)
    if isinstance(scene.law, LawName) and scene.law.name == "direct" and not is_traced(scene) and _may_be(scene):
        bases = _healthy_laws(scene, progress)
        if any(_is_met_otherwise(scene, raceway, base) for raceway, base in bases.items()):
            if isinstance(scene.phase, PitchMean):
                raise status.SceneError(NOT_IN_THE_MEAN)
            return settling.with_laws(scene, settling.settled(scene, bases, progress))
    acting = tuple(
        SeriesRaceways(effect.inner_design_load, _inner_law(scene, effect, progress, least))
        if isinstance(effect, Raceways) else effect
        for effect in scene.effects
    )  # fmt: skip
    return dataclasses.replace(scene, law=prepared_law(scene, progress, least=least), effects=acting)


def _may_be(scene: Scene) -> bool:
    """Whether to ask `_is_met_otherwise`, which takes contacts: of several spalls, or one that is not surely deep."""
    largest, length = _largest_for_curves(scene), float(scene.bearing.roller_length)
    deep = DEEP * float(gap.palmgren_approach(largest, length))
    return len(scene.spalls) > 1 or any(float(spall.depth) < deep for spall in scene.spalls)


def _healthy_laws(scene: Scene, progress: Progress | None) -> dict[Raceway, direct.DirectLaw]:
    """Of healthy rollers, on every raceway that gives way."""
    raceways: list[Raceway] = ["outer"]
    if any(isinstance(effect, Raceways) for effect in scene.effects):
        raceways.append("inner")
    largest = _largest_for_curves(scene)
    return {
        raceway: direct.without_edges(raceway_contact(scene, raceway), largest, (), scene.accuracy, progress)
        for raceway in raceways
    }


def _is_met_otherwise(scene: Scene, raceway: Raceway, base: direct.DirectLaw) -> bool:
    """Whether rollers may meet several of the scene's spalls at once, or a spall's bottom."""
    spalls = ring.spalls_on(scene.spalls, raceway)
    if any(isinstance(effect, Through) for effect in scene.effects) or not spalls:
        return False
    deepest = float(base.healthy[-1])
    if min(float(spall.depth) for spall in spalls) < deepest:
        return True
    half = np.array([0.5 * float(spall.width) for spall in spalls]) + np.sqrt(
        2.0 * float(base.contact.radius) * deepest
    )
    if isinstance(scene.phase, PitchMean):
        turn = 2.0 * np.pi * float(geometry.arc_radius(scene.bearing, raceway))
        places = np.sort([float(spall.angle) % (2.0 * np.pi) / (2.0 * np.pi) * turn for spall in spalls])
        order = np.argsort([float(spall.angle) % (2.0 * np.pi) for spall in spalls])
        apart = np.diff(places, append=places[0] + turn)
        return bool(len(spalls) > 1 and np.any(apart < half[order] + np.roll(half[order], -1)))
    away = np.asarray(
        ring.distances(scene.bearing, spalls, ring.roller_angles(scene.bearing, cast(Real, scene.phase)), raceway)
    )
    return bool(np.any(np.sum(np.abs(away) < half[:, None], axis=0) > 1))


def _inner_law(scene: Scene, effect: Raceways, progress: Progress | None, least: Real | None) -> Law:
    """Of the inner raceway: as prepared before, or named as the outer one's."""
    if isinstance(effect, SeriesRaceways):
        return cast(Law, effect.law).at(raceway_contact(scene, "inner"))
    if not isinstance(scene.law, LawName):
        raise status.SceneError(
            "effects.raceways needs a law for the inner raceway: give the scene its law by name, or the effect as "
            "difftrb.effects.SeriesRaceways(law=...)"
        )
    return prepared_law(scene, progress, "inner", least)


def law_in_effect(scene: Scene, roller_law: Law) -> Law:
    """The outer raceway's law as the scene's effects have it."""
    return power.Through(roller_law) if any(isinstance(effect, Through) for effect in scene.effects) else roller_law


def met(scene: Scene, outer: Law) -> tuple[phase_average.Met, ...]:
    """The spalls on every raceway, with the laws of rollers there."""
    met = [phase_average.Met("outer", ring.spalls_on(scene.spalls, "outer"), outer)]
    for effect in scene.effects:
        if isinstance(effect, SeriesRaceways):
            met.append(phase_average.Met("inner", ring.spalls_on(scene.spalls, "inner"), cast(Law, effect.law)))
    return tuple(met)
