"""A sweep into a store, chunk by chunk: in threads here, beside any number of processes, or by Dask's workers."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from difftrb.sweeps.plan import KEPT, Plan, Program, in_turn
from difftrb.sweeps.store import INSTALL, RESUME, Npz, Zarr, store_of
from difftrb.sweeps.swept import Swept, check_names, coordinates_of, counted, front, labelled, manifest_of

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
    store, done = _begun(plan, out, resume or share is not None)
    first, last = ((share[0] + i) * plan.chunks // share[1] for i in (-1, 0)) if share else (0, plan.chunks)
    counts, computed, ready, met = Counter(), 0, 0, threading.Event()

    def tell() -> None:
        if progress is not None:
            progress(ready, plan.members, counts.total() - counts[status.CONVERGED])

    def own(chunk: int) -> bool:
        return first <= chunk < last

    def engine() -> contextlib.AbstractContextManager[tuple[Any, ...]]:
        if scheduler:
            return _workers(scheduler, plan, store, devices or 1)
        program = Program(plan, lanes)
        return program.ahead(lambda chunk: _taken(program.chunk, store, chunk, own(chunk)))

    tell()
    order = _order(done, range(first, last) if share or not done.any() else range(0), met)
    with _stays_good(store, plan), contextlib.ExitStack() as stack:
        submit, *more = stack.enter_context(engine())
        for chunk, found, what in in_turn(submit, order, *more):
            computed += what != THERE
            ready += len(plan.grid.members(chunk))
            counts.update(found)
            if what == THERE and not own(chunk):
                met.set()
            if what == DAMAGED and say is not None:
                say(f"{store.where}: chunk {chunk} is damaged: computed again")
            tell()
        shown = _shown(plan, store) if share is None or share[0] == 1 else None
    return Ended(counted(counts), computed, store.where, shown)


THERE, NEW, DAMAGED = "there", "new", "damaged"
Taken = tuple[int, Counter, str]
"""Of a chunk: its number, its members by status where they were read, and how it was found."""


def _taken(compute: Callable[[int], storage.Arrays], store: Npz | Zarr, chunk: int, read: bool) -> Taken:
    """Have a chunk in the store: computed, if it is not there or, where that is to be found out, damaged."""
    what = NEW
    if store.has(chunk):
        if not read:
            return chunk, Counter(), THERE
        if (found := store.read(chunk)) is not None:
            return chunk, Counter(found[STATUS].tolist()), THERE
        what = DAMAGED
    store.write(chunk, found := compute(chunk))
    return chunk, Counter(found[STATUS].tolist()), what


def _order(done: np.ndarray, own: range, met: threading.Event) -> Iterator[int]:
    """All chunks, each once: first this process's own; then from where nobody was before until others are met."""
    given, random = np.zeros(len(done), bool), np.random.default_rng()
    given[own.start : own.stop] = True
    yield from own
    met.clear()
    while not given.all():
        left = np.flatnonzero(~given & ~done) if not (given | done).all() else np.flatnonzero(~given)
        for chunk in range(int(random.choice(left)), len(given)):
            if given[chunk] or met.is_set():
                break
            given[chunk] = True
            yield chunk
        met.clear()


# ------------------------------------------------------------------------------------------------ workers


@contextlib.contextmanager
def _workers(address: str, plan: Plan, store: Npz | Zarr, devices: int) -> Iterator[tuple[Any, int, Any]]:
    """For `in_turn`: Dask's workers. A chunk whose worker dies is given to another."""
    try:
        import distributed  # pyright: ignore[reportMissingImports]
        from distributed.comm.core import CommClosedError  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise SweepError("--scheduler needs dask.distributed: pip install 'difftrb[cluster]'") from None
    gone = OSError(None, GONE, address)
    try:
        with contextlib.ExitStack() as stack:
            stack.enter_context(_silent("distributed"))  # what matters is said in one sentence
            try:
                if address == "local":
                    local: Any = distributed.LocalCluster(n_workers=max(1, cores() // devices), threads_per_worker=1)
                    address = stack.enter_context(local).scheduler_address
                client = stack.enter_context(distributed.Client(address))
            except (OSError, ValueError) as error:
                raise SweepError(f"--scheduler {address}: {str(error).splitlines()[0]}") from None
            both = client.submit(_given, plan, store, pure=False)  # sent once, made again where a worker has lost it

            def alive() -> None:
                link = client.scheduler_comm
                if client.status != "running" or link is None or link.comm is None or link.comm.closed():
                    raise gone

            task = partial(_task, devices=devices)
            yield lambda chunk: client.submit(task, both, chunk, pure=False, retries=RETRIES), TASKS, alive
    except (CancelledError, CommClosedError):  # of chunks that it knew, or while one is handed over
        raise gone from None


@contextlib.contextmanager
def _silent(name: str) -> Iterator[None]:
    """Without what a library logs, whose loggers share their handlers."""
    before = [(handler, handler.level) for handler in logging.getLogger(name).handlers]
    for handler, _ in before:
        handler.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for handler, level in before:
            handler.setLevel(level)


def _given(plan: Plan, store: Npz | Zarr) -> tuple[Plan, Npz | Zarr]:
    return plan, store


def _task(both: tuple[Plan, Npz | Zarr], chunk: int, devices: int) -> Taken:
    plan, store = both
    return _taken(_program(plan, devices).chunk, store, chunk, True)


@lru_cache(maxsize=KEPT)
def _program(plan: Plan, devices: int | None) -> Program:
    return Program(plan, lanes_of(devices))


def compute_chunk(
    plan: Plan, chunk: int, out: str | Path | None = None, devices: int | None = None
) -> dict[str, np.ndarray]:
    """One chunk of a sweep, for engines such as Ray, Parsl or Slurm's arrays; may run anywhere, any time, twice.

    Args:
      plan: from `plan_sweep` or `load_plan`. chunk: number, in 0 … `plan.chunks` − 1.
      out: folder or URL. A chunk that is sound there is read, another one is computed and written there. Default: it is
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
        _taken(program.chunk, store, chunk, True)
        return store.whole(chunk)


# ------------------------------------------------------------------------------------------------ stores


def _begun(plan: Plan, out: str | Path, resume: bool) -> tuple[Npz | Zarr, np.ndarray]:
    """The store for a plan, and which chunks are there. Refuses what cannot be written, before anything is computed."""
    check_names(plan)
    sweeping.check_chunks(plan)
    about = manifest_of(plan)
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
        done = store.done()
        sweeping.check_disk(plan, str(out), int(done.sum()))
        store.begin(about, coordinates_of(plan))
    return store, done


@contextlib.contextmanager
def _stays_good(store: Npz | Zarr | str | Path, plan: Plan) -> Iterator[None]:
    """Errors of the disk or bucket, and of packages that are gone, become a `SweepError` that says what is written."""
    try:
        yield
    except (OSError, ImportError) as error:
        there = 0
        if isinstance(store, Npz | Zarr):
            with contextlib.suppress(OSError, ImportError):
                there = int(store.done().sum())
        gone = "start another one" if getattr(error, "strerror", None) == GONE else MEND
        mend = INSTALL if isinstance(error, ImportError) else gone
        what = f"{there} of {plan.chunks} chunks are written and stay good; {mend}, and {RESUME}"
        where = getattr(store, "where", store)
        named = str(getattr(error, "filename", None) or storage.SCRATCH)
        where = where if named.endswith((storage.SCRATCH, ".partial")) else named
        why = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise SweepError(f"{where}: {why}: {what if there else 'nothing is written'}") from None


def _shown(plan: Plan, store: Npz | Zarr) -> Swept:
    """Results along the first one or two axes."""
    plane, members = front(plan)
    places = np.unravel_index(members, plan.counts)
    boxes = np.ravel_multi_index([p // size for p, size in zip(places, plan.grid.shape, strict=True)], plan.grid.boxes)
    taken: dict[str, list[np.ndarray]] = {name: [] for name in plan.shapes}
    for chunk in np.unique(boxes):
        for name, array in store.whole(int(chunk)).items():
            taken[name].append(array[members[boxes == chunk] - plan.grid.members(int(chunk)).start])
    columns = {name: np.concatenate(arrays) for name, arrays in taken.items()}
    return labelled(manifest_of(plane), coordinates_of(plane), columns)


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
