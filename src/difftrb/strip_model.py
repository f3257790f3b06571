"""One roller on one raceway as strips: the rows, the problem without units, and the pressure it comes back with."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from difftrb import gap as gaps
from difftrb import rows, strips
from difftrb.domain import reach_of_strips
from difftrb.geometry import LineContact, Spall
from difftrb.halfspace import Cells
from difftrb.rows import Rows
from difftrb.strips import LAND, LEFT, RIGHT, Frequencies, Layout, Problem


@dataclasses.dataclass(frozen=True)
class Fineness:
    """How fine the strips are: panels of rows on each `land` and on half a spall (`hollow`), modes of each strip
    without and with rolling edges in reach, frequencies likewise."""

    land: int
    hollow: int
    modes: int
    edge_modes: int
    frequencies: Frequencies
    edge_frequencies: Frequencies


GATHERED = 3.0  # power with which rows grow from an edge and from the contact's end
SETTLED = 1e-6  # last change of a free boundary, in Hertz half-widths, at which strips count as converged
LEAST_LAND = 20.0  # loaded length in Hertz half-widths: below, it is no line contact, and rows are no longer than wide
LEAST_CROWN = 1e-3  # crown's scale by approach: below, a roller's end acts as an edge, which the strips do not have


@dataclasses.dataclass(frozen=True)
class Solved:
    """A contact solved by strips: approach [mm], force of every cell [N], longest strip [mm], last relative change of
    the strips' ends, passes, whether strips can describe this contact, and how many unknowns there were."""

    approach: jax.Array
    force: jax.Array
    width: jax.Array
    change: jax.Array
    passes: jax.Array
    suited: jax.Array
    unknowns: int


def outlook(
    contact: LineContact, load: jax.Array, spall: Spall | None, offset: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Whether a rolling edge of the spall may touch the contact, and whether strips can be expected to describe it."""
    low, high = _spall_edges(contact, spall)
    tip, _, unit, approach = jax.lax.stop_gradient(reach_of_strips(contact, load, low, high))
    suited = _suited(contact, spall, (2.0 * tip - (high - low)) / unit, approach)
    if spall is None:
        return jnp.asarray(False), suited
    certain = jnp.sqrt(2.0 * contact.radius * 1.1 * approach)  # beyond it the gap exceeds the approach
    return jnp.abs(offset) + certain > 0.5 * spall.width, suited


def _suited(contact: LineContact, spall: Spall | None, land: jax.Array, approach: jax.Array) -> jax.Array:
    """Whether strips can describe a contact with so much loaded land, in half-widths, and so large an approach [mm]."""
    suited = (gaps.crown_scale(contact) > LEAST_CROWN * approach) & (land > LEAST_LAND)
    return suited if spall is None else suited & (spall.depth > approach)


def solve(
    contact: LineContact, load: jax.Array, spall: Spall | None, offset: jax.Array, mirrored: bool, edges: bool,
    fineness: Fineness, cells: Cells,
) -> Solved:  # fmt: skip
    """Solve by strips and spread the pressure over `cells`.

    `edges`: whether the rolling edges of the spall may be in reach. Not suited: a spall whose bottom is in reach of the
    roller, a roller (nearly) without crown.
    """
    low, high = _spall_edges(contact, spall)
    tip, line_load, unit, estimate = reach_of_strips(contact, load, low, high)
    groups = _groups(spall, low / unit, high / unit, tip / unit, mirrored, edges, fineness)
    layout = _layout(groups, edges, mirrored, fineness)
    nodes, node_weights = layout.frequencies.rule()
    weight = rows.weights(groups)
    push = np.pi * contact.modulus / line_load  # from [mm] to the unit of displacement

    def crown(y: jax.Array) -> jax.Array:
        return push * gaps.crown_at(y * unit, contact)

    gap = jnp.concatenate([rows.integrals(group, crown) for group in groups]) / weight
    half_width = 0.5 * spall.width if spall is not None else jnp.asarray(jnp.inf)
    images = 2.0 if mirrored else 1.0
    problem = Problem(
        products=rows.products(groups, nodes, mirrored) * (2.0 / np.pi * node_weights)[None, None],
        mass=rows.mass(groups),
        weight=weight,
        place=jnp.concatenate([group.peaks for group in groups]),
        gap=gap,
        left=(offset - half_width) / unit,
        right=(offset + half_width) / unit,
        load=load / (images * line_load * unit),
    )
    start = _start(layout, problem, push * estimate)
    (loads, ends, approach), active, change, passes = strips.solve(layout, problem, start)
    approach = approach / push
    suited = _suited(contact, spall, (2.0 * tip - (high - low)) / unit, approach)
    loads = jnp.where(active[:, None], loads, 0.0)
    force = images * line_load * unit * _on_cells(layout, groups, loads, ends, cells, unit)
    span = ends[:, 0] * 2.0 if layout.even else ends[:, 1] - ends[:, 0]
    width = unit * jnp.max(jnp.where(active, span, 0.0))
    return Solved(approach, force, width, change, passes, suited, loads.size)


def _spall_edges(contact: LineContact, spall: Spall | None) -> tuple[jax.Array, jax.Array]:
    if spall is None:
        return jnp.zeros(()), jnp.zeros(())
    half = 0.5 * contact.length
    low, high = (jnp.clip(spall.axial_offset + side * 0.5 * spall.length, -half, half) for side in (-1.0, 1.0))
    return low, high


def _groups(
    spall: Spall | None, low: jax.Array, high: jax.Array, tip: jax.Array, mirrored: bool, edges: bool, fine: Fineness
) -> tuple[Rows, ...]:
    if spall is None:
        return (Rows(rows.graded(jnp.zeros(()), tip, fine.land, 1.0, GATHERED), True, "none"),)
    least = 1e-3 * tip
    high = jnp.minimum(high, tip - least)
    upper = Rows(rows.graded(high, tip, fine.land, GATHERED, GATHERED), False, "low")
    if mirrored:
        hollow = Rows(rows.graded(jnp.zeros(()), high, fine.hollow, 1.0, GATHERED), True, "high")
        return (upper, hollow) if edges else (upper,)
    low = jnp.clip(low, -tip + least, high - least)
    lower = Rows(-rows.graded(-low, tip, fine.land, GATHERED, GATHERED)[::-1], False, "high")
    hollow = Rows(rows.graded(low, high, 2 * fine.hollow, GATHERED, GATHERED), False, "both")
    return (lower, hollow, upper) if edges else (lower, upper)


def _layout(groups: tuple[Rows, ...], edges: bool, mirrored: bool, fine: Fineness) -> Layout:
    hollow = (1,) if edges else ()
    numbers, first = [], 0
    for group in groups:
        numbers.append(tuple(range(first, first + group.count)))
        first += group.count
    land = sum((numbers[i] for i in range(len(groups)) if i not in hollow), ())
    inside = sum((numbers[i] for i in hollow), ())
    return Layout(
        sides=(LAND,) * len(land) + (RIGHT,) * len(inside) + (LEFT,) * len(inside),
        rows=land + inside + inside,
        modes=fine.edge_modes if edges else fine.modes,
        even=not edges,
        frequencies=fine.edge_frequencies if edges else fine.frequencies,
    )


def _start(layout: Layout, problem: Problem, approach: jax.Array) -> jax.Array:
    """Ends of the strips to begin with: a Hertz contact under the local interference, cut by the spall's edges."""
    gap = problem.gap[np.asarray(layout.rows)]
    half = 1.1 * jnp.sqrt(jnp.clip(1.0 - gap / approach, 0.02, 1.0))
    sides = np.asarray(layout.sides)
    low, high = -half, half
    if not layout.even:
        lowest, highest = strips.bounds(layout, problem).T
        low = jnp.where(sides == RIGHT, jnp.maximum(lowest, -1.1), low)
        high = jnp.where(sides == RIGHT, jnp.maximum(1.1, low + 0.2), high)
        high = jnp.where(sides == LEFT, jnp.minimum(highest, 1.1), high)
        low = jnp.where(sides == LEFT, jnp.minimum(-1.1, high - 0.2), low)
    return jax.lax.stop_gradient(jnp.stack([low, high], axis=1))


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
    along = jnp.concatenate([rows.shares(group, cells.lines / unit) for group in groups])
    return along[np.asarray(layout.rows)].T @ across
