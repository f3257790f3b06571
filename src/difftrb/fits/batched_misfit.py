"""The misfit at many points at once, and least squares of it: programs, their batches, and threads that run them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from difftrb.core import machine
from difftrb.core.geometry import Real
from difftrb.core.jax_config import jit_quickly
from difftrb.fits import least_squares
from difftrb.fits.conditions import Conditions, whole
from difftrb.fits.fit_problem import ROBUST, Problem, basin_spacings
from difftrb.fits.least_squares import Alone, Enough, Least
from difftrb.fits.predicted import LOST, predictions, weighted_residuals
from difftrb.fits.stiffness_of_rows import with_slopes

LEAST_SHARE = 0.05
"""Of a measured loss: predicted ones below count as this."""
MANY = 1024
"""More points than these are worth a program of their own."""
BATCH, ROWS_BATCH = 16, 64
"""Most cases that one call evaluates; and without slopes, where calling takes as long as a few cases."""
ADAM = optax.adam(0.25)
"""Steps of a quarter, in coordinates."""


def solved(
    problem: Problem, points: np.ndarray, free: np.ndarray | bool, search: int, steps: int,
    enough: Enough = Enough(), ratios: bool = False, alone: Alone | None = None,  # noqa: B008
    room: np.ndarray | float = np.inf,
) -> Least:  # fmt: skip
    """Least squares from `points`, shape (cases, parameters), moving what is `free`: first `search` steps of Adam, then
    those of `alone`, then `steps` of Levenberg–Marquardt at most.

    `free`, `alone`, `room`: as for `least_squares.minimum`. With `ratios` deviations are as in `by_ratios`.
    """
    first = least_squares.First(_adam, _rest(points), search) if search else None
    evaluate = partial(by_ratios if ratios else evaluated, problem)
    longest = np.minimum(basin_spacings(problem), least_squares.LONGEST)
    return least_squares.minimum(evaluate, np.asarray(points), free, steps, first, enough, longest, alone, room)


@jit_quickly()
def _rest(points: Any) -> Any:
    return ADAM.init(points)


@jit_quickly()
def _adam(gradient: Any, memory: Any) -> tuple[Any, Any]:
    move, memory = ADAM.update(gradient, memory)
    return move, memory


def evaluated(problem: Problem, points: np.ndarray) -> least_squares.Evaluated:
    """Deviations as they count and their slopes by coordinates at `points`, shape (cases, parameters); beside them what
    the model says of the rows, and its status."""
    deviations, jacobian, *beside = _in_parts(_evaluated, problem, points)
    return least_squares.Evaluated(deviations, jacobian, tuple(beside))


def by_ratios(problem: Problem, points: np.ndarray) -> least_squares.Evaluated:
    """As `evaluated`, with the logarithm of a loss by the measured one in place of their difference, both small alike.

    A spall far off tells far too little or too much of a row. By their difference the one is a plateau, and the other
    outweighs all other rows; by their ratio both lead to where the rows agree, from several times as far."""
    values, slopes = _plainly(problem, points)
    rows, sigma = np.asarray(problem.measured), np.asarray(problem.sigma)
    loss, least = problem.conditions.loss & (rows > 0.0), LEAST_SHARE * np.abs(rows)
    with np.errstate(all="ignore"):
        above = np.where(loss, np.maximum(values, least), 1.0)
        size = np.where(loss, np.abs(rows), 1.0)
        off = np.where(loss, size * np.log(above / size), values - rows) / sigma
        rate = np.where(loss, size / above * (values > least), 1.0) / sigma
    known = np.isfinite(off)
    off, rate = np.where(known, off, LOST), np.where(known, rate, 0.0)
    return least_squares.Evaluated(off, np.nan_to_num(slopes) * rate[..., None], (values,))


def _plainly(problem: Problem, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the model says of the rows, however they were measured, and its slopes by coordinates."""
    rows = len(problem.conditions.condition)
    found = evaluated(dataclasses.replace(problem, measured=np.zeros(rows), sigma=np.ones(rows), common=0.0,
                                          robust=ROBUST.index("squares")), points)  # fmt: skip
    return found.beside[0], found.jacobian


def rows_at(problem: Problem, points: np.ndarray, many: bool | None = None) -> np.ndarray:
    """What the model says of the rows at `points`, shape (cases, rows). Of `many` by a program without slopes, which
    takes a quarter of the time, and seconds to compile. None: of more than `MANY`, or if it is compiled."""
    if many is None:
        many = len(points) > MANY or _kind(_rows, _laid_out(problem), ROWS_BATCH) in _compiled
    if not many:
        return evaluated(problem, points).beside[0]
    return _in_parts(_rows, problem, points, ROWS_BATCH)[0]


def _in_parts(
    program: Callable[..., tuple[jax.Array, ...]], problem: Problem, points: np.ndarray, batch: int = BATCH
) -> list[np.ndarray]:
    """What a program says of all points: in even parts, side by side."""
    rows, laid_out, cores = len(problem.measured), _laid_out(problem), machine.cores()
    count = -(-len(points) // batch)
    if len(points) > 1:
        count = min(-(-count // cores) * cores, len(points))

    def part(own: np.ndarray) -> list[np.ndarray]:
        padded = np.zeros((batch, points.shape[1]))
        padded[: len(own)] = own
        every = (np.asarray(out)[: len(own)] for out in program(laid_out, padded, len(own)))
        return [out[:, :rows] if out.ndim > 1 else out for out in every]

    parts = np.array_split(points, max(count, 1))
    kind = _kind(program, laid_out, batch)
    first = [] if kind in _compiled else [part(parts.pop(0))]
    _compiled.add(kind)
    found = [*first, *_pool(cores).map(part, parts)]
    return [np.concatenate(each) for each in zip(*found, strict=True)]


@cache
def _pool(cores: int) -> ThreadPoolExecutor:
    """Threads that stay: a fit asks them hundreds of times."""
    return ThreadPoolExecutor(cores)


def _kind(program: Callable[..., Any], laid_out: Problem, batch: int) -> Any:
    return program, batch, jax.tree.structure(laid_out), *map(np.shape, jax.tree.leaves(laid_out))


_compiled: set[Any] = set()
"""Programs by what they were compiled for: two threads would compile the same one twice."""


def costs(problem: Problem, predicted: np.ndarray) -> np.ndarray:
    """Half the sums of squares of what is `predicted` of the rows, shape (cases, rows); shape (cases,)."""
    count = len(problem.measured)
    longer = np.pad(predicted, ((0, 0), (0, whole(count) - count)))
    return np.asarray(_costs(_laid_out(problem), longer))


@jit_quickly()
def _costs(problem: Problem, rows: Real) -> jax.Array:
    return 0.5 * jnp.sum(jax.vmap(lambda values: weighted_residuals(problem, values))(rows) ** 2, axis=1)


def _laid_out(problem: Problem) -> Problem:
    """The problem with rows that do not count behind its own: one program does for many numbers of rows."""
    more = whole(len(problem.measured)) - len(problem.measured)

    at = _longer(problem.conditions, more)
    return dataclasses.replace(problem, conditions=at, rough=None, measured=_padded(problem.measured, more, 0.0),
                               sigma=_padded(problem.sigma, more, np.inf))  # fmt: skip


def _longer(at: Conditions, more: int) -> Conditions:
    """With so many more rows, of the first condition."""
    own = (_padded(rows, more, 0) for rows in (at.condition, at.entry, at.loss))
    return dataclasses.replace(at, **dict(zip(("condition", "entry", "loss"), own, strict=True)))


def _padded(rows: Any, more: int, value: Any) -> np.ndarray:
    return np.concatenate([np.asarray(rows), np.full(more, value, np.asarray(rows).dtype)])


@jit_quickly()
def _evaluated(problem: Problem, points: jax.Array, count: jax.Array) -> tuple[jax.Array, ...]:
    def misfit(u: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        values, code = predictions(problem, u, with_slopes)
        r = weighted_residuals(problem, values)
        return r, (r, values, code)

    def one(u: jax.Array) -> tuple[jax.Array, ...]:
        slopes, (r, values, code) = jax.jacfwd(misfit, has_aux=True)(u)
        return r, slopes, values, code

    return _each(one, points, count)


@jit_quickly()
def _rows(problem: Problem, points: jax.Array, count: jax.Array) -> tuple[jax.Array, ...]:
    return _each(lambda u: predictions(problem, u)[:1], points, count)


def _each(
    of: Callable[[jax.Array], tuple[jax.Array, ...]], points: jax.Array, count: jax.Array
) -> tuple[jax.Array, ...]:
    """`of` the first `count` points, one after the other: the rings of one fill the processor."""
    of = jax.jit(of, inline=True)  # traced once
    blank = tuple(jnp.zeros((len(points), *out.shape), out.dtype) for out in jax.eval_shape(of, points[0]))

    def one(k: jax.Array, out: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        return tuple(whole.at[k].set(own) for whole, own in zip(out, of(points[k]), strict=True))

    return jax.lax.fori_loop(0, count, one, blank)
