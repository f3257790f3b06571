"""A sweep into a store, chunk by chunk: in threads here, beside any number of processes, or by Dask's workers."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from difftrb.core import status, storage
from difftrb.core.machine import cores, lanes_of
from difftrb.core.status import SweepError
from difftrb.sweeps import sweeping
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.plan import Plan, Program, in_turn
from difftrb.sweeps.store import INSTALL, RESUME, Npz, Zarr, done_in, store_of, swept_in
from difftrb.sweeps.swept import Swept, by_code, check_names, coordinates_of, counted, front, manifest_of

KEPT = 4
"""Programs that a process keeps, at most."""
TASKS = 10_000
"""Chunks that a scheduler knows at once."""
MEND = "make room or allow writing there"
"""What to do where the disk or the bucket fails."""
GONE = "the scheduler is gone"
RETRIES = 3
"""How often a chunk is tried again that failed on a worker."""


@dataclasses.dataclass(frozen=True)
class Ended:
    """What became of a sweep.

    Attributes:
      counts: members by the sentence of their status. computed: chunks that were computed now. where: the store.
      shown: results of `swept.front`; None in processes with a share but the first.
    """

    counts: dict[str, int]
    computed: int
    where: str
    shown: Swept | None = None

    @property
    def failed(self) -> int:
        """Members without a solution."""
        return sum(self.counts.values()) - self.counts.get(status.describe(status.CONVERGED), 0)

    def sentence(self) -> str:
        """All of it in words."""
        members = sum(self.counts.values())
        lines = [f"{members:,} members, {members - self.failed:,} converged, {self.failed:,} without a solution (NaN)"]
        lines += [f"{count:,}: {sentence}" for sentence, count in self.counts.items() if sentence != "converged"]
        return "\n".join([*lines, f"written to {self.where}"])


def run(
    plan: Plan,
    out: str | Path,
    resume: bool = False,
    devices: int | None = None,
    progress: Callable[[int, int, int], None] | None = None,
    say: Callable[[str], None] | None = None,
    share: tuple[int, int] | None = None,
    scheduler: str | None = None,
) -> Ended:
    """Compute a sweep into a store in the folder, or behind the URL, `out`.

    Args:
      plan: from `sweeping.plan_sweep`.
      resume: go on with what is there, beside others that do; damaged chunks are made again. Without it, and without a
        share, a store with a sweep is refused.
      devices: of this process, see `machine.lanes_of`; of each of Dask's workers, there 1 by default.
      progress: told how many of how many members are done, and how many of them have no solution.
      say: told sentences on what is made again.
      share: (i, n), i in 1 … n: begin with this part of the chunks. Then what is left of the others is taken, too; what
        others have done is not read, and not counted.
      scheduler: address of a Dask scheduler, or "local" for one here; its workers have to reach `out`.

    Raises `SweepError`: what is written stays, and stays good.
    """
    lanes = lanes_of(None if scheduler else devices)  # known before anything is written
    if share is not None and not (len(share) == 2 and 1 <= share[0] <= share[1]):
        raise SweepError(f"share = {share}: must be (i, n), this process's number from 1 on and how many there are")
    store, done = _begun(plan, out, resume or share is not None)
    own = range(plan.chunks)
    if share:
        own = range((share[0] - 1) * plan.chunks // share[1], share[0] * plan.chunks // share[1])
    counts, computed, ready, met = Counter(), 0, 0, threading.Event()
    tell = progress or (lambda *_: None)
    tell(0, plan.members, 0)
    order = _order(done, own if share or not done.any() else range(0), met)
    if scheduler:
        taken = _by_workers(scheduler, plan, store, devices or 1, order)
    else:
        program = Program(plan, lanes)
        taken = program.in_turn(lambda chunk: _taken(program, store, chunk, chunk in own), order)
    with _stays_good(store, plan), contextlib.closing(taken):
        for chunk, found, what in taken:
            computed += what != THERE
            ready += int(plan.grid.held(chunk))
            counts.update(found)
            if what == THERE and chunk not in own:
                met.set()
            if what == DAMAGED and say is not None:
                say(f"{store.where}: chunk {chunk} is damaged: computed again")
            tell(ready, plan.members, counts.total() - counts[status.CONVERGED])
        shown = swept_in(store, front(plan.counts)) if share is None or share[0] == 1 else None
    return Ended(counted(counts), computed, store.where, shown)


THERE, NEW, DAMAGED = "there", "new", "damaged"


def _had(program: Program, store: Npz | Zarr, chunk: int) -> tuple[storage.Arrays, str]:
    """A chunk that is in the store now, computed if it was not there or damaged; and how it was found."""
    there = store.has(chunk)
    if there and (found := store.read(chunk)) is not None:
        return found, THERE
    store.write(chunk, found := program.chunk(chunk))
    return found, DAMAGED if there else NEW


def _taken(program: Program, store: Npz | Zarr, chunk: int, read: bool = True) -> tuple[int, Counter[int], str]:
    """The number of a chunk that is in the store now; its members by status, unless it was there and is not to be
    `read`; and how it was found."""
    if not read and store.has(chunk):
        return chunk, Counter(), THERE
    found, what = _had(program, store, chunk)
    return chunk, by_code(found[STATUS]), what


def _order(done: np.ndarray, own: range, met: threading.Event) -> Iterator[int]:
    """All chunks, each once: first this process's own; then from where nobody was before until others are met."""
    given, random = np.zeros(len(done), bool), np.random.default_rng()
    given[own.start : own.stop] = True
    yield from own
    while not given.all():
        met.clear()
        left = np.flatnonzero(~given & ~done) if not (given | done).all() else np.flatnonzero(~given)
        for chunk in range(int(random.choice(left)), len(given)):
            if given[chunk] or met.is_set():
                break
            given[chunk] = True
            yield chunk


def _by_workers(
    address: str, plan: Plan, store: Npz | Zarr, devices: int, chunks: Iterable[int]
) -> Generator[tuple[int, Counter[int], str]]:
    """`Program.in_turn` by Dask's workers. A chunk whose worker dies is given to another."""
    try:
        import distributed  # pyright: ignore[reportMissingImports]
        from distributed.comm.core import CommClosedError  # pyright: ignore[reportMissingImports]
        from distributed.utils import silence_logging_cmgr  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise SweepError("--scheduler needs dask.distributed: pip install '.[cluster]' in difftrb's folder") from None
    gone = OSError(None, GONE, address)
    try:
        with contextlib.ExitStack() as stack:
            stack.enter_context(silence_logging_cmgr(logging.CRITICAL + 1))  # what matters is said in one sentence
            try:
                if address == "local":
                    local: Any = distributed.LocalCluster(n_workers=max(1, cores() // devices), threads_per_worker=1)
                    address = stack.enter_context(local).scheduler_address
                client = stack.enter_context(distributed.Client(address))
            except (OSError, ValueError) as error:
                raise SweepError(f"--scheduler {address}: {str(error).splitlines()[0]}") from None
            both = client.submit(tuple, [plan, store], pure=False)  # sent once, made again where a worker has lost it

            def alive() -> None:
                link = client.scheduler_comm
                if client.status != "running" or link is None or link.comm is None or link.comm.closed():
                    raise gone

            submit = partial(client.submit, _task, both, devices, pure=False, retries=RETRIES)
            yield from in_turn(submit, chunks, TASKS, alive)
    except (CancelledError, CommClosedError):  # of chunks that it knew, or while one is handed over
        raise gone from None


def _task(both: tuple[Plan, Npz | Zarr], devices: int, chunk: int) -> tuple[int, Counter[int], str]:
    return _taken(_program(both[0], devices), both[1], chunk)


@lru_cache(maxsize=KEPT)
def _program(plan: Plan, devices: int | None) -> Program:
    return Program(plan, lanes_of(devices))


def compute_chunk(
    plan: Plan, chunk: int, out: str | Path | None = None, devices: int | None = None
) -> dict[str, np.ndarray]:
    """One chunk of a sweep, for engines such as Ray, Parsl or Slurm's arrays; may run anywhere, any time, twice.

    Args:
      plan: from `plan_sweep` or `load_plan`. chunk: number, in 0 … `plan.chunks` − 1.
      out: folder or URL. A chunk that is whole there is read, another one is computed and written there. Default: it is
        computed.
      devices: as in `sweep`.

    Returns columns by name, shape (members, …): results, derivatives ("radial_stiffness_by_spall.0.length") and
    "status_code". Raises `SweepError`.
    """
    if not 0 <= chunk < plan.chunks:
        raise SweepError(f"chunk = {chunk}: must be in 0 … {plan.chunks - 1}")
    status.require_float64()
    program = _program(plan, devices)
    if out is None:
        return program.chunk(chunk)
    store, _ = _begun(plan, out, True)
    with _stays_good(store, plan):
        return _had(program, store, chunk)[0]


def _begun(plan: Plan, out: str | Path, resume: bool) -> tuple[Npz | Zarr, np.ndarray]:
    """The store for a plan, and which chunks are there. Refuses what cannot be written, before anything is computed."""
    about = manifest_of(plan)
    check_names(about)
    sweeping.check_chunks(plan)
    with _stays_good(out, plan):
        store = store_of(out)
        theirs = store.about
        if store.identity and not resume:
            raise SweepError(f"{out}: holds a sweep already; {RESUME}, or name another folder")
        if store.identity and store.identity != about["identity"]:
            words = {"scene": "of another scene file", "axes": "over other axes", "columns": "of other outputs",
                     "gradients": "with other gradients", "versions": "with other versions of difftrb, jax or numpy",
                     "platform": "on another platform", "batch": "with another batch"}  # fmt: skip
            what = next((words[key] for key in words if theirs.get(key) != about[key]), "of a scene with other numbers")
            raise SweepError(f"{out}: the sweep there is {what}; undo the change, or name another folder")
        store.about = about
        done = done_in(store)
        sweeping.check_disk(plan, str(out), int(done.sum()))
        store.begin(about, coordinates_of(plan))
    return store, done


@contextlib.contextmanager
def _stays_good(store: Npz | Zarr | str | Path, plan: Plan) -> Iterator[None]:
    """Errors of the disk or bucket, and of packages that are gone, become a `SweepError` that says what is written."""
    try:
        yield
    except (OSError, ImportError) as error:
        there, where, named = 0, store, str(getattr(error, "filename", None) or storage.SCRATCH)
        if isinstance(store, Npz | Zarr):
            where = store.where
            with contextlib.suppress(OSError, ImportError):
                there = int(done_in(store).sum())
        if not named.endswith((storage.SCRATCH, ".partial")):
            where = named
        why = getattr(error, "strerror", None) or str(error).splitlines()[0]
        mend = INSTALL if isinstance(error, ImportError) else "start another one" if why == GONE else MEND
        what = f"{there} of {plan.chunks} chunks are written and stay good; {mend}, and {RESUME}"
        raise SweepError(f"{where}: {why}: {what if there else 'nothing is written'}") from None


def write_sweep(
    what: Callable[[Any], Any] | Sequence[str],
    base: Any,
    axes: Mapping[str, Any],
    folder: str | Path,
    gradients: Sequence[str] = (),
    *,
    mode: str = "product",
    batch: int | None = None,
    resume: bool = False,
    devices: int | None = None,
    progress: Callable[[int, int, int], None] | None = None,
    share: tuple[int, int] | None = None,
    scheduler: str | None = None,
) -> Ended:
    """`sweep` into a store, with memory that does not grow with the number of members; `load_sweep` reads it.

    Arguments as in `sweep` and `run`. A function is known by its name: one that was changed needs another name, or
    another folder. Raises `SweepError` as these do, and before anything is computed if the results do not fit into what
    is free in `folder`, which may be a URL.
    """
    plan = sweeping.plan_sweep(what, base, axes, gradients, mode, batch)
    return run(plan, folder, resume, devices, progress, None, share, scheduler)
