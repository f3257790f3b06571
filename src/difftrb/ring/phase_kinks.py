"""Where the mean over cage phases has kinks: found by rings there, and how they move as a scene changes.

Where a roller meets an edge, and where it takes up load, hangs on how the ring lies, and that on the phase. So kinks
are looked for: edges by secants from where they would be of rings that lie alike; ends of load zones, of which there
may be several, between phases at which rings are known. They are roots of what is `_off` at their own phases, and
move by the implicit function theorem: with the slope by the phase on the same side of the kink, for a ring gives way
more on the one than on the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry, implicit, loops
from difftrb.core.geometry import Raceway, Spall, TaperedBearing
from difftrb.core.taylor import Taylor
from difftrb.law import load_curve
from difftrb.law.base import Law
from difftrb.ring import load_zone_ends, ring, roller_places
from difftrb.ring.load_zone_ends import Passing
from difftrb.ring.terms import Terms

KNOWN = 2
"""After so many rounds edges are known well enough to look for ends of load zones between them."""
MOST_ROUNDS = 24
NEAR = 1e-9
"""Of the largest approach, and of the pitch: rounds end where rollers that take up load, and edges, are no farther off;
the next ones would be as near as numbers are."""
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


class Turning(NamedTuple):
    """A ring while the cage turns.

    Attributes:
      met: spalls and laws met, the outer raceway's first: they say how far edges reach.
      loads: shape of the loads that it is under, each by itself; () of one.
      rings: displacements [mm], shape (…, phases, 3 or more), and shares as of `shares`, at phases [rad] of shape (…,
        phases): over spalls, or with few rollers, a ring lies differently at every phase.
    """

    bearing: TaperedBearing
    met: tuple[Met, ...]
    terms: Terms
    loads: tuple[int, ...]
    rings: Callable[[Any], tuple[Any, Sequence[Any]]]


class Borders(NamedTuple):
    """Angles of roller 0 [rad] between which nothing has a kink, over the pitch that begins at 0, rising from there to
    its end, shape (…, kinks + 2); and which of them are there, for others lie at 0 to make up their number."""

    at: Any
    there: Any


def borders(turning: Callable[[Any], Turning], scene: Any, few: bool = False) -> Borders:
    """Those of the ring of a `scene`, expanded or not; `few` as of `load_zone_ends.count`."""
    kinks, rollers, there = _searched(turning(xp.fixed(scene)), few)
    if xp.of_jax(scene):

        def off(at: Any, given: tuple[Any, Any, Any]) -> Any:
            return _off(turning(given[0]), at, *given[1:])

        kinks = implicit.settled(off, kinks, (xp.values(scene), rollers, there))
    if xp.expands(scene):
        at, wide = xp.with_one_more(kinks, scene)
        by = _off(turning(wide), at, rollers, there).by
        kinks = Taylor(kinks, -by[:-1] / by[-1:])
    pitch = geometry.roller_pitch(turning(scene).bearing)
    kinks = xp.mod(kinks, pitch)
    of, none = xp.module_of(kinks), 0.0 * kinks[..., :1]
    order = of.argsort(xp.value(kinks), axis=-1)
    kinks = kinks[order] if order.ndim == 1 else xp.stack([own[k] for own, k in zip(kinks, order, strict=True)])
    there = of.concatenate([there, of.ones_like(order[..., there.shape[-1] :], bool)], axis=-1)
    there = of.take_along_axis(there, order, -1)
    ends = of.ones_like(there[..., :1])
    there = of.concatenate([ends, there, ends], axis=-1)
    return Borders(xp.concatenate([none, kinks, none + pitch], axis=-1), there)


class Secant(NamedTuple):
    """Of edges, shape (…, edges) each: the phase of the last rings [rad], from there to where these have the edge
    [rad], and the slope of that by the phase, −1 where rings lie alike."""

    at: Any
    off: Any
    slope: Any


class State(NamedTuple):
    """Of the search: how many rounds there were; phases of the next rings [rad], of ends of load zones and then of
    edges; approaches of all rollers at the first ones [mm]; and what is known of both."""

    rounds: Any
    at: Any
    first: Any
    passing: Passing
    secant: Secant


def _searched(turning: Turning, few: bool) -> tuple[Any, Any, Any]:
    """Phases of the kinks [rad], ends of load zones and then edges, shape (…, kinks); which roller takes up load at
    every end, and which of the ends are there, shape (…, ends)."""
    bearing, terms = turning.bearing, turning.terms
    ends, pitch = load_zone_ends.count(terms, few), geometry.roller_pitch(bearing)
    of = xp.module_of(jax.tree.leaves(turning[:3]))
    size = ends + _edge_count(turning.met)
    even = of.broadcast_to(pitch * np.linspace(0.0, 1.0, size), (*turning.loads, size))

    def is_on(state: State) -> Any:
        ends_off = load_zone_ends.left(state.passing, state.first)
        off = of.max(of.concatenate([ends_off, of.abs(state.secant.off) / pitch], axis=-1))
        return (state.rounds <= KNOWN) | ((state.rounds < MOST_ROUNDS) & (off > NEAR))

    def nearer(state: State) -> State:
        k, at, first, passing, secant = state
        u, each = turning.rings(at)
        near = _approaches(turning, at, u)
        first = of.where(k == 0, near, first)
        phases = of.concatenate([even, at[..., ends:]], axis=-1)
        begun = load_zone_ends.between(phases, of.concatenate([first, near[..., ends:, :]], axis=-2), ends)
        closer = load_zone_ends.closer(passing, at[..., :ends], near)
        passing = Passing(*(of.where(k <= KNOWN, one, other) for one, other in zip(begun, closer, strict=True)))
        edges, secant = _nearer(at[..., ends:], _edges_off(turning, at, u, each, ends), secant, pitch)
        return State(k + 1, of.concatenate([passing.next, of.mod(edges, pitch)], axis=-1), first, passing, secant)

    none, edges = of.zeros((*turning.loads, ends)), even[..., ends:]
    passing = Passing(none.astype(int), none > 0.0, *[none] * 6)
    first = of.zeros((*turning.loads, size, bearing.rollers * load_zone_ends.rows(terms)))
    start = State(0, even, first, passing, Secant(edges, of.zeros_like(edges), -of.ones_like(edges)))
    _, at, first, passing, _ = loops.repeated_while(is_on, nearer, start)
    there = load_zone_ends.are_there(passing, first)
    return of.concatenate([of.where(there, at[..., :ends], 0.0), at[..., ends:]], axis=-1), passing.rollers, there


def _off(turning: Turning, at: Any, rollers: Any, there: Any) -> Any:
    """What is 0 at every kink, each of its own ring at the phases `at` [rad], shape (…, kinks): approaches of rollers
    that take up load [mm], and how far edges are from there [rad]. Of what is not there, how far it is from here."""
    ends = rollers.shape[-1]
    u, each = turning.rings(at)
    near = load_zone_ends.of_rollers(_approaches(turning, at[..., :ends], u[..., :ends, :]), rollers)
    near = xp.where(there, near, xp.fixed(at[..., :ends]) - at[..., :ends])
    return xp.concatenate([near, _edges_off(turning, at, u, each, ends)], axis=-1)


def _approaches(turning: Turning, at: Any, displacement: Any) -> Any:
    """See `load_zone_ends.approaches`; without an equilibrium 0."""
    u = _finite(displacement)
    rows = load_zone_ends.rows_of(u, turning.bearing, turning.terms)
    return load_zone_ends.approaches(turning.bearing, turning.terms, at, rows)


def _edges_off(turning: Turning, at: Any, displacement: Any, each: Sequence[Any], ends: int) -> Any:
    """From phases `at` [rad] to where rings there have their edges [rad], the nearer way round; all behind the `ends`
    of load zones."""
    at, u = at[..., ends:], _finite(displacement)[..., ends:, :]
    shares = [share if share is WHOLE else share[..., ends:] for share in each]
    return geometry.wrapped(_edges(turning, at, u, shares) - at, geometry.roller_pitch(turning.bearing))


def _finite(displacement: Any) -> Any:
    """Without an equilibrium any phases will do: each of them will say so."""
    return xp.where(xp.module_of(displacement).isfinite(xp.value(displacement)), displacement, 0.0)


def _edge_count(met: tuple[Met, ...]) -> int:
    """How many edges there are: of every spall where rollers begin to meet it and where they have met it on either
    side, and its further walls."""
    inside = sum(spall.walls.size - 2 for one in met for spall in one.spalls)
    return sum((2 if one.law.hard else 4) * len(one.spalls) for one in met) + inside


def _nearer(at: Any, off: Any, before: Secant, period: Any) -> tuple[Any, Secant]:
    """Where edges are that are `off` [rad] by rings at the phases `at` [rad], by a secant through what was `before`:
    where rollers lie in spalls an edge moves nearly as the cage turns. They are the same after a `period` [rad]."""
    of = xp.module_of(at, off)
    way = geometry.wrapped(at - before.at, period)
    far = of.abs(way) > LEAST_WAY * period
    slope = (off - before.off) / of.where(far, way, 1.0)
    slope = of.where(far & (slope > STEEPEST) & (slope < FLATTEST), slope, before.slope)
    return at - off / slope, Secant(at, off, slope)


def _edges(turning: Turning, at: Any, displacement: Any, shares: Sequence[Any]) -> Any:
    """Angles [rad] of the rollers at edges, each as its own ring has them, shape (…, edges): where a roller begins to
    meet every edge of every spall, and where it has met it. They come in pairs, of both sides. `displacement` [mm] of
    these rings, shape (…, edges, 3); `shares` as of `shares`."""
    bearing, terms = turning.bearing, turning.terms
    rows, thicker = load_zone_ends.rows_of(displacement, bearing, terms), load_zone_ends.thicker(bearing, terms)
    sides, found, inside = np.array([1.0, -1.0]), list[Any](), list[Any]()
    for (raceway, spalls, law), share in zip(turning.met, shares, strict=True):
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
    if not _edge_count(turning.met):
        return 0.0 * at
    edges = xp.concatenate([_of_each(part, rows[0].shape[:-2]) for part in (*found, *inside)], axis=-1)
    # a law that does not know its ramps says so itself
    return xp.where(xp.module_of(edges).isfinite(xp.value(edges)), edges, 0.0)


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
