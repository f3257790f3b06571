"""What is wrong with a file or a name in it, as the end of a sentence that begins with that."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def unreadable(error: OSError | UnicodeDecodeError, kind: str) -> str:
    """Why reading ended in `error`; `kind` says what was expected there, with its article: "a scene file"."""
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, IsADirectoryError):
        return f"is a directory, not {kind}"
    if isinstance(error, UnicodeDecodeError):
        return "is not a text file in UTF-8"
    return f"cannot be read ({error.strerror or error})"


def known(name: str, names: Iterable[str], more: str = "") -> str:
    """The end of a sentence on a `name` that is none of `names`: the one that was meant, or all of them and `more`."""
    names = list(names)
    close = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {close[0]}?" if close else f"known here: {', '.join(names)}{more}"
