"""What a fit is to solve: the scene prepared for all its rows, their conditions, parameters with bounds, and sigma."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from difftrb.core.geometry import Real
from difftrb.fits import conditions, measured, stiffness_of_rows
from difftrb.fits import parameters as fit_parameters
from difftrb.fits.conditions import Conditions
from difftrb.fits.least_squares import Bounds
from difftrb.fits.measured import MeasuredError, Measurement, so_many
from difftrb.fits.parameters import Parameter
from difftrb.law import base as laws
from difftrb.law.samples import Progress
from difftrb.ring.load import Load, largest_load
from difftrb.ring.phase_quadrature import POINTS_IN_FITS, ROUGH_POINTS
from difftrb.scene.auto_law import by_table
from difftrb.scene.scene import LawName, Scene, is_auto, laws_error
from difftrb.scene.solving import prepare

ROBUST = ("squares", "huber", "student")
FLOOR = 0.1
"""Measurements without sigma count by their own size, but at least by this share of the middle one of their kind."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Problem:
    """Measurements against the model.

    Attributes:
      parameters: what is sought, within `bounds`. scene: prepared. conditions: of the rows. rough: the same with means
        of few phases, to look for minima.
      measured, sigma: values and their standard deviations [% or N/mm], shape (rows,).
      healthy: `stiffness_of_rows.healthy_stiffness` unless a parameter changes it.
      common: the model's own relative error, which all losses share, and all stiffnesses.
      robust: how deviations count: the number of a name in `ROBUST`.
    """

    parameters: tuple[Parameter, ...] = dataclasses.field(metadata={"static": True})
    bounds: Bounds
    scene: Scene
    conditions: Conditions
    rough: Conditions | None
    measured: Real
    sigma: Real
    healthy: Real | None
    common: Real
    robust: int | jax.Array

    @property
    def by_squares(self) -> Any:
        """Whether deviations count by their squares, all alike."""
        return self.robust == ROBUST.index("squares")

    @property
    def prior(self) -> np.ndarray:
        """How uncertain parameters are before any measurement, in coordinates, shape (parameters,)."""
        return np.array([parameter.prior for parameter in self.parameters])


def prepare_fit(scene: Scene, rows: Sequence[Measurement], progress: Progress | None = None) -> Scene:
    """The scene with its law built for all loads of `rows`, so that fitting again costs no contact solves.

    "auto" is "table".
    """
    rows = measured.listed(rows)
    if not rows:
        raise MeasuredError("measurements: there are no rows to fit")
    for k, row in enumerate(rows, 1):
        measured.check(row, k)
    name = getattr(scene.law, "name", "")
    if laws.kind(name).one_scene:
        raise MeasuredError(f"contact.law = {name!r} holds for one spall; fit with contact.law = 'table'")
    if isinstance(scene.law, LawName):
        loads = [Load(float(row.radial), float(row.axial)) for row in rows]
        loads.sort(key=lambda load: float(largest_load(scene.bearing, load)))
        scene = dataclasses.replace(scene, load=loads[-1])
        if is_auto(scene):
            return by_table(scene)
    return prepare(scene, progress)


def problem_of(
    scene: Scene, rows: tuple[Measurement, ...], names: tuple[str, ...], robust: str, model_error: float | None
) -> tuple[Problem, bool]:
    """What is to be solved, and whether sigma is to be estimated, of which there is only the relative size then."""
    parameters = fit_parameters.named(names)
    bounds = fit_parameters.bounds(parameters, scene, rows)
    given = [row.sigma is not None for row in rows]
    if any(given) != all(given):
        k = given.index(False)
        here, sigma = measured.where(rows[k], k + 1), measured.column("sigma", rows[k].origin)
        raise MeasuredError(f"{here}: {sigma} is empty: give it in all rows or in none")
    estimate = not all(given)
    if estimate and len(rows) <= len(names):
        raise MeasuredError(
            f"{measured.table_of(rows)}: {so_many(len(rows), 'measured value')} cannot give "
            f"{so_many(len(names), 'parameter')} and their own error: give sigma, more rows, or fewer parameters"
        )
    at = conditions.conditions(scene, rows, POINTS_IN_FITS)
    rough = conditions.conditions(scene, rows, ROUGH_POINTS, like=at)
    own_error = float(laws_error(scene))
    return Problem(
        parameters=parameters,
        bounds=bounds,
        scene=scene,
        conditions=at,
        rough=rough,
        measured=np.array([float(row.value) for row in rows]),
        sigma=np.array(_own_size(rows) if estimate else [float(row.sigma) for row in rows]),  # type: ignore[arg-type]
        healthy=None if any(p.changes_healthy for p in parameters) else stiffness_of_rows.healthy_stiffness(scene, at),
        common=model_error if model_error is not None else own_error if np.isfinite(own_error) else 0.0,
        robust=ROBUST.index(robust),
    ), estimate


def with_more(problem: Problem, more: Sequence[Parameter], rows: Sequence[Measurement]) -> Problem:
    """The problem with these parameters sought, too, behind its own."""
    parameters = (*problem.parameters, *more)
    own = fit_parameters.bounds(more, problem.scene, rows) if more else None
    changed = any(parameter.changes_healthy for parameter in more)
    return dataclasses.replace(
        problem, parameters=parameters, healthy=None if changed else problem.healthy,
        bounds=problem.bounds if own is None else problem.bounds.beside(own),
    )  # fmt: skip


def basin_spacings(problem: Problem) -> np.ndarray:
    """How far basins lie apart, in coordinates in the middle of the range, shape (parameters,)."""
    low, high = problem.bounds.ends()
    return 4.0 * np.array([parameter.apart(problem.scene) for parameter in problem.parameters]) / (high - low)


def _own_size(rows: Sequence[Measurement]) -> np.ndarray:
    """What stands for sigma where none is given, up to a factor: a measurement's own size."""
    size = np.abs([float(row.value) for row in rows])
    sigma = np.empty_like(size)
    for loss in (True, False):
        kind = np.array([row.is_loss == loss for row in rows])
        if kind.any():
            sigma[kind] = np.maximum(size[kind], FLOOR * np.median(size[kind]))
    if not (sigma > 0.0).all():
        raise MeasuredError(f"{measured.table_of(rows)}: most values are 0 and no sigma is given, so nothing says what "
                            "0 means: give sigma")  # fmt: skip
    return sigma
