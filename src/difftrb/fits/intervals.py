"""How far measurements determine what was fitted: covariance, profiles of the likelihood, and what they leave open."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.fits import least_squares, predicted
from difftrb.fits.parameters import FARTHEST
from difftrb.fits.predicted import Problem

EDGE = 7.0
"""Coordinates beyond ± this, the outer thousandth of the range, count as the bound."""
NEAR = (0.75, 1.5, 2.25, 3.0)
"""Places of a profile on either side, in standard errors."""
FAR = (0.15, 0.45, 1.0)
"""More of them, as shares of the way from the last one to the bound."""
WITHIN = 3
"""Places between the two that an end of an interval lies between: to 1e-3 of a standard error then."""
STEPS = 25
ENOUGH = 1e-5
"""Gain of half χ² that is not worth a step of a profile, whose ends are where χ² has risen by 4 or so."""


class Profiles(NamedTuple):
    """Profile of every unknown: what is the least sum of squares with it held at a place, all others free.

    Attributes:
      coordinates: places, rising, shape (unknowns, places). rise: of twice the cost over its least, same shape.
      ends: of the interval, in coordinates, shape (unknowns, 2). open: whether an end is the bound, not the data's.
      lowest: the best place seen, shape (unknowns,), and lowest_cost its cost: below the fit's if it was not the least.
    """

    coordinates: np.ndarray
    rise: np.ndarray
    ends: np.ndarray
    open: np.ndarray
    lowest: np.ndarray
    lowest_cost: float


def natural_slope(problem: Problem, u: np.ndarray) -> np.ndarray:
    """Slope of the values' logarithms (of the values themselves for what is no size) by coordinates, shape
    (unknowns,)."""
    low, high = (np.asarray(end) for end in problem.unknowns.ends())
    share = 1.0 / (1.0 + np.exp(-np.asarray(u)))
    return (high - low) * share * (1.0 - share)


def covariance(normal: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Of coordinates at the place u, from the normal matrix JᵀJ there, both of shape (unknowns, unknowns).

    0 for unknowns at a bound; huge but finite for what the normal matrix does not know.
    """
    free = np.abs(u) < EDGE
    both = free[:, None] & free[None, :]
    size = np.sqrt(np.where(free & (np.diag(normal) > 0.0), np.diag(normal), 1.0))
    matrix = np.where(both, normal / np.outer(size, size), np.eye(len(u)))
    known, directions = np.linalg.eigh(matrix)
    inverted = (directions / np.maximum(known, 1e-13)[None, :]) @ directions.T
    return np.where(both, inverted / np.outer(size, size), 0.0)


Solve = Callable[[Problem, np.ndarray, np.ndarray, int, int, float], least_squares.Least]
"""Least squares from places, shape (cases, unknowns), of which those `free` move, same shape; steps of the search, and
of Levenberg–Marquardt; what gain is not worth a step: `fitting.solved`."""


def held(
    solve: Solve, problem: Problem, u: np.ndarray, normal: np.ndarray, free: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least costs, shape (cases,), and their places, with the unknowns that are not `free`, shape (cases, unknowns),
    held where `at`, same shape, has them; started where the quadratic about u expects the others."""
    start = at.copy()
    for case, (moves, place) in enumerate(zip(free, at, strict=True)):
        if moves.any():
            within = normal[np.ix_(moves, moves)]
            damped = within + np.diag(1e-9 * np.diag(within) + 1e-300)
            follow = -np.linalg.solve(damped, normal[np.ix_(moves, ~moves)] @ (place - u)[~moves])
            start[case, moves] = np.clip(u[moves] + np.clip(follow, -3.0, 3.0), -EDGE, EDGE)
    found = solve(problem, start, free, 0, STEPS if free.any() else 0, ENOUGH)
    cost = np.asarray(found.cost)
    return np.where(np.isfinite(cost), cost, np.inf), np.asarray(found.place)


def profiles(solve: Solve, problem: Problem, u: np.ndarray, cost: float, normal: np.ndarray, limit: float) -> Profiles:
    """Profiles about the least place u, shape (unknowns,), with its cost and normal matrix, and where they have risen
    by `limit`: once over the whole range, once between the places that an interval's ends lie between."""
    count, half = len(u), len(NEAR) + len(FAR)
    spread = np.sqrt(np.diag(covariance(normal, u)) * limit) / 2.0
    places = np.empty((count, 2, half))
    for i in range(count):
        for k, side in enumerate((-1.0, 1.0)):
            room = max(EDGE - side * u[i], 1e-3)
            near = np.array(NEAR) * (spread[i] or 1.0)
            far = near[-1] + (room - near[-1]) * np.array(FAR)
            even = room * np.arange(1, half + 1) / half
            places[i, k] = u[i] + side * (np.concatenate([near, far]) if near[-1] < 0.7 * room else even)

    def risen(at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        free = np.repeat(np.arange(count), at[0].size)[:, None] != np.arange(count)[None, :]
        costs, where = held(solve, problem, u, normal, free, np.where(free, u[None, :], at.ravel()[:, None]))
        return 2.0 * (costs - cost).reshape(at.shape), costs, where

    rise, costs, where = risen(places)
    brackets = np.empty((count, 2, 4))  # place and root of the rise before an end, and behind it
    reached = np.zeros((count, 2), bool)
    for i, k in np.ndindex(count, 2):
        beyond = np.nonzero(rise[i, k] > limit)[0]
        reached[i, k] = len(beyond) > 0
        last = beyond[0] if reached[i, k] else half - 1
        start = (places[i, k, last - 1], rise[i, k, last - 1]) if last else (u[i], 0.0)
        brackets[i, k] = start[0], max(start[1], 0.0) ** 0.5, places[i, k, last], max(rise[i, k, last], 0.0) ** 0.5
    inner = brackets[..., :1] + (brackets[..., 2:3] - brackets[..., :1]) * np.arange(1, WITHIN + 1) / (WITHIN + 1)
    finer, *_ = risen(inner)
    ends = np.empty((count, 2))
    for i, k in np.ndindex(count, 2):
        at = np.concatenate([brackets[i, k, :1], inner[i, k], brackets[i, k, 2:3]])
        root = np.concatenate([brackets[i, k, 1:2], np.sqrt(np.maximum(finer[i, k], 0.0)), brackets[i, k, 3:]])
        ends[i, k] = (
            np.interp(np.sqrt(limit), np.maximum.accumulate(root), at) if reached[i, k] else np.inf * (2 * k - 1)
        )
    best = int(np.argmin(costs))
    every = np.concatenate([places.reshape(count, -1), inner.reshape(count, -1), u[:, None]], 1)
    order = np.argsort(every, axis=1)
    rises = np.concatenate([rise.reshape(count, -1), finer.reshape(count, -1), np.zeros((count, 1))], 1)
    return Profiles(
        coordinates=np.take_along_axis(every, order, 1),
        rise=np.take_along_axis(rises, order, 1),
        ends=np.clip(ends, -FARTHEST, FARTHEST),
        open=~reached,
        lowest=where[best],
        lowest_cost=float(costs[best]),
    )


def ridge(
    solve: Solve, problem: Problem, u: np.ndarray, cost: float, normal: np.ndarray, box: np.ndarray, points: int = 21
) -> np.ndarray:
    """Rise of twice the cost over a grid of the first two unknowns, all others free: shape (points, points), the first
    along rows. `box` are coordinates: (first low, high), (second low, high), shape (2, 2)."""
    grid = np.meshgrid(*(np.linspace(low, high, points) for low, high in box), indexing="ij")
    at = np.tile(u, (points * points, 1))
    at[:, 0], at[:, 1] = (axis.ravel() for axis in grid)
    free = np.tile(np.arange(len(u)) > 1, (len(at), 1))
    costs, _ = held(solve, problem, u, normal, free, at)
    return 2.0 * (costs - cost).reshape(points, points)


@jax.jit
def by_data(problem: Problem, u: jax.Array) -> jax.Array:
    """Derivative of the fitted values by the measured ones, shape (unknowns, rows), at the least place u.

    By the implicit function theorem with the whole second derivative, so exact for data that the model does not meet.
    """

    def gradient(v: jax.Array, measured: jax.Array) -> jax.Array:
        own = dataclasses.replace(problem, measured=measured)
        return jax.jacfwd(lambda w: 0.5 * jnp.sum(predicted.residual(own, w) ** 2))(v)

    curvature = jax.jacfwd(gradient)(u, problem.measured)
    moved = -jnp.linalg.solve(curvature, jax.jacfwd(gradient, 1)(u, problem.measured))
    return jax.jacfwd(problem.unknowns.values)(u) @ moved


def tail(chi2: float, freedom: int) -> float:
    """Chance that chi² of so many degrees of freedom is larger."""
    return float(jax.scipy.special.gammaincc(0.5 * freedom, 0.5 * chi2))


def limit_of(freedom: int | None) -> float:
    """Rise of chi² at the ends of a 95 % interval: of the normal distribution or, with sigma estimated from so many
    degrees of freedom, of Student's t, whose square it is."""
    if freedom is None:
        return 1.959963984540054**2
    low, high = 0.0, 1e6
    for _ in range(80):  # the tail of t² is an incomplete beta function (Abramowitz and Stegun, 26.7.1)
        t2 = 0.5 * (low + high)
        outside = float(jax.scipy.special.betainc(0.5 * freedom, 0.5, freedom / (freedom + t2)))
        low, high = (t2, high) if outside > 0.05 else (low, t2)
    return 0.5 * (low + high)


class Combination(NamedTuple):
    """A product of powers of sizes: the exponents by name, and the standard error of its logarithm."""

    powers: dict[str, float]
    error: float


def best_determined(names: tuple[str, ...], covariance: np.ndarray) -> Combination:
    """The product of powers that is known best, from the covariance of logarithms of `names`."""
    _, directions = np.linalg.eigh(covariance)
    powers = directions[:, 0] / directions[np.argmax(np.abs(directions[:, 0])), 0]
    return Combination(dict(zip(names, powers.tolist(), strict=True)), float(np.sqrt(powers @ covariance @ powers)))
