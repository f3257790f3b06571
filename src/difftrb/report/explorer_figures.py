"""The figures of `difftrb explore`, which change in place: numbers go to the page, and it draws."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, CustomJS, LinearColorMapper, Range1d
from bokeh.palettes import Blues9, Viridis256
from bokeh.plotting import figure

from difftrb.core import geometry
from difftrb.report.figure_style import HEALTHY, SPALLED
from difftrb.report.pressure_figure import DrawnContact, on_grid, scale_of
from difftrb.scene.scene import Scene
from difftrb.scene.solution import stiffness_loss
from difftrb.turning.spall_loss import Turn

TALL, WIDE = 290, 430
"""Size of a figure [px]."""
GRID = 240, 90
"""Points of a drawn pressure, along the roller and across it."""
IMAGE = "image", "x", "y", "dw", "dh"
WAYS = ("healthy", HEALTHY, "healthy"), ("spalled", SPALLED, "with spall")


class Rings:
    """The rollers at their places, their loads, and the stiffness over the cage's turn.

    All that changes goes to the page in one message, and it draws once: columns of one source, each filled up with
    empty cells, titles among them."""

    def __init__(self, scene: Scene) -> None:
        self.shown = ColumnDataSource({})
        stiffness = [self._stiffness(name) for name in ("radial", "axial")]
        self.titles = [drawn.title for drawn in stiffness]
        put = "titles.forEach((title, k) => { title.text = shown.data.title[k]; });"
        self.shown.js_on_change("data", CustomJS(args={"titles": self.titles, "shown": self.shown}, code=put))
        self.drawn = column(row(self._ring(scene), self._loads()), row(*stiffness))

    def show(self, scene: Scene, turn: Turn, k: int) -> None:
        """The ring of a scene at the `k`-th phase of its cage's turn."""
        of = scene.bearing
        places = np.asarray(geometry.wrapped(turn.phases[k] + float(geometry.roller_pitch(of)) * np.arange(of.rollers)))
        order = np.argsort(places)  # so that lines go from one to the next
        angle, radius = places[order], float(geometry.pitch_radius(of))
        spalled, healthy = turn.loads[k][order] / 1e3, turn.healthy_loads[k][order] / 1e3
        spall = scene.spalls[0]
        half, middle = 0.5 * float(spall.width) / float(geometry.arc_radius(of)), float(spall.angle) - 0.5 * math.pi
        columns = {
            "roller": order, "angle": angle, "x": radius * np.sin(angle), "y": -radius * np.cos(angle),
            "spalled": spalled, "healthy": healthy, "share": spalled / max(float(spalled.max()), 1e-3),
            "low": [middle - half], "high": [middle + half], "phase": turn.phases,
            "now": np.where(np.arange(len(turn.phases)) == k, turn.phases, np.nan),
        }  # fmt: skip
        titles = []
        for name, j in (("radial", 0), ("axial", 2)):
            ours, theirs = turn.stiffness[:, j, j], turn.healthy[:, j, j]
            now, mean = stiffness_loss(ours[k], theirs[k]), stiffness_loss(ours[:-1].mean(), theirs[:-1].mean())
            columns |= {f"spalled_{name}": ours / 1e3, f"healthy_{name}": theirs / 1e3}
            titles.append(f"{name.title()} {ours[k] / 1e3:,.1f} kN/mm: {now:.2f} % lost, mean {mean:.1f} %")
        rows = max(len(turn.phases), of.rollers, len(titles))
        filled = {name: np.full(rows, np.nan) for name in columns}
        for name, values in columns.items():
            filled[name][: len(values)] = values
        if not len(self.shown.data):  # the page is still to be made
            for title, text in zip(self.titles, titles, strict=True):
                title.text = text
        self.shown.data = {**filled, "title": titles + [""] * (rows - len(titles))}

    def _ring(self, scene: Scene) -> Any:
        of = scene.bearing
        rim, roller = float(geometry.outer_raceway_radius(of)), float(geometry.mean_roller_radius(of))
        ring = figure(width=TALL, height=TALL, frame_width=TALL - 40, frame_height=TALL - 40, min_border=0,
                      frame_align=False, x_range=_span(-1.15 * rim, 1.15 * rim),
                      y_range=_span(-1.15 * rim, 1.15 * rim), title="Along the axis: shaded by load",
                      toolbar_location=None, tooltips=[("roller", "@roller"), ("load [kN]", "@spalled")])  # fmt: skip
        ring.axis.visible = ring.grid.visible = False
        inside = float(geometry.pitch_radius(of)) - roller
        for radius in (rim, 1.12 * rim, inside):
            ring.circle([0.0], [0.0], radius=radius, fill_color=None, line_color="#AAB2BA")
        shade = LinearColorMapper(palette=Blues9[::-1], low=0.0, high=1.0)
        places = ring.circle("x", "y", radius=roller, source=self.shown, line_color="#33404D",
                             fill_color={"field": "share", "transform": shade})  # fmt: skip
        ring.hover.renderers = [places]
        ring.annular_wedge(0.0, 0.0, inner_radius=rim, outer_radius=1.12 * rim, start_angle="low", end_angle="high",
                           source=self.shown, color=SPALLED)  # fmt: skip
        return ring

    def _loads(self) -> Any:
        loads = _plain("Load of every roller [kN]", "angle from the load line [rad]", 2 * WIDE - TALL)
        for name, colour, words in WAYS:
            loads.line("angle", name, source=self.shown, color=colour, line_width=2, legend_label=words)
            loads.scatter("angle", name, source=self.shown, color=colour, size=5)
        return _with_legend_above(loads)

    def _stiffness(self, name: str) -> Any:
        one = _plain(name, "phase [rad]")
        one.title.text_font_size = "12px"
        one.yaxis.axis_label = f"{name} stiffness [kN/mm]"
        for way, colour, words in WAYS:
            one.line("phase", f"{way}_{name}", source=self.shown, color=colour, line_width=2, legend_label=words)
        one.scatter("now", f"spalled_{name}", source=self.shown, size=10, color="black", legend_label="now")
        return _with_legend_above(one)


class Pressures:
    """The contacts of the rollers at the spall, one below the other, on one scale."""

    def __init__(self, most: int) -> None:
        self.shade = LinearColorMapper(palette=Viridis256, low=0.0, high=1.0, nan_color="white")
        self.sources = [ColumnDataSource({name: [] for name in IMAGE}) for _ in range(most)]
        self.figures = [self._figure(source) for source in self.sources]
        self.drawn = column(*self.figures)

    def show(self, found: list[DrawnContact]) -> None:
        """Those found; none: nothing is drawn."""
        self.shade.high = max((scale_of(one) for one in found), default=1.0)
        for k, (drawn, source) in enumerate(zip(self.figures, self.sources, strict=True)):
            drawn.visible = k < len(found)
            if not drawn.visible:
                continue
            one, (along, across, pressure) = found[k], on_grid(found[k].patches, GRID)
            low, wide = across[0], across[-1] - across[0]
            source.data = dict(zip(IMAGE, ([pressure], [along[0]], [low], [along[-1] - along[0]], [wide]), strict=True))
            drawn.title.text = (
                f"Roller {one.roller}: {float(one.solution.load):,.0f} N, pressure [N/mm²], not to scale: "
                f"rolling direction stretched"
            )
            drawn.x_range.update(start=along[0], end=along[-1])
            drawn.y_range.update(start=low, end=low + wide)

    def _figure(self, source: ColumnDataSource) -> Any:
        drawn = figure(width=2 * WIDE, height=220, x_range=_span(0.0, 1.0), y_range=_span(0.0, 1.0), title=" ",
                       x_axis_label="along the roller, y [mm]", y_axis_label="x [mm]", toolbar_location=None,
                       visible=False)  # fmt: skip
        colours: Any = {"color_mapper": self.shade}
        look = drawn.image(**dict(zip(IMAGE, IMAGE, strict=True)), source=source, **colours)
        drawn.grid.visible = False
        drawn.add_layout(look.construct_color_bar(width=10), "right")
        return drawn


def _span(low: float, high: float) -> Any:
    made: Any = Range1d  # whose fields are declared in another order than it takes them
    return made(low, high)


def _plain(title: str, below: str, wide: int = WIDE) -> Any:
    return figure(width=wide, height=TALL, title=title, x_axis_label=below, toolbar_location=None)


def _with_legend_above(drawn: Any) -> Any:
    """Beside the curves, so that it hides none."""
    legend = drawn.legend[0]
    legend.orientation, legend.border_line_color, legend.padding = "horizontal", None, 0
    drawn.add_layout(legend, "above")
    return drawn
