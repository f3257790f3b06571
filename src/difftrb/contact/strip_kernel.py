"""How rows see one another: the integrals of K₀(κ|y−y'|) over pairs of hats, at every frequency κ across the roller.

They are differences of the Bessel function K₀ integrated repeatedly, Bickley's functions: what a line load does beside
itself.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import strip_rows
from difftrb.contact.strip_rows import Rows
from difftrb.contact.strip_waves import Frequencies
from difftrb.core import arrays as xp
from difftrb.core.arrays import Taylor, value
from difftrb.core.numeric import chebyshev_roots
from difftrb.core.series import horner
from difftrb.core.taylor import chained

NEAR = 2.0
"""κ times distance up to which hats that do not overlap take the kernel's integrals from zero; beyond, from infinity,
which for them is the same. Either way differences of them lose the fewest digits."""
ROUNDING = 1e-15
"""Of those integrals. Where a pair of hats would lose more to it than a product of moments leaves out, it is one."""


class Kernel(NamedTuple):
    """How rows see one another: ∬ hat hat' K₀(κ|y−y'|) dy dy' at every frequency times its weight, (rows, rows, κ);
    ∫ hat hat' dy, (rows, rows); ∫ hat y dy, (rows,)."""

    products: Any
    mass: Any
    arm: Any


def kernel_of(groups: tuple[Rows, ...], mirrored: bool, frequencies: Frequencies, nodes: int) -> Kernel:
    """The rows' kernel. In ln κ it is smooth: at the waves' frequencies it is interpolated from `nodes` of them."""
    at, through = _interpolation(frequencies, nodes)
    between = xp.einsum("ijn,nk->ijk", products(groups, at, mirrored), through)
    return Kernel(between, strip_rows.mass(groups), strip_rows.arms(groups))


@lru_cache
def _interpolation(frequencies: Frequencies, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies at which the kernel is computed, and what takes it to all of them, times their weights."""
    kappa, weights = frequencies.rule()
    waves = frequencies.waves
    at, through = kappa, np.eye(kappa.size)
    if nodes < waves:
        low, high = np.log(kappa[-waves]), np.log(kappa[-1])
        roots = chebyshev_roots(nodes)
        few = np.exp(0.5 * (high + low) + 0.5 * (high - low) * roots)
        places = (2.0 * np.log(kappa[-waves:]) - high - low) / (high - low)
        vandermonde = np.polynomial.chebyshev.chebvander
        share = np.linalg.solve(vandermonde(roots, nodes - 1).T, vandermonde(places, nodes - 1).T)
        share = few[:, None] * share / kappa[None, -waves:]  # κ times the kernel is bounded
        at = np.concatenate([kappa[:-waves], few])
        through = np.zeros((at.size, kappa.size))
        through[:-nodes, :-waves] = np.eye(kappa.size - waves)
        through[-nodes:, -waves:] = share
    return at, through * (2.0 / np.pi * weights)[None]


def products(groups: tuple[Rows, ...], kappa: np.ndarray, mirrored: bool) -> Any:
    """∬ hat(y) hat(y') K₀(κ|y−y'|) dy dy', shape (hats, hats, κ); with y' also mirrored about 0 if asked.

    A hat is a second difference: the integral is two of them of K₀'s fourth antiderivative at the lines; half a hat
    takes its slope at the border too, which stands as one more point, at which the antiderivative is one order lower.
    """
    parts = [strip_rows.second_differences(rows) for rows in groups]
    at_lines, at_borders = (xp.block_diagonal([part[i] for part in parts]) for i in (0, 1))
    borders = [rows.lines[np.flatnonzero(rows.borders) * -1] for rows in groups]
    points = xp.concatenate([*(strip_rows.on_points(rows) for rows in groups), *borders])
    stencil = xp.concatenate([at_lines, at_borders], axis=-1)
    later, earlier, images, back = _pairs(points.shape[0], mirrored)
    slope = np.arange(points.shape[0]) >= at_lines.shape[1]  # whether a point stands for a slope
    orders = 4 - slope[later].astype(int) - slope[earlier]
    distance = points[later] - images * points[earlier]
    sign = xp.where(orders == 3, xp.sign(value(distance)), np.where(orders == 2, -images, 1.0))

    hats = _moments(groups)
    *pair, hat_pairs = _pairs(hats.mean.shape[0], mirrored)
    apart, far, by_moments = _by_moments(hats, kappa, *pair)

    k = kappa[:, None]
    of_order = [(n, np.flatnonzero(orders == n)) for n in sorted(set(orders.tolist()))]
    found = [integrals_k0(n, k * xp.magnitude(distance[at])[None]) for n, at in of_order]
    order_of_parts = np.argsort(np.concatenate([at for _, at in of_order]))[back]
    per = xp.concatenate([sign[None, at] / k**n for n, at in of_order], axis=1)

    def over_hats(f: Any) -> Any:
        pairs = (per * f)[:, order_of_parts]  # (κ, images, points, points)
        return xp.einsum("kiab,jb->kiaj", xp.einsum("ca,kiab->kicb", stencil, pairs), stencil)

    from_zero, from_infinity = (xp.concatenate(f, axis=-1) for f in zip(*found, strict=True))
    near = _overlaps(groups, mirrored)[None] | (kappa[:, None, None, None] * apart[hat_pairs][None] < NEAR)
    result = xp.where(near, over_hats(from_zero), over_hats(from_infinity))
    result = xp.where(far[hat_pairs][None], by_moments[:, hat_pairs], result)
    summed = result[:, 0] + result[:, 1] if mirrored else result[:, 0]
    return xp.moveaxis(summed, 0, -1)


class Moments(NamedTuple):
    """Of every hat, all of shape (hats,): its integral, its mean, its second and third central moment by the integral,
    and the longer of its sides."""

    weight: Any
    mean: Any
    second: Any
    third: Any
    size: Any


def _moments(groups: tuple[Rows, ...]) -> Moments:
    """A hat is a triangle; half of one beside a border. The one on the middle has half its weight."""
    parts = [_sides(rows) for rows in groups]
    low, peak, high = (xp.concatenate(part) for part in zip(*parts, strict=True))
    second = (low * low + low * high + high * high) / 18.0
    third = (high - low) * (2.0 * low + high) * (low + 2.0 * high) / 270.0
    weight = strip_rows.weights(groups)
    return Moments(weight, peak + (high - low) / 3.0, second, third, xp.fixed(xp.maximum(low, high)))


def _sides(rows: Rows) -> tuple[Any, Any, Any]:
    """How far every hat reaches to lower lines, where it peaks, and how far it reaches to higher ones."""
    steps, lines = rows.steps, rows.lines
    none = 0.0 * steps[0]
    below = steps[0] if rows.middle else none
    return (
        rows.hats(steps[:-1], below, steps[-1]), rows.hats(lines[1:-1], lines[0], lines[-1]),
        rows.hats(steps[1:], steps[0], none),
    )  # fmt: skip


def _by_moments(
    hats: Moments, kappa: np.ndarray, later: np.ndarray, earlier: np.ndarray, images: np.ndarray
) -> tuple[Any, Any, Any]:
    """Of pairs of hats: how far their means are apart, which are so far apart that they lose less as moments than as
    differences, both of shape (pairs,), and these one's products, K₀ as a polynomial of degree four about that
    distance, shape (κ, pairs)."""
    one, other = (Moments(*(field[at] for field in hats)) for at in (later, earlier))
    away = one.mean - images * other.mean
    second = one.second + other.second
    side = xp.sign(value(away))
    third = side * (one.third - images * other.third)
    fourth = 2.4 * (one.second**2 + other.second**2) + 6.0 * one.second * other.second
    distance = side * away
    apart, larger = xp.fixed(distance), xp.maximum(one.size, other.size)
    lost = ROUNDING * (apart**2 / (one.size * other.size)) ** 2
    left_out = xp.fixed(second) / xp.maximum(apart, larger) ** 2
    far = (apart > 2.0 * larger) & (lost > left_out**3)
    k = kappa[:, None]
    z = k * xp.where(far, distance, 1.0)[None]
    (k0, k1), r = k0_and_k1(z), 1.0 / z
    a, b, c = k**2 * (second / 2.0)[None], k**3 * (third / 6.0)[None], k**4 * (fourth / 24.0)[None]
    by_k0 = 1.0 + a - b * r + c * (1.0 + 3.0 * r * r)
    by_k1 = (a + 2.0 * c) * r - b * (1.0 + 2.0 * r * r) + 6.0 * c * r * r * r
    return apart, far, (k0 * by_k0 + k1 * by_k1) * (one.weight * other.weight)[None]


def _pairs(count: int, mirrored: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of points, each once: the later, the earlier, 1 or (its mirror image) −1; and where to find every pair.

    Shapes (pairs,), thrice, and (images, count, count).
    """
    later, earlier = np.tril_indices(count)
    back = np.zeros((count, count), int)
    back[later, earlier] = back[earlier, later] = np.arange(later.size)
    images = np.array([1.0, -1.0] if mirrored else [1.0])
    return (
        np.tile(later, images.size),
        np.tile(earlier, images.size),
        np.repeat(images, later.size),
        np.stack([back + i * later.size for i in range(images.size)]),
    )


def _overlaps(groups: tuple[Rows, ...], mirrored: bool) -> np.ndarray:
    """Which pairs of hats overlap or meet at an edge, and which a hat and the mirror image of another.

    Shape (images, hats, hats).
    """
    total = sum(rows.count for rows in groups)
    overlap = np.zeros((1 + mirrored, total, total), bool)
    first, lows, highs = 0, [], []
    for rows in groups:
        i = np.arange(rows.count)
        block = slice(first, first + rows.count)
        overlap[0, block, block] = np.abs(i[:, None] - i) <= 1
        if mirrored and rows.middle:
            overlap[1, block, block] = i[:, None] + i <= 1
        low, high = rows.borders
        lows += [first, first + 1] * low
        first += rows.count
        highs += [first - 2, first - 1] * high
    for a, b in ((lows, highs), (highs, lows)):
        overlap[0, np.asarray(a, int)[:, None], np.asarray(b, int)] = True
    return overlap


# ------------------------------------------------------------------------------------------ Bickley's functions


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
