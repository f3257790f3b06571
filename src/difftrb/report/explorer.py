"""A page on this machine with sliders for spall, loads and phase: `difftrb explore`.

A move of a slider solves the ring at all phases of the cage by numpy, in some 30 ms, and the page shows it at once.
What takes longer, pressure and exact gradients, is computed beside it when no slider has moved for a moment.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from html import escape
from threading import Thread
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Div, Slider
from bokeh.server.server import Server

from difftrb.core import geometry
from difftrb.core.geometry import Spall
from difftrb.core.status import DifftrbError, SceneError
from difftrb.report import html_report, pressure_figure
from difftrb.report.explorer_figures import WIDE, Pressures, Rings
from difftrb.report.pressure_figure import DrawnContact
from difftrb.scene import auto_law, scene_laws, solving
from difftrb.scene.prepared_scene import solve_prepared
from difftrb.scene.scene import PitchMean, Scene, named
from difftrb.turning import spall_loss
from difftrb.turning.spall_loss import Turn

DRAWN_PHASES = 61
"""Of the cage over one roller pitch, both ends among them."""
REST = 250
"""How long no slider moves before what takes longer is computed [ms]."""

CELLS = "td, th { padding: 2px 8px; text-align: right; } td { white-space: nowrap; }"


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
    """Sliders and figures of one visitor, to whom `document` is shown."""

    def __init__(self, scene: Scene, document: Document | None = None) -> None:
        self.document, self.base = document, scene
        self.pitch = float(geometry.roller_pitch(scene.bearing))
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
        self.refusal, self.exact = Div(width=WIDE), Div(width=WIDE, stylesheets=[CELLS])
        self.rings, self.pressures = Rings(scene), Pressures(pressure_figure.MOST)
        self.solved: tuple[Scene, Turn | None] | None = None
        self.moved()
        left = column(Div(text="<h2>difftrb explore</h2>"), *self.sliders.values(), self.refusal, self.exact)
        self.page = row(left, column(self.rings.drawn, self.pressures.drawn), spacing=20)
        for slider in self.sliders.values():
            slider.on_change("value", lambda attr, old, new: self.moved())

    def scene(self) -> Scene:
        """Where the sliders are."""
        at = {name: float(slider.value) for name, slider in self.sliders.items()}
        spall = dataclasses.replace(self.base.spalls[0], length=at["length"], width=at["width"], angle=at["angle"])
        load = dataclasses.replace(self.base.load, radial=at["radial"], axial=at["axial"])
        return dataclasses.replace(self.base, load=load, spalls=(spall,), phase=at["phase"])

    def turn(self, scene: Scene) -> Turn | None:
        """The ring at all phases of its cage; of it and of the healthy one only what has changed is solved."""
        at_zero, known = dataclasses.replace(scene, phase=0.0), None
        if self.solved is not None:
            before, known = self.solved
            if before == at_zero:
                return known
            known = known if before.load == scene.load else None
        turn = spall_loss.over_turn(auto_law.by_table(at_zero), DRAWN_PHASES, known)
        self.solved = at_zero, turn
        return turn

    def moved(self) -> None:
        """Show where the sliders are now."""
        scene = self.scene()
        self.show(scene)
        if self.document is None:
            self._show_closer(*closer(scene))
        else:
            self._look_closer(self.document)

    def show(self, scene: Scene) -> None:
        """Loads, and stiffness over the cage's turn."""
        try:
            turn = self.turn(scene)
        except DifftrbError as error:
            self.refusal.text = _sentence(str(error))
            return
        if turn is None:
            self.refusal.text = _sentence(str(solve_prepared(solving.prepare(scene)).status))
            return
        k = round(float(scene.phase) / self.pitch * (DRAWN_PHASES - 1))  # type: ignore[arg-type]
        self.refusal.text = ""
        self.rings.show(scene, turn, k)

    def _look_closer(self, document: Document) -> None:
        """At what takes longer, unless a slider moves before it is known."""
        scene = self.scene()

        def show(found: tuple[str, list[DrawnContact]]) -> None:
            if scene == self.scene():
                self._show_closer(*found)

        def begin() -> None:
            if scene == self.scene():
                Thread(target=lambda: document.add_next_tick_callback(partial(show, closer(scene)))).start()

        document.add_timeout_callback(begin, REST)

    def _show_closer(self, text: str, pressed: list[DrawnContact]) -> None:
        self.exact.text = text
        self.pressures.show(pressed)


def closer(scene: Scene) -> tuple[str, list[DrawnContact]]:
    """What takes longer than a move: a table of losses in the mean over the cage's turn and their gradients, and the
    contacts at the spall; nothing where there is no solution."""
    try:
        ready = solving.prepare(scene)
        found, mean = solve_prepared(ready), solving.assess_mean(ready)
    except DifftrbError:
        return "", []
    if not bool(found.converged) or mean is None:
        return "", []
    rows = []
    for k, name in enumerate(("radial", "axial")):
        slopes = (f"{float(by[k, 0]):,.0f}" for by in (mean.by_length, mean.by_width))
        rows.append((name, f"{float(mean.spalled.both_stiffnesses[k]):,.0f}", f"{float(mean.loss[k]):.2f} %", *slopes))
    heads = "", "[N/mm]", "lost", "by length [N/mm/mm]", "by width [N/mm/mm]"
    table = html_report.table(heads, rows, "Stiffness in the mean over the cage's turn, and its derivatives")
    table = f'<div aria-live="polite">{table}</div>'
    pressed = [one for one in pressure_figure.contacts_at_spall(ready, found) if one.raceway == "outer"]
    return table, pressed if all(bool(one.solution.converged) and one.patches for one in pressed) else []


def _slider(name: str, low: float, high: float, value: float, step: float) -> Any:
    return Slider(title=name, start=min(low, value), end=max(high, value), value=value, step=step, format="0[.]000",
                  width=WIDE)  # fmt: skip


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
    auto_law.by_table(base)  # what is wrong is said before a browser opens

    def page(document: Document) -> None:
        document.title = "difftrb explore"
        document.add_root(Explorer(base, document).page)

    server = Server({"/": page}, port=port, address="127.0.0.1",
                    allow_websocket_origin=[f"localhost:{port}", f"127.0.0.1:{port}"])  # fmt: skip
    server.start()
    if show:
        server.io_loop.add_callback(server.show, "/")
    server.io_loop.start()
