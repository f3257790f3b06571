"""What JAX compiled and what this package traced, kept in the user's cache folder.

JAX itself keeps what it has compiled, but has to trace a program to find it. To read one as it was traced takes a
hundredth of the time that tracing takes. It is found by what it is traced from: the function, its static arguments, the
structure and shapes of the others, and every file of this package. What depends on code from elsewhere is not kept, for
it may change under the same name.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import io
import os
import pickle
import platform
import shutil
import time
import types
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.export
import platformdirs

LIBRARIES = ("jax", "jaxlib", "numpy", "optax")
"""Their versions are part of what a program depends on."""
KNOWN = {"difftrb", *LIBRARIES, "builtins", "collections", "copyreg", "functools", "operator"}
"""Packages whose code a program that is kept may depend on."""
OLD = 30 * 86400.0
"""Seconds after which programs of other contents of the package go, if none was added to them."""
UNTOLD = (pickle.PicklingError, AttributeError, TypeError, ValueError, RecursionError)
"""What pickle raises: code from elsewhere, or without a name; a thing that is within itself."""

_folder: list[Path] = []
"""Where traced programs are kept, if they are."""


def keep_compiled() -> Path | None:
    """Keep what JAX compiles, and what this package traces, from now on in the user's cache folder, and take from there
    what is kept.

    For programs of one's own, before the first solve: the command line does so by itself. JAX tells its releases apart,
    the folder processors. Returns the folder; None where none can be written, and nothing is kept.
    """
    folder = cache_folder()
    if folder is not None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
        _folder[:] = [folder / "traced"]
    return folder


def cache_folder() -> Path | None:
    """Where compiled programs are kept: the user's cache folder, apart for every kind of processor.

    The folder is made; None where it cannot be.
    """
    processor = platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    kind = hashlib.sha256(processor.encode()).hexdigest()[:12]
    folder = Path(platformdirs.user_cache_dir("difftrb")) / kind
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def are_kept() -> bool:
    """Whether traced programs are kept, in this process from now on."""
    return bool(_folder)


def jit_kept(function: Callable[..., Any], depends: Any, *arguments: Any) -> Callable[..., Any]:
    """`function` jitted, traced once for all processes where programs are kept: for `arguments` or their shapes. All
    that it `depends` on tells it from others."""
    found = kept(_folder[0], function, depends, arguments, {}) if _folder else None
    return found or jax.jit(function)


class Kept:
    """The programs of one function: those of this process, and by their files those of earlier ones."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any], **static: Any) -> None:
        """Arguments but the first are `jax.jit`'s: options of the compiler, which arguments are static."""
        self.function, self.options = function, options
        self.signature = inspect.signature(function)
        self.static = _names(self.signature, **static)
        self.programs: dict[Any, Callable[..., Any] | None] = {}

    def clear_cache(self) -> None:
        self.programs.clear()

    def call(self, arguments: tuple[Any, ...], named: dict[str, Any]) -> Callable[[], Any] | None:
        """The call with these arguments, ready to run; None where its program cannot be kept."""
        bound = self.signature.bind(*arguments, **named)
        static, traced = {}, {}
        for name, value in bound.arguments.items():
            (static if name in self.static else traced)[name] = value
        leaves, structure = jax.tree.flatten(traced)
        kind = (tuple(static.items()), structure, tuple(map(jax.typeof, leaves)), _context())
        if kind not in self.programs:
            own = partial(self.function, **static)
            own.__name__ = self.function.__name__  # type: ignore[attr-defined]
            self.programs[kind] = kept(_folder[0], own, (self.function, static), (), traced, self.options)
        found = self.programs[kind]
        return None if found is None else partial(found, **traced)


def kept(
    folder: Path, function: Callable[..., Any], depends: Any, arguments: Sequence[Any], named: dict[str, Any],
    options: dict[str, Any] | None = None,
) -> Callable[..., Any] | None:  # fmt: skip
    """`function`, which all that it `depends` on tells from others, jitted for such arguments or shapes: read from the
    folder, or traced and written there. None where it cannot be kept."""
    leaves, structure = jax.tree.flatten((arguments, named))
    shapes = [(leaf.shape, str(leaf.dtype), leaf.weak_type) for leaf in map(_typed, leaves)]
    try:
        told = _told((depends, structure.unflatten(range(len(leaves))), shapes, _context()))
    except UNTOLD:
        return None
    file = folder / _package() / f"{function.__name__}-{hashlib.sha256(told).hexdigest()[:32]}"
    with suppress(Exception):  # there is none, or it is broken
        exported, returned = pickle.loads(file.read_bytes())
        return _jitted(function.__name__, jax.export.deserialize(bytearray(exported)), returned, options)
    returned = []

    def of_leaves(*leaves: Any) -> list[Any]:
        arguments, named = structure.unflatten(leaves)
        result, tree = jax.tree.flatten(function(*arguments, **named))
        returned[:] = [tree.unflatten(range(len(result)))]
        return result

    try:
        exported = jax.export.export(jax.jit(of_leaves))(*leaves)
        written = pickle.dumps((bytes(exported.serialize()), returned[0]))
    except Exception:  # whatever is wrong is said where it is traced as ever
        return None
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_name(f"{file.name}.{os.getpid()}")
        part.write_bytes(written)
        part.replace(file)
        _clear_of_old(folder)
    return _jitted(function.__name__, exported, returned[0], options)


@functools.cache
def _clear_of_old(folder: Path) -> None:
    """Once in a process: every edit of the package makes a folder of its own."""
    for other in folder.iterdir():
        if other.name != _package() and time.time() - other.stat().st_mtime > OLD:
            shutil.rmtree(other, ignore_errors=True)


def _jitted(
    name: str, exported: jax.export.Exported, returned: Any, options: dict[str, Any] | None
) -> Callable[..., Any]:
    structure = jax.tree.structure(returned)

    def call(*arguments: Any, **named: Any) -> Any:
        return jax.tree.unflatten(structure, exported.call(*jax.tree.leaves((arguments, named))))

    call.__name__ = name  # by which logs call it
    return jax.jit(call, compiler_options=options)


def _typed(leaf: Any) -> Any:
    return leaf if isinstance(leaf, jax.ShapeDtypeStruct) else jax.typeof(leaf)


def _names(
    signature: inspect.Signature,
    static_argnums: int | tuple[int, ...] = (),
    static_argnames: str | tuple[str, ...] = (),
) -> set[str]:
    """Of the static arguments, however they are given to `jax.jit`."""
    every = list(signature.parameters)
    numbers = (static_argnums,) if isinstance(static_argnums, int) else static_argnums
    names = (static_argnames,) if isinstance(static_argnames, str) else static_argnames
    return {*names, *(every[k] for k in numbers)}


# ------------------------------------------------------------------------------------------------ what tells programs


def _context() -> tuple[Any, ...]:
    """What every program depends on besides."""
    return (*map(_version, LIBRARIES), jax.default_backend(), jax.config.read("jax_enable_x64"))


_version = functools.cache(version)


@functools.cache
def _package() -> str:
    """A name for the contents of this package's files."""
    root, contents = Path(__file__).parents[1], hashlib.sha256()
    for file in sorted(root.rglob("*")):
        if file.is_file() and "__pycache__" not in file.parts:
            contents.update(str(file.relative_to(root)).encode())
            contents.update(hashlib.sha256(file.read_bytes()).digest())
    return contents.hexdigest()[:16]


def _told(thing: Any) -> bytes:
    """The same bytes for equal things, in every process."""
    written = io.BytesIO()
    teller = _Teller(written)
    teller.fast = True  # equal parts are told twice, whether or not they are the same object
    teller.dump(thing)
    return written.getvalue()


class _Teller(pickle.Pickler):
    """Tells functions by where they are and what they close over. Refuses code of unknown packages."""

    def reducer_override(self, obj: Any) -> Any:
        if not isinstance(obj, type | types.FunctionType | types.BuiltinFunctionType):
            return NotImplemented
        if (obj.__module__ or "builtins").partition(".")[0].lstrip("_") not in KNOWN:
            raise pickle.PicklingError(f"{obj} is from elsewhere")
        if not isinstance(obj, types.FunctionType):
            return NotImplemented
        inside = [cell.cell_contents for cell in obj.__closure__ or ()] if "<" in obj.__qualname__ else []
        places = list(obj.__code__.co_positions())  # two may be in one line
        told = (obj.__module__, obj.__qualname__, places, inside, obj.__defaults__, obj.__kwdefaults__)
        return tuple, (told,)
