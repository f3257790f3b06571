"""What keeps a file from being read, as the end of a sentence that begins with its name."""

from __future__ import annotations


def unreadable(error: OSError | UnicodeDecodeError, kind: str) -> str:
    """Why reading ended in `error`; `kind` says what was expected there, with its article: "a scene file"."""
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, IsADirectoryError):
        return f"is a directory, not {kind}"
    if isinstance(error, UnicodeDecodeError):
        return "is not a text file in UTF-8"
    return f"cannot be read ({error.strerror or error})"
