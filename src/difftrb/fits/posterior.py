"""What measurements leave of all sizes that a spall may have: the posterior, by nested sampling.

Where a fit's intervals are those of its best answer and name others beside it, a posterior weighs them all, and what is
not known beside them. Priors are even over the range of every parameter, of sizes in their logarithm.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from difftrb.core.input_errors import is_whole, number_in, shown
from difftrb.fits import batched_misfit, nested_sampling
from difftrb.fits import parameters as fit_parameters
from difftrb.fits.fit_problem import Problem, with_more
from difftrb.fits.fit_result import Fit
from difftrb.fits.least_squares import Bounds, at_shares
from difftrb.fits.measured import MeasuredError
from difftrb.fits.profile_intervals import CONFIDENCE, limit_of
from difftrb.law.samples import Progress

if TYPE_CHECKING:
    import xarray

LIVE = 200
"""Points of nested sampling: with more there are more that are independent, answers that are farther apart or narrower
are found, and it takes as much longer."""
DRAWS = 1000
MISSED = 5.0
"""By so much less than that of the fit's answer the logarithms of all likelihoods have missed it."""
AGAIN = 4
"""Times as many points are taken where they have."""
Ranges = Mapping[str, tuple[float, float]]
"""Of priors, by parameter, in its unit."""


@dataclasses.dataclass(frozen=True, repr=False)
class Posterior:
    """Draws from the posterior, all of the same weight.

    Attributes:
      parameters: names, the fit's first, then those that are not of interest by themselves. units: theirs.
      values: draws [unit], shape (draws, parameters).
      ranges: of the prior [unit], shape (parameters, 2): even between these, of sizes in their logarithm.
      log_evidence: natural logarithm of the chance density of the rows as they were measured, whatever the values.
        error: its standard error.
      effective: as many independent draws would tell as much. evaluations: of the likelihood.
      widened: by what factor squares of deviations count less than sigma says, for the fit misses the rows by more;
        the evidence is as if they did, too.
    """

    parameters: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    ranges: np.ndarray
    log_evidence: float
    error: float
    effective: float
    evaluations: int
    widened: float

    def __getitem__(self, name: str) -> np.ndarray:
        """Draws of one parameter, shape (draws,)."""
        return self.values[:, self.parameters.index(name)]

    def __repr__(self) -> str:
        """A line for each parameter: its mean, standard deviation and interval."""
        ends = zip(self.parameters, self.units, self.values.T, self.intervals(), strict=True)
        lines = [
            f"  {name} {np.mean(own):.4g} ± {np.std(own):.2g} {unit} ({low:.4g} … {high:.4g})"
            for name, unit, own, (low, high) in ends
        ]
        evidence = f"log evidence {self.log_evidence:.2f} ± {self.error:.2f}"
        return "\n".join([f"Posterior of {len(self.values)} draws, {evidence}", *lines])

    def intervals(self, confidence: float = CONFIDENCE) -> np.ndarray:
        """The shortest that hold so much of the posterior [unit], shape (parameters, 2)."""
        if not 0.0 < confidence < 1.0:
            raise MeasuredError(f"confidence = {shown(confidence)}: must be above 0 and below 1")
        rising = np.sort(self.values, axis=0)
        held = int(np.ceil(confidence * len(rising))) - 1
        first = np.argmin(rising[held:] - rising[: len(rising) - held], axis=0)
        each = np.arange(rising.shape[1])
        return np.stack([rising[first, each], rising[first + held, each]], axis=1)

    def to_xarray(self) -> xarray.Dataset:
        """A variable for each parameter, of one chain: `arviz.convert_to_inference_data` (`arviz.convert_to_datatree`
        from 1.0 on) takes it as it is. Needs xarray: `pip install '.[io]'`."""
        import xarray

        parts = {
            name: (("chain", "draw"), self[name][None], {"units": unit})
            for name, unit in zip(self.parameters, self.units, strict=True)
        }
        attributes = {"log_evidence": self.log_evidence, "log_evidence_error": self.error, "effective": self.effective}
        return xarray.Dataset(parts, {"chain": [0], "draw": np.arange(len(self.values))}, attributes)


def posterior(
    fit: Fit,
    nuisances: Sequence[str] = (),
    ranges: Ranges | None = None,
    live: int = LIVE,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Progress | None = None,
) -> Posterior:
    """The posterior of what was fitted, by nested sampling (Skilling 2006).

    Args:
      fit: of `difftrb.fit`: its rows, parameters, robustness, model error common to all rows. Where it misses the rows
        by more than sigma, or sigma was estimated, the posterior is as much wider as its intervals are.
      nuisances: parameters that are not known either, say "scale" for the compliance of housing and shaft; the
        posterior of the others is that whatever these are.
      ranges: of priors by parameter, say {"scale": (0.7, 1.0)} [unit], within those that a fit searches, which are
        the default.
      live: points of nested sampling, 50 … 10000: see `LIVE`. The evidence's error falls with their root.
      draws: how many to return, 100 … 100000. seed: of all that is random.
      progress: told how many of how many parts are done.

    Raises `MeasuredError` for what cannot be sampled.
    """
    if not isinstance(fit, Fit):
        raise MeasuredError(f"posterior: {type(fit).__name__} is no fit: give what difftrb.fit returns")
    fit.check()
    for name, value, low, high in (("live", live, 50, 10_000), ("draws", draws, 100, 100_000)):
        if not is_whole(value, low, high):
            raise MeasuredError(f"{name} = {shown(value)}: must be a whole number in {low} … {high}")
    more = [name for name in nuisances if name not in fit.parameters]
    problem = with_more(fit.problem, fit_parameters.named(more) if more else (), fit.rows)
    problem = dataclasses.replace(problem, bounds=_within(problem, ranges or {}))
    widened, known, own = fit.limit / limit_of(None), -np.inf, slice(len(fit.values))
    if np.all((problem.bounds.low[own] <= fit.values) & (fit.values <= problem.bounds.high[own])):
        known = float(log_density(fit.problem, fit.predicted[None], widened)[0])
    return posterior_of(problem, widened, live, draws, seed, _nats(fit), progress, known)


def posterior_of(
    problem: Problem, widened: float, live: int, draws: int, seed: int, nats: float, progress: Progress | None,
    known: float = -np.inf,
) -> Posterior:  # fmt: skip
    """The posterior of a problem that nothing was fitted to, or of one of whose likelihoods the logarithm is `known`:
    points that all miss it are taken again, more of them. See `Posterior.widened` and `nested_sampling.sampled`."""
    problem = dataclasses.replace(problem, bounds=once_round(problem))

    def log_likelihood(points: np.ndarray) -> np.ndarray:
        rows = batched_misfit.rows_at(problem, at_shares(points), many=True)
        return log_density(problem, rows, widened)

    for many in (live, AGAIN * live):
        found = nested_sampling.sampled(log_likelihood, len(problem.parameters), many, seed, nats, progress)
        if found.highest > known - MISSED:
            break
    else:
        raise MeasuredError(
            f"live = {live}: too few points to find the fit's own answer, {known - found.highest:.3g} above all others "
            f"in the logarithm of the likelihood; give more than {AGAIN * live}"
        )
    return Posterior(
        parameters=tuple(parameter.name for parameter in problem.parameters),
        units=tuple(parameter.unit for parameter in problem.parameters),
        values=np.asarray(problem.bounds.values(at_shares(found.drawn(draws, seed)))),
        ranges=np.stack([problem.bounds.low, problem.bounds.high], axis=1),
        log_evidence=found.log_evidence,
        error=found.error,
        effective=found.effective,
        evaluations=found.evaluations,
        widened=widened,
    )


def _within(problem: Problem, ranges: Ranges) -> Bounds:
    """The problem's bounds, those that have `ranges` within these."""
    names, bounds = [parameter.name for parameter in problem.parameters], problem.bounds
    low, high = np.array(bounds.low, float), np.array(bounds.high, float)
    for name, (least, most) in ranges.items():
        if name not in names:
            raise MeasuredError(f"ranges: {shown(name)} is none of the parameters {', '.join(names)}")
        i = names.index(name)
        if not low[i] * (1.0 - 1e-9) <= least < most <= high[i] * (1.0 + 1e-9):
            limits = number_in(float(low[i]), float(high[i]))
            raise MeasuredError(f"ranges: {name} = {least:g} … {most:g}: both ends must be {limits}, and rise")
        low[i], high[i] = least, most
    return dataclasses.replace(bounds, low=low, high=high)


def once_round(problem: Problem) -> Bounds:
    """The problem's bounds, those of more than a period cut to one."""
    low, high = np.array(problem.bounds.low, float), np.array(problem.bounds.high, float)
    period = np.array([parameter.period or np.inf for parameter in problem.parameters])
    more = high - low > period
    return dataclasses.replace(
        problem.bounds, low=np.where(more, -0.5 * period, low), high=np.where(more, 0.5 * period, high)
    )


def _nats(fit: Fit) -> float:
    """By what factor of e the fit's own answer is narrower than the prior, as a normal distribution."""
    low, high = fit.problem.bounds.ends()
    slope = np.maximum(fit.problem.bounds.slope(fit.point) / (high - low), 1e-3)  # of the cube's sides by coordinates
    spread = np.sqrt(np.linalg.det(fit.normal / np.outer(slope, slope) + np.eye(len(slope))))
    return float(np.log(spread)) - 0.5 * len(slope) * float(np.log(2.0 * np.pi * np.e))


def log_density(problem: Problem, rows: np.ndarray, widened: float = 1.0) -> np.ndarray:
    """Logarithm of the chance density of the rows as they were measured, shape (cases,), if the model says these
    `rows`, shape (cases, rows)."""
    sigma, losses = np.asarray(problem.sigma), np.asarray(problem.conditions.loss)
    fixed = -np.sum(np.log(sigma)) - 0.5 * len(sigma) * np.log(2.0 * np.pi * widened)
    common = float(problem.common) if problem.by_squares else 0.0
    # an error that rows have in common takes more of the density the larger they are
    size = np.nan_to_num(rows / sigma) ** 2
    shared = sum(np.log1p(common**2 * np.sum(size[:, kind], axis=1)) for kind in (losses, ~losses))
    return fixed - batched_misfit.costs(problem, rows) / widened - 0.5 * shared
