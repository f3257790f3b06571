"""Contact solves around the loads and tilts of rollers whose rings tilt: the states that a `LocalLaw` is made of then.

Rollers on healthy raceway take theirs from one table over load and tilt, which is smooth; those that meet spalls are
solved each for itself.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.polynomial.chebyshev import chebval2d, chebvander

from difftrb.contact import crown
from difftrb.core import status
from difftrb.core.geometry import LineContact, Spall
from difftrb.core.numeric import chebyshev_nodes
from difftrb.core.series import polynomial
from difftrb.law import load_curve, samples, tilted_roller
from difftrb.law.direct import DirectLaw
from difftrb.law.local import NARROWER, SPREAD, LocalLaw
from difftrb.law.local_states import BENDS, SEARCHED, Known, Reached, solved_at, stacked
from difftrb.law.samples import Case, Node, Progress, Turning

LOADS, TILTS = 4, 4
"""Solves of a state: so many loads at so many tilts."""
TURNED = 0.3
"""How far a state's tilts are spread to either side, by approach over roller length."""
MOST_TURNED = 3.0
"""Of the table, by `TiltTable.reach`: a heavily loaded roller presses with a third of its length there."""
FARTHEST_TURNED = 6.0
"""Beyond, nothing is solved, and the status says so."""
LIFTED = 0.45
"""Of the roller's length from its middle: what the crown has risen there a lightly loaded roller may turn by, too."""
TABLE_LOADS, TABLE_TILTS = 10, 15
LIGHTER = 10.0
"""Factor by which the table reaches to smaller loads than the upright curve: rollers that carry less count as clear."""
SHARED = 8
"""Tables that a process remembers."""
TRIED = 100
"""Loads between which the one is looked for that goes with an approach."""
NOTHING = 1e-18
"""Share of what its contact would carry that a roller clear of the land has: as good as none, and what it would carry
can still be told."""
LEAST_TILT = 1e-9
"""[rad] A roller over a spall is not solved upright, for then it is solved as half of one."""


class TiltTable(NamedTuple):
    """Contacts of healthy rollers, solved over load and tilt.

    Attributes:
      low, high: of log Q [log N]. curve: of an upright roller.
      lift: how far the crown has risen at `LIFTED` [mm].
      coefficients: Chebyshev's in log Q and in the tilt, shape (TABLE_LOADS, TABLE_TILTS, values), of what `_told`
        says.
      status_code: worst of the solves.
    """

    contact: LineContact
    low: float
    high: float
    curve: load_curve.Curve
    lift: float
    coefficients: np.ndarray
    status_code: int

    def upright(self, load: float) -> float:
        """Approach of a healthy, upright roller [mm]."""
        return float(self._upright(np.asarray(load)))

    def _upright(self, loads: np.ndarray) -> np.ndarray:
        return load_curve.approach(self.curve, loads)

    def reach(self, load: float) -> float:
        """What tilts of a roller under this load are measured by [rad]."""
        return (self.upright(load) + self.lift) / float(self.contact.length)

    def knows(self, load: float, tilt: float) -> bool:
        """Whether a state is within the table."""
        return bool(self.low <= np.log(load) <= self.high and abs(tilt) <= MOST_TURNED * self.reach(load))

    def load_at(self, approach: float, tilt: float) -> float:
        """Load [N] of a roller at its approach [mm] and tilt [rad]; 0 where it carries less than the table knows, NaN
        where it may be turned farther."""
        logs = np.linspace(self.low, self.high, TRIED)
        long = self._upright(np.exp(logs)) + self.lift
        turned = tilt * float(self.contact.length) / (MOST_TURNED * long)
        known = np.abs(turned) <= 1.0
        level = (2.0 * logs - self.low - self.high) / (self.high - self.low)
        approaches = (long * chebval2d(level, turned, self.coefficients[..., 0]))[known]
        if not known.any() or approach > approaches[-1] or (approach < approaches[0] and not known[0]):
            return math.nan
        return 0.0 if approach < approaches[0] else float(np.exp(np.interp(approach, approaches, logs[known])))

    def node(self, load: float, tilt: float) -> Node:
        """As of `samples.solved_turning`, of one healthy roller."""
        x, y = (2.0 * np.log(load) - self.low - self.high) / (self.high - self.low), tilt / self.reach(load)
        approach, moment, *rest = chebval2d(x, y / MOST_TURNED, self.coefficients)
        long, arm, count = self.upright(load) + self.lift, load * float(self.contact.length), samples.INPUTS
        sizes = _sizes(self.contact)
        slopes, moment_slopes = long * np.array(rest[:count]) / sizes, arm * np.array(rest[count:]) / sizes
        return Node(
            long * float(approach), 0.0, slopes, self.status_code, 0.0, 0.0, arm * float(moment),
            Turning(0.0, 0.0, moment_slopes),
        )  # fmt: skip


def _sizes(contact: LineContact) -> np.ndarray:
    """What slopes by the inputs are measured by."""
    own = np.array(samples.inputs(contact, None, 0.0))
    return np.where(own != 0.0, own, 1.0)


def table_of(base: DirectLaw, progress: Progress | None) -> TiltTable:
    """The table of a contact over all loads of its upright curve."""
    contact, low, high = base.contact, float(base.log_loads[0] - np.log(LIGHTER)), float(base.log_loads[-1])
    curve = load_curve.one_of(base.curves((), np.zeros((0, 1))).each, 0)
    lift = float(crown.height(LIFTED * contact.length, contact))
    table = TiltTable(contact, low, high, curve, lift, np.zeros(0), status.CONVERGED)
    loads = np.exp(np.asarray(chebyshev_nodes(TABLE_LOADS, low, high)))
    turned = np.asarray(chebyshev_nodes(TABLE_TILTS, -1.0, 1.0))
    leaning = MOST_TURNED * turned[TABLE_TILTS // 2 :]  # the others are mirror images
    cases = [Case(q, tilt=float(y) * table.reach(q)) for q in loads for y in leaning]
    solved = _solved_once(contact, cases, float(base.error), progress)
    told = np.array([_told(table, case.load, node) for case, node in zip(cases, solved, strict=True)])
    told = told.reshape(len(loads), len(leaning), -1)
    odd = np.concatenate([[1.0, -1.0], np.ones(samples.INPUTS), -np.ones(samples.INPUTS)])
    told = np.concatenate([odd * told[:, :0:-1], told], axis=1)
    level = (2.0 * np.log(loads) - low - high) / (high - low)
    along, across = (np.linalg.inv(chebvander(x, len(x) - 1)) for x in (level, turned))
    coefficients = np.einsum("ai,bj,ijv->abv", along, across, told)
    return table._replace(coefficients=coefficients, status_code=int(samples.worst_status(solved)))


_SOLVED: dict[Any, list[Node]] = {}
"""Contacts of the last tables: scenes that differ in spalls, moments and effects share theirs."""


def _solved_once(contact: LineContact, cases: list[Case], accuracy: float, progress: Progress | None) -> list[Node]:
    """`samples.all_solved`, with `turning`; of the last `SHARED` tables without solving again."""
    key = tuple(float(value) for value in dataclasses.astuple(contact)), tuple(cases), accuracy
    if key not in _SOLVED:
        found = samples.all_solved(contact, cases, accuracy, progress, turning=True)
        while len(_SOLVED) >= SHARED:
            _SOLVED.pop(next(iter(_SOLVED)), None)
        _SOLVED[key] = found
    return _SOLVED[key]


def _told(table: TiltTable, load: float, node: Node) -> np.ndarray:
    """Approach by its size, moment by load and length, and the slopes of both by the inputs, all relative."""
    sizes, long, arm = _sizes(table.contact), table.upright(load) + table.lift, load * float(table.contact.length)
    moment_slopes = cast(Turning, node.turning).moment_slopes
    return np.concatenate(
        [[node.approach / long, node.moment / arm], sizes * node.slopes / long, sizes * moment_slopes / arm]
    )


def around(
    base: DirectLaw, table: TiltTable, spalls: tuple[Spall, ...], reached: Sequence[Reached],
    rollers: tuple[int, ...], loads: np.ndarray, tilts: np.ndarray, clear: np.ndarray, found: bool, known: Known,
    progress: Progress | None = None,
) -> LocalLaw:  # fmt: skip
    """As `local_states.around`, of rollers that carry about `loads` [N] at about `tilts` [rad], as contacts see them;
    those that are `clear` would carry less than these; all of shape (rollers reached,)."""
    most = FARTHEST_TURNED * np.array([table.reach(load) for load in loads])
    centres = np.clip(tilts, -most, most)
    logs, leaning = _spread(table, loads, centres, SPREAD if found else SEARCHED, TURNED)

    def solved_around(numbers: Sequence[int]) -> list[list[Node]]:
        own, pressed = [reached[k] for k in numbers], np.exp(logs[numbers])
        _known_by_table(table, own, pressed, leaning[numbers], found, known)
        return solved_at(base, spalls, own, pressed, leaning[numbers], found, known, progress)

    solved = solved_around(range(len(reached)))
    if found:
        bent = [k for k, own in enumerate(solved) if _bend(base.contact, logs[k], leaning[k], own) > BENDS]
        closer = _spread(table, loads[bent], centres[bent], NARROWER * SPREAD, NARROWER * TURNED)
        logs[bent], leaning[bent] = closer
        for k, own in zip(bent, solved_around(bent), strict=True):
            solved[k] = own
    code = max(float(base.status_code), table.status_code, samples.worst_status([n for own in solved for n in own]))
    if np.any(centres != tilts):
        code = max(code, float(status.LEANS))
    states = None
    if reached:
        slopes = [np.array([node.slopes for node in own]) for own in solved]
        shares = np.where(clear, NOTHING, 1.0)
        solved = [
            [dataclasses.replace(node, moment=share * node.moment) for node in own]
            for own, share in zip(solved, shares, strict=True)
        ]
        moment_slopes = [
            share * np.array([_moment_slopes(node) for node in own]) for own, share in zip(solved, shares, strict=True)
        ]
        logs = logs + np.log(shares)[:, None]
        states = stacked(base, spalls, reached, rollers, logs, leaning, solved, slopes, moment_slopes)
    return LocalLaw(dataclasses.replace(base, status_code=code), states, settling=True)


def _spread(
    table: TiltTable, loads: np.ndarray, tilts: np.ndarray, by_load: float, by_tilt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of loads [log N] and tilts [rad] of every state's solves, both of shape (states, solves)."""
    ways, turns = (np.asarray(chebyshev_nodes(count, -1.0, 1.0)) for count in (LOADS, TILTS))
    pressed = np.array([table.upright(load) for load in loads]).reshape(-1, 1) / float(table.contact.length)
    logs = np.repeat(np.log(loads).reshape(-1, 1) + by_load * ways, TILTS, axis=1)
    leaning = np.tile(tilts.reshape(-1, 1) + by_tilt * pressed * turns, (1, LOADS))
    return logs, np.where(np.abs(leaning) < LEAST_TILT, LEAST_TILT, leaning)


def _bend(contact: LineContact, log_loads: np.ndarray, tilts: np.ndarray, solved: Sequence[Node]) -> float:
    """How far solves are from the slices nearest to them, at most, by their loads."""
    approaches, moments = (np.array([getattr(node, name) for node in solved]) for name in ("approach", "moment"))
    length, loads = float(contact.length), np.exp(log_loads)
    own = tilted_roller.near(loads, -tilts, approaches, moments, np.asarray(length))
    z = (approaches[:, None] - tilts[:, None] * tilted_roller.places(length) - own.middle) / own.reach
    found = polynomial(own.coefficients[:, None, :], z, straight=True).sum(axis=-1)
    return float(np.max(np.abs(found / loads - 1.0)))


def _moment_slopes(node: Node) -> np.ndarray:
    return np.zeros_like(node.slopes) if node.turning is None else node.turning.moment_slopes


def _known_by_table(
    table: TiltTable, reached: Sequence[Reached], loads: np.ndarray, tilts: np.ndarray, found: bool, known: Known
) -> None:
    """Add those of healthy rollers that the table knows to the contacts `known`."""
    for each, own, turned in zip(reached, loads, tilts, strict=True):
        for load, tilt in zip(own, turned, strict=True):
            if not each.under and table.knows(load, tilt):
                known[found, each.under, each.away, float(load), float(tilt)] = table.node(load, tilt)
