"""Remarks on a fit, in sentences: what the data leave open, and what in them looks wrong."""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.fits import (
    batched_misfit,
    conditions,
    fit_result,
    optimal_design,
    predicted,
    profile_intervals,
    search,
    suspects,
)
from difftrb.fits.fit_result import UNLIKELY, Alternative, Fit
from difftrb.fits.least_squares import AT_BOUND, at_shares
from difftrb.fits.measured import Measurement, so_many
from difftrb.fits.parameters import OfSpall
from difftrb.fits.profile_intervals import CONFIDENCE
from difftrb.fits.search import Scan
from difftrb.ring import effects

FAR = 4.0
"""Deviation [sigma] at which one row is named."""
REPEAT = 4.0
"""Difference [sigma] between two rows of the same condition at which both are named."""
TOLD_APART = 2.0
"""Difference [sigma] of two answers' predictions below which a measurement does not decide between them."""
HEALTHY = 0.05
"""Chance of what a spall gains over none, above which none is needed."""
TIMES = " × "
MANY = 3
"""Parameters whose range is scanned closely enough to find the answer."""
NEAR_END = 0.1
"""Share of a range within which a value is at its end."""
ALIKE = 0.05
"""By how much an answer's weight has to be more than another's for it to be called likelier."""
MOST_SHOWN = 3
"""Most other answers that are described."""


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
    unclear = np.array([_is_open(fit, i) for i in range(len(fit.parameters))])
    beyond = [fit.parameters[i] for i in _out_of_range(fit)]
    if beyond:
        names = " and ".join(beyond)
        remarks.append(
            f"{names} may lie beyond the range that is searched, and all others would move: nothing is determined"
        )
    healthy = _no_spall_needed(fit)
    if healthy:
        remarks.append(healthy)
    elif unclear.any():
        remarks.append(_undetermined(fit, np.nonzero(unclear)[0].tolist()))
    remarks += _of_alternatives(fit)
    if len(fit.alternatives) > MOST_SHOWN:
        more = len(fit.alternatives) - MOST_SHOWN
        remarks.append(f"{more} more answers are not ruled out" if more > 1 else "one more answer is not ruled out")
    if len(fit.parameters) > MANY and fit.explained:
        remarks.append(
            f"the range of more than {MANY} parameters is scanned thinly: an answer that fits as well may be missed; "
            f"difftrb.fit(…, starts={4 * search.scan_size(len(fit.parameters))}) looks closer"
        )
    if fit.freedom <= 0:
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
        clear &= ~fit_result.outside(other.values, fit.values, fit.own_intervals)
    return {"remarks": tuple(remarks), "doubts": doubts, "determined_each": clear}


def _is_open(fit: Fit, i: int) -> bool:
    (low, high), beyond, parameter = fit.own_intervals[i], fit.own_open[i], fit.problem.parameters[i]
    if _held_by(fit, i):
        return True
    if parameter.logarithmic:
        return bool(beyond.any()) or bool(high / low > parameter.wide)
    return bool(beyond.all() | (beyond & ~np.array(parameter.natural)).any()) or high - low > parameter.wide


def _out_of_range(fit: Fit) -> list[int]:
    """What of the bearing and its loads, not of spalls, may lie beyond the range that is searched."""
    every = enumerate(fit.problem.parameters)
    return [i for i, one in every if not isinstance(one, OfSpall) and _at_searched_end(fit, i, fit.point)]


def _held_by(fit: Fit, i: int) -> list[int]:
    """Which other sizes of spalls, at the end of the range that is searched and not of what the data allow, end the
    interval of this one: beyond, it would go on."""
    ends = fit.profiles.at_ends[i]
    sizes = [j for j, one in enumerate(fit.problem.parameters) if isinstance(one, OfSpall) and one.logarithmic]
    return [j for j in sizes if i in sizes and j != i and any(_at_searched_end(fit, j, point) for point in ends)]


def _at_searched_end(fit: Fit, j: int, point: np.ndarray) -> bool:
    """Whether the interval of a parameter is open at an end of its range that is not nature's, and a point, shape
    (parameters,), within `NEAR_END` of that."""
    far, natural = float(at_shares(np.array(1.0 - NEAR_END))), np.array(fit.problem.parameters[j].natural)
    return bool((np.array([point[j] < -far, point[j] > far]) & fit.own_open[j] & ~natural).any())


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


def _undetermined(fit: Fit, unclear: list[int]) -> str:
    """Which parameters the data leave open, which product of sizes they determine, and what to measure."""
    names = [fit.parameters[i] for i in unclear]
    ranges = [_fits_as_well(fit, i) for i in unclear]

    def each_with(words: str) -> str:
        return " and ".join(f"{name} {words} {own}" for name, own in zip(names, ranges, strict=True))

    suggestion = optimal_design.next_measurements(fit, count=1, parameter=names[0])[0]
    advice = f"measure {optimal_design.in_words(suggestion.row)}"
    sizes = [i for i, parameter in enumerate(fit.problem.parameters)
             if parameter.logarithmic and parameter.in_products and abs(fit.point[i]) < AT_BOUND]  # fmt: skip
    if len(sizes) > 1:
        powers, error = _best_determined(fit, sizes)
        percent = 100.0 * error * float(np.sqrt(fit.limit))
        product = _product(powers)
        if percent < 30.0 and TIMES in product:  # one alone is said to be open or is known
            return f"near this answer {product} is determined to {percent:.2g} %, {each_with('is not')}: {advice}"
    open_ones = each_with("is not determined")
    return f"{open_ones[:1].upper()}{open_ones[1:]}: {advice}"


def _fits_as_well(fit: Fit, i: int) -> str:
    """An interval in brackets: what lies beyond an end of the range that is searched may fit, too."""
    period = fit.problem.parameters[i].period
    (low, high), (no_low, no_high) = fit.own_intervals[i], fit.own_open[i]
    unit = f" {fit.units[i]}".removesuffix(" –")
    if period is not None and high - low >= period:
        return "(any value fits as well)"
    if no_low != no_high:
        return f"({low:.3g}{unit} and more)" if no_high else f"({high:.3g}{unit} and less)"
    held = " and ".join(fit.parameters[j] for j in _held_by(fit, i))
    within = f" with {held} in the range that is searched" if held else ""
    return f"({low:.3g} … {high:.3g}{unit} fit as well{within})"


def _best_determined(fit: Fit, sizes: list[int]) -> tuple[dict[str, float], float]:
    """The product of powers of these parameters that is known best: exponents by name, standard error of its
    logarithm."""
    slope = fit.problem.bounds.slope(fit.point)
    covariance = (profile_intervals.covariance(fit.normal, fit.point) * np.outer(slope, slope))[np.ix_(sizes, sizes)]
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
    return TIMES.join(factors)


def _of_alternatives(fit: Fit) -> list[str]:
    """The first other answers, and which measurement would tell each from the fit's."""
    shown = sorted(fit.alternatives, key=lambda other: -other.weight)[:MOST_SHOWN]
    if not shown:
        return []
    telling = optimal_design.telling(fit, np.array([other.values for other in shown]))
    return [_of_alternative(fit, other, *best) for other, best in zip(shown, telling, strict=True)]


def _percent(share: float) -> str:
    return f"{100.0 * share:.{0 if share > 0.1 else 1}f} %" if share > 1e-3 else "below 0.1 %"


def _chi2(value: float) -> str:
    """To three digits; what is met exactly but for rounding, 0."""
    return f"{value:.3g}" if value > 1e-6 else "0"


def _of_alternative(fit: Fit, other: Alternative, row: Measurement, apart: float) -> str:
    answer = ", ".join(p.in_words(v, 4) for p, v in zip(fit.problem.parameters, other.values, strict=True))
    advice = f"measure {optimal_design.in_words(row)}, where they differ by {apart:.2g} sigma"
    if apart < TOLD_APART:
        advice = "no load and phase like those measured tells them apart"
    # limits grow with the misfit of a fit: others may not pass, and where none passes none fits well
    missed = fit.robust == "squares" and fit_result.tail(other.chi2, fit.freedom) < UNLIKELY
    near = other.chi2 - fit.chi2 <= fit.limit and not missed
    how = "fits nearly as well" if near else "is not ruled out"
    if not missed and other.weight > 1.0 - sum(each.weight for each in fit.alternatives) + ALIKE:
        how += ", over a wider range, and is likelier than the one in the table"
    return (
        f"another answer {how}: {answer} (χ² {_chi2(other.chi2)}, here {_chi2(fit.chi2)}; weight "
        f"{_percent(other.weight)}): {advice}"
    )
