"""What has to be solved for rows of measurements: every load and phase once, means over phases by a rule of few.

All of it is laid out in blocks of a few rings each, of one size whatever the rows are: a loop goes over as many as
there are. So one program does for any rows, and for rules of any number of points.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry, status
from difftrb.core.numeric import gauss_legendre
from difftrb.core.taylor import Taylor
from difftrb.fits.measured import ENTRIES, Measurement
from difftrb.ring import phase_rule
from difftrb.ring.ring import Load
from difftrb.scene import prepared, solving
from difftrb.scene.scene import Definition, PitchMean, Scene, healthy, is_plain, pitch_borders

ROW, COLUMN = (np.array(part) for part in zip(*ENTRIES.values(), strict=True))
"""Of the stiffness matrix, of every entry that can be measured."""
ALIKE = 1e-5
"""Rings whose displacements at all phases differ by no more of themselves than this are one. In narrow load zones they
differ by more, and a loss in the mean is 4 % off if kinks are placed by one of them."""
SIZE = 16
"""Rows, conditions, means and blocks are laid out for multiples of this many."""


class Blocks(NamedTuple):
    """Rings to solve, by blocks.

    Attributes:
      means: radial and axial load [N] of the means over phases, shape (means, 2). turns: how many there are.
      still: displacement [mm] of the healthy ring there, shape (means, 3); None: rings are solved where they
        are asked for, for they have effects, or lie differently at other phases.
      loads: radial and axial load [N] of every ring, shape (2, blocks, rings). phases: of every ring [rad], shape
        (blocks, rings); not used in a mean.
      mean: of which mean over phases a block is; −1: of none. places, weights: its point of a rule, shape (blocks, 1);
        it has a ring between any two kinks.
      of: number of the condition to which each ring counts, shape (blocks, rings); behind the last one to none.
      count: how many blocks there are.
    """

    means: np.ndarray | jax.Array
    turns: np.ndarray | jax.Array
    still: np.ndarray | jax.Array | None
    loads: np.ndarray | jax.Array
    phases: np.ndarray | jax.Array
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
      place: of every row among the conditions, shape (rows,). entry: of the stiffness matrix, a number in `ENTRIES`,
        shape (rows,). loss: whether it is a loss, shape (rows,).
    """

    definitions: tuple[Definition, ...] = dataclasses.field(metadata={"static": True})
    size: int = dataclasses.field(metadata={"static": True})
    blocks: tuple[Blocks, ...]
    place: np.ndarray | jax.Array
    entry: np.ndarray | jax.Array
    loss: np.ndarray | jax.Array


class Condition(NamedTuple):
    """Loads [N] and phase [rad], None for the mean over phases, at which stiffness of one definition is wanted."""

    radial: float
    axial: float
    phase: float | None
    definition: Definition


def conditions(scene: Scene, rows: Sequence[Measurement], points: int = phase_rule.POINTS_IN_FITS) -> Conditions:
    """Those of `rows`; what they leave open is the scene's."""
    return _with_still(scene, _laid_out(scene, rows, points, _kinks(scene)))


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
        entry=np.array([list(ENTRIES).index(row.entry) for row in rows]),
        loss=np.array([row.is_loss for row in rows]),
    )


def _condition(scene: Scene, row: Measurement) -> Condition:
    phase: Any = scene.phase if row.phase is None else row.phase
    at = None if isinstance(phase, str | PitchMean) else float(phase)
    return Condition(float(row.radial), float(row.axial), at, row.definition or scene.definition)


def _kinks(scene: Scene) -> int:
    """Into how many parts a mean over phases of a scene like this is divided."""
    at = dataclasses.replace(scene, phase=PitchMean())
    if is_plain(scene):  # by numpy, in milliseconds
        return pitch_borders(at).size - 1
    return jax.eval_shape(lambda: pitch_borders(at)).size - 1


def phases(at: Conditions) -> np.ndarray:
    """Angles of roller 0 [rad] at which rows were measured that are no means, each once, shape (phases,)."""
    own = [np.asarray(blocks.phases)[(np.asarray(blocks.mean) < 0)[:, None] & (np.asarray(blocks.of) < at.size)]
           for blocks in at.blocks]  # fmt: skip
    return np.unique(np.concatenate(own))


def in_parts(scene: Scene, rows: Sequence[Measurement], points: int = phase_rule.POINTS_IN_FITS) -> list[Conditions]:
    """Those of `rows` in parts, as few as have each the smallest layout: the program that a fit has is theirs, too."""
    kinks, parts, first = _kinks(scene), list[Conditions](), 0
    for behind in range(1, len(rows) + 1):
        longer = _laid_out(scene, rows[first:behind], points, kinks)
        smallest = all(len(blocks.phases) == SIZE for blocks in longer.blocks)
        if behind - first == 1 or not (smallest and behind - first <= SIZE):
            first = behind - 1
            parts.append(_laid_out(scene, rows[first:behind], points, kinks))
        else:
            parts[-1] = longer
    return [_with_still(scene, part) for part in parts]


def whole(count: int) -> int:
    """So many are laid out for `count` of them."""
    return -(-count // SIZE) * SIZE


def _blocks(place: dict[Condition, int], kinks: int, size: int, points: int) -> Blocks:
    single, turning = ([c for c in place if (c.phase is None) == mean] for mean in (False, True))
    found: list[tuple[Any, ...]] = []
    for k in range(0, len(single), kinks):
        own = single[k : k + kinks]
        rings = own + own[:1] * (kinks - len(own))
        counted = [place[c] for c in own] + [size] * (kinks - len(own))
        found.append(([c[:2] for c in rings], [c.phase for c in rings], -1, [0.0], [0.0], counted))
    rule = list(zip(*gauss_legendre(points), strict=True))
    for number, c in enumerate(turning):
        for at, weight in rule:
            found.append(([c[:2]] * kinks, [0.0] * kinks, number, [at], [weight], [place[c]] * kinks))
    blank = [found[0]] * (whole(len(found)) - len(found))
    loads, phases, mean, at, weight, of = (np.array(each) for each in zip(*found, *blank, strict=True))
    means = np.zeros((whole(max(len(turning), 1)), 2))
    means[: len(turning)] = [c[:2] for c in turning] or np.zeros((0, 2))
    loads = np.moveaxis(loads, -1, 0)
    return Blocks(means, np.array(len(turning)), None, loads, phases, mean, at, weight, of, np.array(len(found)))


def _with_still(scene: Scene, at: Conditions) -> Conditions:
    """The same with what is known of healthy rings."""
    known = (blocks._replace(still=_still(scene, np.asarray(blocks.means), int(blocks.turns))) for blocks in at.blocks)
    return dataclasses.replace(at, blocks=tuple(known))


@np.errstate(all="ignore")
def _still(scene: Scene, means: np.ndarray, count: int) -> np.ndarray | None:
    """See `Blocks.still`, of the first `count` of these means; None, too, where rings lie differently at other
    phases."""
    if not is_plain(scene):
        return None
    still, turned = np.zeros((len(means), 3)), np.arange(4) / 4.0 * float(geometry.roller_pitch(scene.bearing))
    if count:
        loads = Load(*np.repeat(means[:count], len(turned), axis=0).T)
        rest = prepared.at_phases(xp.numbers(healthy(scene)), np.tile(turned, count), loads)
        found = xp.values(rest.displacement).reshape(count, len(turned), 3)
        if not np.all(np.ptp(found, axis=1).max(axis=1) <= ALIKE * np.abs(found).max(axis=(1, 2))):
            return None
        still[:count] = found[:, 0]
    return still


def of_changing(at: Conditions) -> Conditions:
    """The same of healthy rings that values of parameters change."""
    return dataclasses.replace(at, blocks=tuple(blocks._replace(still=None) for blocks in at.blocks))


Values = Any
"""Of parameters, shape (parameters,): an array, or an expansion by themselves."""
Of = Callable[[Values], tuple[Scene, Callable[[Load], Load]]]
"""Of values of parameters the prepared scene and what bearings carry at a load."""
Parts = tuple[Any, ...]
"""What a function of the values is: its value, or that and its slopes by them, shape (…, parameters)."""


def stiffness(of: Of, values: jax.Array, at: Conditions, sound: bool = False) -> tuple[jax.Array, jax.Array]:
    """Stiffness of every condition [N/mm], by `ENTRIES`, shape (size, entries), and the worst status; `sound`: without
    the scene's spalls, which say where the phases of means are anyway."""
    (found,), code = _summed(of, at, sound, ValueOrSlopes(values, slopes=False, expands=False))
    return found, code


def with_slopes(of: Of, values: jax.Array, at: Conditions, sound: bool = False) -> tuple[jax.Array, jax.Array]:
    """`stiffness` that is differentiable by `values` alone, and once: its slopes are solved beside it, block by block,
    for to differentiate a loop takes several times as long to trace."""
    here = jax.lax.stop_gradient(values)
    (found, slopes), code = _summed(of, at, sound, ValueOrSlopes(here, slopes=True, expands=is_plain(of(here)[0])))
    return found + slopes @ (values - here), code


@np.errstate(all="ignore")
def of_numbers(scene: Scene, at: Conditions) -> np.ndarray:
    """Stiffness of every condition [N/mm], by `ENTRIES`, shape (size, entries), of a plain ring of numbers: all rings
    at once, and means by a rule of more points."""
    found, scene = np.full((at.size, len(ENTRIES)), np.nan), xp.numbers(scene)
    for definition, blocks in zip(at.definitions, at.blocks, strict=True):
        here = dataclasses.replace(scene, definition=definition)
        places, turned = _distinct(at, blocks), list[tuple[Any, Any]]()
        for k, ring in places.values():
            mean, load = int(blocks.mean[k]), Load(*blocks.loads[:, k, ring])
            if mean < 0:
                turned.append((blocks.phases[k, ring : ring + 1], np.ones(1)))
                continue
            still = None if blocks.still is None else np.asarray(blocks.still)[mean]
            borders = pitch_borders(dataclasses.replace(here, load=load, phase=PitchMean()), still)
            turned.append(xp.values(phase_rule.between(borders)))
        each = [len(phases) for phases, _ in turned]
        own = [np.repeat([blocks.loads[part, k, ring] for k, ring in places.values()], each) for part in (0, 1)]
        loaded = dataclasses.replace(here, load=Load(*own))
        rest = prepared.at_phases(here, np.concatenate([phases for phases, _ in turned]), loaded.load)
        stiffness, ends = xp.values(prepared.as_defined(loaded, rest)), np.cumsum(each)[:-1]
        parts = zip(np.split(stiffness, ends), np.split(xp.values(rest.displacement), ends), strict=True)
        for (place, (k, _)), (_, weights), (own, u) in zip(places.items(), turned, parts, strict=True):
            own = prepared.without_poles(here, u, own) if blocks.mean[k] >= 0 else own
            found[place] = np.einsum("p,pe->e", weights, own[:, ROW, COLUMN])
    return found


def _distinct(at: Conditions, blocks: Blocks) -> dict[int, tuple[int, int]]:
    """Block and ring of every condition, the first of those that count to it."""
    found: dict[int, tuple[int, int]] = {}
    for k in range(int(blocks.count)):
        for ring, place in enumerate(np.asarray(blocks.of)[k]):
            if place < at.size:
                found.setdefault(int(place), (k, ring))
    return found


class ValueOrSlopes(NamedTuple):
    """How functions of `values`, shape (parameters,), are told: by what they are there, or by that and their slopes: of
    one expansion, if all in them `expands`, which is traced in a third of the time; else by JAX."""

    values: jax.Array
    slopes: bool
    expands: bool

    def parts(self, function: Callable[..., tuple[Any, Any]], *given: Parts) -> tuple[Parts, Any]:
        """Parts of the first thing that `function(values, …)` returns, and the other; what else it takes, by parts."""
        if not self.slopes:
            own, beside = function(self.values, *(part for (part,) in given))
            return (own,), beside
        if self.expands:
            turned = (Taylor(part, jnp.moveaxis(slopes, -1, 0)) for part, slopes in given)
            own, beside = function(Taylor(self.values, jnp.eye(len(self.values))), *turned)
            value, slopes = xp.value(own), xp.by(own)
            none = jnp.zeros((*value.shape, len(self.values)))
            return (value, none if slopes is None else jnp.moveaxis(slopes, 0, -1)), xp.values(beside)

        def twice(values: jax.Array) -> tuple[jax.Array, tuple[jax.Array, Any]]:
            own, beside = function(values, *(part + slopes @ (values - self.values) for part, slopes in given))
            return own, (own, beside)

        slopes, (own, beside) = jax.jacfwd(twice, has_aux=True)(self.values)
        return (own, slopes), beside

    def zeros(self, *shape: int) -> Parts:
        """Of what has this shape."""
        return (jnp.zeros(shape), jnp.zeros((*shape, len(self.values))))[: 2 if self.slopes else 1]


def _summed(of: Of, at: Conditions, sound: bool, told: ValueOrSlopes) -> tuple[Parts, jax.Array]:
    """What the rings of all blocks add to the conditions to which they count, as it is told, and the worst status."""
    found, code = told.zeros(at.size + 1, len(ENTRIES)), jnp.asarray(status.CONVERGED)
    for definition, blocks in zip(at.definitions, at.blocks, strict=True):
        every: Blocks = jax.tree.map(jnp.asarray, blocks)
        borders = _borders(of, every, told)

        def more(
            k: jax.Array, state: tuple[Parts, jax.Array], definition: Definition = definition, every: Blocks = every,
            borders: Parts = borders,
        ) -> tuple[Parts, jax.Array]:  # fmt: skip
            def block(values: Values, turn: Any) -> tuple[Any, Any]:
                scene, loaded = of(values)
                scene = dataclasses.replace(healthy(scene) if sound else scene, definition=definition)
                turned, share = _turned(every, turn, k)
                solve = _at_once if told.expands else _one_by_one
                each, code = solve(scene, turned, loaded(Load(*every.loads[:, k])))
                return share[:, None] * each, xp.module_of(code).max(code)

            each, code = told.parts(block, tuple(part[every.mean[k]] for part in borders))
            added = tuple(s.at[every.of[k]].add(e) for s, e in zip(state[0], each, strict=True))
            return added, status.worst(state[1], code)

        found, code = jax.lax.fori_loop(0, every.count, more, (found, code))
    return tuple(part[:-1] for part in found), code


def _borders(of: Of, every: Blocks, told: ValueOrSlopes) -> Parts:
    """Between which phases [rad] there is no kink, of every mean, shape (means, borders), as it is told."""

    def one(k: jax.Array, found: Parts) -> Parts:
        def borders(values: Values) -> tuple[Any, None]:
            scene, loaded = of(values)
            scene = dataclasses.replace(scene, load=loaded(Load(*every.means[k])), phase=PitchMean())
            return pitch_borders(scene, None if every.still is None else every.still[k]), None

        own, _ = told.parts(borders)
        return tuple(whole.at[k].set(part) for whole, part in zip(found, own, strict=True))

    blank = told.zeros(len(every.means), every.phases.shape[1] + 1)
    return jax.lax.fori_loop(0, every.turns, one, blank)


def _turned(every: Blocks, borders: Any, k: jax.Array) -> tuple[Any, Any]:
    """Phases of a block's rings [rad] and by how much they count, shape (rings,); `borders` of its mean, if it is of
    one."""
    mean = every.mean[k] >= 0
    blank = jnp.linspace(0.0, 1.0, len(borders))  # without a mean there may be no borders
    turned, share = phase_rule.between(xp.where(mean, borders, blank), (every.places[k], every.weights[k]))
    return xp.where(mean, turned, every.phases[k]), xp.where(mean, share, 1.0)


def _at_once(scene: Scene, turned: Any, loads: Load) -> tuple[Any, Any]:
    """Stiffness of plain rings at all these phases [N/mm], each under its load, shape (rings, entries), and their
    statuses."""
    rest = prepared.at_phases(scene, turned, loads)
    found = prepared.as_defined(dataclasses.replace(scene, load=loads), rest)
    return found[:, ROW, COLUMN], rest.status_code


def _one_by_one(scene: Scene, turned: jax.Array, loads: Load) -> tuple[jax.Array, jax.Array]:
    """As `_at_once`, of rings with effects."""

    def one(phase: jax.Array, load: Load) -> tuple[jax.Array, jax.Array]:
        at = solving.solve(dataclasses.replace(scene, phase=phase, load=load))
        return at.stiffness[ROW, COLUMN], at.status_code

    return jax.vmap(one)(turned, loads)
