"""Which measurement to make next: among many candidates those that leave the least uncertainty."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from difftrb.core import geometry
from difftrb.core.input_errors import is_whole
from difftrb.fits import measured, predicted
from difftrb.fits.fit_result import Fit
from difftrb.fits.least_squares import AT_BOUND
from difftrb.fits.measured import MeasuredError, Measurement
from difftrb.ring.load import Load, largest_load
from difftrb.scene import checks

SPARE = 1.02
"""By how much an axial load that is suggested is more than what holds the ring."""


class Suggestion(NamedTuple):
    """A measurement worth making.

    Attributes:
      row: what to measure; its value is what the fit predicts, its sigma what the fit's rows let expect.
      gain: by what factor the volume of the confidence region shrinks.
      errors: standard errors of the fit's parameters with this measurement and those suggested before it.
    """

    row: Measurement
    gain: float
    errors: dict[str, float]


def candidates(fit: Fit) -> tuple[Measurement, ...]:
    """Measurements that the fit's rig could make: its loads, half and twice their axial and half and no radial load
    where the law covers them, both directions, with a roller in the middle of the spall, with the spall between two
    rollers, and the mean over phases; of the kinds of quantity that were measured."""
    scene = fit.scene
    known = sorted({(float(row.radial), float(row.axial)) for row in fit.rows})
    most = max(float(largest_load(scene.bearing, Load(*pair))) for pair in known)
    loads = [(r * a, f * b) for r, f in known for a, b in ((1.0, 1.0), (0.0, 1.0), (0.5, 1.0), (1.0, 0.5), (1.0, 2.0))]
    half = 0.5 * float(geometry.roller_pitch(scene.bearing))
    first = scene.spalls[0]
    # a roller's own stays with roller 0, which bears most at the load line
    centred = 0.0 if first.surface == "roller" else float(geometry.wrapped(float(first.angle)))
    turns_along = any(spall.surface == "roller" for spall in scene.spalls)  # it has no mean
    kinds = [kind for kind in ("loss", "stiffness") if any(row.quantity.endswith(kind) for row in fit.rows)]
    definition = fit.rows[0].definition
    found = []
    for radial, axial in dict.fromkeys(loads):
        load = Load(radial, axial)
        if float(largest_load(scene.bearing, load)) > most * (1.0 + 1e-9):
            continue
        scarce = dataclasses.replace(scene, load=Load(radial, axial / SPARE), phase="mean")
        if checks.not_held(scarce) is not None:
            continue
        for kind in kinds:
            for direction in ("radial", "axial"):
                if direction == "radial" and radial == 0.0 and (definition or scene.definition) == "secant":
                    continue
                for phase in (centred, centred + half, *(() if turns_along else ("mean",))):
                    found.append(
                        Measurement(radial, axial, f"{direction}_{kind}", 0.0, 1.0, definition, phase)  # type: ignore[arg-type]
                    )
    return tuple(found)


def next_measurements(
    fit: Fit, among: Sequence[Measurement] | None = None, count: int = 3, parameter: str | None = None
) -> tuple[Suggestion, ...]:
    """The measurements to add, one after the other, each the best beside those before it.

    Args:
      fit: from `difftrb.fit`; measurements are judged at its values.
      among: what could be measured; values are ignored, and a sigma of 1 or None stands for the same relative error as
        the fit's rows of its kind. None: see `candidates`.
      count: how many, at least 1. Default 3.
      parameter: None shrinks the volume of the confidence region most (D-optimal); the name of a parameter shrinks that
        one's interval most.

    Raises `MeasuredError` for what is no fit, for nothing to choose from, and for a parameter that was not fitted.
    """
    if not isinstance(fit, Fit):
        raise MeasuredError(f"next_measurements: {type(fit).__name__} is no fit: give what difftrb.fit returns")
    if not is_whole(count, 1):
        raise MeasuredError(f"next_measurements: count = {count!r}: must be a whole number, at least 1")
    among = candidates(fit) if among is None else measured.listed(among)
    if not among:
        raise MeasuredError("next_measurements: there is nothing to choose from: give measurements in `among`")
    if parameter is not None and parameter not in fit.parameters:
        raise MeasuredError(f"next_measurements: parameter = {parameter!r} was not fitted; use one of "
                            f"{', '.join(fit.parameters)}")  # fmt: skip
    measured.check_loads(fit.scene, among, "next_measurements")
    values, slopes = predicted.other_rows_and_slopes(fit.problem, among, fit.point)
    sigma = np.array([_sigma(fit, row, value) for row, value in zip(among, values, strict=True)])
    rows = slopes / sigma[:, None]
    covariance = np.linalg.inv(fit.normal + np.diag(1.0 / fit.problem.prior**2))
    # at a bound slopes by coordinates vanish, and tell no error
    slope = np.where(np.abs(fit.point) < AT_BOUND, fit.problem.bounds.rate(fit.point), np.nan)
    chosen: list[Suggestion] = []
    left = np.ones(len(among), bool)
    for _ in range(min(count, len(among))):
        towards = rows @ covariance
        more = 1.0 + np.sum(towards * rows, axis=1)
        of_one = None if parameter is None else towards[:, fit.parameters.index(parameter)]
        worth = more if of_one is None else of_one**2 / more
        known = left & np.isfinite(worth)  # the law may not know the rollers of a lighter load
        if not known.any():
            break
        k = int(np.argmax(np.where(known, worth, -1.0)))
        left[k] = False
        covariance = covariance - np.outer(towards[k], towards[k]) / more[k]
        errors = dict(zip(fit.parameters, (np.sqrt(np.diag(covariance)) * slope).tolist(), strict=True))
        row = dataclasses.replace(among[k], value=float(values[k]), sigma=float(sigma[k]))
        chosen.append(Suggestion(row, float(np.sqrt(more[k])), errors))
    return tuple(chosen)


def telling(fit: Fit, others: np.ndarray) -> list[tuple[Measurement, float]]:
    """The measurement among `candidates` that tells the fitted values best from each other answer, shape (answers,
    parameters), and by how many sigma it would differ."""
    among = candidates(fit)
    points = np.concatenate([fit.point[None], fit.problem.bounds.coordinates(others)])
    here, *there = predicted.other_rows(fit.problem, among, points)
    sigma = np.array([_sigma(fit, row, value) for row, value in zip(among, here, strict=True)])
    apart = [np.nan_to_num(np.abs(other - here) / sigma) for other in there]
    return [(among[int(np.argmax(each))], float(np.max(each))) for each in apart]


def _sigma(fit: Fit, row: Measurement, value: float) -> float:
    """The error to expect of a measurement: its own, or in proportion to what it will be, as of the fit's rows."""
    if row.sigma not in (None, 1.0):
        return float(row.sigma)  # type: ignore[arg-type]
    of_kind = [other.is_loss == row.is_loss for other in fit.rows]
    sigma, size = (each[of_kind] if any(of_kind) else each for each in (fit.sigma, np.abs(fit.predicted)))
    seen = size > sigma  # a row at a phase where no roller is at the spall says nothing of what is in proportion
    share = float(np.median(sigma[seen] / size[seen])) if seen.any() else 1.0
    return max(share * abs(value), 0.3 * float(sigma.min()), 1e-9)


def in_words(row: Measurement) -> str:
    """What to measure, for a sentence."""
    phase = "mean" if row.phase == "mean" else round(float(row.phase or 0.0), 6) + 0.0  # type: ignore[arg-type]
    at = "as the mean over phases" if phase == "mean" else f"with roller 0 at {phase:.4g} rad"
    what = row.quantity.replace("_", " ")
    return f"the {what} at {row.radial:g} N radial and {row.axial:g} N axial {at}"
