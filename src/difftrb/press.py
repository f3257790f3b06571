"""Pressing a gap together: the projected-gradient fixed point on cell forces, and its exact finish.

Minimise ½ f·W f + f·gap over f ≥ 0 with Σf = load. Projected gradient finds which cells carry load; conjugate
gradients give the exact forces on those; the two alternate until no cell is in tension and no two surfaces overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

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
    guess = first_guess(area, gap, level)
    return implicit.pressed(halfspace.displacement, _press, _respond, guess, matrix, gap, jnp.asarray(load))


class Guess(NamedTuple):
    """Forces to begin with, and how much force to expect of every cell, nowhere 0; both in any unit.

    They change the path, not the answer. What is expected shapes the metric of the projected gradient.
    """

    force: jax.Array
    expected: jax.Array


def first_guess(area: jax.Array, gap: jax.Array, level: Real) -> Guess:
    """A half-ellipse where the gap is below `level` [mm], everywhere if it nowhere is; a bell about it is expected."""
    force = jnp.sqrt(jnp.maximum(level - gap, 0.0)) * area
    higher = (gap - jnp.min(gap, axis=1, keepdims=True)) / level
    bell = area * jnp.exp(-(jnp.minimum(higher, 1.5) ** 2))
    return jax.lax.stop_gradient(Guess(jnp.where(jnp.any(force > 0.0), force, area), bell))


def _press(guess: Guess, matrix: Operator, gap: jax.Array, load: jax.Array) -> implicit.Pressed:
    share, length, W, g, metric, reachable = scaled(guess, matrix, gap, load)

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

    start = (share, jnp.asarray(jnp.inf), jnp.asarray(2), 0, jnp.asarray(HANDOVER))
    force, residual, count, _, _ = jax.lax.while_loop(unfinished, attempt, start)
    approach = violation(force, halfspace.displacement(W, force) + g)[0]
    return force * load, approach * length, residual, count.astype(float)


class Scaled(NamedTuple):
    """A contact whose forces sum to 1 and whose approach is about 1: first forces, what a unit of displacement is in
    [mm], influence, gap, metric of the projected gradient, and the gap with cells out of reach removed from it."""

    share: jax.Array
    length: jax.Array
    W: Operator
    gap: jax.Array
    metric: jax.Array
    reachable: jax.Array


def scaled(guess: Guess, matrix: Operator, gap: jax.Array, load: jax.Array) -> Scaled:
    """The contact in units of its own."""
    share = guess.force / jnp.sum(guess.force)
    length = jnp.vdot(share, load * halfspace.displacement(matrix, share) + gap)
    W = matrix.scaled(load / length)
    g = gap / length
    near = g < 1.5
    expected = jnp.where(near, guess.expected * jnp.maximum(1.15 - g, 0.05), 0.0)
    return Scaled(share, length, W, g, metric_for(W, expected), jnp.where(near, g, 1e6))


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


def metric_for(W: Operator, expected: jax.Array) -> jax.Array:
    """A diagonal metric in which a full step of projected gradient is safe, for cells expected to carry force.

    With any v > 0, diag(W v/v) − W has v in its null space and no positive entry off the diagonal: it is positive
    semi-definite, and a step never overshoots (Schur's test). The closer v is to the forces that come out, the longer
    the steps where force is; `expected` is v, and 0 on cells out of reach.
    """
    there = expected > 0.0
    return jnp.where(there, halfspace.displacement(W, expected) / jnp.where(there, expected, 1.0), W.diagonal)


def project_gradient(
    W: Operator, metric: jax.Array, gap: jax.Array, force: jax.Array, goal: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Accelerated projected gradient until the violation meets `goal`; the forces and the number of steps.

    The fixed point of f → project(f − (W f + gap)/metric).
    """

    def unfinished(state: Descent):
        return (state.residual > goal) & (state.count < STEPS)

    step, start = descent(W, metric, gap, force)
    end = jax.lax.while_loop(unfinished, step, start)
    return end.force, end.count + 1


class Descent(NamedTuple):
    """Where accelerated projected gradient is: forces, W forces, the same of the extrapolated point, momentum's age,
    violation, steps so far."""

    force: jax.Array
    lifted: jax.Array
    ahead: jax.Array
    lifted_ahead: jax.Array
    age: jax.Array
    residual: jax.Array
    count: jax.Array


def descent(
    W: Operator, metric: jax.Array, gap: jax.Array, force: jax.Array
) -> tuple[Callable[[Descent], Descent], Descent]:
    """One step of accelerated projected gradient, and the state it begins with at `force`.

    Momentum restarts when it points uphill (O'Donoghue & Candès 2015).
    """

    def step(state: Descent) -> Descent:
        f, Wf, y, Wy, t, _, k = state
        new = project(y - (Wy + gap) / metric, metric)
        W_new = halfspace.displacement(W, new)
        uphill = jnp.sum(metric * (y - new) * (new - f)) > 0.0
        t_new = jnp.where(uphill, 1.0, 0.5 * (1.0 + jnp.sqrt(1.0 + 4.0 * t * t)))
        momentum = jnp.where(uphill, 0.0, (t - 1.0) / t_new)
        y_new, Wy_new = new + momentum * (new - f), W_new + momentum * (W_new - Wf)
        return Descent(new, W_new, y_new, Wy_new, t_new, violation(new, W_new + gap)[1], k + 1)

    Wf = halfspace.displacement(W, force)
    start = Descent(force, Wf, force, Wf, jnp.ones(()), violation(force, Wf + gap)[1], jnp.asarray(0))
    return step, start


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
