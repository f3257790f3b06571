"""The figure of roller loads around the ring."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator

from difftrb.core.geometry import arc_radius
from difftrb.report.figure_style import ACCENT, HEALTHY, SPALLED, loads_of, phase_of
from difftrb.scene.scene import Scene
from difftrb.scene.solution import Assessment


def load_distribution(result: Assessment, scene: Scene, ax: Any = None) -> Any:
    """Roller loads on a polar axis, healthy and spalled; the load line points down, as the load hangs."""
    if ax is None:
        _, ax = plt.subplots(figsize=(5.0, 5.4), subplot_kw={"projection": "polar"}, layout="constrained")
    ax.set_theta_zero_location("S")
    ax.set_theta_direction(1)
    angles = np.asarray(result.healthy.angles)
    closed = np.append(angles, angles[0] + 2.0 * np.pi)
    curves = [(result.healthy, HEALTHY, "healthy", "o", "-")]
    if scene.spalls:
        curves.append((result.spalled, SPALLED, "with spall", "s", "--"))
    for solution, colour, label, marker, style in curves:
        loads = np.asarray(solution.loads) / 1e3
        ax.plot(closed, np.append(loads, loads[0]), style, marker=marker, ms=4, lw=1.2, color=colour, label=label)
    top = float(max(np.nanmax(np.asarray(s.loads)) for s, *_ in curves)) / 1e3
    named = set()
    for spall in scene.spalls:
        if spall.surface == "roller":  # it turns with roller 0: no place on a raceway
            continue
        label = "spall" if spall.surface == "outer" else "spall on the inner raceway"
        label += " of the second row" if spall.row == 2 else ""
        width = float(spall.width) / float(arc_radius(scene.bearing, spall.surface))
        bar = {"color": ACCENT, "alpha": 0.5, "zorder": 0, "hatch": None if spall.surface == "outer" else "//"}
        ax.bar(float(spall.angle), 1.15 * top, width=width, label=None if label in named else label, **bar)
        named.add(label)
    ax.set_ylim(0.0, 1.15 * top)
    ax.set_rlabel_position(150)
    ax.yaxis.set_major_locator(MaxNLocator(3))
    ax.set_title(f"Roller load [kN], {loads_of(scene)},\n{phase_of(scene)}", pad=14, fontsize=11)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
    return ax
