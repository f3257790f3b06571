"""Closed forms against each other and against scipy's elliptic integrals."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

from difftrb.core import geometry
from tests import hertz

pytestmark = pytest.mark.exact


def test_complete_elliptic_integrals() -> None:
    k = np.array([1e-6, 1e-3, 0.1, 0.5, 0.9, 1.0])
    K, E = hertz._complete_elliptic(jnp.asarray(k))
    np.testing.assert_allclose(K, special.ellipkm1(k * k), rtol=1e-12)
    np.testing.assert_allclose(E, special.ellipe(1.0 - k * k), rtol=1e-12)


def test_round_ellipse_is_a_sphere() -> None:
    ellipse, sphere = hertz.ellipse(100.0, 5.0, 5.0 * (1 + 1e-4), 1e5), hertz.sphere(100.0, 5.0, 1e5)
    for got, expected in zip(ellipse, sphere, strict=True):
        assert float(got) == pytest.approx(float(expected), rel=1e-4)


@pytest.mark.parametrize("ratio", [1.5, 10.0, 1000.0])
def test_ellipse_satisfies_hertz_equations(ratio: float) -> None:
    load, radius, modulus = 100.0, 3.0, 1e5
    e = hertz.ellipse(load, radius, ratio * radius, modulus)
    k = float(e.semi_x / e.semi_y)
    K, E = special.ellipkm1(k * k), special.ellipe(1.0 - k * k)
    assert (E / k**2 - K) / (K - E) == pytest.approx(ratio, rel=1e-9)  # Johnson 1985, eq. (4.28)
    p0, a, b = float(e.peak_pressure), float(e.semi_y), float(e.semi_x)
    assert p0 * b / modulus * (E / k**2 - K) / (1 - k * k) / (a * a) == pytest.approx(1 / (2 * radius), rel=1e-9)
    assert 2 / 3 * np.pi * a * b * p0 == pytest.approx(load, rel=1e-12)


def test_line_contact_of_32008j() -> None:
    """Half width 0.0944 mm and peak pressure 1482 MPa at 3 kN on the outer raceway."""
    modulus = geometry.contact_modulus(2.1e5, 0.278)
    assert hertz.line_half_width(3000.0 / 13.66, 3.623, modulus) == pytest.approx(0.0944, abs=5e-5)
    assert hertz.line_peak_pressure(3000.0 / 13.66, 3.623, modulus) == pytest.approx(1482.0, abs=1.0)


def test_line_pressure_carries_its_load() -> None:
    b = float(hertz.line_half_width(200.0, 3.6, 1e5))
    x = jnp.linspace(-1.1 * b, 1.1 * b, 20001)
    p = hertz.line_pressure(x, 200.0, 3.6, 1e5)
    assert float(jnp.trapezoid(p, x)) == pytest.approx(200.0, rel=1e-5)
