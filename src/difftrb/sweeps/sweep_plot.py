"""Figures of sweeps: curves and maps, with their slopes."""

from __future__ import annotations

from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from difftrb.report.figure_style import ACCENT, HEALTHY
from difftrb.sweeps.outputs import label_of
from difftrb.sweeps.swept import Swept

LONGEST = 3.0
"""Of arrows, by the length that half of them have: steps in a law would draw them over all others."""


def swept(result: Swept, name: str) -> Any:
    """A sweep's result: a map over its first two axes, curves where there is one."""
    several = [count for count in result.status_code.shape if count > 1]
    return sweep_map(result, name) if len(several) > 1 else sweep_curves(result, name)


def sweep_curves(result: Swept, name: str, ax: Any = None, along: str | None = None, over: str | None = None) -> Any:
    """A result over the axis `along` (default: the first with several values), one curve for up to five values of the
    axis `over` (None: one curve), other axes at their middle; tangents where there is a gradient by `along`."""
    along = along or _by_count(result)[0]
    if ax is None:
        _, ax = plt.subplots(figsize=(4.8, 3.4), layout="constrained")
    places = [0] if over is None else np.unique(np.linspace(0, len(result.coordinates[over]) - 1, 5).astype(int))
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(places)))
    for place, colour in zip(places, colours, strict=True):
        (x,), y, slope = _cut(result, name, (along,), {} if over is None else {over: int(place)})
        label = None if over is None else _label(result, over, float(result.coordinates[over][place]))
        ax.plot(x, y, color=colour if over else HEALTHY, lw=1.6, label=label, marker="." if len(y) < 40 else None)
        if along in slope:
            step = max(1, len(y) // 8)
            ends = 0.03 * (x[-1] - x[0]) * np.array([-1.0, 1.0])
            for i in range(step // 2, len(y), step):
                ax.plot(x[i] + ends, y[i] + slope[along][i] * ends, color="black", lw=1.0)
    ax.set(xlabel=_label(result, along), ylabel=_label(result, name))
    ax.set_title(_where(result, (along,) if over is None else (along, over)), fontsize=8)
    if over is not None:
        ax.legend(frameon=False)
    return ax


def sweep_map(result: Swept, name: str, ax: Any = None, x: str | None = None, y: str | None = None) -> Any:
    """A result over two axes (default: the first two with several values), other axes at their middle, as a map with
    contours; arrows point where it rises, if there are gradients by both; grey where there is no solution.

    Arrows are the gradient in units of the axes' ranges; the longest are cut.
    """
    x, y = x or _by_count(result)[0], y or _by_count(result)[1]
    if ax is None:
        _, ax = plt.subplots(figsize=(5.2, 3.8), layout="constrained")
    (across, up), values, slope = _cut(result, name, (x, y))
    ax.set_facecolor(ACCENT)
    mesh = ax.pcolormesh(across, up, values.T, cmap="viridis", shading="nearest", rasterized=True)
    if np.isfinite(values).sum() > 4 and np.nanmin(values) < np.nanmax(values) and min(values.shape) > 1:
        lines = ax.contour(across, up, values.T, colors="white", linewidths=0.6, levels=6)
        ax.clabel(lines, fontsize=7, fmt="%.4g")
    ax.figure.colorbar(mesh, ax=ax, label=_label(result, name))
    if x in slope and y in slope:
        shown = np.ix_(*(np.arange(n // 9 // 2, n, max(1, -(-n // 9))) for n in values.shape))
        rise = np.array([slope[x][shown] * np.ptp(across), slope[y][shown] * np.ptp(up)])
        places = np.array(np.meshgrid(across[shown[0].ravel()], up[shown[1].ravel()], indexing="ij"))
        size = np.hypot(*rise)
        known = np.isfinite(size) & (size > 0.0)
        if known.any():
            rise = rise * np.minimum(1.0, LONGEST * np.median(size[known]) / np.where(known, size, 1.0))
            ax.quiver(*places[:, known], *rise[:, known], color="white", angles="uv", width=0.003, pivot="mid")
    ax.set(xlabel=_label(result, x), ylabel=_label(result, y))
    ax.set_title(_where(result, (x, y)), fontsize=8)
    return ax


def _where(result: Swept, along: tuple[str, ...]) -> str:
    """At which loads and phase, and where on the axes that a figure does not show."""
    own = {key: f"{value:,g}" if isinstance(value, float) else value
           for key, value in result.about.get("at", {}).items() if value is not None}  # fmt: skip
    words = [f"{own[f'load.{way}']} N {way}" for way in ("radial", "axial") if f"load.{way}" in own]
    phase = own.get("stiffness.phase")
    if phase is not None:
        words.append("mean over the cage's turn" if phase == "mean" else f"roller 0 at {phase} rad")
    for key, count in _counts(result).items():
        if key not in along and count:
            words.append(_label(result, key, float(result.coordinates[key][count // 2])))
    return ", ".join(words)


def _by_count(result: Swept) -> list[str]:
    """Keys of the dimensions with several values, all others behind; of zipped axes the first."""
    counts = _counts(result)
    return sorted(counts, key=lambda key: counts[key] < 2)


def _counts(result: Swept) -> dict[str, int]:
    """Of values by the dimension's key, of zipped axes the first's."""
    keys = [dim if dim in result.coordinates else next(iter(result.coordinates)) for dim in result.dims]
    return dict(zip(keys, result.status_code.shape, strict=True))


def _cut(
    result: Swept, name: str, along: tuple[str, ...], at: dict[str, int] | None = None
) -> tuple[list[np.ndarray], np.ndarray, dict[str, np.ndarray]]:
    """Coordinates along some axes, a result over them, and its slopes; other axes `at` a place, or at their middle."""
    dims = [dim if dim in result.coordinates else along[0] for dim in result.dims]  # zipped axes: by one of them
    chosen = tuple(slice(None) if dim in along else (at or {}).get(dim, count // 2)
                   for dim, count in zip(dims, result.status_code.shape, strict=True))  # fmt: skip
    order = np.argsort([along.index(dim) for dim in dims if dim in along])
    slopes = {key: np.transpose(values[chosen], order) for key, values in result.gradients[name].items()}
    return [result.coordinates[key] for key in along], np.transpose(result.values[name][chosen], order), slopes


def _label(result: Swept, name: str, value: float | None = None) -> str:
    """A key or a result in words, with its unit or with a value."""
    unit = result.units.get(name, "")
    key = name.replace("_", " ").replace("spall.0.", "spall ").replace(".", " ")
    words = key if name in result.coordinates else label_of(name)
    if value is not None:
        return f"{words} {value:.4g} {unit}".rstrip()
    return f"{words} [{unit}]" if unit else words
