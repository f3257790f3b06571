"""The ends of a spall as cracks: how singular the pressure is there, and the energy that moving an end releases.

Beside a sharp edge that crosses the contact p → K(x)/√(2πs), s the distance from it. Where the land ends the two
bodies come apart as at the tip of a crack: an edge that draws back by da at constant load releases da ∫K² dx/(2E'),
E' the contact modulus (Irwin's K²(1−ν²)/E, for two bodies half of it each; Johnson 1985, §5.3; Maugis 2000, §3.2).
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap as gaps
from difftrb.contact import halfspace, projected_gradient, strip_rows
from difftrb.contact.contact_extent import clear_of_spall, domain
from difftrb.contact.contact_solution import Inputs, checked, is_symmetric, settled
from difftrb.contact.gap import Cells
from difftrb.contact.halfspace import EDGE_SHIFT
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real, Spall, as_floats
from difftrb.core.jax_config import jit_quickly

FIRST = 4  # rows at the edge that are left out: their own error is of the size of the pressure
TERMS = 3  # of 2πs p² as a polynomial in s
LEAST_LAND = 4.0  # in Hertz half-widths; on a shorter one the far end is felt at the edge
LEAST_ROWS = 32


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class EdgeIntensity(status.Judged):
    """How singular the pressure is at a spall's two ends.

    Attributes:
      x: places across the contact [mm], shape (columns,).
      low, high: K of p → K/√(2πs) at the ends of smaller and of larger y [N/mm^1.5], shape (columns,).
      release: ∫K² dx/(2E') of the two ends [N mm per mm by which that end draws back], shape (2,). Half their sum is
        the derivative of `energy` by the spall's length, high − low that by its axial offset.
      energy: complementary energy ∫δ dQ [N mm]. approach: δ [mm].
      residual: largest violation of the contact conditions relative to the approach.
      status_code: see `difftrb.status`; `status` is its sentence.
    """

    x: jax.Array
    low: jax.Array
    high: jax.Array
    release: jax.Array
    energy: jax.Array
    approach: jax.Array
    residual: jax.Array
    status_code: jax.Array


def edge_intensity(
    contact: LineContact, load: Real, spall: Spall, offset: Real = 0.0, land: int = 64, columns: int = 48
) -> EdgeIntensity:
    """The stress intensity along the two ends of a spall whose rolling edges are out of the contact's reach.

    Unlike `peak_pressure`, which grows as cells shrink, it has a limit. Solved on cells gathered at the ends.

    Args:
      contact, spall, offset: as in `solve_contact`. load: of the roller [N], > 0.
      land: rows on each land [-], ≥ 32. The release is short of the energy's derivative by at most 2.6, 0.7, 0.4,
        0.3 % with 32, 48, 64, 96 (experiments/energy_release.py).
      columns: cells across the contact [-], ≥ 16.

    The status is `UNSUITED` where a rolling edge is in reach of the contact, the roller reaches the spall's bottom, or
    a land is shorter than four contact half-widths. Differentiable by all numbers.
    """
    status.require_float64()
    for name, value, least in (("land", land, LEAST_ROWS), ("columns", columns, 16)):
        if value < least:
            raise status.SceneError(f"{name} = {value!r} is out of range: at least {least}")
    inputs = Inputs(as_floats(contact), jnp.asarray(load, float), as_floats(spall), jnp.asarray(offset, float))
    return _solve(inputs, is_symmetric(spall), land, columns)


@jit_quickly(static_argnames=("mirrored", "land", "columns"))
def _solve(inputs: Inputs, mirrored: bool, land: int, columns: int) -> EdgeIntensity:
    contact, load, spall, offset, _ = inputs
    assert isinstance(spall, Spall)
    reach_x, _, tip = domain(contact, load, (spall,), jnp.reshape(offset, 1))
    nowhere = jnp.asarray(jnp.inf)
    pitch, x = halfspace.lattice(reach_x * (1.0 + 2.0 / columns), columns, -nowhere, nowhere)
    ends = spall.ends
    least = 2e-3 * tip
    high = jnp.clip(ends[1], (0.0 if mirrored else -tip + 2.0 * least), tip - least)
    low = -high if mirrored else jnp.clip(ends[0], -tip + least, high - least)
    lands = [strip_rows.graded(end, tip, land, 3.0, 2.0) for end in ((high,) if mirrored else (-low, high))]
    drawn = [  # the discrete edge acts as the true one
        lines.at[0].add(-jnp.minimum(EDGE_SHIFT * (lines[1] - lines[0]), 0.25 * (high - low))) for lines in lands
    ]
    lines = drawn[0] if mirrored else jnp.concatenate([-drawn[0][::-1], drawn[1]])
    cells = Cells(pitch, x, lines, mirrored)
    gap = gaps.undeformed(cells, contact, None)
    if not mirrored:
        gap = gap.at[land].add(spall.depth)  # one row over the spall: it carries nothing
    level = gaps.first_level(cells, contact.radius)
    force, approach, residual, _ = projected_gradient.press(cells, contact.modulus, gap, load, level)

    line_loads = force / pitch
    seen = [0.5 * line_loads] if mirrored else [line_loads[land - 1 :: -1], line_loads[land + 1 :]]  # from the edge
    distances = [lines - lines[0] for lines in lands]
    mean = jnp.stack([jnp.sum(f) * pitch / s[-1] for f, s in zip(seen, distances, strict=True)])
    scale = jnp.maximum(gaps.line_half_width(mean, contact.radius, contact.modulus), 1e-6 * tip)
    squared = jnp.stack([intensity_squared(*pair) for pair in zip(distances, seen, scale, strict=True)])
    if mirrored:
        squared, scale = (jnp.concatenate([value, value]) for value in (squared, scale))
    positive = squared > 0.0
    intensity = jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)

    room = tip - jnp.stack([-ends[0], ends[1]])
    suited = clear_of_spall(contact, spall, offset, approach) & jnp.all(room > LEAST_LAND * scale)
    code = checked(inputs, settled(residual, projected_gradient.TOLERANCE), suited)
    return EdgeIntensity(
        x, intensity[0], intensity[1], jnp.sum(squared, axis=1) * pitch / (2.0 * contact.modulus),
        0.5 * (load * approach + jnp.sum(force * jnp.where(force > 0.0, gap, 0.0))), approach,
        jax.lax.stop_gradient(residual), code,
    )  # fmt: skip


def intensity_squared(distance: jax.Array, line_loads: jax.Array, scale: jax.Array) -> jax.Array:
    """K² of every column [N²/mm³], shape (columns,), from cells beside a straight edge.

    Args:
      distance: of the rows' borders from the edge [mm], shape (rows + 1,), the first 0.
      line_loads: force of a cell per its width along the edge [N/mm], shape (rows, columns).
      scale: length over which 2πs p² is a polynomial in the distance s [mm]: one Hertz half-width.

    A least-squares fit of a parabola to 2πs p² on the rows up to `scale`, without the first four. Summed over columns
    p² is nearly linear in s (p itself is not, where the edge leaves the contact). ∫p over a row, divided by ∫s^−1/2,
    is √s p at the mean of s weighted with s^−1/2.
    """
    root = jnp.concatenate([jnp.zeros(1), jnp.sqrt(distance[1:])])
    strength = line_loads / (2.0 * jnp.diff(root))[:, None]
    place = (distance[1:] + root[1:] * root[:-1] + distance[:-1]) / 3.0 / scale
    row = jnp.arange(place.shape[0])
    used = (row >= FIRST) & ((place < 1.0) | (row < FIRST + 2 * TERMS))
    terms = jnp.where(used[:, None], place[:, None] ** np.arange(TERMS)[None], 0.0)
    value = 2.0 * jnp.pi * strength**2
    return jnp.linalg.solve(terms.T @ terms, terms.T @ value)[0]
