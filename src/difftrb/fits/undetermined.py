"""What measurements leave open, in sentences: parameters, what product of them is known, other answers."""

from __future__ import annotations

import numpy as np

from difftrb.fits import fit_result, optimal_design, profile_intervals
from difftrb.fits.fit_result import UNLIKELY, Alternative, Fit
from difftrb.fits.least_squares import AT_BOUND, at_shares
from difftrb.fits.measured import Measurement, so_many
from difftrb.fits.parameters import OfSpall

TOLD_APART = 2.0
"""Difference [sigma] of two answers' predictions below which a measurement does not decide between them."""
TIMES = " × "
NEAR_END = 0.1
"""Share of a range within which a value is at its end."""
ALIKE = 0.05
"""By how much an answer's weight has to be more than another's for it to be called likelier."""
MOST_SHOWN = 3
"""Most other answers that are described."""


def is_open(fit: Fit, i: int) -> bool:
    """Whether the interval of the i-th parameter is too wide to determine it, or ends with the range alone."""
    (low, high), beyond, parameter = fit.own_intervals[i], fit.own_open[i], fit.problem.parameters[i]
    if _held_by(fit, i):
        return True
    if parameter.logarithmic:
        return bool(beyond.any()) or bool(high / low > parameter.wide)
    return bool(beyond.all() | (beyond & ~np.array(parameter.natural)).any()) or high - low > parameter.wide


def out_of_range(fit: Fit) -> list[int]:
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


def sentence(fit: Fit, unclear: list[int]) -> str:
    """Which parameters the data leave open, which product of sizes they determine, and what to measure."""
    names = [fit.parameters[i] for i in unclear]
    ranges = [_fits_as_well(fit, i) for i in unclear]

    def each_with(words: str) -> str:
        return " and ".join(f"{name} {words} {own}" for name, own in zip(names, ranges, strict=True))

    suggestion = optimal_design.next_measurements(fit, count=1, parameter=names[0])[0]
    advice = f"measure {optimal_design.in_words(suggestion.row)}"
    if known := _known_product(fit):
        return f"near this answer {known}, {each_with('is not')}: {advice}"
    open_ones = each_with("is not determined")
    return f"{open_ones[:1].upper()}{open_ones[1:]}: {advice}"


def by_too_few_rows(fit: Fit) -> bool:
    """Whether fewer rows than parameters are met, as they are by many answers."""
    return fit.freedom < 0 and fit.explained


def of_too_few_rows(fit: Fit) -> str:
    """What fewer rows than parameters tell, and what they do not."""
    known = _known_product(fit)
    known = f"near this answer {known}" if known else "only which of their values go together is known"
    return (
        f"{so_many(len(fit.rows), 'measured value')} cannot give {so_many(len(fit.values), 'parameter')}: {known}, and "
        f"the table shows one of many answers, which nothing checks; measure at least {1 - fit.freedom} more"
    )


def _known_product(fit: Fit) -> str:
    """Which product of sizes the data determine, and how well; nothing where none, or one size alone."""
    sizes = [i for i, parameter in enumerate(fit.problem.parameters)
             if parameter.logarithmic and parameter.in_products and abs(fit.point[i]) < AT_BOUND]  # fmt: skip
    if len(sizes) < 2:
        return ""
    powers, error = _best_determined(fit, sizes)
    percent, product = 100.0 * error * float(np.sqrt(fit.limit)), _product(powers)
    return f"{product} is determined to {percent:.2g} %" if percent < 30.0 and TIMES in product else ""


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


def of_alternatives(fit: Fit) -> list[str]:
    """The first other answers, which measurement would tell each from the fit's, and how many more there are."""
    shown = sorted(fit.alternatives, key=lambda other: -other.weight)[:MOST_SHOWN]
    if not shown:
        return []
    telling = optimal_design.telling(fit, np.array([other.values for other in shown]))
    found = [_of_alternative(fit, other, *best) for other, best in zip(shown, telling, strict=True)]
    more = len(fit.alternatives) - len(shown)
    if more:
        found.append("one more answer is not ruled out" if more == 1 else f"{more} more answers are not ruled out")
    return found


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
