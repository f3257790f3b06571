"""The uniform lattice: its coefficients against the cells', its answers against Hertz and the cells', height maps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import cell_solve, halfspace, projected_gradient
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.gap import Cells
from difftrb.contact.height_map import height_at
from tests import hertz

pytestmark = pytest.mark.exact

MODULUS = 113794.0
LOAD = 3000.0


def test_coefficients_are_those_of_the_cells() -> None:
    cells = Cells(jnp.asarray(0.01), 0.01 * jnp.arange(7), jnp.linspace(-0.3, 6.0, 12), False)
    force = jnp.asarray(np.random.default_rng(0).random((11, 7)))
    ways = halfspace.influence, halfspace.uniform_influence
    by_cells, by_lattice = (jax.jit(way)(cells, jnp.asarray(MODULUS)) for way in ways)
    every = [jax.jit(matrix.displacement)(force) for matrix in (by_lattice, by_cells)]
    np.testing.assert_allclose(*every, rtol=1e-9)
    np.testing.assert_allclose(by_lattice.diagonal[0, 0], by_cells.diagonal[:, 0], rtol=1e-11)


def test_sphere() -> None:
    load, radius = 50.0, 8.0
    truth = hertz.sphere(load, radius, MODULUS)
    half = 1.3 * float(truth.semi_x)
    pitch = 2.0 * half / 40
    x = pitch * (jnp.arange(40) + 0.5) - half
    cells = Cells(jnp.asarray(pitch), x, jnp.linspace(-half, half, 41), False)
    gap = (x[:, None] ** 2 + x[None, :] ** 2 + pitch**2 / 6.0) / (2.0 * radius)
    matrix = jax.jit(halfspace.uniform_influence)(cells, jnp.asarray(MODULUS))
    force, approach, residual, _ = jax.jit(projected_gradient.press_by)(
        matrix, cells.area, gap, load, truth.approach / 2
    )
    assert residual < projected_gradient.TOLERANCE
    assert float(approach) == pytest.approx(float(truth.approach), rel=5e-4)
    assert float(jnp.max(force / cells.area)) == pytest.approx(float(truth.peak_pressure), rel=3e-3)


@pytest.mark.parametrize(("spall", "tilt"), [(None, 0.0), (trb.Spall(3.0, 1.0, axial_offset=1.0), 3e-4)])
def test_lattice_and_cells_agree(contact: trb.LineContact, spall: trb.Spall | None, tilt: float) -> None:
    offset = 0.47
    by_cells, by_lattice = (
        trb.solve_contact(contact, LOAD, spall, offset, 1e-2, method, tilt).check() for method in ("cells", "lattice")
    )
    assert float(by_lattice.approach) == pytest.approx(float(by_cells.approach), rel=2e-3)
    assert float(jnp.sum(by_lattice.force)) == pytest.approx(LOAD, rel=1e-12)


def test_bilinear_between_points_and_nothing_outside() -> None:
    height = jnp.array([[1.0, 2.0, 4.0], [3.0, 5.0, 9.0]])
    m = trb.HeightMap(height, pitch_x=0.5, pitch_y=2.0, axial_offset=10.0)
    at = height_at(m, 1.0, jnp.array([0.5, 0.75, 1.0, 1.25, 2.0]), jnp.array([9.0, 10.0, 11.0, 13.0]))
    np.testing.assert_allclose(
        at, [[1.0, 1.5, 2.0, 3.0, 0.0], [2.0, 2.75, 3.5, 5.0, 0.0], [3.0, 4.0, 5.0, 7.0, 0.0], [0.0] * 5], atol=1e-14
    )


def steep(spall: trb.Spall, pitch_x: float, pitch_y: float) -> trb.HeightMap:
    """A spall as a map: 0 on its edges, all its depth from the next point on."""
    rows, columns = round(spall.length / pitch_y) + 1, round(spall.width / pitch_x) + 1
    height = np.zeros((rows, columns))
    height[1:-1, 1:-1] = -spall.depth
    return trb.HeightMap(jnp.asarray(height), pitch_x, pitch_y, spall.axial_offset)


@pytest.mark.slow
def test_a_map_with_steep_walls_comes_to_the_spall_at_first_order(contact: trb.LineContact) -> None:
    spall = trb.Spall(3.0, 0.8, axial_offset=1.0)
    offsets = jnp.array([0.36, 0.37, 0.385, 0.4])
    exact = jnp.stack([trb.solve_contact(contact, LOAD, spall, o, 1e-2, "cells").approach for o in offsets])
    load, errors = jnp.asarray(LOAD), []
    for columns in (12, 24, 48):
        size = (8 * columns, columns)
        found = jax.lax.map(
            lambda o, size=size: cell_solve.solve(
                Inputs(contact, load, steep(spall, 0.005, 0.01), o), size, False, 1e-2
            ),
            offsets,
        )
        assert not found.status_code.any()
        errors.append(float(jnp.sqrt(jnp.mean((found.approach / exact - 1.0) ** 2))))
    assert errors[0] < 0.03
    assert errors[2] < 0.4 * errors[0]  # where walls fall among the lines makes the order ragged
    assert errors[2] < 0.03 * 12 / 48


def test_a_map_out_of_reach_changes_nothing(contact: trb.LineContact) -> None:
    healthy = trb.solve_contact(contact, LOAD, None, 0.0, 1e-2, "lattice").check()
    away = trb.solve_contact(contact, LOAD, steep(trb.Spall(3.0, 0.8), 0.02, 0.1), 2.0, 1e-2).check()
    assert float(away.approach) == pytest.approx(float(healthy.approach), rel=1e-5)


def test_a_flat_bottom_under_the_whole_contact_only_lowers_it(contact: trb.LineContact) -> None:
    bottom = trb.HeightMap(jnp.full((3, 3), -0.05), 2.0, 10.0)
    s = trb.solve_contact(contact, LOAD, bottom, 0.0, 1e-2).check()
    healthy = trb.solve_contact(contact, LOAD, None, 0.0, 1e-2, "lattice")
    assert float(s.approach) == pytest.approx(0.05 + float(healthy.approach), rel=1e-5)


def test_maps_and_spalls_merge(contact: trb.LineContact) -> None:
    spall = trb.Spall(3.0, 0.8)
    same = steep(spall, 0.02, 0.1)
    once = trb.solve_contact(contact, LOAD, spall, 0.3, 1e-2, "lattice").check()
    twice = trb.solve_contact(contact, LOAD, (spall, same), 0.3, 1e-2).check()
    assert float(twice.approach) == pytest.approx(float(once.approach), rel=5e-4)
    assert [type(each) for each, _ in twice.spalls] == [trb.Spall, trb.HeightMap]


def test_reversed_tilt_and_map_mirror_the_pressure(contact: trb.LineContact) -> None:
    m = trb.load_height_map(trb.example_map(), axial_offset=0.7)
    turned = trb.HeightMap(m.height[::-1], m.pitch_x, m.pitch_y, -0.7)
    one = trb.solve_contact(contact, LOAD, m, 0.45, 1e-2, tilt=4e-4).check()
    other = trb.solve_contact(contact, LOAD, turned, 0.45, 1e-2, tilt=-4e-4).check()
    assert float(one.approach) == pytest.approx(float(other.approach), rel=1e-10)
    assert jnp.allclose(one.pressure, other.pressure[::-1], rtol=0.0, atol=1e-7 * float(one.peak_pressure))


def test_a_batch_is_what_its_members_are(contact: trb.LineContact) -> None:
    m = trb.load_height_map(trb.example_map())

    def approach(offset: jax.Array) -> jax.Array:
        return trb.solve_contact(contact, LOAD, m, offset, 1e-2).approach

    offsets = jnp.array([0.4, 0.55])
    together = jax.jit(jax.vmap(approach))(offsets)
    np.testing.assert_allclose(together, [approach(o) for o in offsets], rtol=1e-10)
