"""The states to audit: a scene at one cage phase, its loaded rollers, and their contacts solved afresh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Raceway, Spall
from difftrb.law import samples
from difftrb.law.base import Rest
from difftrb.law.samples import Case, Node, Progress
from difftrb.law.tilt_equilibrium import RollerContacts, at_rest
from difftrb.ring import effect_base, effects, ring, roller_balance, roller_places
from difftrb.ring.effects import Through
from difftrb.scene.prepared_scene import solve_prepared
from difftrb.scene.scene import Scene, law_in_effect, raceway_contact, ring_at
from difftrb.scene.solution import Solution

LIGHT, NOTHING = 1e-3, 1e-5
"""Share of the largest load at which the contact of a roller that carries nothing is solved; below which it does."""
Key = tuple[Raceway, str, tuple[int, ...], tuple[str, ...]]
"""What one contact is known by: equal for mirror images in the rolling direction."""


class RacewayContact(NamedTuple):
    """One roller's contact with one raceway, and the numbers of the scene's spalls in its reach."""

    raceway: Raceway
    contact: LineContact
    case: Case
    key: Key
    spalls: tuple[int, ...]


class State(NamedTuple):
    """One roller at rest, and its contacts: with the outer raceway and, if it gives way, with the inner one. One that
    is free to tilt, with a spall off its middle or between rings that tilt, is brought to rest between both,
    `tilting`; `ratio` is outer by inner load, without what is thrown outwards."""

    roller: int
    contacts: tuple[RacewayContact, ...]
    tilting: RollerContacts | None = None
    ratio: float = 1.0


class AtPhase(NamedTuple):
    """A prepared scene at one phase: its solution, the ring and what its effects add, directions and approaches [mm]
    and loads [N] of all rows' rollers, and those to be audited. Of rings that tilt also how the rings' displacement
    turns every roller's raceways against each other, shape (rollers, 5)."""

    scene: Scene
    found: Solution
    here: effects.Ring
    terms: ring.Terms
    normals: np.ndarray
    approach: np.ndarray
    loads: np.ndarray
    states: list[State]
    turns: np.ndarray | None = None


def at_phase(at: Scene) -> AtPhase:
    """A prepared scene at one phase, with the contacts to solve."""
    at, found = xp.numbers(at), solve_prepared(at)
    here, terms = xp.numbers(ring_at(at, law_in_effect(at, xp.numbers(found.law)), cast(float, at.phase)))
    with np.errstate(all="ignore"):
        rest, angles = here.equilibrium(terms), here.angles
    if terms.pair is not None:
        angles = xp.concatenate([angles, angles])
    normals, turns = ring.normals(at.bearing, angles, terms), None
    approach, loads = np.asarray(rest.all_approaches), np.asarray(rest.all_loads)
    tilts = np.zeros_like(loads)
    if terms.tilting is not None:
        normals, turned = terms.tilting.of_whole(np.asarray(normals), np.asarray(angles))
        if rest.tilts is not None:
            tilts, turns = np.asarray(rest.tilts), turned
    states = _states(at, here, terms, approach, loads, tilts)
    return AtPhase(at, found, here, terms, np.asarray(normals), approach, loads, states, turns)


def _states(
    scene: Scene, here: effects.Ring, terms: ring.Terms, approach: np.ndarray, loads: np.ndarray, tilts: np.ndarray
) -> list[State]:
    """Rollers that carry a load, or may, each with the contacts that hold it; `tilts` as in `law.base.Rest`."""
    largest = float(np.max(loads))
    least, ratio = 0.0, 1.0
    if terms.seat is not None:
        least, ratio = float(terms.seat.least_outer_load), float(terms.seat.ratio)
    contacts: dict[Raceway, LineContact] = {"outer": raceway_contact(scene, "outer")}
    if terms.inner_raceway is not None:
        contacts["inner"] = raceway_contact(scene, "inner")
    deepest = approach + 0.5 * float(scene.bearing.roller_length) * np.abs(tilts)
    met = {raceway: _met(scene, here, terms, raceway, deepest, loads) for raceway in contacts}
    states = []
    for j, load in enumerate(loads):
        pressed = float(load) if load > NOTHING * largest else LIGHT * largest
        thrown = least > 0.0 and pressed <= least * (1.0 + 1e-9)  # clear of the inner raceway, by centrifugal force
        if deepest[j] <= 0.0 or thrown:
            continue
        own, under_it = [], []
        for raceway, contact in contacts.items():
            carried = pressed
            if raceway == "inner":
                carried = float(roller_balance.inner_load(terms.seat, np.asarray(pressed)))  # type: ignore[arg-type]
            spalls, away, reached = met[raceway]
            under = tuple(i for i in range(len(spalls)) if reached[i, j])
            places = [float(away[i, j]) for i in under]
            under_it.append(([spalls[i] for i in under], places))
            case = samples.case_under(carried, *under_it[-1])._replace(tilt=-float(tilts[j]))
            of_scene = tuple(next(n for n, one in enumerate(scene.spalls) if one is spalls[i]) for i in under)
            key = key_of(raceway, carried, under, places, float(tilts[j]))
            own.append(RacewayContact(raceway, contact, case, key, of_scene))
        between = None
        if terms.inner_raceway is not None and terms.inner_raceway.free:
            both, turned = (contacts["outer"], contacts["inner"]), -float(tilts[j])
            (outer, one), (inner, other) = under_it
            between = RollerContacts(both, (outer, inner), (one, other), turned)
        if between is not None and between.leans:
            states.append(_tilting(State(j, tuple(own), between, ratio)))
        else:
            states.append(State(j, tuple(own)))
    return states


def _tilting(state: State) -> State:
    """A roller whose contacts are what both are together."""
    marks = tuple(mark for each in state.contacts for mark in (*map(str, each.key[2]), *each.key[3]))
    named = (each._replace(key=(*each.key[:3], (*each.key[3], "tilts", *marks))) for each in state.contacts)
    return state._replace(contacts=tuple(named))


def _met(
    scene: Scene, here: effects.Ring, terms: ring.Terms, raceway: Raceway, approach: np.ndarray, loads: np.ndarray
) -> tuple[tuple[Spall, ...], np.ndarray, np.ndarray]:
    """The spalls on a raceway, their distances from the rollers [mm] and whether these reach them, shapes
    (spalls, rollers)."""
    through = effect_base.among(scene.effects, Through) is not None
    spalls = () if through else roller_places.spalls_on(scene.spalls, raceway)
    away = np.asarray(here.distances(raceway, terms))[: len(spalls)]
    share = ring.OF_ONE_RACEWAY if terms.inner_raceway is not None else 1.0
    rest = Rest(raceway_contact(scene, raceway).radius, share * approach, loads)
    reached = [np.asarray(rest.in_reach(s, d)) for s, d in zip(spalls, away, strict=True)]
    return spalls, away, np.array(reached).reshape(len(spalls), loads.size)


def key_of(raceway: Raceway, load: float, under: tuple[int, ...], places: Sequence[float], tilt: float = 0.0) -> Key:
    """Equal for contacts that are one: the same, or mirror images in the rolling direction."""
    side = -1.0 if places and places[0] < 0.0 else 1.0
    leaning = (f"{tilt:.6e} rad",) if tilt else ()
    return raceway, f"{load:.6e}", under, (*(f"{side * place:.6f}" for place in places), *leaning)


def solve_contacts(states: Sequence[State], accuracy: float, progress: Progress | None) -> dict[Key, Node]:
    """The contacts of all states, by their keys; equal ones are solved once. Rollers that tilt are brought to rest."""
    tilting = {state.contacts[0].key: state for state in states if state.tilting is not None}

    def rolled(state: State) -> dict[Key, Node]:
        outer, inner = state.contacts
        roller, loads = cast(RollerContacts, state.tilting), (outer.case.load, inner.case.load)
        rest = at_rest(roller, loads, accuracy, tilt_response=True)
        return dict(zip((outer.key, inner.key), rest.shares(state.ratio), strict=True))

    solved: dict[Key, Node] = {}
    for each in samples.mapped(rolled, list(tilting.values()), accuracy, progress):
        solved |= each
    wanted = {each.key: each for state in states if state.tilting is None for each in state.contacts}
    for raceway in ("outer", "inner"):
        upright = [each for each in wanted.values() if each.raceway == raceway]
        if upright:
            cases = [each.case for each in upright]
            tilted = any(case.tilt for case in cases)
            nodes = samples.all_solved(upright[0].contact, cases, accuracy, progress, tilted)
            solved |= {each.key: node for each, node in zip(upright, nodes, strict=True)}
    return solved
