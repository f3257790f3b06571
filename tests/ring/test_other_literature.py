"""Numbers of other authors, at the tolerances their sources support."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import crown, gap
from difftrb.core import geometry
from difftrb.law import base
from difftrb.law.power import Palmgren
from difftrb.ring import ring
from tests import hertz

pytestmark = pytest.mark.literature


def single_law(stiffness: float, exponent: float) -> trb.PowerLaw:
    return trb.PowerLaw(
        jnp.zeros(1), jnp.log(jnp.array([stiffness])), jnp.array([exponent]), (0.0, np.inf), np.nan, 0.0, "given"
    )


# Liu, Fan, Wang, Liu 2022, Lubricants 10:154: roller diameter deviations S1 [µm], 10 kN axial
S1 = [
    0.28, 0.52, -0.56, 0.63, 0.33, -0.03, -0.10, -0.11, -0.15, 0.01, 0.03, 0.41,
    0.76, 0.23, -0.10, 0.31, 0.09, -0.51, 0.47, 0.15, 0.07, 0.26, 0.13,
]  # fmt: skip


@pytest.mark.parametrize(
    ("deviations", "largest", "variance"), [(S1, 2.026, 0.0162), (sorted(S1, reverse=True), 2.013, 0.0096)]
)
def test_roller_diameter_deviations(bearing, deviations: list[float], largest: float, variance: float) -> None:
    """Liu et al. 2022 use their own roller law; with Table 2's healthy one the maximum agrees to 0.1 %."""
    extra = 1e-3 * jnp.array(deviations)
    r = ring.equilibrium(bearing, trb.Load(0.0, 10000.0), (), trb.liu2018(), 0.0, ring.Terms(extra))
    kilonewton = np.asarray(r.loads) / 1e3
    assert kilonewton.max() == pytest.approx(largest, rel=1e-3)
    assert kilonewton.var(ddof=1) == pytest.approx(variance, rel=5e-2)


@pytest.mark.parametrize(
    ("axial", "kxx", "kzz"), [(4e3, 3.84e6, 2.80e6), (40e3, 4.83e6, 3.53e6), (85e3, 5.21e6, 3.80e6)]
)
def test_lim_singh_stiffness(bearing, axial: float, kxx: float, kzz: float) -> None:
    """Kumar 2005, Table 3.1: Z 20, l 18.251 mm, α 31.128°, Q = 7.86e4 l^(8/9) δ^(10/9); printed to three digits."""
    theirs = dataclasses.replace(bearing, rollers=20, outer_angle=np.deg2rad(31.128))
    r = ring.equilibrium(theirs, trb.Load(0.0, axial), (), single_law(7.86e4 * 18.251 ** (8 / 9), 10 / 9), 0.0)
    assert float(r.tangent[0, 0]) == pytest.approx(kxx, rel=3e-3)
    assert float(r.tangent[2, 2]) == pytest.approx(kzz, rel=3e-3)


def test_half_load_zone_of_nsk(bearing) -> None:
    """NSK E728g: half the rollers carry load at F_a = 1.260 F_r tanα, then Q_max = 4.08 F_r/(Z cosα)."""
    many = dataclasses.replace(bearing, rollers=400)
    alpha = many.outer_angle
    radial = 9000.0
    load = trb.Load(radial, 1.260 * radial * np.tan(alpha))
    r = ring.equilibrium(many, load, (), Palmgren(many.roller_length), 0.0)
    assert int(jnp.sum(r.loads > 0.0)) == pytest.approx(200, abs=2)
    assert float(jnp.max(r.loads)) == pytest.approx(4.08 * radial / (400 * np.cos(alpha)), rel=2e-3)


def test_iso_crown_constant_is_a_design_pressure() -> None:
    """MESYS manual: a crown of 0.00035 D_w ln(1/(1−(2y/l)²)) corresponds to 3000 MPa; eq. (2) gives 3011."""
    modulus, diameter, length = geometry.contact_modulus(2.1e5, 0.278), 10.0, 12.0
    design_load = 0.00035 * diameter * np.pi * modulus * length
    contact = trb.LineContact(diameter / 2, length, modulus, design_load)
    assert crown.scale(contact) == pytest.approx(0.00035 * diameter, rel=1e-12)
    peak = float(hertz.line_peak_pressure(design_load / length, diameter / 2, modulus))
    assert peak == pytest.approx(3011.0, abs=1.0)
    assert peak == pytest.approx(3000.0, rel=5e-3)


def test_palmgren_against_its_other_form() -> None:
    """δ = 3.84e-5 Q^0.9/l^0.8 is Q = 8.06e4 l^(8/9) δ^(10/9); Lim and Singh print 7.86e4."""
    K, slope = base.load_over(Palmgren(1.0), jnp.asarray(1.0))
    assert float(slope / K) == pytest.approx(10 / 9)
    assert float(K) == pytest.approx(8.06e4, rel=1e-3)
    assert float(K) == pytest.approx(7.86e4, rel=3e-2)


def test_iso_lamina_constant() -> None:
    assert gap.lamina_stiffness(1.0) == 35948.0
    assert gap.lamina_stiffness(8.0) == pytest.approx(35948.0 * 8.0 ** (8 / 9))


def test_catalogue_factors_of_32008_follow_from_its_contact_angle(bearing) -> None:
    """e = 1.5 tanα = 0.38, Y = 0.4 cotα = 1.58 (ISO 281); the envelope is 40 × 68 × 19 mm."""
    alpha = bearing.outer_angle
    assert 1.5 * np.tan(alpha) == pytest.approx(0.38, abs=0.005)
    assert 0.4 / np.tan(alpha) == pytest.approx(1.58, abs=0.005)
    outermost = float(geometry.outer_raceway_radius(bearing, bearing.roller_length / 2))
    innermost = float(geometry.pitch_radius(bearing)) - bearing.roller_length / 2 * np.sin(0.2211) - 3.43
    assert outermost < 68.0 / 2
    assert innermost > 40.0 / 2
