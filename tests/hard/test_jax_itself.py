"""The JAX that is installed computes this package's kind of expression correctly."""

import jax
import jax.numpy as jnp
import numpy as np


def test_batched_small_matrix_products() -> None:
    """jax 0.10.2 (issue 39103) is silently wrong here by up to 400 %: a bearing sweep is just this expression."""
    rng = np.random.default_rng(0)
    M, r = rng.normal(size=(40000, 3, 3)), rng.normal(size=(40000, 3))
    got = jax.jit(jax.vmap(lambda m, v: jnp.sum((m @ v) ** 2)))(jnp.asarray(M), jnp.asarray(r))
    np.testing.assert_allclose(got, (np.einsum("nij,nj->ni", M, r) ** 2).sum(axis=1), rtol=1e-11)


def test_it_is_not_the_release_that_is_wrong() -> None:
    assert jax.__version__ != "0.10.2"
