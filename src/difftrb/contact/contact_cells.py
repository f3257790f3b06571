"""Cells for one contact: where pressure can be, with lines on the spalls' edges; and the gap on them.

Along the roller lines are graded from edge to edge. Across it the lattice stands on the first spall's edges; for each
further one the nearest line moves there. Each spall is a hair larger than the one before, so that edges that would
coincide keep a line each, and spalls that touch leave no ridge between them. Pressure on a sliver of a cell between two
such lines is singular: the approach does not mind, but across the roller its derivatives come out up to half too small.

A uniform lattice follows only the first spall's edges: a wall elsewhere stands where the nearest line does, so errors
fall with the first power of a cell. It takes height maps, and is a second opinion.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap as gaps
from difftrb.contact import halfspace
from difftrb.contact.contact_extent import depth_at, domain, domain_of_any, ends_along
from difftrb.contact.contact_solution import Inputs, listed
from difftrb.contact.gap import Cells, Uneven
from difftrb.contact.halfspace import EDGE_SHIFT
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import LineContact, Spall

APART = 5e-5
"""By which each spall is longer at either end than the one before, as a part of the domain's half length."""
TOGETHER = 5e-4
"""Ends of two spalls closer than this, as a part of the same, move as one."""
APART_ACROSS = 0.02
"""By which each spall is wider at either side than the one before, as a part of the pitch."""
AT_ENDS = 2.0
"""Half-width of the contact at spalls' ends by that of the mean line load."""
NO_RIDGE = 0.0125
"""A ridge between two spalls that is narrower than this part of the domain's half width is not there, on cells of any
number. Such ones, of 2 µm and less, stand for spalls that touch, to the digits of their angles: steel would crush them.
An elastic one of 2 µm under a roller's middle holds it up by a fifth of its approach."""
TOUCHING = 0.5
"""A wider one that is narrower than this part of the pitch is missed, as the status says."""
FULL = 0.06
"""A land or hollow longer than this part of the domain's half length gets all its rows."""
AWAY = 1e3
"""Gap beyond the roller's ends [mm]."""


@dataclasses.dataclass(frozen=True)
class Resolution:
    """How many cells: `columns` across the contact, `land` rows from a spall's end to the roller's end (or the end of
    the loaded part), `spall` rows along half a spall."""

    columns: int
    land: int
    spall: int


class LaidContact(NamedTuple):
    """Cells, the initial gap on them [mm], shape (rows, columns), and a status: `UNRESOLVED` where a spall is narrower
    than a cell."""

    cells: Cells
    gap: jax.Array
    status_code: jax.Array


def stage(inputs: Inputs, resolution: Resolution, mirrored: bool) -> LaidContact:
    """Cells that span where pressure can be, with boundaries on the spalls' edges. Not for height maps."""
    contact, spall = inputs.contact, cast(Spall | tuple[Spall, ...] | None, inputs.spall)
    if isinstance(spall, tuple):
        cells, depression, code = _several(inputs, spall, resolution, mirrored)
    else:
        cells, code = _single(inputs, spall, resolution, mirrored)
        depression = np.zeros((1, 1)) if spall is None else gaps.depression(cells, spall, inputs.offset)
    return LaidContact(cells, gaps.undeformed(cells, contact, inputs.tilt) + depression, code)


def _single(inputs: Inputs, spall: Spall | None, resolution: Resolution, mirrored: bool) -> tuple[Cells, Any]:
    """Cells for one spall or none, and their status."""
    contact, load, _, offset, tilt = inputs
    spalls, offsets = ((), np.zeros(0)) if spall is None else ((spall,), offset[None])
    reach_x, bottom, top = domain(contact, load, spalls, offsets, tilt)
    reach_y = 0.5 * (top - bottom)
    reach_x = reach_x * (1.0 + 2.0 / resolution.columns)  # the lattice may slide by half a cell, borders stay unloaded
    if spall is None:
        pitch, x = halfspace.lattice(reach_x, resolution.columns, -np.inf, np.inf)
        half = halfspace.graded(np.zeros(()), reach_y, resolution.land, at_start=False)
        lines = half if mirrored else 0.5 * (bottom + top) + xp.concatenate([-half[:0:-1], half])
        return Cells(pitch, x, lines, mirrored), np.asarray(status.CONVERGED)

    pitch, x = halfspace.lattice(reach_x, resolution.columns, offset - 0.5 * spall.width, offset + 0.5 * spall.width)
    sliver = 2e-3 * reach_y  # no segment of the grid is thinner
    ends = spall.ends
    high = xp.clip(ends[1], bottom + 2.0 * sliver, top - sliver)
    whole = halfspace.graded(np.zeros(()), reach_y, resolution.land + resolution.spall, at_start=False)
    if mirrored:
        edge = xp.maximum(high, sliver)
        land = _beyond_edge(halfspace.graded(edge, top, resolution.land, at_start=True), edge)
        hollow = halfspace.graded(np.zeros(()), land[0], resolution.spall, at_start=False)
        lines = xp.concatenate([hollow, land[1:]])
    else:
        low = xp.clip(ends[0], bottom + sliver, high - sliver)
        upper = halfspace.graded(high, top, resolution.land, at_start=True)
        lower = halfspace.graded(-low, -bottom, resolution.land, at_start=True)
        upper, lower = _beyond_edge(upper, 0.5 * (high - low)), -_beyond_edge(lower, 0.5 * (high - low))[::-1]
        hollow = halfspace.graded(lower[-1], upper[0], 2 * resolution.spall, at_start=True)
        lines = xp.concatenate([lower, hollow[1:-1], upper])
        whole = 0.5 * (bottom + top) + xp.concatenate([-whole[:0:-1], whole])
    lines = xp.where((ends[0] <= bottom) & (ends[1] >= top), whole, lines)  # over a spall all along there is no edge
    narrow = _is_narrow(spall, offset, reach_x, resolution)
    return Cells(pitch, x, lines, mirrored), xp.where(narrow, status.UNRESOLVED, status.CONVERGED)


def _is_narrow(spall: Spall, offset: jax.Array, reach: jax.Array, resolution: Resolution) -> jax.Array:
    """Whether both edges are on the cells, and nearer to each other than a cell."""
    inside = xp.magnitude(offset) + 0.5 * spall.width < reach
    return inside & (spall.width > 0.0) & (spall.width < 2.0 * reach / resolution.columns)


def _beyond_edge(land: jax.Array, room: jax.Array) -> jax.Array:
    """Land lines with the first one drawn into the spall, where the discrete edge acts as the true one, by at most half
    the `room` [mm]."""
    drawn = xp.minimum(halfspace.EDGE_SHIFT * (land[1] - land[0]), 0.5 * room)
    return land - drawn * np.eye(1, land.shape[0])[0]


# ------------------------------------------------------------------------------------------ several spalls


def _several(
    inputs: Inputs, spalls: tuple[Spall, ...], resolution: Resolution, mirrored: bool
) -> tuple[Cells, Any, Any]:
    """Cells with a boundary on every edge, the depth under each [mm], and their status. Where spalls overlap the deeper
    one counts. A spall out of the contact's reach in the rolling direction does not act on the cells at all."""
    contact, load, _, offsets, tilt = inputs
    reach_x, _, _ = domain(contact, load, spalls, offsets, tilt)
    near = xp.stack([xp.magnitude(o) - 0.5 * s.width < reach_x for s, o in zip(spalls, offsets, strict=True)])
    spalls = tuple(
        dataclasses.replace(s, length=xp.where(near[i], s.length, 0.0), depth=xp.where(near[i], s.depth, 0.0))
        for i, s in enumerate(spalls)
    )
    reach_x, bottom, top = domain(contact, load, spalls, offsets, tilt)
    spans = _spans(contact, load, spalls, offsets, near, bottom, top)
    lines, under_rows = _along(spans, bottom, top, resolution, mirrored)
    reach_x = reach_x * (1.0 + 2.0 / resolution.columns)  # the lattice may slide by half a cell, borders stay unloaded
    cells, under_columns, spoiled = _across(spalls, offsets, reach_x, resolution.columns, lines, mirrored)
    depression = np.zeros((1, 1))
    for i, spall in enumerate(spalls):
        inside = (under_rows[i][:, None] & under_columns[i][None, :]) & near[i]
        depression = xp.maximum(depression, xp.where(inside, spall.depth, 0.0))  # Liu et al. 2018, eq. (3)
    narrow = [_is_narrow(spall, offset, reach_x, resolution) for spall, offset in zip(spalls, offsets, strict=True)]
    return cells, depression, xp.where(spoiled | xp.any(xp.stack(narrow)), status.UNRESOLVED, status.CONVERGED)


def _spans(
    contact: LineContact, load: jax.Array, spalls: tuple[Spall, ...], offsets: jax.Array, near: jax.Array,
    bottom: jax.Array, top: jax.Array,
) -> list[tuple[jax.Array, ...]]:  # fmt: skip
    """Lines at both ends of every spall [mm]. Ends close `TOGETHER` move as one, by a mean of what each would move, for
    a sliver cannot tell whose end the land's border is: each counts by Hertz's pressure squared over its width, about
    the energy that its edge would release, and less where its bottom is met."""
    mean = gaps.line_half_width(load / contact.length, contact.radius, contact.modulus)
    half, reach = AT_ENDS * xp.fixed(mean), 0.5 * (top - bottom)
    widths, places = (xp.fixed(part) for part in (xp.stack([spall.width for spall in spalls]), offsets))
    low, high = (xp.clip((places + side * widths) / half, -1.0, 1.0) for side in (-0.5, 0.5))
    sunk = xp.fixed(gaps.palmgren_approach(load, contact.length))
    fallen = xp.stack([xp.minimum(xp.fixed(spall.depth) / sunk, 1.0) ** 2 for spall in spalls])
    share = ((high - high**3 / 3.0) - (low - low**3 / 3.0)) * fallen + 1e-9
    every, lines = zip(*(ends_along(contact, spall) for spall in spalls), strict=True), []
    for side, ends in zip((-1.0, 1.0), map(xp.stack, every), strict=True):
        still = xp.fixed(ends)
        together = xp.abs(still[:, None] - still[None]) <= TOGETHER * xp.fixed(reach)
        weight = xp.where(together, share[None], 0.0)
        moved = still + xp.total(weight * (ends - still)[None]) / xp.total(weight)
        longer = moved + side * APART * reach * np.arange(len(spalls))
        lines.append(xp.where(near, xp.clip(longer, bottom, top), top))
    return list(zip(*lines, strict=True))


def _along(
    spans: list[tuple[jax.Array, ...]], bottom: jax.Array, top: jax.Array, resolution: Resolution, mirrored: bool
) -> tuple[jax.Array, list[jax.Array]]:
    """Lines along the roller, and for every spall which rows lie over it."""
    start = np.zeros(()) if mirrored else bottom
    ends = [span[1] for span in spans] if mirrored else [edge for span in spans for edge in span]
    into = np.array([-1.0] * len(spans) if mirrored else [1.0, -1.0] * len(spans))  # from an edge into its spall
    count, apart = len(ends), 0.5 * APART * 0.5 * (top - bottom)
    edges = xp.stack(ends)
    order = xp.argsort(xp.fixed(edges))
    edges = edges[order]
    knots = [start]
    for i in range(count):
        knots.append(xp.maximum(xp.minimum(edges[i], top - (count - i) * apart), knots[-1] + apart))
    knots = xp.stack([*knots, top])

    most = np.array([resolution.land] + [max(2 * resolution.spall, resolution.land // 2)] * (count - 1)
                    + [resolution.land])  # fmt: skip
    if mirrored:
        most[0] = resolution.spall
    lengths = xp.diff(xp.fixed(knots))
    share = xp.minimum(lengths / (FULL * 0.5 * xp.fixed(top - bottom)), 1.0)
    share = xp.where(xp.isfinite(share), share, 1.0)  # what comes of bad inputs has a status; rows are counted anyway
    rows = xp.maximum(xp.round(most * share), 1.0).astype(int)
    longest = np.arange(count + 1) == xp.argmax(lengths)
    rows = rows + xp.where(longest, int(most.sum()) - xp.sum(rows), 0)  # what slivers do not need
    first = xp.concatenate([np.zeros(1, int), xp.cumsum(rows)])  # line that stands on each knot
    line = np.arange(int(most.sum()) + 1)
    part = xp.clip(xp.sum(line[:, None] >= first[None, 1:], axis=1), 0, count)
    s = (line - first[part]) / rows[part]
    both, end = 0.5 * (1.0 - xp.cos(np.pi * s)), xp.sin(0.5 * np.pi * s)
    gathered = xp.where((part == 0) & mirrored, end, both)
    lines = knots[part] + (knots[part + 1] - knots[part]) * (0.05 * s + 0.95 * gathered)

    # the discrete edge acts as the true one from within the spall
    here, side = first[1:-1], xp.module_of(order).asarray(into)[order].astype(int)
    land, hollow = side * (lines[here] - lines[here - side]), side * (lines[here + side] - lines[here])
    drawn = side * xp.minimum(EDGE_SHIFT * land, 0.4 * hollow)
    lines = lines + xp.leading_total(drawn[:, None] * (line[None] == here[:, None]))

    rank = xp.argsort(order)
    row = np.arange(int(most.sum()))
    at = here[rank]
    if mirrored:
        return lines, [row < at[i] for i in range(count)]
    return lines, [(row >= at[2 * i]) & (row < at[2 * i + 1]) for i in range(count // 2)]


def _across(
    spalls: tuple[Spall, ...], offsets: jax.Array, reach: jax.Array, columns: int, lines: jax.Array, mirrored: bool
) -> tuple[Cells, list[jax.Array], jax.Array]:
    """The cells, for every spall which columns lie over it, and whether lines were too close to keep their order."""
    left, right = ([o + side * s.width for s, o in zip(spalls, offsets, strict=True)] for side in (-0.5, 0.5))
    pitch, x = halfspace.lattice(reach, columns, left[0], right[0])
    borders = xp.concatenate([x - 0.5 * pitch, x[-1:] + 0.5 * pitch])
    even, h = xp.fixed(borders), xp.fixed(pitch)
    column, line = np.arange(columns), np.arange(columns + 1)

    def line_of(edge: Any) -> Any:
        return xp.clip(xp.nan_to_num(xp.round((xp.fixed(edge) - even[0]) / h)), 0, columns).astype(int)

    taken, at = [], []
    for edge, into in ((left[0], 1), (right[0], -1)):
        inside = xp.magnitude(edge) < reach
        k = line_of(edge + into * EDGE_SHIFT * pitch)
        taken.append((xp.where(inside, k, -1), into, edge))
        at.append(xp.where(inside, k, xp.where(edge < 0.0, 0, columns)))
    low, high = at
    under = [(column >= low) & (column < high)]
    uneven, spoiled, near = [], np.asarray(False), xp.maximum(TOUCHING * pitch, NO_RIDGE * reach)
    for i, (a, b) in enumerate(zip(left[1:], right[1:], strict=True), 1):
        at = []
        for edge, into in ((a, 1), (b, -1)):
            inside = xp.magnitude(edge) < reach
            edge = edge - into * i * APART_ACROSS * pitch
            even_shift = edge + into * EDGE_SHIFT * pitch
            k = nearest = xp.clip(line_of(even_shift), 1, columns - 1)
            for other, *_ in taken:  # a line that stands on another edge stays there; take its neighbour
                k = xp.where(k == other, k + xp.where(even_shift >= borders[k], 1, -1), k)
            k = xp.clip(k, 1, columns - 1)
            shift = EDGE_SHIFT / (1.0 - EDGE_SHIFT) * xp.magnitude(edge - borders[k - into])
            wanted = xp.where(k == nearest, edge + into * shift, even_shift)
            closest = 0.5 * APART_ACROSS * pitch
            wanted = xp.clip(wanted, borders[k - 1] + closest, borders[k + 1] - closest)
            for other, facing, theirs in taken:  # two spalls that touch share one line
                ridge = into * (edge - theirs)
                touching = inside & (other >= 0) & (xp.magnitude(ridge) < near) & (facing != into)
                k, wanted = xp.where(touching, other, k), xp.where(touching, borders[other], wanted)
                spoiled = spoiled | (touching & (ridge > NO_RIDGE * reach))
            borders = xp.where(inside & (line == k), wanted, borders)
            taken.append((xp.where(inside, k, -1), into, edge))
            at.append(xp.where(inside, k, xp.where(edge < 0.0, 0, columns)))
            uneven += [k - 1, k]
        under.append((column >= at[0]) & (column < at[1]))
    spoiled = spoiled | (xp.min(xp.diff(xp.fixed(borders))) < 0.4 * APART_ACROSS * h)
    centres = 0.5 * (borders[1:] + borders[:-1])
    return Cells(pitch, centres, lines, mirrored, Uneven(xp.stack(uneven), borders)), under, spoiled


def uniform_stage(inputs: Inputs, size: tuple[int, int]) -> LaidContact:
    """A lattice of `size` (rows, columns) where pressure can be, laid on the first spall's edges if there is one and
    moved as in `halfspace.lattice`. Depths are those at the cells' centres."""
    contact, load, spall, offset, tilt = inputs
    defects = listed(spall)
    offsets = jnp.broadcast_to(offset, (len(defects),))
    rows, columns = size
    spalls = tuple(each for each in defects if isinstance(each, Spall))
    if len(spalls) == len(defects):
        reach_x, bottom, top = domain(contact, load, spalls, offsets, tilt)
    else:
        reach_x, bottom, top = domain_of_any(contact, load, defects, offsets, tilt)
    nowhere = -jnp.asarray(jnp.inf), jnp.asarray(jnp.inf)
    left, right = low, high = nowhere
    middle, reach_y = 0.5 * (bottom + top), 0.5 * (top - bottom)
    if defects and isinstance(defects[0], Spall):
        first, offset = defects[0], offsets[0]
        left, right = offset - 0.5 * first.width, offset + 0.5 * first.width
        low, high = (end - middle for end in first.ends)
    pitch, x = halfspace.lattice(reach_x * (1.0 + 2.0 / columns), columns, left, right)
    if spalls:
        height, y = halfspace.lattice(reach_y * (1.0 + 2.0 / rows), rows, low, high)
        lines = middle + jnp.concatenate([y - 0.5 * height, y[-1:] + 0.5 * height])
    else:
        lines = jnp.linspace(bottom, top, rows + 1)
    cells = Cells(pitch, x, lines, False)
    beyond = jnp.where(jnp.abs(cells.y) > 0.5 * contact.length, AWAY, 0.0)[:, None]
    depth = beyond + depth_at(defects, offsets, cells.x, cells.y)
    return LaidContact(cells, gaps.undeformed(cells, contact, tilt) + depth, jnp.asarray(status.CONVERGED))
