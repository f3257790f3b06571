"""The pressure of a contact solved by strips, point by point: to look at, where cells would show notches.

Along the roller the rows' profiles go over into one another: the boundaries between two rows, too, lie between theirs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import strip_model
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.strip_model import Strips, Way

ACROSS = np.sin(0.5 * np.pi * np.linspace(-1.0, 1.0, 81)) * 0.9999
"""Points of a row, by half its width from its middle; denser at its ends."""
ALONG = 4
"""Points between two rows."""


class Patch(NamedTuple):
    """A part of the contact: positions along the roller [mm], shape (points,); in the rolling direction [mm], and
    pressure [N/mm²], shape (points, across)."""

    y: np.ndarray
    x: np.ndarray
    pressure: np.ndarray


def patches(found: Strips, inputs: Inputs, way: Way) -> tuple[Patch, ...]:
    """The contact's parts: beyond the spall's ends along the roller, and beside it. Of numbers."""
    plan, groups, on, loads, ends = strip_model.outlined(found, inputs, way)
    unit, density = float(found.reach.unit), float(found.reach.line_load / found.reach.unit)
    made, first = [], 0
    for group in groups:
        rows = range(first, first + group.count)
        first += group.count
        y = group.hats(group.lines[1:-1], group.lines[0], group.lines[-1])
        low, high, pressure = map(np.stack, zip(*(_profile(plan, on, loads, ends, row) for row in rows), strict=True))
        middle, square = 0.5 * (low + high), 0.25 * (high - low) ** 2
        for at, end in ((0, group.lines[0]), (len(y), group.lines[-1])):
            if not np.isclose(y[min(at, len(y) - 1)], end):  # where contact ends
                near = min(at, len(y) - 1)
                y, middle, square = np.insert(y, at, end), np.insert(middle, at, middle[near]), np.insert(square, at, 0)
                pressure = np.insert(pressure, at, 0.0, axis=0)
        fine = np.interp(np.arange((len(y) - 1) * ALONG + 1) / ALONG, np.arange(len(y)), y)
        half = np.sqrt(np.interp(fine, y, square))[:, None]
        x = np.interp(fine, y, middle)[:, None] + half * ACROSS
        p = np.stack([np.interp(fine, y, column) for column in pressure.T], axis=1)
        if way.mirrored and group.middle:  # symmetric about the roller's middle
            fine, x, p = (
                np.concatenate([part[:0:-1] * sign, part]) for part, sign in ((fine, -1.0), (x, 1.0), (p, 1.0))
            )
        one = Patch(unit * fine, unit * x, density * p)
        made.append(one)
        if way.mirrored and not group.middle:
            made.append(Patch(-one.y[::-1], one.x[::-1], one.pressure[::-1]))
    return tuple(made)


def _profile(plan: Any, on: Any, loads: Any, ends: Any, row: int) -> tuple[float, float, np.ndarray]:
    """Where the loaded part of a row begins and ends, and its pressure on `ACROSS`, without units."""
    own = np.flatnonzero((plan.rows == row) & on & (ends[:, 1] > ends[:, 0]))
    if not len(own):
        return 0.0, 0.0, np.zeros_like(ACROSS)
    low, high = float(ends[own, 0].min()), float(ends[own, 1].max())
    x = 0.5 * (low + high) + 0.5 * (high - low) * ACROSS
    pressure = np.zeros_like(x)
    for strip in own:
        a, b = ends[strip]
        t = (2.0 * x - a - b) / (b - a)
        inside = np.abs(t) < 1.0
        angle = np.arccos(np.where(inside, t, 0.0))
        modes = sum(load * np.cos(m * angle) for load, m in zip(loads[strip], plan.orders, strict=True))
        pressure += np.where(inside, modes * 2.0 / (b - a) / (np.pi * np.sin(angle)), 0.0)  # Tₘ/(π√(1−t²))
    return low, high, np.maximum(pressure, 0.0)
