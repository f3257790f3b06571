"""A spall's rolling edge under a roller: what share of the land's load is left.

At an approach δ the roller carries Q = Qₛ + (Qₕ − Qₛ) W(t): what it would over the middle of the spall, and of what the
land would carry beyond that the share W (`edge_share`). t runs from 0, where the edge enters the contact, to 1, where
the roller no longer meets the land. Beyond 0 and 1 the roller is healthy or over the middle of the spall, exactly. Of a
spall narrower than the contact both edges act as one, that of `narrow_spall`.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from difftrb.contact.gap import certain_reach
from difftrb.core import arrays as xp
from difftrb.core import series
from difftrb.core.geometry import Real
from difftrb.law import edge_share, load_curve, narrow_spall
from difftrb.law.load_curve import Curve
from difftrb.law.narrow_spall import NarrowSpall

TERMS = 9
"""Of s: u = 1 − √(1 − t) times a polynomial in 2u − 1."""
LOAD_SPAN = 300.0
"""Largest by smallest healthy load between which s changes; below it is constant, for such rollers matter little.
Parametrised by the healthy load: over long spalls the roller's own load falls to a tenth and no longer identifies the
state."""
NARROWED = 1e-2
"""Least share of the approach that counts where the crown has risen."""


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


def carried(ramp: Ramp, approach: Any) -> Any:
    """Q [N] at `approach` δ [mm], in the shape of the ramps."""
    healthy, full, low, high = between(ramp, approach)
    edge, at_level = ramp.edge, level(ramp, healthy)
    if ramp.narrow is not None:
        edge = narrow_spall.equivalent_edge(edge, ramp.narrow, approach, low, high, at_level)
    t = edge_share.place(edge, low, high)
    return full + (healthy - full) * edge_share.left(t, series.polynomial(ramp.share, at_level[None]))


def between(ramp: Ramp, approach: Any) -> tuple[Any, Any, Any, Any]:
    """Loads of a healthy roller and of one over the spall's middle [N], and where the ramp begins and ends [mm], as
    `Ramp.edge`; all at this approach [mm]."""
    healthy, full = load_curve.carried(ramp.healthy, approach), load_curve.carried(ramp.full, approach)
    half_width = half_width_at(ramp, healthy)
    # where the crown rises, the contact is narrower
    pressed = xp.where(approach > 0.0, approach, 1.0)
    half_width = half_width * xp.sqrt(xp.within(1.0 - ramp.rise / pressed, NARROWED, 1.0))
    free = approach - ramp.rise - full * xp.exp(series.polynomial(ramp.sunk, _of_load(ramp, full), straight=True))
    above = free > 0.0
    return healthy, full, -half_width, xp.where(above, certain_reach(ramp.radius, xp.where(above, free, 1.0)), 0.0)


def half_width_at(of: Any, healthy: Any) -> Any:
    """Of a healthy contact [mm] at its load [N], by a `Ramp` or whatever else has its `half_width` and `loads`."""
    return xp.exp(series.polynomial(of.half_width, _of_load(of, healthy), straight=True))


def extent(ramp: Ramp, approach: Any) -> tuple[Any, Any]:
    """Where a ramp begins and ends [mm], as `Ramp.edge`."""
    return between(ramp, approach)[2:]


def spread(ramp: Any, axes: int) -> Any:
    """The ramp, or a part of one, with so many axes behind all others, to go with as many approaches."""
    return xp.tree_map(lambda leaf: xp.asarray(leaf)[(..., *[None] * axes)], ramp)


def _of_load(ramp: Any, load: Any) -> Any:
    least = xp.exp(ramp.loads[0] - ramp.loads[1])
    return (xp.log(xp.where(load >= least, load, least)) - ramp.loads[0]) / ramp.loads[1]


def level(ramp: Ramp, healthy: Any) -> Any:
    """log Qₕ, brought to −1…1."""
    top = xp.exp(ramp.loads[0] + ramp.loads[1])
    return 1.0 + 2.0 * xp.log(xp.within(healthy, top / LOAD_SPAN, top) / top) / np.log(LOAD_SPAN)


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
