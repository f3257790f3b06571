"""Intervals of fitted parameters by profiles of the likelihood: how the least cost rises with one of them held."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from difftrb.fits import batched_misfit, edges_at_rollers
from difftrb.fits.fit_problem import Problem, basin_spacings
from difftrb.fits.least_squares import AT_BOUND, FARTHEST, Enough
from difftrb.fits.search import SAME

NEAR = np.array([0.75, 1.5, 2.25, 3.25])
"""Points of a profile on either side, in standard errors."""
FAR = np.array([0.15, 0.45, 1.0])
"""More of them, as shares of the way from the last one to the bound."""
FACTOR = 6.0
"""Between the last near and the first far one each is at most so many times as far as the one before: where a minimum
is far narrower than the range, another one that is wide may lie close behind it."""
WITHIN = 3
"""Points between the two that an end of an interval lies between: to 1e-3 of a standard error then."""
ROUNDS = 5
"""Times that points are put between those, at most."""
STEEP = 3.0
"""Where the root of the rise is this many times what it is at an end, it is not told by its neighbours."""
CLOSE = 0.01
"""Points this close, as a share of how far they are, tell an end well enough, whatever is between them."""
STEPS = 25
ENOUGH = 1e-5
"""Gain of half χ² that is not worth a step of a profile, whose ends are where χ² has risen by 4 or so."""
BEHIND, MARGIN = 0.05, 20.0
"""A case whose half χ² is more than the margin above the least one, and whose step is expected to gain less than this
share of what it is more, will not come near it."""
FLAT = 0.25
"""Points that have risen by less than this share of the limit are not tried again from others."""
MEET = 0.01
"""Cases that come this close to each other, of what parts basins, go on as one."""
INSIDE = 2.0
"""Coordinate from which a parameter starts that is at a bound."""
BESIDE = 0.5
"""A profile's point starts from the lowest known point that lies closer than this, in coordinates, too."""
CONFIDENCE, SURE = 0.95, 0.9973
"""Of intervals: how often they hold what is sought; and of where they end if χ² levels off behind that, for then a
little noise decides."""
BENT = 4.0
"""An interval's end this many times as far as its standard error says, or this near, belies it."""
LEVELS_OFF = 3.0
"""An interval that would be this many times as long on one side to be sure is so there. Of a normal likelihood it is
1.5 times as long."""


class KnownCosts(NamedTuple):
    """Points where the cost was computed, shape (points, parameters), and the costs, shape (points,)."""

    points: np.ndarray
    cost: np.ndarray


class Profiles(NamedTuple):
    """Profile of every parameter: what is the least sum of squares with it held at a point, all others free.

    Attributes:
      coordinates: points, rising, shape (parameters, points). rise: of twice the cost over its least, same shape.
      ends: of the interval, in coordinates, shape (parameters, 2); see `SURE`. open: whether an end is the bound, not
        the data's.
      at_ends: the last points within these, of all parameters, shape (parameters, 2, parameters).
      lowest: the best point seen, shape (parameters,); lowest_cost: its cost, below the fit's if it was not least.
    """

    coordinates: np.ndarray
    rise: np.ndarray
    ends: np.ndarray
    open: np.ndarray
    at_ends: np.ndarray
    lowest: np.ndarray
    lowest_cost: float


def covariance(normal: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Of coordinates at the point u, from the normal matrix JᵀJ there, both of shape (parameters, parameters).

    0 for parameters at a bound; huge but finite for what the normal matrix does not know.
    """
    free = np.abs(u) < AT_BOUND
    both = free[:, None] & free[None, :]
    size = np.sqrt(np.where(free & (np.diag(normal) > 0.0), np.diag(normal), 1.0))
    matrix = np.where(both, normal / np.outer(size, size), np.eye(len(u)))
    known, directions = np.linalg.eigh(matrix)
    inverted = (directions / np.maximum(known, 1e-13)[None, :]) @ directions.T
    return np.where(both, inverted / np.outer(size, size), 0.0)


def correlation(normal: np.ndarray, u: np.ndarray) -> np.ndarray:
    """By the same: of coordinates, shape (parameters, parameters)."""
    known = covariance(normal, u)
    spread = np.sqrt(np.where(np.diag(known) > 0.0, np.diag(known), 1.0))
    found = known / np.outer(spread, spread)
    return found + np.diag(1.0 - np.diag(found))


def standard_errors(
    problem: Problem, u: np.ndarray, normal: np.ndarray, profiles: Profiles, limits: Limits
) -> np.ndarray:
    """Of the parameters by the covariance at the point u [unit], shape (parameters,).

    NaN where it tells none: at a bound, or as uncertain as before any measurement, and where the profile has a cliff or
    another slope close by, so that an end of the interval is `BENT` times nearer or farther than by the covariance.
    """
    spread = np.sqrt(np.maximum(np.diag(covariance(normal, u)), 0.0))
    known = (spread > 0.0) & (spread < problem.prior)
    ratio = np.abs(profiles.ends - u[:, None]) / np.where(known, spread * np.sqrt(limits.end), 1.0)[:, None]
    normal_like = known & np.all(profiles.open | ((ratio > 1.0 / BENT) & (ratio < BENT)), axis=1)
    return np.where(normal_like, spread * np.abs(problem.bounds.rate(u)), np.nan)


def held(
    problem: Problem, free: np.ndarray, starts: Sequence[Sequence[np.ndarray]], at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least costs, shape (cases,), and their points, shape (cases, parameters), moving those parameters that are
    `free`, same shape, from the best of several `starts` of each case, shape (parameters,) each; the others are where
    `at`, same shape, has them."""
    if not free.any():  # then all starts are one
        starts = [own[:1] for own in starts]
    of = np.repeat(np.arange(len(free)), [len(own) for own in starts])
    points = np.where(free[of], np.concatenate([np.stack(own) for own in starts]), at[of])
    enough = Enough(ENOUGH, BEHIND, MARGIN, MEET * basin_spacings(problem))
    found = batched_misfit.solved(problem, points, free[of], 0, STEPS if free.any() else 0, enough)
    cost = np.where(np.isfinite(found.cost), found.cost, np.inf)
    order = np.lexsort((cost, of))
    best = order[np.searchsorted(of[order], np.arange(len(free)))]
    return cost[best], found.points[best]


def starts_of(u: np.ndarray, normal: np.ndarray, known: KnownCosts, free: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Where to start with the parameters that are not `free`, shape (cases, parameters), where `at`, same shape, has
    them, shape (2 or 3, cases, parameters): where the quadratic about u expects the others, and at the lowest known
    point near by, for another basin may be deeper there. Of u at a bound, from where no slope leads away, inside, too.
    """
    starts = np.stack([at, at])
    for case, (moves, point) in enumerate(zip(free, at, strict=True)):
        if moves.any():
            within = normal[np.ix_(moves, moves)]
            damped = within + np.diag(1e-9 * np.diag(within) + 1e-300)
            follow = -np.linalg.solve(damped, normal[np.ix_(moves, ~moves)] @ (point - u)[~moves])
            starts[0, case, moves] = np.clip(u[moves] + np.clip(follow, -3.0, 3.0), -AT_BOUND, AT_BOUND)
        away = np.max(np.abs(known.points - point)[:, ~moves], axis=1, initial=0.0)
        nearest = np.argmin(np.where(away < BESIDE, known.cost, np.max(known.cost) + away))
        starts[1, case, moves] = known.points[nearest, moves]
    if not (np.abs(u) >= AT_BOUND).any():
        return starts
    inside = np.where(free & (np.abs(starts[0]) >= AT_BOUND), np.copysign(INSIDE, starts[0]), starts[0])
    return np.concatenate([starts, inside[None]])


class Held(NamedTuple):
    """A parameter held `at` a coordinate: how far χ² has risen, and where all parameters are, shape (parameters,)."""

    at: float
    rise: float
    where: np.ndarray


class Side(list[Held]):
    """One side of a profile, from the least point outwards; points within `reach` of that are in one basin."""

    def __init__(self, least: Held, reach: float) -> None:
        super().__init__([least])
        self.reach = reach


class Limits(NamedTuple):
    """By how much χ² has risen at an interval's end, and where that is `SURE`."""

    end: float
    sure: float


def profiles(
    problem: Problem, u: np.ndarray, cost: float, normal: np.ndarray, limits: Limits, known: KnownCosts
) -> Profiles:
    """Profiles about the least point u, shape (parameters,), with its cost and normal matrix, and where they have risen
    to their limits: first over the whole range, then between the points that an interval's ends lie between, until the
    rise behind an end is no cliff."""
    limit = limits.end
    own = np.repeat(np.arange(len(u)), 2)
    # minima this close are one answer: an interval goes on over what rises above its limit between them
    reach, tried = SAME * basin_spacings(problem), set[tuple[float, ...]]()
    sides = [Side(Held(u[i], 0.0, u), reach[i]) for i in own]
    points = _points(u, np.sqrt(np.diag(covariance(normal, u)) * limit) / 2.0)
    of, at = np.repeat(np.arange(len(own)), [len(each) for each in points]), np.concatenate(points)
    free = own[of][:, None] != np.arange(len(u))
    starts = starts_of(u, normal, known, free, np.where(free, u, at[:, None])).swapaxes(0, 1)
    wanted: list[Any] = [(number, value, u, two) for number, value, two in zip(of, at, starts, strict=True)]
    edges = edges_at_rollers.sought(problem)
    for k in range(ROUNDS + 1):
        of, at = (np.array(each) for each in list(zip(*wanted, strict=True))[:2])
        free = own[of][:, None] != np.arange(len(u))
        starts = [(*ways, *edges_at_rollers.kept(problem, edges, low, int(own[number]), value))
                  for number, value, low, ways in wanted]  # fmt: skip
        costs, where = held(problem, free, starts, np.where(free, u, at[:, None]))
        for number, value, rise, point in zip(of, at, 2.0 * (costs - cost), where, strict=True):
            _put(sides[number], Held(value, rise, point))
        wanted = [
            (number, *one)
            for number, side in enumerate(sides)
            for one in (*_again(side, limit, tried), *_between(side, limit, k), *_levelling(side, limits, k))
        ]
        if not wanted:
            break
    every = [one for side in sides for one in side]
    lowest = min(every, key=lambda one: one.rise)
    ends = np.array([_end(side, limits) for side in sides]).reshape(-1, 2)
    both = [[*before[:0:-1], *behind] for before, behind in zip(sides[::2], sides[1::2], strict=True)]
    longest = max(map(len, both))
    # the last point, as often as it fills the rest
    shown = np.array([[(one.at, one.rise) for one in (*each, *each[-1:] * (longest - len(each)))] for each in both])
    return Profiles(
        coordinates=shown[..., 0],
        rise=shown[..., 1],
        ends=np.clip(ends, -FARTHEST, FARTHEST),
        open=np.isinf(ends),
        at_ends=np.array([_last_within(side, end) for side, end in zip(sides, ends.ravel(), strict=True)]).reshape(
            *ends.shape, len(u)
        ),
        lowest=lowest.where,
        lowest_cost=cost + 0.5 * lowest.rise,
    )


def _put(side: Side, new: Held) -> None:
    """Add what is new, or lower than what was known there."""
    away = [abs(one.at - side[0].at) for one in side]
    k = int(np.searchsorted(away, abs(new.at - side[0].at)))
    if k == len(side) or side[k].at != new.at:
        side.insert(k, new)
    elif new.rise < side[k].rise:
        side[k] = new


Wanted = Iterator[tuple[float, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]]
"""At which coordinates to hold a parameter, each with a point that is known to be low, whose edges of the spall may be
kept, and three points to start from."""


def _again(side: Side, limit: float, tried: set[tuple[float, ...]]) -> Wanted:
    """Where a point farther out has risen less, its basin may be lower here, too: from there, unless it was `tried`."""
    for k, one in enumerate(side[:-1]):
        lower = min(side[k + 1 :], key=lambda other: other.rise)
        attempt = one.at, lower.at, lower.rise
        if FLAT * limit < one.rise and lower.rise < min(one.rise, STEEP**2 * limit) - ENOUGH and attempt not in tried:
            tried.add(attempt)
            yield one.at, lower.where, (lower.where, one.where, side[k + 1].where)


def _between(side: Side, limit: float, k: int) -> Wanted:
    """Between the points that the k-th look for an interval's end has found it between, unless they tell it."""
    root, behind = _roots(side, limit)
    if behind == len(side):
        return
    low, high = side[behind - 1], side[behind]
    near = abs(high.at - low.at) < CLOSE * abs(high.at - side[0].at)
    if k == 0 or (root[behind] > STEEP * np.sqrt(limit) and not near):
        for share in np.arange(1, WITHIN + 1) / (WITHIN + 1):
            between = low.where + share * (high.where - low.where)
            yield low.at + share * (high.at - low.at), low.where, (between, low.where, high.where)


def _levelling(side: Side, limits: Limits, k: int) -> Wanted:
    """As `_between`, of the limit beyond which it is sure, where that may be far behind the interval's end, and not
    between the same two points."""
    (_, end), (_, sure) = (_roots(side, limit) for limit in limits)
    if end < sure < len(side) and _is_far(side, side[sure].at, limits.end):
        yield from _between(side, limits.sure, k)


def _is_far(side: Side, at: float, limit: float) -> bool:
    """Whether this is several times as far as where the limit is reached."""
    return abs(at - side[0].at) > LEVELS_OFF * abs(_reached(side, limit) - side[0].at)


def _roots(side: Side, limit: float) -> tuple[np.ndarray, int]:
    """Roots of the rise, the largest so far, shape (points,), and the first point that is beyond the limit, behind the
    last one in the basin that is not."""
    rise = np.maximum([one.rise for one in side], 0.0)
    within = [k for k, one in enumerate(side) if one.rise <= limit and abs(one.at - side[0].at) <= side.reach]
    rise[: within[-1]] = np.minimum(rise[: within[-1]], rise[within[-1]])
    root = np.maximum.accumulate(np.sqrt(rise))
    return root, int(np.searchsorted(root, np.sqrt(limit), side="right"))


def _end(side: Side, limits: Limits) -> float:
    """The interval's end."""
    end, sure = _reached(side, limits.end), _reached(side, limits.sure)
    return sure if _is_far(side, sure, limits.end) else end


def _last_within(side: Side, end: float) -> np.ndarray:
    """The point of all parameters farthest out that is within an interval's end."""
    within = [one for one in side if abs(one.at - side[0].at) <= abs(end - side[0].at)]
    return max(within, key=lambda one: abs(one.at - side[0].at)).where


def _reached(side: Side, limit: float) -> float:
    """Where the limit is reached; infinite where it is not."""
    root, behind = _roots(side, limit)
    if behind == len(side):
        return float(np.copysign(np.inf, side[-1].at - side[0].at))
    pair = slice(behind - 1, behind + 1)
    return float(np.interp(np.sqrt(limit), root[pair], [one.at for one in side[pair]]))


def _points(u: np.ndarray, spread: np.ndarray) -> list[np.ndarray]:
    """Where profiles are computed: on either side of u some near, in `spread`s of shape (parameters,), and some as far
    as the bound: of every parameter those below, then those above."""
    points = []
    for at, each in zip(np.repeat(u, 2), np.repeat(spread, 2), strict=True):
        side = 1.0 if len(points) % 2 else -1.0
        room, near = max(AT_BOUND - side * at, 1e-3), NEAR * (each or 1.0)
        if near[-1] < 0.7 * room:
            far = near[-1] + (room - near[-1]) * FAR
            steps = int(np.ceil(np.log(far[0] / near[-1]) / np.log(FACTOR)))
            away = np.concatenate([near, np.geomspace(near[-1], far[0], steps + 1)[1:-1], far])
        else:
            away = room * np.arange(1, len(NEAR) + len(FAR) + 1) / (len(NEAR) + len(FAR))
        points.append(at + side * away)
    return points


def limit_of(freedom: int | None, confidence: float = CONFIDENCE) -> float:
    """Rise of chi² at the ends of an interval: of the normal distribution or, with sigma estimated from so many degrees
    of freedom, of Student's t, whose square it is."""
    tail = 0.5 * (1.0 + confidence)
    return float(ndtri(tail) if freedom is None else stdtrit(freedom, tail)) ** 2


def limits_of(freedom: int | None, scale: float) -> Limits:
    """Both, where χ² counts as so many times what it should be."""
    return Limits(*(scale * limit_of(freedom, confidence) for confidence in (CONFIDENCE, SURE)))
