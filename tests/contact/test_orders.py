"""Orders of convergence: what halving the cells buys."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import cell_solve, contact_cells, projected_gradient
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.gap import Cells
from difftrb.contact.grids import GRIDS
from tests import hertz

pytestmark = pytest.mark.order

MODULUS = 113794.0
pressing = jax.jit(projected_gradient.press)

# Capacity of a square plate of side 1 (Read 1997, J. Comput. Phys. 133, 1–5; Mascagni & Simonov 2004)
SQUARE_CAPACITY = 0.36678980


def punch_capacity(cells: int) -> float:
    """Load per approach of a square flat punch of side 1, in units of πE'; cells end at its edges, uncorrected."""
    pitch = 1.0 / cells
    grid = Cells(
        jnp.asarray(pitch), pitch * (jnp.arange(cells) + 0.5) - 0.5, jnp.linspace(0.0, 0.5, cells // 2 + 1), True
    )
    gap = jnp.zeros((cells // 2, cells))
    _, approach, residual, _ = pressing(grid, MODULUS, gap, 1000.0, 1.0)
    assert residual < projected_gradient.TOLERANCE
    return 1000.0 / (np.pi * MODULUS * float(approach))


def test_square_punch_converges_with_first_order() -> None:
    errors = np.array([SQUARE_CAPACITY - punch_capacity(n) for n in (8, 16, 32)])
    assert (errors > 0.0).all()  # Galerkin: the capacity is approached from below
    orders = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.12)


def test_square_punch_reaches_its_capacity() -> None:
    coarse, fine = punch_capacity(24), punch_capacity(48)
    assert 2.0 * fine - coarse == pytest.approx(SQUARE_CAPACITY, rel=3e-4)


def test_smooth_contact_converges_faster_than_first_order() -> None:
    load, radius = 50.0, 8.0
    truth = hertz.sphere(load, radius, MODULUS)
    half = 1.3 * float(truth.semi_x)

    def error(cells: int) -> float:
        """Root mean square over lattices of slightly different pitch, since a free boundary makes errors ripple."""
        errors = []
        for stretch in np.linspace(1.0, 1.0 + 2.0 / cells, 7):
            pitch = 2.0 * stretch * half / cells
            x = pitch * (jnp.arange(cells) + 0.5) - stretch * half
            grid = Cells(jnp.asarray(pitch), x, jnp.linspace(0.0, stretch * half, cells // 2 + 1), True)
            square = grid.x**2 + pitch**2 / 12.0
            gap = (square[cells // 2 :, None] + square[None, :]) / (2.0 * radius)
            approach = pressing(grid, MODULUS, gap, load, truth.approach / 2)[1]
            errors.append(float(approach / truth.approach) - 1.0)
        return float(np.sqrt(np.mean(np.square(errors))))

    errors = np.array([error(n) for n in (8, 16, 32)])
    assert (np.log2(errors[:-1] / errors[1:]) > 1.4).all()


@pytest.mark.parametrize(
    ("spall", "offsets"),
    [
        (None, [0.0]),
        pytest.param(trb.Spall(4.0, 1.0), [0.0], marks=pytest.mark.slow),  # edges along the roller
        # an edge across the contact, moving over the cells
        pytest.param(trb.Spall(2.0, 1.0), [0.42, 0.44, 0.46, 0.48, 0.5, 0.52], marks=pytest.mark.slow),
    ],
)
def test_roller_contact_converges(spall: trb.Spall | None, offsets: list[float]) -> None:
    """Faster than first order, in the root mean square over loads and offsets, which shift edges among the cells."""
    contact = trb.LineContact(3.623, 13.66, 2.1e5 / (2.0 * (1.0 - 0.278**2)), 3000.0)
    cases = jnp.array([(load, offset) for load in (1500.0, 2000.0, 3000.0, 4500.0) for offset in offsets])

    def approaches(grid: contact_cells.Resolution) -> jax.Array:
        def one(case: jax.Array) -> jax.Array:
            return cell_solve.solve(Inputs(contact, case[0], spall, case[1]), grid, True, 1e-3).approach

        return jax.jit(lambda c: jax.lax.map(one, c))(cases)

    fine = approaches(GRIDS[1e-4].cells)
    errors = [
        float(jnp.sqrt(jnp.mean((approaches(contact_cells.Resolution(8 * k, 6 * k, 3 * k)) / fine - 1.0) ** 2)))
        for k in (1, 4)
    ]
    assert np.log(errors[0] / errors[1]) / np.log(4.0) > 1.0
