"""How rows see one another: the integrals of K₀(κ|y−y'|) over pairs of hats, at every frequency κ across the roller."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import strip_rows
from difftrb.contact.bickley import integrals_k0, k0_and_k1
from difftrb.contact.strip_rows import Rows
from difftrb.core import arrays as xp
from difftrb.core.arrays import value

NEAR = 2.0
"""κ times distance up to which hats that do not overlap take the kernel's integrals from zero; beyond, from infinity,
which for them is the same. Either way differences of them lose the fewest digits."""
ROUNDING = 1e-15
"""Of those integrals. Where a pair of hats would lose more to it than a product of moments leaves out, it is one."""


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
    return xp.moved_last(summed)


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
