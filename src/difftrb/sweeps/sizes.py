"""What a sweep takes of disk and memory; what does not fit is refused before an array of its length is made."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from difftrb.core.machine import free_memory
from difftrb.core.status import SweepError
from difftrb.sweeps.plan import AHEAD, Plan

MOST = 10**12
"""Members of a sweep: at a microsecond each they take twelve days."""


def of_member(plan: Plan) -> int:
    """Bytes of the results of one member."""
    return sum(math.prod(shape.shape) * np.dtype(shape.dtype).itemsize for shape in plan.shapes.values())


def of_chunks(plan: Plan) -> int:
    """Bytes of the chunks that are in memory at once while a sweep runs: in parts, and put together."""
    return 2 * (AHEAD + 2) * plan.chunk * plan.layout.size * of_member(plan)


def check_members(counts: Iterable[int], columns: int) -> None:
    """Refuse more members than any sweep can have; `columns` are results and derivatives of each, one number or more.

    Raises `SweepError`, as do the others.
    """
    counts = list(counts)
    members = math.prod(counts)
    if members > MOST:
        disk = text(2 * members * (8 * columns + 1))
        raise SweepError(f"{_product(counts)}, which take {disk} of disk or more: must be at most {MOST:,}; give fewer")


def check_chunks(plan: Plan) -> None:
    """Refuse results of which the few chunks that are in memory at once do not fit there."""
    needed, free = of_chunks(plan), free_memory()
    if needed > free:
        raise SweepError(
            f"chunks of {plan.chunk * plan.layout.size:,} members with {text(of_member(plan))} each take "
            f"{text(needed)} of memory, of which {text(free)} are free; give a smaller batch, or smaller results"
        )


def check_memory(plan: Plan) -> None:
    """Refuse a sweep whose results do not fit into memory."""
    check_chunks(plan)
    each, free = of_member(plan), free_memory()
    needed = plan.layout.members * each + of_chunks(plan)
    if needed > free:
        most = max(0, int(free - of_chunks(plan)) // each)
        raise SweepError(
            f"{_product(plan.layout.counts)} of {each} bytes take {text(needed)} of memory, of which {text(free)} are "
            f"free, enough for {most:,}; give fewer, or use difftrb.write_sweep, whose memory does not grow"
        )


def check_disk(plan: Plan, folder: Path, there: int) -> None:
    """Refuse a sweep whose chunks, of which some are `there`, and one file with all do not fit into `folder`."""
    each, free = of_member(plan), free_disk(folder)
    left = 1.0 - min(there, plan.chunks) / plan.chunks
    needed = (1.0 + left) * plan.layout.members * each
    if needed > free:
        raise SweepError(
            f"{folder}: {_product(plan.layout.counts)} of {each} bytes{' still' if there else ''} take {text(needed)} "
            f"of disk, in chunks and in one file, of which {text(free)} are free there, enough for "
            f"{int(free / (1.0 + left)) // each:,}; make room, name another folder, or give fewer"
        )


def free_disk(folder: Path) -> int:
    """Bytes that can be written into a folder, which need not be there yet."""
    return shutil.disk_usage(next(at for at in (folder.absolute(), *folder.absolute().parents) if at.exists())).free


def text(count: float) -> str:
    """Bytes for people."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if count < 999.5:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.4g} PB"


def _product(counts: Iterable[int]) -> str:
    counts = list(counts)
    return f"{' × '.join(f'{count:,}' for count in counts)}{f' = {math.prod(counts):,}' * (len(counts) > 1)} members"
