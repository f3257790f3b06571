"""The page of a run, and what its figures are drawn from."""

import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.contact import strip_model
from difftrb.contact.solver import pressure_patches
from difftrb.report import bearing_drawing, html_report, run_figures
from difftrb.scene import scene_file, solving
from difftrb.turning import spall_loss

SMALL = 2_000_000
"""Bytes that a page may have."""
VOID = {"meta", "link", "br", "use", "path", "image", "rect", "stop"}


class Page(HTMLParser):
    """Ids, what is referred to, and whether every element that opens closes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.handle_startendtag(tag, attrs)

    def handle_startendtag(self, tag, attrs) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.append(value)
            if name in ("href", "xlink:href", "src"):
                self.links.append(value)
            self.links += re.findall(r"url\((#[^)]*)\)", value or "")

    def handle_endtag(self, tag) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag


@pytest.fixture(scope="module")
def scene() -> trb.Scene:
    return trb.prepare(trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),)))


def written(folder: Path, text: str, *more: str) -> tuple[str, Page]:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    assert cli.main(["--no-cache", "run", str(path), "--out", str(folder / "out"), *more]) == 0
    html = (folder / "out" / "report.html").read_text(encoding="utf-8")
    return html, Page(html)


def test_a_healthy_bearing_has_no_column_of_a_spall(scene: trb.Scene) -> None:
    whole = scene.replace(spalls=())
    result = trb.assess(whole)
    table = html_report._stiffness_table(html_report.Run("healthy.toml", "", whole, {}, result))
    assert "with spall" not in table
    assert "loss" not in table
    assert html_report._heading("pressure", whole) == "Pressure under the rollers"
    assert html_report._heading("pressure", scene) == "Pressure at the spall"


@pytest.mark.portable
def test_a_page_holds_all_it_needs(capsys, tmp_path: Path) -> None:
    """Every figure once, ids told apart, nothing from elsewhere, the scene's text and the record in it."""
    text = scene_file.example("spall").replace("# ", "# </pre><script>alert(1)</script> ", 1)
    html, page = written(tmp_path, text, "--verify")
    assert not page.open
    assert len(html.encode()) < SMALL
    assert len(set(page.ids)) == len(page.ids)
    assert '<a href="#numbers">Stiffness</a>' in html
    assert "Bearing 32008J" in html  # a file's bearing is a copy
    assert {"bearing", "load_distribution", "pressure", "stiffness", "loss", "acting", "errors"} <= set(page.ids)
    for link in page.links:
        assert link.startswith("data:") or link.removeprefix("#") in page.ids, link
    assert "http://" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", html)
    assert "<script>" not in html
    record = re.search(r'id="result">(.*?)</script>', html, re.DOTALL)
    assert record is not None
    assert json.loads(record[1]) == json.loads((tmp_path / "out" / "result.json").read_text())
    for words in ("outer and inner raceway in series (effects.raceways)", "9,000 N radial, 4,500 N axial", "stretched",
                  "roller 0 at 0 rad", "audit: ", "Tribology International 122"):  # fmt: skip
        assert words in html, words


@pytest.mark.slow
def test_a_page_of_effects_says_what_acts(capsys, tmp_path: Path) -> None:
    text = scene_file.example("paper") + "\n[effects]\ncentrifugal = { speed_rpm = 3000 }\n"
    html, page = written(tmp_path, text)
    assert "centrifugal force on the rollers: speed_rpm = " in html
    assert "(effects.centrifugal)" not in html
    assert "stiffness" in page.ids
    html, page = written(tmp_path, scene_file.example("diameters"))  # which repeats once a turn
    assert "stiffness" not in page.ids
    assert "<code>difftrb stiffness</code> tells it of all" in html


def test_stiffness_over_the_turn_is_that_of_every_phase(scene: trb.Scene) -> None:
    turn = spall_loss.over_turn(scene, 9)
    assert turn is not None
    np.testing.assert_allclose(turn.stiffness[0], turn.stiffness[-1], rtol=1e-9, atol=1e-3)  # a pitch later
    for k in (0, 3, 4):
        there = trb.solve(dataclasses.replace(scene, phase=float(turn.phases[k])))
        np.testing.assert_allclose(turn.stiffness[k], there.stiffness, rtol=1e-9, atol=1e-3)


@pytest.mark.gradient
@pytest.mark.parametrize("law", ["table", "liu2018"])
@pytest.mark.parametrize("definition", ["tangent", "secant"])
def test_a_loss_map_is_the_mean_over_the_turn(law: str, definition, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loss and both derivatives equal those of the scene's own mean; and central differences. A figure takes kinks
    where healthy rings have them, which is ten times as fast, and about the same."""
    scene = trb.prepare(
        trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law=law, definition=definition)
    )
    mean = solving.assess_mean(scene)
    assert mean is not None
    sizes = np.array([3.999, 4.0, 4.001]), np.array([6.999, 7.0, 7.001])
    quickly = spall_loss.loss_map(scene, *sizes)
    monkeypatch.setattr(spall_loss, "healthy_ring", lambda *_: None)
    found = spall_loss.loss_map(scene, *sizes)
    assert found is not None
    assert quickly is not None
    for name, within in (("loss", 1e-4), ("by_length", 1e-3), ("by_width", 1e-2)):
        np.testing.assert_allclose(getattr(quickly, name), getattr(found, name), rtol=within)
    whole = np.asarray(mean.healthy.both_stiffnesses)
    np.testing.assert_allclose(found.loss[:, 1, 1], mean.loss, rtol=1e-9)
    np.testing.assert_allclose(found.by_length[:, 1, 1], -100.0 * np.asarray(mean.by_length)[:, 0] / whole, rtol=1e-9)
    np.testing.assert_allclose(found.by_width[:, 1, 1], -100.0 * np.asarray(mean.by_width)[:, 0] / whole, rtol=1e-9)
    np.testing.assert_allclose(found.by_length[:, 1, 1], (found.loss[:, 2, 1] - found.loss[:, 0, 1]) / 0.002, rtol=1e-4)
    np.testing.assert_allclose(found.by_width[:, 1, 1], (found.loss[:, 1, 2] - found.loss[:, 1, 0]) / 0.002, rtol=1e-4)


def test_a_loss_map_is_right_between_its_sizes(scene: trb.Scene) -> None:
    """Beside the longest of even lengths the figure was 0.4 % of stiffness off."""
    found = spall_loss.loss_map(scene, *spall_loss.sizes_around(scene))
    assert found is not None
    for length, width in ((9.05, 7.36), (9.05, 13.05), (1.5, 7.7)):
        spalls = (dataclasses.replace(scene.spalls[0], length=length, width=width),)
        exact = trb.assess(dataclasses.replace(scene, spalls=spalls, phase="mean")).loss
        for row in (0, 1):
            told = run_figures.loss_between(found, row, np.array([length]), np.array([width]))
            assert float(told[0, 0]) == pytest.approx(float(exact[row]), abs=0.1)


def test_a_loss_map_leaves_out_what_the_law_does_not_know(scene: trb.Scene) -> None:
    found = spall_loss.loss_map(scene, np.array([4.0, 13.0]), np.array([1.0, 7.0]))
    assert found is not None
    assert np.isfinite(found.loss).all(axis=0).tolist() == [[False, True], [False, False]]


@pytest.mark.parametrize(
    ("spall", "offset"),
    [
        (None, 0.0),
        (trb.Spall(4.0, 7.0), 0.0),
        (trb.Spall(4.0, 7.0, axial_offset=1.0), -3.52),
        (trb.Spall(4.0, 0.1), 0.01),
    ],
)
def test_pressure_point_by_point_carries_the_load(contact, spall, offset: float, monkeypatch) -> None:
    """Its integral on dense points is the load, but for what is lost at singular edges; nothing is carried over the
    spall."""
    monkeypatch.setattr(strip_model, "ACROSS", np.sin(0.5 * np.pi * np.linspace(-1.0, 1.0, 641)) * 0.99999)
    solution, patches = pressure_patches(contact, 830.0, spall, offset)
    total = sum(np.trapezoid(np.trapezoid(p.pressure, p.x, axis=1), p.y) for p in patches)
    assert total == pytest.approx(830.0, rel=0.02)
    assert all((p.pressure >= 0.0).all() for p in patches)
    if spall is not None:
        for p in patches:
            y = np.broadcast_to(p.y[:, None], p.x.shape)
            inside = (np.abs(y - spall.axial_offset) < 0.4 * spall.length) & (np.abs(p.x - offset) < 0.4 * spall.width)
            assert (p.pressure[inside] == 0.0).all()
    assert float(solution.force.sum()) == pytest.approx(830.0, rel=1e-9)


def test_other_surfaces_are_not_drawn_into_the_outer_raceway(scene: trb.Scene) -> None:
    """Spalls on a roller and of a second row were."""
    drawn = dataclasses.replace(scene, spalls=(trb.Spall(4.0, 7.0, surface="roller"), trb.Spall(4.0, 7.0, row=2)))
    figure = bearing_drawing.bearing(drawn, trb.solve(scene))
    section, front, unrolled = figure.axes
    assert not any("spall" in text.get_text() for text in section.texts)
    assert unrolled.get_title() == "Outer raceway unrolled"
    assert len(unrolled.patches) == 1  # the raceway
    assert len(front.patches) == 2 + scene.bearing.rollers  # rings and rollers
    plt.close(figure)
