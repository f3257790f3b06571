"""Which unknowns carry load: the fixed point of a projected gradient, found by its own semismooth Newton steps.

Minimise ½ w·A w + g·w over w ≥ 0 with m·w = load. With δ the multiplier of the load, its solution is the fixed point of
w ↦ P(w − M (A w + g − δ m)) for every diagonal M > 0, P the projection onto w ≥ 0. The map's Jacobian is known: it
keeps unknowns whose argument is positive. Newton's step is then a linear solve on them (the primal–dual active set of
Hintermüller, Ito & Kunisch 2003), and ends at the fixed point itself when the set stays as it is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import loops

TOUCHING = 1e-9  # overlap by the approach that an unknown without load may have


class Quadratic(NamedTuple):
    """½ w·A w + g·w on m·w = load: `matrix` (n, n), `gap` (n,), `weight` (n,), `load`."""

    matrix: Any
    gap: Any
    weight: Any
    load: Any


class Response(NamedTuple):
    """Loads (n,), their change by load (n,), the approach and its change by load."""

    loads: Any
    by_load: Any
    approach: Any
    compliance: Any


def on_set(problem: Quadratic, active: Any) -> Response:
    """The minimum where only `active` unknowns, (n,), may carry load, of either sign."""
    matrix, gap, weight, load = problem
    if xp.module_of(matrix, gap, load) is np:  # only these: a large part is often not
        chosen = np.flatnonzero(active)
        right = np.stack([weight[chosen], -gap[chosen]], axis=1)
        by_weight, by_gap = np.zeros((2, gap.size))
        by_weight[chosen], by_gap[chosen] = xp.solved(matrix[np.ix_(chosen, chosen)], right).T
    else:
        scale = xp.where(active, 1.0 / xp.sqrt(xp.maximum(xp.abs(xp.diagonal(matrix)), 1e-300)), 0.0)
        scaled = scale[:, None] * matrix * scale[None] + xp.diag(xp.where(active, 0.0, 1.0))
        right = scale[:, None] * xp.stack([weight, -gap], axis=1)
        by_weight, by_gap = (scale[:, None] * xp.solved(scaled, right)).T
    compliance = 1.0 / xp.vdot(weight, by_weight)
    approach = (load - xp.vdot(weight, by_gap)) * compliance
    return Response(approach * by_weight + by_gap, compliance * by_weight, approach, compliance)


def solve(problem: Quadratic, active: Any, rounds: int) -> tuple[Response, Any, Any]:
    """The fixed point from a first guess of the `active` set, (n,); the set; and whether it stood still.

    At most `rounds` steps.
    """
    matrix, gap, weight, _ = problem

    def step(state: tuple) -> tuple:
        active, _, count, _ = state
        found = on_set(problem, active)
        residual = matrix @ found.loads + gap - found.approach * weight
        # sign of w − M∇E: on the set the gradient vanishes, off it w does
        chosen = xp.where(active, found.loads > 0.0, residual < -TOUCHING * xp.magnitude(found.approach) * weight)
        return chosen, found, count + 1, xp.all(chosen == active)

    def going(state: tuple) -> Any:
        return ~state[3] & (state[2] < rounds)

    zero, none = np.zeros(gap.shape), np.zeros(())
    begun = active, Response(zero, zero, none, none), 0, np.asarray(False)
    active, found, _, still = loops.repeated_while(going, step, begun)
    return found, active, still
