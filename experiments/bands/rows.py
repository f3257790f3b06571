"""Rows of a contact by bands: where they lie, which of them share free boundaries, how they see one another."""

from __future__ import annotations

import dataclasses
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import strip_basis
from difftrb.contact.strip_basis import Rows
from difftrb.contact.strip_fourier import LAND, LEFT, MIDDLE, RIGHT, Frequencies
from difftrb.core.numeric import chebyshev_roots

THIN = 2  # rows of land at a spall's end that share an outline
NEAR_HOLLOW = 2  # rows of the hollow at a spall's end that share an outline
GATHERED, HOLLOW = 3.0, 2.0  # powers with which rows of land and of the hollow grow from their ends


@dataclasses.dataclass(frozen=True)
class Fineness:
    """How fine a contact by bands is.

    Attributes:
      land: panels of rows on each land. hollow: on half a spall.
      bands: on each row. centred: solves of bands, each about the free boundaries of the one before.
      settled: at most so many solves by smooth modes after them, which move the boundaries to where pressure vanishes.
      frequencies, edge_frequencies: the quadrature without and with rolling edges in reach.
      tolerance: what further such solves may be worth, by the approach.
      nodes: frequencies from which the rows' kernel is interpolated to those of the waves.
    """

    land: int
    hollow: int
    bands: int
    centred: int
    settled: int
    tolerance: float
    frequencies: Frequencies
    edge_frequencies: Frequencies
    nodes: int


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is static of a contact by bands.

    Attributes:
      families: bands stand on (row, side): over all of a row of land (LAND), on what is RIGHT or LEFT of the spall's
        rolling edges over the hollow.
      outlines: (side, rows) of every pair of free boundaries. Rows beside a spall's end have three: MIDDLE, between its
        rolling edges, where only there pressure is singular along the roller, and one beyond each edge in reach.
      even: strips are symmetric about x = 0.
    """

    families: tuple[tuple[int, int], ...]
    outlines: tuple[tuple[int, tuple[int, ...]], ...]
    even: bool

    @property
    def rows(self) -> np.ndarray:
        """Of every strip, (strips,)."""
        return np.array([row for _, rows in self.outlines for row in rows])

    @property
    def outline_of(self) -> np.ndarray:
        """Of every strip, (strips,)."""
        return np.array([i for i, (_, rows) in enumerate(self.outlines) for _ in rows])

    @property
    def sides(self) -> np.ndarray:
        """Of every outline, (outlines,)."""
        return np.array([side for side, _ in self.outlines])

    @property
    def orders(self) -> tuple[int, ...]:
        """Of the modes of a strip."""
        return (0, 2) if self.even else (0, 1, 2)

    @property
    def begun_by(self) -> np.ndarray:
        """Which families tell where an outline is at first, as shares, (outlines, families)."""
        shares = np.zeros((len(self.outlines), len(self.families)))
        for i, (side, rows) in enumerate(self.outlines):
            for row in rows:
                own = [j for j, family in enumerate(self.families) if family == (row, side)]
                land = [j for j, family in enumerate(self.families) if family == (row, LAND)]
                shares[i, (own or land)[0]] += 1.0 / len(rows)
        return shares


def plan_of(groups: tuple[Rows, ...], hollow: int | None, edges: int, mirrored: bool, beside: int = 3) -> Plan:
    """The plan of `groups`, of which that of number `hollow` lies over the spall (None: none does)."""
    firsts = np.cumsum([0, *(group.count for group in groups)])
    numbers = [list(range(a, b)) for a, b in itertools.pairwise(firsts)]
    inside = numbers.pop(hollow) if hollow is not None else []
    families = [(row, LAND) for land in numbers for row in land]
    sides = [LEFT, RIGHT][:edges]
    families += [(row, side) for side in sides for row in inside]
    if not inside:
        return Plan(tuple(families), tuple((LAND, (row,)) for land in numbers for row in land), True)
    lands = [land if mirrored or land is numbers[-1] else land[::-1] for land in numbers]  # outwards from the spall
    thin = [part for land in lands for part in _parts(land[:beside], THIN)]
    near = [inside[-NEAR_HOLLOW:]] if mirrored else [inside[:NEAR_HOLLOW], inside[-NEAR_HOLLOW:]]
    rest = [row for row in inside if not any(row in part for part in near)]
    beyond = thin + [tuple(part) for part in near] + [(row,) for row in rest]
    outlines = [(LAND, (row,)) for land in lands for row in land[beside:]]
    outlines += [(MIDDLE, part) for part in thin] + [(side, part) for side in sides for part in beyond]
    return Plan(tuple(families), tuple(outlines), False)


def _parts(rows: list[int], together: int) -> list[tuple[int, ...]]:
    return [tuple(rows[:together]), *((row,) for row in rows[together:])]


def groups_of(
    low: jax.Array, high: jax.Array, tips: tuple[jax.Array, jax.Array], mirrored: bool, spalled: bool, edges: int,
    fine: Fineness,
) -> tuple[tuple[Rows, ...], int | None]:  # fmt: skip
    """Rows of a contact from −`tips[0]` to `tips[1]` with a spall from `low` to `high`; and which group is over it."""
    bottom, tip = -tips[0], tips[1]
    if not spalled:
        if mirrored:
            return (Rows(strip_basis.graded(jnp.zeros(()), tip, fine.land, 1.0, GATHERED), True, "none"),), None
        return (Rows(strip_basis.graded(bottom, tip, 2 * fine.land, GATHERED, GATHERED), False, "none"),), None
    least = 1e-3 * tip  # also of a spall without length: panels of none would make NaN of derivatives
    high = jnp.clip(high, least if mirrored else bottom + 2.0 * least, tip - least)
    upper = Rows(strip_basis.graded(high, tip, fine.land, GATHERED, GATHERED), False, "low")
    if mirrored:
        hollow = Rows(strip_basis.graded(jnp.zeros(()), high, fine.hollow, 1.0, HOLLOW), True, "high")
        return ((upper, hollow), 1) if edges else ((upper,), None)
    low = jnp.clip(low, bottom + least, high - least)
    lower = Rows(-strip_basis.graded(-low, tips[0], fine.land, GATHERED, GATHERED)[::-1], False, "high")
    hollow = Rows(strip_basis.graded(low, high, 2 * fine.hollow, HOLLOW, HOLLOW), False, "both")
    return ((lower, hollow, upper), 1) if edges else ((lower, upper), None)


class Kernel(NamedTuple):
    """How rows see one another: ∬ hat hat' K₀(κ|y−y'|) dy dy' at every frequency times its weight, (rows, rows, κ);
    ∫ hat hat' dy, (rows, rows); ∫ hat dy and ∫ hat y dy, (rows,)."""

    products: jax.Array
    mass: jax.Array
    weight: jax.Array
    arm: jax.Array


def kernel_of(groups: tuple[Rows, ...], mirrored: bool, frequencies: Frequencies, nodes: int) -> Kernel:
    """The rows' kernel. In ln κ it is smooth: at the waves' frequencies it is interpolated from `nodes` of them."""
    kappa, weights = frequencies.rule()
    waves = frequencies.waves
    at, through = kappa, np.eye(kappa.size)
    if nodes < waves:
        low, high = np.log(kappa[-waves]), np.log(kappa[-1])
        roots = chebyshev_roots(nodes)
        few = np.exp(0.5 * (high + low) + 0.5 * (high - low) * roots)
        places = (2.0 * np.log(kappa[-waves:]) - high - low) / (high - low)
        vandermonde = np.polynomial.chebyshev.chebvander
        share = np.linalg.solve(vandermonde(roots, nodes - 1).T, vandermonde(places, nodes - 1).T)
        share = few[:, None] * share / kappa[None, -waves:]  # κ times the kernel is bounded
        at = np.concatenate([kappa[:-waves], few])
        through = np.zeros((at.size, kappa.size))
        through[:-nodes, :-waves] = np.eye(kappa.size - waves)
        through[-nodes:, -waves:] = share
    products = strip_basis.products(groups, at, mirrored) @ jnp.asarray(through * (2.0 / np.pi * weights)[None])
    arm = jnp.concatenate([strip_basis.integrals(rows, lambda y: y) for rows in groups])
    return Kernel(products, strip_basis.mass(groups), strip_basis.weights(groups), arm)
