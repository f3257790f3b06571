"""What is wrong with a file, in one sentence: key, value, allowed range, what to do."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Interval, Unit

from difftrb.core import geometry
from difftrb.core.files import dotted, known, shown

UNKNOWN_KEY = ("unexpected_keyword_argument", "extra_forbidden")  # pydantic's names


def in_one_sentence(error: Any, root: type) -> str:
    """One pydantic error as a sentence: key, value, allowed range, what to do."""
    where = list(error["loc"])
    if where[:2] == ["stiffness", "phase"]:  # behind a key of two kinds the kind is named, too
        where = where[:2]
    key, value = dotted(where), shown(error["input"])
    if error["type"] in UNKNOWN_KEY:
        names = [f.name for f in dataclasses.fields(_owner(root, where[:-1]))]
        return f"{key} is not a known key; {known(str(where[-1]), names)}"
    takes = allowed(root, where)
    if key == "bearing":
        takes = f"a name ({', '.join(map(repr, geometry.NAMED_BEARINGS))}) or a [bearing] table"
    if error["type"] == "missing":
        return f"{key} is missing: give {takes}"
    if where[0] == "spall" and len(where) < 3:
        return f"{key} = {value}: spalls are tables, each under a heading [[spall]]"
    return f"{key} = {value}: must be {takes}"


def _owner(root: type, where: Iterable[str | int]) -> Any:
    """The dataclass (or list) in which the key at `where` lives."""
    owner: Any = root
    for part in where:
        owner = _kind(get_args(owner)[0] if isinstance(part, int) else get_type_hints(owner, include_extras=True)[part])
    return owner


def _kind(hint: Any) -> Any:
    """What a key is if it is there at all."""
    kinds = [h for h in get_args(hint) if h is not type(None)] if get_origin(hint) in (Union, types.UnionType) else []
    return kinds[0] if len(kinds) == 1 else hint


def allowed(root: type, where: list[str | int]) -> str:
    """What a key takes, in words, from its annotation."""
    owner, last = _owner(root, where[:-1]), where[-1]
    hint = get_args(owner)[0] if isinstance(last, int) else get_type_hints(owner, include_extras=True)[last]
    if get_origin(hint) not in (Union, types.UnionType):
        return _in_words(hint)
    kinds = [kind for kind in get_args(hint) if kind is not type(None)]
    return " or ".join(_in_words(kind) for kind in kinds if get_origin(kind) is not None or len(kinds) == 1)


def _in_words(hint: Any) -> str:
    """What one kind of value is, in words."""
    if get_origin(hint) is Literal and len(get_args(hint)) == 1:
        return repr(get_args(hint)[0])
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(repr(v) for v in get_args(hint))
    if get_origin(hint) is tuple and get_origin(get_args(hint)[0]) is Annotated:
        return f"a list, each {_in_words(get_args(hint)[0])}"
    if get_origin(hint) is not Annotated:
        return "a table"
    kind, *metadata = get_args(hint)
    unit = next((m.unit for m in metadata if isinstance(m, Unit)), "")
    limits = next(m for m in metadata if isinstance(m, Interval))
    return number_in(limits.ge, limits.le, unit, whole=kind is int)


def number_in(low: Any, high: Any, unit: str = "", whole: bool = False) -> str:
    """What a number within limits is, in words."""
    return f"{'a whole number' if whole else 'a number'} in {low:g} … {high:g}{f' {unit}' if unit else ''}"
