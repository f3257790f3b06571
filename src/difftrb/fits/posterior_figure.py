"""The figure of a posterior: every parameter by itself, and every two of them."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from difftrb.fits.posterior import Posterior
from difftrb.report.figure_style import HEALTHY, SPALLED

BINS = 20
"""With more of them the few hundred draws that are independent look ragged."""
REGIONS = 0.68, 0.95
"""What the two regions of a pair hold."""


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
