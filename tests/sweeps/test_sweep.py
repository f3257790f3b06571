"""Sweeps: axes, members and blocks, the same bits whatever computes them, files, resuming, refusals, figures."""

import contextlib
import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tracemalloc
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.core import machine, storage
from difftrb.law import power
from difftrb.report import plot
from difftrb.ring import ring
from difftrb.scene import scene_file
from difftrb.sweeps import axes, chunks, gathered, outputs, sweep_file, sweep_plot, sweeping
from difftrb.sweeps.plan import Plan, Program, front

SIZES = ("spall.0.length", "spall.0.width")
FILE = f"""{scene_file.example("spall")}
[contact]
law = "liu2018"
[sweep]
gradients = ["spall.0.length", "spall.0.width"]
spall.0.length = {{from = 0.5, to = 8.0, count = 5}}
load.axial = {{from = 2000, to = 8000, count = 45, spacing = "log"}}
"""


def made(text: str = FILE, **changes) -> Plan:
    """The plan of a scene file, in small chunks."""
    plan = sweep_file.parse(text).plan(3)
    return dataclasses.replace(plan, **changes)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return made()


@pytest.fixture(scope="module")
def whole(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep into files that nothing interrupted."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    ended = chunks.run(plan, folder, FILE, devices=1)
    assert (ended.computed, ended.failed) == (plan.chunks, sum(ended.counts.values()) - ended.counts["converged"])
    return folder


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.suffix in (".npz", ".json")}


# ------------------------------------------------------------------------------------------------ axes and blocks


def test_axes_from_lists_and_ranges() -> None:
    found = axes.axes_of({"a": [3, 1], "b": {"from": 1.0, "to": 100.0, "count": 3, "spacing": "log"}})
    assert [axis.name for axis in found] == ["a", "b"]
    np.testing.assert_allclose(found[1].values, [[1.0, 10.0, 100.0]], rtol=1e-15)
    zipped = axes.axes_of({"a": [1.0, 2.0], "b": [3.0, 4.0]}, "zip")
    assert (zipped[0].name, zipped[0].keys, zipped[0].count) == ("member", ("a", "b"), 2)


@pytest.mark.parametrize("counts", [(1,), (7,), (3, 5), (4, 1, 6), (5, 2, 3, 2)])
@pytest.mark.parametrize("batch", [1, 4, 7, 1000])
def test_blocks_hold_every_member_once_in_order(counts: tuple[int, ...], batch: int) -> None:
    layout = axes.Layout(counts, batch)
    seen = []
    for block in range(layout.blocks):
        places = [np.atleast_1d(np.asarray(p)) for p in layout.places(jnp.asarray(block))]
        numbers = np.ravel_multi_index(np.ix_(*places), counts).ravel()
        size = layout.first(block + 1) - layout.first(block)
        assert len(numbers) == layout.size >= size
        seen += numbers[:size].tolist()
    assert seen == list(range(layout.members))
    assert layout.size <= max(batch, 1)


def test_slabs_are_the_members_in_order() -> None:
    counts = (3, 4, 5)
    for first, last in ((0, 60), (7, 8), (3, 47), (20, 40), (19, 21), (5, 5)):
        numbers = np.arange(60).reshape(counts)
        assert [n for part in gathered._slabs(first, last, counts) for n in numbers[part].ravel()] == list(
            range(first, last)
        )


def test_a_million_million_members_are_planned_at_once(plan: Plan) -> None:
    thousand = {"from": 1.0, "to": 2.0, "count": 1000}
    keys = ("spall.0.length", "spall.0.width", "load.axial", "stiffness.phase")
    plan = sweeping.planned(["peak_load"], plan.base, dict.fromkeys(keys, thousand))
    assert plan.layout.members == 10**12
    assert plan.members(plan.chunks - 1)[1] == 10**12


def test_a_million_million_members_are_forecast_without_arrays_of_their_length(plan: Plan) -> None:
    thousand = {"from": 3000.0, "to": 4000.0, "count": 1000}
    keys = ("load.axial", "load.radial", "spall.0.angle", "stiffness.phase")
    other = {"from": 0.0, "to": 1.0, "count": 1000}
    given = {key: thousand if key == "load.axial" else other for key in keys}
    plan = sweeping.planned(["peak_load"], plan.base, given, batch=8)
    tracemalloc.start()
    printed = sweeping.forecast(plan, 1)
    manifest = chunks.manifest_of(plan)
    members = front(plan)[1]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "1,000,000,000,000 = 1000 × 1000 × 1000 × 1000" in printed
    assert len(json.dumps(manifest)) < 1e6
    assert peak < 1e8
    assert members[[0, -1]].tolist() == [500 * 1000 + 500, 999 * 10**9 + 999 * 10**6 + 500 * 1000 + 500]


def test_figures_show_long_axes_at_some_values(plan: Plan) -> None:
    plan = sweeping.planned(["peak_load"], plan.base, {"load.axial": np.linspace(3e3, 4e3, 10**6)})
    shown, members = front(plan)
    assert len(members) == shown.axes[0].count == 500
    np.testing.assert_array_equal(shown.axes[0].values[0], plan.axes[0].values[0][members])
    record = chunks.manifest_of(plan)["axes"][0]
    other = dataclasses.replace(plan, axes=(dataclasses.replace(plan.axes[0], values=plan.axes[0].values + 1e-9),))
    assert record["digest"] != chunks.manifest_of(other)["axes"][0]["digest"]


@pytest.mark.parametrize("mode", ["sweep", "write_sweep"])
def test_more_members_than_any_sweep_can_have(plan: Plan, tmp_path: Path, mode: str) -> None:
    given = dict.fromkeys(("load.axial", "spall.0.angle", "stiffness.phase"), np.linspace(0.0, 1.0, 10**5))
    run = {"sweep": trb.sweep, "write_sweep": partial(trb.write_sweep, folder=tmp_path / "out")}[mode]
    words = r"^100,000 × 100,000 × 100,000 = 1,000,000,000,000,000 members, which take 50 PB of disk or more: must be"
    with pytest.raises(trb.SweepError, match=words):
        run(["loads"], plan.base, given, gradients=["load.axial", "load.radial"])
    assert not (tmp_path / "out").exists()


def test_what_does_not_fit_is_not_begun(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Program, "__init__", lambda *_: pytest.fail("something is computed"))
    thousand = np.linspace(3e3, 4e3, 1000)
    given = {"load.axial": thousand, "load.radial": thousand}
    with monkeypatch.context() as patch:
        patch.setattr(sweeping, "free_memory", lambda: 1e8)
        words = r"^1,000 × 1,000 = 1,000,000 members of 185 bytes take 20\d MB of memory, of which 100 MB are free, "
        with pytest.raises(trb.SweepError, match=words):
            trb.sweep("loads", plan.base, given)
        patch.setattr(sweeping, "free_memory", lambda: 1e6)
        with pytest.raises(trb.SweepError, match="of memory, of which 1 MB are free; give a smaller batch"):
            trb.write_sweep("loads", plan.base, given, tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr(sweeping, "free_disk", lambda folder: 10**8)
        words = "take 370 MB of disk, in chunks and in one file, of which 100 MB are free there, enough for 270,270;"
        with pytest.raises(trb.SweepError, match=words):
            trb.write_sweep("loads", plan.base, given, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(trb.SweepError, match="batch = 1000000000: must be a whole number in 1 … 131072"):
        trb.sweep("loads", plan.base, given, batch=10**9)


def test_a_sweep_that_is_written_but_for_one_file_needs_room_for_that(
    plan: Plan, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out, ignore=shutil.ignore_patterns("sweep.*"))
    needed = plan.layout.members * sweeping.bytes_of_member(plan)
    monkeypatch.setattr(sweeping, "free_disk", lambda _: needed - 1)
    with pytest.raises(trb.SweepError, match="bytes still take"):
        chunks.run(plan, out, FILE, resume=True)
    monkeypatch.setattr(sweeping, "free_disk", lambda _: needed)
    assert chunks.run(plan, out, FILE, resume=True).computed == 0


# ------------------------------------------------------------------------------------------------ numbers


def test_members_are_solved_scenes(plan: Plan, whole: Path) -> None:
    swept, base = trb.load_sweep(whole), plan.base
    for place in ((0, 20), (4, 44)):
        spall = dataclasses.replace(base.spalls[0], length=swept.coordinates["spall.0.length"][place[0]])
        load = trb.Load(9000.0, swept.coordinates["load.axial"][place[1]])
        solution = trb.solve(dataclasses.replace(base, load=load, spalls=(spall,)))
        for name in ("radial_stiffness", "axial_stiffness"):
            assert swept.values[name][place] == pytest.approx(float(getattr(solution, name)), rel=1e-12)
    assert swept.units["radial_stiffness_by_spall.0.length"] == "N/mm per mm"


def test_members_without_a_solution_are_nan_and_counted(whole: Path) -> None:
    swept = trb.load_sweep(whole)
    needed = 9000.0 * np.tan(0.2473)
    none = swept.coordinates["load.axial"] < 0.98 * needed
    assert none.any()
    assert (swept.status_code[:, none] == 3).all()
    assert np.isnan(swept.values["radial_stiffness"][:, none]).all()
    assert np.isnan(swept.gradients["radial_stiffness"]["spall.0.width"][:, none]).all()
    assert (
        (swept.status_code == 0).sum()
        == swept.counts["converged"]
        == np.isfinite(swept.values["axial_stiffness"]).sum()
    )


def test_the_same_bits_from_any_number_of_lanes(plan: Plan, whole: Path, tmp_path: Path) -> None:
    lanes = [machine.lanes_of(1)[0]] * 3
    columns = dict(Program(plan, lanes).all(range(plan.chunks)))
    for chunk, found in columns.items():
        there = storage.read(whole / f"chunk_{chunk:06d}.npz")
        assert there is not None
        for name, array in found.items():
            np.testing.assert_array_equal(array, there[name])


def test_the_same_bits_from_chunks_of_any_size(plan: Plan, whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("difftrb.sweeps.plan.PARTS", 4)
    assert sweeping.planned(["peak_load"], plan.base, {"load.axial": np.ones(64)}, batch=1).chunk == 4
    other = dataclasses.replace(plan)
    found = [columns for _, columns in Program(other, machine.lanes_of(1)).all(range(other.chunks))]
    swept = trb.load_sweep(whole)
    values = np.concatenate([columns["radial_stiffness"] for columns in found])
    np.testing.assert_array_equal(values, swept.values["radial_stiffness"].ravel())


def test_any_function_of_any_tree() -> None:
    base = {"case": (1.0, 2.0), "spall": trb.Spall(1.0, 2.0)}

    def function(tree):
        return {"area": tree["spall"].length * tree["spall"].width, "two": jnp.log(tree["case"][1]) * jnp.ones(2)}

    given = {"spall.width": [1.0, 2.0, 3.0], "case.1": [-1.0, 4.0]}
    swept = trb.sweep(function, base, given, ["spall.length", "spall.width"])
    assert swept.values["two"].shape == (3, 2, 2)
    np.testing.assert_array_equal(swept.values["area"][:, 1], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(swept.gradients["area"]["spall.length"][:, 1], [1.0, 2.0, 3.0])
    assert np.isnan(swept.values["area"][:, 0]).all()  # log(-1): no number, so nothing of this member
    assert list(swept.counts.values()) == [3, 3]
    assert trb.sweep(lambda tree: tree["case"][0], base, {"case.0": [5.0]}).values["value"].tolist() == [5.0]


def test_zipped_axes(plan: Plan) -> None:
    given = {"spall.0.length": [1.0, 4.0], "load.axial": [4000.0, 4500.0]}
    swept = trb.sweep("loads", plan.base, given, mode="zip")
    assert (swept.dims, swept.values["loads"].shape) == (("member",), (2, 23))
    alone = trb.solve(dataclasses.replace(plan.base, spalls=(trb.Spall(4.0, 7.0),)))
    np.testing.assert_allclose(swept.values["loads"][1], alone.loads, rtol=1e-12)


def test_contacts_by_file(tmp_path: Path) -> None:
    text = scene_file.example("contact").replace("accuracy = 1e-3", "accuracy = 1e-2")
    plan = sweep_file.parse(text + '\n[sweep]\noutputs = ["approach"]\ncontact.offset = [0.0]\n').plan()
    assert plan.layout.size == 1
    assert plan.units["contact.offset"] == plan.units["approach"] == "mm"
    assert (plan.names, plan.title) == (["approach"], "approach")


# ------------------------------------------------------------------------------------------------ the law of all


def test_one_law_covers_all_loads(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(power, "power_law", lambda *a: asked.append(a) or plan.base.law)
    scene = plan.base
    named = dataclasses.replace(scene, law="power")
    given = axes.axes_of({"load.axial": [3000.0, 30000.0], "spall.0.length": [1.0, 4.0]})
    outputs.with_shared_law(named, given)
    low, high = asked[0][1]
    single = [float(ring.largest_load(scene.bearing, trb.Load(9000.0, axial))) for axial in (3000.0, 30000.0)]
    assert (low, high) == (single[0] / 6.0, 1.2 * single[1])


# ------------------------------------------------------------------------------------------------ files


def test_resuming_computes_what_is_missing_or_damaged(plan: Plan, whole: Path, tmp_path: Path) -> None:
    before, out = bytes_of(whole), tmp_path / "out"
    out.mkdir()
    for name, content in before.items():
        (out / name).write_bytes(content)
    assert len(list(out.glob("chunk_*"))) == plan.chunks >= 4
    (out / "chunk_000000.npz").unlink()
    flipped = bytearray(before["chunk_000001.npz"])
    flipped[len(flipped) // 2] ^= 1
    (out / "chunk_000001.npz").write_bytes(flipped)
    (out / "chunk_000002.npz").write_bytes(before["chunk_000003.npz"])  # sound, but not this one
    for name in ("chunk_000000.npz", "manifest.json", "sweep.nc", "sweep.npz"):
        (out / f"{name}-abc.part").write_bytes(b"left by a killed process")
    (out / "own-download.part").write_text("not the sweep's")
    (out / "sweep.npz").unlink(missing_ok=True)  # sweep.nc where h5netcdf is installed
    (out / "manifest.json").write_text("{ cut")
    said: list[str] = []
    ended = chunks.run(plan, out, FILE, resume=True, say=said.append)
    assert ended.computed == 3
    assert [sentence.split(" is ")[1] for sentence in said] == ["damaged: computed again"] * 2
    assert bytes_of(out) == before
    assert [path.name for path in out.glob("*.part")] == ["own-download.part"]
    assert chunks.run(plan, out, FILE, resume=True).computed == 0


def test_a_full_disk_leaves_what_is_written(
    plan: Plan, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, out = storage.write, tmp_path / "out"

    def full(path: Path, arrays: storage.Arrays) -> None:
        if path.name == "chunk_000002.npz":
            raise OSError(28, "No space left on device", str(path))
        write(path, arrays)

    monkeypatch.setattr(storage, "write", full)
    with pytest.raises(trb.SweepError, match=r"No space left on device: 2 of \d+ chunks are written and stay good"):
        chunks.run(plan, out, FILE)
    monkeypatch.setattr(storage, "write", write)
    assert chunks.run(plan, out, FILE, resume=True).computed == plan.chunks - 2
    assert bytes_of(out) == bytes_of(whole)


def test_without_h5py_everything_goes_into_npz(
    plan: Plan, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """h5netcdf alone is importable, and cannot write."""
    monkeypatch.setitem(sys.modules, "h5py", None)
    out = tmp_path / "out"
    shutil.copytree(whole, out, ignore=shutil.ignore_patterns("sweep.*"))
    ended = chunks.run(plan, out, FILE, resume=True)
    assert (ended.computed, ended.file) == (0, out / "sweep.npz")
    found = trb.load_sweep(out)
    assert found.counts == ended.counts
    (out / "sweep.npz").rename(out / "sweep.nc")
    with pytest.raises(trb.SweepError, match=r"sweep.nc: is read by h5netcdf and h5py, .* pip install 'difftrb\[io\]'"):
        trb.load_sweep(out)


def test_a_package_that_goes_missing_leaves_what_is_written(
    plan: Plan, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out, ignore=shutil.ignore_patterns("sweep.*"))
    with monkeypatch.context() as patch:
        patch.setattr(gathered, "has_netcdf", lambda: True)
        patch.setitem(sys.modules, "h5netcdf", None)
        words = (
            rf"{plan.chunks} of {plan.chunks} chunks are written and stay good; pip install 'difftrb\[io\]', and go on"
        )
        with pytest.raises(trb.SweepError, match=words):
            chunks.run(plan, out, FILE, resume=True)
    assert not [p.name for p in out.iterdir() if p.name.startswith("sweep.")]
    assert chunks.run(plan, out, FILE, resume=True).computed == 0
    assert trb.load_sweep(out).counts == trb.load_sweep(whole).counts


@pytest.mark.parametrize("kind", ["netcdf", "npz"])
def test_a_disk_that_fills_while_gathering_leaves_the_chunks(
    plan: Plan, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """At every place of the file: HDF5 crashed where a write failed."""
    resource = pytest.importorskip("resource")
    if kind == "netcdf":
        pytest.importorskip("h5py")
    monkeypatch.setattr(gathered, "has_netcdf", lambda: kind == "netcdf")
    out = tmp_path / "out"
    shutil.copytree(whole, out, ignore=shutil.ignore_patterns("sweep.*"))
    file = chunks.run(plan, out, FILE, resume=True).file
    assert file is not None
    good = file.read_bytes()
    assert len(good) > 10_000
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for size in (0, 100, 5000, len(good) // 2, len(good) - 100):
        with monkeypatch.context() as patch:
            patch.setattr(storage, "replacing", limited(storage.replacing, resource, size, (soft, hard)))
            with pytest.raises(trb.SweepError, match=r"File too large: .* chunks are written and stay good"):
                chunks.run(plan, out, FILE, resume=True)
        assert file.read_bytes() == good  # what was there before stays
        assert not list(out.glob("*.part"))
    assert chunks.run(plan, out, FILE, resume=True).computed == 0


def limited(replacing, resource, size: int, before: tuple[int, int]):
    """`storage.replacing` with a limit on what is written while a file with everything is."""

    @contextlib.contextmanager
    def within(path: Path):
        with replacing(path) as scratch:
            if not path.name.startswith("sweep."):
                yield scratch
                return
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
            try:
                yield scratch
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return within


def test_results_of_another_sweep_are_not_read(plan: Plan, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    (out / "manifest.json").write_text(json.dumps(manifest | {"identity": "another's"}), encoding="utf-8")
    with pytest.raises(trb.SweepError, match="is damaged, or another sweep's; go on with --resume"):
        trb.load_sweep(out)
    for text in ("{}", "[]", "1"):
        (out / "manifest.json").write_text(text, encoding="utf-8")
        with pytest.raises(trb.SweepError, match="there is no sweep here"):
            trb.load_sweep(out)


def test_folders_that_are_refused(plan: Plan, whole: Path, tmp_path: Path) -> None:
    with pytest.raises(trb.SweepError, match="holds a sweep already; go on with --resume"):
        chunks.run(plan, whole, FILE)
    changed = FILE.replace("radial = 9000.0", "radial = 9001.0")
    with pytest.raises(trb.SweepError, match="of another scene file; undo the change"):
        chunks.run(made(changed), whole, changed, resume=True)
    with pytest.raises(trb.SweepError, match="of a scene with other numbers"):
        chunks.run(
            dataclasses.replace(plan, base=dataclasses.replace(plan.base, definition="secant")), whole, FILE, True
        )
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(trb.SweepError, match="is a file; name a folder"):
        chunks.run(plan, tmp_path / "file", FILE)
    with pytest.raises(trb.SweepError, match="Not a directory: nothing is written"):
        chunks.run(plan, tmp_path / "file" / "out", FILE)
    with pytest.raises(trb.SweepError, match="there is no sweep here"):
        trb.load_sweep(tmp_path)


def test_netcdf_holds_the_same(plan: Plan, whole: Path, tmp_path: Path) -> None:
    h5netcdf = pytest.importorskip("h5netcdf")
    assert h5netcdf
    out = tmp_path / "out"
    chunks.run(plan, out, FILE)
    swept, other = trb.load_sweep(out), trb.load_sweep(whole)
    for name in other.values:
        np.testing.assert_array_equal(swept.values[name], other.values[name])


def test_to_xarray(whole: Path) -> None:
    pytest.importorskip("xarray")
    data = trb.load_sweep(whole).to_xarray()
    assert data["radial_stiffness"].dims == ("spall.0.length", "load.axial")
    assert data["radial_stiffness"].attrs["units"] == "N/mm"


# ------------------------------------------------------------------------------------------------ the command line


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("count = 5", "count = 0", "spall.0.length.count = 0: must be a whole number in 1 …"),
        ("count = 5", "count = 1", "count = 1: one value cannot go from 0.5 to 8"),
        ("count = 5", "cuont = 5", "spall.0.length.cuont is not a known key; did you mean count?"),
        ("to = 8.0", f"to = 1{400 * '0'}", "must be a finite number"),
        ("to = 8.0", "to = 1e9", "spall.0.length = 1e+09: must be a number in 0.01 … 1000 mm"),
        ("to = 8.0", "to = 8.5", "spall.0.length = 8.5: contact.law = 'liu2018' knows 0 … 8 mm"),
        ("from = 2000", "from = -1", "needs from and to above 0"),
        ('spacing = "log"', 'spacing = "cubic"', "load.axial.spacing = 'cubic': must be 'linear' or 'log'"),
        ("spall.0.length = {", "spall.2.length = {", "spall.2.length: there is 1 entry, counted from 0"),
        ("spall.0.length = {", "spall.0.lenght = {", "did you mean spall.0.length?"),
        ("spall.0.length = {", '"spall.0.length\\n" = {', "'spall.0.length\\n' is not a known key"),
        ("spall.0.length = {", "spall.0.depth = {", "'liu2018' does not know the depth of a spall; use 'table'"),
        ("spall.0.length = {", "bearing.rollers = {", "bearing.rollers is a count"),
        ("spall.0.length = {", "contact.accuracy = {", "contact.accuracy is not a known key"),
        ("[sweep]\n", '[sweep]\nmode = "zip"\n', "mode = 'zip' needs equally many values"),
        ("[sweep]\n", '[sweep]\noutput = ["loads"]\n', "output is not a known key; did you mean outputs?"),
        ("[sweep]\n", '[sweep]\noutputs = ["noise"]\n', "outputs: 'noise' is unknown; use some of radial_stiffness"),
        ("[sweep]\n", '[sweep]\noutputs = ["approach", "loads"]\n', "do not go with the ring's"),
        ("[sweep]\n", "[sweeep]\n", "sweeep is not a known key"),
        (
            "[sweep]\n",
            "[effects]\ntilt = {}\nraceways = {}\n[sweep]\n",
            "effects.tilt and effects.raceways exclude",
        ),
        (
            "[sweep]\n",
            "[effects.tilt]\n[sweep]\n",
            "effects.tilt carries by slices of ISO/TS 16281: set",
        ),
        ('from = 2000, to = 8000, count = 45, spacing = "log"', "from = -1e308, to = 1e308, count = 3", "nearer"),
        ('"spall.0.width"]', '"accuracy"]', "accuracy is not a known key; known here: load.radial"),
        ('"spall.0.width"]', '"spalls.0.width"]', "spalls.0.width is not a known key; known here: load.radial"),
        ('"spall.0.width"]', '"effects.life.load_rating"]', "numbers of effects are not swept; run one sweep for each"),
        ('"spall.0.width"]', '"spall.0.depth"]', "gradients: spall.0.depth: contact.law = 'liu2018' does not know"),
        ('law = "liu2018"', 'law = "direct"', "contact.law = 'direct' holds for one scene"),
        ('law = "liu2018"', 'law = "power"', "gradients: spall.0.width: contact.law = 'power' is fitted for one width"),
    ],
)
def test_what_cannot_be_swept_is_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, words: str
) -> None:
    file = tmp_path / "scene.toml"
    assert old in FILE
    file.write_text(FILE.replace(old, new), encoding="utf-8")
    assert cli.main(["--no-cache", "sweep", str(file), "--out", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert words in captured.err
    assert captured.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_contacts_accuracy_is_one_for_a_sweep() -> None:
    text = scene_file.example("contact") + '\n[sweep]\noutputs = ["approach"]\n'
    with pytest.raises(scene_file.SceneError, match=r"contact.accuracy is one for a whole sweep, because it shapes"):
        sweep_file.parse(text + "contact.accuracy = [1e-3, 1e-2]\n")
    with pytest.raises(scene_file.SceneError, match=r"contact.accuracy is one for a whole sweep, because it shapes"):
        sweep_file.parse(text + 'gradients = ["contact.accuracy"]\ncontact.offset = [0.0]\n')


@pytest.mark.parametrize(
    ("function", "axes", "words"),
    [
        (lambda t: t["value"], {"value": [1.0, 2.0]}, "'value': this result is named as an axis"),
        (lambda t: {"first": t["value"]}, {"value": [1.0, 2.0]}, "'first': cannot be a name in a file, or has"),
        (lambda t: {"a/b": t["value"]}, {"value": [1.0, 2.0]}, "'a/b': cannot be a name in a file"),
        (lambda t: {"": t["value"]}, {"value": [1.0, 2.0]}, "'': cannot be a name in a file"),
        (lambda t: {"x": jnp.ones(3) * t["x_0"]}, {"x_0": [1.0, 2.0]}, "'x_0': this axis is named as a dimension"),
        (
            lambda t: {"x": t["value"], "x_by_n": t["n"]},
            {"x_0": [1.0, 2.0]},
            "'x_by_n': this result is named as a deriv",
        ),
        (lambda t: t["n"], {"about": [1.0, 2.0]}, "'about': cannot be a name in a file, or has"),
        (lambda t: {}, {"value": [1.0, 2.0]}, "the function returns no number"),
        (lambda t: jnp.zeros(0) * t["n"], {"value": [1.0, 2.0]}, "the function returns no number"),
    ],
)
def test_results_that_cannot_stand_in_a_file(tmp_path: Path, function, axes, words: str) -> None:
    base = {"value": 1.0, "x_0": 1.0, "n": 2.0, "about": 1.0}
    with pytest.raises(trb.SweepError, match=words):
        trb.write_sweep(function, base, axes, tmp_path / "out", ["n"])
    assert not (tmp_path / "out").exists()


def test_a_disk_that_fills_while_drawing_leaves_the_results(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    file, out = tmp_path / "scene.toml", tmp_path / "out"
    file.write_text(FILE.replace("count = 45", "count = 2"), encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(plot, "save", full)
        assert cli.main(["--no-cache", "sweep", str(file), "--out", str(out), "--devices", "1"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "No space left on device: sweep." in said.err
    assert trb.load_sweep(out).status_code.shape == (5, 2)
    assert not list(out.glob("*.png"))


def test_axes_may_be_quoted_or_in_a_table_of_their_own() -> None:
    head = FILE[: FILE.index("spall.0.length = ")]
    quoted = head + '"spall.0.length" = [1, 2]\n"load.axial" = [3000]\n'
    own = head + "[sweep.axes]\nspall.0.length = [1, 2]\nload.axial = [3000]\n"
    assert (
        sweep_file.parse(quoted).axes == sweep_file.parse(own).axes == {"spall.0.length": [1, 2], "load.axial": [3000]}
    )


def test_dry_run_and_missing_folder(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(FILE, encoding="utf-8")
    assert cli.main(["--no-cache", "sweep", str(file), "--dry-run", "--devices", "1"]) == 0
    printed = capsys.readouterr().out
    assert "225 = 5 × 45" in printed
    assert [line.split()[0] for line in printed.splitlines()] == ["members", "disk", "memory", "time"]
    assert cli.main(["--no-cache", "sweep", str(file)]) == 2
    assert "sweep needs --out DIR" in capsys.readouterr().err
    assert cli.main(["--no-cache", "sweep", str(file), "--out", str(tmp_path / "out"), "--devices", "1000"]) == 2
    assert "devices = 1000: must be in 1 …" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.portable
def test_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Two members, one without a solution."""
    file, out = tmp_path / "scene.toml", tmp_path / "out"
    file.write_text(FILE[: FILE.index("spall.0.length = ")] + "load.axial = [4500.0, 1000.0]\n", encoding="utf-8")
    assert cli.main(["--no-cache", "sweep", str(file), "--out", str(out), "--devices", "1"]) == 1
    assert "1 without a solution (NaN)\n1: no equilibrium" in capsys.readouterr().out
    swept = trb.load_sweep(out)
    stiffness, by_length = swept.values["radial_stiffness"], swept.gradients["radial_stiffness"]["spall.0.length"]
    assert [bool(np.isfinite(value).all()) for value in (stiffness[0], stiffness[1], by_length[0])] == [
        True,
        False,
        True,
    ]
    assert by_length[0] < 0.0
    assert cli.main(["--no-cache", "sweep", str(file), "--out", str(out), "--devices", "1"]) == 2
    assert str(out) in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("h:1", 2, None), "several processes need all of"),
        (("h:1", 2, 2), "process = 2: must be in 0 … 1"),
        (("h", 2, 0), "coordinator = 'h': must be HOST:PORT"),
    ],
)
def test_processes_that_cannot_be(given: tuple, words: str) -> None:
    with pytest.raises(trb.SweepError, match=words.replace("(", ".")):
        machine.join(*given, environment={})
    with pytest.raises(trb.SweepError, match="JAX_NUM_PROCESSES = 'x': must be a whole number"):
        machine.join("h:1", None, 0, environment={"JAX_NUM_PROCESSES": "x"})


def experiment():
    path = Path(__file__).parents[2] / "experiments" / "sweep_at_scale.py"
    spec = spec_from_file_location("sweep_at_scale", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SMALL = FILE.replace('gradients = ["spall.0.length", "spall.0.width"]\n', "").replace("count = 45", "count = 200")


def test_two_processes_and_kills_leave_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    scale = experiment()
    assert scale.processes(tmp_path, SMALL) == []
    assert (tmp_path / "two" / "manifest.json").exists()
    differing, there = scale.kills(tmp_path, 1, SMALL, 3.0)
    assert differing == []
    assert len(there) == 1


def test_two_devices_make_the_same_files(whole: Path, tmp_path: Path) -> None:
    """In a process of its own: a CPU shown to JAX as two devices."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import jax; jax.config.update('jax_enable_x64', True)\n"
        "jax.config.update('jax_num_cpu_devices', 2)\n"
        "from pathlib import Path; import difftrb\n"
        "from difftrb.sweeps import chunks, sweep_file\n"
        "text = Path(sys.argv[2]).read_text()\n"
        "assert len(jax.local_devices()) == 2\n"
        "chunks.run(sweep_file.parse(text).plan(3), Path(sys.argv[3]), text)\n"
    )
    file = tmp_path / "scene.toml"
    file.write_text(FILE, encoding="utf-8")
    source = str(Path(trb.__file__).parents[1])
    arguments = [sys.executable, "-c", code, source, str(file), str(tmp_path / "out")]
    subprocess.run(arguments, check=True, timeout=120, env=os.environ | {"TF_CPP_MIN_LOG_LEVEL": "3"})
    assert bytes_of(tmp_path / "out") == bytes_of(whole)


# ------------------------------------------------------------------------------------------------ figures


def test_figures(whole: Path, plan: Plan, tmp_path: Path) -> None:
    swept = trb.load_sweep(whole)
    ax = sweep_plot.swept(swept, "radial_stiffness")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("spall length [mm]", "load axial [N]")
    plot.save(ax, tmp_path, "map")
    other = sweep_plot.sweep_map(swept, "radial_stiffness", x="load.axial", y="spall.0.length")
    assert other.get_xlabel() == "load axial [N]"
    plot.save(other, tmp_path, "turned")
    plot.save(
        sweep_plot.sweep_curves(swept, "axial_stiffness", along="spall.0.length", over="load.axial"), tmp_path, "curves"
    )
    assert len(list(tmp_path.iterdir())) == 6


def test_the_packaged_sweep_is_in_order() -> None:
    found = sweep_file.parse(scene_file.example("sweep"))
    assert tuple(found.axes) == SIZES == found.gradients
    assert json.loads(json.dumps(found.axes))["spall.0.length"]["count"] > 8
