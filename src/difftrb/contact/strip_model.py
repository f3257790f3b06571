"""One roller on one raceway as strips: which parts carry load, then smooth pressure between the free boundaries.

Across every row pressure is first a sum of a few non-negative bands (`strip_bands`), which tells what is loaded and
about where it ends, then a sum of smooth modes (`strip_settling`) whose boundaries move to where they belong.

The approach is the load's multiplier and stationary in the boundaries: derivatives by all inputs are those of one
bilinear form at what was found. Lengths are in Hertz half-widths, line loads in units of their mean, so that radius
and modulus drop out. All of it is by numpy for numbers, by JAX for what is traced.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from difftrb.contact import gap as gaps
from difftrb.contact import strip_bands, strip_kernel, strip_plan, strip_rows, strip_settling
from difftrb.contact.contact_solution import Found, Inputs, verdict
from difftrb.contact.gap import Cells
from difftrb.contact.hollows import Beneath, hollows_of
from difftrb.contact.strip_plan import Fineness, StripPlan
from difftrb.contact.strip_reach import (
    Reach,
    ends_within,
    interference,
    on_missing_land,
    reach_near,
    reach_of,
    suited,
)
from difftrb.contact.strip_rows import Rows
from difftrb.contact.strip_settling import FARTHEST, Settled, StripProblem
from difftrb.core import arrays as xp
from difftrb.core import implicit, status

SETTLED = 0.05  # share of the asked-for accuracy that misplaced boundaries may take
TENSION = 10.0  # share of the load that strips may take as tension, by the accuracy: more, and they are too coarse
ACROSS = np.sin(0.5 * np.pi * np.linspace(-1.0, 1.0, 81)) * 0.9999
"""Points of a row, by half its width from its middle; denser at its ends."""
CLEAR = 100.0
"""By the deepest overlap, the gap of rows on land that a spall leaves none of."""
ALONG = 4
"""Points between two rows."""


class Strips(NamedTuple):
    """A contact solved by strips.

    Attributes:
      approach: δ [mm]. moment: Σ f·y about the roller's middle [N mm].
      settled: mode loads and boundaries, without units. reach: the units.
      still: whether the active set of the bands stood still. passes: solves by smooth modes.
    """

    approach: Any
    moment: Any
    settled: Settled
    reach: Reach
    still: Any
    passes: Any


class Way(NamedTuple):
    """How a contact is solved: on half the roller, over what, how fine, to which share of the approach boundaries must
    settle, and whether it is `strict` on spalls with a rolling edge in reach: they end within the loaded part of the
    roller."""

    mirrored: bool
    beneath: Beneath
    fine: Fineness
    tolerance: float
    strict: bool


def solve(inputs: Inputs, way: Way) -> Strips:
    """Solve by strips. The approach is differentiable once by all inputs, the rest carries no derivative."""

    def moved(found: Strips, inputs: Inputs) -> Any:
        return _shifted(way, found, [found.settled], inputs)[0]

    approach, found = implicit.stationary(moved, partial(_search, way), inputs)
    return found._replace(approach=approach)


def solve_numbers(inputs: Inputs, way: Way) -> Strips:
    """The same of numbers, by numpy."""
    return _search(way, inputs)[1]


def gradients(found: Strips, inputs: Inputs, way: Way, count: int) -> list[Inputs]:
    """Derivatives of what was found for numbers, each in the form of the inputs: of the approach and, if two are asked
    for, of the moment about the roller's middle [N mm]."""
    settled = [found.settled]
    if count > 1:
        problem, plan, ends = _problem(inputs, way, found.reach)
        kernel = _kernel(way, *ends)
        settled.append(strip_settling.turned(plan, problem, kernel, found.settled))
    several = isinstance(inputs.spall, tuple)
    leaves, form = jax.tree.flatten(inputs._replace(offset=tuple(inputs.offset)) if several else inputs)

    def moved(some: list) -> Any:
        return xp.stack(_shifted(way, found, settled, form.unflatten(some)))

    rates = [form.unflatten(list(row)) for row in implicit.rates(moved, leaves).T]
    return [rate._replace(offset=np.stack(rate.offset)) for rate in rates] if several else rates


def _groups(inputs: Inputs, reach: Reach, way: Way) -> tuple[tuple[Rows, ...], tuple[int, ...], tuple]:
    """The rows, the numbers of those over spalls, and what they are made of: the hollows' ends and the contact's."""
    borders = [end for hollow in hollows_of(inputs, way.beneath) for end in (hollow.low, hollow.high)]
    ends = tuple(end / reach.unit for end in (*borders, reach.bottom, reach.top))
    if way.mirrored:
        ends = tuple(end if i % 2 else xp.fixed(end) for i, end in enumerate(ends))
    return *strip_plan.groups_of(ends, way.mirrored, way.beneath.edges, way.fine), ends


def _problem(inputs: Inputs, way: Way, reach: Reach) -> tuple[StripProblem, StripPlan, tuple[Any, ...]]:
    """The contact without units, its plan, and what its rows are made of."""
    contact, load, _, _, tilt = inputs
    mirrored, beneath, fine, *_ = way
    groups, over, ends = _groups(inputs, reach, way)
    push = np.pi * contact.modulus / reach.line_load  # from [mm] to the unit of displacement
    weight = strip_rows.weights(groups)
    gap = xp.concatenate([
        strip_rows.integrals(group, lambda y: push * gaps.rest_at(y * reach.unit, contact, tilt)) for group in groups
    ]) / weight  # fmt: skip
    clear = CLEAR * xp.fixed(push * interference(inputs, reach.approach))
    gap = gap + xp.where(on_missing_land(groups, over, ends), clear, 0.0)
    left, right = _rolling_edges(inputs, beneath, reach.unit)
    land = contact.length
    if not beneath.edges:
        covered = sum(hollow.high - hollow.low for hollow in hollows_of(inputs, beneath))
        land = xp.maximum(contact.length - covered, 0.02 * contact.length)
    wider = xp.sqrt(contact.radius * load / (contact.modulus * land)) / reach.unit
    images = 2.0 if mirrored else 1.0
    problem = StripProblem(
        weight=weight,
        gap=gap,
        bend=push * reach.unit**2 / (4.0 * contact.radius),  # x²/(2R) in units of 2x²
        left=left,
        right=right,
        load=load / (images * reach.line_load * reach.unit),
        push=push,
        shrunk=wider / xp.fixed(wider),
    )
    return problem, strip_plan.plan_of(groups, over, beneath.edges, mirrored, fine), ends


def _kernel(way: Way, *ends: Any) -> strip_kernel.Kernel:
    """Of the rows between these ends of hollows and of the contact."""
    groups, _ = strip_plan.groups_of(ends, way.mirrored, way.beneath.edges, way.fine)
    return strip_kernel.kernel_of(groups, way.mirrored, way.fine.frequencies_for(way.beneath.edges), way.fine.nodes)


def _rolling_edges(inputs: Inputs, beneath: Beneath, unit: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Where the hollows' rolling edges are, by `unit`; at most FARTHEST, where those are that do not count."""
    hollows = hollows_of(inputs, beneath)
    if not beneath.edges:
        return (np.asarray(-FARTHEST),), (np.asarray(FARTHEST),)
    if beneath.edges == 1:
        return (xp.within(-hollows[0].edge / unit, -FARTHEST, FARTHEST),), (np.asarray(FARTHEST),)
    left, right = (
        tuple(xp.within(edge / unit, -FARTHEST, FARTHEST) for edge in edges)
        for edges in zip(*((hollow.left, hollow.right) for hollow in hollows), strict=True)
    )
    return left, right


def _shifted(way: Way, found: Strips, settled: Sequence[Settled], inputs: Inputs) -> list[Any]:
    """To first order in a change of the inputs, at what was found for them: the approach [mm] and, of `settled` with
    changes by the tilt in place of those by the load (`strip_settling.turned`), the moment [N mm].

    Rows and boundaries keep their places in the units, which change: what they are misplaced by does then not enter.
    """
    reach = reach_near(found.reach, inputs, way.beneath, way.mirrored)
    problem, plan, ends = _problem(inputs, way, reach)
    shifts = strip_settling.shifts(plan, problem, partial(_kernel, way), ends, settled)
    moved = [(found.settled.approach + shifts[0]) / problem.push]
    if len(settled) > 1:
        groups, *_ = _groups(inputs, reach, way)
        on = found.settled.active[plan.outline_of]
        own = xp.total(xp.where(on, found.settled.loads[:, 0], 0.0) * strip_rows.arms(groups)[plan.rows])
        moved.append(reach.line_load * reach.unit**2 * (own + shifts[1]))
    return moved


def _search(way: Way, inputs: Inputs) -> tuple[Any, Strips]:
    reach = xp.fixed(reach_of(inputs, way.beneath, way.mirrored))
    problem, plan, ends = _problem(inputs, way, reach)
    kernel, fine = _kernel(way, *ends), way.fine
    estimate = problem.push * reach.approach
    size, on, still = strip_bands.chosen(plan, problem, kernel, estimate, fine.bands, fine.centred)
    begin = plan.begun_by @ size, plan.begun_by @ on
    settled, passes = strip_settling.settle(plan, problem, kernel, *begin, fine.settled, way.tolerance)
    approach = settled.approach / problem.push
    moments = settled.loads[:, 0] * kernel.arm[plan.rows]
    moment = reach.line_load * reach.unit**2 * xp.sum(moments) * (0.0 if way.mirrored else 1.0)
    return approach, Strips(approach, moment, settled, reach, still, passes)


# ------------------------------------------------------------------------------------------ what comes back


def on_cells(found: Strips, inputs: Inputs, way: Way, cells: Cells, accuracy: float) -> Found:
    """The pressure spread over `cells`, and how the solve is judged.

    What is not suited `strip_reach.suited` and `ends_within` say.
    """
    settled, reach = xp.fixed(found.settled), found.reach
    plan, groups, on, loads, ends = _outlined(found, inputs, way)
    images = 2.0 if way.mirrored else 1.0
    force, tension = _pressing(
        images * reach.line_load * reach.unit * _load_on_cells(plan, groups, loads, ends, cells, reach.unit)
    )
    code = verdict(found.approach, settled.error, way.tolerance)
    converged = found.still & (interference(inputs, found.approach) > 0.0)
    code = xp.where(converged, code, status.worst(code, np.asarray(status.NOT_CONVERGED)))
    code = status.worst(code, verdict(found.approach, tension, TENSION * accuracy))
    fits = suited(inputs, reach, found.approach, way.beneath)
    fits = fits & ends_within(inputs, reach, way.beneath) if way.beneath.edges and way.strict else fits
    code = xp.where(fits, code, status.UNSUITED)
    width = reach.unit * _width(plan, on, ends)
    passes = np.asarray(way.fine.centred) + xp.fixed(found.passes)
    left = settled.error + settled.unresolved
    return Found(found.approach, force, found.moment, width, left, passes, np.asarray(loads.size), code)


def _outlined(found: Strips, inputs: Inputs, way: Way) -> tuple[StripPlan, tuple[Rows, ...], Any, Any, Any]:
    """The plan and the rows; of every strip whether it is loaded, its modes' loads, (strips, modes), and its
    boundaries, (strips, 2), where the inputs say that the spall is."""
    settled = xp.fixed(found.settled)
    groups, over, _ = _groups(inputs, found.reach, way)
    plan = strip_plan.plan_of(groups, over, way.beneath.edges, way.mirrored, way.fine)
    on = settled.active[plan.outline_of]
    loads, ends = xp.where(on[:, None], settled.loads, 0.0), settled.ends[plan.outline_of]
    if way.beneath.edges == 1:
        turned = inputs.offset < 0.0  # the nearer edge was looked at from its left
        ends = xp.where(turned, -ends[:, ::-1], ends)
        loads = xp.where(turned, loads * (-1.0) ** np.array(plan.orders)[None], loads)
    return plan, groups, on, loads, ends


def _width(plan: StripPlan, on: Any, ends: Any) -> Any:
    """The longest row across the contact."""
    of_row = np.eye(max(plan.rows) + 1, dtype=bool)[plan.rows] & on[:, None]
    low, high = ends[:, :1], ends[:, 1:]
    return xp.max(xp.max(xp.where(of_row, high, -np.inf), axis=0) - xp.min(xp.where(of_row, low, np.inf), axis=0))


def _pressing(force: Any) -> tuple[Any, Any]:
    """The force without tension, to which few modes on few rows swing beside a spall's corners; all else is so much
    smaller that the sum remains. And the share of it that was tension."""
    pressing = xp.where(force > 0.0, force, 0.0)
    kept = xp.sum(force) / xp.maximum(xp.sum(pressing), 1e-300)
    return kept * pressing, xp.fixed(1.0 - kept)


def _load_on_cells(plan: StripPlan, groups: tuple[Rows, ...], loads: Any, ends: Any, cells: Cells, unit: Any) -> Any:
    """The strips' load on every cell, exactly integrated: share of each strip in x, of each hat in y."""
    low, high = ends[:, 0], ends[:, 1]
    borders = cells.borders / unit
    t = (2.0 * borders[None, :] - (low + high)[:, None]) / (high - low)[:, None]
    inside = xp.abs(t) < 1.0
    angle = xp.where(inside, xp.arccos(xp.where(inside, t, 0.0)), xp.where(t < 0.0, np.pi, 0.0))
    # ∫ Tₘ/(π√(1−t²)) dt from −1
    below = [1.0 - angle / np.pi if m == 0 else -xp.sin(m * angle) / (m * np.pi) for m in plan.orders]
    across = xp.einsum("sm,smx->sx", loads, xp.diff(xp.stack(below, axis=1), axis=-1))
    along = xp.concatenate([strip_rows.shares(group, cells.lines / unit) for group in groups])
    return along[plan.rows].T @ across


# ------------------------------------------------------------------------------------------ point by point


class Patch(NamedTuple):
    """A part of the contact: positions along the roller [mm], shape (points,); in the rolling direction [mm], and
    pressure [N/mm²], shape (points, across)."""

    y: np.ndarray
    x: np.ndarray
    pressure: np.ndarray


def patches(found: Strips, inputs: Inputs, way: Way) -> tuple[Patch, ...]:
    """The pressure to look at, where cells would show notches, of numbers: the contact's parts, beyond the spall's ends
    along the roller and beside it. Profiles of rows, and boundaries between two, go over into those of the next row."""
    plan, groups, on, loads, ends = _outlined(found, inputs, way)
    unit, density = float(found.reach.unit), float(found.reach.line_load / found.reach.unit)
    made, first = [], 0
    for group in groups:
        rows = range(first, first + group.count)
        first += group.count
        y = group.hats(group.lines[1:-1], group.lines[0], group.lines[-1])
        low, high, pressure = map(np.stack, zip(*(_profile(plan, on, loads, ends, row) for row in rows), strict=True))
        middle, square = 0.5 * (low + high), 0.25 * (high - low) ** 2
        for at, end in ((0, group.lines[0]), (len(y), group.lines[-1])):
            near = min(at, len(y) - 1)
            if not np.isclose(y[near], end):  # where contact ends
                y, middle, square = np.insert(y, at, end), np.insert(middle, at, middle[near]), np.insert(square, at, 0)
                pressure = np.insert(pressure, at, 0.0, axis=0)
        fine = np.interp(np.arange((len(y) - 1) * ALONG + 1) / ALONG, np.arange(len(y)), y)
        half = np.sqrt(np.interp(fine, y, square))[:, None]
        x = np.interp(fine, y, middle)[:, None] + half * ACROSS
        p = np.stack([np.interp(fine, y, column) for column in pressure.T], axis=1)
        if way.mirrored and group.middle:  # symmetric about the roller's middle
            fine, x, p = (
                np.concatenate([part[:0:-1] * sign, part]) for part, sign in ((fine, -1.0), (x, 1.0), (p, 1.0))
            )
        one = Patch(unit * fine, unit * x, density * p)
        made.append(one)
        if way.mirrored and not group.middle:
            made.append(Patch(-one.y[::-1], one.x[::-1], one.pressure[::-1]))
    return tuple(made)


def _profile(plan: Any, on: Any, loads: Any, ends: Any, row: int) -> tuple[float, float, np.ndarray]:
    """Where the loaded part of a row begins and ends, and its pressure on `ACROSS`, without units."""
    own = np.flatnonzero((plan.rows == row) & on & (ends[:, 1] > ends[:, 0]))
    if not len(own):
        return 0.0, 0.0, np.zeros_like(ACROSS)
    low, high = float(ends[own, 0].min()), float(ends[own, 1].max())
    x = 0.5 * (low + high) + 0.5 * (high - low) * ACROSS
    pressure = np.zeros_like(x)
    for strip in own:
        a, b = ends[strip]
        t = (2.0 * x - a - b) / (b - a)
        inside = np.abs(t) < 1.0
        angle = np.arccos(np.where(inside, t, 0.0))
        modes = sum(load * np.cos(m * angle) for load, m in zip(loads[strip], plan.orders, strict=True))
        pressure += np.where(inside, modes * 2.0 / (b - a) / (np.pi * np.sin(angle)), 0.0)  # Tₘ/(π√(1−t²))
    return low, high, np.maximum(pressure, 0.0)
