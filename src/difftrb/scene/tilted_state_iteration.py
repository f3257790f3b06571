"""The laws of a scene whose rings tilt, by contact solves around its rollers' loads and tilts, until both stay.

Every roller that carries has a state of its own, at one phase or at all of a mean; on both raceways where these are in
series.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import Raceway
from difftrb.law import tilted_state_solves
from difftrb.law.direct_curves import DirectByCurves
from difftrb.law.direct_states import DirectByStates
from difftrb.law.healthy_tilt_table import Between
from difftrb.law.samples import Progress
from difftrb.law.state_solves import Reached
from difftrb.law.tilted_state_solves import Rollers, Spalls
from difftrb.ring import roller_balance, roller_places
from difftrb.ring.roller_balance import Seat
from difftrb.scene import prepared_scene
from difftrb.scene.scene import PitchMean, Scene, healthy, on_raceways
from difftrb.scene.state_iteration import guess, met_by, rest_at, until_they_stay

LIGHT = 1e-3
"""Share of the largest load below which a roller that is turned farther than the table knows counts as clear."""

CLEAR = 0.05
"""Of the least load of the healthy curve: a roller over a spall whose contact would carry less counts as clear."""

Laws = dict[Raceway, DirectByStates]
At = tuple[int, int, tuple[tuple[int, ...], ...]]
"""A phase, a roller, and the spalls that it may meet on every raceway."""


States = tuple[dict[At, tuple[float, float]], frozenset[At]]
"""With how much rollers press [N] at which tilts of their rings [rad], and which are clear."""


class TiltedRollers(NamedTuple):
    """Rollers of all rows at rest: those that carry or meet a spall, and how many there are, with the phases in front.
    Of those how much they press [N] and the tilts of their rings [rad], as contacts see them, and which are clear of
    the land beside a spall."""

    reached: dict[Raceway, list[Reached]]
    rollers: tuple[int, ...]
    centres: dict[At, tuple[float, float]]
    clear: frozenset[At]


@np.errstate(all="ignore")
def laws_by_tilted_states(scene: Scene, bases: Mapping[Raceway, DirectByCurves], progress: Progress | None) -> Laws:
    """The laws of every raceway for a scene, with and without its spalls, from those of healthy rollers.

    A scene whose loads do not stay keeps the last states, and its own status says that rollers are elsewhere.
    """
    spalls: Spalls = {raceway: roller_places.spalls_on(scene.spalls, raceway) for raceway in bases}
    rollers = tilted_state_solves.between_rings(bases, spalls, _between(scene, bases), progress)
    none = dataclasses.replace(rollers, spalls=dict.fromkeys(bases, ()))
    unspalled = _settled(healthy(scene), none, None)
    laws = _settled(scene, rollers, progress) if scene.spalls else unspalled
    made: Laws = {}
    for raceway, law in laws.items():
        made[raceway] = dataclasses.replace(law, settling=False, healthy_states=unspalled[raceway].states)
    return made


def _between(scene: Scene, bases: Mapping[Raceway, DirectByCurves]) -> Between:
    """What rollers have between the rings, by the scene's effects."""
    ready = xp.numbers(healthy(on_raceways(scene, dict(bases))))
    _, _, terms = prepared_scene.rings_at(ready, np.zeros(1))
    seat = terms.seat
    if seat is None:
        return Between()
    ratio, thrown = (float(np.ravel(x)[0]) for x in (seat.ratio, seat.least_outer_load))
    return Between(ratio if len(bases) > 1 else 1.0, thrown, lambda pressed: _sunk(seat, pressed + thrown))


def _sunk(seat: Seat, loads: Any) -> Any:
    return roller_balance.flange_approach(seat, loads) + 0.0 * loads


def _settled(scene: Scene, of: Rollers, progress: Progress | None) -> Laws:
    """The laws around the states in which the rollers of a scene end."""
    free = len(of.bases) > 1
    made: Laws = {
        raceway: DirectByStates(base, None, settling=True, free_to_tilt=free) for raceway, base in of.bases.items()
    }
    now = _at_rest(scene, made, of, frozenset())
    rollers = now.rollers[0 if isinstance(scene.phase, PitchMean) else 1 :]
    known, leaned = {}, False

    def around(states: States, found: bool) -> States | None:
        nonlocal made, now, leaned
        pressed, tilts = np.array(list(states[0].values())).reshape(-1, 2).T
        clear = np.array([at in now.clear for at in now.centres], bool)
        made = tilted_state_solves.around(of, now.reached, rollers, pressed, tilts, clear, found, known, progress)
        leans = int(made["outer"].status_code) == status.LEANS
        if leans and leaned:  # twice one after the other: they are not coming back
            return None
        leaned = leans
        now = _at_rest(scene, made, of, now.clear)
        return now.centres, now.clear

    def kept(old: States, ended: States, near: float) -> States:
        (centres, _), (others, clear) = old, ended
        return {at: centres[at] if at in centres and _is_near(of, centres[at], own, near) else own
                for at, own in others.items()}, clear  # fmt: skip

    until_they_stay((now.centres, now.clear), around, kept)
    return made


def _is_near(of: Rollers, one: tuple[float, float], other: tuple[float, float], near: float) -> bool:
    """Whether two states are `near` each other, in the logarithm of the load, and half of that in tilt by approach over
    length."""
    turned = abs(one[1] - other[1]) * of.table.length / of.table.upright(one[0])
    return abs(np.log(one[0] / other[0])) < near and turned < 0.5 * near


def _at_rest(scene: Scene, made: Mapping[Raceway, DirectByStates], of: Rollers, before: frozenset[At]) -> TiltedRollers:
    """With how much rollers press at which tilt, and the spalls that they may meet. Healthy ones have what the table
    has at their place, whatever laws they were found by; those that were clear `before` what their contacts would."""
    ready = on_raceways(scene, made)
    every, away, approach, _, tilts = jax.tree.map(np.asarray, rest_at(ready))
    pressed, tilts = every["outer"] - of.table.between.thrown, -tilts
    deepest = approach + 0.5 * of.table.length * np.abs(tilts)
    met = met_by(made, of.spalls, away, deepest, every)
    states = made["outer"].states
    first = states is None
    solved = np.zeros(approach.shape, bool)
    if states is not None:
        solved = (np.sum(np.asarray(states.at), axis=-2) > 0.0).reshape(approach.shape)
    reached: dict[Raceway, list[Reached]] = {raceway: [] for raceway in made}
    centres, clear = {}, set()
    for p, j in np.argwhere(deepest > 0.0):
        own: dict[Raceway, Reached] = {
            raceway: _reached(int(p), int(j), met[raceway], away[raceway]) for raceway in made
        }
        at: At = int(p), int(j), tuple(each.under for each in own.values())
        if any(at[2]):
            load = float(pressed[p, j])
            if first:
                load = min(guess(scene, of.spalls[raceway], each, pressed) for raceway, each in own.items())
            load = load / tilted_state_solves.NOTHING if at in before else load
            if load < CLEAR * of.least:
                clear.add(at)
            load = max(load, of.least)
        else:
            own_place = float(approach[p, j]), float(tilts[p, j])
            load = of.table.pressed_at(*own_place)
            if np.isnan(load):
                known = float(pressed[p, j]) if solved[p, j] else of.table.about(*own_place)
                turned = abs(own_place[1]) > tilted_state_solves.FARTHEST_TURNED * of.table.reach(of.least)
                light = known <= LIGHT * pressed.max()
                load = 0.0 if light and (turned or not solved[p, j]) else max(known, of.least)
        if load > 0.0:
            for raceway, each in own.items():
                reached[raceway].append(each)
            centres[at] = load, float(tilts[p, j])
    return TiltedRollers(reached, pressed.shape, centres, frozenset(clear))


def _reached(p: int, j: int, met: np.ndarray, away: np.ndarray) -> Reached:
    under = tuple(np.flatnonzero(met[:, p, j]).tolist())
    return Reached(p, j, under, tuple(away[p, list(under), j].tolist()))
