"""Where a fit may end: the whole range is scanned, and least squares go down from there, the lowest to the end.

A spall between rollers, or out of the load zone, changes nothing, and one beside the load line measures like its mirror
image: over the angle the sum of squares has plateaus and many narrow minima. No rule of first order leaves these, so
one step of optax's Adam, away from where the gradient vanishes by symmetry, is all there is of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from difftrb.core import arrays as xp
from difftrb.fits import batched_misfit, edges_at_rollers, least_squares
from difftrb.fits import parameters as fit_parameters
from difftrb.fits.fit_problem import Problem, basin_spacings
from difftrb.fits.least_squares import AT_BOUND, Alone, Enough, Least
from difftrb.fits.parameters import OfSpall, Parameter

SCANNED = 64, 512, 4096, 8192
"""Points that are scanned for one, two, three and more parameters."""
SLOPES = 64
"""Points at which it is looked whether deviations change with a coordinate."""
FACTOR = 10.0
"""By how much losses may be off at points that are taken for good ones."""
LOWEST = 256, 24
"""Most points from which least squares go down, and cases that go on to the end."""
ROUNDS = 4, 12
"""Steps of Levenberg–Marquardt after which only every fourth case goes on (`KEPT`)."""
KEPT = 4
NEAR = 0.3
"""Cases this close, of what parts basins, are one."""
ADAM_STEPS = 1
"""Steps of Adam before Levenberg–Marquardt ends it."""
MEET = 0.3
"""Cases that come this close to each other go on as one: of what parts basins."""
BEHIND = 0.02
"""Cases that expect less of a step than this share of what parts them from the best one have found another minimum."""
SAME = 0.05
"""Minima this close, of what parts basins, are one."""
SPREAD, FACTORS = (0.05, 0.95), (0.6, 0.8)
"""Between which shares of a parameter's range points lie, and of one that multiplies losses."""
ALONE = 2
"""Steps in which those that multiply losses move alone."""
MOVED = 12, 128
"""Of how many minima edges are moved, and from how many points least squares then go down."""
ALIKE = 0.02
"""Of those, which are closer than this are one."""
ELSEWHERE = 512
"""Places of one spall that are tried beside the other one."""
MOVES, GAIN = 3, 1e-3
"""How often at most, and by how much half of χ² has to come lower to go on."""
THOROUGH = 8, 16
"""`ROUNDS` where nothing that was found explains the data."""
MORE = 2
"""How many times as many points are scanned then, besides."""


class Scan(NamedTuple):
    """Points of the whole range: coordinates, shape (points, parameters); what the model says there of the rows, shape
    (points, rows); the most that deviations change with each coordinate, shape (parameters,)."""

    points: np.ndarray
    predicted: np.ndarray
    slope: np.ndarray


def scanned(problem: Problem, points: np.ndarray) -> Scan:
    """The model at these points, roughly."""
    rough = _rough(problem)
    with ThreadPoolExecutor(1) as beside:
        # of many points it is another program, traced while the first one is compiled
        many = beside.submit(batched_misfit.rows_at, rough, points) if len(points) > batched_misfit.MANY else None
        jacobian = np.nan_to_num(batched_misfit.evaluated(rough, points[:SLOPES]).jacobian)
        predicted = batched_misfit.rows_at(rough, points) if many is None else many.result()
    return Scan(points, predicted, np.sqrt(np.max(np.sum(jacobian**2, axis=1), axis=0)))


def scan_points(problem: Problem, count: int | None = None) -> np.ndarray:
    """Coordinates of the points, shape (count, parameters): the scene's own values, then an even spread of the range,
    of which up to one half have `edges_at_rollers`.

    None: as many as so many parameters call for.
    """
    parameters = problem.parameters
    count = scan_size(len(parameters)) if count is None else count
    own = problem.bounds.coordinates(np.array([[parameter.start(problem.scene) for parameter in parameters]], float))
    every = np.concatenate([np.clip(own, -4.0, 4.0), spread(parameters, count - 1)])
    half = slice(1, 1 + count // 2)
    every[half] = edges_at_rollers.moved(problem, every[half])
    return every


def scan_size(n: int) -> int:
    """How many are scanned for n parameters."""
    return SCANNED[min(n, len(SCANNED)) - 1]


def spread(parameters: Sequence[Parameter], count: int, behind: int = 0) -> np.ndarray:
    """Coordinates that fill the parameters' ranges evenly, shape (count, parameters), behind so many others: an
    additive recurrence (Roberts 2018)."""
    n, golden = len(parameters), 2.0
    for _ in range(40):
        golden = (1.0 + golden) ** (1.0 / (n + 1))
    steps = golden ** -np.arange(1.0, n + 1.0)
    shares = np.mod(0.5 + (behind + np.arange(1, count + 1))[:, None] * steps[None, :], 1.0)
    low, high = np.array([FACTORS if parameter.multiplies else SPREAD for parameter in parameters]).T
    shares = low + (high - low) * shares
    return least_squares.at_shares(shares)


def thorough(problem: Problem, scan: Scan) -> tuple[Scan, Least]:
    """As `minima`, of `MORE` points besides and by more steps: a larger scan, and where least squares end."""
    more = spread(problem.parameters, MORE * len(scan.points), len(scan.points))
    predicted = batched_misfit.rows_at(_rough(problem), more)
    scan = Scan(np.concatenate([scan.points, more]), np.concatenate([scan.predicted, predicted]), scan.slope)
    return scan, minima(problem, scan, rounds=THOROUGH)


def minima(
    problem: Problem, scan: Scan, free: np.ndarray | bool = True, rounds: tuple[int, ...] = ROUNDS,
    lowest: tuple[int, int] = LOWEST,
) -> Least:  # fmt: skip
    """Where least squares end that go down from the points of a scan: all some steps, the lower ones farther, all of
    it roughly and by ratios; at last exactly from what is left.

    `free`: which parameters move, shape (parameters,), or all. `lowest`: as `LOWEST`.
    """
    most, fewest = lowest
    points, cost, scale, rough = (
        scan.points,
        _costs_at_best_factor(problem, scan.predicted),
        basin_spacings(problem),
        _rough(problem),
    )
    enough, room = Enough(behind=BEHIND, meet=MEET * scale), edges_at_rollers.room(problem)
    multiply = np.array([parameter.multiplies for parameter in problem.parameters]) & free
    alone = Alone(multiply, ALONE) if multiply.any() and not multiply.all() else None
    for k, steps in enumerate(rounds):
        points = points[_lowest_apart(points / scale, cost, np.clip(len(points) // KEPT, fewest, most))]
        first = alone if k == 0 else None
        found = batched_misfit.solved(rough, points, free, 0, steps, enough, ratios=True, alone=first, room=room)
        points, cost = found.points, found.cost
    # the scene's own, too
    return minima_from(
        problem, np.concatenate([points[_lowest_apart(points / scale, cost, fewest)], scan.points[:1]]), free
    )


def minima_from(problem: Problem, points: np.ndarray, free: np.ndarray | bool = True) -> Least:
    """Where least squares end that go down from these points, roughly, and then exactly from what is left of them;
    `free` as in `minima`."""
    enough = Enough(behind=BEHIND, meet=MEET * basin_spacings(problem))
    found = batched_misfit.solved(_rough(problem), points, free, ADAM_STEPS, least_squares.STEPS, enough)
    points = found.points[distinct(problem, found) or [0]]
    return once_round(problem, batched_misfit.solved(problem, points, free, 0, least_squares.STEPS, enough))


def once_round(problem: Problem, found: Least) -> Least:
    """The same minima, those beyond half a period of a parameter at what is the same within it, and two spalls that are
    alike named as the scene names those nearest to them."""
    bounds = problem.bounds
    values = bounds.values(found.points)
    turned = fit_parameters.wrapped(problem.parameters, values)
    points = np.where(turned == values, found.points, bounds.coordinates(turned))
    rate = bounds.slope(points) / np.maximum(bounds.slope(found.points), 1e-300)
    found = found._replace(points=points, normal=found.normal * rate[:, :, None] * rate[:, None, :])
    other = exchange(problem)
    return found if other is None else _named(problem, found, turned, other)


def _named(problem: Problem, found: Least, values: np.ndarray, other: list[int]) -> Least:
    """Minima at these `values`, with the names of two spalls exchanged, `other`, where their angles are nearer to the
    scene's then."""
    own = np.array([parameter.start(problem.scene) for parameter in problem.parameters], float)
    angles = [i for i, p in enumerate(problem.parameters) if isinstance(p, OfSpall) and p.field == "angle"]

    def away(of: np.ndarray) -> np.ndarray:
        return np.sum(np.abs(fit_parameters.wrapped(problem.parameters, of - own))[:, angles], axis=1)

    nearer = away(values[:, other]) < away(values)
    return found._replace(
        points=np.where(nearer[:, None], found.points[:, other], found.points),
        normal=np.where(nearer[:, None, None], found.normal[:, other][:, :, other], found.normal),
    )


def exchange(problem: Problem) -> list[int] | None:
    """Which parameter each becomes when two spalls exchange their names; None where that is another scene: they are not
    two, or not the same is sought of both, or they differ in what is not."""
    fields = [{p.field: i for i, p in enumerate(problem.parameters) if isinstance(p, OfSpall) and p.number == k}
              for k in (0, 1)]  # fmt: skip
    one, two = fields
    if "angle" not in one or one.keys() != two.keys():
        return None
    first, second = (xp.numbers(spall) for spall in problem.scene.spalls[:2])
    if dataclasses.replace(second, **{field: getattr(first, field) for field in one}) != first:
        return None
    order = list(range(len(problem.parameters)))
    for field, i in one.items():
        order[i], order[two[field]] = two[field], i
    return order


def with_edges_moved(problem: Problem, found: Least) -> Least:
    """What was found, and where least squares end from the lowest of these with edges moved (`edges_at_rollers`) and,
    of several spalls, one of them elsewhere, as long as that comes lower."""
    rough, room, moved_already = _rough(problem), edges_at_rollers.room(problem), set[int]()
    for _ in range(MOVES):
        from_here = [k for k in distinct(problem, found)[: MOVED[0]] if k not in moved_already]
        moved_already.update(from_here)
        moved = edges_at_rollers.beside(problem, found.points[from_here])
        more = np.concatenate([moved, _with_one_elsewhere(problem, found.points[from_here])])
        if not len(more):
            break
        cost = _costs_at_best_factor(problem, batched_misfit.rows_at(rough, more))
        more = more[_lowest_apart(more / basin_spacings(problem), cost, MOVED[1], ALIKE)]
        near = batched_misfit.solved(rough, more, True, 0, ROUNDS[1], Enough(behind=BEHIND), room=room)
        ended = minima_from(problem, near.points[distinct(problem, near)[: LOWEST[1]]])
        lower = np.nanmin(ended.cost) < np.nanmin(found.cost) - GAIN
        found = least_squares.both(found, ended)
        if not lower:
            break
    return found


def _with_one_elsewhere(problem: Problem, found_points: np.ndarray) -> np.ndarray:
    """These points, coordinates of shape (points, parameters), with one of several spalls as in points of the range,
    shape (more points, parameters): of two spalls each may be right where the other one is not. None of a single
    spall."""
    numbers = np.array([p.number if isinstance(p, OfSpall) else -1 for p in problem.parameters])
    spalls = [k for k in np.unique(numbers) if k >= 0]
    if len(spalls) < 2:
        return np.zeros((0, len(numbers)))
    elsewhere = scan_points(problem, ELSEWHERE)
    found = [np.where(numbers == k, elsewhere, point) for point in found_points for k in spalls]
    return np.concatenate(found)


def _costs_at_best_factor(problem: Problem, predicted: np.ndarray) -> np.ndarray:
    """What costs would be with the best factor on all losses, shape (points,), of what is `predicted` of the
    rows, shape (points, rows): about what a longer or shorter spall at the same place would have, which least squares
    find from far away. Another place they do not find."""
    loss, sigma, rows = (np.asarray(x) for x in (problem.conditions.loss, problem.sigma, problem.measured))
    predicted, seen = predicted / sigma, rows / sigma
    own = np.nan_to_num(predicted * loss)
    factor = np.clip((own @ seen) / np.maximum(np.sum(own**2, axis=1), 1e-300), 1.0 / FACTOR, FACTOR)
    return 0.5 * np.sum((np.where(loss, factor[:, None], 1.0) * predicted - seen) ** 2, axis=1)


def _rough(problem: Problem) -> Problem:
    """The same with means of few phases."""
    return problem if problem.rough is None else dataclasses.replace(problem, conditions=problem.rough)


def _lowest_apart(points: np.ndarray, cost: np.ndarray, most: int, near: float = NEAR) -> list[int]:
    """The lowest points of which no two are one: closer than `near`."""
    kept: list[int] = []
    for k in np.argsort(cost, kind="stable"):
        if len(kept) == most or not np.isfinite(cost[k]):
            break
        if not kept or np.min(np.max(np.abs(points[kept] - points[k]), axis=1)) >= near:
            kept.append(int(k))
    return kept


def distinct(problem: Problem, found: Least) -> list[int]:
    """Which of the cases are minima of their own, the least first."""
    spacings, kept = basin_spacings(problem), list[int]()
    points, values = np.clip(found.points, -AT_BOUND, AT_BOUND) / spacings, problem.bounds.values(found.points)
    low, high = problem.bounds.ends()
    round_trip = np.array([parameter.period is not None for parameter in problem.parameters])
    for k in np.argsort(found.cost, kind="stable"):
        apart = np.abs(points[kept] - points[k])
        if round_trip.any():
            ways = fit_parameters.wrapped(problem.parameters, values[kept] - values[k])
            apart = np.where(round_trip, np.abs(ways) * 4.0 / (high - low) / spacings, apart)
        if np.isfinite(found.cost[k]) and not np.any(np.max(apart, axis=1) < SAME):
            kept.append(int(k))
    return kept
