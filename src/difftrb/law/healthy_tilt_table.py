"""Healthy rollers whose rings tilt, over load and tilt: of one raceway by contact solves, of two in series from both.

Both are smooth, so a few dozen contacts tell all of them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebval2d, chebvander

from difftrb.contact import crown
from difftrb.core import status
from difftrb.core.geometry import LineContact
from difftrb.core.numeric import chebyshev_nodes
from difftrb.law import load_curve, samples, tilt_equilibrium
from difftrb.law.direct_curves import DirectByCurves
from difftrb.law.roller_states import ALONG, mean_overlap
from difftrb.law.samples import Case, Node, Progress, TiltResponse
from difftrb.law.tilt_equilibrium import RollerContacts

MOST_TURNED = 3.0
"""Of a table, by `TiltTable.reach`: a heavily loaded roller presses with a third of its length there."""
LIFTED = 0.45
"""Of the roller's length from its middle: what the crown has risen there a lightly loaded roller may turn by, too."""
LOADS, TILTS = 12, 21
LIGHTER = 10.0
"""Factor by which a table reaches to smaller loads than the upright curve: rollers that carry less count as clear."""
SHARED = 8
"""Tables that a process remembers."""
HEIGHTS, BEYOND = 2000, 3.0
"""Loads at which the approach of upright rollers is known, and by how much in its logarithm farther than the table."""
TRIED = 100
"""Loads between which the one is looked for that goes with an approach."""
TELLS = 5 + 2 * samples.INPUTS
"""Numbers that a table has of a contact."""
ODD = np.array([1.0, -1.0, 1.0, -1.0, 1.0, *np.ones(samples.INPUTS), *-np.ones(samples.INPUTS)])
"""How they go over to a roller turned the other way."""


class Between(NamedTuple):
    """What a roller that presses against the inner ring with P [N] has on its contacts and on the flange.

    Attributes:
      ratio: outer by inner load, without what is `thrown` [N] and carried by the outer raceway alone.
      sunk: how far the flange lets the rings approach [mm], of P.
    """

    ratio: float = 1.0
    thrown: float = 0.0
    sunk: Callable[[Any], Any] = np.zeros_like

    def loads(self, pressed: Any) -> tuple[Any, Any]:
        """On the outer and on the inner raceway [N]."""
        return pressed + self.thrown, pressed / self.ratio

    def whole(self, parts: Sequence[Any]) -> Any:
        """Approach of the rings [mm], without the flange's, from those of the contacts."""
        return parts[0] if len(parts) == 1 else parts[0] + parts[1] / self.ratio


class Turned(NamedTuple):
    """A roller between rings that tilt: its own tilt against the outer raceway [rad], and what every contact has a part
    in, see `Resting.shares`; of one raceway the contact itself."""

    tilt: float
    nodes: tuple[Node, ...]


class TiltTable(NamedTuple):
    """Healthy rollers over load and tilt.

    Attributes:
      contacts: of every raceway that gives way, the outer one first.
      between: the loads of either.
      low, high: of log P [log N]. lift: how far the crowns have risen at `LIFTED` [mm].
      heights: logarithms of P [log N] and of upright rollers' approaches there [log mm], shape (2, HEIGHTS): tilts are
        measured by them thousands of times.
      coefficients: Chebyshev's in log P and in the tilt of the rings, shape (LOADS, TILTS, raceways · TELLS + 1): what
        `_relative_row` says of every contact, and the roller's own tilt.
      status_code: worst of the solves.
    """

    contacts: tuple[LineContact, ...]
    between: Between
    low: float
    high: float
    lift: float
    heights: np.ndarray
    coefficients: np.ndarray
    status_code: int

    @property
    def length(self) -> float:
        """Of the rollers [mm]."""
        return float(self.contacts[0].length)

    def upright(self, pressed: Any) -> Any:
        """Approach of healthy, upright rollers [mm], without the flange's, to 1e-6."""
        return np.exp(np.interp(np.log(pressed), *self.heights))

    def reach(self, pressed: Any) -> Any:
        """What tilts of rollers that press with so much are measured by [rad]."""
        return (self.upright(pressed) + self.lift) / self.length

    def knows(self, pressed: float, tilt: float) -> bool:
        """Whether a state is within the table."""
        return bool(self.low <= np.log(pressed) <= self.high and abs(tilt) <= MOST_TURNED * self.reach(pressed))

    def pressed_at(self, approach: float, tilt: float) -> float:
        """P [N] of a roller at its approach [mm] and the tilt of its rings [rad]; 0 where that is less than the table
        knows, NaN where it may be turned farther."""
        logs = np.linspace(self.low, self.high, TRIED)
        every = np.exp(logs)
        long = self.upright(every) + self.lift
        turned = tilt / (MOST_TURNED * self.reach(every))
        known = np.abs(turned) <= 1.0
        level = (2.0 * logs - self.low - self.high) / (self.high - self.low)
        parts = [chebval2d(level, turned, self.coefficients[..., k * TELLS]) for k in range(len(self.contacts))]
        approaches = (long * self.between.whole(parts) + self.between.sunk(every))[known]
        if not known.any() or approach > approaches[-1] or (approach < approaches[0] and not known[0]):
            return math.nan
        return 0.0 if approach < approaches[0] else float(np.exp(np.interp(approach, approaches, logs[known])))

    def about(self, approach: float, tilt: float) -> float:
        """About P [N] of a roller turned farther than the table knows: that of an upright one whose overlap along it is
        as large; 0 where that is less than the table knows."""
        crowned = np.sum([crown.height(ALONG * self.length, contact) for contact in self.contacts], axis=0)
        logs = np.linspace(self.low, self.high, TRIED)
        levels = mean_overlap(crowned, self.length, self.upright(np.exp(logs)), np.zeros(TRIED))
        own = float(mean_overlap(crowned, self.length, np.asarray(approach), np.asarray(tilt)))
        return 0.0 if own < levels[0] else float(np.exp(np.interp(own, levels, logs)))

    def at(self, pressed: float, tilt: float) -> Turned:
        """One roller."""
        x = (2.0 * np.log(pressed) - self.low - self.high) / (self.high - self.low)
        loads, reach = self.between.loads(pressed), float(self.reach(pressed))
        values = chebval2d(x, tilt / (MOST_TURNED * reach), self.coefficients)
        rows = values[:-1].reshape(len(self.contacts), TELLS)
        nodes = tuple(
            _node_of_row(row, float(load), contact, reach, self.status_code)
            for row, load, contact in zip(rows, loads, self.contacts, strict=False)
        )
        return Turned(reach * float(values[-1]), nodes)


def _logs(low: float, high: float) -> np.ndarray:
    """Of loads at which heights are known."""
    return np.linspace(low - BEYOND, high + BEYOND, HEIGHTS)


def _sizes(contact: LineContact) -> np.ndarray:
    """What slopes by the inputs are measured by."""
    own = np.array(samples.inputs(contact, None, 0.0))
    return np.where(own != 0.0, own, 1.0)


def _relative_row(node: Node, load: float, contact: LineContact, reach: float) -> np.ndarray:
    """Approach, moment, compliance, and how approach and moment go with tilt and inputs, all relative; shape
    (TELLS,)."""
    long, arm, sizes = reach * float(contact.length), load * float(contact.length), _sizes(contact)
    tilt_response = node.tilt_response
    assert tilt_response is not None
    first = [node.approach / long, node.moment / arm, node.compliance * load / long]
    turned = [tilt_response.by_tilt * reach / long, tilt_response.moment_by_tilt * reach / arm]
    return np.concatenate([first, turned, sizes * node.slopes / long, sizes * tilt_response.moment_slopes / arm])


def _node_of_row(values: np.ndarray, load: float, contact: LineContact, reach: float, code: int) -> Node:
    """The contact whose `_relative_row` it is."""
    long, arm, sizes = reach * float(contact.length), load * float(contact.length), _sizes(contact)
    approach, moment, compliance, by_tilt, moment_by_tilt, *rest = values
    slopes, moment_slopes = (np.array(part) / sizes for part in (rest[: samples.INPUTS], rest[samples.INPUTS :]))
    tilt_response = TiltResponse(by_tilt * long / reach, moment_by_tilt * arm / reach, arm * moment_slopes)
    return Node(approach * long, compliance * long / load, long * slopes, code, 0.0, 0.0, moment * arm, tilt_response)


def of_contact(base: DirectByCurves, progress: Progress | None) -> TiltTable:
    """The table of one contact over all loads of its upright curve, by contact solves."""
    curve = load_curve.one_of(base.curves((), np.zeros((0, 1))).each, 0)
    low, high = float(base.log_loads[0] - np.log(LIGHTER)), float(base.log_loads[-1])
    lift = float(crown.height(LIFTED * base.contact.length, base.contact))
    logs = _logs(low, high)
    heights = np.array([logs, np.log(load_curve.approach(curve, np.exp(logs)))])
    empty = TiltTable((base.contact,), Between(), low, high, lift, heights, np.zeros(0), status.CONVERGED)

    def solved(asked: Sequence[tuple[float, float]]) -> list[Turned]:
        cases = [Case(load, tilt=tilt) for load, tilt in asked]
        nodes = _solved_once(base.contact, cases, float(base.error), progress)
        return [Turned(case.tilt, (node,)) for case, node in zip(cases, nodes, strict=True)]

    return _through(empty, solved)


def between_rings(tables: tuple[TiltTable, ...], between: Between, accuracy: float) -> TiltTable:
    """The table of rollers between rings, from that of healthy contacts with every raceway that gives way. Between two
    raceways a roller rests where both moments balance; contacts that no table knows are solved with `accuracy`."""
    outer, *inner = tables
    low = max(outer.low, *(each.low + np.log(between.ratio) for each in inner), -np.inf)
    most = max(np.exp(outer.high) - between.thrown, 2.0 * np.exp(low))
    high = min(np.log(most), *(each.high + np.log(between.ratio) for each in inner), np.inf)
    logs = _logs(float(low), float(high))
    parts = [table.upright(load) for table, load in zip(tables, between.loads(np.exp(logs)), strict=False)]
    heights = np.array([logs, np.log(between.whole(parts))])
    contacts, code = tuple(each.contacts[0] for each in tables), max(each.status_code for each in tables)
    lift = sum(each.lift for each in tables)
    empty = TiltTable(contacts, between, float(low), float(high), lift, heights, np.zeros(0), code)

    def solved(asked: Sequence[tuple[float, float]]) -> list[Turned]:
        if not inner:
            return [outer.at(between.loads(pressed)[0], tilt) for pressed, tilt in asked]
        known, every = known_by((outer, inner[0])), []
        for pressed, tilt in asked:
            roller = RollerContacts((outer.contacts[0], inner[0].contacts[0]), ((), ()), ((), ()), tilt)
            rest = tilt_equilibrium.at_rest(roller, between.loads(pressed), accuracy, None, True, known)
            every.append(Turned(rest.tilt, rest.shares(between.ratio)))
        return every

    return _through(empty, solved)


def known_by(tables: tuple[TiltTable, TiltTable]) -> tilt_equilibrium.Lookup:
    """Healthy contacts with both raceways, as far as tables of either alone know them."""

    def of(table: TiltTable) -> Callable[[Case], Node | None]:
        def known(case: Case) -> Node | None:
            if case.spall is not None or not table.knows(case.load, case.tilt):
                return None
            return table.at(case.load, case.tilt).nodes[0]

        return known

    return of(tables[0]), of(tables[1])


def _through(table: TiltTable, solved: Callable[[Sequence[tuple[float, float]]], list[Turned]]) -> TiltTable:
    """The table with its coefficients, through what is `solved` at its nodes, of P [N] and tilts [rad]."""
    every = np.exp(np.asarray(chebyshev_nodes(LOADS, table.low, table.high)))
    turned = np.asarray(chebyshev_nodes(TILTS, -1.0, 1.0))
    leaning = MOST_TURNED * turned[TILTS // 2 :]  # the others are mirror images
    asked = [(float(pressed), float(tilt)) for pressed in every for tilt in leaning * table.reach(pressed)]
    found = solved(asked)
    rows = []
    for (pressed, _), each in zip(asked, found, strict=True):
        reach, loads = float(table.reach(pressed)), table.between.loads(pressed)
        of_contacts = [
            _relative_row(node, float(load), contact, reach)
            for node, load, contact in zip(each.nodes, loads, table.contacts, strict=False)
        ]
        rows.append([*np.concatenate(of_contacts), each.tilt / reach])
    values = np.array(rows).reshape(len(every), len(leaning), -1)
    odd = np.array([*np.tile(ODD, len(table.contacts)), -1.0])
    values = np.concatenate([odd * values[:, :0:-1], values], axis=1)
    level = (2.0 * np.log(every) - table.low - table.high) / (table.high - table.low)
    along, across = (np.linalg.inv(chebvander(x, len(x) - 1)) for x in (level, turned))
    coefficients = np.einsum("ai,bj,ijv->abv", along, across, values)
    worst = int(samples.worst_status([node for each in found for node in each.nodes]))
    return table._replace(coefficients=coefficients, status_code=max(table.status_code, worst))


_SOLVED: dict[Any, list[Node]] = {}
"""Contacts of the last tables: scenes that differ in spalls, moments and effects share theirs."""


def _solved_once(contact: LineContact, cases: list[Case], accuracy: float, progress: Progress | None) -> list[Node]:
    """`samples.all_solved`, with `tilt_response`; of the last `SHARED` tables without solving again."""
    key = tuple(float(value) for value in dataclasses.astuple(contact)), tuple(cases), accuracy
    if key not in _SOLVED:
        found = samples.all_solved(contact, cases, accuracy, progress, tilt_response=True)
        while len(_SOLVED) >= SHARED:
            _SOLVED.pop(next(iter(_SOLVED)), None)
        _SOLVED[key] = found
    return _SOLVED[key]
