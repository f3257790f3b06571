"""What is fixed before strips are solved: how fine, where rows lie, and which strips share free boundaries."""

from __future__ import annotations

import dataclasses
import itertools
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from difftrb.contact import strip_rows
from difftrb.contact.strip_rows import Rows
from difftrb.contact.strip_waves import Frequencies
from difftrb.core import arrays as xp

LAND, RIGHT, LEFT, MIDDLE = 0, 1, -1, 2
THIN = 2  # rows of land at a spall's end that share an outline
BESIDE = 3  # rows of land at a spall's end that are cut by its rolling edges
NEAR_HOLLOW = 1  # rows of the hollow at a spall's end that share an outline
GATHERED, HOLLOW = 3.0, 2.0  # powers with which rows of land and of the hollow grow from their ends
LEAST_ROWS = 1e-3  # length of land or spall by the contact's that there are rows for at least


@dataclasses.dataclass(frozen=True)
class Fineness:
    """How fine strips are.

    Attributes:
      land: panels of rows on each land. hollow: on half a spall.
      bands: on each row. centred: solves of bands, each about the free boundaries of the one before.
      settled: at most so many solves by smooth modes after them, which move the boundaries to where pressure vanishes.
      frequencies, edge_frequencies: the quadrature without and with rolling edges in reach.
      nodes: frequencies from which the rows' kernel is interpolated to those of the waves.
    """

    land: int
    hollow: int
    bands: int
    centred: int
    settled: int
    frequencies: Frequencies
    edge_frequencies: Frequencies
    nodes: int

    def frequencies_for(self, edges: int) -> Frequencies:
        """With so many rolling edges in reach."""
        return self.edge_frequencies if edges else self.frequencies


@dataclasses.dataclass(frozen=True)
class StripPlan:
    """What is static of strips.

    Attributes:
      families: bands stand on (row, side): over all of a row of land (LAND), on what is RIGHT or LEFT of the spall's
        rolling edges over the hollow.
      outlines: (side, rows) of every pair of free boundaries. Rows beside a spall's end have three: MIDDLE, between its
        rolling edges, where only there pressure is singular along the roller, and one beyond each edge in reach.
      even: strips are symmetric about x = 0.
      frequencies: the quadrature.
    """

    families: tuple[tuple[int, int], ...]
    outlines: tuple[tuple[int, tuple[int, ...]], ...]
    even: bool
    frequencies: Frequencies

    @cached_property
    def rows(self) -> np.ndarray:
        """Of every strip, (strips,)."""
        return np.array([row for _, rows in self.outlines for row in rows])

    @cached_property
    def outline_of(self) -> np.ndarray:
        """Of every strip, (strips,)."""
        return np.array([i for i, (_, rows) in enumerate(self.outlines) for _ in rows])

    @cached_property
    def sides(self) -> np.ndarray:
        """Of every outline, (outlines,)."""
        return np.array([side for side, _ in self.outlines])

    @cached_property
    def sided(self) -> np.ndarray:
        """Which outlines lie beyond a rolling edge, (outlines,)."""
        return np.isin(self.sides, (LEFT, RIGHT))

    @cached_property
    def family_sides(self) -> np.ndarray:
        """Of every family, (families,)."""
        return np.array([side for _, side in self.families])

    @cached_property
    def family_rows(self) -> np.ndarray:
        """Of every family, (families,)."""
        return np.array([row for row, _ in self.families])

    @property
    def orders(self) -> tuple[int, ...]:
        """Of the modes of a strip."""
        return (0, 2) if self.even else (0, 1, 2)

    @cached_property
    def member(self) -> np.ndarray:
        """Which strip has which outline, as ones, (strips, outlines)."""
        return np.eye(len(self.outlines))[self.outline_of]

    @cached_property
    def begun_by(self) -> np.ndarray:
        """Which families tell where an outline is at first, as shares, (outlines, families)."""
        shares = np.zeros((len(self.outlines), len(self.families)))
        for i, (side, rows) in enumerate(self.outlines):
            for row in rows:
                own = [j for j, family in enumerate(self.families) if family == (row, side)]
                land = [j for j, family in enumerate(self.families) if family == (row, LAND)]
                shares[i, (own or land)[0]] += 1.0 / len(rows)
        return shares


def plan_of(groups: tuple[Rows, ...], hollow: int | None, edges: int, mirrored: bool, fine: Fineness) -> StripPlan:
    """The plan of `groups`, of which that of number `hollow` lies over the spall (None: none does)."""
    return _plan(tuple(group.count for group in groups), hollow, edges, mirrored, fine.frequencies_for(edges))


@lru_cache
def _plan(
    counts: tuple[int, ...], hollow: int | None, edges: int, mirrored: bool, frequencies: Frequencies
) -> StripPlan:
    firsts = np.cumsum([0, *counts])
    numbers = [list(range(a, b)) for a, b in itertools.pairwise(firsts)]
    inside = numbers.pop(hollow) if hollow is not None else []
    families = [(row, LAND) for land in numbers for row in land]
    sides = [LEFT, RIGHT][:edges]
    families += [(row, side) for side in sides for row in inside]
    if not inside:
        return StripPlan(tuple(families), tuple((LAND, (row,)) for land in numbers for row in land), True, frequencies)
    lands = [land if mirrored or land is numbers[-1] else land[::-1] for land in numbers]  # outwards from the spall
    thin = [part for land in lands for part in _parts(land[:BESIDE], THIN)]
    near = [inside[-NEAR_HOLLOW:]] if mirrored else [inside[:NEAR_HOLLOW], inside[-NEAR_HOLLOW:]]
    rest = [row for row in inside if not any(row in part for part in near)]
    beyond = thin + [tuple(part) for part in near] + [(row,) for row in rest]
    outlines = [(LAND, (row,)) for land in lands for row in land[BESIDE:]]
    outlines += [(MIDDLE, part) for part in thin] + [(side, part) for side in sides for part in beyond]
    return StripPlan(tuple(families), tuple(outlines), False, frequencies)


def _parts(rows: list[int], together: int) -> list[tuple[int, ...]]:
    return [tuple(rows[:together]), *((row,) for row in rows[together:])]


def groups_of(
    ends: tuple[Any, ...], mirrored: bool, spalled: bool, edges: int, fine: Fineness
) -> tuple[tuple[Rows, ...], int | None]:
    """The rows, and which group of them is over the spall. `ends`: where the spall begins and ends, where the contact
    does."""
    low, high, bottom, top = ends
    if not spalled:
        if mirrored:
            return (Rows(strip_rows.graded(0.0 * top, top, fine.land, 1.0, GATHERED), True, "none"),), None
        return (Rows(strip_rows.graded(bottom, top, 2 * fine.land, GATHERED, GATHERED), False, "none"),), None
    least = 0.5 * LEAST_ROWS * (top - bottom)  # of a spall without length, too: panels of none make NaN of derivatives
    high = xp.within(high, least if mirrored else bottom + 2.0 * least, top - least)
    upper = Rows(strip_rows.graded(high, top, fine.land, GATHERED, GATHERED), False, "low")
    if mirrored:
        hollow = Rows(strip_rows.graded(0.0 * top, high, fine.hollow, 1.0, HOLLOW), True, "high")
        return ((upper, hollow), 1) if edges else ((upper,), None)
    low = xp.within(low, bottom + least, high - least)
    lower = Rows(-strip_rows.graded(-low, -bottom, fine.land, GATHERED, GATHERED)[::-1], False, "high")
    hollow = Rows(strip_rows.graded(low, high, 2 * fine.hollow, HOLLOW, HOLLOW), False, "both")
    return ((lower, hollow, upper), 1) if edges else ((lower, upper), None)
