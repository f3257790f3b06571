"""Smooth pressure between free boundaries, which move to where it vanishes.

On every interval pressure is a sum of Chebyshev modes over √(1−t²). One linear solve finds them for given boundaries;
what is singular at a free one is by how much it is misplaced. The energy errs by the third power of that and the
approach by the second, so that two or three solves are enough and no boundary needs an equation of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import strip_active_set, strip_coupling, strip_waves
from difftrb.contact.strip_active_set import Quadratic
from difftrb.contact.strip_coupling import Coupling
from difftrb.contact.strip_kernel import Kernel
from difftrb.contact.strip_plan import LEFT, MIDDLE, RIGHT, StripPlan
from difftrb.core import arrays as xp
from difftrb.core import loops

FARTHEST = 3.0  # an edge farther out stands there; the gap there is larger than any approach
LEAST = 1e-3  # width of the narrowest interval
OVERLAP, CALLS = 1e-5, 4  # overlap by the approach at which an outline is loaded again, in the first passes
NARROW = 2.0  # width of the narrowest interval beyond an edge by 1/κ of the last wave: below, it cannot tell its own
UNBOUNDED = 50.0  # stands for no bound
PARTS = 0.3, 1.5  # of the move that a boundary alone would make, at least and at most
INWARD, OUTWARD = 0.4, 0.5  # most that it moves at once, by half the outline's length
BLINDLY = 0.3  # by half the length, where the pressure's slope does not tell how far
BESIDE, WIDEST = 0.3, 0.5  # an outline called beyond an edge: as if this was at least so far out; width it begins with
OVER = 1.5  # by which that width exceeds where curvature has taken the overlap away


class StripProblem(NamedTuple):
    """The contact without units: x in b₀, y in b₀, line load in q₀, displacement in q₀/(πE').

    Attributes:
      weight: ∫ hat dy of the rows, (rows,). gap: their mean initial gap beside curvature, (rows,). bend: curvature's
        gap by 2x².
      left, right: the rolling edges of every hollow; those of one far away where there is none. load: Σ weight q.
        push: takes [mm] to the unit of displacement.
      shrunk: 1, with how a line contact's half-width changes by the unit.
    """

    weight: Any
    gap: Any
    bend: Any
    left: tuple[Any, ...]
    right: tuple[Any, ...]
    load: Any
    push: Any
    shrunk: Any


class Settled(NamedTuple):
    """Mode loads of the strips, (strips, modes), and their change by the load; approach and its change by load;
    boundaries (outlines, 2), which of them are held at an edge, which outlines are loaded, (outlines,); what their
    places may leave in the approach, and what those leave in it that are too thin for the waves to place, both as a
    share of the deepest overlap."""

    loads: Any
    by_load: Any
    approach: Any
    compliance: Any
    ends: Any
    held: Any
    active: Any
    error: Any
    unresolved: Any


def bounds(plan: StripPlan, problem: StripProblem) -> Any:
    """How far boundaries may go, (outlines, 2)."""
    sides, (left, right) = plan.sides, (xp.stack(edges)[plan.hollows] for edges in (problem.left, problem.right))
    low = xp.where(sides == RIGHT, right, xp.where(sides == MIDDLE, left, -UNBOUNDED))
    high = xp.where(sides == LEFT, left, xp.where(sides == MIDDLE, right, UNBOUNDED))
    return xp.stack([low, high], axis=1)


def settle(
    plan: StripPlan, problem: StripProblem, kernel: Kernel, size: Any, on: Any, passes: int, tolerance: float
) -> tuple[Settled, Any]:
    """Pressure and boundaries, and after how many solves; at most `passes`, until moving on is worth less than
    `tolerance` of the approach. `size`: guesses of the boundaries' distance from the middle, (outlines,), of which
    those with `on` > 0 are loaded."""
    bound = bounds(plan, problem)
    ends = xp.stack([xp.maximum(-size, bound[:, 0]), xp.minimum(size, bound[:, 1])], axis=1)
    table, mass = _coupling(plan, kernel), kernel.mass[plan.rows][:, plan.rows]
    none, zero = np.zeros((plan.rows.size, len(plan.orders))), np.zeros(())
    active = (on > 0.0) & (ends[:, 1] - ends[:, 0] > LEAST)
    ends = _waiting(plan, bound, ends, active)
    first = Settled(none, none, zero, zero, ends, ends == bound, active, zero, zero)

    def solve(last: tuple) -> tuple:
        _, ends, held, active, count, _, before = last
        found, overlap = _pressed(plan, problem, table, mass, ends, held, active)
        new, held_next, active_next, errors, moves = _moved(plan, problem, found, bound, before)
        called = (
            ~active
            & (overlap > OVERLAP * _deepest(problem, found))
            & (ends[:, 1] - ends[:, 0] > LEAST)
            & (count < CALLS)
        )
        new = _waiting(plan, bound, new, active_next)
        new = xp.where((called & plan.sided)[:, None], _overlapping_ends(plan, problem, bound, overlap), new)
        active_next = active_next | called
        done = (errors[0] < tolerance) & xp.all(active_next == active)
        found = found._replace(error=errors[0], unresolved=errors[1])
        return found, new, held_next, active_next, count + 1, done, moves

    at_first = np.zeros((2, *ends.shape)) + np.array([0.0, 1.0])[:, None, None]
    begun = (first, first.ends, first.held, first.active, 0, np.asarray(False), at_first)
    found, *_, count, _ = loops.repeated_while(lambda last: ~last[5] & (last[4] < passes), solve, begun)
    return found, count


def _narrowest(plan: StripPlan) -> float:
    """Width of the narrowest interval beyond an edge."""
    return NARROW / plan.frequencies.last


def _waiting(plan: StripPlan, bound: Any, ends: Any, active: Any) -> Any:
    """The boundaries; those of outlines beyond an edge that are not loaded keep close to it, to feel the other body."""
    sides, least = plan.sides, _narrowest(plan)
    low = xp.where(sides == LEFT, bound[:, 1] - least, bound[:, 0])
    high = xp.where(sides == RIGHT, bound[:, 0] + least, bound[:, 1])
    return xp.where((plan.sided & ~active)[:, None], xp.stack([low, high], axis=1), ends)


def _overlapping_ends(plan: StripPlan, problem: StripProblem, bound: Any, overlap: Any) -> Any:
    """About where the contact ends of an outline beyond an edge that overlaps the other body there: where curvature has
    taken the overlap away."""
    low, high = bound[:, 0], bound[:, 1]
    edge = xp.maximum(xp.where(plan.sides == RIGHT, low, -high), BESIDE)
    width = xp.clip(OVER * overlap / (4.0 * problem.bend * edge), _narrowest(plan), WIDEST)
    return xp.stack([
        xp.where(plan.sides == LEFT, high - width, low), xp.where(plan.sides == RIGHT, low + width, high)
    ], axis=1)  # fmt: skip


def _strengths(plan: StripPlan, low: Any, high: Any) -> Any:
    """Of the modes' singularities at both ends, (strips, modes, 2)."""
    orders = np.array(plan.orders)
    signs = np.stack([(-1.0) ** orders, np.ones(orders.size)], axis=1)
    return strip_waves.tail_of(0.5 * (high - low), plan.frequencies.last)[:, None, None] * signs[None]


def _intervals(plan: StripPlan, ends: Any) -> tuple[Any, Any]:
    """Low and high ends of the strips."""
    low, high = ends[:, 0][plan.outline_of], ends[:, 1][plan.outline_of]
    return low, xp.maximum(high, low + LEAST)  # those that have vanished carry nothing, but must be numbers


def _same(plan: StripPlan, held: Any) -> Any:
    """Whether two strips end at the same place, (strips, strips, 2)."""
    sides, own = plan.sides, np.eye(plan.sides.size, dtype=bool)
    left = np.stack([sides == MIDDLE, sides == LEFT], axis=1)
    right = np.stack([sides == RIGHT, sides == MIDDLE], axis=1)
    shared = [(held & part)[:, None, :] & (held & part)[None] for part in (left, right)]
    together = (plan.hollows[:, None] == plan.hollows[None])[:, :, None]
    every = own[:, :, None] | (together & (shared[0] | shared[1]))
    return every[plan.outline_of][:, plan.outline_of].astype(float)


def _terms(plan: StripPlan, problem: StripProblem, curved: Any) -> tuple[Any, Any]:
    """∫ gap and the load of every mode, both (strips, modes)."""
    rows, first = plan.rows, np.eye(1, len(plan.orders))
    weight = problem.weight[rows][:, None]
    return weight * (problem.bend * curved + problem.gap[rows][:, None] * first), weight * first


def _pressed(
    plan: StripPlan, problem: StripProblem, table: Coupling, mass: Any, ends: Any, held: Any, active: Any
) -> tuple[Settled, Any]:
    """The pressure for these boundaries, and by how much outlines overlap the other body, on the mean."""
    matrix = _matrix(plan, table, mass, ends, held)
    gap, weight = _terms(plan, problem, strip_waves.gap_integrals(plan.orders, *_intervals(plan, ends)))
    quadratic = Quadratic(matrix, gap.ravel(), weight.ravel(), problem.load)
    found = strip_active_set.on_set(quadratic, xp.repeat(active[plan.outline_of], len(plan.orders)))
    zero, first = np.zeros(()), len(plan.orders) * np.arange(plan.rows.size)
    residual = quadratic.matrix[first] @ found.loads + gap[:, 0] - found.approach * weight[:, 0]
    overlap = -(plan.member.T @ (residual / weight[:, 0])) / np.sum(plan.member, axis=0)
    return Settled(
        found.loads.reshape(gap.shape), found.by_load.reshape(gap.shape), found.approach, found.compliance, ends, held,
        active, zero, zero,
    ), overlap  # fmt: skip


def _matrix(plan: StripPlan, table: Coupling, mass: Any, ends: Any, held: Any) -> Any:
    """What modes push each other down, (strips · modes, strips · modes)."""
    low, high = _intervals(plan, ends)
    wave = strip_waves.transforms(plan.orders, plan.even, low, high, plan.frequencies.rule()[0])
    matrix = strip_coupling.coupled(table, wave)
    strength, tails = _strengths(plan, low, high), mass[None] * xp.moveaxis(_same(plan, held), -1, 0)
    for end in (0, 1):
        at = strength[..., end]
        matrix = matrix + tails[end][:, None, :, None] * at[:, :, None, None] * at[None, None]
    n = plan.rows.size * len(plan.orders)
    return matrix.reshape(n, n)


def turned(plan: StripPlan, problem: StripProblem, kernel: Kernel, found: Settled) -> Settled:
    """What was found, with the change by the roller's tilt in place of that by its load: of loads and of the approach,
    by a gap that grows by the distance from the middle."""
    table, mass = _coupling(plan, kernel), kernel.mass[plan.rows][:, plan.rows]
    matrix = _matrix(plan, table, mass, found.ends, found.held)
    _, weight = _terms(plan, problem, np.zeros((plan.rows.size, len(plan.orders))))
    arm = kernel.arm[plan.rows][:, None] * np.eye(1, len(plan.orders))
    on = xp.repeat(found.active[plan.outline_of], len(plan.orders))
    by_tilt = strip_active_set.on_set(Quadratic(matrix, arm.ravel(), weight.ravel(), np.zeros(())), on)
    return found._replace(by_load=by_tilt.loads.reshape(weight.shape), compliance=by_tilt.approach)


def _coupling(plan: StripPlan, kernel: Kernel) -> Coupling:
    return strip_coupling.coupling_of(kernel.products, plan.rows, plan.frequencies.rule()[0], plan.even)


def _deepest(problem: StripProblem, found: Settled) -> Any:
    """By how much the undeformed bodies overlap at most: of a tilted roller more than its middle approaches, which may
    stand off."""
    return found.approach + xp.maximum(-xp.min(problem.gap), 0.0)


def _moved(
    plan: StripPlan, problem: StripProblem, found: Settled, bound: Any, before: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """New boundaries, which of them are held and which outlines loaded; about what the move is worth in δ, and what it
    would be worth to move those that are too thin for it, (2,); and by how much every boundary alone would move and
    which part of that it does, as it was `before`, (2, outlines, 2)."""
    orders, out = np.array(plan.orders), np.array([[-1.0, 1.0]])
    weight = plan.member.T * problem.weight[plan.rows][None]
    load, by_load = weight @ found.loads, weight @ found.by_load
    signs = np.stack([(-1.0) ** orders, np.ones(orders.size)])
    tip, slope = load @ signs.T, (load * orders[None] ** 2) @ signs.T  # P and its outward derivative at the ends
    half = 0.5 * (found.ends[:, 1:] - found.ends[:, :1])
    wanted = xp.where(slope < 0.0, -2.0 * tip / xp.where(slope < 0.0, slope, -1.0), BLINDLY * xp.sign(tip))
    alone = half * xp.clip(wanted, -INWARD, OUTWARD)
    # neighbours move, too: the secant through this move and the one before tells by how much boundaries overshoot
    last, part = before
    less = last - alone
    part = xp.where((last != 0.0) & (less != 0.0), part * last / xp.where(less != 0.0, less, 1.0), 1.0)
    part = xp.where(last * less > 0.0, xp.clip(part, *PARTS), 1.0)
    move = part * alone
    stays = (found.held & (tip >= 0.0)) | ~found.active[:, None]
    new = xp.where(stays, found.ends, found.ends + out * move)
    held = xp.where(stays, found.held, (new - bound) * out >= 0.0)
    new = xp.where(held & ~stays, bound, new)
    sides, least = plan.sides, _narrowest(plan)
    low = xp.where(sides == LEFT, xp.minimum(new[:, 0], new[:, 1] - least), new[:, 0])
    high = xp.where(sides == RIGHT, xp.maximum(new[:, 1], new[:, 0] + least), new[:, 1])
    new = xp.stack([low, high], axis=1)
    active = found.active & (load[:, 0] > 0.0) & (new[:, 1] - new[:, 0] > LEAST)
    gain = 0.5 * tip * (by_load @ signs.T)
    worth = gain * (new - found.ends) * out / half
    thin = plan.sided[:, None] & ~stays & (2.0 * half < least * (1.0 + 1e-6))
    lost = xp.where(thin, xp.abs(gain * wanted), 0.0)  # however far: the approach's errors are about this, as measured
    errors = xp.stack([xp.abs(xp.sum(worth)), xp.sum(lost)]) / _deepest(problem, found)
    return new, held, active, errors, xp.stack([alone, part])


def shifts(
    plan: StripPlan, problem: StripProblem, kernel_of: Callable[..., Kernel], ends: tuple[Any, ...],
    every: Sequence[Settled],
) -> list[Any]:  # fmt: skip
    """What the approach is off by, to first order in a change of the problem: 0 for the one that was solved.

    With W w + g = δ m, m·w = load and v = ∂w/∂load: dδ = v·(dW w + dg − δ dm) + ∂δ/∂load (dload − dm·w). Boundaries
    that are free do not matter, those held by an edge move with it, and so do the narrowest outlines beyond one. Of
    what was `turned`, it is the moment that is off by this, all but what the rows' own arms add: of all in `every`,
    which differ in that alone. W changes with the rows, whose kernel is `kernel_of(*ends)`, and with the rolling edges:
    each is expanded alone, for there are few of either.
    """
    found = every[0]
    on = found.active[plan.outline_of][:, None]
    loads, *virtual = (xp.where(on, x, 0.0) for x in (found.loads, *(each.by_load for each in every)))
    pairs_of = partial(_pairs, plan, problem, found, loads, virtual)

    def work(products: Any, mass: Any, pairs: Any, tails: Any) -> Any:
        own = mass[plan.rows][:, plan.rows]
        return xp.einsum("ijk,ijk->", products, pairs) + xp.einsum("ij,eij->", own, tails)

    places = *problem.left, *problem.right, problem.shrunk
    still = pairs_of(*xp.fixed(places))

    def as_rows_move(*ends: Any) -> tuple[list[Any], Any, Any]:
        kernel = kernel_of(*ends)
        worked = [work(kernel.products, kernel.mass, *pairs) for *pairs, _ in still]
        return worked, xp.fixed(kernel.products), xp.fixed(kernel.mass)

    by_rows, products, mass = xp.in_few(as_rows_move, *ends)

    def as_edges_move(*places: Any) -> list[tuple[Any, Any]]:
        return [(work(products, mass, *pairs), curved) for *pairs, curved in pairs_of(*places)]

    weight = problem.weight[plan.rows]
    lacking = problem.load - xp.total(weight * loads[:, 0])
    changes = []
    by_edges = xp.in_few(as_edges_move, *places)
    for each, by_load, rows, (edges, curved) in zip(every, virtual, by_rows, by_edges, strict=True):
        own = problem.bend * curved + by_load[:, 0] * (problem.gap[plan.rows] - found.approach)
        changes.append(rows + edges - xp.fixed(rows) + xp.total(weight * own) + each.compliance * lacking)
    return changes


def _pairs(
    plan: StripPlan,
    problem: StripProblem,
    found: Settled,
    loads: Any,
    virtual: list[Any],
    *places: Any,
) -> list[tuple[Any, Any, Any]]:
    """Virtual by found loads at the same frequency, of pairs of rows; at the same end, of pairs of strips; ∫ gap of
    the virtual ones: with the left and the right rolling edges at `places`, and what keeps its length shrunk by the
    last of them."""
    *edges, shrunk = places
    left, right = tuple(edges[: len(problem.left)]), tuple(edges[len(problem.left) :])
    of_row = np.eye(problem.gap.shape[0])[plan.rows].T
    same = xp.moveaxis(_same(plan, found.held), -1, 0)
    bound = bounds(plan, problem._replace(left=left, right=right))
    # Free ends do not matter as far as waves know them. Where they know slivers only about, these keep their length and
    # move with their edge; the narrowest, which are too wide to end where pressure vanishes, by the unit.
    width, moved = found.ends[:, 1] - found.ends[:, 0], bound - xp.fixed(bound) * shrunk
    kept = xp.where(width < _narrowest(plan) * (1.0 + 1e-6), width, 0.0) * (1.0 - shrunk)
    lower = xp.where(plan.sides == LEFT, moved[:, 1] - kept, 0.0)
    upper = xp.where(plan.sides == RIGHT, moved[:, 0] + kept, 0.0)
    free = found.ends * shrunk + xp.stack([lower, upper], axis=1)
    low, high = _intervals(plan, xp.where(found.held, bound, free))
    wave = strip_waves.transforms(plan.orders, plan.even, low, high, plan.frequencies.rule()[0])
    strength = _strengths(plan, low, high)
    curved = strip_waves.gap_integrals(plan.orders, low, high)

    def waves_of(parts: Any) -> Any:
        return xp.einsum("rs,sk->rk", of_row, xp.einsum("sm,smk->sk", parts, wave))

    there, tails = waves_of(loads), xp.einsum("sm,sme->es", loads, strength)
    count = there.shape[1] if plan.even else there.shape[1] // 2
    starts = range(0, there.shape[1], count)

    def with_found(by_load: Any) -> tuple[Any, Any, Any]:
        here, tail = waves_of(by_load), xp.einsum("sm,sme->es", by_load, strength)
        pairs = sum(here[:, None, k : k + count] * there[None, :, k : k + count] for k in starts)
        return pairs, tail[:, :, None] * tails[:, None, :] * same, xp.total(by_load * curved)

    return [with_found(by_load) for by_load in virtual]
