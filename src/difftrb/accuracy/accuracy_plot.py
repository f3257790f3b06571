"""Work against precision."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from difftrb.accuracy.comparison import Measured
from difftrb.accuracy.ladder import Kind
from difftrb.core.status import SceneError

WAYS = {"palmgren": ("^", "#BBBBBB"), "liu2018": ("v", "#CCBB44"), "power": ("D", "#66CCEE"), "table": ("s", "#4477AA"),
        "direct": ("o", "#EE6677"), "strips": ("o", "#EE6677"), "cells": ("s", "#4477AA"),
        "lattice": ("D", "#CCBB44")}  # fmt: skip


def work_precision(measured: Measured) -> Any:
    """Error against time, for the ring and for the contact; Axes side by side, the first is returned.

    Filled: a new scene, compiled; hollow: one scene of a batch by a law prepared before. A line marks what the finest
    rung is known to. Only kinds of which an error is known; `SceneError` if none is.
    """
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
            marker, colour = WAYS[way]
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
