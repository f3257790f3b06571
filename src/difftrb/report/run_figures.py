"""The figures of a run: which it has, and why one is missing; those of roller loads, of stiffness as the cage turns,
and of what a spall of any size takes of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from difftrb.core.geometry import arc_radius
from difftrb.report import bearing_drawing, pressure_figure
from difftrb.report.figure_style import ACCENT, HEALTHY, SPALLED, loads_of, phase_of
from difftrb.report.run_text import DIRECTIONS
from difftrb.scene.scene import PitchMean, Scene
from difftrb.scene.solution import Assessment
from difftrb.turning import spall_loss
from difftrb.turning.spall_loss import LossMap, Turn

NO_TURN = (
    "Stiffness over the cage's turn is drawn where the roller law holds at every phase and spalls stay on the outer "
    "raceway; `difftrb stiffness` tells it of all."
)
NO_MAP = (
    "Loss over length and width is drawn where the roller law holds at every phase, for a wide spall on the outer "
    "raceway; `difftrb sweep` over spall.0.length and spall.0.width does it for all."
)
LABELS = 0.9
"""Height of the row in which contours of loss are named, from the bottom to the top of the map."""
BY_DESIGN = (NO_TURN, NO_MAP)
"""What need not be said but on the page."""


def figures(scene: Scene, result: Assessment, mean: Assessment | None, missing: list[str]) -> Iterator[tuple[str, Any]]:
    """Names and Axes, or Figures, of a solved and prepared scene; `missing` gets a sentence for each left out."""
    yield "bearing", bearing_drawing.bearing(scene, result.spalled)
    yield "load_distribution", load_distribution(result, scene)
    pressed = pressure_figure.contacts_at_spall(scene, result.spalled)
    if all(bool(one.solution.converged) for one in pressed):
        yield "pressure", pressure_figure.pressures(pressed)
    else:
        missing.append(f"no pressure map: {next(o.solution.status for o in pressed if not bool(o.solution.converged))}")
    turn = spall_loss.over_turn(scene)
    if turn is None:
        missing.append(NO_TURN)
    else:
        yield "stiffness", stiffness_over_turn(turn, scene)
    if not scene.spalls:
        return
    mean = result if mean is None and turn is not None and isinstance(scene.phase, PitchMean) else mean
    found = None if mean is None else spall_loss.loss_map(scene, *spall_loss.sizes_around(scene))
    if found is None or mean is None:
        missing.append(NO_MAP)
    else:
        yield "loss", loss_over_sizes(found, scene, mean)


def stiffness_over_turn(turn: Turn, scene: Scene) -> Figure:
    """Radial and axial stiffness over one roller pitch, healthy and with spalls; dashed where the scene's phase is."""
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 3.5))
    figure.subplots_adjust(left=0.07, right=0.98, bottom=0.27, top=0.82, wspace=0.14)  # to lay it out takes longer
    pitch = turn.phases[-1]
    for ax, (name, k) in zip(axes, DIRECTIONS.items(), strict=True):
        healthy, spalled = turn.healthy[:, k, k] / 1e3, turn.stiffness[:, k, k] / 1e3
        ax.plot(turn.phases, healthy, color=HEALTHY, lw=1.8, label="healthy")
        if scene.spalls:
            ax.plot(turn.phases, spalled, color=SPALLED, lw=1.8, label="with spall")
            ax.fill_between(turn.phases, spalled, healthy, color=SPALLED, alpha=0.12, lw=0)
        if not isinstance(scene.phase, PitchMean):
            ax.axvline(
                float(scene.phase) % pitch,
                color="black",
                lw=1.4,
                ls="--",
                clip_on=False,
                label=f"phase {scene.phase:g} rad",
            )
        ax.set_xlim(0.0, pitch)
        ax.margins(y=0.12)
        ax.set_title(f"{name}, {scene.definition}", fontsize=10)
        ax.set_xlabel("cage angle of roller 0 from the load line [rad]")
        ax.grid(color=ACCENT, lw=0.4, alpha=0.6)
    axes[0].set_ylabel("stiffness [kN/mm]")
    axes[0].legend(frameon=False, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.22), fontsize=9)
    axes[1].text(0.5, -0.33, f"one roller pitch; repeats {scene.bearing.rollers} times a turn of the cage", fontsize=9,
                 transform=axes[1].transAxes, ha="center", color="0.35")  # fmt: skip
    figure.suptitle(f"Stiffness over the cage's turn, {loads_of(scene)}", fontsize=11)
    return figure


def loss_over_sizes(found: LossMap, scene: Scene, mean: Assessment) -> Figure:
    """Loss of radial and axial stiffness in the mean over the cage's turn, over the first spall's length and width; the
    present spall is marked, its gradient drawn bold."""
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.1), layout="constrained")
    one = len(scene.spalls) == 1
    which, beside = ("this spall", "") if one else ("spall 0", ", with all spalls, over the size of spall 0")
    for row, (ax, (name, _)) in enumerate(zip(axes, DIRECTIONS.items(), strict=True)):
        _map(found, row, ax)
        spall, healthy = scene.spalls[0], float(np.asarray(mean.healthy.both_stiffnesses)[row])
        slopes = [-100.0 * float(np.asarray(by)[row, 0]) / healthy for by in (mean.by_length, mean.by_width)]
        _arrow(ax, found, (float(spall.length), float(spall.width)), slopes, which)
        by = f"{slopes[0]:+.2g} %/mm by length, {slopes[1]:+.2g} by width"
        ax.set_title(f"{name}: {float(mean.loss[row]):.2f} %, {by}", fontsize=10)
        ax.set_xlabel("spall length [mm]")
    axes[0].set_ylabel("spall width [mm]")
    figure.suptitle(
        f"Loss of {scene.definition} stiffness in the mean over the cage's turn, {loads_of(scene)}{beside}", fontsize=11
    )
    return figure


def _map(found: LossMap, row: int, ax: Axes) -> None:
    x, y, loss = found.lengths, found.widths, found.loss[row]
    ax.set_facecolor(ACCENT)  # where the law knows no spall
    fine_x, fine_y = (np.linspace(axis[0], axis[-1], 6 * len(axis)) for axis in (x, y))
    smooth = loss_between(found, row, fine_x, fine_y)
    mesh = ax.pcolormesh(fine_x, fine_y, smooth, cmap="viridis", shading="gouraud", rasterized=True)
    if np.isfinite(smooth).sum() > 4 and np.nanmax(smooth) > np.nanmin(smooth):
        lines = ax.contour(fine_x, fine_y, np.ma.masked_invalid(smooth), colors="white", linewidths=0.8, levels=6)
        ax.clabel(
            lines, fontsize=8, fmt="%.3g %%", manual=_label_places(fine_x, fine_y, smooth, np.asarray(lines.levels))
        )
    rise = [found.by_length[row] * np.ptp(x), found.by_width[row] * np.ptp(y)]
    places = np.meshgrid(x, y, indexing="ij")
    inner = np.zeros(loss.shape, bool)
    inner[1:-1, 1:-1] = True
    shown = inner & np.isfinite(rise[0] + rise[1]) & (np.hypot(*rise) > 0.0)
    if shown.any():
        arrows = [part[shown] for part in (*places, *rise)]
        ax.quiver(*arrows, color="white", alpha=0.9, angles="uv", width=0.005, pivot="mid",
                  scale=12.0 * np.hypot(*rise)[shown].max())  # fmt: skip
    ax.figure.colorbar(mesh, ax=ax, label="loss [%]")


def loss_between(found: LossMap, row: int, lengths: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Loss [%] of one direction between the sizes of a map [mm], by its values and slopes; shape (widths, lengths)."""
    x, y = found.lengths, found.widths
    along = _between(x, found.loss[row], found.by_length[row], lengths)
    by_width = np.stack([np.interp(lengths, x, column) for column in found.by_width[row].T], axis=1)
    return _between(y, along.T, by_width.T, widths)


def _label_places(x: np.ndarray, y: np.ndarray, loss: np.ndarray, levels: np.ndarray) -> list[tuple[float, float]]:
    """Where contours are named: in a row above the arrows, where they cross it away from the sides."""
    row = round(LABELS * (len(y) - 1))
    at = [float(np.interp(level, loss[row], x)) for level in levels]
    aside = 0.05 * float(np.ptp(x))
    return [(place, float(y[row])) for place in at if x[0] + aside < place < x[-1] - aside]


def _between(x: np.ndarray, values: np.ndarray, slopes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Cubics through values and slopes at `x`, along the first axis."""
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    step = (x[k + 1] - x[k])[:, None]
    t = (at - x[k])[:, None] / step
    rise = values[k + 1] - values[k]
    low, high = step * slopes[k] - rise, rise - step * slopes[k + 1]
    return values[k] + t * rise + t * (1.0 - t) * ((1.0 - t) * low + t * high)


def _arrow(ax: Axes, found: LossMap, at: tuple[float, float], slopes: list[float], which: str) -> None:
    """The spall as it is, and where its loss rises, in units of the axes' ranges as the other arrows."""
    ax.plot(*at, "o", ms=8, mfc="white", mec=SPALLED, mew=2.2, zorder=6)
    rise = np.array([slopes[0] * np.ptp(found.lengths), slopes[1] * np.ptp(found.widths)])
    if np.hypot(*rise) > 0.0:
        ax.quiver(*at, *rise / np.hypot(*rise), color=SPALLED, angles="uv", width=0.012, scale=6.0, zorder=5)
    ax.annotate(f"{which}:\n{at[0]:g} × {at[1]:g} mm", at, (-10, 0), textcoords="offset points", color="white",
                fontsize=9, ha="right", va="center", weight="bold")  # fmt: skip


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
