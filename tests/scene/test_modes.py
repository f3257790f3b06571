"""Other precisions and other ways to run: refused, or right."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb

pytestmark = pytest.mark.hard


def scene_in(kind) -> trb.Scene:
    """The main scene with its load, spall and phase in one kind of number."""
    bearing = trb.bearing("32008J")
    spall = trb.Spall(kind(4.0), kind(7.0), kind(1.0), kind(0.0), kind(0.0))
    return trb.Scene(bearing, trb.Load(kind(9000.0), kind(4500.0)), (spall,), law="liu2018", phase=kind(0.125))


@pytest.mark.parametrize("kind", [np.float32, jnp.float32, np.float64, jnp.float64, np.int64, jnp.int32])
def test_mixed_precision_is_computed_in_float64(kind) -> None:
    """Numbers that float32 holds exactly give what they give in float64."""
    exact = scene_in(lambda v: float(kind(v)))
    there = trb.solve(scene_in(kind)).check()
    assert there.loads.dtype == jnp.float64
    np.testing.assert_allclose(there.loads, trb.solve(exact).check().loads, rtol=1e-12)


@pytest.mark.parametrize("kind", [np.float32, jnp.float32, np.int64])
def test_contacts_of_mixed_precision_are_computed_in_float64(contact: trb.LineContact, kind) -> None:
    def solved(kind) -> trb.ContactSolution:
        spall = trb.Spall(kind(2.0), kind(8.0), kind(1.0))
        return trb.solve_contact(contact, kind(3000.0), spall, kind(0.0), 1e-2, "cells").check()

    there = solved(kind)
    assert there.force.dtype == jnp.float64
    assert float(there.approach) == pytest.approx(float(solved(float).approach), rel=1e-12)


def test_debug_nans_finds_nothing(bearing: trb.TaperedBearing, contact: trb.LineContact) -> None:
    """A scene with idle rollers, and a contact with an edge in it: no NaN comes up that is thrown away later."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 2500.0), (trb.Spall(4.0, 7.0),), law="liu2018")
    with jax.debug_nans(True):
        r = trb.solve(scene).check()
        slopes = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene)
        s = trb.solve_contact(contact, 3000.0, trb.Spall(2.0, 8.0), 0.0, 1e-2, "cells").check()
    assert int(jnp.sum(r.loads == 0.0)) > 5
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(slopes))
    assert float(s.approach) > 0.0


@pytest.mark.portable
def test_jit_and_vmap_of_scenes_change_nothing(bearing: trb.TaperedBearing) -> None:
    """Alone, compiled, and in a batch beside one that is not a number and one without equilibrium."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="liu2018")

    def loads(axial):
        return trb.solve(dataclasses.replace(scene, load=trb.Load(9000.0, axial))).loads

    alone = trb.solve(scene).loads
    np.testing.assert_allclose(jax.jit(loads)(4500.0), alone, rtol=1e-13)
    batch = jax.vmap(loads)(jnp.array([jnp.nan, 4500.0, 10.0]))
    np.testing.assert_allclose(batch[1], alone, rtol=1e-13)
    assert np.isnan(np.asarray(batch)[[0, 2]]).all()


def test_spalls_that_merge_are_one(contact: trb.LineContact) -> None:
    """Two halves that meet, two that overlap, and the same one twice, as one spall by cells."""
    one = float(trb.solve_contact(contact, 3000.0, trb.Spall(4.0, 7.0), 0.0, 1e-2, "cells").check().approach)
    halves = trb.Spall(2.0, 7.0, axial_offset=-1.0), trb.Spall(2.0, 7.0, axial_offset=1.0)
    overlap = trb.Spall(3.0, 7.0, axial_offset=-0.5), trb.Spall(3.0, 7.0, axial_offset=0.5)
    twice = trb.Spall(4.0, 7.0, axial_offset=1e-300), trb.Spall(4.0, 7.0, axial_offset=-1e-300)
    for spalls in (halves, overlap, twice):
        s = trb.solve_contact(contact, 3000.0, spalls, 0.0, 1e-2).check()
        assert float(s.approach) == pytest.approx(one, rel=5e-3)
