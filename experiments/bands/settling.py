"""Smooth pressure between free boundaries, which move to where it vanishes.

On every interval pressure is a sum of Chebyshev modes over √(1−t²). One linear solve finds them for given boundaries;
what is singular at a free one is by how much it is misplaced. The energy errs by the third power of that and the
approach by the second, so that two or three solves are enough and no boundary needs an equation of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact.strip_fourier import LEFT, MIDDLE, RIGHT, Frequencies
from experiments.bands import choice, waves
from experiments.bands.choice import Quadratic
from experiments.bands.rows import Kernel, Plan

FARTHEST = 3.0  # an edge farther out stands there; the gap there is larger than any approach
LEAST = 1e-3  # width of the narrowest interval
OVERLAP, CALLS = 1e-5, 3  # overlap by the approach at which an outline is loaded again, in the first passes
FAR = 50.0  # stands for no bound


class Scene(NamedTuple):
    """The contact without units: x in b₀, y in b₀, line load in q₀, displacement in q₀/(πE').

    Attributes:
      kernel: of the rows. gap: mean initial gap of the rows beside curvature, (rows,). bend: curvature's gap by 2x².
      left, right: the spall's rolling edges. load: Σ weight q. push: takes [mm] to the unit of displacement.
    """

    kernel: Kernel
    gap: jax.Array
    bend: jax.Array
    left: jax.Array
    right: jax.Array
    load: jax.Array
    push: jax.Array


class Settled(NamedTuple):
    """Mode loads of the strips, (strips, modes), and their change by the load; approach and its change by load;
    boundaries (outlines, 2), which of them are held at an edge, which outlines are loaded, (outlines,); last change of
    a boundary, and what it may leave in the approach, as a share of it."""

    loads: jax.Array
    by_load: jax.Array
    approach: jax.Array
    compliance: jax.Array
    ends: jax.Array
    held: jax.Array
    active: jax.Array
    change: jax.Array
    error: jax.Array


def bounds(plan: Plan, scene: Scene) -> jax.Array:
    """How far boundaries may go, (outlines, 2)."""
    sides = plan.sides
    low = jnp.where(sides == RIGHT, scene.right, jnp.where(sides == MIDDLE, scene.left, -FAR))
    high = jnp.where(sides == LEFT, scene.left, jnp.where(sides == MIDDLE, scene.right, FAR))
    return jnp.stack([low, high], axis=1)


def settle(
    plan: Plan, frequencies: Frequencies, scene: Scene, size: jax.Array, on: jax.Array, passes: int, tolerance: float
) -> Settled:  # fmt: skip
    """Pressure and boundaries, from guesses of their distance from the middle, (outlines,), of which those with `on`
    > 0 are loaded; at most `passes` solves, until moving on is worth less than `tolerance` of the approach."""
    bound = bounds(plan, scene)
    out = np.array([-1.0, 1.0])
    ends = jnp.stack([jnp.maximum(-size, bound[:, 0]), jnp.minimum(size, bound[:, 1])], axis=1)
    table = spread(plan.even, scene.kernel.products, plan.rows)
    strips, modes = plan.rows.size, len(plan.orders)
    first = Settled(
        jnp.zeros((strips, modes)), jnp.zeros((strips, modes)), jnp.zeros(()), jnp.zeros(()), ends, ends == bound,
        (on > 0.0) & (ends[:, 1] - ends[:, 0] > LEAST), jnp.zeros(()), jnp.zeros(()),
    )  # fmt: skip

    def solve(last: tuple):
        _, ends, held, active, count, _ = last
        found, called = _pressed(plan, frequencies, scene, table, ends, held, active)
        new, held_next, active_next, error = _moved(plan, scene, found, bound, out)
        change = jnp.max(jnp.where(active[:, None], jnp.abs(new - ends), 0.0))
        active_next = active_next | (called & (count < CALLS))
        done = (error < tolerance) & jnp.all(active_next == active)
        return found._replace(change=change, error=error), new, held_next, active_next, count + 1, done

    begun = (first, first.ends, first.held, first.active, 0, jnp.asarray(False))
    return jax.lax.while_loop(lambda last: ~last[5] & (last[4] < passes), solve, begun)[0]


def _waves(plan: Plan, frequencies: Frequencies, ends: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Transforms of the strips' modes (strips, modes, z), their strengths at both ends (strips, modes, 2), and the
    integrals of 2x² (strips, modes)."""
    low, high = ends[plan.outline_of].T
    high = jnp.maximum(high, low + LEAST)  # those that have vanished carry nothing, but must be numbers
    wave = waves.transforms(plan.orders, plan.even, low, high, frequencies.rule()[0])
    orders = np.array(plan.orders)
    signs = np.stack([(-1.0) ** orders, np.ones(orders.size)], axis=1)
    strength = tail_of(0.5 * (high - low), frequencies.highest)[:, None, None] * signs[None]
    return wave, strength, waves.gap_integrals(plan.orders, low, high)


def tail_of(half: jax.Array, highest: float) -> jax.Array:
    """Amplitude of what an end with singular pressure adds beyond the highest frequency, by its strength and per mass
    of rows: there K₀ acts as a line and J as (κb)^−1/2, bent over for intervals narrower than the last wave to the
    logarithm of a point load."""
    x = highest * half
    bend = 1.0 + 1.53 / (1.0 + 2.0 * x)
    return jnp.sqrt(0.5 * jnp.log1p(2.0 / np.pi * bend / x))


def _same(plan: Plan, held: jax.Array) -> jax.Array:
    """Whether two strips end at the same place, (strips, strips, 2)."""
    sides, own = plan.sides, np.eye(plan.sides.size, dtype=bool)
    left = np.stack([sides == MIDDLE, sides == LEFT], axis=1)
    right = np.stack([sides == RIGHT, sides == MIDDLE], axis=1)
    shared = [(held & part)[:, None, :] & (held & part)[None] for part in (left, right)]
    every = own[:, :, None] | shared[0] | shared[1]
    return jnp.asarray(every)[plan.outline_of][:, plan.outline_of]


def _terms(plan: Plan, scene: Scene, curved: jax.Array) -> tuple[jax.Array, jax.Array]:
    """∫ gap and the load of every mode, both (strips, modes)."""
    rows, first = plan.rows, np.eye(1, len(plan.orders))
    weight = scene.kernel.weight[rows][:, None]
    return weight * (scene.bend * curved + scene.gap[rows][:, None] * first), weight * first


def _pressed(
    plan: Plan, frequencies: Frequencies, scene: Scene, table: jax.Array, ends: jax.Array, held: jax.Array,
    active: jax.Array,
) -> tuple[Settled, jax.Array]:  # fmt: skip
    """The pressure for these boundaries, and which outlines without load overlap the other body."""
    rows, kernel = plan.rows, scene.kernel
    wave, strength, curved = _waves(plan, frequencies, ends)
    matrix = coupled(table, wave)
    tail = kernel.mass[rows][:, rows][..., None] * _same(plan, held)
    for end in (0, 1):
        at = strength[..., end]
        matrix = matrix + tail[:, None, :, None, end] * at[:, :, None, None] * at[None, None]
    gap, weight = _terms(plan, scene, curved)
    n = gap.size
    problem = Quadratic(matrix.reshape(n, n), gap.ravel(), weight.ravel(), scene.load)
    on = jnp.repeat(active[plan.outline_of], len(plan.orders))
    found = choice.on_set(problem, on)
    zero, first = jnp.zeros(()), len(plan.orders) * np.arange(rows.size)
    residual = problem.matrix[first] @ found.loads + gap[:, 0] - found.approach * weight[:, 0]
    overlap = np.eye(plan.sides.size)[plan.outline_of].T @ (residual / weight[:, 0])
    called = ~active & (overlap < -OVERLAP * found.approach) & (ends[:, 1] - ends[:, 0] > LEAST)
    return Settled(
        found.loads.reshape(gap.shape), found.by_load.reshape(gap.shape), found.approach, found.compliance, ends, held,
        active, zero, zero,
    ), called  # fmt: skip


def spread(even: bool, products: jax.Array, rows: np.ndarray) -> jax.Array:
    """The kernel of `rows`, which may repeat, at every entry z of their waves, (rows, z, rows): real parts and, unless
    `even`, imaginary ones."""
    table = products[rows][:, rows].transpose(0, 2, 1)
    return table if even else jnp.concatenate([table, table], axis=1)


def coupled(table: jax.Array, wave: jax.Array) -> jax.Array:
    """Σ over z of the `spread` kernel and waves (rows, k, z): shape (rows, k, rows, k)."""
    n, k, z = wave.shape
    pushed = (table[..., None] * wave.transpose(2, 0, 1)[None]).reshape(n, z, n * k)
    return jax.lax.dot_general(wave, pushed, (((2,), (1,)), ((0,), (0,)))).reshape(n, k, n, k)


def _moved(
    plan: Plan, scene: Scene, found: Settled, bound: jax.Array, out: np.ndarray
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """New boundaries, which of them are held and which outlines loaded; and about what the move is worth in δ."""
    orders, member = np.array(plan.orders), np.eye(plan.sides.size)[plan.outline_of]
    weight = member.T * scene.kernel.weight[plan.rows][None]
    load, by_load = weight @ found.loads, weight @ found.by_load
    signs = np.stack([(-1.0) ** orders, np.ones(orders.size)])
    tip, slope = load @ signs.T, (load * orders[None] ** 2) @ signs.T  # P and its outward derivative at the ends
    half = 0.5 * (found.ends[:, 1:] - found.ends[:, :1])
    move = jnp.where(slope < 0.0, -2.0 * tip / jnp.where(slope < 0.0, slope, -1.0), 0.3 * jnp.sign(tip))
    move = half * jnp.clip(move, -0.4, 0.5)
    stays = (found.held & (tip >= 0.0)) | ~found.active[:, None]
    new = jnp.where(stays, found.ends, found.ends + out[None] * move)
    held = jnp.where(stays, found.held, (new - bound) * out[None] >= 0.0)
    new = jnp.where(held & ~stays, bound, new)
    active = found.active & (load[:, 0] > 0.0) & (new[:, 1] - new[:, 0] > LEAST)
    worth = jnp.where(stays, 0.0, 0.5 * tip * (by_load @ signs.T) * move / half)
    return new, held, active, jnp.abs(jnp.sum(worth)) / found.approach


def shift(plan: Plan, frequencies: Frequencies, scene: Scene, found: Settled) -> jax.Array:
    """0, whose derivatives by the scene are those of the approach.

    With W w + g = δ m, m·w = load and v = ∂w/∂load: dδ = v·(dW w + dg − δ dm) + ∂δ/∂load (dload − dm·w). Boundaries
    that are free do not matter, those held by an edge move with it.
    """
    found = jax.lax.stop_gradient(found)
    ends = jnp.where(found.held, bounds(plan, scene), found.ends)
    wave, strength, curved = _waves(plan, frequencies, ends)
    rows, kernel = plan.rows, scene.kernel
    on = found.active[plan.outline_of][:, None]
    loads, by_load = jnp.where(on, found.loads, 0.0), jnp.where(on, found.by_load, 0.0)
    pressed, virtual = (jnp.einsum("sm,smz->sz", part, wave) for part in (loads, by_load))
    table = spread(plan.even, kernel.products, rows)
    work = jnp.einsum("iz,izj,jz->", virtual, table, pressed)
    tail = kernel.mass[rows][:, rows][..., None] * _same(plan, found.held)
    ends_pressed, ends_virtual = (jnp.einsum("sm,sme->se", part, strength) for part in (loads, by_load))
    work = work + jnp.einsum("ie,ije,je->", ends_virtual, tail, ends_pressed)
    gap, weight = _terms(plan, scene, curved)
    change = work + jnp.vdot(by_load, gap - found.approach * weight)
    change = change + found.compliance * (scene.load - jnp.vdot(weight, loads))
    return change - jax.lax.stop_gradient(change)
