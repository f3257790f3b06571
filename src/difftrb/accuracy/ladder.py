"""Ways to compute a scene, what was measured of each, and which one to recommend."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

Kind = Literal["ring", "contact"]

STIFFNESS = ("radial_stiffness", "axial_stiffness")
"""What a rung is recommended by."""


@dataclasses.dataclass(frozen=True)
class Rung:
    """One way to compute: for the ring a law, for the single contact a method, each with an accuracy [-] or, of a
    lattice, a `size`: cells across and along the roller."""

    kind: Kind
    way: str
    accuracy: float
    size: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """Way and, where it has one, size or accuracy."""
        if self.size is not None:
            return f"{self.way} {self.size[0]}×{self.size[1]}"
        return self.way if self.way in ("palmgren", "liu2018") else f"{self.way} {_short(self.accuracy)}"

    @property
    def coarseness(self) -> tuple[float, float]:
        """Of rungs of one way, the finer one's is less."""
        return self.accuracy, -float(math.prod(self.size or (1,)))


def _short(accuracy: float) -> str:
    return f"{accuracy:.0e}".replace("e-0", "e-")


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
"""Seconds that each takes with nothing compiled, and then its slopes; of these only the ratios count. Slopes of one
law's rungs share their program: whichever comes first takes this time."""
RUNGS = tuple(USUAL)
ALWAYS = 4
"""How many of them are measured however long it takes: what is quick, the truth and what it is known to."""
FIRST = 7
"""How many come first: these, what scenes are solved by unless they say otherwise, and what a contact is known to."""
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
        """See `USUAL`; of others, the most that any takes."""
        return USUAL.get(self.rung, max(USUAL.values()))[self.slopes]


def steps(rungs: Sequence[Rung]) -> list[Step]:
    """All there is to measure: the `FIRST`, then what takes least time, slopes after their rung."""
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
      again: of these, seconds to prepare the law once compiled; nothing is read from disk. NaN for a contact.
      single: seconds to solve once more. each, each_with_gradient: seconds per scene of a batch, stiffness alone and
        with its derivatives by the first spall's length and width (by the load if healthy). NaN for a contact.
      memory: largest of the process so far [MiB], NaN where the system does not tell.
      values: what came out, by name [N, mm].
      errors: of these, relative to the finest rung of the kind [-]; the finest one's own are the difference from the
        second finest. Filled in by `judged`.
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

    The finest row's error is its difference from the second finest, and nothing is extrapolated: contacts ten times as
    exact, from 1e-2 to 1e-5, bring stiffness and peak load of a ring closer in no clean order. Of 54 such steps on nine
    random scenes 20 turned round, and 8 were larger than the step before; the median is a tenth of it
    (experiments/accuracy_promise.py --order measures others).
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
