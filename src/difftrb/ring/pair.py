"""Two rows of one bearing on one shaft, the second one the other way round.

The shaft's axial load presses the first row's rings together and takes the second one's apart. Spalls are met by the
first row alone; rollers of both stand at the same angles. A tilt about the middle between the rows moves either of them
by the distance of its load centre from there, which is why back to back is stiffer than face to face.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from difftrb.core import geometry
from difftrb.core.geometry import Real, TaperedBearing

NOWHERE = 1e4
"""Distance from a spall [mm] that none is wide enough for."""


class Pair(NamedTuple):
    """How the second row stands to the first.

    Attributes:
      preload: axial way by which both rows together are pressed beyond touching [mm]; negative is end play.
      reach: of the middle between the rows from the first row's load centre, along its rollers towards their small
        ends [mm]: its lever about that middle; the second row's is opposite. None: the shaft does not tilt.
    """

    preload: Real
    reach: Real | None = None

    def rows(self, displacement: jax.Array, outer_angle: Real) -> tuple[jax.Array, jax.Array]:
        """Radial, lateral and axial displacement [mm] by which rings would approach the rollers of either row as the
        shaft's `displacement` does ([mm] and, if it tilts, [rad]), both of shape (3,)."""
        u, half, moved = displacement, 0.5 * self.preload, jnp.zeros(2)
        if self.reach is not None:
            moved = self.reach / jnp.cos(outer_angle) * jnp.stack([-u[4], u[3]])
        first = jnp.append(u[:2] + moved, u[2] + half)
        return first, jnp.append(u[:2] - moved, half - u[2])


def both(normals: jax.Array) -> jax.Array:
    """Normals of both rows in (radial, lateral, axial), shape (2 · rollers, 3), from those of the first."""
    return jnp.concatenate([normals, normals * jnp.array([[1.0, 1.0, -1.0]])])


def beside(distances: jax.Array) -> jax.Array:
    """`distances` from the spalls [mm], shape (spalls, 2 · rollers), from those of the first row; the second one has no
    spall."""
    return jnp.concatenate([distances, jnp.full_like(distances, NOWHERE)], axis=1)


def reach(bearing: TaperedBearing, spacing: Real, back_to_back: bool) -> jax.Array:
    """See `Pair`; `spacing` is the distance between the middles of both rows' outer contacts [mm]."""
    # the contacts' normals meet the axis R tanα from the rows, behind the rollers' large ends
    apart = 0.5 * spacing * jnp.cos(bearing.outer_angle)
    centre = geometry.outer_raceway_radius(bearing) * jnp.sin(bearing.outer_angle)
    return jnp.asarray(centre + apart if back_to_back else centre - apart)
