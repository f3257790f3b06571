"""Which unknowns carry load: the fixed point of a projected gradient, found by its own semismooth Newton steps.

Minimise ½ w·A w + g·w over w ≥ 0 with m·w = load. With δ the multiplier of the load, its solution is the fixed point of
w ↦ P(w − M (A w + g − δ m)) for every diagonal M > 0, P the projection onto w ≥ 0. The map's Jacobian is known: it
keeps unknowns whose argument is positive. Newton's step is then a linear solve on them (the primal–dual active set of
Hintermüller, Ito & Kunisch 2003), and ends at the fixed point itself when the set stays as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

TOUCHING = 1e-9  # overlap by the approach that an unknown without load may have


class Quadratic(NamedTuple):
    """½ w·A w + g·w on m·w = load: `matrix` (n, n), `gap` (n,), `weight` (n,), `load`."""

    matrix: jax.Array
    gap: jax.Array
    weight: jax.Array
    load: jax.Array


class Response(NamedTuple):
    """Loads (n,), their change by load (n,), the approach and its change by load."""

    loads: jax.Array
    by_load: jax.Array
    approach: jax.Array
    compliance: jax.Array


def on_set(problem: Quadratic, active: jax.Array) -> Response:
    """The minimum where only `active` unknowns, (n,), may carry load, of either sign."""
    matrix, gap, weight, load = problem
    scale = jnp.where(active, 1.0 / jnp.sqrt(jnp.maximum(jnp.abs(jnp.diagonal(matrix)), 1e-300)), 0.0)
    scaled = scale[:, None] * matrix * scale[None] + jnp.diag(jnp.where(active, 0.0, 1.0))
    right = scale[:, None] * jnp.stack([weight, -gap], axis=1)
    by_weight, by_gap = (scale[:, None] * jnp.linalg.solve(scaled, right)).T
    compliance = 1.0 / jnp.vdot(weight, by_weight)
    approach = (load - jnp.vdot(weight, by_gap)) * compliance
    return Response(approach * by_weight + by_gap, compliance * by_weight, approach, compliance)


def solve(problem: Quadratic, active: jax.Array, rounds: int) -> tuple[Response, jax.Array, jax.Array]:
    """The fixed point from a first guess of the `active` set, (n,); the set; and whether it stood still.

    At most `rounds` steps.
    """
    matrix, gap, weight, _ = problem

    def step(state: tuple) -> tuple:
        active, _, count, _ = state
        found = on_set(problem, active)
        residual = matrix @ found.loads + gap - found.approach * weight
        # sign of w − M∇E: on the set the gradient vanishes, off it w does
        chosen = jnp.where(active, found.loads > 0.0, residual < -TOUCHING * found.approach * weight)
        return chosen, found, count + 1, jnp.all(chosen == active)

    def going(state: tuple) -> jax.Array:
        return ~state[3] & (state[2] < rounds)

    zero = jnp.zeros_like(gap)
    nothing = Response(zero, zero, jnp.zeros(()), jnp.zeros(()))
    active, found, _, still = jax.lax.while_loop(going, step, (active, nothing, 0, jnp.asarray(False)))
    return found, active, still
