"""The roller's contact: continuum truths, symmetry and scaling laws."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import pytest

import difftrb as trb
from difftrb.accuracy import ladder
from tests import shapes

pytestmark = pytest.mark.exact


@pytest.mark.parametrize("accuracy", ["1e-3", 1.0, 1e-9, None])
def test_an_accuracy_that_is_none_is_refused(accuracy: Any) -> None:
    with pytest.raises(trb.SceneError, match=r"accuracy = .* is out of range: 1e-05 … 0.01"):
        trb.solve_contact(ladder.CONTACT, 1000.0, accuracy=accuracy)


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4])
def test_accuracy_is_kept_against_continuum_truths(accuracy: float) -> None:
    for truth in ladder.TRUTHS:
        solution = trb.solve_contact(ladder.CONTACT, truth.load, truth.spall, truth.offset, accuracy).check()
        assert float(solution.approach) == pytest.approx(truth.approach, rel=accuracy), truth


def test_spalls_at_plus_and_minus_offset_are_alike(contact: trb.LineContact) -> None:
    right, left = (trb.solve_contact(contact, 2000.0, trb.Spall(3.0, 1.0), side * 0.47) for side in (1.0, -1.0))
    assert float(right.approach) == pytest.approx(float(left.approach), rel=1e-10)
    assert jnp.allclose(right.pressure, left.pressure[:, ::-1], rtol=1e-6, atol=1e-6 * float(right.peak_pressure))


def test_spalls_at_plus_and_minus_axial_offset_are_alike(contact: trb.LineContact) -> None:
    up, down = (trb.solve_contact(contact, 2000.0, trb.Spall(3.0, 7.0, axial_offset=a)) for a in (1.5, -1.5))
    assert float(up.approach) == pytest.approx(float(down.approach), rel=1e-10)


def test_half_the_roller_gives_what_the_whole_gives(contact: trb.LineContact) -> None:
    half = trb.solve_contact(contact, 2000.0, trb.Spall(3.0, 7.0), accuracy=1e-2)
    whole = trb.solve_contact(contact, 2000.0, trb.Spall(3.0, 7.0, axial_offset=1e-9), accuracy=1e-2)
    shapes.check(whole)
    assert whole.force.shape[0] == 2 * half.force.shape[0]
    assert float(whole.approach) == pytest.approx(float(half.approach), rel=2e-3)


@pytest.mark.parametrize("spall", [None, trb.Spall(3.0, 1.0)])
def test_approach_scales_with_size_and_modulus(contact: trb.LineContact, spall: trb.Spall | None) -> None:
    base = trb.solve_contact(contact, 2000.0, spall, 0.47)
    k = 3.0
    larger = trb.LineContact(k * contact.radius, k * contact.length, contact.modulus, k * k * contact.design_load)
    grown = spall and dataclasses.replace(spall, length=k * spall.length, width=k * spall.width, depth=k * spall.depth)
    scaled = trb.solve_contact(larger, k * k * 2000.0, grown, k * 0.47)
    assert float(scaled.approach) == pytest.approx(k * float(base.approach), rel=1e-10)
    stiffer = dataclasses.replace(contact, modulus=k * contact.modulus, design_load=k * contact.design_load)
    again = trb.solve_contact(stiffer, k * 2000.0, spall, 0.47)
    assert float(again.approach) == pytest.approx(float(base.approach), rel=1e-10)


def test_spall_far_from_the_contact_changes_nothing(contact: trb.LineContact) -> None:
    healthy = trb.solve_contact(contact, 2000.0)
    away = trb.solve_contact(contact, 2000.0, trb.Spall(3.0, 1.0), 2.0)
    assert float(away.approach) == pytest.approx(float(healthy.approach), rel=5e-4)


def test_approach_grows_with_load_length_and_depth(contact: trb.LineContact) -> None:
    def approach(load=2000.0, **size) -> float:
        spall = trb.Spall(**({"length": 3.0, "width": 7.0, "depth": 0.2} | size))
        return float(trb.solve_contact(contact, load, spall).approach)

    assert approach(load=1900.0) < approach() < approach(load=2100.0)
    assert approach(length=2.5) < approach() < approach(length=3.5)
    assert approach(depth=0.001) < approach(depth=0.003) < approach()


def test_a_very_shallow_spall_is_no_spall(contact: trb.LineContact) -> None:
    healthy = float(trb.solve_contact(contact, 2000.0).approach)
    assert float(trb.solve_contact(contact, 2000.0, trb.Spall(3.0, 7.0, 1e-6)).approach) == pytest.approx(
        healthy, rel=5e-4
    )


def test_pressure_is_zero_over_a_deep_spall(contact: trb.LineContact) -> None:
    """Liu et al. 2018, Fig. 12: the roller never touches the bottom of a 0.2 mm spall."""
    s = trb.solve_contact(contact, 3000.0, trb.Spall(2.0, 7.0))
    over = jnp.abs(s.cells.y) < 1.0
    assert jnp.all(s.pressure[over] == 0.0)
    assert jnp.all(jnp.max(s.pressure[~over & (s.cells.y < 6.0)], axis=1) > 0.0)
