"""How JAX is set up, and how it compiles what this package computes.

JAX is imported by the functions that need it: `set_up_jax` has to come before.
"""

from __future__ import annotations

import functools
import gc
import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])

OPTIONS: dict[str, Any] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": 1,
    "xla_cpu_experimental_ynn_fusion_type": "",
}
"""What helps where it is known. CPU seconds to compile strips, strips' slopes, cells, cells' slopes at 1e-3:

jax 0.10.1: neither 6.0, 17.5, 3.8, 9.9; older emitters 3.4, 9.3, 2.5, 6.0; and level 1 2.9, 8.5, 1.9, 4.7.
jax 0.12.0: neither 7.6, 12.0, 3.2, 8.1; level 1 5.5, 12.0, 3.3, 7.2. There are no older emitters from jax 0.11 on.

Programs run as fast with these two as without. The last keeps sums over rollers out of the library YNNPACK, for which
jax 0.11 cuts loops apart: a ring by the table with slopes takes 11 … 13 µs there without it and 40 with it (jax issue
37465). JAX takes options at the outermost `jit` only.
"""


def set_up_jax(cache: bool) -> None:
    """For a command's process: float64, no noise from XLA and, if asked, compiled programs kept in the user's cache
    folder."""
    # XLA reports its own tuning hints as missing processor features whenever it loads a kept program
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_traceback_in_locations_limit", 0)  # where a line of a program comes from, which nobody reads
    gc.set_threshold(50_000, 20, 100)  # tracing makes many objects: looking through them takes a tenth of the time
    if cache:
        from difftrb.core.user_cache import keep_compiled

        keep_compiled()


def compiler_options() -> dict[str, Any]:
    """What JAX is told when it compiles this package's programs, for programs of one's own that solve scenes.

    `jax.jit(f, compiler_options=difftrb.compiler_options())` compiles sooner, a scene's gradient in 8 s of processors
    for 24 with jax 0.10, with numbers that differ by rounding alone. JAX takes options at the outermost `jit` only, and
    this package cannot set them there. The names are XLA's, for CPUs; those that the installed XLA does not know are
    left out.
    """
    return dict(quick())


@functools.cache
def quick() -> dict[str, Any]:
    """Those of `OPTIONS` that the installed XLA takes; it refuses a program with an option that it does not know."""
    return {name: value for name, value in OPTIONS.items() if _taken(name, value)}


def _taken(name: str, value: Any) -> bool:
    """Whether a trivial program compiles with the option."""
    import jax

    try:
        jax.jit(lambda: 0.0).lower().compile(compiler_options={name: value})
    except jax.errors.JaxRuntimeError:
        return False
    return True


def jit_quickly(static_argnames: tuple[str, ...] = (), within: bool = False) -> Callable[[F], F]:
    """As `jax.jit`, compiled with `quick` options where it is the outermost, and traced once for all processes where
    programs are kept: those that are asked for `within` other programs, too. There, and for what is traced, JAX takes
    no options. They are probed at the first call, so that an import starts no backend. Like a jitted function's, its
    programs are forgotten by `clear_cache()`."""

    def decorate(function: F) -> F:
        @functools.cache
        def compiled(outermost: bool) -> Any:
            import jax

            return jax.jit(function, compiler_options=quick() if outermost else None, static_argnames=static_argnames)

        @functools.cache
        def kept() -> Any:
            from difftrb.core.traced_programs import Kept

            return Kept(function, quick(), static_argnames)

        @functools.wraps(function)
        def call(*a: Any, **k: Any) -> Any:
            from difftrb.core import arrays as xp
            from difftrb.core.user_cache import folder

            own = folder()
            if xp.are_numbers((a, k)):
                try:
                    run = kept().call(own, a, k) if own else None
                    return run() if run else compiled(True)(*a, **k)
                except ValueError as error:  # a program around it, of which nothing is given here
                    if "compiler_options" not in str(error):
                        raise
            elif own and within and (run := kept().within(own, a, k)):
                return run()
            return compiled(False)(*a, **k)

        def clear_cache() -> None:
            for each in (compiled(True), compiled(False), kept()):
                each.clear_cache()

        call.clear_cache = clear_cache  # type: ignore[attr-defined]
        return cast(F, call)

    return decorate
