"""Pressing a gap together: projected gradient on cell forces, in the half-space's own metric.

Minimise ½ f·W f + f·gap over f ≥ 0 with Σf = load. A gradient is the displaced gap over its mean; measured in forces
by about the inverse of W it points almost at the answer, on any grid. Steps along it, conjugate to the one before, are
as long as pays and end projected on f ≥ 0, Σf = load (Polonsky & Keer 1999; Bertsekas 1982 for the two metrics).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from difftrb.contact import halfspace
from difftrb.contact.gap import Cells
from difftrb.contact.halfspace import Operator
from difftrb.core import implicit
from difftrb.core.geometry import Real

TOLERANCE = 1e-11
"""Largest violation of the contact conditions, relative to the approach, at which a solve counts as converged."""
GOAL = 1e-12
"""The violation at which a solve ends: a step or two more than it must, so that differences of answers are smooth."""
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
    return implicit.pressed(press_from, _respond, guess, matrix, gap, jnp.asarray(load))


def first_guess(area: jax.Array, gap: jax.Array, level: Real) -> jax.Array:
    """Forces to begin with, in any unit: half-ellipses where the gap is below `level` [mm], if it anywhere is."""
    force = jnp.sqrt(jnp.maximum(level - gap, 0.0)) * area
    return jax.lax.stop_gradient(jnp.where(jnp.any(force > 0.0), force, area))


def press_from(guess: jax.Array, matrix: Operator, gap: jax.Array, load: jax.Array) -> implicit.Pressed:
    """The same from given forces, without derivatives."""
    share, length, W, g = scaled(guess, matrix, gap, load)
    step, start = descent(W, g, share)

    def unfinished(state: Descent):
        return (state.residual > GOAL) & (state.count < STEPS)

    end = jax.lax.while_loop(unfinished, step, start)
    approach, residual = violation(end.force, W.displacement(end.force) + g)
    return end.force * load, approach * length, residual, (end.products + 2).astype(float)


class Scaled(NamedTuple):
    """A contact whose forces sum to 1 and whose approach is about 1: first forces, what a unit of displacement is in
    [mm], influence, gap."""

    share: jax.Array
    length: jax.Array
    W: Operator
    gap: jax.Array


def scaled(guess: jax.Array, matrix: Operator, gap: jax.Array, load: jax.Array) -> Scaled:
    """The contact in units of its own."""
    share = guess / jnp.sum(guess)
    length = jnp.vdot(share, load * matrix.displacement(share) + gap)
    return Scaled(share, length, matrix.scaled(load / length), gap / length)


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


class Descent(NamedTuple):
    """Where projected gradient is: forces, W forces, the cells that may change, gradient and direction there, the
    gradient's square in the metric (0: begin anew), violation, steps and applications of W so far."""

    force: jax.Array
    lifted: jax.Array
    free: jax.Array
    gradient: jax.Array
    direction: jax.Array
    square: jax.Array
    residual: jax.Array
    count: jax.Array
    products: jax.Array


def descent(W: Operator, gap: jax.Array, force: jax.Array) -> tuple[Callable[[Descent], Descent], Descent]:
    """One step of projected gradient, and the state it begins with at `force`.

    Loaded cells and those that overlap are free. The direction is conjugate to the last one unless that ended on
    f ≥ 0 or other cells were free.
    """
    even = jnp.broadcast_to(1.0 / W.diagonal, force.shape)
    measure = W.resistance()

    def step(state: Descent) -> Descent:
        f, lifted = state.force, state.lifted
        displaced = lifted + gap
        free = (f > 0.0) | (displaced < jnp.average(displaced, weights=jnp.where(f > 0.0, even, 0.0)))
        balance, answer = balanced(measure, free, even)
        r = balance(displaced)
        z = answer(r)
        square = jnp.vdot(r, z)
        again = jnp.all(free == state.free) & (state.square > 0.0)
        turn = jnp.maximum(square - jnp.vdot(z, state.gradient), 0.0) / jnp.where(again, state.square, 1.0)
        p = z + jnp.where(again, turn, 0.0) * state.direction
        Wp = W.displacement(p)
        length = jnp.vdot(r, p) / jnp.vdot(p, Wp)
        trial = f - length * p
        clipped = jnp.any(trial < 0.0)

        def bent():
            new = project(trial, 1.0 / even)
            return new, W.displacement(new)

        new, lifted = jax.lax.cond(clipped, bent, lambda: (trial, lifted - length * Wp))
        residual = violation(new, lifted + gap)[1]
        square = jnp.where(clipped, 0.0, square)
        return Descent(new, lifted, free, r, p, square, residual, state.count + 1, state.products + 1 + clipped)

    lifted, none = W.displacement(force), jnp.zeros_like(force)
    residual = violation(force, lifted + gap)[1]
    return step, Descent(
        force, lifted, force > 0.0, none, none, jnp.zeros(()), residual, jnp.asarray(0), jnp.asarray(1)
    )


Linear = Callable[[jax.Array], jax.Array]


def balanced(measure: Linear, free: jax.Array, even: jax.Array) -> tuple[Linear, Linear]:
    """On the `free` cells: displacements less their mean, and the force, without a sum, that answers such.

    Both means weigh by `even`: what is left of the symmetric `measure` is symmetric.
    """
    even = jnp.where(free, even, 0.0)
    even = even / jnp.sum(even)

    def balance(displaced: jax.Array) -> jax.Array:
        return jnp.where(free, displaced - jnp.sum(even * displaced), 0.0)

    def answer(balanced: jax.Array) -> jax.Array:
        force = jnp.where(free, measure(balanced), 0.0)
        return force - even * jnp.sum(force)

    return balance, answer


# ------------------------------------------------------------------------------------------- linear answer


def _conjugate_gradient(W: Operator, loaded: jax.Array, right: jax.Array) -> tuple[jax.Array, jax.Array]:
    """(w, μ) with W w = right + μ on the loaded cells and Σw = 0: conjugate gradients in the same metric."""
    even = jnp.broadcast_to(1.0 / W.diagonal, right.shape)
    balance, answer = balanced(W.resistance(), loaded, even)

    def step(state):
        w, r, p, square, k = state
        Wp = W.displacement(p)
        length = square / jnp.vdot(p, Wp)
        r = balance(r - length * Wp)
        z = answer(r)
        new = jnp.vdot(r, z)
        return w + length * p, r, z + (new / square) * p, new, k + 1

    def unfinished(state):
        *_, square, k = state
        return (square > 1e-24 * first) & (square > 1e-30 * jnp.sum(jnp.where(loaded, even, 0.0))) & (k < STEPS)

    r = balance(right)
    p = answer(r)
    first = jnp.vdot(r, p)
    w, *_ = jax.lax.while_loop(unfinished, step, (jnp.zeros_like(r), r, p, first, jnp.asarray(0)))
    return w, jnp.average(W.displacement(w) - right, weights=jnp.where(loaded, even, 0.0))


def _respond(W: Operator, loaded: jax.Array, right: jax.Array | None) -> tuple[jax.Array, jax.Array]:
    """The linear answer of the loaded cells, as `implicit.pressed` asks for it."""
    if right is not None:
        return _conjugate_gradient(W, loaded, right)
    even = jnp.where(loaded, 1.0 / W.diagonal, 0.0)
    even = even / jnp.sum(even)
    displaced = W.displacement(even)
    correction, _ = _conjugate_gradient(W, loaded, -displaced)
    per_load = even + correction
    return per_load, jnp.vdot(per_load, W.displacement(per_load))
