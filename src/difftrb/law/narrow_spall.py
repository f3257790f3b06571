"""A spall so narrow that both its edges are in reach: how far a roller sinks over it, and the one edge for both.

In plane strain a roller under a line load, whose contact has the half-width b without a spall, sinks by (b²/R) g more
over a spall with vertical walls that it does not fill. Where both lands touch, at −e₁ and beyond and at e₂ and beyond,
the pressure is |x − m| √((x + a₁)(a₂ − x))/√((x + e₁)(x − e₂)) times E'/2R, 0 at the free ends −a₁ and a₂. m follows
from what it must be far away, a₁ and a₂ from the load and from lands that have sunk equally far. With the middle of a
spall of width w under the roller it sinks w²/8R, exactly; wherever both lands touch, 0.88…1 times that. The share is
solved here once, on a grid, and read as a polynomial. On one land alone g(e) = e²/2 + 3k²/4 + ek − ln(k)/2 − 1/4 with
k = (√(e² + 3) − e)/3 and e in half-widths.

The equivalent edge is the one over which the roller would sink as far, in the mean over rows along the spall, of which
the crown loads the outer ones less. The contact's width goes with the share of load that is left, that with the edge:
it is found in rounds. What rows make of each other comes last (`narrow_shift`).
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import loops, series
from difftrb.core.numeric import bisected, chebyshev_roots, gauss_legendre
from difftrb.law import edge_share, narrow_shift

MIDDLE = 1.0 / 8.0
"""Of the width's square, by which the roller sinks over the spall's middle, by R."""
WIDEST = 80.0
"""Widest spall in half-widths; beyond, so little load is left on the lands that they count as if there were more."""
NARROWEST = 1e-4
"""The narrowest one: what is left of a square is the same below."""
HALF = 2.0
"""Width in half-widths that stands half-way in the polynomials' variable."""
END_DEGREE = 12
"""Of the edge at which the far land begins to touch."""
DEGREES = 7, 6
"""Of the share of w²/8R in the spall's place between there and the middle, and in its width."""
PLACES = 12
POINTS = 400
ROUNDS = 9
"""In which the one edge is found that stands for a narrow spall's two: to rounding, its derivatives to 1e-9."""
ALONG, WEIGHTS = gauss_legendre(6)
"""Rows along a narrow spall, in halves of its length from its middle, and what they count."""
ROW = 1.3
"""A row's line load goes with this power of the approach less the crown, as a crowned roller's load does."""
FAR = 2.5
"""A spall so many times as wide as a ramp's end is off: in its middle a roller meets no land, for two lands that carry
let it sink by at least 0.88 of its chord."""
SHUT = 1e-3
"""Least of that, in shares of the approach."""


def sinking(near: Any, width: Any, half_width: Any) -> Any:
    """How far a roller sinks over both edges of a spall, by the width's square and times R: 1/8 in its middle.

    Args:
      near: how far the nearer edge stands beyond the roller's middle, positive over the spall, at most half of
        `width` [mm]. width: of the spall [mm], ≥ 0.
      half_width: of the contact that would carry the same line load without a spall [mm], > 0.

    0 where the spall is beside the contact. Continuous; smooth but where the far land begins to touch.
    """
    near, width, half_width = map(xp.asarray, (near, width, half_width))
    unit = xp.maximum(half_width, width / WIDEST)
    width = xp.maximum(width, NARROWEST * unit)
    x, edge = width / unit, near / unit
    rows = xp.with_rates(_of_width, x[None])
    end, inside = rows[0], rows[1:]
    place = xp.minimum(((0.5 * x - edge) / _farthest(x, end)) ** 2, 1.0)
    both = place < 1.0
    # over one land alone, by the width's square: where it lies, or where the far one begins to touch
    alone = xp.with_rates(_sunk_over_one, xp.where(both, x * end, edge + 1.0)) / (x * x)
    rest = series.polynomial(inside, 2.0 * place - 1.0)
    return xp.where(both, MIDDLE + place * (alone - MIDDLE + (1.0 - place) * rest), alone)


def reaches_far_land(near: Any, width: Any, half_width: Any) -> Any:
    """Whether the far land carries, too; arguments as of `sinking`, which is that of one edge where it does not."""
    x = xp.maximum(width / xp.maximum(half_width, width / WIDEST), NARROWEST)
    end = series.horner(_polynomials()[:, 0], _variable(x))
    return 0.5 * x - near * (x / xp.maximum(width, NARROWEST * half_width)) < _farthest(x, end)


def _variable(x: Any) -> Any:
    """In −1…1, of a width in half-widths."""
    return 2.0 * x / (x + HALF) * ((WIDEST + HALF) / WIDEST) - 1.0


def _of_width(x: Any) -> tuple[Any, Any, Any]:
    """The rows of `_polynomials` and their first two derivatives by a width in half-widths, of shape (1, …)."""
    every = _polynomials()
    every, w = every.reshape(*every.shape, *[1] * (x.ndim - 1)), _variable(x)
    (value, rate), bend = series.with_slope(every, w), series.derivative(every, w, 2)
    rise = 2.0 * HALF * ((WIDEST + HALF) / WIDEST) / ((x + HALF) * (x + HALF))
    return value, rate * rise, (bend * rise - 2.0 * rate / (x + HALF)) * rise


def _farthest(x: Any, end: Any) -> Any:
    """How far the spall's middle is from the roller's, in half-widths, where the far land begins to touch; `end`: the
    first row of `_polynomials`."""
    return 1.0 + x * (0.5 - end)


def over_one(edge: Any, half_width: Any) -> Any:
    """How far a roller sinks over one edge, times R [mm²]; 0 where it is beside the contact."""
    return half_width * half_width * xp.with_rates(_sunk_over_one, edge / half_width + 1.0)


def over_one_slope(edge: Any, half_width: Any) -> Any:
    """Its derivative by the edge [mm], of numbers."""
    return half_width * _sunk_over_one(edge / half_width + 1.0)[1]


def _sunk_over_one(s: Any) -> tuple[Any, Any, Any]:
    """g at the edge s − 1 and its first two derivatives, of numbers."""
    s, above = xp.maximum(s, 0.0), s > 0.0
    # short = 1 − k: k is half the width of the contact on the one land
    root = xp.sqrt(4.0 - 2.0 * s + s * s)
    short = (s + (2.0 * s - s * s) / (2.0 + root)) / 3.0
    rest = xp.log1p(-short) + short + 0.5 * short * short
    value = 0.5 * s * s + short * short - s * short - 0.5 * rest
    return value, s - short, xp.where(above, (2.0 + (s - 1.0) / root) / 3.0, 0.0)


@cache
def _polynomials() -> np.ndarray:
    """Of a spall's width w in half-widths, coefficients of powers of the width's variable, shape (widths, 1 + places):
    of (e + 1)/w at the edge e where the far land begins to touch; and of what the sinking by w² is more than linear in
    the place p between the middle and there, by p(1 − p). Solved and fitted once for all."""
    rise = 0.5 * (1.0 - chebyshev_roots(24))
    share = rise * WIDEST / (WIDEST + HALF)
    widths = HALF * share / (1.0 - share)
    ends = _where_far_land_touches(widths)
    chebyshev = np.polynomial.chebyshev
    end = np.asarray(chebyshev.cheb2poly(chebyshev.chebfit(2.0 * rise - 1.0, (ends + 1.0) / widths, END_DEGREE)))
    places = 0.5 * (1.0 - chebyshev_roots(PLACES))
    last, sunk = _sunk_over_one(ends + 1.0)[0] / widths**2, _sunk(widths, 0.5 * widths - ends, places) / widths**2
    more = sunk - MIDDLE - places[:, None] * (last - MIDDLE)
    grid = np.meshgrid(2.0 * places - 1.0, 2.0 * rise - 1.0, indexing="ij")
    weight = (widths**2 / (1.0 + widths**2) * np.ones((PLACES, 1))).ravel()
    rows = chebyshev.chebvander2d(grid[0].ravel(), grid[1].ravel(), DEGREES)
    rows = rows * np.repeat(places * (1.0 - places), widths.size)[:, None]
    found = np.linalg.lstsq(rows * weight[:, None], more.ravel() * weight)[0].reshape(*(n + 1 for n in DEGREES))
    inside = np.array([chebyshev.cheb2poly(row) for row in found])
    inside = np.array([chebyshev.cheb2poly(column) for column in inside.T])
    inside = np.pad(inside, ((0, len(end) - len(inside)), (0, 0)))
    return np.concatenate([end[:, None], inside], axis=1)


def _where_far_land_touches(widths: np.ndarray) -> np.ndarray:
    """The near edge at which the gap over the far one closes."""

    def closed(edge: np.ndarray) -> np.ndarray:
        k = (np.sqrt(edge * edge + 3.0) - edge) / 3.0  # half the width of one land's contact
        middle = edge + k
        z = widths - edge + middle
        root, area = np.sqrt(np.maximum(z * z - k * k, 0.0)), np.arccosh(np.maximum(z / k, 1.0))
        return 0.5 * z * root - 0.5 * k * k * area - middle * root - middle * k * area > 0.0

    low, high = bisected(closed, -np.ones_like(widths), 0.5 * widths)
    return 0.5 * (low + high)


def _sunk(widths: np.ndarray, farthest: np.ndarray, places: np.ndarray) -> np.ndarray:
    """g of both lands at every place: the square of the distance from the spall's middle by the farthest's; shape
    (places, widths)."""
    lands = np.log(np.sqrt(1.0 + 0.25 * widths**2) - 0.5 * widths) * np.ones((2, 1))  # beyond edges beside the middle
    found = []
    for place in places:  # from the middle outwards, each from the one before
        away = np.sqrt(place) * farthest
        edges = np.stack([0.5 * widths - away, 0.5 * widths + away])
        for _ in range(14):
            value = _unbalanced(edges, lands)
            columns = [(_unbalanced(edges, lands + h) - value) / 1e-7 for h in 1e-7 * np.eye(2)[:, :, None]]
            (a, c), (b, d) = columns
            step = np.stack([d * value[0] - b * value[1], a * value[1] - c * value[0]]) / (a * d - b * c)
            lands = lands - np.clip(step, -1.0, 1.0)
        found.append(_sinking_of_both(edges, lands))
    return np.array(found)


def _middle(edges: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """m."""
    return 0.5 * (ends[0] - ends[1] - edges[0] + edges[1])


def _unbalanced(edges: np.ndarray, lands: np.ndarray) -> np.ndarray:
    """How far the load is from that of b = 1, and how much farther one land has sunk than the other; shape (2, n)."""
    ends = edges + np.exp(lands)
    m = _middle(edges, ends)
    second = 0.25 * np.sum(edges**2 - ends**2, axis=0) + 0.5 * m**2
    x = 0.5 * np.sum(edges, axis=0) * chebyshev_roots(POINTS)[:, None]
    x = x + 0.5 * (edges[1] - edges[0])
    return np.stack([m * m - second - 0.5, np.mean((x - m) * np.sqrt((x + ends[0]) * (ends[1] - x)), axis=0)])


def _sinking_of_both(edges: np.ndarray, lands: np.ndarray) -> np.ndarray:
    """g of both lands: what the near one's outer end has sunk."""
    (near, far), ends = edges, edges + np.exp(lands)
    m = -_middle(edges, ends)  # all looked at from the other side
    u, weight = gauss_legendre(POINTS)
    u, weight = 0.5 * (u + 1.0), 0.5 * weight
    s = (u**2 / (1.0 - u**2))[:, None]
    z = ends[0] + s
    below = (z + far) * (z - near)
    root = np.sqrt((z + ends[1]) * (z - ends[0]) / below)
    slope = m * root - z * (2.0 * m * z + near * far - ends[0] * ends[1]) / (below * (1.0 + root))
    way = (weight * 2.0 * u / (1.0 - u**2) ** 2)[:, None]
    return 0.5 * ends[0] ** 2 + np.sum(way * (slope - 0.5 / (s + 1.0)), axis=0) - 0.25 - 0.5 * np.log(2.0)


# ------------------------------------------------------------------------------------------ the one edge for both


class NarrowSpall(NamedTuple):
    """A spall so narrow that both edges may be in reach: its width [mm], shape (…); the roller's crown over it at the
    places `ALONG` it [mm], shape (places, …); what rows make of each other, `narrow_shift.by_level`, shape (4, …),
    None: nothing."""

    width: jax.Array
    crown: jax.Array
    shift: Any = None


def equivalent_edge(edge: Any, across: NarrowSpall, approach: Any, low: Any, high: Any, level: Any) -> Any:
    """Where it stands [mm], as `Ramp.edge`, at an approach [mm] and its `edge_ramp.level` on a ramp from `low` to
    `high` [mm], all of one shape. Where no roller of all reaches the far land it is the near one, at once: narrow
    spalls are rare, and cost ten times as much as all else."""
    return (_traced if xp.module_of(approach) is jnp else _if_reached)(edge, across, approach, low, high, level)


def _if_reached(edge: Any, across: NarrowSpall, approach: Any, low: Any, high: Any, level: Any) -> Any:
    near, plain, delta, begin, end = xp.fixed((edge, across, approach, low, high))
    size, _ = _rows(plain, delta, begin)
    off = (plain.width > FAR * end) & (near >= end)  # of all land
    own = _half_widths(near, size, plain.width, begin, end)
    reached = reaches_far_land(near[None], plain.width[None], own) & ~off[None]

    def found(edge: Any) -> Any:
        # what does not depend on the loop's state is computed before it, needed or not
        return _found(*loops.together((edge, across, approach, low, high, level)))

    return loops.done_if(xp.module_of(reached).any(reached), found, edge)


@jax.custom_jvp
def _traced(*arguments: Any) -> Any:
    return _if_reached(*arguments)


@_traced.defjvp
def _traced_jvp(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
    return jax.jvp(_found, primals, tangents)  # a loop that may end at once has no reverse derivatives


def _rows(across: NarrowSpall, approach: Any, low: Any) -> tuple[Any, Any]:
    """Of every row: half the contact's width without a spall [mm], and its weight; shape (rows, …)."""
    left = xp.maximum(1.0 - across.crown / xp.maximum(approach, 1e-9)[None], SHUT)
    weight = np.asarray(WEIGHTS).reshape(-1, *[1] * (left.ndim - 1)) * left ** (ROW - 1.0)
    return -low[None] * left ** (0.5 * ROW), weight


def _half_widths(edge: Any, size: Any, width: Any, low: Any, high: Any) -> Any:
    """Of the contact in every row [mm], with the share of load that an edge leaves."""
    share = xp.with_rates(edge_share.root_of_usual, edge_share.place(edge, low, high))
    return xp.maximum(size * share[None], width[None] / WIDEST)


def _found(edge: Any, across: NarrowSpall, approach: Any, low: Any, high: Any, level: Any) -> Any:
    found = _in_rounds(edge, across, approach, low, high)
    if across.shift is None:
        return found
    return narrow_shift.in_space(edge, found, across.width, low, high, level, across.shift)


def _in_rounds(edge: Any, across: NarrowSpall, approach: Any, low: Any, high: Any) -> Any:
    size, weight = _rows(across, approach, low)
    width = across.width

    def nearer(found: Any) -> Any:
        own = _half_widths(found, size, width, low, high)
        sunk = xp.leading_total(weight * sinking(edge[None], width[None], own))
        met = sunk > 1e-9
        goal = width * xp.sqrt(xp.where(met, sunk, 1.0))
        found = xp.maximum(found, -xp.largest(own) * (1.0 - 1e-6))
        square = xp.where(met, xp.leading_total(weight * over_one(found[None], own)), 1.0)
        root = xp.sqrt(square)
        slopes = over_one_slope(xp.fixed(found)[None], xp.fixed(own))
        rate = xp.where(met, xp.leading_total(xp.fixed(weight) * slopes), 1.0)
        return xp.where(met, found - (root - goal) * (2.0 * xp.fixed(root) / rate), edge)

    def accelerated(state: tuple[Any, Any, Any, Any]) -> tuple[Any, Any, Any, Any]:
        # by a secant, through which derivatives go on
        found, before, then, slope = state
        after = nearer(found)
        at, now = xp.fixed((found, after))
        far = xp.module_of(at).abs(at - before) > 1e-9 * xp.fixed(width)
        slope = xp.where(far, xp.within((now - then) / xp.where(far, at - before, 1.0), -2.0, 0.9), slope)
        return found + (after - found) * (1.0 / (1.0 - slope)), at, now, slope

    start = xp.fixed(edge)
    found = loops.repeated(ROUNDS, accelerated, (edge, start, start, xp.zeros_like(start)))[0]
    # a spall without width leaves the roller where it is: at the ramp's beginning
    widest = xp.largest(size)
    beside = edge <= -widest
    stretch = (edge - low) / xp.where(beside, 1.0, edge + widest)
    return xp.where(beside, edge, edge + (found - edge) * stretch)
