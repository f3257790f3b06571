"""Files that would wait for ever, fill the memory or end as a traceback: each gets one sentence, at once."""

import gc
import io
import os
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import difftrb as trb
from difftrb.__main__ import main
from difftrb.core import input_errors
from difftrb.fits import measured_table
from difftrb.fits.measured import MeasuredError
from difftrb.scene import scene_file
from difftrb.sweeps import sweep_file

pytestmark = pytest.mark.hard

READERS: dict[str, tuple[Callable, str]] = {
    "scene": (trb.load_scene, "s.toml"),
    "sweep": (sweep_file.read, "s.toml"),
    "measurements": (measured_table.load_measured, "m.csv"),
    "map as text": (trb.load_height_map, "m.csv"),
    "map": (trb.load_height_map, "m.npz"),
}


def refusal(reader: Callable, path: object) -> str:
    """The one sentence that a reader ends with, within a second of this thread, in which no garbage is collected."""
    gc.disable()
    try:
        begin = time.thread_time()
        with pytest.raises((scene_file.SceneError, MeasuredError, trb.HeightMapError)) as caught:
            reader(path)
        assert time.thread_time() - begin < 1.0
    finally:
        gc.enable()
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert len(sentence) < 600
    return sentence


@pytest.mark.parametrize("kind", READERS)
def test_what_is_no_file_is_not_opened(kind: str, tmp_path: Path) -> None:
    reader, name = READERS[kind]
    pipe = tmp_path / name
    os.mkfifo(pipe)
    assert "is a pipe or a device, not a" in refusal(reader, pipe)
    pipe.unlink()
    pipe.symlink_to("/dev/zero")
    assert "is a pipe or a device, not a" in refusal(reader, pipe)
    pipe.unlink()
    pipe.mkdir()
    assert "is a directory, not a" in refusal(reader, pipe)
    assert "null" in refusal(reader, f"{tmp_path}/a\0{name}")
    assert "..." in refusal(reader, tmp_path / ("x" * 5000 + name))
    assert "no such file" in refusal(reader, tmp_path / "two\nlines" / name)


@pytest.mark.parametrize("kind", READERS)
def test_a_file_too_large_is_not_read(kind: str, tmp_path: Path) -> None:
    reader, name = READERS[kind]
    with open(tmp_path / name, "wb") as file:
        file.truncate(1_000_000_000)  # takes no room on the disk
    assert "has 1e+03 MB: a" in refusal(reader, tmp_path / name)


def test_a_file_that_lies_about_its_size_is_read_so_far(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "s.toml"
    path.write_text("#" * 3000)
    monkeypatch.setattr(input_errors, "_refusal", lambda *_: "")
    with pytest.raises(ValueError, match=r"more than 0\.001 MB"):
        input_errors.text_of(path, "a scene file", ValueError, 1000)


def test_keys_of_very_many_parts(tmp_path: Path) -> None:
    good = scene_file.example("spall")
    for line in (
        ".".join("a" * 20_000) + " = 1",
        "[" + ".".join(["'1'"] * 20_000) + "]",
        "x = {" + "1." * 9999 + "1=1}",
    ):
        path = tmp_path / "s.toml"
        path.write_text(f"{good}\n{line}\n")
        assert f"line {len(good.splitlines()) + 2}: has more than 32 points" in refusal(trb.load_scene, path)
    values = ", ".join(f"{0.1 + 0.01 * k:.2f}" for k in range(200))
    path.write_text(f"# {'.' * 100}\n{good}\n[sweep]\n'spall.0.length' = [{values}]\n")
    assert len(sweep_file.read(path).axes["spall.0.length"]) == 200


def npy(header: str, data: bytes = b"", version: bytes = b"\1\0") -> bytes:
    size = struct.pack("<H" if version == b"\1\0" else "<I", len(header))
    return b"\x93NUMPY" + version + size + header.encode() + data


def described(shape: object, descr: str = "'<f8'") -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n"


def archive(path: Path, height: bytes, method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as file:
        file.writestr("height.npy", height)
        for key in ("pitch_x", "pitch_y"):
            entry = io.BytesIO()
            np.save(entry, np.array(0.1))
            file.writestr(f"{key}.npy", entry.getvalue())
    return path


GOOD = npy(described((2, 2)), np.arange(4.0).tobytes())
HEIGHTS = {
    "1e18 points": (npy(described((10**9, 10**9))), "at most 4096 × 4096 points"),
    "1e600 points": (npy(described(f"({10**300}, {10**300})")), "height has shape"),
    "points in many directions": (npy(described((2,) * 60)), "height has shape"),
    "fewer than none": (npy(described((-(10**9), 2))), "height has shape"),
    "words": (npy(described((2, 2), "'<U100000000'")), "not numbers"),
    "fields": (npy(described((2, 2), "[('x', '<f8', (100000, 100000))]")), "plain arrays"),
    "objects": (npy(described((2, 2), "'|O'")), "plain arrays"),
    "no data": (npy(described((4096, 4096))), "plain arrays"),
    "no header": (b"\x93NUMPY\1\0", "plain arrays"),
    "a header of 4 GB": (b"\x93NUMPY\2\0\xff\xff\xff\xff" + bytes(100_000), "plain arrays"),
    "a header of brackets": (npy("(" * 9000), "plain arrays"),
    "a header of words": (npy("no header\n"), "plain arrays"),
    "a header of code": (npy("__import__('os').abort()\n"), "plain arrays"),
    "nothing": (b"", "plain arrays"),
}


@pytest.mark.parametrize("name", HEIGHTS)
def test_arrays_that_are_no_map(name: str, tmp_path: Path) -> None:
    content, words = HEIGHTS[name]
    assert words in refusal(trb.load_height_map, archive(tmp_path / "m.npz", content))


def test_members_that_inflate_without_end(tmp_path: Path) -> None:
    """10 MB in 10 kB, four times; what is inflated is what the header says."""
    path = tmp_path / "m.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for key in ("height", "pitch_x", "pitch_y", "more"):
            with file.open(f"{key}.npy", "w") as entry:
                entry.write(npy(described((2, 2) if key == "height" else ()), np.arange(4.0).tobytes()))
                for _ in range(10):
                    entry.write(bytes(1_000_000))
    inflated = 0
    whole = zipfile.ZipExtFile.read

    def counted(self, n: int | None = -1) -> bytes:
        nonlocal inflated
        content = whole(self, n)
        inflated += len(content)
        return content

    zipfile.ZipExtFile.read = counted
    try:
        refusal(trb.load_height_map, path)  # pitches of 0
    finally:
        zipfile.ZipExtFile.read = whole
    assert inflated < 2000


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_members_compressed_otherwise(method: int, tmp_path: Path) -> None:
    assert "plain arrays" in refusal(trb.load_height_map, archive(tmp_path / "m.npz", GOOD, method))


def changed(path: Path, at_local: int, at_directory: int, value: int) -> Path:
    """The archive with one field of two bytes set in all headers of its members."""
    content = bytearray(path.read_bytes())
    for signature, at in ((b"PK\3\4", at_local), (b"PK\1\2", at_directory)):
        place = content.find(signature)
        while place >= 0:
            content[place + at : place + at + 2] = struct.pack("<H", value)
            place = content.find(signature, place + 1)
    path.write_bytes(content)
    return path


def test_archives_that_are_encrypted_unknown_or_false(tmp_path: Path) -> None:
    good = archive(tmp_path / "good.npz", GOOD)
    assert trb.load_height_map(good).height.shape == (2, 2)

    def copy() -> Path:
        path = tmp_path / "m.npz"
        path.write_bytes(good.read_bytes())
        return path

    for at_local, at_directory, value in ((6, 8, 1), (6, 8, 1 + 64), (8, 10, 99), (8, 10, 12), (6, 8, 32)):
        assert "plain arrays" in refusal(trb.load_height_map, changed(copy(), at_local, at_directory, value))
    content = bytearray(good.read_bytes())
    for cut in (30, len(content) // 2, len(content) - 10):
        (tmp_path / "m.npz").write_bytes(content[:cut])
        assert "plain arrays" in refusal(trb.load_height_map, tmp_path / "m.npz")
    place = content.find(b"PK\1\2")
    content[place + 24 : place + 28] = b"\xff" * 4  # a size of 4 GB
    (tmp_path / "m.npz").write_bytes(content)
    assert trb.load_height_map(tmp_path / "m.npz").height.shape == (2, 2)


def test_an_archive_of_very_many_members(tmp_path: Path) -> None:
    entry = b"PK\1\2" + bytes(24) + struct.pack("<H", 4) + bytes(16) + b"name"
    directory = entry * (3_000_000 // len(entry))
    end = b"PK\5\6" + bytes(4) + struct.pack("<HHII", 65535, 65535, len(directory), 0) + bytes(2)
    (tmp_path / "m.npz").write_bytes(directory + end)
    assert "plain arrays" in refusal(trb.load_height_map, tmp_path / "m.npz")


def test_damaged_archives(tmp_path: Path) -> None:
    """One byte changed anywhere: a map or a sentence."""
    good = archive(tmp_path / "good.npz", GOOD).read_bytes()
    rng = np.random.default_rng(0)
    path, refused = tmp_path / "m.npz", 0
    for place in range(0, len(good), 5):
        content = bytearray(good)
        content[place] ^= int(rng.integers(1, 256))
        path.write_bytes(content)
        try:
            trb.load_height_map(path)
        except trb.HeightMapError:
            refused += 1
    assert refused > 50


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0,0\n" * 5000, "at most 4096 × 4096 points"),
        ("0," * 400_000 + "0\n", "at most 4096 × 4096 points"),
        ("# pitch_x = 1\n# pitch_y = 1\n" + "\n" * 900_000, "must be a grid"),
        ("# pitch_x = " + "1" * 900_000 + "\n0,1\n2,3\n", "pitch_y is missing"),
        ("# pitch_y = 1\n# pitch_x = " + "1" * 900_000 + "\n0,1\n2,3\n", "pitch_x = 1111"),
        ("9" * 900_000 + ",1\n2,3\n# pitch_x = 1\n# pitch_y = 1\n", "height[0, 0] = inf"),
        ("\0,1\n", "line 1 holds no number"),
    ],
    ids=["rows", "columns", "lines", "no pitch", "long pitch", "long number", "nul"],
)
def test_texts_that_are_no_map(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text(text)
    assert words in refusal(trb.load_height_map, tmp_path / "m.csv")


def test_maps_named_in_a_scene(tmp_path: Path) -> None:
    scene = tmp_path / "s.toml"
    for name, words in (
        ("x" * 5000 + ".npz", "name too long"),
        ("p.npz", "is a pipe"),
        ("/dev/zero", "a file .npz or"),
    ):
        scene.write_text(f'bearing = "32008J"\n[load]\nradial = 1.0\naxial = 1.0\n[[spall]]\nheight_map = "{name}"\n')
        if name == "p.npz":
            os.mkfifo(tmp_path / name)
        assert words in refusal(scene_file.read, scene)


@pytest.mark.parametrize("command", ["run", "contact", "check", "accuracy", "sweep", "fit", "measured"])
def test_the_command_line_says_so(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = tmp_path / "good.toml"
    good.write_text(scene_file.example("spall"))
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in ("/dev/zero", str(pipe), "x" * 5000, str(tmp_path)):
        arguments = {
            "sweep": ["sweep", path, "--dry-run"],
            "fit": ["fit", path, path],
            "measured": ["fit", str(good), path],
        }.get(command, [command, path])
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert said.startswith("difftrb: ")
        assert said.count("\n") == 1
        assert "Traceback" not in said
