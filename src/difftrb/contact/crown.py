"""The logarithmic crown of a roller: its height along the roller, its slope, and how far a height reaches, tilted
or not. The shipped atlas (`law/atlas`) is of this crown.

With t = 2y/length it is c·ln(1/(1−t²)), c = Q_d/(πE'·length) [mm]: the profile under which a line contact at the load
Q_d has the same pressure all along (Liu et al. 2018, eq. 2). It is infinite at the roller's ends. Lengths in mm.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Real
from difftrb.core.numeric import bisected


def scale(contact: LineContact) -> Real:
    """c = Q_d/(πE'l) [mm], the length that multiplies the crown's logarithm; 0 is a straight roller."""
    return contact.design_load / (np.pi * contact.modulus * contact.length)


def logarithm(t: Real, room: float) -> Any:
    """ln(1/(1−t²)), the crown in its scale at t = 2y/length; beyond 1−t² = `room` it stays as it is there."""
    return -xp.log1p(-xp.minimum(t * t, 1.0 - room))


def height(y: Real, contact: LineContact) -> Any:
    """The crown at positions `y` [mm] along the roller; infinite at the roller's ends unless straight."""
    t = 2.0 * y / contact.length
    inside = (t < 1.0 - 1e-12) & (t > 1e-12 - 1.0)
    return xp.where(inside, scale(contact) * logarithm(xp.where(inside, t, 0.0), 1e-13), np.inf)


def half_length(steepness: Any, contact: LineContact) -> Any:
    """How far from the roller's middle the crown is `steepness` times its scale high [mm]: the inverse of `height`."""
    return 0.5 * contact.length * xp.sqrt(-xp.expm1(-steepness))


def _flattest(contact: LineContact, tilt: Any) -> tuple[Real, Any, Any]:
    """Crown scale and rise of a tilted roller from its middle to its end [mm], and where its gap is least, as a share
    of that half."""
    half = 0.5 * contact.length
    own, rise = scale(contact), half * tilt
    return own, rise, -rise / (own + xp.sqrt(own * own + rise * rise + 1e-30 * half**2))


def least_rest(contact: LineContact, tilt: Any) -> Any:
    """The least gap of a tilted, crowned roller along its line [mm], at most 0."""
    own, rise, t = _flattest(contact, tilt)
    return rise * t + own * logarithm(t, 1e-15)


def crossing(contact: LineContact, delta: Any, tilt: Any, side: float) -> Any:
    """Where on one `side` the gap of a tilted roller along its line exceeds `delta` [mm]; at most at its end."""
    half = 0.5 * contact.length
    own, rise, flat = _flattest(contact, tilt)
    still, begin = xp.fixed((own, rise, delta)), xp.fixed(flat)

    def beyond(t: Any, own: Any, rise: Any, delta: Any) -> tuple[Any, Any]:
        room = xp.maximum(1.0 - t * t, 1e-15)
        return rise * t - own * xp.log(room) - delta, rise + 2.0 * own * t / room

    found, _ = bisected(lambda t: ~(beyond(t, *still)[0] > 0.0), begin, side + 0.0 * begin)
    value, slope = beyond(found, own, rise, delta)
    free = xp.abs(found) < 1.0 - 1e-9  # else the roller's end is the end
    step = xp.where(free, value / xp.where(free, slope, 1.0), 0.0)
    return half * xp.where(free, found - step, side)  # one step from the solution carries its derivatives


def reached(contact: LineContact, level: Any, tilt: Any | None, side: float) -> Any:
    """Where on one `side` the gap along the roller's line, tilted or not (None), exceeds `level` [mm]; without a crown
    at its end."""
    if tilt is not None:
        return crossing(contact, level, tilt, side)
    own = scale(contact)
    crowned = own > 0.0
    return side * half_length(xp.where(crowned, level / xp.where(crowned, own, 1.0), 100.0), contact)


def mean_of_rows(lines: Real, contact: LineContact) -> Any:
    """Mean height between neighbouring `lines` [mm], shape (rows,); finite at the roller's ends, too."""
    t = xp.clip(2.0 * lines / contact.length, -1.0, 1.0)
    inside = xp.diff(t)
    integral = xlogx(1.0 - t) - xlogx(1.0 + t) + 2.0 * t  # ∫₀ᵗ ln(1/(1−s²)) ds
    return scale(contact) * xp.diff(integral) / xp.where(inside > 0.0, inside, 1.0)


def xlogx(v: Real) -> Any:
    """v ln v, 0 at 0."""
    return v * xp.log(xp.where(v > 0.0, v, 1.0))
