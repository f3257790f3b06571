"""What is kept between processes, in the user's cache folder: where that is, and by what a thing in it is known.

A thing is known by all that it depends on: code, arguments, versions of libraries, and every file of this package. What
depends on code from elsewhere is not kept, for it may change under the same name.
"""

from __future__ import annotations

import functools
import hashlib
import io
import os
import pickle
import platform
import shutil
import time
import types
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import jax
import platformdirs

from difftrb.core import storage

T = TypeVar("T")

LIBRARIES = ("jax", "jaxlib", "numpy", "optax")
"""Their versions are part of what everything depends on."""
KNOWN = {"difftrb", *LIBRARIES, "builtins", "collections", "copyreg", "functools", "operator"}
"""Packages whose code a thing that is kept may depend on."""
OLD = 30 * 86400.0
"""Seconds after which things of other contents of the package go, if none was added to them."""
UNTOLD = (pickle.PicklingError, AttributeError, TypeError, ValueError, RecursionError)
"""What pickle raises: code from elsewhere, or without a name; a thing that is within itself."""

_folder: list[Path] = []
"""Where things are kept, if they are."""


def keep_compiled(folder: str | Path | None = None) -> Path | None:
    """From now on keep what JAX compiles, what this package traces, and contacts solved for a law, in a folder; take
    from there what is kept.

    Args:
      folder: to keep it in. Default: the user's cache folder, which the system says (on Linux XDG_CACHE_HOME moves it).

    For programs of one's own, before the first solve: the command line does so by itself. A program around a scene,
    `jax.jit(jax.grad(f))`, then traces it once for all processes. JAX tells its releases apart, folders in `folder`
    processors. Returns the one in use; None where none can be written, and nothing is kept.
    """
    folder = cache_folder(folder)
    if folder is not None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
        _folder[:] = [folder / "kept"]
    return folder


def cache_folder(within: str | Path | None = None) -> Path | None:
    """Where all is kept: `within` a folder, or the user's cache folder, apart for every kind of processor.

    The folder is made; None where it cannot be.
    """
    processor = platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    kind = hashlib.sha256(processor.encode()).hexdigest()[:12]
    folder = Path(within or platformdirs.user_cache_dir("difftrb")) / kind
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def folder() -> Path | None:
    """Where things are kept in this process, if they are."""
    return _folder[0] if _folder else None


def result(compute: Callable[[], T], name: str, depends: Any) -> T:
    """What `compute()` returns, computed once for all processes where things are kept; found by all that it `depends`
    on."""
    file = None if (own := folder()) is None else place(own, name, depends)
    if file is None:
        return compute()
    with suppress(Exception):  # there is none, or it is broken
        return pickle.loads(file.read_bytes())
    found = compute()
    write(file, pickle.dumps(found))
    return found


def place(folder: Path, name: str, depends: Any) -> Path | None:
    """The file, called `name` and by all that it `depends` on; None where that cannot be told."""
    try:
        told = _told((depends, *map(_version, LIBRARIES)))
    except UNTOLD:
        return None
    return folder / _package() / f"{name}-{hashlib.sha256(told).hexdigest()[:32]}"


def write(file: Path, content: bytes) -> None:
    """Keep this, if it can be written."""
    with suppress(OSError):
        with storage.replacing(file) as scratch:
            scratch.write_bytes(content)
        _clear_of_old(file.parents[1])


@functools.cache
def _clear_of_old(folder: Path) -> None:
    """Once in a process: every edit of the package makes a folder of its own."""
    for other in folder.iterdir():
        if other.name != _package() and time.time() - other.stat().st_mtime > OLD:
            shutil.rmtree(other, ignore_errors=True)


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
