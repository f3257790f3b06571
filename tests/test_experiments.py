"""The scripts in experiments/, in small."""

import dataclasses
import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.accuracy import ladder
from difftrb.accuracy.ladder import Rung
from difftrb.contact.contact_cells import Resolution
from difftrb.contact.grids import GRIDS
from experiments import by_scipy

FOLDER = Path(__file__).parents[1] / "experiments"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where a dataclass looks up its annotations
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_accuracy_of_contact(contact: trb.LineContact) -> None:
    experiment = script("accuracy_of_contact")
    cases = experiment.random_cases(3, contact)
    coarse, to_compile, seconds = experiment.approaches(Resolution(12, 8, 4), contact, cases)
    fine, _, _ = experiment.approaches(Resolution(24, 16, 8), contact, cases)
    np.testing.assert_allclose(coarse, fine, rtol=2e-2)
    assert to_compile > 0.0
    assert seconds > 0.0


def test_accuracy_of_strips(contact: trb.LineContact) -> None:
    experiment = script("accuracy_of_strips")
    cases = experiment.random_cases("sliver", 2, contact)
    (coarse, settled, milliseconds), (fine, _, _) = (
        experiment.approaches(GRIDS[accuracy].strips, accuracy, contact, cases, 1) for accuracy in (1e-2, 1e-3)
    )
    np.testing.assert_allclose(coarse, fine, rtol=1e-2)
    assert settled.all()
    assert milliseconds > 0.0


@pytest.mark.slow
def test_speed_of_ring(power: trb.PowerLaw) -> None:
    for first, each in script("speed_of_ring").measure(power, 4).values():
        assert first > 0.0
        assert each > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("way", [by_scipy.in_numpy, by_scipy.on_law])
def test_scipy_finds_the_same_ring(power: trb.PowerLaw, way) -> None:
    scene = trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law=power)
    (stiffness, loads), (by_length, _), (by_width, _) = by_scipy.with_slopes(scene, way)()
    ours = trb.solve(scene).check()
    np.testing.assert_allclose(stiffness, ours.stiffness, rtol=1e-8, atol=1e-4)
    np.testing.assert_allclose(loads, ours.loads, rtol=1e-8, atol=1e-5)
    slope = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene).spalls[0]
    assert by_length[0, 0] == pytest.approx(float(slope.length), rel=1e-5)
    assert by_width[0, 0] == pytest.approx(0.0, abs=1e-3)


def test_drawing_of_axes(tmp_path: Path) -> None:
    script("readme_figures").drawing(tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"axes.png", "axes.svg"}


@pytest.mark.parametrize("name", ["overview", "axes"])
def test_pages_show_figures_that_exist(name: str) -> None:
    shown = [*(FOLDER.parent / "docs").glob("*.md"), FOLDER.parent / "README.md"]
    assert any(f"{name}.png" in page.read_text(encoding="utf-8") for page in shown)
    assert (FOLDER.parent / "docs" / f"{name}.png").exists()


@pytest.mark.slow
def test_speed_of_contact(contact: trb.LineContact) -> None:
    experiment = script("speed_of_contact")
    cases = experiment.geometries(2, contact, 0)
    assert all(experiment.geometries(2, contact, edges).shape == cases.shape == (2, 4) for edges in (1, 2))
    truth = experiment.truths(contact, cases[:1], Resolution(16, 12, 6))
    measured = experiment.measure(contact, cases, 0, 1e-2, truth)
    assert measured["converged"] == 1.0
    assert measured["worst"] < 1e-2
    assert all(number > 0.0 for number in measured.values())


def test_gain_of_two_threads(contact: trb.LineContact) -> None:
    """Measured at all; how large it is depends on who else computes."""
    gain = script("speed_of_contact").on_two_threads(lambda case: contact.radius * jnp.sum(case), jnp.ones((4, 2)))
    assert 0.0 < gain < np.inf


@pytest.mark.slow
def test_iterations_of_contact_meet_their_goals(contact: trb.LineContact) -> None:
    """Far fewer than 50 steps to 1e-4 of the approach and 130 to 1e-6; twice the cells each way add next to none."""
    experiment = script("iterations_of_contact")
    rows = experiment.cases()[[6, 7]]  # 3 kN: a wide spall, and its edge in the middle of the contact
    coarse, fine = (experiment.steps(contact, Resolution(*size), rows, 60) for size in ((16, 8, 4), (32, 16, 8)))
    for measured in (coarse, fine):
        assert (measured.approach <= (15, 25)).all()
        assert (measured.violation >= measured.approach).all()
    assert (fine.approach - coarse.approach <= (3, 5)).all()


@pytest.fixture(scope="module")
def against_peers() -> ModuleType:
    return script("contact_against_peers")


@pytest.mark.slow
def test_contact_against_peers(against_peers: ModuleType, tmp_path: Path) -> None:
    experiment, group = against_peers, "rolling edges out of reach"
    groups = {group: experiment.CASES[group][:2]}
    rows = [task() for task in experiment.tasks(groups, [], (), {"strips": (1e-2,)}, 1)]
    assert [row.setting for row in rows] == ["0.01, batch", "0.01, single"]
    assert all(0.0 < row.median <= row.worst < 1e-2 and row.milliseconds > 0.0 for row in rows)
    peer = experiment.Row(group, "Tamaas", "2 × 2", 4, 10.0 * rows[0].worst, 0.0, 50.0 * rows[0].milliseconds)
    exact = experiment.Row(group, "Tamaas", "4 × 4", 16, 0.0, 0.0, 1.0)
    batch, _, slow, unmatched = experiment.with_ratios([*rows, peer, exact])
    assert (batch.ratio, unmatched.ratio) == (1.0, None)
    assert slow.ratio == pytest.approx(50.0)
    experiment.figure([*rows, peer], groups, tmp_path / "out")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {f"contact_against_peers.{k}" for k in ("png", "svg")}


def test_peers_get_the_papers_sharp_mask_on_a_uniform_grid(against_peers: ModuleType) -> None:
    case = against_peers.CASES["a rolling edge in the contact"][0]
    sides, gap = against_peers.uniform(case, 20, 100)
    hollow = gap > 0.5 * against_peers.DEPTH
    assert hollow.any(axis=0).sum() * sides[1] / 100 == pytest.approx(case.length, abs=sides[1] / 100)
    assert hollow[-1].any()  # the spall covers one side of the contact
    assert not hollow[0].any()
    np.testing.assert_allclose(gap, gap[:, ::-1], atol=1e-15)


@pytest.mark.parametrize("name", ["Tamaas", "ContactMechanics"])
def test_peer_solves_the_same_contact(against_peers: ModuleType, name: str) -> None:
    if against_peers.installed(name) is None:
        pytest.skip(f"{name} is not installed")
    group = "rolling edges out of reach"
    row = against_peers.peer_row(name, group, against_peers.CASES[group][:2], (20, 100), 1)
    assert row.worst < 3e-2
    assert row.milliseconds > 0.0


@pytest.mark.slow
def test_peers_that_are_missing_are_left_out(
    against_peers: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    small = {"a group": against_peers.CASES["rolling edges out of reach"][:1]}
    monkeypatch.setattr(against_peers, "PEERS", {"Tamaas": "no_such_module"})
    monkeypatch.setattr(against_peers, "CASES", small)
    monkeypatch.setattr(against_peers, "ACCURACIES", {"strips": (1e-2,)})
    monkeypatch.setattr(
        "sys.argv", ["contact_against_peers.py", "--repeats", "1", "--json", str(tmp_path / "all.json")]
    )
    against_peers.main()
    assert "Tamaas is not installed and left out" in capsys.readouterr().out
    record = json.loads((tmp_path / "all.json").read_text(encoding="utf-8"))
    assert [row["solver"] for row in record["rows"]] == ["difftrb, strips"] * 2


@pytest.mark.slow
def test_energy_release(contact: trb.LineContact, tmp_path: Path) -> None:
    experiment = script("energy_release")
    rows = [experiment.measure(contact, 2500.0, 4.0, 32, 16)]
    assert rows[0].release == pytest.approx(rows[0].slope, rel=0.03)
    experiment.draw({(2500.0, 4.0): rows}, tmp_path / "energy_release.png")
    assert (tmp_path / "energy_release.png").stat().st_size > 0


def test_the_packaged_height_map_is_the_scripts(tmp_path: Path) -> None:
    experiment = script("example_height_map")
    experiment.write(tmp_path / "map.npz")
    ours, theirs = trb.load_height_map(tmp_path / "map.npz"), trb.load_height_map(trb.example_map())
    np.testing.assert_array_equal(ours.height, theirs.height)
    np.testing.assert_allclose(ours.height, experiment.spall_map(), atol=1e-7)
    assert trb.example_map().stat().st_size < 100_000


@pytest.mark.slow
def test_laws_of_ring() -> None:
    """The comparison itself, with a law that needs no contact solves as the truth."""
    experiment = script("laws_of_ring")
    scenes = [dataclasses.replace(s, law="liu2018") for s in experiment.random_scenes(2, 1e-3)]
    errors = experiment.compare(scenes, ("liu2018", "palmgren"))
    assert errors["liu2018"].shape == (2, 4)
    assert (errors["liu2018"] == 0.0).all()
    assert (errors["palmgren"][:, :2] > 0.0).all()


@pytest.mark.slow
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
    value, slope = experiment.brute_force(scene, 2000)
    assert value == pytest.approx(mean[1], rel=1e-4)
    assert slope == pytest.approx((mean[2] - mean[0]) / (widths[2] - widths[0]), rel=0.1)  # steps of 2.5 %
    experiment.draw(lines, widths, tmp_path)
    assert {p.suffix for p in tmp_path.iterdir()} == {".png", ".svg"}


@pytest.mark.slow
def test_ring_against_peers(tmp_path: Path) -> None:
    """scipy solves the same ring."""
    experiment = importlib.import_module("experiments.ring_against_peers")
    spall = (trb.Spall(4.0, 7.0),)
    scene = trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), spall, trb.liu2018())
    ours = trb.solve(scene)
    values = {f"{way}_stiffness": float(getattr(ours, f"{way}_stiffness")) for way in ("radial", "axial")}
    rung = Rung("ring", "liu2018", 1e-3)
    row = ladder.Row(rung, 0.1, 1e-3, 1e-4, 1e-6, 1e-6, 0.0, values, "converged", dict.fromkeys(values, 0.04))
    measured = SimpleNamespace(rows=(row,), truth=lambda _: row)
    peers = experiment.peer_rows(scene, measured, ("liu2018",), (20, 6))
    assert [each.setting for each in peers] == ["liu2018", "40×400, clipped", "40×400, whole"]
    assert peers[0].error < 1e-9
    assert 0.0 < peers[1].error < 0.2
    experiment.draw([*experiment.own_rows(measured), *peers], 1e-4, tmp_path)
    assert {p.suffix for p in tmp_path.iterdir()} == {".png", ".svg"}


@pytest.mark.slow
def test_effects_and_their_cost(tmp_path: Path) -> None:
    """A rigid flange changes nothing; a through spall takes all dependence on length away."""
    experiment = script("effects_and_their_cost")
    rows = experiment.compare(2, {"combined": trb.Load(9000.0, 4500.0)}, ("none", "flange, rigid", "through"))
    plain, flange, through = rows
    np.testing.assert_allclose([flange.stiffness, flange.load, flange.slope], 0.0, atol=1e-12)  # [%]
    assert plain.program < flange.program
    assert through.slope == [-100.0]
    assert through.stiffness[0] < -10.0
    experiment.draw(rows, ["combined"], tmp_path)
    assert {p.suffix for p in tmp_path.iterdir()} == {".png", ".svg"}
    assert experiment.by_contacts(2, ("none",))["none"] > 0.0


def test_became_slower_than_the_baseline() -> None:
    """More than noise: the quickest round now against three quarters of those then, both in yardsticks."""
    experiment = script("became_slower")
    stats = {"yardstick": (2.0, 3.0), "a": (3.0, 18.0), "b": (3.2, 3.4), "new": (18.0, 18.0)}
    record = [{"name": f"test_{k}", "stats": {"min": low, "q3": high}} for k, (low, high) in stats.items()]
    now = experiment.spans({"benchmarks": record})
    assert now == {"a": (1.5, 9.0), "b": (1.6, 1.7), "new": (9.0, 9.0)}
    before = {"a": (1.0, 1.2), "b": (1.0, 1.2), "gone": (1.0, 1.0)}
    assert experiment.slower(now, before) == ["b"]


@pytest.mark.slow
def test_baseline_is_of_the_benchmarks() -> None:
    suite = script("benchmarks")
    kept = json.loads(script("became_slower").BASELINE.read_text(encoding="utf-8"))
    assert all(0.0 < low <= high for low, high in kept.values())
    rings = {f"{name}[{law}]" for law in suite.LAWS
             for name in ("prepare", "solve", "batch", "batch_with_gradient")}  # fmt: skip
    assert kept.keys() == rings | {f"contact[{method}]" for method in suite.METHODS}
    slopes = suite._slopes(trb.prepare(suite.named("liu2018")), suite.SIZES, suite.RADIALS[:2])[1]
    assert (np.asarray(slopes)[:, 0] < 0.0).all()


@pytest.mark.slow
def test_auto_keeps_its_promise_in_small() -> None:
    """Two random scenes, their rollers anywhere, against contacts ten times as exact as those picked."""
    experiment = script("accuracy_promise")
    for scene in list(experiment.scenes(9, 0))[:9:8]:
        (found,) = experiment.outcomes(scene, (1e-2,), 1e-3)
        assert found.said <= 1e-2
        assert 0.0 < found.error < 0.2 * found.asked


def test_page_of_hard_cases_is_made_of_what_was_run(tmp_path: Path) -> None:
    """Files alone, in small; what else there is to say is kept for another run."""
    module = importlib.import_module("experiments.stability.__main__")
    page = tmp_path / "stability.md"
    module.main(["files", "--small", "--out", str(tmp_path / "numbers"), "--page", str(page)])
    text = page.read_text(encoding="utf-8")
    assert "300 packaged scenes and tables of measurements" in text
    assert ", 0 tracebacks" in text
    assert "## A ring" not in text
    with pytest.raises(SystemExit):
        module.main(["nothing"])
