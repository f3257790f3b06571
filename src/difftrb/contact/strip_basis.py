"""Rows along the roller: a piecewise linear line load, and the integrals of K₀(κ|y−y'|) over pairs of its hats."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core.numeric import chebyshev_roots, horner

NEAR = 2.0
"""κ times distance up to which hats that do not overlap take the kernel's integrals from zero; beyond, from infinity,
which for them is the same. Either way differences of them lose the fewest digits."""
ROUNDING = 1e-15
"""Of those integrals. Where a pair of hats would lose more to it than a product of moments leaves out, it is one."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Rows:
    """Hats that peak on `lines`, shape (panels + 1,), increasing.

    On the border beside a spall's `edge` ("low", "high", "both" or "none") line load may jump: half a hat peaks there.
    On other borders it is zero: no hat. With `middle` the first line is the roller's middle and has a hat that goes on
    into its mirror image.
    """

    lines: jax.Array
    middle: bool = dataclasses.field(metadata={"static": True})
    edge: Literal["low", "high", "both", "none"] = dataclasses.field(metadata={"static": True})

    @property
    def borders(self) -> tuple[bool, bool]:
        """Whether there is half a hat on the first and on the last line."""
        return self.edge in ("low", "both"), self.edge in ("high", "both")

    @property
    def count(self) -> int:
        """Number of hats."""
        return self.lines.shape[0] - 2 + self.middle + sum(self.borders)

    def hats(self, inner: jax.Array, first: jax.Array, last: jax.Array) -> jax.Array:
        """One value for every hat, of those given for inner lines and for the border lines, where they have one."""
        low, high = self.borders
        return jnp.concatenate([first[None]] * (low or self.middle) + [inner] + [last[None]] * high)


def graded(start: jax.Array, end: jax.Array, count: int, at_start: float, at_end: float) -> jax.Array:
    """`count` + 1 lines from `start` to `end`; their distance from either grows there like the given power."""
    u = np.linspace(0.0, 1.0, count + 1)
    share = u**at_start / (u**at_start + (1.0 - u) ** at_end) if at_start > 1.0 else 1.0 - (1.0 - u) ** at_end
    return start + (end - start) * jnp.asarray(share)


def integrals(rows: Rows, function: Callable[[jax.Array], jax.Array]) -> jax.Array:
    """∫ hat f dy of every hat, shape (hats,), by six Gauss points on each panel."""
    x, w = np.polynomial.legendre.leggauss(6)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    steps = jnp.diff(rows.lines)
    values = function(rows.lines[:-1, None] + steps[:, None] * x[None, :]) * steps[:, None]
    falling, rising = values @ (w * (1.0 - x)), values @ (w * x)
    return rows.hats(rising[:-1] + falling[1:], falling[0], rising[-1])


def weights(groups: tuple[Rows, ...]) -> jax.Array:
    """∫ hat dy of every hat of all groups, shape (hats,)."""
    return jnp.concatenate([integrals(rows, jnp.ones_like) for rows in groups])


def shares(rows: Rows, borders: jax.Array) -> jax.Array:
    """∫ hat dy between neighbouring `borders`, shape (hats, len(borders) - 1)."""
    u = jnp.clip((borders[None] - rows.lines[:-1, None]) / jnp.diff(rows.lines)[:, None], 0.0, 1.0)
    rising, falling = 0.5 * u * u, u - 0.5 * u * u
    parts = [jnp.diff(f * jnp.diff(rows.lines)[:, None], axis=-1) for f in (rising, falling)]
    return rows.hats(parts[0][:-1] + parts[1][1:], parts[1][0], parts[0][-1])


def mass(groups: tuple[Rows, ...]) -> jax.Array:
    """∫ hat hat dy, shape (hats, hats); groups do not overlap."""
    blocks = []
    for rows in groups:
        steps = jnp.diff(rows.lines)
        own = rows.hats((steps[:-1] + steps[1:]) / 3.0, steps[0] / 3.0, steps[-1] / 3.0)
        low, high = rows.borders
        beside = steps[0 if low or rows.middle else 1 : len(steps) if high else len(steps) - 1] / 6.0
        blocks.append(jnp.diag(own) + jnp.diag(beside, 1) + jnp.diag(beside, -1))
    return jax.scipy.linalg.block_diag(*blocks)


def products(groups: tuple[Rows, ...], kappa: np.ndarray, mirrored: bool) -> jax.Array:
    """∬ hat(y) hat(y') K₀(κ|y−y'|) dy dy', shape (hats, hats, κ); with y' also mirrored about 0 if asked.

    A hat is a second difference: the integral is two of them of K₀'s fourth antiderivative at the lines; half a hat
    takes its slope at the border too, which stands as one more point, at which the antiderivative is one order lower.
    """
    at_lines, at_borders = (
        jax.scipy.linalg.block_diag(*part) for part in zip(*[_stencil(rows) for rows in groups], strict=True)
    )
    borders = [rows.lines[np.flatnonzero(rows.borders) * -1] for rows in groups]
    points = jnp.concatenate([*(_points(rows) for rows in groups), *borders])
    stencil = jnp.concatenate([at_lines, at_borders], axis=1)
    later, earlier, images, back = _pairs(points.shape[0], mirrored)
    slope = np.arange(points.shape[0]) >= at_lines.shape[1]  # whether a point stands for a slope
    orders = 4 - slope[later].astype(int) - slope[earlier]
    distance = points[later] - images * points[earlier]
    sign = jnp.where(orders == 3, jnp.sign(distance), np.where(orders == 2, -images, 1.0))

    hats = _moments(groups)
    *pair, hat_pairs = _pairs(hats.mean.shape[0], mirrored)
    apart, far, by_moments = _by_moments(hats, kappa, *pair)

    k = kappa[:, None]
    parts = [(n, np.flatnonzero(orders == n)) for n in sorted(set(orders.tolist()))]
    found = [integrals_k0(n, k * jnp.abs(distance[at])[None]) for n, at in parts]
    order_of_parts = np.argsort(np.concatenate([at for _, at in parts]))[back]
    per = jnp.concatenate([sign[None, at] / k**n for n, at in parts], axis=1)

    def over_hats(f: jax.Array) -> jax.Array:
        return jnp.einsum("ia,...ab,jb->...ij", stencil, (per * f)[..., order_of_parts], stencil)

    from_zero, from_infinity = (jnp.concatenate(f, axis=1) for f in zip(*found, strict=True))
    near = _overlaps(groups, mirrored)[None] | (kappa[:, None, None, None] * apart[hat_pairs][None] < NEAR)
    result = jnp.where(near, over_hats(from_zero), over_hats(from_infinity))
    result = jnp.where(far[hat_pairs][None], by_moments[:, hat_pairs], result)
    return jnp.sum(result, axis=1).transpose(1, 2, 0)


class Moments(NamedTuple):
    """Of every hat, all of shape (hats,): its integral, its mean, its second and third central moment by the integral,
    and the longer of its sides."""

    weight: jax.Array
    mean: jax.Array
    second: jax.Array
    third: jax.Array
    size: jax.Array


def _moments(groups: tuple[Rows, ...]) -> Moments:
    """A hat is a triangle; half of one beside a border. The one on the middle has half its weight."""
    parts = [_sides(rows) for rows in groups]
    low, peak, high = (jnp.concatenate(part) for part in zip(*parts, strict=True))
    second = (low * low + low * high + high * high) / 18.0
    third = (high - low) * (2.0 * low + high) * (low + 2.0 * high) / 270.0
    return Moments(weights(groups), peak + (high - low) / 3.0, second, third, jnp.maximum(low, high))


def _sides(rows: Rows) -> tuple[jax.Array, jax.Array, jax.Array]:
    """How far every hat reaches to lower lines, where it peaks, and how far it reaches to higher ones."""
    steps, lines, none = jnp.diff(rows.lines), rows.lines, jnp.zeros(())
    below = steps[0] if rows.middle else none
    return (
        rows.hats(steps[:-1], below, steps[-1]), rows.hats(lines[1:-1], lines[0], lines[-1]),
        rows.hats(steps[1:], steps[0], none),
    )  # fmt: skip


def _by_moments(
    hats: Moments, kappa: np.ndarray, later: np.ndarray, earlier: np.ndarray, images: np.ndarray
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Of pairs of hats: how far their means are apart, which are so far apart that they lose less as moments than as
    differences, both of shape (pairs,), and these one's products, K₀ as a polynomial of degree four about that
    distance, shape (κ, pairs)."""
    one, other = (jax.tree.map(lambda field, at=at: field[at], hats) for at in (later, earlier))
    away = one.mean - images * other.mean
    second = one.second + other.second
    third = jnp.sign(away) * (one.third - images * other.third)
    fourth = 2.4 * (one.second**2 + other.second**2) + 6.0 * one.second * other.second
    apart, larger = jnp.abs(away), jnp.maximum(one.size, other.size)
    lost = ROUNDING * (apart**2 / (one.size * other.size)) ** 2
    far = (apart > 2.0 * larger) & (lost > (second / jnp.maximum(apart, larger) ** 2) ** 3)
    k = kappa[:, None]
    z = k * jnp.where(far, apart, 1.0)[None]
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


def _points(rows: Rows) -> jax.Array:
    return jnp.concatenate([-rows.lines[1:2], rows.lines]) if rows.middle else rows.lines


def _stencil(rows: Rows) -> tuple[jax.Array, jax.Array]:
    """The matrices that take f at the points, and f' at borders with half a hat, to ∫ hat f'' dy."""
    steps = jnp.diff(_points(rows))
    here = np.arange(steps.shape[0])
    slopes = jnp.zeros((len(here), len(here) + 1)).at[here, here].set(-1.0 / steps).at[here, here + 1].set(1.0 / steps)
    none = jnp.zeros((1, len(here) + 1))
    low, high = rows.borders
    stencil = jnp.diff(jnp.concatenate([none] * low + [slopes] + [none] * high), axis=0)
    at_borders = np.zeros((rows.count, low + high))
    if low:
        at_borders[0, 0] = -1.0
    if high:
        at_borders[-1, -1] = 1.0
    return (stencil.at[0].multiply(0.5) if rows.middle else stencil), jnp.asarray(at_borders)


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


# ------------------------------------------------------------------------------------------ repeated integrals of K₀

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


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def integrals_k0(n: int, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """K₀ integrated n = 0…4 times from 0 to z ≥ 0, and from infinity; n = −1 is the derivative. Shape of z.

    From infinity it is (−1)ⁿ Kiₙ(z), Bickley's function; they differ by a polynomial. Relative error below 1e-10.
    """
    near = z < SPLIT
    small = jnp.where(near & (z > 0.0), z, 1.0)
    quarter = 0.25 * small * small
    a, b = _SERIES[n]
    below = small**n * (horner(a, quarter) - jnp.log(0.5 * small) * horner(b, quarter))
    below = jnp.where(z > 0.0, below, 0.0)
    large = jnp.where(near, SPLIT, z)
    u = SPLIT / large
    above = (-1) ** n * jnp.exp(-large) * jnp.sqrt(u / SPLIT) * horner(_SCALED[n], 2.0 * u - 1.0)
    between = horner(_POLYNOMIAL[n], z)
    return jnp.where(near, below, above + between), jnp.where(near, below - between, above)


@jax.custom_jvp
def k0_and_k1(z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """K₀ and K₁ of z > 0."""
    return integrals_k0(0, z)[0], -integrals_k0(-1, z)[0]


@k0_and_k1.defjvp
def _(primals: tuple[jax.Array], tangents: tuple[jax.Array]):
    (z,), (dz,) = primals, tangents
    zero, one = k0_and_k1(z)
    return (zero, one), (-one * dz, -(zero + one / z) * dz)


@integrals_k0.defjvp
def _(n: int, primals: tuple[jax.Array], tangents: tuple[jax.Array]):
    (z,), (dz,) = primals, tangents
    return integrals_k0(n, z), tuple(slope * dz for slope in integrals_k0(n - 1, z))
