"""How members are cut: blocks that are computed at once, calls of several blocks, chunks of several calls."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core.input_errors import is_whole
from difftrb.core.machine import accelerator
from difftrb.core.status import SweepError
from difftrb.sweeps.axes import Axis

BLOCK = 1024
"""Members computed at once on a CPU: 240 to 4000 take the same time within noise (experiments/sweep_at_scale.py
batch)."""
BLOCK_OF_GPU = 2**18
"""The same on a GPU, if its memory holds them: an H200 takes 0.02 (liu2018) and 0.06 µs (table) a member, 0.04 and 0.10
with 40 000 at once, 1.1 and 2.6 with 1000 (experiments/sweep_on_gpu.py batch)."""
MEMBER = 2**15
"""Bytes of a GPU's memory for each of them: measured were 2 … 9 thousand."""
BLOCK_OF_CONTACTS = 48
"""The same on a CPU where the contact itself is swept: each member reads the atlas for itself, which a core's cache has
to hold (1.4 times as long with 120, 2.6 with 400)."""
FEW = 4
"""Blocks that would have fewer values of the axis they cut have one, and lie along the axes behind it: for every axis
in a block JAX goes through the whole program once more, which takes seconds."""
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
        if (other := accelerator()) is not None:
            memory = (other.memory_stats() or {}).get("bytes_limit", math.inf)
            most = int(min(BLOCK_OF_GPU, max(memory // MEMBER, BLOCK)))
        else:
            contacts = any(key.startswith(("bearing.", "contact.")) for axis in axes for key in axis.keys)
            most = BLOCK_OF_CONTACTS if contacts else BLOCK
        return min(most, max(1, members // CHUNKS))
    if not is_whole(batch, 1, BLOCK_OF_GPU):
        raise SweepError(f"batch = {batch!r}: must be a whole number in 1 … {BLOCK_OF_GPU}")
    return batch


@dataclasses.dataclass(frozen=True)
class Grid:
    """Members, numbered with the last axis changing fastest, cut into boxes of one shape: blocks, and chunks of them.

    A box is a part of one axis times all axes behind it, at one place of those before it. So its members follow one
    another, and what does not change inside it is computed once. Boxes at the end of the cut axis may be shorter.

    Attributes:
      counts: values of every axis. shape: of them in a box: 1 before the cut axis, all behind it.
    """

    counts: tuple[int, ...]
    shape: tuple[int, ...]

    @classmethod
    def of(cls, counts: tuple[int, ...], most: int, unit: tuple[int, ...] | None = None) -> Grid:
        """Cut into boxes of `most` members or about one value of the cut axis, each of whole boxes of shape `unit`."""
        cut = next((i for i in range(len(counts) - 1, 0, -1) if math.prod(counts[i:]) >= most), 0)
        taken = most // math.prod(counts[cut + 1 :])
        few = unit is None and taken < FEW and cut < len(counts) - 1
        parts = up(counts[cut], 1 if few else max(1, taken))
        step = unit[cut] if unit else 1
        return cls(counts, (*(1,) * cut, up(up(counts[cut], parts), step) * step, *counts[cut + 1 :]))

    @property
    def boxes(self) -> tuple[int, ...]:
        """Number of boxes along every axis."""
        return tuple(map(up, self.counts, self.shape))

    @property
    def number(self) -> int:
        """Of boxes."""
        return math.prod(self.boxes)

    @property
    def size(self) -> int:
        """Members of a whole box."""
        return math.prod(self.shape)

    @property
    def split(self) -> int:
        """The first axis with several values in a box; the last if there is none."""
        return next((i for i, size in enumerate(self.shape) if size > 1), len(self.shape) - 1)

    def place(self, box: Any) -> list[Any]:
        """Where a box is, counted in boxes along every axis. Works inside jit."""
        return [box // math.prod(self.boxes[i + 1 :]) % number for i, number in enumerate(self.boxes)]

    def slices(self, box: int) -> tuple[slice, ...]:
        """The values of a box on every axis."""
        found = zip(self.place(box), self.shape, self.counts, strict=True)
        return tuple(slice(place * size, min((place + 1) * size, count)) for place, size, count in found)

    def held(self, box: Any) -> Any:
        """How many members a box has, or each of some boxes in an array."""
        found = zip(self.place(box), self.shape, self.counts, strict=True)
        return math.prod(np.minimum(size, count - place * size) for place, size, count in found)

    def members(self, box: int) -> range:
        """Numbers of the members of a box."""
        first = int(np.ravel_multi_index([part.start for part in self.slices(box)], self.counts))
        return range(first, first + int(self.held(box)))

    def within(self, slices: tuple[slice, ...]) -> range:
        """Boxes inside a box of another grid, which has whole ones of this."""
        corner = [part.start // size for part, size in zip(slices, self.shape, strict=True)]
        first = int(np.ravel_multi_index(corner, self.boxes))
        many = (up(part.stop - part.start, size) for part, size in zip(slices, self.shape, strict=True))
        return range(first, first + math.prod(many))

    def values(self, box: jax.Array) -> list[jax.Array]:
        """Places of a box's values on every axis: shape () before `split`, else (values,), the last one again for those
        that are missing. Works inside jit."""
        ends = zip(self.place(box), self.shape, self.counts, strict=True)
        return [place if i < self.split else jnp.minimum(place * size + jnp.arange(size), count - 1)
                for i, (place, size, count) in enumerate(ends)]  # fmt: skip


def up(count: int, size: int) -> int:
    """How many boxes of this size hold so many."""
    return -(-count // size)
