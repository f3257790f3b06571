"""The README's tables of laws, effects, fit parameters and outputs say what their registers say."""

import dataclasses
import inspect
import re
from pathlib import Path
from typing import get_type_hints

import pytest

from difftrb.fits.parameters import PARAMETERS
from difftrb.law import base as laws
from difftrb.ring import effects
from difftrb.sweeps import outputs

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
pytestmark = pytest.mark.portable


def rows_below(heading: str) -> list[list[str]]:
    """Cells of the rows of the table that begins with this heading."""
    lines = README[README.index(heading) :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def parameter_table() -> list[str]:
    """The table of what a fit can find, from each parameter's own words."""
    rows = [f"| `{p.name}` | {p.unit} | {_first_paragraph(type(p))} |" for p in PARAMETERS.values()]
    return ["| parameter | unit | what it is, and the range that is searched |", "|---|---|---|", *rows]


def output_table() -> list[str]:
    """The table of what a sweep can be asked for."""
    rows = [
        f"| `{one.name}` | {one.unit or '–'} | {', '.join(one.dims) or '–'} | {one.source} |"
        for one in outputs.registered().values()
    ]
    return ["| output | unit | its own dimensions | of |", "|---|---|---|---|", *rows]


def _first_paragraph(kind: type) -> str:
    return " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())


def test_laws() -> None:
    rows = {name.strip("`"): what for name, what, *_ in rows_below("| law | what it is")}
    assert set(rows) == set(laws.names())
    for name, kind in laws.LAWS.items():
        assert rows[name].startswith(f"{kind.summary}: "), name


def test_effects() -> None:
    rows = {name.strip("`"): what for name, what, *_ in rows_below("| `effects.` |")}
    kinds = {kind.key: kind for kind in effects.registered()}
    assert set(rows) == set(kinds)
    for key, kind in kinds.items():
        fields = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
        assert set(re.findall(r"`(\w+)`", rows[key])) - set(kinds) - set(laws.LAWS) == fields, key
        for name, hint in get_type_hints(kind, include_extras=True).items():
            if name in fields:
                assert all(unit in rows[key] for unit in re.findall(r"unit='([^']*)'", repr(hint))), (key, name)
        for other in kind.excludes:
            assert re.search(rf"`{key}` excludes[^;]*`{other}`", README.replace("\n", " ")), (key, other)


def test_fit_parameters() -> None:
    assert "\n".join(["", *parameter_table(), ""]) in README


def test_outputs() -> None:
    assert "\n".join(["", *output_table(), ""]) in README
