"""What `difftrb fit` does, and a fit for people (text, figures) and for machines (JSON)."""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from rich.console import Group, RenderableType
from rich.text import Text

from difftrb.fits import measured
from difftrb.fits.fit_result import Fit
from difftrb.fits.fitting import fit, prepare_fit
from difftrb.fits.optimal_design import Suggestion, in_words, next_measurements
from difftrb.fits.profile_intervals import CONFIDENCE, EDGE, limit_of
from difftrb.report import console, remarks, run_text
from difftrb.report.figure_style import ACCENT, HEALTHY, SPALLED
from difftrb.scene import scene_file

WIDE = np.sqrt(limit_of(None))
"""Standard errors to either side of an interval of the normal distribution."""
PERCENT = f"{100.0 * CONFIDENCE:g} %"
LIKELY = f"{PERCENT} interval"


def deliver(options: Any, file: scene_file.SceneFile, path: str) -> int:
    """Fit what `options` name to their measurements, print it and write it where they ask; the exit code."""
    scene_file.check_ring(file, path)
    rows = measured.load_measured(options.measured)
    console.remark(remarks.light_measured_load(file.bearing, rows), options.measured)
    started = time.perf_counter()
    with console.bar("solving contacts for the roller law") as progress:
        scene = prepare_fit(file.scene(), rows, progress)
    console.say_picked(scene)
    with console.busy("fitting"):
        result = fit(scene, rows, [name.strip() for name in options.parameters.split(",")], options.robust)
        suggestions = next_measurements(result) if bool(result.converged) else ()
    record = fit_json(result, suggestions, time.perf_counter() - started)

    text = partial(fit_text, result, suggestions)
    code = console.deliver(options, path, record, text, lambda: [("fit", fit_panels(result))])
    if code == console.EXIT_OK and not result.explained:
        return console.refuse(
            f"{options.measured}: the model does not explain the data: see the remarks", console.EXIT_NO_SOLUTION
        )
    return code


def fit_json(fit: Fit, suggestions: tuple[Suggestion, ...], seconds: float) -> dict[str, Any]:
    """A fit with the keys of the command line's `--json`; numbers that do not exist are None."""
    parameters = {
        name: {
            "value": fit.values[i],
            "unit": fit.units[i],
            "standard_error": fit.standard_errors[i],
            "interval": fit.intervals[i],
            "open": fit.open[i],
            "determined": bool(fit.determined_each[i]),
        }
        for i, name in enumerate(fit.parameters)
    }
    rows = [
        {"quantity": row.quantity, "radial": row.radial, "axial": row.axial, "value": row.value, "unit": row.unit,
         "predicted": told, "sigma": sigma, "residual": off}
        for row, told, sigma, off in zip(fit.rows, fit.predicted, fit.sigma, fit.residuals, strict=True)
    ]  # fmt: skip
    return run_text.plain({
        "status": fit.status,
        "converged": bool(fit.converged),
        "parameters": parameters,
        "correlation": fit.correlation,
        "determined": fit.determined,
        "explained": fit.explained,
        "alternatives": [
            {"values": dict(zip(fit.parameters, other.values.tolist(), strict=True)), "chi2": other.chi2,
             "weight": other.weight}
            for other in fit.alternatives
        ],
        "remarks": fit.remarks,
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.freedom,
        "sigma_estimated": fit.sigma_estimated,
        "robust": fit.robust,
        "rows": rows,
        "next_measurements": [
            {"radial": s.row.radial, "axial": s.row.axial, "quantity": s.row.quantity, "phase": s.row.phase,
             "gain": s.gain, "standard_errors": s.errors}
            for s in suggestions
        ],
        "starts": [
            {"last": last, "chi2": chi2, "steps": int(steps)}
            for last, chi2, steps in zip(*fit.history, strict=True)
        ],
        "seconds": seconds,
    })  # fmt: skip


def fit_text(fit: Fit, suggestions: tuple[Suggestion, ...]) -> RenderableType:
    """A fit for people: parameters, remarks, rows, and what to measure next."""
    table = run_text.house_table("Fitted to the measurements")
    for heading in ("", "value", "standard error", LIKELY, "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for i, name in enumerate(fit.parameters):
        table.add_row(name, f"{fit.values[i]:.4g}", _known(fit.standard_errors[i]), interval(fit, i), fit.units[i])
    rows = run_text.house_table("Measurements")
    for heading in ("row", "quantity", "radial [N]", "axial [N]", "phase", "measured", "model", "off [sigma]"):
        rows.add_column(heading, justify="left" if heading == "quantity" else "right")
    for k, row in enumerate(fit.rows):
        rows.add_row(
            str(k + 1), row.quantity.replace("_", " "), f"{row.radial:g}", f"{row.axial:g}", _phase(row.phase),
            f"{row.value:.5g} {row.unit}", f"{fit.predicted[k]:.5g} {row.unit}", f"{fit.residuals[k]:+.2f}",
        )  # fmt: skip
    lines = [*fit.remarks]
    if len(fit.parameters) > 1:
        pairs = [
            f"{a} and {b} {fit.correlation[i, j]:+.2f}"
            for i, a in enumerate(fit.parameters)
            for j, b in enumerate(fit.parameters[:i])
        ]
        lines.append(f"correlation of {', '.join(pairs)}")
    for s in suggestions:
        errors = ", ".join(f"{name} {error:.2g}" for name, error in s.errors.items())
        lines.append(f"next: measure {in_words(s.row)} (standard errors then: {errors})")
    lines.append(f"{fit.status}; χ² = {fit.chi2:.3g} of {fit.freedom} degrees of freedom")
    return Group(table, rows, *(Text(line) for line in lines))


def interval(fit: Fit, i: int) -> str:
    """An interval in words: an end that the range sets and not the data is left out."""
    (low, high), (no_low, no_high) = fit.intervals[i], fit.open[i]
    if no_low and no_high:
        return "any"
    if no_low:
        return f"< {high:.4g}"
    if no_high:
        return f"> {low:.4g}"
    return f"{low:.4g} … {high:.4g}"


def _known(value: float) -> str:
    return f"{value:.2g}" if math.isfinite(value) else "–"


def _phase(phase: Any) -> str:
    return "scene's" if phase is None else phase if isinstance(phase, str) else f"{phase:.4g}"


def fit_panels(fit: Fit) -> Any:
    """What a fit says, in four Axes: measured against model, residuals, profiles, and the ridge of the first two."""
    _, axes = plt.subplots(2, 2, figsize=(8.4, 6.8), layout="constrained")
    losses = [k for k, row in enumerate(fit.rows) if row.is_loss]
    shown = losses or list(range(len(fit.rows)))
    scale, unit = (1.0, "loss of stiffness [%]") if losses else (1e-6, "stiffness [kN/µm]")
    fit_against_data(fit, shown, scale, unit, axes[0, 0])
    residuals(fit, axes[0, 1])
    profiles(fit, axes[1, 0])
    if len(fit.parameters) > 1:
        ridge(fit, axes[1, 1])
    else:
        axes[1, 1].set_axis_off()
    return axes[0, 0]


def fit_against_data(fit: Fit, shown: list[int], scale: float, unit: str, ax: Axes) -> Axes:
    """Model against measurement with error bars, rows `shown`; on the line they agree."""
    for direction, colour, marker in (("radial", HEALTHY, "o"), ("axial", SPALLED, "s")):
        rows = [k for k in shown if fit.rows[k].quantity.startswith(direction)]
        if rows:
            measured = scale * np.array([float(fit.rows[k].value) for k in rows])
            ax.errorbar(scale * fit.predicted[rows], measured, WIDE * scale * fit.sigma[rows], fmt=marker, ms=5,
                        color=colour, mfc="none", lw=1.0, capsize=2, label=direction)  # fmt: skip
    limits = np.array([*ax.get_xlim(), *ax.get_ylim()])
    ends = limits.min(), limits.max()
    ax.plot(ends, ends, color="black", lw=0.8, zorder=0)
    ax.set(xlim=ends, ylim=ends, xlabel=f"model: {unit}", ylabel=f"measured: {unit}", title=f"Fit (bars: {PERCENT})")
    ax.legend(frameon=False)
    return ax


def residuals(fit: Fit, ax: Axes) -> Axes:
    """What the model leaves of every row, in sigma."""
    at = np.arange(1, len(fit.rows) + 1)
    colours = [HEALTHY if row.quantity.startswith("radial") else SPALLED for row in fit.rows]
    ax.axhspan(-WIDE, WIDE, color=ACCENT, alpha=0.35, lw=0)
    ax.axhline(0.0, color="black", lw=0.8)
    ax.bar(at, fit.residuals, width=0.6, color=colours)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="row", ylabel="measured − model [σ]", title=f"Residuals (band: {PERCENT})")
    return ax


def profiles(fit: Fit, ax: Axes) -> Axes:
    """Rise of χ² with each parameter held, all others free, over the parameter relative to its fitted value."""
    limit = fit.limit
    styles = zip(fit.labels, (HEALTHY, SPALLED, "#228833", "#AA3377", "#CCBB44", "#66CCEE", "black"),
                 ("-", "--", "-.", ":", "-", "--", "-."), strict=False)  # fmt: skip
    widest = 0.0
    for i, (name, colour, style) in enumerate(styles):
        values = fit.along(i, fit.profiles.coordinates[i])
        relative = (values - fit.values[i]) / (abs(fit.values[i]) or 1.0) * 100.0
        rise = np.maximum(fit.profiles.rise[i], 0.0)
        low = rise < 3.0 * limit
        widest = max(widest, float(np.max(np.abs(relative[low]))))
        ax.plot(relative[low], rise[low], style, color=colour, label=f"{name} {fit.values[i]:.3g} {fit.units[i]}")
    ax.axhline(limit, color="black", lw=0.8)
    ax.text(0.02, limit, PERCENT, va="bottom", transform=ax.get_yaxis_transform())
    ax.set(xlabel="parameter against its fitted value [%]", ylabel="rise of χ²", ylim=(0.0, 2.5 * limit))
    ax.set(title="Profiles of the likelihood")
    ax.legend(frameon=False, loc="upper center")
    return ax


def ridge(fit: Fit, ax: Axes) -> Axes:
    """Rise of χ² over the first two parameters, all others free: 68, 95 and 99.7 % regions."""
    box = np.clip(np.stack([_wider(fit, i) for i in (0, 1)]), -EDGE, EDGE)
    rise = np.asarray(fit.ridge(box))
    first, second = (fit.along(k, np.linspace(box[k, 0], box[k, 1], len(rise))) for k in (0, 1))
    scale = fit.limit / limit_of(None)  # larger if sigma was estimated
    levels = [0.0, *(scale * v for v in (2.296, 5.991, 11.829))]  # of χ² of two degrees of freedom
    ax.contourf(first, second, np.maximum(rise.T, 0.0), levels, colors=("#4477AA", "#99B8D8", "#DDE7F1"))
    ax.plot(fit.values[0], fit.values[1], "+", color=SPALLED, ms=10, mew=2, label="fit")
    ax.set(xlabel=f"{fit.labels[0]} [{fit.units[0]}]", ylabel=f"{fit.labels[1]} [{fit.units[1]}]")
    ax.set_title("Ridge: 68, 95, 99.7 %")
    ax.legend(frameon=False)
    return ax


def _wider(fit: Fit, i: int) -> np.ndarray:
    """Coordinates somewhat beyond an interval."""
    low, high = fit.profiles.ends[i]
    return np.array([fit.place[i] - 2.1 * (fit.place[i] - low), fit.place[i] + 2.1 * (high - fit.place[i])])
