"""One roller on one raceway as strips: the rows, the problem without units, and the pressure it comes back with."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap as gaps
from difftrb.contact import strip_basis, strip_fourier, strip_newton
from difftrb.contact.contact_extent import edges_along, reach_of_strips
from difftrb.contact.contact_solution import Found, Inputs, verdict
from difftrb.contact.gap import Cells
from difftrb.contact.strip_basis import Rows
from difftrb.contact.strip_fourier import LAND, LEFT, MIDDLE, RIGHT, Frequencies, Layout
from difftrb.contact.strip_newton import Problem
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real, Spall


@dataclasses.dataclass(frozen=True)
class Fineness:
    """How fine the strips are: panels of rows on each `land` and on half a spall (`hollow`), modes of each strip
    without and with rolling edges in reach, frequencies likewise."""

    land: int
    hollow: int
    beside: int
    modes: int
    edge_modes: int
    frequencies: Frequencies
    edge_frequencies: Frequencies


THIN = 2  # rows of land at a spall's end that share an outline
NEAR_HOLLOW = 2  # rows of the hollow at a spall's end that share an outline
GATHERED = 3.0  # power with which rows of land grow from an edge and from the contact's end
HOLLOW = 2.0  # and rows of the hollow, of which only the last has a corner to follow
REACHED = 2.75  # where the raceway may still be touched, in the unit of length: strips end at LARGEST
SETTLED = 1e-6  # last change of a free boundary, in Hertz half-widths, at which strips count as converged
LEAST_LAND = 20.0  # loaded length in Hertz half-widths: below, it is no line contact, and rows are no longer than wide
TENSION = 10.0  # share of the load that strips may take as tension, by the accuracy: more, and they are too coarse
LEAST_ROWS = 1e-3  # length of land or spall by the contact's that there are rows for at least
ABOVE = 1.1  # by its estimate, so large an approach may be
FAR_ENDS = 0.75, 0.95  # of a spall by the contact's tip: from here on strips go farther than that
FARTHER = 0.05, 0.3  # if it ends there by so much farther from the middle than on the other side, by the tip
ALONE = 0.15  # and by what share of that on the other side
CLEAR = 100.0  # by the approach, the gap of rows on land that a spall leaves none of
LEAST_CROWN = 1e-3  # crown's scale by approach: below, a roller's end acts as an edge, which the strips do not have


def outlook(inputs: Inputs) -> tuple[jax.Array, jax.Array]:
    """How many rolling edges of the spall may be in reach of the contact, 0…2, and whether strips can be expected to
    describe it."""
    contact, load, spall, offset, _ = _of_strips(inputs)
    low, high = _spall_edges(contact, spall)
    tip, _, unit, approach = jax.lax.stop_gradient(reach_of_strips(contact, load, low, high))
    suited = _suited(contact, spall, low, high, tip, unit, approach)
    if spall is None:
        return jnp.asarray(0), suited
    certain = jnp.sqrt(2.0 * contact.radius * 1.1 * approach)  # beyond it the gap exceeds the approach
    near, far = 0.5 * spall.width - jnp.abs(offset), 0.5 * spall.width + jnp.abs(offset)
    edges = (near < certain).astype(int) + (far < certain)
    return edges, suited & ((edges == 0) | _ends(low, high, tip, unit))


def _suited(
    contact: LineContact, spall: Spall | None, low: jax.Array, high: jax.Array, tip: jax.Array, unit: jax.Array,
    approach: jax.Array,
) -> jax.Array:  # fmt: skip
    """Whether strips can describe a contact beside `low` … `high` [mm] up to ± `tip`, of half-width `unit`, at so large
    an approach [mm]."""
    land = (2.0 * tip - (high - low)) / unit
    suited = (gaps.crown_scale(contact) > LEAST_CROWN * approach) & (land > LEAST_LAND)
    return suited if spall is None else suited & (spall.depth > approach)


def _ends(low: jax.Array, high: jax.Array, tip: jax.Array, unit: jax.Array) -> jax.Array:
    """Whether a spall ends within the loaded part of the roller, at both ends: where it goes on to the roller's end,
    what stands on its rolling edge ends freely, and strips over a spall do not."""
    return (high < tip - unit) & (low > unit - tip)


def solve(inputs: Inputs, mirrored: bool, edges: int, fineness: Fineness, cells: Cells, accuracy: float) -> Found:
    """Solve by strips and spread the pressure over `cells`.

    `edges`: how many rolling edges of the spall may be in reach, 0…2; if one, it is the nearer. Not suited: a spall
    whose bottom is in reach of the roller, a roller (nearly) without crown.
    """
    contact, load, spall, offset, _ = _of_strips(inputs)
    low, high = _spall_edges(contact, spall)
    turned = offset < 0.0  # one edge is always looked at from its left
    if edges == 1:
        offset = jnp.abs(offset)
    tip, line_load, unit, estimate = _reach(contact, load, spall, offset, edges)
    tips = tuple(_tip(contact, tip, estimate, end, other) / unit for end, other in ((-low, high), (high, -low)))
    groups = _groups(spall, low / unit, high / unit, tips, mirrored, edges, fineness)
    layout = _layout(groups, edges, mirrored, fineness)
    images = 2.0 if mirrored else 1.0
    push = np.pi * contact.modulus / line_load  # from [mm] to the unit of displacement
    half_width = 0.5 * spall.width if spall is not None else jnp.asarray(jnp.inf)
    rolling_edges = (offset - half_width) / unit, (offset + half_width) / unit
    share = load / (images * line_load * unit)
    clear = CLEAR * push * jax.lax.stop_gradient(estimate) * _gone(groups, -low / unit / tips[0], high / unit / tips[1])
    problem = _problem(layout, groups, contact, rolling_edges, push, unit, share, mirrored, clear)
    start = _start(layout, problem, push * estimate)
    (loads, ends, approach), active, change, passes = strip_newton.solve(layout, problem, start)
    approach = approach / push
    suited = _suited(contact, spall, low, high, tip, unit, approach)
    suited = suited & _ends(low, high, tip, unit) if edges else suited
    loads = jnp.where(active[:, None], loads, 0.0)
    ends = ends[np.asarray(layout.outlines)]
    if edges == 1:
        ends = jnp.where(turned, -ends[:, ::-1], ends)
        loads = jnp.where(turned, loads * (-1.0) ** layout.orders[None], loads)
    force, tension = _pressing(images * line_load * unit * _on_cells(layout, groups, loads, ends, cells, unit))
    code = jnp.where(suited, _judged(approach, change, tension, accuracy), status.UNSUITED)
    return Found(approach, force, unit * _width(layout, active, ends), change, passes, loads.size, code)


def _of_strips(inputs: Inputs) -> tuple[LineContact, jax.Array, Spall | None, jax.Array, None]:
    """The inputs, which strips take: one spall or none, no tilt."""
    return cast(Any, inputs)


def _judged(approach: jax.Array, change: jax.Array, tension: jax.Array, accuracy: float) -> jax.Array:
    """The status of strips that can describe the contact."""
    code = verdict(approach, change, SETTLED)
    code = jnp.where(approach > 0.0, code, status.NOT_CONVERGED)  # boundaries may settle where no contact is
    return status.worst(code, verdict(approach, tension, TENSION * accuracy))


def _problem(
    layout: Layout, groups: tuple[Rows, ...], contact: LineContact, rolling_edges: tuple[jax.Array, jax.Array],
    push: Real, unit: jax.Array, load: jax.Array, mirrored: bool, clear: jax.Array,
) -> Problem:  # fmt: skip
    """The contact without units; rolling edges, load and by what rows are `clear` are so already; `push`, `unit` take
    them off."""
    nodes, node_weights = layout.frequencies.rule()
    weight = strip_basis.weights(groups)

    def crown(y: jax.Array) -> jax.Array:
        return push * gaps.crown_at(y * unit, contact)

    gap = jnp.concatenate([strip_basis.integrals(group, crown) for group in groups]) / weight + clear
    return Problem(
        products=strip_basis.products(groups, nodes, mirrored) * (2.0 / np.pi * node_weights)[None, None],
        mass=strip_basis.mass(groups),
        weight=weight,
        gap=gap,
        left=rolling_edges[0],
        right=rolling_edges[1],
        load=load,
    )


def _reach(
    contact: LineContact, load: jax.Array, spall: Spall | None, offset: jax.Array, edges: int
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """`reach_of_strips`; with rolling edges in reach, between those with and without the spall, by the share of the
    pressure that it takes."""
    reach = reach_of_strips(contact, load, *_spall_edges(contact, spall))
    if spall is None or not edges:
        return reach
    sound = reach_of_strips(contact, load, jnp.zeros(()), jnp.zeros(()))
    ends = jnp.clip((offset + jnp.array([-0.5, 0.5]) * spall.width) / reach[2], -1.0, 1.0)
    within = 1.0 - ends**2
    angle = jnp.arcsin(jnp.where(within > 0.0, ends, 0.0)) + jnp.where(within > 0.0, 0.0, 0.5 * np.pi * ends)
    below = (angle + ends * jnp.sqrt(jnp.where(within > 0.0, within, 0.0) + 1e-30)) / np.pi  # of half an ellipse
    taken = below[1] - below[0]
    taken = 0.5 * (taken**2 + taken**8)  # what is left of a strip is nearly as stiff until little is left
    tip, line_load, _, approach = (taken * a + (1.0 - taken) * b for a, b in zip(reach, sound, strict=True))
    # a light load sinks a roller over a long spall through its crown: then edges far beyond the half-width are in reach
    farthest = jnp.sqrt(2.0 * contact.radius * reach[3]) / REACHED
    unit = jnp.maximum(gaps.line_half_width(line_load, contact.radius, contact.modulus), farthest)
    return tip, 0.25 * jnp.pi * contact.modulus * unit**2 / contact.radius, unit, approach


def _spall_edges(contact: LineContact, spall: Spall | None) -> tuple[jax.Array, jax.Array]:
    return (jnp.zeros(()), jnp.zeros(())) if spall is None else edges_along(contact, spall)


def _tip(contact: LineContact, tip: jax.Array, estimate: jax.Array, end: jax.Array, other: jax.Array) -> jax.Array:
    """Where strips end on one side of the roller [mm], where the spall ends at `end` on this, at `other` on the other
    side: at the contact's `tip` or, where little or nothing is left before it, where the gap exceeds the approach, for
    land may touch with its corner alone. The land that then carries alone reaches farther, too.
    """
    half, scale = 0.5 * contact.length, gaps.crown_scale(contact)
    deepest = ABOVE * estimate / jnp.where(scale > 0.0, scale, 1.0)
    farthest = jnp.maximum(half * jnp.sqrt(-jnp.expm1(-jnp.where(scale > 0.0, deepest, 100.0))), tip)

    def grown(start: float, full: float, value: jax.Array) -> jax.Array:
        share = jnp.clip((value / tip - start) / (full - start), 0.0, 1.0)
        return (3.0 - 2.0 * share) * share**2

    here, there = (grown(*FAR_ENDS, one) * grown(*FARTHER, one - two) for one, two in ((end, other), (other, end)))
    return tip + jnp.maximum(here, ALONE * there) * (farthest - tip)


def _groups(
    spall: Spall | None, low: jax.Array, high: jax.Array, tips: tuple[jax.Array, ...], mirrored: bool, edges: int,
    fine: Fineness,
) -> tuple[Rows, ...]:  # fmt: skip
    below, tip = tips
    if spall is None:
        return (Rows(strip_basis.graded(jnp.zeros(()), tip, fine.land, 1.0, GATHERED), True, "none"),)
    least = LEAST_ROWS * tip  # also of a spall without length: panels of none would make NaN of derivatives
    high = jnp.clip(high, least if mirrored else -below + 2.0 * least, tip - least)
    upper = Rows(strip_basis.graded(high, tip, fine.land, GATHERED, GATHERED), False, "low")
    if mirrored:
        hollow = Rows(strip_basis.graded(jnp.zeros(()), high, fine.hollow, 1.0, HOLLOW), True, "high")
        return (upper, hollow) if edges else (upper,)
    low = jnp.clip(low, -below + least, high - least)
    lower = Rows(-strip_basis.graded(-low, below, fine.land, GATHERED, GATHERED)[::-1], False, "high")
    hollow = Rows(strip_basis.graded(low, high, 2 * fine.hollow, HOLLOW, HOLLOW), False, "both")
    return (lower, hollow, upper) if edges else (lower, upper)


def _gone(groups: tuple[Rows, ...], below: jax.Array, above: jax.Array) -> jax.Array:
    """Which rows stand for land of which a spall leaves none, ones in zeros, shape (rows,); `below`, `above`: how far
    it goes on either side of the roller's middle, by where strips end there."""
    beside = {"high": below, "low": above}  # land below a spall ends with its high end

    def gone(group: Rows) -> jax.Array:
        land = group.edge in beside and not group.middle
        return jnp.where(beside[group.edge] > 1.0 - LEAST_ROWS, 1.0, 0.0) if land else jnp.zeros(())

    return jnp.concatenate([jnp.full(group.count, gone(group)) for group in groups])


def _layout(groups: tuple[Rows, ...], edges: int, mirrored: bool, fine: Fineness) -> Layout:
    """Which strips there are, and which of them share an outline: those beside a spall's end."""
    numbers, first = [], 0
    for group in groups:
        numbers.append(list(range(first, first + group.count)))
        first += group.count
    hollow = numbers.pop(1) if edges else []
    lands = [land if mirrored or land is numbers[-1] else land[::-1] for land in numbers]  # outwards from the spall
    beside = [land[: fine.beside] for land in lands] if groups[0].edge != "none" else []
    whole = [[row] for land in lands for row in land[fine.beside if beside else 0 :]]
    thin = [part for land in beside for part in (land[:THIN], *([row] for row in land[THIN:]))]
    if not edges:
        families = [(LAND, thin + whole)]
    else:
        near = hollow[-NEAR_HOLLOW:], hollow[:NEAR_HOLLOW]
        through = [land + inside for land, inside in zip(beside[::-1], near, strict=False)]
        alone = [[row] for row in hollow[0 if mirrored else NEAR_HOLLOW : -NEAR_HOLLOW]]
        families = [(LAND, whole), (MIDDLE, thin), (LEFT, through + alone), (RIGHT, through + alone)][: 2 + edges]
    outlines = [(side, shared) for side, family in families for shared in family]
    return Layout(
        rows=tuple(row for _, shared in outlines for row in shared),
        outlines=tuple(i for i, (_, shared) in enumerate(outlines) for _ in shared),
        sides=tuple(side for side, _ in outlines),
        modes=fine.edge_modes if edges else fine.modes,
        even=not edges,
        frequencies=fine.edge_frequencies if edges else fine.frequencies,
    )


def _start(layout: Layout, problem: Problem, approach: jax.Array) -> jax.Array:
    """Ends of the strips to begin with: a Hertz contact under the local interference, cut by the spall's edges."""
    member = layout.member / np.sum(layout.member, axis=0)
    gap = member.T @ problem.gap[np.asarray(layout.rows)]
    half = 1.1 * jnp.sqrt(jnp.clip(1.0 - gap / approach, 0.02, 1.0))
    sides = np.asarray(layout.sides)
    low, high = -half, half
    if not layout.even:
        lowest, highest = strip_fourier.bounds(layout, problem.left, problem.right).T
        low = jnp.where(sides == RIGHT, jnp.maximum(lowest, -1.1), low)
        high = jnp.where(sides == RIGHT, jnp.maximum(1.1, low + 0.2), high)
        high = jnp.where(sides == LEFT, jnp.minimum(highest, 1.1), high)
        low = jnp.where(sides == LEFT, jnp.minimum(-1.1, high - 0.2), low)
        low = jnp.where(sides == MIDDLE, jnp.maximum(lowest, jnp.minimum(low, highest - 0.2)), low)
        high = jnp.where(sides == MIDDLE, jnp.minimum(highest, jnp.maximum(high, lowest + 0.2)), high)
    return jax.lax.stop_gradient(jnp.stack([low, high], axis=1))


def _width(layout: Layout, active: jax.Array, ends: jax.Array) -> jax.Array:
    """The longest row across the contact."""
    on = np.eye(max(layout.rows) + 1, dtype=bool)[list(layout.rows)] & active[:, None]
    low, high = (-ends[:, :1], ends[:, :1]) if layout.even else (ends[:, :1], ends[:, 1:])
    span = jnp.max(jnp.where(on, high, -jnp.inf), axis=0) - jnp.min(jnp.where(on, low, jnp.inf), axis=0)
    return jnp.max(span)


def _pressing(force: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The force without tension, to which few modes on few rows swing beside a spall's corners; all else is so much
    smaller that the sum remains. And the share of it that was tension."""
    pressing = jnp.where(force > 0.0, force, 0.0)
    kept = jnp.sum(force) / jnp.maximum(jnp.sum(pressing), 1e-300)
    return kept * pressing, jax.lax.stop_gradient(1.0 - kept)


def _on_cells(
    layout: Layout, groups: tuple[Rows, ...], loads: jax.Array, ends: jax.Array, cells: Cells, unit: jax.Array
) -> jax.Array:
    """The strips' load on every cell, exactly integrated: share of each strip in x, of each hat in y."""
    low, high = (-ends[:, 0], ends[:, 0]) if layout.even else (ends[:, 0], ends[:, 1])
    borders = jnp.concatenate([cells.x - 0.5 * cells.pitch, cells.x[-1:] + 0.5 * cells.pitch]) / unit
    t = (2.0 * borders[None, :] - (low + high)[:, None]) / (high - low)[:, None]
    inside = jnp.abs(t) < 1.0
    angle = jnp.where(inside, jnp.arccos(jnp.where(inside, t, 0.0)), jnp.where(t < 0.0, np.pi, 0.0))
    orders = layout.orders
    # ∫ Tₘ/(π√(1−t²)) dt from −1
    below = [1.0 - angle / np.pi if m == 0 else -jnp.sin(m * angle) / (m * np.pi) for m in orders]
    across = jnp.einsum("sm,msx->sx", loads, jnp.diff(jnp.stack(below), axis=-1))
    along = jnp.concatenate([strip_basis.shares(group, cells.lines / unit) for group in groups])
    return along[np.asarray(layout.rows)].T @ across
