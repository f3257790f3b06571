"""Phases of the cage over one roller pitch, and their weights in a mean.

Stiffness and loads have kinks (or jumps) where a roller meets an edge of a spall, and weaker ones where a roller takes
up load. Between them Gauss–Legendre points are few and exact; they move with the kinks, so that derivatives of a mean
hold what the kinks' motion adds: of a hard window that is all there is by width.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry, loops
from difftrb.core.geometry import Raceway, Spall, TaperedBearing
from difftrb.core.numeric import gauss_legendre
from difftrb.law import load_curve
from difftrb.law.base import Law
from difftrb.ring import ring, roller_places
from difftrb.ring.load import Load

POINTS_BETWEEN_KINKS = 10
"""Gauss–Legendre points between two kinks: 70 phases with one spall of soft edges. Losses are within 2e-5 of themselves
by the median of 30 random spalls, and within 7e-4 at worst."""
POINTS_IN_FITS = 4
"""The same of fits: by the table 3e-4 and 5e-4 of 30 random spalls, as with 6 and 10 points, whose kinks are as they
are here; a tenth of the noise of good measurements."""
POINTS_BY_CONTACTS = 4
"""The same where contacts are solved for every phase."""
ROUGH_POINTS = 2
"""The same where fits look for minima: 5e-4 and 4e-3."""

ROUNDS = 3
"""How often kinks are looked for where the last rings have them, the first time at phase 0."""

ALIKE = 1e-5
"""Rings whose displacements at all phases differ by no more of themselves than this are one. In narrow load zones they
differ by more, and a loss in the mean is 4 % off if kinks are placed by one of them."""
Rule = tuple[Any, Any]
"""Places in −1 … 1 and weights, which add up to 2, of a mean between two kinks, shape (points,) each."""


class Met(NamedTuple):
    """Spalls met on one raceway, and the law of rollers there."""

    raceway: Raceway
    spalls: tuple[Spall, ...]
    law: Law


def borders(
    bearing: TaperedBearing, load: Load, met: tuple[Met, ...], at_rest: Callable[[Any], ring.Equilibrium],
    terms: ring.Terms = ring.PLAIN, still: Any = None,
) -> Any:  # fmt: skip
    """Angles of roller 0 [rad] between which nothing has a kink, over the pitch that begins at 0, rising from there to
    its end; shape (kinks + 2,). If there are several loads, of parts of shape (loads,), so are these in front.

    The laws met, the outer raceway's first, say how far their edges reach. `at_rest`: rings under the `load` with
    `terms`, at phases of shape (…, kinks): over spalls, or with few rollers, a ring lies differently at every phase.
    `still`: of a plain healthy one the displacement [mm], shape (…, 3), if it is known and the same at all phases: then
    none is solved, and kinks are about where spalls put them.
    """
    whole = geometry.roller_pitch(bearing)

    def found(displacement: Any, rest: ring.Equilibrium | None = None) -> Any:
        kinks = xp.mod(_kinks(bearing, met, displacement, terms, rest), whole)
        # a law that does not know its ramps says so itself
        return xp.where(xp.module_of(kinks).isfinite(xp.value(kinks)), kinks, 0.0)

    def moved(at: Any) -> Any:
        rest = at_rest(at)
        return found(rest.displacement, rest)

    rows = 1 if terms.pair is None else 2
    inside = sum(spall.walls.size - 2 for one in met for spall in one.spalls)
    count = 2 * rows + sum((2 if one.law.hard else 4) * len(one.spalls) for one in met) + inside
    shape = (*np.shape(xp.value(load.radial)), count)
    if still is None:
        kinks = loops.repeated(ROUNDS, moved, xp.module_of(jax.tree.leaves((bearing, load, met, terms))).zeros(shape))
    else:
        kinks = found(xp.broadcast_to(still[..., None, :], (*shape, 3)))
    order = xp.module_of(kinks).argsort(xp.value(kinks), axis=-1)
    kinks = kinks[order] if order.ndim == 1 else xp.stack([own[k] for own, k in zip(kinks, order, strict=True)])
    none = 0.0 * kinks[..., :1]
    return xp.concatenate([none, kinks, none + whole], axis=-1)


def between(borders: Any, rule: Rule | None = None) -> tuple[Any, Any]:
    """Angles of roller 0 [rad] and their weights, which add up to 1, by a rule between every two of the `borders`.

    None: `gauss` with `POINTS_BETWEEN_KINKS`. Both of shape (phases,).
    """
    starts, length = borders[:-1], borders[1:] - borders[:-1]
    places, weights = rule or gauss_legendre(POINTS_BETWEEN_KINKS)
    at = starts[:, None] + length[:, None] * (0.5 + 0.5 * places)[None, :]
    share = (length / borders[-1])[:, None] * (0.5 * weights)[None, :]
    return at.reshape(-1), share.reshape(-1)


def _kinks(
    bearing: TaperedBearing, met: tuple[Met, ...], displacement: Any, terms: ring.Terms, rest: ring.Equilibrium | None
) -> Any:
    """Angles [rad] of the rollers at kinks, each as its own ring has them, shape (…, kinks): where the load zone of
    every row ends on either side, then where a roller begins to meet every edge of every spall, and where it has met
    it. They come in pairs, of both sides. `displacement` [mm] of these rings, shape (…, kinks, 3); `rest`: all."""
    # without an equilibrium any phases will do: each of them will say so
    u = xp.where(xp.module_of(displacement).isfinite(xp.value(displacement)), displacement, 0.0)
    rows = (u,) if terms.pair is None else terms.pair.rows(u, bearing.outer_angle)
    sides, found, inside = np.array([1.0, -1.0]), list[Any](), list[Any]()
    for k, own in enumerate(rows):
        found.append(_zone(bearing, own[..., 2 * k : 2 * k + 2, :], sides))
    for raceway, spalls, law in met:
        radius = geometry.arc_radius(bearing, raceway)
        share = None if rest is None or terms.seat is None or law.hard else _share(law, rest)
        for i, spall in enumerate(spalls):
            walls = spall.angle + spall.walls / radius
            edges = walls[:2]
            inside.append(walls[2:])
            if law.hard:
                found.append(edges)
                continue
            mine = slice(2 * len(found), 2 * len(found) + 4)
            towards = roller_places.directions(bearing, xp.concatenate([edges, edges]))
            approach = xp.einsum("ki,...ki->...k", towards, rows[spall.row - 1][..., mine, :3])
            if share is not None:
                approach = approach * share[..., mine]
            begins, ends = (xp.broadcast_to(place, approach.shape) for place in law.ramp(i, spall, approach))
            found += [edges - sides * begins[..., :2] / radius, edges - sides * ends[..., 2:] / radius]
    return xp.concatenate([_of_each(part, rows[0].shape[:-2]) for part in (*found, *inside)], axis=-1)


def _of_each(part: Any, loads: tuple[int, ...]) -> Any:
    """The same angles for each of so many loads, if they are not of each already."""
    return part if part.ndim > len(loads) else xp.broadcast_to(part[None], (*loads, *part.shape))


def _zone(bearing: TaperedBearing, u: Any, sides: np.ndarray) -> Any:
    """Angles at which the load zone ends [rad] on the `sides`, at a displacement each, shape (…, 2, 3); 0 without."""
    forward = u[..., 0] > 0.0
    radial = xp.where(forward, u[..., 0], 1.0)
    aside = u[..., 1] / radial
    cos_end = -u[..., 2] * xp.tan(bearing.outer_angle) / (radial * xp.sqrt(1.0 + aside * aside))
    partly = (cos_end > -1.0) & (cos_end < 1.0) & forward
    ends = xp.arctan(aside) + sides * xp.arccos(xp.where(partly, cos_end, 0.0))
    return xp.where(partly, ends, 0.0)


def _share(law: Law, rest: ring.Equilibrium) -> Any:
    """What part of the ring's approach to a loaded roller is the contact's in which `law` holds, of every ring, shape
    (…, kinks): the largest there is, for rollers over a spall have less."""
    loads, approach = xp.fixed((rest.loads, rest.approach))
    of, healthy = xp.module_of(loads), law.curves((), cast(Any, np.zeros((0, 1)))).each
    alone = load_curve.approach(xp.fixed(load_curve.one_of(healthy, 0)), xp.maximum(loads, 1.0))
    heavy = (loads > 0.5 * of.max(loads, axis=-1)[..., None]) & (approach > 0.0)
    share = of.where(heavy, alone / of.where(heavy, approach, 1.0), 0.0)
    own, whole = (xp.taken(xp.moveaxis(part, -1, 0), of.argmax(share, axis=-1)) for part in (alone, rest.approach))
    return own / xp.maximum(whole, own)
