"""Levenberg–Marquardt, made for batches: one evaluation of residual and exact Jacobian a step, safe against NaN.

jaxopt has one, too. It evaluates the residual three times a step where this one does once, a NaN in one trial step ends
it for good, and it stops by the gradient's size alone, which says nothing without a scale.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

STEPS = 40
TOLERANCE = 1e-9
"""Of coordinates: a step shorter than this ends it."""
LONGEST = 2.0
"""Longest step of one coordinate."""
ROUNDING = 1e-13
"""Relative gain of the sum of squares below which there is nothing left to gain."""


class Least(NamedTuple):
    """A minimum: place, shape (n,); half the sum of squares there; its gradient, shape (n,); steps taken; whether it
    converged."""

    place: jax.Array
    cost: jax.Array
    gradient: jax.Array
    steps: jax.Array
    converged: jax.Array


def minimum(residual: Callable[[jax.Array], jax.Array], start: jax.Array, farthest: float, steps: int = STEPS) -> Least:
    """Least squares of `residual`, shape (m,), from `start`, shape (n,), within ± `farthest` of 0. For jit and vmap."""

    def at(u: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        J, r = jax.jacfwd(lambda v: (residual(v),) * 2, has_aux=True)(u)
        return 0.5 * jnp.vdot(r, r), J.T @ r, J.T @ J

    def step(state):
        u, cost, gradient, normal, damping, move, k, _ = state
        expected = -(jnp.vdot(gradient, move) + 0.5 * jnp.vdot(move, normal @ move))
        new = u + move, *at(u + move)
        better = ~(new[1] >= cost)
        good = better & ~(cost - new[1] < 0.25 * expected)
        relaxed = jnp.where(good, jnp.where(damping > 1e-9, 0.1 * damping, 0.0), damping)
        damping = jnp.where(better, relaxed, jnp.maximum(10.0 * damping, 1e-4))
        tiny = (jnp.max(jnp.abs(move), initial=0.0) < TOLERANCE) | (expected <= ROUNDING * cost)
        done = (k > 0) & (tiny | (damping > 1e9))
        u, cost, gradient, normal = (jnp.where(better, a, b) for a, b in zip(new, state[:4], strict=True))
        scale = jnp.maximum(jnp.diag(normal), 1e-12 * jnp.max(jnp.diag(normal), initial=0.0) + 1e-300)
        inward = ((u < farthest) | (gradient > 0.0)) & ((u > -farthest) | (gradient < 0.0))
        free = inward[:, None] & inward[None, :]
        matrix = jnp.where(free, normal, 0.0) + jnp.diag(jnp.where(inward, damping * scale, 1.0))
        move = jnp.linalg.solve(matrix, jnp.where(inward, -gradient, 0.0))
        move = jnp.clip(u + jnp.clip(move, -LONGEST, LONGEST), -farthest, farthest) - u
        return u, cost, gradient, normal, damping, move, k + 1, done

    def unfinished(state):
        return ~state[-1] & (state[-2] <= steps)

    n = start.shape[0]
    zero = jnp.zeros(n)
    state = (
        start,
        jnp.asarray(jnp.inf),
        zero,
        jnp.zeros((n, n)),
        jnp.asarray(1e-3),
        zero,
        jnp.asarray(0),
        jnp.asarray(False),
    )
    u, cost, gradient, _, _, _, k, done = jax.lax.while_loop(unfinished, step, state)
    return Least(u, cost, gradient, k - 1, done)
