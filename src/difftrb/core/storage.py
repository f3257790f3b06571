"""Files written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

Arrays = dict[str, np.ndarray]
SCRATCH = ".part"


def read(path: Path, names: Sequence[str] | None = None) -> Arrays | None:
    """What `write` wrote, or the arrays of these `names` of it.

    None if the file is not there, cut short or changed: every array has a checksum.
    """
    try:
        with open(path, "rb") as whole, np.load(whole, allow_pickle=False) as file:
            return {entry: file[entry] for entry in (file.files if names is None else names)}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):  # each one met with a file cut or changed
        return None


def write(path: Path, arrays: Arrays) -> None:
    """All or nothing: a reader never sees half a file, whoever else writes. Equal arrays make equal bytes."""
    with replacing(path) as scratch, open(scratch, "wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A scratch file beside `path` that takes its place when the block ends well, and is removed when it does not.

    What a killed process left (`remove_leftovers`) is named after `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=f"{path.name}-", suffix=SCRATCH)
    os.close(handle)
    try:
        yield Path(scratch)
        os.chmod(scratch, 0o666 & ~_umask())  # mkstemp's files are their owner's alone
        os.replace(scratch, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(scratch)
        raise


def write_folder(target: Path, fill: Callable[[Path], None]) -> list[str]:
    """Let `fill` write files into a scratch folder inside `target`, then move them out one by one, each whole.

    Returns their names. If anything fails, `target` keeps what it had, or is not made at all; files of other names in
    it are left alone.
    OSErrors name `target`.
    """
    made = [folder for folder in (target, *target.parents) if not folder.exists()]
    try:
        target.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target, prefix=".difftrb-") as scratch:
            fill(Path(scratch))
            files = sorted(Path(scratch).iterdir())
            for file in files:
                if (target / file.name).is_dir():
                    raise IsADirectoryError(21, f"a folder named {file.name} is in the way")
            for file in files:
                os.replace(file, target / file.name)
            return [file.name for file in files]
    except OSError as error:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise OSError(error.errno, error.strerror, str(target)) from None


def remove_leftovers(folder: Path, pattern: str) -> None:
    """Remove scratch files that nobody has written to for an hour: their process was killed."""
    for scratch in folder.rglob(pattern):
        with contextlib.suppress(OSError):  # another process removes it, or ends it well
            if time.time() - scratch.stat().st_mtime > 3600.0:
                scratch.unlink()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
