"""Programs as JAX traced them, kept in a folder: to read one takes a hundredth of the time that tracing it takes. Those
of a scene go into programs of users, too: that of its gradient is ready in 1.6 s where it was in 3.9.

JAX itself keeps what it has compiled, but has to trace a program to find it. Here one is found by what it is traced
from: the function, its static arguments, and the structure and shapes of the others.
"""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.core
import jax.export
from jax.interpreters import partial_eval

from difftrb.core import implicit
from difftrb.core.user_cache import folder, place, write


def jit_kept(
    function: Callable[..., Any], depends: Any, options: dict[str, Any], *arguments: Any
) -> Callable[..., Any]:
    """`function` jitted with the compiler's `options`, traced once for all processes where programs are kept: for
    `arguments` or their shapes. All that it `depends` on tells it from others."""
    own = folder()
    found = None if own is None else kept(own, function, depends, arguments, {})
    return jax.jit(found or function, compiler_options=options)


class Program(NamedTuple):
    """A kept program as a function, to be part of others, and jitted."""

    function: Callable[..., Any]
    jitted: Callable[..., Any]


class Kept:
    """The programs of one function: those of this process, and by their files those of earlier ones."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any], static_argnames: Sequence[str]) -> None:
        """Arguments but the first are `jax.jit`'s: options of the compiler, which arguments are static."""
        self.function, self.options = function, options
        self.signature = inspect.signature(function)
        self.static = static_argnames
        self.programs: dict[Any, Program | None] = {}

    def clear_cache(self) -> None:
        self.programs.clear()

    def call(self, folder: Path, arguments: tuple[Any, ...], named: dict[str, Any]) -> Callable[[], Any] | None:
        """The call with these arguments, ready to run; None where its program cannot be kept."""
        found, _, traced = self._found(folder, arguments, named)
        return None if found is None else partial(found.jitted, **traced)

    def within(self, folder: Path, arguments: tuple[Any, ...], named: dict[str, Any]) -> Callable[[], Any] | None:
        """The same in a program around it that is being traced, into which the kept one goes as it is. None also where
        it would be differentiated or mapped at once."""
        if not all(map(_is_only_traced, jax.tree.leaves((arguments, named)))):
            return None
        found, static, traced = self._found(folder, arguments, named)
        if found is None:
            return None
        return partial(
            implicit.standing_in, lambda a: found.function(**a), lambda a: self.function(**static, **a), traced
        )

    def _found(
        self, folder: Path, arguments: tuple[Any, ...], named: dict[str, Any]
    ) -> tuple[Program | None, dict, dict]:
        """The program for these arguments, None if it cannot be kept; those that are static, and the others."""
        bound = self.signature.bind(*arguments, **named)
        bound.apply_defaults()
        static, traced = {}, {}
        for name, value in bound.arguments.items():
            (static if name in self.static else traced)[name] = value
        leaves, structure = jax.tree.flatten(traced)
        kind = (tuple(static.items()), structure, tuple(map(jax.typeof, leaves)), _context())
        if kind not in self.programs:
            own = partial(self.function, **static)
            own.__name__ = self.function.__name__  # type: ignore[attr-defined]
            one = kept(folder, own, (self.function, static), (), traced)
            self.programs[kind] = one and Program(one, jax.jit(one, compiler_options=self.options))
        return self.programs[kind], static, traced


def _is_only_traced(leaf: Any) -> bool:
    """Whether it goes into a program as it is: neither mapped nor differentiated on the way."""
    return isinstance(leaf, partial_eval.DynamicJaxprTracer) or not isinstance(leaf, jax.core.Tracer)


def kept(
    folder: Path, function: Callable[..., Any], depends: Any, arguments: Sequence[Any], named: dict[str, Any]
) -> Callable[..., Any] | None:
    """`function`, which all that it `depends` on tells from others, for such arguments or shapes: read from the folder,
    or traced and written there. None where it cannot be kept."""
    leaves, structure = jax.tree.flatten((arguments, named))
    types = [leaf if isinstance(leaf, jax.ShapeDtypeStruct) else _type_of(leaf) for leaf in leaves]
    shapes = [(leaf.shape, str(leaf.dtype), leaf.weak_type) for leaf in types]
    file = place(folder, function.__name__, (depends, structure.unflatten(range(len(leaves))), shapes, _context()))
    if file is None:
        return None
    with suppress(Exception):  # there is none, or it is broken
        exported, returned = pickle.loads(file.read_bytes())
        return _called(function.__name__, jax.export.deserialize(bytearray(exported)), returned)
    returned = []

    def of_leaves(*leaves: Any) -> list[Any]:
        arguments, named = structure.unflatten(leaves)
        result, tree = jax.tree.flatten(function(*arguments, **named))
        returned[:] = [tree.unflatten(range(len(result)))]
        return result

    try:
        exported = jax.export.export(jax.jit(of_leaves))(*types)
        written = pickle.dumps((bytes(exported.serialize()), returned[0]))
    except Exception:  # whatever is wrong is said where it is traced as ever
        return None
    write(file, written)
    return _called(function.__name__, exported, returned[0])


def _type_of(leaf: Any) -> jax.ShapeDtypeStruct:
    """Of an argument that may be traced by a program around."""
    of = jax.typeof(leaf)
    return jax.ShapeDtypeStruct(of.shape, of.dtype, weak_type=of.weak_type)


def _called(name: str, exported: jax.export.Exported, returned: Any) -> Callable[..., Any]:
    structure = jax.tree.structure(returned)

    def call(*arguments: Any, **named: Any) -> Any:
        return jax.tree.unflatten(structure, exported.call(*jax.tree.leaves((arguments, named))))

    call.__name__ = name  # by which logs call it
    return call


def _context() -> tuple[str, bool]:
    """What every program depends on besides."""
    return jax.default_backend(), bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]
