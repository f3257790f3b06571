"""Levenberg–Marquardt, made for batches: one evaluation of residual and exact Jacobian a step, safe against NaN.

jaxopt has one, too. It evaluates the residual three times a step where this one does once, a NaN in one trial step ends
it for good, and it stops by the gradient's size alone, which says nothing without a scale.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

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
    """A minimum: place, shape (n,); half the sum of squares there; its normal matrix JᵀJ, shape (n, n); what else the
    residual told there; steps taken; whether it converged."""

    place: jax.Array
    cost: jax.Array
    normal: jax.Array
    told: Any
    steps: jax.Array
    converged: jax.Array


Lead = Callable[[jax.Array, Any], tuple[jax.Array, Any]]
"""From a gradient and a memory to a step, shape (n,), and the memory after it: as optax has them."""


def minimum(
    residual: Callable[[jax.Array], tuple[jax.Array, Any]],
    start: jax.Array,
    free: jax.Array,
    farthest: float,
    lead: Lead,
    memory: Any,
    led: jax.Array | int,
    steps: jax.Array | int,
) -> Least:
    """Least squares of `residual`, which returns it, shape (m,), and whatever else it tells. For jit and vmap.

    Args:
      start: shape (n,). free: which of its coordinates move, shape (n,). farthest: all stay within ± this of 0.
      lead, memory: another rule that goes first, and its memory at the start; led: for how many steps.
      steps: of Levenberg–Marquardt after that, at most. With none of both it evaluates the start.

    One loop does both, because every evaluation written down is compiled once more.
    """

    def at(u: jax.Array) -> tuple[jax.Array, ...]:
        def twice(v: jax.Array):
            r, told = residual(v)
            return r, (r, told)

        J, (r, told) = jax.jacfwd(twice, has_aux=True)(u)
        return 0.5 * jnp.vdot(r, r), J.T @ r, J.T @ J, told

    def step(state):
        u, cost, gradient, normal, told, damping, move, memory, k, _ = state
        expected = -(jnp.vdot(gradient, move) + 0.5 * jnp.vdot(move, normal @ move))
        new = u + move, *at(u + move)
        leading = k < led
        better = ~(new[1] >= cost) | leading
        good = better & ~(cost - new[1] < 0.25 * expected)
        relaxed = jnp.where(good & (k > led), jnp.where(damping > 1e-9, 0.1 * damping, 0.0), damping)
        damping = jnp.where(better, relaxed, jnp.maximum(10.0 * damping, 1e-4))
        tiny = (jnp.max(jnp.abs(move)) < TOLERANCE) | (expected <= ROUNDING * cost)
        done = (k > led) & (tiny | (damping > 1e9))
        old = u, cost, gradient, normal, told
        u, cost, gradient, normal, told = jax.tree.map(lambda a, b: jnp.where(better, a, b), new, old)
        scale = jnp.maximum(jnp.diag(normal), 1e-12 * jnp.max(jnp.diag(normal)) + 1e-300)
        inward = free & ((u < farthest) | (gradient > 0.0)) & ((u > -farthest) | (gradient < 0.0))
        both = inward[:, None] & inward[None, :]
        matrix = jnp.where(both, normal, 0.0) + jnp.diag(jnp.where(inward, damping * scale, 1.0))
        move = jnp.linalg.solve(matrix, jnp.where(inward, -gradient, 0.0))
        other, memory = lead(gradient, memory)
        move = jnp.where(leading, jnp.where(free, other, 0.0), move)
        move = jnp.clip(u + jnp.clip(move, -LONGEST, LONGEST), -farthest, farthest) - u
        return u, cost, gradient, normal, told, damping, move, memory, k + 1, done

    def unfinished(state):
        return ~state[-1] & (state[-2] <= led + steps)

    n = start.shape[0]
    shape = jax.eval_shape(residual, start)[1]
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shape)
    first = start, jnp.asarray(jnp.inf), jnp.zeros(n), jnp.zeros((n, n)), blank
    state = *first, jnp.asarray(1e-3), jnp.zeros(n), memory, jnp.asarray(0), jnp.asarray(False)
    u, cost, _, normal, told, *_, k, done = jax.lax.while_loop(unfinished, step, state)
    return Least(u, cost, normal, told, k - 1, done)
