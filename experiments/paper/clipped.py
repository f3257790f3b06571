"""The contact as the paper seems to have solved it: uniform cells on a domain narrower than the contact.

A domain that ends inside the contact cuts it off: load and edges are carried by what is left, so it is softer than the
half-space. That is no model of a roller; it lives here only to show where the paper's Table 2 comes from.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap as gaps
from difftrb.contact import halfspace, projected_gradient
from difftrb.contact.gap import Cells
from difftrb.core.geometry import LineContact, Real, Spall

PAPER_GRID = (400, 40)
"""Rows along the roller, columns across it: the grid of the paper's pressure figure."""
NARROWED = 0.7
"""Half width of the domain by Hertz's half width with which Table 2 comes out on the outer raceway: `01_table2`."""


LOADS = np.geomspace(1500.0, 12000.0, 15)
"""Roller loads [N] to which the paper's laws are fitted, as far as can be told."""


class Uniform(NamedTuple):
    """A contact on uniform cells: approach [mm], pressure [N/mm²] of shape (rows, columns), cells, residual."""

    approach: jax.Array
    pressure: jax.Array
    cells: Cells
    residual: jax.Array


def solve(
    contact: LineContact, load: Real, spall: Spall | None, offset: Real, reach: Real, size: tuple[int, int]
) -> Uniform:
    """One contact on `size` (rows, columns) uniform cells over the whole roller and ±`reach` Hertz half widths.

    `offset` of the spall's middle in the rolling direction [mm]. A cell is spall when its middle is: sizes are rounded
    to whole cells, as in the paper.
    """
    rows, columns = size
    half_width = gaps.line_half_width(load / contact.length, contact.radius, contact.modulus)
    half = reach * half_width
    pitch = jnp.asarray(2.0 * half / columns)
    x = pitch * (jnp.arange(columns) + 0.5) - half
    lines = 0.5 * contact.length * jnp.linspace(-1.0, 1.0, rows + 1)
    cells = Cells(pitch, x, lines, False)
    gap = gaps.undeformed(cells, contact, None)
    if spall is not None:
        gap = gap + gaps.depression(cells, spall, offset)
    lowest = jnp.min(gap)
    matrix = halfspace.uniform_influence(cells, jnp.asarray(contact.modulus))
    force, approach, residual, _ = projected_gradient.press_by(
        matrix, cells.area, gap - lowest, load, gaps.first_level(cells, contact.radius)
    )
    return Uniform(approach + lowest, force / cells.area, cells, residual)


@partial(jax.jit, static_argnames=("size",))
def approaches(
    contact: LineContact, loads: jax.Array, lengths: jax.Array, reach: Real, size: tuple[int, int]
) -> jax.Array:
    """Approach [mm] over the middle of wide spalls of `lengths` (0: healthy) at `loads`: shape (lengths, loads)."""

    def one(case: tuple[jax.Array, jax.Array]) -> jax.Array:
        length, load = case
        spall = Spall(length, 100.0, jnp.where(length > 0.0, 0.2, 0.0))
        return solve(contact, load, spall, 0.0, reach, size).approach

    cases = jnp.meshgrid(lengths, loads, indexing="ij")
    found = jax.lax.map(one, (cases[0].ravel(), cases[1].ravel()))
    return found.reshape(lengths.size, loads.size)


class Fit(NamedTuple):
    """Q = K δⁿ of several spall lengths: K [N/mmⁿ], n, and the largest relative error of Q; shape (…, lengths)."""

    stiffness: np.ndarray
    exponent: np.ndarray
    error: np.ndarray


def power_fit(loads: np.ndarray, approach: np.ndarray) -> Fit:
    """Least squares in log Q over log δ; `approach` of shape (…, lengths, loads)."""
    x, y = np.log(approach), np.log(loads)
    middle = x.mean(axis=-1, keepdims=True)
    exponent = ((x - middle) * (y - y.mean())).sum(axis=-1) / ((x - middle) ** 2).sum(axis=-1)
    stiffness = np.exp(y.mean() - exponent * middle[..., 0])
    error = np.abs(stiffness[..., None] * approach ** exponent[..., None] / loads - 1.0).max(axis=-1)
    return Fit(stiffness, exponent, error)
