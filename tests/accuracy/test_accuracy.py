"""What accuracy costs: errors and recommendations of rungs made up, and the command with two that compile fast."""

import dataclasses
import io
import json
import math
import os
from pathlib import Path
from types import SimpleNamespace

import jax
import pytest
from rich.console import Console

from difftrb import __main__ as cli
from difftrb.accuracy import accuracy_report, ladder, timing
from difftrb.accuracy.ladder import Measured, Row, Rung
from difftrb.core import machine
from difftrb.law.base import LAWS
from difftrb.report import figure_style, tables
from difftrb.scene import scene_file

ROW_KEYS = {
    "way", "accuracy", "status", "error", "errors", "values", "first", "again", "single", "each", "each_with_gradient",
    "new", "yardsticks", "memory", "device", "size", "there", "continuum",
}  # fmt: skip
KEYS = {
    "status", "converged", "asked", "recommended", "finer", "ring", "contact", "truth", "left_out", "yardstick",
    "device", "cores", "one_core", "seconds", "accelerator", "importing",
}  # fmt: skip


def row(way: str, figure: float, radial: float, axial: float, again: float, status: str = "converged") -> Row:
    values = {"radial_stiffness": radial, "axial_stiffness": axial, "load": radial, "by_length": -radial}
    return Row(Rung("ring", way, figure), 9.0 + again, again, 1e-3, 1e-5, 3e-5, 500.0, values, status)


ROWS = (
    row("direct", 1e-3, 1.0004, 2.0, 4.0),
    row("direct", 1e-4, 1.0, 2.0, 9.0),
    row("table", 1e-3, 1.0008, 2.0004, 20.0),
    row("power", 1e-3, 1.03, 2.02, 0.5),
    row("liu2018", 1e-3, 1.3, 2.6, 0.0),
    row("direct", 1e-2, 1.002, 2.003, 1.0),
)


def measured(rows: tuple[Row, ...], asked: float = 1e-3) -> Measured:
    compared = ladder.judged(rows)
    best = ladder.recommended(compared, asked)
    return Measured(
        tuple(compared), {"ring palmgren": "no"}, asked, best, ladder.finer(compared, best), 1e-2, "cpu", 2, 60.0
    )


def shown(result: Measured, width: int) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(accuracy_report.accuracy_text(result))
    return console.export_text()


def test_errors_are_from_the_finest_rung_and_its_own_from_the_next() -> None:
    rows = ladder.judged(ROWS)
    assert rows[0].errors["radial_stiffness"] == pytest.approx(4e-4)
    assert rows[1].errors["radial_stiffness"] == pytest.approx(4e-4, rel=1e-3)
    assert rows[3].error == pytest.approx(3e-2)
    assert rows[5].error == pytest.approx(2e-3)
    assert rows[5].errors["by_length"] == pytest.approx(2e-3)
    (alone,) = ladder.judged(ROWS[2:3])
    assert math.isnan(alone.error)


@pytest.mark.parametrize(
    ("asked", "way", "figure"), [(1.0, "liu2018", 1e-3), (5e-2, "power", 1e-3), (4e-3, "direct", 1e-2),
                                 (1e-3, "direct", 1e-3)]
)  # fmt: skip
def test_the_cheapest_that_meets_it_is_recommended(asked: float, way: str, figure: float) -> None:
    best = ladder.recommended(ladder.judged(ROWS), asked)
    assert best is not None
    assert (best.rung.way, best.rung.accuracy) == (way, figure)


def test_the_next_more_exact_is_named() -> None:
    rows = ladder.judged(ROWS)
    for this, finer in ((3, 5), (5, 0), (0, 1), (1, None)):
        assert ladder.finer(rows, rows[this]) is (None if finer is None else rows[finer])


def test_nothing_is_recommended_beyond_what_the_truth_is_known_to() -> None:
    assert ladder.recommended(ladder.judged(ROWS), 1e-4) is None
    assert ladder.recommended(ladder.judged(ROWS[2:4]), 1e-1) is None


def test_a_rung_that_did_not_converge_is_neither_truth_nor_recommended() -> None:
    rows = ladder.judged((row("direct", 1e-4, 7.0, 7.0, 0.1, "did not"), *ROWS[2:], ROWS[0]))
    truth = ladder.finest(rows, "ring")
    assert truth is not None
    assert truth.rung.accuracy == 1e-3
    best = ladder.recommended(rows, 1.0)
    assert best is not None
    assert best.rung.way == "liu2018"


def test_without_a_truth_the_record_has_the_reason() -> None:
    failed = row("direct", 1e-4, 7.0, 7.0, 0.1, "it did not")
    for rows, words in (((failed, ROWS[3]), "it did not"), (ROWS[2:4], "compared with")):
        record = accuracy_report.accuracy_json(measured(rows))
        assert record["converged"] is False
        assert words in record["status"]


def test_text_fits_a_page() -> None:
    text = shown(measured(ROWS), 80)
    for words in (
        "direct 1e-4",
        "±4.0e-4",
        "take direct 1e-3",
        "3.0e-2",
        "left out: ring palmgren: no",
        "yardstick",
    ):
        assert words in text
    assert "…" not in text


def test_what_is_not_known_of_any_rung_has_no_column() -> None:
    few = tuple(dataclasses.replace(r, values={k: v for k, v in r.values.items() if k != "by_length"}) for r in ROWS)
    assert "length" in shown(measured(ROWS), 80).splitlines()[2]
    assert "length" not in shown(measured(few), 80).splitlines()[2]
    assert "radial" in shown(measured(few), 80).splitlines()[2]
    assert "±–" not in shown(measured((few[0], *ROWS[1:])), 80)
    assert "±–" not in shown(measured((ROWS[0], few[1], *ROWS[2:])), 80)


def test_the_figure_has_a_panel_for_what_was_measured(tmp_path: Path) -> None:
    ax = accuracy_report.work_precision(measured(ROWS))
    assert len(ax.figure.axes) == 1
    names = {text.get_text() for text in ax.get_legend().get_texts()}
    assert names == {"direct", "table", "power", "liu2018", "truth known to"}
    figure_style.save(ax, tmp_path, "accuracy")
    assert (tmp_path / "accuracy.png").stat().st_size > 0


@pytest.mark.slow
@pytest.mark.portable
def test_command(capsys, monkeypatch, tmp_path: Path) -> None:
    """The default scene in the mean over phases: without a direct rung there is no truth, nothing is recommended."""
    path = tmp_path / "mean.toml"
    path.write_text(scene_file.example("spall") + '\n[stiffness]\nphase = "mean"\n', encoding="utf-8")
    out = tmp_path / "out"
    few = Rung("ring", "liu2018", 1e-3), Rung("contact", "cells", 1e-2), Rung("contact", "lattice", 1e-3, (8, 80))
    monkeypatch.setattr(ladder, "rungs", lambda _: few)
    monkeypatch.setattr(timing, "BATCH", 2)
    code = cli.main(["--no-cache", "accuracy", str(path), "--json", "--accuracy", "1e-2", "--out", str(out)])
    captured = capsys.readouterr()
    record = json.loads(captured.out)
    assert (code, captured.err) == (0, "")
    assert set(record) == KEYS
    (ring,), (contact, lattice) = record["ring"], sorted(record["contact"], key=lambda row: row["way"])
    assert set(ring) == set(contact) == ROW_KEYS
    assert ring["status"] == contact["status"] == "converged"
    assert ring["error"] is contact["error"] is None
    assert 0.0 < lattice["error"] < 1e-2
    assert set(ring["values"]) == {"approach", "load", "radial_stiffness", "axial_stiffness", "by_length", "by_width"}
    assert ring["first"] > ring["again"] > 0.0
    assert ring["yardsticks"] == pytest.approx((ring["again"] + ring["single"]) / record["yardstick"])
    assert ring["values"]["by_length"] < 0.0
    assert ring["values"]["by_width"] < 0.0
    assert ring["each_with_gradient"] > 0.0
    assert (record["asked"], record["recommended"], record["truth"]["ring"]) == (1e-2, None, None)
    assert record["truth"]["contact"] == contact
    assert {path.name for path in out.iterdir()} == {"result.json", "accuracy.png", "accuracy.svg"}


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system does not pin processes")
def test_one_core_is_another_process() -> None:
    file = scene_file.parse(scene_file.example("spall"))
    result = timing.measure(file, rungs=(Rung("ring", "liu2018", 1e-3),), batch=2, thorough=True)
    record = accuracy_report.accuracy_json(result)["one_core"]
    assert record["each"] > 0.0
    assert record["each_with_gradient"] > 0.0
    assert "on one core alone a batch takes" in shown(result, 100)


@pytest.mark.slow
def test_with_an_accelerator_a_batch_is_timed_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "accelerator", lambda: jax.local_devices(backend="cpu")[0])  # stands for one
    monkeypatch.setattr(timing, "BATCH_THERE", 3)
    file = scene_file.parse(scene_file.example("spall"))
    result = timing.measure(file, rungs=(Rung("ring", "liu2018", 1e-3),), batch=2)
    record = accuracy_report.accuracy_json(result)
    assert record["accelerator"] == record["device"]
    assert record["ring"][0]["there"] > 0.0
    assert shown(result, 100).count("there") == 2  # the column, and what it is


@pytest.mark.slow
def test_ways_to_solve_a_contact_are_compared_with_the_continuum_if_asked() -> None:
    file = scene_file.parse(scene_file.example("spall"))
    few = Rung("contact", "cells", 1e-2), Rung("contact", "lattice", 1e-3, (8, 80))
    result = timing.measure(file, rungs=few, thorough=True)
    cells, lattice = (row.continuum for row in result.rows)
    assert 0.0 < cells < 1e-2
    assert 1e-3 < lattice < 1e-1
    assert "lattice 8×80" in shown(result, 100)
    assert shown(result, 100).count("continuum") == 3
    assert result.importing > 0.0


@pytest.mark.parametrize(("slower", "rows", "slopes"), [(0.2, 17, 8), (0.6, 16, 5), (1.0, 7, 2), (3.0, 4, 0)])
def test_what_would_not_be_done_in_time_is_not_begun(monkeypatch, slower: float, rows: int, slopes: int) -> None:
    """The first four are measured on the slowest machine; then what takes least time comes first."""
    clock, slopes_of, told = [0.0], [], []

    def lasts(rung: Rung, slopes: bool) -> Row:
        clock[0] += slower * ladder.Step(rung, slopes).usual
        return dataclasses.replace(row(rung.way, rung.accuracy, 1.0, 2.0, 1.0), rung=rung)

    def with_gradient(done: Row, *_) -> Row:
        slopes_of.append(done.rung)
        return lasts(done.rung, True)

    monkeypatch.setattr(timing, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    monkeypatch.setattr(timing, "on_ring", lambda rung, *_: (lasts(rung, False), None))
    monkeypatch.setattr(timing, "on_contact", lambda rung, *_: lasts(rung, False))
    monkeypatch.setattr(timing, "with_gradient", with_gradient)
    result = timing.measure(scene_file.parse(scene_file.example("spall")), progress=lambda *at: told.append(at))
    assert (len(result.rows), len(slopes_of)) == (rows, slopes)
    assert {r.rung for r in result.rows} >= set(slopes_of)
    assert all("no time left within 55 s" in reason for reason in result.left_out.values())
    always = sum(ladder.Step(rung, False).usual for rung in ladder.rungs()[: ladder.ALWAYS])
    assert result.seconds <= max(timing.LIMIT, slower * always)
    assert told[-1] == (25, 25)


def test_what_cannot_be_had_is_left_out_with_its_reason(monkeypatch, capsys, tmp_path: Path) -> None:
    monkeypatch.setattr(ladder, "rungs", lambda _: (Rung("ring", "power", 1e-3),))
    path = tmp_path / "map.toml"
    path.write_text(scene_file.example("map"), encoding="utf-8")
    assert cli.main(["--no-cache", "accuracy", str(path)]) == 2
    err = capsys.readouterr().err
    assert "height_map" in err
    assert err.count("\n") == 1


def test_every_law_that_is_registered_is_measured(monkeypatch) -> None:
    assert {rung.way for rung in ladder.rungs() if rung.kind == "ring"} == set(LAWS)
    assert set(ladder.rungs(full=True)) > set(ladder.rungs()) == set(ladder.USUAL)
    monkeypatch.setitem(LAWS, "toy", dataclasses.replace(LAWS["palmgren"], name="toy"))
    assert Rung("ring", "toy", 1e-3) in ladder.rungs()
    assert [Rung("ring", way, 1e-3).name for way in ("toy", "power", "direct")] == ["toy", "power 1e-3", "direct 1e-3"]


def test_an_accuracy_out_of_range_is_refused(capsys) -> None:
    assert cli.main(["--no-cache", "accuracy", "--accuracy", "2"]) == 2
    assert "--accuracy = 2: must be a number in 1e-06 … 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "0 s"), (3e-7, "0.3 µs"), (0.0471, "47 ms"), (0.996, "1 s"), (99.6, "100 s"), (149.0, "2.5 min"),
     (5990.0, "1.7 h"), (math.nan, "–")],
)  # fmt: skip
def test_durations_have_two_digits(seconds: float, text: str) -> None:
    assert tables.duration(seconds) == text
