"""Many scenes at once: the program for a chunk of members, laid out over devices, and results with labels.

Blocks of members (`axes.Layout`) are computed one after another by `lax.map`, the members of one by `vmap` along one
axis after another, so that what an axis does not change is computed once. A chunk, which ends up in one file, is some
blocks in parts of equal size, which devices or threads take as they are free. Their number changes no bit of a number.
"""

from __future__ import annotations

import dataclasses
import queue
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import SingleDeviceSharding

from difftrb import axes as axes_
from difftrb import outputs, status
from difftrb.axes import Axis, Layout, SweepError
from difftrb.devices import lanes_of
from difftrb.nodes import Progress
from difftrb.outputs import STATUS
from difftrb.scene import Scene
from difftrb.swept import Swept, column_of

BATCH = {"cpu": 1024, "gpu": 65536}
"""Members computed at once: on a busy CPU 240 to 4000 took the same time within noise (experiments/sweep_at_scale.py
--batch); a GPU wants more, how many was not measured."""
PARTS, SHARE, MOST_MEMBERS = 16, 64, 2**17
"""Of a chunk: the parts it is computed in; which share of the sweep it is; members, at most (or so many blocks)."""
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
        columns |= {column_of(name, key): value[..., i] for name, value in by.items()}
    known = {name: jnp.where(code == status.CONVERGED, value, jnp.nan) for name, value in columns.items()}
    return known | {STATUS: code.astype(jnp.int8)}


class Program:
    """The program of a plan, compiled when first used, and the lanes it runs in: devices, or threads of one of them.

    Every call computes the same number of blocks, whatever the number of lanes, by one and the same executable: XLA
    makes another one, with other last bits, of a program for several devices than of that for one.
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
            while waiting:
                number, finish = waiting.pop(0)
                yield number, finish()
        finally:  # of one that stopped early
            self._pool.shutdown(cancel_futures=True)


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


# ------------------------------------------------------------------------------------------------ results


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
    """The plan of the first one or two axes with several values, all others at their middle, and the numbers of its
    members in the whole plan, rising."""
    many = [i for i, axis in enumerate(plan.axes) if axis.count > 1][:2] or [0]
    counts = plan.layout.counts
    places = [np.arange(n) if i in many else np.array([n // 2]) for i, n in enumerate(counts)]
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


def planned(
    what: Callable[[Any], Any] | Sequence[str],
    base: Any,
    given: Mapping[str, Any],
    gradients: Sequence[str] = (),
    mode: str = "product",
    batch: int | None = None,
    progress: Progress | None = None,
) -> Plan:
    """A plan, checked, the roller law of a scene made once for all members; arguments and errors as in `sweep`."""
    status.require_float64()
    made = axes_.axes_of(given, mode)
    units = axes_.check(base, made, gradients)
    dims: dict[str, tuple[str, ...]] = {}
    if isinstance(base, Scene):
        base = outputs.prepared(base, made, gradients, progress)
    if callable(what):
        function, title = _by_name(what), getattr(what, "__qualname__", repr(what))
    else:
        names = [what] if isinstance(what, str) else list(what)
        function, title = outputs.of_scene(names), " ".join(names)
        units |= {name: outputs.RING[name].unit for name in names}
        dims = {name: outputs.RING[name].dims for name in names}
    return Plan(base, made, function, tuple(gradients), units, dims, _batch(made, batch), title)


def _by_name(function: Callable[[Any], Any]) -> Callable[[Any], dict[str, jax.Array]]:
    """The function with its result in a dict: "value", unless it is one."""

    def named(tree: Any) -> dict[str, jax.Array]:
        found = function(tree)
        return dict(found) if isinstance(found, Mapping) else {"value": found}

    return named


def _batch(made: Sequence[Axis], batch: int | None) -> int:
    """Members of a block: small sweeps have small ones, so that there are enough to share among devices."""
    if batch is None:
        members = Layout(tuple(axis.count for axis in made), 1).members
        return min(BATCH.get(jax.default_backend(), BATCH["gpu"]), max(1, members // SHARE))
    if not isinstance(batch, int) or batch < 1:
        raise SweepError(f"batch = {batch!r}: must be a whole number of at least 1")
    return batch


def sweep(
    what: Callable[[Any], Any] | Sequence[str],
    base: Any,
    axes: Mapping[str, Any],
    gradients: Sequence[str] = (),
    *,
    mode: str = "product",
    batch: int | None = None,
    devices: int | None = None,
    progress: Progress | None = None,
) -> Swept:
    """Compute a function of many scenes, all in memory; `difftrb.write_sweep` does the same into files.

    Args:
      what: names of results (`difftrb.outputs.RING`), or any function of a member that `jit` takes, returning an array
        or a dict of arrays; one called "status_code" is the member's status.
      base: a `Scene`; or, with a function, any tree of dataclasses, dicts and tuples.
      axes: values by dotted key, as in a scene file: {"spall.0.length": [1.0, 2.0], "load.axial": {"from": 4000.0,
        "to": 9000.0, "count": 64, "spacing": "log"}}.
      gradients: keys by which every result is differentiated, whether an axis or not; forward mode.
      mode: "product", all combinations, the last axis changing fastest; "zip", side by side.
      batch: members computed at once. Default: by the number of members and the platform. Give 1 for a function that
        chooses by `lax.cond` or iterates very differently from member to member, such as `solve_contact`.
      devices: how many of this process, or on a CPU how many threads. Default all.
      progress: told how many of how many members are done.

    The law of a scene is made once for all members. A member without a solution is NaN, its status says why. Raises
    `SweepError` for axes, keys or names that cannot be.
    """
    plan = planned(what, base, axes, gradients, mode, batch)
    columns: dict[str, list[np.ndarray]] = {}
    done = 0
    for _, found in Program(plan, lanes_of(devices)).all(range(plan.chunks)):
        for name, array in found.items():
            columns.setdefault(name, []).append(array)
        done += len(found[STATUS])
        if progress is not None:
            progress(done, plan.layout.members)
    return labelled(plan, {name: np.concatenate(arrays) for name, arrays in columns.items()})
