"""What is computed once for all processes is found again, and never taken for another."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import difftrb as trb
from difftrb.core import user_cache
from difftrb.law import samples
from difftrb.law.samples import Case


@pytest.fixture
def keeping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the package keeps things."""
    monkeypatch.setattr(user_cache, "_folder", [tmp_path])
    return tmp_path


def test_a_result_is_computed_once(keeping: Path) -> None:
    computed: list[Any] = []

    def result(depends: Any) -> Any:
        return user_cache.result(lambda: computed.append(depends) or {"of": depends}, "thing", depends)

    for depends in ((1.0, "a"), (1.0, "b"), (2.0, "a"), (1.0, "a"), (2.0, "a")):
        assert result(depends) == {"of": depends}
    assert computed == [(1.0, "a"), (1.0, "b"), (2.0, "a")]
    for file in keeping.rglob("thing-*"):
        file.write_bytes(b"broken")
    assert result((1.0, "a")) == {"of": (1.0, "a")}
    assert len(computed) == 4
    for _ in range(2):  # no telling whether it will be the same
        result(lambda: None)
    assert len(computed) == 6


def test_where_nothing_is_kept_it_is_computed() -> None:
    assert user_cache.folder() is None
    assert [user_cache.result(lambda k=k: k, "thing", 1.0) for k in range(2)] == [0, 1]


def test_contacts_are_solved_once(keeping: Path, contact: trb.LineContact, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [Case(1000.0), Case(2000.0, trb.Spall(4.0, 7.0))]
    first = samples.all_solved(contact, cases, 1e-2)
    asked: list[int] = []
    monkeypatch.setattr(samples, "mapped", lambda solve, cases, *_: asked.append(len(cases)) or [])
    done: list[tuple[int, int]] = []
    again = samples.all_solved(contact, cases, 1e-2, lambda *told: done.append(told))
    assert not asked
    assert done == [(2, 2)]
    for one, other in zip(first, again, strict=True):
        assert one.approach == other.approach
        np.testing.assert_array_equal(one.slopes, other.slopes)
    samples.all_solved(contact, cases, 1e-3)
    samples.all_solved(contact, cases, 1e-2, tilt_response=True)
    samples.all_solved(contact, cases[:1], 1e-2)
    assert asked == [2, 2, 1]
