"""What is swept, and the program that computes it on devices or threads.

Blocks of members (`axes.Layout`) are computed one after another by `lax.map`, the members of one by `vmap` along one
axis after another, so that what an axis does not change is computed once. A chunk, which ends up in one file, is some
blocks in parts of equal size. Devices or threads take parts as they are free; their number changes no bit of a number.
"""

from __future__ import annotations

import dataclasses
import queue
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import SingleDeviceSharding

from difftrb.core import status
from difftrb.core.messages import shown
from difftrb.core.status import SweepError
from difftrb.sweeps.axes import Axis, Layout, number_at, replaced
from difftrb.sweeps.outputs import STATUS

PARTS, SHARE, MOST_MEMBERS = 16, 64, 2**17
"""Of a chunk: the parts it is computed in; which share of the sweep it is; members, at most (or so many blocks)."""
AHEAD = 2
"""Chunks that are computed while one is dealt with: no lane waits for the last part of a chunk."""
SHOWN = 500
"""Values of an axis in a figure, at most."""
OWN_NAMES = ("identity", "first", "about", "file", "allow_pickle", STATUS)
"""Names that results and keys cannot have: what stands beside them in files, and arguments of `np.savez`."""


def column_of(name: str, by: str | None = None) -> str:
    """Name under which a result, or its derivative by a key, is stored."""
    return name if by is None else f"{name}_by_{by}"


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is swept.

    Attributes:
      base: the scene, or any other tree of dataclasses, dicts and tuples. Members differ from it at the axes' keys.
      axes: see `Axis`.
      function: from a member to its results by name, arrays of any shape; one called `STATUS` is the member's status.
      gradients: keys by which every result is differentiated.
      units: of keys and results; one that is not there is without unit.
      dims: names of the results' own dimensions; default the result's name with a number.
      batch: members of a block, at most.
      title: what tells this sweep from others, beside the attributes here.
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
        return jax.eval_shape(lambda: _member(self, [jnp.asarray(axis.values[:, 0]) for axis in self.axes]))

    @cached_property
    def compute(self) -> Callable[[jax.Array, list[jax.Array]], dict[str, jax.Array]]:
        """The jitted program: from numbers of blocks, shape (n,), and the axes' values to columns, (n, size, …).

        The scene's numbers are constants in it: as arguments they cost up to twice the time.
        """

        def several(blocks: jax.Array, values: list[jax.Array]) -> dict[str, jax.Array]:
            return jax.lax.map(lambda block: _block(self, values, block), blocks)

        return jax.jit(several)

    @property
    def names(self) -> list[str]:
        """Of the results."""
        columns = {column_of(name, key) for name in self.shapes for key in self.gradients}
        return [name for name in self.shapes if name != STATUS and name not in columns]

    @property
    def own_dims(self) -> dict[str, tuple[str, ...]]:
        """Names of the results' own dimensions."""
        return {name: self.dims.get(name) or tuple(f"{name}_{i}" for i in range(len(self.shapes[name].shape)))
                for name in self.names}  # fmt: skip

    @property
    def all_units(self) -> dict[str, str]:
        """Units of keys and results, and of all derivatives."""
        return self.units | {
            column_of(name, key): f"{self.units.get(name, '') or '1'} per {self.units.get(key, '') or '1'}"
            for name in self.names
            for key in self.gradients
        }

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
        """Number of chunks."""
        return -(-self.layout.blocks // self.chunk)

    def members(self, chunk: int) -> tuple[int, int]:
        """The first member of a chunk and the one behind its last."""
        ends = chunk * self.chunk, min((chunk + 1) * self.chunk, self.layout.blocks)
        return self.layout.first(ends[0]), self.layout.first(ends[1])


def _member(plan: Plan, at: Sequence[jax.Array]) -> dict[str, jax.Array]:
    """Everything of one member by column; `at` holds the values of every axis's keys, each of shape (keys,)."""
    tree = plan.base
    for axis, values in zip(plan.axes, at, strict=True):
        for key, value in zip(axis.keys, values, strict=True):
            tree = replaced(tree, key, value)

    def both(numbers: jax.Array) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
        moved = tree
        for key, number in zip(plan.gradients, numbers, strict=True):
            moved = replaced(moved, key, number)
        found = {name: jnp.asarray(value) for name, value in plan.function(moved).items()}
        return {name: value.astype(float) for name, value in found.items() if name != STATUS}, found

    by: dict[str, jax.Array] = {}
    if plan.gradients:
        numbers = jnp.stack([jnp.asarray(number_at(tree, key), float) for key in plan.gradients])
        by, found = jax.jacfwd(both, has_aux=True)(numbers)
    else:
        found = both(jnp.zeros(0))[1]
    columns = {name: value for name, value in found.items() if name != STATUS}
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(value)) for value in columns.values()]))
    code = found.get(STATUS, jnp.where(finite, status.CONVERGED, status.UNDEFINED))
    for i, key in enumerate(plan.gradients):
        slopes = {column_of(name, key): value[..., i] for name, value in by.items()}
        if twice := sorted(slopes.keys() & columns.keys()):
            raise SweepError(f"{shown(twice[0])}: this result is named as a derivative of another; name it otherwise")
        columns |= slopes
    known = {name: jnp.where(code == status.CONVERGED, value, jnp.nan) for name, value in columns.items()}
    return known | {STATUS: code.astype(jnp.int8)}


def _block(plan: Plan, values: list[jax.Array], block: jax.Array) -> dict[str, jax.Array]:
    """All members of one block, shape (size, …)."""
    layout = plan.layout
    at = [value[:, place] for value, place in zip(values, layout.places(block), strict=True)]
    if layout.size == 1:  # without vmap, under which both branches of a choice are computed
        one = _member(plan, [a.reshape(a.shape[:1]) for a in at])
        return {name: value[None] for name, value in one.items()}

    def member(at: list[jax.Array]) -> dict[str, jax.Array]:
        return _member(plan, at)

    for axis in reversed(range(layout.split, len(at))):
        member = jax.vmap(member, in_axes=([1 if i == axis else None for i in range(len(at))],))
    depth = len(at) - layout.split
    return {name: value.reshape(layout.size, *value.shape[depth:]) for name, value in member(at).items()}


def front(plan: Plan) -> tuple[Plan, np.ndarray]:
    """The plan of the first one or two axes with several values, each of at most `SHOWN`, others at their middle.

    Also the numbers of its members in the whole plan, rising.
    """
    many = [i for i, axis in enumerate(plan.axes) if axis.count > 1][:2] or [0]
    counts = plan.layout.counts
    places = [np.linspace(0, n - 1, min(n, SHOWN)).round().astype(int) if i in many else np.array([n // 2])
              for i, n in enumerate(counts)]  # fmt: skip
    members = np.ravel_multi_index(np.ix_(*places), counts).ravel()
    kept = tuple(
        dataclasses.replace(axis, values=axis.values[:, place]) for axis, place in zip(plan.axes, places, strict=True)
    )
    return dataclasses.replace(plan, axes=kept), members


def check_names(plan: Plan) -> None:
    """Raise `SweepError` for names of results and keys that cannot stand in a file, or not beside each other."""
    keys = [key for axis in plan.axes for key in axis.keys]
    for name in (*keys, *(name for name in plan.shapes if name != STATUS)):
        if name in OWN_NAMES or not name.isprintable() or "/" in name or not name.strip("."):
            raise SweepError(f"{shown(name)}: cannot be a name in a file, or has a meaning there; name it otherwise")
    for name in plan.shapes:
        if name in keys:
            raise SweepError(f"{shown(name)}: this result is named as an axis; name it otherwise")
    for name in sorted({dim for own in plan.own_dims.values() for dim in own}):
        if name in keys:
            raise SweepError(f"{shown(name)}: this axis is named as a dimension of a result; name it otherwise")


class Program:
    """The program of a plan, compiled when first used, and the lanes it runs in: devices, or threads of one of them.

    Every call computes the same number of blocks by the same executable, whatever the number of lanes: XLA compiles a
    program for several devices differently, with other last bits.
    """

    def __init__(self, plan: Plan, lanes: Sequence[Any]) -> None:
        self.plan = plan
        values = [axis.values for axis in plan.axes]
        there = {lane: jax.device_put(values, SingleDeviceSharding(lane)) for lane in set(lanes)}
        self._free: queue.SimpleQueue[tuple[Any, list[jax.Array]]] = queue.SimpleQueue()
        for lane in lanes:
            self._free.put((lane, there[lane]))
        self._pool = ThreadPoolExecutor(len(lanes))

    def _call(self, part: int) -> dict[str, np.ndarray]:
        """The columns of one part of a chunk, numbered through all chunks, shape (blocks, size, …)."""
        plan = self.plan
        blocks = np.minimum(part * plan.part + np.arange(plan.part), plan.layout.blocks - 1)
        lane, values = self._free.get()
        try:
            found = plan.compute(jax.device_put(blocks, SingleDeviceSharding(lane)), values)
            return {name: np.asarray(array) for name, array in found.items()}
        finally:
            self._free.put((lane, values))

    def parts(self, numbers: Sequence[int]) -> None:
        """Compute some parts, on trial."""
        for running in [self._pool.submit(self._call, part) for part in numbers]:
            running.result()

    def scratch(self) -> int:
        """Bytes that a call takes while it runs, with its results."""
        lane, values = self._free.get()
        self._free.put((lane, values))
        needed = cast(Any, self.plan.compute).lower(np.arange(self.plan.part), values).compile().memory_analysis()
        return int(needed.temp_size_in_bytes + needed.output_size_in_bytes) if needed is not None else 0

    def start(self, chunk: int) -> Callable[[], dict[str, np.ndarray]]:
        """Begin to compute a chunk; what is returned waits for it, and gives its columns, shape (members, …)."""
        plan, layout = self.plan, self.plan.layout
        first = chunk * plan.chunk
        last = min(first + plan.chunk, layout.blocks)
        parts = range(first // plan.part, -(-last // plan.part))
        running = [self._pool.submit(self._call, part) for part in parts]
        sizes = [layout.first(block + 1) - layout.first(block) for block in range(first, last)]

        def finish() -> dict[str, np.ndarray]:
            found = [part.result() for part in running]
            columns = {name: np.concatenate([part[name] for part in found])[: len(sizes)] for name in found[0]}
            if min(sizes) == layout.size:
                return {name: array.reshape(-1, *array.shape[2:]) for name, array in columns.items()}
            return {name: np.concatenate([array[i, :size] for i, size in enumerate(sizes)])
                    for name, array in columns.items()}  # fmt: skip

        return finish

    def all(self, chunks: Sequence[int]) -> Generator[tuple[int, dict[str, np.ndarray]]]:
        """Columns chunk by chunk; the next one is computed while this one is dealt with."""
        waiting: list[tuple[int, Callable[[], dict[str, np.ndarray]]]] = []
        try:
            for chunk in chunks:
                waiting.append((chunk, self.start(chunk)))
                if len(waiting) > AHEAD:
                    number, finish = waiting.pop(0)
                    yield number, finish()
            for number, finish in waiting:
                yield number, finish()
        finally:  # of one that stopped early
            self._pool.shutdown(cancel_futures=True)
