"""The road backwards: from measured stiffness, or its loss, to the spall's size.

The whole range is scanned, least squares go down from every basin (`search`), and what fits as well as the best answer
is kept. What the model does not explain is not called determined; what may be wrong is tried (`suspects`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from difftrb.core import status
from difftrb.core.input_errors import is_whole
from difftrb.fits import (
    batched_misfit,
    fit_remarks,
    fit_result,
    least_squares,
    measured,
    predicted,
    profile_intervals,
    search,
)
from difftrb.fits import parameters as fit_parameters
from difftrb.fits.fit_problem import ROBUST, Problem, basin_spacings, prepare_fit, problem_of
from difftrb.fits.fit_result import Alternative, Fit, History
from difftrb.fits.least_squares import AT_BOUND, Least
from difftrb.fits.measured import MeasuredError, Measurement
from difftrb.fits.parameters import OfSpall, Parameter
from difftrb.fits.profile_intervals import KnownCosts, Limits, Profiles
from difftrb.fits.search import Scan
from difftrb.law.samples import Progress
from difftrb.scene.scene import Scene
from difftrb.scene.scene_laws import with_any_width

LOAD_STEP = 0.01
"""Relative step of the loads by which it is told how rows follow them."""
PLATEAU = 0.01
"""Answers that differ by less in every row [sigma] are one to these rows."""
LEAST_SIGMA = 1e-7
"""Estimates of a relative error below this are rounding."""
ROUNDS = 3
"""Of estimating sigma beside a robust fit."""
NEARLY = 1.05
"""Widths within this factor of the least one that is searched are at it."""
STEPS = 4
"""Of a fit, as its progress counts them: scan, search, profiles, remarks."""
DEEPER = 3
"""Most times that a fit goes on from a profile that has found a lower point."""


def fit(
    scene: Scene,
    rows: Sequence[Measurement],
    parameters: Sequence[str] = ("length", "width"),
    robust: str = "squares",
    starts: int | None = None,
    model_error: float | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Fit a scene's first spall to measurements, and say how far they determine it.

    Args:
      scene: bearing, law and whatever is known of the spall; its load does not matter. The law "table" knows ramps and
        so the width at any phase; under the others width acts through rows with phase "mean" alone. With a prepared law
        nothing is solved but rings.
      rows: from `load_measured`, or your own.
      parameters: of "length", "width", "depth", "angle", "axial_offset" (of the spall), "length_2", "width_2",
        "angle_2" (of a second one), "crown" (the rollers' design load), "preload" (added to every axial load), "scale"
        (the bearing's share in the measured compliance, the rest being housing and shaft), "reference" (by which the
        healthy stiffness is off that losses are told by), "load_factor" (by which all loads are off), and what
        `fits.parameters.register` adds. All others stay as in the scene. Default: length and width.
      robust: "squares"; "huber" or "student" where single rows may be far off.
      starts: at how many points the range is scanned, at least 1; the first is the scene's own spall. None: 64, 512,
        4096 or 8192, for one, two, three or more parameters.
      model_error: relative error of the model that all losses share, and all stiffnesses, ≥ 0; it widens intervals
        (not of robust fits). None: that of the roller law, if it is known.
      progress: told how many of how many contacts are solved for the law, then how many of how many steps are done:
        the first is the longest where its program is not compiled yet.

    Rows without sigma: its size, relative to each value, is estimated from how the fit misses them. Raises
    `MeasuredError` for what cannot be fitted; what the data do not determine is said in `remarks`.
    Spalls narrower than that a roller may meet both edges are looked for where nothing wider ends the interval of a
    width: that takes a program of its own.
    """
    status.require_float64()
    if model_error is not None and not (isinstance(model_error, float | int) and 0.0 <= model_error < np.inf):
        raise MeasuredError(f"model_error = {model_error!r}: must be 0 or a positive number; None takes the law's own")
    if robust not in ROBUST:
        raise MeasuredError(f"robust = {robust!r} is not known; use one of {', '.join(ROBUST)}")
    if starts is not None and not is_whole(starts, 1):
        raise MeasuredError(f"starts = {starts!r}: must be a whole number, at least 1, or None for as many as needed")
    fit_parameters.named(parameters)
    rows = measured.listed(rows)
    scene = prepare_fit(scene, rows, progress)
    measured.check_loads(scene, rows)
    any_width = with_any_width(scene)
    rounds = 1 if any_width is None else 2

    def report(before: int, step: int) -> None:
        if progress is not None:
            progress(before * STEPS + step, rounds * STEPS)

    report(0, 0)
    found = _fit(scene, rows, tuple(parameters), robust, starts, model_error, partial(report, 0))
    if any_width is not None and _may_be_narrower(found):
        found = _fit(any_width, rows, tuple(parameters), robust, starts, model_error, partial(report, 1))
    report(rounds - 1, STEPS)
    return found


def _may_be_narrower(fit: Fit) -> bool:
    """Whether the data leave a width open at its low end, or an answer is there."""
    widths = [i for i, p in enumerate(fit.problem.parameters) if isinstance(p, OfSpall) and p.field == "width"]
    least = np.asarray(fit.problem.bounds.low) * NEARLY
    others = [fit.values, *(other.values for other in fit.alternatives)]
    return any(fit.open[i, 0] or min(values[i] for values in others) < least[i] for i in widths)


def _fit(
    scene: Scene, rows: tuple[Measurement, ...], parameters: tuple[str, ...], robust: str, starts: int | None,
    model_error: float | None, report: Callable[[int], None],
) -> Fit:  # fmt: skip
    """`fit` with a prepared scene; `report` takes how many of the `STEPS` are done."""
    problem, estimate = problem_of(scene, rows, parameters, robust, model_error)
    scan = search.scanned(problem, search.scan_points(problem, starts))
    report(1)
    if not np.isfinite(scan.predicted).any():
        code = batched_misfit.evaluated(problem, scan.points[:1]).beside[1]
        why = status.describe(int(code[0])).partition(":")[0]  # its advice is for a scene, not for a fit
        raise MeasuredError(
            f"{measured.table_of(rows)}: no spall has a solution under these loads: {why}; check their unit, N"
        )
    _check_effects(problem.parameters, scan.slope)
    freedom = len(rows) - len(parameters)
    if estimate:
        problem, found = _with_sigma(problem, scan, freedom)
    else:
        found = search.with_edges_moved(problem, search.minima(problem, scan))
        if fit_result.tail(2.0 * float(np.nanmin(found.cost)), freedom) < fit_result.UNLIKELY:
            scan, more = search.thorough(problem, scan)
            if np.nanmin(more.cost) < np.nanmin(found.cost):
                found = search.with_edges_moved(problem, more)
    report(2)
    if any(row.load_sigma > 0.0 for row in rows):
        problem = _with_loads(problem, rows, found.points[least_squares.best(found)])
        found = _descended(problem, found.points)
    tried = _with_profiles(problem, scan, found, estimate)
    for _ in range(DEEPER):  # a profile may have found more
        if tried.profiles.lowest_cost >= found.cost[tried.best] * (1.0 - 1e-6) - 1e-9:
            break
        found = _descended(problem, np.concatenate([tried.profiles.lowest[None], found.points]))
        tried = _with_profiles(problem, scan, found, estimate)
    report(3)
    result = _result(rows, problem, tried, estimate)
    return dataclasses.replace(result, **fit_remarks.judged(result, scan))


def _check_effects(parameters: Sequence[Parameter], slope: np.ndarray) -> None:
    """Refuse parameters on which no row depends at any point; `slope` of `Scan`."""
    for parameter, own in zip(parameters, slope, strict=True):
        if own <= 1e-12 * np.max(slope):
            raise MeasuredError(f"parameters: {parameter.name} cannot be fitted to these rows: {parameter.no_effect}")


def _descended(problem: Problem, points: np.ndarray) -> Least:
    """From these points with all parameters free, by Levenberg–Marquardt alone."""
    return search.once_round(problem, batched_misfit.solved(problem, points, True, 0, least_squares.STEPS))


def _with_sigma(problem: Problem, scan: Scan, freedom: int) -> tuple[Problem, Least]:
    """The problem with sigma as the fit misses the rows, and its minima."""
    for _ in range(1 if problem.by_squares else ROUNDS):
        found = search.minima(problem, scan)
        off = (found.beside[0][least_squares.best(found)] - np.asarray(problem.measured)) / np.asarray(problem.sigma)
        if problem.by_squares:
            factor = float(np.sqrt(np.sum(off**2) / freedom))
        else:  # the middle deviation, of normal errors
            factor = 1.4826 * float(np.median(np.abs(off))) * float(np.sqrt(len(off) / freedom))
        problem = dataclasses.replace(problem, sigma=problem.sigma * max(factor, LEAST_SIGMA))
        found = _descended(problem, found.points)
    return problem, found  # pyright: ignore[reportPossiblyUnbound]  # there is a round


def _with_loads(problem: Problem, rows: tuple[Measurement, ...], point: np.ndarray) -> Problem:
    """The problem with sigma larger by what rows change with the errors of their own loads, at this point."""
    rows_at = []
    for factor in (1.0 - LOAD_STEP, 1.0 + LOAD_STEP):
        loaded = [dataclasses.replace(row, radial=row.radial * factor, axial=row.axial * factor) for row in rows]
        rows_at += predicted.other_rows(problem, loaded, [point])
    slope = (rows_at[1] - rows_at[0]) / (2.0 * LOAD_STEP)  # by the logarithm of the loads
    share = 0.01 * np.array([float(row.load_sigma) for row in rows])
    return dataclasses.replace(problem, sigma=np.hypot(problem.sigma, np.nan_to_num(slope) * share))


class Tried(NamedTuple):
    """All minima, the best one's number and profiles, to what limits its χ² rises at the ends of intervals, how many
    times χ² is what sigma lets expect, at least 1, and where the cost is known."""

    found: Least
    best: int
    profiles: Profiles
    limits: Limits
    scale: float
    known: KnownCosts


def _with_profiles(problem: Problem, scan: Scan, found: Least, estimated: bool) -> Tried:
    best, freedom = least_squares.best(found), scan.predicted.shape[1] - found.points.shape[1]
    point, normal, cost = found.points[best], found.normal[best], float(found.cost[best])
    trusted = not estimated and problem.by_squares
    scale = max(2.0 * cost / max(freedom, 1), 1.0) if trusted else 1.0
    limits = profile_intervals.limits_of(freedom if estimated else None, scale)
    costs = np.concatenate([found.cost, batched_misfit.costs(problem, scan.predicted)])
    known = KnownCosts(np.concatenate([found.points, scan.points]), np.nan_to_num(costs, nan=np.inf))
    profiles = profile_intervals.profiles(problem, point, cost, normal, limits, known)
    return Tried(found, best, profiles, limits, scale, known)


def _result(rows: tuple[Measurement, ...], problem: Problem, tried: Tried, estimated: bool) -> Fit:
    """The fit, without remarks."""
    best, bounds, found, profiles = tried.best, problem.bounds, tried.found, tried.profiles
    u, normal, read = (np.asarray(each[best]) for each in (found.points, found.normal, found.beside[0]))
    every = bounds.values(found.points)
    values = every[best]
    converged = np.where(found.converged[best], status.CONVERGED, status.NOT_CONVERGED)
    others = _alternatives(problem, tried, every)
    weight = fit_result.weights(problem, found, [best, *others], tried.scale)
    pieces = _pieces(problem, tried, others, every, _among_likeliest(weight)[1:])
    return Fit(
        parameters=tuple(parameter.name for parameter in problem.parameters),
        values=values,
        standard_errors=profile_intervals.standard_errors(problem, u, normal, profiles, tried.limits),
        pieces=tuple(own[:, :2] for own in pieces),
        open=np.array([(own[0, 2], own[-1, 3]) for own in pieces], bool),
        correlation=profile_intervals.correlation(normal, u),
        rows=rows,
        predicted=read,
        sigma=np.asarray(problem.sigma),
        sigma_estimated=estimated,
        residuals=(np.asarray(problem.measured) - read) / np.asarray(problem.sigma),
        chi2=2.0 * float(found.cost[best]),
        freedom=len(rows) - len(u),
        remarks=(),
        doubts=(),
        determined_each=np.zeros(len(u), bool),
        alternatives=tuple(
            Alternative(every[k], 2.0 * float(found.cost[k]), float(share))
            for k, share in zip(others, weight[1:], strict=True)
        ),
        scene=fit_parameters.put(problem.parameters, problem.scene, values),
        history=History(every, 2.0 * np.asarray(found.cost), np.asarray(found.steps)),
        profiles=profiles,
        problem=problem,
        robust=ROBUST[int(problem.robust)],
        point=u,
        normal=normal,
        limit=tried.limits.end,
        known=tried.known,
        status_code=status.worst(found.beside[1][best], converged),
    )


def _alternatives(problem: Problem, tried: Tried, values: np.ndarray) -> list[int]:
    """Minima that it is not sure to be without, and that the best one's intervals do not hold; `values` of all."""
    found, best, intervals = tried.found, tried.best, problem.bounds.values(tried.profiles.ends.T).T
    outside = np.any(fit_result.outside(problem.parameters, values, values[best], intervals), axis=1)
    within = 2.0 * (found.cost - found.cost[best]) < tried.limits.sure
    cases: list[int] = []
    for k in search.distinct(problem, found):
        if (
            k != best
            and outside[k]
            and within[k]
            and not any(_on_one_plateau(problem, found, k, other) for other in cases)
        ):
            cases.append(k)
    return cases


def _among_likeliest(weight: np.ndarray) -> np.ndarray:
    """Which answers, of weights that sum to 1, are needed to have 95 % of the probability: the likeliest first."""
    order = np.argsort(-weight, kind="stable")
    before = np.cumsum(weight[order]) - weight[order]
    return (before < profile_intervals.CONFIDENCE)[np.argsort(order)]


def _pieces(
    problem: Problem, tried: Tried, others: list[int], values: np.ndarray, likely: np.ndarray
) -> list[np.ndarray]:
    """Of each parameter the pieces of its interval, rising: low, high, and whether these ends are open, shape (pieces,
    4); `values` of all minima.

    A profile follows one minimum, and `others` may be as good: each of them whose χ² is within the limit has a piece,
    too, as of a normal distribution, to either side no longer than basins lie apart. One that is `likely`, shape
    (others,), has its own 95 % as well: where the least χ² is in a narrow basin, wide ones that rise above the limit
    may be likelier. Pieces that overlap are one.
    """
    found, bounds, best = tried.found, problem.bounds, tried.best
    ends = [np.column_stack([bounds.values(tried.profiles.ends.T).T, tried.profiles.open])]
    for k, counts in zip(others, likely, strict=True):
        left = tried.limits.end - (0.0 if counts else 2.0 * (found.cost[k] - found.cost[best]))
        if left > 0.0:
            own = np.diag(np.linalg.inv(fit_result.curvature(problem, found, k)))
            away = np.minimum(np.sqrt(left * own), 0.25 * basin_spacings(problem))
            both = least_squares.shares_of(found.points[k]) + np.stack([-away, away])
            turn = fit_parameters.wrapped(problem.parameters, values[k], values[best]) - values[k]
            beyond = both[0] < least_squares.shares_of(-AT_BOUND), both[1] > least_squares.shares_of(AT_BOUND)
            ends.append(np.column_stack([(bounds.values(least_squares.at_shares(both)) + turn).T, *beyond]))
    return [_united(own) for own in np.stack(ends, axis=1)]


def _united(ends: np.ndarray) -> np.ndarray:
    """Pieces as of `_pieces`, shape (pieces, 4), with those made one that overlap."""
    united: list[np.ndarray] = []
    for low, high, low_open, high_open in ends[np.argsort(ends[:, 0], kind="stable")]:
        if united and low <= united[-1][1]:
            if high > united[-1][1]:
                united[-1][[1, 3]] = high, high_open
        else:
            united.append(np.array([low, high, low_open, high_open]))
    return np.array(united)


def _on_one_plateau(problem: Problem, found: Least, one: int, other: int) -> bool:
    """Whether two minima lie on one plateau: the model says the same of all rows there, and they are no farther apart
    than basins are."""
    apart = np.abs(found.beside[0][one] - found.beside[0][other]) / np.asarray(problem.sigma)
    away = np.abs(np.diff(np.clip(found.points[[one, other]], -AT_BOUND, AT_BOUND), axis=0)) / basin_spacings(problem)
    return bool(apart.max() < PLATEAU and away.max() < 1.0)
