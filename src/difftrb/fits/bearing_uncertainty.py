"""What a bearing that was estimated from its catalogue leaves open of fitted sizes, beside the measurements' errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from difftrb.core.geometry import TaperedBearing
from difftrb.fits import batched_misfit, predicted
from difftrb.fits.fit_result import Fit
from difftrb.scene.scene_laws import with_any_width


def moves(fit: Fit) -> Callable[[TaperedBearing, float], np.ndarray]:
    """How far the values move, shape (parameters,), if the bearing and its design load [N] are others.

    To first order: what the other bearing would read in the rows (as one without `effects` does) moves the values as
    the opposite change of the measurements would.
    """
    plain = dataclasses.replace(with_any_width(fit.scene) or fit.scene, effects=())
    step = np.linalg.pinv(batched_misfit.evaluated(fit.problem, fit.point[None]).jacobian[0])  # of deviations in sigma
    slope = fit.problem.bounds.rate(fit.point)
    own = predicted.rows_of(fit.problem.parameters, plain, fit.rows, fit.values)

    def moved(bearing: TaperedBearing, design_load: float) -> np.ndarray:
        scene = dataclasses.replace(plain, bearing=bearing, design_load=design_load)
        other = predicted.rows_of(fit.problem.parameters, scene, fit.rows, fit.values)
        with np.errstate(all="ignore"):
            share = np.where(own == 0.0, 0.0, other / own - 1.0)
        return -slope * (step @ (share * fit.predicted / fit.sigma))

    return moved


def sentence(fit: Fit, about: np.ndarray) -> str:
    """What that leaves, in one sentence."""
    if not np.isfinite(about).all():
        return (
            "the bearing is estimated from its catalogue: what that leaves is not known, for the law does not know all "
            "these bearings under all these loads"
        )
    every = zip(fit.parameters, about, fit.units, fit.determined_each, strict=True)
    left = ", ".join(f"{name} ± {value:.2g} {unit}".rstrip() for name, value, unit, known in every if known)
    if not left:
        return "the bearing is estimated from its catalogue: that leaves more, beside what the rows leave"
    text = f"the bearing is estimated from its catalogue: beside what the rows leave, that alone leaves {left} (k = 2)"
    lost = [p.name for p, value, own in zip(fit.problem.parameters, about, fit.values, strict=True)
            if p.logarithmic and value > own]  # fmt: skip
    if not lost:
        return text
    return f"{text}, so that nothing is known of {' and '.join(lost)}: measure losses, or give the rollers' dimensions"
