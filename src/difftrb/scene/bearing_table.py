"""What a file's `bearing` may be: a name, a catalogue's line, or a table in full."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from difftrb.core import packaged_bearings
from difftrb.core.geometry import FILE_RULES, TaperedBearing
from difftrb.core.status import SceneError
from difftrb.ring.catalogue import Catalogue
from difftrb.ring.catalogue_estimate import CatalogueBearing, estimated
from difftrb.scene.validation import validated


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
