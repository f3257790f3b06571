"""What pressure on the rows pushes rows down: the rows' kernel put together with the waves of pressure across them.

Rows farther apart than a few waves do not see one another: K₀ of κ|y−y'| is gone. In numpy such pairs are left out,
which are most of them at the high frequencies that thin slivers of contact need; a program has one shape for all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.core import arrays as xp

GONE = 1e-11  # of what two rows push themselves down: less is left out
TOGETHER = 8  # strips that are looked at as one
CHUNKS = (4.0, 16.0, 64.0)  # frequencies by which what is gone is decided


class Part(NamedTuple):
    """Of some neighbouring frequencies: their entries z of the waves, which strips are taken together, and for each of
    these which strips they see and the kernel, (strips, z, seen)."""

    z: np.ndarray
    strips: list[np.ndarray]
    seen: list[np.ndarray]
    kernel: list[np.ndarray]


class Coupling(NamedTuple):
    """The kernel of strips at every entry z of their waves: as a whole, (strips, z, strips), or in `parts`, for pairs
    that are `above`, (strips, strips); the others mirror these."""

    whole: Any
    parts: list[Part]
    above: Any = None


def coupling_of(products: Any, rows: np.ndarray, kappa: np.ndarray, even: bool) -> Coupling:
    """Of strips on `rows`, which may repeat, of the rows' kernel `products` at frequencies `kappa`. Waves have real
    parts and, unless `even`, imaginary ones."""
    if xp.module_of(products) is np and not even:
        return Coupling(None, *_parts(products, rows, kappa))
    table = products[rows][:, rows].transpose(0, 2, 1)
    return Coupling(table if even else xp.concatenate([table, table], axis=1), [])


def coupled(kernel: Coupling, wave: Any) -> Any:
    """Σ over z of the kernel and waves (strips, k, z): shape (strips, k, strips, k)."""
    n, k, z = wave.shape
    if not kernel.parts:
        pushed = (kernel.whole[..., None] * wave.transpose(2, 0, 1)[None]).reshape(n, z, n * k)
        return xp.matmul(wave, pushed).reshape(n, k, n, k)
    result = np.zeros((n, k, n, k))
    for part in kernel.parts:
        pressed = wave[:, :, part.z]
        pushing = pressed.transpose(2, 0, 1)
        for strips, seen, own in zip(part.strips, part.seen, part.kernel, strict=True):
            pushed = (own[..., None] * pushing[None, :, seen]).reshape(len(strips), part.z.size, -1)
            found = np.matmul(pressed[strips], pushed).reshape(len(strips), k, len(seen), k)
            result[strips[:, None], :, seen[None]] += found.transpose(0, 2, 1, 3)
    return np.where(kernel.above[:, None, :, None], result, result.transpose(2, 3, 0, 1))


def _parts(products: np.ndarray, rows: np.ndarray, kappa: np.ndarray) -> tuple[list[Part], np.ndarray]:
    own = np.sqrt(np.abs(np.einsum("iik->ik", products)))
    sees = np.abs(products) > GONE * own[:, None] * own[None]
    of_chunk = np.searchsorted(CHUNKS, kappa)
    order = np.argsort(rows, kind="stable")
    blocks = np.array_split(order, max(1, round(rows.size / TOGETHER)))
    number = np.empty(rows.size, int)  # of the block of every strip
    number[np.concatenate(blocks)] = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
    above = number[:, None] <= number[None]
    parts = []
    for chunk in range(len(CHUNKS) + 1):
        at = np.flatnonzero(of_chunk == chunk)
        if not at.size:
            continue
        near = np.any(sees[:, :, at], axis=-1)[rows][:, rows] & above
        seen = [np.flatnonzero(np.any(near[block], axis=0)) for block in blocks]
        few = np.ascontiguousarray(products[:, :, at].transpose(0, 2, 1))
        tables = [
            np.tile(few[rows[block]][:, :, rows[some]], (1, 2, 1)) for block, some in zip(blocks, seen, strict=True)
        ]
        parts.append(Part(np.concatenate([at, at + kappa.size]), list(blocks), seen, tables))
    return parts, above
