"""The FMU against the turn that it holds, by another program that runs FMUs: FMPy."""

import importlib.util
import zipfile
from pathlib import Path

import numpy as np
import pytest

import difftrb as trb
from difftrb.core.geometry import cage_rate
from difftrb.turning.cage_turn import CageTurn

there = all(importlib.util.find_spec(name) for name in ("pythonfmu", "fmpy"))
needs_both = pytest.mark.skipif(not there, reason="PythonFMU and FMPy are not both installed")
SPEED = 3000.0  # [rev/min]


@pytest.fixture(scope="module")
def turn() -> CageTurn:
    return trb.stiffness(trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),)), 64).check()


def simulated(path: Path, q: np.ndarray, stop: float, step: float) -> np.ndarray:
    """Outputs over time, the shaft held at q [m]."""
    import fmpy  # pyright: ignore[reportMissingImports]

    held = np.array([(0.0, *q)], [("time", float), ("x", float), ("y", float), ("z", float)])
    return fmpy.simulate_fmu(
        str(path), stop_time=stop, step_size=step, output_interval=step, input=held,
        output=["cage_angle", "fx", "fy", "fz", "kxx", "kyy", "kyz"],
    )  # fmt: skip


@needs_both
@pytest.mark.filterwarnings("default")
def test_force_is_that_of_the_turn(turn: CageTurn, tmp_path: Path) -> None:
    """At the phases of the turn, where nothing is interpolated: f = -K (q - u + ū), in N and m."""
    from fmpy.validation import validate_fmu  # pyright: ignore[reportMissingImports]

    path = tmp_path / "bearing.fmu"
    trb.fmu.write(turn, path, SPEED)
    assert validate_fmu(str(path)) == []
    q = np.array([2e-7, -5e-7, 1e-7])
    step = float(turn.span) / 64 / float(cage_rate(turn.bearing, SPEED))
    found = simulated(path, q, 70 * step, step)
    stiff, moved = trb.ross.over_axes(turn)
    np.testing.assert_allclose(found["cage_angle"][1:65], float(turn.span) / 64 * np.arange(1, 65), rtol=1e-9)
    for row in (1, 30, 63, 66):
        wanted = -stiff[row % 64] @ (q - moved[row % 64])
        np.testing.assert_allclose([found[name][row] for name in ("fx", "fy", "fz")], wanted, rtol=1e-6, atol=1e-3)
        own = [stiff[row % 64][k] for k in ((0, 0), (1, 1), (1, 2))]
        np.testing.assert_allclose([found[name][row] for name in ("kxx", "kyy", "kyz")], own, rtol=1e-6)


@needs_both
def test_by_the_command(tmp_path: Path, capsys) -> None:
    from difftrb import __main__ as cli

    path = tmp_path / "bearing.fmu"
    assert cli.main(["--no-cache", "stiffness", "--phases", "16", "--speed", "3000", "--out", str(path)]) == 0
    assert f"written to {path}" in capsys.readouterr().out
    names = zipfile.ZipFile(path).namelist()
    assert {"modelDescription.xml", "resources/turn.json", "resources/fmu_slave.py"} <= set(names)
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_refused(turn: CageTurn, tmp_path: Path) -> None:
    with pytest.raises(trb.SceneError, match=r"name a file that ends with \.fmu"):
        trb.fmu.write(turn, tmp_path / "bearing.zip")
    part = trb.stiffness(trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),)), 4, span=0.1)
    with pytest.raises(trb.SceneError, match="nothing repeats"):
        trb.fmu.write(part, tmp_path / "bearing.fmu")
    if not there and importlib.util.find_spec("pythonfmu") is None:
        with pytest.raises(trb.SceneError, match=r"pip install '\.\[fmu\]'"):
            trb.fmu.write(turn, tmp_path / "bearing.fmu")
