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
from typing import Any, NamedTuple

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import series
from difftrb.core.geometry import Real
from difftrb.core.taylor import Taylor
from difftrb.law import load_curve, narrow_spall
from difftrb.law.load_curve import Curve

TERMS = 9
"""Of s: u = 1 − √(1 − t) times a polynomial in 2u − 1."""
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
    places `ALONG` it [mm], shape (places, …)."""

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
      share: coefficients of s by u: powers of `level` by powers of 2u − 1; shape (k, TERMS, …).
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
      ramps: along an axis behind every field's own; None: there is none.
      at: which roller stands on which ramp: ones in zeros, shape (ramps, rollers).
    """

    each: Curve
    ramps: Ramp | None = None
    at: jax.Array | None = None


def roller_loads(curves: RollerCurves, approach: Any) -> tuple[Any, Any]:
    """Load [N] and its slope [N/mm] of every roller at its approach [mm], all of shape (rollers,)."""
    loads, slopes = load_curve.load(curves.each, approach)
    if curves.ramps is None or curves.at is None:
        return loads, slopes
    # products of matrices, for what one of them takes is computed once and not for every roller
    there = load(curves.ramps, xp.einsum("e...r,...r->e...", curves.at, approach))
    elsewhere = 1.0 - curves.at.sum(axis=0)
    loads, slopes = (
        a * elsewhere + xp.einsum("e...,e...r->...r", b, curves.at) for a, b in zip((loads, slopes), there, strict=True)
    )
    return loads, slopes


def expanded_loads(curves: RollerCurves, approach: Any) -> Taylor:
    """Load of every roller [N] as an expansion by parameters and, last, by its approach: `approach` [mm] holds how it
    changes with the parameters alone."""
    variable, curves = xp.variable(approach, mixed=True), xp.beside_variable(curves)
    loads = load_curve.carried(curves.each, variable)
    if curves.ramps is None or curves.at is None:
        return loads
    there = carried(curves.ramps, xp.einsum("e...r,...r->e...", curves.at, variable))
    return loads * (1.0 - curves.at.sum(axis=0)) + xp.einsum("e...,e...r->...r", there, curves.at)


def load(ramp: Ramp, approach: Any) -> tuple[Any, Any]:
    """Q [N] and dQ/dδ [N/mm] at `approach` δ [mm], in the shape of the ramps."""
    found = carried(ramp, xp.variable(approach))
    return found.value, found.by[0]


def carried(ramp: Ramp, approach: Any) -> Any:
    """Q [N] at `approach` δ [mm], in the shape of the ramps."""
    healthy, full, low, high = between(ramp, approach)
    t = place(ramp.edge if ramp.narrow is None else _worth(ramp, ramp.narrow, approach, low, high), low, high)
    return full + (healthy - full) * left(t, shares_at(ramp.share, level(ramp, healthy)))


def shares_at(share: Any, level: Any) -> Any:
    """Coefficients of s by u in powers of 2u − 1 at a level, shape (TERMS, …)."""
    return series.polynomial(share, level[None])


def _worth(ramp: Ramp, across: NarrowSpall, approach: Any, low: Any, high: Any) -> Any:
    """The one edge over which the roller would sink as far, in the mean along the spall, as over both."""
    left = xp.maximum(1.0 - across.crown / xp.maximum(approach, 1e-9)[None], SHUT)
    weight = np.asarray(WEIGHTS).reshape(-1, *[1] * (left.ndim - 1)) * left ** (ROW - 1.0)
    size = -low[None] * left ** (0.5 * ROW)  # of every row's contact without a spall, half its width

    def nearer(edge: Any) -> Any:
        # the share left decides how wide the contact is, and the edge the share
        share = xp.univariate(lambda t: xp.sqrt(xp.maximum(usual(t), 1e-6)), place(edge, low, high))
        own = size * share[None]
        own = xp.maximum(own, across.width[None] / narrow_spall.WIDEST)
        sunk = xp.leading_total(weight * narrow_spall.sinking(ramp.edge[None], across.width[None], own))
        met = sunk > 1e-9
        goal = across.width * xp.sqrt(xp.where(met, sunk, 1.0))
        least = -xp.largest(own) * (1.0 - 1e-6)

        def closer(edge: Any) -> Any:
            square = xp.where(met, xp.leading_total(weight * narrow_spall.over_one(edge[None], own)), 1.0)
            rate = xp.where(met, xp.leading_total(weight * narrow_spall.over_one_slope(edge[None], own)), 1.0)
            root = xp.sqrt(square)
            return xp.where(met, xp.maximum(edge - (root - goal) * 2.0 * root / rate, least), ramp.edge)

        return xp.repeated(2, closer, edge)

    edge = xp.repeated(SHARES, nearer, ramp.edge)  # a loop: rounds written out take a minute to compile
    # a spall without width leaves the roller where it is: at the ramp's beginning
    widest = xp.largest(size)
    beside = ramp.edge <= -widest
    stretch = (ramp.edge - low) / xp.where(beside, 1.0, ramp.edge + widest)
    return xp.where(beside, ramp.edge, ramp.edge + (edge - ramp.edge) * stretch)


def left(t: Any, coefficients: Any) -> Any:
    """W for the coefficients of s, shape (TERMS, …), in powers of 2u − 1."""
    u = xp.univariate(beyond, t)
    return xp.univariate(usual, t) * (1.0 + u * series.polynomial(coefficients, 2.0 * u - 1.0))


def usual(t: Any) -> Any:
    """W₀ at t in 0…1, any shape."""
    narrow = -xp.log(xp.within(1.0 - t, 1e-12, 1.0))  # the contact left on the land is a narrow line
    return (1.0 - t * t) / (1.0 + t * t * (USUAL[0] + USUAL[1] * narrow))


def beyond(t: Any) -> Any:
    """u = 1 − √(1 − t)."""
    return 1.0 - xp.sqrt(xp.within(1.0 - t, 1e-12, 1.0))


def guessed(healthy: Any, full: Any, t: Any) -> Any:
    """About the load [N], before any solve at the edge."""
    return full + (healthy - full) * usual(t)


def between(ramp: Ramp, approach: Any) -> tuple[Any, Any, Any, Any]:
    """Loads of a healthy roller and of one over the spall's middle [N], and where the ramp begins and ends [mm], as
    `Ramp.edge`; all at this approach [mm]."""
    healthy, full = load_curve.carried(ramp.healthy, approach), load_curve.carried(ramp.full, approach)
    half_width = xp.exp(series.polynomial(ramp.half_width, _of_load(ramp, healthy), straight=True))
    # where the crown rises, the contact is narrower
    pressed = xp.where(approach > 0.0, approach, 1.0)
    half_width = half_width * xp.sqrt(xp.within(1.0 - ramp.rise / pressed, NARROWED, 1.0))
    free = approach - ramp.rise - full * xp.exp(series.polynomial(ramp.sunk, _of_load(ramp, full), straight=True))
    above = free > 0.0
    return healthy, full, -half_width, xp.where(above, xp.sqrt(2.0 * ramp.radius * xp.where(above, free, 1.0)), 0.0)


def extent(ramp: Ramp, approach: Any) -> tuple[Any, Any]:
    """Where a ramp begins and ends [mm], as `Ramp.edge`."""
    return between(ramp, approach)[2:]


def spread(ramp: Ramp, axes: int) -> Ramp:
    """The ramp with so many axes behind all others, to go with as many approaches."""
    return xp.tree_map(lambda leaf: xp.asarray(leaf)[(..., *[None] * axes)], ramp)


def place(edge: Any, low: Any, high: Any) -> Any:
    """t in 0…1."""
    return xp.within((edge - low) / (high - low), 0.0, 1.0)


def _of_load(ramp: Ramp, load: Any) -> Any:
    least = xp.exp(ramp.loads[0] - ramp.loads[1])
    return (xp.log(xp.within(load, least, np.inf)) - ramp.loads[0]) / ramp.loads[1]


def level(ramp: Ramp, healthy: Any) -> Any:
    """log Qₕ, brought to −1…1."""
    top = xp.exp(ramp.loads[0] + ramp.loads[1])
    return 1.0 + 2.0 * xp.log(xp.within(healthy, top / LEAST, top) / top) / np.log(LEAST)


def in_powers(share: Any) -> Any:
    """`Ramp.share` of coefficients of Chebyshev polynomials, levels by terms behind all other axes; these in front."""
    levels, terms = (_powers(count) for count in share.shape[-2:])
    return xp.einsum("...lt,lmtn->mn...", share, np.einsum("lm,tn->lmtn", levels, terms))


def _powers(count: int) -> np.ndarray:
    """What every Chebyshev polynomial has of every power, shape (count, count)."""
    return np.array([np.pad(np.polynomial.chebyshev.cheb2poly(row), (0, count))[:count] for row in np.eye(count)])


def guess() -> np.ndarray:
    """`Ramp.share` of any roller."""
    return np.zeros((1, TERMS))
