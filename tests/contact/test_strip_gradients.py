"""Derivatives of the strips: against differences, zero where nothing is touched, smooth where an edge moves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.contact import solver as contacts
from difftrb.contact.contact_solution import Inputs
from difftrb.core.geometry import LineContact, Spall

pytestmark = pytest.mark.gradient

NAMES = ("load", "length", "width", "offset", "radius", "roller_length", "modulus", "design_load")
POINTS = {
    "no edge in reach": (2900.0, 4.1, 7.0, 0.1),
    "edge in the contact": (2900.0, 2.1, 1.0, 0.47),
}


def approach(v: jax.Array, edges: int) -> jax.Array:
    contact = LineContact(v[4], v[5], v[6], v[7])
    return contacts._by_strips(
        Inputs(contact, v[0], Spall(v[1], v[2], 0.2, 0.0, 0.0), v[3]), True, edges, 1e-2
    ).approach


value = jax.jit(approach, static_argnums=1)
slopes = jax.jit(jax.grad(approach), static_argnums=1)


@pytest.mark.parametrize("point", POINTS)
def test_gradient_matches_central_differences(point: str) -> None:
    """Of fourth order over 1e-3: shorter steps meet the rounding of the rows' integrals, 1e-10 of the approach."""
    edges = 0 if point == "no edge in reach" else 2
    at = jnp.array([*POINTS[point], 3.623, 13.66, 113794.5, 3000.0])
    found = slopes(at, edges)
    for i, name in enumerate(NAMES):
        h = 1e-3 * float(at[i])
        one, two = (float(value(at.at[i].add(k * h), edges) - value(at.at[i].add(-k * h), edges)) for k in (1, 2))
        difference = (8.0 * one - two) / (12.0 * h)
        scale = 1e-6 * float(value(at, edges)) / float(at[i])  # what a derivative of the size of the value would be
        assert float(found[i]) == pytest.approx(difference, rel=1e-6, abs=scale), name


def test_forward_and_reverse_agree() -> None:
    at = jnp.array([*POINTS["edge in the contact"], 3.623, 13.66, 113794.5, 3000.0])
    forward = jax.jit(jax.jacfwd(approach), static_argnums=1)(at, 2)
    np.testing.assert_allclose(forward, slopes(at, 2), rtol=1e-6)


@pytest.mark.parametrize("edges", [0, 1, 2])
def test_edges_out_of_the_contact_do_not_matter(edges: int) -> None:
    at = jnp.array([2900.0, 4.1, 1.0, 0.0, 3.623, 13.66, 113794.5, 3000.0])
    found = dict(zip(NAMES, slopes(at, edges), strict=True))
    assert float(found["width"]) == 0.0
    assert float(found["offset"]) == 0.0


def test_slopes_do_not_ripple_as_an_edge_moves() -> None:
    """Slopes by offset and width follow a cubic within 3e-3 over a tenth of a half-width, by length within 1e-3."""
    at = jnp.array([*POINTS["edge in the contact"], 3.623, 13.66, 113794.5, 3000.0])
    for index, reach, share in ((3, 0.01, 3e-3), (2, 0.02, 3e-3), (1, 0.02, 1e-3)):
        steps = np.linspace(-reach, reach, 9)
        edges = 0 if index == 1 else 2
        found = np.array([float(slopes(at.at[index].add(s), edges)[index]) for s in steps])
        curve = np.polyval(np.polyfit(steps, found, 3), steps)
        assert np.ptp(found - curve) < share * abs(found.mean())
