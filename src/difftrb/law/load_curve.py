"""From approach to load: log Q as a polynomial in log(δ − δ₀), the one kind of curve that the ring knows.

A power law is a polynomial of degree one. A curve through contact solves goes exactly through them; outside it runs
on straight in these logarithms, so that Q, dQ/dδ are continuous for every δ and d²Q/dδ² wherever a solve was near.
Where it is known which contact it becomes under vanishing loads, it goes over to that one (`lighter`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import implicit, loops, series
from difftrb.core.geometry import Real
from difftrb.core.numeric import value_and_slope
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
      bend: by how much the exponent under vanishing loads is larger than at the curve's lower end [-], shape (…); None:
        it is the same.
    """

    coefficients: jax.Array
    middle: jax.Array
    reach: jax.Array
    shift: jax.Array
    bend: Any = None


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


def lighter(curve: Curve, exponent: Any) -> Curve:
    """The same curve, which under vanishing loads becomes Q ~ (δ − δ₀)^`exponent` [-].

    Below its lower end the exponent's difference to that falls in proportion to δ − δ₀: Q is as on straight, times
    exp(b (x − eˣ + 1)) with x = log of (δ − δ₀) by that at the end, and b the difference there. In this proportion the
    contact of a smooth crown leaves Hertz's ellipse, as the first higher term of its gap grows.
    """
    return dataclasses.replace(curve, bend=exponent - exponent_below(curve))


def exponent_below(curve: Curve) -> Any:
    """d log Q/d log(δ − δ₀) at the curve's lower end [-]."""
    degrees = np.arange(1.0, len(curve.coefficients))
    return xp.einsum("k,k...->...", degrees * (-1.0) ** (degrees - 1.0), curve.coefficients[1:]) / curve.reach


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
        moved = series.derivative(found[:, None], places, 1)[None] * z.by
        change = -moved if change is None else change - moved
    if change is None:
        return found
    of = xp.module_of(change)
    by = _interpolant(places.reshape(len(places), 1, *places.shape[1:]), of.moveaxis(change, 0, 1))
    return Taylor(found, by=of.moveaxis(by, 1, 0))


def _coefficients(z: Any, values: Any) -> Any:
    """Of the polynomials in powers of z through `values` at `z`, all of shape (n, …); linear in the values."""
    of, order, count = xp.module_of(z, values), np.array(_leja_order(len(z))), len(z)
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


def _leja_order(count: int) -> list[int]:
    """An order of Chebyshev–Lobatto nodes in which divided differences stay accurate (Leja's)."""
    x = np.cos(np.pi * np.arange(count) / (count - 1))
    order = [0]
    while len(order) < count:
        product = np.prod(np.abs(x[:, None] - x[order][None, :]), axis=1)
        order.append(int(np.argmax(product)))
    return order


def load(curve: Curve, approach: Any) -> tuple[Any, Any]:
    """Q [N] and dQ/dδ [N/mm] at an approach δ [mm], in the shape of the curves."""
    return value_and_slope(partial(carried, curve), approach)


def carried(curve: Curve, approach: Any) -> Any:
    """Q [N] at an approach δ [mm], in the shape of the curves."""
    above = approach - curve.shift
    touching = above > 0.0
    z = (xp.log(xp.where(touching, above, 1.0)) - curve.middle) / curve.reach
    return xp.where(touching, xp.exp(_log_load(curve, z)), 0.0)


def _log_load(curve: Curve, z: Any) -> Any:
    straight = series.polynomial(curve.coefficients, z, straight=True)
    if curve.bend is None:
        return straight
    return straight + curve.bend * xp.with_rates(_leaving, curve.reach * (z + 1.0))


def _leaving(x: Any) -> tuple[Any, Any, Any]:
    """x − eˣ + 1 below 0 and 0 above, with its first two derivatives."""
    of = xp.module_of(x)
    below = of.minimum(x, 0.0)
    share = of.exp(below)  # not expm1, which is three times as slow; 1e-16 of log Q does not matter
    return below + 1.0 - share, 1.0 - share, of.where(x < 0.0, -share, 0.0)


def approach(curve: Curve, loads: Any) -> Any:
    """δ [mm] at which the curves carry `loads` [N] > 0, by Newton's method on logarithms: a start value, to about
    1e-6, that carries no derivative."""
    return approach_and_exponent(curve, loads)[0]


def approach_and_exponent(curve: Curve, loads: Any) -> tuple[Any, Any]:
    """`approach`, and d log Q/d log(δ − δ₀) there [-]."""
    curve, loads = xp.fixed((curve, loads))
    goal = xp.log(loads)

    def step(state: tuple[Any, Any]) -> tuple[Any, Any]:
        found, rate = value_and_slope(partial(_log_load, curve), state[0])
        return state[0] + (goal - found) / rate, rate

    z, rate = loops.repeated(6, step, (xp.zeros_like(curve.middle + goal),) * 2)
    return xp.exp(curve.middle + curve.reach * z) + curve.shift, rate / curve.reach


def chosen(curves: Curve, index: Any) -> Curve:
    """As `one_of`, for few curves and many an index: by comparing, which in a batch is faster than gathering."""
    here = [index == k for k in range(1, curves.shift.shape[-1])]

    def field(values: Any) -> Any:
        lead = values.shape[:-1]

        def column(k: int) -> Any:
            return values[..., k].reshape(*lead, *[1] * index.ndim)

        taken = column(0)
        for k, is_own in enumerate(here, start=1):
            taken = xp.where(is_own.reshape((1,) * len(lead) + index.shape), column(k), taken)
        return xp.broadcast_to(taken, (*lead, *index.shape))

    return xp.tree_map(field, curves)


def one_of(curves: Curve, index: Any) -> Curve:
    """The curves at `index` (any shape) along the last axis of `curves`."""
    return xp.tree_map(lambda field: field[..., index], curves)


def joined(*curves: Curve) -> Curve:
    """Several curves, each of shape () or (n,), one behind the other along a last axis."""
    if any(c.bend is not None for c in curves):
        curves = tuple(map(_with_bend, curves))

    def columns(fields: list[jax.Array], rank: int) -> jax.Array:
        return xp.concatenate([f if f.ndim > rank else f[..., None] for f in fields], axis=-1)

    return Curve(
        columns([c.coefficients for c in curves], 1), columns([c.middle for c in curves], 0),
        columns([c.reach for c in curves], 0), columns([c.shift for c in curves], 0),
        None if curves[0].bend is None else columns([c.bend for c in curves], 0),
    )  # fmt: skip


def replaced(curves: Curve, mix: Callable[[Any, Any], Any], others: Curve) -> Curve:
    """What `mix` makes of every field of `curves` and of `others`, which may be of a lower degree."""
    missing = curves.coefficients.shape[0] - others.coefficients.shape[0]
    more = np.zeros((missing, *others.coefficients.shape[1:]))
    others = dataclasses.replace(others, coefficients=xp.concatenate([others.coefficients, more]))
    return xp.tree_map(mix, curves, others if curves.bend is None else _with_bend(others))


def _with_bend(curve: Curve) -> Curve:
    return curve if curve.bend is not None else dataclasses.replace(curve, bend=0.0 * curve.shift)
