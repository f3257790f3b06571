"""W: what share of the land's load is left under a rolling edge.

W(t) = W₀(t) (1 + s): W₀ is what any roller has, to about 0.01, and s a polynomial in u = 1 − √(1 − t), 0 where t is,
for land is highest in the middle of its contact, whose length ends as √(1 − t). t is 0 where the edge enters the
contact, and 1 where the roller no longer meets the land.
"""

from __future__ import annotations

from typing import Any

from difftrb.core import arrays as xp
from difftrb.core import series

USUAL = 0.07, 0.23
"""Of W₀: measured at many rollers."""


def place(edge: Any, low: Any, high: Any) -> Any:
    """t in 0…1."""
    return xp.within((edge - low) / (high - low), 0.0, 1.0)


def left(t: Any, coefficients: Any) -> Any:
    """W for the coefficients of s, shape (TERMS, …), in powers of 2u − 1."""
    u = beyond(t)
    return usual(t) * (1.0 + u * series.polynomial(coefficients, 2.0 * u - 1.0))


def usual(t: Any) -> Any:
    """W₀ at t in 0…1, any shape."""
    return xp.with_rates(_usual, t)


def beyond(t: Any) -> Any:
    """u = 1 − √(1 − t)."""
    return xp.with_rates(_beyond, t)


def _rest(t: Any) -> tuple[Any, Any]:
    """1 − t, and whether it is more than nothing."""
    return xp.within(1.0 - t, 1e-12, 1.0), 1.0 - t > 1e-12


def _usual(t: Any) -> tuple[Any, Any, Any]:
    """W₀ and its first two derivatives."""
    rest, some = _rest(t)
    square, turn = t * t, USUAL[1] * xp.where(some, 1.0 / rest, 0.0)
    slow = USUAL[0] - USUAL[1] * xp.log(rest)  # the contact left on the land is a narrow line
    below = 1.0 / (1.0 + square * slow)
    value = (1.0 - square) * below
    rate = 2.0 * t * slow + square * turn
    bend = 2.0 * slow + 4.0 * t * turn + square * turn * turn * (1.0 / USUAL[1])
    slope = -(2.0 * t + value * rate) * below
    return value, slope, -(2.0 + 2.0 * slope * rate + value * bend) * below


def root_of_usual(t: Any) -> tuple[Any, Any, Any]:
    """√W₀ and its first two derivatives."""
    value, rate, bend = _usual(t)
    some = value > 1e-6
    root = xp.sqrt(xp.where(some, value, 1e-6))
    slope = xp.where(some, 0.5 * rate / root, 0.0)
    return root, slope, xp.where(some, (0.5 * bend - slope * slope) / root, 0.0)


def _beyond(t: Any) -> tuple[Any, Any, Any]:
    """u and its first two derivatives."""
    rest, some = _rest(t)
    root = xp.sqrt(rest)
    return 1.0 - root, xp.where(some, 0.5 / root, 0.0), xp.where(some, 0.25 / (root * rest), 0.0)
