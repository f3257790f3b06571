"""Stiffness over the cage's angle: it is the ring's at every phase, repeats, and goes into files and into ROSS."""

import csv
import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.core import geometry
from difftrb.turning import turn_file
from difftrb.turning.cage_turn import CageTurn

PHASES = 8


@pytest.fixture(scope="module")
def scene(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),))


@pytest.fixture(scope="module")
def turn(scene: trb.Scene) -> CageTurn:
    return trb.stiffness(scene, PHASES)


def test_every_phase_is_the_ring_at_that_phase(scene: trb.Scene, turn: CageTurn) -> None:
    turn.check()
    for k in (0, 3):
        there = trb.solve(dataclasses.replace(scene, phase=float(turn.cage[k])))
        np.testing.assert_allclose(turn.stiffness[k], there.stiffness, rtol=1e-9, atol=1.0)
        np.testing.assert_allclose(turn.displacement[k], there.displacement, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(turn.loads[k], there.loads, rtol=1e-9, atol=1e-6)


@pytest.mark.gradient
def test_slopes_are_those_of_the_ring_and_of_differences(scene: trb.Scene, turn: CageTurn) -> None:
    at = dataclasses.replace(scene, phase=float(turn.cage[3]))
    by = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(at).spalls[0]
    assert turn.by_length is not None
    assert turn.by_width is not None
    assert float(turn.by_length[3, 0, 0, 0]) == pytest.approx(float(by.length), rel=1e-7)
    assert float(turn.by_width[3, 0, 0, 0]) == pytest.approx(float(by.width), rel=1e-7, abs=1e-3)
    both = [trb.stiffness(dataclasses.replace(scene, spalls=(trb.Spall(4.0 + e, 7.0),)), PHASES).stiffness
            for e in (1e-4, -1e-4)]  # fmt: skip
    np.testing.assert_allclose(turn.by_length[..., 0], (both[0] - both[1]) / 2e-4, rtol=1e-4, atol=50.0)


def test_all_repeats_after_a_pitch(scene: trb.Scene, turn: CageTurn) -> None:
    assert turn.repeats == "pitch"
    assert float(turn.span) == pytest.approx(float(geometry.roller_pitch(scene.bearing)))
    orders = turn.orders(PHASES // 2)
    angle = 2.0 * np.pi * np.arange(PHASES) / PHASES
    back = sum(np.real(np.asarray(c)[..., None] * np.exp(1j * n * angle)) for n, c in enumerate(orders.stiffness))
    np.testing.assert_allclose(np.moveaxis(back, -1, 0), turn.stiffness, rtol=1e-9, atol=1e-3)
    with pytest.raises(trb.SceneError, match="highest = 9"):
        turn.orders(9)
    with pytest.raises(trb.SceneError, match="phases = 0"):
        trb.stiffness(scene, 0)


def test_springs_in_series_give_as_much_as_all_together(turn: CageTurn) -> None:
    housing = np.array([4e5, 4e5, 2e5])
    total = turn.in_series(housing)
    for k in range(PHASES):
        give = np.linalg.inv(turn.stiffness[k]) + np.diag(1.0 / housing)
        np.testing.assert_allclose(total.stiffness[k], np.linalg.inv(give), rtol=1e-9, atol=1e-3)
    step = dataclasses.replace(turn, stiffness=turn.stiffness + 1e-6 * turn.by_length[..., 0]).in_series(housing)
    np.testing.assert_allclose((step.stiffness - total.stiffness) / 1e-6, total.by_length[..., 0], rtol=1e-3, atol=5.0)
    with pytest.raises(trb.SceneError, match="shape"):
        turn.in_series(np.ones(2))


@pytest.mark.exact
def test_defect_frequencies_are_the_textbooks(bearing: trb.TaperedBearing) -> None:
    """Harris, Rolling Bearing Analysis, §25.4, for contact angle β and D/D_pw cosα as tan γ/tan β."""
    found = trb.defect_frequencies(bearing, 1500.0)
    assert float(found.shaft) == 25.0
    ratio = 1.0 - 2.0 * float(found.ftf) / 25.0
    assert 0.05 < ratio < 0.25
    assert float(found.bpfo) == pytest.approx(0.5 * bearing.rollers * 25.0 * (1.0 - ratio))
    assert float(found.bpfi) == pytest.approx(0.5 * bearing.rollers * 25.0 * (1.0 + ratio))
    assert float(found.bpfo + found.bpfi) == pytest.approx(bearing.rollers * 25.0)
    both = trb.defect_frequencies(bearing, 1500.0, 1500.0)
    assert float(both.bpfo) == float(both.bsf) == 0.0
    with pytest.raises(trb.SceneError, match="no bearing named"):
        trb.defect_frequencies("no bearing", 1500.0)
    slope = jax.grad(lambda rpm: trb.defect_frequencies(bearing, rpm).bpfo)(1500.0)
    assert float(slope) == pytest.approx(float(found.bpfo) / 1500.0)


def test_files_have_units_and_axes(turn: CageTurn, tmp_path: Path) -> None:
    for kind in (".csv", ".json", ".npz"):
        turn_file.write(turn, tmp_path / f"K{kind}", "si", 1500.0)
    with (tmp_path / "K.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    column = rows[0].index("stiffness_radial_radial [N/m]")
    assert len(rows) == PHASES + 1
    np.testing.assert_allclose([float(row[column]) for row in rows[1:]], 1e3 * turn.stiffness[:, 0, 0], rtol=1e-12)
    record = json.loads((tmp_path / "K.json").read_text(encoding="utf-8"))
    assert record["axes"] == ["radial", "lateral", "axial"]
    assert record["defect_frequencies"]["bpfo"] > 0.0
    np.testing.assert_allclose(record["stiffness"], 1e3 * turn.stiffness, rtol=1e-12)
    with np.load(tmp_path / "K.npz") as found:
        np.testing.assert_allclose(found["displacement"], 1e-3 * turn.displacement, rtol=1e-12)
        assert found["time"][1] > found["time"][0] == 0.0
    with pytest.raises(trb.SceneError, match=r"must end with \.csv"):
        turn_file.write(turn, tmp_path / "K.txt")
    with pytest.raises(trb.SceneError, match="units = 'inch'"):
        turn_file.table(turn, "inch")  # type: ignore[arg-type]


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], turn: CageTurn) -> None:
    out = tmp_path / "K.json"
    assert cli.main(["--no-cache", "stiffness", "--phases", str(PHASES), "--out", str(out), "--speed", "1500"]) == 0
    printed = capsys.readouterr().out
    assert "BPFO" in printed
    assert "order 1" in printed
    np.testing.assert_allclose(json.loads(out.read_text(encoding="utf-8"))["stiffness"], turn.stiffness, rtol=1e-12)
    assert cli.main(["--no-cache", "stiffness", "--phases", "4", "--json", "--housing", "4e5,2e5"]) == 0
    assert np.asarray(json.loads(capsys.readouterr().out)["stiffness"])[:, 0, 0].max() < 4e5
    assert cli.main(["--no-cache", "stiffness", "--housing", "4e5"]) == 2
    assert "give RADIAL,AXIAL" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------ ROSS


def test_axes_of_ross(turn: CageTurn) -> None:
    """Radial is −y, lateral is x, axial is z: as gravity pulls on a lying shaft."""
    K = trb.ross.stiffness_in_metres(turn)
    mean = 1e3 * np.asarray(turn.mean_stiffness)
    np.testing.assert_allclose(K[1, 1], mean[0, 0], rtol=1e-12)
    np.testing.assert_allclose(K[0, 0], mean[1, 1], rtol=1e-12)
    np.testing.assert_allclose(K[2, 2], mean[2, 2], rtol=1e-12)
    np.testing.assert_allclose(K[1, 2], -mean[0, 2], rtol=1e-12)
    with pytest.raises(trb.SceneError, match="axial = 0"):
        trb.ross.axes(axial=0)  # type: ignore[arg-type]
    assert trb.ross.stiffness_in_metres(np.eye(3)) == pytest.approx(1e3 * np.eye(3))


def test_ross_itself(turn: CageTurn) -> None:
    """Natural frequencies are those with the same matrix entered by hand; passing rollers shake the shaft a little."""
    ross = pytest.importorskip("ross")
    steel = ross.Material(name="steel", rho=7810.0, E=211e9, G_s=81.2e9)
    shaft = [ross.ShaftElement(L=0.1, idl=0.0, odl=0.04, material=steel, n=n) for n in range(4)]
    disk = ross.DiskElement(n=2, m=10.0, Id=0.02, Ip=0.04)
    K = trb.ross.stiffness_in_metres(turn)
    by_hand = {"kxx": K[0, 0], "kxy": K[0, 1], "kyx": K[1, 0], "kyy": K[1, 1], "kzz": K[2, 2], "cxx": 1e3}
    rotors = [
        ross.Rotor(shaft, [disk], [make(n) for n in (0, 4)])
        for make in (
            lambda n: trb.ross.bearing_element(turn, n, 1e3, coupled=False),
            lambda n: ross.BearingElement(n=n, **by_hand),
            lambda n: trb.ross.bearing_element(turn, n, 1e3),
        )
    ]
    ours, theirs, coupled = (rotor.run_modal(speed=100.0).wn for rotor in rotors)
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    assert not np.allclose(coupled, theirs, rtol=1e-6)
    t = np.linspace(0.0, 0.02, 401)
    force = trb.ross.passage_force(turn, rotors[2], 0, 100.0, t)
    found = np.array([force(k, np.zeros(rotors[2].ndof)) for k in range(len(t))])
    assert np.isfinite(found).all()
    assert np.abs(found[:, :3]).max() > 0.0
    assert not found[:, 3:].any()


def test_passage_moves_the_shaft_as_the_waveform_says(turn: CageTurn) -> None:
    """At rest in the waveform the force of the turn is met by the mean spring: no shaft is needed to see it."""

    class Rotor:
        number_dof, ndof = 3, 3

    t = np.linspace(0.0, 0.01, 11)
    force = trb.ross.passage_force(turn, Rotor(), 0, 100.0, t)
    across = trb.ross.axes()
    rest = 1e-3 * across @ np.asarray(turn.waveform[0])
    K = trb.ross.stiffness_in_metres(turn)
    np.testing.assert_allclose(force(0, rest), K @ rest, rtol=1e-9, atol=1e-9)
    assert jnp.all(jnp.isfinite(force(5, rest)))
