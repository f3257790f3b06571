"""Derivatives of a contact on a height map: AD against central differences, forward against reverse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact.height_map import HeightMap, height_at
from difftrb.core.geometry import LineContact

pytestmark = pytest.mark.gradient

NAMES = ("load", "scale", "offset", "axial_offset", "pitch_x", "pitch_y", "tilt", "radius")
POINTS = {
    "edge in the contact": (2900.0, 1.0, 0.47, 0.3, 0.02, 0.04, 2e-4),
    "bottom touched": (2900.0, 0.013, 0.11, -0.4, 0.02, 0.04, 0.0),
    "out of reach": (2900.0, 1.0, 2.5, 0.3, 0.02, 0.04, 0.0),
}


@pytest.fixture(scope="module")
def measured() -> HeightMap:
    return trb.load_height_map(trb.example_map())


@jax.jit
def approach(v: jax.Array, measured: HeightMap, contact: LineContact) -> jax.Array:
    load, scale, offset, axial_offset, pitch_x, pitch_y, tilt, radius = v
    contact = LineContact(radius, contact.length, contact.modulus, contact.design_load)
    here = HeightMap(scale * measured.height, pitch_x, pitch_y, axial_offset)
    return trb.solve_contact(contact, load, here, offset, 1e-2, tilt=tilt).approach


gradient = jax.jit(jax.grad(approach))


@pytest.mark.parametrize("point", POINTS)
def test_gradient_matches_central_differences(point: str, measured: HeightMap, contact: LineContact) -> None:
    at = jnp.array([*POINTS[point], float(contact.radius)])
    slopes, delta = gradient(at, measured, contact), float(approach(at, measured, contact))
    for i, name in enumerate(NAMES):
        size = max(abs(float(at[i])), 1e-3 if name == "tilt" else 0.01)
        step = 1e-7 * size  # between the kinks of a bilinear surface
        ahead, behind = (approach(at.at[i].add(side * step), measured, contact) for side in (1.0, -1.0))
        difference = float(ahead - behind) / (2.0 * step)
        assert float(slopes[i]) == pytest.approx(difference, rel=1e-5, abs=1e-6 * delta / size), name
    if point == "out of reach":
        assert not slopes[jnp.array([1, 2, 3, 4, 5])].any()  # exactly


@pytest.mark.slow
def test_forward_and_reverse_agree(measured: HeightMap, contact: LineContact) -> None:
    at = jnp.array([*POINTS["bottom touched"], float(contact.radius)])
    forward = jax.jacfwd(approach)(at, measured, contact)
    np.testing.assert_allclose(forward, gradient(at, measured, contact), rtol=1e-8, atol=1e-15)


@pytest.mark.slow
def test_derivative_by_every_height(measured: HeightMap, contact: LineContact) -> None:
    """Raising the surface under the contact lifts the roller; beside it, it does not."""
    at = jnp.array([*POINTS["edge in the contact"], float(contact.radius)])
    # without any optimisation, as tests are compiled, XLA's program says NaN; by levels 1 and 2 it does not
    slope = jax.jit(jax.grad(approach, argnums=1), compiler_options={"xla_backend_optimization_level": 1})
    by_height = slope(at, measured, contact).height
    assert by_height.shape == measured.height.shape
    assert -1.0 < float(jnp.sum(by_height)) < 0.0
    assert not by_height[:, -1].any()  # 1.47 mm beside the contact: exactly
    index = np.unravel_index(int(jnp.argmin(by_height)), by_height.shape)
    step = 1e-8

    def moved(by: float) -> float:
        return float(approach(at, HeightMap(measured.height.at[index].add(by), 0.02, 0.04), contact))

    assert float(by_height[index]) == pytest.approx((moved(step) - moved(-step)) / (2.0 * step), rel=1e-4)


def test_approach_slopes_are_the_gradient(measured: HeightMap, contact: LineContact) -> None:
    at = jnp.array([2900.0, 1.0, 0.47, 0.3, 0.02, 0.04, 0.0, float(contact.radius)])
    slopes = trb.approach_slopes(contact, 2900.0, HeightMap(measured.height, 0.02, 0.04, 0.3), 0.47, 1e-2)
    assert slopes["length"] is slopes["width"] is slopes["offset"] is None
    expected = dict(zip(NAMES, gradient(at, measured, contact), strict=True))
    for name in ("load", "radius"):
        assert float(slopes[name]) == pytest.approx(float(expected[name]), rel=1e-6)  # type: ignore[arg-type]


def test_heights_between_points_are_differentiable() -> None:
    height = jnp.asarray(np.random.default_rng(5).normal(size=(4, 5)))

    @jax.jit
    def value(v: jax.Array) -> jax.Array:
        m = HeightMap(height * v[0], v[1], v[2], v[3])
        return jnp.sum(height_at(m, v[4], jnp.array([-0.013, 0.021]), jnp.array([0.031, 0.072])))

    at = jnp.array([1.3, 0.03, 0.05, 0.004, 0.007])
    for i in range(5):
        step = 1e-7
        difference = (value(at.at[i].add(step)) - value(at.at[i].add(-step))) / (2.0 * step)
        assert float(jax.grad(value)(at)[i]) == pytest.approx(float(difference), rel=1e-6)
        assert float(jax.jacfwd(value)(at)[i]) == pytest.approx(float(jax.grad(value)(at)[i]), rel=1e-12)
