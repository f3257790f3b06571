"""How many members are computed and stored together: blocks, calls of several blocks, chunks of several calls."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax

from difftrb.core.status import SweepError
from difftrb.sweeps.axes import Axis

BLOCK = {"cpu": 1024, "gpu": 65536}
"""Members computed at once: on a busy CPU 240 to 4000 took the same time within noise (experiments/sweep_at_scale.py
batch); a GPU wants more, how many was not measured."""
BLOCK_OF_CONTACTS = 128
"""The same on a CPU where the contact itself is swept: each member reads the atlas for itself, which a core's cache has
to hold (2.2 times as long with 1024)."""
CALLS = 16
"""Calls by which a chunk is computed."""
CHUNKS = 64
"""A sweep has at least so many chunks, if it is large enough."""
LARGEST_CHUNK = 2**17
"""Members of a chunk, about; or so many blocks."""
CHUNKS_AT_ONCE = 3
"""Chunks that are dealt with at once: no lane waits for the last call of a chunk, or for a disk."""
MOST = 10**12
"""Members of a sweep, at most: at a microsecond each they take twelve days."""


def of_block(axes: Sequence[Axis], batch: int | None) -> int:
    """Members of a block: small sweeps have small ones, so that there are enough to share among devices."""
    if batch is None:
        members = math.prod(axis.count for axis in axes)
        most = BLOCK.get(jax.default_backend(), BLOCK["gpu"])
        if most == BLOCK["cpu"] and any(key.startswith(("bearing.", "contact.")) for axis in axes for key in axis.keys):
            most = BLOCK_OF_CONTACTS
        return min(most, max(1, members // CHUNKS))
    if not isinstance(batch, int) or not 1 <= batch <= LARGEST_CHUNK:
        raise SweepError(f"batch = {batch!r}: must be a whole number in 1 … {LARGEST_CHUNK}")
    return batch


def of_chunk(members: int, block: int) -> int:
    """Members of a chunk, at most, of a sweep of so many with blocks of so many."""
    return max(CALLS * block, min(members // CHUNKS, LARGEST_CHUNK))
