"""A fit, its posterior and how many spalls rows need, for machines: the keys of the command line's `--json`."""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.fits.fit_result import Fit
from difftrb.fits.optimal_design import Suggestion
from difftrb.fits.posterior import Posterior
from difftrb.fits.spall_count import SpallCount
from difftrb.report import tables


def fit_json(fit: Fit, suggestions: tuple[Suggestion, ...], seconds: float) -> dict[str, Any]:
    """A fit with the keys of the command line's `--json`; numbers that do not exist are None."""
    return tables.plain({
        "status": fit.status,
        "converged": bool(fit.converged),
        "parameters": _parameters_json(fit),
        "correlation": fit.correlation,
        "determined": fit.determined,
        "explained": fit.explained,
        "alternatives": [
            {"values": dict(zip(fit.parameters, other.values.tolist(), strict=True)), "chi2": other.chi2,
             "weight": other.weight}
            for other in fit.alternatives
        ],
        "remarks": fit.remarks,
        "doubts": fit.doubts,
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.freedom,
        "sigma_estimated": fit.sigma_estimated,
        "robust": fit.robust,
        "rows": _rows_json(fit),
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


def _parameters_json(fit: Fit) -> dict[str, dict[str, Any]]:
    return {
        name: {
            "value": fit.values[i],
            "unit": fit.units[i],
            "standard_error": fit.standard_errors[i],
            "interval": fit.intervals[i],
            "pieces": fit.pieces[i],
            "open": fit.open[i],
            "determined": bool(fit.determined_each[i]),
        }
        for i, name in enumerate(fit.parameters)
    }


def _rows_json(fit: Fit) -> list[dict[str, Any]]:
    return [
        {"quantity": row.quantity, "radial": row.radial, "axial": row.axial, "phase": row.phase,
         "definition": row.definition, "value": row.value, "unit": row.unit, "predicted": predicted, "sigma": sigma,
         "residual": off}
        for row, predicted, sigma, off in zip(fit.rows, fit.predicted, fit.sigma, fit.residuals, strict=True)
    ]  # fmt: skip


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


def count_json(counted: SpallCount) -> list[dict[str, Any]]:
    """For the command line's `--json`: an entry for each number of spalls."""
    parts = zip(counted.counts, counted.log_evidences, counted.errors, counted.shares, counted.posteriors, strict=True)
    return [
        {"spalls": count, "log_evidence": value, "log_evidence_error": error, "share": share,
         "posterior": None if own is None else posterior_json(own)}
        for count, value, error, share, own in parts
    ]  # fmt: skip
