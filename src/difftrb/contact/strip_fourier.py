"""Strips in x and their waves: Fourier transforms of pressure on strips whose ends move, with derivatives by the ends.

Pressure on a strip is Σₘ aₘ Tₘ(t)/(π b √(1−t²)), t = (x−c)/b; its transform is a sum of Bessel functions of κb. All
lengths are in units of a Hertz half-width.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special

LAND, RIGHT, LEFT, MIDDLE = 0, 1, -1, 2
# Ends that strips share: which sides, low or high end, and whether pressure may be singular there.
PLACES = (
    ((RIGHT,), 0, True), ((LEFT,), 1, True), ((MIDDLE,), 0, True), ((MIDDLE,), 1, True),
    ((LAND, LEFT), 0, False), ((LAND, RIGHT), 1, False),
)  # fmt: skip
SHARE = np.sqrt(np.sqrt(0.75) / 2.0)  # ∫κ⁻³ of a sharp and a blunt wave by the roots of ∫κ⁻² and ∫κ⁻⁴ is √3/2
MEETING = ((0, 3), (1, 2))  # places that lie on one rolling edge from either side
LEAST = 2.0  # width of the narrowest strip at an edge, by 1/κ of the last wave: below, it cannot tell its own width
ASIDE = 0.1  # width of the strip that stands for a spall which is nowhere near
LARGEST = 3.2  # farthest end of a strip; the gap there is larger than any approach


@dataclasses.dataclass(frozen=True)
class Frequencies:
    """Quadrature of ∫ dκ from 0 to `highest`: K₀ is logarithmic near 0, smooth in ln κ; then Bessel functions swing.

    Attributes: how many nodes lie near 0 (`low`), up to κ = 1.5 (`smooth`), and up to `highest` (`waves`).
    """

    low: int
    smooth: int
    waves: int
    highest: float

    def rule(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and weights."""

        def gauss(a: float, b: float, count: int) -> tuple[np.ndarray, np.ndarray]:
            x, w = np.polynomial.legendre.leggauss(count)
            return 0.5 * (b - a) * x + 0.5 * (b + a), 0.5 * (b - a) * w

        root, root_weight = gauss(0.0, 0.1, self.low)
        log, log_weight = gauss(np.log(1e-3), np.log(1.5), self.smooth)
        wave, wave_weight = gauss(1.5, self.highest, self.waves)
        return (
            np.concatenate([root**3, np.exp(log), wave]),
            np.concatenate([3.0 * root**2 * root_weight, np.exp(log) * log_weight, wave_weight]),
        )


@dataclasses.dataclass(frozen=True)
class Layout:
    """What is static of a strip model: rows, boundaries and modes of its strips, frequencies.

    Attributes:
      rows: for every strip its row.
      outlines: for every strip which pair of free boundaries is its own. Rows much thinner than the contact is wide
        share one: alone, each would leave its ends almost undetermined.
      sides: for every outline where it may be: anywhere (LAND), RIGHT or LEFT of the spall's rolling edges, or between
        them (MIDDLE: on the land's first rows, where only there pressure is singular along the roller).
      modes: Chebyshev modes of a strip. even: strips are symmetric about x = 0 (only even modes, c = 0).
      frequencies: the quadrature in κ.
    """

    rows: tuple[int, ...]
    outlines: tuple[int, ...]
    sides: tuple[int, ...]
    modes: int
    even: bool
    frequencies: Frequencies

    @property
    def member(self) -> np.ndarray:
        """Which strip has which outline, as ones, shape (strips, outlines)."""
        return np.eye(len(self.sides))[list(self.outlines)]

    @property
    def outward(self) -> np.ndarray:
        """The sign of each end, (1, ends)."""
        return np.array([[1.0]] if self.even else [[-1.0, 1.0]])

    @property
    def sided(self) -> np.ndarray:
        """Which outlines lie beyond a rolling edge, (outlines,)."""
        return np.isin(np.asarray(self.sides), (LEFT, RIGHT))

    @property
    def beside(self) -> np.ndarray:
        """Which outlines between the edges have which one beyond an edge beside them on a row, (outlines, outlines)."""
        sides, rows = np.asarray(self.sides), np.asarray(self.rows)
        common = self.member.T @ (rows[:, None] == rows) @ self.member > 0.0
        return (common & (sides[:, None] == MIDDLE) & self.sided[None]).astype(float)

    @property
    def orders(self) -> np.ndarray:
        """Of the modes, shape (modes,)."""
        return np.arange(self.modes) * (2 if self.even else 1)


@lru_cache
def _tables(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev coefficients by which matrix products give Jₘ(κb), and cos κc and sin κc, for |b|, |c| ≤ LARGEST.

    Shapes (terms, modes, κ) and (terms, 2, κ).
    """
    kappa = layout.frequencies.rule()[0]
    terms = int(LARGEST * layout.frequencies.highest) + 26
    angles = np.pi * (np.arange(terms) + 0.5) / terms
    x = LARGEST * np.cos(angles)[:, None] * kappa
    wave = [scipy.special.jv(m, x) for m in layout.orders]
    to_terms = 2.0 / terms * np.cos(np.outer(np.arange(terms), angles))
    to_terms[0] *= 0.5
    return (
        np.einsum("tj,mjk->tmk", to_terms, np.stack(wave)),
        np.einsum("tj,mjk->tmk", to_terms, np.stack([np.cos(x), np.sin(x)])),
    )


def _chebyshev(terms: int, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """T₀ … of x/LARGEST and their derivatives by x, shape (strips, terms); x is kept a little inside ± LARGEST."""
    angle = jnp.arccos(jnp.clip(x / LARGEST, -0.999, 0.999))[:, None]
    k = jnp.arange(terms)[None]
    return jnp.cos(k * angle), k * jnp.sin(k * angle) / (LARGEST * jnp.sin(angle))


def waves(layout: Layout, ends: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Fourier transforms of a strip's modes and their derivatives by its ends.

    Shapes (strips, modes, z) and (strips, ends, modes, z): z runs over the real parts at all frequencies, then (if not
    even) the imaginary ones, then the tails beyond the last frequency.
    """
    kappa = layout.frequencies.rule()[0][None, None]
    orders = layout.orders
    bessel, circle = _tables(layout)
    terms = bessel.shape[0]
    low, high = (-ends[:, 0], ends[:, 0]) if layout.even else (ends[:, 0], ends[:, 1])
    b, c = 0.5 * (high - low), 0.5 * (high + low)
    value, slope = _chebyshev(terms, b)
    j, j_by_b = (jnp.tensordot(basis, bessel, 1) for basis in (value, slope))  # (strips, modes, κ)
    tails, tails_by_b = _tails(layout, b)
    if layout.even:
        sign = (-1.0) ** (orders // 2)[None, :, None]
        by_b = jnp.concatenate([sign * j_by_b, tails_by_b], axis=-1)
        return jnp.concatenate([sign * j, tails], axis=-1), by_b[:, None]
    turned = jnp.tensordot(_chebyshev(terms, c)[0], circle, 1)
    cosine, sine = turned[:, None, 0], turned[:, None, 1]
    # (−i)ᵐ exp(−iκc): real and imaginary part
    even, odd = (np.array(turn)[orders % 4][None, :, None] for turn in ([1.0, 0.0, -1.0, 0.0], [0.0, -1.0, 0.0, 1.0]))
    real, imag = even * cosine + odd * sine, odd * cosine - even * sine
    wave = jnp.concatenate([j * real, j * imag, tails], axis=-1)
    by_b = jnp.concatenate([j_by_b * real, j_by_b * imag, tails_by_b], axis=-1)
    by_c = jnp.concatenate([j * imag * kappa, -j * real * kappa, jnp.zeros_like(tails)], axis=-1)
    return wave, jnp.stack([0.5 * (by_c - by_b), 0.5 * (by_c + by_b)], axis=1)


def _tails(layout: Layout, b: jax.Array) -> tuple[jax.Array, jax.Array]:
    """What strips add beyond the last frequency, as columns of `waves`; and the derivative by b.

    There K₀ acts as a line and J as a wave from either end of a strip, which only strips with an end at the same place
    share: (κb)^−1/2 from an end with singular pressure, (κb)^−3/2 from every end. For strips narrower than the last
    wave both bend over: the first to the logarithm that a point load has.
    """
    orders, highest = layout.orders, layout.frequencies.highest
    squares = orders.astype(float) ** 2 - 0.25
    x = highest * b[:, None, None]
    blunt = 1.0 / jnp.sqrt(12.0 * np.pi * (x**3 + 1.0))
    blunt_by_b = -1.5 * blunt * x**3 / (x**3 + 1.0)
    if layout.even:
        both = np.sqrt(2.0) * squares[None, :, None] * np.ones((len(layout.rows), 1, 1))
        return both * blunt, both * blunt_by_b / b[:, None, None]
    bend = 1.0 + 1.53 / (1.0 + 2.0 * x)
    inner = 1.0 + 2.0 / np.pi * bend / x
    sharp = jnp.sqrt(0.5 * jnp.log(inner))
    inner_slope = -2.0 / np.pi * (bend / x + 3.06 / (1.0 + 2.0 * x) ** 2)  # times x: by ln x
    sharp_by_b = 0.25 / sharp * inner_slope / inner
    at_ends = signs(layout)
    at = [layout.member @ np.isin(layout.sides, sides)[:, None] * at_ends[end] for sides, end, _ in PLACES]
    at_sharp = np.stack([a for a, place in zip(at, PLACES, strict=True) if place[2]], axis=-1)
    at_all = np.stack(at, axis=-1) * squares[None, :, None]

    def columns(sharp: jax.Array, blunt: jax.Array) -> jax.Array:
        # waves from two sides of one edge are in phase only where one is sharp and one blunt: 2uv = (u+v)²/2 − (u−v)²/2
        one, other = (np.array(places) for places in zip(*MEETING, strict=True))
        u = jnp.concatenate([at_sharp[..., one], at_sharp[..., other]], axis=-1) * sharp
        v = jnp.concatenate([at_all[..., other], at_all[..., one]], axis=-1) * blunt
        return jnp.concatenate([at_sharp * sharp, at_all * blunt, SHARE * (u + v), SHARE * (u - v)], axis=-1)

    return columns(sharp, blunt), columns(sharp_by_b, blunt_by_b) / b[:, None, None]


def signs(layout: Layout) -> np.ndarray:
    """Tₘ at the ends: (ends, modes)."""
    ones = np.ones(layout.modes)
    return ones[None] if layout.even else np.stack([(-1.0) ** layout.orders, ones])


def bounds(layout: Layout, left: jax.Array, right: jax.Array) -> jax.Array:
    """How far the ends may go between or beside the spall's rolling edges `left` and `right`: (outlines, ends)."""
    sides = np.asarray(layout.sides)
    room = LARGEST - 0.3  # a strip at an edge farther out stays there, without load
    left = jnp.clip(left, -room, room - ASIDE)
    right = jnp.clip(right, left + ASIDE, room)
    high = jnp.where(sides == LEFT, left, jnp.where(sides == MIDDLE, right, LARGEST))
    low = jnp.where(sides == RIGHT, right, jnp.where(sides == MIDDLE, left, -LARGEST))
    return high[:, None] if layout.even else jnp.stack([low, high], axis=1)


def places(layout: Layout, bound: jax.Array, narrow: jax.Array) -> jax.Array:
    """Where ends that do not move stand: on their bounds, or next to the other one's."""
    least = LEAST / layout.frequencies.highest
    low = jnp.where(narrow > 0, bound[:, 1] - least, bound[:, 0])
    return jnp.stack([low, jnp.where(narrow < 0, bound[:, 0] + least, bound[:, 1])], axis=1)


def gaps(layout: Layout, ends: jax.Array, rest: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Mean gap under each mode and its derivative by the ends: 2x² in these units, and the rows' own."""
    n = layout.modes
    if layout.even:
        b = ends[:, 0]
        zero = jnp.zeros_like(b)
        gap = [b * b + rest, 0.5 * b * b] + [zero] * (n - 2)
        slope = [2.0 * b, b] + [zero] * (n - 2)
        return jnp.stack(gap[:n], axis=1), jnp.stack(slope[:n], axis=1)[:, :, None]
    b, c = 0.5 * (ends[:, 1] - ends[:, 0]), 0.5 * (ends[:, 1] + ends[:, 0])
    zero = jnp.zeros_like(b)
    gap = [2.0 * c * c + b * b + rest, 2.0 * c * b, 0.5 * b * b] + [zero] * (n - 3)
    by_b = jnp.stack([2.0 * b, 2.0 * c, b] + [zero] * (n - 3), axis=1)
    by_c = jnp.stack([4.0 * c, 2.0 * b, zero] + [zero] * (n - 3), axis=1)
    return jnp.stack(gap, axis=1), jnp.stack([0.5 * (by_c - by_b), 0.5 * (by_c + by_b)], axis=-1)
