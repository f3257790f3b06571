"""What has to be solved for rows of measurements: every load and phase once, means over phases by a rule of few.

All of it is laid out in blocks of a few rings each, of one size whatever the rows are: a loop goes over as many as
there are. So one program does for any rows, and for rules of any number of points.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from difftrb.core.numeric import gauss_legendre
from difftrb.fits.measured import ENTRIES, Measurement
from difftrb.ring import phase_quadrature
from difftrb.ring.phase_kinks import HealthyRing
from difftrb.scene import cage_phases
from difftrb.scene.scene import Definition, PitchMean, Scene

ROW, COLUMN = (np.array(part) for part in zip(*ENTRIES.values(), strict=True))
"""Of the stiffness matrix, of every entry that can be measured."""
SIZE = 16
"""Rows, conditions, means and blocks are laid out for multiples of this many."""


class Blocks(NamedTuple):
    """Rings to solve, by blocks.

    Attributes:
      means: radial and axial load [N] of the means over phases, shape (means, 2). turns: how many there are.
      healthy_ring: those there, parts of shape (means, …); None: rings are solved where they are asked for, for they
        lie differently at other phases, or tilt.
      loads: radial and axial load [N] of every ring, shape (2, blocks, rings). phases: of every ring [rad], shape
        (blocks, rings); not used in a mean.
      mean: of which mean over phases a block is; −1: of none. nodes, weights: its point of a rule, shape (blocks, 1);
        it has a ring between any two kinks.
      of: number of the condition to which each ring counts, shape (blocks, rings); behind the last one to none.
      count: how many blocks there are.
    """

    means: np.ndarray | jax.Array
    turns: np.ndarray | jax.Array
    healthy_ring: HealthyRing | None
    loads: np.ndarray | jax.Array
    phases: np.ndarray | jax.Array
    mean: np.ndarray | jax.Array
    nodes: np.ndarray | jax.Array
    weights: np.ndarray | jax.Array
    of: np.ndarray | jax.Array
    count: np.ndarray | jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Conditions:
    """What to solve for rows of measurements, and where each row finds itself in it.

    Attributes:
      definitions: of stiffness, as they come. blocks: of each of them. size: so many conditions are laid out.
      condition: of every row, its number, shape (rows,). entry: of the stiffness matrix, a number in `ENTRIES`,
        shape (rows,). loss: whether it is a loss, shape (rows,).
    """

    definitions: tuple[Definition, ...] = dataclasses.field(metadata={"static": True})
    size: int = dataclasses.field(metadata={"static": True})
    blocks: tuple[Blocks, ...]
    condition: np.ndarray | jax.Array
    entry: np.ndarray | jax.Array
    loss: np.ndarray | jax.Array

    @property
    def kinks(self) -> int:
        """Into how many parts a mean over phases is divided."""
        return self.blocks[0].of.shape[-1]


class Condition(NamedTuple):
    """Loads [N] and phase [rad], None for the mean over phases, at which stiffness of one definition is wanted."""

    radial: float
    axial: float
    phase: float | None
    definition: Definition


def conditions(
    scene: Scene,
    rows: Sequence[Measurement],
    points: int = phase_quadrature.POINTS_IN_FITS,
    like: Conditions | None = None,
) -> Conditions:
    """Those of `rows`; what they leave open is the scene's. `like`: others of the same scene, if there are some; into
    how many parts its means are divided takes as long to tell as rings to solve."""
    at = _laid_out(scene, rows, points, _kinks(scene) if like is None else like.kinks)
    known = (
        blocks._replace(healthy_ring=_healthy_ring(scene, np.asarray(blocks.means), int(blocks.turns)))
        for blocks in at.blocks
    )
    return dataclasses.replace(at, blocks=tuple(known))


def row_conditions(scene: Scene, rows: Sequence[Measurement]) -> tuple[list[int], list[Condition]]:
    """The number of the condition of every row, and the conditions."""
    every = [_condition(scene, row) for row in rows]
    numbers = {condition: k for k, condition in enumerate(dict.fromkeys(every))}
    return [numbers[condition] for condition in every], list(numbers)


def _laid_out(scene: Scene, rows: Sequence[Measurement], points: int, kinks: int) -> Conditions:
    """Not knowing of healthy rings."""
    row_condition, every = row_conditions(scene, rows)
    numbers = {condition: k for k, condition in enumerate(every)}
    definitions: tuple[Definition, ...] = tuple({condition.definition: None for condition in numbers})
    size = whole(len(numbers))
    own = [{c: k for c, k in numbers.items() if c.definition == definition} for definition in definitions]
    return Conditions(
        definitions=definitions,
        size=size,
        blocks=tuple(_blocks(each, kinks, size, points) for each in own),
        condition=np.array(row_condition),
        entry=np.array([list(ENTRIES).index(row.entry) for row in rows]),
        loss=np.array([row.is_loss for row in rows]),
    )


def _condition(scene: Scene, row: Measurement) -> Condition:
    phase: Any = scene.phase if row.phase is None else row.phase
    at = None if isinstance(phase, str | PitchMean) else float(phase)
    return Condition(float(row.radial), float(row.axial), at, row.definition or scene.definition)


def _kinks(scene: Scene) -> int:
    """Into how many parts a mean over phases of a scene like this is divided."""
    return cage_phases.pitch_borders(dataclasses.replace(scene, phase=PitchMean())).size - 1


def phases(at: Conditions) -> np.ndarray:
    """Angles of roller 0 [rad] at which rows were measured that are no means, each once, shape (phases,)."""
    own = [np.asarray(blocks.phases)[(np.asarray(blocks.mean) < 0)[:, None] & (np.asarray(blocks.of) < at.size)]
           for blocks in at.blocks]  # fmt: skip
    return np.unique(np.concatenate(own))


def whole(count: int) -> int:
    """So many are laid out for `count` of them."""
    return -(-count // SIZE) * SIZE


def _blocks(numbers: dict[Condition, int], kinks: int, size: int, points: int) -> Blocks:
    single, turning = ([c for c in numbers if (c.phase is None) == mean] for mean in (False, True))
    found: list[tuple[Any, ...]] = []
    for k in range(0, len(single), kinks):
        own = single[k : k + kinks]
        rings = own + own[:1] * (kinks - len(own))
        counted = [numbers[c] for c in own] + [size] * (kinks - len(own))
        found.append(([c[:2] for c in rings], [c.phase for c in rings], -1, [0.0], [0.0], counted))
    rule = list(zip(*gauss_legendre(points), strict=True))
    for number, c in enumerate(turning):
        for at, weight in rule:
            found.append(([c[:2]] * kinks, [0.0] * kinks, number, [at], [weight], [numbers[c]] * kinks))
    blank = [found[0]] * (whole(len(found)) - len(found))
    loads, phases, mean, at, weight, of = (np.array(each) for each in zip(*found, *blank, strict=True))
    means = np.zeros((whole(len(turning)), 2))
    means[: len(turning)] = [c[:2] for c in turning] or np.zeros((0, 2))
    loads = np.moveaxis(loads, -1, 0)
    return Blocks(means, np.array(len(turning)), None, loads, phases, mean, at, weight, of, np.array(len(found)))


def _healthy_ring(scene: Scene, means: np.ndarray, count: int) -> HealthyRing | None:
    """See `Blocks.healthy_ring`, of the first `count` of these means."""
    found = cage_phases.healthy_ring(scene, means[:count]) if count else None
    if found is None:
        return None
    return HealthyRing(*(np.concatenate([part, np.zeros((len(means) - count, part.shape[-1]))]) for part in found))


def of_changing(at: Conditions) -> Conditions:
    """The same of healthy rings that values of parameters change."""
    return dataclasses.replace(at, blocks=tuple(blocks._replace(healthy_ring=None) for blocks in at.blocks))
