"""What is swept: members by number, laid out in blocks and chunks, and the program that computes a block of them.

Blocks of members (`axes.Layout`) are computed one after another by `lax.map`, the members of one by `vmap` along one
axis after another, so that what an axis does not change is computed once.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import status
from difftrb.core.messages import shown
from difftrb.sweeps import axes as axes_
from difftrb.sweeps.axes import Axis, Layout
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.sweep_result import Swept, column_of

PARTS, SHARE, MOST_MEMBERS = 16, 64, 2**17
"""Of a chunk: the parts it is computed in; which share of the sweep it is; members, at most (or so many blocks)."""
SHOWN = 500
"""Values of an axis in a figure, at most."""
AHEAD = 2
"""Chunks that are computed while one is dealt with: none of the lanes waits for the last part of a chunk."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is swept.

    Attributes:
      base: the scene, or any other tree of dataclasses, dicts and tuples, that members differ from at the axes' keys.
      axes: see `Axis`. function: from a member to its results by name, arrays of any shape; `STATUS` among them is its
        status. gradients: keys by which every result is differentiated.
      units: of keys and results; results and keys that it does not have are numbers without unit. dims: names of the
        results' own dimensions.
      batch: members of a block, at most.
      title: what makes this sweep another than others, beside the attributes here: the scene file's text, say.
    """

    base: Any
    axes: tuple[Axis, ...]
    function: Callable[[Any], dict[str, jax.Array]]
    gradients: tuple[str, ...]
    units: dict[str, str]
    dims: dict[str, tuple[str, ...]]
    batch: int
    title: str = ""

    @cached_property
    def layout(self) -> Layout:
        """Of its members."""
        return Layout(tuple(axis.count for axis in self.axes), self.batch)

    @cached_property
    def shapes(self) -> dict[str, jax.ShapeDtypeStruct]:
        """Of one member's results by column."""
        return jax.eval_shape(lambda: _member(self, self.base, [jnp.asarray(axis.values[:, 0]) for axis in self.axes]))

    @cached_property
    def compute(self) -> Callable[[jax.Array, list[jax.Array]], dict[str, jax.Array]]:
        """The jitted program: from numbers of blocks, shape (n,), and the axes' values to columns, (n, size, …).

        The scene's numbers are constants in it: as arguments they cost up to twice the time.
        """

        def several(blocks: jax.Array, values: list[jax.Array]) -> dict[str, jax.Array]:
            return jax.lax.map(lambda block: _block(self, self.base, values, block), blocks)

        return jax.jit(several)

    @property
    def names(self) -> list[str]:
        """Of the results."""
        columns = {column_of(name, key) for name in self.shapes for key in self.gradients}
        return [name for name in self.shapes if name != STATUS and name not in columns]

    @property
    def chunk(self) -> int:
        """Blocks of a chunk."""
        blocks, size = self.layout.blocks, self.layout.size
        chunk = min(blocks, max(PARTS, min(blocks // SHARE, MOST_MEMBERS // size)))
        return -(-chunk // PARTS) * PARTS if chunk > PARTS else chunk

    @property
    def part(self) -> int:
        """Blocks of a part of a chunk, computed by one call."""
        return -(-self.chunk // PARTS)

    @property
    def chunks(self) -> int:
        """How many there are."""
        return -(-self.layout.blocks // self.chunk)

    def members(self, chunk: int) -> tuple[int, int]:
        """The first member of a chunk and the one behind its last."""
        ends = chunk * self.chunk, min((chunk + 1) * self.chunk, self.layout.blocks)
        return self.layout.first(ends[0]), self.layout.first(ends[1])

    def unit(self, name: str, by: str | None = None) -> str:
        """Of a result or, with the key `by`, of its derivative."""
        own = self.units.get(name, "")
        if by is None:
            return own
        return f"{own or '1'} per {self.units.get(by, '') or '1'}"


def _member(plan: Plan, base: Any, at: Sequence[jax.Array]) -> dict[str, jax.Array]:
    """Everything of one member by column; `at` holds the values of every axis's keys, each of shape (keys,)."""
    tree = base
    for axis, values in zip(plan.axes, at, strict=True):
        for key, value in zip(axis.keys, values, strict=True):
            tree = axes_.replaced(tree, key, value)

    def both(numbers: jax.Array) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
        moved = tree
        for key, number in zip(plan.gradients, numbers, strict=True):
            moved = axes_.replaced(moved, key, number)
        found = {name: jnp.asarray(value) for name, value in plan.function(moved).items()}
        return {name: value.astype(float) for name, value in found.items() if name != STATUS}, found

    by: dict[str, jax.Array] = {}
    if plan.gradients:
        numbers = jnp.stack([jnp.asarray(axes_.number_at(tree, key), float) for key in plan.gradients])
        by, found = jax.jacfwd(both, has_aux=True)(numbers)
    else:
        found = both(jnp.zeros(0))[1]
    values = {name: value for name, value in found.items() if name != STATUS}
    whole = jnp.all(jnp.stack([jnp.all(jnp.isfinite(value)) for value in values.values()]))
    code = found.get(STATUS, jnp.where(whole, status.CONVERGED, status.UNDEFINED))
    columns = {column_of(name): value for name, value in values.items()}
    for i, key in enumerate(plan.gradients):
        slopes = {column_of(name, key): value[..., i] for name, value in by.items()}
        if twice := sorted(slopes.keys() & columns.keys()):
            raise axes_.SweepError(
                f"{shown(twice[0])}: this result is named as a derivative of another; name it otherwise"
            )
        columns |= slopes
    known = {name: jnp.where(code == status.CONVERGED, value, jnp.nan) for name, value in columns.items()}
    return known | {STATUS: code.astype(jnp.int8)}


def _block(plan: Plan, base: Any, values: list[jax.Array], block: jax.Array) -> dict[str, jax.Array]:
    """All members of one block, shape (size, …)."""
    layout = plan.layout
    at = [value[:, place] for value, place in zip(values, layout.places(block), strict=True)]
    if layout.size == 1:  # without vmap, under which both ways of a choice are computed
        one = _member(plan, base, [a.reshape(a.shape[:1]) for a in at])
        return {name: value[None] for name, value in one.items()}

    def member(at: list[jax.Array]) -> dict[str, jax.Array]:
        return _member(plan, base, at)

    for axis in reversed(range(layout.split, len(at))):
        member = jax.vmap(member, in_axes=([1 if i == axis else None for i in range(len(at))],))
    depth = len(at) - layout.split
    return {name: value.reshape(layout.size, *value.shape[depth:]) for name, value in member(at).items()}


def labelled(plan: Plan, columns: Mapping[str, np.ndarray], about: dict[str, Any] | None = None) -> Swept:
    """`Swept` of columns of all members, in their order."""
    counts = plan.layout.counts

    def shaped(name: str) -> np.ndarray:
        return columns[name].reshape(*counts, *columns[name].shape[1:])

    units = dict(plan.units) | {
        column_of(name, key): plan.unit(name, key) for name in plan.names for key in plan.gradients
    }
    return Swept(
        tuple(axis.name for axis in plan.axes),
        {key: values for axis in plan.axes for key, values in zip(axis.keys, axis.values, strict=True)},
        {name: shaped(name) for name in plan.names},
        {name: {key: shaped(column_of(name, key)) for key in plan.gradients} for name in plan.names},
        shaped(STATUS),
        units,
        own_dims(plan),
        about or {},
    )


def front(plan: Plan) -> tuple[Plan, np.ndarray]:
    """The plan of the first one or two axes with several values, of each at most `SHOWN`, all others at their middle,
    and the numbers of its members in the whole plan, rising."""
    many = [i for i, axis in enumerate(plan.axes) if axis.count > 1][:2] or [0]
    counts = plan.layout.counts
    places = [
        np.linspace(0, n - 1, min(n, SHOWN)).round().astype(int) if i in many else np.array([n // 2])
        for i, n in enumerate(counts)
    ]
    members = np.ravel_multi_index(np.ix_(*places), counts).ravel()
    kept = tuple(
        dataclasses.replace(axis, values=axis.values[:, place]) for axis, place in zip(plan.axes, places, strict=True)
    )
    return dataclasses.replace(plan, axes=kept), members


def own_dims(plan: Plan) -> dict[str, tuple[str, ...]]:
    """Names of the results' own dimensions."""
    return {
        name: plan.dims.get(name) or tuple(f"{name}_{i}" for i in range(len(plan.shapes[name].shape)))
        for name in plan.names
    }
