"""What comes out of a fit: values, intervals, other answers, and what was measured beside what the model says."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special

from difftrb.core import status
from difftrb.core.jax_config import jit_quickly
from difftrb.fits import parameters as fit_parameters
from difftrb.fits import predicted, profile_intervals
from difftrb.fits.fit_problem import Problem, basin_spacings
from difftrb.fits.least_squares import Least, shares_of
from difftrb.fits.measured import Measurement, so_many
from difftrb.fits.parameters import Parameter
from difftrb.fits.profile_intervals import KnownCosts, Profiles
from difftrb.scene.scene import Scene

MOST_SHOWN = 2
"""Pieces of an interval that are shown one by one."""
UNLIKELY = 1e-3
"""Probability of a χ² below which data and model are taken to contradict each other."""


class History(NamedTuple):
    """Where least squares from each basin ended: values, shape (starts, parameters); χ² there and steps taken, shapes
    (starts,)."""

    last: np.ndarray
    chi2: np.ndarray
    steps: np.ndarray


class Alternative(NamedTuple):
    """Another answer, not ruled out at 99.7 %: values, shape (parameters,); its χ²; its share of the
    probability that all answers have together, each as a normal distribution of its own (Laplace)."""

    values: np.ndarray
    chi2: float
    weight: float


@dataclasses.dataclass(frozen=True, repr=False)
class Fit(status.Judged):
    """What measurements say of a spall.

    Attributes:
      parameters: names of what was fitted. values: in mm, rad, N or 1 (`units`), shape (parameters,).
      standard_errors: from the covariance at the optimum, shape (parameters,); NaN at a bound, and where the interval
        belies it, as at a cliff or a kink.
      pieces: of the 95 % interval of each parameter, rising, shape (pieces, 2) each. One is the fitted value's, from
        the profile of its likelihood: where χ² levels off behind an end, that is where 99.7 % end. `alternatives` that
        fit as well have others, and so have the fewest answers, this one among them, that have 95 % of the probability.
      open: where the first and the last of the pieces end with the range that was searched, shape (parameters, 2).
      correlation: of the parameters, shape (parameters, parameters).
      rows: the measurements. predicted: what the model says of them [% or N/mm], shape (rows,). sigma: that they were
        weighed by, shape (rows,); `sigma_estimated` if none was given. residuals: measured minus predicted in sigma.
      chi2: sum of squared residuals (of how they count, if robust). freedom: rows less parameters.
      remarks: what is worth knowing, in sentences. doubts: those of them that name what may be wrong with the data.
      determined_each: whether a parameter has a closed interval of one piece, less than a factor of 1.5 wide (angle:
        0.5 rad), that holds it in all `alternatives`, too, while the model explains the data, and that is not a
        spall's size whose interval ends where another size leaves the range that is searched; shape (parameters,).
        `determined`: all.
      alternatives: other answers that fit about as well, the best first.
      robust: how deviations counted. scene: prepared, with the fitted spall. history: of all starts.
      profiles, problem, point (coordinates), normal (matrix, by coordinates), limit (rise of χ² at an interval's ends):
        for figures and designs. known: all points that were scanned, and minima.
      status_code: see `difftrb.status`.
    """

    parameters: tuple[str, ...]
    values: np.ndarray
    standard_errors: np.ndarray
    pieces: tuple[np.ndarray, ...]
    open: np.ndarray
    correlation: np.ndarray
    rows: tuple[Measurement, ...]
    predicted: np.ndarray
    sigma: np.ndarray
    sigma_estimated: bool
    residuals: np.ndarray
    chi2: float
    freedom: int
    remarks: tuple[str, ...]
    doubts: tuple[str, ...]
    determined_each: np.ndarray
    alternatives: tuple[Alternative, ...]
    scene: Scene
    history: History
    profiles: Profiles
    problem: Problem
    robust: str
    point: np.ndarray
    normal: np.ndarray
    limit: float
    known: KnownCosts
    status_code: jax.Array

    def __repr__(self) -> str:
        """On a few lines: parameters with their intervals, misfit, remarks."""
        parts = zip(self.problem.parameters, self.values, self.determined_each, strict=True)
        lines = [
            f"  {parameter.in_words(value, 4)} ({self.interval_in_words(i)}{'' if sure else ', not determined'})"
            for i, (parameter, value, sure) in enumerate(parts)
        ]
        first = f"Fit of {so_many(len(self.rows), 'row')}, χ² {self.chi2:.3g}: {self.status}"
        return "\n".join([first, *lines, *(f"  {remark}" for remark in self.remarks)])

    @property
    def determined(self) -> bool:
        """Whether every parameter is."""
        return bool(self.determined_each.all())

    @property
    def intervals(self) -> np.ndarray:
        """95 %, shape (parameters, 2): the least range that holds all `pieces`."""
        return np.array([(own[0, 0], own[-1, 1]) for own in self.pieces])

    @property
    def place(self) -> np.ndarray:
        """`point` by its name in 0.1; goes with the release after this one."""
        warnings.warn("Fit.place is called Fit.point", DeprecationWarning, stacklevel=2)
        return self.point

    @property
    def own_intervals(self) -> np.ndarray:
        """Those `pieces` that hold the fitted values, shape (parameters, 2)."""
        return np.stack([own[self._own(i)] for i, own in enumerate(self.pieces)])

    @property
    def own_open(self) -> np.ndarray:
        """Where `own_intervals` end with the range that was searched, shape (parameters, 2)."""
        at = [(self._own(i), len(own) - 1) for i, own in enumerate(self.pieces)]
        return self.open & np.array([(k == 0, k == last) for k, last in at])

    def _own(self, i: int) -> int:
        """Which of the pieces holds the fitted value, or is next to it."""
        low, high = self.pieces[i].T
        return int(np.argmin(np.maximum(np.maximum(low - self.values[i], self.values[i] - high), 0.0)))

    def interval_in_words(self, i: int) -> str:
        """The pieces of an interval; an end that the range sets and not the data is left out. Many are shown as one."""
        pieces, (no_low, no_high) = self.pieces[i], self.open[i]
        if len(pieces) > MOST_SHOWN:
            pieces = self.intervals[i : i + 1]
        period = self.problem.parameters[i].period or np.inf
        if len(pieces) == 1 and ((no_low and no_high) or np.ptp(pieces) >= period):
            return "any"
        ends = [(f"{low:.4g}", f"{high:.4g}") for low, high in pieces]
        words = [low if low == high else f"{low} … {high}" for low, high in ends]
        if no_low:
            words[0] = f"< {pieces[0, 1]:.4g}"
        if no_high:
            words[-1] = f"> {pieces[-1, 0]:.4g}"
        return " or ".join(words)

    @property
    def chance(self) -> float:
        """Chance of a `misfit` this large if the model and sigma are right; NaN if sigma was estimated."""
        return float("nan") if self.sigma_estimated else tail(*self.misfit)

    @property
    def misfit(self) -> tuple[float, int]:
        """χ² of the rows that should be met, with the model's common error in it, and its degrees of freedom, one where
        no row is to spare: as many parameters as rows meet them all, or their bounds keep them from it. Of a robust fit
        that of those two thirds of the rows that are nearest to it: what misses more is no outlier."""
        if self.robust == "squares":
            return self.chi2, max(self.freedom, 1)
        squares = np.sort(self.residuals**2)
        kept = squares[: len(squares) - len(squares) // 3]
        return float(np.sum(kept)), max(len(kept) - len(self.values), 1)

    @property
    def explained(self) -> bool:
        """Whether data and model do not contradict each other, as far as that can be told."""
        return not self.chance < UNLIKELY

    @property
    def reliable(self) -> bool:
        """Whether the model explains the data and nothing is found that explains them much better."""
        return self.explained and not self.doubts

    @property
    def units(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(parameter.unit for parameter in self.problem.parameters)

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the parameters, for figures."""
        return tuple(parameter.label or parameter.name for parameter in self.problem.parameters)

    def __getitem__(self, name: str) -> float:
        """The fitted value of a parameter."""
        return float(self.values[self.parameters.index(name)])

    def along(self, i: int, coordinates: np.ndarray) -> np.ndarray:
        """Values of the i-th parameter at its coordinates, any one shape."""
        low, high = (end[i] for end in self.problem.bounds.ends())
        raw = low + (high - low) * shares_of(coordinates)
        return np.exp(raw) if self.problem.bounds.logarithmic[i] else raw

    def ridge(self, box: np.ndarray, points: int = 21) -> np.ndarray:
        """Rise of χ² over a grid of the first two parameters, all others free: shape (points, points), the first along
        rows. `box` are coordinates: (first low, high), (second low, high), shape (2, 2)."""
        grid = np.meshgrid(*(np.linspace(low, high, points) for low, high in box), indexing="ij")
        at = np.tile(self.point, (points * points, 1))
        at[:, 0], at[:, 1] = (axis.ravel() for axis in grid)
        free = np.tile(np.arange(len(self.point)) > 1, (len(at), 1))
        starts = profile_intervals.starts_of(self.point, self.normal, self.known, free, at)
        costs, _ = profile_intervals.held(self.problem, free, list(starts.swapaxes(0, 1)), at)
        return 2.0 * (costs - 0.5 * self.chi2).reshape(points, points)

    def by_data(self) -> np.ndarray:
        """Derivative of the values by what was measured, shape (parameters, rows).

        By the implicit function theorem with the whole second derivative: exact for data that the model does not meet,
        too.
        """
        return np.asarray(_by_data(self.problem, self.point))


@jit_quickly()
def _by_data(problem: Problem, u: jax.Array | np.ndarray) -> jax.Array:
    def gradient(v: jax.Array, measured: jax.Array) -> jax.Array:
        own = dataclasses.replace(problem, measured=measured)
        return jax.jacfwd(lambda w: 0.5 * jnp.sum(predicted.residual(own, w) ** 2))(v)

    curvature = jax.jacfwd(gradient)(u, problem.measured)
    moved = -jnp.linalg.solve(curvature, jax.jacfwd(gradient, 1)(u, problem.measured))
    return jax.jacfwd(problem.bounds.values)(u) @ moved


def outside(parameters: Sequence[Parameter], values: np.ndarray, best: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """Which values, shape (…, parameters), lie outside of the intervals of the `best` ones, by more than rounding; of
    what has a period they are taken next to the best."""
    values = fit_parameters.wrapped(parameters, values, best)
    near = 1e-3 * np.abs(best) + 1e-6
    return (values < intervals[:, 0] - near) | (values > intervals[:, 1] + near)


def curvature(problem: Problem, found: Least, k: int, scale: float = 1.0) -> np.ndarray:
    """Of half χ² at a minimum, divided by `scale`, by shares of the ways between the parameters' bounds, along which a
    spall is as likely everywhere; shape (parameters, parameters). No answer is wider than basins lie apart."""
    share = shares_of(found.points[k])
    rate = share * (1.0 - share)
    return found.normal[k] / (scale * np.outer(rate, rate)) + np.diag((0.25 * basin_spacings(problem)) ** -2.0)


def weights(problem: Problem, found: Least, cases: list[int], scale: float) -> np.ndarray:
    """Shares of the probability of these minima, shape (cases,), each as a normal distribution of its own (Laplace);
    χ² counts by `scale`."""
    logs = [-found.cost[k] / scale - 0.5 * np.linalg.slogdet(curvature(problem, found, k, scale))[1] for k in cases]
    shares = np.exp(np.array(logs) - max(logs))
    return shares / np.sum(shares)


def tail(chi2: float, freedom: int) -> float:
    """Chance that chi² of so many degrees of freedom is larger; of one where no row is to spare."""
    return float(scipy.special.gammaincc(0.5 * max(freedom, 1), 0.5 * chi2))
