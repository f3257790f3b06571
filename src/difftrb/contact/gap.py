"""The gap between the undeformed surfaces, as terms that add; every term is the mean over the cells [mm]."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from difftrb.contact.halfspace import Cells
from difftrb.core.geometry import LineContact, Real, Spall


def curvature(cells: Cells, radius: Real) -> jax.Array:
    """x²/(2R), shape (1, columns)."""
    return ((cells.x**2 + cells.widths**2 / 12.0) / (2.0 * radius))[None, :]


def first_level(cells: Cells, radius: Real) -> jax.Array:
    """The gap up to which a first guess puts pressure [mm]: over six tenths of the cells' reach in x."""
    return jax.lax.stop_gradient(0.4 * jnp.max(curvature(cells, radius)))


def tilt(cells: Cells, slope: Real) -> jax.Array:
    """`slope`·y of a roller turned by `slope` [rad] about its middle, shape (rows, 1)."""
    return (slope * cells.y)[:, None]


def crown(cells: Cells, contact: LineContact) -> jax.Array:
    """Logarithmic crown of the roller, shape (rows, 1); integrable where it is infinite, at the roller's ends."""
    t = jnp.clip(2.0 * cells.lines / contact.length, -1.0, 1.0)
    inside = jnp.diff(t)
    mean = jnp.diff(_log_integral(t)) / jnp.where(inside > 0.0, inside, 1.0)
    return (crown_scale(contact) * mean)[:, None]


def crown_scale(contact: LineContact) -> Real:
    """Q_d/(πE'l) [mm], the length that multiplies the crown's logarithm."""
    return contact.design_load / (jnp.pi * contact.modulus * contact.length)  # Liu et al. 2018, eq. (2)


def log_crown(t: jax.Array, room: float) -> jax.Array:
    """ln(1/(1−t²)), the crown in its scale at t = 2y/length; beyond 1−t² = `room` it stays as it is there."""
    return -jnp.log1p(-jnp.minimum(t * t, 1.0 - room))  # Liu et al. 2018, eq. (2)


def crown_at(y: jax.Array, contact: LineContact) -> jax.Array:
    """Logarithmic crown at positions `y` [mm] along the roller; infinite at the roller's ends unless straight."""
    t = 2.0 * y / contact.length
    inside = jnp.abs(t) < 1.0 - 1e-12
    return jnp.where(inside, crown_scale(contact) * log_crown(jnp.where(inside, t, 0.0), 1e-13), jnp.inf)


def _log_integral(t: jax.Array) -> jax.Array:
    """∫₀ᵗ ln(1/(1−s²)) ds."""
    return xlogx(1.0 - t) - xlogx(1.0 + t) + 2.0 * t


def xlogx(v: jax.Array) -> jax.Array:
    """v ln v, 0 at 0."""
    return v * jnp.log(jnp.where(v > 0.0, v, 1.0))


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
    vertical and stay so: cells follow the edges, hence the mask is exact and has no derivative of its own.
    """
    across = jnp.abs(cells.x - offset) < 0.5 * spall.width
    along = jnp.abs(cells.y - spall.axial_offset) < 0.5 * spall.length
    if cells.mirrored:
        along = jnp.abs(cells.y) < 0.5 * spall.length
    return spall.depth * (along[:, None] & across[None, :])  # Liu et al. 2018, eq. (3)
