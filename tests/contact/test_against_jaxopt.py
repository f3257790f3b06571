"""An independent solver on the same contact: jaxopt's projected gradient on the simplex."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import cell_solve, contact_cells, halfspace
from difftrb.contact.contact_solution import Inputs

pytestmark = pytest.mark.exact

jaxopt = pytest.importorskip("jaxopt")


@pytest.mark.slow
@pytest.mark.parametrize(("spall", "offset"), [(None, 0.0), (trb.Spall(3.0, 1.0), 0.46)])
def test_jaxopt_finds_the_same_approach_and_forces(contact: trb.LineContact, spall, offset: float) -> None:
    load = 2000.0
    s = cell_solve.solve(
        Inputs(contact, jnp.asarray(load), spall, jnp.asarray(offset)), contact_cells.Resolution(12, 8, 4), True, 1e-2
    )  # fmt: skip
    W = jax.jit(halfspace.influence)(s.cells, jnp.asarray(contact.modulus))
    W = jax.tree.map(lambda m: m * (load / s.approach), W)
    gap = s.gap / s.approach

    def energy(f: jax.Array) -> jax.Array:
        f = f.reshape(gap.shape)
        return jnp.vdot(f, 0.5 * W.displacement(f) + gap)

    columns = jnp.eye(gap.size).reshape(-1, *gap.shape)
    matrix = jax.jit(jax.vmap(lambda e: W.displacement(e)))(columns).reshape(gap.size, -1)
    step = 1.0 / float(jnp.linalg.eigvalsh(matrix)[-1])
    solver = jaxopt.ProjectedGradient(
        energy, jaxopt.projection.projection_simplex, stepsize=step, maxiter=4000, tol=1e-9, implicit_diff=False
    )
    force = solver.run(jnp.full(gap.size, 1.0 / gap.size)).params.reshape(gap.shape)
    displaced = W.displacement(force) + gap
    assert float(jnp.vdot(force, displaced)) == pytest.approx(1.0, rel=1e-6)
    np.testing.assert_allclose(load * force, s.force, atol=1e-4 * float(s.force.max()))
