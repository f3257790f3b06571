"""Axes of a sweep: dotted keys and their values; members in the order of the axes.

A key names a number of a scene as the scene file does: `spall.0.length`, `load.axial`, `stiffness.phase`,
`contact.design_load`. In any other dataclass, dict or tuple it is the path through the fields.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import jax
import numpy as np
from annotated_types import Interval, Unit

from difftrb.core.input_errors import did_you_mean, dotted, number_in, shown
from difftrb.core.status import SweepError
from difftrb.scene.scene import Scene

ZIPPED = "member"
"""Dimension of zipped axes."""
OF_SCENE = "load.radial, load.axial, spall.0.length and so on, bearing.…, stiffness.phase, contact.design_load"
OWN_FIELDS = ("stiffness.phase", "contact.design_load")
"""Keys of a scene file that are fields of the scene itself."""
RANGE_KEYS = ("from", "to", "count", "spacing")
EXAMPLE = "spall.0.length = {from = 0.5, to = 8, count = 64}"
MOST_VALUES = 10_000_000
"""Values of one axis, at most: they are kept in memory, members of the product are not."""


@dataclasses.dataclass(frozen=True)
class Axis:
    """One dimension of a sweep.

    Attributes:
      keys: dotted keys that change along it: one, or all of the zipped axes.
      values: shape (keys, count), in the units of the keys.
    """

    keys: tuple[str, ...]
    values: np.ndarray

    @property
    def name(self) -> str:
        """Name of the dimension: its key, or "member" for zipped axes."""
        return self.keys[0] if len(self.keys) == 1 else ZIPPED

    @property
    def count(self) -> int:
        """Number of values."""
        return self.values.shape[1]


def axes_of(given: Mapping[str, Any], mode: str = "product") -> tuple[Axis, ...]:
    """Axes from values by dotted key: numbers in a list or array, or {from, to, count, spacing}.

    `mode` "product" makes one dimension of every key, and the last one changes fastest. "zip" makes one dimension of
    all keys, which then need equally many values. Raises `SweepError`.
    """
    if mode not in ("product", "zip"):
        raise SweepError(f"mode = {shown(mode)}: must be 'product' (all combinations) or 'zip' (side by side)")
    if not given:
        raise SweepError(f"there are no axes; name at least one key, say {EXAMPLE}")
    values = {key: _values(key, spec) for key, spec in given.items()}
    if mode == "product" or len(values) == 1:
        return tuple(Axis((key,), value[None]) for key, value in values.items())
    counts = {key: len(value) for key, value in values.items()}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{key} {count}" for key, count in counts.items())
        raise SweepError(f"mode = 'zip' needs equally many values on every axis; there are {listed}")
    return (Axis(tuple(values), np.stack(list(values.values()))),)


def _values(key: str, spec: Any) -> np.ndarray:
    """Values of one axis, shape (count,)."""
    if isinstance(spec, Mapping):
        return _spaced(key, spec)
    try:
        values = np.asarray(spec)
    except ValueError:  # rows of different lengths
        values = np.zeros((0, 0))
    if values.ndim != 1 or not len(values) or values.dtype.kind not in "iuf":
        raise SweepError(f"{key} = {shown(spec)}: must be a list of numbers or {{from = …, to = …, count = …}}")
    if not np.isfinite(values).all():
        raise SweepError(f"{key} = {shown(spec)}: must be a list of finite numbers")
    return values.astype(float)


def _spaced(key: str, spec: Mapping[str, Any]) -> np.ndarray:
    """Values of {from, to, count, spacing}, shape (count,)."""
    for name in spec:
        if name not in RANGE_KEYS:
            where = dotted([*key.split("."), name])
            raise SweepError(f"{where} is not a known key; {did_you_mean(str(name), RANGE_KEYS)}")
    for name in RANGE_KEYS[:3]:
        if name not in spec:
            raise SweepError(f"{key}.{name} is missing: give {key} = {{from = …, to = …, count = …}}")
        if name != "count" and not _is_number(spec[name]):
            raise SweepError(f"{key}.{name} = {shown(spec[name])}: must be a finite number")
    first, last, count, spacing = float(spec["from"]), float(spec["to"]), spec["count"], spec.get("spacing", "linear")
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or not 1 <= count <= MOST_VALUES:
        raise SweepError(f"{key}.count = {shown(count)}: must be a whole number in 1 … {MOST_VALUES}")
    if spacing not in ("linear", "log"):
        raise SweepError(f"{key}.spacing = {shown(spacing)}: must be 'linear' or 'log'")
    if count == 1 and first != last:
        raise SweepError(f"{key}.count = 1: one value cannot go from {first:g} to {last:g}; give more, or a list")
    if spacing == "log" and (first <= 0.0 or last <= 0.0):
        raise SweepError(f"{key}: spacing = 'log' needs from and to above 0; they are {first:g} and {last:g}")
    with np.errstate(over="ignore", invalid="ignore"):
        values = (np.geomspace if spacing == "log" else np.linspace)(first, last, int(count))
    if not np.isfinite(values).all():
        raise SweepError(f"{key}: from {first:g} to {last:g} is farther than numbers reach; give ends that are nearer")
    return values


def _is_number(value: Any) -> bool:
    try:
        return isinstance(value, int | float | np.number) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number with hundreds of digits
        return False


def _has_value(value: Any) -> bool:
    return isinstance(value, int | float | np.number | np.ndarray | jax.Array) and not isinstance(value, bool)


def _entries(tree: Any) -> dict[str, Any]:
    """Fields of a dataclass, entries of a dict or tuple, by name; empty for anything else."""
    if dataclasses.is_dataclass(tree):
        return {field.name: getattr(tree, field.name, None) for field in dataclasses.fields(tree)}
    if isinstance(tree, Mapping):
        return {str(name): entry for name, entry in tree.items()}
    return {str(i): entry for i, entry in enumerate(tree)} if isinstance(tree, tuple | list) else {}


def _way(tree: Any, key: str) -> list[tuple[Any, str]]:
    """What leads to the number that `key` names: owners, and names of entries in them; a scene's keys are those of a
    scene file. Raises `SweepError` if there is none."""
    written = key.split(".")
    path, at, way = _path_in_scene(key) if isinstance(tree, Scene) else written, tree, []
    for i, step in enumerate(path):
        entries = _entries(at)
        if step not in entries:
            if step.isdigit() and isinstance(at, tuple | list):
                there = "is 1 entry" if len(at) == 1 else f"are {len(at)} entries"
                raise SweepError(f"{key}: there {there}, counted from 0")
            before = "".join(f"{each}." for each in written[: i + len(written) - len(path)])
            hint = f"; {did_you_mean(step, entries, before=before)}" if entries else ""
            raise SweepError(f"{dotted(written)} is not a known key{hint}")
        way.append((at, step))
        at = entries[step]
    return way


def _path_in_scene(key: str) -> list[str]:
    """Names of fields; refuses what no key of a scene begins with, such as Python's names of its fields."""
    owner, _, rest = key.partition(".")
    if owner == "effects" and not rest[:1].isdigit():
        raise SweepError(f"{dotted(key.split('.'))}: numbers of effects are not swept; run one sweep for each")
    if owner not in ("load", "spall", "bearing", "effects") and key not in OWN_FIELDS:
        raise SweepError(f"{dotted(key.split('.'))} is not a known key; known here: {OF_SCENE}")
    if owner == "spall" and rest and not rest[:1].isdigit():
        raise SweepError(f"{dotted(key.split('.'))} is not a known key; say which spall, from 0: spall.0.{rest}")
    path = (key.removeprefix(f"{owner}.") if key in OWN_FIELDS else key).split(".")
    return ["spalls", *path[1:]] if owner == "spall" else path


def number_at(tree: Any, key: str) -> Any:
    """The number that `key` names in `tree`. Raises `SweepError` if there is none."""
    owner, name = _way(tree, key)[-1]
    return _entries(owner)[name]


def replaced(tree: Any, key: str, value: Any) -> Any:
    """`tree` with `value` at `key`."""
    for owner, name in reversed(_way(tree, key)):
        if dataclasses.is_dataclass(owner):
            value = dataclasses.replace(owner, **{name: value})  # pyright: ignore
        elif isinstance(owner, Mapping):
            value = {**owner, name: value}
        else:
            value = type(owner)([*owner[: int(name)], value, *owner[int(name) + 1 :]])
    return value


def _meaning(tree: Any, key: str) -> tuple[Interval, str]:
    """Range and unit of `key` from its annotation; none and "" where there is none.

    Raises `SweepError` for a key that is not there, or is not a number that may change.
    """
    (owner, name), number, static, hint = _way(tree, key)[-1], number_at(tree, key), False, None
    if dataclasses.is_dataclass(owner):
        static = next(f for f in dataclasses.fields(owner) if f.name == name).metadata.get("static", False)
        with contextlib.suppress(NameError):  # of annotations that only a checker of types imports
            hint = get_type_hints(type(owner), include_extras=True).get(name)
    kinds = [h for h in (hint, *get_args(hint)) if get_origin(h) is Annotated]
    if not kinds:
        if static or not _has_value(number):
            raise SweepError(f"{key} is not a number that can be swept")
        return Interval(), ""
    first, *metadata = get_args(kinds[0])
    if static or first is int:
        what = "is a count, which" if first is int else "is one for a whole sweep, because it"
        raise SweepError(f"{key} {what} shapes the computation: run one sweep for each")
    limits = next((m for m in metadata if isinstance(m, Interval)), Interval())
    return limits, next((m.unit for m in metadata if isinstance(m, Unit)), "")


def check(tree: Any, axes: Sequence[Axis], gradients: Sequence[str] = ()) -> dict[str, str]:
    """Units of all keys. Raises `SweepError` for keys that are not there and values outside a key's range."""
    units = {}
    for axis in axes:
        for key, values in zip(axis.keys, axis.values, strict=True):
            limits, units[key] = _meaning(tree, key)
            for value in (values.min(), values.max()):
                if (limits.ge is not None and value < limits.ge) or (limits.le is not None and value > limits.le):
                    raise SweepError(f"{key} = {value:g}: must be {number_in(limits.ge, limits.le, units[key])}")
    for key in gradients:
        swept = key in units
        _, units[key] = _meaning(tree, key)
        if not swept and not _has_value(number_at(tree, key)):
            raise SweepError(f"gradients: {key} has no value here to differentiate by; give it one, or an axis")
    if len(set(gradients)) < len(gradients):
        raise SweepError("gradients: a key is there twice; name each once")
    return units
