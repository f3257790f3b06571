"""Remarks on a fit, in sentences: what the data leave open, and what in them looks wrong."""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.fits import fit_result, optimal_design
from difftrb.fits.fit_result import EDGE, Fit
from difftrb.fits.parameters import PARAMETERS, OfSpall
from difftrb.ring import effects

UNLIKELY = 1e-3
"""Probability of a χ² below which data and model are taken to contradict each other."""
FAR = 4.0
"""Deviation [sigma] at which one row is named."""
REPEAT = 4.0
"""Difference [sigma] between two rows of the same condition at which both are named."""
TOLD_APART = 2.0
"""Difference [sigma] of two answers' predictions below which a measurement does not decide between them."""


def of(fit: Fit, starts: np.ndarray) -> dict[str, Any]:
    """Fields `remarks` and `determined` of a fit; `starts` are the predictions at all starts, shape (starts, rows)."""
    unclear = [i for i in range(len(fit.parameters)) if _is_open(fit, i)]
    remarks = [
        *effects.remarks(fit.scene.effects, fit.scene.spalls),
        *_about_rows(fit),
        *_about_misfit(fit),
        *_beyond(fit, starts),
        *_bounds(fit),
    ]
    if unclear:
        remarks.append(_unclear(fit, unclear))
    rivals = [] if unclear else _rivals(fit)
    remarks += [_of_rival(fit, values, chi2) for values, chi2 in rivals]
    if fit.sigma_estimated:
        kind = "losses" if all(row.is_loss for row in fit.rows) else "values"
        middle = 100.0 * float(np.median(fit.sigma / np.array([abs(float(row.value)) or 1.0 for row in fit.rows])))
        remarks.append(
            f"no sigma was given: from how the fit misses the {kind} it is estimated as {middle:.2g} % of them"
        )
    return {"remarks": tuple(remarks), "determined": not unclear and not rivals}


def _is_open(fit: Fit, i: int) -> bool:
    (low, high), parameter = fit.intervals[i], fit.problem.parameters[i]
    if parameter.logarithmic:
        return bool(high / low > parameter.wide)
    return bool(fit.open[i].all()) or high - low > parameter.wide


def _about_rows(fit: Fit) -> list[str]:
    """What is odd about the measurements alone."""
    found = []
    by_kind: dict[tuple, list[int]] = {}
    for k, row in enumerate(fit.rows):
        if row.is_loss and row.value < -3.0 * fit.sigma[k]:
            found.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} % is below zero by more than its error: a spall cannot "
                "stiffen a bearing; check the sign (a loss is positive) and which of the two is the healthy bearing"
            )
        by_kind.setdefault((row.radial, row.axial, row.quantity, row.definition, row.phase), []).append(k)
    for same in by_kind.values():
        values = np.array([fit.rows[k].value for k in same])
        low, high = same[int(np.argmin(values))], same[int(np.argmax(values))]
        apart = (fit.rows[high].value - fit.rows[low].value) / np.hypot(fit.sigma[low], fit.sigma[high])
        if apart > REPEAT:
            found.append(
                f"rows {low + 1} and {high + 1} measure the same and differ by {apart:.1f} sigma: one of them is "
                "wrong, or sigma is too small"
            )
    for quantity in sorted({row.quantity for row in fit.rows}):
        rows = [k for k, row in enumerate(fit.rows) if row.quantity == quantity]
        constant = len(rows) > 2 and len({float(fit.rows[k].value) for k in rows}) == 1
        if constant and np.ptp(fit.predicted[rows]) > 3.0 * float(np.median(fit.sigma[rows])):
            found.append(
                f"all {len(rows)} values of {quantity} are {fit.rows[rows[0]].value:g} although they were measured "
                "under different conditions: check that the column was filled in"
            )
    return found


def _about_misfit(fit: Fit) -> list[str]:
    """Where the model misses the data by more than sigma."""
    found = []
    if not fit.sigma_estimated and fit.freedom > 0 and fit.robust == "squares":
        chance = fit_result.tail(fit.chi2, fit.freedom)
        if chance < UNLIKELY:
            worst = int(np.argmax(np.abs(fit.residuals)))
            times = float(np.sqrt(fit.chi2 / fit.freedom))
            others = ", ".join(name for name, one in reversed(PARAMETERS.items()) if not isinstance(one, OfSpall))
            found.append(
                f"the fit misses the data by {times:.1f} times their sigma (χ² = {fit.chi2:.3g} of {fit.freedom} "
                f"degrees of freedom), worst in row {worst + 1} ({fit.residuals[worst]:+.1f} sigma): sigma is too "
                f"small, rows contradict each other, or the model lacks something ({others}); intervals are too narrow"
            )
    for k, off in enumerate(fit.residuals):
        if abs(off) > FAR and fit.robust != "squares":
            found.append(f"row {k + 1} stands {off:+.1f} sigma from the fit and counts for little")
    return found


def _beyond(fit: Fit, starts: np.ndarray) -> list[str]:
    """Measured values that no spall within the ranges gives."""
    most = np.maximum(np.nanmax(starts, axis=0), fit.predicted)
    found = []
    for k, row in enumerate(fit.rows):
        if row.is_loss and row.value > most[k] + 3.0 * fit.sigma[k]:
            found.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} % is more than the model can give: at most "
                f"{most[k]:.3g} % in the ranges searched; check the unit (percent), and that nothing but the spall "
                "differs"
            )
        if not row.is_loss and not 0.2 < row.value / fit.predicted[k] < 5.0:
            found.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} N/mm is {row.value / fit.predicted[k]:.2g} times what "
                "the model gives: check the unit (N/mm, not N/µm)"
            )
    return found


def _bounds(fit: Fit) -> list[str]:
    found = []
    for i, name in enumerate(fit.parameters):
        if abs(fit.place[i]) >= EDGE:
            side = "largest" if fit.place[i] > 0.0 else "smallest"
            found.append(f"{name} ends at the {side} value that is searched, {fit.values[i]:.4g} {fit.units[i]}")
    return found


def _unclear(fit: Fit, unclear: list[int]) -> str:
    """Which parameters the data leave open, which product of sizes they determine, and what to measure."""
    names = [fit.parameters[i] for i in unclear]
    each = [
        f"{name} is not ({fit.intervals[i][0]:.3g} … {fit.intervals[i][1]:.3g} {fit.units[i]} fit as well)"
        for i, name in zip(unclear, names, strict=True)
    ]
    suggestion = optimal_design.next_measurements(fit, count=1, parameter=names[0])[0]
    advice = f"measure {optimal_design.in_words(suggestion.row)}"
    sizes = [i for i, parameter in enumerate(fit.problem.parameters)
             if parameter.logarithmic and parameter.in_products and abs(fit.place[i]) < EDGE]  # fmt: skip
    if len(sizes) > 1:
        powers, error = _best_determined(fit, sizes)
        percent = 100.0 * error * float(np.sqrt(fit.limit))
        if percent < 30.0:
            return f"{_product(powers)} is determined to {percent:.2g} %, {' and '.join(each)}: {advice}"
    return f"{' and '.join(each)[:1].upper()}{' and '.join(each)[1:]}: {advice}"


def _best_determined(fit: Fit, sizes: list[int]) -> tuple[dict[str, float], float]:
    """The product of powers of these parameters that is known best: exponents by name, standard error of its
    logarithm."""
    slope = fit.problem.bounds.slope(fit.place)
    covariance = (fit_result.covariance(fit.normal, fit.place) * np.outer(slope, slope))[np.ix_(sizes, sizes)]
    _, directions = np.linalg.eigh(covariance)
    powers = directions[:, 0] / directions[np.argmax(np.abs(directions[:, 0])), 0]
    names = [fit.parameters[i] for i in sizes]
    return dict(zip(names, powers.tolist(), strict=True)), float(np.sqrt(powers @ covariance @ powers))


def _product(powers: dict[str, float]) -> str:
    """A product of powers in words; factors that hardly count are left out."""
    factors = []
    for name, power in sorted(powers.items(), key=lambda pair: -abs(pair[1])):
        if abs(power) > 0.15:
            factors.append(name if abs(power - 1.0) < 0.1 else f"{name}^{power:.1f}")
    return " × ".join(factors)


def _rivals(fit: Fit) -> list[tuple[np.ndarray, float]]:
    """The best two other answers that fit as well, outside of the best one's intervals, and their χ²."""
    found: list[tuple[np.ndarray, float]] = []
    near = 1e-3 * np.abs(fit.values) + 1e-6
    low, high = fit.intervals[:, 0] - near, fit.intervals[:, 1] + near
    for k in np.argsort(fit.history.chi2):
        values, chi2 = fit.history.last[k], float(fit.history.chi2[k])
        outside = (values < low) | (values > high)
        known = any(np.allclose(values, other, rtol=1e-2, atol=1e-3) for other, _ in found)
        if outside.any() and not known and chi2 - fit.chi2 < fit.limit:
            found.append((values, chi2))
    return found[:2]


def _of_rival(fit: Fit, values: np.ndarray, chi2: float) -> str:
    """Another answer, and which measurement would tell it from the fit's."""
    other = ", ".join(f"{n} {v:.4g} {u}" for n, v, u in zip(fit.parameters, values, fit.units, strict=True))
    row, apart = optimal_design.telling(fit, values)
    advice = f"measure {optimal_design.in_words(row)}, where they differ by {apart:.2g} sigma"
    if apart < TOLD_APART:
        advice = "no load and phase like those measured tells them apart"
    return f"another answer fits nearly as well: {other} (χ² {chi2:.3g}, here {fit.chi2:.3g}): {advice}"
