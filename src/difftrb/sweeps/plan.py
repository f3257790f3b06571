"""What is swept, and the program that computes it on devices or threads.

Blocks of members (`blocks`) are computed one after another by `lax.map`, the members of one by `vmap` along
one axis after another, so that what an axis does not change is computed once. A chunk, which is stored as one, is a box
of blocks, computed by calls of equally many. Devices or threads take calls as they are free; their number changes no
bit.
"""

from __future__ import annotations

import dataclasses
import math
import queue
import threading
import uuid
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from itertools import islice
from typing import Any
from weakref import WeakValueDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import SingleDeviceSharding

from difftrb.core import jax_config, status, traced_programs
from difftrb.core.input_errors import shown
from difftrb.core.status import SweepError
from difftrb.sweeps import blocks
from difftrb.sweeps.axes import Axis, number_at, replaced
from difftrb.sweeps.blocks import Grid, up
from difftrb.sweeps.outputs import STATUS


def column_of(name: str, by: str) -> str:
    """Name under which a result's derivative by a key is stored."""
    return f"{name}_by_{by}"


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What is swept; it can be sent to other processes by cloudpickle, which Dask, Ray and Parsl use.

    Attributes:
      base: the scene, or any other tree of dataclasses, dicts and tuples. Members differ from it at the axes' keys.
      axes: see `Axis`.
      function: from a member to its results by name, arrays of any shape; one called `STATUS` is the member's status.
      gradients: keys by which every result is differentiated.
      units: of keys and results; one that is not there is without unit.
      dims: names of the results' own dimensions; default the result's name with a number.
      batch: members of a block, at most.
      title: what tells this sweep from others, beside the attributes here. text: of its scene file.
      token: tells this plan from others, also in other processes.
    """

    base: Any
    axes: tuple[Axis, ...]
    function: Callable[[Any], dict[str, jax.Array]]
    gradients: tuple[str, ...]
    units: dict[str, str]
    dims: dict[str, tuple[str, ...]]
    batch: int
    title: str = ""
    text: str = ""
    token: str = dataclasses.field(default_factory=lambda: uuid.uuid4().hex, init=False)

    @property
    def counts(self) -> tuple[int, ...]:
        """Values of every axis."""
        return tuple(axis.count for axis in self.axes)

    @property
    def members(self) -> int:
        """Number of members."""
        return math.prod(self.counts)

    @cached_property
    def blocks(self) -> Grid:
        """What is computed at once. Depends on axes and `batch` alone, as the numbers' last bits do."""
        return Grid.of(self.counts, self.batch)

    @cached_property
    def grid(self) -> Grid:
        """The chunks."""
        most = max(blocks.CALLS * self.blocks.size, min(self.members // blocks.CHUNKS, blocks.LARGEST_CHUNK))
        return Grid.of(self.counts, most, self.blocks.shape)

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return self.grid.number

    @cached_property
    def call(self) -> int:
        """Blocks that one call of the program computes."""
        return up(math.prod(map(up, self.grid.shape, self.blocks.shape)), blocks.CALLS)

    @property
    def arguments(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Such as `compute` is given."""
        return np.arange(self.call), [axis.values for axis in self.axes]

    @cached_property
    def shapes(self) -> dict[str, jax.ShapeDtypeStruct]:
        """Of one member's results by column."""
        whole = jax.eval_shape(self.compute, *self.arguments)
        return {name: jax.ShapeDtypeStruct(shape.shape[2:], shape.dtype) for name, shape in whole.items()}

    @cached_property
    def compute(self) -> Callable[[Any, Any], dict[str, jax.Array]]:
        """The jitted program: from numbers of blocks, shape (n,), and the axes' values to columns, (n, size, …).

        The scene's numbers are constants in it: as arguments they cost up to twice the time.
        """

        def several(blocks: jax.Array, values: list[jax.Array]) -> dict[str, jax.Array]:
            return jax.lax.map(lambda block: _block(self, values, block), blocks)

        depends = (several.__qualname__, self.base, self.function, self.gradients, self.batch,
                   [(axis.keys, axis.values.shape) for axis in self.axes])  # fmt: skip
        return traced_programs.jit_kept(several, depends, jax_config.quick(), *self.arguments)

    def __reduce__(self) -> Any:
        """Numbers stay float64 wherever a plan is sent, and one that comes twice is there once, compiled once."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.init}
        cached = jax.config.jax_compilation_cache_dir is not None  # type: ignore[attr-defined]
        return _arrived, (_Ready(cached), self.token, fields)


@dataclasses.dataclass
class _Ready:
    """Sets up JAX in the process that unpickles it, before what is pickled behind it."""

    cache: bool

    def __reduce__(self) -> Any:
        return jax_config.set_up_jax, (self.cache,)


_HERE: WeakValueDictionary[str, Plan] = WeakValueDictionary()
"""Plans that came from other processes."""


def _arrived(_: None, token: str, fields: dict[str, Any]) -> Plan:
    return _HERE.get(token) or _HERE.setdefault(token, Plan(**fields))


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
        # jacfwd would put the whole program, of which nothing is mapped, through one more vmap
        _, moved, found = jax.linearize(both, numbers, has_aux=True)
        by = jax.vmap(moved, out_axes=-1)(jnp.eye(len(numbers)))
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
    grid = plan.blocks
    at = [value[:, place] for value, place in zip(values, grid.values(block), strict=True)]
    if grid.size == 1:  # without vmap, under which both branches of a choice are computed
        one = _member(plan, [a.reshape(a.shape[:1]) for a in at])
        return {name: value[None] for name, value in one.items()}

    def member(at: list[jax.Array]) -> dict[str, jax.Array]:
        return _member(plan, at)

    for axis in reversed(range(grid.split, len(at))):
        member = jax.vmap(member, in_axes=([1 if i == axis else None for i in range(len(at))],))
    depth = len(at) - grid.split
    return {name: value.reshape(grid.size, *value.shape[depth:]) for name, value in member(at).items()}


class Program:
    """The program of a plan, compiled when first used, and the lanes it runs in: devices, or threads of one of them.

    Every call computes the same number of blocks by the same executable, whatever the number of lanes: XLA compiles a
    program for several devices differently, with other last bits. Several threads may ask for chunks.
    """

    def __init__(self, plan: Plan, lanes: Sequence[Any]) -> None:
        values = [axis.values for axis in plan.axes]
        there = {lane: jax.device_put(values, SingleDeviceSharding(lane)) for lane in set(lanes)}
        self.plan, self._own, free = plan, threading.local(), [(lane, there[lane]) for lane in lanes]

        def begin() -> None:
            self._own.lane = free.pop()

        self._pool = ThreadPoolExecutor(len(lanes), initializer=begin)

    def _call(self, first: int) -> dict[str, np.ndarray]:
        """The columns of some blocks, shape (blocks, size, …); behind the last one, that one again."""
        blocks = np.minimum(first + np.arange(self.plan.call), self.plan.blocks.number - 1)
        lane, values = self._own.lane
        found = self.plan.compute(jax.device_put(blocks, SingleDeviceSharding(lane)), values)
        return {name: np.asarray(array) for name, array in found.items()}

    def calls(self, blocks: Iterable[int]) -> list[dict[str, np.ndarray]]:
        """Make calls that begin at these blocks."""
        return list(self._pool.map(self._call, blocks))

    def chunk(self, number: int) -> dict[str, np.ndarray]:
        """Compute a chunk: its columns, shape (members, …)."""
        grid = self.plan.blocks
        blocks = grid.within(self.plan.grid.slices(number))
        found = self.calls(blocks[:: self.plan.call])
        inside = np.arange(grid.size) < grid.held(np.asarray(blocks))[:, None]
        return {name: np.concatenate([call[name] for call in found])[: len(blocks)][inside] for name in found[0]}

    def in_turn(self, deal: Callable[[int], Any], chunks: Iterable[int]) -> Generator[Any]:
        """What `deal` gives for every chunk, as they finish, a few at once in threads. A program serves one of these:
        its lanes end with it."""
        with ThreadPoolExecutor(blocks.CHUNKS_AT_ONCE) as threads:
            try:
                yield from in_turn(partial(threads.submit, deal), chunks, blocks.CHUNKS_AT_ONCE)
            finally:  # of a sweep that stopped early
                threads.shutdown(wait=False, cancel_futures=True)
                self._pool.shutdown(cancel_futures=True)


def in_turn(
    submit: Callable[[int], Any], chunks: Iterable[int], many: int, alive: Callable[[], None] = lambda: None
) -> Generator[Any]:
    """Submit chunks, `many` at once, and give what each comes to, as they finish. While none does, ask `alive`."""
    finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
    left, running = iter(chunks), 0
    while True:
        for chunk in islice(left, many - running):
            submit(chunk).add_done_callback(finished.put)
            running += 1
        if not running:
            return
        try:
            ended = finished.get(timeout=1.0)
        except queue.Empty:
            alive()
            continue
        running -= 1
        yield ended.result()
