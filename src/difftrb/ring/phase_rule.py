"""Phases of the cage over one roller pitch, and their weights in a mean.

Stiffness and loads have kinks (or jumps) where a roller meets an edge of a spall, and weaker ones where a roller takes
up load. Between them a rule of few points is exact; they move with the kinks, so that derivatives of a mean hold what
the kinks' motion adds: of a hard window that is all there is by width.
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
from difftrb.ring.terms import PLAIN, Terms

POINTS_BETWEEN_KINKS = 8
"""Of `crowded`, between two kinks: 56 phases with one spall of soft edges. Stiffness in the mean is within 1e-6 of that
of 200 000 phases, but within 1e-4 where rollers in long spalls, or few rollers, move the ends of the load zone."""
POINTS_IN_FITS = 4
"""The same of fits: by the table 3e-4 and 5e-4 of 30 random spalls, as with 6 and 10 points, whose kinks are as they
are here; a tenth of the noise of good measurements."""
POINTS_BY_CONTACTS = 4
"""The same where contacts are solved for every phase."""
ROUGH_POINTS = 2
"""The same where fits look for minima: 5e-4 and 4e-3."""

ROUNDS = 6
"""How often kinks are looked for where the last rings have them, the first time at even phases. With three of them
derivatives were up to 6 % off where rollers in long spalls move the load zone's ends."""

ENDS = 2
"""Of a load zone."""
STEEPEST, FLATTEST, LEAST_WAY = -5.0, -0.1, 1e-6
"""Between which slopes a secant is believed, and through phases how far apart, of the pitch."""

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
    terms: Terms = PLAIN, still: Any = None,
) -> Any:  # fmt: skip
    """Angles of roller 0 [rad] between which nothing has a kink, over the pitch that begins at 0, rising from there to
    its end; shape (kinks + 2,). If there are several loads, of parts of shape (loads,), so are these in front.

    The laws met, the outer raceway's first, say how far their edges reach. `at_rest`: rings under the `load` with
    `terms`, at phases of shape (…, kinks): over spalls, or with few rollers, a ring lies differently at every phase.
    `still`: of a plain healthy one the displacement [mm], shape (…, 3), if it is known and the same at all phases: then
    none is solved, and kinks are about where spalls put them.
    """
    whole = geometry.roller_pitch(bearing)

    def known(kinks: Any) -> Any:
        # a law that does not know its ramps says so itself
        return xp.where(xp.module_of(kinks).isfinite(xp.value(kinks)), kinks, 0.0)

    rows = 1 if terms.pair is None else 2
    inside = sum(spall.walls.size - 2 for one in met for spall in one.spalls)
    count = ENDS * rows + sum((2 if one.law.hard else 4) * len(one.spalls) for one in met) + inside
    shape = (*np.shape(xp.value(load.radial)), count)
    if still is None:
        of = xp.module_of(jax.tree.leaves((bearing, load, met, terms)))

        def moved(k: Any, state: tuple[Any, Search]) -> tuple[Any, Search]:
            at, before = state
            rest = at_rest(at)
            of_kinks = known(_kinks(bearing, met, at, rest.displacement, terms, rest))
            kinks, search = _nearer(of_kinks, at, before, whole)
            zone = _zone_from(xp.fixed(at), xp.fixed(rest.displacement), xp.fixed(bearing), xp.fixed(terms))
            start, way = (
                of.where(k == 0, of.concatenate([part, own[..., ENDS * rows :]], axis=-1), own)
                for part, own in zip(zone, (search.at, search.off), strict=True)
            )
            return xp.mod(xp.where(k == 0, start + way, kinks), whole), Search(start, way, search.slope)

        even = of.broadcast_to(whole * np.arange(count) / count, shape)
        kinks, _ = loops.counted(ROUNDS, moved, (even, Search(even, of.zeros(shape), -of.ones(shape))))
    else:
        rings = xp.broadcast_to(still[..., None, :], (*shape, 3))
        kinks = xp.mod(known(_kinks(bearing, met, np.zeros(shape), rings, terms)), whole)
    order = xp.module_of(kinks).argsort(xp.value(kinks), axis=-1)
    kinks = kinks[order] if order.ndim == 1 else xp.stack([own[k] for own, k in zip(kinks, order, strict=True)])
    none = 0.0 * kinks[..., :1]
    return xp.concatenate([none, kinks, none + whole], axis=-1)


def between(borders: Any, rule: Rule | None = None) -> tuple[Any, Any]:
    """Angles of roller 0 [rad] and their weights, which add up to 1, by a rule between every two of the `borders`.

    None: `crowded`, of `POINTS_BETWEEN_KINKS`. Both of shape (phases,).
    """
    starts, length = borders[:-1], borders[1:] - borders[:-1]
    places, weights = rule or crowded(POINTS_BETWEEN_KINKS)
    at = starts[:, None] + length[:, None] * (0.5 + 0.5 * places)[None, :]
    share = (length / borders[-1])[:, None] * (0.5 * weights)[None, :]
    return at.reshape(-1), share.reshape(-1)


def crowded(count: int) -> Rule:
    """Gauss's rule in t of the place 3t² − 2t³: points crowd at both ends, from where stiffness goes off as a square
    root, for there a roller takes up load. In t it is smooth."""
    places, weights = gauss_legendre(count)
    t = 0.5 + 0.5 * places
    return 2.0 * t * t * (3.0 - 2.0 * t) - 1.0, weights * 6.0 * t * (1.0 - t)


class Search(NamedTuple):
    """For kinks, shape (…, kinks) each: the phase of the last rings [rad], from there to where these have the kink
    [rad], and the slope of that by the phase, −1 where rings lie alike."""

    at: Any
    off: Any
    slope: Any


def _nearer(of_kinks: Any, at: Any, before: Search, whole: float) -> tuple[Any, Search]:
    """Where kinks are that are at `of_kinks` by rings at the phases `at` [rad], by a secant through what was `before`:
    where rollers lie in spalls a kink moves nearly as the cage turns."""
    off = geometry.turned(of_kinks - at, whole)
    now = Search(xp.fixed(at), xp.fixed(off), before.slope)
    of = xp.module_of(now.at, before.at)
    way = geometry.turned(now.at - before.at, whole)
    far = of.abs(way) > LEAST_WAY * whole
    slope = (now.off - before.off) / of.where(far, way, 1.0)
    slope = of.where(far & (slope > STEEPEST) & (slope < FLATTEST), slope, before.slope)
    return at - off / slope, now._replace(slope=slope)


def _zone_from(phases: Any, displacement: Any, bearing: TaperedBearing, terms: Terms) -> tuple[Any, Any]:
    """From where to look for the ends of the load zones of all rows, and how far from there they are [rad], shape (…,
    ends), by rings at several `phases` [rad], shape (…, phases): where one is nearest to an end."""
    starts, ways, whole = list[Any](), list[Any](), geometry.roller_pitch(bearing)
    of = xp.module_of(phases, displacement)
    for u in rows_of(displacement, bearing, terms):
        ends, some = _zone(bearing, u)
        off = of.where(some[..., None], geometry.turned(ends - phases[..., None], whole), 0.0)  # (…, phases, sides)
        best = of.argmin(of.where(some[..., None], of.abs(off), np.inf), axis=-2)
        starts.append(of.take_along_axis(phases, best, -1))
        ways.append(of.take_along_axis(off, best[..., None, :], -2)[..., 0, :])
    return of.concatenate(starts, axis=-1), of.concatenate(ways, axis=-1)


def rows_of(displacement: Any, bearing: TaperedBearing, terms: Terms) -> tuple[Any, ...]:
    """Displacements [mm] of every row of rollers."""
    return (displacement,) if terms.pair is None else terms.pair.rows(displacement, bearing.outer_angle)


def _kinks(
    bearing: TaperedBearing, met: tuple[Met, ...], at: Any, displacement: Any, terms: Terms,
    rest: ring.Equilibrium | None = None,
) -> Any:  # fmt: skip
    """Angles [rad] of the rollers at kinks, each as its own ring has them, shape (…, kinks): where the load zone of
    every row ends on either side, or the phase `at` which the ring is where it does not; then where a roller begins to
    meet every edge of every spall, and where it has met it. They come in pairs, of both sides. `displacement` [mm] of
    these rings, shape (…, kinks, 3); `rest`: all of them."""
    # without an equilibrium any phases will do: each of them will say so
    u = xp.where(xp.module_of(displacement).isfinite(xp.value(displacement)), displacement, 0.0)
    rows = rows_of(u, bearing, terms)
    sides, found, inside = np.array([1.0, -1.0]), list[Any](), list[Any]()
    for k, own in enumerate(rows):
        mine = slice(ENDS * k, ENDS * (k + 1))
        ends, some = _own_zone(bearing, own[..., mine, :])
        found.append(xp.where(some, ends, at[..., mine]))
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


def _zone(bearing: TaperedBearing, u: Any) -> tuple[Any, Any]:
    """Angles at which the load zone ends [rad] on either side, at displacements of shape (…, 3), shape (…, 2); and
    whether it does, shape (…)."""
    forward = u[..., 0] > 0.0
    radial = xp.where(forward, u[..., 0], 1.0)
    aside = u[..., 1] / radial
    cos_end = -u[..., 2] * xp.tan(bearing.outer_angle) / (radial * xp.sqrt(1.0 + aside * aside))
    partly = (cos_end > -1.0) & (cos_end < 1.0) & forward
    middle, half = xp.arctan(aside), xp.arccos(xp.where(partly, cos_end, 0.0))
    return xp.stack([middle + half, middle - half], axis=-1), partly


def _own_zone(bearing: TaperedBearing, u: Any) -> tuple[Any, Any]:
    """The same of a side each, at displacements of shape (…, 2, 3), shape (…, 2)."""
    ends, partly = _zone(bearing, u)
    return xp.stack([ends[..., side, side] for side in range(ENDS)], axis=-1), partly


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
