"""What comes out of a fit."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import status
from difftrb.fits import intervals
from difftrb.fits import parameters as unknown
from difftrb.fits.intervals import Profiles, Solve
from difftrb.fits.measured import Measurement
from difftrb.fits.predicted import Problem
from difftrb.scene.scene import Scene


class History(NamedTuple):
    """Where each start went: values at first and at last, shapes (starts, unknowns); chi² at last and steps of
    Levenberg–Marquardt, shapes (starts,)."""

    first: np.ndarray
    last: np.ndarray
    chi2: np.ndarray
    steps: np.ndarray


@dataclasses.dataclass(frozen=True)
class Fit(status.Judged):
    """What measurements say of a spall.

    Attributes:
      parameters: names of what was fitted. values: in mm, rad, N or 1 (`units`), shape (parameters,).
      standard_errors: from the covariance at the optimum, shape (parameters,); NaN at a bound.
      intervals: 95 %, from profiles of the likelihood, shape (parameters, 2); `open` where an end is the end of the
        range that was searched, shape (parameters, 2).
      correlation: of the parameters, shape (parameters, parameters).
      rows: the measurements. predicted: what the model says of them [% or N/mm], shape (rows,). sigma: that they were
        weighed by, shape (rows,); `sigma_estimated` if none was given. residuals: measured minus predicted in sigma.
      chi2: sum of squared residuals (of how they count, if robust). freedom: rows less parameters.
      remarks: what is worth knowing, in sentences. `determined`: whether every parameter has a closed interval less
        than a factor of 1.5 wide (angle: 0.5 rad), and no other answer fits nearly as well.
      robust: how deviations counted. scene: prepared, with the fitted spall. history: of all starts.
      profiles, problem, place (coordinates), normal (matrix, by coordinates), limit (rise of χ² at an interval's ends),
        solve (the program that fitted): for figures and designs.
      status_code: see `difftrb.status`.
    """

    parameters: tuple[str, ...]
    values: np.ndarray
    standard_errors: np.ndarray
    intervals: np.ndarray
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
    determined: bool
    scene: Scene
    history: History
    profiles: Profiles
    problem: Problem
    robust: str
    place: np.ndarray
    normal: np.ndarray
    limit: float
    solve: Solve
    status_code: jax.Array

    @property
    def units(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(unknown.UNITS[name] for name in self.parameters)

    def __getitem__(self, name: str) -> float:
        """The fitted value of a parameter."""
        return float(self.values[self.parameters.index(name)])

    def along(self, i: int, coordinates: np.ndarray) -> np.ndarray:
        """Values of the i-th parameter at its coordinates, any one shape."""
        low, high = (np.asarray(end)[i] for end in self.problem.unknowns.ends())
        raw = low + (high - low) / (1.0 + np.exp(-coordinates))
        return np.exp(raw) if self.problem.unknowns.logarithmic[i] else raw

    def ridge(self, box: np.ndarray) -> np.ndarray:
        """See `intervals.ridge`: over coordinates of the first two parameters, (low, high) of each, shape (2, 2)."""
        return intervals.ridge(self.solve, self.problem, self.place, 0.5 * self.chi2, self.normal, box)

    def by_data(self) -> np.ndarray:
        """Derivative of the values by what was measured, shape (parameters, rows): see `intervals.by_data`."""
        return np.asarray(intervals.by_data(self.problem, jnp.asarray(self.place)))
