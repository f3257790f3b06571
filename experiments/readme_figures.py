"""The README's figures: what the package gives at a glance, and a drawing of axes and angles.

python experiments/readme_figures.py [DIR]   (default docs/)
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Circle, Polygon, Rectangle, Wedge

import difftrb as trb
from difftrb.contact.solver import pressure_patches
from difftrb.report import figure_style, pressure_figure, run_figures


def loss_over_length(scene: trb.Scene, ax: Axes) -> None:
    """Radial and axial loss over spall length, with tangents from the gradient at a few points."""

    def losses(length: jax.Array) -> jax.Array:
        spall = dataclasses.replace(scene.spalls[0], length=length)
        spalled = trb.solve(dataclasses.replace(scene, spalls=(spall,))).stiffness
        sound = trb.solve(trb.healthy(scene)).stiffness
        return 100.0 * (1.0 - jnp.stack([spalled[0, 0] / sound[0, 0], spalled[2, 2] / sound[2, 2]]))

    lengths = jnp.linspace(0.0, 10.0, 101)
    values = np.asarray(jax.vmap(losses)(lengths))
    marks = jnp.array([2.0, 5.0, 8.0])
    at, slopes = np.asarray(jax.vmap(losses)(marks)), np.asarray(jax.vmap(jax.jacfwd(losses))(marks))
    for i, (name, colour) in enumerate((("radial", figure_style.HEALTHY), ("axial", figure_style.SPALLED))):
        ax.plot(lengths, values[:, i], color=colour, lw=1.6, label=name)
        for x, y, slope in zip(np.asarray(marks), at[:, i], slopes[:, i], strict=True):
            reach = np.array([-1.2, 1.2])
            ax.plot(x + reach, y + slope * reach, color="black", lw=1.0)
            ax.plot(x, y, "o", color=colour, ms=5)
    ax.plot([], [], color="black", lw=1.0, label="its gradient")
    ax.set_xlabel("spall length [mm]")
    ax.set_ylabel("loss of tangent stiffness [%]")
    ax.set_xlim(0.0, 10.0)
    ax.set_ylim(bottom=0.0)
    ax.legend(frameon=False)
    ax.set_title("Stiffness loss and d(loss)/d(length)")


def overview(folder: Path) -> None:
    """Load distribution, pressure and stiffness loss of 32008J with a spall of 4 × 7 mm."""
    bearing = trb.bearing("32008J")
    contact = trb.LineContact.of(bearing)
    scene = trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),)))
    result = trb.assess(scene)
    pressed, patches = pressure_patches(contact, result.spalled.loads[0], scene.spalls[0], 0.0, pressure_figure.FINE)
    figure = plt.figure(figsize=(14.0, 4.6), layout="constrained")
    left, middle, right = np.ravel(np.asarray(figure.subfigures(1, 3, width_ratios=(1.0, 1.35, 1.15))))
    run_figures.load_distribution(result, scene, left.add_subplot(projection="polar"))
    pressure_figure.pressure_map(pressed, middle.add_subplot(), patches)
    loss_over_length(scene, right.add_subplot())
    for kind in ("png", "svg"):
        figure.savefig(folder / f"overview.{kind}", dpi=110)
    plt.close(figure)


def drawing(folder: Path) -> None:
    """Where angles start, which way they turn, and what a spall's sizes are."""
    figure, (front, plan) = plt.subplots(1, 2, figsize=(11.0, 5.0), layout="constrained")
    ring_drawing(front)
    spall_drawing(plan)
    for kind in ("png", "svg"):
        figure.savefig(folder / f"axes.{kind}", dpi=110)
    plt.close(figure)


def ring_drawing(ax: Axes) -> None:
    """The bearing seen along its axis."""
    ax.set_aspect("equal")
    ax.axis("off")
    pitch, rollers, phase, spall = 1.0, 15, 0.14, 0.75
    for radius in (pitch - 0.17, pitch + 0.17):
        ax.add_patch(Circle((0, 0), radius, fill=False, lw=1.5))
    place = lambda angle, r=pitch: (r * np.sin(angle), -r * np.cos(angle))  # noqa: E731  the load line points down
    ax.add_patch(
        Wedge(
            (0, 0), pitch + 0.21, np.degrees(spall) - 96, np.degrees(spall) - 84, width=0.05, color=figure_style.SPALLED
        )
    )
    for j in range(rollers):
        first = j == 0
        ax.add_patch(
            Circle(
                place(phase + 2 * np.pi * j / rollers), 0.165, fc=figure_style.HEALTHY if first else "white", ec="black"
            )
        )
    ax.annotate("", place(0, 1.75), place(0, 0.0), arrowprops={"arrowstyle": "-|>", "lw": 2.0, "color": "black"})
    ax.text(0.05, -1.72, "radial load, angle 0\n(the load line)", va="center")
    ax.annotate("", place(np.pi / 2, 1.45), place(0, 0), arrowprops={"arrowstyle": "-|>", "lw": 1.0, "color": "grey"})
    ax.text(1.3, 0.07, "lateral", color="grey")
    ax.plot([0], [0], "o", ms=9, mfc="white", mec="black")
    ax.plot([0], [0], ".", ms=4, color="black")
    ax.text(0.0, 0.12, "axial load presses\nthe rings together", ha="center", va="bottom", fontsize=9)
    for angle, radius, name, at in ((phase, 0.66, "phase", (-0.03, 0.6)), (spall, 0.36, "angle", (1.02, 0.46))):
        ax.plot(*zip((0, 0), place(angle, 1.25), strict=True), lw=0.8, ls="--", color="black")
        ax.add_patch(Arc((0, 0), 2 * radius, 2 * radius, theta1=-90, theta2=np.degrees(angle) - 90, lw=1.2))
        ax.text(*place(*at), name, ha="right" if angle == phase else "left", va="center")
    ax.text(*place(spall, 1.32), "spall on the\nouter raceway", color=figure_style.SPALLED, va="top")
    ax.text(*place(phase, 1.32), "roller 0", color=figure_style.HEALTHY, va="top", ha="left")
    ax.set_xlim(-1.5, 2.1)
    ax.set_ylim(-1.95, 1.3)
    ax.set_title("Seen along the axis: angles from the load line")


def spall_drawing(ax: Axes) -> None:
    """The raceway unrolled under one roller."""
    ax.axis("off")
    ax.add_patch(Rectangle((-5, -0.35), 10, 0.7, fc=figure_style.HEALTHY, alpha=0.25, ec=figure_style.HEALTHY))
    ax.text(-4.9, -0.42, "contact of roller and raceway", color=figure_style.HEALTHY, va="top")
    ax.add_patch(
        Polygon(
            [(-0.6, -0.2), (2.4, -0.2), (2.4, 2.2), (-0.6, 2.2)],
            fc=figure_style.SPALLED,
            alpha=0.35,
            ec=figure_style.SPALLED,
        )
    )
    ax.text(0.9, 1.6, "spall, depth below\nthe raceway", ha="center", color=figure_style.SPALLED)

    def measure(
        a: tuple[float, float], b: tuple[float, float], name: str, at: tuple[float, float], **text: str
    ) -> None:
        ax.annotate("", b, a, arrowprops={"arrowstyle": "<->", "lw": 1.1, "color": "black"})
        ax.text(*at, name, **text)  # type: ignore[arg-type]

    measure((-0.6, 2.45), (2.4, 2.45), "length", (0.9, 2.55), ha="center")
    measure((2.7, -0.2), (2.7, 2.2), "width", (2.85, 1.0), va="center")
    measure((0.9, 0.0), (0.9, 1.0), "offset", (1.0, 0.55), va="center")
    measure((0.0, 1.0), (0.9, 1.0), "axial_offset", (0.45, 1.1), ha="center")
    measure((-5.0, -0.9), (5.0, -0.9), "roller length", (0.0, -1.25), ha="center")
    ax.plot(0.9, 1.0, "+", color="black", ms=10)
    ax.plot(0.0, 0.0, "+", color=figure_style.HEALTHY, ms=12)
    ax.annotate("", (-6.0, 1.9), (-6.0, 0.0), arrowprops={"arrowstyle": "-|>", "lw": 1.3})
    ax.text(-6.0, 2.0, "x, rolling", ha="center", fontsize=9)
    ax.annotate("", (-4.6, 0.0), (-6.0, 0.0), arrowprops={"arrowstyle": "-|>", "lw": 1.3})
    ax.text(-4.5, 0.0, "y, along the roller", fontsize=9, va="center")
    ax.set_xlim(-6.8, 5.4)
    ax.set_ylim(-1.6, 3.0)
    ax.set_title("Raceway under one roller: sizes of a spall (not to scale)")


def main() -> None:
    """Draw all into the folder named on the command line."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent.parent / "docs"
    folder.mkdir(parents=True, exist_ok=True)
    overview(folder)
    drawing(folder)


if __name__ == "__main__":
    main()
