"""The roller laws of a scene, for every raceway that gives way; `with_laws` is the way in.

All but "direct" are made at once, also inside jit. "direct" is made from contacts solved one by one, which needs
numbers. It is a `DirectByStates`: contacts are solved around the rollers' loads, and the ring on them, until the loads
stay. In the mean it is a `DirectByCurves`, of curves over all loads, where no roller meets but one deep rectangular
spall: that takes a third of the contacts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar, cast

import jax
import jax.core
import numpy as np

from difftrb.contact import gap
from difftrb.contact.height_map import HeightMap
from difftrb.core import arrays as xp
from difftrb.core import geometry, status
from difftrb.core.geometry import Raceway, Real, Spall
from difftrb.core.status import SceneError
from difftrb.law import base as laws
from difftrb.law import direct_curves
from difftrb.law.base import Law
from difftrb.law.direct_curves import DirectByCurves
from difftrb.law.direct_states import DirectByStates
from difftrb.law.samples import Progress
from difftrb.law.table import TableLaw
from difftrb.ring import effect_base, effects, roller_places
from difftrb.ring.effects import Raceways, SeriesRaceways, Through, Tilt
from difftrb.scene import largest_roller_load
from difftrb.scene.cage_phases import phases
from difftrb.scene.prepared_scene import solve_prepared
from difftrb.scene.scene import (
    LawName,
    PitchMean,
    Scene,
    has_map,
    healthy,
    on_raceways,
    raceway_contact,
    upright_by_table,
)
from difftrb.scene.state_iteration import laws_by_states
from difftrb.scene.tilted_state_iteration import laws_by_tilted_states

TRACED = (
    "law = 'direct' needs numbers: prepare the scene first, difftrb.prepare(scene), and differentiate, jit or batch "
    "what comes out; derivatives stay complete"
)
NO_INNER_LAW = (
    "effects.raceways needs a law for the inner raceway: give the scene its law by name, or the effect as "
    "difftrb.effects.SeriesRaceways(law=...)"
)
NOTHING_PRESSES = (
    "load.radial = 0 N and load.axial = 0 N: nothing presses the rollers, whose contacts law 'direct' solves under "
    "their loads; give a load"
)
NO_LAW_OF_TILTED = (
    "effects.raceways has a law already, which knows no roller of rings that tilt (effects.tilt): give "
    "difftrb.effects.Raceways(), without a law"
)
DEEP = 5.0
"""A spall deeper than Palmgren's approach so many times is deeper than a roller sinks: more than crowns make of it."""


def with_laws(scene: Scene, progress: Progress | None = None, least: Real | None = None) -> Scene:
    """A checked scene with a law on every raceway that gives way; arguments as in `difftrb.prepare`.

    A law that is there is carried to its contact. Raises SceneError for a traced scene whose law needs numbers, where
    only the inner raceway's law is missing.
    """
    known = False
    if isinstance(scene.law, LawName) and scene.law.name == "direct" and xp.are_numbers(scene):
        if not largest_roller_load.largest_for_curves(scene) > 0.0:
            raise SceneError(NOTHING_PRESSES)
        if effect_base.among(scene.effects, Tilt) is not None:
            if effect_base.among(scene.effects, SeriesRaceways) is not None:
                raise SceneError(NO_LAW_OF_TILTED)
            return _judged(scene, laws_by_tilted_states(scene, _healthy_laws(scene, progress), progress))
        at_one = not isinstance(scene.phase, PitchMean)
        known = not at_one and _table_knows(scene)
        if at_one or _may_meet_more(scene):
            bases = _with_kinks(_healthy_laws(scene, progress), known)
            if at_one and effect_base.among(scene.effects, Through) is not None:
                return on_raceways(scene, bases)
            if at_one or any(_meet_more(scene, raceway, base) for raceway, base in bases.items()):
                return _judged(scene, laws_by_states(scene, bases, progress))
    made: dict[Raceway, Law] = {raceway: _law(scene, raceway, progress, least) for raceway in _raceways(scene)}
    return _with_edges(scene, _with_kinks(made, known), progress)


L = TypeVar("L", bound=Law)


def _with_kinks(made: Mapping[Raceway, L], by_table: bool) -> Mapping[Raceway, L]:
    """Laws by contact solves, told if the table is to say where a mean has its kinks."""
    if not by_table:
        return made
    return {raceway: dataclasses.replace(law, kinks_by_table=True) if isinstance(law, DirectByCurves) else law
            for raceway, law in made.items()}  # fmt: skip


def _table_knows(scene: Scene) -> bool:
    """Whether the table knows all rollers of a scene of numbers, at all phases of its mean."""
    if has_map(scene) or effect_base.among(scene.effects, Through) is not None:
        return False
    return int(solve_prepared(upright_by_table(scene)).status_code) == status.CONVERGED


def _judged(scene: Scene, made: Mapping[Raceway, DirectByStates]) -> Scene:
    """The scene with laws of its rollers' states, which say so if it does not end in these."""
    ready = on_raceways(scene, made)
    if int(solve_prepared(ready).status_code) != status.OTHER_SCENE:
        return ready
    return on_raceways(scene, {raceway: dataclasses.replace(law, stays=False) for raceway, law in made.items()})


def with_any_width(scene: Scene) -> Scene | None:
    """A prepared scene with laws that know narrow spalls, too; None if there are none that do not."""
    more = jax.tree.map(lambda part: part.of_any_width() if isinstance(part, TableLaw) else part, scene,
                        is_leaf=lambda part: isinstance(part, TableLaw))  # fmt: skip
    return None if jax.tree.structure(more) == jax.tree.structure(scene) else more


def _healthy_laws(scene: Scene, progress: Progress | None) -> dict[Raceway, DirectByCurves]:
    """The curves of healthy rollers on every raceway, by contact solves."""
    largest = largest_roller_load.largest_for_curves(scene)
    return {
        raceway: direct_curves.without_edges(raceway_contact(scene, raceway), largest, (), scene.accuracy, progress)
        for raceway in _lacking(scene)
    }


def _raceways(scene: Scene) -> tuple[Raceway, ...]:
    """Those that give way."""
    return ("outer", "inner") if effect_base.among(scene.effects, Raceways) is not None else ("outer",)


def _lacking(scene: Scene) -> tuple[Raceway, ...]:
    """Those of them for which a law is to be made: the inner raceway's may be there."""
    return ("outer",) if effect_base.among(scene.effects, SeriesRaceways) is not None else _raceways(scene)


def _law(scene: Scene, raceway: Raceway, progress: Progress | None, least: Real | None) -> Law:
    """The law on one raceway, carried to its contact, or built.

    `least` is the largest roller load [N] of the lightest loaded scene that the law is to serve; default: of this one.
    """
    contact, spalls = raceway_contact(scene, raceway), roller_places.spalls_on(scene.spalls, raceway)
    given = scene.law
    if raceway == "inner":
        series = effect_base.among(scene.effects, SeriesRaceways)
        if series is None and not isinstance(given, LawName):
            raise SceneError(NO_INNER_LAW)
        given = given if series is None else cast(Law, series.law)
    if not isinstance(given, LawName):
        return cast(Law, given).at(contact)
    by_samples = laws.kind(given.name).by_samples
    if by_samples and not xp.are_numbers(scene):
        raise SceneError(TRACED)
    if laws.kind(given.name).of_all_loads:
        largest = np.nan
    else:
        largest = (
            largest_roller_load.largest_for_curves(scene) if by_samples else largest_roller_load.largest_load(scene)
        )
    request = laws.Request(contact, largest if least is None else least, largest, spalls, scene.accuracy, progress)
    return laws.made(given.name, request)


def _with_edges(scene: Scene, made: Mapping[Raceway, Law], progress: Progress | None) -> Scene:
    """The scene with these laws; those just made by "direct" get the contacts at edges that the ring will ask for.

    The phases of a mean hang on all laws, so all are made before the first edge is solved.
    """
    ready = on_raceways(scene, made)
    lacking: dict[Raceway, DirectByCurves] = {
        raceway: law
        for raceway in _lacking(scene)
        if isinstance(law := made.get(raceway), DirectByCurves) and law.spalls
    }
    if not lacking or not isinstance(scene.law, LawName):
        return ready
    every = phases(ready)[0]
    edged: dict[Raceway, Law] = dict(made)
    for raceway, law in lacking.items():
        edged[raceway] = direct_curves.with_edges(law, _at_edges(scene, raceway, law, every), progress)
    return on_raceways(scene, edged)


def _at_edges(scene: Scene, raceway: Raceway, law: DirectByCurves, every: Any) -> list[list[tuple[float, float]]]:
    """For every spall the distances [mm] at which rollers stand on its ramps, in any of these phases [rad], and their
    approaches [mm] on the healthy ring."""
    distances, approaches = map(np.asarray, _healthy_approaches(largest_roller_load.single(scene, law), raceway, every))
    if np.isnan(approaches).any():  # no equilibrium, as the ring's status will say
        return [[] for _ in law.spalls]
    return [
        sorted({(abs(float(d)), max(float(a), 0.1 * float(approaches.max())))  # out of the load zone: as good as any
                for d, a in zip(distances[i].ravel(), approaches[spall.row - 1].ravel(), strict=True)
                if low <= 0.5 * float(spall.width) - abs(d) <= high})
        for i, spall in enumerate(law.spalls)
        for low, high in [map(float, law.ramp(i, spall, law.full[i, -1]))]
    ]  # fmt: skip


def _healthy_approaches(scene: Scene, raceway: Raceway, phases: Any) -> tuple[Any, Any]:
    """Distances from the spalls on a raceway [mm], shape (spalls, phases, rollers), and approaches there on the healthy
    ring [mm], shape (rows, phases, rollers)."""
    bearing, law = scene.bearing, cast(DirectByCurves, scene.law)
    away = roller_places.distances(bearing, law.spalls, roller_places.roller_angles(bearing, phases), raceway)
    every = np.asarray(largest_roller_load.rings(healthy(scene), law, phases).all_approaches)
    return away, np.moveaxis(every.reshape(len(every), -1, scene.bearing.rollers), 1, 0)


def _may_meet_more(scene: Scene) -> bool:
    """Whether to ask `_meet_more`, for which contacts are solved: of several spalls, or one that is not surely deep, or
    under rollers that may tilt."""
    if len(scene.spalls) > 1 or _leans(scene) or has_map(scene):
        return True
    largest = largest_roller_load.largest_for_curves(scene)
    deep = DEEP * float(gap.palmgren_approach(largest, float(scene.bearing.roller_length)))
    return any(float(spall.depth) < deep for spall in scene.spalls)


def _leans(scene: Scene) -> bool:
    """Whether rollers between both raceways may tilt over a spall off their middle."""
    return effects.are_free(scene.effects) and any(bool(spall.off_middle) for spall in scene.spalls)


def _meet_more(scene: Scene, raceway: Raceway, base: DirectByCurves) -> bool:
    """Whether rollers may meet several of the spalls at once, a bottom or a map while the cage turns, or tilt."""
    if effect_base.among(scene.effects, Through) is not None:
        return False
    if _leans(scene):
        return True
    every = roller_places.spalls_on(scene.spalls, raceway)
    return any(_row_meets_more(scene, raceway, base, [spall for spall in every if spall.row == row]) for row in (1, 2))


def _row_meets_more(scene: Scene, raceway: Raceway, base: DirectByCurves, spalls: list[Spall]) -> bool:
    """The same of the spalls of one row."""
    if not spalls or any(isinstance(spall, HeightMap) for spall in spalls):
        return bool(spalls)
    deepest = float(base.healthy[-1])
    if min(float(spall.depth) for spall in spalls) < deepest:
        return True
    reach = gap.certain_reach(float(base.contact.radius), deepest)
    half = np.array([0.5 * float(spall.width) for spall in spalls]) + reach
    turn = 2.0 * np.pi * float(geometry.arc_radius(scene.bearing, raceway))
    shares = np.array([float(spall.angle) % (2.0 * np.pi) for spall in spalls]) / (2.0 * np.pi)
    order = np.argsort(shares)
    places = np.sort(shares * turn)
    apart = np.diff(places, append=places[0] + turn)
    return bool(len(spalls) > 1 and np.any(apart < half[order] + np.roll(half[order], -1)))
