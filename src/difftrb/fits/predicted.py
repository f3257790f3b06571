"""What the model says of measurements, and how far it misses them.

Every condition is solved once, and every row is read from that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import Real
from difftrb.core.taylor import Taylor
from difftrb.fits import conditions, stiffness_of_rows
from difftrb.fits import parameters as fit_parameters
from difftrb.fits.conditions import COLUMN, ROW, Conditions
from difftrb.fits.fit_problem import ROBUST, Problem
from difftrb.fits.measured import Measurement
from difftrb.fits.parameters import Parameter
from difftrb.fits.stiffness_of_rows import Values, stiffness
from difftrb.ring.load import Load
from difftrb.scene.scene import Scene

HUBER = 1.345
"""Deviations beyond this many sigma count linearly: 95 % efficient on normal errors (Huber 1981)."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t for data with outliers (Lange, Little and Taylor 1989)."""
LOST = 1e3
"""Deviation [sigma] of a row that the model has no solution for."""
Solve = Callable[..., tuple[jax.Array, jax.Array]]
"""`stiffness_of_rows.stiffness`, or `stiffness_of_rows.with_slopes`."""


def predicted(
    parameters: Sequence[Parameter], scene: Scene, at: Conditions, values: jax.Array, healthy: jax.Array | None = None,
    solve: Solve = stiffness,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """What the model says of every row [% or N/mm], shape (rows,), and the worst status of all solves.

    `scene` is prepared; `values` of shape (parameters,); `healthy` is `Problem.healthy`.
    `solve`: `stiffness_of_rows.with_slopes` where nothing but first derivatives by `values` are wanted.
    """
    of = _of(parameters, scene)
    if healthy is None:
        at = conditions.of_changing(at)
    spalled, code = solve(of, values, at)
    if healthy is None:
        healthy, other = solve(of, values, at, without_spalls=True)
        code = status.worst(code, other)
    return _read(parameters, at, values, spalled, healthy), code


def _of(parameters: Sequence[Parameter], scene: Scene) -> stiffness_of_rows.Of:
    """The prepared scene, and what bearings carry at a load, of values of its parameters."""

    def of(values: Values) -> tuple[Scene, Callable[[Load], Load]]:
        def loaded(load: Load) -> Load:
            for parameter, value in zip(parameters, values, strict=True):
                load = parameter.load(load, value)
            return load

        return fit_parameters.put(parameters, scene, values), loaded

    return of


def _read(parameters: Sequence[Parameter], at: Conditions, values: Any, spalled: Any, healthy: Any) -> Any:
    """Every row [% or N/mm], shape (rows,), from stiffness at the conditions with spalls and without."""
    spalled, healthy = (pair[at.condition, at.entry] for pair in (spalled, healthy))
    # beside the diagonal there may be nothing of a healthy bearing: what spalls add is no share of it
    beside = xp.module_of(at.entry).asarray(ROW != COLUMN)[at.entry]
    healthy = xp.where(beside, spalled, healthy)
    added = xp.where(beside, 0.0, healthy / xp.where(beside, 1.0, spalled) - 1.0)
    for parameter, value in zip(parameters, values, strict=True):
        healthy, added = parameter.measured(healthy, added, value)
    left = 1.0 / (1.0 + added)
    return xp.where(at.loss, 100.0 * (1.0 - left), healthy * left)


def healthy_rows(problem: Problem) -> np.ndarray:
    """What rows would read of a bearing without spalls, shape (rows,): no loss; of a problem whose parameters leave the
    healthy bearing as it is, or that has losses alone."""
    at, healthy = problem.conditions, problem.healthy
    return np.where(at.loss, 0.0, 0.0 if healthy is None else np.asarray(healthy)[at.condition, at.entry])


def residual(problem: Problem, u: jax.Array) -> jax.Array:
    """What least squares is made of, shape (rows,), at coordinates u: see `weighted_residuals`."""
    return weighted_residuals(problem, predictions(problem, u)[0])


def predictions(problem: Problem, u: jax.Array, solve: Solve = stiffness) -> tuple[jax.Array, jax.Array]:
    """See `predicted`: at coordinates u."""
    values = problem.bounds.values(u)
    return predicted(problem.parameters, problem.scene, problem.conditions, values, problem.healthy, solve)


def _without_common(r: jax.Array, along: jax.Array, common: Real) -> jax.Array:
    """Deviations r whose errors are independent but for one of size `common` in the direction `along`, all of shape
    (rows,), turned into independent ones: by the root of the inverse of 1 + common² along alongᵀ."""
    size = jnp.vdot(along, along)
    share = (1.0 - 1.0 / jnp.sqrt(1.0 + common**2 * size)) / jnp.where(size > 0.0, size, 1.0)
    return r - share * jnp.vdot(along, r) * along


def weighted_residuals(problem: Problem, values: jax.Array) -> jax.Array:
    """Predicted `values` minus measured ones in sigma, shape (rows,), weighted so that half the sum of their squares is
    the negative log likelihood up to a constant."""
    known, counts = jnp.isfinite(values), jnp.isfinite(problem.sigma)
    r = jnp.where(known, (values - problem.measured) / problem.sigma, jnp.where(counts, LOST, 0.0))
    common = jnp.where(problem.by_squares, problem.common, 0.0)
    # of what is predicted: a share of the measured values would pull every fit below them
    scale = jnp.where(known, values, problem.measured) / problem.sigma
    for kind in (problem.conditions.loss, ~problem.conditions.loss):
        r = _without_common(r, jnp.where(kind, scale, 0.0), common)
    size, sign = jnp.abs(r), jnp.sign(r)
    beyond, far = size > HUBER, size > 1e-6
    huber = jnp.sqrt(HUBER * (2.0 * jnp.where(beyond, size, HUBER) - HUBER))
    student = jnp.sqrt((FREEDOM + 1.0) * jnp.log1p(jnp.where(far, size, 1.0) ** 2 / FREEDOM))
    ways = {
        "squares": r,
        "huber": jnp.where(beyond, sign * huber, r),
        "student": jnp.where(far, sign * student, r * np.sqrt((FREEDOM + 1.0) / FREEDOM)),
    }
    return jnp.select([problem.robust == k for k in range(len(ROBUST))], [ways[name] for name in ROBUST], r)


def other_rows(problem: Problem, rows: Sequence[Measurement], points: Iterable[np.ndarray | Taylor]) -> list[Any]:
    """What the model says of other rows at each of the `points`, coordinates or their expansions, shape (rows,): by
    numbers, for they are few."""
    at = conditions.conditions(problem.scene, rows, like=problem.conditions)
    healthy = None if problem.healthy is None else stiffness_of_rows.healthy_stiffness(problem.scene, at)
    of = problem.parameters, problem.scene, at
    return [_by_numbers(*of, problem.bounds.values(point), healthy) for point in points]


def other_rows_and_slopes(
    problem: Problem, rows: Sequence[Measurement], point: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the model says of other rows at a `point`, shape (rows,), and its slopes by coordinates, shape
    (rows, parameters)."""
    (read,) = other_rows(problem, rows, [Taylor(point, by=np.eye(len(point)))])
    by = xp.by(read)
    return xp.value(read), np.zeros((len(rows), len(point))) if by is None else np.transpose(by)


def rows_of(
    parameters: Sequence[Parameter], scene: Scene, rows: Sequence[Measurement], values: np.ndarray
) -> np.ndarray:
    """What a prepared scene with these values says of rows [% or N/mm], shape (rows,): of numbers."""
    return xp.value(_by_numbers(parameters, scene, conditions.conditions(scene, rows), values, None))


@np.errstate(all="ignore")
def _by_numbers(parameters: Sequence[Parameter], scene: Scene, at: Conditions, values: Any, healthy: Any) -> Any:
    """`predicted` of numbers, or of their expansion, shape (rows,)."""
    of = _of(parameters, scene)
    at = conditions.of_changing(at) if healthy is None else at
    spalled = stiffness_of_rows.of_numbers(of, values, at)
    healthy = (
        stiffness_of_rows.of_numbers(of, values, at, without_spalls=True) if healthy is None else np.asarray(healthy)
    )
    return _read(parameters, at, values, spalled, healthy)
