"""Stiffness over the cage's angle: equal to solves one by one, its derivatives, orders, springs, files, the command."""

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
from difftrb.report import stiffness_report
from difftrb.turning import ross
from difftrb.turning.cage_turn import CageTurn


@pytest.fixture(scope="module")
def spalled() -> trb.Scene:
    return trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),))


@pytest.fixture(scope="module")
def turn(spalled: trb.Scene) -> CageTurn:
    return trb.stiffness(spalled, 32).check()


@pytest.mark.exact
@pytest.mark.portable
def test_each_phase_is_that_solved_alone(spalled: trb.Scene, turn: CageTurn) -> None:
    for k in (0, 11, 20):
        alone = trb.assess(spalled.replace(phase=float(turn.cage[k])))
        np.testing.assert_allclose(turn.stiffness[k], alone.spalled.stiffness, rtol=1e-9, atol=1e-3)
        np.testing.assert_allclose(turn.displacement[k], alone.spalled.displacement, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(turn.loads[k], alone.spalled.loads, rtol=1e-9, atol=1e-6)
        assert turn.by_length is not None
        assert turn.by_width is not None
        np.testing.assert_allclose(turn.by_length[k, 0, 0], alone.by_length[0], rtol=1e-7)
        np.testing.assert_allclose(turn.by_width[k, 0, 0], alone.by_width[0], rtol=1e-7, atol=1e-3)


@pytest.mark.slow
def test_contacts_are_solved_phase_by_phase(spalled: trb.Scene) -> None:
    """By contact solves the same, to their error; a map, which only these know, is turned over, too."""
    at = {"span": 0.04, "phases": 2}
    by_contacts = trb.stiffness(spalled.replace(law="direct", accuracy=1e-2), **at).check()
    by_table = trb.stiffness(spalled, **at).check()
    assert by_contacts.by_length is not None
    np.testing.assert_allclose(by_contacts.stiffness[:, 0, 0], by_table.stiffness[:, 0, 0], rtol=3e-3)
    with_map = dataclasses.replace(spalled, spalls=(trb.load_height_map(trb.example_map()),))
    turned = trb.stiffness(with_map, **at).check()
    assert float(turned.stiffness[0, 0, 0]) < float(turned.stiffness[1, 0, 0])


@pytest.mark.exact
def test_the_mean_is_the_scenes_own(spalled: trb.Scene) -> None:
    """Equal steps over a kinked period against Gauss between its kinks."""
    mean = trb.solve(spalled.replace(phase="mean")).stiffness
    np.testing.assert_allclose(trb.stiffness(spalled, 1024).mean_stiffness, mean, rtol=2e-4, atol=500.0)


@pytest.mark.gradient
def test_derivatives_by_two_routes(spalled: trb.Scene, turn: CageTurn) -> None:
    """`jax.grad` through all phases against the slopes that come with them, and against steps."""

    def total(scene: trb.Scene) -> jax.Array:
        return jnp.sum(trb.stiffness(scene, 32).stiffness[:, 0, 0])

    slope = jax.grad(total)(spalled)
    assert turn.by_length is not None
    assert turn.by_width is not None
    assert float(slope.spalls[0].length) == pytest.approx(float(turn.by_length[:, 0, 0, 0].sum()), rel=1e-9)
    assert float(slope.spalls[0].width) == pytest.approx(float(turn.by_width[:, 0, 0, 0].sum()), rel=1e-9, abs=1e-3)
    by_steps = (total(spalled.replace(axial=4500.01)) - total(spalled.replace(axial=4499.99))) / 0.02
    assert float(slope.load.axial) == pytest.approx(float(by_steps), rel=1e-5)


@pytest.mark.exact
def test_orders_make_the_stiffness_again(turn: CageTurn) -> None:
    orders = turn.orders(16)
    angle = 2.0 * np.pi * np.arange(32) / 32
    again = np.real(np.einsum("nij,np->pij", np.asarray(orders.stiffness), np.exp(1j * np.outer(np.arange(17), angle))))
    np.testing.assert_allclose(again, turn.stiffness, rtol=1e-9, atol=1e-3)
    np.testing.assert_allclose(turn.waveform.mean(axis=0), 0.0, atol=1e-15)


@pytest.mark.exact
@pytest.mark.gradient
@pytest.mark.parametrize("skew", [0.0, 8e5])
def test_springs_in_series(turn: CageTurn, skew: float) -> None:
    """Compliances add; slopes go along as steps say, also where a film's stiffness is not symmetric."""
    shaft, housing = np.array([2e6, 2e6, 1e6]), np.diag([3e6, 4e6, 5e5])
    housing[0, 1], housing[1, 0] = skew, -skew
    total = turn.in_series(shaft, housing)
    whole = np.linalg.inv(np.linalg.inv(np.asarray(turn.stiffness)) + np.diag(1.0 / shaft) + np.linalg.inv(housing))
    np.testing.assert_allclose(total.stiffness, whole, rtol=1e-9, atol=1e-3)
    assert turn.by_length is not None
    assert total.by_length is not None
    moved = [dataclasses.replace(turn, stiffness=turn.stiffness + h * turn.by_length[..., 0]) for h in (1e-3, -1e-3)]
    steps = (moved[0].in_series(shaft, housing).stiffness - moved[1].in_series(shaft, housing).stiffness) / 2e-3
    np.testing.assert_allclose(total.by_length[..., 0], steps, rtol=1e-5, atol=1.0)


@pytest.mark.exact
def test_defect_frequencies_are_the_textbooks() -> None:
    """With D/D_pw cosα as tan γ/tan β; of both rings turning only the difference counts."""
    bearing = trb.bearing("32008J")
    beta, ratio = geometry.roller_axis_angle(bearing), 0.0
    ratio = np.tan(bearing.roller_angle) / np.tan(beta)
    f = trb.defect_frequencies(bearing, 3300.0, 300.0)
    assert float(f.shaft) == 50.0
    assert float(f.ftf) == pytest.approx(25.0 * (1.0 - ratio), rel=2e-3)
    assert float(f.bpfo) == pytest.approx(23 * 25.0 * (1.0 - ratio), rel=2e-3)
    assert float(f.bpfi) == pytest.approx(23 * 25.0 * (1.0 + ratio), rel=2e-3)
    by_size = np.sin(beta) / (2.0 * np.tan(bearing.roller_angle))  # D_pw/(2 D)
    assert float(f.bsf) == pytest.approx(50.0 * by_size * (1.0 - ratio**2), rel=2e-3)
    with pytest.raises(trb.SceneError, match="bearing = '6205' is unknown"):
        trb.defect_frequencies("6205", 3000.0)
    with pytest.raises(trb.SceneError, match=r"speed\.inner_rpm = 10000000"):
        trb.defect_frequencies(bearing, 1e7)


@pytest.mark.gradient
def test_defect_frequencies_are_differentiable() -> None:
    bearing = trb.bearing("32008J")
    slope = jax.grad(lambda b: trb.defect_frequencies(b, 3000.0).bsf)(bearing).roller_angle
    ends = [dataclasses.replace(bearing, roller_angle=bearing.roller_angle + h) for h in (1e-7, -1e-7)]
    high, low = (float(trb.defect_frequencies(b, 3000.0).bsf) for b in ends)
    assert float(slope) == pytest.approx((high - low) / 2e-7, rel=1e-5)


def test_orders_of_a_whole_turn_are_no_aliases() -> None:
    """One roller 1 nm thicker: 64 phases of the turn gave 1610 N/mm at the first order, the third of the passage."""
    differ = trb.effects.Diameters((1e-6, *[0.0] * 22))
    scene = trb.Scene("32008J", trb.Load(9000.0, 4500.0), trb.Spall(4.0, 7.0), law="palmgren", effects=(differ,))
    whole = trb.stiffness(scene)
    assert whole.cage.shape == (64 * 23,)
    assert float(abs(whole.orders(1).stiffness[1, 0, 0])) < 1.0


def test_what_moves_along_does_not_repeat(turn: CageTurn) -> None:
    """Where rollers differ the cage's whole turn is one period; other spans have no orders."""
    differ = trb.effects.Diameters(tuple([1e-4] + [0.0] * 22))
    whole = trb.stiffness(trb.Scene("32008J", trb.Load(0.0, 9000.0), law="palmgren", effects=differ), 23)  # type: ignore[arg-type]
    assert whole.repeats == "turn"
    assert float(whole.span) == pytest.approx(2.0 * np.pi)
    radial = np.asarray(whole.stiffness[:, 0, 0])
    assert radial.max() > radial.min()
    with pytest.raises(trb.SceneError, match="give phases = 368 or more"):
        whole.orders()
    with pytest.raises(trb.SceneError, match="give phases = 368 or more"):
        ross.over_axes(whole)
    scene = trb.Scene("32008J", trb.Load(9000.0, 4500.0), law="liu2018")
    part = trb.stiffness(scene, np.int64(4), span=0.1)  # type: ignore[arg-type]
    one_sided = [[1e6, 9e6, 0.0], [0.0, 1e6, 0.0], [0.0, 0.0, 1e6]]
    for springs in ((0.0, 1.0, 1.0), (-1e6, 1e6, 1e6), np.nan * np.eye(3), one_sided):
        with pytest.raises(trb.SceneError, match="must be above 0 N/mm along every axis"):
            part.in_series(springs)
    with pytest.raises(trb.SceneError, match="a stiffness in series = 'a': must be numbers"):
        part.in_series("a")
    for span in (0.0, np.inf, "1"):
        with pytest.raises(trb.SceneError, match=r"span = .*: must be a number above 0 rad, and finite"):
            trb.stiffness(scene, 4, span=span)  # type: ignore[arg-type]
    for speed in (0.0, np.nan):
        with pytest.raises(trb.SceneError, match=r"speed_rpm = .*: must be a number above 0 rev/min"):
            part.time(speed)
    with pytest.raises(trb.SceneError, match="nothing repeats"):
        part.orders()
    for highest in (17, 2.0):
        with pytest.raises(trb.SceneError, match=f"highest = {highest}"):
            turn.orders(highest)  # type: ignore[arg-type]
    with pytest.raises(trb.SceneError, match="phases = 0"):
        trb.stiffness(trb.Scene("32008J", trb.Load(9000.0, 4500.0)), 0)


def test_files_agree(turn: CageTurn, tmp_path: Path) -> None:
    """CSV, JSON and NPZ have the same numbers, in N/mm and in N/m."""
    for kind in ("csv", "json", "npz"):
        stiffness_report.write(turn, tmp_path / f"K.{kind}", "si", 3000.0)
    with open(tmp_path / "K.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    told = json.loads((tmp_path / "K.json").read_text(encoding="utf-8"))
    arrays = np.load(tmp_path / "K.npz")
    expected = 1e3 * np.asarray(turn.stiffness)
    np.testing.assert_allclose(arrays["stiffness"], expected)
    np.testing.assert_allclose(told["stiffness"], expected)
    np.testing.assert_allclose([float(row["stiffness_radial_axial [N/m]"]) for row in rows], expected[:, 0, 2])
    np.testing.assert_allclose([float(row["time [s]"]) for row in rows], turn.time(3000.0))
    assert told["unit"]["stiffness"][0][0] == "N/m"
    assert told["defect_frequencies"]["bpfo"] == pytest.approx(float(arrays["bpfo"]))
    assert turn.by_length is not None
    np.testing.assert_allclose(arrays["by_length"], 1e6 * np.asarray(turn.by_length))
    with pytest.raises(trb.SceneError, match=r"cannot be written; name a file that ends with \.csv or \.json or \.npz"):
        stiffness_report.write(turn, tmp_path / "K.xlsx")


def test_the_command(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    out = tmp_path / "K.csv"
    call = ["--no-cache", "stiffness", "--phases", "8", "--speed", "3000", "--housing", "1e6,5e5", "--out", str(out)]
    assert cli.main(call) == 0
    text = capsys.readouterr().out
    assert "BPFO 508" in text.replace("\n", " ")
    assert len(out.read_text(encoding="utf-8").splitlines()) == 9
    assert cli.main(["--no-cache", "stiffness", "--phases", "8", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["axes"] == ["radial", "lateral", "axial"]
    with monkeypatch.context() as patched:  # all of it is said before anything is solved
        patched.setattr(stiffness_report, "stiffness", None)
        for wrong, said in (
            (["--housing", "soft"], "give RADIAL,AXIAL in N/mm"),
            (["--speed", "0"], "speed = 0: must be above 0 rev/min"),
            (["--out", str(tmp_path / "K.xlsx")], "K.xlsx: cannot be written; name a file that ends with"),
        ):
            assert cli.main(["--no-cache", "stiffness", *wrong]) == 2
            assert said in capsys.readouterr().err


def test_labels_and_reprs(spalled: trb.Scene, turn: CageTurn) -> None:
    solution = trb.solve(spalled)
    for shown in (spalled, solution, turn):
        lines = repr(shown).splitlines()
        assert len(lines) <= 8
        assert max(map(len, lines)) <= 160
    pytest.importorskip("xarray")
    labelled = solution.to_xarray()
    value = labelled["stiffness"].sel(axis="radial", motion="axial")
    assert float(value) == float(solution.stiffness[0, 2])
    assert labelled["loads"].attrs["units"] == "N"


def test_scenes_are_replaced_by_name(spalled: trb.Scene) -> None:
    other = spalled.replace(length=3.0, radial=8000.0, phase=0.1, roller_length=13.0)
    assert (other.spalls[0].length, other.load.radial, other.phase) == (3.0, 8000.0, 0.1)
    assert other.bearing.roller_length == 13.0
    with pytest.raises(trb.SceneError, match="lenght is not known; did you mean length"):
        spalled.replace(lenght=3.0)
    with pytest.raises(trb.SceneError, match="the scene has 0 spalls"):
        spalled.replace(spalls=(), length=3.0)
    two = spalled.replace(spalls=spalled.spalls * 2)
    assert [spall.width for spall in two.replace(width=2.0, spall=1).spalls] == [7.0, 2.0]
    with_map = dataclasses.replace(spalled, spalls=(trb.HeightMap(jnp.zeros((2, 2)), 0.1, 0.1),))
    assert with_map.replace(scale=2.0).spalls[0].scale == 2.0
    with pytest.raises(trb.SceneError, match="length is not known"):
        with_map.replace(length=3.0)
    both = dataclasses.replace(spalled, spalls=spalled.spalls + with_map.spalls)
    with pytest.raises(trb.SceneError, match="length: spall 1 is a HeightMap, which has none"):
        both.replace(length=3.0, spall=1)
