"""Series of powers and of Chebyshev polynomials, of arrays and of their expansions."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import implicit, numeric
from difftrb.core.taylor import Taylor, bends, by_product, chained, plus, summed, whole


def polynomial_at(coefficients: Any, x: Any, order: int) -> Any:
    """The derivative of this order at every `x`, shape (n, …), of polynomials with coefficients of shape (m, …)."""
    return numeric.polynomial(coefficients[:, None], x, order)


def polynomial(coefficients: Any, x: Any, straight: bool = False) -> Any:
    """Σ cₖ xᵏ, coefficients of shape (degree + 1, …), `x` of the shape behind; with `straight`, of a degree above 1, it
    goes on straight outside −1 … 1."""
    straight = straight and len(coefficients) > 2
    c = coefficients if isinstance(coefficients, Taylor) else Taylor(coefficients)
    z = x if isinstance(x, Taylor) else Taylor(x)
    if all(part is None for part in (c.slope, c.by, z.by)):
        return _by_steps(c.value, z, straight)
    if straight:
        inside = xp.within(z.value, -1.0, 1.0)
        table, rates, curves = _powers(inside, len(coefficients))
        table = table + (z.value - inside)[None] * rates
        curves = xp.where((xp.of(inside).abs(z.value) < 1.0)[None], curves, 0.0)
    else:
        table, rates, curves = _powers(z.value, len(coefficients))

    def series(part: Any, powers: Any) -> Any:
        """Of coefficients, or of their derivatives by parameters."""
        if part is None:
            return None
        up = np.ndim(part) > coefficients.ndim
        return (part * powers[None]).sum(axis=1) if up else (part * powers).sum(axis=0)

    still = z.slope is None and z.by is None
    rate = None if still else series(c.value, rates)
    along = chained(z, series(c.value, table), rate, None if z.slope is None else series(c.value, curves))
    slope_rate = None if still or c.slope is None else series(c.slope, rates)
    by_rate = None if z.slope is None else series(c.by, rates)
    twice = None if slope_rate is None else 2.0 * slope_rate
    return whole(
        along.value,
        plus(along.slope, series(c.slope, table)),
        plus(along.bend, plus(series(c.bend, table), summed((twice, z.slope)))) if bends(c, z) else None,
        plus(along.by, series(c.by, table)),
        plus(plus(along.slope_by, series(c.slope_by, table)),
             summed((z.by, slope_rate), (by_rate, z.slope), product=by_product)),
    )  # fmt: skip


def _by_steps(coefficients: Any, z: Taylor, straight: bool) -> Any:
    """The polynomial of constant coefficients, and its slope by the variable alone: one step for every coefficient."""
    rules = implicit if xp.of(coefficients, z.value) is jnp else numeric
    inside = xp.within(z.value, -1.0, 1.0) if straight else z.value
    value, rate = rules.with_slope(coefficients, inside)
    if straight:
        value = value + rate * (z.value - inside)
    if z.slope is None:
        return value
    bend = None
    if z.bend is not None:
        bend = numeric.polynomial(coefficients, inside, 2)
        bend = xp.where(xp.of(inside).abs(z.value) < 1.0, bend, 0.0) if straight else bend
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


def chebyshev(z: Any, count: int) -> Any:
    """The first `count` Chebyshev polynomials of `z` in −1 … 1, shape (), in shape (count,)."""
    if not isinstance(z, Taylor):
        return implicit.chebyshev(count, z) if xp.of(z) is jnp else numeric.chebyshev_row(count, z)
    rows = chebyshev(z.value, count)
    rates = xp.einsum("kn,n->k", numeric.chebyshev_rates(count), rows)
    return Taylor(rows, by=None if z.by is None else z.by[:, None] * rates[None])
