"""What became slower than experiments/baseline.json by more than noise, in times by the yardstick of the same run.

python experiments/became_slower.py [RUNS]          (default 5; exit code 1 if anything did)
python experiments/became_slower.py --keep [RUNS]   (writes baseline.json)

Yardsticks make machines comparable only roughly: keep a baseline of your own machine where a tenth matters.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from difftrb import accuracy, scenefile  # noqa: E402
from difftrb.rungs import Rung  # noqa: E402

BASELINE = Path(__file__).parent / "baseline.json"
RUNGS = (
    Rung("ring", "liu2018", 1e-3), Rung("ring", "power", 1e-3), Rung("contact", "strips", 1e-3),
    Rung("contact", "cells", 1e-3), Rung("contact", "lattice", 1e-2),
)  # fmt: skip
TIMES = ("again", "single", "each", "each_with_gradient")
SLACK = 1.3
"""Slower is what takes this many times as long at its quickest as the baseline did at its slowest."""
SHORTEST = 1e-4
"""Times of less than this many seconds, but for batches, are those of Python's calls, and are left out."""

Spans = dict[str, tuple[float, float]]
"""Least and largest time in yardsticks, by rung and kind of time."""


def measured(runs: int, rungs: Sequence[Rung] = RUNGS, batch: int | None = None) -> Spans:
    """Of several runs, after one that compiles."""
    file = scenefile.parse(scenefile.example("spall"))
    found: dict[str, list[float]] = {}
    for run in range(runs + 1):
        result = accuracy.measure(file, rungs=rungs, limit=1e9, batch=batch)
        for row in result.rows if run else ():
            for name in TIMES:
                seconds = getattr(row, name)
                if seconds > (0.0 if name.startswith("each") else SHORTEST):
                    found.setdefault(f"{row.rung.kind} {row.rung.name}: {name}", []).append(seconds / result.yardstick)
    return {name: (min(ratios), max(ratios)) for name, ratios in found.items() if len(ratios) == runs}


def slower(now: Spans, before: Spans) -> list[str]:
    """Names of what became slower."""
    return [name for name, (low, _) in now.items() if name in before and low > SLACK * before[name][1]]


def main() -> int:
    """Measure and compare, or keep."""
    arguments = [argument for argument in sys.argv[1:] if argument != "--keep"]
    now = measured(int(arguments[0]) if arguments else 5)
    if "--keep" in sys.argv:
        BASELINE.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
        print(f"written to {BASELINE}")
        return 0
    before = json.loads(BASELINE.read_text(encoding="utf-8"))
    found = slower(now, before)
    table = Table(title="time in yardsticks, least … largest")
    for heading in ("", "baseline", "now", ""):
        table.add_column(heading)
    for name, span in now.items():
        spans = ["–" if s is None else f"{s[0]:.3g} … {s[1]:.3g}" for s in (before.get(name), span)]
        table.add_row(name, *spans, "slower" if name in found else "")
    Console(width=100).print(table)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
