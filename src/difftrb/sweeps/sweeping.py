"""Many scenes at once: a plan's chunks computed by devices or threads.

A chunk, which ends up in one file, is some blocks in parts of equal size, which devices or threads take as they are
free. Their number changes no bit of a number.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import SingleDeviceSharding

from difftrb.core import status
from difftrb.core.machine import lanes_of
from difftrb.core.status import SweepError
from difftrb.law.samples import Progress
from difftrb.scene import checks
from difftrb.scene.scene import Scene
from difftrb.sweeps import axes as axes_
from difftrb.sweeps import outputs, sizes
from difftrb.sweeps.axes import Axis, Layout
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.plan import AHEAD, MOST_MEMBERS, SHARE, Plan, labelled
from difftrb.sweeps.sweep_result import Swept

BATCH = {"cpu": 1024, "gpu": 65536}
"""Members computed at once: on a busy CPU 240 to 4000 took the same time within noise (experiments/sweep_at_scale.py
--batch); a GPU wants more, how many was not measured."""


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
    results = 1 if callable(what) or isinstance(what, str) else len(what)
    sizes.check_members((axis.count for axis in made), results * (1 + len(gradients)))
    if isinstance(base, Scene):
        checks.refuse(base)
    units = axes_.check(base, made, gradients)
    dims: dict[str, tuple[str, ...]] = {}
    if isinstance(base, Scene):
        _check_ends(base, made)
        base = outputs.prepared(base, made, gradients, progress)
    if callable(what):
        function, title = _by_name(what), getattr(what, "__qualname__", repr(what))
    else:
        names = [what] if isinstance(what, str) else list(what)
        function, title = outputs.of_scene(names), " ".join(names)
        units |= {name: outputs.RING[name].unit for name in names}
        dims = {name: outputs.RING[name].dims for name in names}
    return Plan(base, made, function, tuple(gradients), units, dims, _batch(made, batch), title)


def _check_ends(scene: Scene, made: Sequence[Axis]) -> None:
    """Refuse members at an end of an axis that could not be had alone."""
    for axis in made:
        for k in {int(place) for values in axis.values for place in (values.argmin(), values.argmax())}:
            member = scene
            for key, values in zip(axis.keys, axis.values, strict=True):
                member = axes_.replaced(member, key, float(values[k]))
            if (sentence := checks.wrong(member)) is not None:
                raise SweepError(sentence)


def _by_name(function: Callable[[Any], Any]) -> Callable[[Any], dict[str, jax.Array]]:
    """The function with its result in a dict: "value", unless it is one."""

    def named(tree: Any) -> dict[str, jax.Array]:
        found = function(tree)
        results = dict(found) if isinstance(found, Mapping) else {"value": found}
        if not any(jnp.asarray(value).size for name, value in results.items() if name != STATUS):
            raise SweepError("the function returns no number; return an array, or a dict of arrays")
        return results

    return named


def _batch(made: Sequence[Axis], batch: int | None) -> int:
    """Members of a block: small sweeps have small ones, so that there are enough to share among devices."""
    if batch is None:
        members = Layout(tuple(axis.count for axis in made), 1).members
        return min(BATCH.get(jax.default_backend(), BATCH["gpu"]), max(1, members // SHARE))
    if not isinstance(batch, int) or not 1 <= batch <= MOST_MEMBERS:
        raise SweepError(f"batch = {batch!r}: must be a whole number in 1 … {MOST_MEMBERS}")
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

    The law of a scene is made once for all members; "auto" chooses it by some of them (`difftrb.outputs.prepared`), and
    `scene.picked` of the plan says which. A member without a solution is NaN, its status says why. Raises
    `SweepError` for axes, keys or names that cannot be, for ends of axes that no scene may have, and before anything is
    computed if the results do not fit into the memory that is free; `SceneError` for a scene that `solve` would refuse.
    More than 1e12 members are refused everywhere.
    """
    plan = planned(what, base, axes, gradients, mode, batch)
    sizes.check_memory(plan)
    columns = {name: np.empty((plan.layout.members, *shape.shape), shape.dtype) for name, shape in plan.shapes.items()}
    done = 0
    for _, found in Program(plan, lanes_of(devices)).all(range(plan.chunks)):
        members = len(found[STATUS])
        for name, array in found.items():
            columns[name][done : done + members] = array
        done += members
        if progress is not None:
            progress(done, plan.layout.members)
    return labelled(plan, columns)
