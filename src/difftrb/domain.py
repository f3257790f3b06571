"""Where pressure can be: the cells or the rows of strips that one contact is solved on."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from difftrb import gap as gaps
from difftrb import halfspace, hertz, status
from difftrb.geometry import LineContact, Spall
from difftrb.halfspace import Cells


@dataclasses.dataclass(frozen=True)
class Resolution:
    """How many cells: `columns` across the contact, `land` rows from a spall's end to the roller's end (or the end of
    the loaded part), `spall` rows along half a spall."""

    columns: int
    land: int
    spall: int


def fitted_cells(
    contact: LineContact,
    load: jax.Array,
    spall: Spall | None,
    offset: jax.Array,
    resolution: Resolution,
    mirrored: bool,
) -> tuple[Cells, jax.Array]:
    """Cells for one contact: they span where pressure can be, and have boundaries on the spall's edges."""
    reach_x, reach_y = domain(contact, load, spall)
    reach_x = reach_x * (1.0 + 2.0 / resolution.columns)  # the lattice may slide by half a cell, borders stay unloaded
    if spall is None:
        nowhere = jnp.asarray(jnp.inf)
        pitch, x = halfspace.lattice(reach_x, resolution.columns, -nowhere, nowhere)
        half = halfspace.graded(jnp.zeros(()), reach_y, resolution.land, at_start=False, at_end=True)
        lines = half if mirrored else jnp.concatenate([-half[:0:-1], half])
        return Cells(pitch, x, lines, mirrored), jnp.asarray(status.CONVERGED)

    pitch, x = halfspace.lattice(reach_x, resolution.columns, offset - 0.5 * spall.width, offset + 0.5 * spall.width)
    sliver = 2e-3 * reach_y  # no segment of the grid is thinner
    high = jnp.clip(spall.axial_offset + 0.5 * spall.length, -reach_y + 2.0 * sliver, reach_y - sliver)
    if mirrored:
        edge = jnp.maximum(high, sliver)
        land = _beyond_edge(halfspace.graded(edge, reach_y, resolution.land, at_start=True, at_end=True), edge)
        hollow = halfspace.graded(jnp.zeros(()), land[0], resolution.spall, at_start=False, at_end=True)
        lines = jnp.concatenate([hollow, land[1:]])
    else:
        low = jnp.clip(spall.axial_offset - 0.5 * spall.length, -reach_y + sliver, high - sliver)
        upper = halfspace.graded(high, reach_y, resolution.land, at_start=True, at_end=True)
        lower = halfspace.graded(-low, reach_y, resolution.land, at_start=True, at_end=True)
        upper, lower = _beyond_edge(upper, 0.5 * (high - low)), -_beyond_edge(lower, 0.5 * (high - low))[::-1]
        hollow = halfspace.graded(lower[-1], upper[0], 2 * resolution.spall, at_start=True, at_end=True)
        lines = jnp.concatenate([lower, hollow[1:-1], upper])
    inside = jnp.abs(offset) + 0.5 * spall.width < reach_x
    unresolved = inside & (spall.width < 2.0 * reach_x / resolution.columns)
    return Cells(pitch, x, lines, mirrored), jnp.where(unresolved, status.UNRESOLVED, status.CONVERGED)


def _beyond_edge(land: jax.Array, room: jax.Array) -> jax.Array:
    """Land lines with the first one drawn into the spall, where the discrete edge acts as the true one; by at most
    half the `room` [mm] that there is."""
    return land.at[0].add(-jnp.minimum(halfspace.EDGE_SHIFT * (land[1] - land[0]), 0.5 * room))


def domain(contact: LineContact, load: jax.Array, spall: Spall | None) -> tuple[jax.Array, jax.Array]:
    """Half extents of the solution domain in x and y [mm]: where the gap is less than an upper estimate of δ.

    The estimate is a foundation of independent slices, each with the stiffness of a long line contact, of which the
    spall carries nothing. Extents are differentiated like everything else: the grid breathes with the contact, so the
    free boundary keeps its place among the cells and derivatives by load and radius do not ripple.
    """
    half = 0.5 * contact.length
    half_width = hertz.line_half_width(load / contact.length, contact.radius, contact.modulus)
    slice_stiffness = jnp.pi * contact.modulus / (2.0 * jnp.log(4.0 * half / half_width) + 1.0)  # long cylinder
    needed = load / slice_stiffness
    delta = _sunk(contact, needed, jnp.zeros(()), jnp.zeros(()), jnp.ones(2))
    if spall is not None:
        low, high = (jnp.clip(spall.axial_offset + side * 0.5 * spall.length, -half, half) for side in (-1.0, 1.0))
        delta = jnp.minimum(
            _sunk(contact, needed, low, high, jnp.ones(2)), delta + spall.depth
        )  # at most down to its bottom
    delta = 1.15 * delta
    scale = gaps.crown_scale(contact)
    unloaded = jnp.where(scale > 0.0, jnp.exp(-delta / jnp.where(scale > 0.0, scale, 1.0)), 0.0)
    reach_y = half * jnp.sqrt(1.0 - unloaded)
    certain = jnp.sqrt(2.0 * contact.radius * delta)  # beyond it the gap exceeds the approach
    slenderness = jnp.maximum(2.0 * jnp.log(4.0 * reach_y / certain) + 1.0, 3.0)
    # slices, and a margin for the peaks at spall edges and, where the crown no longer relieves them, at roller ends
    margin = 1.75 + 2.0 * jnp.clip((delta / 100.0 - scale) / (scale + 1e-12 * delta), 0.0, 1.0)
    widest = margin * jnp.sqrt(4.0 * contact.radius * delta / slenderness)
    return jnp.minimum(certain, widest), reach_y


def _sunk(contact: LineContact, needed: jax.Array, low: jax.Array, high: jax.Array, stiffness: jax.Array) -> jax.Array:
    """The approach at which slices carry `needed`: those above `high` and those below `low`, of given stiffnesses."""
    half = 0.5 * contact.length
    s = (jnp.arange(64) + 0.5) / 64.0
    land = jnp.maximum(jnp.stack([half - high, low + half]), 1e-3 * half)
    y = jnp.stack([high, -low])[:, None] + land[:, None] * (s**3)[None, :]
    weight = (stiffness * land)[:, None] * (3.0 * s**2 / 64.0)[None, :]
    crown = gaps.crown_at(jnp.minimum(jnp.abs(y), half * (1.0 - 1e-9)), contact)

    def newton(_: int, delta: jax.Array) -> jax.Array:
        pressed = delta > crown
        carried = jnp.sum(jnp.where(pressed, weight * (delta - crown), 0.0))
        slope = jnp.sum(jnp.where(pressed, weight, 0.0))
        return delta - (carried - needed) / jnp.maximum(slope, jnp.min(weight))

    start = needed / jnp.sum(weight) + jnp.max(crown)
    found = jax.lax.stop_gradient(jax.lax.fori_loop(0, 30, newton, start))
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
        half_width = hertz.line_half_width(load / jnp.sum(length), contact.radius, contact.modulus)
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
    return tip, line_load, jnp.asarray(hertz.line_half_width(line_load, contact.radius, contact.modulus)), delta
