"""One roller on one raceway: the half-space contact problem with a spall, solved by projected gradient.

Minimise ½ f·W f + f·gap over cell forces f ≥ 0 with Σf = load. The approach δ is the multiplier of the load: the
displaced gap W f + gap equals δ where cells are loaded and exceeds it elsewhere (Liu et al. 2018, eqs 1, 4).
"""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.core
import jax.numpy as jnp

from difftrb import gap as gaps
from difftrb import halfspace, hertz, status
from difftrb.geometry import LineContact, Real, Spall, as_floats, contact_is_sound, spall_is_sound
from difftrb.halfspace import Cells
from difftrb.press import TOLERANCE, press


@dataclasses.dataclass(frozen=True)
class Resolution:
    """How many cells: `columns` across the contact, `land` rows from a spall's end to the roller's end (or the end of
    the loaded part), `spall` rows along half a spall."""

    columns: int
    land: int
    spall: int


# Relative accuracy of the approach, and the grid measured to meet it (experiments/accuracy_of_contact.py).
RESOLUTIONS = {1e-2: Resolution(16, 12, 6), 1e-3: Resolution(32, 20, 8), 1e-4: Resolution(64, 64, 16)}


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "approach", "force", "cells", "load", "spall", "offset", "gap", "contact_width", "loaded_fraction", "residual",
        "iterations", "status_code",
    ],
    meta_fields=["accuracy"],
)  # fmt: skip
@dataclasses.dataclass(frozen=True)
class ContactSolution(status.Judged):
    """A solved contact.

    Attributes:
      approach: δ of the two bodies, contact alone [mm].
      force: of every cell [N], shape (rows, columns); a mirrored cell counts both halves.
      cells: the grid: `cells.x`, `cells.y` centres [mm].
      load: [N]. spall, offset: what was given. gap: initial gap [mm], shape of `force`.
      contact_width: longest extent of the loaded cells in the rolling direction [mm].
      loaded_fraction: share of the roller's length on which some cell is loaded [-].
      residual: largest violation of the contact conditions, relative to the approach.
      iterations: applications of the influence matrix.
      status_code: see `difftrb.status`; `status` is its sentence.
      accuracy: the relative accuracy of the approach that was asked for.
    """

    approach: jax.Array
    force: jax.Array
    cells: Cells
    load: jax.Array
    spall: Spall | None
    offset: jax.Array
    gap: jax.Array
    contact_width: jax.Array
    loaded_fraction: jax.Array
    residual: jax.Array
    iterations: jax.Array
    status_code: jax.Array
    accuracy: float

    @property
    def pressure(self) -> jax.Array:
        """Mean pressure of every cell [N/mm²], shape (rows, columns)."""
        return self.force / self.cells.area[:, None]

    @property
    def peak_pressure(self) -> jax.Array:
        """Largest cell pressure [N/mm²]. Singular at a spall's sharp edge: there it depends on the cell size."""
        return jnp.max(self.pressure)

    @property
    def unknowns(self) -> int:
        """Number of cells."""
        return self.force.shape[-1] * self.force.shape[-2]


def solve_contact(
    contact: LineContact,
    load: Real,
    spall: Spall | None = None,
    offset: Real = 0.0,
    accuracy: float = 1e-3,
) -> ContactSolution:
    """Press a roller on a raceway, with or without a spall between them.

    Args:
      contact: radius, length, modulus and crown, from `LineContact.of`.
      load: normal load of the roller [N], > 0.
      spall: None is a healthy raceway.
      offset: of the spall's centre from the contact's, in the rolling direction [mm].
      accuracy: relative accuracy of the approach, 1e-2…1e-4; a smaller number costs time. Where a heavily loaded
        contact laps over a rolling edge by a few cells only, it is not met: 1.6e-2, 6e-3, 2e-3 were seen for 1e-2,
        1e-3, 1e-4.

    A spall whose `axial_offset` is 0, and not being traced, is solved on half the roller. Differentiable by every
    number in `contact`, `spall`, `load` and `offset`, forward and reverse; `jit` and `vmap` as you like (`lax.map` is
    faster for batches on a CPU). Raises ValueError for an accuracy out of range, SolveError without float64;
    everything else ends as a status in the result.
    """
    status.require_float64()
    resolution = resolution_for(accuracy)
    mirrored = is_symmetric(spall)
    contact, spall = as_floats((contact, spall))
    return _solve(contact, jnp.asarray(load, float), spall, jnp.asarray(offset, float), resolution, mirrored, accuracy)


def approach_slopes(
    contact: LineContact, load: Real, spall: Spall | None = None, offset: Real = 0.0, accuracy: float = 1e-3
) -> dict[str, Real | None]:
    """Derivatives of the approach [mm] by load [N], length, width, offset, radius [mm] and design_load [N].

    All from one linear solve (reverse mode). None where there is no spall to change. Arguments as `solve_contact`.
    """
    status.require_float64()
    inputs = as_floats(contact), jnp.asarray(load, float), as_floats(spall), jnp.asarray(offset, float)
    by_contact, by_load, by_spall, by_offset = _slopes(*inputs, resolution_for(accuracy), is_symmetric(spall), accuracy)
    there = by_spall is not None
    return {
        "load": by_load,
        "length": by_spall.length if there else None,
        "width": by_spall.width if there else None,
        "offset": by_offset if there else None,
        "radius": by_contact.radius,
        "design_load": by_contact.design_load,
    }


def resolution_for(accuracy: float) -> Resolution:
    """The cheapest grid measured to reach a relative `accuracy` of the approach."""
    enough = [a for a in RESOLUTIONS if a <= accuracy * (1.0 + 1e-9)]
    if not enough or not accuracy <= max(RESOLUTIONS):
        raise ValueError(f"accuracy = {accuracy!r} is out of range: {min(RESOLUTIONS):g} … {max(RESOLUTIONS):g}")
    return RESOLUTIONS[max(enough)]


def is_symmetric(spall: Spall | None) -> bool:
    """Whether the contact is known to be symmetric about the roller's middle: no spall, or `axial_offset` a plain 0."""
    if spall is None:
        return True
    known = not isinstance(spall.axial_offset, jax.core.Tracer)
    return known and float(spall.axial_offset) == 0.0


@partial(jax.jit, static_argnames=("resolution", "mirrored", "accuracy"))
def _solve(
    contact: LineContact,
    load: jax.Array,
    spall: Spall | None,
    offset: jax.Array,
    resolution: Resolution,
    mirrored: bool,
    accuracy: float,
) -> ContactSolution:
    cells, domain_status = fitted_cells(contact, load, spall, offset, resolution, mirrored)
    gap = gaps.curvature(cells, contact.radius) + gaps.crown(cells, contact)
    if spall is not None:
        gap = gap + gaps.depression(cells, spall, offset)
    level = jax.lax.stop_gradient(0.4 * jnp.max(gaps.curvature(cells, contact.radius)))
    force, approach, residual, iterations = press(cells, contact.modulus, gap, load, level)
    loaded = force > 0.0
    code = status.worst(domain_status, _verdict(approach, residual), _border(cells, loaded, approach, contact))
    sound = contact_is_sound(contact) & (load > 0.0) & jnp.isfinite(offset)
    if spall is not None:
        sound = sound & spall_is_sound(spall)
    code = jnp.where(sound, code, status.BAD_INPUT)
    columns = jnp.any(loaded, axis=0)
    extent = jnp.max(jnp.where(columns, cells.x, -jnp.inf)) - jnp.min(jnp.where(columns, cells.x, jnp.inf))
    width = extent + cells.pitch
    fraction = jnp.sum(jnp.where(jnp.any(loaded, axis=1), cells.area, 0.0)) / (cells.pitch * contact.length)
    return ContactSolution(
        approach, force, cells, load, spall, offset, gap, jax.lax.stop_gradient(width), jax.lax.stop_gradient(fraction),
        residual, iterations.astype(int), code, accuracy,
    )  # fmt: skip


@partial(jax.jit, static_argnums=(4, 5, 6))
def _slopes(*arguments):
    """Derivatives of the approach by the first four arguments of `_solve`."""
    return jax.grad(lambda *a: _solve(*a).approach, argnums=(0, 1, 2, 3))(*arguments)


def _verdict(approach: jax.Array, residual: jax.Array) -> jax.Array:
    converged = jnp.where(residual <= TOLERANCE, status.CONVERGED, status.NOT_CONVERGED)
    return jnp.where(jnp.isfinite(approach), converged, status.BAD_INPUT)


def _border(cells: Cells, loaded: jax.Array, approach: jax.Array, contact: LineContact) -> jax.Array:
    """Whether pressure is cut off by the domain's border: not by a roller's end, nor where the crown is too high."""
    crown = gaps.crown_at(cells.lines, contact)
    touched = jnp.any(loaded[:, 0] | loaded[:, -1]) | (jnp.any(loaded[-1]) & (crown[-1] < approach))
    if not cells.mirrored:
        touched = touched | (jnp.any(loaded[0]) & (crown[0] < approach))
    return jnp.where(touched, status.TOUCHES_BORDER, status.CONVERGED)


# ---------------------------------------------------------------------------------------------- the domain


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
    delta = _sunk(contact, needed, jnp.zeros(()), jnp.zeros(()))
    if spall is not None:
        low, high = (jnp.clip(spall.axial_offset + side * 0.5 * spall.length, -half, half) for side in (-1.0, 1.0))
        delta = jnp.minimum(_sunk(contact, needed, low, high), delta + spall.depth)  # at most down to its bottom
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


def _sunk(contact: LineContact, needed: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """The approach at which slices with unit stiffness, all but those between `low` and `high`, carry `needed`."""
    half = 0.5 * contact.length
    s = (jnp.arange(64) + 0.5) / 64.0
    land = jnp.maximum(jnp.stack([half - high, low + half]), 1e-3 * half)
    y = jnp.stack([high, -low])[:, None] + land[:, None] * (s**3)[None, :]
    weight = land[:, None] * (3.0 * s**2 / 64.0)[None, :]
    crown = gaps.crown_at(jnp.minimum(jnp.abs(y), half * (1.0 - 1e-9)), contact)

    def newton(_: int, delta: jax.Array) -> jax.Array:
        pressed = delta > crown
        carried = jnp.sum(jnp.where(pressed, weight * (delta - crown), 0.0))
        slope = jnp.sum(jnp.where(pressed, weight, 0.0))
        return delta - (carried - needed) / jnp.maximum(slope, jnp.min(weight))

    start = needed / jnp.sum(weight) + jnp.max(crown)
    found = jax.lax.stop_gradient(jax.lax.fori_loop(0, 30, newton, start))
    return newton(0, found)  # one step from the solution carries its derivatives
