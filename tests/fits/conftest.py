"""Programs of fits run thousands of times: here they are compiled as for users."""

from collections.abc import Iterator

import pytest

from difftrb.core import jax_config


@pytest.fixture(scope="module", autouse=True)
def _as_for_users() -> Iterator[None]:
    patch = pytest.MonkeyPatch()
    patch.setitem(jax_config.OPTIONS, "xla_backend_optimization_level", 1)
    patch.setitem(jax_config.OPTIONS, "xla_llvm_disable_expensive_passes", False)
    jax_config.quick.cache_clear()
    yield
    patch.undo()
    jax_config.quick.cache_clear()
