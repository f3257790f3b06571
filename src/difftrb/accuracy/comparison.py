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
from pathlib import Path

import jax

from difftrb.accuracy import timing
from difftrb.accuracy.ladder import ALWAYS, RUNGS, Kind, Row, Rung, Step, finer, finest, judged, recommended, steps
from difftrb.core import machine
from difftrb.core.status import SolveError
from difftrb.law.samples import Progress
from difftrb.scene.scene import Scene
from difftrb.scene.scene_file import SceneError, SceneFile

BATCH = 256
LIMIT = 55.0
"""Seconds within which all is to be done, unless all rungs are asked for; starting and drawing take the others of a
minute."""
NO_TIME = "no time left within {:g} s; compiled programs are kept, so a second run gets further; --full measures all"


@dataclasses.dataclass(frozen=True)
class Measured:
    """All rungs of a scene.

    Attributes:
      rows: in the order in which they were measured. left_out: names of rungs that were not measured, and why.
      asked: accuracy of stiffness that `recommended` meets: the cheapest such rung, None if none does.
      finer: the cheapest law with at most half its error, None if there is none.
      yardstick: seconds of a fixed piece of work, see `machine.yardstick`; seconds by this compare across machines.
      device: name of the CPU. cores: how many this process may use. seconds: the whole measurement.
      importing: see `machine.importing`.
      one_core: of the ring that is cheapest to make, how many times as long one scene of a batch takes on one core, by
        itself and with derivatives; None if that was not measured.
      accelerator: name of what `Row.there` was measured on; None without one.
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
    importing: float = math.nan
    one_core: tuple[float, float] | None = None
    accelerator: str | None = None

    def of(self, kind: Kind) -> list[Row]:
        """The rows of one kind, the cheapest first."""
        return sorted((row for row in self.rows if row.rung.kind == kind), key=lambda row: row.seconds)

    def truth(self, kind: Kind) -> Row | None:
        """What the others are compared with."""
        return finest(self.rows, kind)


@contextlib.contextmanager
def _on_cpu() -> Iterator[None]:
    """All that is not sent elsewhere is computed on the CPU."""
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        yield


@_on_cpu()
def measure(
    file: SceneFile,
    path: str | Path = "scene",
    rungs: Sequence[Rung] = RUNGS,
    asked: float | None = None,
    limit: float = LIMIT,
    batch: int | None = None,
    progress: Progress | None = None,
    thorough: bool = False,
) -> Measured:
    """Measure every rung on a scene.

    Args:
      file: the scene, from `scene_file.read`; `path` names it in sentences.
      rungs: which; `FULL` has those that take minutes, too.
      asked: relative accuracy of stiffness to recommend a rung for; default `contact.accuracy`.
      limit: seconds; what would not be done by then is not begun (after the first four rungs), judging by what others
        took here and usually take. Default 55.
      batch: scenes of a batch, their radial load spread over a tenth; default 256.
      progress: told how many of how many rungs are done.
      thorough: whether a batch is also measured in a process that may use one core alone, and ways to solve a contact
        also on contacts with a known continuum solution. Default False.

    All is computed on the CPU; if there is an accelerator, batches are also computed there. Rungs that the scene cannot
    have are left out, with the reason. Raises SceneError if not even one can be had.
    """
    started = time.perf_counter()
    batch = batch or BATCH
    stick = machine.yardstick()
    importing, accelerator = machine.importing(), machine.accelerator()
    rows: list[Row] = []
    left_out: dict[str, str] = {}
    rings: dict[Rung, tuple[int, Scene]] = {}  # number of the row, and the prepared scene
    order, begun, usual = steps(rungs), time.perf_counter(), 0.0

    def in_time(done: int, step: Step) -> bool:
        now = time.perf_counter()
        slower = (now - begun) / usual if usual else 0.0  # this machine, with what is compiled by now
        return done < ALWAYS or now - started + slower * step.usual <= limit

    for done, step in enumerate(order):
        rung = step.rung
        if progress is not None:
            progress(done, len(order))
        if step.slopes and rung not in rings:
            continue
        name = f"slopes of {rung.name}" if step.slopes else f"{rung.kind} {rung.name}"
        if not in_time(done, step):
            left_out[name] = NO_TIME.format(limit)
            continue
        try:
            if step.slopes:
                number, ready = rings[rung]
                rows[number] = timing.with_gradient(rows[number], ready, batch)
            elif rung.kind == "contact":
                rows.append(timing.on_contact(rung, file, path, thorough))
            else:
                row, ready = timing.on_ring(rung, file, path, batch, accelerator)
                rings[rung] = len(rows), ready
                rows.append(row)
            usual += step.usual
        except (ValueError, SolveError) as error:
            left_out[name] = str(error).removeprefix(f"{path}: ")
    if not rows:
        raise SceneError(f"{path}: no way to compute it could be measured: {next(iter(left_out.values()), 'none')}")
    slower = _on_one_core(rows, file, path, batch) if thorough else None
    if progress is not None:
        progress(len(order), len(order))
    compared = judged(rows)
    wanted = file.contact.accuracy if asked is None else asked
    best = recommended(compared, wanted)
    return Measured(
        tuple(compared), left_out, float(wanted), best, finer(compared, best), stick,
        jax.local_devices(backend="cpu")[0].device_kind, machine.cores(), time.perf_counter() - started, importing,
        slower, None if accelerator is None else accelerator.device_kind,
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
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from difftrb.accuracy import comparison; comparison.pinned()"
    )
    there = subprocess.run(
        [sys.executable, "-c", code], env=environment, input=pickle.dumps((file, path, here.rung, batch)),
        capture_output=True, check=False,
    )  # fmt: skip
    if there.returncode != 0:
        return None
    each, each_with_gradient = json.loads(there.stdout)
    return each / here.each, each_with_gradient / here.each_with_gradient


@_on_cpu()
def pinned() -> None:
    """The other process: reads what to measure, writes seconds."""
    file, path, rung, batch = pickle.load(sys.stdin.buffer)
    row = timing.with_gradient(*timing.on_ring(rung, file, path, batch), batch)
    print(json.dumps([row.each, row.each_with_gradient]))
