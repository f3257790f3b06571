"""Where the load zone of a ring ends: there a roller takes up load, and stiffness has a kink over the cage's phase.

Rollers that are alike take it up at one place on either side. Of rollers of different diameters each has its own, and
within a pitch none may, or several.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.geometry import TaperedBearing
from difftrb.ring.terms import Terms

SIDES = 2
NEIGHBOURS = np.array([-1, 0, 1])
"""Of rollers that differ: which may take up load within a pitch, beside the one that would if all had the middle
diameter."""
TURN = 2.0 * np.pi
"""After this phase an end of a roller that differs is the same; of those that are alike after a pitch."""


def rows_of(displacement: Any, bearing: TaperedBearing, terms: Terms) -> tuple[Any, ...]:
    """Displacements [mm] of every row of rollers."""
    return (displacement,) if terms.pair is None else terms.pair.rows(displacement, bearing.outer_angle)


def thicker(bearing: TaperedBearing, terms: Terms) -> tuple[Any, ...]:
    """By how much the rollers of every row are too thick [mm], one number or shape (rollers,); None: not at all."""
    rows, more = 1 if terms.pair is None else 2, terms.interference
    if not are_different(terms):
        return (more,) * rows
    return tuple(xp.asarray(more)[bearing.rollers * k : bearing.rollers * (k + 1)] for k in range(rows))


def are_different(terms: Terms) -> bool:
    """Whether rollers differ in diameter."""
    return terms.interference is not None and np.size(xp.value(terms.interference)) > 1


def count(terms: Terms) -> int:
    """How many ends of one row are looked for: on either side one, or those of `NEIGHBOURS`."""
    return SIDES * len(NEIGHBOURS) if are_different(terms) else SIDES


class Nearest(NamedTuple):
    """From where to look for the ends of all rows, and how far from there they are [rad]; and which rollers pass them,
    None where rollers are alike. Of shape (…, ends) each."""

    start: Any
    way: Any
    rollers: Any


def nearest(phases: Any, displacement: Any, bearing: TaperedBearing, terms: Terms) -> Nearest:
    """By rings at several `phases` [rad], shape (…, phases): where one is nearest to an end."""
    found, pitch = list[tuple[Any, ...]](), geometry.roller_pitch(bearing)
    of = xp.module_of(phases, displacement)
    for u, more in zip(rows_of(displacement, bearing, terms), thicker(bearing, terms), strict=True):
        ends, some = _ends(bearing, u, xp.total(more) / np.size(more) if np.ndim(more) else more)
        off = of.where(some[..., None], geometry.wrapped(ends - phases[..., None], pitch), 0.0)  # (…, phases, sides)
        best = of.argmin(of.where(some[..., None], of.abs(off), np.inf), axis=-2)
        start, way = of.take_along_axis(phases, best, -1), of.take_along_axis(off, best[..., None, :], -2)[..., 0, :]
        if not are_different(terms):
            found.append((start, way))
            continue
        end = of.take_along_axis(ends, best[..., None, :], -2)[..., 0, :]
        passing = of.round((end - start - way) / pitch)
        each = [(start, way - pitch * k, passing + k) for k in NEIGHBOURS]
        found.append(tuple(of.concatenate(part, axis=-1) for part in zip(*each, strict=True)))
    start, way, *rollers = (of.concatenate(part, axis=-1) for part in zip(*found, strict=True))
    return Nearest(start, way, *rollers or (None,))


def of_rings(bearing: TaperedBearing, terms: Terms, at: Any, rows: tuple[Any, ...], rollers: Any) -> Any:
    """At which phase of the cage every end is [rad], as its own ring has it, shape (…, ends of all rows), or the phase
    `at` which the ring is where there is none. `rows`: displacements [mm] of the rings of every row, shape (…, ends or
    more, 3); `rollers` as of `nearest`, not needed of rollers that are alike."""
    found, each = list[Any](), count(terms)
    for k, (u, more) in enumerate(zip(rows, thicker(bearing, terms), strict=True)):
        mine = slice(each * k, each * (k + 1))
        if rollers is not None:
            more = more[numbered(bearing, rollers[..., mine])]
        ends, some = _ends(bearing, u[..., mine, :], more)
        own = xp.stack([ends[..., k, k % SIDES] for k in range(each)], axis=-1)
        if rollers is not None:
            away = own - geometry.roller_pitch(bearing) * rollers[..., mine] - at[..., mine]
            own = at[..., mine] + geometry.wrapped(away, TURN)
        found.append(xp.where(some, own, at[..., mine]))
    return xp.concatenate(found, axis=-1)


def numbered(bearing: TaperedBearing, rollers: Any) -> Any:
    """The nearest rollers to numbers counted on over the whole turn, as an index."""
    of = xp.module_of(rollers := xp.fixed(rollers))
    return of.mod(of.round(rollers), bearing.rollers).astype(int)


def _ends(bearing: TaperedBearing, u: Any, more: Any) -> tuple[Any, Any]:
    """Angles at which the load zone ends [rad] on either side, at displacements of shape (…, 3) and of rollers too
    thick by `more` [mm], shape (…, 2); and whether it does, shape (…)."""
    forward = u[..., 0] > 0.0
    radial = xp.where(forward, u[..., 0], 1.0)
    aside = u[..., 1] / radial
    pressed = u[..., 2] * xp.tan(bearing.outer_angle)
    if more is not None:
        pressed = pressed + more / xp.cos(bearing.outer_angle)
    cos_end = -pressed / (radial * xp.sqrt(1.0 + aside * aside))
    partly = (cos_end > -1.0) & (cos_end < 1.0) & forward
    middle, half = xp.arctan(aside), xp.arccos(xp.where(partly, cos_end, 0.0))
    return xp.stack([middle + half, middle - half], axis=-1), partly
