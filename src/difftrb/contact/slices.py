"""About how a roller is loaded along its line, and where its contact ends: slices that press one another down.

Each slice is a line contact with a semi-elliptic pressure, and sinks as its middle does under all of them: the
half-space's kernel along the line. That is right to some thousandths where no rolling edge is in the contact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import crown, strip_active_set, strip_rows
from difftrb.contact import gap as gaps
from difftrb.contact.strip_active_set import Quadratic
from difftrb.core import arrays as xp
from difftrb.core import loops
from difftrb.core.arrays import Taylor
from difftrb.core.geometry import LineContact

LAND, HOLLOW = 24, 10  # slices of each land and of the hollow
AT_TIP, AT_SPALL = 2.5, 1.5  # powers with which they grow from there
BLUNT = 0.5 * np.exp(-0.5)
"""A semi-ellipse's pressure sinks its own middle as a line at this distance does, by the half-width."""
NARROWEST, MOST = 0.05, 2.0  # line load by the mean: with less or more, slices count as such
WIDE = 2.0
"""By how much blunter than their own middle slices are for others. What is missing on themselves is added: short slices
beside a spall's end would else be as good as one, and the solution ill-conditioned."""
OPEN = 0.05  # gap that is left where rows end, by the approach
BEYOND = 1.05  # by the approach that was found between the roller's ends
TURNS, ROUNDS = 2, 12  # half-widths that are tried, and steps of the active set for each


class Slices(NamedTuple):
    """Of a loaded roller, all along its line from its lower end to its upper one.

    Attributes:
      middle, length: of the slices [mm], (slices,). load: line load by πE' [mm], and whether it is `active`.
      blunt_by: the line loads that tell how blunt they are [mm].
      approach: [mm]. left: the gap that is left between slices [mm]. level: undeformed gap at which they end [mm].
    """

    middle: Any
    length: Any
    load: Any
    active: Any
    blunt_by: Any
    approach: Any
    left: Any
    level: Any

    @property
    def mean(self) -> Any:
        """Of the line loads by πE', by what they carry [mm]."""
        carried = self.length * self.load
        return xp.total(carried * self.load) / xp.total(carried)


def pressed(contact: LineContact, needed: Any, low: Any, high: Any, edge: Any, tilt: Any | None) -> Slices:
    """The slices under a load of `needed` πE' [mm²]; those between `low` and `high` stand on land that ends `edge` [mm]
    beside the roller's middle, or beyond it, if that is negative."""

    def between(ends: tuple[Any, Any], load_at: Callable[[Any], Any]) -> Slices:
        middle, length = _lines(ends, low, high)

        def turn(state: tuple) -> tuple:
            active, last, _, _ = state
            sunk, own, rest = _terms(contact, ends, low, high, edge, tilt, last)
            problem = Quadratic(_symmetric(sunk) + xp.diag(own), rest, length, needed)
            found, active, _ = strip_active_set.solve(problem, active, ROUNDS)
            return active, found.loads, last, found.approach

        first = load_at(middle)
        begun = length > 1e-9 * contact.length, first, first, 0.0 * needed
        active, load, before, approach = loops.repeated(TURNS, turn, begun)
        left = _left(length, *_terms(contact, ends, low, high, edge, tilt, before), load, approach)
        return Slices(middle, length, load, active, before, approach, left, 0.0 * needed)

    half = 0.5 * contact.length
    first = between((-half, half), lambda middle: needed / contact.length + 0.0 * middle)
    level = BEYOND * first.approach
    found = between(_ends(contact, level, low, high, tilt), lambda middle: xp.interp(middle, first.middle, first.load))
    return found._replace(level=level)


def _ends(contact: LineContact, level: Any, low: Any, high: Any, tilt: Any | None) -> tuple[Any, Any]:
    """Where slices begin and end: no slice is loaded where the gap exceeds the approach."""
    bottom, top = (crown.reached(contact, level, tilt, side) for side in (-1.0, 1.0))
    return xp.minimum(bottom, low), xp.maximum(top, high)


def near(found: Slices, contact: LineContact, needed: Any, low: Any, high: Any, edge: Any, tilt: Any | None) -> Slices:
    """The slices to about first order in a change of what was `pressed`; where they end grows like the approach."""
    about = found
    for _ in range(TURNS):
        ends = _ends(contact, about.approach * (found.level / found.approach), low, high, tilt)
        middle, length = _lines(ends, low, high)
        sunk, own, rest = _terms(contact, ends, low, high, edge, tilt, about.blunt_by)
        pushed = 0.5 * (xp.einsum("ij,j->i", sunk, found.load) + xp.einsum("i,ij->j", found.load, sunk))
        residual = pushed + own * found.load + rest - found.approach * length
        if xp.by(residual) is None:
            return found
        matrix = _symmetric(xp.value(sunk)) + xp.diag(xp.value(own))
        lacking = needed - xp.total(length * found.load)
        approach, load = _followed(found, matrix, xp.by(residual), xp.by(lacking))
        left = _left(length, sunk, own, rest, load, approach)
        about = found._replace(
            middle=middle,
            length=length,
            load=load,
            approach=approach,
            left=left,
            blunt_by=Taylor(found.blunt_by, load.by),
        )
    return about


def _followed(found: Slices, matrix: Any, residual: Any, lacking: Any) -> tuple[Taylor, Taylor]:
    """Approach and line loads, expanded so that those that are active follow derivatives of a `residual`, (parameters,
    slices), and of a load that is `lacking`, (parameters,) or None."""
    on = found.active
    masked = xp.where(on[:, None] & on[None], matrix, xp.diag(xp.where(on, 0.0, 1.0)))
    right = xp.concatenate([found.length[:, None], -residual.T], axis=-1)
    by_weight, *by_gap = xp.solved(masked, xp.where(on[:, None], right, 0.0)).T
    by_gap, weight = xp.stack(by_gap), xp.where(on, found.length, 0.0)
    by_approach = ((0.0 if lacking is None else lacking) - by_gap @ weight) / (weight @ by_weight)
    return Taylor(found.approach, by_approach), Taylor(found.load, by_gap + by_approach[:, None] * by_weight[None])


def _symmetric(matrix: Any) -> Any:
    return 0.5 * (matrix + matrix.T)


def _lines(ends: tuple[Any, Any], low: Any, high: Any) -> tuple[Any, Any]:
    """Middles and lengths of the slices [mm]."""
    lines = _borders(ends, low, high)
    return 0.5 * (lines[1:] + lines[:-1]), lines[1:] - lines[:-1]


def _borders(ends: tuple[Any, Any], low: Any, high: Any) -> Any:
    bottom, top = ends
    lower = -strip_rows.graded(-low, -bottom, LAND, AT_SPALL, AT_TIP)[::-1]
    hollow = strip_rows.graded(low, high, HOLLOW, AT_SPALL, AT_SPALL)
    return xp.concatenate([lower, hollow[1:], strip_rows.graded(high, top, LAND, AT_SPALL, AT_TIP)[1:]])


def _terms(
    contact: LineContact, ends: tuple[Any, Any], low: Any, high: Any, edge: Any, tilt: Any | None, load: Any
) -> tuple[Any, Any, Any]:
    """How deep slices sink by the line load of others and of themselves, and their gap, all times their lengths. How
    blunt they are is from a first `load`."""
    edge = edge / xp.sqrt(4.0 * contact.radius)  # the gap is 2x², a half-width squared a line load
    lines = _borders(ends, low, high)
    middle, length = _lines(ends, low, high)
    over = np.repeat([0.0, 1.0, 0.0], [LAND, HOLLOW, LAND])
    most = 0.5 * contact.length * (1.0 - 1e-9)  # the crown is infinite at the roller's ends
    rest = gaps.rest_at(xp.clip(middle, -most, most), contact, tilt) + over * 2.0 * xp.maximum(edge, 0.0) ** 2
    known = xp.fixed(length)
    mean = xp.total(known * load**2) / xp.total(known * load)
    blunt = 2.0 * BLUNT * WIDE * xp.sqrt(contact.radius * mean)
    thick = xp.clip(load, NARROWEST * mean, MOST * mean)
    own = xp.log(WIDE**2 * mean / thick) + over * _cut(thick, edge)
    away = (middle[:, None] - lines[None]) / blunt
    from_end = xp.arcsinh(away)
    sunk = length[:, None] * (from_end[:, :-1] - from_end[:, 1:])
    return sunk, length * own, length * rest


def _cut(load: Any, edge: Any) -> Any:
    """By how much farther contacts sink that are cut off at `edge`, by their `load` and beyond the gap there, if it is
    beside the middle: closed form of a cylinder on a half-plane."""
    outer = xp.where(edge < -xp.sqrt(load), xp.sqrt(load), (edge + 2.0 * xp.sqrt(edge * edge + 3.0 * load)) / 3.0)
    inner = xp.maximum(edge, -outer)
    half, middle = 0.5 * (outer - inner), 0.5 * (outer + inner)
    farther = 2.0 * middle**2 + half**2 - load + load * xp.log(load / half**2)
    return (farther - 2.0 * xp.maximum(edge, 0.0) ** 2) / load


def _left(length: Any, sunk: Any, own: Any, rest: Any, load: Any, approach: Any) -> Any:
    """The gap that is left between slices [mm], (slices,)."""
    pushed = 0.5 * (xp.einsum("ij,j->i", sunk, load) + xp.einsum("j,ji->i", load, sunk))
    there = xp.value(length) > 0.0
    return (pushed + own * load + rest) / xp.where(there, length, 1.0) - approach


def reached(slices: Slices, side: float) -> Any:
    """How far on one `side` slices are nearer than `OPEN` of the approach [mm]: between two of them linearly."""
    y, left = side * slices.middle, slices.left - OPEN * slices.approach
    if side < 0.0:
        y, left = y[::-1], left[::-1]
    closed = xp.value(left) < 0.0
    last = xp.minimum(xp.max(xp.where(closed, np.arange(len(y)), 0)), len(y) - 2)
    share = left[last] / (left[last] - left[last + 1])
    return side * (y[last] + xp.clip(share, 0.0, 1.0) * (y[last + 1] - y[last]))
