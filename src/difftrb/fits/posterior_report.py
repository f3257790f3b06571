"""A posterior, and how many spalls rows need, for people (text) and for machines (JSON)."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import RenderableType

from difftrb.fits.posterior import Posterior
from difftrb.fits.profile_intervals import CONFIDENCE
from difftrb.fits.spall_count import SpallCount
from difftrb.report import run_text


def posterior_json(posterior: Posterior) -> dict[str, Any]:
    """For the command line's `--json`."""
    parts = zip(
        posterior.parameters, posterior.units, posterior.values.T, posterior.intervals(), posterior.ranges, strict=True
    )
    return {
        "parameters": {
            name: {"mean": np.mean(own), "standard_deviation": np.std(own), "unit": unit, "interval": ends,
                   "prior": prior}
            for name, unit, own, ends, prior in parts
        },
        "log_evidence": posterior.log_evidence,
        "log_evidence_error": posterior.error,
        "draws": len(posterior.values),
        "effective": posterior.effective,
        "evaluations": posterior.evaluations,
    }  # fmt: skip


def posterior_text(posterior: Posterior, heading: str = "Posterior") -> RenderableType:
    """A table of its parameters."""
    table = run_text.house_table(f"{heading}, log evidence {posterior.log_evidence:.2f} ± {posterior.error:.2f}")
    for name in ("", "mean", "standard deviation", f"{100.0 * CONFIDENCE:g} % interval", "unit"):
        table.add_column(name, justify="left" if name in ("", "unit") else "right")
    parts = zip(posterior.parameters, posterior.units, posterior.values.T, posterior.intervals(), strict=True)
    for name, unit, own, (low, high) in parts:
        table.add_row(name, f"{np.mean(own):.4g}", f"{np.std(own):.2g}", f"{low:.4g} … {high:.4g}", unit)
    return table


def count_json(counted: SpallCount) -> list[dict[str, Any]]:
    """For the command line's `--json`: an entry for each number of spalls."""
    parts = zip(counted.counts, counted.log_evidences, counted.errors, counted.shares, counted.posteriors, strict=True)
    return [
        {"spalls": count, "log_evidence": value, "log_evidence_error": error, "share": share,
         "posterior": None if own is None else posterior_json(own)}
        for count, value, error, share, own in parts
    ]  # fmt: skip


def count_text(counted: SpallCount) -> RenderableType:
    """A table of what speaks for each number of spalls."""
    table = run_text.house_table("How many spalls")
    for name in ("spalls", "log evidence", "probability"):
        table.add_column(name, justify="right")
    parts = zip(counted.counts, counted.log_evidences, counted.errors, counted.shares, strict=True)
    for count, value, error, share in parts:
        table.add_row(str(count), f"{value:.2f} ± {error:.2f}", f"{100.0 * share:.3g} %")
    return table
