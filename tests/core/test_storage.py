"""What is kept on disk: whole, known by what made it, made again when damaged."""

from pathlib import Path

import numpy as np
import pytest

from difftrb.core import storage


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(storage, "folder", lambda: tmp_path / "tables")
    monkeypatch.setattr(storage, "keeping", True)  # whatever a test of the command line has left
    return tmp_path / "tables"


def made(calls: list[int]) -> storage.Arrays:
    calls.append(1)
    return {"x": np.arange(5.0), "y": np.array(2.5)}


def test_made_once_then_read(folder: Path) -> None:
    calls: list[int] = []
    first, again = (storage.kept("a", lambda: made(calls)) for _ in range(2))
    assert len(calls) == 1
    assert first.keys() == again.keys()
    np.testing.assert_array_equal(first["x"], again["x"])
    assert [p.name for p in folder.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("damage", ["cut", "empty", "flipped", "text"])
def test_damaged_files_are_made_again(folder: Path, damage: str) -> None:
    calls: list[int] = []
    storage.kept("a", lambda: made(calls))
    path = folder / "a.npz"
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[whole.index(np.arange(5.0).tobytes()) + 9] ^= 0xFF
    path.write_bytes({"cut": whole[:-40], "empty": b"", "flipped": bytes(flipped), "text": b"not a table"}[damage])
    np.testing.assert_array_equal(storage.kept("a", lambda: made(calls))["x"], np.arange(5.0))
    assert len(calls) == 2
    assert path.read_bytes() == whole


def test_an_interrupted_write_leaves_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", broken)
    with pytest.raises(KeyboardInterrupt):
        storage.kept("a", lambda: made([]))
    assert list(folder.iterdir()) == []


def test_nowhere_to_write_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(storage, "folder", lambda: tmp_path / "file" / "tables")
    assert storage.kept("a", lambda: made([]))["y"] == 2.5


def test_keeping_nothing_when_told_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "keeping", False)
    calls: list[int] = []
    for _ in range(2):
        storage.kept("a", lambda: made(calls))
    assert len(calls) == 2
    assert not folder.exists()


def test_key_depends_on_numbers_and_their_version(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {storage.key([1.0, 2.0]), storage.key([1.0, 2.0 + 1e-15])}
    assert len(keys) == 2
    assert storage.key([1.0, 2.0]) in keys
    monkeypatch.setattr(storage, "NUMERICS", storage.NUMERICS + 1)
    assert storage.key([1.0, 2.0]) not in keys


@pytest.mark.parametrize("there", [True, False])
def test_a_failure_while_writing_leaves_what_was_there(tmp_path: Path, there: bool) -> None:
    target = tmp_path / "a" / "out"
    if there:
        target.mkdir(parents=True)
        (target / "result.json").write_text("old", encoding="utf-8")

    def fill(folder: Path) -> None:
        (folder / "result.json").write_text("half", encoding="utf-8")
        raise OSError(28, "No space left on device", str(folder))

    with pytest.raises(OSError, match="No space left") as caught:
        storage.write_folder(target, fill)
    assert caught.value.filename == str(target)
    if there:
        assert (target / "result.json").read_text() == "old"
        assert [p.name for p in target.iterdir()] == ["result.json"]
    else:
        assert list(tmp_path.iterdir()) == []
