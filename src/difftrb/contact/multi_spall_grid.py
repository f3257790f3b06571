"""Cells for several spalls: every edge has a line of its own, along the roller and across it.

Along the roller lines are graded from edge to edge. Across it the lattice stands on the first spall's edges; for each
further one the nearest line moves there. Each spall is a hair larger than the one before, so that edges that would
coincide keep a line each, which moves alone, and spalls that touch leave no ridge between them.

Across the roller two lines so close make a sliver of a cell at an edge with singular pressure; the approach does not
mind, but its derivatives by such a width or offset come out up to half too small.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import halfspace
from difftrb.contact.contact_extent import Resolution, domain, edges_along
from difftrb.contact.halfspace import EDGE_SHIFT, Cells, Uneven
from difftrb.core import status
from difftrb.core.geometry import LineContact, Spall

APART = 5e-5
"""By which each spall is longer at either end than the one before, as a part of the domain's half length."""
APART_ACROSS = 0.02
"""The same across the roller, as a part of the pitch."""
TOUCHING = 0.5
"""A ridge between two spalls that is narrower than this part of the pitch is not there."""
FULL = 0.06
"""A land or hollow longer than this part of the domain's half length gets all its rows."""


class Fitted(NamedTuple):
    """Cells, the depth of the spalls under each [mm], shape (rows, columns), and a status code."""

    cells: Cells
    depression: jax.Array
    status_code: jax.Array


def fitted(
    contact: LineContact,
    load: jax.Array,
    spalls: tuple[Spall, ...],
    offsets: jax.Array,
    resolution: Resolution,
    mirrored: bool,
    tilt: jax.Array | None,
) -> Fitted:
    """Cells with a boundary on every edge of every spall; `offsets` shape (spalls,). Where spalls overlap the deeper
    one counts. A spall out of the contact's reach in the rolling direction does not act on the cells at all."""
    reach_x, _, _ = domain(contact, load, spalls, offsets, tilt)
    near = jnp.stack([jnp.abs(o) - 0.5 * s.width < reach_x for s, o in zip(spalls, offsets, strict=True)])
    spalls = tuple(
        dataclasses.replace(s, length=jnp.where(near[i], s.length, 0.0), depth=jnp.where(near[i], s.depth, 0.0))
        for i, s in enumerate(spalls)
    )
    reach_x, bottom, top = domain(contact, load, spalls, offsets, tilt)
    apart = APART * 0.5 * (top - bottom)
    spans = [
        tuple(
            jnp.where(near[i], jnp.clip(edge + side * i * apart, bottom, top), top)
            for side, edge in zip((-1.0, 1.0), edges_along(contact, spall), strict=True)
        )
        for i, spall in enumerate(spalls)
    ]
    lines, under_rows = _along(spans, bottom, top, resolution, mirrored)
    reach_x = reach_x * (1.0 + 2.0 / resolution.columns)  # the lattice may slide by half a cell, borders stay unloaded
    cells, under_columns, spoiled = _across(spalls, offsets, reach_x, resolution.columns, lines, mirrored)
    depression = jnp.zeros((1, 1))
    for i, spall in enumerate(spalls):
        inside = (under_rows[i][:, None] & under_columns[i][None, :]) & near[i]
        depression = jnp.maximum(depression, jnp.where(inside, spall.depth, 0.0))  # Liu et al. 2018, eq. (3)
    narrow = jnp.stack([
        (jnp.abs(o) + 0.5 * s.width < reach_x) & (s.width > 0.0) & (s.width < 2.0 * reach_x / resolution.columns)
        for s, o in zip(spalls, offsets, strict=True)
    ])  # fmt: skip
    unresolved = spoiled | jnp.any(narrow)
    return Fitted(cells, depression, jnp.where(unresolved, status.UNRESOLVED, status.CONVERGED))


def _along(
    spans: list[tuple[jax.Array, ...]], bottom: jax.Array, top: jax.Array, resolution: Resolution, mirrored: bool
) -> tuple[jax.Array, list[jax.Array]]:
    """Lines along the roller, and for every spall which rows lie over it."""
    start = jnp.zeros(()) if mirrored else bottom
    ends = [span[1] for span in spans] if mirrored else [edge for span in spans for edge in span]
    into = np.array([-1.0] * len(spans) if mirrored else [1.0, -1.0] * len(spans))  # from an edge into its spall
    count, apart = len(ends), 0.5 * APART * 0.5 * (top - bottom)
    order = jnp.argsort(jax.lax.stop_gradient(jnp.stack(ends)))
    edges = jnp.stack(ends)[order]
    knots = [start]
    for i in range(count):
        knots.append(jnp.maximum(jnp.minimum(edges[i], top - (count - i) * apart), knots[-1] + apart))
    knots = jnp.stack([*knots, top])

    most = np.array([resolution.land] + [max(2 * resolution.spall, resolution.land // 2)] * (count - 1)
                    + [resolution.land])  # fmt: skip
    if mirrored:
        most[0] = resolution.spall
    lengths = jax.lax.stop_gradient(jnp.diff(knots))
    share = jnp.minimum(lengths / (FULL * 0.5 * jax.lax.stop_gradient(top - bottom)), 1.0)
    rows = jnp.maximum(jnp.round(most * share), 1.0).astype(int)
    rows = rows.at[jnp.argmax(lengths)].add(int(most.sum()) - jnp.sum(rows))  # what slivers do not need
    first = jnp.concatenate([jnp.zeros(1, int), jnp.cumsum(rows)])  # line that stands on each knot
    line = jnp.arange(int(most.sum()) + 1)
    part = jnp.clip(jnp.sum(line[:, None] >= first[None, 1:], axis=1), 0, count)
    s = (line - first[part]) / rows[part]
    both, end = 0.5 * (1.0 - jnp.cos(jnp.pi * s)), jnp.sin(0.5 * jnp.pi * s)
    gathered = jnp.where((part == 0) & mirrored, end, both)
    lines = knots[part] + (knots[part + 1] - knots[part]) * (0.05 * s + 0.95 * gathered)

    # the discrete edge acts as the true one from within the spall
    here, side = first[1:-1], jnp.asarray(into)[order].astype(int)
    land, hollow = jnp.abs(lines[here] - lines[here - side]), jnp.abs(lines[here + side] - lines[here])
    lines = lines.at[here].add(side * jnp.minimum(EDGE_SHIFT * land, 0.4 * hollow))

    rank = jnp.argsort(order)
    row = jnp.arange(int(most.sum()))
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
    borders = jnp.concatenate([x - 0.5 * pitch, x[-1:] + 0.5 * pitch])
    even, h = jax.lax.stop_gradient(borders), jax.lax.stop_gradient(pitch)
    column = jnp.arange(columns)

    def line_of(edge: jax.Array) -> jax.Array:
        return jnp.clip(jnp.round((jax.lax.stop_gradient(edge) - even[0]) / h), 0, columns).astype(int)

    taken, at = [], []
    for edge, into in ((left[0], 1), (right[0], -1)):
        inside = jnp.abs(edge) < reach
        k = line_of(edge + into * EDGE_SHIFT * pitch)
        taken.append((jnp.where(inside, k, -1), into, edge))
        at.append(jnp.where(inside, k, jnp.where(edge < 0.0, 0, columns)))
    low, high = at
    under = [(column >= low) & (column < high)]
    uneven, spoiled = [], jnp.asarray(False)
    for i, (a, b) in enumerate(zip(left[1:], right[1:], strict=True), 1):
        at = []
        for edge, into in ((a, 1), (b, -1)):
            inside = jnp.abs(edge) < reach
            edge = edge - into * i * APART_ACROSS * pitch
            even_shift = edge + into * EDGE_SHIFT * pitch
            k = nearest = jnp.clip(line_of(even_shift), 1, columns - 1)
            for other, *_ in taken:  # a line that stands on another edge stays there; take its neighbour
                k = jnp.where(k == other, k + jnp.where(even_shift >= borders[k], 1, -1), k)
            k = jnp.clip(k, 1, columns - 1)
            shift = EDGE_SHIFT / (1.0 - EDGE_SHIFT) * jnp.abs(edge - borders[k - into])
            wanted = jnp.where(k == nearest, edge + into * shift, even_shift)
            closest = 0.5 * APART_ACROSS * pitch
            wanted = jnp.clip(wanted, borders[k - 1] + closest, borders[k + 1] - closest)
            for other, facing, theirs in taken:  # two spalls that touch share one line
                ridge = into * (edge - theirs)
                touching = inside & (other >= 0) & (jnp.abs(ridge) < TOUCHING * pitch) & (facing != into)
                k, wanted = jnp.where(touching, other, k), jnp.where(touching, borders[other], wanted)
                spoiled = spoiled | (touching & (ridge > 0.1 * pitch))
            borders = jnp.where(inside, borders.at[k].set(wanted), borders)
            taken.append((jnp.where(inside, k, -1), into, edge))
            at.append(jnp.where(inside, k, jnp.where(edge < 0.0, 0, columns)))
            uneven += [k - 1, k]
        under.append((column >= at[0]) & (column < at[1]))
    spoiled = spoiled | (jnp.min(jnp.diff(borders)) < 0.4 * APART_ACROSS * h)
    centres = 0.5 * (borders[1:] + borders[:-1])
    return Cells(pitch, centres, lines, mirrored, Uneven(jnp.stack(uneven), borders)), under, spoiled
