"""What all figures share: colours, words, and how they are written down.

Functions that draw do so on the Axes they are given (or make one) and return it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from difftrb.scene.scene import PitchMean, Scene

HEALTHY, SPALLED, ACCENT = "#4477AA", "#EE6677", "#BBBBBB"  # colour-blind safe (Tol, bright)


def loads_of(scene: Scene) -> str:
    """A scene's loads in words."""
    return f"{scene.load.radial:,g} N radial, {scene.load.axial:,g} N axial"


def phase_of(scene: Scene) -> str:
    """Where its rollers stand, in words."""
    return "mean over the cage's turn" if isinstance(scene.phase, PitchMean) else f"roller 0 at {scene.phase:g} rad"


def save(ax: Any, folder: Path, name: str) -> None:
    """Write a figure, or that of an Axes, as PNG and SVG into `folder` and close it. SVG keeps words as words."""
    figure = ax if isinstance(ax, Figure) else ax.figure
    with plt.rc_context({"svg.fonttype": "none", "font.family": ["DejaVu Sans", "sans-serif"]}):
        figure.savefig(folder / f"{name}.svg", dpi=110)
        figure.set_layout_engine("none")  # it stays as laid out
        figure.savefig(folder / f"{name}.png", dpi=120, pil_kwargs={"compress_level": 1})
    plt.close(figure)
