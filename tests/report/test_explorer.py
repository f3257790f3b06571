"""The live page's numbers, without a browser."""

import dataclasses

import numpy as np
import pytest

import difftrb as trb

explorer = pytest.importorskip("difftrb.report.explorer", reason="needs Bokeh", exc_type=ImportError)


def test_moves_are_solved_and_what_cannot_be_is_a_sentence() -> None:
    scene = trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),))
    page = explorer.Explorer(explorer.checked(scene))
    page.sliders["length"].value = 5.0
    longer = trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(5.0, 7.0),))
    assert f"{float(trb.solve(longer).radial_stiffness) / 1e3:,.1f} kN/mm" in page.rings.shown.data["title"][0]
    assert f"{float(trb.assess(longer).loss[0]):.2f} % lost" in page.rings.shown.data["title"][0]  # healthy rings kept
    found = trb.assess(dataclasses.replace(longer, phase="mean"))
    assert all(f"{float(by[0, 0]):,.0f}" in page.exact.text for by in (found.by_length, found.by_width))
    assert all(f"{float(loss):.2f} %" in page.exact.text for loss in found.loss)
    peak = max(np.nanmax(source.data["image"][0]) for source in page.pressures.sources if source.data["image"])
    assert 1e3 < peak < 1e4  # [N/mm²], of 1.3 kN
    page.sliders["axial"].value = 100.0
    assert "no equilibrium" in page.refusal.text
    assert page.exact.text == ""
    with pytest.raises(trb.SceneError, match="without effects"):
        explorer.checked(trb.Scene("32008J", trb.Load(9000.0, 4500.0), effects=(trb.effects.Life(),)))
    with pytest.raises(trb.SceneError, match="explore takes one rectangular spall"):
        explorer.checked(trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.load_height_map(trb.example_map()),)))
