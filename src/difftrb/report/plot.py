"""Figures. Every function draws on the Axes it is given (or makes one) and returns it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from difftrb.contact import gap
from difftrb.contact.contact_solution import ContactSolution
from difftrb.contact.height_map import HeightMap
from difftrb.contact.solver import pressure_patches
from difftrb.contact.strip_model import Patch
from difftrb.core.geometry import arc_radius
from difftrb.ring import ring
from difftrb.scene.scene import PitchMean, Scene, raceway_contact
from difftrb.scene.solution import Assessment, Solution

HEALTHY, SPALLED, ACCENT = "#4477AA", "#EE6677", "#BBBBBB"  # colour-blind safe (Tol, bright)
MOST = 3
"""Rollers at a spall whose contacts are drawn."""
FINE = 1e-4
"""Accuracy of contacts that are drawn: their rows are dense enough to look at."""


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
    ax.set_title(f"Roller load [kN], {loads_of(scene)},\n{phase_of(scene)}", pad=14, fontsize=11)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
    return ax


def loads_of(scene: Scene) -> str:
    """A scene's loads in words."""
    return f"{scene.load.radial:,g} N radial, {scene.load.axial:,g} N axial"


def phase_of(scene: Scene) -> str:
    """Where its rollers stand, in words."""
    return "mean over the cage's turn" if isinstance(scene.phase, PitchMean) else f"roller 0 at {scene.phase:g} rad"


class Pressed(NamedTuple):
    """One roller's contact: its number, the solution, and its pressure point by point, if it has that."""

    roller: int
    solution: ContactSolution
    patches: tuple[Patch, ...]


def contacts_at_spall(scene: Scene, solution: Solution) -> list[Pressed]:
    """The outer contacts of up to `MOST` loaded rollers that meet the first spall there; of the most loaded roller if
    none does, or there is none. Each with the load, the offset and the tilt that it has in `solution`."""
    loads, contact = np.asarray(solution.loads), raceway_contact(scene, "outer")
    spall = next(iter(ring.spalls_on(scene.spalls, "outer")), None)
    rollers, away = [int(np.argmax(loads))], np.zeros(loads.size)
    if spall is not None:
        away = np.asarray(ring.distances(scene.bearing, (spall,), solution.angles)[0])
        lines = np.maximum(loads, 0.0) / contact.length
        half = np.asarray(gap.line_half_width(lines, contact.radius, contact.modulus))
        met = np.flatnonzero((np.abs(away) < 0.5 * float(spall.width) + half) & (loads > 0.0))
        nearest = met[np.argsort(np.abs(away[met]), kind="stable")[:MOST]]
        rollers = sorted((int(j) for j in nearest), key=lambda j: away[j]) or rollers
    accuracy = min(scene.accuracy, FINE)
    tilts = 1e-3 * np.asarray(solution.effects.get("roller_tilts", np.zeros(loads.size)))
    found = (pressure_patches(contact, loads[j], spall, -float(away[j]), accuracy, float(tilts[j])) for j in rollers)
    return [Pressed(j, *one) for j, one in zip(rollers, found, strict=True)]


def pressures(found: list[Pressed]) -> Any:
    """Contact pressure of rollers at the spall, one below the other, on one scale."""
    _, axes = plt.subplots(len(found), 1, figsize=(8.5, 0.7 + 2.5 * len(found)), layout="constrained", squeeze=False)
    top = max(_scale_of(one) for one in found)
    for ax, one in zip(axes[:, 0], found, strict=True):
        pressure_map(one.solution, ax, one.patches, top)
        ax.set_title(f"Roller {one.roller}: {ax.get_title()}", fontsize=10)
    return axes[-1, 0]


def _scale_of(one: Pressed) -> float:
    """Where the colours of a contact end [N/mm²], so that only a hundredth of its area is beyond: at a sharp edge there
    is no largest pressure."""
    values, areas = np.asarray(one.solution.pressure).ravel(), np.asarray(one.solution.cells.area).ravel()
    if one.patches:
        values = np.concatenate([patch.pressure.ravel() for patch in one.patches])
        sizes = (np.gradient(patch.y)[:, None] * np.gradient(patch.x, axis=1) for patch in one.patches)
        areas = np.abs(np.concatenate([size.ravel() for size in sizes]))
    order = np.argsort(values)
    order = order[values[order] > 0.0]
    share = np.cumsum(areas[order])
    return float(values[order][np.searchsorted(share, 0.99 * share[-1])]) if order.size else 1.0


def pressure_map(
    solution: ContactSolution, ax: Axes | None = None, patches: tuple[Patch, ...] = (), limit: float | None = None
) -> Axes:
    """Contact pressure over the roller's length and the rolling direction, which is stretched: from point to point if
    there are `patches` (`pressure_patches`), else by cells.

    The colour scale ends at `limit` [N/mm²], by default where few points are beyond: at a sharp edge there is no finite
    one.
    """
    if ax is None:
        _, ax = plt.subplots(figsize=(8.0, 3.2), layout="constrained")
    solution = jax.device_get(solution)
    top = _scale_of(Pressed(0, solution, patches)) if limit is None else limit
    look = {"cmap": "viridis", "vmin": 0.0, "vmax": top, "rasterized": True}
    if patches:
        for patch in patches:
            y = np.broadcast_to(patch.y[:, None], patch.x.shape)
            mesh = ax.pcolormesh(y, patch.x, patch.pressure, shading="gouraud", **look)
        along = np.concatenate([patch.y for patch in patches])
        across = np.concatenate([patch.x.ravel() for patch in patches])
        lines, reach = np.array([along.min(), along.max()]), 1.25 * float(np.abs(across).max())
    else:
        mesh, lines, reach = _by_cells(solution, ax, look)
    ax.figure.colorbar(mesh, ax=ax, label="pressure [N/mm²]", extend="max")
    for i, (spall, offset) in enumerate(solution.spalls):
        length, width = spall.extent if isinstance(spall, HeightMap) else (spall.length, spall.width)
        corner = (float(spall.axial_offset - 0.5 * length), float(offset - 0.5 * width))
        over = patches and not isinstance(spall, HeightMap)  # nothing is carried there
        outline = {"facecolor": "#EDEDED", "alpha": 1.0 if over else 0.35, "edgecolor": SPALLED, "linewidth": 1.2}
        label = "spall" if i == 0 else None
        ax.add_patch(Rectangle(corner, float(length), float(width), zorder=2 if over else 0, label=label, **outline))
    if solution.spalls:
        ax.legend(loc="upper right", frameon=True, framealpha=0.9, edgecolor="none", fontsize=9)
    ax.set_xlim(lines[0] - 0.3, lines[1] + 0.3)
    ax.set_ylim(-reach, reach)
    ax.set_xlabel("along the roller, y [mm]")
    ax.set_ylabel("rolling direction, x [mm]")
    box = ax.get_window_extent()
    stretch = (lines[1] - lines[0]) / (2.0 * reach) * box.height / box.width
    ax.text(0.01, 0.02, f"not to scale: x stretched about {float(f'{stretch:.1g}'):g} times", fontsize=8, color="0.35",
            transform=ax.transAxes, va="bottom")  # fmt: skip
    place = ", ".join(f"{float(offset) + 0.0:.3g}" for _, offset in solution.spalls)
    place = f", {place} mm from the spall's middle" if solution.spalls else ""
    ax.set_title(f"{float(solution.load):,.0f} N{place}, approach {1e3 * float(solution.approach):.3f} µm", fontsize=10)
    return ax


def _by_cells(solution: ContactSolution, ax: Axes, look: dict[str, Any]) -> tuple[Any, np.ndarray, float]:
    """The cells of a solution; where loaded ones begin and end along the roller, and how far to look across it [mm]."""
    cells = solution.cells
    x_lines, lines, pressure = np.asarray(cells.borders), np.asarray(cells.lines), np.asarray(solution.pressure)
    if cells.mirrored:
        lines = np.concatenate([-lines[:0:-1], lines])
        pressure = np.concatenate([pressure[::-1], pressure])
    loaded = pressure > 0.0
    mesh = ax.pcolormesh(lines, x_lines, np.ma.masked_where(~loaded, pressure).T, shading="flat", **look)
    rows, columns = loaded.any(axis=1), loaded.any(axis=0)
    reach = 1.3 * float(np.max(np.abs(np.asarray(cells.x)[columns]))) if columns.any() else float(x_lines[-1])
    return mesh, np.array([lines[:-1][rows].min(), lines[1:][rows].max()]), reach


def save(ax: Any, folder: Path, name: str) -> None:
    """Write a figure, or that of an Axes, as PNG and SVG into `folder` and close it. SVG keeps words as words."""
    figure = ax if isinstance(ax, Figure) else ax.figure
    with plt.rc_context({"svg.fonttype": "none", "font.family": ["DejaVu Sans", "sans-serif"]}):
        figure.savefig(folder / f"{name}.svg", dpi=110)
        figure.set_layout_engine("none")  # it stays as laid out
        figure.savefig(folder / f"{name}.png", dpi=120, pil_kwargs={"compress_level": 1})
    plt.close(figure)


def svg_text(ax: Any) -> str:
    """The figure of `ax` as SVG, which keeps words as words; the figure is closed."""
    text = io.StringIO()
    with plt.rc_context({"svg.fonttype": "none"}):
        ax.figure.savefig(text, format="svg")
    plt.close(ax.figure)
    return text.getvalue()
