"""Influence coefficients against quadrature, and applying them against the sum they stand for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

from difftrb.contact import halfspace
from difftrb.contact.gap import Cells
from difftrb.contact.halfspace import Influence

pytestmark = pytest.mark.exact

MODULUS = 113794.0
influence = jax.jit(halfspace.influence)
displacement = jax.jit(Influence.displacement)
X, W = np.polynomial.legendre.leggauss(12)


def grid(columns: int = 5, mirrored: bool = False) -> Cells:
    lines = jnp.array([0.0, 0.2, 0.25, 0.9]) if mirrored else jnp.array([-0.7, -0.1, 0.2, 0.25, 0.9])
    return Cells(jnp.asarray(0.1), 0.1 * (jnp.arange(columns) - 1.5), lines, mirrored)


def dense(cells: Cells) -> np.ndarray:
    """The influence matrix, column by column, as (rows, columns, rows, columns)."""
    matrix = influence(cells, jnp.asarray(MODULUS))
    rows, columns = cells.y.shape[0], cells.x.shape[0]
    units = np.eye(rows * columns).reshape(rows, columns, rows, columns)
    found = jax.jit(jax.vmap(Influence.displacement, (None, 2), 2))(matrix, units.reshape(rows, columns, -1))
    return np.asarray(found).reshape(units.shape)


def potential(x: float, y: float, a: float, b: float) -> float:
    """∫∫ 1/r over the rectangle (±a, ±b), seen from (x, y): Love 1929 in the form of Johnson 1985, §3.6."""

    def corner(u: float, v: float) -> float:
        return u * np.arcsinh(v / abs(u)) + v * np.arcsinh(u / abs(v))

    return corner(x + a, y + b) - corner(x - a, y + b) - corner(x + a, y - b) + corner(x - a, y - b)


def mean_influence(cells: Cells, receiver: tuple[int, int], source: tuple[int, int]) -> float:
    """Love's displacement under a uniformly loaded cell, averaged over another by Gauss quadrature."""
    pitch, lines = float(cells.pitch), np.asarray(cells.lines)
    (a, i), (b, j) = receiver, source
    height, depth = lines[a + 1] - lines[a], lines[b + 1] - lines[b]
    xs = float(cells.x[i]) + 0.5 * pitch * X - float(cells.x[j])
    ys = 0.5 * (lines[a] + lines[a + 1]) + 0.5 * height * X - 0.5 * (lines[b] + lines[b + 1])
    values = [[potential(x, y, 0.5 * pitch, 0.5 * depth) for y in ys] for x in xs]
    return float(W @ np.array(values) @ W) / 4.0 / (np.pi * MODULUS * pitch * depth)


@pytest.mark.parametrize(
    ("receiver", "source"), [((0, 0), (3, 4)), ((2, 1), (0, 3)), ((3, 4), (1, 0)), ((0, 2), (2, 0))]
)
def test_separate_cells_match_quadrature_of_love(receiver: tuple[int, int], source: tuple[int, int]) -> None:
    cells = grid()
    assert dense(cells)[(*receiver, *source)] == pytest.approx(mean_influence(cells, receiver, source), rel=1e-9)


def test_a_cell_on_itself_matches_adaptive_quadrature() -> None:
    cells = grid()
    pitch, height = 0.1, 0.6
    value, _ = integrate.dblquad(
        lambda y, x: potential(x, y, 0.5 * pitch, 0.5 * height), 1e-14, 0.5 * pitch, 1e-14, 0.5 * height, epsrel=1e-9
    )
    expected = 4.0 * value / (np.pi * MODULUS * pitch**2 * height**2)
    assert dense(cells)[0, 2, 0, 2] == pytest.approx(expected, rel=1e-7)


def test_matrix_is_symmetric_and_positive_definite() -> None:
    matrix = dense(grid())
    size = matrix.shape[0] * matrix.shape[1]
    flat = matrix.reshape(size, size)
    assert np.abs(flat - flat.T).max() < 1e-12 * flat.max()
    assert np.linalg.eigvalsh(flat).min() > 0.0


def test_far_cell_is_a_point_force() -> None:
    cells = Cells(jnp.asarray(0.01), 0.01 * jnp.arange(2), jnp.array([0.0, 0.01, 5.0, 5.01]), False)
    distance = np.hypot(0.01, 5.0)
    assert dense(cells)[0, 0, 2, 1] == pytest.approx(1.0 / (np.pi * MODULUS * distance), rel=1e-5)


def test_tiny_distant_cells_do_not_cancel() -> None:
    lines = jnp.array([0.0, 1e-3, 6.8, 6.801])
    cells = Cells(jnp.asarray(0.01), 0.01 * jnp.arange(2), lines, False)
    expected = 1.0 / (np.pi * MODULUS * 6.8)
    assert dense(cells)[0, 0, 2, 0] == pytest.approx(expected, rel=1e-4)


def test_mirror_image_counts_both_halves() -> None:
    half, whole = grid(mirrored=True), Cells(jnp.asarray(0.1), 0.1 * (jnp.arange(5) - 1.5),
                                             jnp.array([-0.9, -0.25, -0.2, 0.0, 0.2, 0.25, 0.9]), False)  # fmt: skip
    force = jnp.asarray(np.random.default_rng(0).random((3, 5)))
    both = jnp.concatenate([force[::-1], force]) / 2.0
    u_half = displacement(influence(half, jnp.asarray(MODULUS)), force)
    u_whole = displacement(influence(whole, jnp.asarray(MODULUS)), both)
    np.testing.assert_allclose(u_half, u_whole[3:], rtol=1e-11)


def test_lattice_puts_boundaries_on_the_edges_it_can_see() -> None:
    for left, right in [(-0.03, 0.05), (-5.0, 0.04), (-0.02, 7.0)]:
        pitch, x = halfspace.lattice(jnp.asarray(0.2), 32, jnp.asarray(left), jnp.asarray(right))
        lines = np.append(np.asarray(x) - 0.5 * float(pitch), float(x[-1] + 0.5 * pitch))
        shift = halfspace.EDGE_SHIFT * float(pitch)
        for edge, into in ((left, shift), (right, -shift)):
            if abs(edge) < 0.2:
                assert np.abs(lines - (edge + into)).min() < 1e-12
