"""Rows along the roller: a piecewise linear line load, of hats."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core.numeric import gauss_legendre


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Rows:
    """Hats that peak on `lines`, shape (panels + 1,), increasing.

    On the border beside a spall's `edge` ("low", "high", "both" or "none") line load may jump: half a hat peaks there.
    On other borders it is zero: no hat. With `middle` the first line is the roller's middle and has a hat that goes on
    into its mirror image.
    """

    lines: Any
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

    @property
    def steps(self) -> Any:
        """Lengths of the panels."""
        return self.lines[1:] - self.lines[:-1]

    def hats(self, inner: Any, first: Any, last: Any) -> Any:
        """One value for every hat, of those given for inner lines and for the border lines, where they have one."""
        low, high = self.borders
        return xp.concatenate([first[None]] * (low or self.middle) + [inner] + [last[None]] * high)


def graded(start: Any, end: Any, count: int, at_start: float, at_end: float) -> Any:
    """`count` + 1 lines from `start` to `end`; their distance from either grows there like the given power."""
    u = np.linspace(0.0, 1.0, count + 1)
    share = u**at_start / (u**at_start + (1.0 - u) ** at_end) if at_start > 1.0 else 1.0 - (1.0 - u) ** at_end
    return start + (end - start) * share


def integrals(rows: Rows, function: Callable[[Any], Any]) -> Any:
    """∫ hat f dy of every hat, shape (hats,), by six Gauss points on each panel."""
    x, w = gauss_legendre(6)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    steps = rows.steps
    values = function(rows.lines[:-1][:, None] + steps[:, None] * x[None, :]) * steps[:, None]
    falling, rising = (xp.einsum("pg,g->p", values, weight) for weight in (w * (1.0 - x), w * x))
    return rows.hats(rising[:-1] + falling[1:], falling[0], rising[-1])


def weights(groups: tuple[Rows, ...]) -> Any:
    """∫ hat dy of every hat of all groups, shape (hats,)."""
    return xp.concatenate([integrals(rows, xp.ones_like) for rows in groups])


def arms(groups: tuple[Rows, ...]) -> Any:
    """∫ hat y dy of all rows, (rows,)."""
    return xp.concatenate([integrals(rows, lambda y: y) for rows in groups])


def shares(rows: Rows, borders: Any) -> Any:
    """∫ hat dy between neighbouring `borders`, shape (hats, len(borders) - 1)."""
    u = xp.clip((borders[None] - rows.lines[:-1, None]) / rows.steps[:, None], 0.0, 1.0)
    rising, falling = 0.5 * u * u, u - 0.5 * u * u
    parts = [xp.diff(f * rows.steps[:, None], axis=-1) for f in (rising, falling)]
    return rows.hats(parts[0][:-1] + parts[1][1:], parts[1][0], parts[0][-1])


def mass(groups: tuple[Rows, ...]) -> Any:
    """∫ hat hat dy, shape (hats, hats); groups do not overlap."""
    blocks = []
    for rows in groups:
        steps, eye = rows.steps, np.eye(rows.count)
        own = rows.hats((steps[:-1] + steps[1:]) / 3.0, steps[0] / 3.0, steps[-1] / 3.0)
        low, high = rows.borders
        beside = steps[0 if low or rows.middle else 1 : len(steps) if high else len(steps) - 1] / 6.0
        beside = xp.concatenate([beside, np.zeros(1)])
        beside = beside[:, None] * np.eye(rows.count, k=1) + beside[None] * np.eye(rows.count, k=-1)
        blocks.append(own[:, None] * eye + beside)
    return xp.block_diagonal(blocks)


def on_points(rows: Rows) -> Any:
    """The lines, and the mirror image of the first after the middle, if there is one."""
    return xp.concatenate([-rows.lines[1:2], rows.lines]) if rows.middle else rows.lines


def second_differences(rows: Rows) -> tuple[Any, np.ndarray]:
    """The matrices that take f at the points, and f′ at borders with half a hat, to ∫ hat f″ dy."""
    points = on_points(rows)
    count, (low, high) = points.shape[0] - 1, rows.borders
    slopes = (np.eye(count, count + 1, 1) - np.eye(count, count + 1)) / (points[1:] - points[:-1])[:, None]
    none = np.zeros((1, count + 1))
    slopes = xp.concatenate([none] * low + [slopes] + [none] * high)
    stencil = slopes[1:] - slopes[:-1]
    if rows.middle:
        stencil = stencil * np.append(0.5, np.ones(rows.count - 1))[:, None]
    at_borders = np.zeros((rows.count, low + high))
    if low:
        at_borders[0, 0] = -1.0
    if high:
        at_borders[-1, -1] = 1.0
    return stencil, at_borders
