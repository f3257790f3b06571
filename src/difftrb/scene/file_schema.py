"""The schema of scene files: every table a dataclass; an unknown key, or a value out of range, is refused in one
sentence. What a file's `bearing` may be: a name, a catalogue's line, or a table in full."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

from annotated_types import Interval, Unit
from pydantic import TypeAdapter, ValidationError

from difftrb.core import geometry, packaged_bearings
from difftrb.core.geometry import DESIGN_LOAD, FILE_RULES, LineContact, Real, Spall, TaperedBearing
from difftrb.core.input_errors import UNKNOWN_KEY, in_one_sentence
from difftrb.core.status import SceneError
from difftrb.ring import effect_base
from difftrb.ring.catalogue_inference import CatalogueBearing, estimated
from difftrb.ring.catalogue_relations import Catalogue
from difftrb.ring.effect_base import Effect
from difftrb.ring.load import Load
from difftrb.scene.scene import DEFAULT_LAW, Definition, DesignLoad, Phase, Scene

TAKES = {
    "bearing": f"a name ({', '.join(map(repr, packaged_bearings.BEARINGS))}), a catalogue's {{ d, D, T, e }} or a "
    "[bearing] table"
}
"""What keys take of which annotations do not tell all."""


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


@functools.cache
def of_files(kinds: tuple[type[Effect], ...]) -> type:
    """Of scene files that may name these effects."""
    hints, table = get_type_hints(SceneFile, include_extras=True), effect_base.file_table(kinds)
    own = [field for field in dataclasses.fields(SceneFile) if field.name not in ("effects", "catalogue")]
    rows: list[Any] = [(field.name, hints[field.name], dataclasses.field(default=field.default)) for field in own]
    rows.append(("effects", table, dataclasses.field(default_factory=table)))
    rules = {"__pydantic_config__": FILE_RULES}
    return dataclasses.make_dataclass("SceneFile", rows, frozen=True, namespace=rules)


@functools.cache
def adapter(kinds: tuple[type[Effect], ...]) -> TypeAdapter[Any]:
    """Made once, which takes longer than to check a file, and only if a file is read."""
    return TypeAdapter(of_files(kinds))


def as_read(read: Any, kinds: tuple[type[Effect], ...]) -> SceneFile:
    """The file with the effects that it names."""
    tables: dict[str, Any] = {field.name: getattr(read, field.name) for field in dataclasses.fields(read)}
    every = (getattr(read.effects, kind.key) for kind in kinds)
    tables["effects"] = tuple(one for one in every if one is not None)
    return SceneFile(**tables)


def validated(adapter: TypeAdapter[Any], content: dict[str, Any], path: str | Path, schema: type) -> Any:
    """A file's tables as dataclasses; what is wrong with them is a `SceneError`."""
    try:  # as JSON, where strictness still lets a table become a dataclass and a list a tuple
        return adapter.validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        worst = min(error.errors(), key=lambda e: e["type"] not in UNKNOWN_KEY)  # a misspelt key explains a missing one
        raise SceneError(f"{path}: {in_one_sentence(worst, schema, TAKES)}") from None
    except RecursionError:
        raise SceneError(f"{path}: is nested too deeply for a scene") from None


def in_full(content: dict[str, Any], path: str | Path) -> CatalogueBearing | None:
    """Put a bearing's own table in place of its name, or of what its catalogue prints, in a file's tables; the latter
    brings the crown of its rollers, too, if `[contact]` has none. Returns what it was estimated from, if it was."""
    bearing = content.get("bearing")
    if isinstance(bearing, str):
        try:
            packaged = packaged_bearings.named(bearing, "a catalogue's { d, D, T, e } or a [bearing] table")
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None
        content["bearing"] = _table_of(packaged)
    if not isinstance(bearing, dict) or not {"d", "D", "T"} & set(bearing):
        return None
    read = validated(_catalogues(), {"bearing": bearing}, path, _CatalogueFile)
    try:
        catalogue = estimated(read.bearing)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    content["bearing"] = _table_of(catalogue.bearing)
    contact = content.setdefault("contact", {})
    if isinstance(contact, dict):
        contact.setdefault("design_load", catalogue.design_load)
    return catalogue


def _table_of(bearing: TaperedBearing) -> dict[str, Any]:
    return {key: value for key, value in dataclasses.asdict(bearing).items() if value is not None}


@dataclasses.dataclass(frozen=True)
class _CatalogueFile:
    """`bearing = { d = …, D = …, T = … }`."""

    __pydantic_config__ = FILE_RULES

    bearing: Catalogue


@functools.cache
def _catalogues() -> TypeAdapter[_CatalogueFile]:
    return TypeAdapter(_CatalogueFile)
