"""The road backwards: from measured stiffness, or its loss, to the spall's size.

Many starts in one batch: first some steps of Adam, then Levenberg–Marquardt with exact Jacobians.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from difftrb import confidence, least_squares, observed, remarks, status
from difftrb import scene as scenes
from difftrb import unknowns as unknown
from difftrb.confidence import Profiles
from difftrb.fitted import Fit, History
from difftrb.measured import MeasuredError, Measurement, check
from difftrb.nodes import Progress
from difftrb.observed import ROBUST, Evaluated, Problem
from difftrb.ring import Load, largest_load
from difftrb.scene import LawName, Scene
from difftrb.unknowns import FARTHEST, Unknowns

STARTS = 16
SEARCH = 12
"""Steps of Adam before Levenberg–Marquardt takes over."""
RATE = 0.25
"""Of Adam, in coordinates."""
SPREAD = 0.05, 0.95
"""Between which shares of an unknown's range starts lie."""
FLOOR = 0.1
"""Measurements without sigma count by their own size, but at least by this share of the middle one of their kind."""
LEAST_SIGMA = 1e-7
"""Estimates of a relative error below this are rounding."""
ROUNDS = 3
"""Of estimating sigma beside a robust fit."""


def prepare_fit(scene: Scene, rows: Sequence[Measurement], progress: Progress | None = None) -> Scene:
    """The scene with its law built for all loads of `rows`, so that fitting again costs no contact solves."""
    if not rows:
        raise MeasuredError("measurements: there are no rows to fit")
    for k, row in enumerate(rows, 1):
        check(row, f"measurements: row {k}")
    if isinstance(scene.law, LawName):
        if scene.law.name == "direct":
            raise MeasuredError("contact.law = 'direct' holds for one spall; fit with contact.law = 'table'")
        loads = [Load(float(row.radial), float(row.axial)) for row in rows]
        hardest = max(loads, key=lambda load: float(largest_load(scene.bearing, load)))
        scene = dataclasses.replace(scene, load=hardest)
    return scenes.prepare(scene, progress)


def fit(
    scene: Scene,
    rows: Sequence[Measurement],
    parameters: Sequence[str] = ("length", "width"),
    robust: str = "squares",
    starts: int = STARTS,
    progress: Progress | None = None,
) -> Fit:
    """Fit a scene's first spall to measurements, and say how far they determine it.

    Args:
      scene: bearing, law and whatever is known of the spall; its load does not matter. The law "table" knows ramps and
        so the width at any phase; under the others width acts through rows with phase "mean" alone. With a prepared law
        nothing is solved but rings.
      rows: from `load_measured`, or your own.
      parameters: of "length", "width", "depth", "angle" (of the spall), "crown" (the rollers' design load), "preload"
        (added to every axial load) and "scale" (the bearing's share in the measured compliance, the rest being housing
        and shaft). All others stay as in the scene.
      robust: "squares"; "huber" or "student" where single rows may be far off.
      starts: how many, at least 1. More where the widths may hold many rollers.
      progress: told how many of how many contacts are solved for the law.

    Rows without sigma: its size, relative to each value, is estimated from how the fit misses them. Raises
    `MeasuredError` for what cannot be fitted; what the data do not determine is said in `remarks`.
    """
    status.require_float64()
    if robust not in ROBUST:
        raise MeasuredError(f"robust = {robust!r} is not known; use one of {', '.join(ROBUST)}")
    rows, names = tuple(rows), tuple(parameters)
    scene = prepare_fit(scene, rows, progress)
    unknown.check_loads(scene, rows)
    unknowns = unknown.bounded(scene, rows, names)
    given = [row.sigma is not None for row in rows]
    if any(given) != all(given):
        k = given.index(False) + 1
        raise MeasuredError(f"measurements: row {k}: sigma is empty: give it in all rows or in none")
    estimate = not all(given)
    if estimate and len(rows) <= len(names):
        raise MeasuredError(
            f"measurements: {len(rows)} rows cannot give {len(names)} parameters and their own error: give sigma, more "
            "rows, or fewer parameters"
        )
    measured = np.array([float(row.value) for row in rows])
    sigma = _own_size(rows, measured) if estimate else np.array([float(row.sigma) for row in rows])  # type: ignore[arg-type]
    todo = observed.plan(scene, rows)
    problem = Problem(unknowns, scene, todo, jnp.asarray(measured), jnp.asarray(sigma), robust)
    places = start_places(unknowns, scene, starts)
    first = observed.evaluated(problem, places)
    _check_effects(names, np.asarray(first.slopes))

    freedom = len(rows) - len(names)
    limit = confidence.limit_of(freedom if estimate else None)
    for _ in range(ROUNDS if estimate and robust != "squares" else 1):
        found = solve_starts(problem, places)
        if estimate:
            told = observed.evaluated(problem, found.place).told[int(jnp.argmin(found.cost))]
            off = (np.asarray(told) - measured) / np.asarray(problem.sigma)
            problem = dataclasses.replace(problem, sigma=problem.sigma * _scatter(off, robust, freedom))
    tried = _judged(problem, places, found, limit)
    if tried.profiles.lowest_cost < tried.at.cost[tried.best] * (1.0 - 1e-6) - 1e-9:  # a profile has found more
        places = jnp.concatenate([jnp.asarray(tried.profiles.lowest)[None], places[1:]])
        tried = _judged(problem, places, solve_starts(problem, places, 0), limit)
    return _result(rows, problem, tried, first, limit, estimate)


class Tried(NamedTuple):
    """All starts, where they went, the model there, the best one's number, normal matrix and profiles."""

    starts: jax.Array
    found: least_squares.Least
    at: Evaluated
    best: int
    normal: np.ndarray
    profiles: Profiles


def _judged(problem: Problem, starts: jax.Array, found: least_squares.Least, limit: float) -> Tried:
    at = observed.evaluated(problem, found.place)
    best = int(np.argmin(np.where(np.isfinite(at.cost), at.cost, np.inf)))
    slopes = np.asarray(at.slopes[best])
    normal = slopes.T @ slopes
    profiles = confidence.profiles(problem, np.asarray(found.place[best]), float(at.cost[best]), normal, limit)
    return Tried(starts, found, at, best, normal, profiles)


def _own_size(rows: Sequence[Measurement], measured: np.ndarray) -> np.ndarray:
    """What stands for sigma where none is given, up to a factor: a measurement's own size."""
    size = np.abs(measured)
    sigma = np.empty_like(size)
    for loss in (True, False):
        kind = np.array([row.is_loss == loss for row in rows])
        if kind.any():
            sigma[kind] = np.maximum(size[kind], FLOOR * np.median(size[kind]))
    if not (sigma > 0.0).all():
        raise MeasuredError("measurements: most values are 0 and no sigma is given, so nothing says what 0 means: "
                            "give sigma")  # fmt: skip
    return sigma


def start_places(unknowns: Unknowns, scene: Scene, count: int) -> jax.Array:
    """Coordinates of the starts, shape (count, unknowns): the scene's own values, then an even spread of the range."""
    n = len(unknowns.names)
    golden = 2.0
    for _ in range(40):
        golden = (1.0 + golden) ** (1.0 / (n + 1))
    steps = golden ** -np.arange(1.0, n + 1.0)  # additive recurrence (Roberts 2018)
    shares = np.mod(0.5 + np.arange(1, count)[:, None] * steps[None, :], 1.0)
    shares = SPREAD[0] + (SPREAD[1] - SPREAD[0]) * shares
    own = unknowns.coordinates(jnp.array([[unknown.own(scene, name) for name in unknowns.names]]))
    return jnp.concatenate([jnp.clip(own, -4.0, 4.0), jnp.asarray(np.log(shares / (1.0 - shares)))])


def _check_effects(names: tuple[str, ...], slopes: np.ndarray) -> None:
    """Refuse unknowns on which no row depends at any start."""
    for i, name in enumerate(names):
        if not np.any(np.abs(slopes[..., i]) > 1e-12 * np.max(np.abs(slopes))):
            raise MeasuredError(f"parameters: {name} cannot be fitted to these rows: {unknown.NO_EFFECT[name]}")


@partial(jax.jit, static_argnames="search")
def solve_starts(problem: Problem, starts: jax.Array, search: int = SEARCH) -> least_squares.Least:
    """Least squares from all starts, shape (starts, unknowns), in one batch."""
    return jax.vmap(partial(_from, problem, search))(starts)


def _from(problem: Problem, search: int, start: jax.Array) -> least_squares.Least:
    adam = optax.adam(RATE)

    def slope(u: jax.Array) -> jax.Array:
        J, r = jax.jacfwd(lambda v: (observed.residual(problem, v),) * 2, has_aux=True)(u)
        return J.T @ r

    def step(state, _):
        u, memory = state
        change, memory = adam.update(slope(u), memory)
        return (jnp.clip(u + jnp.asarray(change), -4.0, 4.0), memory), None

    if search:
        start = jax.lax.scan(step, (start, adam.init(start)), None, length=search)[0][0]
    return least_squares.minimum(partial(observed.residual, problem), start, FARTHEST)


def _scatter(off: np.ndarray, robust: str, freedom: int) -> float:
    """By what factor the fit misses the measurements more than sigma says; `off` is in sigma, shape (rows,)."""
    if robust == "squares":
        factor = float(np.sqrt(np.sum(off**2) / freedom))
    else:  # the middle deviation, of normal errors
        factor = 1.4826 * float(np.median(np.abs(off))) * float(np.sqrt(len(off) / freedom))
    return max(factor, LEAST_SIGMA)


def _result(
    rows: tuple[Measurement, ...], problem: Problem, tried: Tried, first: Evaluated, limit: float, estimated: bool
) -> Fit:
    best, unknowns = tried.best, problem.unknowns
    u = np.asarray(tried.found.place[best])
    values = unknowns.values(jnp.asarray(u))
    known = confidence.covariance(tried.normal, u)
    variance = np.diag(known)
    slope = confidence.natural_slope(problem, u) * np.where(unknowns.logarithmic, np.asarray(values), 1.0)
    spread = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = known / np.outer(spread, spread)
    profiles = tried.profiles
    predicted = np.asarray(tried.at.told[best])
    result = Fit(
        parameters=unknowns.names,
        values=np.asarray(values),
        standard_errors=np.where(variance > 0.0, np.sqrt(variance) * np.abs(slope), np.nan),
        intervals=np.stack([np.asarray(unknowns.values(jnp.asarray(end))) for end in profiles.ends.T], 1),
        open=profiles.open,
        correlation=correlation + np.diag(1.0 - np.diag(correlation)),
        rows=rows,
        predicted=predicted,
        sigma=np.asarray(problem.sigma),
        sigma_estimated=estimated,
        residuals=(np.asarray(problem.measured) - predicted) / np.asarray(problem.sigma),
        chi2=2.0 * float(tried.at.cost[best]),
        freedom=len(rows) - len(unknowns.names),
        remarks=(),
        determined=False,
        scene=unknown.apply(unknowns, problem.scene, values).scene,
        history=History(
            *(np.asarray(jax.vmap(unknowns.values)(places)) for places in (tried.starts, tried.found.place)),
            chi2=2.0 * tried.at.cost,
            steps=np.asarray(tried.found.steps),
        ),
        profiles=profiles,
        problem=problem,
        place=u,
        normal=tried.normal,
        limit=limit,
        status_code=status.worst(
            tried.at.code[best], jnp.where(tried.found.converged[best], status.CONVERGED, status.NOT_CONVERGED)
        ),
    )  # fmt: skip
    return dataclasses.replace(result, **remarks.of(result, np.asarray(first.told)))
