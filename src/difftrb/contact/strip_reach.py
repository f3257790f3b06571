"""How far strips may reach along the roller, the units they are solved in, and what they can describe."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import crown, slices
from difftrb.contact import gap as gaps
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.hollows import Beneath, hollows_of, of_one, of_several
from difftrb.contact.slices import Line, Slices
from difftrb.contact.strip_plan import LEAST_ROWS
from difftrb.contact.strip_rows import Rows
from difftrb.core import arrays as xp

REACHED = 2.75  # where the raceway may still be touched, in the unit of length: strips end at FARTHEST
LEAST_LAND = 4.0  # loaded length by the unit of length; shorter ones were not compared with lattices
ABOVE = 1.1  # by its estimate, so large an approach may be
MARGIN = 0.15  # by which rows go on beyond slices, by what is left of the approach there
NEARLY = 0.5 * (1.0 - 1e-9)  # of the roller's length from its middle to its end, where its crown is infinite
OUT_OF_REACH = 10.0  # by the roller's length: where an edge is that does not count
RIDGE = 1.0  # least length of land between spalls, in the unit of length
LEAST_CROWN = 1e-3  # crown's scale by approach: below, a roller's end acts as an edge, which the strips do not have


class Reach(NamedTuple):
    """Where rows begin and end along the roller [mm]; the units, which are a line load [N/mm] and its Hertz half-width
    [mm]: the mean one or, with edges in reach, more if the contact reaches so far; an estimate of the approach, the
    length of the loaded land [mm], and the slices that tell all this."""

    bottom: Any
    top: Any
    line_load: Any
    unit: Any
    approach: Any
    land: Any
    slices: Slices


class Verdict(NamedTuple):
    """What is beneath a contact; whether strips can be expected to describe it but for the spalls' ends, and whether
    these are within where it matters (`ends_within`)."""

    beneath: Beneath
    fits: Any
    within: Any


def judged(inputs: Inputs, mirrored: bool) -> Verdict:
    """Whether strips are for this contact. Several spalls must be numbers."""
    if isinstance(inputs.spall, tuple):
        return _judged_several(inputs, mirrored)
    without = of_one(inputs, 0)
    reach = xp.fixed(reach_of(inputs, without, mirrored))
    fits = suited(inputs, reach, reach.approach, without)
    if inputs.spall is None:
        return Verdict(without, fits, np.asarray(True))
    certain = gaps.certain_reach(inputs.contact.radius, ABOVE * interference(inputs, reach.approach))
    (hollow,) = hollows_of(inputs, without)
    far = hollow.right - hollow.left - hollow.edge
    edges = xp.where(hollow.edge < certain, 1, 0) + xp.where(far < certain, 1, 0)
    return Verdict(of_one(inputs, edges), fits, (edges == 0) | ends_within(inputs, reach, without))


def _judged_several(inputs: Inputs, mirrored: bool) -> Verdict:
    """The same of several: as if a contact reached all of them, and then of those that it reaches."""
    every = of_several(inputs, np.inf)
    reach = xp.fixed(reach_of(inputs, every._replace(edges=0), mirrored))
    certain = gaps.certain_reach(inputs.contact.radius, ABOVE * interference(inputs, reach.approach))
    met = of_several(inputs, certain)
    if met.hollows != every.hollows:
        reach = xp.fixed(reach_of(inputs, met._replace(edges=0), mirrored))
    within = (met.edges == 0) | ends_within(inputs, reach, met)
    return Verdict(met, suited(inputs, reach, reach.approach, met), within)


def suited(inputs: Inputs, reach: Reach, approach: Any, beneath: Beneath) -> Any:
    """Whether strips can describe a contact of so large an approach [mm]."""
    deepest = interference(inputs, approach)
    fits = crown.scale(inputs.contact) > LEAST_CROWN * deepest
    fits = fits & (reach.land > LEAST_LAND * reach.unit)
    hollows = hollows_of(inputs, beneath)
    for hollow in hollows:
        fits = fits & (hollow.depth > deepest)
    for before, after in itertools.pairwise(hollows):
        fits = fits & (after.low - before.high > RIDGE * reach.unit)
    return fits & beneath.described


def interference(inputs: Inputs, approach: Any) -> Any:
    """By how much the undeformed bodies overlap at most [mm]."""
    return approach if inputs.tilt is None else approach - crown.least_rest(inputs.contact, inputs.tilt)


def ends_within(inputs: Inputs, reach: Reach, beneath: Beneath) -> Any:
    """Whether every spall ends within the loaded part of the roller, at both ends: one that goes on to the roller's end
    leaves land beside it whose end is free, which strips do not know; they are off by up to 5e-3 of the approach."""
    within = np.asarray(True)
    for hollow in hollows_of(inputs, beneath):
        within = within & (hollow.high < reach.top - reach.unit) & (hollow.low > reach.unit + reach.bottom)
    return within


def reach_of(inputs: Inputs, beneath: Beneath, mirrored: bool) -> Reach:
    """By slices; `mirrored` is a roller that is alike on both sides of its middle."""
    line = _line(inputs, beneath, mirrored)
    return _reach(inputs, beneath, line, slices.pressed(line, _needed(inputs, mirrored)))


def reach_near(reach: Reach, inputs: Inputs, beneath: Beneath, mirrored: bool) -> Reach:
    """The same to first order in a change of the inputs it was found for."""
    line = _line(inputs, beneath, mirrored)
    return _reach(inputs, beneath, line, slices.near(reach.slices, line, _needed(inputs, mirrored)))


def _reach(inputs: Inputs, beneath: Beneath, line: Line, found: Slices) -> Reach:
    """Rows go on beyond slices by a part of what is left of the approach there. They go on to land beyond a spall that
    slices do not load, too, for it may touch with its corner."""
    contact = inputs.contact
    unit = gaps.line_half_width(np.pi * contact.modulus * found.mean, contact.radius, contact.modulus)
    if beneath.edges:  # far beyond the half-width, where a light load sinks a roller over a long spall, they count
        unit = xp.maximum(unit, gaps.certain_reach(contact.radius, interference(inputs, found.approach)) / REACHED)
    line_load = gaps.line_load_at(unit, contact.radius, contact.modulus)
    hollows = hollows_of(inputs, beneath)
    ends = (hollows[0].low, hollows[-1].high) if hollows else (0.0, 0.0)
    tips = [slices.tip(found, side, line) for side in (-1.0, 1.0)]
    bottom, top = (_row_end(inputs, found.approach, *side) for side in zip(tips, ends, (-1.0, 1.0), strict=True))
    land = tips[1] - tips[0]
    for hollow in hollows:
        land = land - (xp.clip(hollow.high, *tips) - xp.clip(hollow.low, *tips))
    return Reach(bottom, top, line_load, unit, found.approach, land, found)


def _line(inputs: Inputs, beneath: Beneath, mirrored: bool) -> Line:
    """What slices are pressed on."""
    hollows = hollows_of(inputs, beneath)
    if not beneath.edges:
        far = OUT_OF_REACH * inputs.contact.length
        hollows = tuple(hollow._replace(left=-far, right=far) for hollow in hollows)
    return Line(inputs.contact, hollows, inputs.tilt, mirrored)


def _needed(inputs: Inputs, mirrored: bool) -> Any:
    """The load of the slices by πE' [mm²]."""
    return (0.5 if mirrored else 1.0) * inputs.load / (np.pi * inputs.contact.modulus)


def _row_end(inputs: Inputs, approach: Any, tip: Any, end: Any, side: float) -> Any:
    """Where rows end on one `side` [mm], where slices do at `tip` and the last spall at `end`."""
    contact, tilt = inputs.contact, inputs.tilt
    most = NEARLY * contact.length
    reached = side * xp.clip(xp.maximum(side * tip, side * end), -most, most)
    level = gaps.rest_at(reached, contact, tilt)
    farther = crown.reached(contact, level + MARGIN * (approach - level), tilt, side)
    return xp.where(level < approach, farther, tip)


def on_missing_land(groups: tuple[Rows, ...], over: tuple[int, ...], ends: tuple[Any, ...]) -> Any:
    """Which rows stand for land of which a spall leaves none, or which lies beyond the contact, shape (rows,); `over`
    hollows are these groups; `ends` of the hollows and of the rows."""
    *borders, bottom, top = xp.fixed(ends)
    least, every = 0.5 * LEAST_ROWS * (top - bottom), [bottom, *borders, top]
    lands = zip(every[::2], every[1::2], strict=True)
    missing = [xp.minimum(end, top) - xp.maximum(start, bottom) < least for start, end in lands]
    of_land = iter(missing[len(over) - len(groups) :])  # half a roller has its upper land alone
    flags = [np.asarray(False) if i in over else next(of_land) for i in range(len(groups))]
    return xp.concatenate([flag & np.ones(group.count, bool) for flag, group in zip(flags, groups, strict=True)])
