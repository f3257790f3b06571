"""Random pairs of spalls under tilted rollers: edges in each other's way or over the end, touched bottoms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import projected_gradient
from difftrb.contact.solver import approach_and_gradient
from difftrb.core import status

pytestmark = pytest.mark.hard

LENGTH = 13.66
NAMES = ("load", "tilt", "design_load", "length 1", "width 1", "depth 1", "axial 1", "offset 1", "length 2", "width 2",
         "depth 2", "axial 2", "offset 2")  # fmt: skip


def cases(count: int) -> jax.Array:
    rng = np.random.default_rng(7)
    spalls = []
    for _ in range(2):
        width = 10 ** rng.uniform(-1.0, 1.0, count)
        spalls += [rng.uniform(0.05, LENGTH, count), width, 10 ** rng.uniform(-4, 0, count),
                   np.where(rng.random(count) < 0.5, 0.0, rng.uniform(-8, 8, count)),
                   rng.uniform(-1, 1, count) * (width / 2 + 0.2)]  # fmt: skip
    tilt = np.where(rng.random(count) < 0.3, 0.0, rng.uniform(-3e-3, 3e-3, count))
    crown = np.where(rng.random(count) < 0.2, 0.0, 10 ** rng.uniform(1, 5, count))
    return jnp.asarray(np.stack([10 ** rng.uniform(0, 5, count), tilt, crown, *spalls], axis=1))


@pytest.mark.slow
def test_random_pairs_converge_with_finite_gradients(contact: trb.LineContact) -> None:
    def solved(v: jax.Array):
        spalls = trb.Spall(v[3], v[4], v[5], 0.0, v[6]), trb.Spall(v[8], v[9], v[10], 0.0, v[11])
        here = trb.LineContact(contact.radius, LENGTH, contact.modulus, v[2])
        s = trb.solve_contact(here, v[0], spalls, jnp.stack([v[7], v[12]]), 1e-2, tilt=v[1])
        return s.approach, (s.status_code, s.residual, jnp.sum(s.force) / v[0])

    batch = jax.jit(lambda c: jax.lax.map(jax.value_and_grad(solved, has_aux=True), c))
    (_, (codes, residual, total)), slopes = batch(cases(24))
    codes, slopes = np.asarray(codes), np.asarray(slopes)
    assert set(codes) <= {status.CONVERGED, status.UNRESOLVED}, [status.SENTENCES[c] for c in set(codes)]
    good = codes == status.CONVERGED
    assert good.mean() > 0.8  # the rest are narrower than a cell, and say so
    assert float(residual.max()) <= projected_gradient.TOLERANCE
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)
    assert np.isfinite(slopes).all()
    assert (slopes[good, 0] > 0.0).all()


@pytest.mark.slow
def test_a_batch_is_what_its_members_are(contact: trb.LineContact) -> None:
    spalls = trb.Spall(2.0, 1.0, axial_offset=1.0), trb.Spall(3.0, 0.8, axial_offset=-2.0)

    def approach(offset: jax.Array) -> jax.Array:
        return trb.solve_contact(contact, 2000.0, spalls, (offset, -0.3), 1e-2, "cells").approach

    offsets = jnp.array([0.4, 0.55])
    together = jax.jit(jax.vmap(approach))(offsets)
    np.testing.assert_allclose(together, [approach(o) for o in offsets], rtol=1e-10)


@pytest.mark.parametrize(
    ("load", "first", "offset"),
    [
        (np.nan, trb.Spall(3.0, 7.0), 2.0),
        (0.0, trb.Spall(3.0, 7.0), 2.0),
        (-5.0, trb.Spall(3.0, 7.0), 2.0),
        (np.inf, trb.Spall(3.0, 7.0), 2.0),
        (1000.0, trb.Spall(3.0, np.nan), 2.0),
        (1000.0, trb.Spall(np.nan, 7.0), 2.0),
        (1000.0, trb.Spall(3.0, 7.0, axial_offset=np.inf), 2.0),
        (1000.0, trb.Spall(3.0, 7.0), np.nan),
    ],
)
def test_numbers_that_are_none_have_a_status(
    contact: trb.LineContact, load: float, first: trb.Spall, offset: float
) -> None:
    """Rows and lines are counted by numbers, which were no indices here."""
    spalls = (first, trb.Spall(2.0, 5.0, axial_offset=3.0))
    solution, _ = approach_and_gradient(contact, load, spalls, offset, 1e-2)
    assert int(solution.status_code) == status.BAD_INPUT
