"""The contact as strips across it, each with its own free boundaries: spectral in x, piecewise linear in y.

Pressure is Σ hatᵢ(y) Σₘ aᵢₘ Tₘ(t)/(π b √(1−t²)), t = (x−c)/b: row i carries line load along the roller, its strip
reaches from l to r across it. Where a strip ends freely its pressure must fall to zero there, which fixes l and r;
at a spall's rolling edge it stays singular. No cell boundary is crossed when an edge moves, so nothing ripples.

1/r = (2/π) ∫ K₀(κ|y|) cos κx dκ makes the influence separable: Bessel functions of κb for every strip, and one
matrix of the rows for every κ that knows nothing of the strips (`strip_basis.products`). All lengths are in units of a
Hertz half-width, line loads in units of their mean, so that radius and modulus drop out.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import strip_fourier
from difftrb.contact.strip_fourier import MEETING, PLACES, Layout
from difftrb.core import implicit

TOLERANCE = 1e-7
PASSES = 60
SLACK = 3e-4  # overlap that strips away from edges bear without load, by the approach: else the last rows never settle
WAITING = 0.35  # size of an outline without load, as a share of its size at first
NEAR = 0.1  # last change of the ends below which Newton's method takes over
CLOSE, SHRINKING = 0.005, 0.1  # below this, and this times the one before, it does without a new Jacobian


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Problem:
    """The contact without units: x in b₀, y in b₀, line load in q₀, displacement in q₀/(πE').

    Attributes:
      products: of the rows at every frequency times its weight, shape (rows, rows, frequencies).
      mass: ∫ hat hat dy, shape (rows, rows). weight: ∫ hat dy, shape (rows,).
      gap: mean initial gap of the rows beside curvature, shape (rows,). left, right: the spall's rolling edges.
      load: Σ weight q.
    """

    products: jax.Array
    mass: jax.Array
    weight: jax.Array
    gap: jax.Array
    left: jax.Array
    right: jax.Array
    load: jax.Array


def _coupling(layout: Layout, problem: Problem) -> jax.Array:
    """The rows' products for all pairs of strips and all z, shape (strips, strips, z)."""
    rows = np.asarray(layout.rows)
    sharp, crossed = sum(singular for *_, singular in PLACES), 2 * len(MEETING)
    signs = np.ones(1) if layout.even else np.repeat([1.0, -1.0], [sharp + len(PLACES) + crossed, crossed])
    parts = [problem.products] * (1 if layout.even else 2)
    full = jnp.concatenate([*parts, problem.mass[..., None] * signs[None, None]], axis=-1)
    if np.array_equal(rows, np.arange(full.shape[0])):
        return full
    return full[rows][:, rows]


Unknowns = tuple[jax.Array, jax.Array, jax.Array]
"""Mode loads (strips, modes), ends of the outlines (outlines, 2; half widths (outlines, 1) if even), approach."""
Choice = tuple[jax.Array, jax.Array, jax.Array]
"""Of the outlines: which are loaded, (outlines,); which ends do not move, like the ends; which are as narrow as can be,
beside a bound of their low (−1) or high (1) end, (outlines,), else 0."""


def _contact(
    layout: Layout, x: Unknowns, problem: Problem, coupling: jax.Array
) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    """How far each mode is from lying on the other body, (strips, modes); and the waves, their derivatives by the ends,
    and that of the former by a strip's own ends."""
    loads, outline, approach = x
    rows = np.asarray(layout.rows)
    ends = outline[np.asarray(layout.outlines)]
    wave, by_ends = strip_fourier.waves(layout, ends)
    field = jnp.einsum("ijz,jz->iz", coupling, jnp.einsum("jm,jmz->jz", loads, wave)) / problem.weight[rows][:, None]
    gap, gap_by_ends = strip_fourier.gaps(layout, ends, problem.gap[rows])
    residual = jnp.einsum("iz,imz->im", field, wave) + gap - approach * np.eye(1, layout.modes)
    return residual, (wave, by_ends, jnp.einsum("iz,iemz->ime", field, by_ends) + gap_by_ends)


def _equations(layout: Layout, x: Unknowns, choice: Choice, problem: Problem, residual: jax.Array) -> jax.Array:
    """All equations: contact of loaded strips, no load on others, pressure zero at free ends (those that are not held),
    the sum of loads."""
    loads, (active, held, _) = x[0], choice
    on, fixed = active[np.asarray(layout.outlines)][:, None], held | ~active[:, None]
    total = jnp.vdot(problem.weight[np.asarray(layout.rows)], loads[:, 0]) - problem.load
    at_ends = _shares(layout, problem) @ loads @ strip_fourier.signs(layout).T
    return jnp.concatenate([
        jnp.where(on, residual, loads).ravel(), jnp.where(fixed, 0.0, at_ends).ravel(), total[None]
    ])  # fmt: skip


def _jacobian(
    layout: Layout, loads: jax.Array, choice: Choice, problem: Problem, coupling: jax.Array,
    parts: tuple[jax.Array, ...],
) -> jax.Array:  # fmt: skip
    """Of the equations by all unknowns."""
    (active, held, _), (wave, by_ends, own) = choice, parts
    (strips, n), (outlines, k) = loads.shape, (len(layout.sides), by_ends.shape[1])
    a, e = strips * n, outlines * k
    member, weight = layout.member, problem.weight[np.asarray(layout.rows)]
    moved = jnp.einsum("jm,jemz->jez", loads, by_ends)
    pulled = jnp.concatenate([wave, moved], axis=1)  # (strips, modes + ends, z)
    pushed = coupling[:, :, None, :] * (wave / weight[:, None, None])[None]
    matrix = jax.lax.dot_general(pushed.reshape(strips, a, -1), pulled, (((2,), (2,)), ((0,), (0,))))
    matrix = matrix.reshape(strips, strips, n, n + k).transpose(1, 2, 0, 3)
    by_end = jnp.einsum("imje,jo->imoe", matrix[..., n:], member) + own[:, :, None] * member[:, None, :, None]
    on = active[np.asarray(layout.outlines)][:, None]
    fixed = (held | ~active[:, None])[:, :, None, None]
    no_load = np.eye(a).reshape(strips, n, strips, n)
    at_ends = _shares(layout, problem)[:, None, :, None] * strip_fourier.signs(layout)[None, :, None, :]
    total = (weight[:, None] * np.eye(1, n)).reshape(1, a)
    return jnp.block([
        [jnp.where(on[..., None, None], matrix[..., :n], no_load).reshape(a, a),
         jnp.where(on[..., None, None], by_end, 0.0).reshape(a, e), jnp.where(on, -np.eye(1, n), 0.0).reshape(a, 1)],
        [jnp.where(fixed, 0.0, at_ends).reshape(e, a),
         jnp.where(fixed, np.eye(e).reshape(outlines, k, outlines, k), 0.0).reshape(e, e), jnp.zeros((e, 1))],
        [total, jnp.zeros((1, e + 1))],
    ])  # fmt: skip


def _shares(layout: Layout, problem: Problem) -> jax.Array:
    """Of each strip in its outline by the length of its row, shape (outlines, strips)."""
    weight = jnp.asarray(layout.member.T) * problem.weight[np.asarray(layout.rows)][None]
    return weight / jnp.sum(weight, axis=1, keepdims=True)


def solve(layout: Layout, problem: Problem, start: jax.Array) -> tuple[Unknowns, jax.Array, jax.Array, jax.Array]:
    """Unknowns, which strips are loaded, last change of the ends and number of passes.

    `start`: ends of the outlines to begin with, (outlines, 2). Differentiable by `problem`.
    """
    x, (choice, change, count) = implicit.factored_root(
        partial(_residual, layout), partial(_search, layout), problem, start
    )
    return x, choice[0][np.asarray(layout.outlines)], change, count


def _residual(layout: Layout, x: Unknowns, choice: Choice, problem: Problem) -> jax.Array:
    """The equations as functions of the problem, with held ends where the spall's edges hold them."""
    residual, _ = _contact(layout, x, problem, _coupling(layout, problem))
    equations = _equations(layout, x, choice, problem, residual)
    if layout.even:
        return equations
    active, held, narrow = choice
    bound = strip_fourier.bounds(layout, problem.left, problem.right)
    off = jnp.where(held & active[:, None], x[1] - strip_fourier.places(layout, bound, narrow), 0.0)
    first = x[0].size
    return equations.at[first : first + x[1].size].add(off.ravel())


class Fixed(NamedTuple):
    """What stays the same during a search, and the outlines' ends when one has no load, (outlines, ends)."""

    layout: Layout
    problem: Problem
    coupling: jax.Array
    bound: jax.Array
    small: jax.Array


class State(NamedTuple):
    """A search after some passes: unknowns and choice; passes for which each outline stays without load; last change of
    the ends and whether it shrinks fast; passes so far; whether the last one factored the Jacobian, for which choice,
    and the factors."""

    x: Unknowns
    choice: Choice
    rest: jax.Array
    change: jax.Array
    near: jax.Array
    count: jax.Array
    fresh: jax.Array
    factored: Choice
    factors: tuple[jax.Array, jax.Array]


def _search(layout: Layout, problem: Problem, start: jax.Array, exact: bool):
    """Find loads, ends and which outlines are loaded.

    With the ends held, all else is linear; P = Σ aₘTₘ then tells at each free end how far it is off: it moves to
    where P would vanish. Close to the solution Newton's method on everything takes over; closer still the Jacobian is
    not factored again as long as steps shrink fast, unless at the end, for `exact` factors there.
    """
    ends = start[:, 1:] if layout.even else start
    bound, coupling = strip_fourier.bounds(layout, problem.left, problem.right), _coupling(layout, problem)
    fixed = Fixed(layout, problem, coupling, bound, _waiting(layout, bound, ends))
    (strips, n), outlines = (len(layout.rows), layout.modes), len(layout.sides)
    size = strips * n + ends.size + 1
    no, none = jnp.asarray(False), jnp.zeros(outlines, int)
    begun = jnp.ones(outlines, bool), (bound - ends) * layout.outward <= 0.0, none
    first = State(
        (jnp.zeros((strips, n)).at[:, 0].set(1.0), ends, jnp.asarray(1.0)), begun, none, jnp.asarray(0.5), no,
        jnp.asarray(0), no, begun, (jnp.zeros((size, size)), jnp.zeros(size, jnp.int32)),
    )  # fmt: skip

    def unfinished(state: State):
        return ((state.change > TOLERANCE) | (exact & ~state.fresh)) & (state.count < PASSES)

    last = jax.lax.while_loop(unfinished, partial(_pass, fixed, exact), first)
    # where it went astray the last change says so, and numbers to go on with keep NaN out of derivatives of what is
    # taken in its place
    lu, pivots = last.factors
    sane = jnp.all(jnp.array([jnp.all(jnp.isfinite(v)) for v in (*last.x, lu)])) & jnp.all(jnp.diagonal(lu) != 0.0)
    x = jax.tree.map(lambda found, begun: jnp.where(sane, found, begun), last.x, first.x)
    factors = jnp.where(sane, lu, jnp.eye(size)), jnp.where(sane, pivots, jnp.arange(size, dtype=pivots.dtype))
    return x, last.choice, factors, (jnp.where(sane, last.change, jnp.inf), last.count)


def _waiting(layout: Layout, bound: jax.Array, ends: jax.Array) -> jax.Array:
    """Where an outline waits without load for the bodies to overlap: about the place where they are nearest."""
    nearest = 0.0 if layout.even else jnp.clip(0.0, bound[:, :1], bound[:, 1:])
    small = nearest + WAITING * (ends - nearest)
    if layout.even:
        return small
    return jnp.where(
        layout.sided[:, None], strip_fourier.places(layout, bound, jnp.asarray(-np.asarray(layout.sides))), small
    )


def _pass(fixed: Fixed, exact: bool, state: State) -> State:
    """One pass: loads and approach for these ends, or Newton's step of all; then new ends and a new choice."""
    layout, problem, coupling, *_ = fixed
    (loads, ends, approach), (active, held, narrow) = state.x, state.choice
    (strips, n), newton = loads.shape, state.change < NEAR
    share = _shares(layout, problem)
    residual, parts = _contact(layout, state.x, problem, coupling)
    overlap = share @ residual[:, 0] < jnp.where(layout.sided, 0.0, -SLACK * approach)
    called = ~active & (state.rest <= 0) & overlap  # they overlap without load
    chosen = active | called, held | ~newton, narrow
    same = jnp.all(chosen[0] == state.factored[0]) & jnp.all(chosen[1] == state.factored[1])
    fresh = ~(state.near & same) | (exact & (state.change <= TOLERANCE))
    equations = _equations(layout, state.x, chosen, problem, residual)
    factors = jax.lax.cond(
        fresh, lambda: tuple(jax.lax.linalg.lu(_jacobian(layout, loads, chosen, problem, coupling, parts))[:2]),
        lambda: state.factors,
    )  # fmt: skip
    found = -jax.scipy.linalg.lu_solve(factors, equations)
    loads = loads + found[: strips * n].reshape(strips, n)
    tension = chosen[0] & (share @ loads[:, 0] <= 0.0)
    next_active = chosen[0] & ~tension
    move = _move(layout, loads, ends, share, found[strips * n : -1], newton, chosen[0], held)
    new, next_held, next_narrow = _placed(fixed, ends, move, chosen[0], tension)
    rests = ~next_active & overlap  # one that still rests is not done with
    settled = jnp.all((next_active == active) & ~rests) & jnp.all((next_held == held) | ~next_active[:, None])
    change = jnp.max(jnp.where(next_active[:, None], jnp.abs(new - ends), 0.0))
    change = jnp.where(settled, change, 0.5)
    change = jnp.where(newton, change, jnp.maximum(change, 2.0 * TOLERANCE))
    rest = jnp.where(tension, 2, state.rest - 1)
    loads = jnp.where(next_active[np.asarray(layout.outlines)][:, None], loads, 0.0)
    near = change < jnp.minimum(SHRINKING * state.change, CLOSE)
    x, choice = (loads, new, approach + found[-1]), (next_active, next_held, next_narrow)
    return State(x, choice, rest, change, near, state.count + 1, fresh, chosen, factors)


def _move(
    layout: Layout, loads: jax.Array, ends: jax.Array, share: jax.Array, by_newton: jax.Array, newton: jax.Array,
    active: jax.Array, held: jax.Array,
) -> jax.Array:  # fmt: skip
    """How far ends move, (outlines, ends): by Newton's step or, while that is not near, to where P would vanish."""
    signs, squares = strip_fourier.signs(layout), layout.orders.astype(float)[None] ** 2
    b = ends if layout.even else 0.5 * (ends[:, 1:] - ends[:, :1])
    tip, slope = share @ loads @ signs.T, share @ (loads * squares) @ signs.T
    guess = jnp.where(slope < 0.0, -2.0 * tip / jnp.where(slope < 0.0, slope, -1.0), 0.3 * jnp.sign(tip))
    guess = layout.outward * b * jnp.clip(guess, -0.4, 0.5)
    by_newton = by_newton.reshape(ends.shape)
    free = active[:, None] & ~held
    by_newton = by_newton / jnp.maximum(1.0, jnp.max(jnp.where(free, jnp.abs(by_newton) / (0.4 * b), 0.0)))
    return jnp.where(newton & ~held, by_newton, guess)


def _placed(
    fixed: Fixed, ends: jax.Array, move: jax.Array, active: jax.Array, tension: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The ends moved, but not beyond their bounds; which are held there; and which outlines are narrow, as in
    `Choice`."""
    layout, _, _, bound, small = fixed
    new = jnp.where(active[:, None], ends + move, ends)
    new = jnp.where(tension[:, None], small, new)
    held = (bound - new) * layout.outward <= 0.0
    new = jnp.where(held, bound, new)
    if layout.even:
        return new, held, jnp.zeros(active.shape, int)
    # no strip vanishes, and none hangs in the air beyond an edge
    short = new[:, 1] - new[:, 0] < 1.0001 * strip_fourier.LEAST / layout.frequencies.highest
    narrow = jnp.where(layout.sided, -np.asarray(layout.sides), held[:, 1].astype(int) - held[:, 0]) * short
    goes_on = held & (active & ~tension & (narrow == 0))[:, None]
    held = held | (narrow != 0)[:, None] | (layout.beside @ jnp.where(goes_on[:, ::-1], 1.0, 0.0) > 0.0)
    return jnp.where(held, strip_fourier.places(layout, bound, narrow), new), held, narrow
