"""Sweeps: axes, members and blocks, the same bits whatever computes them, files, resuming, refusals, figures."""

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.core import jax_config, machine, status
from difftrb.law import power
from difftrb.report import figure_style
from difftrb.ring.load import largest_load
from difftrb.scene import scene_file
from difftrb.sweeps import axes, blocks, chunk_sharing, shared_law, store, sweep_file, sweep_plot, sweeping
from difftrb.sweeps.plan import Plan, Program
from difftrb.sweeps.swept import front, manifest_of

needs_zarr = pytest.mark.skipif(not store.has_zarr(), reason="README's extra `cluster` has zarr")

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
    ended = chunk_sharing.run(plan, folder, devices=1)
    assert (ended.computed, ended.failed) == (plan.chunks, sum(ended.counts.values()) - ended.counts["converged"])
    return folder


def bytes_of(folder: Path) -> dict[str, bytes]:
    """Everything in a store by its path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def copied(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "out"))


def shard(folder: Path, chunk: int, column: str = "radial_stiffness") -> Path:
    """Where a chunk of a column is: there are as many as lengths."""
    return folder / "sweep.zarr" / column / "c" / str(chunk) / "0"


# ------------------------------------------------------------------------------------------------ axes and blocks


def test_axes_from_lists_and_ranges() -> None:
    found = axes.axes_of({"a": [3, 1], "b": {"from": 1.0, "to": 100.0, "count": 3, "spacing": "log"}})
    assert [axis.name for axis in found] == ["a", "b"]
    np.testing.assert_allclose(found[1].values, [[1.0, 10.0, 100.0]], rtol=1e-15)
    zipped = axes.axes_of({"a": [1.0, 2.0], "b": [3.0, 4.0]}, "zip")
    assert (zipped[0].name, zipped[0].keys, zipped[0].count) == ("member", ("a", "b"), 2)


@pytest.mark.parametrize("counts", [(1,), (7,), (3, 5), (4, 1, 6), (5, 2, 3, 2)])
@pytest.mark.parametrize("batch", [1, 4, 7, 1000])
def test_boxes_hold_every_member_once_in_order(counts: tuple[int, ...], batch: int) -> None:
    """Blocks of chunks and chunks of the sweep; in a chunk whole blocks follow one another."""
    of_blocks = blocks.Grid.of(counts, batch)
    of_chunks = blocks.Grid.of(counts, 3 * of_blocks.size, of_blocks.shape)
    for grid in (of_blocks, of_chunks):
        seen = []
        for box in range(grid.number):
            places = [np.atleast_1d(np.asarray(p)) for p in grid.values(jnp.asarray(box))]
            numbers = np.ravel_multi_index(np.ix_(*places), counts).ravel()
            members = grid.members(box)
            assert len(numbers) == grid.size >= len(members)
            slices = np.arange(np.prod(counts)).reshape(counts)[grid.slices(box)]
            assert numbers[: len(members)].tolist() == list(members) == slices.ravel().tolist()
            seen += members
        assert seen == list(range(int(np.prod(counts))))
    inside = [block for chunk in range(of_chunks.number) for block in of_blocks.within(of_chunks.slices(chunk))]
    assert inside == list(range(of_blocks.number))
    assert of_blocks.size <= max(batch, 1)


def test_blocks_of_hardly_more_than_the_last_axis_lie_along_it() -> None:
    assert [blocks.Grid.of((200, 100), most).shape for most in (99, 100, 399, 400)] == [
        (1, 50),
        (1, 100),
        (1, 100),
        (4, 100),
    ]


def test_a_million_million_members_are_planned_at_once(plan: Plan) -> None:
    thousand = {"from": 1.0, "to": 2.0, "count": 1000}
    keys = ("spall.0.length", "spall.0.width", "load.axial", "stiffness.phase")
    plan = sweeping.plan_sweep(["peak_load"], plan.base, dict.fromkeys(keys, thousand))
    assert plan.members == plan.grid.members(plan.chunks - 1).stop == 10**12


def test_a_million_million_members_are_forecast_without_arrays_of_their_length(plan: Plan) -> None:
    thousand = {"from": 3000.0, "to": 4000.0, "count": 1000}
    keys = ("load.axial", "load.radial", "spall.0.angle", "stiffness.phase")
    other = {"from": 0.0, "to": 1.0, "count": 1000}
    given = {key: thousand if key == "load.axial" else other for key in keys}
    plan = sweeping.plan_sweep(["peak_load"], plan.base, given, batch=8)
    tracemalloc.start()
    printed = sweeping.forecast_of_disk(plan) + sweeping.forecast(plan, 1)
    manifest = manifest_of(plan)
    shown = front(plan.counts)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "1,000,000,000,000 = 1000 × 1000 × 1000 × 1000" in printed
    assert len(json.dumps(manifest)) < 1e6
    assert peak < 1e8
    assert [(len(places), places[0], places[-1]) for places in shown] == 2 * [(500, 0, 999)] + 2 * [(1, 500, 500)]


def test_figures_show_long_axes_at_some_values(plan: Plan) -> None:
    plan = sweeping.plan_sweep(["peak_load"], plan.base, {"load.axial": np.linspace(3e3, 4e3, 10**6)})
    (places,) = front(plan.counts)
    assert (len(places), places[0], places[-1], set(np.diff(np.diff(places)))) == (500, 0, 10**6 - 1, {-1, 0, 1})
    record = manifest_of(plan)["axes"][0]
    other = dataclasses.replace(plan, axes=(dataclasses.replace(plan.axes[0], values=plan.axes[0].values + 1e-9),))
    assert record["digest"] != manifest_of(other)["axes"][0]["digest"]


@pytest.mark.parametrize("mode", ["sweep", "write_sweep"])
def test_more_members_than_any_sweep_can_have(plan: Plan, tmp_path: Path, mode: str) -> None:
    given = dict.fromkeys(("load.axial", "spall.0.angle", "stiffness.phase"), np.linspace(0.0, 1.0, 10**5))
    run = {"sweep": trb.sweep, "write_sweep": partial(trb.write_sweep, folder=tmp_path / "out")}[mode]
    words = r"^100,000 × 100,000 × 100,000 = 1,000,000,000,000,000 members, which take 25.0 PB of disk or more: must be"
    with pytest.raises(trb.SweepError, match=words):
        run(["loads"], plan.base, given, gradients=["load.axial", "load.radial"])
    assert not (tmp_path / "out").exists()


def test_what_does_not_fit_is_not_begun(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Program, "__init__", lambda *_: pytest.fail("something is computed"))
    thousand = np.linspace(3e3, 4e3, 1000)
    given = {"load.axial": thousand, "load.radial": thousand}
    with monkeypatch.context() as patch:
        patch.setattr(sweeping, "free_memory", lambda: 1e8)
        words = r"^1,000 × 1,000 = 1,000,000 members of 185 bytes take 2\d\d\.\d MB of memory, of which 100"
        with pytest.raises(trb.SweepError, match=words):
            trb.sweep("loads", plan.base, given)
        patch.setattr(sweeping, "free_memory", lambda: 1e6)
        with pytest.raises(trb.SweepError, match=r"of memory, of which 1\.0 MB are free; give a smaller"):
            trb.write_sweep("loads", plan.base, given, tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr(sweeping, "free_disk", lambda _: 10**8)
        words = "take 185.0 MB of disk, of which 100.0 MB are free there; make room"
        with pytest.raises(trb.SweepError, match=words):
            trb.write_sweep("loads", plan.base, given, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(trb.SweepError, match="batch = 1000000000: must be a whole number in 1 … 262144"):
        trb.sweep("loads", plan.base, given, batch=10**9)


@needs_zarr
def test_a_sweep_that_is_there_but_for_a_chunk_needs_room_for_that(
    plan: Plan, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = copied(whole, tmp_path)
    shard(out, 2, "status_code").unlink()
    needed = plan.members * sweeping.bytes_of_member(plan) // plan.chunks
    monkeypatch.setattr(sweeping, "free_disk", lambda _: needed - 1)
    with pytest.raises(trb.SweepError, match="bytes still take"):
        chunk_sharing.run(plan, out, resume=True)
    monkeypatch.setattr(sweeping, "free_disk", lambda _: needed + 1)
    assert chunk_sharing.run(plan, out, resume=True).computed == 1


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


def test_bearings_that_cannot_be_are_members_without_a_solution(bearing: trb.TaperedBearing) -> None:
    """The ends of either axis fit the rest, one of their corners does not: as `solve` refuses it."""
    outer, inner = float(bearing.outer_angle), float(bearing.inner_angle)
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), trb.Spall(4.0, 7.0), law="table")
    axes = {"bearing.outer_angle": [outer, 1.015 * outer], "bearing.inner_angle": [0.98 * inner, inner]}
    found = trb.sweep(["radial_stiffness"], scene, axes)
    wrong = np.array([[False, False], [True, False]])
    np.testing.assert_array_equal(np.isnan(found.values["radial_stiffness"]), wrong)
    np.testing.assert_array_equal(found.status_code == status.BAD_INPUT, wrong)
    for i, j in np.ndindex(2, 2):
        member = scene.replace(outer_angle=axes["bearing.outer_angle"][i], inner_angle=axes["bearing.inner_angle"][j])
        if wrong[i, j]:
            with pytest.raises(trb.SceneError, match="share one apex"):
                trb.solve(member)
        else:
            assert bool(trb.solve(member).converged)


def test_the_same_bits_from_any_number_of_lanes(plan: Plan, whole: Path, tmp_path: Path) -> None:
    program, there = Program(plan, [machine.lanes_of(1)[0]] * 3), store.store_of(whole)
    for chunk in range(plan.chunks):
        found, written = program.chunk(chunk), there.read(chunk)
        assert written is not None
        assert found.keys() == written.keys() == plan.shapes.keys()
        for name in found:
            np.testing.assert_array_equal(found[name], written[name])


def test_the_same_bits_from_chunks_of_any_size(plan: Plan, whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("difftrb.sweeps.blocks.CALLS", 4)
    other = dataclasses.replace(plan)
    assert other.chunks > plan.chunks
    program = Program(other, machine.lanes_of(1))
    values = np.concatenate([program.chunk(chunk)["radial_stiffness"] for chunk in range(other.chunks)])
    np.testing.assert_array_equal(values, trb.load_sweep(whole).values["radial_stiffness"].ravel())


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


def test_zipped_keys_of_a_file_are_checked_together(bearing: trb.TaperedBearing) -> None:
    """Either diameter alone, moved so far, is no roller of this bearing; both together are."""
    small, large = float(bearing.roller_small_diameter), float(bearing.roller_large_diameter)
    text = (
        scene_file.example("spall")
        + f"""
[sweep]
mode = "zip"
bearing.roller_small_diameter = [{small}, {small + 0.2}]
bearing.roller_large_diameter = [{large}, {large + 0.2}]
"""
    )
    assert sweep_file.parse(text).plan(3).axes[0].count == 2
    alone = "\n".join(line for line in text.splitlines() if "roller_large" not in line)
    with pytest.raises(trb.SceneError, match="does not fit the roller's diameters and length"):
        sweep_file.parse(alone)


def test_zipped_axes(plan: Plan) -> None:
    given = {"spall.0.length": [1.0, 4.0], "load.axial": [4000.0, 4500.0]}
    swept = trb.sweep("loads", plan.base, given, mode="zip")
    assert (swept.dims, swept.values["loads"].shape) == (("member",), (2, 23))
    alone = trb.solve(dataclasses.replace(plan.base, spalls=(trb.Spall(4.0, 7.0),)))
    np.testing.assert_allclose(swept.values["loads"][1], alone.loads, rtol=1e-12)


def test_contacts_by_file(tmp_path: Path) -> None:
    text = scene_file.example("contact").replace("accuracy = 1e-3", "accuracy = 1e-2")
    plan = sweep_file.parse(text + '\n[sweep]\noutputs = ["approach"]\ncontact.offset = [0.0]\n').plan()
    assert plan.blocks.size == 1
    assert plan.units["contact.offset"] == plan.units["approach"] == "mm"
    assert (list(plan.shapes), plan.title) == (["approach", "status_code"], "approach")


# ------------------------------------------------------------------------------------------------ the law of all


def test_one_law_covers_all_loads(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(power, "power_law", lambda *a: asked.append(a) or plan.base.law)
    scene = plan.base
    named = dataclasses.replace(scene, law="power")
    given = axes.axes_of({"load.axial": [3000.0, 30000.0], "spall.0.length": [1.0, 4.0]})
    shared_law.with_shared_law(named, given)
    low, high = asked[0][1]
    single = [float(largest_load(scene.bearing, trb.Load(9000.0, axial))) for axial in (3000.0, 30000.0)]
    assert (low, high) == (single[0] / 6.0, 1.2 * single[1])


# ------------------------------------------------------------------------------------------------ files


def damages() -> dict[str, Callable[[Path], object]]:
    """What may happen to a file."""

    def flip(path: Path, place: int) -> None:
        content = bytearray(path.read_bytes())
        content[place] ^= 1
        path.write_bytes(content)

    return {
        "missing": lambda path: path.unlink(),
        "empty": lambda path: path.write_bytes(b""),
        "cut": lambda path: path.write_bytes(path.read_bytes()[:-7]),
        "half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
        "flipped": lambda path: flip(path, path.stat().st_size // 2),
        "flipped at the end": lambda path: flip(path, -9),
    }


@needs_zarr
@pytest.mark.parametrize("column", ["radial_stiffness_by_spall_0_width", "status_code"])
@pytest.mark.parametrize("damage", damages())
def test_what_is_damaged_is_found_and_made_again(
    plan: Plan, whole: Path, tmp_path: Path, column: str, damage: str
) -> None:
    before, out = bytes_of(whole), copied(whole, tmp_path)
    damages()[damage](shard(out, 1, column))
    gone = damage == "missing" and column == "status_code"
    with pytest.raises(trb.SweepError, match="not finished" if gone else "chunk 1 is missing or damaged; go on with"):
        trb.load_sweep(out)
    said: list[str] = []
    assert chunk_sharing.run(plan, out, resume=True, say=said.append).computed == 1
    assert said == ([] if gone else [f"{out}/sweep.zarr: chunk 1 is damaged: computed again"])
    assert bytes_of(out) == before
    assert chunk_sharing.run(plan, out, resume=True).computed == 0


@needs_zarr
@pytest.mark.parametrize("damage", damages())
@pytest.mark.parametrize("file", ["zarr.json", "load_axial/zarr.json", "load_axial/c/0", "status_code/zarr.json"])
def test_descriptions_are_made_again(plan: Plan, whole: Path, tmp_path: Path, file: str, damage: str) -> None:
    before, out = bytes_of(whole), copied(whole, tmp_path)
    damages()[damage](out / "sweep.zarr" / file)
    assert chunk_sharing.run(plan, out, resume=True).computed == 0
    assert bytes_of(out) == before
    (out / "sweep.zarr" / "zarr.json").unlink()
    with pytest.raises(trb.SweepError, match="there is no sweep here"):
        trb.load_sweep(out)


@needs_zarr
def test_what_killed_processes_left_is_removed_after_an_hour(plan: Plan, whole: Path, tmp_path: Path) -> None:
    out = copied(whole, tmp_path)
    old, new = (shard(out, 0).with_name(f"0.{name}.partial") for name in ("abc", "def"))
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (0, 0))
    assert chunk_sharing.run(plan, out, resume=True).computed == 0
    assert (old.exists(), new.exists()) == (False, True)


@needs_zarr
def test_without_zarr_chunks_are_npz(plan: Plan, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made, damaged, resumed; also where zarr is there."""
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(store, "has_zarr", lambda: False)
        assert chunk_sharing.run(plan, out, devices=1).computed == plan.chunks
        with pytest.raises(trb.SweepError, match=r"sweep.zarr: is read and written by zarr, .* pip install '\."):
            trb.load_sweep(whole)
        with pytest.raises(trb.SweepError, match=r"sweep\.zarr: is read and written by zarr"):
            chunk_sharing.run(plan, "memory://bucket")
    before = bytes_of(out)
    assert sorted(before) == ["axes.npz", *(f"chunk_00000{i}.npz" for i in range(5)), "manifest.json"]
    swept, other = trb.load_sweep(out), trb.load_sweep(whole)
    assert swept.to_xarray().identical(other.to_xarray())
    (out / "chunk_000000.npz").unlink()
    damages()["flipped"](out / "chunk_000001.npz")
    shutil.copy(out / "chunk_000003.npz", out / "chunk_000002.npz")  # sound, but not this one
    (out / "manifest.json").write_text("{ cut")
    for name in ("chunk_000000.npz-abc.part", "own-download.part"):
        (out / name).write_bytes(b"half")
    os.utime(out / "chunk_000000.npz-abc.part", (0, 0))
    said: list[str] = []
    ended = chunk_sharing.run(plan, out, resume=True, say=said.append)
    assert ended.computed == 3
    assert sorted(said) == [f"{out}: chunk {chunk} is damaged: computed again" for chunk in (1, 2)]
    (out / "own-download.part").unlink()
    assert bytes_of(out) == before
    assert chunk_sharing.run(plan, out, resume=True).computed == 0


@needs_zarr
@pytest.mark.parametrize("kind", ["zarr", "npz"])
def test_a_full_disk_leaves_what_is_written(
    plan: Plan, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """The system refuses to write longer files than some, at any place."""
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(store, "has_zarr", lambda: kind == "zarr")
    out, write, limits = tmp_path / "out", (store.Zarr if kind == "zarr" else store.Npz).write, resource.RLIMIT_FSIZE
    before = resource.getrlimit(limits)
    for size in (0, 100, 380):

        def full(self: store.Npz | store.Zarr, chunk: int, columns: dict[str, np.ndarray]) -> None:
            resource.setrlimit(limits, (before[1] if chunk < 2 else size, before[1]))  # noqa: B023
            try:
                write(self, chunk, columns)  # pyright: ignore
            finally:
                resource.setrlimit(limits, before)

        with monkeypatch.context() as patch:
            patch.setattr(store.Zarr if kind == "zarr" else store.Npz, "write", full)
            patch.setattr("difftrb.sweeps.blocks.CHUNKS_AT_ONCE", 1)
            with pytest.raises(trb.SweepError, match=r"File too large: 2 of 5 chunks are written and stay good; make"):
                chunk_sharing.run(plan, out, resume=True, devices=1)
    assert chunk_sharing.run(plan, out, resume=True).computed == plan.chunks - 2
    monkeypatch.undo()
    if kind == "zarr":
        assert bytes_of(out) == bytes_of(whole)
    assert trb.load_sweep(out).to_xarray().identical(trb.load_sweep(whole).to_xarray())


def test_a_folder_that_cannot_be_written(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(tmp_path / "out"))

    monkeypatch.setattr(Path, "mkdir", denied)
    with pytest.raises(trb.SweepError, match=r"out: Permission denied: nothing is written$"):
        chunk_sharing.run(plan, tmp_path / "out")


# ------------------------------------------------------------------------------------------------ other places


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[type]:
    """A file system behind "failing://" that refuses some writes and reads, as fsspec's memory otherwise."""
    fsspec = pytest.importorskip("fsspec")
    from fsspec.implementations.memory import MemoryFileSystem

    class Failing(MemoryFileSystem):
        protocol, cachable = "failing", False
        refuse: Callable[[str, str], None] = staticmethod(lambda _, __: None)

        def pipe_file(self, path: str, value: bytes, **more: object) -> None:
            type(self).refuse("write", path)
            super().pipe_file(path, value, **more)

        def cat_file(self, path: str, start: int | None = None, end: int | None = None, **more: object) -> bytes:
            type(self).refuse("read", path)
            return super().cat_file(path, start, end, **more)

    fsspec.register_implementation("failing", Failing, clobber=True)
    MemoryFileSystem.store.clear()
    yield Failing
    MemoryFileSystem.store.clear()


def test_a_sweep_in_a_bucket(plan: Plan, whole: Path, bucket: type) -> None:
    """What it refuses is one sentence; what was written stays good."""
    from fsspec.implementations.memory import MemoryFileSystem

    def refuse(what: str, path: str) -> None:
        if what == "write" and "axial_stiffness/c/3/" in path:
            raise RuntimeError("503 slow down\nof a library with errors of its own")

    bucket.refuse = staticmethod(refuse)  # type: ignore[attr-defined]
    words = r"^failing://bucket/run/sweep.zarr: 503 slow down: \d of 5 chunks are written and stay good; make room or"
    with pytest.raises(trb.SweepError, match=words):
        chunk_sharing.run(plan, "failing://bucket/run", devices=1)

    def refuse_reads(what: str, path: str) -> None:
        if what == "read":
            raise OSError("the token has expired")

    bucket.refuse = staticmethod(refuse_reads)  # type: ignore[attr-defined]
    with pytest.raises(trb.SweepError, match="the token has expired"):
        trb.load_sweep("failing://bucket/run")
    with pytest.raises(trb.SweepError, match="the token has expired"):
        chunk_sharing.run(plan, "failing://bucket/run", resume=True)
    bucket.refuse = staticmethod(lambda _, __: None)  # type: ignore[attr-defined]
    path = next(path for path in MemoryFileSystem.store if path.endswith("axial_stiffness/c/1/0"))
    MemoryFileSystem.store[path].seek(0)
    MemoryFileSystem.store[path].write(b"noise")
    said: list[str] = []
    chunk_sharing.run(plan, "failing://bucket/run", resume=True, say=said.append)
    assert said == ["failing://bucket/run/sweep.zarr: chunk 1 is damaged: computed again"]
    there = trb.load_sweep("failing://bucket/run").to_xarray()
    assert there.identical(trb.load_sweep(whole).to_xarray())


@needs_zarr
def test_a_url_that_cannot_be_opened(plan: Plan) -> None:
    with pytest.raises(trb.SweepError, match=r"^nowhere://bucket/run/sweep\.zarr: Protocol not known: nowhere$"):
        chunk_sharing.run(plan, "nowhere://bucket/run")


def test_xarray_opens_it_half_way(plan: Plan, whole: Path, tmp_path: Path) -> None:
    """Names without dots, units; NaN and status −1 where nothing is yet; into netCDF and CSV by xarray."""
    xarray = pytest.importorskip("xarray")
    out = copied(whole, tmp_path)
    full = xarray.open_zarr(whole / "sweep.zarr", consolidated=False).load()
    assert full.identical(trb.load_sweep(whole).to_xarray().assign_attrs(full.attrs)) or full.equals(
        trb.load_sweep(whole).to_xarray()
    )
    for path in out.rglob("3/0"):
        path.unlink()
    half = xarray.open_zarr(out / "sweep.zarr", consolidated=False)
    assert (half.status_code.values[3] == -1).all()
    assert half.radial_stiffness.isel(spall_0_length=3).isnull().all()
    assert half.isel(spall_0_length=slice(3)).equals(full.isel(spall_0_length=slice(3)))
    assert half.radial_stiffness.attrs == {"units": "N/mm", "long_name": "radial stiffness"}
    assert half.spall_0_length.attrs["units"] == "mm"
    full.to_netcdf(tmp_path / "own.nc", engine="scipy")
    with xarray.open_dataset(tmp_path / "own.nc", engine="scipy") as own:
        assert own.equals(full)
    assert len(full.to_dataframe().to_csv().splitlines()) == 1 + plan.members
    with pytest.raises(trb.SweepError, match="the sweep is not finished; go on with --resume"):
        trb.load_sweep(out)


@pytest.mark.parametrize(
    "more",
    [
        "",
        '[contact]\nlaw = "power"\n',
        "[effects.raceways]\n",
        '[contact]\nlaw = "palmgren"\n[effects.tilt]\nmoment_radial = 1e4\n',
    ],
)
def test_another_process_knows_the_sweep_again(more: str) -> None:
    """Whatever law its scene has: nothing that tells sweeps apart is of one process, as an address in memory is."""
    text = f"{scene_file.example('spall')}{more}[sweep]\nspall.0.length = [3.9, 4.0]\n"
    base = sweep_file.parse(text).plan().base
    told = repr(jax.tree.structure(base)) + "".join(map(repr, jax.tree.leaves(base)))
    assert " at 0x" not in told


def test_a_sweep_by_the_table_goes_on_in_another_process(tmp_path: Path) -> None:
    text = f"{scene_file.example('spall')}[sweep]\nspall.0.length = [3.0, 4.0]\n"
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    code = "import jax; jax.config.update('jax_enable_x64', True)\nfrom difftrb.sweeps import sweep_file, swept\n" + (
        f"print(swept.manifest_of(sweep_file.load_plan({str(tmp_path / 'scene.toml')!r}))['identity'])"
    )
    other = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.strip()
    assert other == manifest_of(sweep_file.load_plan(tmp_path / "scene.toml"))["identity"]


# ------------------------------------------------------------------------------------------------ refusals


def test_folders_that_are_refused(plan: Plan, whole: Path, tmp_path: Path) -> None:
    with pytest.raises(trb.SweepError, match="holds a sweep already; go on with --resume"):
        chunk_sharing.run(plan, whole)
    changed = FILE.replace("radial = 9000.0", "radial = 9001.0")
    with pytest.raises(trb.SweepError, match="of another scene file; undo the change"):
        chunk_sharing.run(made(changed), whole, resume=True)
    other = dataclasses.replace(plan, base=dataclasses.replace(plan.base, definition="secant"))
    with pytest.raises(trb.SweepError, match="of a scene with other numbers"):
        chunk_sharing.run(other, whole, resume=True)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(trb.SweepError, match="is a file; name a folder"):
        chunk_sharing.run(plan, tmp_path / "file")
    with pytest.raises(trb.SweepError, match="Not a directory: nothing is written"):
        chunk_sharing.run(plan, tmp_path / "file" / "out")
    with pytest.raises(trb.SweepError, match="there is no sweep here"):
        trb.load_sweep(tmp_path)


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
            "[effects]\ntilt = {}\nthrough = {}\n[sweep]\n",
            "effects.tilt and effects.through exclude",
        ),
        (
            "[sweep]\n",
            "[effects.tilt]\n[sweep]\n",
            "effects.tilt: contact.law = 'liu2018' knows no tilted roller",
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
        (lambda t: t["value"], {"value": [1.0, 2.0]}, "'value': a result is named as an axis"),
        (lambda t: {"chunk": t["value"]}, {"value": [1.0, 2.0]}, "'chunk': cannot be a name in a file, or has"),
        (lambda t: {"a/b": t["value"]}, {"value": [1.0, 2.0]}, "'a/b': cannot be a name in a file"),
        (lambda t: {"": t["value"]}, {"value": [1.0, 2.0]}, "'': cannot be a name in a file"),
        (
            lambda t: {"x": jnp.ones(3) * t["x_0"]},
            {"x_0": [1.0, 2.0]},
            "'x_0': a dimension of a result is named as an axis",
        ),
        (
            lambda t: {"x": t["value"], "x_by_n": t["n"]},
            {"x_0": [1.0, 2.0]},
            "'x_by_n': this result is named as a deriv",
        ),
        (lambda t: t["n"], {"identity": [1.0, 2.0]}, "'identity': cannot be a name in a file, or has"),
        (lambda t: {}, {"value": [1.0, 2.0]}, "the function returns no number"),
        (lambda t: jnp.zeros(0) * t["n"], {"value": [1.0, 2.0]}, "the function returns no number"),
    ],
)
def test_results_that_cannot_stand_in_a_file(tmp_path: Path, function, axes, words: str) -> None:
    base = {"value": 1.0, "x_0": 1.0, "n": 2.0, "identity": 1.0}
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
        patch.setattr(figure_style, "save", full)
        assert cli.main(["--no-cache", "sweep", str(file), "--out", str(out), "--devices", "1"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "No space left on device: " in said.err
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


def test_shares() -> None:
    task = {"SLURM_ARRAY_TASK_ID": "7", "SLURM_ARRAY_TASK_MIN": "3", "SLURM_ARRAY_TASK_MAX": "11"}
    task["SLURM_ARRAY_TASK_STEP"] = "2"
    assert sweep_file.share_of(None, {}) is None
    assert sweep_file.share_of("1/1", {}) is None
    assert sweep_file.share_of(None, task) == (3, 5)
    assert sweep_file.share_of("2/4", task) == (2, 4)
    assert sweep_file.share_of(None, {"SLURM_PROCID": "0", "SLURM_NTASKS": "3"}) == (1, 3)
    for wrong in ("0/2", "3/2", "1", "a/b", "1/0", "-1/2"):
        with pytest.raises(trb.SweepError, match=f"^--share {wrong}: must be I/N"):
            sweep_file.share_of(wrong, {})


@pytest.mark.parametrize("share", [(3, 2), (0, 2), (1, 0)])
def test_shares_that_are_none_write_nothing(plan: Plan, tmp_path: Path, share: tuple[int, int]) -> None:
    """(3, 2) wrote chunks that no sweep has."""
    with pytest.raises(trb.SweepError, match=r"^share = \(\d, \d\): must be \(i, n\)"):
        chunk_sharing.run(plan, tmp_path / "out", share=share)
    assert not (tmp_path / "out").exists()


def experiment():
    path = Path(__file__).parents[2] / "experiments" / "sweep_at_scale.py"
    spec = spec_from_file_location("sweep_at_scale", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SMALL = FILE.replace('gradients = ["spall.0.length", "spall.0.width"]\n', "").replace("count = 45", "count = 200")


@pytest.mark.slow
def test_two_processes_and_kills_leave_the_same_bytes(tmp_path: Path) -> None:
    scale = experiment()
    assert scale.processes(tmp_path, SMALL)[0] == []
    differing, there = scale.kills(tmp_path, 1, SMALL, 3.0)
    assert differing == []
    assert len(there) == 1


@pytest.mark.slow
def test_two_devices_make_the_same_files(whole: Path, tmp_path: Path) -> None:
    """In a process of its own: a CPU shown to JAX as two devices."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import jax; jax.config.update('jax_enable_x64', True)\n"
        "jax.config.update('jax_num_cpu_devices', 2)\n"
        "from pathlib import Path; import difftrb\n"
        "from difftrb.core import jax_config\n"
        f"jax_config.OPTIONS.update({jax_config.OPTIONS})\n"  # other options, other bytes
        "from difftrb.sweeps import shared_law, chunk_sharing, sweep_file\n"
        "text = Path(sys.argv[2]).read_text()\n"
        "assert len(jax.local_devices()) == 2\n"
        "chunk_sharing.run(sweep_file.parse(text).plan(3), Path(sys.argv[3]))\n"
    )
    file = tmp_path / "scene.toml"
    file.write_text(FILE, encoding="utf-8")
    source = str(Path(trb.__file__).parents[1])
    arguments = [sys.executable, "-c", code, source, str(file), str(tmp_path / "out")]
    subprocess.run(arguments, check=True, timeout=120, env=os.environ | {"TF_CPP_MIN_LOG_LEVEL": "3"})
    assert bytes_of(tmp_path / "out") == bytes_of(whole)


def test_workers_of_dask_make_the_same_files(whole: Path, plan: Plan, tmp_path: Path) -> None:
    """Here as threads of this process; a plan goes to others by cloudpickle."""
    distributed = pytest.importorskip("distributed")
    cloudpickle = pytest.importorskip("cloudpickle")
    sent = cloudpickle.dumps(plan)
    assert cloudpickle.loads(sent) is cloudpickle.loads(sent)  # compiled once
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:
        ended = chunk_sharing.run(plan, tmp_path / "out", scheduler=cluster.scheduler_address)
        store, _ = chunk_sharing._begun(plan, tmp_path / "gone", False)
        for lost in (distributed.comm.CommClosedError("in <TCP>: Stream is closed"), CancelledError("a chunk")):

            def order(lost: BaseException = lost) -> Iterator[int]:
                raise lost
                yield

            with (
                pytest.raises(trb.SweepError, match=f"{chunk_sharing.GONE}: nothing is written"),
                chunk_sharing._stays_good(store, plan),
            ):
                list(chunk_sharing._by_workers(cluster.scheduler_address, plan, store, 1, order()))
    assert ended.computed == plan.chunks
    assert bytes_of(tmp_path / "out") == bytes_of(whole)


@pytest.mark.slow
@pytest.mark.hard
def test_a_scheduler_that_dies_is_said_in_one_sentence(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    differing, (told,) = experiment().kills_on_dask(tmp_path, 1, "scheduler", SMALL)
    assert differing == []
    if not told.endswith("command ended 1"):  # it was done before
        assert "command ended 2: difftrb: " in told
        assert "the scheduler is gone: " in told
        assert told.endswith("chunks are written and stay good; start another one, and go on with --resume; resumed")


# ------------------------------------------------------------------------------------------------ figures


def test_figures(whole: Path, plan: Plan, tmp_path: Path) -> None:
    swept = trb.load_sweep(whole)
    assert repr(swept).startswith("Swept: spall.0.length (")
    assert 3 <= len(repr(swept).splitlines()) < 8
    ax = sweep_plot.swept(swept, "radial_stiffness")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("spall length [mm]", "load axial [N]")
    figure_style.save(ax, tmp_path, "map")
    other = sweep_plot.sweep_map(swept, "radial_stiffness", x="load.axial", y="spall.0.length")
    assert other.get_xlabel() == "load axial [N]"
    figure_style.save(other, tmp_path, "turned")
    figure_style.save(
        sweep_plot.sweep_curves(swept, "axial_stiffness", along="spall.0.length", over="load.axial"), tmp_path, "curves"
    )
    assert len(list(tmp_path.iterdir())) == 6


def test_the_packaged_sweep_is_in_order() -> None:
    found = sweep_file.parse(scene_file.example("sweep"))
    assert tuple(found.axes) == SIZES == found.gradients
    assert json.loads(json.dumps(found.axes))["spall.0.length"]["count"] > 8
