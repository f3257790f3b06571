"""Tables of a scene file as dataclasses; an unknown key, or a value out of range, is refused in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from difftrb.core import packaged_bearings
from difftrb.core.bad_input import UNKNOWN_KEY, in_one_sentence
from difftrb.core.status import SceneError

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
