"""The ring: equilibrium, symmetry, closed forms, and where there is none."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

import difftrb as trb
from difftrb.core import geometry, status
from difftrb.law import roller_curves
from difftrb.law.power import Palmgren
from difftrb.ring import newton_start, ring, roller_places
from difftrb.ring.load import needed_axial
from tests import shapes

pytestmark = pytest.mark.exact

LIU = trb.liu2018()


def rest(bearing, radial, axial, spalls=(), roller_law=LIU, phase=0.0, interference=0.0):
    return ring.equilibrium(bearing, trb.Load(radial, axial), spalls, roller_law, phase, ring.Terms(interference))


@pytest.mark.parametrize("phase", [0.0, 0.05, 0.13])
@pytest.mark.parametrize(
    ("radial", "axial"), [(9000.0, 4500.0), (0.0, 60.0), (120.0, 60.0), (9000.0, 2300.0), (1e5, 1e6)]
)
def test_loads_balance(bearing, radial: float, axial: float, phase: float) -> None:
    r = rest(bearing, radial, axial, (trb.Spall(6.0, 7.0, depth=10.0),), phase=phase)
    assert status.describe(r.status_code) == "converged"
    shapes.check(r)
    angles = roller_places.roller_angles(bearing, phase)
    cos, sin = jnp.cos(bearing.outer_angle), jnp.sin(bearing.outer_angle)
    scale = np.hypot(radial, axial)
    assert float(jnp.sum(r.loads * jnp.cos(angles)) * cos) == pytest.approx(radial, abs=1e-10 * scale)
    assert float(jnp.sum(r.loads * jnp.sin(angles)) * cos) == pytest.approx(0.0, abs=1e-10 * scale)
    assert float(jnp.sum(r.loads) * sin) == pytest.approx(axial, abs=1e-10 * scale)
    assert float(jnp.min(r.loads)) >= 0.0
    assert jnp.all((r.loads > 0.0) == (r.approach > 0.0))


def test_a_spall_on_a_roller_meets_both_raceways_the_same_way_round(bearing) -> None:
    """About its own axis a point at ε from the outer contact lies ahead of it along the cage's turn, one at ε from the
    inner contact behind it."""
    for contact, raceway, way in ((0.0, "outer", -1.0), (np.pi, "inner", 1.0)):
        spall = trb.Spall(4.0, 1.0, angle=contact + 0.1, surface="roller")
        away = roller_places.distances(bearing, (spall,), roller_places.roller_angles(bearing, 0.3), raceway)[0]
        assert float(away[0]) == pytest.approx(way * 0.1 * float(geometry.mean_roller_radius(bearing)))
        assert float(away[1]) > 10.0


def test_pure_axial_load_is_shared_equally_and_has_closed_stiffness(bearing) -> None:
    axial = 10000.0
    r = rest(bearing, 0.0, axial)
    alpha, rollers = bearing.outer_angle, bearing.rollers
    share = axial / (rollers * np.sin(alpha))
    np.testing.assert_allclose(r.loads, share, rtol=1e-12)
    K, n = (float(v) for v in LIU.coefficients(jnp.zeros(())))
    slope = n * share / (share / K) ** (1.0 / n)
    expected = rollers * slope * np.diag([np.cos(alpha) ** 2 / 2, np.cos(alpha) ** 2 / 2, np.sin(alpha) ** 2])
    np.testing.assert_allclose(r.tangent, expected, rtol=1e-11, atol=1e-9 * expected.max())


def test_a_power_law_scales(bearing) -> None:
    """Loads scale with the load; displacements with its 1/n-th power, for one exponent."""
    palmgren = Palmgren(bearing.roller_length)
    one, ten = (rest(bearing, k * 9000.0, k * 4500.0, (trb.Spall(4.0, 7.0),), palmgren) for k in (1.0, 10.0))
    np.testing.assert_allclose(ten.loads, 10.0 * one.loads, rtol=1e-9)
    np.testing.assert_allclose(ten.displacement, 10.0**0.9 * one.displacement, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(ten.tangent, 10.0**0.1 * one.tangent, rtol=1e-9, atol=1e-6 * float(one.tangent.max()))


def test_mirrored_spalls_mirror_the_loads(bearing) -> None:
    left, right = (rest(bearing, 9000.0, 4500.0, (trb.Spall(6.0, 7.0, angle=side * 0.2732),)) for side in (1.0, -1.0))
    mirror = -np.arange(bearing.rollers) % bearing.rollers
    np.testing.assert_allclose(left.loads, right.loads[mirror], rtol=1e-10)
    assert float(left.displacement[1]) == pytest.approx(-float(right.displacement[1]), rel=1e-8)


def test_one_roller_pitch_of_phase_renames_the_rollers(bearing) -> None:
    spalls = (trb.Spall(6.0, 7.0),)
    base, turned = (rest(bearing, 9000.0, 4500.0, spalls, phase=p) for p in (0.1, 0.1 + geometry.roller_pitch(bearing)))
    np.testing.assert_allclose(turned.loads, jnp.roll(base.loads, -1), rtol=1e-10)
    np.testing.assert_allclose(turned.tangent, base.tangent, rtol=1e-9, atol=1e-9 * float(base.tangent.max()))


def test_tangent_is_the_derivative_of_force(bearing) -> None:
    """Force by displacement, from differences of the equilibrium itself."""
    spalls, h = (trb.Spall(6.0, 7.0),), 0.5

    def u(radial: float, axial: float):
        return rest(bearing, radial, axial, spalls).displacement

    radial = (u(9000.0 + h, 4500.0) - u(9000.0 - h, 4500.0)) / (2 * h)
    axial = (u(9000.0, 4500.0 + h) - u(9000.0, 4500.0 - h)) / (2 * h)
    compliance = np.linalg.inv(np.asarray(rest(bearing, 9000.0, 4500.0, spalls).tangent))
    np.testing.assert_allclose(radial, compliance[:, 0], rtol=1e-6, atol=1e-9 * compliance.max())
    np.testing.assert_allclose(axial, compliance[:, 2], rtol=1e-6, atol=1e-9 * compliance.max())


@pytest.mark.parametrize("phase", [0.0, 0.05, 0.1366])
def test_needed_axial_is_where_pushing_rollers_can_no_longer_hold_the_load(bearing, phase: float) -> None:
    """Against a linear programme: the least axial load for which some loads Q ≥ 0 balance the radial one."""
    normals = np.asarray(roller_places.directions(bearing, roller_places.roller_angles(bearing, phase)))
    answer = optimize.linprog(normals[:, 2], A_eq=normals[:, :2].T, b_eq=[9000.0, 0.0], bounds=(0, None))
    assert float(needed_axial(bearing, 9000.0, phase)) == pytest.approx(answer.fun, rel=1e-9)


def test_hard_window_counts_rollers(bearing) -> None:
    """One roller in spalls of 7 and 14 mm, 3 at 21 and 28, 5 at 35 and 42, 7 at 49 (a roller centred)."""
    angles = roller_places.roller_angles(bearing, 0.0)
    for width, inside in zip((7, 14, 21, 28, 35, 42, 49), (1, 1, 3, 3, 5, 5, 7), strict=True):
        spalls = (trb.Spall(4.0, float(width)),)
        away = roller_places.distances(bearing, spalls, angles)
        assert int(jnp.sum(roller_curves.spalls_under(spalls, away))) == inside


def test_of_two_spalls_under_a_roller_the_longer_counts(bearing) -> None:
    angles = roller_places.roller_angles(bearing, 0.0)
    spalls = (trb.Spall(2.0, 7.0), trb.Spall(5.0, 3.0), trb.Spall(3.0, 5.0, angle=float(angles[4])))
    over = np.asarray(roller_curves.spalls_under(spalls, roller_places.distances(bearing, spalls, angles)))
    assert (over[0], over[4]) == (2, 3)
    assert over.sum() == 5


def test_secant_is_force_over_displacement(bearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), law="liu2018", definition="secant")
    r = trb.solve(scene)
    assert float(r.radial_stiffness) == pytest.approx(9000.0 / float(r.displacement[0]))
    assert float(r.axial_stiffness) == pytest.approx(4500.0 / float(r.displacement[2]))
    axial_only = trb.solve(dataclasses.replace(scene, load=trb.Load(0.0, 4500.0)))
    assert jnp.isnan(axial_only.radial_stiffness)
    assert jnp.isfinite(axial_only.axial_stiffness)


@pytest.mark.parametrize("exponent", [1.1, 1.2, 1.35])
@pytest.mark.parametrize("narrowness", [0.05, 0.5, 1.0, 3.0])
def test_load_zone_of_many_rollers(exponent: float, narrowness: float) -> None:
    """Sums over 600 rollers give back, through the ratio of their forces, the load zone they were made of."""
    angles = 2.0 * np.pi * np.arange(600) / 600
    share = np.maximum(1.0 - narrowness * (1.0 - np.cos(angles)), 0.0) ** exponent
    ratio = np.sum(share * np.cos(angles)) / np.sum(share)
    found, largest = newton_start.load_zone(jnp.asarray(ratio), jnp.asarray(exponent))
    assert float(found) == pytest.approx(narrowness, rel=0.05)
    assert float(largest) == pytest.approx(1.0 / np.mean(share), rel=0.03)


@pytest.mark.parametrize("axial", [2600.0, 4500.0, 9000.0, 1e5])
def test_newton_begins_at_the_load_zone(bearing, axial: float) -> None:
    """From rollers all loaded alike it takes up to eight steps."""
    assert int(rest(bearing, 9000.0, axial, (trb.Spall(4.0, 7.0),)).iterations) <= 4
