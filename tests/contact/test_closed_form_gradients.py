"""Derivatives of the closed forms, of the gap and of the influence coefficients, against central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import crown, gap, halfspace
from difftrb.contact.gap import Cells
from difftrb.core import geometry
from tests import hertz

pytestmark = pytest.mark.gradient

FUNCTIONS = {
    "line_half_width": (lambda v: hertz.line_half_width(*v), [200.0, 3.6, 1e5]),
    "line_peak_pressure": (lambda v: hertz.line_peak_pressure(*v), [200.0, 3.6, 1e5]),
    "sphere": (lambda v: hertz.sphere(*v).approach, [200.0, 3.6, 1e5]),
    "ellipse approach": (lambda v: hertz.ellipse(*v).approach, [200.0, 3.6, 40.0, 1e5]),
    "ellipse semi-axis": (lambda v: hertz.ellipse(*v).semi_y, [200.0, 3.6, 40.0, 1e5]),
    "palmgren_approach": (lambda v: gap.palmgren_approach(*v), [200.0, 13.66]),
    "lamina_stiffness": (lambda v: gap.lamina_stiffness(v[0]), [13.66]),
    "contact_modulus": (lambda v: geometry.contact_modulus(*v), [2.1e5, 0.278]),
    "primitive": (lambda v: halfspace.primitive(v[0], v[1]), [0.3, -1.7]),
    "primitive far": (lambda v: halfspace.primitive(v[0], v[1]), [-0.02, 9.0]),
    "line_pressure": (lambda v: hertz.line_pressure(jnp.asarray(0.05), *v), [200.0, 3.6, 1e5]),
}


def central(function, at: np.ndarray, relative: float = 1e-6) -> np.ndarray:
    slopes = []
    for i in range(at.size):
        step = np.zeros_like(at)
        step[i] = relative * abs(at[i])
        slopes.append(
            (float(function(jnp.asarray(at + step))) - float(function(jnp.asarray(at - step)))) / (2 * step[i])
        )
    return np.array(slopes)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_closed_forms(name: str) -> None:
    function, values = jax.jit(FUNCTIONS[name][0]), FUNCTIONS[name][1]
    at = np.array(values)
    reverse = np.asarray(jax.grad(function)(jnp.asarray(at)))
    np.testing.assert_allclose(reverse, central(function, at), rtol=1e-6)
    np.testing.assert_allclose(jax.jacfwd(function)(jnp.asarray(at)), reverse, rtol=1e-11)


def test_primitive_has_zero_slopes_where_it_is_even() -> None:
    for at in ([0.0, 1.0], [0.0, 0.0]):
        slopes = jax.grad(lambda v: halfspace.primitive(v[0], v[1]))(jnp.array(at))
        assert float(slopes[0]) == 0.0
        assert np.isfinite(np.asarray(slopes)).all()


def test_geometry_by_every_entry(bearing: trb.TaperedBearing) -> None:
    leaves, structure = jax.tree.flatten(bearing)
    at = np.array(leaves)

    def rebuilt(v: jax.Array) -> trb.TaperedBearing:
        return jax.tree.unflatten(structure, list(v))

    for function in (
        lambda b: geometry.equivalent_radius(b, "outer"),
        lambda b: geometry.equivalent_radius(b, "inner"),
        geometry.pitch_radius,
        geometry.arc_radius,
        geometry.roller_mass,
        geometry.apex_distance,
        geometry.flange_force_angle,
    ):
        own = jax.jit(lambda v, f=function: f(rebuilt(v)))
        slopes = np.asarray(jax.grad(own)(jnp.asarray(at)))
        expected = central(own, at)
        np.testing.assert_allclose(slopes, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_influence_and_gap_by_grid_lines(contact: trb.LineContact) -> None:
    """The pullback of a smooth number of everything, by the lines and the pitch."""
    force = jnp.asarray(np.random.default_rng(1).random((3, 4)))
    weights = jnp.asarray(np.random.default_rng(2).random((3, 4)))

    @jax.jit
    def number(v: jax.Array) -> jax.Array:
        cells = Cells(v[0], v[0] * (jnp.arange(4) - 1.3), v[1:], True)
        u = halfspace.influence(cells, jnp.asarray(contact.modulus)).displacement(force)
        return jnp.sum(
            weights * (u + gap.curvature(cells, contact.radius) + crown.mean_of_rows(cells.lines, contact)[:, None])
        )

    at = np.array([0.02, 0.0, 1.1, 4.0, 6.6])
    at[1] = 0.5
    slopes = np.asarray(jax.grad(number)(jnp.asarray(at)))
    np.testing.assert_allclose(slopes, central(number, at, 1e-5), rtol=1e-5)


def test_crown_reaches_the_rollers_end(contact: trb.LineContact) -> None:
    """Its mean over the last cell is finite, and so is the mean's derivative by the cell's inner line."""

    @jax.jit
    def last(line: jax.Array) -> jax.Array:
        cells = Cells(jnp.asarray(0.1), jnp.zeros(1), jnp.stack([line, jnp.asarray(contact.length / 2)]), True)
        return crown.mean_of_rows(cells.lines, contact)[0]

    assert np.isfinite(float(last(jnp.asarray(6.8))))
    assert np.isfinite(float(jax.grad(last)(6.8)))
    fine = jnp.linspace(6.8, contact.length / 2, 200001)
    mean = jnp.mean(crown.height(0.5 * (fine[1:] + fine[:-1]), contact))
    assert float(last(jnp.asarray(6.8))) == pytest.approx(float(mean), rel=1e-4)
