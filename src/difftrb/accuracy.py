"""What accuracy costs in time: every way to a scene's stiffness, and to its single contact, timed on this machine and
compared with the finest of them."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

import jax
import jax.numpy as jnp

from difftrb import clock, scenefile, store
from difftrb.contact import COMPILING, solve_contact
from difftrb.contact_solution import ContactSolution
from difftrb.nodes import Progress
from difftrb.preparation import prepare
from difftrb.scene import PitchMean, Scene
from difftrb.scenefile import SceneError, SceneFile
from difftrb.solution import solve
from difftrb.status import SolveError

Kind = Literal["ring", "contact"]

BATCH = 256
LIMIT = 50.0
"""Seconds after which no further rung is begun, unless all are asked for: the last one begun takes its time."""
STIFFNESS = ("radial_stiffness", "axial_stiffness")
"""What a rung is recommended by."""
NO_TIME = "no time left after {:g} s; compiled programs are kept, so a second run gets further; --full measures all"


@dataclasses.dataclass(frozen=True)
class Rung:
    """One way to compute: for the ring a law, for the single contact a method, each with an accuracy [-]."""

    kind: Kind
    way: str
    accuracy: float

    @property
    def name(self) -> str:
        """Way and, where it has one, accuracy."""
        return self.way if self.way in ("palmgren", "liu2018") else f"{self.way} {_short(self.accuracy)}"


def _short(accuracy: float) -> str:
    return f"{accuracy:.0e}".replace("e-0", "e-")


# In the order in which they are measured: first what is quick, the truth and what it is known to; last what is slow.
RUNGS = (
    Rung("ring", "liu2018", 1e-3), Rung("ring", "palmgren", 1e-3), Rung("ring", "direct", 1e-3),
    Rung("ring", "direct", 1e-4), Rung("ring", "power", 1e-3), Rung("contact", "strips", 1e-3),
    Rung("contact", "strips", 1e-4), Rung("contact", "cells", 1e-2), Rung("contact", "cells", 1e-3),
    Rung("contact", "lattice", 1e-2), Rung("contact", "strips", 1e-2), Rung("ring", "power", 1e-2),
    Rung("contact", "cells", 1e-4), Rung("ring", "direct", 1e-2), Rung("ring", "table", 1e-3),
)  # fmt: skip
ALWAYS = 4
"""How many of them are measured however long it takes."""
FULL = (*RUNGS, Rung("contact", "strips", 1e-5), Rung("ring", "table", 1e-4))


@dataclasses.dataclass(frozen=True)
class Row:
    """A rung as measured.

    Attributes:
      first: seconds to the first result in this process, with all compiling that no rung before had done.
      again: of these, seconds to prepare the law once compiled; nothing is read from disk. NaN for a contact.
      single: seconds to solve once more. each, each_with_gradient: seconds per scene of a batch, stiffness alone and
        with its derivatives by the first spall's length and width (by the load if healthy). NaN for a contact.
      memory: largest of the process so far [MiB], NaN where the system does not tell.
      values: what came out, by name [N, mm].
      errors: of these, relative to the finest rung of the kind [-]; the finest one's own are the difference from the
        second finest. Filled in by `judged`.
      status: a sentence; "converged".
    """

    rung: Rung
    first: float
    again: float
    single: float
    each: float
    each_with_gradient: float
    memory: float
    values: dict[str, float]
    status: str
    errors: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """For one new scene or contact, everything compiled."""
        return self.single + (self.again if math.isfinite(self.again) else 0.0)

    @property
    def error(self) -> float:
        """Of stiffness, the larger of radial and axial; of a contact, that of the approach."""
        names = STIFFNESS if self.rung.kind == "ring" else ("approach",)
        known = [self.errors[name] for name in names if math.isfinite(self.errors.get(name, math.nan))]
        return max(known) if known else math.nan


@dataclasses.dataclass(frozen=True)
class Measured:
    """All rungs of a scene.

    Attributes:
      rows: in the order of `RUNGS`. left_out: names of rungs that were not measured, and why.
      asked: accuracy of stiffness that `recommended` meets: the cheapest such rung, None if none does.
      finer: the cheapest law with at most half its error, None if there is none.
      yardstick: seconds of a fixed piece of work, see `clock.yardstick`; seconds by this compare across machines.
      device: name of what JAX computes on. cores: how many this process may use. seconds: the whole measurement.
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
) -> Measured:
    """Measure every rung on a scene.

    Args:
      file: the scene, from `scenefile.read`; `path` names it in sentences.
      rungs: which; `FULL` has those that take minutes, too.
      asked: relative accuracy of stiffness to recommend a rung for; default `contact.accuracy`.
      limit: seconds after which no further rung is begun (after the first four). Default 50.
      batch: scenes of a batch, their radial load spread over a tenth; default 256.
      progress: told how many of how many rungs are done.

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
    if progress is not None:
        progress(steps, steps)
    compared = judged(rows)
    wanted = file.contact.accuracy if asked is None else asked
    best = recommended(compared, wanted)
    return Measured(
        tuple(compared), left_out, float(wanted), best, finer(compared, best), stick,
        jax.devices()[0].device_kind, clock.cores(), time.perf_counter() - started,
    )  # fmt: skip


def finest(rows: Sequence[Row], kind: Kind) -> Row | None:
    """The row of the most exact way to solve: `direct` for the ring; strips, else cells, for the contact."""
    return next(iter(_by_fineness(rows, kind)), None)


def _by_fineness(rows: Sequence[Row], kind: Kind) -> list[Row]:
    own = [row for row in rows if row.rung.kind == kind and row.status == "converged"]
    for way in ("direct",) if kind == "ring" else ("strips", "cells", "lattice"):
        if solved := [row for row in own if row.rung.way == way]:
            return sorted(solved, key=lambda row: row.rung.accuracy)
    return []


def judged(rows: Sequence[Row]) -> list[Row]:
    """The rows with their errors; NaN where there is nothing to compare with."""
    result = []
    for row in rows:
        other = next((one for one in _by_fineness(rows, row.rung.kind) if one is not row), None)
        known = {} if other is None else other.values
        errors = {name: _apart(value, known.get(name, math.nan)) for name, value in row.values.items()}
        result.append(dataclasses.replace(row, errors=errors))
    return result


def _apart(value: float, truth: float) -> float:
    return abs(value / truth - 1.0) if truth and math.isfinite(value) and math.isfinite(truth) else math.nan


def recommended(rows: Sequence[Row], asked: float) -> Row | None:
    """The cheapest ring whose stiffness meets an accuracy, of rows with errors.

    None unless the truth is known that well, too: so a true error is at most twice what was asked.
    """
    truth = finest(rows, "ring")
    if truth is None or not truth.error <= asked:
        return None
    good = [row for row in rows if row.rung.kind == "ring" and row.status == "converged" and row.error <= asked]
    return min(good, key=lambda row: row.seconds)


def finer(rows: Sequence[Row], best: Row | None) -> Row | None:
    """The cheapest ring with at most half the recommended one's error; the truth counts as exact."""
    truth = finest(rows, "ring")
    if best is None or best is truth:
        return None
    good = [row for row in rows if row.rung.kind == "ring" and (row is truth or row.error <= 0.5 * best.error)]
    return min(good, key=lambda row: row.seconds)


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
    scenefile.check_contact(file, path)
    given = file.single_contact() | {"accuracy": rung.accuracy, "method": rung.way}

    def solved() -> ContactSolution:
        return solve_contact(**given)

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
