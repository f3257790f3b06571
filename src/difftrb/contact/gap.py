"""Cells, the gap of the undeformed surfaces on them, and closed forms of a single line contact.

Every term of the gap is the mean over a cell [mm]; terms add. Lengths in mm, loads in N, E' = contact modulus [N/mm²]
(`geometry.contact_modulus`), R = equivalent radius [mm].
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Real, Spall


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
        return xp.broadcast_to(self.pitch, self.x.shape) if self.uneven is None else xp.diff(self.uneven.borders)

    @property
    def area(self) -> jax.Array:
        """Of the cells (of both mirror images) [mm²], shape (rows, columns)."""
        return (2.0 if self.mirrored else 1.0) * xp.diff(self.lines)[:, None] * self.widths[None, :]


def curvature(cells: Cells, radius: Real) -> jax.Array:
    """x²/(2R), shape (1, columns)."""
    return ((cells.x**2 + cells.widths**2 / 12.0) / (2.0 * radius))[None, :]


def first_level(cells: Cells, radius: Real) -> jax.Array:
    """The gap up to which a first guess puts pressure [mm]: 0.4 of the largest curvature gap."""
    return xp.fixed(0.4 * xp.max(curvature(cells, radius)))


def tilt(cells: Cells, slope: Real) -> jax.Array:
    """`slope`·y of a roller turned by `slope` [rad] about its middle, shape (rows, 1)."""
    return (slope * cells.y)[:, None]


def crown(cells: Cells, contact: LineContact) -> jax.Array:
    """Logarithmic crown of the roller, shape (rows, 1); integrable where it is infinite, at the roller's ends."""
    t = xp.clip(2.0 * cells.lines / contact.length, -1.0, 1.0)
    inside = xp.diff(t)
    mean = xp.diff(_log_integral(t)) / xp.where(inside > 0.0, inside, 1.0)
    return (crown_scale(contact) * mean)[:, None]


def crown_scale(contact: LineContact) -> Real:
    """Q_d/(πE'l) [mm], the length that multiplies the crown's logarithm."""
    return contact.design_load / (np.pi * contact.modulus * contact.length)  # Liu et al. 2018, eq. (2)


def log_crown(t: Real, room: float) -> Any:
    """ln(1/(1−t²)), the crown in its scale at t = 2y/length; beyond 1−t² = `room` it stays as it is there."""
    return -xp.log1p(-xp.minimum(t * t, 1.0 - room))  # Liu et al. 2018, eq. (2)


def crown_at(y: Real, contact: LineContact) -> Any:
    """Logarithmic crown at positions `y` [mm] along the roller; infinite at the roller's ends unless straight."""
    t = 2.0 * y / contact.length
    inside = (t < 1.0 - 1e-12) & (t > 1e-12 - 1.0)
    return xp.where(inside, crown_scale(contact) * log_crown(xp.where(inside, t, 0.0), 1e-13), np.inf)


def _log_integral(t: jax.Array) -> jax.Array:
    """∫₀ᵗ ln(1/(1−s²)) ds."""
    return xlogx(1.0 - t) - xlogx(1.0 + t) + 2.0 * t


def xlogx(v: jax.Array) -> jax.Array:
    """v ln v, 0 at 0."""
    return v * xp.log(xp.where(v > 0.0, v, 1.0))


def undeformed(cells: Cells, contact: LineContact, slope: Real | None) -> jax.Array:
    """Curvature, crown and tilt (None: not tilted), shape (rows, columns)."""
    gap = curvature(cells, contact.radius) + crown(cells, contact)
    return gap if slope is None else gap + tilt(cells, slope)


def rest_at(y: jax.Array, contact: LineContact, slope: Real | None) -> jax.Array:
    """Gap along the roller's line x = 0 at positions `y` [mm], from crown and tilt (None: not tilted)."""
    return crown_at(y, contact) if slope is None else crown_at(y, contact) + slope * y


def depression(cells: Cells, spall: Spall, offset: Real) -> jax.Array:
    """Depth of the spall under the cells whose centre lies in it, shape (rows, columns).

    `offset` is the distance of the spall's centre from the contact's in the rolling direction [mm]. Walls are
    vertical; cells follow the edges, so the mask is exact and has no derivative of its own.
    """
    across = xp.abs(cells.x - offset) < 0.5 * spall.width
    along = xp.abs(cells.y - spall.axial_offset) < 0.5 * spall.length
    if cells.mirrored:
        along = xp.abs(cells.y) < 0.5 * spall.length
    return spall.depth * (along[:, None] & across[None, :])  # Liu et al. 2018, eq. (3)


def rest_slope(y: Real, contact: LineContact, slope: Real | None) -> Real:
    """The derivative of `rest_at` by `y`, between the roller's ends."""
    t = 2.0 * y / contact.length
    rise = crown_scale(contact) * 4.0 * t / ((1.0 - t * t) * contact.length)
    return rise if slope is None else rise + slope


# ------------------------------------------------------------------------------------------ closed forms


def line_half_width(line_load: Real, radius: Real, modulus: Real) -> Real:
    """Half width b of a line contact [mm] under `line_load` [N/mm]."""
    return xp.sqrt(4.0 * line_load * radius / (np.pi * modulus))  # Johnson 1985, eq. (4.43)


def palmgren_approach(load: Real, length: Real) -> Real:
    """Approach of inner and outer ring about one steel roller [mm], both contacts together."""
    return 3.84e-5 * load**0.9 / length**0.8  # Palmgren 1959


def lamina_stiffness(length: Real) -> Real:
    """Spring constant c_L of a whole roller between its raceways [N/mm^(10/9)], Q = c_L δ^(10/9)."""
    return 35948.0 * length ** (8.0 / 9.0)  # ISO/TS 16281:2008, eq. (38)
