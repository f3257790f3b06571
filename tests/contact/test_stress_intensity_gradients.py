"""Derivatives of the stress intensity's integral and of the energy: reverse, forward and by differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core.geometry import LineContact, Spall

pytestmark = pytest.mark.gradient


def energies(v: jax.Array) -> jax.Array:
    """Release of both ends and energy, by load, length, radius, roller length, modulus and design load."""
    contact = LineContact(v[2], v[3], v[4], v[5])
    found = trb.edge_intensity(contact, v[0], Spall(v[1], 7.0, 0.2, 0.0, 0.0), 0.0, 32, 16)
    return jnp.stack([found.release.sum(), found.energy])


@pytest.mark.slow
def test_gradients_match_central_differences() -> None:
    at = jnp.array([2500.0, 4.0, 3.623, 13.66, 113794.5, 3000.0])
    value = jax.jit(energies)
    reverse, forward = jax.jit(lambda v: (jax.jacrev(energies)(v), jax.jacfwd(energies)(v)))(at)
    np.testing.assert_allclose(reverse, forward, rtol=1e-6)
    for i in range(6):
        h = 3e-4 * at[i]  # below, rounding: 1.6e-5 of the difference on some machines
        difference = (value(at.at[i].add(h)) - value(at.at[i].add(-h))) / (2.0 * h)
        for found, expected, size in zip(reverse[:, i], difference, value(at) / at[i], strict=True):
            assert float(found) == pytest.approx(float(expected), rel=1e-5, abs=1e-5 * abs(float(size)))
