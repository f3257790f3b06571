"""Scene files: TOML in, a `Scene` out; what is wrong with a file is one sentence with file, key, value and range."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from pathlib import Path
from typing import Any

from difftrb.contact import height_map
from difftrb.contact.height_map import HeightMap
from difftrb.core import input_errors
from difftrb.core.bearing_checks import across
from difftrb.core.geometry import Spall
from difftrb.core.input_errors import shown
from difftrb.core.status import SceneError
from difftrb.law import base as laws
from difftrb.ring import effects
from difftrb.scene import checks, file_schema
from difftrb.scene.file_schema import SceneFile, in_full, validated
from difftrb.scene.scene import COARSEST, Scene

PACKAGED_MAPS = ("spall_map.npz",)
DEEPEST = 32
"""Points of a line of a scene file, without those of numbers: no key has so many parts."""


class NoEquilibriumError(SceneError):
    """A scene that is well formed but has no solution."""

    exit_code = 1


def load_scene(path: str | Path) -> Scene:
    """Read a scene file; `SceneError` (a ValueError) says in one sentence what is wrong with it."""
    file = read(path)
    check_ring(file, path)
    return file.scene()


def example(name: str = "spall") -> str:
    """The text of a packaged scene; `SceneError` lists the names there are."""
    texts = input_errors.packaged(".toml")
    if name not in texts:
        raise SceneError(f"no example named {name!r}; there are {', '.join(texts)}")
    return texts[name]


def example_names() -> list[str]:
    """Names of the packaged scenes."""
    return list(input_errors.packaged(".toml"))


def read(path: str | Path) -> SceneFile:
    """Read and check a scene file, table by table and across tables; raises `SceneError`."""
    return parse(text_of(path), path)


def text_of(path: str | Path) -> str:
    """The text of a scene file, at most 1 MB; raises `SceneError`."""
    return input_errors.text_of(path, "a scene file", SceneError)


def parse(text: str, path: str | Path = "scene") -> SceneFile:
    """Check the text of a scene file; `path` names it in errors. Raises `SceneError`."""
    _deep(text, path)
    try:
        content: dict[str, Any] = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError; so are numbers without end
        reason = str(error).splitlines()[0][:200]
        if twice := re.match(r"Cannot (?:overwrite a value|declare .* twice) \(at line (\d+)", reason):
            key = text.split("\n")[int(twice[1]) - 1].split("=")[0].strip()
            raise SceneError(f"{path}: line {twice[1]}: {shown(key)} is named twice; name it once") from None
        line = re.search(r"at line (\d+)", reason)
        comma = line is not None and re.search(r"=\s*[+-]?\d+,\d", text.split("\n")[int(line[1]) - 1])
        more = "; write decimals with a point" if comma else ""
        raise SceneError(f"{path}: is not TOML that can be read: {reason}{more}") from None
    content.pop("sweep", None)  # for `sweep_file`
    return from_content(content, path)


def has_sweep(text: str) -> bool:
    """Whether a scene file that `parse` takes has a table `[sweep]`, which is for `sweeps.sweep_file`."""
    return "sweep" in tomllib.loads(text)


def _deep(text: str, path: str | Path) -> None:
    """Refuse keys of very many parts: TOML's reader takes the square of their number in time and memory."""
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > DEEPEST and len(re.sub(r"\d\.\d|\.\.+|[^.]", "", line)) > DEEPEST:
            raise SceneError(
                f"{path}: line {number}: has more than {DEEPEST} points beside those of numbers: no key has so many "
                "parts; write keys as `difftrb example` does"
            )


def from_content(content: dict[str, Any], path: str | Path) -> SceneFile:
    """Check a scene file's tables, which are changed by it, as `parse` does its text."""
    _known_law(content, path)
    catalogue = in_full(content, path)
    if isinstance(content.get("spall"), dict):
        raise SceneError(f"{path}: [spall] is a list of tables; write [[spall]]")
    maps = _height_maps(content, path)
    kinds = effects.registered()
    file = file_schema.as_read(validated(file_schema.adapter(kinds), content, path, file_schema.of_files(kinds)), kinds)
    if (sentence := across(file.bearing, file.spall)) is not None:
        raise SceneError(f"{path}: {sentence}")
    spalls: list[Any] = list(file.spall)
    for i, name in maps.items():
        spalls[i] = _loaded(name, spalls[i], f"{path}: spall.{i}.height_map", Path(path).parent)
    return dataclasses.replace(file, spall=tuple(spalls), catalogue=catalogue)


def _height_maps(content: dict[str, Any], path: str | Path) -> dict[int, str]:
    """Names of height maps by the index of their spall, which keeps a stand-in for the sizes it does not have."""
    found: dict[int, str] = {}
    tables = content.get("spall")
    for i, table in enumerate(tables if isinstance(tables, list) else []):
        if not isinstance(table, dict) or "height_map" not in table:
            continue
        name = table.pop("height_map")
        if not isinstance(name, str) or not name or not name.isprintable():
            raise SceneError(f"{path}: spall.{i}.height_map = {shown(name)}: must be the name of a file .npz or .csv")
        for key in ("length", "width", "depth"):
            if key in table:
                raise SceneError(
                    f"{path}: spall.{i}.{key} = {shown(table[key])}: a height map has its own size; leave it out"
                )
        table |= {"length": 0.01, "width": 0.01}
        found[i] = name
    return found


def _loaded(name: str, place: Spall, key: str, folder: Path) -> HeightMap:
    """The map of a file beside the scene file or, if there is none, of a packaged one, put where `place` is."""
    file = folder / name
    try:
        if name in PACKAGED_MAPS and not file.exists():
            file = height_map.example_map(name)
        loaded = height_map.load_height_map(file, place.axial_offset, place.angle, place.surface)
        return dataclasses.replace(loaded, row=place.row)
    except height_map.HeightMapError as error:
        raise SceneError(f"{key} = {shown(name)}: {error}") from None


def _known_law(content: dict[str, Any], path: str | Path) -> None:
    """Refuse a law that cannot be named here."""
    contact = content.get("contact")
    if not isinstance(contact, dict) or "law" not in contact or contact["law"] in laws.names():
        return
    raise SceneError(f"{path}: contact.{laws.unknown(contact['law'])}")


def check_contact(file: SceneFile, path: str | Path) -> None:
    """Refuse what a single contact cannot have; raises `SceneError`."""
    if file.contact.accuracy > COARSEST:
        raise SceneError(
            f"{path}: contact.accuracy = {file.contact.accuracy:g}: must be at most {COARSEST:g} for `difftrb contact`"
        )
    first = file.spall[0] if file.spall else None
    for i, spall in enumerate(file.spall):
        if first is not None and spall.surface != first.surface:
            raise SceneError(
                f"{path}: spall.{i}.surface = {spall.surface!r}: all spalls of `difftrb contact` lie on one surface; "
                f"make it {first.surface!r}, or leave the spall out"
            )
        if first is not None and spall.surface != "outer" and spall.angle != first.angle:
            raise SceneError(
                f"{path}: spall.{i}.angle = {spall.angle:g}: an angle is a distance on the 'outer' raceway only; "
                f"make it that of the first spall, {first.angle:g} rad"
            )


def check_ring(file: SceneFile, path: str | Path) -> None:
    """Refuse what the contact alone could do but the ring cannot; raises `SceneError`."""
    try:
        sentence = checks.wrong(file.scene())
    except SceneError as error:  # effects that exclude each other
        sentence = str(error)
    if sentence is not None:
        raise SceneError(f"{path}: {sentence}")
    sentence = checks.not_held(file.scene(), "load.")
    if sentence is not None:
        raise NoEquilibriumError(f"{path}: {sentence}")
