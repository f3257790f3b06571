"""What every field of a scene may hold, from its annotation: as a sentence outside jit, and as a truth inside."""

from __future__ import annotations

import functools
import math
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from annotated_types import Interval

from difftrb.core import geometry
from difftrb.core.files import shown
from difftrb.core.messages import allowed, number_in
from difftrb.core.pytrees import numbers_of

SHRINKING = ("length", "width", "depth")
"""Sizes of a spall that may shrink to nothing in Python, where derivatives by them are asked for; in a file their least
value tells mm from other units."""
SLACK = 1e-3
"""By how much of an end a traced number may be beyond it: differences over a small step are taken there."""


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
            if cls is geometry.Spall and name in SHRINKING:
                low, takes = 0.0, number_in(0.0, high, "mm")
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
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    real = whole or (isinstance(value, float | np.floating | np.ndarray | jax.Array) and _kind(value) in "iuf")
    if math.isnan(field.low) or not real or (field.whole and not whole):
        return f"{key} = {shown(value)}: must be {takes}"
    number = value if isinstance(value, int) else float(value)
    if field.low <= number <= field.high or (not_finite and not -math.inf < number < math.inf):
        return None
    return f"{key} = {shown(number)}: must be {takes}"


def _kind(value: Any) -> str:
    """Of a number with a dtype its kind."""
    return value.dtype.kind if hasattr(value, "dtype") else "f"


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


def all_within(numbers: Iterator[tuple[Any, float, float]]) -> jax.Array:
    """Whether all of some `traced` numbers are, shape ()."""
    values, lows, highs = zip(*numbers, strict=True)
    every = jax.lax.stop_gradient(jnp.stack([jnp.asarray(value, float) for value in values]))
    return jnp.all((every >= np.array(lows)) & (every <= np.array(highs)))
