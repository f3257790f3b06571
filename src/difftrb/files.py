"""What is wrong with a file or a name in it, as the end of a sentence that begins with that."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import Any

LONGEST = 60
"""Characters of a value or a name that are shown."""


def unreadable(error: OSError | UnicodeDecodeError, kind: str) -> str:
    """Why reading ended in `error`; `kind` says what was expected there, with its article: "a scene file"."""
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, IsADirectoryError):
        return f"is a directory, not {kind}"
    if isinstance(error, UnicodeDecodeError):
        return "is not a text file in UTF-8"
    return f"cannot be read ({error.strerror or error})"


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
