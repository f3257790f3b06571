"""The JAX that is installed computes this package's kind of expression correctly and takes its compile options."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import jax_config

pytestmark = pytest.mark.hard


@pytest.mark.portable
def test_batched_small_matrix_products() -> None:
    """jax 0.10.2 (issue 39103) is silently wrong here by up to 400 %: a bearing sweep is just this expression."""
    rng = np.random.default_rng(0)
    M, r = rng.normal(size=(40000, 3, 3)), rng.normal(size=(40000, 3))
    got = jax.jit(jax.vmap(lambda m, v: jnp.sum((m @ v) ** 2)))(jnp.asarray(M), jnp.asarray(r))
    np.testing.assert_allclose(got, (np.einsum("nij,nj->ni", M, r) ** 2).sum(axis=1), rtol=1e-11)


@pytest.mark.portable
def test_it_is_not_the_release_that_is_wrong() -> None:
    assert jax.__version__ != "0.10.2"


@pytest.mark.portable
def test_programs_of_ones_own_take_the_packages_options() -> None:
    options = trb.compiler_options()
    assert float(jax.jit(lambda x: x + 1.0, compiler_options=options)(1.0)) == 2.0
    options.clear()  # one's own
    assert trb.compiler_options() == jax_config.quick() != {}


@pytest.mark.portable
def test_options_that_xla_does_not_know_are_left_out(monkeypatch) -> None:
    """As on jax 0.11 and later, which have no older emitters."""
    known = {"xla_backend_optimization_level": 1}
    monkeypatch.setattr(jax_config, "OPTIONS", {"xla_no_such_option": False} | known)
    jax_config.quick.cache_clear()
    try:
        with pytest.raises(jax.errors.JaxRuntimeError, match="No such compile option"):
            jax.jit(lambda: 0.0, compiler_options=jax_config.OPTIONS)()
        double = jax_config.jit_quickly(static_argnames=("times",))(lambda x, times: times * x)
        assert float(double(2.0, times=3.0)) == 6.0
        assert jax_config.quick() == known
    finally:
        jax_config.quick.cache_clear()
