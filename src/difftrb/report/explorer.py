"""A page on this machine with sliders for spall, loads and phase: `difftrb explore`.

A move of a slider solves the ring at all phases of the cage by numpy, in some 20 ms; what takes longer, pressure and
exact gradients, follows when the slider is let go.
"""

from __future__ import annotations

import dataclasses
import math
from html import escape
from typing import Any, cast

import numpy as np
import panel as pn
from bokeh.models import ColumnDataSource, LinearColorMapper, Range1d
from bokeh.palettes import Blues9
from bokeh.plotting import figure

from difftrb.core import geometry
from difftrb.core.geometry import Spall
from difftrb.core.status import DifftrbError, SceneError
from difftrb.report import figure_style, html_report, pressure_figure
from difftrb.report.figure_style import HEALTHY, SPALLED
from difftrb.scene import auto_law, scene_laws, solving
from difftrb.scene.prepared import solve_prepared
from difftrb.scene.scene import PitchMean, Scene, named
from difftrb.scene.solution import Solution
from difftrb.turning import spall_loss

DRAWN_PHASES = 61
"""Of the cage over one roller pitch, both ends among them."""
TALL, WIDE = 300, 470
"""Size of a figure [px]."""


def checked(scene: Scene) -> Scene:
    """The scene that is explored: of a plain ring with one spall on the outer raceway, by law "table"."""
    if scene.effects:
        raise SceneError("explore takes scenes without effects, which are solved at once; leave [effects] out")
    if len(scene.spalls) > 1 or any(spall.surface != "outer" or not isinstance(spall, Spall) for spall in scene.spalls):
        raise SceneError("explore takes one rectangular spall, on the outer raceway; leave the others out")
    spalls = scene.spalls or (Spall(length=0.2 * scene.bearing.roller_length, width=5.0),)
    phase = 0.0 if isinstance(scene.phase, PitchMean) else scene.phase
    return dataclasses.replace(named(scene, "table", 1e-3), spalls=spalls, phase=phase)


class Explorer:
    """Sliders and figures of one visitor."""

    def __init__(self, scene: Scene) -> None:
        self.base, self.pitch = scene, float(geometry.roller_pitch(scene.bearing))
        spall, length = scene.spalls[0], float(scene.bearing.roller_length)
        radial, axial = float(scene.load.radial), float(scene.load.axial)
        narrow, wide = _widths(scene)
        step = self.pitch / (DRAWN_PHASES - 1)
        start = round(float(scene.phase) % self.pitch / step) * step  # type: ignore[arg-type]
        top = max(2.5 * radial, 1.0)
        self.sliders = {
            "length": _slider("spall length [mm]", 0.1, round(0.84 * length, 1), float(spall.length), 0.1),
            "width": _slider("spall width [mm]", narrow, wide, float(spall.width), 0.1),
            "angle": _slider("spall angle from the load line [rad]", -3.1, 3.1, float(spall.angle), 0.02),
            "radial": _slider("radial load [N]", 0.0, top, radial, top / 100.0),
            "axial": _slider("axial load [N]", 0.0, max(4.0 * axial, 1.0), axial, max(axial, 1.0) / 25.0),
            "phase": _slider("phase: roller 0 from the load line [rad]", 0.0, self.pitch, start, step),
        }
        self.numbers, self.exact = pn.pane.HTML(width=WIDE), pn.pane.HTML(width=WIDE)
        self.pressure = pn.pane.HTML(width=2 * WIDE)
        self.rollers, self.spall = ColumnDataSource({}), ColumnDataSource({})
        self.shown, self.turn = ColumnDataSource({}), ColumnDataSource({})
        self.now = ColumnDataSource({})
        self.shade = LinearColorMapper(palette=Blues9[::-1], low=0.0, high=1.0)
        self.moved()
        self.let_go()
        self.page = self._page()
        for slider in self.sliders.values():
            slider.param.watch(lambda _: self.moved(), "value")
            slider.param.watch(lambda _: self.let_go(), "value_throttled")

    def scene(self) -> Scene:
        """Where the sliders are."""
        at = {name: float(slider.value) for name, slider in self.sliders.items()}
        spall = dataclasses.replace(self.base.spalls[0], length=at["length"], width=at["width"], angle=at["angle"])
        load = dataclasses.replace(self.base.load, radial=at["radial"], axial=at["axial"])
        return dataclasses.replace(self.base, load=load, spalls=(spall,), phase=at["phase"])

    def moved(self) -> None:
        """Loads, and stiffness over the cage's turn."""
        scene = self.scene()
        try:
            turn = spall_loss.over_turn(auto_law.by_table(scene), DRAWN_PHASES)
        except DifftrbError as error:
            self.numbers.object = _sentence(str(error))
            return
        if turn is None:
            self.numbers.object = _sentence(str(solve_prepared(solving.prepare(scene)).status))
            return
        k = round(float(scene.phase) / self.pitch * (DRAWN_PHASES - 1))  # type: ignore[arg-type]
        self._ring(scene, turn.loads[k], turn.healthy_loads[k])
        values = {f"{way}_{name}": part[:, j, j] / 1e3 for name, j in (("radial", 0), ("axial", 2))
                  for way, part in (("healthy", turn.healthy), ("spalled", turn.stiffness))}  # fmt: skip
        self.turn.data = {"phase": turn.phases, **values}
        self.now.data = {"phase": [turn.phases[k]], **{name: [value[k]] for name, value in values.items()}}
        rows = []
        for name, j in (("radial", 0), ("axial", 2)):
            here, mean = turn.stiffness[k, j, j], turn.stiffness[:-1, j, j].mean()
            loss, mean_loss = (100.0 * (1.0 - a / b) for a, b in
                               ((here, turn.healthy[k, j, j]), (mean, turn.healthy[:-1, j, j].mean())))  # fmt: skip
            rows.append(f"<tr><td>{name}</td><td>{here:,.0f}</td><td>{loss:.2f} %</td><td>{mean_loss:.2f} %</td></tr>")
        heads = ("", f"{scene.definition} stiffness [N/mm]", "loss at this phase", "loss over the turn")
        head = "".join(f'<th scope="col">{text}</th>' for text in heads)
        self.numbers.object = f'<table aria-live="polite"><tr>{head}</tr>{"".join(rows)}</table>'

    def let_go(self) -> None:
        """Pressure at the spall, and exact gradients in the mean over the cage's turn."""
        self.pressure.object = None
        try:
            ready = solving.prepare(self.scene())
            found: Solution = solve_prepared(ready)
            mean = solving.assess_mean(ready)
        except DifftrbError as error:
            self.exact.object = _sentence(str(error))
            return
        if not bool(found.converged) or mean is None:
            self.exact.object = _sentence(str(found.status))
            return
        slopes = [f"{float(by[row, 0]):,.0f}" for by in (mean.by_length, mean.by_width) for row in (0, 1)]
        self.exact.object = (
            f"<p>In the mean over the cage's turn a millimetre of length changes radial stiffness by {slopes[0]} and "
            f"axial by {slopes[1]} N/mm, one of width by {slopes[2]} and {slopes[3]} N/mm.</p>"
        )
        pressed = pressure_figure.contacts_at_spall(ready, found)
        if all(bool(one.solution.converged) for one in pressed):
            svg = figure_style.svg_text(pressure_figure.pressures(pressed))
            self.pressure.object = html_report.inlined(svg, "pressure", "pressure of the rollers at the spall")

    def _ring(self, scene: Scene, loads: np.ndarray, healthy: np.ndarray) -> None:
        """Rollers at their places."""
        of = scene.bearing
        angles = float(scene.phase) + self.pitch * np.arange(of.rollers)  # type: ignore[arg-type]
        radius = float(geometry.pitch_radius(of))
        self.shade.high = max(float(loads.max()), 1.0)
        place = {"x": radius * np.sin(angles), "y": -radius * np.cos(angles), "load": loads}
        self.rollers.data = {**place, "roller": np.arange(of.rollers)}
        order = np.argsort(np.asarray(geometry.turned(angles)))
        sorted_angles = np.asarray(geometry.turned(angles))[order]
        self.shown.data = {"angle": sorted_angles, "spalled": loads[order] / 1e3, "healthy": healthy[order] / 1e3}
        spall = scene.spalls[0]
        half = 0.5 * float(spall.width) / float(geometry.arc_radius(of))
        middle = float(spall.angle) - 0.5 * math.pi
        rim = float(geometry.outer_raceway_radius(of))
        self.spall.data = {"x": [0.0], "y": [0.0], "low": [middle - half], "high": [middle + half], "inside": [rim],
                           "outside": [1.12 * rim]}  # fmt: skip

    def _page(self) -> Any:
        of = self.base.bearing
        edge: Any = 1.2 * float(geometry.outer_raceway_radius(of))
        across, up = Range1d(-edge, edge), Range1d(-edge, edge)
        ring = figure(frame_width=TALL, frame_height=TALL, x_range=cast(Any, across), y_range=cast(Any, up),
                      title="Along the axis, to scale: shaded by load", toolbar_location=None,
                      tooltips=[("roller", "@roller"), ("load", "@load{0,0} N")])  # fmt: skip
        ring.axis.visible = ring.grid.visible = False
        ring.circle("x", "y", radius=float(geometry.mean_roller_radius(of)), source=self.rollers, line_color="#33404D",
                    fill_color={"field": "load", "transform": self.shade})  # fmt: skip
        ring.annular_wedge("x", "y", inner_radius="inside", outer_radius="outside", start_angle="low", end_angle="high",
                           source=self.spall, color=SPALLED)  # fmt: skip
        loads = _figure("Load of every roller [kN]", "angle from the load line [rad]")
        for name, colour, words in (("healthy", HEALTHY, "healthy"), ("spalled", SPALLED, "with spall")):
            loads.line("angle", name, source=self.shown, color=colour, line_width=2, legend_label=words)
            loads.scatter("angle", name, source=self.shown, color=colour, size=5)
        figures = []
        for name in ("radial", "axial"):
            one = _figure(f"{name} stiffness over the cage's turn [kN/mm]", "phase [rad]")
            for way, colour, words in (("healthy", HEALTHY, "healthy"), ("spalled", SPALLED, "with spall")):
                one.line("phase", f"{way}_{name}", source=self.turn, color=colour, line_width=2, legend_label=words)
            one.scatter("phase", f"spalled_{name}", source=self.now, size=10, color="black")
            figures.append(one)
        left = pn.Column("## difftrb explore", *self.sliders.values(), self.numbers, self.exact, width=WIDE)
        right = pn.Column(pn.Row(ring, loads), pn.Row(*figures), self.pressure)
        return pn.Row(left, right)


def _slider(name: str, low: float, high: float, value: float, step: float) -> Any:
    return pn.widgets.FloatSlider(label=name, start=min(low, value), end=max(high, value), value=value, step=step,
                                  format="0[.]000", sizing_mode="stretch_width")  # fmt: skip


def _figure(title: str, below: str) -> Any:
    return figure(width=WIDE, height=TALL, title=title, x_axis_label=below, toolbar_location=None)


def _widths(scene: Scene) -> tuple[float, float]:
    """From the narrowest spall of which a roller meets one edge at a time, if the scene's is such a one, to a few
    rollers' pitches [mm]: narrower ones take some tenths of a second."""
    own = float(scene.spalls[0].width)
    widest = max(3.0 * float(geometry.arc_radius(scene.bearing) * geometry.roller_pitch(scene.bearing)), 1.5 * own)
    for width in np.round(np.linspace(0.1, own, 40), 1):
        spall = dataclasses.replace(scene.spalls[0], width=max(float(width), 0.1))
        law: Any = scene_laws.with_laws(dataclasses.replace(scene, spalls=(spall,))).law
        if not law.narrow:
            return max(float(width), 0.1), round(widest, 1)
    return 0.1, round(widest, 1)


def _sentence(text: str) -> str:
    return f'<p role="alert">{escape(text)}</p>'


def serve(scene: Scene, port: int, show: bool) -> None:
    """Serve the page on this machine alone until interrupted."""
    base = checked(scene)
    Explorer(base)  # what is wrong is said before a browser opens
    pn.extension(inline=True)
    pn.serve(lambda: Explorer(base).page, port=port, address="127.0.0.1", show=show, title="difftrb explore",
             websocket_origin=[f"localhost:{port}", f"127.0.0.1:{port}"])  # fmt: skip
