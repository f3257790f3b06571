"""Where pressure can be: an upper estimate of the approach, and how far the contact reaches with it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import crown
from difftrb.contact import gap as gaps
from difftrb.contact.height_map import HeightMap, height_at
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Spall

Defects = tuple[Spall | HeightMap, ...]
ESTIMATE = 1.15
"""Factor on the estimated approach: no contact sinks deeper."""
ACROSS = 257
"""Places in the rolling direction at which a surface of any shape is looked at; where rims may reach too far out for
these to see them, pressure at the border says so."""
BESIDE = 0.75
"""What part of the way that the roller overlaps the raceway beside a hole its contact there may take."""
AT_EDGES = 0.7
"""Stiffness of a slice that stands on a spall's rolling edge, by that of one on healthy raceway: at least."""
LEAST_RIDGE = 0.02
"""Narrowest ridge between spalls under the roller's middle that slices count as land, by the contact's half width:
cells leave narrower ones out, and the roller sinks beside them."""


def domain(
    contact: LineContact, load: Any, spalls: tuple[Spall, ...], offsets: Any, tilt: Any | None = None
) -> tuple[Any, Any, Any]:
    """Half extent of the solution domain in x, its ends in y [mm]: where the gap is less than an upper estimate of δ.

    The estimate is a foundation of independent slices, each with the stiffness of a long line contact, of which those
    over a spall begin to carry at the raceway that is left beside it, or at its bottom. Extents are differentiated like
    everything else: the grid breathes with the contact, so the free boundary keeps its place among the cells and
    derivatives by load and radius do not ripple. `offsets` of the spalls, shape (spalls,).
    """
    needed = needed_by_slices(contact, load)
    zero = np.zeros(())
    delta = sinking(contact, needed, zero, zero, np.ones(2), tilt)
    if not spalls:
        return extents(contact, delta, tilt)
    lands = _beside(contact, spalls)
    narrow = 0.0 if len(spalls) == 1 else LEAST_RIDGE * xp.fixed(extents(contact, delta, tilt)[0])
    raised = _raised(contact, spalls, offsets, lands, narrow)
    depth = xp.largest(xp.stack([spall.depth for spall in spalls]))
    if len(spalls) == 1:
        sunk = sinking(contact, needed, lands.low[0], lands.high[0], np.ones(2), tilt, raised[1])
    else:
        sunk = _sunk_beside(contact, needed, lands, raised, tilt)
    delta = xp.minimum(sunk, delta + depth)  # at most down to its bottom
    reach, bottom, top = extents(contact, delta, tilt)
    interference = delta if tilt is None else delta - crown.least_rest(contact, tilt)
    met = xp.largest(xp.where(lands.covered & (raised < interference), raised, 0.0))  # by a slice over a spall
    beyond, low, high = extents(contact, delta - xp.minimum(met, 0.999 * interference), tilt)
    certain = gaps.certain_reach(contact.radius, ESTIMATE * interference)
    edge = gaps.certain_reach(contact.radius, xp.where(met > 0.0, met, 1.0))
    # `beyond` holds the margin of `extents`, at least 1.75; of it 1.05 is enough beside an edge
    reach = xp.where(met > 0.0, xp.clip(edge + 0.6 * beyond, reach, certain), reach)
    if len(spalls) == 1:  # where no land is left, only what sinks past the edges meets the crown
        over = (lands.low[0] <= bottom) & (lands.high[0] >= top)
        bottom, top = xp.where(over, low, bottom), xp.where(over, high, top)
    return reach, bottom, top


def depth_at(defects: Defects, offsets: Any, x: Any, y: Any) -> Any:
    """Depth below the raceway [mm] at all pairs of `y` and `x`: of the deepest defect there, less the highest rim."""
    deep = high = xp.zeros((y.shape[0], x.shape[0]))
    for i, each in enumerate(defects):
        if isinstance(each, HeightMap):
            height = height_at(each, offsets[i], x, y)
            deep, high = xp.maximum(deep, -height), xp.maximum(high, height)
        else:
            across = xp.abs(x - offsets[i]) < 0.5 * each.width
            along = xp.abs(y - each.axial_offset) < 0.5 * each.length
            deep = xp.maximum(deep, each.depth * (along[:, None] & across[None, :]))
    return deep - high


def domain_of_any(
    contact: LineContact, load: Any, defects: Defects, offsets: Any, tilt: Any | None
) -> tuple[Any, Any, Any]:
    """As `domain`, for surfaces of any shape: slices begin to carry where their gap is least."""
    reach, _, _ = domain(contact, load, (), offsets, tilt)
    half = 0.5 * contact.length
    uneven = xp.max(xp.stack([_unevenness(each) for each in defects]))  # by so much it may stand aside
    beyond = gaps.certain_reach(contact.radius, xp.where(uneven > 0.0, uneven, 1.0))
    x = xp.maximum(1.5 * reach, reach + xp.where(uneven > 0.0, beyond, 0.0)) * xp.linspace(-1.0, 1.0, ACROSS)
    y = half * (2.0 * (xp.arange(256) + 0.5) / 256.0 - 1.0)
    depth = depth_at(defects, offsets, x, y)
    surface = x[None, :] ** 2 / (2.0 * contact.radius) + depth
    lowest = xp.min(surface, axis=1)
    rest = gaps.rest_at(y, contact, tilt)
    needed = needed_by_slices(contact, load)
    weight = xp.full(y.shape, 2.0 * half / 256.0)
    sunk = approach_of_slices(needed, weight, rest + lowest)
    healthy = approach_of_slices(needed, weight, rest)
    delta = xp.minimum(sunk, healthy + xp.maximum(xp.max(lowest), 0.0))
    # a raised rim meets the roller before the raceway does; so does a bottom that is all there is
    least = xp.min(lowest)
    widest, bottom, top = extents(contact, delta - least, tilt)
    # a slice that first meets a rim, or land beside a hole, does so aside, and reaches on from there
    places = xp.broadcast_to(xp.abs(x)[None, :], surface.shape)
    met = surface + rest[:, None] < least + ESTIMATE * (delta - least)
    aside = xp.min(xp.where(surface <= lowest[:, None], places, np.inf), axis=1)
    beyond = BESIDE * (xp.max(xp.where(met, places, 0.0), axis=1) - aside)
    step = x[1] - x[0]
    reached = xp.where(xp.any(met, axis=1) & (aside > step), aside + xp.maximum(beyond, 0.0) + 2.0 * step, 0.0)
    return xp.maximum(widest, xp.max(reached)), bottom, top


def _unevenness(defect: Spall | HeightMap) -> Any:
    """From the lowest to the highest point of a surface with one defect [mm]."""
    if isinstance(defect, Spall):
        return xp.asarray(defect.depth)
    height = defect.scale * defect.height
    return xp.maximum(height.max(), 0.0) - xp.minimum(height.min(), 0.0)


def needed_by_slices(contact: LineContact, load: Any) -> Any:
    """The load in the unit of slices that all have the stiffness of a long line contact [mm²]."""
    half_width = gaps.line_half_width(load / contact.length, contact.radius, contact.modulus)
    return load * (2.0 * xp.log(2.0 * contact.length / half_width) + 1.0) / (np.pi * contact.modulus)  # long cylinder


def ends_along(contact: LineContact, spall: Any) -> tuple[Any, Any]:
    """Where a spall begins and ends along the roller [mm], not beyond the roller's ends; both 0 for None."""
    if spall is None:
        return 0.0, 0.0
    half = 0.5 * contact.length
    low, high = (xp.within(end, -half, half) for end in spall.ends)
    return low, high


def clear_of_spall(contact: LineContact, spall: Spall, offset: Any, approach: Any) -> Any:
    """Whether a roller over a spall, at this approach [mm], reaches neither its rolling edges nor its bottom."""
    certain = gaps.certain_reach(contact.radius, approach)
    return (xp.abs(offset) + certain <= 0.5 * spall.width) & (approach < spall.depth)


def extents(contact: LineContact, delta: Any, tilt: Any | None) -> tuple[Any, Any, Any]:
    """The domain of a contact whose approach is estimated as `delta` [mm]: see `domain`."""
    scale = crown.scale(contact)
    least = 0.0 if tilt is None else crown.least_rest(contact, tilt)
    delta = ESTIMATE * (delta - least)
    bottom, top = (crown.reached(contact, delta + least, tilt, side) for side in (-1.0, 1.0))
    certain = gaps.certain_reach(contact.radius, delta)
    slenderness = xp.maximum(2.0 * xp.log(2.0 * (top - bottom) / certain) + 1.0, 3.0)
    # slices, and a margin for the peaks at spall edges and, where the crown no longer relieves them, at roller ends
    margin = 1.75 + 2.0 * xp.clip((delta / 100.0 - scale) / (scale + 1e-12 * delta), 0.0, 1.0)
    widest = margin * xp.sqrt(4.0 * contact.radius * delta / slenderness)
    return xp.minimum(certain, widest), bottom, top


def sinking(
    contact: LineContact, needed: Any, low: Any, high: Any, stiffness: Any,
    tilt: Any | None = None, raised: Any | None = None,
) -> Any:  # fmt: skip
    """The approach at which slices carry `needed`: those above `high` and those below `low`, of given stiffnesses, and
    those between that begin `raised` [mm] later, if it is given."""
    half = 0.5 * contact.length
    land = xp.maximum(xp.stack([half - high, low + half]), 1e-3 * half)
    start, land, later = xp.stack([high, low]), land * np.array([1.0, -1.0]), np.zeros(2)
    if raised is not None:
        hollow = 0.5 * (high - low) * np.array([1.0, -1.0])  # either half from its end on
        start, land = xp.concatenate([start, xp.stack([low, high])]), xp.concatenate([land, hollow])
        stiffness = xp.concatenate([stiffness, np.full(2, AT_EDGES)])
        later = xp.concatenate([later, raised * np.ones(2)])
    return _approach_on_lands(contact, needed, start, land, stiffness, later, tilt)


class Lands(NamedTuple):
    """Parts of the roller between neighbouring ends of spalls: where they begin and end [mm], shape (parts,), whether a
    spall is there, and which, shape (spalls, parts); and the ends of the spalls themselves [mm], shape (spalls,)."""

    breaks: Any
    covered: Any
    covering: Any
    low: Any
    high: Any


def _beside(contact: LineContact, spalls: tuple[Spall, ...]) -> Lands:
    half = 0.5 * contact.length
    low, high = (xp.stack(edge) for edge in zip(*(ends_along(contact, spall) for spall in spalls), strict=True))
    breaks = xp.concatenate([low, high, xp.stack([-half, half])])
    breaks = breaks[xp.argsort(xp.fixed(breaks))]
    middle = 0.5 * (breaks[1:] + breaks[:-1])
    covering = (low[:, None] <= middle[None]) & (middle[None] < high[:, None])
    return Lands(breaks, xp.any(covering, axis=0), covering, low, high)


def _raised(contact: LineContact, spalls: tuple[Spall, ...], offsets: Any, lands: Lands, narrow: Any) -> Any:
    """How much later than without spalls the slices of every part begin to carry [mm], shape (parts,): at the healthy
    raceway that is nearest to the middle in the rolling direction, or at the deepest bottom. Between several spalls
    `narrow` ridges [mm] carry nothing."""
    half = 0.5 * xp.stack([spall.width for spall in spalls])
    depth = xp.largest(xp.stack([spall.depth for spall in spalls]))
    # where edges of two coincide the least of their rises has a kink, which the grid would follow
    middle_alone = len(spalls) > 1
    places = narrow * np.array([-0.5, 0.5])
    if not middle_alone:
        places = xp.concatenate([np.zeros(1), offsets - half, offsets + half])
    over = xp.magnitude(places[:, None] - offsets[None]) < half[None] * (1.0 - 1e-9)
    healthy = ~xp.any(over[:, :, None] & lands.covering[None], axis=1)  # (places, parts)
    if middle_alone:
        return xp.minimum(xp.where(xp.any(healthy, axis=0), 0.0, np.inf), depth)
    own = [np.ones((1, lands.covered.size), bool), lands.covering, lands.covering]  # another spall's edge is none here
    rise = xp.where(healthy & xp.concatenate(own), (places**2 / (2.0 * contact.radius))[:, None], np.inf)
    return xp.minimum(-xp.largest(-rise), depth)


def _sunk_beside(contact: LineContact, needed: Any, lands: Lands, raised: Any, tilt: Any | None) -> Any:
    """The approach at which slices beside all the spalls, and those over them, carry `needed`."""
    stiffness = xp.where(lands.covered, AT_EDGES, 1.0)
    land = xp.diff(lands.breaks) + 5e-4 * contact.length
    return _approach_on_lands(contact, needed, lands.breaks[:-1], land, stiffness, raised, tilt)


def _approach_on_lands(
    contact: LineContact, needed: Any, start: Any, land: Any, stiffness: Any,
    later: Any, tilt: Any | None,
) -> Any:  # fmt: skip
    """The approach at which slices carry `needed`: on each land from `start` on, `land` [mm] long (down, if negative),
    after they have sunk by `later` [mm].

    All shapes (lands,).
    """
    half = 0.5 * contact.length
    s = (xp.arange(64) + 0.5) / 64.0
    y = start[:, None] + land[:, None] * (s**3)[None, :]
    weight = (stiffness * xp.magnitude(land))[:, None] * (3.0 * s**2 / 64.0)[None, :]
    rest = gaps.rest_at(xp.clip(y, -half * (1.0 - 1e-9), half * (1.0 - 1e-9)), contact, tilt)
    return approach_of_slices(needed, weight, rest + later[:, None])


def approach_of_slices(needed: Any, weight: Any, rest: Any) -> Any:
    """The approach [mm] at which slices that weigh `weight` [mm] and begin at `rest` [mm] carry `needed` [mm²]."""

    def carried_by(pressed: Any, needed: Any, weight: Any, rest: Any) -> Any:
        own = xp.where(pressed, weight, 0.0)
        return (needed + xp.total(own * rest)) / xp.total(own)

    weight, rest = weight.reshape(-1), rest.reshape(-1)
    still = xp.fixed((needed, weight, rest))
    first = xp.argsort(still[2])
    sizes, begun = still[1][first], still[2][first]
    # slices that begin later would pull: of the first ones, however many, the approach is the least
    least = xp.min((still[0] + xp.cumsum(sizes * begun)) / xp.cumsum(sizes))
    return carried_by(still[2] < least, needed, weight, rest)
