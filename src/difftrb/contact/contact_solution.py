"""A solved contact, and how it is judged: forces on cells, approach, status."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp

from difftrb.contact import gap as gaps
from difftrb.contact.contact_problem import Defect, is_sound, listed
from difftrb.contact.halfspace import Cells
from difftrb.contact.height_map import HeightMap
from difftrb.core import status
from difftrb.core.geometry import LineContact, Spall


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "approach", "force", "cells", "load", "spall", "offset", "tilt", "gap", "contact_width", "loaded_fraction",
        "residual", "iterations", "unknowns", "status_code",
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
      load: [N]. spall, offset, tilt: what was given; `offset` one per spall of several, `tilt` None where it is 0.
      gap: initial gap [mm], shape of `force`.
      contact_width: longest extent of the contact in the rolling direction [mm].
      loaded_fraction: share of the roller's length on which some cell is loaded [-].
      residual: by cells, the largest violation of the contact conditions relative to the approach; by strips, the last
        change of a free boundary relative to the contact's half-width.
      iterations: applications of the influence matrix, or passes over the strips.
      unknowns: of the solve: cells, or modes of all strips.
      status_code: see `difftrb.status`; `status` is its sentence.
      accuracy: the relative accuracy of the approach that it was solved to: what was asked for or, where strips of
        that did not converge, another.
    """

    approach: jax.Array
    force: jax.Array
    cells: Cells
    load: jax.Array
    spall: Defect
    offset: jax.Array
    tilt: jax.Array | None
    gap: jax.Array
    contact_width: jax.Array
    loaded_fraction: jax.Array
    residual: jax.Array
    iterations: jax.Array
    unknowns: jax.Array
    status_code: jax.Array
    accuracy: float

    @property
    def pressure(self) -> jax.Array:
        """Mean pressure of every cell [N/mm²], shape (rows, columns)."""
        return self.force / self.cells.area

    @property
    def spalls(self) -> tuple[tuple[Spall | HeightMap, jax.Array], ...]:
        """Every spall or height map, and its offset [mm]."""
        spalls = listed(self.spall)
        return tuple(zip(spalls, jnp.broadcast_to(self.offset, (len(spalls),)), strict=True))

    @property
    def peak_pressure(self) -> jax.Array:
        """Largest cell pressure [N/mm²]. Singular at a spall's sharp edge: there it depends on the cell size."""
        return jnp.max(self.pressure)


def assembled(
    contact: LineContact, load: jax.Array, spall: Defect, offset: jax.Array, gap: jax.Array, cells: Cells,
    accuracy: float, tilt: jax.Array | None, *, approach: jax.Array, force: jax.Array, width: jax.Array,
    residual: jax.Array, iterations: jax.Array, unknowns: int, code: jax.Array,
) -> ContactSolution:  # fmt: skip
    """The solution as whichever way found it; `width` is the contact's, `code` what the way itself says of it."""
    sound = is_sound((contact, load, spall, offset, tilt))
    rows = jnp.where(jnp.any(force > 0.0, axis=1), jnp.sum(cells.area, axis=1), 0.0)
    fraction = jnp.sum(rows) / (jnp.sum(cells.widths) * contact.length)
    return ContactSolution(
        approach, force, cells, load, spall, offset, tilt, gap, jax.lax.stop_gradient(width),
        jax.lax.stop_gradient(fraction), jax.lax.stop_gradient(residual), iterations.astype(int), jnp.asarray(unknowns),
        jnp.where(sound, code, status.BAD_INPUT), accuracy,
    )  # fmt: skip


def extent(cells: Cells, force: jax.Array) -> jax.Array:
    """From the first to the last loaded column [mm]."""
    loaded, borders = jnp.any(force > 0.0, axis=0), cells.borders
    return jnp.max(jnp.where(loaded, borders[1:], -jnp.inf)) - jnp.min(jnp.where(loaded, borders[:-1], jnp.inf))


def verdict(approach: jax.Array, residual: jax.Array, tolerance: float) -> jax.Array:
    """The status that an iteration's last `residual` earns."""
    converged = jnp.where(residual <= tolerance, status.CONVERGED, status.NOT_CONVERGED)
    return jnp.where(jnp.isfinite(approach), converged, status.BAD_INPUT)


def border(cells: Cells, loaded: jax.Array, approach: jax.Array, gap: jax.Array, contact: LineContact) -> jax.Array:
    """Whether pressure is cut off by the domain's border: not by a roller's end, nor where the gap there rises above
    the approach, being the crown's beyond the mean of the last row."""
    rise = gaps.crown_at(cells.lines, contact)[jnp.array([0, -1])] - gaps.crown(cells, contact)[jnp.array([0, -1]), 0]
    at_ends = loaded[jnp.array([0, -1])] & (gap[jnp.array([0, -1])] + rise[:, None] < approach)
    touched = jnp.any(loaded[:, 0] | loaded[:, -1]) | jnp.any(at_ends[1 if cells.mirrored else 0 :])
    return jnp.where(touched, status.TOUCHES_BORDER, status.CONVERGED)
