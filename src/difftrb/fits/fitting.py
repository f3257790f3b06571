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

from difftrb.core import status
from difftrb.fits import diagnostics, intervals, least_squares, predicted
from difftrb.fits import parameters as unknown
from difftrb.fits.fit_result import Fit, History
from difftrb.fits.intervals import Profiles
from difftrb.fits.least_squares import Least
from difftrb.fits.measured import MeasuredError, Measurement, check
from difftrb.fits.parameters import FARTHEST, Unknowns
from difftrb.fits.predicted import ROBUST, Problem
from difftrb.law.samples import Progress
from difftrb.ring.ring import Load, largest_load
from difftrb.scene import auto_law
from difftrb.scene.scene import LawName, Scene

STARTS = 16
BATCH = 16
"""Most cases that one call evaluates."""
SEARCH = 1
"""Steps of Adam before Levenberg–Marquardt takes over."""
ADAM = optax.adam(0.25)
"""Steps of a quarter, in coordinates."""
MEET = 0.3
"""Starts that come this close to each other, in coordinates, go on as one."""
BEHIND = 0.05
"""Starts that expect less of a step than this share of what parts them from the best one have found another minimum."""
SPREAD = 0.05, 0.95
"""Between which shares of an unknown's range starts lie."""
FLOOR = 0.1
"""Measurements without sigma count by their own size, but at least by this share of the middle one of their kind."""
LEAST_SIGMA = 1e-7
"""Estimates of a relative error below this are rounding."""
ROUNDS = 3
"""Of estimating sigma beside a robust fit."""


def prepare_fit(scene: Scene, rows: Sequence[Measurement], progress: Progress | None = None) -> Scene:
    """The scene with its law built for all loads of `rows`, so that fitting again costs no contact solves.

    "auto" becomes a table, judged under the lightest and the heaviest of these loads at the scene's own spall.
    """
    if not rows:
        raise MeasuredError("measurements: there are no rows to fit")
    for k, row in enumerate(rows, 1):
        check(row, f"measurements: row {k}")
    if isinstance(scene.law, LawName):
        if scene.law.name == "direct":
            raise MeasuredError("contact.law = 'direct' holds for one spall; fit with contact.law = 'table'")
        loads = [Load(float(row.radial), float(row.axial)) for row in rows]
        loads.sort(key=lambda load: float(largest_load(scene.bearing, load)))
        ends = [dataclasses.replace(scene, load=load) for load in (loads[0], loads[-1])]
        scene = ends[-1]
        if auto_law.is_auto(scene):
            return auto_law.shared(ends, partial(auto_law.by_name, scene, progress=progress), auto_law.SOFT)
    return auto_law.prepare(scene, progress)


def fit(
    scene: Scene,
    rows: Sequence[Measurement],
    parameters: Sequence[str] = ("length", "width"),
    robust: str = "squares",
    starts: int = STARTS,
    model_error: float | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Fit a scene's first spall to measurements, and say how far they determine it.

    Args:
      scene: bearing, law and whatever is known of the spall; its load does not matter. The law "table" knows ramps and
        so the width at any phase; under the others width acts through rows with phase "mean" alone. With a prepared law
        nothing is solved but rings.
      rows: from `load_measured`, or your own.
      parameters: of "length", "width", "depth", "angle", "axial_offset" (of the spall), "crown" (the rollers' design
        load), "preload" (added to every axial load) and "scale" (the bearing's share in the measured compliance, the
        rest being housing and shaft). All others stay as in the scene.
      robust: "squares"; "huber" or "student" where single rows may be far off.
      starts: how many, at least 1. More where the widths may hold many rollers.
      model_error: relative error of the model that all losses share, and all stiffnesses, ≥ 0; it widens intervals
        (not of robust fits). None: that of the roller law, if it is known.
      progress: told how many of how many contacts are solved for the law.

    Rows without sigma: its size, relative to each value, is estimated from how the fit misses them. Raises
    `MeasuredError` for what cannot be fitted; what the data do not determine is said in `remarks`.
    """
    status.require_float64()
    if model_error is not None and not 0.0 <= model_error < np.inf:
        raise MeasuredError(f"model_error = {model_error!r}: must be 0 or a positive number; None takes the law's own")
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
    todo = predicted.plan(scene, rows)
    own_error = float(scene.law.error)  # type: ignore[union-attr]  # it is prepared
    common = model_error if model_error is not None else own_error if np.isfinite(own_error) else 0.0
    sound = None if set(names) & {"crown", "preload"} else predicted.healthy_stiffness(scene, todo)
    problem = Problem(
        unknowns, scene, todo, jnp.asarray(measured), jnp.asarray(sigma), sound, common, ROBUST.index(robust)
    )
    places = start_places(unknowns, scene, starts)
    every = np.ones_like(places, bool)
    first = solved(problem, places, every, 0, 0)
    _check_effects(names, np.asarray(first.normal))

    freedom = len(rows) - len(names)
    limit = intervals.limit_of(freedom if estimate else None)
    for _ in range(ROUNDS if estimate and robust != "squares" else 1):
        found = solved(problem, places, every, SEARCH, least_squares.STEPS, meet=MEET, behind=BEHIND)
        if estimate:
            off = (found.told[0][np.nanargmin(found.cost)] - measured) / np.asarray(problem.sigma)
            problem = dataclasses.replace(problem, sigma=problem.sigma * _scatter(off, robust, freedom))
            found = solved(problem, np.asarray(found.place), every, 0, least_squares.STEPS)
    tried = _judged(problem, places, found, limit)
    if tried.profiles.lowest_cost < found.cost[tried.best] * (1.0 - 1e-6) - 1e-9:  # a profile has found more
        again = np.concatenate([tried.profiles.lowest[None], found.place[1:]])
        tried = _judged(problem, places, solved(problem, again, every, 0, least_squares.STEPS), limit)
    return _result(rows, problem, tried, first.told[0], limit, estimate)


class Tried(NamedTuple):
    """All starts, where they went, the best one's number and profiles."""

    starts: np.ndarray
    found: Least
    best: int
    profiles: Profiles


def _judged(problem: Problem, starts: np.ndarray, found: Least, limit: float) -> Tried:
    best = int(np.nanargmin(found.cost))
    profiles = intervals.profiles(
        solved, problem, np.asarray(found.place[best]), float(found.cost[best]), np.asarray(found.normal[best]), limit
    )
    return Tried(starts, found, best, profiles)


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


def start_places(unknowns: Unknowns, scene: Scene, count: int) -> np.ndarray:
    """Coordinates of the starts, shape (count, unknowns): the scene's own values, then an even spread of the range."""
    n = len(unknowns.names)
    golden = 2.0
    for _ in range(40):
        golden = (1.0 + golden) ** (1.0 / (n + 1))
    steps = golden ** -np.arange(1.0, n + 1.0)  # additive recurrence (Roberts 2018)
    shares = np.mod(0.5 + np.arange(1, count)[:, None] * steps[None, :], 1.0)
    shares = SPREAD[0] + (SPREAD[1] - SPREAD[0]) * shares
    own = unknowns.coordinates(jnp.array([[unknown.own(scene, name) for name in unknowns.names]]))
    return np.concatenate([np.clip(np.asarray(own), -4.0, 4.0), np.log(shares / (1.0 - shares))])


def _check_effects(names: tuple[str, ...], normals: np.ndarray) -> None:
    """Refuse unknowns on which no row depends at any start; `normals` of shape (starts, unknowns, unknowns)."""
    size = np.sqrt(np.max(np.einsum("kii->ki", normals), axis=0))
    for name, own in zip(names, size, strict=True):
        if own <= 1e-12 * np.max(size):
            raise MeasuredError(f"parameters: {name} cannot be fitted to these rows: {unknown.NO_EFFECT[name]}")


def solved(
    problem: Problem, places: np.ndarray, free: np.ndarray, search: int, steps: int, enough: float = 0.0,
    meet: float = 0.0, behind: float = 0.0,
) -> Least:  # fmt: skip
    """Least squares from `places`, shape (cases, unknowns), moving those coordinates that are `free`, same shape: first
    `search` steps of Adam, then `steps` of Levenberg–Marquardt at most; the rest as in `least_squares.minimum`."""
    lead = (_adam, ADAM.init(jnp.asarray(places)), search) if search else (None, None, 0)
    return least_squares.minimum(
        partial(evaluated, problem), np.asarray(places), free, FARTHEST, steps, *lead, enough, meet, behind
    )


@jax.jit
def _adam(gradient: jax.Array, memory: optax.OptState) -> tuple[jax.Array, optax.OptState]:
    move, memory = ADAM.update(gradient, memory)
    return move, memory  # type: ignore[return-value]  # optax says any tree of arrays


def evaluated(problem: Problem, places: np.ndarray) -> least_squares.Evaluated:
    """Deviations as they count and their slopes by coordinates at `places`, shape (cases, unknowns); told besides: what
    the model says of the rows, and its status. In parts of one size, by one program."""
    parts = []
    for k in range(0, len(places), BATCH):
        part = places[k : k + BATCH]
        padded = np.zeros((BATCH, places.shape[1]))
        padded[: len(part)] = part
        parts.append([np.asarray(out)[: len(part)] for out in _evaluated(problem, padded, len(part))])
    residual, jacobian, *told = (np.concatenate(each) for each in zip(*parts, strict=True))
    return least_squares.Evaluated(residual, jacobian, tuple(told))


@jax.jit
def _evaluated(problem: Problem, places: jax.Array, count: jax.Array) -> tuple[jax.Array, ...]:
    """Of the first `count` places, one after the other: the rings of one fill the processor."""

    def misfit(u: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        told, code = predicted.predictions(problem, u)
        r = predicted.counted(problem, told)
        return r, (r, told, code)

    def one(k: jax.Array, out: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        slopes, (r, told, code) = jax.jacfwd(misfit, has_aux=True)(places[k])
        return tuple(all_.at[k].set(own) for all_, own in zip(out, (r, slopes, told, code), strict=True))

    rows, n = problem.measured.size, places.shape[1]
    blank = tuple(jnp.zeros((BATCH, *shape)) for shape in ((rows,), (rows, n), (rows,)))
    return jax.lax.fori_loop(0, count, one, (*blank, jnp.zeros(BATCH, int)))


def _scatter(off: np.ndarray, robust: str, freedom: int) -> float:
    """By what factor the fit misses the measurements more than sigma says; `off` is in sigma, shape (rows,)."""
    if robust == "squares":
        factor = float(np.sqrt(np.sum(off**2) / freedom))
    else:  # the middle deviation, of normal errors
        factor = 1.4826 * float(np.median(np.abs(off))) * float(np.sqrt(len(off) / freedom))
    return max(factor, LEAST_SIGMA)


def _result(
    rows: tuple[Measurement, ...], problem: Problem, tried: Tried, first: np.ndarray, limit: float, estimated: bool
) -> Fit:
    best, unknowns = tried.best, problem.unknowns
    u = np.asarray(tried.found.place[best])
    values = unknowns.values(jnp.asarray(u))
    known = intervals.covariance(np.asarray(tried.found.normal[best]), u)
    variance = np.diag(known)
    slope = intervals.natural_slope(problem, u) * np.where(unknowns.logarithmic, np.asarray(values), 1.0)
    spread = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = known / np.outer(spread, spread)
    profiles = tried.profiles
    told = np.asarray(tried.found.told[0][best])
    result = Fit(
        parameters=unknowns.names,
        values=np.asarray(values),
        standard_errors=np.where(variance > 0.0, np.sqrt(variance) * np.abs(slope), np.nan),
        intervals=np.stack([np.asarray(unknowns.values(jnp.asarray(end))) for end in profiles.ends.T], 1),
        open=profiles.open,
        correlation=correlation + np.diag(1.0 - np.diag(correlation)),
        rows=rows,
        predicted=told,
        sigma=np.asarray(problem.sigma),
        sigma_estimated=estimated,
        residuals=(np.asarray(problem.measured) - told) / np.asarray(problem.sigma),
        chi2=2.0 * float(tried.found.cost[best]),
        freedom=len(rows) - len(unknowns.names),
        remarks=(),
        determined=False,
        scene=unknown.apply(unknowns, problem.scene, values).scene,
        history=History(
            *(np.asarray(jax.vmap(unknowns.values)(jnp.asarray(v))) for v in (tried.starts, tried.found.place)),
            chi2=2.0 * np.asarray(tried.found.cost),
            steps=np.asarray(tried.found.steps),
        ),
        profiles=profiles,
        problem=problem,
        robust=ROBUST[int(problem.robust)],
        place=u,
        normal=np.asarray(tried.found.normal[best]),
        limit=limit,
        solve=solved,
        status_code=status.worst(
            tried.found.told[1][best], jnp.where(tried.found.converged[best], status.CONVERGED, status.NOT_CONVERGED)
        ),
    )  # fmt: skip
    return dataclasses.replace(result, **diagnostics.of(result, first))
