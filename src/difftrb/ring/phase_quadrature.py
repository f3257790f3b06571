"""Phases of the cage over one roller pitch, and their weights in a mean.

Stiffness and loads have kinks (or jumps) where a roller meets an edge of a spall, and weaker ones where a roller takes
up load. Between them a rule of few points is exact; they move with the kinks, so that derivatives of a mean hold what
the kinks' motion adds: of a hard window that is all there is by width.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry, loops
from difftrb.core.geometry import Raceway, Spall, TaperedBearing
from difftrb.core.numeric import gauss_legendre
from difftrb.law import load_curve
from difftrb.law.base import Law
from difftrb.ring import load_zone_ends, ring, roller_places
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
STEEPEST, FLATTEST, LEAST_WAY = -5.0, -0.1, 1e-6
"""Between which slopes a secant is believed, and through phases how far apart, of the pitch."""

ALIKE = 1e-5
"""Rings whose displacements at all phases differ by no more of themselves than this are one. In narrow load zones they
differ by more, and a loss in the mean is 4 % off if kinks are placed by one of them."""
LEAST_LAND = 0.05
"""Of the roller's length, at least."""
SOFTER = 1.3
"""A roller over a spall keeps this power of its land's share of its stiffness, for a crown's middle carries most; of
both raceways in series its contact there then gives way more. Losses in the mean are 1e-4 … 4e-4 of themselves off so,
2e-3 were it as of healthy rollers."""
WHOLE = np.ones(1)
"""The share of the contact where nothing else gives way."""
Rule = tuple[Any, Any]
"""Places in −1 … 1 and weights, which add up to 2, of a mean between two kinks, shape (points,) each."""


class Met(NamedTuple):
    """Spalls met on one raceway, and the law of rollers there."""

    raceway: Raceway
    spalls: tuple[Spall, ...]
    law: Law


class HealthyRing(NamedTuple):
    """A healthy ring that lies alike at all phases: its displacement [mm], shape (…, 3); and of the approach of ring to
    rollers the share of the contact with every raceway met, shape (…, raceways)."""

    displacement: Any
    shares: Any


def borders(
    bearing: TaperedBearing, load: Load, met: tuple[Met, ...], at_rest: Callable[[Any], ring.Equilibrium],
    terms: Terms = PLAIN, healthy_ring: HealthyRing | None = None,
) -> Any:  # fmt: skip
    """Angles of roller 0 [rad] between which nothing has a kink, over the pitch that begins at 0, rising from there to
    its end; shape (kinks + 2,). If there are several loads, of parts of shape (loads,), so are these in front.

    The laws met, the outer raceway's first, say how far their edges reach. `at_rest`: rings under the `load` with
    `terms`, at phases of shape (…, kinks): over spalls, or with few rollers, a ring lies differently at every phase.
    `healthy_ring`: if it is known and the same at all phases: then none is solved, and kinks are about where spalls put
    them.
    """
    shape = (*np.shape(xp.value(load.radial)), _count(met, terms))
    if healthy_ring is None:
        kinks = _by_rings(bearing, load, met, terms, at_rest, shape)
    else:
        rings = xp.broadcast_to(healthy_ring.displacement[..., None, :], (*shape, 3))
        own = (xp.broadcast_to(share[..., None], shape) for share in xp.moveaxis(healthy_ring.shares, -1, 0))
        each = [WHOLE for _ in met] if terms.seat is None else list(own)
        kinks = _within_pitch(bearing, terms, _kinks(bearing, met, np.zeros(shape), rings, terms, each))
    order = xp.module_of(kinks).argsort(xp.value(kinks), axis=-1)
    kinks = kinks[order] if order.ndim == 1 else xp.stack([own[k] for own, k in zip(kinks, order, strict=True)])
    none = 0.0 * kinks[..., :1]
    return xp.concatenate([none, kinks, none + geometry.roller_pitch(bearing)], axis=-1)


def _by_rings(
    bearing: TaperedBearing, load: Load, met: tuple[Met, ...], terms: Terms,
    at_rest: Callable[[Any], ring.Equilibrium], shape: tuple[int, ...],
) -> Any:  # fmt: skip
    """Kinks in the pitch, of this shape, each where its own ring has it: rings are solved at those known, in rounds."""
    zone, differ, pitch = _zone_ends(terms), load_zone_ends.are_different(terms), geometry.roller_pitch(bearing)
    period = np.where(np.arange(shape[-1]) < zone, load_zone_ends.TURN, pitch) if differ else pitch
    of = xp.module_of(jax.tree.leaves((bearing, load, met, terms)))

    def moved(k: Any, state: tuple[Any, Search]) -> tuple[Any, Search]:
        at, before = state
        rest = at_rest(at)
        each = shares(met, rest, terms)
        kinks = _kinks(bearing, met, at, rest.displacement, terms, each, before.rollers)
        kinks, search = _nearer(kinks, at, before, period)
        first = load_zone_ends.nearest(*xp.fixed((at, rest.displacement, bearing, terms)))
        start, way = (
            of.where(k == 0, of.concatenate([part, own[..., zone:]], axis=-1), own)
            for part, own in zip(first[:2], (search.at, search.off), strict=True)
        )
        rollers = of.where(k == 0, first.rollers, before.rollers) if differ else None
        kinks = xp.where(k == 0, start + way, kinks)
        return _within_pitch(bearing, terms, kinks), Search(start, way, search.slope, rollers)

    even = of.broadcast_to(pitch * np.arange(shape[-1]) / shape[-1], shape)
    passing = of.zeros((*shape[:-1], zone)) if differ else None
    return loops.counted(ROUNDS, moved, (even, Search(even, of.zeros(shape), -of.ones(shape), passing)))[0]


def _within_pitch(bearing: TaperedBearing, terms: Terms, kinks: Any) -> Any:
    """In the pitch that begins at 0; ends of load zones of rollers that differ, no farther than to its ends."""
    zone, pitch = _zone_ends(terms), geometry.roller_pitch(bearing)
    if not load_zone_ends.are_different(terms):
        return xp.mod(kinks, pitch)
    return xp.concatenate([xp.clip(kinks[..., :zone], 0.0, pitch), xp.mod(kinks[..., zone:], pitch)], axis=-1)


def _zone_ends(terms: Terms) -> int:
    """How many ends of load zones there are, of all rows."""
    return load_zone_ends.count(terms) * (1 if terms.pair is None else 2)


def _count(met: tuple[Met, ...], terms: Terms) -> int:
    """How many kinks there are: ends of load zones, then of every spall where rollers begin to meet its edges and where
    they have met them, then its further walls."""
    inside = sum(spall.walls.size - 2 for one in met for spall in one.spalls)
    return _zone_ends(terms) + sum((2 if one.law.hard else 4) * len(one.spalls) for one in met) + inside


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
    [rad], and the slope of that by the phase, −1 where rings lie alike. `rollers` as of `load_zone_ends.nearest`."""

    at: Any
    off: Any
    slope: Any
    rollers: Any


def _nearer(of_kinks: Any, at: Any, before: Search, period: Any) -> tuple[Any, Search]:
    """Where kinks are that are at `of_kinks` by rings at the phases `at` [rad], by a secant through what was `before`:
    where rollers lie in spalls a kink moves nearly as the cage turns. They are the same after a `period` [rad]."""
    off = geometry.wrapped(of_kinks - at, period)
    now = before._replace(at=xp.fixed(at), off=xp.fixed(off))
    of = xp.module_of(now.at, before.at)
    way = geometry.wrapped(now.at - before.at, period)
    far = of.abs(way) > LEAST_WAY * period
    slope = (now.off - before.off) / of.where(far, way, 1.0)
    slope = of.where(far & (slope > STEEPEST) & (slope < FLATTEST), slope, before.slope)
    return at - off / slope, now._replace(slope=slope)


def _kinks(
    bearing: TaperedBearing, met: tuple[Met, ...], at: Any, displacement: Any, terms: Terms, shares: Sequence[Any],
    rollers: Any = None,
) -> Any:  # fmt: skip
    """Angles [rad] of the rollers at kinks, each as its own ring has them, shape (…, kinks): where the load zone of
    every row ends on either side, or the phase `at` which the ring is where it does not; then where a roller begins to
    meet every edge of every spall, and where it has met it. They come in pairs, of both sides. `displacement` [mm] of
    these rings, shape (…, kinks, 3); `shares` as of `shares`; `rollers` as of `load_zone_ends.nearest`."""
    # without an equilibrium any phases will do: each of them will say so
    u = xp.where(xp.module_of(displacement).isfinite(xp.value(displacement)), displacement, 0.0)
    rows, thicker = load_zone_ends.rows_of(u, bearing, terms), load_zone_ends.thicker(bearing, terms)
    sides, inside = np.array([1.0, -1.0]), list[Any]()
    found = [load_zone_ends.of_rings(bearing, terms, at, rows, rollers)]
    for (raceway, spalls, law), share in zip(met, shares, strict=True):
        radius = geometry.arc_radius(bearing, raceway)
        for i, spall in enumerate(spalls):
            walls = spall.angle + spall.walls / radius
            edges = walls[:2]
            inside.append(walls[2:])
            if law.hard:
                found.append(edges)
                continue
            begin = sum(part.shape[-1] for part in found)
            mine, edges_twice = slice(begin, begin + 4), xp.concatenate([edges, edges])
            towards = roller_places.directions(bearing, edges_twice)
            approach = xp.einsum("ki,...ki->...k", towards, rows[spall.row - 1][..., mine, :3])
            more = thicker[spall.row - 1]
            if more is not None:
                passing = xp.fixed((edges_twice - at[..., mine]) / geometry.roller_pitch(bearing))
                approach = approach + (more[load_zone_ends.numbered(bearing, passing)] if np.ndim(more) else more)
            if share is not WHOLE:
                own = share[..., mine]
                land = xp.maximum(1.0 - spall.length / bearing.roller_length, LEAST_LAND) ** SOFTER
                land = xp.where(np.arange(4) < 2, 1.0, land)
                approach = approach * own / (own + (1.0 - own) * land)
            begins, ends = (xp.broadcast_to(place, approach.shape) for place in law.ramp(i, spall, approach))
            found += [edges - sides * begins[..., :2] / radius, edges - sides * ends[..., 2:] / radius]
    kinks = xp.concatenate([_of_each(part, rows[0].shape[:-2]) for part in (*found, *inside)], axis=-1)
    # a law that does not know its ramps says so itself
    return xp.where(xp.module_of(kinks).isfinite(xp.value(kinks)), kinks, 0.0)


def _of_each(part: Any, loads: tuple[int, ...]) -> Any:
    """The same angles for each of so many loads, if they are not of each already."""
    return part if part.ndim > len(loads) else xp.broadcast_to(part[None], (*loads, *part.shape))


def shares(met: tuple[Met, ...], rest: ring.Equilibrium, terms: Terms) -> list[Any]:
    """What part of the ring's approach to a loaded roller is the contact's with every raceway met, of every ring at
    `rest`, shape (…, rings), or `WHOLE`."""
    return [WHOLE if terms.seat is None or law.hard else _share(law, rest) for _, _, law in met]


def _share(law: Law, rest: ring.Equilibrium) -> Any:
    """Of the contacts in which `law` holds the largest share there is, for rollers over a spall have less."""
    loads, approach = xp.fixed((rest.loads, rest.approach))
    of, healthy = xp.module_of(loads), law.curves((), cast(Any, np.zeros((0, 1)))).each
    alone = load_curve.approach(xp.fixed(load_curve.one_of(healthy, 0)), xp.maximum(loads, 1.0))
    heavy = (loads > 0.5 * of.max(loads, axis=-1)[..., None]) & (approach > 0.0)
    share = of.where(heavy, alone / of.where(heavy, approach, 1.0), 0.0)
    own, whole = (xp.taken(xp.moveaxis(part, -1, 0), of.argmax(share, axis=-1)) for part in (alone, rest.approach))
    return own / xp.maximum(whole, own)
