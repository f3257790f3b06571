"""What may be wrong with measurements that the model does not explain: each is tried, and named if it explains more.

One row alone; a spall that stands elsewhere, a soft housing and whatever else a parameter declares as its `suspect`;
losses given as fractions. A suspect is a fit with one more freedom: it is named if χ² falls by more than chance lets
expect of that.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy import special

from difftrb.fits import batched_misfit, fit_result, search
from difftrb.fits import parameters as fit_parameters
from difftrb.fits.fit_problem import Problem, basin_spacings, with_more
from difftrb.fits.fit_result import UNLIKELY, Fit
from difftrb.fits.least_squares import AT_BOUND, Least, at_shares, best
from difftrb.fits.measured import MeasuredError
from difftrb.fits.parameters import PARAMETERS, Parameter
from difftrb.fits.search import Scan

UNWEIGHED = 1e4
"""By what factor sigma grows of a row that is left aside."""
STARTS = 8
"""Points of the fit's own parameters from which each suspect is tried."""
TURNING = 0.2
"""Parameters whose basins lie closer, in coordinates, are scanned; others are tried at `FEW` values."""
FEW = 3
POINTS, LOWEST = 512, (32, 4)
"""Points that are scanned then, for a fit that scans as many as usual, and `search.LOWEST` of them: a suspect is a
hint, and what it explains is far from chance."""
NAMED = 3
"""Most suspects that are named."""
NEARLY = 10.0
"""A suspect whose χ² is larger than this many times the best one's is not named beside it."""
SCATTER = 0.005
"""Estimated relative error of measurements from which on suspects are tried without a sigma, too."""
ALONE = UNLIKELY
"""Chance of its gain below which a row is named that is left aside."""
ADDED = 0.04
"""The same of all parameters that are tried together, where sigma was estimated: by so many of them each has a chance.
With the rows' it is about one good set of data in twenty."""
SEARCHED = 2
"""Freedoms that a parameter brings whose whole range is searched: where on that it is may meet one more row."""
PART = 0.2
"""Chance of its gain below which any suspect is named, where sigma is given and the data are far from explained."""


class Suspect(NamedTuple):
    """What may be wrong, as the end of a sentence, with the answer it would give; χ² then, whether it gains more than
    chance and, where sigma was estimated, is another answer, and whether it explains the data; what to do."""

    what: str
    answer: str
    chi2: float
    gains: bool
    explains: bool
    advice: str


def named(fit: Fit, scan: Scan) -> list[Suspect]:
    """Those that explain much more than the fit, the best first."""
    found = [*_rows_left_aside(fit, scan), *_fractions(fit, scan)]
    if not any(one.gains and one.explains for one in found):  # else what takes programs of its own need not be tried
        found += _other_parameters(fit, scan)
    better = sorted((one for one in found if one.gains), key=lambda one: one.chi2)
    return [one for one in better if one.chi2 <= NEARLY * max(better[0].chi2, float(fit.freedom))][:NAMED]


def wanted(fit: Fit) -> bool:
    """Whether the data give reason to look for any."""
    if fit.robust != "squares" or fit.freedom < 2:
        return False
    if not fit.sigma_estimated:
        return not fit.explained
    size = np.abs([float(row.value) for row in fit.rows])
    return float(np.median(fit.sigma / np.maximum(size, 1e-300))) > SCATTER


def _gains(fit: Fit, chi2: float, chance: float, more: int = 1) -> bool:
    """Whether as many more freedoms bring more than chance, by Fisher's F; nothing tells where no freedom is left. With
    sigma given by χ²; then F says whether one takes away a good part of what is missed."""
    more = more if fit.sigma_estimated else 1
    gain, left = max(fit.chi2 - chi2, 0.0), fit.freedom - more
    if left < 1:
        return False
    share = gain / more / (chi2 / left) if chi2 > 0.0 else np.inf
    likely = float(special.fdtrc(more, left, share))
    if fit.sigma_estimated:
        return likely < chance
    return likely < PART and fit_result.tail(gain, 1) < UNLIKELY


def _explains(fit: Fit, chi2: float) -> bool:
    """Whether what is left is as small as sigma lets expect."""
    return fit.sigma_estimated or fit_result.tail(chi2, fit.freedom - 1) > UNLIKELY


def _suspect(
    fit: Fit, problem: Problem, found: Least, what: str, advice: str, chance: float = ALONE, more: int = 1
) -> Suspect:
    """From the lowest case; `chance` and `more` as in `_gains`."""
    k = best(found)
    values = problem.bounds.values(found.points[k])
    answer = [p.in_words(v) for p, v in zip(problem.parameters, values, strict=True)]
    chi2 = 2.0 * float(found.cost[k])
    own = values[: len(fit.parameters)]
    other = bool(fit_result.outside(fit.problem.parameters, own, fit.values, fit.own_intervals).any())
    return Suspect(
        what,
        ", ".join(answer[: len(fit.parameters)]),
        chi2,
        (other or not fit.sigma_estimated) and _gains(fit, chi2, chance, more),
        _explains(fit, chi2),
        advice,
    )


def _descended(fit: Fit, problem: Problem, scan: Scan) -> Least:
    """Least squares of another problem of the fit's parameters, from the fit's point, what else fitted well, and the
    lowest points of that problem."""
    low = np.argsort(batched_misfit.costs(problem, scan.predicted), kind="stable")[:STARTS]
    return search.minima_from(problem, np.concatenate([fit.point[None], scan.points[low], _best_points(fit)]))


def _best_points(fit: Fit) -> np.ndarray:
    """Points that fit best, shape (STARTS, parameters)."""
    return fit.known.points[np.argsort(fit.known.cost, kind="stable")[:STARTS]]


def _rows_left_aside(fit: Fit, scan: Scan) -> Iterator[Suspect]:
    """Each row left aside."""
    for k, row in enumerate(fit.rows):
        sigma = np.array(fit.sigma)
        sigma[k] *= UNWEIGHED
        problem = dataclasses.replace(fit.problem, sigma=jnp.asarray(sigma))
        found = _descended(fit, problem, scan)
        expected = float(found.beside[0][best(found)][k])
        off = (
            f"row {k + 1} is off: {row.quantity} = {row.value:g} {row.unit}, where the others let expect {expected:.4g}"
        )
        one = _suspect(fit, problem, found, off, "check that row, or fit with --robust student")
        yield one if one.explains else one._replace(advice="check that row")


def _fractions(fit: Fit, scan: Scan) -> Iterator[Suspect]:
    """Losses as shares of one."""
    losses = np.array([row.is_loss for row in fit.rows])
    values = np.array([float(row.value) for row in fit.rows])
    if not losses.any() or np.max(np.abs(values[losses])) >= 1.0:
        return
    factor = np.where(losses, 100.0, 1.0)
    problem = dataclasses.replace(fit.problem, measured=jnp.asarray(factor * values),
                                  sigma=jnp.asarray(factor * fit.sigma))  # fmt: skip
    found = _descended(fit, problem, scan)
    yield _suspect(fit, problem, found, "losses are given as fractions", "give them in percent")


def _other_parameters(fit: Fit, scan: Scan) -> Iterator[Suspect]:
    """Each parameter that is a suspect and was not fitted, by one program for all of them."""
    more = list(_suspect_parameters(fit))
    if not more or (fit.sigma_estimated and fit.freedom <= SEARCHED):  # nothing would tell
        return
    own, problem = len(fit.parameters), with_more(fit.problem, more, fit.rows)
    parameters, bounds = problem.parameters, problem.bounds
    still = bounds.coordinates(np.array([parameter.start(fit.problem.scene) for parameter in parameters], float))
    low, count = _best_points(fit), POINTS * len(scan.points) // search.scan_size(own)
    for i, parameter in enumerate(more, own):
        free = np.arange(len(parameters)) < own
        free[i] = True
        many = basin_spacings(problem)[i] < TURNING
        at = np.tile(still, (count if many else FEW * len(low), 1))
        if many:
            at[:, free] = search.spread([*parameters[:own], parameter], len(at))
        else:
            shares = np.linspace(*search.SPREAD, FEW)
            at[:, :own], at[:, i] = np.repeat(low, FEW, axis=0), np.tile(at_shares(shares), len(low))
        at[0, :own] = fit.point
        found = search.minima(problem, search.scanned(problem, at), free, lowest=LOWEST)
        k = best(found)
        value = float(bounds.values(found.points[k])[i])
        end = ", the end of its range" if abs(found.points[k, i]) >= AT_BOUND else ""
        what = f"{parameter.suspect} ({parameter.in_words(value)}{end})"
        yield _suspect(
            fit, problem, found, what, f"fit {parameter.name}, too, or measure it", ADDED / len(more), SEARCHED
        )


def _suspect_parameters(fit: Fit) -> Iterator[Parameter]:
    for name, parameter in PARAMETERS.items():
        if parameter.suspect and name not in fit.parameters:
            try:
                fit_parameters.bounds((parameter,), fit.problem.scene, fit.rows)
            except MeasuredError:  # such a law, or such rows, do not know it
                continue
            yield parameter
