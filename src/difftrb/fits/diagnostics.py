"""What is worth saying about a fit, in sentences: what the data leave open, and what in them looks wrong."""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.fits import intervals, optimal_design
from difftrb.fits.fit_result import Fit
from difftrb.fits.intervals import EDGE
from difftrb.ring import effects

WIDE = 1.5
"""An interval whose ends differ by more than this factor does not determine a size."""
WIDE_PLACE = {"angle": 0.5, "axial_offset": 1.0, "preload": np.inf}
"""The same for the difference of the ends [rad], [mm], [N] of what is no size; with both ends open none is narrow."""
UNLIKELY = 1e-3
"""Chance of a χ² below which data and model are said to contradict each other."""
FAR = 4.0
"""Deviation [sigma] at which one row is named."""
REPEAT = 4.0
"""Difference [sigma] between two rows that ought to agree at which both are named."""
TOLD_APART = 2.0
"""Difference [sigma] of two answers below which a measurement does not tell which one is right."""


def of(fit: Fit, starts: np.ndarray) -> dict[str, Any]:
    """`remarks` and `determined` of a fit; `starts` is what the model says of the rows at all starts, shape (starts,
    rows)."""
    scene = fit.scene
    unclear = [i for i in range(len(fit.parameters)) if _is_open(fit, i)]
    said = [
        *effects.remarks(scene.effects, scene.spalls),
        *_about_rows(fit),
        *_about_misfit(fit),
        *_beyond(fit, starts),
        *_bounds(fit),
    ]
    if unclear:
        said.append(_unclear(fit, unclear))
    rivals = [] if unclear else _rivals(fit)
    said += [_of_rival(fit, values, chi2) for values, chi2 in rivals]
    if fit.sigma_estimated:
        kind = "losses" if all(row.is_loss for row in fit.rows) else "values"
        middle = 100.0 * float(np.median(fit.sigma / np.array([abs(float(row.value)) or 1.0 for row in fit.rows])))
        said.append(f"no sigma was given: from how the fit misses the {kind} it is estimated as {middle:.2g} % of them")
    return {"remarks": tuple(said), "determined": not unclear and not rivals}


def _is_open(fit: Fit, i: int) -> bool:
    low, high = fit.intervals[i]
    if (widest := WIDE_PLACE.get(fit.parameters[i])) is not None:
        return bool(fit.open[i].all()) or high - low > widest
    return bool(high / low > WIDE)


def _about_rows(fit: Fit) -> list[str]:
    """What the measurements alone show."""
    said = []
    by_kind: dict[tuple, list[int]] = {}
    for k, row in enumerate(fit.rows):
        if row.is_loss and row.value < -3.0 * fit.sigma[k]:
            said.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} % is below zero by more than its error: a spall cannot "
                "stiffen a bearing; check the sign (a loss is positive) and which of the two is the healthy bearing"
            )
        by_kind.setdefault((row.radial, row.axial, row.quantity, row.definition, row.phase), []).append(k)
    for same in by_kind.values():
        values = np.array([fit.rows[k].value for k in same])
        low, high = same[int(np.argmin(values))], same[int(np.argmax(values))]
        apart = (fit.rows[high].value - fit.rows[low].value) / np.hypot(fit.sigma[low], fit.sigma[high])
        if apart > REPEAT:
            said.append(
                f"rows {low + 1} and {high + 1} measure the same and differ by {apart:.1f} sigma: one of them is "
                "wrong, or sigma is too small"
            )
    for quantity in sorted({row.quantity for row in fit.rows}):
        rows = [k for k, row in enumerate(fit.rows) if row.quantity == quantity]
        told = fit.predicted[rows]
        constant = len(rows) > 2 and len({float(fit.rows[k].value) for k in rows}) == 1
        if constant and np.ptp(told) > 3.0 * float(np.median(fit.sigma[rows])):
            said.append(
                f"all {len(rows)} values of {quantity} are {fit.rows[rows[0]].value:g} although they were measured "
                "under different conditions: check that the column was filled in"
            )
    return said


def _about_misfit(fit: Fit) -> list[str]:
    """Whether the model meets the data as well as sigma promises."""
    said = []
    if not fit.sigma_estimated and fit.freedom > 0 and fit.robust == "squares":
        chance = intervals.tail(fit.chi2, fit.freedom)
        if chance < UNLIKELY:
            worst = int(np.argmax(np.abs(fit.residuals)))
            times = float(np.sqrt(fit.chi2 / fit.freedom))
            said.append(
                f"the fit misses the data by {times:.1f} times their sigma (χ² = {fit.chi2:.3g} of {fit.freedom} "
                f"degrees of freedom), worst in row {worst + 1} ({fit.residuals[worst]:+.1f} sigma): sigma is too "
                "small, rows contradict each other, or the model lacks something (scale, preload, crown); intervals "
                "are too narrow"
            )
    for k, off in enumerate(fit.residuals):
        if abs(off) > FAR and fit.robust != "squares":
            said.append(f"row {k + 1} stands {off:+.1f} sigma from the fit and counts for little")
    return said


def _beyond(fit: Fit, starts: np.ndarray) -> list[str]:
    """Values that no spall of the ranges makes."""
    told = np.maximum(np.nanmax(starts, axis=0), fit.predicted)
    said = []
    for k, row in enumerate(fit.rows):
        if row.is_loss and row.value > told[k] + 3.0 * fit.sigma[k]:
            said.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} % is more than the model can give: at most "
                f"{told[k]:.3g} % in the ranges searched; check the unit (percent), and that nothing but the spall "
                "differs"
            )
        if not row.is_loss and not 0.2 < row.value / fit.predicted[k] < 5.0:
            said.append(
                f"row {k + 1}: {row.quantity} = {row.value:g} N/mm is {row.value / fit.predicted[k]:.2g} times what "
                "the model gives: check the unit (N/mm, not N/µm)"
            )
    return said


def _bounds(fit: Fit) -> list[str]:
    said = []
    for i, name in enumerate(fit.parameters):
        if abs(fit.place[i]) >= EDGE:
            side = "largest" if fit.place[i] > 0.0 else "smallest"
            said.append(f"{name} ends at the {side} value that is searched, {fit.values[i]:.4g} {fit.units[i]}")
    return said


def _unclear(fit: Fit, unclear: list[int]) -> str:
    """What the data do not determine, what they do, and what to measure."""
    names = [fit.parameters[i] for i in unclear]
    each = [
        f"{name} is not ({fit.intervals[i][0]:.3g} … {fit.intervals[i][1]:.3g} {fit.units[i]} fit as well)"
        for i, name in zip(unclear, names, strict=True)
    ]
    suggestion = optimal_design.next_measurements(fit, count=1, parameter=names[0])[0]
    advice = f"measure {optimal_design.in_words(suggestion.row)}"
    sizes = [i for i, name in enumerate(fit.parameters) if name in ("length", "width", "depth", "scale")
             and abs(fit.place[i]) < EDGE]  # fmt: skip
    if len(sizes) > 1:
        slope = intervals.natural_slope(fit.problem, fit.place)
        covariance = (intervals.covariance(fit.normal, fit.place) * np.outer(slope, slope))[np.ix_(sizes, sizes)]
        best = intervals.best_determined(tuple(fit.parameters[i] for i in sizes), covariance)
        percent = 100.0 * best.error * float(np.sqrt(fit.limit))
        if percent < 30.0:
            return f"{_product(best.powers)} is determined to {percent:.2g} %, {' and '.join(each)}: {advice}"
    return f"{' and '.join(each)[:1].upper()}{' and '.join(each)[1:]}: {advice}"


def _product(powers: dict[str, float]) -> str:
    """A product of powers in words; factors that hardly count are left out."""
    factors = []
    for name, power in sorted(powers.items(), key=lambda pair: -abs(pair[1])):
        if abs(power) > 0.15:
            factors.append(name if abs(power - 1.0) < 0.1 else f"{name}^{power:.1f}")
    return " × ".join(factors)


def _rivals(fit: Fit) -> list[tuple[np.ndarray, float]]:
    """Other places that fit as well, apart from the best one's interval, the best two of them, and their χ²."""
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
    """What it is, and which measurement tells it from the fit."""
    other = ", ".join(f"{n} {v:.4g} {u}" for n, v, u in zip(fit.parameters, values, fit.units, strict=True))
    row, apart = optimal_design.telling(fit, values)
    advice = f"measure {optimal_design.in_words(row)}, where they differ by {apart:.2g} sigma"
    if apart < TOLD_APART:
        advice = "no load and phase like those measured tells them apart"
    return f"another answer fits nearly as well: {other} (χ² {chi2:.3g}, here {fit.chi2:.3g}): {advice}"
