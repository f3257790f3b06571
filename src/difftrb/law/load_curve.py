"""From approach to load: log Q as a polynomial in log(δ − δ₀), the one kind of curve that the ring knows.

A power law is a polynomial of degree one. A curve through contact solves goes exactly through them; outside it runs
on straight in these logarithms, so that Q, dQ/dδ are continuous for every δ and d²Q/dδ² wherever a solve was near.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import implicit
from difftrb.core.geometry import Real
from difftrb.core.numeric import horner_with_slope


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
    K, n = jnp.asarray(stiffness, float), jnp.asarray(exponent, float)
    return Curve(jnp.stack([jnp.log(K), n]), jnp.zeros_like(n), jnp.ones_like(n), jnp.zeros_like(n))


def weights(places: jax.Array | np.ndarray, x: jax.Array | np.ndarray) -> jax.Array:
    """What the values at `places`, shape (n,), count at `x`, any shape, on the polynomial through all of them; shape
    x.shape + (n,)."""
    count = len(places)
    gaps = jnp.where(np.eye(count, dtype=bool), 1.0, places[:, None] - places[None, :])
    scale = 1.0 / jnp.prod(gaps, axis=1)
    x = jnp.asarray(x)
    away = [x - places[k] for k in range(count)]
    below, above = [jnp.ones_like(x)], [jnp.ones_like(x)]  # products of all before and of all behind
    for k in range(count - 1):
        below.append(below[-1] * away[k])
        above.append(above[-1] * away[count - 1 - k])
    found = jnp.stack([scale[k] * below[k] * above[count - 1 - k] for k in range(count)], axis=-1)
    # or else XLA writes out products with them, a sum of so many, wherever the result is used
    return jax.lax.optimization_barrier(found)


def through(log_loads: jax.Array, approaches: jax.Array, shift: jax.Array) -> Curve:
    """The curve through the `approaches` [mm] at `log_loads` (of loads in N), both of shape (n, …), n ≥ 2.

    Rising, best spaced like Chebyshev nodes. `shift` [mm], shape (…), below every approach. Divided differences:
    differentiable by everything, no iteration.
    """
    x = jnp.log(approaches - shift[None])
    middle, reach = 0.5 * (x[-1] + x[0]), 0.5 * (x[-1] - x[0])
    z = (x - middle[None]) / reach[None]
    values = jnp.broadcast_to(
        log_loads.reshape(-1, *[1] * (z.ndim - 1)) if log_loads.ndim < z.ndim else log_loads, z.shape
    )
    return Curve(implicit.interpolant(_coefficients, z, values), middle, reach, shift)


def _coefficients(z: jax.Array, values: jax.Array) -> jax.Array:
    """Of the polynomials in powers of z through `values` at `z`, all of shape (n, …); linear in the values."""
    order = np.array(_spread(len(z)))
    places, differences = z[order], values[order]
    divided = [differences[0]]
    for level in range(1, len(z)):  # whole rows at once: programs compile in proportion to their operations
        differences = (differences[1:] - differences[:-1]) / (places[level:] - places[:-level])
        divided.append(differences[0])
    powers = divided[-1][None]
    for place, first in zip(places[-2::-1], divided[-2::-1], strict=True):  # · (z − place) + first
        within = powers[:-1] - place[None] * powers[1:]
        powers = jnp.concatenate([(first - place * powers[0])[None], within, powers[-1:]])
    return powers


def _spread(count: int) -> list[int]:
    """An order of Chebyshev–Lobatto nodes in which divided differences stay accurate (Leja's)."""
    x = np.cos(np.pi * np.arange(count) / (count - 1))
    order = [0]
    while len(order) < count:
        product = np.prod(np.abs(x[:, None] - x[order][None, :]), axis=1)
        order.append(int(np.argmax(product)))
    return order


def load(curve: Curve, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
    above = approach - curve.shift
    touching = above > 0.0
    depth = jnp.where(touching, above, 1.0)
    z = (jnp.log(depth) - curve.middle) / curve.reach
    log_load, rate = straight(curve.coefficients, z)
    Q = jnp.where(touching, jnp.exp(log_load), 0.0)
    return Q, Q * rate / (curve.reach * depth)


def within(x: jax.Array, low: Real, high: Real) -> jax.Array:
    """As `jnp.clip`, whose derivative, a half at either end, costs divisions."""
    return jnp.where(x > low, jnp.where(x < high, x, high), low)


def straight(coefficients: jax.Array, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Σ cₖ zᵏ, coefficients of shape (degree + 1, …), and its derivative by z; straight outside −1…1."""
    return implicit.pointwise(_straight, _bending, coefficients, z)


def _straight(coefficients: jax.Array, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    inside = within(z, -1.0, 1.0) if coefficients.shape[0] > 2 else z
    value, rate = horner_with_slope(coefficients, inside)
    return value + rate * (z - inside), rate


def _bending(coefficients: jax.Array, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The first two derivatives by z."""
    _, rate = straight(coefficients, z)
    if coefficients.shape[0] <= 2:
        return rate, jnp.zeros_like(rate)
    powers = jnp.arange(1.0, coefficients.shape[0]).reshape(-1, *[1] * (coefficients.ndim - 1))
    _, bend = straight(powers * coefficients[1:], z)
    return rate, jnp.where(jnp.abs(z) < 1.0, bend, 0.0)


def approach(curve: Curve, loads: jax.Array) -> jax.Array:
    """δ [mm] at which the curves carry `loads` [N] > 0, by Newton's method on logarithms: a start value, to about
    1e-6, that carries no derivative."""
    goal = jnp.log(loads)

    def step(_: int, z: jax.Array) -> jax.Array:
        value, rate = straight(curve.coefficients, z)
        return z + (goal - value) / rate

    z = jax.lax.fori_loop(0, 6, step, jnp.zeros_like(curve.middle + goal))
    return jax.lax.stop_gradient(jnp.exp(curve.middle + curve.reach * z) + curve.shift)


def chosen(curves: Curve, index: jax.Array) -> Curve:
    """The same as `of` for few curves and many an index: by comparing, which in a batch is faster than gathering."""

    def field(values: jax.Array) -> jax.Array:
        taken = values[..., :1]
        for k in range(1, values.shape[-1]):
            taken = jnp.where(
                (index == k).reshape((1,) * (values.ndim - 1) + index.shape), values[..., k : k + 1], taken
            )
        return jnp.broadcast_to(taken, (*values.shape[:-1], *index.shape))

    return jax.tree.map(field, curves)


def of(curves: Curve, index: jax.Array | int) -> Curve:
    """The curves at `index` (any shape) along the last axis of `curves`."""
    return jax.tree.map(lambda field: field[..., index], curves)


def joined(*curves: Curve) -> Curve:
    """Several curves, each of shape () or (n,), one behind the other along a last axis."""

    def columns(fields: list[jax.Array], rank: int) -> jax.Array:
        return jnp.concatenate([f if f.ndim > rank else f[..., None] for f in fields], axis=-1)

    return Curve(
        columns([c.coefficients for c in curves], 1),
        *(columns([getattr(c, name) for c in curves], 0) for name in ("middle", "reach", "shift")),
    )
