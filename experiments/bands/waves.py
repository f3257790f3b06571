"""Fourier transforms of pressure on intervals across a row, without tables that grow with the highest frequency.

Pressure on an interval is Σₘ aₘ Tₘ(t)/(π b √(1−t²)), t = (x−c)/b; its transform is Σₘ aₘ (−i)ᵐ e^(−iκc) Jₘ(κb). All
lengths are in units of a Hertz half-width.
"""

from __future__ import annotations

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special

from difftrb.core.numeric import chebyshev_roots, horner

SPLIT = 6.0  # power series of the Bessel functions below, amplitude and phase above
_NEAR, _FAR = 10, 8  # degrees


@lru_cache
def _fits(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Power series of Jₘ(x)/xᵐ in 2(x/SPLIT)² − 1 up to SPLIT; and, beyond, of the real and imaginary part of
    √(πx/2) e^(−i(x−π/4)) Hₘ(x) in 2 SPLIT/x − 1."""
    nodes = chebyshev_roots(_NEAR + 1)
    x = SPLIT * np.sqrt(0.5 * (nodes + 1.0))
    near = np.polynomial.chebyshev.chebfit(nodes, scipy.special.jv(order, x) / x**order, _NEAR)
    nodes = chebyshev_roots(_FAR + 1)
    x = 2.0 * SPLIT / (nodes + 1.0)
    wave = scipy.special.hankel1e(order, x) * np.sqrt(0.5 * np.pi * x) * np.exp(0.25j * np.pi)
    far = [np.polynomial.chebyshev.chebfit(nodes, part, _FAR) for part in (wave.real, wave.imag)]
    return tuple(np.polynomial.chebyshev.cheb2poly(c) for c in (near, *far))  # type: ignore[return-value]


def bessel(orders: tuple[int, ...], x: jax.Array) -> list[jax.Array]:
    """Jₘ(x) of every order, each of the shape of x ≥ 0; absolute error below 1e-9."""
    near = x < SPLIT
    small, large = jnp.where(near, x, 0.0), jnp.where(near, SPLIT, x)
    s, u = 2.0 * (small / SPLIT) ** 2 - 1.0, 2.0 * SPLIT / large - 1.0
    size, phase = jnp.sqrt(2.0 / np.pi / large), large - 0.25 * np.pi
    cosine, sine = size * jnp.cos(phase), size * jnp.sin(phase)
    found = []
    for m in orders:
        series, real, imag = _fits(m)
        found.append(jnp.where(near, small**m * horner(series, s), horner(real, u) * cosine - horner(imag, u) * sine))
    return found


def transforms(orders: tuple[int, ...], even: bool, low: jax.Array, high: jax.Array, kappa: np.ndarray) -> jax.Array:
    """Of every mode on the intervals `low` … `high`, shape (…, modes, z): real parts at all κ and, unless the intervals
    are symmetric (`even`, of even orders alone), imaginary ones."""
    b, c = 0.5 * (high - low)[..., None], 0.5 * (high + low)[..., None]
    kappa = kappa.reshape((1,) * low.ndim + (-1,))
    j = jnp.stack(bessel(orders, jnp.abs(b) * kappa), axis=-2)
    m = np.asarray(orders)
    real, imag = (
        np.array(turn)[m % 4].reshape((1,) * low.ndim + (-1, 1))
        for turn in ([1.0, 0.0, -1.0, 0.0], [0.0, -1.0, 0.0, 1.0])
    )
    if even:
        return j * real
    cosine, sine = jnp.cos(kappa * c)[..., None, :], jnp.sin(kappa * c)[..., None, :]
    return jnp.concatenate([j * (real * cosine + imag * sine), j * (imag * cosine - real * sine)], axis=-1)


def gap_integrals(orders: tuple[int, ...], low: jax.Array, high: jax.Array) -> jax.Array:
    """∫ 2x² of every mode on the intervals, shape (…, modes)."""
    b, c = 0.5 * (high - low), 0.5 * (high + low)
    by_order = {0: 2.0 * c * c + b * b, 1: 2.0 * c * b, 2: 0.5 * b * b}
    return jnp.stack([by_order.get(m, jnp.zeros_like(b)) for m in orders], axis=-1)


def contact_on(low: jax.Array, high: jax.Array, turned: np.ndarray | bool = False) -> jax.Array:
    """Loads of T₀, T₁, T₂ of a cylinder pressed on `low` … `high` of a half-plane, shape (…, 3), in the units of the
    gap 2x²: zero pressure at `high`, at `low` what comes of it. If `turned`, the other way round."""
    b, c = 0.5 * (high - low), 0.5 * (high + low)
    lean = jnp.where(turned, -1.0, 1.0)
    c = lean * c
    return jnp.stack([b * (b + 2.0 * c), -2.0 * lean * c * b, -b * b], axis=-1)
