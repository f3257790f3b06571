"""Cells, the gap of the undeformed surfaces on them, and closed forms of a single line contact.

Every term of the gap is the mean over a cell [mm]; terms add. Lengths in mm, loads in N, E' = contact modulus [N/mm²]
(`geometry.contact_modulus`), R = equivalent radius [mm].
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from difftrb.contact import crown
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Real, Spall

APPROACH_EXPONENT = 0.9
"""Of δ over Q of a line contact: Palmgren 1959."""
LOAD_EXPONENT = 1.0 / APPROACH_EXPONENT
"""10/9, of Q over δ; as in ISO/TS 16281:2008, eq. (38)."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Uneven:
    """Columns of cells that are not as wide as the others.

    Attributes:
      columns: their indices, shape (uneven,); a column named twice counts once.
      borders: all cell boundaries in x [mm], shape (columns + 1,), increasing.
    """

    columns: jax.Array
    borders: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Cells:
    """A tensor grid of pressure cells: equal pitch across the contact (x), graded lines along the roller (y).

    Attributes:
      pitch: width of every cell in x [mm], except the `uneven` ones.
      x: cell centres in x [mm], shape (columns,).
      lines: cell boundaries in y [mm], shape (rows + 1,), increasing.
      mirrored: the grid is the half y ≥ 0 of a contact symmetric about y = 0; a cell's force then counts both halves.
      uneven: columns of another width, default None.
    """

    pitch: jax.Array
    x: jax.Array
    lines: jax.Array
    mirrored: bool = dataclasses.field(metadata={"static": True})
    uneven: Uneven | None = None

    @property
    def y(self) -> jax.Array:
        """Cell centres in y [mm], shape (rows,)."""
        return 0.5 * (self.lines[1:] + self.lines[:-1])

    @property
    def borders(self) -> jax.Array:
        """Cell boundaries in x [mm], shape (columns + 1,)."""
        if self.uneven is not None:
            return self.uneven.borders
        return xp.concatenate([self.x - 0.5 * self.pitch, self.x[-1:] + 0.5 * self.pitch])

    @property
    def widths(self) -> jax.Array:
        """Of the columns [mm], shape (columns,)."""
        if self.uneven is not None:
            return xp.diff(self.uneven.borders)
        return xp.broadcast_to(self.pitch[None], self.x.shape)

    @property
    def area(self) -> jax.Array:
        """Of the cells (of both mirror images) [mm²], shape (rows, columns)."""
        return (2.0 if self.mirrored else 1.0) * xp.diff(self.lines)[:, None] * self.widths[None, :]


def curvature(cells: Cells, radius: Real) -> jax.Array:
    """x²/(2R), shape (1, columns)."""
    return ((cells.x**2 + cells.widths**2 / 12.0) / (2.0 * radius))[None, :]


def first_level(cells: Cells, radius: Real) -> jax.Array:
    """The gap up to which a first guess puts pressure [mm]: 0.4 of the largest curvature gap."""
    return 0.4 * xp.max(xp.fixed(curvature(cells, radius)))


def undeformed(cells: Cells, contact: LineContact, slope: Real | None) -> jax.Array:
    """Curvature, crown and tilt (None: not tilted), shape (rows, columns)."""
    gap = curvature(cells, contact.radius) + crown.mean_of_rows(cells.lines, contact)[:, None]
    return gap if slope is None else gap + (slope * cells.y)[:, None]


def rest_at(y: jax.Array, contact: LineContact, slope: Real | None) -> jax.Array:
    """Gap along the roller's line x = 0 at positions `y` [mm], from crown and tilt (None: not tilted)."""
    return crown.height(y, contact) if slope is None else crown.height(y, contact) + slope * y


def depression(cells: Cells, spall: Spall, offset: Real) -> jax.Array:
    """Depth of the spall under the cells whose centre lies in it, shape (rows, columns).

    `offset` is the distance of the spall's centre from the contact's in the rolling direction [mm]. Walls are
    vertical; cells follow the edges, so the mask is exact and has no derivative of its own.
    """
    across = xp.magnitude(cells.x - offset) < 0.5 * spall.width
    along = xp.magnitude(cells.y if cells.mirrored else cells.y - spall.axial_offset) < 0.5 * spall.length
    return xp.where(along[:, None] & across[None, :], spall.depth, 0.0)  # Liu et al. 2018, eq. (3)


# ------------------------------------------------------------------------------------------ closed forms


def certain_reach(radius: Real, approach: Real) -> Real:
    """Where a roller's curvature alone exceeds the approach [mm]: no contact reaches farther from its middle."""
    return xp.sqrt(2.0 * radius * approach)


def half_width(contact: LineContact, loads: Any) -> np.ndarray:
    """Of contacts under `loads` [N], spread evenly over the roller: Hertz's half-width [mm], of numbers."""
    line_loads = np.maximum(loads, 0.0) / contact.length
    return np.asarray(line_half_width(line_loads, contact.radius, contact.modulus))


def line_half_width(line_load: Real, radius: Real, modulus: Real) -> Real:
    """Half width b of a line contact [mm] under `line_load` [N/mm]."""
    return xp.sqrt(4.0 * line_load * radius / (np.pi * modulus))  # Johnson 1985, eq. (4.43)


def line_load_at(half_width: Real, radius: Real, modulus: Real) -> Real:
    """The line load [N/mm] under which a line contact has this half width [mm]: the inverse of `line_half_width`."""
    return 0.25 * np.pi * modulus * half_width**2 / radius


def palmgren_approach(load: Real, length: Real) -> Real:
    """Approach of a steel roller and one raceway [mm]; `lamina_stiffness`, of both, is 2.07 times as soft."""
    return 3.84e-5 * load**APPROACH_EXPONENT / length**0.8  # Palmgren 1959


def lamina_stiffness(length: Real) -> Real:
    """Spring constant c_L of a whole steel roller between its raceways [N/mm^(10/9)], Q = c_L δ^(10/9)."""
    return 35948.0 * length ** (8.0 / 9.0)  # ISO/TS 16281:2008, eq. (38)
