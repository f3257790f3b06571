"""What the model says of measurements, how far it misses them, and where it misses them least.

Every condition is solved once, and every row is read from that.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax

from difftrb.core import machine, status
from difftrb.core.geometry import Real
from difftrb.core.jax_config import jit_quickly
from difftrb.fits import least_squares
from difftrb.fits import parameters as fit_parameters
from difftrb.fits.least_squares import Bounds, Least
from difftrb.fits.measured import Measurement
from difftrb.fits.parameters import Parameter
from difftrb.ring.ring import Load
from difftrb.scene import solving
from difftrb.scene.scene import Definition, PitchMean, Scene, healthy
from difftrb.scene.scene import phases as phases_of

Kind = tuple[Definition, bool]
"""Of stiffness, and whether it is the mean over phases."""
ROBUST = ("squares", "huber", "student")
HUBER = 1.345
"""Deviations beyond this many sigma count linearly: 95 % efficient on normal errors (Huber 1981)."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t for data with outliers (Lange, Little and Taylor 1989)."""
LOST = 1e3
"""Deviation [sigma] of a row that the model has no solution for."""
BATCH = 16
"""Most cases that one call evaluates."""
ADAM = optax.adam(0.25)
"""Steps of a quarter, in coordinates."""


MEAN = PitchMean(5)
"""Means over phases have half the points that they have elsewhere: a hundredth of the noise of good measurements."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Conditions:
    """What to solve for rows of measurements, and where each row finds itself in it.

    Attributes:
      kinds: of stiffness and phase. each: for each kind radial load [N], axial load [N], phase [rad], shape
        (conditions, 3). place: of every row among the conditions of all kinds one after the other, shape (rows,).
      axis: 0 radial, 1 axial, shape (rows,). loss: whether it is a loss, shape (rows,).
      mean: over phases, and with how many points.
    """

    kinds: tuple[Kind, ...] = dataclasses.field(metadata={"static": True})
    each: tuple[jax.Array, ...]
    place: jax.Array
    axis: jax.Array
    loss: jax.Array
    mean: PitchMean = MEAN


def conditions(scene: Scene, rows: Sequence[Measurement]) -> Conditions:
    """Those of `rows`; what they leave open is the scene's."""
    found: dict[Kind, list[tuple[float, float, float]]] = {}
    seen = []
    for row in rows:
        phase = scene.phase if row.phase is None else row.phase
        mean = isinstance(phase, str | PitchMean)
        kind: Kind = (row.definition or scene.definition, mean)
        condition = float(row.radial), float(row.axial), 0.0 if mean else float(phase)  # type: ignore[arg-type]
        of_kind = found.setdefault(kind, [])
        if condition not in of_kind:
            of_kind.append(condition)
        seen.append((kind, of_kind.index(condition)))
    first = dict(zip(found, np.cumsum([0, *map(len, found.values())]).tolist(), strict=False))
    return Conditions(
        kinds=tuple(found),
        each=tuple(map(jnp.asarray, found.values())),
        place=jnp.array([first[kind] + k for kind, k in seen]),
        axis=jnp.array([0 if row.quantity.startswith("radial") else 1 for row in rows]),
        loss=jnp.array([row.is_loss for row in rows]),
    )


def predicted(
    parameters: Sequence[Parameter], scene: Scene, at: Conditions, values: jax.Array, sound: jax.Array | None = None
) -> tuple[jax.Array, jax.Array]:
    """What the model says of every row [% or N/mm], shape (rows,), and the worst status of all solves.

    `scene` is prepared; `values` of shape (parameters,); `sound` is `healthy_stiffness` where no parameter changes it.
    Differentiable by all of it.
    """
    scene = fit_parameters.put(parameters, scene, values)

    def loaded(load: Load) -> Load:
        for parameter, value in zip(parameters, values, strict=True):
            load = parameter.load(load, value)
        return load

    stiffness, code = _stiffness(scene, at, loaded)
    if sound is None:
        sound, other = _stiffness(healthy(scene), at, loaded)
        code = status.worst(code, other)
    spalled, sound = (pair[at.place, at.axis] for pair in (stiffness, sound))
    added = sound / spalled - 1.0
    for parameter, value in zip(parameters, values, strict=True):
        sound, added = parameter.measured(sound, added, value)
    left = 1.0 / (1.0 + added)
    return jnp.where(at.loss, 100.0 * (1.0 - left), sound * left), code


@jit_quickly()
def healthy_stiffness(scene: Scene, at: Conditions) -> jax.Array:
    """Of the prepared scene without spalls, radial and axial, of every condition [N/mm], shape (conditions, 2)."""
    return _stiffness(healthy(scene), at, lambda load: load)[0]


def _stiffness(scene: Scene, at: Conditions, loaded: Callable[[Load], Load]) -> tuple[jax.Array, jax.Array]:
    """Radial and axial stiffness of every condition [N/mm], shape (conditions, 2), and the worst status.

    All phases of all conditions are solved side by side: a program for one and one for means would be compiled twice.
    """

    def under(condition: jax.Array, mean: bool) -> Scene:
        load = loaded(Load(condition[0], condition[1]))
        return dataclasses.replace(scene, load=load, phase=at.mean if mean else condition[2])

    def phases(condition: jax.Array, mean: bool) -> tuple[jax.Array, jax.Array]:
        each, weights = phases_of(under(condition, mean))
        return jnp.stack([jnp.broadcast_to(v, each.shape) for v in (condition[0], condition[1], each)], 1), weights

    def one(condition: jax.Array, definition: Definition) -> tuple[jax.Array, jax.Array]:
        solved = solving.solve(dataclasses.replace(under(condition, False), definition=definition))
        return jnp.stack([solved.radial_stiffness, solved.axial_stiffness]), solved.status_code

    every: dict[int, jax.Array] = {}
    codes = []
    definitions: dict[Definition, None] = dict.fromkeys(definition for definition, _ in at.kinds)
    for definition in definitions:
        own = [k for k, kind in enumerate(at.kinds) if kind[0] == definition]
        parts = [jax.vmap(partial(phases, mean=at.kinds[k][1]))(at.each[k]) for k in own]
        together = jnp.concatenate([each.reshape(-1, 3) for each, _ in parts])
        stiffness, code = jax.vmap(partial(one, definition=definition))(together)
        codes.append(jnp.max(code))
        ends = np.cumsum([weights.size for _, weights in parts])[:-1]
        for k, (_, weights), found in zip(own, parts, jnp.split(stiffness, ends), strict=True):
            every[k] = jnp.einsum("cp,cpd->cd", weights, found.reshape(*weights.shape, 2))
    return jnp.concatenate([every[k] for k in range(len(at.kinds))]), status.worst(*codes)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Problem:
    """Measurements against the model.

    Attributes:
      parameters: what is sought, within `bounds`. scene: prepared. conditions: of the rows.
      measured, sigma: values and their standard deviations [% or N/mm], shape (rows,).
      sound: `healthy_stiffness` unless a parameter changes it.
      common: the model's own relative error, which all losses share, and all stiffnesses.
      robust: how deviations count: the number of a name in `ROBUST`.
    """

    parameters: tuple[Parameter, ...] = dataclasses.field(metadata={"static": True})
    bounds: Bounds
    scene: Scene
    conditions: Conditions
    measured: jax.Array
    sigma: jax.Array
    sound: jax.Array | None
    common: Real
    robust: int | jax.Array


def residual(problem: Problem, u: jax.Array) -> jax.Array:
    """What least squares is made of, shape (rows,), at coordinates u: see `counted`."""
    return counted(problem, predictions(problem, u)[0])


def predictions(problem: Problem, u: jax.Array, at: Conditions | None = None) -> tuple[jax.Array, jax.Array]:
    """See `predicted`: at coordinates u, of the problem's rows or of others `at` other conditions."""
    at, sound = (problem.conditions, problem.sound) if at is None else (at, None)
    return predicted(problem.parameters, problem.scene, at, problem.bounds.values(u), sound)


def _without_common(r: jax.Array, along: jax.Array, common: Real) -> jax.Array:
    """Deviations r whose errors are independent but for one of size `common` in the direction `along`, all of shape
    (rows,), turned into independent ones: by the root of the inverse of 1 + common² along alongᵀ."""
    size = jnp.vdot(along, along)
    share = (1.0 - 1.0 / jnp.sqrt(1.0 + common**2 * size)) / jnp.where(size > 0.0, size, 1.0)
    return r - share * jnp.vdot(along, r) * along


def counted(problem: Problem, values: jax.Array) -> jax.Array:
    """Predicted `values` minus measured ones in sigma as it counts, shape (rows,): half the sum of squares is the
    negative log likelihood up to a constant."""
    known = jnp.isfinite(values)
    r = jnp.where(known, (values - problem.measured) / problem.sigma, LOST)
    common = jnp.where(problem.robust == ROBUST.index("squares"), problem.common, 0.0)
    # of what is predicted: a share of the measured values would pull every fit below them
    scale = jnp.where(known, values, problem.measured) / problem.sigma
    for kind in (problem.conditions.loss, ~problem.conditions.loss):
        r = _without_common(r, jnp.where(kind, scale, 0.0), common)
    size, sign = jnp.abs(r), jnp.sign(r)
    beyond, far = size > HUBER, size > 1e-6
    huber = jnp.sqrt(HUBER * (2.0 * jnp.where(beyond, size, HUBER) - HUBER))
    student = jnp.sqrt((FREEDOM + 1.0) * jnp.log1p(jnp.where(far, size, 1.0) ** 2 / FREEDOM))
    ways = {
        "squares": r,
        "huber": jnp.where(beyond, sign * huber, r),
        "student": jnp.where(far, sign * student, r * np.sqrt((FREEDOM + 1.0) / FREEDOM)),
    }
    return jnp.select([problem.robust == k for k in range(len(ROBUST))], [ways[name] for name in ROBUST], r)


def solved(
    problem: Problem, places: np.ndarray, free: np.ndarray, search: int, steps: int, enough: float = 0.0,
    meet: np.ndarray | None = None, behind: float = 0.0,
) -> Least:  # fmt: skip
    """Least squares from `places`, shape (cases, parameters), moving those coordinates that are `free`, same shape:
    first `search` steps of Adam, then `steps` of Levenberg–Marquardt at most; the rest as in `least_squares.minimum`.
    """
    first = least_squares.First(_adam, ADAM.init(jnp.asarray(places)), search) if search else None
    evaluate, longest = partial(evaluated, problem), np.minimum(scales(problem), least_squares.LONGEST)
    return least_squares.minimum(evaluate, np.asarray(places), free, steps, first, enough, meet, behind, longest)


def scales(problem: Problem) -> np.ndarray:
    """How far basins lie apart, in coordinates in the middle of the range, shape (parameters,)."""
    low, high = (np.asarray(end) for end in problem.bounds.ends())
    return 4.0 * np.array([parameter.apart(problem.scene) for parameter in problem.parameters]) / (high - low)


@jit_quickly()
def _adam(gradient: jax.Array, memory: optax.OptState) -> tuple[jax.Array, optax.OptState]:
    move, memory = ADAM.update(gradient, memory)
    return move, memory  # type: ignore[return-value]  # optax says any tree of arrays


def evaluated(problem: Problem, places: np.ndarray) -> least_squares.Evaluated:
    """Deviations as they count and their slopes by coordinates at `places`, shape (cases, parameters); beside them what
    the model says of the rows, and its status."""
    deviations, jacobian, *beside = _in_parts(_evaluated, problem, places)
    return least_squares.Evaluated(deviations, jacobian, tuple(beside))


def told(problem: Problem, places: np.ndarray) -> np.ndarray:
    """What the model says of the rows at `places`, shape (cases, rows): a quarter of the time of `evaluated`."""
    return _in_parts(_told, problem, places)[0]


def _in_parts(program: Callable[..., tuple[jax.Array, ...]], problem: Problem, places: np.ndarray) -> list[np.ndarray]:
    """What a program says of all places: in parts of one size, side by side."""

    def part(k: int) -> list[np.ndarray]:
        own = places[k : k + BATCH]
        padded = np.zeros((BATCH, places.shape[1]))
        padded[: len(own)] = own
        return [np.asarray(out)[: len(own)] for out in program(problem, padded, len(own))]

    first = part(0)  # compiles
    with ThreadPoolExecutor(machine.cores()) as pool:
        parts = [first, *pool.map(part, range(BATCH, len(places), BATCH))]
    return [np.concatenate(each) for each in zip(*parts, strict=True)]


@jit_quickly()
def _evaluated(problem: Problem, places: jax.Array, count: jax.Array) -> tuple[jax.Array, ...]:
    def misfit(u: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        values, code = predictions(problem, u)
        r = counted(problem, values)
        return r, (r, values, code)

    def one(u: jax.Array) -> tuple[jax.Array, ...]:
        slopes, (r, values, code) = jax.jacfwd(misfit, has_aux=True)(u)
        return r, slopes, values, code

    return _each(one, places, count)


@jit_quickly()
def _told(problem: Problem, places: jax.Array, count: jax.Array) -> tuple[jax.Array, ...]:
    return _each(lambda u: predictions(problem, u)[:1], places, count)


def _each(
    of: Callable[[jax.Array], tuple[jax.Array, ...]], places: jax.Array, count: jax.Array
) -> tuple[jax.Array, ...]:
    """`of` the first `count` places, one after the other: the rings of one fill the processor."""
    blank = tuple(jnp.zeros((len(places), *out.shape), out.dtype) for out in jax.eval_shape(of, places[0]))

    def one(k: jax.Array, out: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        return tuple(whole.at[k].set(own) for whole, own in zip(out, of(places[k]), strict=True))

    return jax.lax.fori_loop(0, count, one, blank)
