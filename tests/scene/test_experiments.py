"""The scripts in experiments/, in small."""

import dataclasses
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import Resolution

FOLDER = Path(__file__).parents[2] / "experiments"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_accuracy_of_contact(contact: trb.LineContact) -> None:
    experiment = script("accuracy_of_contact")
    cases = experiment.random_cases(3, contact)
    coarse, to_compile, seconds = experiment.approaches(Resolution(12, 8, 4), contact, cases)
    fine, _, _ = experiment.approaches(Resolution(24, 16, 8), contact, cases)
    np.testing.assert_allclose(coarse, fine, rtol=2e-2)
    assert to_compile > 0.0
    assert seconds > 0.0


def test_speed_of_ring(power: trb.PowerLaw) -> None:
    for first, each in script("speed_of_ring").measure(power, 4).values():
        assert first > 0.0
        assert each > 0.0


def test_drawing_of_axes(tmp_path: Path) -> None:
    script("readme_figures").drawing(tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"axes.png", "axes.svg"}


@pytest.mark.parametrize("name", ["overview", "axes"])
def test_readme_shows_figures_that_exist(name: str) -> None:
    assert f"docs/{name}.png" in (FOLDER.parent / "README.md").read_text(encoding="utf-8")
    assert (FOLDER.parent / "docs" / f"{name}.png").exists()


def test_speed_of_contact(contact: trb.LineContact) -> None:
    experiment = script("speed_of_contact")
    cases = experiment.geometries(2, contact, False)
    assert experiment.geometries(2, contact, True).shape == cases.shape == (2, 4)
    measured = experiment.measure(contact, cases, False, 1e-2)
    assert measured["converged"] == 1.0
    assert all(number > 0.0 for number in measured.values())


def test_laws_of_ring() -> None:
    """The comparison itself, with a law that needs no contact solves as the truth."""
    experiment = script("laws_of_ring")
    scenes = [dataclasses.replace(s, law="liu2018") for s in experiment.random_scenes(2, 1e-3)]
    errors = experiment.compare(scenes, ("liu2018", "palmgren"))
    assert errors["liu2018"].shape == (2, 4)
    assert (errors["liu2018"] == 0.0).all()
    assert (errors["palmgren"][:, :2] > 0.0).all()


def test_width_and_phase(tmp_path: Path) -> None:
    """Under a hard window the ramp's lines are the staircase's and the mean falls with width."""
    experiment = script("width_and_phase")
    scene = trb.Scene(
        trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 5.0),), trb.liu2018(), phase=0.09
    )
    widths = np.array([3.0, 5.0, 9.0])
    lines = experiment.curves(scene, widths)
    step, same, mean, _ = lines.values()
    np.testing.assert_array_equal(step, same)
    assert (np.diff(mean) < 0.0).all()
    value, slope = experiment.brute_force(scene, 200)
    assert value == pytest.approx(mean[1], rel=1e-3)
    assert slope == 0.0  # no ramp: equal steps see no width
    experiment.draw(lines, widths, tmp_path)
    assert {p.suffix for p in tmp_path.iterdir()} == {".png", ".svg"}


def test_scipy_solves_the_same_ring() -> None:
    assert script("speed_of_ring").by_scipy(trb.liu2018(), 2) > 0.0
