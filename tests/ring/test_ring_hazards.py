"""Rings at and beyond the edge of equilibrium, and at kinks."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import geometry, status
from difftrb.law import direct_curves, ramp_fit
from difftrb.ring import newton, ring
from difftrb.ring.load import needed_axial
from tests.bearings import of_many

pytestmark = pytest.mark.hard


def test_random_rings_all_come_to_rest(bearing) -> None:
    """Radial loads over seven decades, axial loads from 1e-5 above the least possible, any spall anywhere."""
    rng = np.random.default_rng(0)
    count = 2000
    radial = 10 ** rng.uniform(-1, 6, count)
    above = 1.0 + 10 ** rng.uniform(-5, 3, count)
    phase, angle = rng.uniform(0, 0.2732, count), rng.uniform(-3, 3, count)
    length, width = rng.uniform(0, 8, count), rng.uniform(1, 100, count)

    def rest(radial, above, phase, length, width, angle):
        load = trb.Load(radial, above * needed_axial(bearing, radial, phase))
        spall = trb.Spall(length, width, depth=1e6, angle=angle)  # under 1e9 N rollers would meet any other bottom
        e = ring.equilibrium(bearing, load, (spall,), trb.liu2018(), phase)
        return e.status_code, e.residual, jnp.linalg.eigvalsh(e.tangent)[0], jnp.min(e.loads)

    arguments = (jnp.asarray(a) for a in (radial, above, phase, length, width, angle))
    codes, residuals, least, loads = jax.jit(jax.vmap(rest))(*arguments)
    assert (np.asarray(codes) == status.CONVERGED).all()
    assert float(residuals.max()) <= newton.TOLERANCE
    assert (np.asarray(least) > 0.0).all()
    assert (np.asarray(loads) >= 0.0).all()


@pytest.mark.parametrize("axial", [0.0, 100.0, 2272.0])
def test_no_equilibrium_is_said_and_spoils_nothing(bearing, axial: float) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), law="liu2018")
    bad = trb.solve(dataclasses.replace(scene, load=trb.Load(9000.0, axial)))
    assert not bool(bad.converged)
    assert "axial load is too small" in bad.status
    assert jnp.isnan(bad.loads).all()
    with pytest.raises(trb.SolveError, match=r"raise load\.axial"):
        bad.check()
    batch = jax.vmap(lambda a: trb.solve(dataclasses.replace(scene, load=trb.Load(9000.0, a))))(
        jnp.array([axial, 4500.0])
    )
    assert np.isfinite(np.asarray(batch.loads[1])).all()
    assert list(np.asarray(batch.converged)) == [False, True]


def test_gradient_of_a_good_member_survives_a_bad_neighbour(bearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="liu2018")

    def stiffness(axial: jax.Array) -> jax.Array:
        return trb.solve(dataclasses.replace(scene, load=trb.Load(9000.0, axial))).stiffness[0, 0]

    slopes = jax.vmap(jax.grad(stiffness))(jnp.array([100.0, 4500.0]))
    assert np.isfinite(float(slopes[1]))
    assert float(slopes[1]) == pytest.approx(float(jax.grad(stiffness)(4500.0)), rel=1e-12)


@pytest.mark.parametrize("how", [lambda f: f, jax.jit], ids=["numbers", "program"])
def test_derivatives_of_what_has_no_solution_are_none(bearing, how) -> None:
    """They were 0, as at an optimum, beside a value that is NaN."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="liu2018")

    def stiffness(axial: jax.Array, length: jax.Array) -> jax.Array:
        return trb.solve(scene.replace(axial=axial, length=length)).stiffness[0, 0]

    slope = how(jax.grad(stiffness, argnums=(0, 1)))
    assert np.isnan(slope(100.0, 4.0)).all()
    assert np.isnan(slope(4500.0, np.nan)).all()
    assert np.isfinite(slope(4500.0, 4.0)).all()


def test_rollers_clear_of_the_raceway_leave_no_nan(bearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 2500.0), (trb.Spall(4.0, 7.0),), law="liu2018")
    r = trb.solve(scene).check()
    assert int(jnp.sum(r.loads == 0.0)) > 10
    for leaf in jax.tree.leaves(jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene)):
        assert np.isfinite(np.asarray(leaf)).all()


def test_a_roller_exactly_at_zero_approach_has_finite_derivatives() -> None:
    from difftrb.law import base

    spall = trb.Spall(2.0, 7.0)
    for which in (0, 1):
        slope = jax.grad(lambda d, which=which: base.load_over(trb.liu2018(), d, spall)[which])(0.0)
        assert np.isfinite(float(slope))


def test_no_load_at_all_is_no_equilibrium(bearing) -> None:
    r = trb.solve(trb.Scene(bearing, trb.Load(0.0, 0.0), law="liu2018"))
    assert not bool(r.converged)
    assert jnp.isnan(r.loads).all()


def test_numbers_that_are_not_numbers_are_flagged(bearing) -> None:
    for load in (trb.Load(float("nan"), 4500.0), trb.Load(9000.0, float("nan"))):
        assert "not a number" in trb.solve(trb.Scene(bearing, load, law="liu2018")).status
    nan = float("nan")
    for spall in (trb.Spall(4.0, 7.0, angle=nan), trb.Spall(4.0, nan)):
        r = trb.solve(trb.Scene(bearing, trb.Load(9000.0, 4500.0), (spall,), law="liu2018"))
        assert "not a number" in r.status
        assert jnp.isnan(r.loads).all()


def test_negative_numbers_are_refused_and_flagged_inside_jit(bearing) -> None:
    good = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="liu2018")
    for load, length in ((-1.0, 4.0), (9000.0, -4.0)):
        bad = dataclasses.replace(good, load=trb.Load(load, 4500.0), spalls=(trb.Spall(length, 7.0),))
        with pytest.raises(trb.SceneError, match=r"= -\d\.0: must be a number in 0 …"):
            trb.solve(bad)
        r = jax.jit(trb.solve)(bad)
        assert "not a number" in r.status
        assert jnp.isnan(r.loads).all()


def test_whole_numbers_are_numbers(bearing) -> None:
    whole = trb.assess(trb.Scene(bearing, trb.Load(9000, 4500), (trb.Spall(4, 7),), law="liu2018"))
    real = trb.assess(trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="liu2018"))
    assert float(whole.by_length[0, 0]) == float(real.by_length[0, 0])


def test_unknown_definitions_are_refused(bearing) -> None:
    with pytest.raises(ValueError, match=r"definition = 'Secant': must be one of 'tangent', 'secant'"):
        trb.solve(trb.Scene(bearing, trb.Load(9000.0, 4500.0), law="liu2018", definition="Secant"))  # type: ignore[arg-type]


def test_one_fitted_law_cannot_serve_spalls_of_two_shapes(bearing) -> None:
    spalls = trb.Spall(4.0, 7.0), trb.Spall(4.0, 7.0, depth=0.002, angle=1.0)
    with pytest.raises(ValueError, match="one width, depth and axial offset"):
        trb.solve(trb.Scene(bearing, trb.Load(9000.0, 4500.0), spalls, "power"))


def test_a_spall_longer_than_the_law_knows_is_refused_by_status(bearing) -> None:
    r = trb.solve(trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(9.0, 7.0),), law=trb.liu2018()))
    assert "longer than the roller law knows" in r.status
    assert jnp.isnan(r.loads).all()


def test_a_spall_that_begins_to_grow_has_the_slope_of_growing(bearing) -> None:
    """At length 0 no roller was taken to be over it, and the derivative was 0."""

    def stiffness(length: jax.Array) -> jax.Array:
        scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(length, 7.0),), law="liu2018")
        return trb.solve(scene).stiffness[0, 0]

    value, slope = jax.jit(jax.value_and_grad(stiffness))(0.0)
    healthy = trb.solve(trb.Scene(bearing, trb.Load(9000.0, 4500.0), law="liu2018"))
    assert float(value) == pytest.approx(float(healthy.stiffness[0, 0]), rel=1e-12)
    assert float(slope) == pytest.approx(float(stiffness(1e-5) - value) / 1e-5, rel=1e-3)
    assert abs(float(slope)) > 1.0


@pytest.mark.parametrize("clear", ["over one spall", "too thin"])
def test_rollers_that_are_all_clear_at_first(bearing, clear: str) -> None:
    """Newton's method once began where none was loaded, and ended there."""
    plain = trb.Scene(bearing, trb.Load(2000.0, 4500.0), law="liu2018")
    if clear == "too thin":
        moved = dataclasses.replace(plain, effects=(trb.effects.Diameters((-0.5,) * bearing.rollers),))
    else:
        around = trb.Spall(4.0, 174.0, 0.2)  # what is left lies between two rollers
        moved = dataclasses.replace(plain, spalls=(around,), effects=(trb.effects.Through(),))
    there = trb.solve(moved).check()
    np.testing.assert_allclose(there.loads, trb.solve(plain).check().loads, rtol=1e-9)


@pytest.mark.parametrize("rollers", [3, 4, 60, 200])
def test_few_and_many_rollers(bearing, rollers: int) -> None:
    few = of_many(bearing, rollers)
    r = trb.solve(trb.Scene(few, trb.Load(1000.0, 4500.0), law=trb.liu2018()))
    assert bool(r.converged), r.status


def test_phase_on_a_window_edge(bearing) -> None:
    """Just inside and just outside differ by one roller; the edge itself is finite and one of the two."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="liu2018")
    edge = 3.5 / float(geometry.arc_radius(bearing))
    inside, at, outside = (
        float(trb.solve(dataclasses.replace(scene, phase=p)).stiffness[0, 0]) for p in (edge - 1e-9, edge, edge + 1e-9)
    )
    assert inside < outside
    assert at in (pytest.approx(inside, rel=1e-6), pytest.approx(outside, rel=1e-6))


def test_ramps_of_contacts_without_a_solution_are_nan() -> None:
    """And nothing else warns of it: the law's status says it."""
    loads = direct_curves.log_loads(1000.0)
    assert np.isnan(ramp_fit.extents(loads, np.where(np.arange(loads.size) == 3, -1.0, 0.1))).all()


def test_without_float64_everything_refuses(bearing, contact) -> None:
    with jax.enable_x64(False):
        with pytest.raises(trb.SolveError, match="jax_enable_x64"):
            trb.solve(trb.Scene(bearing, trb.Load(9000.0, 4500.0), law="liu2018"))
        with pytest.raises(trb.SolveError, match="jax_enable_x64"):
            trb.solve_contact(contact, 1000.0)
        with pytest.raises(trb.SolveError, match="jax_enable_x64"):
            trb.power_law(contact)
