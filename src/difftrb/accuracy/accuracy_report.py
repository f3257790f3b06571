"""What `difftrb accuracy` does; what accuracy costs as text, as JSON, and as a figure of work against precision."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from difftrb.accuracy import ladder, timing
from difftrb.accuracy.ladder import TRUTHS, Kind, Measured, Row
from difftrb.core.status import SceneError
from difftrb.report import console, remarks, tables
from difftrb.report.tables import duration
from difftrb.scene.file_schema import SceneFile

KINDS: tuple[Kind, ...] = ("ring", "contact")
WAYS = {"palmgren": ("^", "#BBBBBB"), "liu2018": ("v", "#CCBB44"), "power": ("D", "#66CCEE"), "table": ("s", "#4477AA"),
        "direct": ("o", "#EE6677"), "strips": ("o", "#EE6677"), "cells": ("s", "#4477AA"),
        "lattice": ("D", "#CCBB44")}  # fmt: skip
"""Marker and colour of the package's laws and methods."""
OTHER_WAY = "P", "#AA3377"
"""Of laws that somebody else registered."""
ERRORS_SHOWN = {"radial_stiffness": "radial", "axial_stiffness": "axial", "load": "load", "by_length": "length",
                "by_width": "width"}  # fmt: skip

TIMES: dict[Kind, dict[str, Callable[[Row], float]]] = {
    "ring": {
        "first": lambda row: row.first, "again": lambda row: row.again, "solve": lambda row: row.single,
        "batch": lambda row: row.each, "slopes": lambda row: row.each_with_gradient,
    },
    "contact": {"first": lambda row: row.first, "solve": lambda row: row.single},
}  # fmt: skip


def deliver(options: Any, file: SceneFile, path: str) -> int:
    """Measure, print it and write it where `options` ask; the exit code."""
    if options.accuracy is not None and not 1e-6 <= options.accuracy <= 1.0:
        raise SceneError(f"--accuracy = {options.accuracy:g}: must be a number in 1e-06 … 1")
    console.remark(path, *remarks.of_ring(file))
    full = options.full
    rungs, limit = ladder.rungs(full), float("inf") if full else timing.LIMIT
    with console.bar("measuring what accuracy costs") as progress:
        measured = timing.measure(file, path, rungs, options.accuracy, limit, progress=progress, thorough=options.full)

    def figures() -> console.Figures:
        if any(row.error > 0.0 for row in measured.rows):
            yield "accuracy", work_precision(measured)

    record = accuracy_json(measured)
    return console.deliver(options, path, record, lambda: accuracy_text(measured), figures)


def accuracy_json(measured: Measured) -> dict[str, Any]:
    """What accuracy costs: every rung's times [s], memory [MiB], values [N, mm] and relative errors. `yardsticks` is
    the time of a new scene or contact by that of the yardstick."""

    def entry(row: Row | None) -> dict[str, Any] | None:
        return None if row is None else {
            "way": row.rung.way, "accuracy": None if row.rung.size else row.rung.accuracy, "size": row.rung.size,
            "status": row.status, "error": row.error,
            "errors": row.errors, "values": row.values, "first": row.first, "again": row.again, "single": row.single,
            "each": row.each, "each_with_gradient": row.each_with_gradient, "new": row.seconds,
            "yardsticks": row.seconds / measured.yardstick, "memory": row.memory, "device": measured.device,
            "there": row.there, "continuum": row.continuum,
        }  # fmt: skip

    truths = [measured.truth(kind) for kind in KINDS]
    sentences = (row.status for row in measured.rows if row.status != "converged")
    failed = next(sentences, "no way to compute it was measured that others can be compared with")
    return tables.plain({
        "status": "converged" if any(truths) else failed,
        "converged": any(truths),
        "asked": measured.asked,
        "recommended": entry(measured.recommended),
        "finer": entry(measured.finer),
        **{kind: [entry(row) for row in measured.of(kind)] for kind in KINDS},
        "truth": {kind: entry(truth) for kind, truth in zip(KINDS, truths, strict=True)},
        "left_out": measured.left_out,
        "yardstick": measured.yardstick,
        "device": measured.device,
        "cores": measured.cores,
        "one_core": measured.one_core and dict(zip(("each", "each_with_gradient"), measured.one_core, strict=True)),
        "accelerator": measured.accelerator,
        "importing": measured.importing,
        "seconds": measured.seconds,
    })  # fmt: skip


def accuracy_text(measured: Measured) -> RenderableType:
    """What accuracy costs, for people: a table for the ring, one for the contact, and the rung to take."""
    parts: list[RenderableType] = []
    for kind in KINDS:
        rows = measured.of(kind)
        names = [n for n in ERRORS_SHOWN if any(math.isfinite(row.errors.get(n, math.nan)) for row in rows)]
        if kind == "contact":
            names = ["approach"]
        if not rows:
            continue
        table = tables.house_table({"ring": "Ring, by roller law", "contact": "One contact, by method"}[kind])
        table.padding = 0  # ten columns on a page
        table.add_column("", no_wrap=True)
        for name in names:
            table.add_column(ERRORS_SHOWN.get(name, "error of approach"), justify="right", no_wrap=True)
        columns = [(heading, duration, get) for heading, get in TIMES[kind].items()]
        if kind == "contact":
            columns.append(("continuum", _error, lambda row: row.continuum))
        elif measured.accelerator is not None:
            columns.append(("there", duration, lambda row: row.there))
        columns = [column for column in columns if any(math.isfinite(column[2](row)) for row in rows)]
        for heading, *_ in columns:
            table.add_column(heading, justify="right", no_wrap=True)
        truth = measured.truth(kind)
        for row in rows:
            own = [row.errors.get(name, math.nan) for name in names]
            errors = ["±" * (row is truth and math.isfinite(error)) + _error(error) for error in own]
            table.add_row(row.rung.name, *errors, *(shown(get(row)) for _, shown, get in columns))
        parts.append(table)
    return Group(*parts, *(Text(line) for line in _accuracy_lines(measured)))


def _accuracy_lines(measured: Measured) -> list[str]:
    lines = []
    for kind in KINDS:
        truth = measured.truth(kind)
        if truth is not None and math.isfinite(truth.error):
            lines.append(
                f"{kind}: errors are from {truth.rung.name}, which is ± its own difference from the next finest"
            )
        elif measured.of(kind):
            lines.append(f"{kind}: too few rungs to know how good they are")
    best, finer = measured.recommended, measured.finer
    if best is None:
        lines.append(f"no law is known to have stiffness within {measured.asked:g}")
    else:
        lines.append(
            f"for stiffness within {measured.asked:g} take {best.rung.name}: error {_error(best.error)}, "
            f"{duration(best.seconds)} for a new scene ({best.seconds / measured.yardstick:.3g} yardsticks)"
        )
        if finer is not None:
            lines.append(f"more exact: {finer.rung.name}, error {_error(finer.error)}, {duration(finer.seconds)}")
    if measured.one_core is not None:
        each, slopes = measured.one_core
        lines.append(f"on one core alone a batch takes {each:.2g} times as long, with derivatives {slopes:.2g} times")
    reasons: dict[str, list[str]] = {}
    for name, reason in measured.left_out.items():
        reasons.setdefault(reason, []).append(name)
    lines += [f"left out: {', '.join(names)}: {reason}" for reason, names in reasons.items()]
    if any(math.isfinite(row.continuum) for row in measured.rows):
        lines.append(f"continuum: the largest error on {len(TRUTHS)} contacts with a known continuum solution")
    if measured.accelerator is not None:
        lines.append(f"there: one of a batch of {timing.BATCH_THERE} on {measured.accelerator}")
    memory = max(row.memory for row in measured.rows)
    return [
        *lines,
        "first: until the first result, with programs compiled that no rung before had; again: the law made anew, "
        "compiled; solve: the scene by that law; batch: one of a batch; slopes: one, with derivatives by length and "
        "width",
        f"on {measured.device}, {measured.cores} cores; yardstick {duration(measured.yardstick)}; difftrb imported in "
        f"{duration(measured.importing)}; memory {tables.number(memory, '.0f')} MiB; measured in "
        f"{duration(measured.seconds)}",
    ]


def _error(value: float) -> str:
    return tables.number(value, ".1e").replace("e-0", "e-").replace("e+00", "")


def work_precision(measured: Measured) -> Any:
    """Error against time for the ring and for the contact, on Axes side by side; the first is returned.

    Filled: a new scene, compiled; hollow: one scene of a batch by a prepared law. A line marks the error of the finest
    rung. Kinds without a known error have no Axes; raises `SceneError` if none has one.
    """
    import matplotlib.pyplot as plt

    kinds: list[tuple[Kind, str]] = [
        ("ring", "error of the ring's stiffness [–]"), ("contact", "error of the approach [–]")
    ]  # fmt: skip
    kinds = [entry for entry in kinds if any(row.error > 0.0 for row in measured.of(entry[0]))]
    if not kinds:
        raise SceneError("no error is known: fewer than two rungs of a kind were measured")
    _, axes = plt.subplots(1, len(kinds), figsize=(4.4 * len(kinds), 4.3), layout="constrained", squeeze=False)
    for ax, (kind, label) in zip(axes[0], kinds, strict=True):
        rows = [row for row in measured.of(kind) if row.error > 0.0]
        for way in dict.fromkeys(row.rung.way for row in rows):
            own = sorted(
                (row for row in rows if row.rung.way == way), key=lambda row: row.rung.coarseness, reverse=True
            )
            marker, colour = WAYS.get(way, OTHER_WAY)
            errors = [row.error for row in own]
            style = {"marker": marker, "color": colour, "markeredgecolor": "black", "markeredgewidth": 0.6, "ms": 7}
            ax.loglog([row.seconds for row in own], errors, linestyle="-", lw=1.0, label=way, **style)
            if kind == "ring":
                ax.loglog([row.each for row in own], errors, linestyle=":", fillstyle="none", lw=1.0,
                          **style | {"markeredgecolor": colour, "markeredgewidth": 1.4})  # fmt: skip
        truth = measured.truth(kind)
        if truth is not None and truth.error > 0.0:
            ax.axhline(truth.error, color="black", lw=0.8, linestyle="--", zorder=0, label="truth known to")
        ax.set_ylabel(label)
        ax.grid(which="major", color="#DDDDDD", lw=0.6)
        ax.set_axisbelow(True)
        ax.margins(0.12)
        low, high = (np.log10(limit) for limit in ax.get_ylim())
        ax.set_ylim(10.0 ** np.floor(low), 10.0 ** np.ceil(high))
    for ax, (kind, _) in zip(axes[0], kinds, strict=True):
        ax.set_xlabel("time per scene [s]" if kind == "ring" else "time per solve [s]")
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, frameon=False, fontsize=8,
                  title="filled: new scene; hollow: in a batch" if kind == "ring" else None,
                  title_fontsize=8)  # fmt: skip
    return axes[0, 0]
