"""The line load: its kernel against quadrature, its approach against continuum solutions."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import difftrb as trb
from difftrb import line

CONTACT = trb.LineContact(3.623, 13.66, 2.1e5 / (2.0 * (1.0 - 0.278**2)), 3000.0)
# load [N], spall length [mm] (width 1, depth 0.2, centred), approach [mm]: Polonsky–Keer on edge-aligned grids of up to
# 640 × 1366 and 80 × 10928 cells, Richardson-extrapolated, error estimates below 1e-5
CONTINUUM = [
    (100.0, 0.0, 0.0005365688403),
    (100.0, 2.0, 0.0006137801635),
    (100.0, 4.0, 0.000742553878),
    (100.0, 6.0, 0.0009291261844),
    (100.0, 8.0, 0.001207644344),
    (1000.0, 0.0, 0.003023218433),
    (1000.0, 2.0, 0.003267867384),
    (1000.0, 4.0, 0.003690234545),
    (1000.0, 6.0, 0.004306116163),
    (1000.0, 8.0, 0.005243200774),
    (3000.0, 0.0, 0.007588983207),
    (3000.0, 2.0, 0.008111204602),
    (3000.0, 4.0, 0.009046521489),
]


@pytest.mark.parametrize("sigma", [1e-3, 0.02, 0.4, 1.0, 3.0, 50.0])
def test_ellipse_integral(sigma: float) -> None:
    """t = sin φ in ∫ (2/π)√(1−t²) asinh(σ/|t|) dt."""
    exact = quad(
        lambda f: 4.0 / np.pi * np.cos(f) ** 2 * np.arcsinh(sigma / np.sin(f)), 0.0, 0.5 * np.pi,
        epsabs=1e-11, epsrel=1e-10, limit=200,
    )[0]  # fmt: skip
    assert float(line.ellipse_integral(jnp.asarray(sigma))) == pytest.approx(exact, abs=6e-7)
    assert float(line.ellipse_integral(jnp.asarray(-sigma))) == pytest.approx(-exact, abs=6e-7)


@pytest.mark.parametrize(("load", "length", "approach"), CONTINUUM)
def test_approach_is_within_a_thousandth(load: float, length: float, approach: float) -> None:
    spall = trb.Spall(length, 1.0) if length else None
    found = trb.line_contact(CONTACT, load, spall).check()
    assert float(found.approach) == pytest.approx(approach, rel=1e-3)
    assert float(jnp.vdot(found.line_load, found.end - found.start)) == pytest.approx(0.5 * load, rel=1e-9)


def test_off_the_middle_it_agrees_with_the_strips() -> None:
    spall = trb.Spall(4.0, 7.0, axial_offset=1.2)
    found = trb.line_contact(CONTACT, 1500.0, spall).check()
    full = trb.solve_contact(CONTACT, 1500.0, spall, 0.0, 1e-4, "strips").check()
    assert float(found.approach) == pytest.approx(float(full.approach), rel=1e-3)
