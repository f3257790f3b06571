"""What accuracy costs in time: every way to a scene's stiffness and to its single contact, timed on this machine."""

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
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp

from difftrb.accuracy import ladder
from difftrb.accuracy.ladder import ALWAYS, Measured, Row, Rung, Step, finer, judged, recommended, steps
from difftrb.contact.contact_solution import ContactSolution
from difftrb.contact.solver import on_lattice, solve_contact
from difftrb.core import machine
from difftrb.core.jax_config import jit_quickly
from difftrb.core.status import SceneError, SolveError
from difftrb.law.samples import Progress
from difftrb.scene import scene_file
from difftrb.scene.file_schema import SceneFile
from difftrb.scene.scene import PitchMean, Scene
from difftrb.scene.solving import prepare, solve

BATCH = 256
"""Scenes of a batch on the CPU."""
BATCH_THERE = 16384
"""Scenes of a batch on an accelerator, which needs many to be busy."""
LIMIT = 55.0
"""Seconds for all, unless all rungs are asked for: with starting and drawing a minute."""
NO_TIME = "no time left within {:g} s; compiled programs are kept, so a second run gets further; --full measures all"


@contextlib.contextmanager
def _on_cpu() -> Iterator[None]:
    """All that is not sent elsewhere is computed on the CPU."""
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        yield


@dataclasses.dataclass
class _Session:
    """Rungs of one scene while they are measured: arguments as in `measure`, and what was found."""

    file: SceneFile
    path: str | Path
    batch: int
    thorough: bool
    accelerator: Any
    rows: list[Row] = dataclasses.field(default_factory=list)
    left_out: dict[str, str] = dataclasses.field(default_factory=dict)
    rings: dict[Rung, tuple[int, Scene]] = dataclasses.field(default_factory=dict)  # number of the row, prepared scene

    def take(self, step: Step) -> None:
        """Measure one step. Raises `SceneError` or `SolveError` if the scene cannot have it."""
        if step.slopes:
            number, ready = self.rings[step.rung]
            self.rows[number] = with_gradient(self.rows[number], ready, self.batch)
        elif step.rung.kind == "contact":
            self.rows.append(on_contact(step.rung, self.file, self.path, self.thorough))
        else:
            row, ready = on_ring(step.rung, self.file, self.path, self.batch, self.accelerator)
            self.rings[step.rung] = len(self.rows), ready
            self.rows.append(row)

    def take_all(self, order: Sequence[Step], started: float, limit: float, progress: Progress | None) -> None:
        """Measure the steps that can be done within the limit."""
        begun, usual = time.perf_counter(), 0.0
        for done, step in enumerate(order):
            if progress is not None:
                progress(done, len(order))
            if step.slopes and step.rung not in self.rings:
                continue
            now = time.perf_counter()
            slower = (now - begun) / usual if usual else 0.0  # this machine, with what is compiled by now
            name = f"slopes of {step.rung.name}" if step.slopes else f"{step.rung.kind} {step.rung.name}"
            if done >= ALWAYS and now - started + slower * step.usual > limit:
                self.left_out[name] = NO_TIME.format(limit)
                continue
            try:
                self.take(step)
                usual += step.usual
            except (SceneError, SolveError) as error:
                self.left_out[name] = str(error).removeprefix(f"{self.path}: ")


@_on_cpu()
def measure(
    file: SceneFile,
    path: str | Path = "scene",
    rungs: Sequence[Rung] | None = None,
    asked: float | None = None,
    limit: float = LIMIT,
    batch: int | None = None,
    progress: Progress | None = None,
    thorough: bool = False,
) -> Measured:
    """Measure every rung on a scene.

    Args:
      file: the scene, from `scene_file.read`; `path` names it in sentences.
      rungs: which; default `ladder.rungs()`.
      asked: relative accuracy of stiffness to recommend a rung for; default `contact.accuracy`.
      limit: seconds. After the first four rungs, those that cannot finish by then are skipped and listed, judging by
        the time that others took here and usually take. Default 55.
      batch: scenes of a batch, their radial load spread over a tenth; default 256.
      progress: told how many of how many rungs are done.
      thorough: whether a batch is also measured on one core alone, in a process of its own, and contacts also on those
        with a known continuum solution. Default False.

    All is computed on the CPU; with an accelerator, batches are also computed there. Rungs that the scene cannot have
    are left out, with the reason. Raises SceneError if not even one can be had.
    """
    started = time.perf_counter()
    stick, importing, accelerator = machine.yardstick(), machine.importing(), machine.accelerator()
    session = _Session(file, path, batch or BATCH, thorough, accelerator)
    order = steps(ladder.rungs() if rungs is None else rungs)
    session.take_all(order, started, limit, progress)
    if not session.rows:
        why = next(iter(session.left_out.values()), "none")
        raise SceneError(f"{path}: no way to compute it could be measured: {why}")
    slower = _on_one_core(session) if thorough else None
    if progress is not None:
        progress(len(order), len(order))
    compared = judged(session.rows)
    wanted = file.contact.accuracy if asked is None else asked
    best = recommended(compared, wanted)
    return Measured(
        tuple(compared), session.left_out, float(wanted), best, finer(compared, best), stick,
        jax.local_devices(backend="cpu")[0].device_kind, machine.cores(), time.perf_counter() - started, importing,
        slower, None if accelerator is None else accelerator.device_kind,
    )  # fmt: skip


def _on_one_core(session: _Session) -> tuple[float, float] | None:
    """See `Measured.one_core`. XLA takes its threads when it starts, so another process measures."""
    rings = [row for row in session.rows if row.rung.kind == "ring" and row.each_with_gradient > 0.0]
    if not rings or not hasattr(os, "sched_setaffinity"):
        return None
    here = min(rings, key=lambda row: row.again)
    environment = os.environ | {"JAX_ENABLE_X64": "1"}
    if (folder := jax.config.jax_compilation_cache_dir) is not None:  # type: ignore[attr-defined]
        environment["JAX_COMPILATION_CACHE_DIR"] = folder
    code = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from difftrb.accuracy import timing; timing.pinned()"
    )
    task = pickle.dumps((session.file, session.path, here.rung, session.batch))
    there = subprocess.run([sys.executable, "-c", code], env=environment, input=task, capture_output=True, check=False)
    if there.returncode != 0:
        return None
    each, each_with_gradient = json.loads(there.stdout)
    return each / here.each, each_with_gradient / here.each_with_gradient


@_on_cpu()
def pinned() -> None:
    """The other process: reads what to measure, writes seconds."""
    file, path, rung, batch = pickle.load(sys.stdin.buffer)
    row = with_gradient(*on_ring(rung, file, path, batch), batch)
    print(json.dumps([row.each, row.each_with_gradient]))


# ------------------------------------------------------------------------------------------------ one way


def on_ring(rung: Rung, file: SceneFile, path: str | Path, batch: int, accelerator: Any = None) -> tuple[Row, Scene]:
    """The row of one law, from the scene and a batch of it (also on the `accelerator`), and the prepared scene."""
    file = dataclasses.replace(file, contact=dataclasses.replace(file.contact, law=cast(Any, rung.way), accuracy=1e-3))
    scene_file.check_ring(file, path)
    scene = dataclasses.replace(file.scene(), accuracy=rung.accuracy)  # to 1e-5, which a file may not ask for
    started = time.perf_counter()
    ready = dataclasses.replace(prepare(scene), accuracy=1e-3)  # another one would compile the same program again
    solution = jax.block_until_ready(solve(ready))
    first = time.perf_counter() - started
    started = time.perf_counter()
    jax.block_until_ready(prepare(scene))
    again = time.perf_counter() - started
    _, single = machine.timed(lambda: solve(ready))
    _, each = machine.timed(lambda: _batch(_spread(ready, batch), ready))
    there = math.nan
    if accelerator is not None:
        own = jax.device_put((_spread(ready, BATCH_THERE), ready), accelerator)
        there = machine.timed(lambda: _batch(*own))[1] / BATCH_THERE
    top = int(jnp.argmax(solution.loads))
    values = {
        "approach": float(solution.approach[top]),
        "load": float(solution.loads[top]),
        "radial_stiffness": float(solution.radial_stiffness),
        "axial_stiffness": float(solution.axial_stiffness),
    }
    row = Row(
        rung, first, again, single, each / batch, math.nan, machine.memory(), values, solution.status, there=there
    )
    return row, ready


def with_gradient(row: Row, ready: Scene, batch: int) -> Row:
    """The row with derivatives by the first spall's sizes and what they cost."""
    (_, slopes), seconds = machine.timed(lambda: _batch_with_gradient(_spread(ready, batch), ready))
    values = dict(row.values)
    if ready.spalls:
        values["by_length"] = float(slopes[0, 0])
        if isinstance(ready.phase, PitchMean):  # at one phase the hard window makes it a staircase
            values["by_width"] = float(slopes[0, 1])
    return dataclasses.replace(row, each_with_gradient=seconds / batch, values=values, memory=machine.memory())


def _spread(ready: Scene, batch: int) -> jax.Array:
    """Radial loads [N], shape (batch,): the scene's and smaller ones, which are in equilibrium, too."""
    return ready.load.radial * (1.0 - 0.1 * jnp.arange(batch) / batch)


def _radial(sizes: jax.Array, radial: jax.Array, ready: Scene) -> jax.Array:
    """Radial stiffness [N/mm] for length and width of the first spall [mm]; for a factor on the load if healthy."""
    if ready.spalls:
        sized = dataclasses.replace(ready.spalls[0], length=sizes[0], width=sizes[1])
        ready = dataclasses.replace(ready, spalls=(sized, *ready.spalls[1:]))
    else:
        radial = radial * sizes[0]
    return solve(dataclasses.replace(ready, load=dataclasses.replace(ready.load, radial=radial))).radial_stiffness


def _sizes(ready: Scene) -> jax.Array:
    spall = ready.spalls[0] if ready.spalls else None
    return jnp.stack([jnp.asarray(v, float) for v in ((spall.length, spall.width) if spall else (1.0, 1.0))])


@jit_quickly()
def _batch(loads: jax.Array, ready: Scene) -> jax.Array:
    return jax.vmap(lambda radial: _radial(_sizes(ready), radial, ready))(loads)


@jit_quickly()
def _batch_with_gradient(loads: jax.Array, ready: Scene) -> tuple[jax.Array, jax.Array]:
    def one(radial: jax.Array) -> tuple[jax.Array, jax.Array]:
        def twice(sizes: jax.Array) -> tuple[jax.Array, jax.Array]:
            stiffness = _radial(sizes, radial, ready)
            return stiffness, stiffness

        slopes, stiffness = jax.jacfwd(twice, has_aux=True)(_sizes(ready))
        return stiffness, slopes

    return jax.vmap(one)(loads)


def on_contact(rung: Rung, file: SceneFile, path: str | Path, known: bool = False) -> Row:
    """The row of one method for the single contact; with `known` also of contacts with a known continuum solution."""
    file = dataclasses.replace(file, contact=dataclasses.replace(file.contact, accuracy=rung.accuracy))
    scene_file.check_contact(file, path)
    given = file.single_contact()

    started = time.perf_counter()
    solution = jax.block_until_ready(_pressed(rung, **given))
    first = time.perf_counter() - started
    _, single = machine.timed(lambda: _pressed(rung, **given))
    off = math.nan
    if known:
        off = ladder.worst_error(lambda t: float(_pressed(
            rung, contact=ladder.CONTACT, load=t.load, spall=t.spall, offset=t.offset, accuracy=rung.accuracy
        ).approach))  # fmt: skip
    nan = math.nan
    return Row(
        rung, first, nan, single, nan, nan, machine.memory(), {"approach": float(solution.approach)}, solution.status,
        continuum=off,
    )  # fmt: skip


def _pressed(rung: Rung, **given: Any) -> ContactSolution:
    if rung.size is not None:
        return on_lattice(rung.size, **given)
    return solve_contact(**given, method=cast(Any, rung.way))
