"""The logarithmic crown of a roller: its height along the roller, its slope, and how far a height reaches.

With t = 2y/length it is c·ln(1/(1−t²)), c = Q_d/(πE'·length) [mm]: the profile under which a line contact at the load
Q_d has the same pressure all along (Liu et al. 2018, eq. 2). It is infinite at the roller's ends. Lengths in mm.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Real


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


def slope(y: Real, contact: LineContact) -> Real:
    """The derivative of `height` by `y`, between the roller's ends."""
    t = 2.0 * y / contact.length
    return scale(contact) * 4.0 * t / ((1.0 - t * t) * contact.length)


def half_length(steepness: Any, contact: LineContact) -> Any:
    """How far from the roller's middle the crown is `steepness` times its scale high [mm]: the inverse of `height`."""
    return 0.5 * contact.length * xp.sqrt(-xp.expm1(-steepness))


def mean_of_rows(lines: Real, contact: LineContact) -> Any:
    """Mean height between neighbouring `lines` [mm], shape (rows,); finite at the roller's ends, too."""
    t = xp.clip(2.0 * lines / contact.length, -1.0, 1.0)
    inside = xp.diff(t)
    return scale(contact) * xp.diff(_integral(t)) / xp.where(inside > 0.0, inside, 1.0)


def _integral(t: Real) -> Any:
    """∫₀ᵗ ln(1/(1−s²)) ds."""
    return xlogx(1.0 - t) - xlogx(1.0 + t) + 2.0 * t


def xlogx(v: Real) -> Any:
    """v ln v, 0 at 0."""
    return v * xp.log(xp.where(v > 0.0, v, 1.0))
