"""Tables of a scene file as dataclasses; an unknown key, or a value out of range, is refused in one sentence. What a
file's `bearing` may be: a name, a catalogue's line, or a table in full."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from difftrb.core import packaged_bearings
from difftrb.core.bad_input import UNKNOWN_KEY, in_one_sentence
from difftrb.core.geometry import FILE_RULES, TaperedBearing
from difftrb.core.status import SceneError
from difftrb.ring.catalogue_inference import CatalogueBearing, estimated
from difftrb.ring.catalogue_relations import Catalogue

TAKES = {
    "bearing": f"a name ({', '.join(map(repr, packaged_bearings.BEARINGS))}), a catalogue's {{ d, D, T, e }} or a "
    "[bearing] table"
}
"""What keys take of which annotations do not tell all."""


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
