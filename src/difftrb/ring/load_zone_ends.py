"""Where the load zone of a ring ends: there a roller takes up load, and stiffness has a kink over the cage's phase.

Where rings lie alike at all phases, one roller leaves the zone within a pitch and one enters it. Where rollers meet
spalls the zone grows and shrinks as the cage turns, at times faster than rollers move: one may leave it, come back and
leave it again. Rollers of different diameters have each a place of its own. So ends are looked for between phases at
which rings are known: wherever one roller is loaded here and not there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.geometry import TaperedBearing
from difftrb.ring import roller_places
from difftrb.ring.terms import Terms

MOST = 6
"""Of one row: four more than of rings that lie alike. Of 185 rings of 7 or 17 rollers with one spall 19 had four and 8
had six; of 61 with two of them two had more."""
FEWEST = 2
"""Of rings that lie alike."""
LEFT = 1e-5
"""Of the largest approach, what is left of a roller's where it takes up load; where more is, it does so in a jump."""


def rows(terms: Terms) -> int:
    """How many rows of rollers there are."""
    return 1 if terms.pair is None else 2


def rows_of(displacement: Any, bearing: TaperedBearing, terms: Terms) -> tuple[Any, ...]:
    """Displacements [mm] of every row of rollers."""
    return (displacement,) if terms.pair is None else terms.pair.rows(displacement, bearing.outer_angle)


def thicker(bearing: TaperedBearing, terms: Terms) -> tuple[Any, ...]:
    """By how much the rollers of every row are too thick [mm], one number or shape (rollers,); None: not at all."""
    more, count = terms.interference, bearing.rollers
    if not are_different(terms):
        return (more,) * rows(terms)
    return tuple(xp.asarray(more)[count * k : count * (k + 1)] for k in range(rows(terms)))


def are_different(terms: Terms) -> bool:
    """Whether rollers differ in diameter."""
    return terms.interference is not None and np.size(xp.value(terms.interference)) > 1


def count(terms: Terms, few: bool = False) -> int:
    """How many ends are looked for, of all rows; `few`: as of rings that lie alike."""
    return (FEWEST if few and not are_different(terms) else MOST) * rows(terms)


def approaches(bearing: TaperedBearing, terms: Terms, at: Any, displacements: tuple[Any, ...]) -> Any:
    """Of the rollers of all rows [mm], negative where they are clear, shape (…, phases, rollers): of rings at the
    phases `at` [rad]; `displacements` [mm] of every row, shape (…, phases, 3 or more)."""
    towards, found = roller_places.directions(bearing, roller_places.roller_angles(bearing, at)), list[Any]()
    for u, more in zip(displacements, thicker(bearing, terms), strict=True):
        own = xp.einsum("...kri,...ki->...kr", towards, u[..., :3])
        if more is not None:
            own = own + (more[(None,) * (own.ndim - 1)] if np.ndim(more) else more)
        found.append(own)
    return xp.concatenate(found, axis=-1)


class Passing(NamedTuple):
    """Rollers that take up load between two phases, shape (…, ends) each.

    Attributes:
      rollers: which, counted through all rows. there: whether there are so many.
      front, back, before: the last phase looked at, one on the other side of the end, and one before these [rad].
      front_near, back_near, before_near: the roller's approaches there [mm].
    """

    rollers: Any
    there: Any
    front: Any
    back: Any
    before: Any
    front_near: Any
    back_near: Any
    before_near: Any

    @property
    def next(self) -> Any:
        """Where to look next [rad]: where a straight line through two phases has the end, and then a parabola through
        three, if it is believed; else in the middle (Chandrupatla 1997), for rings may give way nearly at once."""
        (a, b, c), (near_a, near_b, near_c) = self[2:5], self[5:]
        of = xp.module_of(a)
        place, share = _ratio(a - b, c - b), _ratio(near_a - near_b, near_c - near_b)
        believed = (c != b) & (share**2 < place) & ((1.0 - share) ** 2 < 1.0 - place)
        straight = _ratio(near_a, near_b - near_a) * _ratio(near_c, near_b - near_c)
        bent = _ratio(c - a, b - a) * _ratio(near_a, near_c - near_a) * _ratio(near_b, near_c - near_b)
        way = of.where(c == b, _ratio(near_a, near_a - near_b), of.where(believed, straight + bent, 0.5))
        return a + (b - a) * way


def _ratio(a: Any, b: Any) -> Any:
    return a / xp.module_of(b).where(b == 0.0, 1.0, b)


def between(phases: Any, near: Any, ends: int) -> Passing:
    """So many rollers that take up load between two of these `phases` [rad], shape (…, phases); `near`: approaches of
    all rollers [mm]. Those come first that do so once, or stay loaded, or clear, for long."""
    of = xp.module_of(phases, near)
    order = of.argsort(phases, axis=-1)
    phases, near = of.take_along_axis(phases, order, -1), of.take_along_axis(near, order[..., None], -2)
    changes = (near[..., 1:, :] > 0.0) != (near[..., :-1, :] > 0.0)
    middle, others = phases[..., 1:] + phases[..., :-1], ~np.eye(changes.shape[-2], dtype=bool)
    apart = of.abs(middle[..., :, None] - middle[..., None, :])[..., None]
    alone = of.where(changes[..., None, :, :] & others[..., None], apart, np.inf).min(axis=-2)
    changes, alone = (part.reshape(*part.shape[:-2], -1) for part in (changes, alone))
    picked = of.argsort(of.where(changes, -alone, 1.0), axis=-1, stable=True)[..., :ends]
    begin, every = picked // near.shape[-1], near.reshape(*near.shape[:-2], -1)
    front, back = (of.take_along_axis(phases, begin + k, -1) for k in (0, 1))
    front_near, back_near = (of.take_along_axis(every, picked + k * near.shape[-1], -1) for k in (0, 1))
    there = of.take_along_axis(changes, picked, -1)
    return Passing(picked % near.shape[-1], there, front, back, back, front_near, back_near, back_near)


def closer(passing: Passing, at: Any, near: Any) -> Passing:
    """With the phases `at` [rad] looked at, where all rollers' approaches are `near` [mm]."""
    rollers, there, front, back, _, front_near, back_near, _ = passing
    own = of_rollers(near, rollers)
    of = xp.module_of(own)
    crossed = (own > 0.0) != (front_near > 0.0)
    return Passing(
        rollers, there,
        at, of.where(crossed, front, back), of.where(crossed, back, front),
        own, of.where(crossed, front_near, back_near), of.where(crossed, back_near, front_near),
    )  # fmt: skip


def left(passing: Passing, near: Any) -> Any:
    """How far rollers are from taking up load, of the largest approach of rings at some phases, where all are `near`
    [mm]; shape (…, ends)."""
    of = xp.module_of(near)
    largest = of.max(of.abs(near), axis=(-2, -1))[..., None]
    return of.where(passing.there, of.abs(passing.front_near), 0.0) / of.where(largest > 0.0, largest, 1.0)


def are_there(passing: Passing, near: Any) -> Any:
    """Which ends were found; the others are not, or jumps where a roller meets an edge. `near` as of `left`."""
    return passing.there & (left(passing, near) <= LEFT)


def of_rollers(near: Any, rollers: Any) -> Any:
    """Of approaches of all rollers, shape (…, ends or more, rollers), those of one for each end."""
    return xp.taken(xp.moveaxis(near[..., : rollers.shape[-1], :], -1, 0), rollers)


def numbered(bearing: TaperedBearing, rollers: Any) -> Any:
    """The nearest rollers to numbers counted on over the whole turn, as an index."""
    of = xp.module_of(rollers := xp.fixed(rollers))
    return of.mod(of.round(rollers), bearing.rollers).astype(int)
