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

    @property
    def finer(self) -> Fineness:
        """For slivers beyond a rolling edge that are half as wide."""
        edge = self.edge_frequencies
        doubled = Frequencies(edge.low, edge.smooth + 1, 2 * edge.waves, 2.0 * edge.highest)
        hollow = self.hollow + self.hollow // 2
        return dataclasses.replace(self, hollow=hollow, edge_frequencies=doubled, nodes=self.nodes + 2)

    def frequencies_for(self, edges: int) -> Frequencies:
        """With so many rolling edges in reach."""
        return self.edge_frequencies if edges else self.frequencies


@dataclasses.dataclass(frozen=True)
class StripPlan:
    """What is static of strips.

    Attributes:
      families: bands stand on (row, side, hollow): over all of a row of land (LAND), on what is RIGHT or LEFT of a
        hollow's rolling edges over it.
      outlines: (side, rows, hollow) of every pair of free boundaries. Rows beside a spall's end have three: MIDDLE,
        between its rolling edges, where only there pressure is singular along the roller, and one beyond each edge in
        reach. Where none of the hollows matters it is 0.
      even: strips are symmetric about x = 0.
      frequencies: the quadrature.
    """

    families: tuple[tuple[int, int, int], ...]
    outlines: tuple[tuple[int, tuple[int, ...], int], ...]
    even: bool
    frequencies: Frequencies

    @cached_property
    def rows(self) -> np.ndarray:
        """Of every strip, (strips,)."""
        return np.array([row for _, rows, _ in self.outlines for row in rows])

    @cached_property
    def outline_of(self) -> np.ndarray:
        """Of every strip, (strips,)."""
        return np.array([i for i, (_, rows, _) in enumerate(self.outlines) for _ in rows])

    @cached_property
    def sides(self) -> np.ndarray:
        """Of every outline, (outlines,)."""
        return np.array([side for side, *_ in self.outlines])

    @cached_property
    def hollows(self) -> np.ndarray:
        """Of every outline, (outlines,)."""
        return np.array([hollow for *_, hollow in self.outlines])

    @cached_property
    def sided(self) -> np.ndarray:
        """Which outlines lie beyond a rolling edge, (outlines,)."""
        return np.isin(self.sides, (LEFT, RIGHT))

    @cached_property
    def family_sides(self) -> np.ndarray:
        """Of every family, (families,)."""
        return np.array([side for _, side, _ in self.families])

    @cached_property
    def family_rows(self) -> np.ndarray:
        """Of every family, (families,)."""
        return np.array([row for row, *_ in self.families])

    @cached_property
    def family_hollows(self) -> np.ndarray:
        """Of every family, (families,)."""
        return np.array([hollow for *_, hollow in self.families])

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
        for i, (side, rows, _) in enumerate(self.outlines):
            for row in rows:
                own = [j for j, family in enumerate(self.families) if family[:2] == (row, side)]
                land = [j for j, family in enumerate(self.families) if family[:2] == (row, LAND)]
                shares[i, (own or land)[0]] += 1.0 / len(rows)
        return shares


def plan_of(
    groups: tuple[Rows, ...], hollows: tuple[int, ...], edges: int, mirrored: bool, fine: Fineness
) -> StripPlan:
    """The plan of `groups`, of which those numbered in `hollows` lie over spalls."""
    return _plan(tuple(group.count for group in groups), hollows, edges, mirrored, fine.frequencies_for(edges))


@lru_cache
def _plan(
    counts: tuple[int, ...], hollows: tuple[int, ...], edges: int, mirrored: bool, frequencies: Frequencies
) -> StripPlan:
    firsts = np.cumsum([0, *counts])
    numbers = [list(range(a, b)) for a, b in itertools.pairwise(firsts)]
    every = [row for group, rows in enumerate(numbers) if group not in hollows for row in rows]
    families = [(row, LAND, 0) for row in every]
    sides = [LEFT, RIGHT][:edges]
    families += [(row, side, i) for i, group in enumerate(hollows) for side in sides for row in numbers[group]]
    if not hollows:
        return StripPlan(tuple(families), tuple((LAND, (row,), 0) for row in every), True, frequencies)
    cut, middle, beyond = [], [], []
    for i, group in enumerate(hollows):
        inside = numbers[group]
        beside = [numbers[0]] if mirrored else [numbers[group - 1][::-1], numbers[group + 1]]  # outwards from the spall
        near = [inside[-NEAR_HOLLOW:]] if mirrored else [inside[:NEAR_HOLLOW], inside[-NEAR_HOLLOW:]]
        thin = [part for land in beside for part in _parts(land[:BESIDE], THIN)]
        rest = [row for row in inside if not any(row in part for part in near)]
        cut += [row for part in thin for row in part]
        middle += [(MIDDLE, part, i) for part in thin]
        beyond += [(part, i) for part in thin + [tuple(part) for part in near] + [(row,) for row in rest]]
    outlines = [(LAND, (row,), 0) for row in every if row not in cut] + middle
    outlines += [(side, part, i) for side in sides for part, i in beyond]
    return StripPlan(tuple(families), tuple(outlines), False, frequencies)


def _parts(rows: list[int], together: int) -> list[tuple[int, ...]]:
    return [tuple(rows[:together]), *((row,) for row in rows[together:])]


def groups_of(
    ends: tuple[Any, ...], mirrored: bool, edges: int, fine: Fineness
) -> tuple[tuple[Rows, ...], tuple[int, ...]]:
    """The rows, and which groups of them are over spalls, if any of these's rolling edges are in reach. `ends`: where
    every hollow begins and ends, in their order along the roller, and then where the contact does."""
    *borders, bottom, top = ends
    if not borders:
        if mirrored:
            return (Rows(strip_rows.graded(0.0 * top, top, fine.land, 1.0, GATHERED), True, "none"),), ()
        return (Rows(strip_rows.graded(bottom, top, 2 * fine.land, GATHERED, GATHERED), False, "none"),), ()
    least = 0.5 * LEAST_ROWS * (top - bottom)  # of a spall without length, too: panels of none make NaN of derivatives
    if mirrored:
        high = xp.within(borders[1], least, top - least)
        upper = Rows(strip_rows.graded(high, top, fine.land, GATHERED, GATHERED), False, "low")
        hollow = Rows(strip_rows.graded(0.0 * top, high, fine.hollow, 1.0, HOLLOW), True, "high")
        return ((upper, hollow), (1,)) if edges else ((upper,), ())
    above = top
    for i in reversed(range(len(borders))):
        borders[i] = above = xp.within(borders[i], bottom + (i + 1) * least, above - least)
    count, every = len(borders) // 2, [bottom, *borders, top]
    groups, over = [], []
    for i, (start, end) in enumerate(itertools.pairwise(every)):
        if i % 2 == 0:
            edge = "high" if i == 0 else "low" if i == 2 * count else "both"
            groups.append(Rows(strip_rows.graded(start, end, fine.land, GATHERED, GATHERED), False, edge))
        elif edges:
            over.append(len(groups))
            groups.append(Rows(strip_rows.graded(start, end, 2 * fine.hollow, HOLLOW, HOLLOW), False, "both"))
    return tuple(groups), tuple(over)
