"""Series of powers and of Chebyshev polynomials, of arrays and of their expansions.

`polynomial` takes all; `horner`, `derivative` and `with_slope` take numbers and arrays. `chebyshev`
takes one number in −1 … 1, `chebyshev_by_recurrence` any, of any shape. What is traced has rules of its own for further
derivatives: few operations, where differentiating these takes many.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from difftrb.core import arrays as xp
from difftrb.core.taylor import Taylor, chained, plus, summed, whole


def polynomial(coefficients: Any, x: Any, straight: bool = False) -> Any:
    """Σ cₖ xᵏ, coefficients of shape (degree + 1, …), `x` of the shape behind; with `straight`, of a degree above 1, it
    goes on straight outside −1 … 1."""
    straight = straight and len(coefficients) > 2
    c = coefficients if isinstance(coefficients, Taylor) else Taylor(coefficients)
    z = x if isinstance(x, Taylor) else Taylor(x)
    if c.by is None and (z.by is None or len(z.by) == 1):
        return _by_steps(c.value, z, straight)
    if straight:
        inside = xp.within(z.value, -1.0, 1.0)
        table, rates, curves = _powers(inside, len(coefficients))
        table = table + (z.value - inside)[None] * rates
        curves = xp.where((xp.module_of(inside).abs(z.value) <= 1.0)[None], curves, 0.0)
    else:
        table, rates, curves = _powers(z.value, len(coefficients))

    def series(part: Any, powers: Any) -> Any:
        """Of coefficients, or of their derivatives by parameters."""
        if part is None:
            return None
        up = np.ndim(part) > coefficients.ndim
        return (part * powers[None]).sum(axis=1) if up else (part * powers).sum(axis=0)

    if z.by is None:
        return whole(series(c.value, table), series(c.by, table), series(c.mixed, table))
    along = chained(z, series(c.value, table), series(c.value, rates), series(c.value, curves))
    by, mixed = plus(along.by, series(c.by, table)), plus(along.mixed, series(c.mixed, table))
    if mixed is not None:
        by_rate = series(c.by, rates)
        turned = None if c.mixed is None or by_rate is None else by_rate[-1]
        mixed = plus(mixed, summed((z.by, turned), (by_rate, None if z.mixed is None else z.by[-1])))
    return whole(along.value, by, mixed)


def _by_steps(coefficients: Any, z: Taylor, straight: bool) -> Any:
    """The polynomial of constant coefficients, and its slope by the variable alone: one step for every coefficient."""
    rule = _with_slope if xp.module_of(coefficients, z.value) is jnp else with_slope
    inside = xp.within(z.value, -1.0, 1.0) if straight else z.value
    value, rate = rule(coefficients, inside)
    if straight:
        value = value + rate * (z.value - inside)
    if z.by is None:
        return value
    bend = None
    if z.mixed is not None:
        bend = derivative(coefficients, inside, 2)
        bend = xp.where(xp.module_of(inside).abs(z.value) <= 1.0, bend, 0.0) if straight else bend
    return chained(z, value, rate, bend)


def _powers(z: Any, count: int) -> tuple[Any, Any, Any]:
    """Powers of `z` and their first two derivatives, of shape (count, …) each: few operations, by doubling."""
    rows, square = xp.concatenate([xp.ones_like(z)[None], z[None]]), z * z
    while len(rows) < count:
        rows, square = xp.concatenate([rows, square[None] * rows]), square * square
    found, steps = [rows[:count]], np.arange(float(count)).reshape(-1, *[1] * np.ndim(z))
    for _ in range(2):
        found.append(xp.concatenate([xp.zeros_like(found[-1][:1]), steps[1:] * found[-1][:-1]]))
    return found[0], found[1], found[2]


def horner(coefficients: Sequence[Any] | np.ndarray | jax.Array, x: Any) -> Any:
    """Σ cₖ xᵏ of two or more coefficients; each a number, or of the shape of `x`."""
    value = coefficients[-1]
    for k in range(len(coefficients) - 2, -1, -1):
        value = value * x + coefficients[k]
    return value


def derivative(coefficients: Any, x: Any, order: int) -> Any:
    """The derivative of this order of Σ cₖ xᵏ, as in `polynomial`, of arrays."""
    count = len(coefficients)
    if order:
        factors = np.array([math.perm(k, order) for k in range(order, count)], float)
        if not factors.size:
            return 0.0 * coefficients[0] * x
        coefficients = factors.reshape(-1, *[1] * (coefficients.ndim - 1)) * coefficients[order:]
    return horner(coefficients, x)


def with_slope(coefficients: Any, x: Any) -> tuple[Any, Any]:
    """Σ cₖ xᵏ, as in `polynomial`, and its derivative by `x`, of arrays."""
    if len(coefficients) < 2:
        none = 0.0 * (coefficients[0] * x)
        return coefficients[0] + none, none
    value, slope = coefficients[-1], 0.0
    for k in range(len(coefficients) - 2, -1, -1):
        value, slope = value * x + coefficients[k], slope * x + value
    return value, slope


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _derivative(order: int, coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """`derivative` of what is traced. By `x` its derivative is the one of the next order, and so on."""
    return derivative(coefficients, x, order)


def _derivative_jvp(order: int, primals: tuple, tangents: tuple):
    (coefficients, x), (change, x_change) = primals, tangents
    found = _derivative(order, coefficients, x)
    moved = jnp.zeros_like(found)
    if not isinstance(change, SymbolicZero):
        moved = moved + derivative(change, x, order)
    if not isinstance(x_change, SymbolicZero):
        moved = moved + _derivative(order + 1, coefficients, x) * x_change
    return found, moved


_derivative.defjvp(_derivative_jvp, symbolic_zeros=True)


@jax.custom_jvp
def _with_slope(coefficients: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """`with_slope` of what is traced; differentiated as `_derivative`."""
    return with_slope(coefficients, x)


def _with_slope_jvp(primals: tuple, tangents: tuple):
    (coefficients, x), (change, x_change) = primals, tangents
    value, slope = _with_slope(coefficients, x)
    moved, turned = jnp.zeros_like(value), jnp.zeros_like(slope)
    if not isinstance(change, SymbolicZero):
        moved, turned = _with_slope(change, x)
    if not isinstance(x_change, SymbolicZero):
        moved, turned = moved + slope * x_change, turned + _derivative(2, coefficients, x) * x_change
    return (value, slope), (moved, turned)


_with_slope.defjvp(_with_slope_jvp, symbolic_zeros=True)


def chebyshev(z: Any, count: int) -> Any:
    """The first `count` Chebyshev polynomials of `z` in −1 … 1, shape (), in shape (count,)."""
    if not isinstance(z, Taylor):
        return _cosines_of_traced(count, z) if xp.module_of(z) is jnp else _cosines(count, z)
    rows = chebyshev(z.value, count)
    rates = xp.einsum("kn,n->k", _chebyshev_rates(count), rows)
    return Taylor(rows, by=None if z.by is None else z.by[:, None] * rates[None])


def chebyshev_by_recurrence(x: Any, degree: int) -> list[Any]:
    """Chebyshev polynomials T₀ … of `x` of any shape, also outside −1…1, up to `degree`; see `chebyshev`."""
    rows = [0.0 * x + 1.0, x]
    for _ in range(degree - 1):
        rows.append(2.0 * x * rows[-1] - rows[-2])
    return rows[: degree + 1]


def _cosines(count: int, x: Any) -> Any:
    """`chebyshev` of a number."""
    of = xp.module_of(x)
    return of.cos(np.arange(count) * of.arccos(of.clip(x, -1.0, 1.0)))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _cosines_of_traced(count: int, x: jax.Array) -> jax.Array:
    """`_cosines`, whose derivatives are sums of them, also at the ends."""
    return _cosines(count, x)


@_cosines_of_traced.defjvp
def _cosines_jvp(count: int, primals: tuple[jax.Array], tangents: tuple[jax.Array]):
    rows = _cosines_of_traced(count, primals[0])
    rates = jnp.matmul(_chebyshev_rates(count), rows, precision=jax.lax.Precision.HIGHEST)
    return rows, rates * tangents[0]


@cache
def _chebyshev_rates(count: int) -> np.ndarray:
    """The derivative of every Chebyshev polynomial, by what it has of the others, shape (count, count)."""
    rows = [np.polynomial.chebyshev.chebder(row) for row in np.eye(count)]
    return np.array([np.pad(row, (0, count))[:count] for row in rows])
