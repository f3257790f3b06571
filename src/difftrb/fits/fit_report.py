"""What `difftrb fit` does, and what it says to people of a fit, its posterior and how many spalls rows need.

What it says to machines is `fit_record`, what it draws `fit_figure`."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from difftrb.core import status
from difftrb.fits import bearing_uncertainty, measured, measured_table, spall_count, undetermined
from difftrb.fits import parameters as fit_parameters
from difftrb.fits.conditions import Condition, row_conditions
from difftrb.fits.fit_figure import PERCENT, corner, fit_panels
from difftrb.fits.fit_problem import prepare_fit
from difftrb.fits.fit_record import count_json, fit_json, posterior_json
from difftrb.fits.fit_result import Fit
from difftrb.fits.fitting import fit
from difftrb.fits.least_squares import STEPS
from difftrb.fits.measured import Measurement, so_many
from difftrb.fits.optimal_design import Suggestion, in_words, next_measurements
from difftrb.fits.posterior import Posterior, posterior
from difftrb.fits.spall_count import SpallCount, count_spalls
from difftrb.report import console, law_text, remarks, tables
from difftrb.ring import effect_base
from difftrb.ring.effects import Raceways
from difftrb.ring.load import Load, largest_load
from difftrb.scene import scene_file
from difftrb.scene.file_schema import SceneFile

LIKELY = f"{PERCENT} interval"
LEFT = "± by the bearing"
UNFINISHED = (
    f"least squares were still coming down after {STEPS} steps, so a better answer may lie beyond this one: fit fewer "
    "parameters, or measure more"
)
"""Of a fit that was stopped: what it has found is shown all the same."""
HELD = "length", "width", "angle"
"""What a spall's other sizes hang on, where it is not fitted."""


def deliver(options: Any, file: SceneFile, path: str) -> int:
    """Fit what `options` name to their measurements, print it and write it where they ask; the exit code."""
    rows, names, counts = _checked(options, file, path)
    started = time.perf_counter()
    with console.bar("solving contacts for the roller law") as progress:
        scene = prepare_fit(file.scene(), rows, progress)
    console.say_picked(scene)
    with console.bar("fitting; the first time its program is compiled") as progress:
        result = fit(scene, rows, names, options.robust, progress=progress)
    with console.busy("looking for what to measure next"):
        suggestions = next_measurements(result) if bool(result.converged) and result.reliable else ()
    record = fit_json(result, suggestions, time.perf_counter() - started)
    texts, figures, about = [], [("fit", lambda: fit_panels(result))], None
    if file.catalogue is not None and bool(result.converged):
        with console.busy("asking other bearings of this catalogue line"):
            about = file.catalogue.uncertainty(bearing_uncertainty.moves(result))
        record["left_by_catalogue"] = tables.plain(dict(zip(result.parameters, about, strict=True)))
        texts.append(Text(f"note: {bearing_uncertainty.sentence(result, about)}"))  # not to be overlooked
    texts.append(fit_text(result, suggestions, about))
    if options.posterior and bool(result.converged):
        with console.bar("sampling the posterior") as progress:
            drawn = posterior(result, progress=progress)
        record["posterior"] = tables.plain(posterior_json(drawn))
        texts.append(posterior_text(drawn))
        figures.append(("posterior", lambda: corner(drawn, dict(zip(result.parameters, result.values, strict=True)))))
    if counts is not None:
        with console.bar("counting spalls") as progress:
            counted = count_spalls(scene, rows, counts, names, progress=progress)
        record["spalls"] = tables.plain(count_json(counted))
        texts.append(count_text(counted))
    if int(result.status_code) == status.NOT_CONVERGED:
        path, record["status"] = options.measured, UNFINISHED
        if not options.json:
            console.show(Group(*texts))
    code = console.deliver(
        options, path, record, lambda: Group(*texts), lambda: ((name, drawn()) for name, drawn in figures)
    )
    if code == console.EXIT_OK and not result.reliable:
        what = "something explains the data much better" if result.explained else "the model does not explain the data"
        return console.refuse(f"{options.measured}: {what}: see the remarks", console.EXIT_NO_SOLUTION)
    return code


def _checked(options: Any, file: SceneFile, path: str) -> tuple[tuple[Measurement, ...], list[str], list[int] | None]:
    """Rows, names of parameters, numbers of spalls: what is wrong with them is said before anything is solved."""
    scene_file.check_ring(file, path)
    rows = measured_table.load_measured(options.measured)
    light = remarks.odd_measured_load(file.bearing, rows)
    if light is not None and remarks.all_in_kn(file.bearing, rows):
        raise measured.MeasuredError(f"{options.measured}: {light}: name the columns radial [kN] and axial [kN]")
    console.remark(options.measured, light)
    names = [name.strip() for name in options.parameters.split(",")]
    fit_parameters.named(names)
    measured.check_loads(file.scene(), rows)
    counts = None if options.spalls is None else _counts(options.spalls)
    if counts is not None:
        spall_count.check(file.scene(), rows, counts, names)
    return rows, names, counts


def _counts(text: str) -> list[int]:
    """Numbers of spalls, as 0,1,2."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise measured.MeasuredError(f"--spalls {text}: give numbers of spalls, say 0,1,2") from None


def fit_text(fit: Fit, suggestions: tuple[Suggestion, ...], by_catalogue: np.ndarray | None = None) -> RenderableType:
    """A fit for people: parameters, remarks, rows, and what to measure next; with what a bearing that was estimated
    from its catalogue leaves of the parameters (k = 2), shape (parameters,)."""
    table = _table_of_parameters(fit, by_catalogue)
    return Group(table, _table_of_rows(fit), *(Text(line) for line in _lines(fit, suggestions)))


def _table_of_parameters(fit: Fit, by_catalogue: np.ndarray | None) -> Table:
    left = () if by_catalogue is None else (LEFT,)
    headings = "", "value", "standard error", LIKELY, *left, "unit", "determined"
    table = tables.house_table("Fitted to the measurements", *headings, words=("", "unit", "determined"))
    for i, name in enumerate(fit.parameters):
        known, more = "yes" if fit.determined_each[i] else "no, see below", []
        if by_catalogue is not None:
            more = [tables.number(by_catalogue[i] if fit.determined_each[i] else np.nan, ".2g")]
            within = np.ptp(fit.intervals[i])
            known = "by the rows, not by the bearing" if known == "yes" and 2.0 * by_catalogue[i] > within else known
        values = f"{fit.values[i]:.4g}", tables.number(fit.standard_errors[i], ".2g"), fit.interval_in_words(i)
        table.add_row(name, *values, *more, fit.units[i], known)
    return table


def _table_of_rows(fit: Fit) -> Table:
    rows = tables.house_table("Measurements")
    for heading in ("row", "quantity", "radial [N]", "axial [N]", "phase", "measured", "model", "off [sigma]"):
        words = heading == "quantity"
        rows.add_column(heading, justify="left" if words else "right", no_wrap=heading in ("measured", "model"),
                        min_width=len(heading) if words else None)  # fmt: skip
    for k, row in enumerate(fit.rows):
        off = round(float(fit.residuals[k]), 2) + 0.0  # no -0
        quantity = row.quantity.removesuffix("_stiffness").replace("_", " ")  # the unit says what it is
        rows.add_row(
            str(k + 1), f"{quantity} [{row.unit}]", f"{row.radial:g}", f"{row.axial:g}",
            _phase(row.phase), _amount(row.value), _amount(fit.predicted[k]), f"{off:+.2f}",
        )  # fmt: skip
    return rows


def _lines(fit: Fit, suggestions: tuple[Suggestion, ...]) -> list[str]:
    """What is to say beside the tables: remarks, what to measure next, what the fit rests on."""
    lines = [*fit.remarks]
    if fit.alternatives and not undetermined.by_too_few_rows(fit):
        lines.insert(0, "other answers are possible, see below; intervals hold those that fit as well, standard errors "
                     "are of the one in the table alone")  # fmt: skip
    if len(fit.parameters) > 1 and fit.freedom >= 0:  # else it is none of the data
        pairs = [
            f"{a} and {b} {fit.correlation[i, j]:+.2f}"
            for i, a in enumerate(fit.parameters)
            for j, b in enumerate(fit.parameters[:i])
        ]
        lines.append(f"correlation of {', '.join(pairs)}")
    for s in suggestions:
        errors = ", ".join(f"{name} {tables.number(error, '.2g')}" for name, error in s.errors.items())
        again = " once more" if any(_is_same(s.row, row, fit) for row in fit.rows) else ""
        first = "next" if s is suggestions[0] else "and then"
        lines.append(f"{first}: measure {in_words(s.row)}{again} (standard errors then: {errors})")
    sizes = [fit_parameters.PARAMETERS[name] for name in HELD if name not in fit.parameters]
    held = [size.in_words(size.start(fit.scene), 4) for size in sizes]
    if held:
        lines.append(f"held as in the scene: {', '.join(held)}; what is fitted holds for that alone")
    if effect_base.among(fit.scene.effects, Raceways) is None:
        heaviest = max(float(largest_load(fit.scene.bearing, Load(row.radial, row.axial))) for row in fit.rows)
        lines.append(
            "the model is the contacts with the outer raceway alone, as in the paper; of a real bearing, in which both "
            f"raceways give way, a spall takes about {law_text.outer_share(fit.scene, heaviest):.2f} of that: name "
            "effects.raceways for rows that were measured"
        )
    misfit = f"; χ² = {fit.chi2:.3g} of {so_many(fit.freedom, 'degree')} of freedom" if fit.freedom > 0 else ""
    lines.append(f"{fit.status}{misfit}")
    return lines


def _is_same(one: Measurement, row: Measurement, fit: Fit) -> bool:
    """Whether a measurement that may be made is a row that was measured."""
    _, (first, *second) = row_conditions(fit.scene, (one, row))  # one, if they are equal
    return one.quantity == row.quantity and all(_near(first, other) for other in second)


def _near(one: Condition, other: Condition) -> bool:
    """Conditions that differ by rounding alone."""
    if (one.phase is None) != (other.phase is None) or one.definition != other.definition:
        return False
    pairs = ((one.radial, other.radial), (one.axial, other.axial), (one.phase or 0.0, other.phase or 0.0))
    return all(math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-6) for a, b in pairs)


def _amount(value: float) -> str:
    """Five digits, in full; rounding's remains are 0."""
    if abs(value) < 1e-9:
        return "0"
    return f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.5g}"


def _phase(phase: Any) -> str:
    return "scene's" if phase is None else phase if isinstance(phase, str) else f"{phase:.4g}"


def posterior_text(posterior: Posterior) -> RenderableType:
    """A table of its parameters."""
    title = f"Posterior, log evidence {posterior.log_evidence:.2f} ± {posterior.error:.2f}"
    table = tables.house_table(title, "", "mean", "standard deviation", LIKELY, "unit")
    parts = zip(posterior.parameters, posterior.units, posterior.values.T, posterior.intervals(), strict=True)
    for name, unit, own, (low, high) in parts:
        table.add_row(name, f"{np.mean(own):.4g}", f"{np.std(own):.2g}", f"{low:.4g} … {high:.4g}", unit)
    return table


def count_text(counted: SpallCount) -> RenderableType:
    """A table of what speaks for each number of spalls."""
    table = tables.house_table("How many spalls", "spalls", "log evidence", "probability")
    parts = zip(counted.counts, counted.log_evidences, counted.errors, counted.shares, strict=True)
    for count, value, error, share in parts:
        table.add_row(str(count), f"{value:.2f} ± {error:.2f}", f"{100.0 * share:.3g} %")
    return table
