"""Fourier transforms of pressure on intervals across a row.

Pressure on an interval is Σₘ aₘ Tₘ(t)/(π b √(1−t²)), t = (x−c)/b; its transform is Σₘ aₘ (−i)ᵐ e^(−iκc) Jₘ(κb). All
lengths are in units of a Hertz half-width.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.special

from difftrb.core import arrays as xp
from difftrb.core.numeric import chebyshev_roots, gauss_legendre
from difftrb.core.series import horner

FADING = 0.6  # share of the highest frequency from which weights fade
SPLIT = 6.0  # power series of the Bessel functions below, amplitude and phase above
_NEAR, _FAR = 10, 8  # degrees


@dataclasses.dataclass(frozen=True)
class Frequencies:
    """Quadrature of ∫ dκ from 0 to `highest`: K₀ is logarithmic near 0, smooth in ln κ; then Bessel functions swing.

    Towards the last frequency weights fade, for what ends there at once makes answers ripple as edges move.

    Attributes: how many nodes lie near 0 (`low`), up to κ = 1.5 (`smooth`), and up to `highest` (`waves`).
    """

    low: int
    smooth: int
    waves: int
    highest: float

    def rule(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and weights."""
        return _rule(self)[:2]

    @property
    def last(self) -> float:
        """Where a quadrature that ends at once would leave as much out."""
        return _rule(self)[2]


@lru_cache
def _rule(of: Frequencies) -> tuple[np.ndarray, np.ndarray, float]:
    def gauss(a: float, b: float, count: int) -> tuple[np.ndarray, np.ndarray]:
        x, w = gauss_legendre(count)
        return 0.5 * (b - a) * x + 0.5 * (b + a), 0.5 * (b - a) * w

    root, root_weight = gauss(0.0, 0.1, of.low)
    log, log_weight = gauss(np.log(1e-3), np.log(1.5), of.smooth)
    wave, wave_weight = gauss(1.5, of.highest, of.waves)

    def fading(kappa: np.ndarray) -> np.ndarray:
        share = np.clip((kappa / of.highest - FADING) / (1.0 - FADING), 0.0, 1.0)
        return np.cos(0.5 * np.pi * share) ** 2

    fine, fine_weight = gauss(FADING * of.highest, of.highest, 40)
    left_out = 1.0 / of.highest + np.sum(fine_weight * (1.0 - fading(fine)) / fine**2)
    return (
        np.concatenate([root**3, np.exp(log), wave]),
        np.concatenate([3.0 * root**2 * root_weight, np.exp(log) * log_weight, wave_weight * fading(wave)]),
        float(1.0 / left_out),
    )


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
    near, real, imag = (np.polynomial.chebyshev.cheb2poly(c) for c in (near, *far))
    return near, real, imag


def bessel(orders: tuple[int, ...], x: Any) -> list[Any]:
    """Jₘ(x) of every order, each of the shape of x ≥ 0; absolute error below 1e-9."""
    near = xp.value(x) < SPLIT
    small, large = xp.where(near, x, 0.0), xp.where(near, SPLIT, x)
    s, u = 2.0 * (small / SPLIT) ** 2 - 1.0, 2.0 * SPLIT / large - 1.0
    size, phase = xp.sqrt(2.0 / np.pi / large), large - 0.25 * np.pi
    cosine, sine = size * xp.cos(phase), size * xp.sin(phase)
    found, power = [], xp.ones_like(x)
    for m in range(max(orders) + 1):
        if m in orders:
            series, real, imag = _fits(m)
            away = horner(real, u) * cosine - horner(imag, u) * sine
            found.append(xp.where(near, power * horner(series, s), away))
        power = power * small
    return found


def transforms(orders: tuple[int, ...], even: bool, low: Any, high: Any, kappa: np.ndarray) -> Any:
    """Of every mode on the intervals `low` … `high`, (intervals,) each, shape (intervals, modes, z): real parts at all
    κ and, unless the intervals are symmetric (`even`, of even orders alone), imaginary ones."""
    b, c = 0.5 * (high - low)[:, None], 0.5 * (high + low)[:, None]
    kappa = kappa[None]
    j = bessel(orders, b * kappa)
    # (−i)ᵐ by its real and its imaginary part
    turns = [([1.0, 0.0, -1.0, 0.0][m % 4], [0.0, -1.0, 0.0, 1.0][m % 4]) for m in orders]
    if even:
        return xp.stack([real * wave for (real, _), wave in zip(turns, j, strict=True)], axis=1)
    cosine, sine = xp.cos(kappa * c), xp.sin(kappa * c)
    parts = []
    for (real, imag), wave in zip(turns, j, strict=True):
        one, other = (cosine, -sine) if real else (sine, cosine)
        sign = real or imag
        parts.append(xp.concatenate([wave * (sign * one), wave * (sign * other)], axis=-1))
    return xp.stack(parts, axis=1)


def gap_integrals(orders: tuple[int, ...], low: Any, high: Any) -> Any:
    """∫ 2x² of every mode on the intervals, shape (…, modes)."""
    b, c = 0.5 * (high - low), 0.5 * (high + low)
    by_order = {0: 2.0 * c * c + b * b, 1: 2.0 * c * b, 2: 0.5 * b * b}
    return xp.stack([by_order[m] for m in orders], axis=-1)


def contact_on(low: Any, high: Any, turned: Any = False) -> Any:
    """Loads of T₀, T₁, T₂ of a cylinder pressed on `low` … `high` of a half-plane, shape (…, 3), in the units of the
    gap 2x²: zero pressure at `high`, at `low` what comes of it. If `turned`, the other way round."""
    b, c = 0.5 * (high - low), 0.5 * (high + low)
    lean = np.where(turned, -1.0, 1.0)
    c = lean * c
    return xp.stack([b * (b + 2.0 * c), -2.0 * lean * c * b, -b * b], axis=-1)


def tail_of(half: Any, highest: float) -> Any:
    """Amplitude of what an end with singular pressure adds beyond the highest frequency, by its strength and per mass
    of rows: there K₀ acts as a line and J as (κb)^−1/2, bent over for intervals narrower than the last wave to the
    logarithm of a point load."""
    x = highest * half
    bend = 1.0 + 1.53 / (1.0 + 2.0 * x)
    return xp.sqrt(0.5 * xp.log1p(2.0 / np.pi * bend / x))
