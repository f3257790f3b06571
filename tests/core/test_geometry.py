"""Every number derived from Table 1 of Liu et al. 2018, by hand where a hand can."""

import math

import pytest

import difftrb as trb
from difftrb.core import geometry

pytestmark = pytest.mark.exact


def test_derived_numbers_of_32008j(bearing: trb.TaperedBearing) -> None:
    assert geometry.contact_modulus(2.1e5, 0.278) == pytest.approx(113794.0, rel=1e-5)
    assert geometry.mean_roller_radius(bearing) == pytest.approx((6.131 + 6.846) / 4)
    assert geometry.apex_distance(bearing) == pytest.approx(123.96, abs=0.005)
    assert geometry.roller_axis_angle(bearing) == pytest.approx(0.2211, abs=1e-12)
    assert geometry.pitch_radius(bearing) == pytest.approx(27.19, abs=0.005)
    assert geometry.roller_normal_radius(bearing) == pytest.approx(3.247, abs=0.0005)
    assert geometry.raceway_normal_radius(bearing, "outer") == pytest.approx(31.29, abs=0.005)
    assert geometry.raceway_normal_radius(bearing, "inner") == pytest.approx(24.47, abs=0.01)
    assert geometry.equivalent_radius(bearing, "outer") == pytest.approx(3.623, abs=0.001)
    assert geometry.equivalent_radius(bearing, "inner") == pytest.approx(2.867, abs=0.0005)
    assert geometry.flange_force_angle(bearing) == pytest.approx(0.2036, abs=5e-5)
    assert geometry.roller_mass(bearing) == pytest.approx(3.55e-3, rel=1e-3)
    assert geometry.roller_pitch(bearing) == pytest.approx(0.2732, abs=5e-5)


def test_cones_share_one_apex(bearing: trb.TaperedBearing) -> None:
    assert bearing.outer_angle - bearing.inner_angle == pytest.approx(2 * bearing.roller_angle)
    assert math.atan((6.846 - 6.131) / 2 / 13.66) == pytest.approx(bearing.roller_angle, rel=2e-3)


def test_default_arc_radius_is_the_papers_choice(bearing: trb.TaperedBearing) -> None:
    """7 mm and 0.24 rad, 49 mm and 1.71 rad: the outer raceway at the roller's small end, not its middle."""
    assert geometry.arc_radius(bearing) == pytest.approx(28.65, rel=1e-3)
    assert 49.0 / geometry.arc_radius(bearing) == pytest.approx(1.71, abs=0.005)
    assert 7.0 / geometry.arc_radius(bearing) == pytest.approx(0.24, abs=0.005)
    assert geometry.outer_raceway_radius(bearing) == pytest.approx(30.3, abs=0.05)


def test_rollers_of_32008j_leave_a_7_mm_spall_at_times(bearing: trb.TaperedBearing) -> None:
    """No roller is in it at 10.6 % of cage phases."""
    covered = 7.0 / geometry.arc_radius(bearing)
    assert 1.0 - covered / geometry.roller_pitch(bearing) == pytest.approx(0.106, abs=5e-4)


def test_contact_of_a_bearing(bearing: trb.TaperedBearing) -> None:
    inner = trb.LineContact.of(bearing, "inner")
    assert (inner.length, inner.design_load) == (13.66, 6500.0)
    assert inner.radius == pytest.approx(2.867, abs=0.0005)


def test_unknown_bearing_names_the_known_ones() -> None:
    with pytest.raises(trb.SceneError, match="32008J"):
        trb.bearing("30205")
