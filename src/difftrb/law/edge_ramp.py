"""A spall's rolling edge under a roller: what share of the land's load is left.

At an approach δ the roller carries Q = Qₛ + (Qₕ − Qₛ) W(t): what it would over the middle of the spall, and of what the
land would carry beyond that the share W. t runs from 0, where the edge enters the contact, to 1, where the roller no
longer meets the land. W is written (1 − t²)/(1 + t² y), in which y hardly changes with load and length and is smooth
but at its ends. At t = 1 the contact left on the land is a narrow line, for which y has a logarithm, and a short one,
for land is highest in the line's middle: its length ends as √(1 − t), for which y has one over that. At t = 0 the edge
enters the middle of the contact first, for the same reason. A small polynomial and these three hold y.
Beyond 0 and 1 the roller is healthy or over the middle of the spall, exactly.

Where both edges of a spall narrower than the contact act, W is that of the one edge over which the roller would sink as
far by plane strain (`narrow_spall`), in the mean over rows along the spall; the crown loads those near its ends less.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import implicit
from difftrb.core.geometry import Real
from difftrb.core.numeric import chebyshev
from difftrb.law import load_curve, narrow_spall
from difftrb.law.load_curve import Curve

DEGREE = 2
"""Of the polynomial in t in y, beside the terms for its ends."""
BEND = 1e-3
"""1 − t at which the term for a short line stops growing."""
ENTRY = 0.1
"""t within which the edge has entered all of the contact."""
TERMS = DEGREE + 4
GUESS = np.array([0.07] + [0.0] * DEGREE + [0.23, 0.0, 0.0])
"""y of any roller to about 0.2 % of Qₕ: enough to choose the loads at which contacts are solved."""
LEAST = 16.0
"""Largest by smallest healthy load between which y changes; below it is constant, for such rollers matter little.
Parametrised by the healthy load: over long spalls the roller's own load falls to a tenth and no longer identifies the
state."""
SHARES = 5
"""Rounds in which the one edge is found that stands for a narrow spall's two."""
ALONG, WEIGHTS = np.polynomial.legendre.leggauss(6)
"""Rows along a narrow spall, in halves of its length from its middle, and what they count."""
ROW = 1.3
"""A row's line load goes with this power of the approach less the crown, as a crowned roller's load does."""
SHUT = 1e-3
"""Least of that, in shares of the approach."""


class NarrowSpall(NamedTuple):
    """A spall so narrow that both edges may be in reach: its width [mm], shape (…); the roller's crown over it at the
    places `along` it [mm], shape (ROWS, …)."""

    width: jax.Array
    crown: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Ramp:
    """One rolling edge or, with the same shape behind every field but `loads` and `radius`, many.

    Attributes:
      edge: how far beyond the roller's middle it stands, positive over the spall [mm].
      healthy, full: the curves of a healthy roller and of one over the spall's middle.
      half_width: of the healthy contact, coefficients of its logarithm [log mm], shape (n, …).
      sunk: how deep the spall's ends, pressed down, take the land at the ramp's end with them by the load that they
        carry, coefficients of its logarithm [log mm/N], shape (m, …). Both in powers of log Q, brought to −1…1.
      loads: middle and reach of that log Q [log N], shape (2,).
      radius: of the contact [mm].
      share: y's coefficients: Chebyshev polynomials of log Qₕ by terms of t; shape (k, TERMS, …).
      narrow: of a spall whose other edge may be in reach, too; None: it is not.
    """

    edge: jax.Array
    healthy: Curve
    full: Curve
    half_width: jax.Array
    sunk: jax.Array
    loads: jax.Array
    radius: Real
    share: jax.Array
    narrow: NarrowSpall | None = None


class RollerCurves(NamedTuple):
    """Q(δ) of every roller of a ring.

    Attributes:
      each: the curve of every roller that is on no ramp, shape (rollers,).
      ramps: stacked along a first axis of every field; None: there is none.
      at: which roller stands on which ramp: ones in zeros, shape (ramps, rollers).
    """

    each: Curve
    ramps: Ramp | None = None
    at: jax.Array | None = None


def roller_loads(curves: RollerCurves, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Load [N] and its slope [N/mm] of every roller at its approach [mm], all of shape (rollers,)."""
    loads, slopes = load_curve.load(curves.each, approach)
    if curves.ramps is None or curves.at is None:
        return loads, slopes
    # products of matrices, for what one of them takes is computed once and not for every roller
    product = partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST)
    # one after the other: then a batch is what a ramp's programs run along, not two edges
    there = jax.lax.map(lambda ramp_at: load(*ramp_at), (curves.ramps, product(curves.at, approach)))
    elsewhere = 1.0 - jnp.sum(curves.at, axis=0)
    loads, slopes = (a * elsewhere + product(b, curves.at) for a, b in zip((loads, slopes), there, strict=True))
    return loads, slopes


def load(ramp: Ramp, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Q [N] and dQ/dδ [N/mm] at `approach` δ [mm], in the shape of the ramps."""
    return jax.jvp(lambda delta: _load(ramp, delta), (approach,), (jnp.ones_like(approach),))


def _load(ramp: Ramp, approach: jax.Array) -> jax.Array:
    healthy, full, low, high = between(ramp, approach)
    t = place(ramp.edge if ramp.narrow is None else _worth(ramp, ramp.narrow, approach, low, high), low, high)
    levels = chebyshev(level(ramp, healthy), ramp.share.shape[0] - 1)
    return full + (healthy - full) * _left(t, [_combined(ramp.share[:, k], levels) for k in range(TERMS)])


def _worth(ramp: Ramp, across: NarrowSpall, approach: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """The one edge over which the roller would sink as far, in the mean along the spall, as over both."""
    left = jnp.maximum(1.0 - across.crown / jnp.maximum(approach, 1e-9)[None], SHUT)
    weight = jnp.asarray(WEIGHTS).reshape(-1, *[1] * (left.ndim - 1)) * left ** (ROW - 1.0)
    size = -low[None] * left ** (0.5 * ROW)  # of every row's contact without a spall, half its width

    def nearer(_: int, edge: jax.Array) -> jax.Array:
        # the share left decides how wide the contact is, and the edge the share
        share = _left(place(edge, low, high), list(GUESS))
        own = size * jnp.sqrt(jnp.maximum(share, 1e-6))[None]
        own = jnp.maximum(own, across.width[None] / narrow_spall.WIDEST)
        sunk = jnp.sum(weight * narrow_spall.sinking(ramp.edge[None], across.width[None], own), axis=0)
        met = sunk > 1e-9
        goal = across.width * jnp.sqrt(jnp.where(met, sunk, 1.0))
        least = -jnp.max(own, axis=0) * (1.0 - 1e-6)
        for _ in range(2):
            square = jnp.where(met, jnp.sum(weight * narrow_spall.over_one(edge[None], own), axis=0), 1.0)
            rate = jnp.where(met, jnp.sum(weight * narrow_spall.over_one_slope(edge[None], own), axis=0), 1.0)
            root = jnp.sqrt(square)
            edge = jnp.where(met, jnp.maximum(edge - (root - goal) * 2.0 * root / rate, least), ramp.edge)
        return edge

    edge = jax.lax.fori_loop(0, SHARES, nearer, ramp.edge)  # a loop: rounds written out take a minute to compile
    # a spall without width leaves the roller where it is: at the ramp's beginning
    widest = jnp.max(size, axis=0)
    beside = ramp.edge <= -widest
    stretch = (ramp.edge - low) / jnp.where(beside, 1.0, ramp.edge + widest)
    return jnp.where(beside, ramp.edge, ramp.edge + (edge - ramp.edge) * stretch)


def _left(t: jax.Array, coefficients: Sequence[jax.Array]) -> jax.Array:
    """W for the coefficients of y."""
    return (1.0 - t * t) / load_curve.within(1.0 + t * t * implicit.pointwise(_y, None, coefficients, t), 0.1, jnp.inf)


def _y(coefficients: Sequence[jax.Array], t: jax.Array) -> jax.Array:
    return _combined(coefficients, terms(t))


def _combined(coefficients: Sequence[jax.Array] | jax.Array, parts: list[jax.Array]) -> jax.Array:
    total = coefficients[0] * parts[0]
    for k in range(1, len(parts)):
        total = total + coefficients[k] * parts[k]
    return total


def guessed(healthy: jax.Array, full: jax.Array, t: jax.Array) -> jax.Array:
    """About the load [N], before any solve at the edge."""
    return full + (healthy - full) * _left(t, list(GUESS))


def between(ramp: Ramp, approach: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    healthy, _ = load_curve.load(ramp.healthy, approach)
    full, _ = load_curve.load(ramp.full, approach)
    half_width = jnp.exp(load_curve.straight(ramp.half_width, _of_load(ramp, healthy))[0])
    free = approach - full * jnp.exp(load_curve.straight(ramp.sunk, _of_load(ramp, full))[0])
    above = free > 0.0
    return healthy, full, -half_width, jnp.where(above, jnp.sqrt(2.0 * ramp.radius * jnp.where(above, free, 1.0)), 0.0)


def extent(ramp: Ramp, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where a ramp begins and ends [mm], as `Ramp.edge`."""
    return between(ramp, approach)[2:]


def place(edge: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """t in 0…1."""
    return load_curve.within((edge - low) / (high - low), 0.0, 1.0)


def _of_load(ramp: Ramp, load: jax.Array) -> jax.Array:
    least = jnp.exp(ramp.loads[0] - ramp.loads[1])
    return (jnp.log(load_curve.within(load, least, jnp.inf)) - ramp.loads[0]) / ramp.loads[1]


def level(ramp: Ramp, healthy: jax.Array) -> jax.Array:
    """log Qₕ, brought to −1…1."""
    top = jnp.exp(jnp.sum(ramp.loads))
    return 1.0 + 2.0 * jnp.log(load_curve.within(healthy, top / LEAST, top) / top) / np.log(LEAST)


def terms(t: jax.Array) -> list[jax.Array]:
    """What y is made of: Chebyshev polynomials, a narrow line, a short one, and the edge's entry."""
    left = 1.0 - t
    narrow, short = -jnp.log(load_curve.within(left, 1e-12, 1.0)), jax.lax.rsqrt(left + BEND)
    return [*chebyshev(2.0 * t - 1.0, DEGREE), narrow, short, 1.0 / (1.0 + (t / ENTRY) ** 2)]


def guess(degree: int = 0) -> jax.Array:
    """`Ramp.share` of any roller."""
    return jnp.zeros((degree + 1, TERMS)).at[0].set(GUESS)
