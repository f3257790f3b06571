"""The mean over cage phases, against many phases."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import geometry
from difftrb.ring import phase_average

pytestmark = pytest.mark.exact

MANY = 2000


@pytest.fixture(scope="module")
def scene(bearing) -> trb.Scene:
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 5.0),), law="liu2018", phase="mean")


def brute(scene: trb.Scene, values) -> jax.Array:
    """The mean of `values(solution)` over many equal steps of phase."""
    phases = (jnp.arange(MANY) + 0.5) / MANY * geometry.roller_pitch(scene.bearing)
    every = jax.jit(jax.vmap(lambda p, s: values(trb.solve(dataclasses.replace(s, phase=p))), (0, None)))
    return jnp.mean(every(phases, scene), axis=0)


def test_weights_are_a_mean(scene) -> None:
    phases, weights = phase_average.phases(
        scene.bearing, scene.load, (phase_average.Met("outer", scene.spalls, trb.liu2018()),)
    )
    whole = float(geometry.roller_pitch(scene.bearing))
    assert phases.shape == weights.shape == (40,)
    assert float(weights.sum()) == pytest.approx(1.0, abs=1e-12)
    assert float(weights.min()) > -1e-15  # two kinks may coincide
    assert float(phases.max() - phases.min()) < whole


def test_mean_is_that_of_many_phases(scene) -> None:
    """40 phases against 2000, whose own error is a jump of 3 % times one step in 2000."""
    r = trb.solve(scene).check()
    stiffness, loads = brute(scene, lambda s: s.stiffness), brute(scene, lambda s: s.loads)
    np.testing.assert_allclose(r.stiffness, stiffness, atol=3e-5 * float(stiffness.max()))
    np.testing.assert_allclose(r.loads, loads, atol=1e-4 * float(loads.max()))
    assert (np.asarray(r.stiffness_span[0]) <= np.asarray(r.stiffness) + 1e-6).all()
    assert (np.asarray(r.stiffness_span[1]) >= np.asarray(r.stiffness) - 1e-6).all()


def test_width_acts_on_the_mean_through_the_window_alone(scene) -> None:
    """A hard window is open for a share of the pitch that grows with width: the slope is the jump times that."""

    def stiffness(s: trb.Scene) -> jax.Array:
        return trb.solve(s).stiffness[0, 0]

    def wide(width: float) -> trb.Scene:
        return dataclasses.replace(scene, spalls=(trb.Spall(4.0, width),))

    slope = float(jax.grad(stiffness)(scene).spalls[0].width)
    h = 0.2
    assert slope == pytest.approx(float(stiffness(wide(5 + h)) - stiffness(wide(5 - h))) / (2 * h), rel=1e-2)
    change = brute(wide(5 + h), lambda s: s.stiffness[0, 0]) - brute(wide(5 - h), lambda s: s.stiffness[0, 0])
    assert slope == pytest.approx(float(change) / (2 * h), rel=1e-2)
    assert slope < -1e3


@pytest.mark.portable
@pytest.mark.parametrize("leaf", ["length", "angle", "width"])
def test_derivatives_forward_and_reverse(scene, leaf: str) -> None:
    moved = dataclasses.replace(scene, spalls=(trb.Spall(4.0, 5.0, angle=0.1),))

    def stiffness(value: jax.Array) -> jax.Array:
        spall = dataclasses.replace(moved.spalls[0], **{leaf: value})
        return trb.solve(dataclasses.replace(moved, spalls=(spall,))).stiffness[2, 2]

    at = jnp.asarray(getattr(moved.spalls[0], leaf))
    forward, reverse = float(jax.jacfwd(stiffness)(at)), float(jax.grad(stiffness)(at))
    h = 1e-4
    assert forward == pytest.approx(reverse, rel=1e-8, abs=1e-6)
    assert forward == pytest.approx(float(stiffness(at + h) - stiffness(at - h)) / (2 * h), rel=1e-4)


def test_the_load_zone_moves_with_the_load(bearing) -> None:
    """Its ends are kinks, too. Held fast, they left the derivative by the load of a narrow zone 40 % off."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 2650.0), law="liu2018", phase="mean")

    def stiffness(radial: jax.Array | float) -> jax.Array:
        return trb.solve(dataclasses.replace(scene, load=trb.Load(radial, 2650.0))).stiffness[0, 0]

    def many(radial: float) -> jax.Array:
        return brute(dataclasses.replace(scene, load=trb.Load(radial, 2650.0)), lambda s: s.stiffness[0, 0])

    slope = float(jax.grad(stiffness)(9000.0))
    assert slope == pytest.approx(float(stiffness(9000.1) - stiffness(8999.9)) / 0.2, rel=1e-5)
    assert slope == pytest.approx(float(many(9010.0) - many(8990.0)) / 20.0, rel=0.1)  # of the power law near its zero


def test_pure_axial_load_and_no_spall_have_a_mean(bearing) -> None:
    """No kinks at all, or as good as none: still a mean, of what does not change."""
    scene = trb.Scene(bearing, trb.Load(0.0, 4500.0), law="liu2018", phase="mean")
    r = trb.solve(scene).check()
    one = trb.solve(dataclasses.replace(scene, phase=0.03))
    np.testing.assert_allclose(r.stiffness, one.stiffness, atol=1e-9 * float(one.stiffness.max()))


def test_another_word_for_the_mean_is_refused(scene) -> None:
    with pytest.raises(ValueError, match="give an angle"):
        dataclasses.replace(scene, phase="average")
