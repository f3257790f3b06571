"""How far strips may reach along the roller, the units they are solved in, and what they can describe."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from difftrb.contact import crown, slices
from difftrb.contact import gap as gaps
from difftrb.contact.contact_extent import ends_along
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.slices import Slices
from difftrb.contact.strip_plan import LEAST_ROWS
from difftrb.contact.strip_rows import Rows
from difftrb.core import arrays as xp

REACHED = 2.75  # where the raceway may still be touched, in the unit of length: strips end at FARTHEST
LEAST_LAND = 4.0  # loaded length in Hertz half-widths that was compared with lattices: rows no longer than wide
ABOVE = 1.1  # by its estimate, so large an approach may be
MARGIN = 0.15  # by which rows go on beyond slices, by what is left of the approach there
NEARLY = 0.5 * (1.0 - 1e-9)  # of the roller's length from its middle to its end, where its crown is infinite
FAR = 10.0  # by the roller's length: where an edge is that does not count
CLEAR = 100.0  # by the approach, the gap of rows on land that a spall leaves none of
LEAST_CROWN = 1e-3  # crown's scale by approach: below, a roller's end acts as an edge, which the strips do not have


class Reach(NamedTuple):
    """Where rows begin and end along the roller [mm]; mean line load [N/mm] and its Hertz half-width [mm], the units;
    an estimate of the approach, the length of the loaded land [mm], and the slices that tell all this."""

    bottom: Any
    top: Any
    line_load: Any
    unit: Any
    approach: Any
    land: Any
    slices: Slices


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
    fits = crown.scale(contact) > LEAST_CROWN * interference(inputs, approach)
    fits = fits & (reach.land > LEAST_LAND * reach.unit)
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
    """By slices."""
    return _reach(inputs, edges, slices.pressed(*_on_land(inputs, edges)))


def reach_near(reach: Reach, inputs: Inputs, edges: int) -> Reach:
    """The same to first order in a change of the inputs it was found for."""
    return _reach(inputs, edges, slices.near(reach.slices, *_on_land(inputs, edges)))


def _reach(inputs: Inputs, edges: int, found: Slices) -> Reach:
    """Rows go on beyond slices by a part of what is left of the approach there. They go on to land beyond a spall that
    slices do not load, too, for it may touch with its corner."""
    contact = inputs.contact
    unit = gaps.line_half_width(np.pi * contact.modulus * found.mean, contact.radius, contact.modulus)
    if edges:  # a light load sinks a roller over a long spall through its crown: edges far beyond the half-width count
        unit = xp.maximum(unit, gaps.certain_reach(contact.radius, found.approach) / REACHED)
    line_load = gaps.line_load_at(unit, contact.radius, contact.modulus)
    spall = ends_along(contact, inputs.spall)
    tips = [slices.tip(found, side) for side in (-1.0, 1.0)]
    bottom, top = (_row_end(inputs, found.approach, *side) for side in zip(tips, spall, (-1.0, 1.0), strict=True))
    low, high = (xp.clip(end, *tips) for end in spall)
    return Reach(bottom, top, line_load, unit, found.approach, tips[1] - tips[0] - (high - low), found)


def _on_land(inputs: Inputs, edges: int) -> tuple[Any, ...]:
    """What `slices.pressed` is asked."""
    contact, load, _, offset, tilt = inputs
    spall = cast(Any, inputs.spall)
    edge = 0.5 * spall.width - xp.magnitude(offset) if spall is not None and edges else FAR * contact.length
    return contact, load / (np.pi * contact.modulus), *ends_along(contact, inputs.spall), edge, tilt


def _row_end(inputs: Inputs, approach: Any, tip: Any, end: Any, side: float) -> Any:
    """Where rows end on one `side` [mm], where slices do at `tip` and the spall at `end`."""
    contact, tilt = inputs.contact, inputs.tilt
    most = NEARLY * contact.length
    reached = side * xp.clip(xp.maximum(side * tip, side * end), -most, most)
    level = gaps.rest_at(reached, contact, tilt)
    beyond = level + MARGIN * (approach - level)
    if tilt is not None:
        farther = crown.crossing(contact, beyond, tilt, side)
    else:
        scale = crown.scale(contact)
        crowned = scale > 0.0
        steepness = xp.where(crowned, beyond / xp.where(crowned, scale, 1.0), 100.0)
        farther = side * crown.half_length(steepness, contact)
    return xp.where(level < approach, farther, tip)


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
