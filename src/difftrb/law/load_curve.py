"""From approach to load: log Q as a polynomial in log(δ − δ₀), the one kind of curve that the ring knows.

A power law is a polynomial of degree one. A curve through contact solves goes exactly through them; outside it runs
on straight in these logarithms, so that Q, dQ/dδ are continuous for every δ and d²Q/dδ² wherever a solve was near.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import implicit, loops, numeric, series
from difftrb.core.geometry import Real
from difftrb.core.taylor import Taylor


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Curve:
    """log Q = Σ cₖ zᵏ with z = (log(δ − δ₀) − middle)/reach in −1…1; one curve or, with the same shape behind every
    field, many.

    Attributes:
      coefficients: cₖ, shape (degree + 1, …). middle, reach: of log(δ − δ₀) [log mm], shape (…).
      shift: δ₀ [mm], shape (…): the approach at which load begins, 0 but over a spall under whose middle the crown
        has to be closed first.
    """

    coefficients: jax.Array
    middle: jax.Array
    reach: jax.Array
    shift: jax.Array


def power(stiffness: Real, exponent: Real) -> Curve:
    """Q = K δⁿ with K [N/mmⁿ] and n, any one shape."""
    K, n = xp.asarray(stiffness), xp.asarray(exponent)
    return Curve(xp.stack([xp.log(K), n]), xp.zeros_like(n), xp.ones_like(n), xp.zeros_like(n))


def weights(places: Any, x: Any) -> Any:
    """What the values at `places`, shape (n,), count at `x`, any shape, on the polynomial through all of them; shape
    x.shape + (n,)."""
    count, x = len(places), xp.asarray(x)
    gaps = xp.where(np.eye(count, dtype=bool), 1.0, places[:, None] - places[None, :])
    scale = 1.0 / xp.module_of(gaps).prod(gaps, axis=1)
    away = [x - places[k] for k in range(count)]
    below, above = [xp.ones_like(x)], [xp.ones_like(x)]  # products of all before and of all behind
    for k in range(count - 1):
        below.append(below[-1] * away[k])
        above.append(above[-1] * away[count - 1 - k])
    return xp.stack([scale[k] * below[k] * above[count - 1 - k] for k in range(count)], axis=-1)


def through(log_loads: Any, approaches: Any, shift: Any) -> Curve:
    """The curve through the `approaches` [mm] at `log_loads` (of loads in N), both of shape (n, …), n ≥ 2.

    Rising, best spaced like Chebyshev nodes. `shift` [mm], shape (…), below every approach. Divided differences:
    differentiable by everything, no iteration.
    """
    x = xp.log(approaches - shift[None])
    middle, reach = 0.5 * (x[-1] + x[0]), 0.5 * (x[-1] - x[0])
    z = (x - middle[None]) / reach[None]
    missing = z.ndim - log_loads.ndim
    values = log_loads.reshape(-1, *[1] * missing) if missing > 0 else log_loads
    return Curve(_interpolant(z, xp.broadcast_to(values, z.shape)), middle, reach, shift)


def _interpolant(z: Any, values: Any) -> Any:
    """`_coefficients` with their derivatives."""
    if not isinstance(z, Taylor) and not isinstance(values, Taylor):
        traced = xp.module_of(z, values) is jnp
        return implicit.interpolant(_coefficients, z, values) if traced else _coefficients(z, values)
    # when places move by dz and values by dy, the polynomial P changes by the one through dy − P′ dz
    places = xp.value(z)
    found = _interpolant(places, xp.value(values))
    change = None if not isinstance(values, Taylor) else values.by
    if isinstance(z, Taylor) and z.by is not None:
        moved = numeric.polynomial(found[:, None], places, 1)[None] * z.by
        change = -moved if change is None else change - moved
    if change is None:
        return found
    of = xp.module_of(change)
    by = _interpolant(places.reshape(len(places), 1, *places.shape[1:]), of.moveaxis(change, 0, 1))
    return Taylor(found, by=of.moveaxis(by, 1, 0))


def _coefficients(z: Any, values: Any) -> Any:
    """Of the polynomials in powers of z through `values` at `z`, all of shape (n, …); linear in the values."""
    of, order, count = xp.module_of(z, values), np.array(_spread(len(z))), len(z)
    places = z[order]
    at = np.arange(count).reshape(-1, *[1] * (z.ndim - 1))

    def divided(k: Any, differences: Any) -> Any:
        apart = places - of.roll(places, k + 1, axis=0)
        return of.where(at > k, (differences - of.roll(differences, 1, axis=0)) / apart, differences)

    def multiplied(k: Any, powers: Any) -> Any:  # · (z − place) + difference
        place, difference = (rows[count - 2 - k][None] for rows in (places, differences))
        return of.roll(powers, 1, axis=0) - place * powers + of.where(at == 0, difference, 0.0)

    differences = loops.counted(count - 1, divided, values[order])
    return loops.counted(count - 1, multiplied, of.where(at == 0, differences[-1:], 0.0))


def _spread(count: int) -> list[int]:
    """An order of Chebyshev–Lobatto nodes in which divided differences stay accurate (Leja's)."""
    x = np.cos(np.pi * np.arange(count) / (count - 1))
    order = [0]
    while len(order) < count:
        product = np.prod(np.abs(x[:, None] - x[order][None, :]), axis=1)
        order.append(int(np.argmax(product)))
    return order


def load(curve: Curve, approach: Any) -> tuple[Any, Any]:
    """Q [N] and dQ/dδ [N/mm] at an approach δ [mm], in the shape of the curves."""
    found = carried(curve, xp.variable(approach))
    return found.value, found.by[0]


def carried(curve: Curve, approach: Any) -> Any:
    """Q [N] at an approach δ [mm], in the shape of the curves."""
    above = approach - curve.shift
    touching = above > 0.0
    z = (xp.log(xp.where(touching, above, 1.0)) - curve.middle) / curve.reach
    return xp.where(touching, xp.exp(series.polynomial(curve.coefficients, z, straight=True)), 0.0)


def approach(curve: Curve, loads: Any) -> Any:
    """δ [mm] at which the curves carry `loads` [N] > 0, by Newton's method on logarithms: a start value, to about
    1e-6, that carries no derivative."""
    curve, loads = xp.fixed((curve, loads))
    goal = xp.log(loads)

    def step(z: Any) -> Any:
        found = series.polynomial(curve.coefficients, xp.variable(z), straight=True)
        return z + (goal - found.value) / found.by[0]

    z = loops.repeated(6, step, xp.zeros_like(curve.middle + goal))
    return xp.exp(curve.middle + curve.reach * z) + curve.shift


def chosen(curves: Curve, index: Any) -> Curve:
    """As `one_of`, for few curves and many an index: by comparing, which in a batch is faster than gathering."""

    def field(values: Any) -> Any:
        lead = values.shape[:-1]

        def column(k: int) -> Any:
            return values[..., k].reshape(*lead, *[1] * index.ndim)

        taken = column(0)
        for k in range(1, values.shape[-1]):
            taken = xp.where((index == k).reshape((1,) * len(lead) + index.shape), column(k), taken)
        return xp.broadcast_to(taken, (*lead, *index.shape))

    return xp.tree_map(field, curves)


def one_of(curves: Curve, index: Any) -> Curve:
    """The curves at `index` (any shape) along the last axis of `curves`."""
    return xp.tree_map(lambda field: field[..., index], curves)


def joined(*curves: Curve) -> Curve:
    """Several curves, each of shape () or (n,), one behind the other along a last axis."""

    def columns(fields: list[jax.Array], rank: int) -> jax.Array:
        return xp.concatenate([f if f.ndim > rank else f[..., None] for f in fields], axis=-1)

    return Curve(
        columns([c.coefficients for c in curves], 1),
        *(columns([getattr(c, name) for c in curves], 0) for name in ("middle", "reach", "shift")),
    )
