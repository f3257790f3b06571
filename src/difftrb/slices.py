"""Rollers in slices, for rings that tilt against each other: every slice carries by its own approach.

Slices follow ISO/TS 16281: q = (c/n) (δ − x ψ − 2P(x))^(10/9) at x along the roller, ψ the tilt in the roller's plane
and P the profile. A slice over a spall carries by the part of it that has land beneath.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp

from difftrb import curve, gap, hertz
from difftrb.geometry import LineContact, Real, Spall
from difftrb.law import spalls_under
from difftrb.ramp import Carried

LEAST = 1e-12
"""Share of a slice's land that is left where a spall takes all of it: its logarithm is needed."""


class Slices(NamedTuple):
    """The slices of a ring's rollers.

    Attributes:
      curves: what every slice carries, shape (rollers · slices,), roller by roller.
      levers: distance of every slice from the tilting centre along the roller [mm], shape (slices,).
      moments: about the radial and the lateral axis through that centre [N mm], shape (2,), or (0,) for rings that
        stay parallel.
    """

    curves: Carried
    levers: jax.Array
    moments: jax.Array

    def normals(self, normals: jax.Array, angles: jax.Array) -> jax.Array:
        """Directions of all slices in (radial, lateral, axial) and, if the rings tilt, (about radial, about lateral)
        times the longest lever; shape (rollers · slices, 3 or 5)."""
        straight = jnp.repeat(normals, self.levers.size, axis=0)
        if not self.moments.size:
            return straight
        turned = jnp.stack([jnp.sin(angles), -jnp.cos(angles)], axis=-1)  # n·(θ × p) = (θ_r sinφ − θ_l cosφ) x
        tilted = turned[:, None, :] * (self.levers / self.longest)[None, :, None]
        return jnp.concatenate([straight, tilted.reshape(-1, 2)], axis=1)

    @property
    def longest(self) -> jax.Array:
        """The longest lever [mm]."""
        return jax.lax.stop_gradient(jnp.max(jnp.abs(self.levers)))

    def in_radians(self, displacement: jax.Array, tangent: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Displacement [mm], [rad] and stiffness of the same units, from those by tilt times the longest lever."""
        scale = jnp.ones(displacement.size).at[3:].set(self.longest)
        return displacement / scale, tangent * scale[:, None] * scale[None, :]


def sliced(
    contact: LineContact, spalls: tuple[Spall, ...], distances: jax.Array, count: int, reach: Real, moments: jax.Array
) -> Slices:
    """Rollers at `distances` [mm] from `spalls`, shape (spalls, rollers), in `count` slices.

    `reach` is how far the tilting centre lies from the middle of the contact along the roller [mm], positive if nearer
    to the rollers' small ends; `moments` [N mm] about radial and lateral axis, shape (2,), or (0,).
    """
    places = contact.length * ((jnp.arange(count) + 0.5) / count - 0.5)
    stiffness = hertz.lamina_stiffness(contact.length) / count  # ISO/TS 16281:2008, eq. (38)
    land = jnp.stack([jnp.ones(count), *(1.0 - _covered(contact, spall, places) for spall in spalls)])
    under = spalls_under(spalls, distances)
    here = (under[:, None] == jnp.arange(land.shape[0])[None, :])[..., None]  # no gather: slow in a batch
    left = jnp.sum(jnp.where(here, land[None], 0.0), axis=1)
    K = stiffness * jnp.maximum(left, LEAST)
    slices = curve.power(K.ravel(), jnp.full(K.size, 10.0 / 9.0))
    profile = 2.0 * gap.crown_at(places, contact)  # both raceways
    slices = dataclasses.replace(slices, shift=jnp.tile(profile, under.size))
    return Slices(Carried(slices), places + reach, moments)


def _covered(contact: LineContact, spall: Spall, places: jax.Array) -> jax.Array:
    """What part of every slice a spall takes the land from, 0…1."""
    half = 0.5 * contact.length / places.size
    low = jnp.maximum(places - half, spall.axial_offset - 0.5 * spall.length)
    high = jnp.minimum(places + half, spall.axial_offset + 0.5 * spall.length)
    return jnp.maximum(high - low, 0.0) / (2.0 * half)
