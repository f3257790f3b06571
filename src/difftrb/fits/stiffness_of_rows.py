"""Stiffness at the conditions of rows: of what is traced, with its slopes if they are wanted, and of healthy numbers.

A loop goes over the blocks of rings; what it adds to every condition is a value, or a value with slopes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.taylor import Taylor
from difftrb.fits.conditions import COLUMN, ROW, Blocks, Conditions
from difftrb.fits.measured import ENTRIES
from difftrb.ring import phase_quadrature
from difftrb.ring.load import Load
from difftrb.scene import prepared_scene
from difftrb.scene.cage_phases import pitch_borders
from difftrb.scene.scene import Definition, PitchMean, Scene, healthy

Values = Any
"""Of parameters, shape (parameters,): an array, or an expansion by themselves."""
Of = Callable[[Values], tuple[Scene, Callable[[Load], Load]]]
"""Of values of parameters the prepared scene and what bearings carry at a load."""
Parts = tuple[Any, ...]
"""What a function of the values is: its value, or that and its slopes by them, shape (…, parameters)."""


def stiffness(of: Of, values: jax.Array, at: Conditions, without_spalls: bool = False) -> tuple[jax.Array, jax.Array]:
    """Stiffness of every condition [N/mm], by `ENTRIES`, shape (size, entries), and the worst status.

    `without_spalls`: of the healthy bearing; the scene's spalls say where the phases of means are all the same.
    """
    (found,), code = _summed(of, at, without_spalls, ValueOrSlopes(values, slopes=False))
    return found, code


def with_slopes(of: Of, values: jax.Array, at: Conditions, without_spalls: bool = False) -> tuple[jax.Array, jax.Array]:
    """`stiffness` that is differentiable by `values` alone, and once: its slopes are solved beside it, block by block,
    for to differentiate a loop takes several times as long to trace."""
    here = jax.lax.stop_gradient(values)
    (found, slopes), code = _summed(of, at, without_spalls, ValueOrSlopes(here, slopes=True))
    return found + slopes @ (values - here), code


@np.errstate(all="ignore")
def of_numbers(of: Of, values: Values, at: Conditions, without_spalls: bool = False) -> Any:
    """Stiffness of every condition [N/mm], by `ENTRIES`, shape (size, entries), of numbers at values that
    are numbers, or an expansion by themselves: all rings at once, and means by a rule of more points."""
    found: list[Any] = [np.full(len(ENTRIES), np.nan)] * at.size
    for definition, blocks in zip(at.definitions, at.blocks, strict=True):
        scene, loaded = of(values)
        scene = dataclasses.replace(xp.numbers(healthy(scene) if without_spalls else scene), definition=definition)
        rings = _distinct(at, blocks)
        each = _together(scene, loaded, blocks, list(rings.values()))
        if not all(np.isfinite(xp.value(one)).any() for one in each):  # one without a solution leaves none of any
            each = [_together(scene, loaded, blocks, [one])[0] for one in rings.values()]
        for number, one in zip(rings, each, strict=True):
            found[number] = one
    return xp.stack(found)


def healthy_stiffness(scene: Scene, at: Conditions) -> np.ndarray | jax.Array:
    """`of_numbers` of the prepared scene without spalls, shape (size, entries)."""
    return xp.value(of_numbers(lambda _: (scene, lambda load: load), np.zeros(0), at, without_spalls=True))


def _together(
    scene: Scene, loaded: Callable[[Load], Load], blocks: Blocks, rings: list[tuple[int, int]]
) -> list[Any]:  # fmt: skip
    """The same of conditions that begin at these blocks and `rings` of them."""
    loads = np.array([blocks.loads[:, k, ring] for k, ring in rings]).T
    means = [int(blocks.mean[k]) for k, _ in rings]
    turned = [(blocks.phases[k, ring : ring + 1], np.ones(1)) for k, ring in rings]
    turning = [n for n, mean in enumerate(means) if mean >= 0]
    if turning:
        here = dataclasses.replace(scene, load=loaded(Load(*loads[:, turning])), phase=PitchMean())
        healthy_ring = jax.tree.map(lambda part: np.asarray(part)[[means[n] for n in turning]], blocks.healthy_ring)
        for n, borders in zip(turning, pitch_borders(here, healthy_ring), strict=True):
            turned[n] = phase_quadrature.between(borders)
    ends = np.cumsum([0, *(len(weights) for _, weights in turned)])
    load = loaded(Load(*np.repeat(loads, np.diff(ends), axis=1)))
    rest = prepared_scene.at_phases(scene, xp.concatenate([phases for phases, _ in turned]), load)
    stiffness = prepared_scene.as_defined(dataclasses.replace(scene, load=load), rest)
    found = []
    for n, (_, weights) in enumerate(turned):
        own, u = (each[ends[n] : ends[n + 1]] for each in (stiffness, rest.displacement))
        own = prepared_scene.without_poles(scene, u, own) if n in turning else own
        found.append(xp.einsum("p,pe->e", weights, own[:, ROW, COLUMN]))
    return found


def _distinct(at: Conditions, blocks: Blocks) -> dict[int, tuple[int, int]]:
    """Block and ring of every condition, the first of those that count to it."""
    found: dict[int, tuple[int, int]] = {}
    for k in range(int(blocks.count)):
        for ring, number in enumerate(np.asarray(blocks.of)[k]):
            if number < at.size:
                found.setdefault(int(number), (k, ring))
    return found


class ValueOrSlopes(NamedTuple):
    """How functions of `values`, shape (parameters,), are computed: their value there, or that and its slopes, of one
    expansion."""

    values: jax.Array
    slopes: bool

    def parts(self, function: Callable[..., tuple[Any, Any]], *given: Parts) -> tuple[Parts, Any]:
        """Parts of the first thing that `function(values, …)` returns, and the other; what else it takes, by parts."""
        if not self.slopes:
            own, beside = function(self.values, *(part for (part,) in given))
            return (own,), beside
        turned = (Taylor(part, jnp.moveaxis(slopes, -1, 0)) for part, slopes in given)
        own, beside = function(Taylor(self.values, jnp.eye(len(self.values))), *turned)
        value, slopes = xp.value(own), xp.by(own)
        none = jnp.zeros((*value.shape, len(self.values)))
        return (value, none if slopes is None else jnp.moveaxis(slopes, 0, -1)), xp.values(beside)

    def zeros(self, *shape: int) -> Parts:
        """Of what has this shape."""
        return (jnp.zeros(shape), jnp.zeros((*shape, len(self.values))))[: 2 if self.slopes else 1]


def _summed(of: Of, at: Conditions, without_spalls: bool, parted: ValueOrSlopes) -> tuple[Parts, jax.Array]:
    """What the rings of all blocks add to the conditions to which they count, and the worst status."""
    found, code = parted.zeros(at.size + 1, len(ENTRIES)), jnp.asarray(status.CONVERGED)
    for definition, blocks in zip(at.definitions, at.blocks, strict=True):
        every: Blocks = jax.tree.map(jnp.asarray, blocks)
        borders = _borders(of, every, parted)

        def more(
            k: jax.Array, state: tuple[Parts, jax.Array], definition: Definition = definition, every: Blocks = every,
            borders: Parts = borders,
        ) -> tuple[Parts, jax.Array]:  # fmt: skip
            def block(values: Values, *turn: Any) -> tuple[Any, Any]:
                scene, loaded = of(values)
                scene = dataclasses.replace(healthy(scene) if without_spalls else scene, definition=definition)
                turned, share = _turned(every, k, *turn)
                each, code = _at_once(scene, turned, loaded(Load(*every.loads[:, k])))
                return share[:, None] * each, xp.module_of(code).max(code)

            turn = [tuple(part[every.mean[k]] for part in borders)] if borders else []
            each, code = parted.parts(block, *turn)
            added = tuple(s.at[every.of[k]].add(e) for s, e in zip(state[0], each, strict=True))
            return added, status.worst(state[1], code)

        found, code = jax.lax.fori_loop(0, every.count, more, (found, code))
    return tuple(part[:-1] for part in found), code


def _borders(of: Of, every: Blocks, parted: ValueOrSlopes) -> Parts:
    """Between which phases [rad] there is no kink, of every mean, shape (means, borders); nothing where
    there are none, for it is a third of a program."""
    if not len(every.means):
        return ()

    def one(k: jax.Array, found: Parts) -> Parts:
        def borders(values: Values) -> tuple[Any, None]:
            scene, loaded = of(values)
            scene = dataclasses.replace(scene, load=loaded(Load(*every.means[k])), phase=PitchMean())
            return pitch_borders(scene, jax.tree.map(lambda part: part[k], every.healthy_ring)), None

        own, _ = parted.parts(borders)
        return tuple(whole.at[k].set(part) for whole, part in zip(found, own, strict=True))

    blank = parted.zeros(len(every.means), every.phases.shape[1] + 1)
    return jax.lax.fori_loop(0, every.turns, one, blank)


def _turned(every: Blocks, k: jax.Array, borders: Any = None) -> tuple[Any, Any]:
    """Phases of a block's rings [rad] and by how much they count, shape (rings,); `borders` of its mean, if it is of
    one; None: no block is."""
    if borders is None:
        return every.phases[k], jnp.ones(every.phases.shape[1])
    mean = every.mean[k] >= 0
    blank = jnp.linspace(0.0, 1.0, len(borders))  # without a mean there may be no borders
    turned, share = phase_quadrature.between(xp.where(mean, borders, blank), (every.nodes[k], every.weights[k]))
    return xp.where(mean, turned, every.phases[k]), xp.where(mean, share, 1.0)


def _at_once(scene: Scene, turned: Any, loads: Load) -> tuple[Any, Any]:
    """Stiffness of rings at all these phases [N/mm], each under its load, shape (rings, entries), and their
    statuses."""
    rest = prepared_scene.at_phases(scene, turned, loads)
    found = prepared_scene.as_defined(dataclasses.replace(scene, load=loads), rest)
    return found[:, ROW, COLUMN], rest.status_code
