"""A spall so narrow that both its edges are in reach: the one edge that stands for both.

It is the edge over which the roller would sink as far by plane strain (`narrow_spall`), in the mean over rows along the
spall; the crown loads those near its ends less. How wide the contact is goes with the share of load that is left, and
that with the edge, so that it is found in rounds.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import loops
from difftrb.core.numeric import gauss_legendre
from difftrb.law import edge_share, narrow_spall

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


class NarrowSpall(NamedTuple):
    """A spall so narrow that both edges may be in reach: its width [mm], shape (…); the roller's crown over it at the
    places `ALONG` it [mm], shape (places, …)."""

    width: jax.Array
    crown: jax.Array


def of_both(edge: Any, across: NarrowSpall, approach: Any, low: Any, high: Any) -> Any:
    """Where that edge stands [mm], as `Ramp.edge`, for an approach [mm] of a ramp that begins at `low` and ends at
    `high` [mm], all of one shape. Where no roller of all reaches the far land it is the near one, at once: narrow
    spalls are rare, and cost ten times as much as all else."""
    return (_traced if xp.module_of(approach) is jnp else _if_reached)(edge, across, approach, low, high)


def _if_reached(edge: Any, across: NarrowSpall, approach: Any, low: Any, high: Any) -> Any:
    near, plain, delta, begin, end = xp.fixed((edge, across, approach, low, high))
    size, _ = _rows(plain, delta, begin)
    off = (plain.width > FAR * end) & (near >= end)  # of all land
    own = _half_widths(near, size, plain.width, begin, end)
    reached = narrow_spall.reaches_far_land(near[None], plain.width[None], own) & ~off[None]

    def found(edge: Any) -> Any:
        # what does not depend on the loop's state is computed before it, needed or not
        return _equivalent(*loops.together((edge, across, approach, low, high)))

    return loops.done_if(xp.module_of(reached).any(reached), found, edge)


@jax.custom_jvp
def _traced(*arguments: Any) -> Any:
    return _if_reached(*arguments)


@_traced.defjvp
def _traced_jvp(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
    return jax.jvp(_equivalent, primals, tangents)  # a loop that may end at once has no reverse derivatives


def _rows(across: NarrowSpall, approach: Any, low: Any) -> tuple[Any, Any]:
    """Of every row: half the contact's width without a spall [mm], and its weight; shape (rows, …)."""
    left = xp.maximum(1.0 - across.crown / xp.maximum(approach, 1e-9)[None], SHUT)
    weight = np.asarray(WEIGHTS).reshape(-1, *[1] * (left.ndim - 1)) * left ** (ROW - 1.0)
    return -low[None] * left ** (0.5 * ROW), weight


def _half_widths(edge: Any, size: Any, width: Any, low: Any, high: Any) -> Any:
    """Of the contact in every row [mm], with the share of load that an edge leaves."""
    share = xp.with_rates(edge_share.root_of_usual, edge_share.place(edge, low, high))
    return xp.maximum(size * share[None], width[None] / narrow_spall.WIDEST)


def _equivalent(edge: Any, across: NarrowSpall, approach: Any, low: Any, high: Any) -> Any:
    size, weight = _rows(across, approach, low)
    width = across.width

    def nearer(found: Any) -> Any:
        own = _half_widths(found, size, width, low, high)
        sunk = xp.leading_total(weight * narrow_spall.sinking(edge[None], width[None], own))
        met = sunk > 1e-9
        goal = width * xp.sqrt(xp.where(met, sunk, 1.0))
        found = xp.maximum(found, -xp.largest(own) * (1.0 - 1e-6))
        square = xp.where(met, xp.leading_total(weight * narrow_spall.over_one(found[None], own)), 1.0)
        root = xp.sqrt(square)
        slopes = narrow_spall.over_one_slope(xp.fixed(found)[None], xp.fixed(own))
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
