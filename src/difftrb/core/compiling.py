"""`jax.jit` for large programs, with the compile options that shorten their compilation, where XLA knows them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import jax

F = TypeVar("F", bound=Callable[..., Any])

OPTIONS: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}
"""What helps where it is known. CPU seconds to compile strips, strips' slopes, cells, cells' slopes at 1e-3:

jax 0.10.1: neither 6.0, 17.5, 3.8, 9.9; older emitters 3.4, 9.3, 2.5, 6.0; and level 1 2.9, 8.5, 1.9, 4.7.
jax 0.12.0: neither 7.6, 12.0, 3.2, 8.1; level 1 5.5, 12.0, 3.3, 7.2. There are no older emitters from jax 0.11 on.

Programs run as fast with them as without. JAX takes options at the outermost `jit` only.
"""


@functools.cache
def quick() -> dict[str, Any]:
    """Those of `OPTIONS` that the installed XLA takes; it refuses a program with an option that it does not know."""
    return {name: value for name, value in OPTIONS.items() if _taken(name, value)}


def _taken(name: str, value: Any) -> bool:
    """Whether a trivial program compiles with the option."""
    try:
        jax.jit(lambda: 0.0).lower().compile(compiler_options={name: value})
    except jax.errors.JaxRuntimeError:
        return False
    return True


def jit_quickly(**arguments: Any) -> Callable[[F], F]:
    """As `partial(jax.jit, **arguments)`, compiled with `quick` options. They are probed at the first call, so that an
    import starts no backend. Like a jitted function's, its programs are forgotten by `clear_cache()`."""

    def decorate(function: F) -> F:
        @functools.cache
        def compiled() -> Callable[..., Any]:
            return jax.jit(function, compiler_options=quick(), **arguments)

        @functools.wraps(function)
        def call(*a: Any, **k: Any) -> Any:
            return compiled()(*a, **k)

        call.clear_cache = lambda: compiled().clear_cache()  # type: ignore[attr-defined]
        return cast(F, call)

    return decorate
