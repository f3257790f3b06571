"""Closed forms of Hertz's contact, to compare the solver with.

Symbols: E' = contact modulus [N/mm²] (`geometry.contact_modulus`), R = equivalent radius [mm], load [N], lengths [mm].
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from difftrb.contact.gap import line_half_width
from difftrb.core.geometry import Real
from difftrb.core.numeric import bisected


def line_peak_pressure(line_load: Real, radius: Real, modulus: Real) -> Real:
    """Peak pressure of a line contact [N/mm²] under `line_load` [N/mm]."""
    return jnp.sqrt(line_load * modulus / (jnp.pi * radius))  # Johnson 1985, eq. (4.45)


def line_pressure(x: jax.Array, line_load: Real, radius: Real, modulus: Real) -> jax.Array:
    """Half-elliptic pressure of a line contact at `x` [mm] across it [N/mm²]."""
    b = line_half_width(line_load, radius, modulus)
    inside = jnp.abs(x) < b
    root = jnp.sqrt(jnp.where(inside, 1.0 - (x / b) ** 2, 0.0))
    return line_peak_pressure(line_load, radius, modulus) * root  # Johnson 1985, eq. (4.44)


class PointContact(NamedTuple):
    """Semi-axes [mm] (`semi_x` across the first radius), peak pressure [N/mm²] and approach [mm]."""

    semi_x: jax.Array
    semi_y: jax.Array
    peak_pressure: jax.Array
    approach: jax.Array


def sphere(load: Real, radius: Real, modulus: Real) -> PointContact:
    """Circular point contact of equivalent `radius`."""
    a = (0.75 * load * radius / modulus) ** (1.0 / 3.0)  # Johnson 1985, eq. (4.22)
    p0 = 1.5 * load / (jnp.pi * a * a)
    return PointContact(*(jnp.asarray(v) for v in (a, a, p0, a * a / radius)))


def ellipse(load: Real, radius_x: Real, radius_y: Real, modulus: Real) -> PointContact:
    """Elliptic point contact on the gap x²/(2 radius_x) + y²/(2 radius_y); `radius_y` > `radius_x`.

    The ratio k = semi_x/semi_y is found by bisection; one Newton step behind it carries the derivatives.
    """
    ratio = jnp.asarray(radius_y, float) / radius_x

    def excess(log_k: jax.Array) -> jax.Array:
        k = jnp.exp(log_k)
        K, E = _complete_elliptic(k)
        return jnp.log((E / k**2 - K) / (K - E) / ratio)  # Johnson 1985, eq. (4.28)

    low, high = bisected(lambda at: excess(at) > 0.0, jnp.full_like(ratio, -15.0), jnp.full_like(ratio, -1e-6))
    log_k = 0.5 * (low + high)
    value, slope = jax.jvp(excess, (log_k,), (jnp.ones_like(log_k),))
    k = jnp.exp(log_k - value / jax.lax.stop_gradient(slope))
    K, E = _complete_elliptic(k)
    semi_y = (3.0 * load * radius_y * (K - E) / (jnp.pi * modulus * (1.0 - k * k))) ** (1.0 / 3.0)
    semi_x = k * semi_y
    p0 = 1.5 * load / (jnp.pi * semi_x * semi_y)
    return PointContact(semi_x, semi_y, p0, p0 * semi_x * K / modulus)  # Johnson 1985, eqs (4.24)–(4.26)


def _complete_elliptic(k: jax.Array) -> tuple[jax.Array, jax.Array]:
    """K and E of the modulus √(1 − k²), by the arithmetic–geometric mean (Abramowitz & Stegun 17.6)."""
    a, g = jnp.ones_like(k), k
    total = 0.5 * (1.0 - k * k)
    weight = 1.0
    for _ in range(7):
        a, g, c = 0.5 * (a + g), jnp.sqrt(a * g), 0.5 * (a - g)
        total = total + weight * c * c
        weight *= 2.0
    K = 0.5 * jnp.pi / a
    return K, K * (1.0 - total)
