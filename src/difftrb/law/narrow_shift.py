"""What rows along a narrow spall make of each other: how far from plane strain's the one edge for both its edges is.

`narrow_spall` finds it in plane strain, every row of the contact by itself. In truth rows lean on each other, and on
what lies beyond the spall's ends. Plane strain has the one edge at the shares s₁ and s₂ of the ways from the ramp's
beginning to the near and to the far edge; in space it has gone (1 − s₁⁶)(1 − s₂⁶) c times as much farther. Where the
spall has no width it is at the ramp's beginning, where the far land is out of reach s₁ is 1: there nothing changes. To
both sides of the spall's middle it is the same, and flat, as sinking is: with lower powers loads are no less exact, but
how they go with the angle is not. c is a cubic of log λ, the spall's length variable and the load's level, fitted to
contact solves and kept in the atlas.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import series

DEGREE = 3
EXPONENTS = np.array([e for e in itertools.product(range(DEGREE + 1), repeat=3) if sum(e) <= DEGREE])
"""Of the cubic's terms: powers of λ's, the length's and the level's number, shape (20, 3)."""
FARTHEST = 1.0 / 6.0
"""Bound of |c|: the edge stays between the ramp's beginning and the near edge."""


def by_level(shift: np.ndarray, number: Any, length: Any) -> Any:
    """Coefficients of c in powers of `edge_ramp.level`, shape (4,), where log λ and the length's variable
    (`atlas_place`), both brought to −1…1, are these; `shift` by powers of all three, shape (4, 4, 4)."""
    by_length = series.polynomial(shift, xp.asarray(number)[None, None])
    return series.polynomial(by_length, xp.asarray(length)[None])


def terms(number: Any, length: Any, level: Any) -> Any:
    """Those of the cubic, as in `by_level`, by which least squares find it; shape (20, …), of arrays."""
    powers = [x ** n.reshape(-1, *[1] * np.ndim(x)) for x, n in zip((number, length, level), EXPONENTS.T, strict=True)]
    return math.prod(powers)


def moved(near: Any, found: Any, width: Any, low: Any, high: Any, by: Any) -> Any:
    """Where the edge for both stands [mm] if c is `by`, of the near edge, the one that plane strain finds, the spall's
    width, and the ramp's beginning and end [mm]."""
    least = -1e-9 * low
    way, far = found - low, xp.maximum(width - near - low, least)
    short = xp.within(way / xp.maximum(xp.minimum(near, high) - low, least), 0.0, 1.0)
    return found + way * _rest(short) * _rest(way / far) * by


def _rest(share: Any) -> Any:
    """1 − s⁶."""
    cube = share * share * share
    return 1.0 - cube * cube


def in_space(near: Any, found: Any, width: Any, low: Any, high: Any, level: Any, shift: Any) -> Any:
    """The same with c of `by_level`, shape (4, …)."""
    return moved(near, found, width, low, high, xp.within(series.polynomial(shift, level), -FARTHEST, FARTHEST))
