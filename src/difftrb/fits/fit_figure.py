"""The figures of a fit: measured against model, residuals, profiles, what is traded for what; and of its posterior."""

from __future__ import annotations

import itertools
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from difftrb.fits.fit_result import Fit
from difftrb.fits.least_squares import AT_BOUND
from difftrb.fits.measured import ENTRIES
from difftrb.fits.posterior import Posterior
from difftrb.fits.profile_intervals import CONFIDENCE, limit_of
from difftrb.report.figure_style import ACCENT, HEALTHY, SPALLED

WIDE = np.sqrt(limit_of(None))
"""Standard errors to either side of an interval of the normal distribution."""
COLOURS, MARKERS = (HEALTHY, SPALLED, "#228833", "#AA3377", "#CCBB44", "#66CCEE"), "os^vD*"
"""Of what is measured, by `ENTRIES`."""
PERCENT = f"{100.0 * CONFIDENCE:g} %"
BINS = 20
"""With more of them the few hundred draws that are independent look ragged."""
REGIONS = 0.68, 0.95
"""What the two regions of a pair hold."""


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
    for entry, colour, marker in zip(ENTRIES, COLOURS, MARKERS, strict=True):
        rows = [k for k in shown if fit.rows[k].entry == entry]
        if rows:
            measured = scale * np.array([float(fit.rows[k].value) for k in rows])
            ax.errorbar(scale * fit.predicted[rows], measured, WIDE * scale * fit.sigma[rows], fmt=marker, ms=5,
                        color=colour, mfc="none", lw=1.0, capsize=2, label=entry.replace("_", " by "))  # fmt: skip
    limits = np.array([*ax.get_xlim(), *ax.get_ylim()])
    ends = limits.min(), limits.max()
    ax.plot(ends, ends, color="black", lw=0.8, zorder=0)
    ax.set(xlim=ends, ylim=ends, xlabel=f"model: {unit}", ylabel=f"measured: {unit}", title=f"Fit (bars: {PERCENT})")
    ax.legend(frameon=False)
    return ax


def residuals(fit: Fit, ax: Axes) -> Axes:
    """What the model leaves of every row, in sigma."""
    at = np.arange(1, len(fit.rows) + 1)
    colours = [COLOURS[list(ENTRIES).index(row.entry)] for row in fit.rows]
    ax.axhspan(-WIDE, WIDE, color=ACCENT, alpha=0.35, lw=0)
    ax.axhline(0.0, color="black", lw=0.8)
    ax.bar(at, fit.residuals, width=0.6, color=colours)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="row", ylabel="measured − model [σ]", title=f"Residuals (band: {PERCENT})")
    return ax


def profiles(fit: Fit, ax: Axes) -> Axes:
    """Rise of χ² with each parameter held, all others free, over how far it is from its fitted value, by half the
    length of its interval: so that all can be seen, whatever their units and how well they are known."""
    limit = fit.limit
    styles = zip(
        fit.labels, itertools.cycle((*COLOURS, "black")), itertools.cycle(("-", "--", "-.", ":")), strict=False
    )
    for i, (name, colour, style) in enumerate(styles):
        values, (low, high) = fit.along(i, fit.profiles.coordinates[i]), fit.own_intervals[i]
        away = 2.0 * (values - fit.values[i]) / ((high - low) or 1.0)
        rise = np.maximum(fit.profiles.rise[i], 0.0)
        near = rise < 4.0 * limit
        label = f"{name} {fit.values[i]:.4g} ({low:.4g} … {high:.4g}) {fit.units[i]}"
        ax.plot(*_parabolas(away[near], rise[near]), style, color=colour, label=label)
    ax.axhline(limit, color="black", lw=0.8)
    ax.text(0.02, limit, PERCENT, va="bottom", transform=ax.get_yaxis_transform())
    ax.set(xlabel="from the fitted value, by half the interval", ylabel="rise of χ²", ylim=(0.0, 3.5 * limit))
    ax.set(title="Profiles of the likelihood")
    ax.legend(frameon=False, loc="upper center", fontsize=8)  # in the upper third, above the curves
    return ax


def _parabolas(away: np.ndarray, rise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Many points of a profile through a few: between them its root is straight, as about any minimum it is."""
    fine = np.union1d(away, np.linspace(away[0], away[-1], 20 * len(away)))
    return fine, np.interp(fine, away, np.sign(away) * np.sqrt(rise)) ** 2


def ridge(fit: Fit, ax: Axes) -> Axes:
    """Rise of χ² over the first two parameters, all others free: 68, 95 and 99.7 % regions."""
    box = np.clip(np.stack([_wider(fit, i) for i in (0, 1)]), -AT_BOUND, AT_BOUND)
    rise = np.asarray(fit.ridge(box))
    first, second = (fit.along(k, np.linspace(box[k, 0], box[k, 1], len(rise))) for k in (0, 1))
    scale = fit.limit / limit_of(None)  # larger if sigma was estimated
    levels = [0.0, *(scale * v for v in (2.296, 5.991, 11.829))]  # of χ² of two degrees of freedom
    ax.contourf(first, second, np.maximum(rise.T, 0.0), levels, colors=("#4477AA", "#99B8D8", "#DDE7F1"))
    ax.plot(fit.values[0], fit.values[1], "+", color=SPALLED, ms=10, mew=2, label="fit")
    ax.set(xlabel=f"{fit.labels[0]} [{fit.units[0]}]", ylabel=f"{fit.labels[1]} [{fit.units[1]}]")
    ax.set_title("Ridge: 68, 95, 99.7 %")
    ax.legend(frameon=False)
    return ax


def _wider(fit: Fit, i: int) -> np.ndarray:
    """Coordinates somewhat beyond an interval."""
    low, high = fit.profiles.ends[i]
    return np.array([fit.point[i] - 2.1 * (fit.point[i] - low), fit.point[i] + 2.1 * (high - fit.point[i])])


def corner(posterior: Posterior, fitted: dict[str, float] | None = None) -> Any:
    """Histograms with 95 % intervals, and for pairs the regions that hold 68 and 95 %; a cross where the fit is."""
    n, marks = len(posterior.parameters), fitted or {}
    figure, grid = plt.subplots(n, n, figsize=(2.0 + 2.0 * n, 2.0 + 2.0 * n), squeeze=False, layout="constrained")
    labels = [f"{name} [{unit}]" for name, unit in zip(posterior.parameters, posterior.units, strict=True)]
    for i, row in enumerate(grid):
        for k, ax in enumerate(row):
            if k > i:
                ax.set_axis_off()
            elif k == i:
                _alone(posterior, i, marks, ax)
            else:
                _pair(posterior, k, i, marks, ax)
            ax.xaxis.set_major_locator(MaxNLocator(4))
            if k < i:
                ax.yaxis.set_major_locator(MaxNLocator(4))
            ax.set_xlabel(labels[k] if i == n - 1 else "")
            ax.set_ylabel(labels[i] if k == 0 and i > 0 else "")
            ax.tick_params(labelbottom=i == n - 1, labelleft=k == 0 and i > 0)
    if n == 1:  # narrow, and there are no regions
        title = "Posterior: 95 % interval" + ("; red: the fit" if marks else "")
    else:
        title = "Posterior: 95 % intervals; 68 and 95 % regions" + ("; cross: the fit" if marks else "")
    figure.suptitle(title)
    return grid[0, 0]


def _alone(posterior: Posterior, i: int, fitted: dict[str, float], ax: Axes) -> None:
    name, (low, high) = posterior.parameters[i], posterior.intervals()[i]
    ax.hist(posterior.values[:, i], bins=BINS, density=True, color=HEALTHY, alpha=0.6)
    for end in (low, high):
        ax.axvline(end, color="black", lw=0.8, ls="--")
    if name in fitted:
        ax.axvline(fitted[name], color=SPALLED, lw=1.5)
    ax.set(yticks=[], title=f"{low:.4g} … {high:.4g} {posterior.units[i]}")
    ax.title.set_fontsize("small")


def _pair(posterior: Posterior, k: int, i: int, fitted: dict[str, float], ax: Axes) -> None:
    across, up = posterior.values[:, k], posterior.values[:, i]
    counts, x, y = np.histogram2d(across, up, bins=BINS)
    smooth = _smoothed(counts)
    rising = np.sort(smooth.ravel())
    beyond = np.cumsum(rising) / np.sum(rising)
    levels = [float(rising[np.searchsorted(beyond, 1.0 - share)]) for share in sorted(REGIONS, reverse=True)]
    middle = [0.5 * (ends[1:] + ends[:-1]) for ends in (x, y)]
    ax.scatter(across, up, s=1.0, color=HEALTHY, alpha=0.15, lw=0, rasterized=True)
    if levels[0] < levels[1] < float(smooth.max()):
        ax.contourf(*middle, smooth.T, [*levels, float(smooth.max())], colors=("#99B8D8", "#4477AA"), alpha=0.7)
    names = [posterior.parameters[j] for j in (k, i)]
    if set(names) <= set(fitted):
        ax.plot(*[[fitted[name]] for name in names], "+", color=SPALLED, ms=10, mew=2)


def _smoothed(counts: np.ndarray) -> np.ndarray:
    """By the mean of neighbours, so that regions are not ragged."""
    weights = np.array([1.0, 2.0, 1.0]) / 4.0
    for axis in (0, 1):
        counts = np.apply_along_axis(lambda line: np.convolve(line, weights, mode="same"), axis, counts)
    return counts
