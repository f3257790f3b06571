"""The half-space on a uniform lattice, applied by FFT in both directions: for height maps, and as a second opinion.

The same Galerkin coefficients as `halfspace`, which here depend on differences in y too. Nothing but the first spall's
edges is followed: a wall elsewhere stands where the nearest line does, so errors fall with the first power of a cell.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from difftrb.contact import contact_extent, halfspace
from difftrb.contact import gap as gaps
from difftrb.contact.halfspace import Cells
from difftrb.contact.height_map import HeightMap, height_at
from difftrb.core.geometry import LineContact, Spall

AWAY = 1e3
"""Gap beyond the roller's ends [mm]."""


@partial(jax.tree_util.register_dataclass, data_fields=["spectrum", "diagonal"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Convolution:
    """Influence on a uniform lattice: its Fourier coefficients on twice the lattice, shape (2 rows, columns + 1), and a
    cell's influence on itself, shape (1, 1)."""

    spectrum: jax.Array
    diagonal: jax.Array

    def displacement(self, force: jax.Array) -> jax.Array:
        rows, columns = force.shape
        size = (2 * rows, 2 * columns)
        return jnp.fft.irfft2(jnp.fft.rfft2(force, size) * self.spectrum, size)[:rows, :columns]

    def scaled(self, factor: jax.Array) -> Convolution:
        return Convolution(factor * self.spectrum, factor * self.diagonal)

    def resistance(self) -> Callable[[jax.Array], jax.Array]:
        """The inverse of the spectrum, which is positive."""
        return Convolution(1.0 / self.spectrum, 1.0 / self.diagonal).displacement


def influence(cells: Cells, modulus: jax.Array) -> Convolution:
    """Mean displacement [mm] of a cell by a unit force [N] on another; all cells of one height, not mirrored."""
    rows, columns = cells.y.shape[0], cells.x.shape[0]
    height = (cells.lines[-1] - cells.lines[0]) / rows
    x, y = cells.pitch * jnp.arange(-1, columns + 2), height * jnp.arange(-1, rows + 2)
    g = halfspace.primitive(x[None, :], y[:, None])
    for _ in range(2):  # second differences, in x and then in y
        g = (g[:, 2:] - 2.0 * g[:, 1:-1] + g[:, :-2]).T
    kernel = g / (jnp.pi * modulus * (cells.pitch * height) ** 2)
    for _ in range(2):
        kernel = jnp.concatenate([kernel, kernel[-2:0:-1]]).T  # even extensions: a real spectrum
    return Convolution(jnp.fft.rfft2(kernel).real, kernel[:1, :1])


Defects = tuple[Spall | HeightMap, ...]


def fitted(
    contact: LineContact,
    load: jax.Array,
    defects: Defects,
    offsets: jax.Array,
    size: tuple[int, int],
    tilt: jax.Array | None,
) -> tuple[Cells, jax.Array]:
    """A lattice of `size` (rows, columns) where pressure can be, and the defects' depth on it [mm].

    With a spall it is laid on the first one's edges, moved as in `halfspace.lattice`. Depths are those at the cells'
    centres.
    """
    rows, columns = size
    spalls = tuple(each for each in defects if isinstance(each, Spall))
    if len(spalls) == len(defects):
        reach_x, bottom, top = contact_extent.domain(contact, load, spalls, offsets, tilt)
    else:
        reach_x, bottom, top = _domain(contact, load, defects, offsets, tilt)
    nowhere = -jnp.asarray(jnp.inf), jnp.asarray(jnp.inf)
    left, right = low, high = nowhere
    middle, reach_y = 0.5 * (bottom + top), 0.5 * (top - bottom)
    if defects and isinstance(defects[0], Spall):
        first, offset = defects[0], offsets[0]
        left, right = offset - 0.5 * first.width, offset + 0.5 * first.width
        low, high = (first.axial_offset + side * first.length - middle for side in (-0.5, 0.5))
    pitch, x = halfspace.lattice(reach_x * (1.0 + 2.0 / columns), columns, left, right)
    if spalls:
        height, y = halfspace.lattice(reach_y * (1.0 + 2.0 / rows), rows, low, high)
        lines = middle + jnp.concatenate([y - 0.5 * height, y[-1:] + 0.5 * height])
    else:
        lines = jnp.linspace(bottom, top, rows + 1)
    cells = Cells(pitch, x, lines, False)
    beyond = jnp.where(jnp.abs(cells.y) > 0.5 * contact.length, AWAY, 0.0)[:, None]
    return cells, beyond + depth_at(defects, offsets, cells.x, cells.y)


def depth_at(defects: Defects, offsets: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """Depth below the raceway [mm] at all pairs of `y` and `x`: of the deepest defect there, less the highest rim."""
    deep = high = jnp.zeros((y.shape[0], x.shape[0]))
    for i, each in enumerate(defects):
        if isinstance(each, HeightMap):
            height = height_at(each, offsets[i], x, y)
            deep, high = jnp.maximum(deep, -height), jnp.maximum(high, height)
        else:
            across = jnp.abs(x - offsets[i]) < 0.5 * each.width
            along = jnp.abs(y - each.axial_offset) < 0.5 * each.length
            deep = jnp.maximum(deep, each.depth * (along[:, None] & across[None, :]))
    return deep - high


def _domain(
    contact: LineContact, load: jax.Array, defects: Defects, offsets: jax.Array, tilt: jax.Array | None
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """As `contact_extent.domain`, for surfaces of any shape: slices begin to carry where their gap is least."""
    reach, _, _ = contact_extent.domain(contact, load, (), offsets, tilt)
    half = 0.5 * contact.length
    x = reach * jnp.linspace(-1.5, 1.5, 65)
    y = half * (2.0 * (jnp.arange(256) + 0.5) / 256.0 - 1.0)
    depth = depth_at(defects, offsets, x, y)
    lowest = jnp.min(x[None, :] ** 2 / (2.0 * contact.radius) + depth, axis=1)
    rest = gaps.rest_at(y, contact, tilt)
    needed = contact_extent.needed_by_slices(contact, load)
    weight = jnp.full(y.shape, 2.0 * half / 256.0)
    sunk = contact_extent.carried(needed, weight, rest + lowest, 60)
    healthy = contact_extent.carried(needed, weight, rest, 60)
    delta = jnp.minimum(sunk, healthy + jnp.maximum(jnp.max(lowest), 0.0))
    # a raised rim meets the roller before the raceway does; so does a bottom that is all there is
    return contact_extent.extents(contact, delta - jnp.min(lowest), tilt)
