"""Derivatives by tilt and by each of several spalls: AD against central differences, forward against reverse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core.geometry import LineContact, Spall

pytestmark = pytest.mark.gradient

NAMES = ("load", "tilt", "length 1", "width 1", "axial 1", "offset 1", "length 2", "width 2", "axial 2", "offset 2",
         "depth 2", "radius")  # fmt: skip
POINTS = {
    # rolling edges of both in the contact; the second shallow enough to be touched
    "apart": (2900.0, 3e-4, 2.1, 1.0, 1.2, 0.47, 1.7, 0.9, -2.4, -0.44, 0.003),
    # same place and size across: their edges coincide
    "in line": (2900.0, 2e-4, 2.1, 1.0, 1.2, 0.47, 2.1, 1.0, -2.4, 0.47, 0.2),
    # the second is out of reach
    "far": (2900.0, -3e-4, 2.1, 1.0, 1.2, 0.47, 2.1, 1.0, -2.4, 3.0, 0.2),
}


@jax.jit
def approach(v: jax.Array, contact: LineContact) -> jax.Array:
    load, tilt, *sizes, radius = v
    spalls = Spall(sizes[0], sizes[1], 0.2, 0.0, sizes[2]), Spall(sizes[4], sizes[5], sizes[8], 0.0, sizes[6])
    contact = LineContact(radius, contact.length, contact.modulus, contact.design_load)
    return trb.solve_contact(contact, load, spalls, (sizes[3], sizes[7]), 1e-2, tilt=tilt).approach


gradient = jax.jit(jax.grad(approach))


@pytest.mark.slow
@pytest.mark.parametrize("point", POINTS)
def test_gradient_matches_central_differences(point: str, contact: LineContact) -> None:
    at = jnp.array([*POINTS[point], float(contact.radius)])
    slopes, delta = gradient(at, contact), float(approach(at, contact))
    for i, name in enumerate(NAMES):
        size = max(abs(float(at[i])), 1e-3 if name == "tilt" else 0.01)
        step = 2e-6 * size  # two lines a fiftieth of a column apart: derivatives bend soon
        one, two = (
            float(approach(at.at[i].add(k * step), contact) - approach(at.at[i].add(-k * step), contact))
            for k in (1, 2)
        )
        difference = (8.0 * one - two) / (12.0 * step)
        assert float(slopes[i]) == pytest.approx(difference, rel=1e-6, abs=1e-8 * delta / size), name
    if point == "far":
        assert not slopes[jnp.array([6, 7, 9, 10])].any()  # exactly
    if point == "in line":
        assert float(slopes[2]) > 0.0
        assert float(slopes[6]) == pytest.approx(float(slopes[2]), rel=0.5)  # of the same size, at another place


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "shares"), [(0.0, (0.5, 0.5)), (0.03, (0.65, 0.35)), (-0.1, (0.05, 0.95))])
def test_spalls_that_touch_share_their_end(joint: float, shares: tuple[float, float], contact: LineContact) -> None:
    """Of two as long side by side the first had all of the derivative by length, its lines being a hair apart. Shares
    are by differences over ± 0.1 mm, half-way between the derivatives on either side."""
    at = jnp.array([1309.0, 0.0, 4.0, 5.0, 0.0, joint - 2.5, 4.0, 5.0, 0.0, joint + 2.5, 0.2, float(contact.radius)])
    slopes = gradient(at, contact)
    own, whole = slopes[jnp.array([2, 6])], slopes[2] + slopes[6]
    np.testing.assert_allclose(own / whole, shares, atol=0.06)
    longer, shorter = (approach(at.at[jnp.array([2, 6])].add(side * 0.1), contact) for side in (1.0, -1.0))
    assert float(whole) == pytest.approx(float(longer - shorter) / 0.2, rel=0.03)


def test_a_bottom_takes_no_share_of_an_end(contact: LineContact) -> None:
    """Beside a deep spall one that is hardly there ends at the same place."""
    both = [5.0, 0.0, -2.5, 4.0, 5.0, 0.0, 2.5]
    at = jnp.array([1309.0, 0.0, 4.0, *both, 1e-5, float(contact.radius)])
    slopes = gradient(at, contact)
    assert abs(float(slopes[6])) < 0.02 * float(slopes[2])


@pytest.mark.slow
def test_forward_and_reverse_agree(contact: LineContact) -> None:
    at = jnp.array([*POINTS["apart"], float(contact.radius)])
    forward = jax.jacfwd(approach)(at, contact)
    np.testing.assert_allclose(forward, gradient(at, contact), rtol=1e-8, atol=1e-15)
