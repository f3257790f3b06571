"""Figures. Every function draws on the Axes it is given (or makes one) and returns it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from difftrb.contact.contact_solution import ContactSolution
from difftrb.contact.height_map import HeightMap
from difftrb.contact.solver import solve_contact
from difftrb.core.geometry import arc_radius
from difftrb.ring import ring
from difftrb.scene.scene import COARSEST, Scene, raceway_contact
from difftrb.scene.solution import Assessment, Solution

HEALTHY, SPALLED, ACCENT = "#4477AA", "#EE6677", "#BBBBBB"  # colour-blind safe (Tol, bright)


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
        width = float(spall.width) / float(arc_radius(scene.bearing, spall.surface))
        bar = {"color": ACCENT, "alpha": 0.5, "zorder": 0, "hatch": None if spall.surface == "outer" else "//"}
        ax.bar(float(spall.angle), 1.15 * top, width=width, label=None if label in named else label, **bar)
        named.add(label)
    ax.set_ylim(0.0, 1.15 * top)
    ax.set_rlabel_position(150)
    ax.yaxis.set_major_locator(MaxNLocator(3))
    ax.set_title(f"Roller load [kN], radial {scene.load.radial:g} N, axial {scene.load.axial:g} N", pad=14)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
    return ax


def contact_under_spall(scene: Scene, solution: Solution) -> ContactSolution:
    """The outer contact of the roller nearest to the first spall met there (of the most loaded roller if there is none,
    or the nearest carries nothing), with the load and the offset it has in `solution`."""
    roller, offset = int(np.argmax(solution.loads)), 0.0
    spall = next(iter(ring.spalls_on(scene.spalls, "outer")), None)
    if spall is not None:
        away = ring.distances(scene.bearing, (spall,), solution.angles)[0]
        nearest = int(np.argmin(np.abs(away)))
        roller = nearest if float(solution.loads[nearest]) > 0.0 else roller
        offset = -float(away[roller])
    contact, accuracy = raceway_contact(scene, "outer"), min(scene.accuracy, COARSEST)
    return jax.device_get(solve_contact(contact, solution.loads[roller], spall, offset, accuracy))


def pressure_map(solution: ContactSolution, ax: Axes | None = None) -> Axes:
    """Contact pressure over the roller's length and the rolling direction.

    The colour scale ends at the 99.5th percentile of loaded cells, because cells at a sharp edge have no finite limit.
    """
    if ax is None:
        _, ax = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
    solution = jax.device_get(solution)
    cells = solution.cells
    x_lines, lines, pressure = np.asarray(cells.borders), np.asarray(cells.lines), np.asarray(solution.pressure)
    if cells.mirrored:
        lines = np.concatenate([-lines[:0:-1], lines])
        pressure = np.concatenate([pressure[::-1], pressure])
    loaded = pressure > 0.0
    limit = float(np.percentile(pressure[loaded], 99.5)) if loaded.any() else 1.0
    shown = np.ma.masked_where(~loaded, pressure)
    mesh = ax.pcolormesh(lines, x_lines, shown.T, cmap="viridis", vmin=0.0, vmax=limit, shading="flat", rasterized=True)
    ax.figure.colorbar(mesh, ax=ax, label="pressure [MPa]", extend="max")
    spalls = solution.spalls
    for i, (spall, offset) in enumerate(spalls):
        length, width = spall.extent if isinstance(spall, HeightMap) else (spall.length, spall.width)
        corner = (float(spall.axial_offset - 0.5 * length), float(offset - 0.5 * width))
        outline = {"facecolor": ACCENT, "alpha": 0.35, "edgecolor": "black", "linestyle": "--"}
        label = "spall" if i == 0 else None
        ax.add_patch(Rectangle(corner, float(length), float(width), zorder=0, label=label, **outline))
    if spalls:
        ax.legend(loc="upper right", frameon=False)
    rows, columns = loaded.any(axis=1), loaded.any(axis=0)
    reach = 1.3 * np.max(np.abs(np.asarray(cells.x)[columns])) if columns.any() else float(x_lines[-1])
    ax.set_xlim(lines[:-1][rows].min() - 0.3, lines[1:][rows].max() + 0.3)
    ax.set_ylim(-reach, reach)
    ax.set_xlabel("along the roller, y [mm]")
    ax.set_ylabel("rolling direction, x [mm]")
    ax.set_title(
        f"Contact pressure, roller load {float(solution.load):.0f} N, approach {1e3 * solution.approach:.3f} µm"
    )
    return ax


def stiffness_bars(result: Assessment, scene: Scene) -> tuple[Any, Any]:
    """Radial and axial stiffness, healthy and spalled, with the loss in percent; two Axes side by side."""
    _, axes = plt.subplots(1, 2, figsize=(6.0, 3.6), layout="constrained")
    for ax, name, loss in zip(axes, ("radial", "axial"), np.asarray(result.loss), strict=True):
        values = [float(getattr(s, f"{name}_stiffness")) / 1e3 for s in (result.healthy, result.spalled)]
        bars = ax.bar(["healthy", "with spall"], values, width=0.6, color=[HEALTHY, SPALLED])
        ax.bar_label(bars, fmt="%.4g", padding=2)
        ax.set_title(f"{name}: loss {loss:.2f} %")
        ax.margins(y=0.12)
    axes[0].set_ylabel(f"{scene.definition} stiffness [kN/mm]")
    return axes[0], axes[1]


def save(ax: Any, folder: Path, name: str) -> None:
    """Write the figure of `ax` as PNG and SVG into `folder` and close it."""
    figure = ax.figure
    for kind in ("png", "svg"):
        figure.savefig(folder / f"{name}.{kind}", dpi=160, bbox_inches="tight")
    plt.close(figure)
