"""What became slower than experiments/baseline.json by more than noise, in times by the yardstick of the same run.

taskset -c 0 python experiments/became_slower.py          (exit code 1 if anything did)
taskset -c 0 python experiments/became_slower.py --keep   (writes baseline.json)

The times are those of the pytest-benchmark suite in benchmarks.py. Yardsticks make machines comparable only roughly:
keep a baseline of your own machine where a tenth matters.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import pytest
from rich.console import Console
from rich.markup import escape
from rich.table import Table

FOLDER = Path(__file__).parent
BASELINE = FOLDER / "baseline.json"
SLACK = 1.3
"""Slower is what takes this many times as long at its quickest as three quarters of the baseline's rounds did."""

Spans = dict[str, tuple[float, float]]
"""Least time and that of which three quarters are below, in yardsticks, by benchmark."""


def measured(*options: str) -> Spans:
    """Run the suite, with further `options` of pytest's."""
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "times.json"
        code = pytest.main(["-n0", f"--benchmark-json={record}", *options, str(FOLDER / "benchmarks.py")])
        if code != pytest.ExitCode.OK:
            raise SystemExit(f"the suite did not end well: {code!r}")
        return spans(json.loads(record.read_text(encoding="utf-8")))


def spans(record: dict) -> Spans:
    """Of pytest-benchmark's record."""
    times = {one["name"].removeprefix("test_"): one["stats"] for one in record["benchmarks"]}
    yardstick = times.pop("yardstick")["min"]
    return {name: (each["min"] / yardstick, each["q3"] / yardstick) for name, each in times.items()}


def slower(now: Spans, before: Spans) -> list[str]:
    """Names of what became slower."""
    return [name for name, (low, _) in now.items() if name in before and low > SLACK * before[name][1]]


def main() -> int:
    """Measure and compare, or keep."""
    now = measured()
    if "--keep" in sys.argv:
        BASELINE.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
        print(f"written to {BASELINE}")
        return 0
    before = json.loads(BASELINE.read_text(encoding="utf-8"))
    found = slower(now, before)
    table = Table(title="time in yardsticks: least … three quarters")
    for heading in ("", "baseline", "now", ""):
        table.add_column(heading)
    for name, span in now.items():
        both = ["–" if s is None else f"{s[0]:.3g} … {s[1]:.3g}" for s in (before.get(name), span)]
        table.add_row(escape(name), *both, "slower" if name in found else "")
    Console(width=100).print(table)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
