"""How far strips may reach along the roller, the units they are solved in, and what they can describe."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from difftrb.contact import contact_extent, crown
from difftrb.contact import gap as gaps
from difftrb.contact.contact_extent import ends_along
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.strip_plan import LEAST_ROWS
from difftrb.contact.strip_rows import Rows
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact

REACHED = 2.75  # where the raceway may still be touched, in the unit of length: strips end at FARTHEST
LEAST_LAND = 20.0  # loaded length in Hertz half-widths: below, it is no line contact, and rows are no longer than wide
ABOVE = 1.1  # by its estimate, so large an approach may be
FAR_ENDS = 0.75, 0.95  # of a spall by the contact's tip: from here on strips go farther than that
FARTHER = 0.05, 0.3  # if it ends there by so much farther from the middle than on the other side, by the tip
ALONE = 0.15  # and by what share of that on the other side
CLEAR = 100.0  # by the approach, the gap of rows on land that a spall leaves none of
LEAST_CROWN = 1e-3  # crown's scale by approach: below, a roller's end acts as an edge, which the strips do not have


class Reach(NamedTuple):
    """Where rows begin and end along the roller [mm]; mean line load [N/mm] and its Hertz half-width [mm], the units;
    an estimate of the approach [mm]; and where contact would end without what strips go farther for [mm]."""

    bottom: Any
    top: Any
    line_load: Any
    unit: Any
    approach: Any
    tip: Any


def edges_and_suitability(inputs: Inputs) -> tuple[Any, Any, Any]:
    """How many rolling edges of the spall may be in reach of the contact, 0…2, whether strips can be expected to
    describe it but for the spall's ends, and whether these are within where it matters (`ends_within`)."""
    contact, spall = inputs.contact, cast(Any, inputs.spall)
    reach = xp.fixed(reach_of(inputs, 0))
    fits = suited(inputs, reach, reach.approach)
    if spall is None:
        return np.asarray(0), fits, np.asarray(True)
    certain = gaps.certain_reach(contact.radius, ABOVE * interference(inputs, reach.approach))
    near, far = 0.5 * spall.width - xp.abs(inputs.offset), 0.5 * spall.width + xp.abs(inputs.offset)
    edges = xp.where(near < certain, 1, 0) + xp.where(far < certain, 1, 0)
    return edges, fits, (edges == 0) | ends_within(inputs, reach)


def suited(inputs: Inputs, reach: Reach, approach: Any) -> Any:
    """Whether strips can describe a contact of so large an approach [mm]."""
    contact, spall = inputs.contact, cast(Any, inputs.spall)
    low, high = ends_along(inputs.contact, inputs.spall)
    land = (
        2.0 * reach.tip - (xp.clip(high, reach.bottom, reach.top) - xp.clip(low, reach.bottom, reach.top))
    ) / reach.unit
    fits = (crown.scale(contact) > LEAST_CROWN * interference(inputs, approach)) & (land > LEAST_LAND)
    return fits if spall is None else fits & (spall.depth > interference(inputs, approach))


def interference(inputs: Inputs, approach: Any) -> Any:
    """By how much the undeformed bodies overlap at most [mm]."""
    return approach if inputs.tilt is None else approach - crown.least_rest(inputs.contact, inputs.tilt)


def ends_within(inputs: Inputs, reach: Reach) -> Any:
    """Whether a spall ends within the loaded part of the roller, at both ends: where it goes on to the roller's end,
    what stands on its rolling edge ends freely, and strips over a spall do not, by up to 5e-3 of the approach."""
    low, high = ends_along(inputs.contact, inputs.spall)
    return (high < reach.top - reach.unit) & (low > reach.unit + reach.bottom)


def reach_of(inputs: Inputs, edges: int) -> Reach:
    """By slices with the stiffness of a line contact of each land's length: see `contact_extent.reach_of_strips`.

    A tilted roller's slices begin to carry where its gap is least.
    """
    contact, load, spall, offset, tilt = inputs
    offset = xp.abs(offset) if edges == 1 else offset
    low, high = ends_along(inputs.contact, inputs.spall)
    tip, line_load, unit, approach = _level_reach(contact, load, spall, offset, edges)
    if tilt is None:
        ends = [_tip(contact, tip, approach, end, other) for end, other in ((-low, high), (high, -low))]
        return Reach(-ends[0], ends[1], line_load, unit, approach, tip)
    half = 0.5 * contact.length
    stiff = xp.maximum(2.0 * xp.log(4.0 * (2.0 * tip - high + low) / unit) - 1.0, 1.0)
    needed = load / (np.pi * contact.modulus)
    sunk = contact_extent.sinking(contact, needed, low, high, np.ones(2) / stiff, tilt)
    least = crown.least_rest(contact, tilt)
    share = xp.maximum(1.0 - 1.5 / stiff, 0.2)
    level = least + share * (sunk - least)
    bottom, top = (crown.crossing(contact, level, tilt, side) for side in (-1.0, 1.0))
    line_load = load / xp.maximum(top - bottom - (high - low), 0.05 * half)
    unit = gaps.line_half_width(line_load, contact.radius, contact.modulus)
    return Reach(bottom, top, line_load, unit, sunk, 0.5 * (top - bottom))


def _level_reach(contact: LineContact, load: Any, spall: Any, offset: Any, edges: int) -> tuple[Any, Any, Any, Any]:
    """`reach_of_strips`; with rolling edges in reach, between those with and without the spall, by the share of the
    pressure that it takes."""
    reach = contact_extent.reach_of_strips(contact, load, *ends_along(contact, spall))
    if spall is None or not edges:
        return reach
    healthy = contact_extent.reach_of_strips(contact, load, 0.0 * load, 0.0 * load)
    ends = [xp.clip((offset + side * spall.width) / reach[2], -1.0, 1.0) for side in (-0.5, 0.5)]
    below = [(xp.arcsin(end) + end * xp.sqrt(1.0 - end * end)) / np.pi for end in ends]  # of half an ellipse
    taken = below[1] - below[0]
    taken = 0.5 * (taken**2 + taken**8)  # what is left of a strip is nearly as stiff until little is left
    tip, line_load, _, approach = (taken * a + (1.0 - taken) * b for a, b in zip(reach, healthy, strict=True))
    # a light load sinks a roller over a long spall through its crown: then edges far beyond the half-width are in reach
    farthest = gaps.certain_reach(contact.radius, reach[3]) / REACHED
    unit = xp.maximum(gaps.line_half_width(line_load, contact.radius, contact.modulus), farthest)
    return tip, gaps.line_load_at(unit, contact.radius, contact.modulus), unit, approach


def _tip(contact: LineContact, tip: Any, estimate: Any, end: Any, other: Any) -> Any:
    """Where strips end on one side of the roller [mm], where the spall ends at `end` on this, at `other` on the other
    side: at the contact's `tip` or, where little or nothing is left before it, where the gap exceeds the approach, for
    land may touch with its corner alone. The land that then carries alone reaches farther, too.
    """
    scale = crown.scale(contact)
    deepest = ABOVE * estimate / xp.where(scale > 0.0, scale, 1.0)
    farthest = xp.maximum(crown.half_length(xp.where(scale > 0.0, deepest, 100.0), contact), tip)

    def grown(start: float, full: float, value: Any) -> Any:
        share = xp.clip((value / tip - start) / (full - start), 0.0, 1.0)
        return (3.0 - 2.0 * share) * share**2

    here, there = (grown(*FAR_ENDS, one) * grown(*FARTHER, one - two) for one, two in ((end, other), (other, end)))
    return tip + xp.maximum(here, ALONE * there) * (farthest - tip)


def carried_along(reach: Reach, inputs: Inputs, edges: int) -> Reach:
    """The same reach, with about its derivatives by the inputs: half-widths like those of a line contact on the land
    that there is (of the whole roller, if it may stand beyond a rolling edge), and ends where the gap has grown like
    the approach."""
    contact, load, *_, tilt = inputs
    low, high = (0.0, 0.0) if edges else ends_along(inputs.contact, inputs.spall)
    land = xp.maximum(reach.top - reach.bottom - (high - low), 0.02 * contact.length)
    line_load, bent, modulus = (
        x / xp.fixed(x) for x in (load / (contact.modulus * land), contact.radius, contact.modulus)
    )  # all of them 1
    frozen, still = xp.fixed((contact, tilt))
    most = 0.5 * frozen.length * (1.0 - 1e-9)

    def end(y: Any) -> Any:
        within = xp.clip(y, -most, most)
        rest, slope = gaps.rest_at(within, frozen, still), gaps.rest_slope(within, frozen, still)
        return y + (rest * line_load - gaps.rest_at(within, contact, tilt)) / slope

    return reach._replace(
        bottom=end(reach.bottom),
        top=end(reach.top),
        line_load=reach.line_load * modulus * line_load,
        unit=reach.unit * xp.sqrt(line_load * bent),
    )


def missing_land_clearance(groups: tuple[Rows, ...], ends: tuple[Any, ...]) -> Any:
    """By how much, in approaches, rows are clear that stand for land of which a spall leaves none, shape (rows,);
    `ends` of the spall and of the rows."""
    low, high, bottom, top = xp.fixed(ends)
    left = {"high": low - bottom, "low": top - high}  # land below a spall ends with its high end
    least = 0.5 * LEAST_ROWS * (top - bottom)

    def clear(group: Rows) -> Any:
        land = group.edge in left and not group.middle
        return xp.where(left[group.edge] < least, CLEAR, 0.0) if land else 0.0

    return xp.concatenate([clear(group) * np.ones(group.count) for group in groups])
