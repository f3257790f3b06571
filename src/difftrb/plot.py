"""Figures. Every function draws on the Axes it is given (or makes one) and returns it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from difftrb import confidence
from difftrb.contact_solution import ContactSolution
from difftrb.fitted import Fit
from difftrb.geometry import arc_radius
from difftrb.heightmap import HeightMap
from difftrb.scene import Scene
from difftrb.solution import Assessment
from difftrb.swept import Swept

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
    for i, spall in enumerate(scene.spalls):
        half = 0.5 * float(spall.width) / float(arc_radius(scene.bearing))
        label = "spall" if i == 0 else None
        ax.bar(float(spall.angle), 1.15 * top, width=2.0 * half, color=ACCENT, alpha=0.5, zorder=0, label=label)
    ax.set_ylim(0.0, 1.15 * top)
    ax.set_rlabel_position(150)
    ax.yaxis.set_major_locator(MaxNLocator(3))
    ax.set_title(f"Roller load [kN], radial {scene.load.radial:g} N, axial {scene.load.axial:g} N", pad=14)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
    return ax


def pressure_map(solution: ContactSolution, ax: Axes | None = None) -> Axes:
    """Contact pressure over the roller's length and the rolling direction.

    The colour scale ends at the 99.5th percentile of loaded cells, because cells at a sharp edge have no finite limit.
    """
    if ax is None:
        _, ax = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
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


def swept(result: Swept, name: str) -> Any:
    """A sweep's result: a map over its first two axes, curves where there is one."""
    many = [dim for dim in result.dims if result.status_code.shape[result.dims.index(dim)] > 1]
    return sweep_map(result, name) if len(many) > 1 else sweep_curves(result, name)


def sweep_curves(result: Swept, name: str, ax: Any = None, along: str | None = None, over: str | None = None) -> Any:
    """A result over the axis `along` (default: the first with several values), one curve for up to five values of the
    axis `over` (None: one curve), other axes at their middle; tangents where there is a gradient by `along`."""
    along = along or _several(result)[0]
    if ax is None:
        _, ax = plt.subplots(figsize=(4.8, 3.4), layout="constrained")
    places = [0] if over is None else np.unique(np.linspace(0, len(result.coordinates[over]) - 1, 5).astype(int))
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(places)))
    for place, colour in zip(places, colours, strict=True):
        x, (y, slope) = _cut(result, name, (along,), {} if over is None else {over: int(place)})
        label = None if over is None else _label(result, over, float(result.coordinates[over][place]))
        ax.plot(x[0], y, color=colour if over else HEALTHY, lw=1.6, label=label, marker="." if len(y) < 40 else None)
        if along in slope:
            step = max(1, len(y) // 8)
            reach = 0.03 * (x[0][-1] - x[0][0])
            for i in range(step // 2, len(y), step):
                ends = np.array([-reach, reach])
                ax.plot(x[0][i] + ends, y[i] + slope[along][i] * ends, color="black", lw=1.0)
    ax.set_xlabel(_label(result, along))
    ax.set_ylabel(_label(result, name))
    if over is not None:
        ax.legend(frameon=False)
    return ax


def sweep_map(result: Swept, name: str, ax: Any = None, x: str | None = None, y: str | None = None) -> Any:
    """A result over two axes (default: the first two with several values), other axes at their middle, as a map with
    contours; arrows point where it rises, if there are gradients by both; grey where there is no solution.

    Arrows are the gradient in units of the axes' ranges.
    """
    x, y = x or _several(result)[0], y or _several(result)[1]
    if ax is None:
        _, ax = plt.subplots(figsize=(5.2, 3.8), layout="constrained")
    (across, up), (values, slope) = _cut(result, name, (x, y))
    ax.set_facecolor(ACCENT)
    mesh = ax.pcolormesh(across, up, values.T, cmap="viridis", shading="nearest", rasterized=True)
    if np.isfinite(values).sum() > 4 and np.nanmin(values) < np.nanmax(values) and min(values.shape) > 1:
        lines = ax.contour(across, up, values.T, colors="white", linewidths=0.6, levels=6)
        ax.clabel(lines, fontsize=7, fmt="%.4g")
    ax.figure.colorbar(mesh, ax=ax, label=_label(result, name))
    if x in slope and y in slope and np.isfinite(values).any():
        shown = np.ix_(*(np.arange(n // 12 // 2, n, max(1, n // 12)) for n in values.shape))
        rise = [slope[x][shown] * np.ptp(across), slope[y][shown] * np.ptp(up)]
        places = np.meshgrid(across[shown[0].ravel()], up[shown[1].ravel()], indexing="ij")
        known = np.isfinite(rise[0] + rise[1]) & (np.hypot(*rise) > 0.0)
        if known.any():
            places, rise = ([part[known] for part in parts] for parts in (places, rise))
            ax.quiver(*places, *rise, color="black", angles="uv", width=0.004, pivot="mid")
    ax.set_xlabel(_label(result, x))
    ax.set_ylabel(_label(result, y))
    return ax


def _several(result: Swept) -> list[str]:
    """Keys of the dimensions with several values, all others behind; of zipped axes the first."""
    counts = dict(zip(result.dims, result.status_code.shape, strict=True))
    keys = [dim if dim in result.coordinates else next(iter(result.coordinates)) for dim in result.dims]
    return sorted(keys, key=lambda key: counts.get(key, 2) < 2)


def _cut(
    result: Swept, name: str, along: tuple[str, ...], at: dict[str, int] | None = None
) -> tuple[list[np.ndarray], tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Coordinates along some axes, a result over them, and its slopes; other axes `at` a place, or at their middle."""
    dims = [dim if dim in result.coordinates else along[0] for dim in result.dims]  # zipped axes: by one of them
    chosen = tuple(slice(None) if dim in along else (at or {}).get(dim, count // 2)
                   for dim, count in zip(dims, result.status_code.shape, strict=True))  # fmt: skip
    order = np.argsort([along.index(dim) for dim in dims if dim in along])

    def cut(values: np.ndarray) -> np.ndarray:
        back = np.argsort(order)
        return np.transpose(values[chosen], back)

    slopes = {key: cut(values) for key, values in result.gradients[name].items()}
    return [result.coordinates[key] for key in along], (cut(result.values[name]), slopes)


def _label(result: Swept, name: str, value: float | None = None) -> str:
    """A key or a result in words, with its unit or, with a value, with that."""
    unit = result.units.get(name, "")
    words = name.replace("_", " ").replace("spall.0.", "spall ").replace(".", " ")
    if value is not None:
        return f"{words} {value:.4g} {unit}".rstrip()
    return f"{words} [{unit}]" if unit else words


def save(ax: Any, folder: Path, name: str) -> None:
    """Write the figure of `ax` as PNG and SVG into `folder` and close it."""
    figure = ax.figure
    for kind in ("png", "svg"):
        figure.savefig(folder / f"{name}.{kind}", dpi=160, bbox_inches="tight")
    plt.close(figure)


def fit_panels(fit: Fit) -> Any:
    """What a fit says, in four Axes: measured against model, residuals, profiles, and the ridge of the first two."""
    _, axes = plt.subplots(2, 2, figsize=(8.4, 6.8), layout="constrained")
    losses = [k for k, row in enumerate(fit.rows) if row.is_loss]
    shown = losses or list(range(len(fit.rows)))
    scale, unit = (1.0, "loss of stiffness [%]") if losses else (1e-6, "stiffness [kN/µm]")
    fit_against_data(fit, shown, scale, unit, axes[0, 0])
    residuals(fit, axes[0, 1])
    profiles(fit, axes[1, 0])
    if len(fit.parameters) > 1:
        ridge(fit, axes[1, 1])
    else:
        axes[1, 1].set_axis_off()
    return axes[0, 0]


def fit_against_data(fit: Fit, shown: list[int], scale: float, unit: str, ax: Axes) -> Axes:
    """Model against measurement with error bars, rows `shown`; on the line they agree."""
    for direction, colour, marker in (("radial", HEALTHY, "o"), ("axial", SPALLED, "s")):
        rows = [k for k in shown if fit.rows[k].quantity.startswith(direction)]
        if rows:
            measured = scale * np.array([float(fit.rows[k].value) for k in rows])
            ax.errorbar(scale * fit.predicted[rows], measured, 1.96 * scale * fit.sigma[rows], fmt=marker, ms=5,
                        color=colour, mfc="none", lw=1.0, capsize=2, label=direction)  # fmt: skip
    limits = np.array([*ax.get_xlim(), *ax.get_ylim()])
    ends = limits.min(), limits.max()
    ax.plot(ends, ends, color="black", lw=0.8, zorder=0)
    ax.set(xlim=ends, ylim=ends, xlabel=f"model: {unit}", ylabel=f"measured: {unit}", title="Fit (bars: 95 %)")
    ax.legend(frameon=False)
    return ax


def residuals(fit: Fit, ax: Axes) -> Axes:
    """What the model leaves of every row, in sigma."""
    at = np.arange(1, len(fit.rows) + 1)
    colours = [HEALTHY if row.quantity.startswith("radial") else SPALLED for row in fit.rows]
    ax.axhspan(-1.96, 1.96, color=ACCENT, alpha=0.35, lw=0)
    ax.axhline(0.0, color="black", lw=0.8)
    ax.bar(at, fit.residuals, width=0.6, color=colours)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="row", ylabel="measured − model [σ]", title="Residuals (band: 95 %)")
    return ax


def profiles(fit: Fit, ax: Axes) -> Axes:
    """Rise of χ² with each parameter held, all others free, over the parameter relative to its fitted value."""
    limit = fit.limit
    styles = zip(fit.parameters, (HEALTHY, SPALLED, "#228833", "#AA3377", "#CCBB44", "#66CCEE", "black"),
                 ("-", "--", "-.", ":", "-", "--", "-."), strict=False)  # fmt: skip
    widest = 0.0
    for i, (name, colour, style) in enumerate(styles):
        values = fit.along(i, fit.profiles.coordinates[i])
        relative = (values - fit.values[i]) / (abs(fit.values[i]) or 1.0) * 100.0
        rise = np.maximum(fit.profiles.rise[i], 0.0)
        low = rise < 2.5 * limit
        widest = max(widest, float(np.max(np.abs(relative[low]))))
        ax.plot(relative[low], rise[low], style, color=colour, label=f"{name} {fit.values[i]:.3g} {fit.units[i]}")
    ax.axhline(limit, color="black", lw=0.8)
    ax.text(0.02, limit, "95 %", va="bottom", transform=ax.get_yaxis_transform())
    ax.set(xlabel="parameter against its fitted value [%]", ylabel="rise of χ²", ylim=(0.0, 2.5 * limit))
    ax.set(title="Profiles of the likelihood")
    ax.legend(frameon=False, loc="upper center")
    return ax


def ridge(fit: Fit, ax: Axes) -> Axes:
    """Rise of χ² over the first two parameters, all others free: 68, 95 and 99.7 % regions."""
    box = np.clip(np.stack([_wider(fit, i) for i in (0, 1)]), -confidence.EDGE, confidence.EDGE)
    rise = np.asarray(fit.ridge(box))
    first, second = (fit.along(k, np.linspace(box[k, 0], box[k, 1], len(rise))) for k in (0, 1))
    scale = fit.limit / 1.959963984540054**2  # larger if sigma was estimated
    levels = [0.0, *(scale * v for v in (2.296, 5.991, 11.829))]  # of χ² of two degrees of freedom
    ax.contourf(first, second, np.maximum(rise.T, 0.0), levels, colors=("#4477AA", "#99B8D8", "#DDE7F1"))
    ax.plot(fit.values[0], fit.values[1], "+", color=SPALLED, ms=10, mew=2, label="fit")
    ax.set(xlabel=f"{fit.parameters[0]} [{fit.units[0]}]", ylabel=f"{fit.parameters[1]} [{fit.units[1]}]")
    ax.set_title("Ridge: 68, 95, 99.7 %")
    ax.legend(frameon=False)
    return ax


def _wider(fit: Fit, i: int) -> np.ndarray:
    """Coordinates somewhat beyond an interval."""
    low, high = fit.profiles.ends[i]
    return np.array([fit.place[i] - 2.1 * (fit.place[i] - low), fit.place[i] + 2.1 * (high - fit.place[i])])
