"""The elastic half-space on rectangular cells: cells that follow the spall's edges, their influence, applying it.

Cells form a tensor grid: equal pitch across the contact (x, rolling direction), graded lines along it (y, the
roller). Forces live on cells, array shape (rows along y, cells along x). The displacement of a cell is its mean
(Galerkin), so the influence matrix is symmetric; it depends on x by differences alone and is applied by FFT. A few
columns may be of another width, where a line had to move to an edge: their part is kept as it is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Protocol, Self

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact.gap import Cells, Uneven
from difftrb.core import arrays as xp

# A sharp edge with a pressure that is singular there acts as if it stood this part of a cell inside the last loaded
# cell (uniform Galerkin cells, half-plane problem); cells are therefore drawn that much beyond the true edge.
EDGE_SHIFT = 0.11505
EVEN = 0.05  # share of even spacing in graded lines: it bounds the ratio of the largest to the smallest cell
LOW = 8  # frequencies of the resistance at which rows see one another; 4 or 16 cost as much


class Operator(Protocol):
    """What the press asks of a half-space: `displacement` and a positive `diagonal` that broadcasts to the forces."""

    @property
    def diagonal(self) -> jax.Array:
        """Displacement of every cell by a unit force on itself [mm/N]."""
        ...

    def displacement(self, force: jax.Array) -> jax.Array:
        """Mean normal one of every cell [mm] by the forces [N], both of shape (rows, columns); linear, symmetric."""
        ...

    def scaled(self, factor: jax.Array) -> Self:
        """`factor` times the operator."""
        ...

    def resistance(self) -> Callable[[jax.Array], jax.Array]:
        """About the inverse, in which steps of a descent are measured: forces [N] by displacements [mm]; linear,
        symmetric, positive definite, not exact."""
        ...


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Influence:
    """Mean displacement of a cell by the force on another, ready to apply.

    Attributes:
      spectrum: Fourier coefficients in x for every pair of rows, shape (columns + 1, rows, rows).
      diagonal: influence of a cell on itself, shape (rows, 1).
    """

    spectrum: jax.Array
    diagonal: jax.Array

    def displacement(self, force: jax.Array) -> jax.Array:
        columns = force.shape[1]
        product = _along_rows(self.spectrum, jnp.fft.rfft(force, 2 * columns, axis=1))
        return jnp.fft.irfft(product, 2 * columns, axis=1)[:, :columns]

    def scaled(self, factor: jax.Array) -> Influence:
        return Influence(factor * self.spectrum, factor * self.diagonal)

    def resistance(self) -> Callable[[jax.Array], jax.Array]:
        """The spectrum's inverse, of which rows see one another at the lowest frequencies only: what changes faster
        across the contact than `LOW` times in its domain is not felt a row away."""
        low = min(LOW, self.spectrum.shape[0])
        blocks = jax.lax.map(
            jnp.linalg.inv, self.spectrum[:low]
        )  # all at once, two threads wait for each other forever
        rows = 1.0 / jnp.diagonal(self.spectrum, axis1=1, axis2=2).T

        def by(displaced: jax.Array) -> jax.Array:
            columns = displaced.shape[1]
            transformed = jnp.fft.rfft(displaced, 2 * columns, axis=1)
            lowest = _along_rows(blocks, transformed[:, :low])
            product = jnp.concatenate([lowest, rows[:, low:] * transformed[:, low:]], axis=1)
            return jnp.fft.irfft(product, 2 * columns, axis=1)[:, :columns]

        return by


def _along_rows(blocks: jax.Array, transformed: jax.Array) -> jax.Array:
    """A real matrix for every frequency, shape (frequencies, rows, rows), on Fourier coefficients of rows."""
    parts = jnp.stack([transformed.T.real, transformed.T.imag], axis=-1)
    product = jnp.matmul(blocks, parts)
    return (product[..., 0] + 1j * product[..., 1]).T


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PatchedInfluence:
    """The same with columns of another width, whose part is not of differences.

    Attributes:
      even: as if all columns were even.
      patch: displacement of all cells by a unit force on one of an uneven column, shape (uneven, columns, rows, rows).
      place: 1 where an uneven column stands, shape (uneven, columns).
      diagonal: influence of a cell on itself, shape (rows, columns).
    """

    even: Influence
    patch: jax.Array
    place: jax.Array
    diagonal: jax.Array

    def displacement(self, force: jax.Array) -> jax.Array:
        keep = 1.0 - jnp.sum(self.place, axis=0)[None, :]
        from_uneven = jnp.einsum("mjab,mb->aj", self.patch, self.place @ force.T)
        on_uneven = jnp.einsum("mjab,aj->mb", self.patch, keep * force)
        return keep * self.even.displacement(keep * force) + from_uneven + on_uneven.T @ self.place

    def scaled(self, factor: jax.Array) -> PatchedInfluence:
        return PatchedInfluence(self.even.scaled(factor), factor * self.patch, self.place, factor * self.diagonal)

    def resistance(self) -> Callable[[jax.Array], jax.Array]:
        """As if all columns were even."""
        return self.even.resistance()


@jax.tree_util.register_dataclass
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


def graded(start: Any, end: Any, count: int, at_start: bool) -> Any:
    """`count` + 1 lines from `start` to `end`, gathered like a cosine at the end and, if asked, at the start."""
    s = np.linspace(0.0, 1.0, count + 1)
    gathered = 0.5 * (1.0 - np.cos(np.pi * s)) if at_start else np.sin(0.5 * np.pi * s)
    return start + (end - start) * (EVEN * s + (1.0 - EVEN) * gathered)


def lattice(half_width: Any, columns: int, left: Any, right: Any) -> tuple[Any, Any]:
    """Pitch and cell centres in x, with a cell boundary on each spall edge inside ± `half_width`.

    `left` and `right` are the spall's edges [mm]. The pitch divides the spall when both edges are inside; an edge that
    is outside does not act on the lattice at all, so derivatives by it are exactly zero. Nor does the width of a spall
    narrower than a cell, which the lattice cannot show, or does not have to: 0 is no spall. With no edge inside, a
    boundary lies a quarter of a cell beside the middle: then the errors of the two free boundaries, which ripple with
    their place in a cell, are in opposite phase and cancel.
    """
    even_pitch = 2.0 * half_width / columns
    left_in, right_in = xp.magnitude(left) < half_width, xp.magnitude(right) < half_width
    both = left_in & right_in & (right - left >= even_pitch)
    width = xp.where(both, right - left, 4.0 * half_width)
    count = xp.maximum(xp.floor(xp.fixed(width) / xp.fixed(even_pitch) - 2.0 * EDGE_SHIFT), 1.0)
    pitch = xp.where(both, width / (count + 2.0 * EDGE_SHIFT), even_pitch)
    line = xp.where(left_in, left + EDGE_SHIFT * pitch, xp.where(right_in, right - EDGE_SHIFT * pitch, 0.25 * pitch))
    first = xp.round(xp.fixed((line + 0.5 * columns * pitch) / pitch))
    return pitch, line + (np.arange(columns) - first + 0.5) * pitch


@jax.custom_jvp
def primitive(x: jax.Array, y: jax.Array) -> jax.Array:
    """Fourth antiderivative of 1/r, twice in x and twice in y, even in both.

    |y|³/6 is left out of the true r³/6: it is the same for every x, and rounding it would spoil small distant cells.
    """
    return _primitive_and_slopes(x, y)[0]


@primitive.defjvp
def _(primals: tuple[jax.Array, jax.Array], tangents: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
    value, by_x, by_y = _primitive_and_slopes(*primals)
    return value, by_x * tangents[0] + by_y * tangents[1]


def _primitive_and_slopes(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    sign_x, sign_y = jnp.sign(x), jnp.sign(y)
    x, y = jnp.abs(x), jnp.abs(y)
    r = jnp.sqrt(x * x + y * y)
    positive = jnp.where(r > 0.0, r, 1.0)
    beyond = x * x / (positive + y)  # r − y without cancellation
    # asinh(y/x) and asinh(x/y); each is multiplied by its own denominator, so 1 may stand in for a zero
    a = jnp.log((y + positive) / jnp.where(x > 0.0, x, 1.0))
    b = jnp.log1p((x + beyond) / jnp.where(y > 0.0, y, 1.0))
    cubes = beyond * (r * r + r * y + y * y)  # r³ − y³
    value = 0.5 * x * y * (x * a + y * b) - cubes / 6.0  # Love 1929, integrated twice more
    by_x = sign_x * (x * y * a + 0.5 * y * y * b - 0.5 * x * r)
    by_y = sign_y * (x * y * b + 0.5 * x * x * a - 0.5 * y * beyond)
    return value, by_x, by_y


def influence(cells: Cells, modulus: jax.Array) -> Influence | PatchedInfluence:
    """Mean displacement [mm] of a cell by a unit force [N] spread evenly over another.

    u = 1/(πE') ∬ p/r dA (Liu et al. 2018, eq. 1), averaged over the receiving cell: the half-space of Love 1929.
    """
    columns = cells.x.shape[0]
    lags = cells.pitch * jnp.arange(-1, columns + 2)

    def across(distance: jax.Array) -> jax.Array:
        g = primitive(lags[:, None], distance[None])
        return g[2:] - 2.0 * g[1:-1] + g[:-2]

    kernel = _along(cells, across) / (jnp.pi * modulus * cells.pitch**2)
    circle = jnp.concatenate([kernel, kernel[-2:0:-1]])  # even extension: a symmetric circulant has a real spectrum
    even = Influence(jnp.fft.rfft(circle, axis=0).real, jnp.diagonal(kernel[0])[:, None])
    return even if cells.uneven is None else _patched(cells, cells.uneven, even, modulus)


def uniform_influence(cells: Cells, modulus: jax.Array) -> Convolution:
    """Mean displacement [mm] of a cell by a unit force [N] on another; all cells of one height, not mirrored."""
    rows, columns = cells.y.shape[0], cells.x.shape[0]
    height = (cells.lines[-1] - cells.lines[0]) / rows
    x, y = cells.pitch * jnp.arange(-1, columns + 2), height * jnp.arange(-1, rows + 2)
    g = primitive(x[None, :], y[:, None])
    for _ in range(2):  # second differences, in x and then in y
        g = (g[:, 2:] - 2.0 * g[:, 1:-1] + g[:, :-2]).T
    kernel = g / (jnp.pi * modulus * (cells.pitch * height) ** 2)
    for _ in range(2):
        kernel = jnp.concatenate([kernel, kernel[-2:0:-1]]).T  # even extensions: a real spectrum
    return Convolution(jnp.fft.rfft2(kernel).real, kernel[:1, :1])


def _patched(cells: Cells, uneven: Uneven, even: Influence, modulus: jax.Array) -> PatchedInfluence:
    """`even` with the true influence of uneven columns in place of what it has for them."""
    columns, borders = uneven.columns, uneven.borders
    lags = jnp.stack([borders[columns], borders[columns + 1]], axis=1)[:, :, None] - borders[None, None, :]

    def across(distance: jax.Array) -> jax.Array:
        g = primitive(lags[..., None], distance[None, None, None])
        g = g[:, 1] - g[:, 0]
        return g[:, :-1] - g[:, 1:]

    width = jnp.diff(borders)
    kernel = _along(cells, across) / (jnp.pi * modulus * width[columns][:, None] * width[None])[..., None, None]
    first = jnp.sum(jnp.tril(columns[:, None] == columns[None, :], -1), axis=1) == 0
    place = (first[:, None] & (columns[:, None] == jnp.arange(width.shape[0])[None, :])).astype(float)
    own = jnp.diagonal(jnp.einsum("mjab,mj->mab", kernel, place), axis1=1, axis2=2)
    diagonal = even.diagonal * (1.0 - jnp.sum(place, axis=0)[None, :]) + own.T @ place
    return PatchedInfluence(even, kernel, place, diagonal)


def _along(cells: Cells, across: Callable[[jax.Array], jax.Array]) -> jax.Array:
    """Mean over the receiving row of what a unit force spread over another does: shape (…, rows, rows).

    `across` takes distances in y, shape (pairs of lines,), to the second difference in x of the primitive at these
    distances, shape (…, pairs).
    """
    y, lines = cells.lines, cells.lines.shape[0]
    upper = jnp.triu_indices(lines)

    def pairs(distance: jax.Array) -> jax.Array:  # the distance is symmetric up to sign, the primitive even
        half = across(distance[upper])
        full = jnp.zeros((*half.shape[:-1], lines, lines))
        filled = full.at[..., upper[0], upper[1]].set(half)
        return filled.at[..., upper[1], upper[0]].set(half)

    def over_cells(t: jax.Array) -> jax.Array:
        return t[..., 1:, 1:] - t[..., :-1, 1:] - t[..., 1:, :-1] + t[..., :-1, :-1]

    kernel = -over_cells(pairs(y[:, None] - y[None, :]))
    if cells.mirrored:
        kernel = kernel + over_cells(pairs(y[:, None] + y[None, :]))
    side = jnp.diff(y)
    sides = (2.0 if cells.mirrored else 1.0) * side[:, None] * side[None, :]
    return kernel / sides.reshape((1,) * (kernel.ndim - 2) + sides.shape)
