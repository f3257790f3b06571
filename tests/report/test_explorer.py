"""The live page's numbers, without a browser."""

import pytest

import difftrb as trb

explorer = pytest.importorskip("difftrb.report.explorer", reason="needs Panel", exc_type=ImportError)


def test_moves_are_solved_and_what_cannot_be_is_a_sentence() -> None:
    scene = trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),))
    page = explorer.Explorer(explorer.checked(scene))
    page.sliders["length"].value = 5.0
    longer = trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(5.0, 7.0),))
    assert f"{float(trb.solve(longer).radial_stiffness):,.0f}" in page.numbers.object
    page.sliders["axial"].value = 100.0
    assert "no equilibrium" in page.numbers.object
    with pytest.raises(trb.SceneError, match="without effects"):
        explorer.checked(trb.Scene("32008J", trb.Load(9000.0, 4500.0), effects=(trb.effects.Life(),)))
    with pytest.raises(trb.SceneError, match="explore takes one rectangular spall"):
        explorer.checked(trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.load_height_map(trb.example_map()),)))
