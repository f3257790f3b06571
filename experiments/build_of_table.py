"""What the table of a bearing costs: to build, compiled and not, and to load from disk.

python experiments/build_of_table.py [ACCURACY]   (default 1e-3; all cores)
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from rich.console import Console
from rich.table import Table

import difftrb as trb
from difftrb.core import storage
from difftrb.core.geometry import LineContact
from difftrb.law import table

LARGEST = 2000.0
"""About the largest roller load of the README's scene [N]."""
SPALLS = (trb.Spall(4.0, 7.0),)


def seconds(make: Callable[[], object]) -> float:
    """Of one call."""
    started = time.perf_counter()
    jax.block_until_ready(make())
    return time.perf_counter() - started


def measure(contact: LineContact, accuracy: float, folder: Path) -> dict[str, float]:
    """Seconds to build the table, with compiling and once compiled; seconds to load it, the first time and the median
    of nine more; its stored error [-] and size [bytes]."""

    def law() -> table.TableLaw:
        return table.table_law(contact, LARGEST, SPALLS, accuracy)

    with mock.patch.object(storage, "folder", return_value=folder):
        with mock.patch.object(storage, "keeping", False):
            cold, warm = seconds(law), seconds(law)
        kept = law()
        first, *again = [seconds(law) for _ in range(10)]
    size = sum(file.stat().st_size for file in folder.iterdir())
    return {"build, first": cold, "build, compiled": warm, "load, first": first, "load": float(np.median(again)),
            "error": float(kept.error), "bytes": float(size)}  # fmt: skip


def main() -> None:
    """Measure for 32008J and print."""
    accuracy = float(sys.argv[1]) if len(sys.argv) > 1 else 1e-3
    with tempfile.TemporaryDirectory() as folder:
        found = measure(LineContact.of(trb.bearing("32008J"), "outer", 6500.0), accuracy, Path(folder))
    shown = Table(title=f"table of 32008J, contacts to {accuracy:g}")
    shown.add_column("")
    shown.add_column("", justify="right")
    for name in ("build, first", "build, compiled", "load, first", "load"):
        shown.add_row(name, f"{found[name]:.3g} s")
    shown.add_row("stored error", f"{found['error']:.1e}")
    shown.add_row("on disk", f"{found['bytes'] / 1e3:.0f} kB")
    Console().print(shown)


if __name__ == "__main__":
    main()
