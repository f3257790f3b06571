"""About how a roller is loaded along its line, and where its contact ends: slices that press one another down.

Each slice is a line contact with a semi-elliptic pressure, and sinks as its middle does under all of them: the
half-space's kernel along the line. That is right to some thousandths where no rolling edge is in the contact.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import gap as gaps
from difftrb.contact import strip_active_set, strip_rows
from difftrb.contact.hollows import Hollow
from difftrb.contact.strip_active_set import Quadratic
from difftrb.core import arrays as xp
from difftrb.core import loops
from difftrb.core.arrays import Taylor
from difftrb.core.geometry import LineContact

OUTER, HOLLOW, BETWEEN = 28, 10, 16  # slices of land up to the roller's end, of a hollow, of land between two
AT_TIP, AT_SPALL = 3.0, 1.5  # powers with which they grow from there
BLUNT = 0.5 * np.exp(-0.5)
"""A semi-ellipse's pressure sinks its own middle as a line at this distance does, by the half-width."""
NARROWEST, MOST = 0.05, 2.0  # line load by the mean: with less or more, slices count as such
WIDE = 2.0
"""For others a slice counts as so many times as blunt as it is; what is then missing of its own sinking is added there.
Short slices beside a spall's end would else be as good as one, and the solution ill-conditioned."""
OPENS = 0.1
"""Of what is left of the gap under the first slice that is not loaded, so much counts as load that it lacks: ends of
contacts are within 0.004 of half the roller's length from those of 150 slices a land, as measured."""
TURNS, ROUNDS = 3, 12  # half-widths that are tried, and steps of the active set for each


class Slices(NamedTuple):
    """Of a loaded roller, all along its line from its lower end, or its middle if it is mirrored, to its upper one.

    Attributes:
      middle, length: of the slices [mm], (slices,). load: line load by πE' [mm], and whether it is `active`.
      blunt_by: the line loads that tell how blunt they are [mm].
      gap: what is left of the gap under those that are not loaded [mm], (slices,); 0 under the others.
      approach: [mm].
    """

    middle: Any
    length: Any
    load: Any
    active: Any
    blunt_by: Any
    gap: Any
    approach: Any

    @property
    def mean(self) -> Any:
        """Of the line loads by πE', by what they carry [mm]."""
        carried = self.length * self.load
        return xp.total(carried * self.load) / xp.total(carried)


class Line(NamedTuple):
    """A roller along its line: over which `hollows`, how it is tilted [rad] or None, and whether it is `mirrored` about
    its middle and the slices are those of its upper half."""

    contact: LineContact
    hollows: tuple[Hollow, ...]
    tilt: Any | None
    mirrored: bool


def pressed(line: Line, needed: Any) -> Slices:
    """The slices under a load of `needed` πE' [mm²] on all of them; those over hollows stand on land that ends with the
    nearer of these's rolling edges."""

    def turn(state: tuple) -> tuple:
        found = Slices(middle, length, *state)
        terms = sunk, own, rest = _terms(line, found.load)
        problem = Quadratic(_symmetric(sunk) + xp.diag(own), rest, length, needed)
        solved, active, _ = strip_active_set.solve(problem, found.active, ROUNDS)
        found = found._replace(load=solved.loads, active=active, blunt_by=found.load, approach=solved.approach)
        return found._replace(gap=_gap_left(found, terms))[2:]

    borders = _borders(line)
    middle, length = _sizes(borders)
    even = needed / (borders[-1] - borders[0]) + 0.0 * length
    first = even, length > 1e-9 * line.contact.length, even, 0.0 * length, 0.0 * needed
    return Slices(middle, length, *loops.repeated(TURNS, turn, first))


def near(found: Slices, line: Line, needed: Any) -> Slices:
    """The slices to about first order in a change of what was `pressed`."""
    middle, length = _sizes(_borders(line))
    lacking = needed - xp.total(length * found.load)
    blunt_by, approach, load = found.blunt_by, found.approach, found.load
    for _ in range(TURNS - 1):
        sunk, own, rest = _terms(line, blunt_by)
        residual = _residual(found._replace(length=length), (sunk, own, rest))
        by_gap, by_load = xp.by(residual), xp.by(lacking)
        if by_gap is None and by_load is None:
            break
        if by_gap is None:  # by the load alone
            by_gap = np.zeros((len(by_load), len(found.load)))
        matrix = _symmetric(xp.value(sunk)) + xp.diag(xp.value(own))
        approach, load = _followed(found, matrix, by_gap, by_load)
        blunt_by = Taylor(found.blunt_by, load.by)
    found = found._replace(middle=middle, length=length, load=load, approach=approach, blunt_by=blunt_by)
    return found._replace(gap=_gap_left(found, _terms(line, blunt_by)))


def _residual(found: Slices, terms: tuple[Any, Any, Any]) -> Any:
    """What is left of the gap under every slice, times their lengths [mm²]."""
    sunk, own, rest = terms
    pushed = 0.5 * (xp.einsum("ij,j->i", sunk, found.load) + xp.einsum("i,ij->j", found.load, sunk))
    return pushed + own * found.load + rest - found.approach * found.length


def _gap_left(found: Slices, terms: tuple[Any, Any, Any]) -> Any:
    size = xp.maximum(found.length, 1e-9 * xp.total(found.length))  # hollows may have no length
    return xp.where(found.active, 0.0, _residual(found, terms) / size)


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


def _sizes(borders: Any) -> tuple[Any, Any]:
    """Middles and lengths of the slices [mm]."""
    return 0.5 * (borders[1:] + borders[:-1]), borders[1:] - borders[:-1]


def _counts(hollows: int) -> list[int]:
    """Slices of every land and hollow, in their order along the roller; even, where they hold its middle."""
    if not hollows:
        return [2 * OUTER]
    return [OUTER, *[HOLLOW, BETWEEN] * (hollows - 1), HOLLOW, OUTER]


def _parts(hollows: int, mirrored: bool) -> np.ndarray:
    """The number of the land (even) or hollow (odd) of every slice."""
    counts = _counts(hollows)
    every = np.repeat(np.arange(len(counts)), counts)
    return every[len(every) // 2 :] if mirrored else every


def _borders(line: Line) -> Any:
    """Where slices end [mm]."""
    half, hollows = 0.5 * line.contact.length, line.hollows
    if not hollows:  # a light load is on a healthy roller's middle
        upper = strip_rows.graded(0.0 * half, half, OUTER, AT_SPALL, AT_TIP)
        return upper if line.mirrored else xp.concatenate([-upper[:0:-1], upper])
    ends = [-half, *(end for hollow in hollows for end in (hollow.low, hollow.high)), half]
    counts = _counts(len(hollows))
    lines = []
    for i, count in enumerate(counts):
        powers = (AT_SPALL if i else AT_TIP, AT_SPALL if i + 1 < len(counts) else AT_TIP)
        lines.append(strip_rows.graded(ends[i], ends[i + 1], count, *powers))
    every = xp.concatenate([lines[0], *(some[1:] for some in lines[1:])])
    return every[sum(counts) // 2 :] if line.mirrored else every


def _terms(line: Line, load: Any) -> tuple[Any, Any, Any]:
    """How deep slices sink by the line load of others and of themselves, and their gap, all times their lengths. How
    blunt they are is from a first `load`."""
    contact, borders = line.contact, _borders(line)
    middle, length = _sizes(borders)
    known = xp.fixed(length)
    mean = xp.total(known * load**2) / xp.total(known * load)
    blunt = 2.0 * BLUNT * WIDE * xp.sqrt(contact.radius * mean)
    thick = xp.clip(load, NARROWEST * mean, MOST * mean)
    most = 0.5 * contact.length * (1.0 - 1e-9)  # the crown is infinite at the roller's ends
    rest = gaps.rest_at(xp.clip(middle, -most, most), contact, line.tilt)
    own = xp.log(WIDE**2 * mean / thick)
    part = _parts(len(line.hollows), line.mirrored)
    for i, hollow in enumerate(line.hollows):
        over = (part == 2 * i + 1).astype(float)
        edge = hollow.edge / xp.sqrt(4.0 * contact.radius)  # the gap is 2x², a half-width squared a line load
        rest = rest + over * 2.0 * xp.maximum(edge, 0.0) ** 2
        own = own + over * _cut(thick, edge)
    from_end = xp.arcsinh((middle[:, None] - borders[None]) / blunt)
    sunk = from_end[:, :-1] - from_end[:, 1:]
    if line.mirrored:
        from_image = xp.arcsinh((middle[:, None] + borders[None]) / blunt)
        sunk = sunk + from_image[:, 1:] - from_image[:, :-1]
    return length[:, None] * sunk, length * own, length * rest


def _cut(load: Any, edge: Any) -> Any:
    """By how much farther contacts sink that are cut off at `edge`, by their `load` and beyond the gap there, if it is
    beside the middle: closed form of a cylinder on a half-plane."""
    outer = xp.where(edge < -xp.sqrt(load), xp.sqrt(load), (edge + 2.0 * xp.sqrt(edge * edge + 3.0 * load)) / 3.0)
    inner = xp.maximum(edge, -outer)
    half, middle = 0.5 * (outer - inner), 0.5 * (outer + inner)
    farther = 2.0 * middle**2 + half**2 - load + load * xp.log(load / half**2)
    return (farther - 2.0 * xp.maximum(edge, 0.0) ** 2) / load


def tip(slices: Slices, side: float, line: Line) -> Any:
    """Where contact ends on one `side` [mm]: between the last slice that is loaded and the next, nearer to the one with
    less load or gap, so that it does not step when the next one is loaded; beyond a spall's end, if that is between the
    two."""
    part = _parts(len(line.hollows), line.mirrored)
    y, load, gap = slices.middle, slices.load, slices.gap
    if side < 0.0 and not line.mirrored:
        y, load, gap, part = -y[::-1], load[::-1], gap[::-1], part[::-1]
    last = xp.max(xp.where(xp.value(load) > 0.0, np.arange(len(y)), 0))
    beyond = xp.minimum(last + 1, len(y) - 1)
    share = load[last] / xp.maximum(load[last] + OPENS * gap[beyond], 1e-12 * slices.approach)
    share = xp.where(xp.any(last == np.flatnonzero(np.diff(part))), 1.0, share)
    return side * (y[last] + (y[beyond] - y[last]) * share)
