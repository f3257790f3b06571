"""A spall's rolling edge under a roller: what share of the land's load is left.

At an approach δ the roller carries Q = Qₛ + (Qₕ − Qₛ) W(t): what it would over the middle of the spall, and of what the
land would carry beyond that the share W. t runs from 0, where the edge enters the contact, to 1, where the roller no
longer meets the land. W is written W₀(t) (1 + s): W₀ is what any roller has, to about 0.01, and s a polynomial in
1 − √(1 − t), 0 where t is, for land is highest in the middle of its contact, whose length ends as √(1 − t).
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

TERMS = 9
"""Of u = 1 − √(1 − t) in s: u times Chebyshev polynomials."""
USUAL = 0.07, 0.23
"""Of W₀: measured at many rollers."""
LEAST = 300.0
"""Largest by smallest healthy load between which s changes; below it is constant, for such rollers matter little.
Parametrised by the healthy load: over long spalls the roller's own load falls to a tenth and no longer identifies the
state."""
NARROWED = 1e-2
"""Least share of the approach that counts where the crown has risen."""
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
        carry, beyond `rise`, coefficients of its logarithm [log mm/N], shape (m, …). Both in powers of log Q, brought
        to −1…1.
      rise: of the crown where the spall is nearest to the roller's middle [mm].
      loads: middle and reach of that log Q [log N], shape (2,).
      radius: of the contact [mm].
      share: coefficients of s: Chebyshev polynomials of log Qₕ by `terms` of t; shape (k, TERMS, …).
      narrow: of a spall whose other edge may be in reach, too; None: it is not.
    """

    edge: jax.Array
    healthy: Curve
    full: Curve
    half_width: jax.Array
    sunk: jax.Array
    rise: jax.Array
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
    return full + (healthy - full) * left(t, [_combined(ramp.share[:, k], levels) for k in range(TERMS)])


def _worth(ramp: Ramp, across: NarrowSpall, approach: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """The one edge over which the roller would sink as far, in the mean along the spall, as over both."""
    left = jnp.maximum(1.0 - across.crown / jnp.maximum(approach, 1e-9)[None], SHUT)
    weight = jnp.asarray(WEIGHTS).reshape(-1, *[1] * (left.ndim - 1)) * left ** (ROW - 1.0)
    size = -low[None] * left ** (0.5 * ROW)  # of every row's contact without a spall, half its width

    def nearer(_: int, edge: jax.Array) -> jax.Array:
        # the share left decides how wide the contact is, and the edge the share
        share = usual(place(edge, low, high))
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


def left(t: jax.Array, coefficients: Sequence[jax.Array]) -> jax.Array:
    """W for the coefficients of s."""
    return usual(t) * (1.0 + implicit.pointwise(_series, None, coefficients, t))


def usual(t: jax.Array) -> jax.Array:
    """W₀ at t in 0…1, any shape."""
    narrow = -jnp.log(load_curve.within(1.0 - t, 1e-12, 1.0))  # the contact left on the land is a narrow line
    return (1.0 - t * t) / (1.0 + t * t * (USUAL[0] + USUAL[1] * narrow))


def _series(coefficients: Sequence[jax.Array], t: jax.Array) -> jax.Array:
    return _combined(coefficients, terms(t))


def _combined(coefficients: Sequence[jax.Array] | jax.Array, parts: list[jax.Array]) -> jax.Array:
    total = coefficients[0] * parts[0]
    for k in range(1, len(parts)):
        total = total + coefficients[k] * parts[k]
    return total


def guessed(healthy: jax.Array, full: jax.Array, t: jax.Array) -> jax.Array:
    """About the load [N], before any solve at the edge."""
    return full + (healthy - full) * usual(t)


def between(ramp: Ramp, approach: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    healthy, _ = load_curve.load(ramp.healthy, approach)
    full, _ = load_curve.load(ramp.full, approach)
    half_width = jnp.exp(load_curve.straight(ramp.half_width, _of_load(ramp, healthy))[0])
    # where the crown rises, the contact is narrower
    pressed = jnp.where(approach > 0.0, approach, 1.0)
    half_width = half_width * jnp.sqrt(load_curve.within(1.0 - ramp.rise / pressed, NARROWED, 1.0))
    free = approach - ramp.rise - full * jnp.exp(load_curve.straight(ramp.sunk, _of_load(ramp, full))[0])
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
    """The polynomials that s is made of, 0 at t = 0."""
    place = 1.0 - jnp.sqrt(load_curve.within(1.0 - t, 1e-12, 1.0))
    return [place * polynomial for polynomial in chebyshev(2.0 * place - 1.0, TERMS - 1)]


def guess(degree: int = 0) -> jax.Array:
    """`Ramp.share` of any roller."""
    return jnp.zeros((degree + 1, TERMS))
