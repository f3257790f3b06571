"""The solver on problems with closed answers: sphere, ellipse, long cylinder; and what any answer must obey."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.contact import halfspace, projected_gradient
from difftrb.contact.gap import Cells
from tests import hertz

pytestmark = pytest.mark.exact

MODULUS = 113794.0
pressing = jax.jit(projected_gradient.press)
influence_of = jax.jit(halfspace.influence)


def square_grid(half: float, cells: int, ratio: float = 1.0) -> Cells:
    """`cells` × `cells` over ± `half` in x and 0…`ratio`·`half` in y, mirrored."""
    pitch = 2.0 * half / cells
    x = pitch * (jnp.arange(cells) + 0.5) - half
    return Cells(jnp.asarray(pitch), x, jnp.linspace(0.0, ratio * half, cells // 2 + 1), True)


def parabola(cells: Cells, radius_x: float, radius_y: float) -> jax.Array:
    height = jnp.diff(cells.lines)
    along = (cells.y**2 + height**2 / 12.0) / (2.0 * radius_y)
    across = (cells.x**2 + cells.pitch**2 / 12.0) / (2.0 * radius_x)
    return along[:, None] + across[None, :]


def test_sphere() -> None:
    load, radius = 50.0, 8.0
    truth = hertz.sphere(load, radius, MODULUS)
    cells = square_grid(1.3 * float(truth.semi_x), 40)
    force, approach, residual, _ = pressing(cells, MODULUS, parabola(cells, radius, radius), load, truth.approach / 2)
    assert residual < projected_gradient.TOLERANCE
    assert float(approach) == pytest.approx(float(truth.approach), rel=5e-4)
    assert float(jnp.max(force / cells.area)) == pytest.approx(float(truth.peak_pressure), rel=3e-3)


def test_ellipse() -> None:
    load, radius_x, radius_y = 300.0, 3.6, 60.0
    truth = hertz.ellipse(load, radius_x, radius_y, MODULUS)
    cells = square_grid(1.25 * float(truth.semi_x), 40, float(truth.semi_y / truth.semi_x))
    gap = parabola(cells, radius_x, radius_y)
    force, approach, residual, _ = pressing(cells, MODULUS, gap, load, truth.approach / 2)
    assert residual < projected_gradient.TOLERANCE
    assert float(approach) == pytest.approx(float(truth.approach), rel=5e-4)
    assert float(jnp.max(force / cells.area)) == pytest.approx(float(truth.peak_pressure), rel=3e-3)


def test_long_cylinder_has_hertz_line_pressure_in_its_middle() -> None:
    radius, length, line_load = 3.6235, 40.0, 100.0
    b = float(hertz.line_half_width(line_load, radius, MODULUS))
    half = 1.3 * b
    lines = halfspace.graded(jnp.zeros(()), jnp.asarray(0.5 * length), 40, at_start=False)
    pitch = 2.0 * half / 48
    cells = Cells(jnp.asarray(pitch), pitch * (jnp.arange(48) + 0.5) - half, lines, True)
    gap = jnp.broadcast_to(((cells.x**2 + pitch**2 / 12.0) / (2.0 * radius))[None, :], (40, 48))
    force, _, residual, _ = pressing(cells, MODULUS, gap, line_load * length, b * b / (2.0 * radius))
    middle = np.asarray(force / cells.area)[0]
    q = middle.sum() * pitch  # the ends carry more; the middle has Hertz's pressure for the line load it has
    assert residual < projected_gradient.TOLERANCE
    assert 0.9 * line_load < q < line_load
    expected = np.asarray(hertz.line_pressure(cells.x, q, radius, MODULUS))
    inside = np.abs(np.asarray(cells.x)) < 0.85 * b  # the cell at the free boundary is loaded in part
    np.testing.assert_allclose(middle[inside], expected[inside], rtol=5e-3)
    assert middle.max() == pytest.approx(float(hertz.line_peak_pressure(q, radius, MODULUS)), rel=2e-3)


def test_contact_conditions_hold_everywhere(contact) -> None:
    import difftrb as trb

    s = trb.solve_contact(contact, 3000.0, trb.Spall(2.0, 1.0), 0.45, method="cells").check()
    matrix = influence_of(s.cells, jnp.asarray(contact.modulus))
    clearance = np.asarray(jax.jit(matrix.displacement)(s.force) + s.gap - s.approach)
    force = np.asarray(s.force)
    assert force.min() >= 0.0
    assert force.sum() == pytest.approx(3000.0, rel=1e-12)
    assert np.abs(clearance[force > 0.0]).max() < 1e-10 * float(s.approach)
    assert clearance[force == 0.0].min() > -1e-10 * float(s.approach)


def test_projection_is_the_nearest_point_of_the_simplex() -> None:
    rng = np.random.default_rng(3)
    trial, weight = jnp.asarray(rng.normal(size=(4, 6))), jnp.asarray(rng.uniform(0.1, 10.0, (4, 1)))
    f = np.asarray(projected_gradient.project(trial, weight))
    assert f.min() >= 0.0
    assert f.sum() == pytest.approx(1.0, abs=1e-13)
    shift = (f - np.asarray(trial)) * np.asarray(weight)  # the multiplier: equal where f > 0, at least that elsewhere
    level = shift[f > 0.0].mean()
    np.testing.assert_allclose(shift[f > 0.0], level, rtol=1e-12)
    assert (shift[f == 0.0] >= level - 1e-12).all()


def test_any_start_leads_to_the_same_forces() -> None:
    radius = 8.0
    truth = hertz.sphere(50.0, radius, MODULUS)
    cells = square_grid(1.3 * float(truth.semi_x), 16)
    gap = parabola(cells, radius, radius)
    force, *_ = pressing(cells, MODULUS, gap, 50.0, truth.approach / 2)
    matrix = influence_of(cells, jnp.asarray(MODULUS))
    pressed = jax.jit(projected_gradient.press_from)
    corner = jnp.zeros_like(gap).at[-1, -1].set(1.0)  # where no force will be
    for guess in (jnp.ones_like(gap), corner, jnp.asarray(np.random.default_rng(0).random(gap.shape))):
        again, _, residual, _ = pressed(guess, matrix, gap, jnp.asarray(50.0))
        assert residual < projected_gradient.TOLERANCE
        np.testing.assert_allclose(again, force, atol=1e-9 * float(force.max()))


def by_columns(linear: Callable[[jax.Array], jax.Array], shape: tuple[int, int]) -> np.ndarray:
    """The matrix of a linear map of cells."""
    columns = jnp.eye(shape[0] * shape[1]).reshape(-1, *shape)
    return np.asarray(jax.vmap(lambda e: linear(e).ravel())(columns)).T


@pytest.mark.parametrize("of", ["rows", "uneven", "lattice"])
def test_resistance_is_about_the_inverse(of: str) -> None:
    """Symmetric, and of W's square root on either side it leaves eigenvalues far closer than W's own."""
    cells = square_grid(1.0, 12, 20.0)
    if of == "uneven":
        borders = cells.borders.at[4].add(0.3 * cells.pitch)
        cells = dataclasses.replace(cells, uneven=halfspace.Uneven(jnp.array([3, 4]), borders))
    if of == "lattice":
        cells = dataclasses.replace(cells, mirrored=False)
    influence = jax.jit(halfspace.uniform_influence) if of == "lattice" else influence_of
    W = influence(cells, jnp.asarray(MODULUS))
    shape = (cells.y.size, cells.x.size)
    influence, resistance = by_columns(W.displacement, shape), by_columns(jax.jit(W.resistance()), shape)
    np.testing.assert_allclose(resistance, resistance.T, atol=1e-9 * resistance.max())
    values, vectors = np.linalg.eigh(influence)
    root = vectors * np.sqrt(values) @ vectors.T
    spread = np.linalg.eigvalsh(root @ resistance @ root)
    assert spread.min() > 0.2
    assert spread.max() < 5.0
    assert values.max() / values.min() > 50.0
