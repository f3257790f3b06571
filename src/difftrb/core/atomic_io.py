"""Results written into a folder, each file whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path


def write_folder(target: Path, fill: Callable[[Path], None]) -> None:
    """Let `fill` write files into a scratch folder inside `target`, then move them out one by one, each whole.

    If anything fails, `target` keeps what it had, or is not made at all; files of other names in it are left alone.
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
    except OSError as error:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise OSError(error.errno, error.strerror, str(target)) from None
