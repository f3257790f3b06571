"""Files are written whole or not at all, and read only if they are whole."""

from pathlib import Path

import numpy as np
import pytest

from difftrb.core import storage

MADE = {"x": np.arange(5.0), "y": np.array(2.5)}


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "a.npz"
    storage.write(path, MADE)
    found = storage.read(path)
    assert found is not None
    assert found.keys() == MADE.keys()
    np.testing.assert_array_equal(found["x"], MADE["x"])
    assert [p.name for p in path.parent.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("damage", ["cut", "empty", "flipped", "text"])
def test_damaged_files_are_not_read(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "a.npz"
    storage.write(path, MADE)
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[whole.index(np.arange(5.0).tobytes()) + 9] ^= 0xFF
    path.write_bytes({"cut": whole[:-40], "empty": b"", "flipped": bytes(flipped), "text": b"not arrays"}[damage])
    assert storage.read(path) is None


def test_an_interrupted_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", broken)
    with pytest.raises(KeyboardInterrupt):
        storage.write(tmp_path / "a.npz", MADE)
    assert list(tmp_path.iterdir()) == []


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
