"""Measured stiffness and its loss, row by row: CSV in, `Measurement`s out; what is wrong with a row is one sentence."""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Interval, Unit
from pydantic import TypeAdapter, ValidationError

from difftrb.core import bad_input, fields, geometry
from difftrb.core.bad_input import allowed, did_you_mean, shown
from difftrb.core.geometry import FILE_RULES, Real
from difftrb.core.status import DifftrbError
from difftrb.ring.ring import needed_axial, too_light
from difftrb.scene.scene import Definition, Phase, Scene

Quantity = Literal["radial_loss", "axial_loss", "radial_stiffness", "axial_stiffness"]
NEEDED = ("radial", "axial", "quantity", "value")
ADVICE = {
    "radial": "give the radial load of this row in N",
    "axial": "give the axial load of this row in N",
    "quantity": "name what was measured",
    "value": "give a loss in percent of the healthy stiffness, a stiffness in N/mm",
    "sigma": "leave it empty in all rows if it is not known",
    "definition": "leave it empty for the scene's own",
    "phase": "leave it empty for the scene's own",
    "speed_rpm": "leave it empty for a bearing at rest",
}


class MeasuredError(DifftrbError, ValueError):
    """Measurements that cannot be used; the message is one sentence."""


@dataclasses.dataclass(frozen=True)
class Measurement:
    """One measured number.

    Attributes:
      radial, axial: the load under which it was measured [N], 0…1e7.
      quantity: "radial_loss" or "axial_loss" (of stiffness, in percent of the healthy bearing's), "radial_stiffness"
        or "axial_stiffness" [N/mm].
      value: what was measured [%, or N/mm].
      sigma: its standard deviation in the same unit; None in all rows: estimated from how the fit misses them.
      definition: "tangent" or "secant"; None is the scene's.
      phase: cage angle of roller 0 from the load line [rad], or "mean" over one roller pitch; None is the scene's.
      speed_rpm: must be 0 in this version.
    """

    __pydantic_config__ = FILE_RULES

    radial: Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]
    axial: Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]
    quantity: Quantity
    value: Annotated[Real, Interval(ge=-1e10, le=1e10)]
    sigma: Annotated[Real, Interval(ge=1e-9, le=1e10)] | None = None
    definition: Definition | None = None
    phase: Phase | Literal["mean"] | None = None
    speed_rpm: Annotated[Real, Interval(ge=0.0, le=1e6), Unit("rev/min")] = 0.0

    @property
    def is_loss(self) -> bool:
        """Whether it is a loss [%] and not a stiffness."""
        return self.quantity.endswith("loss")

    @property
    def unit(self) -> str:
        """Of value and sigma."""
        return "%" if self.is_loss else "N/mm"


ROW = TypeAdapter(Measurement)
COLUMNS = tuple(field.name for field in dataclasses.fields(Measurement))


def load_measured(path: str | Path) -> tuple[Measurement, ...]:
    """Read measurements from a CSV file; `MeasuredError` (a ValueError) says in one sentence what is wrong with it.

    Columns as the fields of `Measurement`, in any order, named in the first line; radial, axial, quantity and value are
    needed. Lines that begin with # are comments. At most 1 MB.
    """
    return parse(bad_input.text_of(path, "a table of measurements", MeasuredError), path)


def example() -> str:
    """The text of the packaged measurements."""
    return bad_input.packaged(".csv")["measured"]


def parse(text: str, path: str | Path = "measured") -> tuple[Measurement, ...]:
    """Check the text of a table of measurements; `path` names it in errors. Raises `MeasuredError`."""
    numbered = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and line.strip()[0] != "#"]
    if not numbered:
        raise MeasuredError(f"{path}: holds no rows; give a line of column names ({', '.join(NEEDED)} …) and rows")
    cells = [_cells(line, f"{path}: line {number}") for number, line in numbered]
    names = cells[0]
    _check_header(names, path)
    if len(cells) < 2:
        raise MeasuredError(f"{path}: holds column names but no rows")
    rows = []
    for k, ((line, _), row) in enumerate(zip(numbered[1:], cells[1:], strict=True), 1):
        rows.append(_row(names, row, f"{path}: row {k} (line {line})"))
    return tuple(rows)


def _cells(line: str, where: str) -> list[str]:
    """The cells of one line, on which every cell that is quoted has to end."""
    try:
        (row,) = csv.reader([line], strict=True)
    except csv.Error as error:
        raise MeasuredError(f"{where}: is not CSV that can be read: {error}; close every quote on its line") from None
    return [cell.strip() for cell in row]


def _check_header(names: list[str], path: str | Path) -> None:
    if len(names) == 1 and any(c in names[0] for c in ";\t"):
        raise MeasuredError(f"{path}: columns must be separated by commas, and decimals written with a point")
    for name in names:
        if name not in COLUMNS:
            raise MeasuredError(f"{path}: column {shown(name)} is not known; {did_you_mean(name, COLUMNS)}")
        if names.count(name) > 1:
            raise MeasuredError(f"{path}: column {shown(name)} stands twice; keep one of them")
    for name in NEEDED:
        if name not in names:
            raise MeasuredError(f"{path}: column {name} is missing: {ADVICE[name]}")


def _row(names: list[str], cells: list[str], where: str) -> Measurement:
    """One row; `where` begins its sentence."""
    if len(cells) != len(names):
        raise MeasuredError(
            f"{where}: has {len(cells)} cells where the first line has {len(names)}; separate columns by commas and "
            "write decimals with a point"
        )
    content: dict[str, Any] = {name: _cell(cell) for name, cell in zip(names, cells, strict=True) if cell}
    try:
        row = ROW.validate_json(json.dumps(content))  # as JSON, where strictness lets a table become a dataclass
    except ValidationError as error:
        column = str(error.errors()[0]["loc"][0])
        value = f"= {shown(content[column])}" if column in content else "is empty"
        raise MeasuredError(
            f"{where}: {column} {value}: must be {allowed(Measurement, [column])}; {ADVICE[column]}"
        ) from None
    return check(row, where)


def _cell(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


def check(row: Measurement, where: str) -> Measurement:
    """The row, if its columns are within their ranges and fit together; else a `MeasuredError` that begins with
    `where`."""
    for field in fields.fields_of(Measurement):
        sentence = fields.of_field(field, getattr(row, field.name), field.name)
        if sentence is not None:
            raise MeasuredError(f"{where}: {sentence}; {ADVICE[field.name]}")
    if row.is_loss and row.value >= 100.0:
        raise MeasuredError(f"{where}: value = {row.value:g}: a loss must be below 100 %; {ADVICE['value']}")
    if not row.is_loss and row.value <= 0.0:
        raise MeasuredError(f"{where}: value = {row.value:g}: a stiffness must be above 0 N/mm; {ADVICE['value']}")
    if row.speed_rpm != 0.0:
        raise MeasuredError(
            f"{where}: speed_rpm = {row.speed_rpm:g}: must be 0: the fit of this version knows no effect of speed; "
            "leave rows at speed out, or set 0 if speed did not matter"
        )
    return row


def check_loads(scene: Scene, rows: Sequence[Measurement], path: str = "measurements") -> None:
    """Refuse rows under which the ring has no equilibrium or the stiffness asked for does not exist."""
    for k, row in enumerate(rows, 1):
        phase = scene.phase if row.phase is None else row.phase
        worst = phase if isinstance(phase, float | int) else 0.5 * geometry.roller_pitch(scene.bearing)
        needed = float(needed_axial(scene.bearing, row.radial, worst))
        where = f"{path}: row {k}"
        if (sentence := too_light(row.axial, row.radial, needed)) is not None:
            raise MeasuredError(f"{where}: {sentence}; check both loads of this row")
        if (row.definition or scene.definition) == "secant" and row.radial == 0.0 and row.quantity[:6] == "radial":
            raise MeasuredError(
                f"{where}: quantity = {row.quantity!r}: a secant radial stiffness F/u needs a radial load; give "
                "definition = tangent, or leave the row out"
            )
