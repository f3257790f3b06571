"""Chebyshev's nodes, Gauss's rule, slopes, bisection, and least squares: written once."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.taylor import Taylor

SECTIONS = np.arange(1, 64) / 64.0

Number = TypeVar("Number", jax.Array, np.ndarray)


def chebyshev_nodes(count: int, low: Any, high: Any) -> jax.Array:
    """`count` ≥ 2 Chebyshev–Lobatto nodes rising from `low` to `high`, both of them nodes."""
    rise = 0.5 * (1.0 - np.cos(np.pi * np.arange(count) / (count - 1)))
    return jnp.asarray(low + (high - low) * rise)


def chebyshev_roots(count: int) -> np.ndarray:
    """The zeros of the Chebyshev polynomial of degree `count`, falling, inside −1…1."""
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


@functools.cache
def gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places in −1 … 1 and weights, which add up to 2."""
    return np.polynomial.legendre.leggauss(count)


def value_and_slope(function: Callable[[Any], Any], x: Any) -> tuple[Any, Any]:
    """`function(x)` and its derivative by `x`, entry by entry, from one expansion."""
    found = function(xp.variable(x))
    return found.value, found.by[0]


def bisected(holds: Callable[[Number], Any], inside: Number, outside: Number, steps: int = 60) -> tuple[Number, Number]:
    """Two places, any one shape, between which `holds` ends: it holds at `inside` and not at `outside`.

    They are 2^−steps times as far apart as `inside` and `outside`, and carry no derivative. Of numpy's arrays it is
    computed by numpy, while others are traced, too; of single numbers, 63 places of which are asked for at once.
    """
    traced = isinstance(inside, jax.Array)
    if not traced and np.ndim(inside) == np.ndim(outside) == 0:
        return _sectioned(holds, inside, outside, math.ceil(steps / 6))

    def halve(_: int, ends: tuple[Any, Any]) -> tuple[Any, Any]:
        middle = 0.5 * (ends[0] + ends[1])
        good, where = holds(middle), jnp.where if traced else np.where
        return where(good, middle, ends[0]), where(good, ends[1], middle)

    if traced:
        return jax.lax.stop_gradient(jax.lax.fori_loop(0, steps, halve, (inside, outside)))
    ends = (inside, outside)
    for k in range(steps):
        ends = halve(k, ends)
    return ends


def _sectioned(holds: Callable[[Any], Any], inside: Any, outside: Any, rounds: int) -> tuple[Any, Any]:
    """`bisected`, each round of which is six halvings: numpy takes as long for 63 places as for one."""
    for _ in range(rounds):
        places = np.concatenate([[inside], inside + (outside - inside) * SECTIONS, [outside]])
        good = np.asarray(holds(places[1:-1]))
        last = len(SECTIONS) if np.all(good) else int(np.argmin(good))
        inside, outside = places[last], places[last + 1]
    return inside, outside


def least_squares(matrix: Any, right: Any, ridge: float) -> Any:
    """x with `matrix` · x nearest to `right`, shapes (…, n, m) and (…, n); what the rows do not tell stays small."""
    plain, goal = xp.value(matrix), xp.value(right)
    eye = np.broadcast_to(ridge * np.eye(plain.shape[-1]), (*plain.shape[:-2], *plain.shape[-1:] * 2))
    q, r = xp.module_of(plain).linalg.qr(xp.concatenate([plain, eye], axis=plain.ndim - 2))
    turned, lifted = (xp.moveaxis(part, -1, -2) for part in (q[..., : plain.shape[-2], :], r))

    def solved(triangle: Any, right: Any) -> Any:
        return xp.solved(triangle, right[..., None])[..., 0]

    def times(matrix: Any, vector: Any) -> Any:
        return xp.matmul(matrix, vector[..., None])[..., 0]

    found = solved(r, times(turned, goal))
    matrix_by, right_by = xp.by(matrix), xp.by(right)
    if matrix_by is None and right_by is None:
        return found
    # x moves as the least squares of what the rows miss by, and as the missed turns with the rows
    missed, by = goal - times(plain, found), 0.0
    if right_by is not None:
        by = by + solved(r[None], times(turned[None], right_by))
    if matrix_by is not None:
        by = by - solved(r[None], times(turned[None], times(matrix_by, found[None])))
        turning = times(xp.moveaxis(matrix_by, -1, -2), missed[None])
        by = by + solved(r[None], solved(lifted[None], turning))
    return Taylor(found, by=by)
