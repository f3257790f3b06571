"""A few of the random scenes that `experiments/audit_of_scenes.py` audits by the hundred."""

import csv
from pathlib import Path

import pytest

from experiments import audit_of_scenes

pytestmark = pytest.mark.hard


@pytest.mark.parametrize("seed", [3, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 4))])
def test_what_converges_is_within_its_promise(seed: int) -> None:
    """By a power law beside a second row, and by the literature's over one and two spalls: none refused."""
    row = audit_of_scenes.row(seed, audit_of_scenes.LAWS)
    assert row["status"] == "converged"
    assert row["kept"]
    assert row["failed"] == 0
    if "finite" in row:
        assert row["finite"]
        assert row["derivative_error"] < 1e-6


def test_rows_are_summed_up(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = tmp_path / "audit.csv"
    rows = [
        {"seed": 0, "law": "power", "status": "converged", "load_error": 0.01, "promised": 0.02, "kept": True,
         "radial_error": 0.02, "finite": True, "derivative_error": 1e-9},
        {"seed": 1, "law": "table", "status": "converged", "load_error": 0.03, "promised": 0.02, "kept": False,
         "radial_error": 0.02},
        {"seed": 2, "law": "table", "status": "refused: because"},
    ]  # fmt: skip
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, audit_of_scenes.FIELDS)
        writer.writeheader()
        writer.writerows(rows)
    audit_of_scenes.summary(path)
    out = capsys.readouterr().out
    assert "3 scenes, 2 converged" in out
    assert "beyond what is promised: 1 [('1', 'table')]" in out
    assert "not finite: []" in out
