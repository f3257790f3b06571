"""What has to be solved for rows of measurements: every load and phase once, means over phases by a rule of few.

All of it is laid out in blocks of a few rings each, of one size whatever the rows are: a loop goes over as many as
there are. So one program does for any rows, and for rules of any number of points.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import status
from difftrb.fits.measured import Measurement
from difftrb.ring import phase_average
from difftrb.ring.ring import Load
from difftrb.scene import solving
from difftrb.scene.scene import Definition, PitchMean, Scene, healthy, is_plain, phases

POINTS = 6
"""Between two kinks of a mean over phases: its error is a hundredth of the noise of good measurements, 1e-4 of a loss
by the median of 30 random spalls, and 4e-4 at worst."""
ROUGH = 2
"""The same where minima are looked for: 1e-3 and 4e-3."""
TOGETHER = 2
"""Points of a rule that are in one block."""
SIZE = 16
"""Rows, conditions and blocks are laid out for multiples of this many."""


class Blocks(NamedTuple):
    """Rings to solve, by blocks.

    Attributes:
      rings: radial load [N], axial load [N] and phase [rad], shape (blocks, rings, 3); in a mean the phase is not used.
      mean: whether a block is of a mean over phases. places, weights: its part of a rule, shape (blocks, TOGETHER).
      of: number of the condition to which each ring counts, shape (blocks, rings); behind the last one to none.
      count: how many blocks there are.
    """

    rings: np.ndarray | jax.Array
    mean: np.ndarray | jax.Array
    places: np.ndarray | jax.Array
    weights: np.ndarray | jax.Array
    of: np.ndarray | jax.Array
    count: np.ndarray | jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Conditions:
    """What to solve for rows of measurements, and where each row finds itself in it.

    Attributes:
      definitions: of stiffness, as they come. blocks: of each of them. size: so many conditions are laid out.
      place: of every row among the conditions, shape (rows,). axis: 0 radial, 1 axial, shape (rows,). loss: whether it
        is a loss, shape (rows,).
    """

    definitions: tuple[Definition, ...] = dataclasses.field(metadata={"static": True})
    size: int = dataclasses.field(metadata={"static": True})
    blocks: tuple[Blocks, ...]
    place: np.ndarray | jax.Array
    axis: np.ndarray | jax.Array
    loss: np.ndarray | jax.Array


class Condition(NamedTuple):
    """Loads [N] and phase [rad], None for the mean over phases, at which stiffness of one definition is wanted."""

    radial: float
    axial: float
    phase: float | None
    definition: Definition


def conditions(scene: Scene, rows: Sequence[Measurement], points: int = POINTS) -> Conditions:
    """Those of `rows`; what they leave open is the scene's."""
    return _laid_out(scene, rows, points, _kinks(scene))


def _laid_out(scene: Scene, rows: Sequence[Measurement], points: int, kinks: int) -> Conditions:
    place: dict[Condition, int] = {}
    for row in rows:
        place.setdefault(_condition(scene, row), len(place))
    definitions: tuple[Definition, ...] = tuple({condition.definition: None for condition in place})
    size = whole(len(place))
    own = [{c: k for c, k in place.items() if c.definition == definition} for definition in definitions]
    return Conditions(
        definitions=definitions,
        size=size,
        blocks=tuple(_blocks(each, kinks, size, points) for each in own),
        place=np.array([place[_condition(scene, row)] for row in rows]),
        axis=np.array([0 if row.quantity.startswith("radial") else 1 for row in rows]),
        loss=np.array([row.is_loss for row in rows]),
    )


def _condition(scene: Scene, row: Measurement) -> Condition:
    phase: Any = scene.phase if row.phase is None else row.phase
    at = None if isinstance(phase, str | PitchMean) else float(phase)
    return Condition(float(row.radial), float(row.axial), at, row.definition or scene.definition)


def _kinks(scene: Scene) -> int:
    """Of a mean over phases of a scene like this."""
    at, one = dataclasses.replace(scene, phase=PitchMean()), phase_average.gauss(1)
    if is_plain(scene):  # by numpy, in milliseconds
        return phases(at, one)[0].size
    return jax.eval_shape(lambda: phases(at, one)[0]).size


def in_parts(scene: Scene, rows: Sequence[Measurement], points: int = POINTS) -> list[Conditions]:
    """Those of `rows` in parts, as few as have each the smallest layout: the program that a fit has is theirs, too."""
    kinks, parts, first = _kinks(scene), list[Conditions](), 0
    for behind in range(1, len(rows) + 1):
        longer = _laid_out(scene, rows[first:behind], points, kinks)
        smallest = all(len(blocks.rings) == SIZE for blocks in longer.blocks)
        if behind - first == 1 or not (smallest and behind - first <= SIZE):
            first = behind - 1
            parts.append(_laid_out(scene, rows[first:behind], points, kinks))
        else:
            parts[-1] = longer
    return parts


def whole(count: int) -> int:
    """So many are laid out for `count` of them."""
    return -(-count // SIZE) * SIZE


def _blocks(place: dict[Condition, int], kinks: int, size: int, points: int) -> Blocks:
    rings, none = kinks * TOGETHER, (np.zeros(TOGETHER), np.zeros(TOGETHER))
    found: list[tuple[Any, ...]] = []
    single = [c for c in place if c.phase is not None]
    for k in range(0, len(single), rings):
        own = single[k : k + rings]
        more = rings - len(own)
        at = [c[:3] for c in own] + [own[0][:3]] * more
        found.append((at, False, *none, [place[c] for c in own] + [size] * more))
    places, weights = phase_average.gauss(points)
    for c in (c for c in place if c.phase is None):
        for k in range(0, points, TOGETHER):
            part = slice(k, k + TOGETHER)
            found.append(([(c.radial, c.axial, 0.0)] * rings, True, places[part], weights[part], [place[c]] * rings))
    blank = [found[0]] * (whole(len(found)) - len(found))
    rows, mean, at, weight, of = (np.array(each) for each in zip(*found, *blank, strict=True))
    return Blocks(rows, mean, at, weight, of, np.array(len(found)))


Of = Callable[[jax.Array], tuple[Scene, Callable[[Load], Load]]]
"""Of values of parameters, shape (parameters,), the prepared scene and what bearings carry at a load."""


def stiffness(of: Of, values: jax.Array, at: Conditions, sound: bool = False) -> tuple[jax.Array, jax.Array]:
    """Radial and axial stiffness of every condition [N/mm], shape (size, 2), and the worst status; `sound`: without the
    scene's spalls, which say where the phases of means are anyway."""
    blank = jnp.zeros((at.size + 1, 2)), jnp.asarray(status.CONVERGED)
    found, code = _summed(partial(_block, of, sound, values), at, blank)
    return found[:-1], code


def with_slopes(of: Of, values: jax.Array, at: Conditions, sound: bool = False) -> tuple[jax.Array, jax.Array]:
    """`stiffness` that is differentiable by `values` alone, and once: its slopes are solved beside it, block by block,
    for to differentiate a loop takes several times as long to trace."""
    fixed = jax.lax.stop_gradient(values)

    def block(definition: Definition, blocks: Blocks, k: jax.Array) -> tuple[Any, jax.Array]:
        def here(values: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
            each, code = _block(of, sound, values, definition, blocks, k)
            return each, (each, code)

        slopes, (each, code) = jax.jacfwd(here, has_aux=True)(fixed)
        return (each, slopes), code

    blank = jnp.zeros((at.size + 1, 2)), jnp.zeros((at.size + 1, 2, len(values)))
    (found, slopes), code = _summed(block, at, (blank, jnp.asarray(status.CONVERGED)))
    return (found + slopes @ (values - fixed))[:-1], code


Block = Callable[[Definition, Blocks, jax.Array], tuple[Any, jax.Array]]
"""What the rings of the k-th block have, shapes (rings, …), and their worst status."""


def _summed(block: Block, at: Conditions, found: tuple[Any, jax.Array]) -> tuple[Any, jax.Array]:
    """What the rings of all blocks have, added to the conditions to which they count, and the worst status."""
    for definition, blocks in zip(at.definitions, at.blocks, strict=True):
        found = _added(partial(block, definition), blocks, found)
    return found


def _added(
    block: Callable[[Blocks, jax.Array], tuple[Any, jax.Array]], blocks: Blocks, found: tuple[Any, jax.Array]
) -> tuple[Any, jax.Array]:
    every = jax.tree.map(jnp.asarray, blocks)

    def more(k: jax.Array, found: tuple[Any, jax.Array]) -> tuple[Any, jax.Array]:
        each, code = block(every, k)
        return jax.tree.map(lambda s, e: s.at[every.of[k]].add(e), found[0], each), status.worst(found[1], code)

    return jax.lax.fori_loop(0, every.count, more, found)


def _block(
    of: Of, sound: bool, values: jax.Array, definition: Definition, every: Blocks, k: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """What the rings of a block count in stiffness [N/mm], shape (rings, 2), and the worst status."""
    scene, loaded = of(values)
    scene = dataclasses.replace(scene, definition=definition)
    solved = healthy(scene) if sound else scene
    rings, mean = every.rings[k], every.mean[k]

    def one(ring: jax.Array) -> tuple[jax.Array, jax.Array]:
        at = solving.solve(dataclasses.replace(solved, load=loaded(Load(ring[0], ring[1])), phase=ring[2]))
        return jnp.stack([at.radial_stiffness, at.axial_stiffness]), at.status_code

    under = dataclasses.replace(scene, load=loaded(Load(rings[0, 0], rings[0, 1])), phase=PitchMean())
    turned, share = phases(under, (every.places[k], every.weights[k]))
    turned, share = jnp.where(mean, turned, rings[:, 2]), jnp.where(mean, share, 1.0)
    each, codes = jax.vmap(one)(jnp.concatenate([rings[:, :2], turned[:, None]], axis=1))
    return share[:, None] * each, jnp.max(codes)
