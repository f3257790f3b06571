"""Intervals of fitted parameters by profiles of the likelihood: how the least cost rises with one of them held."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.special

from difftrb.core.numeric import bisected
from difftrb.fits import predicted
from difftrb.fits.least_squares import FARTHEST
from difftrb.fits.predicted import Problem

EDGE = 7.0
"""Coordinates beyond ± this, the outer thousandth of the range, count as the bound."""
NEAR = np.array([0.75, 1.5, 2.25, 3.0])
"""Places of a profile on either side, in standard errors."""
FAR = np.array([0.15, 0.45, 1.0])
"""More of them, as shares of the way from the last one to the bound."""
WITHIN = 3
"""Places between the two that an end of an interval lies between: to 1e-3 of a standard error then."""
ROUNDS = 5
"""Times that places are put between those, at most."""
STEEP = 3.0
"""Where the root of the rise is this many times what it is at an end, it is not told by its neighbours."""
CLOSE = 0.01
"""Places this close, as a share of how far they are, tell an end well enough, whatever is between them."""
STEPS = 25
ENOUGH = 1e-5
"""Gain of half χ² that is not worth a step of a profile, whose ends are where χ² has risen by 4 or so."""
BESIDE = 0.5
"""A profile's place starts from the lowest known point that lies closer than this, in coordinates, too."""
NORMAL_95 = 1.959963984540054
"""Standard errors to either side of a 95 % interval of the normal distribution."""


class Known(NamedTuple):
    """Places where the cost was computed, shape (places, parameters), and the costs, shape (places,)."""

    place: np.ndarray
    cost: np.ndarray


class Profiles(NamedTuple):
    """Profile of every parameter: what is the least sum of squares with it held at a place, all others free.

    Attributes:
      coordinates: places, rising, shape (parameters, places). rise: of twice the cost over its least, same shape.
      ends: of the interval, in coordinates, shape (parameters, 2). open: whether an end is the bound, not the data's.
      lowest: the best place seen, shape (parameters,); lowest_cost: its cost, below the fit's if it was not least.
    """

    coordinates: np.ndarray
    rise: np.ndarray
    ends: np.ndarray
    open: np.ndarray
    lowest: np.ndarray
    lowest_cost: float


def covariance(normal: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Of coordinates at the place u, from the normal matrix JᵀJ there, both of shape (parameters, parameters).

    0 for parameters at a bound; huge but finite for what the normal matrix does not know.
    """
    free = np.abs(u) < EDGE
    both = free[:, None] & free[None, :]
    size = np.sqrt(np.where(free & (np.diag(normal) > 0.0), np.diag(normal), 1.0))
    matrix = np.where(both, normal / np.outer(size, size), np.eye(len(u)))
    known, directions = np.linalg.eigh(matrix)
    inverted = (directions / np.maximum(known, 1e-13)[None, :]) @ directions.T
    return np.where(both, inverted / np.outer(size, size), 0.0)


def held(
    problem: Problem, u: np.ndarray, normal: np.ndarray, free: np.ndarray, at: np.ndarray, known: Known
) -> tuple[np.ndarray, np.ndarray]:
    """Least costs, shape (cases,), and their places, with the parameters that are not `free`, shape (cases,
    parameters), held where `at`, same shape, has them. The others start where the quadratic about u expects them, and
    from the lowest known point near by: another basin may be deeper there."""
    start = at.copy()
    for case, (moves, place) in enumerate(zip(free, at, strict=True)):
        if moves.any():
            within = normal[np.ix_(moves, moves)]
            damped = within + np.diag(1e-9 * np.diag(within) + 1e-300)
            follow = -np.linalg.solve(damped, normal[np.ix_(moves, ~moves)] @ (place - u)[~moves])
            start[case, moves] = np.clip(u[moves] + np.clip(follow, -3.0, 3.0), -EDGE, EDGE)
    if not free.any():
        found = predicted.solved(problem, start, free, 0, 0)
        return np.where(np.isfinite(found.cost), found.cost, np.inf), found.place
    other = at.copy()
    for case, (moves, place) in enumerate(zip(free, at, strict=True)):
        away = np.max(np.abs(known.place - place)[:, ~moves], axis=1, initial=0.0)
        nearest = np.argmin(np.where(away < BESIDE, known.cost, np.max(known.cost) + away))
        other[case, moves] = known.place[nearest, moves]
    found = predicted.solved(problem, np.concatenate([start, other]), np.tile(free, (2, 1)), 0, STEPS, ENOUGH)
    cost = np.where(np.isfinite(found.cost), found.cost, np.inf).reshape(2, -1)
    better = np.argmin(cost, axis=0)
    each = np.arange(len(at))
    return cost[better, each], found.place.reshape(2, *at.shape)[better, each]


def profiles(problem: Problem, u: np.ndarray, cost: float, normal: np.ndarray, limit: float, known: Known) -> Profiles:
    """Profiles about the least place u, shape (parameters,), with its cost and normal matrix, and where they have risen
    by `limit`: first over the whole range, then between the places that an interval's ends lie between, until the rise
    behind an end is no cliff."""
    count = len(u)
    seen: list[tuple[np.ndarray, ...]] = []

    def risen(which: np.ndarray, at: np.ndarray) -> np.ndarray:
        """With the parameters `which` held `at` places, both of one shape."""
        free = which.ravel()[:, None] != np.arange(count)
        costs, where = held(problem, u, normal, free, np.where(free, u, at.ravel()[:, None]), known)
        rise = 2.0 * (costs - cost)
        seen.append((which.ravel(), at.ravel(), rise, costs, where))
        return rise.reshape(at.shape)

    places = _places(u, np.sqrt(np.diag(covariance(normal, u)) * limit) / 2.0)
    rise = risen(np.broadcast_to(np.arange(count)[:, None, None], places.shape), places)
    least = np.broadcast_to(u[:, None, None], (count, 2, 1))
    root = np.concatenate([np.zeros_like(least), np.sqrt(np.maximum(rise, 0.0))], axis=2)
    reached = (root > np.sqrt(limit)).any(axis=2)
    brackets = _bracket(np.concatenate([least, places], axis=2), root, limit)
    ends, unclear = np.where(reached, 0.0, np.array([-np.inf, np.inf])), reached.copy()
    for _ in range(ROUNDS if reached.any() else 0):
        own, (before, low, behind, high) = np.nonzero(unclear), brackets[unclear].T[..., None]
        inner = before + (behind - before) * np.arange(1, WITHIN + 1) / (WITHIN + 1)
        rise = risen(np.broadcast_to(own[0][:, None], inner.shape), inner)
        at = np.concatenate([before, inner, behind], axis=1)
        root = np.concatenate([low, np.sqrt(np.maximum(rise, 0.0)), high], axis=1)
        root = np.maximum.accumulate(root, axis=1)
        ends[own] = [np.interp(np.sqrt(limit), *pair) for pair in zip(root, at, strict=True)]
        brackets[own] = _bracket(at, root, limit)
        near = np.abs(brackets[own][:, 2] - brackets[own][:, 0]) < CLOSE * np.abs(brackets[own][:, 2] - u[own[0]])
        unclear[own] = (root[:, -1] > STEEP * np.sqrt(limit)) & ~near
        if not unclear.any():
            break
    which, at, rise, costs, where = (np.concatenate(each) for each in zip(*seen, strict=True))
    longest = np.max(np.bincount(which)) + 1
    told = np.tile(np.stack([u, np.zeros(count)])[..., None], longest)  # the least place, as often as it fills the rest
    for i in range(count):
        of = which == i
        told[:, i, : of.sum()] = at[of], rise[of]
    order = np.argsort(told[0], axis=1)
    return Profiles(
        coordinates=np.take_along_axis(told[0], order, 1),
        rise=np.take_along_axis(told[1], order, 1),
        ends=np.clip(ends, -FARTHEST, FARTHEST),
        open=~reached,
        lowest=where[np.argmin(costs)],
        lowest_cost=float(np.min(costs)),
    )


def _bracket(at: np.ndarray, root: np.ndarray, limit: float) -> np.ndarray:
    """Place and root of the rise before and behind where it first passes the limit, shape (…, 4), of places `at` and
    their roots, shape (…, places); of no use where it does not."""
    k = np.maximum(np.argmax(root > np.sqrt(limit), axis=-1), 1)[..., None]
    return np.concatenate([np.take_along_axis(each, j, -1) for j in (k - 1, k) for each in (at, root)], axis=-1)


def _places(u: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Where profiles are computed: on either side of u some near, in `spread`s of shape (parameters,), and some as far
    as the bound; shape (parameters, 2, places)."""
    half = len(NEAR) + len(FAR)
    places = np.empty((len(u), 2, half))
    for i in range(len(u)):
        for k, side in enumerate((-1.0, 1.0)):
            room = max(EDGE - side * u[i], 1e-3)
            near = NEAR * (spread[i] or 1.0)
            far = near[-1] + (room - near[-1]) * FAR
            even = room * np.arange(1, half + 1) / half
            places[i, k] = u[i] + side * (np.concatenate([near, far]) if near[-1] < 0.7 * room else even)
    return places


def limit_of(freedom: int | None) -> float:
    """Rise of chi² at the ends of a 95 % interval: of the normal distribution or, with sigma estimated from so many
    degrees of freedom, of Student's t, whose square it is."""
    if freedom is None:
        return NORMAL_95**2

    def outside(t2: np.ndarray) -> bool:  # an incomplete beta function (Abramowitz and Stegun, 26.7.1)
        return float(scipy.special.betainc(0.5 * freedom, 0.5, freedom / (freedom + t2))) > 0.05

    low, high = bisected(outside, np.zeros(()), np.asarray(1e6), 80)
    return 0.5 * float(low + high)
