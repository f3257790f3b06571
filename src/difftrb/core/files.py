"""Files that a user names: reading them, and what is wrong with one or a name in it, as the end of a sentence."""

from __future__ import annotations

import contextlib
import difflib
import io
import os
import re
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

LONGEST = 60
"""Characters of a value or a name that are shown."""
LONGEST_PATH = 300
"""Characters of a path that are shown."""
LARGEST_TEXT = 1_000_000
"""Bytes of a text file that is read: 20 000 rows, or a list of 50 000 values."""


@contextlib.contextmanager
def opened(path: str | Path, kind: str, most: int, refused: type[ValueError]) -> Iterator[io.BufferedReader]:
    """A file of at most `most` bytes, open for reading. What is wrong with it is raised as `refused`, in one sentence.

    `kind` says what was expected there, with its article: "a scene file". A pipe or a device is not opened at all: the
    one may never begin, the other never end.
    """
    try:
        about = os.stat(path)
        wrong = _refusal(about, kind, most)
        file = None if wrong else open(path, "rb")  # noqa: SIM115
    except (OSError, ValueError) as error:  # a ValueError tells of a path that no file can have
        wrong, file = _unreadable(error), None
    if file is None:
        raise refused(f"{named(path)}: {wrong}")
    with file:
        try:
            yield file
        except OSError as error:
            raise refused(f"{named(path)}: {_unreadable(error)}") from None


def text_of(path: str | Path, kind: str, refused: type[ValueError], most: int = LARGEST_TEXT) -> str:
    """The text of a file, as `opened`; without the mark with which some editors begin."""
    with opened(path, kind, most, refused) as file:
        content = file.read(most + 1)  # what grows, or lies about its size, ends here
    if len(content) > most:
        raise refused(f"{named(path)}: has more than {most / 1e6:.3g} MB, the most that {kind} has")
    try:
        return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig").read()
    except UnicodeDecodeError:
        raise refused(f"{named(path)}: is not a text file in UTF-8") from None


def _refusal(about: os.stat_result, kind: str, most: int) -> str:
    """Why a file is not even opened, or nothing."""
    if stat.S_ISDIR(about.st_mode):
        return f"is a directory, not {kind}"
    if not stat.S_ISREG(about.st_mode):
        return f"is a pipe or a device, not {kind}: write to a file what comes from there"
    if about.st_size > most:
        return f"has {about.st_size / 1e6:.3g} MB: {kind} has at most {most / 1e6:.3g} MB"
    return ""


def _unreadable(error: OSError | ValueError) -> str:
    """Why opening or reading ended in `error`."""
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    return f"cannot be read ({getattr(error, 'strerror', None) or error})"


def named(path: str | Path) -> str:
    """A path as it begins a sentence: cut short, and in quotes if it has what cannot be shown."""
    name = str(path)
    name = name if name.isprintable() else repr(name)
    return name if len(name) <= LONGEST_PATH else f"{name[: LONGEST_PATH - 3]}..."


def shown(value: Any) -> str:
    """A value as it stands in a sentence: in quotes if it is text, and cut short."""
    return _cut(repr(value))


def dotted(parts: Iterable[str | int]) -> str:
    """A key as it stands in a sentence: bare if TOML can write all its parts so, else in quotes; and cut short."""
    names = [str(part) for part in parts]
    key = ".".join(names)
    return _cut(key if all(re.fullmatch(r"[A-Za-z0-9_-]+", name) for name in names) else repr(key))


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def known(name: str, names: Iterable[str], more: str = "") -> str:
    """The end of a sentence on a `name` that is none of `names`: the one that was meant, or all of them and `more`."""
    names = list(names)
    close = difflib.get_close_matches(name.lower(), names, n=1)
    return f"did you mean {close[0]}?" if close else f"known here: {', '.join(names)}{more}"
