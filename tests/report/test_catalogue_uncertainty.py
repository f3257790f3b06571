"""What a run says of a bearing that was estimated from its catalogue."""

import json
from pathlib import Path

import numpy as np
import pytest

import difftrb as trb
from difftrb import __main__ as cli

LINE = "bearing = { d = 30, D = 62, T = 17.25, e = 0.37, rollers = 17, roller_diameter = 7.8 }\n"
SCENE = LINE + "load = { radial = 4000.0, axial = 2000.0 }\n[[spall]]\nlength = 3.0\nwidth = 5.0\n"


def test_run_says_what_is_left_of_stiffness_and_of_its_loss(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As much as `CatalogueBearing.uncertainty` finds of the same functions of bearing and crown."""
    path = tmp_path / "mine.toml"
    path.write_text(SCENE, encoding="utf-8")
    assert cli.main(["--no-cache", "run", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["estimated"]
    made = trb.bearing_from_catalogue(d=30.0, D=62.0, T=17.25, e=0.37, rollers=17, roller_diameter=7.8)

    def radial(bearing: trb.TaperedBearing, design_load: float) -> np.ndarray:
        scene = trb.Scene(bearing, trb.Load(4000.0, 2000.0), trb.Spall(3.0, 5.0), design_load=design_load)
        whole, spalled = (trb.solve(s).check().radial_stiffness for s in (scene.replace(spalls=()), scene))
        return np.array([spalled, 1.0 - spalled / whole])

    stiffness, loss = made.uncertainty(radial)
    assert found["stiffness_uncertainty"]["radial"] == pytest.approx(stiffness, rel=2e-3)
    share = loss / radial(made.bearing, made.design_load)[1]
    assert found["relative_loss_uncertainty"]["radial"] == pytest.approx(share, rel=1e-2)
    path.write_text(f"{SCENE}[contact]\nlaw = 'direct'\n", encoding="utf-8")
    assert cli.main(["--no-cache", "run", str(path), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)  # by the table, for contacts that were solved know one bearing
    share = stiffness / radial(made.bearing, made.design_load)[0]
    told = record["estimated"]["stiffness_uncertainty"]["radial"] / record["stiffness"]["radial"]
    assert told == pytest.approx(share, rel=2e-3)
    path.write_text(SCENE, encoding="utf-8")
    share = loss / radial(made.bearing, made.design_load)[1]
    assert cli.main(["--no-cache", "run", str(path)]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert f"and what the spall takes of it within ± {100.0 * share:.0f} %" in words
