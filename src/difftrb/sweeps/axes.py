"""Axes of a sweep: dotted keys and their values, members numbered in their order, blocks of members computed at once.

A key names a number of a scene as the scene file does: `spall.0.length`, `load.axial`, `stiffness.phase`,
`contact.design_load`; of any other dataclass, dict or tuple it is the way through its fields.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
from annotated_types import Interval, Unit

from difftrb.core.messages import dotted, known, shown
from difftrb.core.status import SweepError
from difftrb.scene.scene import Scene

Mode = Literal["product", "zip"]
ZIPPED = "member"
"""Dimension of zipped axes."""
OF_SCENE = "load.radial, load.axial, spall.0.length and so on, bearing.…, stiffness.phase, contact.design_load"
WITHOUT_OWNER = ("stiffness.phase", "contact.design_load")
"""Keys of a scene file that are a scene's own fields."""
SPACINGS = ("linear", "log")
RANGE_KEYS = ("from", "to", "count", "spacing")
MOST_VALUES = 10_000_000
"""Of one axis: its values are kept; members of the product are not."""


@dataclasses.dataclass(frozen=True)
class Axis:
    """One dimension of a sweep.

    Attributes:
      keys: dotted keys that change along it: one, or all of zipped axes.
      values: shape (keys, count), in the units of the keys.
    """

    keys: tuple[str, ...]
    values: np.ndarray

    @property
    def name(self) -> str:
        """Of the dimension: its key, or "member" for zipped axes."""
        return self.keys[0] if len(self.keys) == 1 else ZIPPED

    @property
    def count(self) -> int:
        """How many values it has."""
        return self.values.shape[1]


def axes_of(given: Mapping[str, Any], mode: str = "product") -> tuple[Axis, ...]:
    """Axes from values by dotted key: numbers in a list or array, or {from, to, count, spacing}.

    `mode` "product" makes one dimension of every key, the last one changing fastest; "zip" one dimension of all keys,
    which then have equally many values. Raises `SweepError`.
    """
    if mode not in get_args(Mode):
        raise SweepError(f"mode = {shown(mode)}: must be 'product' (all combinations) or 'zip' (side by side)")
    if not given:
        raise SweepError(
            "there are no axes; name at least one key, say spall.0.length = {from = 0.5, to = 8, count = 64}"
        )
    values = {key: _values(key, spec) for key, spec in given.items()}
    if mode == "product" or len(values) == 1:
        return tuple(Axis((key,), value[None]) for key, value in values.items())
    counts = {key: len(value) for key, value in values.items()}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{key} {count}" for key, count in counts.items())
        raise SweepError(f"mode = 'zip' needs equally many values on every axis; there are {listed}")
    return (Axis(tuple(values), np.stack(list(values.values()))),)


def _values(key: str, spec: Any) -> np.ndarray:
    """The values of one axis, shape (count,)."""
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
    for name in spec:
        if name not in RANGE_KEYS:
            raise SweepError(f"{dotted([*key.split('.'), name])} is not a known key; {known(str(name), RANGE_KEYS)}")
    for name in RANGE_KEYS[:3]:
        if name not in spec:
            raise SweepError(f"{key}.{name} is missing: give {key} = {{from = …, to = …, count = …}}")
    for name in RANGE_KEYS[:2]:
        if not _is_number(spec[name]):
            raise SweepError(f"{key}.{name} = {shown(spec[name])}: must be a finite number")
    count, spacing = spec["count"], spec.get("spacing", "linear")
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or not 1 <= count <= MOST_VALUES:
        raise SweepError(f"{key}.count = {shown(count)}: must be a whole number in 1 … {MOST_VALUES}")
    first, last = float(spec["from"]), float(spec["to"])
    if spacing not in SPACINGS:
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


# ------------------------------------------------------------------------------------------------ keys


def _steps(tree: Any, key: str) -> list[str]:
    """The way to `key` through the fields of `tree`; a scene's keys are those of a scene file."""
    steps = key.split(".")
    if isinstance(tree, Scene):
        if steps[0] == "spall":
            steps[0] = "spalls"
        elif key in WITHOUT_OWNER:
            steps = steps[1:]
    return steps


def _is_of_scene(key: str) -> bool:
    """Whether a key begins as those of scenes do: Python's names of other fields are none. Raises `SweepError`."""
    owner, _, rest = key.partition(".")
    if owner == "effects" and not rest[:1].isdigit():
        raise SweepError(f"{dotted(key.split('.'))}: numbers of effects are not swept; run one sweep for each")
    return owner in ("load", "spall", "bearing", "effects") or key in WITHOUT_OWNER


def _fields(tree: Any) -> list[str]:
    if dataclasses.is_dataclass(tree):
        return [field.name for field in dataclasses.fields(tree)]
    if isinstance(tree, Mapping):
        return [str(name) for name in tree]
    return [str(i) for i in range(len(tree))] if isinstance(tree, tuple | list) else []


def _taken(tree: Any, step: str) -> Any:
    if dataclasses.is_dataclass(tree):
        return getattr(tree, step)
    return tree[step] if isinstance(tree, Mapping) else tree[int(step)]


def number_at(tree: Any, key: str) -> Any:
    """The number that `key` names in `tree`. Raises `SweepError` if there is none."""
    at = tree
    steps = _steps(tree, key)
    if isinstance(tree, Scene) and not _is_of_scene(key):
        raise SweepError(f"{dotted(key.split('.'))} is not a known key; known here: {OF_SCENE}")
    for i, step in enumerate(steps):
        fields = _fields(at)
        if step not in fields:
            if step.isdigit() and isinstance(at, tuple | list):
                raise SweepError(f"{key}: there {_are(len(at))}, counted from 0")
            close = difflib.get_close_matches(step, fields, n=1)
            written = key.split(".")[: i + len(key.split(".")) - len(steps)]
            hint = f"did you mean {'.'.join([*written, close[0]])}?" if close else f"known here: {', '.join(fields)}"
            raise SweepError(f"{dotted(key.split('.'))} is not a known key" + (f"; {hint}" if fields else ""))
        at = _taken(at, step)
    return at


def _are(count: int) -> str:
    return f"is {count} entry" if count == 1 else f"are {count} entries"


def replaced(tree: Any, key: str, value: Any) -> Any:
    """`tree` with `value` at `key`."""

    def down(at: Any, steps: Sequence[str]) -> Any:
        if not steps:
            return value
        new = down(_taken(at, steps[0]), steps[1:])
        if dataclasses.is_dataclass(at) and not isinstance(at, type):
            return dataclasses.replace(at, **{steps[0]: new})
        if isinstance(at, Mapping):
            return {**at, steps[0]: new}
        return type(at)(new if i == int(steps[0]) else entry for i, entry in enumerate(at))  # pyright: ignore

    return down(tree, _steps(tree, key))


def meaning(tree: Any, key: str) -> tuple[Interval | None, str]:
    """The range and the unit of `key`, from its annotation; None and "" where there is none.

    Raises `SweepError` for a key that is not there, or is not a number that may change.
    """
    number = number_at(tree, key)
    *way, name = _steps(tree, key)
    owner = tree
    for step in way:
        owner = _taken(owner, step)
    if not dataclasses.is_dataclass(owner):
        if not isinstance(number, jax.Array | np.ndarray) and not _is_number(number):
            raise SweepError(f"{key} is not a number; sweep a number")
        return None, ""
    hint = get_type_hints(type(owner) if not isinstance(owner, type) else owner, include_extras=True)[name]
    kinds = [hint] if get_origin(hint) is Annotated else [h for h in get_args(hint) if get_origin(h) is Annotated]
    static = next(field for field in dataclasses.fields(owner) if field.name == name).metadata.get("static", False)
    if not kinds:
        if static or not isinstance(number, float | int | jax.Array) or isinstance(number, bool):
            raise SweepError(f"{key} is not a number that can be swept")
        return None, ""
    first, *metadata = get_args(kinds[0])
    if static or first is int:
        what = "is a count, which" if first is int else "is one for a whole sweep, because it"
        raise SweepError(f"{key} {what} shapes the computation: run one sweep for each")
    limits = next((m for m in metadata if isinstance(m, Interval)), None)
    return limits, next((m.unit for m in metadata if isinstance(m, Unit)), "")


def check(tree: Any, axes: Sequence[Axis], gradients: Sequence[str] = ()) -> dict[str, str]:
    """The units of all keys; refuses keys that are not there and values outside a key's range. Raises `SweepError`."""
    units = {}
    for axis in axes:
        for key, values in zip(axis.keys, axis.values, strict=True):
            limits, units[key] = meaning(tree, key)
            low, high = (getattr(limits, side, None) for side in ("ge", "le"))
            for value in (float(values.min()), float(values.max())):
                if (low is not None and value < low) or (high is not None and value > high):
                    unit = f" {units[key]}" if units[key] else ""
                    raise SweepError(f"{key} = {value:g}: must be a number in {low:g} … {high:g}{unit}")
    swept = {key for axis in axes for key in axis.keys}
    for key in gradients:
        _, units[key] = meaning(tree, key)
        number = number_at(tree, key)
        if key not in swept and not isinstance(number, jax.Array | np.ndarray) and not _is_number(number):
            raise SweepError(f"gradients: {key} has no value here to differentiate by; give it one, or an axis")
    if len(set(gradients)) < len(gradients):
        raise SweepError("gradients: a key is there twice; name each once")
    return units


# ------------------------------------------------------------------------------------------------ members and blocks


@dataclasses.dataclass(frozen=True)
class Layout:
    """How members, numbered with the last axis changing fastest, are cut into blocks that are computed at once.

    A block is a part of one axis times all of the axes behind it, at one place of those before it, so that what does
    not change inside is computed once. It depends on the axes and on `batch` alone: not on files, devices, processes.

    Attributes:
      counts: values of every axis. batch: members of a block, at most (but for what one axis must have).
    """

    counts: tuple[int, ...]
    batch: int

    @property
    def members(self) -> int:
        """Of the whole sweep."""
        return math.prod(self.counts)

    @property
    def split(self) -> int:
        """The axis of which blocks take a part."""
        for axis in range(len(self.counts) - 1, 0, -1):
            if math.prod(self.counts[axis:]) >= self.batch:
                return axis
        return 0

    @property
    def behind(self) -> int:
        """Members for one value of the axis that is split."""
        return math.prod(self.counts[self.split + 1 :])

    @property
    def parts(self) -> int:
        """In how many the axis is split."""
        return -(-self.counts[self.split] // max(1, self.batch // self.behind))

    @property
    def part(self) -> int:
        """Values of the split axis in a block; the last part may be short, and is filled up."""
        return -(-self.counts[self.split] // self.parts)

    @property
    def blocks(self) -> int:
        """How many there are."""
        return math.prod(self.counts[: self.split]) * self.parts

    @property
    def size(self) -> int:
        """Members of a block, those that fill it up included."""
        return self.part * self.behind

    def first(self, block: int) -> int:
        """The first member of a block; the end of all for the block behind the last."""
        before, part = divmod(block, self.parts)
        return (
            before * self.counts[self.split] * self.behind
            + min(part * self.part, self.counts[self.split]) * self.behind
        )

    def places(self, block: jax.Array) -> list[jax.Array]:
        """Places on every axis: of the axes before the split one, shape (); of the others, shape (values,). Inside
        jit, too."""
        before, part = block // self.parts, block % self.parts
        outer: list[jax.Array] = []
        for count in reversed(self.counts[: self.split]):
            outer.append(before % count)
            before = before // count
        inside = jnp.minimum(part * self.part + jnp.arange(self.part), self.counts[self.split] - 1)
        return [*reversed(outer), inside, *(jnp.arange(count) for count in self.counts[self.split + 1 :])]

    def member(self, number: int) -> tuple[int, ...]:
        """A member's place on every axis."""
        return tuple(int(i) for i in np.unravel_index(number, self.counts))
