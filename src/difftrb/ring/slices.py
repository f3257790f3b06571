"""Rollers in slices, for rings that tilt against each other: every slice carries by its own approach.

Slices follow ISO/TS 16281: q = (c/n) (δ − x ψ − 2P(x))^(10/9) at x along the roller, ψ the tilt in the roller's plane
and P the profile. A slice over a spall carries by the part of it that has land beneath.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap, hertz
from difftrb.core.geometry import LineContact, Spall
from difftrb.law import load_curve
from difftrb.law.edge_ramp import Carried
from difftrb.law.laws import spalls_under

LEAST = 1e-12
"""Share of a slice's land that is left where a spall takes all of it: its logarithm is needed."""


def without_land(carried: Carried) -> jax.Array:
    """Which slices a spall takes all land from, shape (rollers · slices,)."""
    stiffness = carried.each.coefficients[0]  # its logarithm
    return stiffness < jnp.max(stiffness) + 0.5 * np.log(LEAST)


def places(contact: LineContact, count: int) -> jax.Array:
    """Middles of `count` slices along the roller from its own middle [mm], shape (count,)."""
    return contact.length * ((jnp.arange(count) + 0.5) / count - 0.5)


def sliced(contact: LineContact, spalls: tuple[Spall, ...], distances: jax.Array, count: int) -> Carried:
    """What every slice carries of rollers at `distances` [mm] from `spalls`, shape (spalls, rollers), in `count` slices
    each; shape (rollers · slices,), roller by roller."""
    at = places(contact, count)
    stiffness = hertz.lamina_stiffness(contact.length) / count  # ISO/TS 16281:2008, eq. (38)
    land = jnp.stack([jnp.ones(count), *(1.0 - _covered(contact, spall, at) for spall in spalls)])
    under = spalls_under(spalls, distances)
    here = (under[:, None] == jnp.arange(land.shape[0])[None, :])[..., None]  # no gather: slow in a batch
    left = jnp.sum(jnp.where(here, land[None], 0.0), axis=1)
    K = stiffness * jnp.maximum(left, LEAST)
    slices = load_curve.power(K.ravel(), jnp.full(K.size, 10.0 / 9.0))
    profile = 2.0 * gap.crown_at(at, contact)  # both raceways
    return Carried(dataclasses.replace(slices, shift=jnp.tile(profile, under.size)))


def _covered(contact: LineContact, spall: Spall, places: jax.Array) -> jax.Array:
    """What part of every slice a spall takes the land from, 0…1."""
    half = 0.5 * contact.length / places.size
    low = jnp.maximum(places - half, spall.axial_offset - 0.5 * spall.length)
    high = jnp.minimum(places + half, spall.axial_offset + 0.5 * spall.length)
    return jnp.maximum(high - low, 0.0) / (2.0 * half)
