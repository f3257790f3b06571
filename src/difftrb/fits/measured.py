"""Measured stiffness and its loss, row by row, and in one sentence what is wrong with a row."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from annotated_types import Interval, Unit

from difftrb.core import fields
from difftrb.core.geometry import FILE_RULES, Real
from difftrb.core.status import DifftrbError
from difftrb.ring.load import Load
from difftrb.scene import checks
from difftrb.scene.scene import Definition, Phase, PitchMean, Scene

Quantity = Literal[
    "radial_loss", "axial_loss", "lateral_loss", "radial_stiffness", "axial_stiffness", "lateral_stiffness",
    "radial_axial_stiffness", "radial_lateral_stiffness", "lateral_axial_stiffness",
]  # fmt: skip
ENTRIES = {"radial": (0, 0), "axial": (2, 2), "lateral": (1, 1), "radial_axial": (0, 2), "radial_lateral": (0, 1),
           "lateral_axial": (1, 2)}  # fmt: skip
"""Of the stiffness matrix, by how a quantity begins."""
SIGMA = "_sigma"
"""Ends the column of a quantity's standard deviations, in a table with a column for each quantity."""
ADVICE = {
    "radial": "give the radial load of this row in N",
    "axial": "give the axial load of this row in N",
    "quantity": "name what was measured",
    "value": "give a loss in percent of the healthy stiffness, a stiffness in N/mm",
    "sigma": "leave it empty in all rows if it is not known",
    "definition": "leave it empty for the scene's own",
    "phase": "leave it empty for the scene's own",
    "speed_rpm": "leave it empty for a bearing at rest",
    "load_sigma": "leave it empty if the loads are known",
}


class MeasuredError(DifftrbError, ValueError):
    """Measurements that cannot be used; the message is one sentence."""


class Origin(NamedTuple):
    """Where a measurement was read: the path of its file, its line there from 1, and the column of its value."""

    path: str
    line: int
    column: str


@dataclasses.dataclass(frozen=True)
class Measurement:
    """One measured number.

    Attributes:
      radial, axial: the load under which it was measured [N], 0…1e7.
      quantity: "radial_loss", "axial_loss" or "lateral_loss" (of stiffness, in percent of the healthy bearing's),
        "radial_stiffness", "axial_stiffness", "lateral_stiffness", or of the matrix beside its diagonal
        "radial_axial_stiffness", "radial_lateral_stiffness", "lateral_axial_stiffness" [N/mm].
      value: what was measured [%, or N/mm].
      sigma: its standard deviation in the same unit; None in all rows: estimated from how the fit misses them.
      definition: "tangent" or "secant"; None is the scene's.
      phase: cage angle of roller 0 from the load line [rad], or "mean" over one roller pitch; None is the scene's.
      speed_rpm: must be 0 in this version.
      load_sigma: relative standard deviation of this row's loads [%], 0 … 50, each row's by chance. Default 0. What all
        loads have in common is the parameter `load_factor`.
      origin: where it was read, for sentences; None of what was not. Rows are equal wherever they come from.
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
    load_sigma: Annotated[Real, Interval(ge=0.0, le=50.0), Unit("%")] = 0.0
    origin: Origin | None = dataclasses.field(default=None, compare=False, repr=False)

    @property
    def is_loss(self) -> bool:
        """Whether it is a loss [%] and not a stiffness."""
        return self.quantity.endswith("loss")

    @property
    def entry(self) -> str:
        """Of the stiffness matrix: a name in `ENTRIES`."""
        return self.quantity.rpartition("_")[0]

    @property
    def is_coupling(self) -> bool:
        """Whether that is beside the diagonal."""
        row, column = ENTRIES[self.entry]
        return row != column

    @property
    def unit(self) -> str:
        """Of value and sigma."""
        return "%" if self.is_loss else "N/mm"


def listed(rows: Sequence[Measurement]) -> tuple[Measurement, ...]:
    """Rows as a tuple; raises `MeasuredError` for the name of a file in place of them, and for what is no row."""
    if isinstance(rows, str | Path):
        raise MeasuredError(f"measurements = {str(rows)!r}: give rows, say load_measured({str(rows)!r})")
    if not isinstance(rows, Sequence) or not all(isinstance(row, Measurement) for row in rows):
        raise MeasuredError("measurements: give a list of Measurement, or what load_measured returns")
    return tuple(rows)


def where(row: Measurement, number: int, table: str = "measurements") -> str:
    """What begins a sentence on a row: its file and line there or, if it was not read, its number from 1 in a table."""
    return f"{table}: row {number}" if row.origin is None else f"{row.origin.path}: line {row.origin.line}"


def column(field: str, origin: Origin | None) -> str:
    """The column of a field in the table that a row was read from."""
    if origin is None or origin.column == "value":
        return field
    return {"quantity": origin.column, "value": origin.column, "sigma": origin.column + SIGMA}.get(field, field)


def table_of(rows: Sequence[Measurement]) -> str:
    """What begins a sentence on all rows: their file, if it is one."""
    paths = {None if row.origin is None else row.origin.path for row in rows}
    return (paths.pop() if len(paths) == 1 else None) or "measurements"


def so_many(count: int, noun: str) -> str:
    """A number of what a noun says."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def check(row: Measurement, number: int = 1) -> Measurement:
    """The row, if its columns are within their ranges and fit together; else a `MeasuredError` that begins as `where`
    says."""
    here, value = where(row, number), column("value", row.origin)
    for field in fields.fields_of(Measurement):
        sentence = fields.of_field(field, getattr(row, field.name), column(field.name, row.origin))
        if sentence is not None:
            raise MeasuredError(f"{here}: {sentence}; {ADVICE[field.name]}")
    if row.is_loss and row.value >= 100.0:
        raise MeasuredError(f"{here}: {value} = {row.value:g} %: a loss must be below 100 %; {ADVICE['value']}")
    if not row.is_loss and not row.is_coupling and row.value <= 0.0:
        raise MeasuredError(f"{here}: {value} = {row.value:g} N/mm: must be above 0 N/mm; {ADVICE['value']}")
    if row.load_sigma > 0.0 and row.sigma is None:
        raise MeasuredError(
            f"{here}: load_sigma = {row.load_sigma:g} %: {column('sigma', row.origin)} is empty: give both, or leave "
            "both empty"
        )
    if row.speed_rpm != 0.0:
        raise MeasuredError(
            f"{here}: speed_rpm = {row.speed_rpm:g}: must be 0: the fit of this version knows no effect of speed; "
            "leave rows at speed out, or set 0 if speed did not matter"
        )
    return row


def check_loads(scene: Scene, rows: Sequence[Measurement], table: str = "measurements") -> None:
    """Refuse rows of a table under which the ring has no equilibrium or the stiffness asked for does not exist."""
    for k, row in enumerate(rows, 1):
        under = dataclasses.replace(
            scene, load=Load(row.radial, row.axial), phase=scene.phase if row.phase is None else row.phase
        )
        here, quantity = where(row, k, table), column("quantity", row.origin)
        quantity = f"quantity = {row.quantity!r}" if quantity == "quantity" else quantity
        if isinstance(under.phase, PitchMean) and any(spall.surface == "roller" for spall in scene.spalls):
            raise MeasuredError(f"{here}: phase = mean: a spall on a roller belongs to that one; give a phase in rad")
        if (sentence := checks.not_held(under)) is not None:
            raise MeasuredError(f"{here}: {sentence}; check both loads of this row")
        secant = (row.definition or scene.definition) == "secant"
        if secant and row.entry not in ("radial", "axial"):
            raise MeasuredError(
                f"{here}: {quantity}: a secant stiffness F/u is along a load; give definition = "
                "tangent, or leave the row out"
            )
        if secant and row.radial == 0.0 and row.entry == "radial":
            raise MeasuredError(
                f"{here}: {quantity}: a secant radial stiffness F/u needs a radial load; give "
                "definition = tangent, or leave the row out"
            )
