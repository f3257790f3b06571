"""Dataclasses of numbers as pytrees: whole numbers become floats when one is made, nothing when one is rebuilt.

JAX rebuilds a tree of whatever it has in place of numbers: tracers, None, objects, truths, axes of `vmap`. That goes
round the constructor, which is free to tidy and to refuse what people give it.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import jax
import jax.core
import numpy as np
from jax.tree_util import GetAttrKey, register_pytree_with_keys

Class = TypeVar("Class", bound=type)


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
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:  # hundreds of digits: for the checks to refuse
            return value
    if isinstance(value, jax.Array | np.ndarray) and not isinstance(value, jax.core.Tracer):
        return value.astype(float) if value.ndim == 0 and value.dtype.kind in "iu" else value
    return value
