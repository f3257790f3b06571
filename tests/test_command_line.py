"""The command line, in process: output, exit codes, and what is (not) written."""

import dataclasses
import io
import json
import math
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.core import geometry, user_cache
from difftrb.fits import measured_table
from difftrb.fits.parameters import PARAMETERS
from difftrb.report import pressure_figure, remarks, run_figures, run_text
from difftrb.scene import scene_file, solving
from difftrb.scene.prepared_scene import solve_prepared
from difftrb.scene.solution import Assessment
from difftrb.sweeps import sweep_file

PAPER = scene_file.example("paper")


def call(capsys, *arguments: str) -> tuple[int, str, str]:
    code = cli.main(["--no-cache", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture
def paper(tmp_path: Path) -> Path:
    path = tmp_path / "paper.toml"
    path.write_text(PAPER, encoding="utf-8")
    return path


RUN_KEYS = {
    "scene", "status", "converged", "angles", "loads", "displacement", "stiffness", "healthy", "loss", "sensitivity",
    "residual", "iterations", "seconds",
}  # fmt: skip
CONTACT_KEYS = {
    "status", "converged", "approach", "peak_pressure", "contact_width", "loaded_fraction", "residual", "iterations",
    "unknowns", "sensitivity", "accuracy", "seconds",
}  # fmt: skip


@pytest.mark.portable
def test_run_prints_json(capsys, paper: Path) -> None:
    code, out, err = call(capsys, "run", str(paper), "--json")
    record = json.loads(out)
    assert (code, err) == (0, "")
    assert set(record) == RUN_KEYS | {"mean"}
    assert record["converged"] is True
    assert len(record["loads"]) == len(record["angles"]) == 23
    assert set(record["displacement"]) == {"radial", "lateral", "axial"}
    assert set(record["stiffness"]) == {"definition", "phase", "radial", "axial", "matrix", "axes"}
    assert record["stiffness"]["definition"] == "secant"
    assert record["loss"]["radial"] == pytest.approx(8.78, abs=0.005)
    assert record["loss"]["axial"] == pytest.approx(3.42, abs=0.005)
    assert record["loads"][0] == pytest.approx(846.0, rel=1e-3)
    assert record["sensitivity"]["radial"]["length"] < 0.0
    assert record["sensitivity"]["axial"]["width"] == 0.0


def test_run_with_the_mean_over_the_cages_turn(capsys, paper: Path) -> None:
    """Where no roller stands on an edge, width has a derivative in the mean alone."""
    code, out, _ = call(capsys, "run", str(paper), "--json", "--mean")
    record = json.loads(out)
    assert code == 0
    assert set(record) == RUN_KEYS | {"mean"}
    assert set(record["mean"]) == {"stiffness", "healthy", "loss", "sensitivity"}
    assert record["sensitivity"]["radial"]["width"] == 0.0
    assert record["mean"]["sensitivity"]["radial"]["width"] < 0.0
    assert record["mean"]["loss"]["radial"] == pytest.approx(record["loss"]["radial"], rel=0.3)
    text = " ".join(call(capsys, "run", str(paper), "--mean")[1].split())
    assert "in the mean over the cage's turn, secant F/u" in text
    assert "no roller stands on a rolling edge at this phase" in text
    assert "both raceways in series make about 0.5" in text


@pytest.mark.portable
def test_run_prints_text_for_people(capsys, paper: Path) -> None:
    code, out, _ = call(capsys, "run", str(paper))
    assert code == 0
    for words in (
        "Stiffness at this phase, secant F/u [N/mm]",
        "Stiffness in the mean over the cage's turn, secant F/u [N/mm]",
        "loss [%]",
        "8.783",
        "Load distribution",
        "█",
        "µm",
        "liu2018",
        "converged",
    ):
        assert words in out
    assert max(len(line) for line in out.splitlines()) <= 80


def test_run_audits_itself(capsys, paper: Path) -> None:
    """`--verify` solves contacts afresh; the paper's law promises nothing of these, and is off by what is known."""
    code, out, err = call(capsys, "run", str(paper), "--json", "--verify")
    audit = json.loads(out)["audit"]
    assert (code, err) == (0, "")
    assert audit["promised"] is None
    assert audit["kept"] is True
    assert 0.01 < audit["load_error"] < 0.1
    assert audit["worst"]["roller"] in range(23)
    assert set(audit["stiffness_error"]) == {"radial", "axial"}
    code, out, _ = call(capsys, "run", str(paper), "--verify")
    assert "nothing is promised" in " ".join(out.split())


@pytest.mark.slow
def test_run_with_effects(capsys, tmp_path: Path) -> None:
    """A scene that names some: their results in both kinds of output, within the width of a page."""
    path = tmp_path / "effects.toml"
    path.write_text(
        PAPER + "\n[effects]\nflange = {}\nlife = {}\ncentrifugal = { speed_rpm = 3000 }\n", encoding="utf-8"
    )
    code, out, _ = call(capsys, "run", str(path), "--json")
    record = json.loads(out)
    assert code == 0
    assert set(record) == RUN_KEYS | {"effects", "edge_stress", "mean"}
    (edge,) = record["edge_stress"]
    assert set(edge) == {"spall", "roller", "raceway", "load", "land", "intensity", "within"}
    assert edge["load"] == record["loads"][0]
    assert set(record["effects"]) == {
        "inner_loads", "flange_loads", "flange_angle", "centrifugal_force", "load_rating", "basic_life",
        "reference_life",
    }  # fmt: skip
    code, out, _ = call(capsys, "run", str(path))
    assert code == 0
    for words in ("on flange [N]", "centrifugal force: 1.8", "reference life: ", "million revolutions", "no limit",
                  f"K = {edge['intensity']:.0f} N"):  # fmt: skip
        assert words in " ".join(out.split())
    assert max(len(line) for line in out.splitlines()) <= 80


@pytest.mark.parametrize(
    "name", ["diameters", "flange", "healthy", "mounting", "other_bearing", "raceways", "speed", "spall"]
)
def test_packaged_scenes_of_parallel_rings_are_solved(capsys, tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.toml"
    path.write_text(scene_file.example(name), encoding="utf-8")
    code, out, err = call(capsys, "run", str(path), "--json")
    assert (code, json.loads(out)["converged"]) == (0, True), err


@pytest.mark.portable
def test_every_packaged_scene_is_in_order(capsys, tmp_path: Path) -> None:
    for name in scene_file.example_names():
        path = tmp_path / f"{name}.toml"
        path.write_text(scene_file.example(name), encoding="utf-8")
        code, _, err = call(capsys, "check", str(path))
        assert code == 0, err


def test_run_of_a_healthy_bearing(capsys, tmp_path: Path) -> None:
    path = tmp_path / "healthy.toml"
    path.write_text(scene_file.example("healthy") + '[contact]\nlaw = "liu2018"\n', encoding="utf-8")
    code, out, _ = call(capsys, "run", str(path), "--json")
    record = json.loads(out)
    assert code == 0
    assert record["loss"] == {"radial": 0.0, "axial": 0.0}
    assert record["sensitivity"]["radial"] == {"length": None, "width": None}
    assert call(capsys, "run", str(path))[0] == 0


FIGURES = ("bearing", "load_distribution", "pressure", "stiffness", "loss")


def test_run_writes_figures_and_the_record(capsys, paper: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    code, printed, _ = call(capsys, "run", str(paper), "--json", "--out", str(out))
    assert code == 0
    names = {f"{stem}.{kind}" for stem in FIGURES for kind in ("png", "svg")}
    assert {p.name for p in out.iterdir()} == names | {"result.json", "report.html"}
    assert json.loads((out / "result.json").read_text()) == json.loads(printed)
    assert (out / "pressure.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (out / "pressure.svg").read_text()
    assert [p.name for p in out.parent.iterdir()] == ["out"]  # nothing of the scratch folder is left


def test_figures_and_slopes_are_of_every_spall(bearing: trb.TaperedBearing) -> None:
    """Two spalls at the load line, one on either raceway, behind one where nothing presses."""
    sizes = (8.0, 7.0, math.pi), (4.0, 7.0, 0.0)
    outside = [trb.Spall(length, width, angle=angle) for length, width, angle in sizes]
    spalls = (*outside, trb.Spall(3.0, 7.0, surface="inner"))
    scene = trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 4500.0), spalls, law="table"))
    result = trb.assess(scene)
    pressed = pressure_figure.contacts_at_spall(scene, result.spalled)
    loads = np.asarray(result.spalled.loads)
    assert loads[pressed[0].roller] > 0.8 * loads.max()
    under = {one.raceway: [float(spall.length) for spall, _ in one.solution.spalls]
             for one in pressed if one.roller == 0}  # fmt: skip
    assert under == {"outer": [4.0], "inner": [3.0]}
    record = run_text.run_json(scene, result, 0.0)["sensitivity"]["radial"]
    np.testing.assert_allclose(record["length"], np.asarray(result.by_length)[0])
    assert record["length"][0] > 100.0 * record["length"][1]
    words = io.StringIO()
    Console(file=words, width=200, markup=False).print(run_text.run_text(scene, result))
    shown = [line.split() for line in words.getvalue().splitlines()]
    assert [row[0] for row in shown if len(row) == 5 and row[0] in "012"][:3] == ["0", "1", "2"]
    assert "a spall on the inner raceway calls for them" in words.getvalue()


@pytest.mark.slow
def test_a_mean_is_made_for_a_law_of_one_phase(bearing: trb.TaperedBearing) -> None:
    """`run --mean`: it was left out without a word. A spall on a roller has none."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), trb.Spall(4.0, 7.0), "direct", accuracy=1e-2)
    ready = trb.prepare(scene)
    assert solving.assess_mean(ready) is None
    mean = solving.assess_mean(ready, scene)
    assert mean is not None
    np.testing.assert_allclose(mean.spalled.stiffness, trb.solve(scene.replace(phase="mean")).stiffness, rtol=1e-12,
                               atol=1e-6)  # fmt: skip
    table = solving.assess_mean(trb.prepare(scene.replace(law="table")))
    np.testing.assert_allclose(mean.loss, table.loss, rtol=2e-2)
    on_roller = scene.replace(spalls=trb.Spall(4.0, 7.0, surface="roller"), law="table")
    assert solving.assess_mean(ready.replace(spalls=on_roller.spalls), on_roller) is None


@pytest.mark.slow
def test_figures_put_an_inner_spall_where_it_is() -> None:
    before, _, inner = scene_file.example("raceways").split("[[spall]]")
    file = scene_file.parse(f"{before}[[spall]]{inner}")
    scene = trb.prepare(file.scene())
    found = solve_prepared(scene)
    pressed = pressure_figure.contacts_at_spall(scene, found)
    assert [one.raceway for one in pressed] == ["outer", "inner"] * (len(pressed) // 2)
    for outer, inner in zip(pressed[::2], pressed[1::2], strict=True):
        assert outer.roller == inner.roller
        assert not outer.solution.spalls  # outside, no roller meets it
        ((spall, offset),) = inner.solution.spalls
        assert spall.length == scene.spalls[0].length
        assert abs(offset) < 0.5 * spall.width + 0.2
        np.testing.assert_allclose(inner.solution.load, found.effects["inner_loads"][inner.roller])
    axes = pressure_figure.pressures(pressed).figure.axes
    assert sum("inner raceway" in ax.get_title() for ax in axes) == len(pressed) // 2
    nothing = jnp.zeros(2)
    result = Assessment(found, found, nothing, nothing, nothing)
    bar = run_figures.load_distribution(result, scene).patches[0]
    assert bar.get_width() == pytest.approx(7.0 / geometry.arc_radius(scene.bearing, "inner"))


@pytest.mark.portable
def test_contact_prints_json(capsys, tmp_path: Path) -> None:
    path = tmp_path / "contact.toml"
    path.write_text(scene_file.example("contact").replace("accuracy = 1e-3", "accuracy = 1e-2"), encoding="utf-8")
    code, out, err = call(capsys, "contact", str(path), "--json")
    record = json.loads(out)
    assert (code, err) == (0, "")
    assert set(record) == CONTACT_KEYS
    assert set(record["sensitivity"]) == {"load", "length", "width", "offset", "radius", "design_load"}
    contact = trb.LineContact.of(trb.bearing("32008J"))
    direct = trb.solve_contact(contact, 3000.0, trb.Spall(2.0, 1.0), 0.5, 1e-2)
    assert record["approach"] == pytest.approx(float(direct.approach), rel=1e-12)
    assert record["unknowns"] == int(direct.unknowns)
    code, out, _ = call(capsys, "contact", str(path), "--out", str(tmp_path / "out"))
    assert code == 0
    assert "approach" in out
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"pressure.png", "pressure.svg", "result.json"}


def test_contact_with_the_inner_raceway(capsys, tmp_path: Path) -> None:
    text = scene_file.example("contact").replace("accuracy = 1e-3", "accuracy = 1e-2")
    path = tmp_path / "inner.toml"
    path.write_text(text.replace("length = 2.0", 'surface = "inner"\nlength = 2.0'), encoding="utf-8")
    code, out, _ = call(capsys, "contact", str(path), "--json")
    contact = trb.LineContact.of(trb.bearing("32008J"), "inner")
    direct = trb.solve_contact(contact, 3000.0, trb.Spall(2.0, 1.0), 0.5, 1e-2)
    assert code == 0
    assert json.loads(out)["approach"] == pytest.approx(float(direct.approach), rel=1e-12)


@pytest.mark.slow
def test_contact_with_a_height_map(capsys, tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(scene_file.example("map").replace("accuracy = 1e-3", "accuracy = 1e-2"), encoding="utf-8")
    code, out, err = call(capsys, "contact", str(path), "--json", "--out", str(tmp_path / "out"))
    record = json.loads(out)
    assert (code, err) == (0, "")
    assert set(record) == CONTACT_KEYS
    assert [record["sensitivity"][key] for key in ("length", "width", "offset")] == [None] * 3
    contact = trb.LineContact.of(trb.bearing("32008J"))
    direct = trb.solve_contact(contact, 3000.0, trb.load_height_map(trb.example_map()), 0.5, 1e-2)
    assert record["approach"] == pytest.approx(float(direct.approach), rel=1e-12)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"pressure.png", "pressure.svg", "result.json"}
    code, out, err = call(capsys, "run", str(path))  # the ring on it, too
    assert code == 0, err
    assert "law: direct" in out
    path.write_text(path.read_text(encoding="utf-8").replace("[contact]", '[contact]\nlaw = "table"'), encoding="utf-8")
    code, out, err = call(capsys, "run", str(path))
    assert (code, out) == (2, "")
    assert "spall.0.height_map: contact.law = 'table' knows rectangular spalls" in err


SEVERAL = """[[spall]]
length = 2.0
width = 1.0
axial_offset = 2.0
[[spall]]
length = 3.0
width = 0.9
axial_offset = -2.0
angle = 0.01
"""


@pytest.mark.slow
def test_contact_with_several_spalls_and_tilt(capsys, tmp_path: Path) -> None:
    """Angles place spalls from the first on; derivatives by size come one for each."""
    head = 'bearing = "32008J"\n[load]\nradial = 9000.0\naxial = 4500.0\n'
    table = "[contact]\noffset = 0.4\naccuracy = 1e-2\ntilt = 1e-4\n"
    path = tmp_path / "several.toml"
    path.write_text(head + table + SEVERAL, encoding="utf-8")
    code, out, _ = call(capsys, "contact", str(path), "--json")
    record = json.loads(out)
    bearing = trb.bearing("32008J")
    offsets = (0.4, 0.4 + 0.01 * float(geometry.arc_radius(bearing)))
    spalls = trb.Spall(2.0, 1.0, axial_offset=2.0), trb.Spall(3.0, 0.9, axial_offset=-2.0)
    direct = trb.solve_contact(trb.LineContact.of(bearing), 3000.0, spalls, offsets, 1e-2, tilt=1e-4)
    assert code == 0
    assert record["approach"] == pytest.approx(float(direct.approach), rel=1e-12)
    assert [len(record["sensitivity"][key]) for key in ("length", "width", "offset")] == [2, 2, 2]
    code, out, _ = call(capsys, "contact", str(path))
    assert code == 0
    assert "converged" in out
    for old, new, words in (
        ("length = 3.0", 'surface = "inner"\nlength = 3.0', "spall.1.surface = 'inner': all spalls of"),
        ("length = ", 'surface = "inner"\nlength = ', "spall.1.angle = 0.01: an angle is a distance on the 'outer'"),
    ):
        path.write_text(head + table + SEVERAL.replace(old, new), encoding="utf-8")
        code, out, err = call(capsys, "contact", str(path))
        assert (code, out) == (2, "")
        assert words in err


@pytest.mark.portable
@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("length = 8.0", "lenght = 8.0", 2, "did you mean length"),
        ("length = 8.0", "length = 8.1", 2, "knows 0 … 8 mm"),
        ("axial = 4500.0", "axial = 2200.0", 1, "too small for an equilibrium"),
    ],
)
def test_refusals(capsys, tmp_path: Path, old: str, new: str, code: int, words: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(PAPER.replace(old, new), encoding="utf-8")
    out = tmp_path / "out"
    for arguments in (["run", str(path), "--out", str(out)], ["check", str(path)], ["run", str(path), "--json"]):
        got, printed, err = call(capsys, *arguments)
        assert (got, printed) == (code, "")
        assert err.startswith(f"difftrb: {path}: ")
        assert words in err
        assert err.count("\n") == 1
        assert not out.exists()


def test_missing_file(capsys, tmp_path: Path) -> None:
    code, _, err = call(capsys, "run", str(tmp_path / "none.toml"))
    assert (code, err) == (2, f"difftrb: {tmp_path / 'none.toml'}: there is no such file\n")


@pytest.mark.slow
def test_contact_that_cannot_be_resolved_is_no_solution(capsys, tmp_path: Path) -> None:
    path = tmp_path / "narrow.toml"
    text = (
        scene_file.example("contact")
        .replace("accuracy = 1e-3", "accuracy = 1e-2")
        .replace("width = 1.0", "depth = 0.001\nwidth = 0.01")
    )
    path.write_text(text.replace("offset = 0.5", "offset = 0.0"), encoding="utf-8")
    code, _, err = call(capsys, "contact", str(path), "--out", str(tmp_path / "out"))
    assert code == 1
    assert "narrower than one cell" in err
    assert not (tmp_path / "out").exists()


def test_an_out_that_is_a_file_is_refused_and_kept(capsys, paper: Path, tmp_path: Path) -> None:
    target = tmp_path / "result"
    target.write_text("mine", encoding="utf-8")
    code, _, err = call(capsys, "run", str(paper), "--out", str(target))
    assert code == 2
    assert err == f"difftrb: {target}: is a file; name a folder\n"
    assert target.read_text() == "mine"


def test_a_folder_in_the_way_stops_everything(capsys, paper: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "stiffness.png").mkdir(parents=True)
    code, _, err = call(capsys, "run", str(paper), "--out", str(out))
    assert (code, err) == (2, f"difftrb: {out}: a folder named stiffness.png is in the way\n")
    assert [p.name for p in out.iterdir()] == ["stiffness.png"]


def test_a_pressure_map_that_cannot_be_resolved_is_left_out(capsys, paper: Path, tmp_path: Path, monkeypatch) -> None:
    narrow = trb.solve_contact(
        trb.LineContact.of(trb.bearing("32008J")), 3000.0, trb.Spall(2.0, 0.01), accuracy=1e-2, method="cells"
    )
    monkeypatch.setattr(
        pressure_figure, "contacts_at_spall", lambda scene, solution: [pressure_figure.DrawnContact(0, narrow, ())]
    )
    code, _, err = call(capsys, "run", str(paper), "--out", str(tmp_path / "out"))
    assert code == 0
    assert "no pressure map: a spall, or the ridge between two, is narrower than one cell" in err
    assert not (tmp_path / "out" / "pressure.png").exists()
    assert (tmp_path / "out" / "stiffness.png").exists()


def test_secant_without_radial_load(capsys, tmp_path: Path) -> None:
    path = tmp_path / "axial.toml"
    path.write_text(PAPER.replace("radial = 9000.0", "radial = 0.0"), encoding="utf-8")
    record = json.loads(call(capsys, "run", str(path), "--json")[1])
    assert (
        record["stiffness"]["radial"] is record["loss"]["radial"] is record["sensitivity"]["radial"]["length"] is None
    )
    assert record["loss"]["axial"] > 0.0
    assert "–" in call(capsys, "run", str(path))[1]


def test_programs_are_kept_only_where_one_may_write(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = user_cache.cache_folder()
    assert folder is not None
    assert folder.is_dir()
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert user_cache.cache_folder() is None
    own = user_cache.cache_folder(tmp_path / "own")
    assert own is not None
    assert own.is_relative_to(tmp_path / "own")


def test_library_users_keep_programs_by_one_call(tmp_path: Path) -> None:
    script = "import difftrb as trb, jax; f = trb.keep_compiled(); jax.jit(lambda x: x + 1)(1.0); print(f)"
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True, env=environment)
    folder = Path(run.stdout.strip())
    assert folder.is_relative_to(tmp_path)
    assert list(folder.iterdir())


@pytest.mark.portable
def test_check_and_example(capsys, paper: Path) -> None:
    code, out, _ = call(capsys, "check", str(paper))
    assert code == 0
    assert "in order: 23 rollers, 1 spall, radial 9000 N" in out
    swept = paper.with_name("swept.toml")
    swept.write_text(f"{PAPER}[sweep]\nload.radial = [8e3, 9e3]\n", encoding="utf-8")
    assert call(capsys, "check", str(swept))[1].endswith(", with a sweep of 2 members\n")
    swept.write_text(f"{PAPER}[sweep]\nload.radial = [8e3, 9e3]\noutputs = ['nonsense']\n", encoding="utf-8")
    code, _, err = call(capsys, "check", str(swept))
    assert code == 2
    assert "nonsense" in err
    code, out, _ = call(capsys, "example")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == [*scene_file.example_names(), "measured"]
    assert call(capsys, "example", "paper")[1] == PAPER
    code, _, err = call(capsys, "example", "none")
    assert code == 2
    assert "there are contact, diameters, double_row, fit, flange" in err
    assert err.endswith(", measured\n")


@pytest.mark.portable
def test_version_is_that_of_the_package(capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"difftrb {metadata.version('difftrb')}\n"
    assert trb.__version__ == metadata.version("difftrb")


def test_a_version_and_an_example_need_no_jax() -> None:
    code = """if True:
        import sys
        from difftrb.__main__ import main
        for arguments in (["example"], ["example", "paper"], ["example", "none"], ["--version"]):
            try:
                main(arguments)
            except SystemExit:
                pass
        assert not {"jax", "pydantic", "matplotlib"} & set(sys.modules)
    """
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.parametrize(
    ("radial", "axial", "words"),
    [
        ("9000.0", "4500.0", None),
        ("900.0", "450.0", "is 0.019 of the bearing's dynamic load rating C (ISO 281), less than the 0.02 C"),
        ("120.0", "60.0", "check for a lost factor of ten"),
        ("9.0", "4.5", "loads are in N, and this looks like kN"),
        ("3e5", "3e5", "times the bearing's dynamic load rating C (ISO 281): its steel would yield"),
    ],
)
def test_small_and_huge_loads_get_a_remark(capsys, tmp_path: Path, radial: str, axial: str, words: str | None) -> None:
    """In one sentence on stderr; the scene is as much in order as before."""
    path = tmp_path / "light.toml"
    path.write_text(PAPER.replace("9000.0", radial).replace("4500.0", axial), encoding="utf-8")
    for arguments in (["check"], ["run", "--json"], ["stiffness", "--json", "--phases", "4"]):
        code, _, err = call(capsys, arguments[0], str(path), *arguments[1:])
        assert code == 0
        assert err == "" if words is None else words in err
        assert err.count("\n") == (words is not None)


def test_slopes_by_the_size_of_a_map_are_not_told(bearing: trb.TaperedBearing) -> None:
    """They were fourteen times too large in the packaged one; a rectangular spall beside it has its own."""
    nothing, slope = jnp.zeros(2), np.ones((2, 2))
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.load_height_map(trb.example_map()), trb.Spall(4.0, 7.0)))
    found = solve_prepared(trb.prepare(scene.replace(spalls=(), law="liu2018")))
    told = run_text.slopes_by_spall(scene, Assessment(found, found, nothing, slope, slope))
    assert told == [[["–", "–"]] * 2, [["1.0", "1.0"]] * 2]
    assert any("slopes by a height map's size are not told" in one for one in remarks.of_solution(scene, found))


@pytest.mark.portable
def test_small_loads_of_contacts_and_measured_rows_get_a_remark() -> None:
    file = scene_file.parse(scene_file.example("contact"))
    assert remarks.odd_contact_load(file) is None
    light = dataclasses.replace(file, contact=dataclasses.replace(file.contact, load=3.0))
    assert "contact.load = 3 N: " in str(remarks.odd_contact_load(light))
    assert remarks.odd_ring_load(scene_file.parse(scene_file.example("mounting"))) is None
    pressed = 'bearing = "32008J"\n[load]\nradial = {}\naxial = 0\n[effects.double_row]\npreload = 0.03\n'
    assert remarks.odd_ring_load(scene_file.parse(pressed.format(800))) is None
    scene_file.check_ring(scene_file.parse(pressed.format(0)), "pair.toml")
    small = f"{pressed.split('[effects')[0].format(9)}[sweep]\noutputs = ['radial_stiffness']\nload.axial = [4, 6]\n"
    swept = sweep_file.parse(small, "swept.toml")
    heaviest = sweep_file._under_the_heaviest(swept.scene, swept.plan(law=False))
    assert (float(heaviest.load.radial), float(heaviest.load.axial)) == (9.0, 6.0)
    assert "this looks like kN" in str(remarks.odd_ring_load(heaviest))
    rows = measured_table.parse(measured_table.example())
    assert remarks.odd_measured_load(file.bearing, rows) is None
    in_kn = [dataclasses.replace(row, radial=row.radial / 1e3, axial=row.axial / 1e3) for row in rows[1:]]
    assert str(remarks.odd_measured_load(file.bearing, [rows[0], *in_kn])).startswith(
        "line 10: radial = 3 N, axial = 4.5 N: "
    )
    assert not remarks.all_in_kn(file.bearing, [rows[0], *in_kn])
    assert remarks.all_in_kn(file.bearing, in_kn)


def test_help_names_all_that_a_fit_can_find(capsys: pytest.CaptureFixture[str]) -> None:
    """Written out there, for whoever asks for help would wait for JAX."""
    with pytest.raises(SystemExit):
        cli.main(["fit", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    listed = told[told.index("what to fit, of ") :].removeprefix("what to fit, of ").split(" (default")[0]
    assert set(listed.split(", ")) == set(PARAMETERS)
