"""Rings that tilt against each other: two more degrees of freedom, about the radial and about the lateral axis."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp


class Tilting(NamedTuple):
    """What a tilt does to the rollers of a ring, or to their slices.

    Attributes:
      levers: of every roller's (or slice's) normal about the tilting centre [mm], shape (rollers · slices,), roller by
        roller: its approach per tilt in its own plane.
      moments: about the radial and the lateral axis through that centre [N mm], shape (2,).
    """

    levers: jax.Array
    moments: jax.Array

    def directions(self, normals: jax.Array, angles: jax.Array) -> jax.Array:
        """Directions in (radial, lateral, axial, about radial, about lateral), the last two times the longest lever;
        from normals of shape (rollers · slices, 3) of rollers at `angles` [rad], shape (rollers,)."""
        turned = jnp.stack([jnp.sin(angles), -jnp.cos(angles)], axis=-1)  # n·(θ × p) = (θ_r sinφ − θ_l cosφ) x
        turned = jnp.repeat(turned, self.levers.size // angles.size, axis=0)
        return jnp.concatenate([normals, turned * (self.levers / self.longest)[:, None]], axis=1)

    @property
    def longest(self) -> jax.Array:
        """The longest lever [mm]."""
        return jax.lax.stop_gradient(jnp.max(jnp.abs(self.levers)))

    def in_radians(self, displacement: jax.Array, tangent: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Displacement [mm], [rad] and stiffness of the same units, from those by tilt times the longest lever."""
        scale = jnp.ones(displacement.size).at[3:].set(self.longest)
        return displacement / scale, tangent * scale[:, None] * scale[None, :]
