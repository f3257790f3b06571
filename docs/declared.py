"""Tables of the pages that the package's declarations hold: `python docs/declared.py` writes them there.

In a page they stand between `<!-- declared: NAME -->` and `<!-- end -->`; `tests/test_docs.py` holds that they are up
to date. What is registered in the package, or a key that is declared, needs no other mention.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from difftrb.core import input_errors
from difftrb.core.geometry import Spall, TaperedBearing
from difftrb.fits.parameters import PARAMETERS
from difftrb.law.base import LAWS
from difftrb.ring import effects
from difftrb.ring.catalogue_relations import Catalogue
from difftrb.ring.load import Load
from difftrb.scene.file_schema import ContactTable, StiffnessTable
from difftrb.sweeps import outputs

FOLDER = Path(__file__).parent
TABLES = (
    ("bearing", "bearing.", TaperedBearing),
    ("load", "load.", Load),
    ("spall", "[[spall]] ", Spall),
    ("contact", "contact.", ContactTable),
    ("stiffness", "stiffness.", StiffnessTable),
)
"""Tables of a scene file, how their keys are written, and where they are declared."""
SAID_ELSEWHERE = re.compile(r" \[[^\]]+\](, [−\d][^\s,;]*…[^\s,;]*?(?=[,.;]))?")
"""Units and ranges of docstrings, which have columns of their own."""


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """In Markdown."""
    lines = [list(heads), *map(list, rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def first_paragraph(kind: type) -> str:
    """Of a docstring."""
    return " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())


def meanings(kind: type) -> dict[str, str]:
    """What a docstring's "Attributes:" say, by name."""
    _, _, text = (inspect.getdoc(kind) or "").partition("Attributes:\n")
    found: dict[str, str] = {}
    for entry in re.split(r"\n(?=  \w)", f"\n{text}"):
        names, colon, words = entry.strip().partition(": ")
        if colon:
            found |= dict.fromkeys(names.split(", "), " ".join(words.split()))
    return found


def keys(kind: type, before: str) -> list[tuple[str, str, str, str]]:
    """Every key of a dataclass: its name, what it takes, its default, what it means."""
    words, rows = meanings(kind), []
    for field in dataclasses.fields(kind):
        default = "required" if field.default is dataclasses.MISSING else _shown(field.default)
        meaning = SAID_ELSEWHERE.sub("", words[field.name])
        rows.append((f"`{before}{field.name}`", _takes(kind, field.name), default, meaning))
    return rows


def _takes(kind: type, name: str) -> str:
    if (kind, name) == (ContactTable, "law"):
        return "a law's name"
    if (kind, name) == (StiffnessTable, "phase"):
        return f"{input_errors.allowed(kind, [name]).replace(' or one of', ', or')}"
    return input_errors.allowed(kind, [name]).replace("a number in ", "")


def _shown(default: Any) -> str:
    return (
        "–"
        if default is None
        else f"`{default:g}`"
        if isinstance(default, float)
        else f"`{default!r}`".replace("'", '"')
    )


def scene_keys() -> str:
    """All keys of a scene file but those of effects and sweeps."""
    rows = [row for _, before, kind in TABLES for row in keys(kind, before)]
    return table(("key", "takes", "default", "meaning and source"), rows)


def catalogue_keys() -> str:
    """All keys of a scene file's `bearing` as a catalogue's line; of `bearing_from_catalogue`, too."""
    return table(("key", "takes", "default", "meaning"), keys(Catalogue, ""))


def effect_keys() -> str:
    """Every effect: what it is, and its keys."""
    parts = []
    for kind in effects.registered():
        parts.append(f"### `effects.{kind.key}`\n\n{first_paragraph(kind)}")
        if rows := keys(kind, ""):
            parts.append(table(("key", "takes", "default", "meaning"), rows))
    return "\n\n".join(parts)


def law_properties() -> str:
    """What laws are made by and for."""
    rows = [
        (f"`{kind.name}`", kind.summary, "yes" if kind.solves else "no", "yes" if kind.inner else "no",
         f"{kind.longest(1.0):.2g}" if kind.bearing is None else f"of {kind.bearing} alone",
         "one scene" if kind.one_scene else "any scene of its contact", "yes" if kind.promises else "no")
        for _, kind in sorted(LAWS.items())
    ]  # fmt: skip
    heads = ("law", "what it is", "solves contacts", "knows the inner raceway", "longest spall by the roller's length",
             "made for", "keeps its error")  # fmt: skip
    return table(heads, rows)


def fit_parameters() -> str:
    """What a fit can find."""
    rows = [(f"`{one.name}`", one.unit, first_paragraph(type(one))) for one in PARAMETERS.values()]
    return table(("parameter", "unit", "what it is, and the range that is searched"), rows)


def sweep_outputs() -> str:
    """What a sweep can be asked for."""
    rows = [
        (f"`{one.name}`", one.unit or "–", ", ".join(one.dims) or "–", one.source) for one in outputs.OUTPUTS.values()
    ]
    return table(("output", "unit", "its own dimensions", "of"), rows)


DECLARED: dict[str, Callable[[], str]] = {
    made.__name__: made
    for made in (scene_keys, catalogue_keys, effect_keys, law_properties, fit_parameters, sweep_outputs)
}


def filled(text: str) -> str:
    """A page's text with its tables as they are declared."""

    def block(found: re.Match[str]) -> str:
        return f"<!-- declared: {found[1]} -->\n\n{DECLARED[found[1]]()}\n\n<!-- end -->"

    return re.sub(r"<!-- declared: (\w+) -->.*?<!-- end -->", block, text, flags=re.DOTALL)


def main() -> None:
    """Write all tables."""
    for page in sorted(FOLDER.glob("**/*.md")):
        before = page.read_text(encoding="utf-8")
        if (after := filled(before)) != before:
            page.write_text(after, encoding="utf-8")


if __name__ == "__main__":
    main()
