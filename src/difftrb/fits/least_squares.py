"""Levenberg–Marquardt for many cases side by side: one evaluation of residual and exact Jacobian a step, safe against
NaN.

The loop runs outside of jit: only the evaluation is compiled, once, and finished cases cost nothing more. jaxopt has
the method, too. It evaluates the residual three times a step where this one does once, a NaN in one trial step ends it
for good, and it stops by the gradient's size alone, which says nothing without a scale.

It moves in coordinates u without bounds: a value runs from its lower to its upper bound as 1/(1 + e⁻ᵘ) runs from 0 to
1, in its logarithm where it is a size.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from difftrb.core import arrays as xp

FARTHEST = 14.0
"""Coordinates stay within ± this of 0: there they are at the bound to 1e-6 of the range."""
AT_BOUND = 7.0
"""Coordinates beyond ± this, the outer thousandth of the range, count as the bound."""
STEPS = 40
TOLERANCE = 1e-9
"""A step shorter than this, in coordinates, ends a case."""
LONGEST = 2.0
"""Longest step of one coordinate."""
ROUNDING = 1e-13
"""Relative gain of the sum of squares below which there is nothing left to gain."""
SHORTER = 0.1, 0.5
"""By how much a step is shortened that was none, at most and at least."""
SETTLED = 1e-3
"""Gain of half the sum of squares that is expected of a next step, below which a case has come to its end, if to no
smaller one: on a kink steps get shorter and shorter."""
LEAST_DAMPING = 1e-13
"""Relative: keeps the normal matrix invertible where residuals do not depend on something."""


def at_shares(shares: np.ndarray) -> np.ndarray:
    """Coordinates at which values, of sizes their logarithms, have gone these shares of the way from their lower to
    their upper bound, of any one shape; shares at a bound are moved inside."""
    inside = np.clip(shares, 1e-6, 1.0 - 1e-6)
    return np.log(inside / (1.0 - inside))


def shares_of(u: Any) -> Any:
    """What shares of that way are gone at these coordinates, of any shape."""
    return 1.0 / (1.0 + np.exp(-u))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Bounds:
    """Bounds of n values, shape (n,) each, and which are sizes: those are above 0, and their relative changes count."""

    low: Any
    high: Any
    logarithmic: tuple[bool, ...] = dataclasses.field(metadata={"static": True})

    def values(self, u: Any) -> Any:
        """Values at coordinates u within ±`FARTHEST`, both of shape (…, n)."""
        low, high = self.ends()
        raw, sizes = low + (high - low) / (1.0 + xp.exp(-u)), np.array(self.logarithmic)
        return xp.where(sizes, xp.exp(xp.where(sizes, raw, 0.0)), raw)

    def coordinates(self, values: np.ndarray) -> np.ndarray:
        """Coordinates of values, both of shape (…, n); values at a bound or beyond are moved inside."""
        low, high = self.ends()
        return at_shares((self._raw(values) - low) / (high - low))

    def ends(self) -> tuple[Any, Any]:
        """The bounds, of sizes their logarithms; shape (n,) each."""
        return self._raw(self.low), self._raw(self.high)

    def _raw(self, values: Any) -> Any:
        sizes = np.array(self.logarithmic)
        return xp.where(sizes, xp.log(xp.where(sizes, values, 1.0)), values)

    def beside(self, other: Bounds) -> Bounds:
        """Those of these values and, behind them, of others."""
        low, high = (np.concatenate(pair) for pair in ((self.low, other.low), (self.high, other.high)))
        return Bounds(low, high, (*self.logarithmic, *other.logarithmic))

    def slope(self, u: np.ndarray) -> np.ndarray:
        """Slope of the values, of sizes their logarithms, by coordinates, shape (n,)."""
        low, high = self.ends()
        share = shares_of(u)
        return (high - low) * share * (1.0 - share)

    def rate(self, u: np.ndarray) -> np.ndarray:
        """Slope of the values themselves by coordinates, shape (n,)."""
        return np.asarray(self.slope(u) * np.where(self.logarithmic, self.values(u), 1.0))


class Least(NamedTuple):
    """Minima: points, shape (cases, n); half the sums of squares there, shape (cases,); their normal matrices JᵀJ,
    shape (cases, n, n); what else was evaluated there, shapes (cases, …); steps taken; which converged."""

    points: np.ndarray
    cost: np.ndarray
    normal: np.ndarray
    beside: tuple[np.ndarray, ...]
    steps: np.ndarray
    converged: np.ndarray


def best(found: Least) -> int:
    """The case of the least cost."""
    return int(np.nanargmin(found.cost))


def both(first: Least, second: Least) -> Least:
    """The cases of the first, and behind them those of the second."""
    return jax.tree.map(lambda *pair: np.concatenate(pair), first, second)


class Evaluated(NamedTuple):
    """Residuals, shape (cases, m), their Jacobians, shape (cases, m, n), and whatever else there is, shapes
    (cases, …)."""

    residual: np.ndarray
    jacobian: np.ndarray
    beside: tuple[np.ndarray, ...]


class First(NamedTuple):
    """Another rule that goes first: from gradients, shape (cases, n), and a memory it makes steps, same shape, and the
    memory after it, as optax does; its memory at the start; for how many steps."""

    rule: Callable[[np.ndarray, Any], tuple[np.ndarray, Any]]
    memory: Any
    steps: int


class Alone(NamedTuple):
    """Coordinates that move alone at first, shape (n,), however far, and for how many steps."""

    moves: np.ndarray
    steps: int


class Enough(NamedTuple):
    """When a case is done, besides where rounding ends it.

    Attributes:
      gain: of half the sum of squares, below which a step is not worth it.
      behind: the same as a share of how far the case is behind the best one, of what that is more than `margin`.
      meet: a case that comes closer than this, shape (n,), to a better one with the same coordinates held, ends where
        that one does.
    """

    gain: float = 0.0
    behind: float = 0.0
    margin: float = 0.0
    meet: np.ndarray | None = None


def minimum(
    evaluate: Callable[[np.ndarray], Evaluated], start: np.ndarray, free: np.ndarray | bool, steps: int,
    first: First | None = None, enough: Enough = Enough(), longest: np.ndarray | float = LONGEST,  # noqa: B008
    alone: Alone | None = None, room: np.ndarray | float = np.inf,
) -> Least:  # fmt: skip
    """Least squares of what `evaluate` says of points, shape (some cases, n).

    Args:
      start: shape (cases, n). free: which coordinates move, of the same shape or one that broadcasts to it.
      steps: at most. With none it evaluates the start.
      first: what goes before, if anything. alone: what comes between that and the `steps`.
      longest: step of every coordinate, shape (n,); how far the residual is about straight.
      room: the same of the first step; from there it grows as long as steps are good ones.
    """
    free = np.broadcast_to(free, start.shape)
    cases, led, memory = _Cases(start, free, np.broadcast_to(longest, start.shape[1:]), room), 0, None
    if first is not None:
        led, memory = first.steps, first.memory
    before = led + (alone.steps if alone is not None else 0)
    if alone is not None:
        cases.room[:, alone.moves] = LONGEST
    for k in range(before + steps + 1):
        if k == before:
            cases.room = np.minimum(cases.room, cases.longest)
        at = np.nonzero(~cases.done)[0]
        cases.update(at, evaluate(cases.points[at] + cases.move[at]), k, led)
        if first is not None and k < led:
            move, memory = first.rule(cases.gradient, memory)
            cases.move = np.where(free, move, 0.0)
        else:
            cases.free = free & alone.moves if alone is not None and k < before else free
            cases.step(at)
        cases.shorten()
        if k >= before:
            cases.finish(enough)
        if cases.done.all():
            break
    cases.done |= cases.expected <= SETTLED
    return cases.least()


class _Cases:
    """Where all cases are, shape (cases, …) each, and the step that each tries next, within a box of its own."""

    def __init__(self, start: np.ndarray, free: np.ndarray, longest: np.ndarray, room: np.ndarray | float) -> None:
        cases, n = start.shape
        self.free, self.longest, self.room = free, longest, np.tile(np.minimum(longest, room), (cases, 1))
        self.points, self.cost = start.copy(), np.full(cases, np.inf)
        self.gradient, self.normal = np.zeros((cases, n)), np.zeros((cases, n, n))
        self.move, self.linear, self.expected = np.zeros((cases, n)), np.zeros(cases), np.zeros(cases)
        self.damping, self.taken = np.full(cases, 1e-3), np.zeros(cases, int)
        self.done, self.ends = np.zeros(cases, bool), np.arange(cases)
        self.blamed = np.zeros((cases, n), bool)  # for steps that were none, since the last that was one
        self.beside: tuple[np.ndarray, ...] = ()

    def update(self, at: np.ndarray, new: Evaluated, k: int, led: int) -> None:
        """Take the k-th step of the cases `at` if it was a good one; the first `led` ones are taken anyway."""
        if not self.beside:
            self.beside = tuple(np.zeros((len(self.cost), *more.shape[1:]), more.dtype) for more in new.beside)
        sums = 0.5 * np.sum(new.residual**2, axis=1)
        better = (sums < self.cost[at]) | (k < led)
        if k > led:
            self._resize(at, sums, better)
        here, jacobian = at[better], new.jacobian[better]
        self.points[here], self.cost[here] = (self.points[at] + self.move[at])[better], sums[better]
        self.gradient[here] = np.einsum("kmi,km->ki", jacobian, new.residual[better])
        self.normal[here] = np.einsum("kmi,kmj->kij", jacobian, jacobian)
        for whole, more in zip(self.beside, new.beside, strict=True):
            whole[here] = more[better]
        self.taken[at] = k

    def _resize(self, at: np.ndarray, sums: np.ndarray, better: np.ndarray) -> None:
        """Give the cases `at`, which have come to `sums`, more or less room for their next step.

        A step that is none is tried again with its longest part alone shorter: that one may have met a kink, or where
        residuals bend; of parts about as long the one that is expected to gain least, and not the same one twice. How
        much shorter is told by the parabola through what is known of the sum along the step.
        """
        move, room, gain = self.move[at], self.room[at], self.cost[at] - sums
        good = better & ~(gain < 0.25 * self.expected[at])
        self.damping[at] = np.where(good, np.maximum(0.1 * self.damping[at], LEAST_DAMPING), self.damping[at])
        grown = np.where(np.abs(move) > 0.9 * room, np.minimum(2.0 * room, self.longest), room)
        every = (self.blamed[at] | (move == 0.0)).all(axis=1)
        self.blamed[at] &= ~(better | every)[:, None]
        part = np.where(self.blamed[at] | (move == 0.0), 0.0, np.abs(move) / self.longest)
        long = part >= 0.9 * np.max(part, axis=1, keepdims=True)
        longest = np.argmin(np.where(long, -self.gradient[at] * move, np.inf), axis=1)[:, None]
        with np.errstate(all="ignore"):
            least = 0.5 * self.linear[at] / (gain + self.linear[at])
        share = np.clip(np.nan_to_num(least), *SHORTER)[:, None] * np.abs(np.take_along_axis(move, longest, 1))
        shrunk, blamed = room.copy(), self.blamed[at]
        np.put_along_axis(shrunk, longest, share, 1)
        np.put_along_axis(blamed, longest, ~better[:, None], 1)
        self.blamed[at] = blamed
        self.room[at] = np.where(better[:, None], np.where(good[:, None], grown, room), shrunk)

    def reach(self) -> tuple[np.ndarray, np.ndarray]:
        """How far a step may go down and up, shape (cases, n) each."""
        down, up = (np.clip(way * FARTHEST - self.points, -self.room, self.room) for way in (-1.0, 1.0))
        return down, up

    def step(self, at: np.ndarray) -> None:
        """Say where the cases `at` go next."""
        down, up = (end[at] for end in self.reach())
        self.move[at] = _step(self.gradient[at], self.normal[at], self.damping[at], down, up, self.longest,
                              self.free[at])  # fmt: skip

    def shorten(self) -> None:
        """Keep the next step in bounds, and say what it is expected to gain."""
        self.move = np.clip(self.move, *self.reach())
        self.linear = np.einsum("ki,ki->k", self.gradient, self.move)
        self.expected = -self.linear - 0.5 * np.einsum("ki,kij,kj->k", self.move, self.normal, self.move)

    def finish(self, enough: Enough) -> None:
        """End the cases that have nothing more to gain."""
        behind = enough.behind * np.maximum(self.cost - np.nanmin(self.cost) - enough.margin, 0.0)
        least = np.maximum(np.maximum(ROUNDING * self.cost, enough.gain), behind)
        self.done |= (np.max(np.abs(self.move), axis=1) < TOLERANCE) | (self.expected <= least)
        if enough.meet is not None:
            self._join(enough.meet)
            self.done |= self.ends != np.arange(len(self.ends))

    def _join(self, meet: np.ndarray) -> None:
        """Let every case that has come close to a better one end where that one does."""
        order, close = np.argsort(self.cost, kind="stable"), np.where(self.free, meet, 0.0)
        for rank, case in enumerate(order):
            if self.ends[case] != case:
                continue
            ahead = order[:rank]
            alike = (self.ends[ahead] == ahead) & (self.free[ahead] == self.free[case]).all(axis=1)
            met = alike & np.all(np.abs(self.points[ahead] - self.points[case]) <= close[case], axis=1)
            if met.any():
                self.ends[case] = ahead[np.argmax(met)]

    def least(self) -> Least:
        """Of every case, at its own end or that of the one it has met."""
        ends = self.ends
        for _ in range(len(ends)):  # those that met one that met another
            ends = ends[ends]
        beside = tuple(more[ends] for more in self.beside)
        return Least(self.points[ends], self.cost[ends], self.normal[ends], beside, self.taken, self.done[ends])


def _step(
    gradient: np.ndarray, normal: np.ndarray, damping: np.ndarray, down: np.ndarray, up: np.ndarray,
    longest: np.ndarray, free: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Of Levenberg–Marquardt, shape (cases, n), along what is free, from `down` to `up` at most: what would go farther
    goes as far as that, and the others follow. Cut afterwards, a long step along what hardly matters would spoil the
    rest of it."""
    cases, n = gradient.shape
    each = np.arange(cases)
    moves = free & ((up > 0.0) | (gradient > 0.0)) & ((down < 0.0) | (gradient < 0.0))
    # what changes residuals by less than one over its longest step is damped as if it did by one
    size = np.sqrt(np.maximum(np.einsum("kii->ki", normal), longest**-2.0))
    scaled = normal / (size[:, :, None] * size[:, None, :])
    step = np.zeros((cases, n))
    for _ in range(n):
        matrix = np.where(moves[:, :, None] & moves[:, None, :], scaled, 0.0)
        matrix += np.eye(n) * np.where(moves, damping[:, None], 1.0)[:, None, :]
        right = -(gradient + np.einsum("kij,kj->ki", normal, np.where(moves, 0.0, step))) / size
        found = np.linalg.solve(matrix, np.where(moves, right, 0.0)[..., None])[..., 0] / size
        step = np.where(moves, found, step)
        over = np.where(moves, np.maximum(step - up, down - step) / longest, 0.0)
        most = np.argmax(over, axis=1)
        beyond = over[each, most] > 0.0
        if not beyond.any():
            break
        at = each[beyond], most[beyond]
        step[at] = np.clip(step[at], down[at], up[at])
        moves[at] = False
    return step
