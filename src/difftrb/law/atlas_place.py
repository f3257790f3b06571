"""Where a spall lies along a roller, in the variables in which the atlas is a polynomial."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.geometry import Real
from difftrb.law.base import LENGTH_SHARE

INNER = 0.45
"""Both ends of a spall lie within this share of the roller's length from its middle, or one beyond the roller's end:
of slivers of land between, and of spalls that leave no more than that of the roller's end, the atlas knows nothing."""
LONGEST = LENGTH_SHARE
"""Longest spall inside the roller by the roller's length. The atlas's variables are made of it: it has to be built anew
where this changes."""
AT_END = 0.05, 0.9
"""How much of the roller's length a spall over its end may take."""
USUAL_LOAD = 0.3
"""Load by the design load whose contact's width rounds off the variable for a spall's length."""


class Place(NamedTuple):
    """Where a spall lies along a roller, in the atlas's variables, all of shape ().

    `length` and `aside` are 0…1; `over_end`: whether it laps over the roller's end; `known`: whether the atlas
    holds it.
    """

    length: Any
    aside: Any
    over_end: Any
    known: Any


def shortest(number: Real) -> Any:
    """Width of a usual contact by the roller's length: spalls' lengths are told apart by their roots from there on."""
    return xp.sqrt(16.0 * USUAL_LOAD * number / np.pi)  # twice `gap.line_half_width`


def place_of(length: Real, axial_offset: Real, number: Real) -> Place:
    """The place of a spall whose length and axial offset are by the roller's length."""
    length, offset = xp.asarray(length), xp.asarray(axial_offset)
    aside = xp.magnitude(offset)
    over_end = aside + 0.5 * length >= 0.5 - 1e-9
    least = shortest(number)
    inside = (xp.sqrt(length + least) - xp.sqrt(least)) / (xp.sqrt(LONGEST + least) - xp.sqrt(least))
    share = (offset / xp.maximum(INNER - 0.5 * length, 0.5 * (INNER - 0.5 * LONGEST))) ** 2
    taken = (0.5 - aside + 0.5 * length - AT_END[0]) / (AT_END[1] - AT_END[0])
    tiny = 1e-9
    fits = xp.where(over_end, taken, inside)
    known = (fits >= -tiny) & (fits <= 1.0 + tiny) & (over_end | (share <= 1.0 + tiny))

    def kept(x: Any) -> Any:  # with its derivatives at both ends, too, which rounding may overstep
        return x + xp.fixed(xp.within(x, 0.0, 1.0) - x)

    return Place(kept(fits), kept(xp.where(over_end, 0.0, share)), over_end, known)
