"""The bearing of a scene drawn to scale: in section, seen along its axis, and its raceway unrolled about the spall."""

from __future__ import annotations

from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge

from difftrb.core import geometry
from difftrb.core.geometry import Spall, TaperedBearing
from difftrb.report.figure_style import ACCENT, HEALTHY, SPALLED
from difftrb.scene.scene import Scene
from difftrb.scene.solution import Solution

STEEL, DARK = "#E4E8EC", "#33404D"
RING = 1.1
"""Thickness of a drawn ring by the roller's radius: scenes do not name bore and outside."""


def bearing(scene: Scene, solution: Solution) -> Figure:
    """Three drawings, each with equal scales: section through the first spall, view along the axis with rollers at
    their places and shaded by their loads, and the outer raceway unrolled."""
    figure = plt.figure(figsize=(12.5, 4.3))
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.02, top=0.93, wspace=0.16)  # to lay it out takes longer
    section, front, unrolled = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.05))
    section_view(scene, section)
    front_view(scene, solution, front)
    unrolled_view(scene, solution, unrolled)
    return figure


def section_view(scene: Scene, ax: Axes) -> None:
    """Half of the section in which the first spall of the outer raceway lies."""
    of: TaperedBearing = scene.bearing
    tilt, half = float(geometry.roller_axis_angle(of)), 0.5 * float(of.roller_length)
    small, large = 0.5 * float(of.roller_small_diameter), 0.5 * float(of.roller_large_diameter)
    apex, slant = float(geometry.apex_distance(of)), float(geometry.slant_distance(of))
    thick = RING * large
    along = np.array([np.cos(tilt), np.sin(tilt)])
    normal = np.array([-along[1], along[0]])
    reach = half * float(np.cos(of.roller_angle))
    roller = [(apex - reach) * along + small * normal, (apex + reach) * along + large * normal,
              (apex + reach) * along - large * normal, (apex - reach) * along - small * normal]  # fmt: skip

    def on(angle: float, s: float) -> np.ndarray:
        return s * np.array([np.cos(angle), np.sin(angle)])

    low, high = slant - 1.12 * half, slant + 1.12 * half
    outer, inner = float(of.outer_angle), float(of.inner_angle)
    a, b = on(outer, low), on(outer, high)
    top = b[1] + 0.8 * thick
    ax.add_patch(Polygon([a, b, (b[0], top), (a[0], top)], fc=STEEL, ec=DARK, hatch="///", lw=1.0, alpha=0.9))
    c, d = on(inner, low), on(inner, slant + half * 1.01)
    bore = c[1] - 0.7 * thick
    lip = d + 0.8 * large * np.array([-np.sin(inner), np.cos(inner)])
    back = (lip[0] + 0.7 * large, lip[1])
    ax.add_patch(
        Polygon([c, d, lip, back, (back[0], bore), (c[0], bore)], fc=STEEL, ec=DARK, hatch="\\\\\\", lw=1.0, alpha=0.9)
    )
    ax.add_patch(Polygon(roller, fc="white", ec=DARK, lw=1.4, zorder=3))
    ends = [(apex - 1.35 * reach) * along, (apex + 1.35 * reach) * along]
    ax.plot(*np.transpose(ends), color=DARK, lw=0.7, ls="-.", zorder=4)
    for spall in _on_outer_raceway(scene)[:1]:
        middle, depth = slant + float(spall.axial_offset), float(spall.depth)
        p, q = on(outer, middle - 0.5 * float(spall.length)), on(outer, middle + 0.5 * float(spall.length))
        up = np.array([-np.sin(outer), np.cos(outer)])
        hole = [p, q, q + depth * up, p + depth * up]
        ax.add_patch(Polygon(hole, fc=SPALLED, ec=SPALLED, lw=1.8, zorder=5))
        label = f"spall {spall.length:g} mm long,\n{spall.depth:g} mm deep"
        at = 0.5 * (p + q)
        words = {"color": SPALLED, "ha": "center", "va": "bottom", "fontsize": 9}
        line = {"arrowstyle": "-", "color": SPALLED, "lw": 0.8}
        ax.annotate(label, (at[0], at[1]), (at[0], top + 0.8 * thick), arrowprops=line, **words)
    middle = apex * along - 0.2 * small * normal  # the one dimension that a scene names
    ax.text(middle[0], middle[1], f"{float(of.roller_length):.1f} mm", rotation=np.degrees(tilt),
            rotation_mode="anchor", ha="center", va="top", fontsize=8, zorder=5)  # fmt: skip
    ax.set_title(f"Section: outer cone {np.degrees(outer):.2f}°, inner {np.degrees(inner):.2f}°", fontsize=10)
    _to_scale(ax, (a[0] - thick, back[0] + thick), (bore - 1.8 * thick, top + 2.0 * thick))
    ax.text(0.5, 0.0, "to scale; rings' backs are sketched, a scene does not name them", transform=ax.transAxes,
            ha="center", va="bottom", fontsize=7.5, color="0.35")  # fmt: skip


def front_view(scene: Scene, solution: Solution, ax: Axes) -> None:
    """Along the axis, at the rollers' middles: the load line points down."""
    of: TaperedBearing = scene.bearing
    pitch, radius = float(geometry.pitch_radius(of)), float(geometry.mean_roller_radius(of))
    rim, hub = float(geometry.outer_raceway_radius(of)), pitch - radius
    loads = np.asarray(solution.loads)
    shades = matplotlib.colormaps["Blues"](0.85 * np.clip(loads / max(float(loads.max()), 1e-9), 0.0, 1.0))
    ax.add_patch(Wedge((0, 0), rim + RING * radius, 0, 360, width=RING * radius, fc=STEEL, ec=DARK, lw=0.8))
    ax.add_patch(Wedge((0, 0), hub, 0, 360, width=RING * radius, fc=STEEL, ec=DARK, lw=0.8))
    for j, (angle, shade) in enumerate(zip(np.asarray(solution.angles), shades, strict=True)):
        place = (pitch * np.sin(angle), -pitch * np.cos(angle))
        ax.add_patch(Circle(place, radius, fc=shade, ec=DARK, lw=1.6 if j == 0 else 0.7))
        if j == 0:
            inside = 0.62 * pitch
            ax.annotate("roller 0", place, (inside * np.sin(angle + 0.5), -inside * np.cos(angle + 0.5)), fontsize=8,
                        ha="center", arrowprops={"arrowstyle": "-", "lw": 0.7, "color": DARK})  # fmt: skip
    for spall in scene.spalls:
        if spall.surface == "roller" or spall.row > 1:
            continue
        turn = np.degrees(float(spall.width / geometry.arc_radius(of, spall.surface)))
        middle, band = np.degrees(float(spall.angle)) - 90.0, 0.4 * radius
        outside = hub if spall.surface == "inner" else rim + band
        ax.add_patch(Wedge((0, 0), outside, middle - turn / 2, middle + turn / 2, width=band, color=SPALLED, zorder=4))
    edge = rim + RING * radius
    tip, tail = (0.0, -0.42 * pitch), (0.0, 0.1 * pitch)
    ax.annotate("", tip, tail, arrowprops={"arrowstyle": "-|>", "lw": 1.8, "color": "black"})
    ax.text(0.0, 0.15 * pitch, f"radial {scene.load.radial:,.0f} N\naxial {scene.load.axial:,.0f} N", ha="center",
            va="bottom", fontsize=9)  # fmt: skip
    ax.set_title(f"Along the axis: {of.rollers} rollers, shaded by load", fontsize=10)
    _to_scale(ax, (-1.04 * edge, 1.04 * edge), (-1.04 * edge, 1.04 * edge))


def unrolled_view(scene: Scene, solution: Solution, ax: Axes) -> None:
    """The outer raceway about the first spall, or about the most loaded roller; contacts as wide as they are."""
    of: TaperedBearing = scene.bearing
    spalls, loads = _on_outer_raceway(scene), np.asarray(solution.loads)
    radius, half = float(geometry.arc_radius(of)), 0.5 * float(of.roller_length)
    middle = float(spalls[0].angle) if spalls else float(np.asarray(solution.angles)[loads.argmax()])
    pitch = radius * float(geometry.roller_pitch(of))
    reach = max(1.6 * pitch, *(0.5 * float(spall.width) + 0.7 * pitch for spall in spalls), 1.15 * half)
    reach = min(reach, np.pi * radius)
    ax.add_patch(Rectangle((-reach, -half), 2.0 * reach, 2.0 * half, fc=STEEL, ec="none"))
    for spall in spalls:
        x = radius * float(geometry.wrapped(spall.angle - middle))
        corner = (x - 0.5 * float(spall.width), float(spall.axial_offset) - 0.5 * float(spall.length))
        ax.add_patch(Rectangle(corner, float(spall.width), float(spall.length), fc=SPALLED, alpha=0.75, ec=SPALLED))
    for j, (angle, load) in enumerate(zip(np.asarray(solution.angles), loads, strict=True)):
        x = radius * float(geometry.wrapped(angle - middle))
        if abs(x) > 0.98 * reach:
            continue
        ax.plot([x, x], [-half, half], color=HEALTHY if load > 0.0 else ACCENT, lw=1.6)
        ax.text(x, half + 0.06 * half, f"roller {j}\n{load:,.0f} N", ha="center", va="bottom", fontsize=8)
    ax.set_xlabel("along the rolling direction, from the spall's middle [mm]" if spalls else "rolling direction [mm]",
                  fontsize=9)  # fmt: skip
    ax.set_ylabel("along the roller [mm]", fontsize=9)
    ax.tick_params(labelsize=8)
    ax.set_aspect("equal", anchor="N")
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-1.15 * half, 1.55 * half)
    size = f": spall {spalls[0].length:g} × {spalls[0].width:g} mm" if spalls else ""
    ax.set_title(f"Outer raceway unrolled{size}", fontsize=10)


def _on_outer_raceway(scene: Scene) -> list[Spall]:
    """The spalls on the outer raceway of the first row: that is drawn."""
    return [spall for spall in scene.spalls if spall.surface == "outer" and spall.row == 1]


def _to_scale(ax: Axes, across: tuple[float, float], up: tuple[float, float]) -> Any:
    ax.set_aspect("equal", anchor="N")
    ax.axis("off")
    ax.set_xlim(*across)
    ax.set_ylim(*up)
