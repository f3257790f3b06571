"""Files that a user names: reading them safely, and what is wrong with one in one sentence: key, value, what it takes.

Needs neither JAX nor numpy.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import io
import math
import os
import re
import stat
import types
from collections.abc import Iterable, Iterator, Mapping
from importlib import resources
from numbers import Integral
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Interval, Unit

LONGEST = 60
"""Characters of a value or a name that are shown."""
LONGEST_PATH = 300
"""Characters of a path that are shown."""
LARGEST_TEXT = 1_000_000
"""Bytes of a text file that is read: 20 000 rows, or a list of 50 000 values."""
UNKNOWN_KEY = ("unexpected_keyword_argument", "extra_forbidden")  # pydantic's names


# ------------------------------------------------------------------------------------------------ reading


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
        raise refused(
            f"{named(path)}: is not a text file in UTF-8; save it as such, from a spreadsheet as CSV UTF-8"
        ) from None


def packaged(kind: str) -> dict[str, str]:
    """Texts of the packaged files that end with `kind`, ".toml" for scenes, by their names without it, in order."""
    files = [each for each in (resources.files("difftrb") / "scenes").iterdir() if each.name.endswith(kind)]
    return dict(sorted((each.name.removesuffix(kind), each.read_text(encoding="utf-8")) for each in files))


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


# ------------------------------------------------------------------------------------------------ words


def named(path: str | Path) -> str:
    """A path at the start of a sentence: cut short, and in quotes if it has what cannot be shown."""
    name = str(path)
    name = name if name.isprintable() else repr(name)
    return name if len(name) <= LONGEST_PATH else f"{name[: LONGEST_PATH - 3]}..."


def shown(value: Any) -> str:
    """A value in a sentence: in quotes if it is text, on one line, and cut short."""
    return _cut(repr(value).replace("\n", " "))


def dotted(parts: Iterable[str | int]) -> str:
    """A key in a sentence: bare if TOML can write all its parts so, else in quotes; and cut short."""
    names = [str(part) for part in parts]
    key = ".".join(names)
    return _cut(key if all(re.fullmatch(r"[A-Za-z0-9_-]+", name) for name in names) else repr(key))


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def did_you_mean(name: str, names: Iterable[str], more: str = "", before: str = "", close: float = 0.6) -> str:
    """The end of a sentence on a `name` that is none of `names`: the one that was meant, if it is so `close` (0 … 1),
    behind what stands `before` it, or all of them and `more`."""
    names = list(names)
    meant = difflib.get_close_matches(name.lower(), names, n=1, cutoff=close)
    return f"did you mean {before}{meant[0]}?" if meant else f"known here: {', '.join(names)}{more}"


# ------------------------------------------------------------------------------------------------ what a key takes


def in_one_sentence(error: Any, root: type, takes: Mapping[str, str]) -> str:
    """One pydantic error on a file read as dataclass `root`: key, value, allowed range, what to do.

    `takes` says what keys take of which annotations do not tell all.
    """
    where = list(error["loc"])
    if where[:2] == ["stiffness", "phase"]:  # pydantic names the kind, too, behind a key of two kinds
        where = where[:2]
    key, value = dotted(where), shown(error["input"])
    if error["type"] in UNKNOWN_KEY:
        names = [f.name for f in dataclasses.fields(_owner(root, where[:-1]))]
        if len(where) > 1 and where[-1] in {f.name for f in dataclasses.fields(root)}:
            return f"{key} is not a known key; {where[-1]} is one of the file itself: write it above the first heading"
        return f"{key} is not a known key; {did_you_mean(str(where[-1]), names)}"
    wanted = takes.get(key) or allowed(root, where)
    if error["type"] == "missing":
        return f"{key} is missing: give {wanted}"
    if where[0] == "spall" and len(where) < 3:
        return f"{key} = {value}: spalls are tables, each under a heading [[spall]]"
    return must_be(key, error["input"], wanted)


def must_be(key: str, value: Any, wanted: str) -> str:
    """The sentence on a value that is not what is wanted, with what was most likely meant if that can be seen."""
    sentence = f"{key} = {shown(value)}: must be {wanted}"
    if isinstance(value, str) and "number" in wanted and re.fullmatch(r"\s*[+-]?\d[\d.,eE+-]*\s*", value):
        return f"{sentence}; write it without quotes"
    if isinstance(value, str) and "number" in wanted and re.fullmatch(r"\s*[+-]?\d[\d.,eE+-]*\s*[^\d\s]+", value):
        return f"{sentence}; write the number alone, without quotes and unit"
    if key.startswith("load.") and isinstance(value, int | float) and value < 0.0:
        return f"{sentence}; angles count from the line of the radial load, so give loads by their size"
    if wanted.endswith(" rad") and isinstance(value, int | float) and abs(value) <= 360.0:
        return f"{sentence}; in degrees? {value:g}° are {math.radians(value):.4g} rad"
    if wanted == "a table" and value is True:
        return f"{sentence}: write {{ }}, or a heading in brackets, for its defaults"
    if wanted == "a table" and isinstance(value, list | tuple) and value and isinstance(value[0], str):
        return f"{sentence}: write a heading in brackets for each, say [{dotted([key, value[0]])}]"
    return sentence


def _owner(root: type, where: Iterable[str | int]) -> Any:
    """The dataclass (or list) in which the key at `where` lives."""
    owner: Any = root
    for part in where:
        owner = _kind(_hint(owner, part))
    return owner


def _hint(owner: Any, part: str | int) -> Any:
    """The annotation of a field, or of a list's entries."""
    return get_args(owner)[0] if isinstance(part, int) else get_type_hints(owner, include_extras=True)[part]


def _kind(hint: Any) -> Any:
    """What a key is if it is there at all."""
    kinds = [h for h in get_args(hint) if h is not type(None)] if get_origin(hint) in (Union, types.UnionType) else []
    return kinds[0] if len(kinds) == 1 else hint


def allowed(root: type, where: list[str | int]) -> str:
    """What a key takes, in words, from its annotation."""
    hint = _hint(_owner(root, where[:-1]), where[-1])
    if get_origin(hint) not in (Union, types.UnionType):
        return _in_words(hint)
    kinds = [kind for kind in get_args(hint) if kind is not type(None)]
    return " or ".join(_in_words(kind) for kind in kinds if get_origin(kind) is not None or len(kinds) == 1)


def _in_words(hint: Any) -> str:
    """What one kind of value is, in words."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Literal:
        return repr(parts[0]) if len(parts) == 1 else "one of " + ", ".join(map(repr, parts))
    if origin is tuple and get_origin(parts[0]) is Annotated:
        return f"a list, each {_in_words(parts[0])}"
    if origin is not Annotated:
        return "a table"
    kind, *metadata = parts
    unit = next((m.unit for m in metadata if isinstance(m, Unit)), "")
    limits = next(m for m in metadata if isinstance(m, Interval))
    return number_in(limits.ge, limits.le, unit, whole=kind is int)


def is_whole(value: Any, low: float = -math.inf, high: float = math.inf) -> bool:
    """Whether it is a whole number between these, Python's or numpy's; truths are none."""
    return isinstance(value, Integral) and not isinstance(value, bool) and low <= int(value) <= high


def number_in(low: Any, high: Any, unit: str = "", whole: bool = False) -> str:
    """What a number within limits is, in words."""
    return f"{'a whole number' if whole else 'a number'} in {low:g} … {high:g}{f' {unit}' if unit else ''}"
