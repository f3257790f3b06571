"""Stress intensity at an edge, and the energy it releases, where both are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import projected_gradient, stress_intensity, strip_rows
from difftrb.contact.gap import Cells
from difftrb.contact.halfspace import EDGE_SHIFT

pytestmark = pytest.mark.exact

MODULUS = 113794.0


def test_strip_punch() -> None:
    """p = q/(π√(a²−y²)): K = q/√(πa); its compliance 2/(πE') ln(…/a) falls by 2/(πE'a) per da, at two edges."""
    line_load, half = 250.0, 0.8
    s = np.asarray(strip_rows.graded(jnp.zeros(()), jnp.asarray(half), 48, 3.0, 2.0))
    loads = line_load / np.pi * np.diff(np.arcsin(s / half - 1.0))
    squared = stress_intensity.intensity_squared(jnp.asarray(s), jnp.asarray(loads)[:, None], jnp.asarray(0.2))
    assert float(squared[0]) == pytest.approx(line_load**2 / (np.pi * half), rel=1e-4)
    released = 2.0 * float(squared[0]) / (2.0 * MODULUS)
    assert released == pytest.approx(0.5 * line_load**2 * 2.0 / (np.pi * MODULUS * half), rel=1e-4)


def test_long_punch() -> None:
    """Solved in three dimensions: in the middle of a punch 40 long and 1 wide K is that of its line load there."""
    half, columns = 0.5, 24
    pitch = 40.0 / (columns - 2.0 * EDGE_SHIFT)
    s = strip_rows.graded(jnp.zeros(()), jnp.asarray(half), 32, 3.0, 1.0)
    lines = (half - s[::-1]).at[-1].add(EDGE_SHIFT * s[1])
    x = pitch * (jnp.arange(columns) + 0.5 - 0.5 * columns)
    cells = Cells(jnp.asarray(pitch), x, lines, True)
    force, _, residual, _ = jax.jit(projected_gradient.press)(cells, MODULUS, jnp.zeros((32, columns)), 1000.0, 1.0)
    assert residual < projected_gradient.TOLERANCE
    squared = stress_intensity.intensity_squared(s, 0.5 * force[::-1] / pitch, jnp.asarray(0.25))
    line_load = float(jnp.sum(force[:, columns // 2]) / pitch)
    assert float(squared[columns // 2]) == pytest.approx(line_load**2 / (np.pi * half), rel=2e-3)


def test_release_of_a_moved_spall(contact: trb.LineContact) -> None:
    """An offset spall by a solve of both lands; in the middle both ends are alike and as by half the roller."""
    moved = stress_intensity.edge_intensity(
        contact, 2500.0, trb.Spall(4.0, 7.0, axial_offset=1e-9), 0.0, 32, 24
    ).check()
    half = stress_intensity.edge_intensity(contact, 2500.0, trb.Spall(4.0, 7.0), 0.0, 32, 24).check()
    np.testing.assert_allclose(moved.low, moved.high, rtol=1e-5, atol=1e-6 * float(half.high.max()))
    np.testing.assert_allclose(moved.release, half.release, rtol=1e-5)
    assert float(moved.energy) == pytest.approx(float(half.energy), rel=1e-7)
