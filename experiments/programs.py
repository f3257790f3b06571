"""Letting go of compiled programs in a process that meets very many."""

from pathlib import Path

import jax

MAPS = Path("/proc/self/maps")
"""Each compiled program takes some of the 65 530 memory maps Linux grants a process; beyond, compiling crashes."""


def let_go(beyond: int) -> None:
    """Forget all compiled programs if this process has more than so many memory maps; where there are none, nothing."""
    if MAPS.exists() and len(MAPS.read_bytes().splitlines()) > beyond:
        jax.clear_caches()
