"""Where pressure can be: an upper estimate of the approach, and how far the contact reaches with it."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap as gaps
from difftrb.contact.height_map import HeightMap, height_at
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.core.numeric import bisected

Defects = tuple[Spall | HeightMap, ...]
AT_EDGES = 0.7
"""Stiffness of a slice that stands on a spall's rolling edge, by that of one on sound raceway: at least."""


def domain(
    contact: LineContact, load: jax.Array, spalls: tuple[Spall, ...], offsets: jax.Array, tilt: jax.Array | None = None
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Half extent of the solution domain in x, its ends in y [mm]: where the gap is less than an upper estimate of δ.

    The estimate is a foundation of independent slices, each with the stiffness of a long line contact, of which those
    over a spall begin to carry at the raceway that is left beside it, or at its bottom. Extents are differentiated like
    everything else: the grid breathes with the contact, so the free boundary keeps its place among the cells and
    derivatives by load and radius do not ripple. `offsets` of the spalls, shape (spalls,).
    """
    needed = needed_by_slices(contact, load)
    zero = jnp.zeros(())
    delta = _sunk(contact, needed, zero, zero, jnp.ones(2), tilt)
    if not spalls:
        return extents(contact, delta, tilt)
    lands = _beside(contact, spalls)
    raised = _raised(contact, spalls, offsets, lands)
    depth = jnp.max(jnp.stack([jnp.asarray(spall.depth, float) for spall in spalls]))
    if len(spalls) == 1:
        sunk = _sunk(contact, needed, lands.low[0], lands.high[0], jnp.ones(2), tilt, raised[1])
    else:
        sunk = _sunk_beside(contact, needed, lands, raised, tilt)
    delta = jnp.minimum(sunk, delta + depth)  # at most down to its bottom
    reach, bottom, top = extents(contact, delta, tilt)
    interference = delta if tilt is None else delta - _least_rest(contact, tilt)
    met = jnp.max(jnp.where(lands.covered & (raised < interference), raised, 0.0))  # by a slice over a spall
    beyond, low, high = extents(contact, delta - jnp.minimum(met, 0.999 * interference), tilt)
    certain = jnp.sqrt(2.0 * contact.radius * 1.15 * interference)
    edge = jnp.sqrt(2.0 * contact.radius * jnp.where(met > 0.0, met, 1.0))
    # in `beyond` there is the margin that `reach` has for contacts about the middle
    reach = jnp.where(met > 0.0, jnp.clip(edge + 0.6 * beyond, reach, certain), reach)
    if len(spalls) == 1:  # where no land is left, only what sinks past the edges meets the crown
        over = (lands.low[0] <= bottom) & (lands.high[0] >= top)
        bottom, top = jnp.where(over, low, bottom), jnp.where(over, high, top)
    return reach, bottom, top


def depth_at(defects: Defects, offsets: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """Depth below the raceway [mm] at all pairs of `y` and `x`: of the deepest defect there, less the highest rim."""
    deep = high = jnp.zeros((y.shape[0], x.shape[0]))
    for i, each in enumerate(defects):
        if isinstance(each, HeightMap):
            height = height_at(each, offsets[i], x, y)
            deep, high = jnp.maximum(deep, -height), jnp.maximum(high, height)
        else:
            across = jnp.abs(x - offsets[i]) < 0.5 * each.width
            along = jnp.abs(y - each.axial_offset) < 0.5 * each.length
            deep = jnp.maximum(deep, each.depth * (along[:, None] & across[None, :]))
    return deep - high


def domain_of_any(
    contact: LineContact, load: jax.Array, defects: Defects, offsets: jax.Array, tilt: jax.Array | None
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """As `domain`, for surfaces of any shape: slices begin to carry where their gap is least."""
    reach, _, _ = domain(contact, load, (), offsets, tilt)
    half = 0.5 * contact.length
    x = reach * jnp.linspace(-1.5, 1.5, 65)
    y = half * (2.0 * (jnp.arange(256) + 0.5) / 256.0 - 1.0)
    depth = depth_at(defects, offsets, x, y)
    lowest = jnp.min(x[None, :] ** 2 / (2.0 * contact.radius) + depth, axis=1)
    rest = gaps.rest_at(y, contact, tilt)
    needed = needed_by_slices(contact, load)
    weight = jnp.full(y.shape, 2.0 * half / 256.0)
    sunk = carried(needed, weight, rest + lowest, 60)
    healthy = carried(needed, weight, rest, 60)
    delta = jnp.minimum(sunk, healthy + jnp.maximum(jnp.max(lowest), 0.0))
    # a raised rim meets the roller before the raceway does; so does a bottom that is all there is
    return extents(contact, delta - jnp.min(lowest), tilt)


def needed_by_slices(contact: LineContact, load: jax.Array) -> jax.Array:
    """The load in the unit of slices that all have the stiffness of a long line contact [mm²]."""
    half_width = gaps.line_half_width(load / contact.length, contact.radius, contact.modulus)
    return load * (2.0 * jnp.log(2.0 * contact.length / half_width) + 1.0) / (jnp.pi * contact.modulus)  # long cylinder


def edges_along(contact: LineContact, spall: Spall) -> tuple[jax.Array, jax.Array]:
    """Where a spall begins and ends along the roller [mm], not beyond the roller's ends."""
    half = 0.5 * contact.length
    low, high = (jnp.clip(spall.axial_offset + side * 0.5 * spall.length, -half, half) for side in (-1.0, 1.0))
    return low, high


def clear_of_spall(contact: LineContact, spall: Spall, offset: jax.Array, approach: jax.Array) -> jax.Array:
    """Whether a roller over a spall, at this approach [mm], reaches neither its rolling edges nor its bottom."""
    certain = jnp.sqrt(2.0 * contact.radius * approach)  # beyond it the gap exceeds the approach
    return (jnp.abs(offset) + certain <= 0.5 * spall.width) & (approach < spall.depth)


def extents(contact: LineContact, delta: jax.Array, tilt: jax.Array | None) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The domain of a contact whose approach is estimated as `delta` [mm]: see `domain`."""
    half, scale = 0.5 * contact.length, gaps.crown_scale(contact)
    if tilt is None:
        delta = 1.15 * delta
        unloaded = jnp.where(scale > 0.0, jnp.exp(-delta / jnp.where(scale > 0.0, scale, 1.0)), 0.0)
        top = half * jnp.sqrt(1.0 - unloaded)
        bottom = -top
    else:
        least = _least_rest(contact, tilt)
        delta = 1.15 * (delta - least)
        bottom, top = (_reach(contact, delta + least, tilt, side) for side in (-1.0, 1.0))
    certain = jnp.sqrt(2.0 * contact.radius * delta)  # beyond it the gap exceeds the approach
    slenderness = jnp.maximum(2.0 * jnp.log(2.0 * (top - bottom) / certain) + 1.0, 3.0)
    # slices, and a margin for the peaks at spall edges and, where the crown no longer relieves them, at roller ends
    margin = 1.75 + 2.0 * jnp.clip((delta / 100.0 - scale) / (scale + 1e-12 * delta), 0.0, 1.0)
    widest = margin * jnp.sqrt(4.0 * contact.radius * delta / slenderness)
    return jnp.minimum(certain, widest), bottom, top


def _flattest(contact: LineContact, tilt: jax.Array) -> tuple[Real, jax.Array, jax.Array]:
    """Crown scale and rise of a tilted roller from its middle to its end [mm], and where its gap is least, as a share
    of that half."""
    half = 0.5 * contact.length
    scale, rise = gaps.crown_scale(contact), half * tilt
    return scale, rise, -rise / (scale + jnp.sqrt(scale * scale + rise * rise + 1e-30 * half**2))


def _least_rest(contact: LineContact, tilt: jax.Array) -> jax.Array:
    """The least gap of a tilted, crowned roller along its line [mm], at most 0."""
    scale, rise, t = _flattest(contact, tilt)
    return rise * t + scale * gaps.log_crown(t, 1e-15)


def _reach(contact: LineContact, delta: jax.Array, tilt: jax.Array, side: float) -> jax.Array:
    """Where on one `side` the gap of a tilted roller along its line exceeds `delta` [mm]; at most at its end."""
    half = 0.5 * contact.length
    scale, rise, flat = _flattest(contact, tilt)

    def beyond(t: jax.Array) -> tuple[jax.Array, jax.Array]:
        room = jnp.maximum(1.0 - t * t, 1e-15)
        return rise * t - scale * jnp.log(room) - delta, rise + 2.0 * scale * t / room

    found, _ = bisected(lambda t: ~(beyond(t)[0] > 0.0), flat, jnp.asarray(side))
    value, slope = beyond(found)
    free = jnp.abs(found) < 1.0 - 1e-9  # else the roller's end is the end
    step = jnp.where(free, value / jnp.where(free, slope, 1.0), 0.0)
    return half * jnp.where(free, found - step, side)  # one step from the solution carries its derivatives


def _sunk(
    contact: LineContact, needed: jax.Array, low: jax.Array, high: jax.Array, stiffness: jax.Array,
    tilt: jax.Array | None = None, raised: jax.Array | None = None,
) -> jax.Array:  # fmt: skip
    """The approach at which slices carry `needed`: those above `high` and those below `low`, of given stiffnesses, and
    those between that begin `raised` [mm] later, if it is given."""
    half = 0.5 * contact.length
    land = jnp.maximum(jnp.stack([half - high, low + half]), 1e-3 * half)
    start, land, later = jnp.stack([high, low]), land * np.array([1.0, -1.0]), jnp.zeros(2)
    if raised is not None:
        hollow = 0.5 * (high - low) * np.array([1.0, -1.0])  # either half from its end on
        start, land = jnp.append(start, jnp.stack([low, high])), jnp.append(land, hollow)
        stiffness, later = jnp.append(stiffness, jnp.full(2, AT_EDGES)), jnp.append(later, raised * jnp.ones(2))
    return _carried(contact, needed, start, land, stiffness, later, tilt)


class Lands(NamedTuple):
    """Parts of the roller between neighbouring ends of spalls: where they begin and end [mm], shape (parts,), whether a
    spall is there, and which, shape (spalls, parts); and the ends of the spalls themselves [mm], shape (spalls,)."""

    breaks: jax.Array
    covered: jax.Array
    covering: jax.Array
    low: jax.Array
    high: jax.Array


def _beside(contact: LineContact, spalls: tuple[Spall, ...]) -> Lands:
    half = 0.5 * contact.length
    low, high = (jnp.stack(edge) for edge in zip(*(edges_along(contact, spall) for spall in spalls), strict=True))
    breaks = jnp.sort(jnp.concatenate([low, high, jnp.array([-half, half])]))
    middle = 0.5 * (breaks[1:] + breaks[:-1])
    covering = (low[:, None] <= middle[None]) & (middle[None] < high[:, None])
    return Lands(breaks, jnp.any(covering, axis=0), covering, low, high)


def _raised(contact: LineContact, spalls: tuple[Spall, ...], offsets: jax.Array, lands: Lands) -> jax.Array:
    """How much later than without spalls the slices of every part begin to carry [mm], shape (parts,): at the sound
    raceway that is nearest to the middle in the rolling direction, or at the deepest bottom."""
    half = 0.5 * jnp.stack([jnp.asarray(spall.width, float) for spall in spalls])
    places = jnp.concatenate([jnp.zeros(1), offsets - half, offsets + half])
    gone = jnp.abs(places[:, None] - offsets[None]) < half[None] * (1.0 - 1e-9)
    sound = ~jnp.any(gone[:, :, None] & lands.covering[None], axis=1)  # (places, parts)
    own = [jnp.ones((1, lands.covered.size), bool), lands.covering, lands.covering]  # another spall's edge is none here
    sound = sound & jnp.concatenate(own)
    if len(spalls) > 1:  # where edges of two coincide the least of their rises has a kink, which the grid would follow
        places, sound = places[:1], sound[:1]
    depth = jnp.max(jnp.stack([jnp.asarray(spall.depth, float) for spall in spalls]))
    rise = jnp.where(sound, (places**2 / (2.0 * contact.radius))[:, None], jnp.inf)
    return jnp.minimum(jnp.min(rise, axis=0), depth)


def _sunk_beside(
    contact: LineContact, needed: jax.Array, lands: Lands, raised: jax.Array, tilt: jax.Array | None
) -> jax.Array:
    """The approach at which slices beside all the spalls, and those over them, carry `needed`."""
    stiffness = jnp.where(lands.covered, AT_EDGES, 1.0)
    land = jnp.diff(lands.breaks) + 5e-4 * contact.length
    return _carried(contact, needed, lands.breaks[:-1], land, stiffness, raised, tilt)


def _carried(
    contact: LineContact, needed: jax.Array, start: jax.Array, land: jax.Array, stiffness: jax.Array,
    later: jax.Array, tilt: jax.Array | None,
) -> jax.Array:  # fmt: skip
    """The approach at which slices carry `needed`: on each land from `start` on, `land` [mm] long (down, if negative),
    after they have sunk by `later` [mm].

    All shapes (lands,).
    """
    half = 0.5 * contact.length
    s = (jnp.arange(64) + 0.5) / 64.0
    y = start[:, None] + land[:, None] * (s**3)[None, :]
    weight = (stiffness * jnp.abs(land))[:, None] * (3.0 * s**2 / 64.0)[None, :]
    rest = gaps.rest_at(jnp.clip(y, -half * (1.0 - 1e-9), half * (1.0 - 1e-9)), contact, tilt)
    return carried(needed, weight, rest + later[:, None])


def carried(needed: jax.Array, weight: jax.Array, rest: jax.Array, steps: int = 30) -> jax.Array:
    """The approach [mm] at which slices that weigh `weight` [mm] and begin at `rest` [mm] carry `needed` [mm²]."""

    def newton(_: int, delta: jax.Array) -> jax.Array:
        pressed = delta > rest
        held = jnp.sum(jnp.where(pressed, weight * (delta - rest), 0.0))
        slope = jnp.sum(jnp.where(pressed, weight, 0.0))
        return delta - (held - needed) / jnp.maximum(slope, jnp.min(weight))

    begin = needed / jnp.sum(weight) + jnp.max(rest)
    found = jax.lax.stop_gradient(jax.lax.fori_loop(0, steps, newton, begin))
    return newton(0, found)  # one step from the solution carries its derivatives


def reach_of_strips(
    contact: LineContact, load: jax.Array, low: jax.Array, high: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Where loaded strips end along the roller [mm], mean line load [N/mm], its Hertz half-width, an approach [mm].

    `low`, `high`: axial edges of the spall [mm] (both 0 without one). Slices again, on the land at either side; the
    strips need no margin, so each land has the stiffness of a line contact of its own length beside the other one.
    """
    half = 0.5 * contact.length
    scale = jnp.maximum(gaps.crown_scale(contact), 1e-12 * half)

    nearest = jnp.where((low < 0.0) & (high > 0.0), jnp.minimum(high, -low), 0.0)  # of the land to the roller's middle
    lowest = gaps.crown_at(jnp.minimum(nearest, half * (1.0 - 1e-9)), contact)

    def lands(tip: jax.Array) -> jax.Array:
        return jnp.maximum(jnp.stack([tip - high, low + tip]), 1e-3 * half)

    def refine(_: int, state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        length = lands(state[0])
        half_width = gaps.line_half_width(load / jnp.sum(length), contact.radius, contact.modulus)
        apart = [high - low, jnp.sum(length) + high - low, *(length + high - low)]
        whole, both, first, second = (gaps.xlogx(distance) for distance in apart)
        shape = 2.0 * jnp.log(4.0 * length / half_width) - 1.0 + (whole + both - first - second) / length
        needed = load / (jnp.pi * contact.modulus)
        delta = _sunk(contact, needed, low, high, 1.0 / jnp.maximum(shape, 1.0))
        alone = 1.0 - jnp.clip(0.5 * (high - low) / jnp.maximum(state[0], 1e-3 * half), 0.0, 1.0)
        # neighbours lift the surface beyond the tip, too: measured on strips four times as fine
        share = jnp.maximum(1.0 - (1.5 + 0.5 * alone**2) / jnp.max(shape), 0.2)
        tip = half * jnp.sqrt(-jnp.expm1(-(lowest + share * jnp.maximum(delta - lowest, 0.0)) / scale))
        return tip, delta

    tip, delta = jax.lax.fori_loop(0, 3, refine, (jnp.asarray(half), jnp.asarray(0.0)))
    line_load = load / jnp.sum(lands(tip))
    return tip, line_load, jnp.asarray(gaps.line_half_width(line_load, contact.radius, contact.modulus)), delta
