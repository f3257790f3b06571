"""Ways to compute a scene (rungs), what was measured of each (rows), which one to recommend; and `TRUTHS`, contacts
whose continuum solution is known, the approach in the limit of ever finer grids, to compare with."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

from difftrb.core.geometry import LineContact, Spall, contact_modulus
from difftrb.law.base import LAWS

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
        return self.way if self.is_plain else f"{self.way} {self.accuracy:.0e}".replace("e-0", "e-")

    @property
    def is_plain(self) -> bool:
        """Whether it is a law that solves no contacts."""
        law = LAWS.get(self.way)
        return law is not None and not law.solves

    @property
    def coarseness(self) -> tuple[float, float]:
        """Orders the rungs of one way, the finest first."""
        return self.accuracy, -float(math.prod(self.size or (1,)))


LATTICES = tuple(Rung("contact", "lattice", 1e-3, (n, 10 * n)) for n in (20, 40, 80, 160))
"""The paper's is the second."""
USUAL = {
    Rung("ring", "liu2018", 1e-3): (3.1, 1.4), Rung("ring", "palmgren", 1e-3): (1.8, 1.1),
    Rung("ring", "direct", 1e-3): (26.0, 7.8), Rung("ring", "direct", 1e-4): (12.0, 7.8),
    Rung("ring", "table", 1e-3): (3.0, 2.0), Rung("contact", "strips", 1e-3): (3.8, 0.0),
    Rung("contact", "strips", 1e-4): (2.7, 0.0), Rung("contact", "strips", 1e-2): (3.1, 0.0),
    Rung("ring", "power", 1e-3): (6.8, 1.0), Rung("ring", "power", 1e-2): (3.6, 1.0),
    Rung("ring", "direct", 1e-2): (10.0, 7.8),
    Rung("contact", "cells", 1e-2): (2.0, 0.0), Rung("contact", "cells", 1e-3): (1.8, 0.0),
    Rung("contact", "cells", 1e-4): (2.5, 0.0),
    LATTICES[0]: (3.1, 0.0), LATTICES[1]: (3.3, 0.0), LATTICES[2]: (4.1, 0.0),
}  # fmt: skip
"""Seconds of each rung with nothing compiled, and of its slopes; only their ratios count. Slopes of one law's rungs
share a program: the first one takes this time."""
SLOW = (LATTICES[3], Rung("contact", "strips", 1e-5), Rung("ring", "direct", 1e-5))
"""Rungs for those who have minutes."""
ALWAYS = 4
"""Number of rungs that are measured however long it takes: the quick ones, the truth and the next finest."""
FIRST = 7
"""Number of rungs that come first: these, the default law, and the two finest of a contact."""


def rungs(full: bool = False) -> tuple[Rung, ...]:
    """What is measured: the `USUAL` rungs, one of every other registered law and, if `full`, the `SLOW` ones."""
    known = {rung.way for rung in USUAL if rung.kind == "ring"}
    more = (Rung("ring", name, 1e-3) for name in LAWS if name not in known)
    return (*USUAL, *more, *(SLOW if full else ()))


class Step(NamedTuple):
    """Measuring a rung, or its slopes."""

    rung: Rung
    slopes: bool

    @property
    def usual(self) -> float:
        """Seconds from `USUAL`; for other rungs those of a law without contacts, or the largest there."""
        other = USUAL[Rung("ring", "palmgren", 1e-3)] if self.rung.is_plain else max(USUAL.values())
        return USUAL.get(self.rung, other)[self.slopes]


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


# ------------------------------------------------------------------------------------------------ known contacts

CONTACT = LineContact(radius=3.623, length=13.66, modulus=contact_modulus(2.1e5, 0.278), design_load=3000.0)
WIDTH, DEPTH = 1.0, 0.2
"""Of all spalls of `TRUTHS` [mm], whose roller is `CONTACT`: healthy, and with rolling edges out of reach, in the
contact and just beyond it."""


class Truth(NamedTuple):
    """Load [N], length of the spall (0: healthy) and its offset [mm], continuum approach [mm] and an estimate of that
    number's own error [-]."""

    load: float
    length: float
    offset: float
    approach: float
    doubt: float

    @property
    def spall(self) -> Spall | None:
        """None is a healthy raceway."""
        return Spall(self.length, WIDTH, DEPTH) if self.length else None


# Polonsky–Keer on edge-aligned grids up to 640 × 1366 and 80 × 10928 cells, half width of the domain 2.8 Hertz half
# widths, Richardson-extrapolated.
TRUTHS = [Truth(*row) for row in (
    (100, 0, 0, 5.365688403e-04, 2.5e-07), (100, 2, 0, 6.137801635e-04, 2.1e-06),
    (100, 4, 0, 7.425538780e-04, 4.6e-07), (100, 6, 0, 9.291261844e-04, 2.7e-06),
    (100, 8, 0, 1.207644344e-03, 5.3e-06), (1000, 0, 0, 3.023218433e-03, 2.3e-06),
    (1000, 2, 0, 3.267867384e-03, 5.0e-07), (1000, 4, 0, 3.690234545e-03, 9.9e-07),
    (1000, 6, 0, 4.306116163e-03, 1.2e-06), (1000, 8, 0, 5.243200774e-03, 1.0e-06),
    (3000, 0, 0, 7.588983207e-03, 4.3e-06), (3000, 2, 0, 8.111204602e-03, 3.0e-06),
    (3000, 4, 0, 9.046521489e-03, 6.7e-06), (3000, 6, 0, 1.041452150e-02, 7.4e-06),
    (3000, 8, 0, 1.248768281e-02, 7.4e-06), (10000, 0, 0, 2.174177485e-02, 6.3e-06),
    (10000, 2, 0, 2.298730331e-02, 3.1e-05), (10000, 4, 0, 2.533746477e-02, 3.4e-05),
    (10000, 6, 0, 2.877591004e-02, 2.4e-05), (10000, 8, 0, 3.391902836e-02, 6.2e-06),
    (3000, 2, 0.2, 8.111234095e-03, 8.5e-06),
    (3000, 2, 0.3, 8.111234179e-03, 8.6e-06), (3000, 2, 0.36, 7.985099359e-03, 7.2e-05),
    (3000, 2, 0.4, 7.874553700e-03, 2.6e-05), (3000, 2, 0.46, 7.734098573e-03, 2.7e-05),
    (3000, 2, 0.48, 7.696276107e-03, 2.5e-05), (3000, 2, 0.5, 7.663558878e-03, 2.2e-05),
    (3000, 2, 0.54, 7.614832562e-03, 1.7e-05), (3000, 2, 0.56, 7.599585052e-03, 2.3e-05),
    (3000, 2, 0.6, 7.588990986e-03, 4.8e-06),
)]  # fmt: skip


def worst_error(approach: Callable[[Truth], float]) -> float:
    """Largest relative error of what `approach` [mm] says of all `TRUTHS`."""
    return max(abs(approach(truth) / truth.approach - 1.0) for truth in TRUTHS)
