"""The scripts in experiments/, in small."""

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


def test_the_packaged_height_map_is_the_scripts(tmp_path: Path) -> None:
    experiment = script("example_height_map")
    experiment.write(tmp_path / "map.npz")
    ours, theirs = trb.load_height_map(tmp_path / "map.npz"), trb.load_height_map(trb.example_map())
    np.testing.assert_array_equal(ours.height, theirs.height)
    np.testing.assert_allclose(ours.height, experiment.spall_map(), atol=1e-7)
    assert trb.example_map().stat().st_size < 100_000
