"""Scene files: TOML in, a `Scene` out; what is wrong with a file is one sentence with file, key, value and range."""

from __future__ import annotations

import dataclasses
import functools
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

from annotated_types import Interval, Unit
from pydantic import TypeAdapter

from difftrb.contact import height_map
from difftrb.contact.height_map import HeightMap
from difftrb.core import bad_input, geometry
from difftrb.core.bad_input import shown
from difftrb.core.bearing_checks import across
from difftrb.core.geometry import DESIGN_LOAD, FILE_RULES, LineContact, Real, Spall, TaperedBearing
from difftrb.core.status import SceneError
from difftrb.law import base as laws
from difftrb.ring import effect_base, effects
from difftrb.ring.catalogue_inference import CatalogueBearing
from difftrb.ring.effect_base import Effect
from difftrb.ring.load import Load
from difftrb.scene import checks
from difftrb.scene.file_schema import in_full, validated
from difftrb.scene.scene import COARSEST, DEFAULT_LAW, Definition, DesignLoad, Phase, Scene

PACKAGED_MAPS = ("spall_map.npz",)
DEEPEST = 32
"""Points of a line of a scene file, without those of numbers: no key has so many parts."""


class NoEquilibriumError(SceneError):
    """A scene that is well formed but has no solution."""

    exit_code = 1


@dataclasses.dataclass(frozen=True)
class ContactTable:
    """`[contact]`: the roller law and the single contact of `difftrb contact`.

    Attributes:
      law: of the rollers: "auto", "table", "direct", "power", "liu2018" or "palmgren".
      design_load: Q_d of the logarithmic crown (Liu et al. 2018, eq. 2); the default is the value with which Table 2
        comes out.
      accuracy: relative, of the approach: 1e-2 … 1e-4 (of `difftrb contact` and in Python to 1e-5). With law "auto" of
        stiffness and peak load, 1e-1 … 1e-3.
      load: roller load, for `difftrb contact` alone.
      offset: of the first spall's centre in the rolling direction, for `difftrb contact` alone; further spalls stand as
        far from it as their `angle`s.
      tilt: of the roller about its middle, for `difftrb contact` alone.
    """

    __pydantic_config__ = FILE_RULES

    law: str = DEFAULT_LAW
    design_load: DesignLoad = DESIGN_LOAD
    accuracy: Annotated[float, Interval(ge=1e-5, le=1e-1)] = dataclasses.field(default=1e-3, metadata={"static": True})
    load: Annotated[Real, Interval(ge=1e-3, le=1e7), Unit("N")] = 3000.0
    offset: Annotated[Real, Interval(ge=-1000.0, le=1000.0), Unit("mm")] = 0.0
    tilt: Annotated[Real, Interval(ge=-0.1, le=0.1), Unit("rad")] = 0.0


@dataclasses.dataclass(frozen=True)
class StiffnessTable:
    """`[stiffness]`: which stiffness, and where the rollers stand.

    Attributes:
      definition: "tangent" dF/du or "secant" F/u (Liu et al. 2018, Fig. 17 is secant).
      phase: cage angle of roller 0 from the load line, or "mean": all results averaged over one roller pitch of cage
        phases, with least and largest.
    """

    __pydantic_config__ = FILE_RULES

    definition: Definition = "tangent"
    phase: Phase | Literal["mean"] = 0.0


@dataclasses.dataclass(frozen=True)
class SceneFile:
    """A whole scene file, table by table. After `parse`, a `HeightMap` may stand among the spalls, `effects` are those
    that `[effects]` names, and `catalogue` is what the bearing was estimated from, if it was."""

    __pydantic_config__ = FILE_RULES

    bearing: TaperedBearing
    load: Load
    spall: tuple[Spall, ...] = ()
    contact: ContactTable = ContactTable()
    stiffness: StiffnessTable = StiffnessTable()
    effects: tuple[Effect, ...] = ()
    catalogue: CatalogueBearing | None = None

    def scene(self) -> Scene:
        """The scene this file describes."""
        contact, stiffness = self.contact, self.stiffness
        return Scene(
            self.bearing, self.load, self.spall, contact.law, contact.design_load, contact.accuracy,
            stiffness.definition, stiffness.phase, self.effects,
        )  # fmt: skip

    def single_contact(self) -> dict[str, Any]:
        """What `solve_contact` is given for the single contact, by its names: with the inner raceway if the first spall
        lies there, else with the outer. The first spall is at `contact.offset` [mm] from the contact's middle, the
        others as far from it as their angles say."""
        table, spalls, radius = self.contact, self.spall, geometry.arc_radius(self.bearing)
        raceway = "inner" if spalls and spalls[0].surface == "inner" else "outer"
        offsets = tuple(table.offset + (spall.angle - spalls[0].angle) * radius for spall in spalls)
        return {"contact": LineContact.of(self.bearing, raceway, table.design_load), "load": table.load,
                "spall": spalls, "offset": offsets, "accuracy": table.accuracy, "tilt": table.tilt}  # fmt: skip


def load_scene(path: str | Path) -> Scene:
    """Read a scene file; `SceneError` (a ValueError) says in one sentence what is wrong with it."""
    file = read(path)
    check_ring(file, path)
    return file.scene()


def example(name: str = "spall") -> str:
    """The text of a packaged scene; `SceneError` lists the names there are."""
    texts = bad_input.packaged(".toml")
    if name not in texts:
        raise SceneError(f"no example named {name!r}; there are {', '.join(texts)}")
    return texts[name]


def example_names() -> list[str]:
    """Names of the packaged scenes."""
    return list(bad_input.packaged(".toml"))


def read(path: str | Path) -> SceneFile:
    """Read and check a scene file, table by table and across tables; raises `SceneError`."""
    return parse(text_of(path), path)


def text_of(path: str | Path) -> str:
    """The text of a scene file, at most 1 MB; raises `SceneError`."""
    return bad_input.text_of(path, "a scene file", SceneError)


def parse(text: str, path: str | Path = "scene") -> SceneFile:
    """Check the text of a scene file; `path` names it in errors. Raises `SceneError`."""
    _deep(text, path)
    try:
        content: dict[str, Any] = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError; so are numbers without end
        reason = str(error).splitlines()[0][:200]
        if twice := re.match(r"Cannot overwrite a value \(at line (\d+)", reason):
            key = text.splitlines()[int(twice[1]) - 1].split("=")[0].strip()
            raise SceneError(f"{path}: line {twice[1]}: {shown(key)} is named twice; name it once") from None
        line = re.search(r"at line (\d+)", reason)
        comma = line is not None and re.search(r"=\s*[+-]?\d+,\d", text.splitlines()[int(line[1]) - 1])
        more = "; write decimals with a point" if comma else ""
        raise SceneError(f"{path}: is not TOML that can be read: {reason}{more}") from None
    content.pop("sweep", None)  # for `sweep_file`
    return from_content(content, path)


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
    file = _as_read(validated(_adapter(kinds), content, path, _schema(kinds)), kinds)
    if (sentence := across(file.bearing, file.spall)) is not None:
        raise SceneError(f"{path}: {sentence}")
    spalls: list[Any] = list(file.spall)
    for i, name in maps.items():
        spalls[i] = _loaded(name, spalls[i], f"{path}: spall.{i}.height_map", Path(path).parent)
    return dataclasses.replace(file, spall=tuple(spalls), catalogue=catalogue)


@functools.cache
def _schema(kinds: tuple[type[Effect], ...]) -> type:
    """Of scene files that may name these effects."""
    hints, table = get_type_hints(SceneFile, include_extras=True), effect_base.file_table(kinds)
    own = [field for field in dataclasses.fields(SceneFile) if field.name not in ("effects", "catalogue")]
    rows: list[Any] = [(field.name, hints[field.name], dataclasses.field(default=field.default)) for field in own]
    rows.append(("effects", table, dataclasses.field(default_factory=table)))
    rules = {"__pydantic_config__": FILE_RULES}
    return dataclasses.make_dataclass("SceneFile", rows, frozen=True, namespace=rules)


@functools.cache
def _adapter(kinds: tuple[type[Effect], ...]) -> TypeAdapter[Any]:
    """Made once, which takes longer than to check a file, and only if a file is read."""
    return TypeAdapter(_schema(kinds))


def _as_read(read: Any, kinds: tuple[type[Effect], ...]) -> SceneFile:
    """The file with the effects that it names."""
    tables: dict[str, Any] = {field.name: getattr(read, field.name) for field in dataclasses.fields(read)}
    every = (getattr(read.effects, kind.key) for kind in kinds)
    tables["effects"] = tuple(one for one in every if one is not None)
    return SceneFile(**tables)


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
