"""Series of powers and of Chebyshev polynomials, of arrays and of their expansions."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import implicit, numeric
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
    rules = implicit if xp.module_of(coefficients, z.value) is jnp else numeric
    inside = xp.within(z.value, -1.0, 1.0) if straight else z.value
    value, rate = rules.with_slope(coefficients, inside)
    if straight:
        value = value + rate * (z.value - inside)
    if z.by is None:
        return value
    bend = None
    if z.mixed is not None:
        bend = numeric.polynomial(coefficients, inside, 2)
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


def chebyshev(z: Any, count: int) -> Any:
    """The first `count` Chebyshev polynomials of `z` in −1 … 1, shape (), in shape (count,)."""
    if not isinstance(z, Taylor):
        return implicit.chebyshev(count, z) if xp.module_of(z) is jnp else numeric.chebyshev_row(count, z)
    rows = chebyshev(z.value, count)
    rates = xp.einsum("kn,n->k", numeric.chebyshev_rates(count), rows)
    return Taylor(rows, by=None if z.by is None else z.by[:, None] * rates[None])
