"""Derivatives of the line load's approach: reverse, forward and by differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.geometry import LineContact, Spall

SOUND = jnp.array([1800.0, 4.1, 3.623, 13.66, 113794.5, 3000.0])


def approach(v: jax.Array, spalled: bool) -> jax.Array:
    """By load, spall length, radius, roller length, modulus and design load."""
    spall = Spall(v[1], 7.0, 0.2, 0.0, 0.0) if spalled else None
    return trb.line_contact(LineContact(v[2], v[3], v[4], v[5]), v[0], spall).approach


@pytest.mark.parametrize("spalled", [True, False])
def test_gradient_matches_central_differences(spalled: bool) -> None:
    value = jax.jit(lambda v: approach(v, spalled))
    reverse, forward = jax.jit(lambda v: (jax.grad(approach)(v, spalled), jax.jacfwd(approach)(v, spalled)))(SOUND)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-18)
    for i in range(6):
        h = 3e-5 * SOUND[i]
        difference = float((value(SOUND.at[i].add(h)) - value(SOUND.at[i].add(-h))) / (2.0 * h))
        size = 1e-6 * float(value(SOUND) / SOUND[i])
        assert float(reverse[i]) == pytest.approx(difference, rel=1e-6, abs=size)


def test_slope_by_length_follows_the_strips(contact: trb.LineContact) -> None:
    full = trb.approach_slopes(contact, 2000.0, trb.Spall(4.0, 7.0), 0.0, 1e-4, "strips")["length"]
    found = jax.grad(lambda length: trb.line_contact(contact, 2000.0, Spall(length, 7.0)).approach)(4.0)
    assert full is not None
    assert float(found) == pytest.approx(float(full), rel=5e-3)
