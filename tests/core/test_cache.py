"""What is kept on disk: whole, known by what made it, made again when damaged."""

import os
from pathlib import Path

import numpy as np
import pytest

from difftrb.core import cache


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "tables")
    monkeypatch.setattr(cache, "keeping", True)  # whatever a test of the command line has left
    return tmp_path / "tables"


def made(calls: list[int]) -> cache.Arrays:
    calls.append(1)
    return {"x": np.arange(5.0), "y": np.array(2.5)}


def test_made_once_then_read(folder: Path) -> None:
    calls: list[int] = []
    first, again = (cache.kept("a", lambda: made(calls)) for _ in range(2))
    assert len(calls) == 1
    assert first.keys() == again.keys()
    np.testing.assert_array_equal(first["x"], again["x"])
    assert [p.name for p in folder.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("damage", ["cut", "empty", "flipped", "text"])
def test_damaged_files_are_made_again(folder: Path, damage: str) -> None:
    calls: list[int] = []
    cache.kept("a", lambda: made(calls))
    path = folder / "a.npz"
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[whole.index(np.arange(5.0).tobytes()) + 9] ^= 0xFF
    path.write_bytes({"cut": whole[:-40], "empty": b"", "flipped": bytes(flipped), "text": b"not a table"}[damage])
    np.testing.assert_array_equal(cache.kept("a", lambda: made(calls))["x"], np.arange(5.0))
    assert len(calls) == 2
    assert path.read_bytes() == whole


def test_an_interrupted_write_leaves_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", broken)
    with pytest.raises(KeyboardInterrupt):
        cache.kept("a", lambda: made([]))
    assert list(folder.iterdir()) == []


def test_nowhere_to_write_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "file" / "tables")
    assert cache.kept("a", lambda: made([]))["y"] == 2.5


def test_keeping_nothing_when_told_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "keeping", False)
    calls: list[int] = []
    for _ in range(2):
        cache.kept("a", lambda: made(calls))
    assert len(calls) == 2
    assert not folder.exists()


def test_key_depends_on_numbers_and_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {
        cache.key([1.0, 2.0], ("curve",)),
        cache.key([1.0, 2.0 + 1e-15], ("curve",)),
        cache.key([1.0, 2.0], ("gap",)),
    }
    assert len(keys) == 3
    assert cache.key([1.0, 2.0], ("curve",)) in keys
    source = tmp_path / "store.py"
    for text in ("one", "two"):
        (tmp_path / "curve.py").write_text(text)
        monkeypatch.setattr(cache, "__file__", os.fspath(source))
        keys.add(cache.key([1.0, 2.0], ("curve",)))
    assert len(keys) == 5
