"""Numbers and tables as all commands print them, and as JSON has them."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
from rich import box
from rich.table import Table


def number(value: Any, style: str) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    text = format(float(value), style)
    return text if text.strip("-+0.,") else format(0.0, style)  # no −0.000


def duration(seconds: float, /) -> str:
    """Two digits and a unit."""
    if not math.isfinite(seconds):
        return "–"
    units = ("h", 3600.0, 1.0), ("min", 60.0, 2.0), ("s", 1.0, 0.995), ("ms", 1e-3, 0.995), ("µs", 1e-6, 0.0)
    unit, scale, _ = next(each for each in units if seconds >= each[1] * each[2]) if seconds else units[2]
    return f"{float(f'{seconds / scale:.2g}'):g} {unit}"


def plain(value: Any) -> Any:
    """`value` with arrays as lists and NaN as None, ready for strict JSON."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, jax.Array | np.ndarray | np.integer):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def house_table(title: str, *headings: str, words: tuple[str, ...] = ("", "unit")) -> Table:
    """An empty table of the house; under `headings` of `words` these stand left, numbers right."""
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False,
                  min_width=min(len(title), 60))  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="left" if heading in words else "right")
    return table
