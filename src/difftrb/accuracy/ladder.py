"""Ways to compute a scene (rungs), what was measured of each (rows), and which one to recommend."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

Kind = Literal["ring", "contact"]

STIFFNESS = ("radial_stiffness", "axial_stiffness")
"""Names of the values by which a rung is recommended."""


@dataclasses.dataclass(frozen=True)
class Rung:
    """One way to compute: a law of the ring or a method of the single contact.

    It has an accuracy [-] or, of a lattice, a `size`: cells across and along the roller.
    """

    kind: Kind
    way: str
    accuracy: float
    size: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """Way and, where it has one, size or accuracy."""
        if self.size is not None:
            return f"{self.way} {self.size[0]}×{self.size[1]}"
        accuracy = f" {self.accuracy:.0e}".replace("e-0", "e-")
        return self.way if self.way in ("palmgren", "liu2018") else self.way + accuracy

    @property
    def coarseness(self) -> tuple[float, float]:
        """Orders the rungs of one way, the finest first."""
        return self.accuracy, -float(math.prod(self.size or (1,)))


LATTICES = tuple(Rung("contact", "lattice", 1e-3, (n, 10 * n)) for n in (20, 40, 80, 160))
"""The paper's is the second."""
USUAL = {
    Rung("ring", "liu2018", 1e-3): (3.1, 1.4), Rung("ring", "palmgren", 1e-3): (1.8, 1.1),
    Rung("ring", "direct", 1e-3): (26.0, 7.8), Rung("ring", "direct", 1e-4): (12.0, 7.8),
    Rung("ring", "power", 1e-3): (6.8, 1.0), Rung("contact", "strips", 1e-3): (3.8, 0.0),
    Rung("contact", "strips", 1e-4): (2.7, 0.0), Rung("contact", "strips", 1e-2): (3.1, 0.0),
    Rung("ring", "power", 1e-2): (3.6, 1.0), Rung("ring", "direct", 1e-2): (10.0, 7.8),
    Rung("ring", "table", 1e-3): (54.0, 11.0),
    Rung("contact", "cells", 1e-2): (2.0, 0.0), Rung("contact", "cells", 1e-3): (1.8, 0.0),
    Rung("contact", "cells", 1e-4): (2.5, 0.0),
    LATTICES[0]: (3.1, 0.0), LATTICES[1]: (3.3, 0.0), LATTICES[2]: (4.1, 0.0),
}  # fmt: skip
"""Seconds of each rung with nothing compiled, and of its slopes; only their ratios count. Slopes of one law's rungs
share a program: the first one takes this time."""
RUNGS = tuple(USUAL)
ALWAYS = 4
"""Number of rungs that are measured however long it takes: the quick ones, the truth and the next finest."""
FIRST = 7
"""Number of rungs that come first: these, the default law, and the two finest of a contact."""
FULL = (
    *RUNGS, LATTICES[3], Rung("contact", "strips", 1e-5), Rung("ring", "table", 1e-2), Rung("ring", "table", 1e-4),
    Rung("ring", "direct", 1e-5),
)  # fmt: skip


class Step(NamedTuple):
    """Measuring a rung, or its slopes."""

    rung: Rung
    slopes: bool

    @property
    def usual(self) -> float:
        """Seconds from `USUAL`; for other rungs the largest there."""
        return USUAL.get(self.rung, max(USUAL.values()))[self.slopes]


def steps(rungs: Sequence[Rung]) -> list[Step]:
    """All steps: the `FIRST`, then by time, the shortest first, slopes after their rung."""
    every = [Step(rung, False) for rung in rungs] + [Step(rung, True) for rung in rungs if rung.kind == "ring"]
    first = every[:FIRST]
    done = {step.rung for step in first}
    return first + sorted(
        every[FIRST:], key=lambda step: max(step.usual, 0.0 if step.rung in done else Step(step.rung, False).usual)
    )


@dataclasses.dataclass(frozen=True)
class Row:
    """A rung as measured.

    Attributes:
      first: seconds to the first result in this process, with all compiling that no rung before had done.
      again: seconds to prepare the law, compiled; nothing is read from disk. NaN for a contact.
      single: seconds to solve once more. each, each_with_gradient: seconds per scene of a batch, stiffness alone and
        with its derivatives by the first spall's length and width (by the load if healthy). NaN for a contact.
      memory: largest of the process so far [MiB], NaN where the system does not tell.
      values: what came out, by name [N, mm].
      errors: of the values, relative to the finest rung of the kind [-]; for the finest the difference from the second
        finest. Filled in by `judged`.
      status: a sentence; "converged".
      there: as `each`, on an accelerator; NaN without one.
      continuum: of a contact, the largest error of the approach on contacts with a known continuum solution [-]; NaN if
        not measured.
    """

    rung: Rung
    first: float
    again: float
    single: float
    each: float
    each_with_gradient: float
    memory: float
    values: dict[str, float]
    status: str
    errors: dict[str, float] = dataclasses.field(default_factory=dict)
    there: float = math.nan
    continuum: float = math.nan

    @property
    def seconds(self) -> float:
        """For one new scene or contact, everything compiled."""
        return self.single + (self.again if math.isfinite(self.again) else 0.0)

    @property
    def error(self) -> float:
        """Of stiffness, the larger of radial and axial; of a contact, that of the approach."""
        names = STIFFNESS if self.rung.kind == "ring" else ("approach",)
        known = [self.errors[name] for name in names if math.isfinite(self.errors.get(name, math.nan))]
        return max(known) if known else math.nan


def finest(rows: Sequence[Row], kind: Kind) -> Row | None:
    """The row of the most exact way to solve: `direct` for the ring; strips, else cells, for the contact."""
    return next(iter(_by_fineness(rows, kind)), None)


def _by_fineness(rows: Sequence[Row], kind: Kind) -> list[Row]:
    own = [row for row in rows if row.rung.kind == kind and row.status == "converged"]
    for way in ("direct",) if kind == "ring" else ("strips", "cells", "lattice"):
        if solved := [row for row in own if row.rung.way == way]:
            return sorted(solved, key=lambda row: row.rung.coarseness)
    return []


def judged(rows: Sequence[Row]) -> list[Row]:
    """The rows with their errors; NaN where there is nothing to compare with.

    The finest row's error is its difference from the second finest. Nothing is extrapolated: with contacts ten times as
    exact, from 1e-2 to 1e-5, stiffness and peak load of a ring converge in no clean order. Of 54 such steps on nine
    random scenes 20 changed sign, and 8 were larger than the step before; the median is a tenth of it
    (experiments/accuracy_promise.py --order).
    """
    result = []
    for row in rows:
        other = next((one for one in _by_fineness(rows, row.rung.kind) if one is not row), None)
        known = {} if other is None else other.values
        errors = {name: _apart(value, known.get(name, math.nan)) for name, value in row.values.items()}
        result.append(dataclasses.replace(row, errors=errors))
    return result


def _apart(value: float, truth: float) -> float:
    return abs(value / truth - 1.0) if truth and math.isfinite(value) and math.isfinite(truth) else math.nan


def recommended(rows: Sequence[Row], asked: float) -> Row | None:
    """The cheapest ring whose stiffness meets an accuracy, of rows with errors.

    None unless the truth is known that well, too: so a true error is at most twice what was asked.
    """
    truth = finest(rows, "ring")
    if truth is None or not truth.error <= asked:
        return None
    good = [row for row in rows if row.rung.kind == "ring" and row.status == "converged" and row.error <= asked]
    return min(good, key=lambda row: row.seconds)


def finer(rows: Sequence[Row], best: Row | None) -> Row | None:
    """The cheapest ring with at most half the recommended one's error; the truth counts as exact."""
    truth = finest(rows, "ring")
    if best is None or best is truth:
        return None
    good = [row for row in rows if row.rung.kind == "ring" and (row is truth or row.error <= 0.5 * best.error)]
    return min(good, key=lambda row: row.seconds)


@dataclasses.dataclass(frozen=True)
class Measured:
    """All rungs of a scene as measured.

    Attributes:
      rows: in the order in which they were measured. left_out: names of rungs that were not measured, and why.
      asked: accuracy of stiffness that `recommended` meets: the cheapest such rung, None if none does.
      finer: the cheapest law with at most half its error, None if there is none.
      yardstick: seconds of a fixed piece of work, see `machine.yardstick`; seconds by this compare across machines.
      device: name of the CPU. cores: how many this process may use. seconds: the whole measurement.
      importing: see `machine.importing`.
      one_core: time of one scene of a batch on one core relative to all cores, without and with derivatives, for the
        ring that is cheapest to make; None if not measured.
      accelerator: name of what `Row.there` was measured on; None without one.
    """

    rows: tuple[Row, ...]
    left_out: dict[str, str]
    asked: float
    recommended: Row | None
    finer: Row | None
    yardstick: float
    device: str
    cores: int
    seconds: float
    importing: float = math.nan
    one_core: tuple[float, float] | None = None
    accelerator: str | None = None

    def of(self, kind: Kind) -> list[Row]:
        """The rows of one kind, the cheapest first."""
        return sorted((row for row in self.rows if row.rung.kind == kind), key=lambda row: row.seconds)

    def truth(self, kind: Kind) -> Row | None:
        """What the others are compared with."""
        return finest(self.rows, kind)
