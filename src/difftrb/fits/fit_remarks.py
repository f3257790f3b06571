"""Remarks on a fit, in sentences: what in the data looks wrong, and what they leave open (`undetermined`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.fits import (
    batched_misfit,
    conditions,
    fit_result,
    predicted,
    search,
    suspects,
    undetermined,
)
from difftrb.fits.fit_result import Fit
from difftrb.fits.least_squares import AT_BOUND
from difftrb.fits.measured import so_many
from difftrb.fits.profile_intervals import CONFIDENCE
from difftrb.fits.search import Scan
from difftrb.ring import effects

FAR = 4.0
"""Deviation [sigma] at which one row is named."""
REPEAT = 4.0
"""Difference [sigma] between two rows of the same condition at which both are named."""
HEALTHY = 0.05
"""Chance of what a spall gains over none, above which none is needed."""
MANY = 3
"""Parameters whose range is scanned closely enough to find the answer."""


def judged(fit: Fit, scan: Scan) -> dict[str, Any]:
    """Fields `remarks`, `doubts` and `determined_each` of a fit."""
    remarks = [
        *effects.remarks(fit.scene.effects, fit.scene.spalls),
        *_about_rows(fit),
        *_about_misfit(fit),
        *_beyond_the_model(fit, np.nanmax(scan.predicted, axis=0)),
        *_at_bounds(fit),
    ]
    wrong = suspects.named(fit, scan) if suspects.wanted(fit) else []
    doubts = tuple(_of_suspect(fit, one) for one in wrong)
    remarks += doubts
    unclear = np.array([undetermined.is_open(fit, i) for i in range(len(fit.parameters))])
    beyond = [fit.parameters[i] for i in undetermined.out_of_range(fit)]
    if beyond:
        names = " and ".join(beyond)
        remarks.append(
            f"{names} may lie beyond the range that is searched, and all others would move: nothing is determined"
        )
    healthy = _no_spall_needed(fit)
    too_few = undetermined.by_too_few_rows(fit) and not healthy
    if healthy:
        remarks.append(healthy)
    elif too_few:
        remarks.append(undetermined.of_too_few_rows(fit))
    elif unclear.any():
        remarks.append(undetermined.sentence(fit, np.nonzero(unclear)[0].tolist()))
    remarks += [] if too_few else undetermined.of_alternatives(fit)
    if len(fit.parameters) > MANY and fit.explained and not too_few:
        remarks.append(
            f"the range of more than {MANY} parameters is scanned thinly: an answer that fits as well may be missed; "
            f"difftrb.fit(…, starts={4 * search.scan_size(len(fit.parameters))}) looks closer"
        )
    if fit.freedom <= 0 and not too_few:
        remarks.append("there are no more rows than parameters, so none checks the fit")
    if fit.sigma_estimated:
        kind = "losses" if all(row.is_loss for row in fit.rows) else "values"
        middle = 100.0 * float(np.median(fit.sigma / np.array([abs(float(row.value)) or 1.0 for row in fit.rows])))
        remarks.append(
            f"no sigma was given: from how the fit misses the {kind} it is estimated as {middle:.2g} % of them"
        )
    whole = np.array([len(own) == 1 for own in fit.pieces])
    clear = whole & ~unclear & fit.explained & (not wrong) & (not healthy) & (not beyond)
    for other in fit.alternatives:
        clear &= ~fit_result.outside(fit.problem.parameters, other.values, fit.values, fit.own_intervals)
    return {"remarks": tuple(remarks), "doubts": doubts, "determined_each": clear}


def _about_rows(fit: Fit) -> list[str]:
    """What is odd about the measurements alone."""
    found = []
    by_kind: dict[tuple, list[int]] = {}
    numbers, _ = conditions.row_conditions(fit.scene, fit.rows)
    for k, row in enumerate(fit.rows):
        if row.is_loss and row.value < -3.0 * fit.sigma[k] and abs(fit.residuals[k]) > FAR:
            found.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} % is below zero by more than its error: a spall cannot "
                "stiffen a bearing; check the sign (a loss is positive) and which of the two is the healthy bearing"
            )
        by_kind.setdefault((numbers[k], row.quantity), []).append(k)
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
    if not fit.explained:
        worst = int(np.argmax(np.abs(fit.residuals)))
        chi2, freedom = fit.misfit
        times = float(np.sqrt(chi2 / freedom))
        rows = "" if fit.robust == "squares" else " even in the two thirds of the rows that it meets best"
        of = (
            f"of {so_many(freedom, 'degree')} of freedom"
            if fit.freedom > 0
            else "where so many parameters could meet every row"
        )
        common = 100.0 * float(fit.problem.common) if fit.robust == "squares" else 0.0
        expected, unit = "their sigma", "sigma"
        if common > 0.0:  # it counts in χ², in no row's own deviation
            expected = f"what sigma and an error of {common:.2g} % that the model may have in all rows let expect"
            unit = "of its own sigma alone"
        missed = ", or the search has missed the best of so many parameters" if len(fit.parameters) > MANY else ""
        found.append(
            f"the fit misses the data{rows} by {times:.1f} times {expected} (χ² = {chi2:.3g} {of}), "
            f"worst in row {worst + 1} ({fit.residuals[worst]:+.1f} {unit}): sigma is too small, rows "
            f"contradict each other, or the model lacks something{missed}; do not rely on the sizes"
        )
    for k, off in enumerate(fit.residuals):
        if abs(off) > FAR and fit.robust != "squares":
            found.append(f"row {k + 1} stands {off:+.1f} sigma from the fit and counts for little")
    return found


def _of_suspect(fit: Fit, suspect: suspects.Suspect) -> str:
    """What may be wrong, and what to do."""
    how = f"explains the data (χ² {suspect.chi2:.3g}" if suspect.explains else f"explains more (χ² {suspect.chi2:.3g}"
    return f"perhaps {suspect.what}: that {how}, here {fit.chi2:.3g}), with {suspect.answer}: {suspect.advice}"


def _no_spall_needed(fit: Fit) -> str:
    """That no spall is needed, if none is."""
    losses = np.array([row.is_loss for row in fit.rows])
    if (fit.problem.healthy is None and not losses.all()) or not fit.explained:
        return ""
    chi2 = 2.0 * float(batched_misfit.costs(fit.problem, predicted.healthy_rows(fit.problem)[None])[0])
    by_one = fit_result.tail(max(chi2 - fit.chi2, 0.0), len(fit.parameters))
    # as many answers, as many chances that noise looks like one
    if 1.0 - (1.0 - by_one) ** (1 + len(fit.alternatives)) < HEALTHY or not np.isfinite(chi2):
        return ""
    limits = [
        f"{name} < {fit.intervals[i][1]:.3g} {fit.units[i]}"
        for i, name in enumerate(fit.parameters)
        if fit.problem.parameters[i].logarithmic and not fit.open[i][1]
    ]
    known = "; nor do the data limit its size"
    if limits:
        at_phases = len(conditions.phases(fit.problem.conditions)) > 0
        which = "one that a roller was over when it was measured" if at_phases else "one"
        known = f"; {100.0 * CONFIDENCE:g} % limits of {which}: {', '.join(limits)}"
    return f"no spall is needed: the healthy bearing fits as well (χ² {chi2:.3g}, here {fit.chi2:.3g}){known}"


def _beyond_the_model(fit: Fit, most: np.ndarray) -> list[str]:
    """Measured values that no spall within the ranges gives; `most` is given at the points scanned, shape (rows,)."""
    most = np.maximum(most, fit.predicted)
    found = []
    for k, row in enumerate(fit.rows):
        if row.is_loss and row.value > most[k] + 3.0 * fit.sigma[k]:
            found.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} % is more than the model can give: at most "
                f"{most[k]:.3g} % in the ranges searched; check the unit (percent), and that nothing but the spall "
                "differs"
            )
        if not row.is_loss and not row.is_coupling and not 0.2 < row.value / fit.predicted[k] < 5.0:
            times = row.value / fit.predicted[k]
            factor, other = (f"{times:.0f}" if times > 10.0 else f"{times:.2g}"), "N/m" if times > 1.0 else "N/µm"
            found.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} N/mm is {factor} times what the model gives: check the "
                f"unit (N/mm, not {other})"
            )
    return found


def _at_bounds(fit: Fit) -> list[str]:
    found = []
    for i, name in enumerate(fit.parameters):
        if abs(fit.point[i]) >= AT_BOUND:
            side = "largest" if fit.point[i] > 0.0 else "smallest"
            value = fit.problem.parameters[i].in_words(fit.values[i], 4).removeprefix(f"{name} ")
            found.append(f"{name} ends at the {side} value that is searched, {value}")
    return found
