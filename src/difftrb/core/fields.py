"""Dataclasses of numbers: as pytrees; and what every field may hold, from its annotation.

JAX rebuilds a tree with whatever it has in place of numbers: tracers, None, objects, truths, axes of `vmap`. That goes
round the constructor, which is free to tidy and to refuse what people give it. Ranges are told as a sentence outside
jit, and as a truth inside.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
import types
from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import jax
import jax.core
import numpy as np
from annotated_types import Interval, Unit
from jax.tree_util import GetAttrKey, register_pytree_with_keys

from difftrb.core import arrays as xp
from difftrb.core.input_errors import allowed, is_whole, must_be, number_in, shown

Class = TypeVar("Class", bound=type)

SHRINKS = "may be 0 in Python"
"""Annotation of a size that may shrink to nothing in Python, where derivatives by it are asked for. In a file its least
value tells mm from other units."""
SLACK = 1e-3
"""By how much of an end a traced number may be beyond it: differences over a small step are taken there."""


# ------------------------------------------------------------------------------------------------ pytrees


@functools.cache
def numbers_of(cls: type) -> tuple[str, ...]:
    """Names of the fields that are leaves, or trees of them: all but those marked as static."""
    return tuple(field.name for field in dataclasses.fields(cls) if not field.metadata.get("static", False))


def register(cls: Class) -> Class:
    """Make a dataclass a pytree with its static fields in the structure; for use as a decorator, too."""
    data = numbers_of(cls)
    meta = tuple(field.name for field in dataclasses.fields(cls) if field.name not in data)
    keys, names = tuple(map(GetAttrKey, data)), (*data, *meta)
    leaves, static = _getter(data), _getter(meta)

    def flatten(tree: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        return leaves(tree), static(tree)

    def with_keys(tree: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        return tuple(zip(keys, leaves(tree), strict=True)), static(tree)

    def rebuild(meta: tuple[Any, ...], data: Any) -> Any:
        tree = object.__new__(cls)
        tree.__dict__.update(zip(names, (*data, *meta), strict=True))
        return tree

    register_pytree_with_keys(cls, with_keys, rebuild, flatten)
    return cls


def _getter(names: tuple[str, ...]) -> Callable[[Any], tuple[Any, ...]]:
    """Of these fields; as fast as can be, for every call of a compiled function takes scenes apart."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    return lambda tree: tuple([getattr(tree, name) for name in names])


def whole_to_float(tree: Any, names: Iterable[str] | None = None) -> None:
    """Turn whole numbers among a new dataclass's fields, or those of some `names`, into floats, by which JAX
    differentiates; for `__post_init__`. What is no whole number stays as it is, truths among it."""
    for name in numbers_of(type(tree)) if names is None else names:
        value = getattr(tree, name)
        if type(value) is float:
            continue
        new = tuple(map(_as_float, value)) if type(value) is tuple else _as_float(value)
        if new is not value:
            object.__setattr__(tree, name, new)


def _as_float(value: Any) -> Any:
    if is_whole(value):
        try:
            return float(value)
        except OverflowError:  # hundreds of digits: for the checks to refuse
            return value
    if isinstance(value, jax.Array | np.ndarray) and not isinstance(value, jax.core.Tracer):
        return value.astype(float) if value.ndim == 0 and value.dtype.kind in "iu" else value
    return value


# ------------------------------------------------------------------------------------------------ ranges


class Field(NamedTuple):
    """What one field takes: `texts`, or numbers from `low` to `high`, `whole` ones, `several` of them in a tuple."""

    name: str
    texts: tuple[str, ...]
    low: float
    high: float
    whole: bool
    several: bool
    optional: bool
    takes: str


@functools.cache
def fields_of(cls: type) -> tuple[Field, ...]:
    """Those of a dataclass that hold numbers within limits, or one of some texts."""
    found = []
    for name, hint in get_type_hints(cls, include_extras=True).items():
        kinds = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
        texts = tuple(text for kind in kinds if get_origin(kind) is Literal for text in get_args(kind))
        several = any(get_origin(kind) is tuple and get_origin(get_args(kind)[0]) is Annotated for kind in kinds)
        numbers = [get_args(kind)[0] if several else kind for kind in kinds]
        numbers = [number for number in numbers if get_origin(number) is Annotated]
        if not texts and not numbers:
            continue
        low, high, whole, takes = math.nan, math.nan, False, allowed(cls, [name])
        if numbers:
            kind, *metadata = get_args(numbers[0])
            limits = next(m for m in metadata if isinstance(m, Interval))
            low, high, whole = float(limits.ge), float(limits.le), kind is int  # type: ignore[arg-type]
            if SHRINKS in metadata:
                low, takes = 0.0, number_in(0.0, high, next(m.unit for m in metadata if isinstance(m, Unit)))
        found.append(Field(name, texts, low, high, whole, several, type(None) in kinds, takes))
    return tuple(found)


def wrong(tree: Any, key: str, not_finite: bool = False) -> str | None:
    """What is wrong with one of a dataclass's fields, whose names follow `key` and a dot; None if nothing is. Traced
    numbers are passed over, with `not_finite` NaN and infinity, too."""
    for field in fields_of(type(tree)):
        value = getattr(tree, field.name)
        if type(value) is float and field.low <= value <= field.high and not (field.whole or field.several):
            continue
        sentence = of_field(field, value, f"{key}.{field.name}", not_finite)
        if sentence is not None:
            return sentence
    return None


def of_field(field: Field, value: Any, key: str, not_finite: bool = False) -> str | None:
    """What is wrong with the value of one field; see `wrong`."""
    if value is None and field.optional:
        return None
    if isinstance(value, str) and value in field.texts:
        return None
    if not field.several:
        return _of_number(field, value, key, not_finite)
    if not isinstance(value, tuple | list):
        return f"{key} = {shown(value)}: must be {field.takes}"
    sentences = (_of_number(field, each, f"{key}.{i}", not_finite) for i, each in enumerate(value))
    return next((sentence for sentence in sentences if sentence is not None), None)


def _of_number(field: Field, value: Any, key: str, not_finite: bool) -> str | None:
    takes = field.takes.removeprefix("a list, each ")
    shape = getattr(value, "shape", ())
    if shape:
        return (
            f"{key} has shape {tuple(shape)}: a scene takes one number; use jax.vmap for many scenes at once, or "
            f"difftrb.sweep with {key} as an axis"
        )
    if isinstance(value, jax.core.Tracer):
        return None
    whole = is_whole(value)
    kind = getattr(getattr(value, "dtype", None), "kind", "f")
    real = whole or (isinstance(value, float | np.floating | np.ndarray | jax.Array) and kind in "iuf")
    if math.isnan(field.low) or not real or (field.whole and not whole):
        return must_be(key, value, takes)
    number = value if isinstance(value, int) else float(value)
    if field.low <= number <= field.high or (not_finite and not -math.inf < number < math.inf):
        return None
    return must_be(key, number, takes)


def traced(tree: Any) -> Iterator[tuple[Any, float, float]]:
    """Every number of a dataclass that is a leaf, with the ends that it may not be beyond inside jit."""
    for field in fields_of(type(tree)):
        value = getattr(tree, field.name)
        if math.isnan(field.low) or field.name not in numbers_of(type(tree)):
            continue
        low, high = field.low - SLACK * abs(field.low), field.high + SLACK * abs(field.high)
        for each in value if field.several else (value,):
            if isinstance(each, float | int | np.generic | np.ndarray | jax.Array):  # neither None nor a mean
                yield each, low, high


def all_within(numbers: Iterator[tuple[Any, float, float]]) -> Any:
    """Whether all of some `traced` numbers are, shape ()."""
    values, lows, highs = zip(*numbers, strict=True)
    every = xp.fixed(xp.stack([xp.asarray(value) for value in values]))
    return xp.module_of(every).all((every >= np.array(lows)) & (every <= np.array(highs)))
