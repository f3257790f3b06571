"""Pressing a gap together: the projected-gradient fixed point on cell forces, and its exact finish.

Minimise ½ f·W f + f·gap over f ≥ 0 with Σf = load. Projected gradient finds which cells carry load; conjugate
gradients give the exact forces on those; the two alternate until no cell is in tension and no two surfaces overlap.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from difftrb import halfspace, implicit
from difftrb.geometry import Real
from difftrb.halfspace import Cells, Operator

TOLERANCE = 1e-11
"""Largest violation of the contact conditions, relative to the approach, at which a solve counts as converged."""
HANDOVER = 1e-3
"""Violation at which projected gradient first hands over to the exact finish."""
ROUNDS = 12
STEPS = 400


def press(cells: Cells, modulus: Real, gap: jax.Array, load: Real, level: Real) -> implicit.Pressed:
    """Cell forces [N], approach [mm], residual and applications of the influence matrix, for a load on any gap.

    Args:
      cells: the grid. modulus: E' [N/mm²]. gap: initial gap, shape (rows, columns) [mm]. load: [N].
      level: gap up to which the first guess puts pressure [mm]; it changes the path, not the answer.

    Derivatives come from `implicit.pressed`: one linear solve, forward and reverse.
    """
    return press_by(halfspace.influence(cells, jnp.asarray(modulus)), cells.area, gap, load, level)


def press_by(matrix: Operator, area: jax.Array, gap: jax.Array, load: Real, level: Real) -> implicit.Pressed:
    """The same by any operator of a half-space; `area` of the cells [mm²], shape (rows, columns)."""
    guess = jnp.sqrt(jnp.maximum(level - gap, 0.0)) * area
    guess = jax.lax.stop_gradient(jnp.where(jnp.any(guess > 0.0), guess, area))
    return implicit.pressed(halfspace.displacement, _press, _respond, guess, matrix, gap, jnp.asarray(load))


def _press(guess: jax.Array, matrix: Operator, gap: jax.Array, load: jax.Array) -> implicit.Pressed:
    share = guess / jnp.sum(guess)
    length = jnp.vdot(share, load * halfspace.displacement(matrix, share) + gap)
    W = matrix.scaled(load / length)  # forces sum to 1, the approach is about 1
    g = gap / length
    metric = _metric(W, g < 1.5)
    reachable = jnp.where(g < 1.5, g, 1e6)

    def attempt(state):
        force, _, count, rounds, goal = state
        force, used = project_gradient(W, metric, reachable, force, goal)
        exact, more = _exact(W, g, force)
        before = violation(force, halfspace.displacement(W, force) + g)[1]
        after = violation(exact, halfspace.displacement(W, exact) + g)[1]
        better = after < before
        residual = jnp.where(better, after, before)
        return jnp.where(better, exact, force), residual, count + used + more + 2, rounds + 1, 0.1 * residual

    def unfinished(state):
        _, residual, _, rounds, _ = state
        return (residual > TOLERANCE) & (rounds < ROUNDS)

    start = (share, jnp.asarray(jnp.inf), jnp.asarray(6), 0, jnp.asarray(HANDOVER))
    force, residual, count, _, _ = jax.lax.while_loop(unfinished, attempt, start)
    approach = violation(force, halfspace.displacement(W, force) + g)[0]
    return force * load, approach * length, residual, count.astype(float)


def violation(force: jax.Array, displaced: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Approach, and the largest violation of the contact conditions relative to it, given W f + gap."""
    approach = jnp.vdot(force, displaced) / jnp.sum(force)
    error = displaced - approach
    worst = jnp.max(jnp.where(force > 0.0, jnp.abs(error), jnp.maximum(-error, 0.0)))
    return approach, worst / approach


# ------------------------------------------------------------------------------------------ projected gradient


def project(trial: jax.Array, weight: jax.Array) -> jax.Array:
    """The point of the simplex f ≥ 0, Σf = 1 nearest to `trial` in the metric diag(weight).

    f = max(0, trial + λ/weight); Newton's method on the convex, piecewise linear Σf(λ) = 1 ends after few steps.
    """

    def newton(state):
        shift, _, k = state
        moved = trial + shift / weight
        excess = jnp.sum(jnp.maximum(moved, 0.0)) - 1.0
        step = excess / jnp.sum(jnp.where(moved > 0.0, 1.0 / weight, 0.0))
        return shift - step, jnp.abs(step), k + 1

    def unfinished(state):
        shift, step, k = state
        return (step > 1e-14 * jnp.abs(shift)) & (k < 40)

    highest = (1.0 - jnp.min(trial)) * jnp.max(weight)  # every cell positive, the sum too large: Newton descends
    shift, _, _ = jax.lax.while_loop(unfinished, newton, (highest, jnp.asarray(jnp.inf), 0))
    return jnp.maximum(trial + shift / weight, 0.0)


def _metric(W: Operator, possible: jax.Array) -> jax.Array:
    """W's diagonal times an upper bound of the largest eigenvalue of W in that metric, on the `possible` cells."""
    ones = jnp.where(possible, 1.0, 0.0)

    def power(_: int, v: jax.Array) -> jax.Array:
        u = ones * halfspace.displacement(W, v) / W.diagonal
        return u / jnp.max(u)

    v = jax.lax.fori_loop(0, 4, power, ones)
    ratio = halfspace.displacement(W, v) / (W.diagonal * jnp.where(possible, v, 1.0))
    return W.diagonal * jnp.max(ones * ratio)  # Collatz–Wielandt: W and v are positive


def project_gradient(
    W: Operator, metric: jax.Array, gap: jax.Array, force: jax.Array, goal: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Accelerated projected gradient until the violation meets `goal`; the forces and the number of steps.

    The fixed point of f → project(f − (W f + gap)/metric). Momentum restarts when it points uphill
    (O'Donoghue & Candès 2015).
    """

    def step(state):
        f, Wf, y, Wy, t, _, k = state
        new = project(y - (Wy + gap) / metric, metric)
        W_new = halfspace.displacement(W, new)
        uphill = jnp.sum(metric * (y - new) * (new - f)) > 0.0
        t_new = jnp.where(uphill, 1.0, 0.5 * (1.0 + jnp.sqrt(1.0 + 4.0 * t * t)))
        momentum = jnp.where(uphill, 0.0, (t - 1.0) / t_new)
        y_new, Wy_new = new + momentum * (new - f), W_new + momentum * (W_new - Wf)
        return new, W_new, y_new, Wy_new, t_new, violation(new, W_new + gap)[1], k + 1

    def unfinished(state):
        *_, residual, k = state
        return (residual > goal) & (k < STEPS)

    Wf = halfspace.displacement(W, force)
    start = (force, Wf, force, Wf, jnp.ones(()), violation(force, Wf + gap)[1], jnp.asarray(0))
    force, *_, count = jax.lax.while_loop(unfinished, step, start)
    return force, count + 1


# ------------------------------------------------------------------------------------------- exact forces


def _exact(W: Operator, gap: jax.Array, force: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Forces that meet the contact conditions on the loaded and the overlapping cells; tension is cut off."""
    displaced = halfspace.displacement(W, force) + gap
    approach = jnp.vdot(force, displaced) / jnp.sum(force)
    loaded = (force > 0.0) | (displaced < approach)
    correction, _, used = _conjugate_gradient(W, loaded, -displaced)
    new = jnp.maximum(force + correction, 0.0)
    return new / jnp.sum(new), used + 1


def _conjugate_gradient(W: Operator, loaded: jax.Array, right: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """(w, μ, iterations) with W w = right + μ on the loaded cells and Σw = 0: projected preconditioned CG."""
    inverse = jnp.where(loaded, 1.0 / W.diagonal, 0.0)

    def balanced(r: jax.Array) -> tuple[jax.Array, jax.Array]:
        level = jnp.sum(inverse * r) / jnp.sum(inverse)
        return level, jnp.where(loaded, r - level, 0.0)

    def step(state):
        w, r, mu, p, rz, k = state
        Wp = halfspace.displacement(W, p)
        a = rz / jnp.vdot(p, Wp)
        level, r = balanced(r - a * Wp)
        rz_new = jnp.vdot(r, inverse * r)
        return w + a * p, r, mu + level, inverse * r + (rz_new / rz) * p, rz_new, k + 1

    def unfinished(state):
        *_, rz, k = state
        return (rz > 1e-24 * first) & (rz > 1e-30 * jnp.sum(inverse)) & (k < STEPS)

    level, r = balanced(right)
    first = jnp.vdot(r, inverse * r)
    start = (jnp.zeros_like(r), r, level, inverse * r, first, jnp.asarray(0))
    w, _, mu, *_, k = jax.lax.while_loop(unfinished, step, start)
    return w, -mu, k


def _respond(W: Operator, loaded: jax.Array, right: jax.Array | None) -> tuple[jax.Array, jax.Array]:
    """The linear answer of the loaded cells, as `implicit.pressed` asks for it."""
    if right is not None:
        return _conjugate_gradient(W, loaded, right)[:2]
    even = jnp.where(loaded, 1.0 / W.diagonal, 0.0)
    even = even / jnp.sum(even)
    displaced = halfspace.displacement(W, even)
    correction, _, _ = _conjugate_gradient(W, loaded, -displaced)
    per_load = even + correction
    return per_load, jnp.vdot(per_load, halfspace.displacement(W, per_load))
