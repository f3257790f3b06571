"""Derivatives of the whole road: a scene in, a scene of gradients out."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.law import roller_curves
from difftrb.law.power import Palmgren
from difftrb.ring import roller_places
from tests import shapes

pytestmark = pytest.mark.gradient


def resized(scene: trb.Scene, length: jax.Array) -> trb.Scene:
    return dataclasses.replace(scene, spalls=(dataclasses.replace(scene.spalls[0], length=length),))


@pytest.fixture(params=["power", "liu2018", "palmgren"])
def any_scene(request, scene: trb.Scene, power) -> trb.Scene:
    named = {"power": power, "liu2018": trb.liu2018(), "palmgren": Palmgren(scene.bearing.roller_length)}
    return dataclasses.replace(scene, law=named[request.param])


@pytest.mark.parametrize("definition", ["tangent", "secant"])
def test_stiffness_by_length(any_scene: trb.Scene, definition) -> None:
    scene = dataclasses.replace(any_scene, definition=definition)

    def stiffness(length: jax.Array) -> jax.Array:
        s = trb.solve(resized(scene, length))
        return jnp.stack([s.radial_stiffness, s.axial_stiffness])

    at, h = jnp.asarray(4.3), 1e-4
    forward, reverse = jax.jacfwd(stiffness)(at), jax.jacrev(stiffness)(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    difference = (stiffness(at + h) - stiffness(at - h)) / (2 * h)
    np.testing.assert_allclose(forward, difference, rtol=1e-6)
    assert (np.asarray(forward) < 0.0).all()


def test_shapes_are_as_annotated(scene: trb.Scene) -> None:
    found = trb.assess(dataclasses.replace(scene, law=trb.liu2018()))
    shapes.check(found)
    shapes.check(found.spalled)


def test_loads_by_length(any_scene: trb.Scene) -> None:
    def loads(length: jax.Array) -> jax.Array:
        return trb.solve(resized(any_scene, length)).loads

    at, h = jnp.asarray(4.3), 1e-4
    forward, reverse = jax.jacfwd(loads)(at), jax.jacrev(loads)(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-9)
    difference = (loads(at + h) - loads(at - h)) / (2 * h)
    np.testing.assert_allclose(forward, difference, rtol=1e-6, atol=1e-6 * float(jnp.abs(forward).max()))
    assert float(jnp.sum(forward)) == pytest.approx(0.0, abs=1e-9)  # the axial load fixes the sum


def test_every_leaf_of_a_scene_has_its_gradient(scene: trb.Scene) -> None:
    """The bearing, load, phase and law by central differences, one leaf at a time."""

    def stiffness(s: trb.Scene) -> jax.Array:
        return trb.solve(s).stiffness[0, 0]

    slopes = jax.tree.leaves(jax.grad(stiffness)(scene))
    leaves, structure = jax.tree.flatten(scene)
    checked = 0
    for i, leaf in enumerate(leaves):
        leaf = np.asarray(leaf, float)
        for index in np.ndindex(leaf.shape):
            h = 1e-5 * max(abs(leaf[index]), 1e-2)

            def moved(step: float, i=i, leaf=leaf, index=index) -> float:
                changed = leaf.copy()
                changed[index] += step
                return float(
                    stiffness(jax.tree.unflatten(structure, [*leaves[:i], jnp.asarray(changed), *leaves[i + 1 :]]))
                )

            difference = (moved(h) - moved(-h)) / (2 * h)
            got = float(np.asarray(slopes[i])[index])
            assert got == pytest.approx(
                difference, rel=2e-5, abs=1e-6 * float(stiffness(scene)) / max(abs(leaf[index]), 1)
            )
            checked += 1
    assert checked > 30


def test_second_derivation_of_the_load_gradient(scene: trb.Scene) -> None:
    """du/dl = −K⁻¹ ΣdQ/dl n, dQ_j/dl = ∂Q/∂l + Q' n·du/dl, assembled in numpy."""
    s = trb.solve(scene)
    away = roller_places.distances(scene.bearing, scene.spalls, s.angles)
    normals = np.asarray(roller_places.directions(scene.bearing, s.angles))
    h = 1e-5

    def at(length: float) -> tuple[jax.Array, jax.Array]:
        return roller_curves.roller_loads(s.law.curves(resized(scene, jnp.asarray(length)).spalls, away), s.approach)

    by_length = np.asarray((at(4.0 + h)[0] - at(4.0 - h)[0]) / (2 * h))
    slopes = np.asarray(at(4.0)[1])
    moved = -np.linalg.solve(np.asarray(s.stiffness), normals.T @ by_length)
    expected = by_length + slopes * (normals @ moved)
    got = jax.jacfwd(lambda l: trb.solve(resized(scene, l)).loads)(4.0)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_width_derivative_is_zero_under_a_hard_window(scene: trb.Scene) -> None:
    slope = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene).spalls[0]
    assert float(slope.width) == 0.0
    assert float(slope.length) < 0.0


def test_assessment_agrees_with_solve(scene: trb.Scene) -> None:
    a = trb.assess(scene)
    slope = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene).spalls[0]
    assert float(a.by_length[0, 0]) == pytest.approx(float(slope.length), rel=1e-9)
    assert float(a.by_width[0, 0]) == 0.0
    healthy = trb.solve(trb.healthy(scene))
    assert float(a.loss[0]) == pytest.approx(100 * (1 - float(a.spalled.stiffness[0, 0] / healthy.stiffness[0, 0])))


@pytest.mark.slow
def test_named_law_carries_gradients_through_its_contact_solves(scene: trb.Scene, bearing) -> None:
    """By design load: the law is fitted inside the differentiated function."""
    named = dataclasses.replace(scene, law="power", accuracy=1e-2)

    def stiffness(design_load: jax.Array) -> jax.Array:
        return trb.solve(dataclasses.replace(named, design_load=design_load)).stiffness[0, 0]

    h = 0.1
    slope = jax.grad(stiffness)(6500.0)
    difference = (stiffness(jnp.asarray(6500.0 + h)) - stiffness(jnp.asarray(6500.0 - h))) / (2 * h)
    assert float(slope) == pytest.approx(float(difference), rel=1e-4)


@pytest.mark.slow
def test_named_law_follows_the_load_range(scene: trb.Scene) -> None:
    """The range of the fit moves with the radial load; its derivative is carried."""
    named = dataclasses.replace(scene, law="power", accuracy=1e-2)

    def stiffness(radial: jax.Array) -> jax.Array:
        return trb.solve(dataclasses.replace(named, load=trb.Load(radial, 4500.0))).stiffness[0, 0]

    h = 0.1
    difference = (stiffness(jnp.asarray(9000.0 + h)) - stiffness(jnp.asarray(9000.0 - h))) / (2 * h)
    assert float(jax.grad(stiffness)(9000.0)) == pytest.approx(float(difference), rel=1e-4)


def test_batches_give_what_single_solves_give(scene: trb.Scene) -> None:
    lengths = jnp.array([1.0, 4.0, 9.0])
    batch = jax.vmap(lambda l: trb.solve(resized(scene, l)).loads)(lengths)
    for i, length in enumerate(lengths):
        np.testing.assert_allclose(batch[i], trb.solve(resized(scene, length)).loads, rtol=1e-11)
