"""The Bessel function K₀ and its repeated integrals, Bickley's functions: what a line load does beside itself."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.arrays import Taylor
from difftrb.core.numeric import chebyshev_roots, horner
from difftrb.core.taylor import chained

SPLIT = 4.0  # power series below, exponentially scaled Chebyshev series above
_TERMS = 16
_DEGREE = 17


def _series(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Polynomials A, B in (z/2)² with z⁻ⁿ ∫…∫ K₀ = A − ln(z/2) B, n integrations from 0."""
    a, b = np.zeros(_TERMS), np.zeros(_TERMS)
    harmonic = -np.euler_gamma
    for k in range(_TERMS):  # K₀ = Σ (z/2)^2k/k!² (ψ(k+1) − ln(z/2)): Abramowitz & Stegun 9.6.13
        factor = 1.0 / (math.factorial(k) ** 2 * math.prod(2 * k + j for j in range(1, n + 1)))
        a[k] = factor * (harmonic + sum(1.0 / (2 * k + j) for j in range(1, n + 1)))
        b[k] = factor
        harmonic += 1.0 / (k + 1)
    return a, b


def _scaled_fit(n: int) -> np.ndarray:
    """Power series in 2·(split/z) − 1 of Kiₙ(z) eᶻ √z for z ≥ split; Kiₙ(z) = ∫ e^(−z cosh t)/coshⁿ t dt."""
    nodes = chebyshev_roots(_DEGREE + 1)
    z = 2.0 * SPLIT / (nodes + 1.0)
    s = np.arange(-6.5, 6.5, 0.05)  # t = s/√z, so that the integrand is a bell of width 1; the trapezoid is exact
    t = s[:, None] / np.sqrt(z)
    values = 0.05 * np.sum(np.exp(-2.0 * z * np.sinh(0.5 * t) ** 2) / np.cosh(t) ** n, axis=0) / 2.0
    return np.polynomial.chebyshev.cheb2poly(np.polynomial.chebyshev.chebfit(nodes, values, _DEGREE))


_ORDERS = [0, 1, 2, 3, 4, -1]  # so that order −1 is also the last of each list


def _derivative(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The polynomials of z K₀′ from those of K₀."""
    twice = 2.0 * np.arange(_TERMS)
    return twice * a - b, twice * b


_SERIES = np.array([*(_series(n) for n in _ORDERS[:-1]), _derivative(*_series(0))])
_SCALED = np.array([_scaled_fit(n) for n in _ORDERS])
# ∫…∫ K₀ from 0 = (−1)ⁿ Kiₙ(z) + polynomial, coefficients of z⁰, z¹, …; Kiₙ(0) = ½ √π Γ(n/2)/Γ((n+1)/2)
_AT_ZERO = [math.inf, math.pi / 2.0, 1.0, math.pi / 4.0, 2.0 / 3.0]
_POLYNOMIAL = [
    np.array([*(-((-1) ** (n - j)) * _AT_ZERO[n - j] / math.factorial(j) for j in range(n)), 0.0]) for n in _ORDERS
]


def integrals_k0(n: int, z: Any) -> tuple[Any, Any]:
    """K₀ integrated n = 0…4 times from 0 to z ≥ 0, and from infinity; n = −1 is the derivative. Shape of z.

    From infinity it is (−1)ⁿ Kiₙ(z), Bickley's function; they differ by a polynomial. Relative error below 1e-10.
    """
    if isinstance(z, Taylor):
        both = zip(integrals_k0(n, z.value), integrals_k0(n - 1, z.value), strict=True)
        one, other = (chained(z, value, slope, None) for value, slope in both)
        return one, other
    near = z < SPLIT
    small = xp.where(near & (z > 0.0), z, 1.0)
    quarter = 0.25 * small * small
    a, b = _SERIES[n]
    below = small**n * (horner(a, quarter) - xp.log(0.5 * small) * horner(b, quarter))
    below = xp.where(z > 0.0, below, 0.0)
    large = xp.where(near, SPLIT, z)
    u = SPLIT / large
    above = (-1) ** n * xp.exp(-large) * xp.sqrt(u / SPLIT) * horner(_SCALED[n], 2.0 * u - 1.0)
    between = horner(_POLYNOMIAL[n], z)
    return xp.where(near, below, above + between), xp.where(near, below - between, above)


def k0_and_k1(z: Any) -> tuple[Any, Any]:
    """K₀ and K₁ of z > 0."""
    if isinstance(z, Taylor):
        zero, one = k0_and_k1(z.value)
        return chained(z, zero, -one, None), chained(z, one, -(zero + one / z.value), None)
    return integrals_k0(0, z)[0], -integrals_k0(-1, z)[0]
