"""The laws of a scene by contact solves around its rollers' loads, until these stay, at one phase or all of a mean.

Every roller that meets spalls gets contacts of its own, on both raceways where both give way: there it is free to tilt.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.geometry import Raceway, Spall
from difftrb.law import state_solves, tilt_equilibrium
from difftrb.law.base import Rest
from difftrb.law.direct_curves import DirectByCurves
from difftrb.law.direct_states import DirectByStates
from difftrb.law.samples import Progress
from difftrb.law.state_solves import Reached
from difftrb.law.tilt_equilibrium import RollerContacts, TiltCurve
from difftrb.law.tilted_state_solves import Spalls
from difftrb.ring import effects, ring, roller_balance, roller_places
from difftrb.ring.roller_balance import Seat
from difftrb.scene import prepared_scene
from difftrb.scene.cage_phases import phases
from difftrb.scene.scene import PitchMean, Scene, on_raceways

ROUNDS = 8
"""Of contact solves around the rollers' loads, at most."""
STAYS = 0.1
"""Change of a load, in its logarithm, below which it stays."""
FARTHER = 1.05
"""Factor on the approach when looking for the spalls that a roller may meet: marginal ones are included."""
LEAST_INNER = 1e-3
"""Least share of an outer load that the inner raceway is taken to carry: contacts have a load."""
LIGHTER = 0.1
"""Lightest load around which contacts are solved, by the lightest of a healthy roller's curve: in a ring of six one of
half of that, on an edge, moved stiffness by 0.7 % as its curve ran on straight."""
LEAST_SHARE = 0.15
"""Least share of a healthy roller's load that one over a spall is taken to carry at first."""


class LoadedRollers(NamedTuple):
    """Rollers of all rows at rest: loads on every raceway [N], shape (phases, rollers), and spalls that they may meet
    there; outer by inner load of a roller, the former without what is `thrown` [N] and carried by the outer raceway
    alone."""

    loads: dict[Raceway, np.ndarray]
    reached: dict[Raceway, list[Reached]]
    ratio: float = 1.0
    thrown: float = 0.0

    def inner(self, load: float) -> float:
        """Inner load [N] of a roller that carries `load` [N] outside; a little where the inner raceway has none."""
        return max((load - self.thrown) / self.ratio, LEAST_INNER * load)


def laws_by_states(
    scene: Scene, bases: Mapping[Raceway, DirectByCurves], progress: Progress | None
) -> dict[Raceway, DirectByStates]:
    """The laws of every raceway for a scene, from those of healthy rollers.

    A scene whose loads do not stay keeps the last laws, and its own status says that rollers are elsewhere.
    """
    spalls: Spalls = {raceway: roller_places.spalls_on(scene.spalls, raceway) for raceway in bases}
    free = effects.are_free(scene.effects) and len(bases) > 1
    made: dict[Raceway, DirectByStates] = {
        raceway: DirectByStates(base, None, settling=True, free_to_tilt=free) for raceway, base in bases.items()
    }
    each_phase = phases(on_raceways(scene, made))[0]  # which hang on no states
    now = _at_rest(scene, made, spalls, each_phase)
    rollers = now.loads["outer"].shape[0 if isinstance(scene.phase, PitchMean) else 1 :]
    centres: dict[Raceway, Centres] = {
        raceway: {each[:3]: guess(scene, spalls[raceway], each, now.loads[raceway]) for each in now.reached[raceway]}
        for raceway in bases
    }
    if free:
        inner = [now.inner(load) for load in centres["outer"].values()]
        centres["inner"] = dict(zip(centres["inner"], inner, strict=True))
    known: dict[Raceway, state_solves.SolvedContacts] = {raceway: {} for raceway in bases}
    tilts = None

    def around(centres: dict[Raceway, Centres], found: bool) -> dict[Raceway, Centres]:
        nonlocal made, now, tilts
        if free:
            tilts = _tilts(bases, spalls, now, list(centres["outer"].values()), found, tilts, progress)
        made = {
            raceway: state_solves.around(
                base, spalls[raceway], now.reached[raceway], rollers, np.array(list(centres[raceway].values())), found,
                known[raceway], None if tilts is None else tilts.of(raceway, now), progress,
            )
            for raceway, base in bases.items()
        }  # fmt: skip
        now = _at_rest(scene, made, spalls, each_phase)
        return {raceway: _loads(now, raceway, base) for raceway, base in bases.items()}

    def kept(
        old: dict[Raceway, Centres], ended: dict[Raceway, Centres], near: float
    ) -> dict[Raceway, Centres]:  # fmt: skip
        return {raceway: _kept(old[raceway], ended[raceway], near) for raceway in bases}

    until_they_stay(centres, around, kept)
    return {raceway: dataclasses.replace(law, settling=False) for raceway, law in made.items()}


C = TypeVar("C")
"""States of rollers around which contacts are solved."""


def until_they_stay(centres: C, around: Callable[[C, bool], C | None], kept: Callable[[C, C, float], C]) -> None:
    """Solve contacts around `centres` until rollers end there, for `ROUNDS` at most: first looked for by few contacts,
    then `found`.

    `around(centres, found)` solves them and returns where rollers end then; None leaves off. `kept(centres, ended,
    near)` is the new centres, with the old one where a roller is `near` it, in the logarithm of its load.
    """
    found = False
    for _ in range(ROUNDS):
        ended = around(centres, found)
        if ended is None:
            return
        own = kept(centres, ended, STAYS if found else state_solves.SEARCHED)
        if own != centres:
            centres = own
        elif found:
            return
        else:
            found, centres = True, ended


Centres = dict[tuple[int, int, tuple[int, ...]], float]
"""Loads [N] around which contacts are solved, by phase, roller and the spalls that it may meet."""


def _kept(centres: Centres, loads: Centres, near: float) -> Centres:
    """The loads, but the old centre where one is `near` it, in the logarithm: there contacts are solved already."""
    stay = {at for at, load in loads.items() if at in centres and abs(np.log(load / centres[at])) < near}
    return {at: centres[at] if at in stay else load for at, load in loads.items()}


def _loads(now: LoadedRollers, raceway: Raceway, base: DirectByCurves) -> Centres:
    """Of the rollers reached [N], at least a part of the lightest that the base law knows."""
    least = LIGHTER * float(np.exp(base.log_loads[0]))
    return {each[:3]: max(float(now.loads[raceway][each[:2]]), least) for each in now.reached[raceway]}


def guess(scene: Scene, spalls: tuple[Spall, ...], reached: Reached, loads: np.ndarray) -> float:
    """About the load [N] of a roller, from that on a healthy ring: by the land that is left."""
    length = float(scene.bearing.roller_length)
    land = 1.0 - sum(min(float(spalls[i].length), length) for i in reached.under) / length
    return float(loads[reached[:2]]) * max(land, LEAST_SHARE) + 1e-3 * float(loads.max())


# ------------------------------------------------------------------------------------------------ rollers that tilt


class Tilts(NamedTuple):
    """Tilts [rad] of the rollers reached, by phase and number, over the logarithm of the outer load [log N]."""

    curves: dict[tuple[int, int], TiltCurve]

    def of(self, raceway: Raceway, now: LoadedRollers) -> list[TiltCurve]:
        """As a raceway sees them, over the logarithm of the load there."""
        curves = [self.curves[each[:2]] for each in now.reached[raceway]]
        if raceway == "outer":
            return curves
        return [_from_inside(own, now) for own in curves]


def _from_inside(own: TiltCurve, now: LoadedRollers) -> TiltCurve:
    """As the inner raceway sees it: turned the other way, and pushed by the inner load."""
    if own is tilt_equilibrium.UPRIGHT:
        return own

    def outer(log_load: np.ndarray) -> np.ndarray:
        return np.log(np.exp(log_load) * now.ratio + now.thrown)

    return TiltCurve(lambda x: -own.tilt(outer(x)), lambda x: -now.ratio * own.gain(outer(x)))


def _tilts(
    bases: Mapping[Raceway, DirectByCurves], spalls: Spalls, now: LoadedRollers, loads: Sequence[float], found: bool,
    before: Tilts | None, progress: Progress | None,
) -> Tilts:  # fmt: skip
    """Tilts of all rollers reached about their outer `loads` [N]."""
    contacts = bases["outer"].contact, bases["inner"].contact
    each = list(zip(now.reached["outer"], now.reached["inner"], strict=True))
    rollers = []
    for both in each:
        outer, inner = ([spalls[raceway][i] for i in one.under] for raceway, one in zip(bases, both, strict=True))
        rollers.append(RollerContacts(contacts, (outer, inner), (both[0].away, both[1].away)))
    spread, way = state_solves.spread_of(found, tilt_equilibrium.FOUND if found else tilt_equilibrium.SEARCHED)
    logs = np.log(np.asarray(loads).reshape(-1, 1)) + spread * way
    starts = [None if before is None else before.curves.get(own[:2]) for own, _ in each]
    accuracy = float(bases["outer"].error)
    curves = tilt_equilibrium.tilt_curves(rollers, logs, now.inner, accuracy, starts, found, progress)
    return Tilts({own[:2]: curve for (own, _), curve in zip(each, curves, strict=True)})


# ------------------------------------------------------------------------------------------------ the ring on them


def _at_rest(
    scene: Scene, made: Mapping[Raceway, DirectByStates], spalls: Spalls, each_phase: np.ndarray
) -> LoadedRollers:
    """What rollers carry on every raceway, and the spalls that they may meet there. One free to tilt is reached on both
    raceways or on none."""
    ready = on_raceways(scene, made)
    loads, away, approach, seat, _ = jax.tree.map(np.asarray, rest_at(ready, each_phase))
    met = met_by(made, spalls, away, approach, loads)
    meets = {raceway: own.any(axis=0) for raceway, own in met.items()}
    if any(law.free_to_tilt for law in made.values()):
        meets = dict.fromkeys(meets, np.logical_or(meets["outer"], meets["inner"]))
    reached: dict[Raceway, list[Reached]] = {}
    for raceway, own in met.items():
        reached[raceway] = [
            Reached(int(p), int(j), tuple(np.flatnonzero(own[:, p, j]).tolist()),
                    tuple(away[raceway][p, own[:, p, j], j].tolist()))
            for p, j in np.argwhere(meets[raceway])
        ]  # fmt: skip
    now = LoadedRollers(loads, reached)
    if seat is None:
        return now
    ratio, thrown = seat.ratio, seat.least_outer_load  # the same at all phases
    return now._replace(ratio=float(np.ravel(ratio)[0]), thrown=float(np.ravel(thrown)[0]))


def met_by(
    made: Mapping[Raceway, DirectByStates], spalls: Spalls, away: Mapping[Raceway, np.ndarray], approach: np.ndarray,
    loads: Mapping[Raceway, np.ndarray],
) -> dict[Raceway, np.ndarray]:  # fmt: skip
    """Which spalls on every raceway rollers may meet, shape (spalls, phases, rollers), for approaches [mm] and loads
    [N] of shape (phases, rollers), and distances [mm] of shape (phases, spalls, rollers)."""
    share = FARTHER * (ring.OF_ONE_RACEWAY if len(made) > 1 else 1.0)
    met = {}
    for raceway, law in made.items():
        rest = Rest(float(law.contact.radius), share * approach, loads[raceway])
        own = [rest.in_reach(s, d) for s, d in zip(spalls[raceway], np.moveaxis(away[raceway], 1, 0), strict=True)]
        met[raceway] = np.reshape(np.array(own, bool), (len(own), *approach.shape))
    return met


class Rests(NamedTuple):
    """Loads on every raceway [N], distances from the spalls there [mm], approaches [mm], of all rows, the seat, and
    tilts of rings that tilt [rad]; all with the phases in front."""

    loads: dict[Raceway, Any]
    away: dict[Raceway, Any]
    approaches: Any
    seat: Seat | None
    tilts: Any


@np.errstate(all="ignore")
def rest_at(scene: Scene, each: np.ndarray | None = None) -> Rests:
    """The rings of a prepared scene at all its phases, in numbers; `each` of these [rad], if they are known."""
    scene = xp.numbers(scene)
    each = phases(scene)[0] if each is None else each
    found, here, terms = prepared_scene.rings_at(scene, each)
    rest = xp.values(found)
    loads: dict[Raceway, Any] = {"outer": rest.all_loads}
    if terms.inner_raceway is not None and terms.seat is not None:
        loads["inner"] = roller_balance.inner_load(terms.seat, rest.all_loads)
    away: dict[Raceway, Any] = {
        raceway: np.moveaxis(np.asarray(here.distances(raceway, terms)), 0, 1) for raceway in loads
    }
    tilts = np.zeros_like(rest.all_loads) if rest.tilts is None else rest.tilts
    return Rests(loads, away, rest.all_approaches, terms.seat, tilts)
