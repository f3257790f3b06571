"""Contact solves around the loads and tilts of rollers whose rings tilt: the states of a `DirectByStates` then.

Rollers on healthy raceways take theirs from a table over load and tilt, which is smooth; those that meet spalls are
solved each for itself. With both raceways in series a roller is solved between them, at the tilt at which it rests.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from difftrb.core import status, user_cache
from difftrb.core.geometry import Raceway, Spall
from difftrb.core.numeric import chebyshev_nodes
from difftrb.core.series import polynomial
from difftrb.law import healthy_tilt_table, samples, tilt_energy, tilt_equilibrium
from difftrb.law.direct_curves import DirectByCurves, accuracy_at_edges
from difftrb.law.direct_states import NARROWER, SPREAD, DirectByStates
from difftrb.law.healthy_tilt_table import Between, TiltTable, Turned
from difftrb.law.samples import Node, Progress
from difftrb.law.state_solves import BENDS, SEARCHED, Reached, stacked
from difftrb.law.tilt_equilibrium import RollerContacts

LOADS, TILTS = 4, 4
"""Solves of a state: so many loads at so many tilts."""
TURNED = 0.3
"""How far a state's tilts are spread to either side, by approach over roller length."""
FARTHEST_TURNED = 6.0
"""By `TiltTable.reach`: beyond, nothing is solved, and the status says so."""
NOTHING = 1e-9
"""Share of what its contact would carry that a roller clear of the land has: as good as none, and what it would carry
can still be told."""
LEAST_TILT = 1e-9
"""[rad] A roller over a spall is not solved upright, for then it is solved as half of one."""

Spalls = Mapping[Raceway, tuple[Spall, ...]]
Met = tuple[tuple[tuple[int, ...], tuple[float, ...]], ...]
"""Spalls that a roller may meet on every raceway, and how far away they are [mm]."""
SolvedRollers = dict[tuple[bool, Met, float, float], Turned]
"""Rollers that were solved: whether with `TiltResponse`, what they meet, with how much they press [N], tilt [rad]."""


@dataclasses.dataclass(frozen=True)
class Rollers:
    """Rollers between two rings: the laws of healthy ones on every raceway that gives way, the outer one first, the
    spalls there, and the table of healthy rollers."""

    bases: Mapping[Raceway, DirectByCurves]
    spalls: Spalls
    table: TiltTable
    tables: tuple[TiltTable, ...]

    @property
    def accuracy(self) -> float:
        """Of contacts at edges."""
        return accuracy_at_edges(float(self.bases["outer"].error))

    @property
    def least(self) -> float:
        """The least load of the healthy curve [N]."""
        return float(np.exp(self.bases["outer"].log_loads[0]))


def between_rings(
    bases: Mapping[Raceway, DirectByCurves], spalls: Spalls, between: Between, progress: Progress | None
) -> Rollers:
    """Rollers whose healthy contacts have the laws `bases`."""
    tables = tuple(healthy_tilt_table.of_contact(base, progress) for base in bases.values())
    whole = healthy_tilt_table.between_rings(tables, between, float(bases["outer"].error))
    return Rollers(bases, spalls, whole, tables)


def around(
    of: Rollers, reached: Mapping[Raceway, Sequence[Reached]], rollers: tuple[int, ...], pressed: np.ndarray,
    tilts: np.ndarray, clear: np.ndarray, found: bool, known: SolvedRollers, progress: Progress | None = None,
) -> dict[Raceway, DirectByStates]:  # fmt: skip
    """As `state_solves.around`, of every raceway: of rollers that press the inner ring with about `pressed` [N] where
    the rings are tilted by about `tilts` [rad], as contacts see it; those that are `clear` would press with less than
    these; all of shape (rollers reached,). `reached` has the same rollers on every raceway."""
    table = of.table
    met = [tuple((one.under, one.away) for one in each) for each in zip(*reached.values(), strict=True)]
    reach, turned = table.reach(pressed), TURNED * table.upright(pressed) / table.length
    leans = bool(np.any(np.abs(tilts) > FARTHEST_TURNED * reach))
    # while some are too far, none is solved: as far as the table goes will do to see whether they come back
    most = np.maximum(healthy_tilt_table.MOST_TURNED * reach - turned, 0.0) if leans else FARTHEST_TURNED * reach
    centres = np.clip(tilts, -most, most)
    logs, leaning = _loads_and_tilts(table, pressed, centres, SPREAD if found else SEARCHED, TURNED)

    def at(numbers: Sequence[int]) -> list[list[Turned]]:
        asked = [(met[k], np.exp(logs[k]), leaning[k]) for k in numbers]
        return _solved(of, asked, found, known, progress)

    solved = at(range(len(met)))
    if found:
        bent = [k for k, own in enumerate(solved) if _bend(table, logs[k], leaning[k], own) > BENDS]
        narrower = NARROWER * SPREAD, NARROWER * TURNED
        logs[bent], leaning[bent] = _loads_and_tilts(table, pressed[bent], centres[bent], *narrower)
        for k, own in zip(bent, at(bent), strict=True):
            solved[k] = own
    worst = samples.worst_status([node for own in solved for each in own for node in each.nodes])
    code = max(table.status_code, worst, float(status.LEANS) if leans else 0.0)
    shares = np.where(clear, NOTHING, 1.0)
    loads = table.between.loads(shares[:, None] * np.exp(logs))
    own_tilts = np.array([[each.tilt for each in own] for own in solved])
    laws, free = {}, len(of.bases) > 1
    for k, (raceway, base) in enumerate(of.bases.items()):
        base = dataclasses.replace(base, status_code=max(float(base.status_code), code))
        states = None
        if met:
            nodes = [
                [_carrying(each.nodes[k], share) for each in own] for own, share in zip(solved, shares, strict=True)
            ]
            slopes = [np.array([node.slopes for node in own]) for own in nodes]
            states = stacked(base, of.spalls[raceway], reached[raceway], rollers, np.log(loads[k]), leaning, nodes,
                             slopes, own_tilts if k == 0 else None, leaning=True)  # fmt: skip
        # a healthy scene asks for the states without spalls, and while they are looked for these are they
        laws[raceway] = DirectByStates(base, states, healthy_states=states, settling=True, free_to_tilt=free)
    return laws


def _carrying(node: Node, share: float) -> Node:
    """A contact with a share of its moment, as of its load."""
    tilt_response = node.tilt_response
    if tilt_response is not None:
        tilt_response = tilt_response._replace(moment_slopes=share * tilt_response.moment_slopes)
    return dataclasses.replace(node, moment=share * node.moment, tilt_response=tilt_response)


def _solved(
    of: Rollers, asked: Sequence[tuple[Met, np.ndarray, np.ndarray]], tilt_response: bool, known: SolvedRollers,
    progress: Progress | None,
) -> list[list[Turned]]:  # fmt: skip
    """Rollers under their loads at their tilts, a row for every one that is asked for."""
    keys = [
        [(tilt_response, met, float(load), float(tilt)) for load, tilt in zip(*at, strict=True)] for met, *at in asked
    ]
    missing = list(dict.fromkeys(key for row in keys for key in row if key not in known))
    for key in missing:
        _, met, pressed, tilt = key
        if not any(under for under, _ in met) and of.table.knows(pressed, tilt):
            known[key] = of.table.at(pressed, tilt)
    missing = [key for key in missing if key not in known]
    if missing:
        solve = _of_one_raceway if len(of.bases) == 1 else _in_series
        known.update(zip(missing, solve(of, [key[1:] for key in missing], tilt_response, progress), strict=True))
    return [[known[key] for key in row] for row in keys]


Asked = Sequence[tuple[Met, float, float]]
"""What rollers meet, with how much they press [N], and at which tilt of their rings [rad]."""


def _of_one_raceway(of: Rollers, asked: Asked, tilt_response: bool, progress: Progress | None) -> list[Turned]:
    cases = []
    for ((under, away),), pressed, tilt in asked:
        load, _ = of.table.between.loads(pressed)
        cases.append(samples.case_under(load, [of.spalls["outer"][i] for i in under], away)._replace(tilt=tilt))
    nodes = samples.all_solved(of.bases["outer"].contact, cases, of.accuracy, progress, tilt_response)
    return [Turned(case.tilt, (node,)) for case, node in zip(cases, nodes, strict=True)]


def _in_series(of: Rollers, asked: Asked, tilt_response: bool, progress: Progress | None) -> list[Turned]:
    contacts = of.bases["outer"].contact, of.bases["inner"].contact
    tables, between = healthy_tilt_table.known_by((of.tables[0], of.tables[1])), of.table.between

    def solve(case: tuple[Met, float, float]) -> Turned:
        met, pressed, tilt = case
        outer, inner = (
            [of.spalls[raceway][i] for i in under] for raceway, (under, _) in zip(of.bases, met, strict=True)
        )
        roller = RollerContacts(contacts, (outer, inner), (met[0][1], met[1][1]), tilt)
        start = of.table.at(pressed, tilt).tilt if of.table.knows(pressed, tilt) else None
        rest = tilt_equilibrium.at_rest(roller, between.loads(pressed), of.accuracy, start, tilt_response, tables)
        return Turned(rest.tilt, rest.shares(between.ratio))

    marks = contacts, dict(of.spalls), tuple(asked), (between.ratio, between.thrown), of.accuracy, tilt_response
    return user_cache.result(lambda: samples.mapped(solve, asked, of.accuracy, progress), "rollers_in_series", marks)


def _loads_and_tilts(
    table: TiltTable, pressed: np.ndarray, tilts: np.ndarray, by_load: float, by_tilt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of loads [log N] and tilts [rad] of every state's solves, both of shape (states, solves)."""
    ways, turns = (np.asarray(chebyshev_nodes(count, -1.0, 1.0)) for count in (LOADS, TILTS))
    turned = table.upright(pressed).reshape(-1, 1) / table.length
    logs = np.repeat(np.log(pressed).reshape(-1, 1) + by_load * ways, TILTS, axis=1)
    leaning = np.tile(tilts.reshape(-1, 1) + by_tilt * turned * turns, (1, LOADS))
    return logs, np.where(np.abs(leaning) < LEAST_TILT, LEAST_TILT, leaning)


def _bend(table: TiltTable, logs: np.ndarray, tilts: np.ndarray, solved: Sequence[Turned]) -> float:
    """How far solves are from the slices nearest to them, at most, by their loads."""
    loads, _ = table.between.loads(np.exp(logs))
    moments = np.array([each.nodes[0].moment for each in solved])
    approaches = np.array([table.between.whole([node.approach for node in each.nodes]) for each in solved])
    own = tilt_energy.fitted_slices(loads, -tilts, approaches, moments, np.asarray(table.length))
    z = (approaches[:, None] - tilts[:, None] * tilt_energy.points(table.length) - own.middle) / own.reach
    found = polynomial(own.coefficients[:, None, :], z, straight=True).sum(axis=-1)
    return float(np.max(np.abs(found / loads - 1.0)))
