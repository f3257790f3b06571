"""Tables of measurements: CSV in, `Measurement`s out; what is wrong with a table is one sentence.

A table is long, with a column `quantity` and one `value` a line, or wide, with a column for each quantity and as many
values a line as were measured. Columns may name their unit, as `radial [kN]` or `axial_stiffness [N/µm]`. Where columns
are separated by semicolons or tabs, decimals may have a comma.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, get_args

from pydantic import TypeAdapter, ValidationError

from difftrb.core import input_errors
from difftrb.core.input_errors import allowed, did_you_mean, shown
from difftrb.fits.measured import ADVICE, SIGMA, MeasuredError, Measurement, Origin, Quantity, check, so_many
from difftrb.fits.measured import column as heading

ROW = TypeAdapter(Measurement)
COLUMNS = tuple(field.name for field in dataclasses.fields(Measurement) if field.name != "origin")
QUANTITIES: tuple[str, ...] = get_args(Quantity)
LONG, WIDE = ("quantity", "value", "sigma"), (*QUANTITIES, *(quantity + SIGMA for quantity in QUANTITIES))
FORCE = {"N": 1.0, "kN": 1e3}
STIFFNESS = {"N/mm": 1.0, "N/µm": 1e3, "N/um": 1e3, "kN/mm": 1e3, "kN/µm": 1e6, "kN/um": 1e6, "N/m": 1e-3, "MN/m": 1e3}
SHARE = {"%": 1.0, "1": 100.0}
OTHERS = ";", "\t"
"""What may stand between columns in place of a comma."""
NUMBER = r"[+-]?[\d.,]*\d[\d.,]*([eE][+-]?\d+)?"
UNITS: Mapping[str, Mapping[str, float]] = {
    "radial": FORCE, "axial": FORCE, "phase": {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0},
    "speed_rpm": {"rev/min": 1.0, "rpm": 1.0}, "load_sigma": SHARE,
    **{name: SHARE if "loss" in name else STIFFNESS for name in WIDE},
}  # fmt: skip
"""By how much a number in a unit has to be multiplied, by column. Of `value` and `sigma` the quantity says it."""


class Column(NamedTuple):
    """A column's name and the unit that it gives, if any."""

    name: str
    unit: str | None


def load_measured(path: str | Path) -> tuple[Measurement, ...]:
    """Read measurements from a CSV file; `MeasuredError` (a ValueError) says in one sentence what is wrong with it.

    Columns as the fields of `Measurement`, in any order, named in the first line. `radial` and `axial` are needed, and
    either `quantity` and `value`, or a column for each quantity, say `radial_loss`, with its standard deviation in one
    named `radial_loss_sigma`; there an empty cell was not measured. A name may have its unit behind it in brackets:
    [kN], [N/µm] and other usual ones, [deg], [1] for a loss that is no percentage. Columns are separated by commas, or
    by semicolons or tabs with decimals as 1.5 or 1,5. Lines that begin with # are comments. At most 1 MB.
    """
    return parse(input_errors.text_of(path, "a table of measurements", MeasuredError), path)


def example() -> str:
    """The text of the packaged measurements."""
    return input_errors.packaged(".csv")["measured"]


def parse(text: str, path: str | Path = "measured") -> tuple[Measurement, ...]:
    """Check the text of a table of measurements; `path` names it in errors. Raises `MeasuredError`."""
    passed = re.compile(r"[\s;,]*$|\s*(#|sep=.$)", re.IGNORECASE)  # a spreadsheet may say first what parts columns
    numbered = [(n, line) for n, line in enumerate(re.split(r"\r\n?|\n", text), 1) if not passed.match(line)]
    if not numbered:
        raise MeasuredError(
            f"{path}: holds no rows; give a line of column names (radial, axial, quantity, value …) and rows"
        )
    between = next((each for each in OTHERS if each in numbered[0][1]), ",")
    (first, names), *lines = ((n, _cells(line, between, f"{path}: line {n}")) for n, line in numbered)
    if not names[-1]:  # a spreadsheet ends every line with what parts columns
        lines = [(n, row[:-1] if len(row) == len(names) and not row[-1] else row) for n, row in lines]
        names = names[:-1]
    columns = _header(names, f"{path}: line {first}")
    if not lines:
        raise MeasuredError(f"{path}: holds column names but no rows")
    _check_decimals(columns, lines, path, between)
    rows: list[Measurement] = []
    for line, row in lines:
        cells = row if between == "," else [_with_point(cell) for cell in row]
        rows.extend(_rows(columns, cells, str(path), line))
    return tuple(rows)


def _cells(line: str, between: str, where: str) -> list[str]:
    """The cells of one line, on which every cell that is quoted has to end."""
    try:
        (row,) = csv.reader([line], strict=True, delimiter=between)
    except csv.Error as error:
        raise MeasuredError(f"{where}: is not CSV that can be read: {error}; close every quote on its line") from None
    return [cell.strip() for cell in row]


def _check_decimals(columns: list[Column], lines: list[tuple[int, list[str]]], path: str | Path, between: str) -> None:
    """Refuse numbers with commas and points, one of which parts thousands, and loads in newton that have, one and all,
    one of them before their last three digits, where it may."""
    every = [(column, cell, f"{path}: line {line}: {column.name} = {cell}")
             for line, row in lines for column, cell in zip(columns, row, strict=False)
             if re.fullmatch(NUMBER, cell)]  # fmt: skip
    mixed = [where for _, cell, where in every if "." in cell]
    if between != "," and mixed and any("," in cell for _, cell, _ in every):
        raise MeasuredError(f"{mixed[0]}: numbers have a comma and a point: write decimals one way, and nothing "
                            "between thousands")  # fmt: skip
    loads = [(cell, where) for column, cell, where in every
             if column.name in ("radial", "axial") and column.unit in (None, "N") and cell.strip("0.,")]  # fmt: skip
    if loads and all(re.fullmatch(r"[1-9]\d{0,2}([.,]\d{3})+", cell) for cell, _ in loads):
        cell, where = loads[0]
        raise MeasuredError(f"{where} N may have a {'comma' if ',' in cell else 'point'} between thousands: write "
                            f"{re.sub('[.,]', '', cell)} if so, else not three decimals in all loads")  # fmt: skip


def _with_point(cell: str) -> str:
    """A cell with a point for a decimal comma."""
    return cell.replace(",", ".") if re.fullmatch(NUMBER, cell) else cell


def _header(cells: list[str], where: str) -> list[Column]:
    """The columns, if they are known, each once, and enough."""
    columns = [_column(cell, where) for cell in cells]
    names = [column.name for column in columns]
    for name in names:
        if names.count(name) > 1:
            raise MeasuredError(f"{where}: column {shown(name)} stands twice; keep one of them")
    wide = [name for name in names if name in QUANTITIES]
    if wide and (both := [name for name in LONG if name in names]):
        raise MeasuredError(
            f"{where}: column {both[0]} beside {wide[0]}: a table has either quantity and value, or a column for each "
            f"quantity, with {wide[0]}{SIGMA} for its sigma; keep one way"
        )
    for name in names:
        if name.endswith(SIGMA) and name in WIDE and name.removesuffix(SIGMA) not in names:
            raise MeasuredError(f"{where}: column {name} has no column {name.removesuffix(SIGMA)} beside it; add it")
    for name in ("radial", "axial", *(() if wide else LONG[:2])):
        if name not in names:
            raise MeasuredError(f"{where}: column {name} is missing: {ADVICE[name]}")
    return columns


def _column(cell: str, where: str) -> Column:
    found = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]", cell)
    name, unit = (found[1], found[2].strip().replace("μ", "µ")) if found else (cell, None)
    if name not in COLUMNS and name not in WIDE:
        raise MeasuredError(
            f"{where}: column {shown(name)} is not known; {did_you_mean(name, (*COLUMNS, *QUANTITIES), close=0.78)}"
        )
    known = {**STIFFNESS, **SHARE} if name in LONG[1:] else UNITS.get(name, {})
    if unit is not None and unit not in known:
        raise MeasuredError(f"{where}: column {name}: unit [{shown(unit)[1:-1]}] is not known; "
                            f"{'use one of ' + ', '.join(known) if known else 'it has none'}")  # fmt: skip
    return Column(name, unit)


def _rows(columns: list[Column], cells: list[str], path: str, line: int) -> Iterator[Measurement]:
    """What was measured on one line."""
    where = f"{path}: line {line}"
    if len(cells) != len(columns):
        raise MeasuredError(
            f"{where}: has {so_many(len(cells), 'cell')} where the first line has {len(columns)}: give every column a "
            "name, and between commas write decimals with a point"
        )
    content = {column: cell for column, cell in zip(columns, cells, strict=True) if cell}
    shared = {column: cell for column, cell in content.items() if column.name not in WIDE}
    quantities = [column for column in columns if column.name in QUANTITIES]
    if not quantities:
        yield _row(shared, Origin(path, line, "value"))
    elif not any(column in content for column in quantities):
        raise MeasuredError(f"{where}: holds no value; give what was measured, or leave the line out")
    for column in quantities:
        if column in content:
            own = {Column("quantity", None): column.name, Column("value", column.unit): content[column]}
            sigma = next((c for c in content if c.name == column.name + SIGMA), None)
            if sigma is not None:
                own[Column("sigma", sigma.unit or column.unit)] = content[sigma]
            yield _row({**shared, **own}, Origin(path, line, column.name))


def _row(content: dict[Column, str], origin: Origin) -> Measurement:
    """One measurement from its cells that are not empty."""
    where = f"{origin.path}: line {origin.line}"
    given: dict[str, Any] = {column.name: _cell(cell) for column, cell in content.items()}
    units = {column.name: column.unit for column in content if column.unit}
    if "value" in units:
        units.setdefault("sigma", units["value"])
    converted = dict(given)
    for name, unit in units.items():
        known = UNITS.get(str(given.get("quantity")), {}) if name in LONG else UNITS[name]
        if known and unit not in known:
            raise MeasuredError(f"{where}: {name} in [{unit}]: {given['quantity']} is in {' or '.join(known)}; name "
                                "the unit that fits, or use a column for each quantity")  # fmt: skip
        if isinstance(given.get(name), float) and known:
            converted[name] = given[name] * known[unit]
    try:
        row = ROW.validate_json(json.dumps(converted))  # as JSON, where strictness lets a table become a dataclass
    except ValidationError as error:
        column = str(error.errors()[0]["loc"][0])
        unit = f" [{units[column]}]" if column in units else ""
        value = f"= {shown(given[column])}{unit}" if column in given else "is empty"
        advice = ADVICE[column]
        if isinstance(given.get(column), str) and re.match(r"[+-]?\d", given[column]):
            advice = "write a number alone, with a decimal point; a unit goes into the first line, in brackets"
        elif column == "phase" and isinstance(given.get(column), float) and "phase" not in units:
            advice = "in degrees the column is named phase [deg]"
        raise MeasuredError(
            f"{where}: {heading(column, origin)} {value}: must be {allowed(Measurement, [column])}; {advice}"
        ) from None
    return check(dataclasses.replace(row, origin=origin))


def _cell(cell: str) -> float | str:
    try:
        return cell if "_" in cell else float(cell)  # as Python alone would write it
    except ValueError:
        return cell
