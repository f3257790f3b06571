"""Levenberg–Marquardt for many cases side by side: one evaluation of residual and exact Jacobian a step, safe against
NaN.

The loop runs outside of jit: only the evaluation is compiled, once, and finished cases cost nothing more. jaxopt has
the method, too. It evaluates the residual three times a step where this one does once, a NaN in one trial step ends it
for good, and it stops by the gradient's size alone, which says nothing without a scale.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

STEPS = 40
TOLERANCE = 1e-9
"""Of coordinates: a step shorter than this ends it."""
LONGEST = 2.0
"""Longest step of one coordinate."""
ROUNDING = 1e-13
"""Relative gain of the sum of squares below which there is nothing left to gain."""
LEAST_DAMPING = 1e-13
"""Relative: keeps the normal matrix invertible where residuals do not depend on something."""


class Least(NamedTuple):
    """Minima: places, shape (cases, n); half the sums of squares there, shape (cases,); their normal matrices JᵀJ,
    shape (cases, n, n); what else the residual told there, shapes (cases, …); steps taken; which converged."""

    place: np.ndarray
    cost: np.ndarray
    normal: np.ndarray
    told: tuple[np.ndarray, ...]
    steps: np.ndarray
    converged: np.ndarray


class Evaluated(NamedTuple):
    """Residuals, shape (cases, m), their Jacobians, shape (cases, m, n), and whatever else there is to tell, shapes
    (cases, …)."""

    residual: np.ndarray
    jacobian: np.ndarray
    told: tuple[np.ndarray, ...]


Lead = Callable[[np.ndarray, Any], tuple[np.ndarray, Any]]
"""From gradients, shape (cases, n), and a memory to steps, same shape, and the memory after it: as optax has them."""


def minimum(
    evaluate: Callable[[np.ndarray], Evaluated],
    start: np.ndarray,
    free: np.ndarray,
    farthest: float,
    steps: int,
    lead: Lead | None = None,
    memory: Any = None,
    led: int = 0,
    enough: float = 0.0,
    meet: float = 0.0,
    behind: float = 0.0,
) -> Least:
    """Least squares of what `evaluate` says of places, shape (some cases, n).

    Args:
      start: shape (cases, n). free: which coordinates move, same shape. farthest: all stay within ± this of 0.
      steps: at most. With none it evaluates the start.
      lead, memory, led: another rule that goes first, its memory at the start, and for how many steps.
      enough: gain of half the sum of squares, besides rounding, below which a case is done.
      meet: a case that comes closer than this to a better one, in every coordinate, ends where that one does.
      behind: a case that expects of its next step less than this share of what parts it from the best one is done.
    """
    place, cost = start.copy(), np.full(len(start), np.inf)
    cases, n = start.shape
    gradient, normal, move = np.zeros((cases, n)), np.zeros((cases, n, n)), np.zeros((cases, n))
    damping, expected, taken = np.full(cases, 1e-3), np.zeros(cases), np.zeros(cases, int)
    done, ends = np.zeros(cases, bool), np.arange(cases)
    told: tuple[np.ndarray, ...] = ()
    for k in range(led + steps + 1):
        at = np.nonzero(~done)[0]
        trial = place[at] + move[at]
        new = evaluate(trial)
        if not told:
            told = tuple(np.zeros((cases, *more.shape[1:]), more.dtype) for more in new.told)
        sums = 0.5 * np.sum(new.residual**2, axis=1)
        better = (sums < cost[at]) | (k < led)
        good = better & ~(cost[at] - sums < 0.25 * expected[at])
        relaxed = np.where(good & (k > led), np.maximum(0.1 * damping[at], LEAST_DAMPING), damping[at])
        damping[at] = np.where(better, relaxed, np.maximum(10.0 * damping[at], 1e-4))
        here = at[better]
        place[here], cost[here] = trial[better], sums[better]
        jacobian = new.jacobian[better]
        gradient[here] = np.einsum("kmi,km->ki", jacobian, new.residual[better])
        normal[here] = np.einsum("kmi,kmj->kij", jacobian, jacobian)
        for whole, more in zip(told, new.told, strict=True):
            whole[here] = more[better]
        taken[at] = k
        if lead is not None and k < led:
            other, memory = lead(gradient, memory)
            move = np.where(free, other, 0.0)
        else:
            move[at] = _step(place[at], gradient[at], normal[at], damping[at], free[at], farthest)
        move = np.clip(place + np.clip(move, -LONGEST, LONGEST), -farthest, farthest) - place
        expected = -np.einsum("ki,ki->k", gradient, move) - 0.5 * np.einsum("ki,kij,kj->k", move, normal, move)
        if k >= led:
            least = np.maximum(np.maximum(ROUNDING * cost, enough), behind * (cost - np.nanmin(cost)))
            tiny = (np.max(np.abs(move), axis=1) < TOLERANCE) | (expected <= least)
            done |= tiny | (damping > 1e9)
            if meet > 0.0:
                ends = _met(place, cost, ends, meet)
                done |= ends != np.arange(cases)
        if done.all():
            break
    for _ in range(cases):  # those that met one that met another
        ends = ends[ends]
    own = np.arange(cases) == ends
    return Least(
        place[ends],
        cost[ends],
        normal[ends],
        tuple(more[ends] for more in told),
        taken,
        np.where(own, done, done[ends]),
    )


def _step(
    place: np.ndarray, gradient: np.ndarray, normal: np.ndarray, damping: np.ndarray, free: np.ndarray, farthest: float
) -> np.ndarray:
    """Of Levenberg–Marquardt, shape (cases, n), along what is free and not held back by a bound."""
    inward = free & ((place < farthest) | (gradient > 0.0)) & ((place > -farthest) | (gradient < 0.0))
    diagonal = np.einsum("kii->ki", normal)
    size = np.sqrt(np.maximum(diagonal, 1e-12 * np.max(diagonal, axis=1, keepdims=True) + 1e-300))
    both = inward[:, :, None] & inward[:, None, :]
    matrix = np.where(both, normal / (size[:, :, None] * size[:, None, :]), 0.0)
    matrix += np.eye(place.shape[1]) * np.where(inward, damping[:, None], 1.0)[:, None, :]
    right = np.where(inward, -gradient / size, 0.0)
    return np.linalg.solve(matrix, right[..., None])[..., 0] / size


def _met(place: np.ndarray, cost: np.ndarray, ends: np.ndarray, meet: float) -> np.ndarray:
    """Whose place every case ends at: its own, or that of a better one it has come close to."""
    ends = ends.copy()
    order = np.argsort(cost, kind="stable")
    for rank, case in enumerate(order):
        if ends[case] != case:
            continue
        for other in order[:rank]:
            if ends[other] == other and np.max(np.abs(place[case] - place[other])) < meet:
                ends[case] = other
                break
    return ends
