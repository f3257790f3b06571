"""Which parts of the rows carry load, and about where it ends: pressure as a sum of few non-negative bands.

Bands are differences of the contacts of a cylinder on nested intervals that end at the spall's rolling edges. That is a
small quadratic problem with bounds, solved by `strip_active_set`, a few times about the boundaries of the time before.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.contact import strip_active_set, strip_coupling, strip_waves
from difftrb.contact.strip_active_set import Quadratic
from difftrb.contact.strip_coupling import Coupling
from difftrb.contact.strip_kernel import Kernel
from difftrb.contact.strip_plan import LAND, LEFT, RIGHT, StripPlan
from difftrb.contact.strip_settling import StripProblem
from difftrb.core import arrays as xp
from difftrb.core import loops

ROUNDS = 15  # steps of the active set
FIRST = {2: (0.85, 1.2), 3: (0.7, 0.95, 1.25)}
"""Where bands end, by the guessed distance of the free boundary from the edge or the middle; at first, and later."""
LATER = {2: (0.9, 1.15), 3: (0.75, 1.0, 1.25)}


def chosen(
    plan: StripPlan, problem: StripProblem, kernel: Kernel, estimate: Any, count: int, times: int
) -> tuple[Any, Any, Any]:
    """The distance of every family's free boundary from the middle, (families,), 1 where it is loaded, and whether the
    last active set stood still.

    `estimate` of the approach; `count` of a row's bands; `times` they are solved.
    """
    sides, rows = plan.family_sides, plan.family_rows
    left, right = (xp.stack(edges)[plan.family_hollows] for edges in (problem.left, problem.right))
    edge = xp.where(sides == RIGHT, right, xp.where(sides == LEFT, -left, 0.0))
    nearest = xp.maximum(xp.where(sides == LAND, 0.0, edge), 0.0)
    table = strip_coupling.coupling_of(kernel.products, rows, plan.frequencies.rule()[0], plan.even)
    hollows = plan.family_hollows
    same = (sides[:, None] == sides[None]) & (sides != LAND)[None] & (hollows[:, None] == hollows[None])
    tail = kernel.mass[rows][:, rows] * same
    weight, gap_of_rows = problem.weight[rows], problem.gap[rows]
    places = np.array([FIRST[count]] + [LATER[count]] * (times - 1))
    turned = np.broadcast_to((sides == LEFT)[:, None], (sides.size, count))

    def boundary(load: Any) -> Any:
        """Where a contact cut off by the edge ends if it carries `load`."""
        whole = (sides == LAND) | ((edge < 0.0) & (load < edge * edge))
        cut = (edge + 2.0 * xp.sqrt(edge * edge + 3.0 * load)) / 3.0
        return xp.where(whole, xp.sqrt(load), cut)

    def solve(state: tuple) -> tuple:
        k, load, active, _ = state
        t = nearest[:, None] + (boundary(load) - nearest)[:, None] * xp.take(places, k, axis=0)[None]
        low = xp.where((sides == LAND)[:, None], -t, xp.maximum(-t, xp.minimum(edge[:, None], t - 1e-9)))
        low, high = xp.where(turned, -t, low), xp.where(turned, -low, t)
        shape = strip_waves.contact_on(low, high, turned)
        step = xp.diff(shape[..., 0], axis=1, prepend=0.0)
        quadratic = _quadratic(plan, problem, table, tail, low, high, shape, step, gap_of_rows, weight)
        found, active, still = strip_active_set.solve(quadratic, active, ROUNDS)
        density = found.loads.reshape(step.shape) / step
        return k + 1, _recentred(load, shape[..., 0], step, density), active, still

    deepest = xp.where(estimate > 0.0, estimate, estimate - xp.min(gap_of_rows))  # of a middle that stands off
    first = 1.03**2 * xp.clip((estimate - gap_of_rows) / deepest, 0.03, 1.0)
    begun = np.tile(np.arange(count) < 2, rows.size)
    state = 0, first, begun, np.asarray(False)
    _, load, active, still = loops.repeated(times, solve, state)
    return boundary(load), xp.any(active.reshape(-1, count), axis=1).astype(float), still


def _quadratic(
    plan: StripPlan, problem: StripProblem, table: Coupling, tail: Any, low: Any, high: Any, shape: Any, step: Any,
    gap: Any, weight: Any,
) -> Quadratic:  # fmt: skip
    """The problem of all bands: those of a family are the differences of the contacts of this `shape`, each by the
    load of its own, `step`."""
    families, count = low.shape
    orders, turned = plan.orders, (plan.family_sides == LEFT)[:, None]
    by_order = shape[..., ::2] if plan.even else shape
    wave = strip_waves.transforms(orders, plan.even, low.ravel(), high.ravel(), plan.frequencies.rule()[0])
    wave = xp.matmul(by_order.reshape(families * count, 1, -1), wave).reshape(families, count, -1)
    at_low, at_high = shape[..., 0] - shape[..., 1] + shape[..., 2], xp.sum(shape, axis=-1)
    strength = xp.where(turned, at_high, at_low) * strip_waves.tail_of(0.5 * (high - low), plan.frequencies.last)
    curved = strip_waves.gap_integrals(orders, low, high)
    works = xp.sum(by_order * problem.bend * curved, axis=-1) + shape[..., 0] * gap[:, None]

    def banded(whole: Any) -> Any:
        rise = xp.concatenate([whole[:, :1], xp.diff(whole, axis=1)], axis=1)
        return rise / step.reshape(*step.shape, *(1,) * (rise.ndim - 2))

    matrix, strength = strip_coupling.coupled(table, banded(wave)), banded(strength)
    matrix = matrix + tail[:, None, :, None] * strength[:, :, None, None] * strength[None, None]
    n = families * count
    return Quadratic(
        matrix.reshape(n, n), (banded(works) * weight[:, None]).ravel(), xp.repeat(weight, count), problem.load
    )


def _recentred(load: Any, ends: Any, step: Any, density: Any) -> Any:
    """The load that a contact of the free boundary in the last loaded band would carry alone, (families,)."""
    k = np.arange(step.shape[1])
    last = xp.max(xp.where(density > 0.0, k[None], -1), axis=1)

    def pick(table: Any, at: Any) -> Any:
        return xp.sum(xp.where(k[None] == at[:, None], table, 0.0), axis=1)

    before = xp.where(last > 0, pick(density, last - 1), 1.0)
    share = xp.minimum(pick(density, last) / xp.maximum(before, 1e-9), xp.where(last > 0, 1.4, 1.0))
    new = xp.where(last < 0, 0.5 * load, pick(ends, last - 1) + share * pick(step, last))
    return xp.clip(new, 0.3 * load, 2.2 * load)
