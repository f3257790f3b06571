"""What accuracy costs in time: every way to a scene's stiffness, and to its single contact, timed on this machine and
compared with the finest of them."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp

from difftrb import clock, scenefile, store
from difftrb.choice import prepare
from difftrb.contact import COMPILING, solve_contact
from difftrb.contact_solution import ContactSolution
from difftrb.nodes import Progress
from difftrb.rungs import ALWAYS, RUNGS, Kind, Row, Rung, finer, finest, judged, recommended
from difftrb.scene import PitchMean, Scene
from difftrb.scenefile import SceneError, SceneFile
from difftrb.solving import solve
from difftrb.status import SolveError

BATCH = 256
LIMIT = 50.0
"""Seconds after which no further rung is begun, unless all are asked for: the last one begun takes its time."""
NO_TIME = "no time left after {:g} s; compiled programs are kept, so a second run gets further; --full measures all"


@dataclasses.dataclass(frozen=True)
class Measured:
    """All rungs of a scene.

    Attributes:
      rows: in the order of `RUNGS`. left_out: names of rungs that were not measured, and why.
      asked: accuracy of stiffness that `recommended` meets: the cheapest such rung, None if none does.
      finer: the cheapest law with at most half its error, None if there is none.
      yardstick: seconds of a fixed piece of work, see `clock.yardstick`; seconds by this compare across machines.
      device: name of what JAX computes on. cores: how many this process may use. seconds: the whole measurement.
      one_core: of the ring that is cheapest to make, how many times as long one scene of a batch takes on one core, by
        itself and with derivatives; None if that was not measured.
    """

    rows: tuple[Row, ...]
    left_out: dict[str, str]
    asked: float
    recommended: Row | None
    finer: Row | None
    yardstick: float
    device: str
    cores: int
    seconds: float
    one_core: tuple[float, float] | None = None

    def of(self, kind: Kind) -> list[Row]:
        """The rows of one kind, the cheapest first."""
        return sorted((row for row in self.rows if row.rung.kind == kind), key=lambda row: row.seconds)

    def truth(self, kind: Kind) -> Row | None:
        """What the others are compared with."""
        return finest(self.rows, kind)


def measure(
    file: SceneFile,
    path: str | Path = "scene",
    rungs: Sequence[Rung] = RUNGS,
    asked: float | None = None,
    limit: float = LIMIT,
    batch: int | None = None,
    progress: Progress | None = None,
    one_core: bool = False,
) -> Measured:
    """Measure every rung on a scene.

    Args:
      file: the scene, from `scenefile.read`; `path` names it in sentences.
      rungs: which; `FULL` has those that take minutes, too.
      asked: relative accuracy of stiffness to recommend a rung for; default `contact.accuracy`.
      limit: seconds after which no further rung is begun (after the first four). Default 50.
      batch: scenes of a batch, their radial load spread over a tenth; default 256.
      progress: told how many of how many rungs are done.
      one_core: whether a batch is also measured in a process that may use one core alone.

    Rungs that the scene cannot have are left out, with the reason. Raises SceneError if not even one can be had.
    """
    started = time.perf_counter()
    stick = clock.yardstick()
    batch = batch or BATCH
    rows: list[Row] = []
    left_out: dict[str, str] = {}
    rings: dict[int, Scene] = {}  # prepared, by the number of their row
    steps = len(rungs) + sum(rung.kind == "ring" for rung in rungs)

    def in_time(done: int, name: str) -> bool:
        if progress is not None:
            progress(done, steps)
        if done >= ALWAYS and time.perf_counter() - started > limit:
            left_out[name] = NO_TIME.format(limit)
            return False
        return True

    for done, rung in enumerate(rungs):
        if not in_time(done, f"{rung.kind} {rung.name}"):
            continue
        try:
            if rung.kind == "contact":
                rows.append(_on_contact(rung, file, path))
            else:
                row, rings[len(rows)] = _on_ring(rung, file, path, batch)
                rows.append(row)
        except (ValueError, SolveError) as error:
            left_out[f"{rung.kind} {rung.name}"] = str(error).removeprefix(f"{path}: ")
    for done, (i, ready) in enumerate(rings.items(), len(rungs)):  # last, for they take longest to compile
        if in_time(done, f"slopes of {rows[i].rung.name}"):
            rows[i] = _with_gradient(rows[i], ready, batch)
    if not rows:
        raise SceneError(f"{path}: no way to compute it could be measured: {next(iter(left_out.values()), 'none')}")
    slower = _on_one_core(rows, file, path, batch) if one_core else None
    if progress is not None:
        progress(steps, steps)
    compared = judged(rows)
    wanted = file.contact.accuracy if asked is None else asked
    best = recommended(compared, wanted)
    return Measured(
        tuple(compared), left_out, float(wanted), best, finer(compared, best), stick,
        jax.devices()[0].device_kind, clock.cores(), time.perf_counter() - started, slower,
    )  # fmt: skip


def _on_one_core(rows: Sequence[Row], file: SceneFile, path: str | Path, batch: int) -> tuple[float, float] | None:
    """See `Measured.one_core`. XLA takes its threads when it starts, so another process measures."""
    rings = [row for row in rows if row.rung.kind == "ring" and row.each_with_gradient > 0.0]
    if not rings or not hasattr(os, "sched_setaffinity"):
        return None
    here = min(rings, key=lambda row: row.again)
    environment = os.environ | {"JAX_ENABLE_X64": "1"}
    if (folder := jax.config.jax_compilation_cache_dir) is not None:  # type: ignore[attr-defined]
        environment["JAX_COMPILATION_CACHE_DIR"] = folder
    code = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); import difftrb.accuracy as a; a.pinned()"
    )
    there = subprocess.run(
        [sys.executable, "-c", code], env=environment, input=pickle.dumps((file, path, here.rung, batch)),
        capture_output=True, check=False,
    )  # fmt: skip
    if there.returncode != 0:
        return None
    each, each_with_gradient = json.loads(there.stdout)
    return each / here.each, each_with_gradient / here.each_with_gradient


def pinned() -> None:
    """The other process: reads what to measure, writes seconds."""
    file, path, rung, batch = pickle.load(sys.stdin.buffer)
    (row,) = measure(file, path, (rung,), batch=batch).rows
    print(json.dumps([row.each, row.each_with_gradient]))


def _on_ring(rung: Rung, file: SceneFile, path: str | Path, batch: int) -> tuple[Row, Scene]:
    """Prepare and solve the scene by one law; also the prepared scene."""
    file = dataclasses.replace(
        file, contact=dataclasses.replace(file.contact, law=cast(Any, rung.way), accuracy=rung.accuracy)
    )
    scenefile.check_ring(file, path)
    scene = file.scene()
    with _nothing_kept():
        started = time.perf_counter()
        ready = _of_one_program(prepare(scene))
        solution = jax.block_until_ready(solve(ready))
        first = time.perf_counter() - started
        started = time.perf_counter()
        jax.block_until_ready(prepare(scene))
        again = time.perf_counter() - started
    _, single = clock.timed(lambda: solve(ready))
    _, each = clock.timed(lambda: _batch(_spread(ready, batch), ready))
    top = int(jnp.argmax(solution.loads))
    values = {
        "approach": float(solution.approach[top]),
        "load": float(solution.loads[top]),
        "radial_stiffness": float(solution.radial_stiffness),
        "axial_stiffness": float(solution.axial_stiffness),
    }
    return Row(rung, first, again, single, each / batch, math.nan, clock.memory(), values, solution.status), ready


def _with_gradient(row: Row, ready: Scene, batch: int) -> Row:
    """The row with derivatives by the first spall's sizes and what they cost."""
    (_, slopes), seconds = clock.timed(lambda: _batch_with_gradient(_spread(ready, batch), ready))
    values = dict(row.values)
    if ready.spalls:
        values["by_length"] = float(slopes[0, 0])
        if isinstance(ready.phase, PitchMean):  # else it is a staircase under a hard window
            values["by_width"] = float(slopes[0, 1])
    return dataclasses.replace(row, each_with_gradient=seconds / batch, values=values, memory=clock.memory())


def _spread(ready: Scene, batch: int) -> jax.Array:
    """Radial loads [N], the scene's first; the others are less, so in equilibrium, too."""
    return ready.load.radial * (1.0 - 0.1 * jnp.arange(batch) / batch)


def _of_one_program(ready: Scene) -> Scene:
    """A prepared scene without the accuracy it was prepared with, which would only compile it once more."""
    return dataclasses.replace(ready, accuracy=1e-3)


def _radial(sizes: jax.Array, radial: jax.Array, ready: Scene) -> jax.Array:
    """Radial stiffness [N/mm] for the first spall's length and width [mm], or a factor on the load if healthy."""
    if ready.spalls:
        sized = dataclasses.replace(ready.spalls[0], length=sizes[0], width=sizes[1])
        ready = dataclasses.replace(ready, spalls=(sized, *ready.spalls[1:]))
    else:
        radial = radial * sizes[0]
    return solve(dataclasses.replace(ready, load=dataclasses.replace(ready.load, radial=radial))).radial_stiffness


def _sizes(ready: Scene) -> jax.Array:
    spall = ready.spalls[0] if ready.spalls else None
    return jnp.stack([jnp.asarray(v, float) for v in ((spall.length, spall.width) if spall else (1.0, 1.0))])


@partial(jax.jit, compiler_options=COMPILING)
def _batch(loads: jax.Array, ready: Scene) -> jax.Array:
    return jax.vmap(lambda radial: _radial(_sizes(ready), radial, ready))(loads)


@partial(jax.jit, compiler_options=COMPILING)
def _batch_with_gradient(loads: jax.Array, ready: Scene) -> tuple[jax.Array, jax.Array]:
    def one(radial: jax.Array) -> tuple[jax.Array, jax.Array]:
        def twice(sizes: jax.Array) -> tuple[jax.Array, jax.Array]:
            stiffness = _radial(sizes, radial, ready)
            return stiffness, stiffness

        slopes, stiffness = jax.jacfwd(twice, has_aux=True)(_sizes(ready))
        return stiffness, slopes

    return jax.vmap(one)(loads)


def _on_contact(rung: Rung, file: SceneFile, path: str | Path) -> Row:
    """Solve the single contact by one method."""
    file = dataclasses.replace(file, contact=dataclasses.replace(file.contact, accuracy=rung.accuracy))
    scenefile.check_contact(file, path)
    given = file.single_contact()

    def solved() -> ContactSolution:
        return solve_contact(**given, method=cast(Any, rung.way))

    started = time.perf_counter()
    solution = jax.block_until_ready(solved())
    first = time.perf_counter() - started
    _, single = clock.timed(solved)
    nan = math.nan
    return Row(
        rung, first, nan, single, nan, nan, clock.memory(), {"approach": float(solution.approach)}, solution.status
    )  # fmt: skip


@contextlib.contextmanager
def _nothing_kept() -> Iterator[None]:
    """Tables are made, not read from disk."""
    before, store.keeping = store.keeping, False
    try:
        yield
    finally:
        store.keeping = before
