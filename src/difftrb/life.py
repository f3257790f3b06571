"""Rating life of a tapered roller bearing: ISO 281 from its size and load, ISO/TS 16281 from every roller's load."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from difftrb import geometry
from difftrb.geometry import Real, TaperedBearing

QUALITY = 1.1
"""b_m of tapered roller bearings of today's steel (ISO 281)."""


def gamma(bearing: TaperedBearing) -> jax.Array:
    """D_we cosα/D_pw."""
    return geometry.mean_roller_radius(bearing) * jnp.cos(bearing.outer_angle) / geometry.pitch_radius(bearing)


def load_factor(ratio: Real) -> jax.Array:
    """f_c of radial roller bearings by D_we cosα/D_pw, 0.01…0.3: the formula behind the table of ISO 281."""
    raceways = (1.0 + (1.04 * _slower(ratio)) ** 4.5) ** (-2.0 / 9.0)
    size = ratio ** (2.0 / 9.0) * (1.0 - ratio) ** (29.0 / 27.0) / (1.0 + ratio) ** 0.25
    return 0.83 * 207.9 * size * raceways  # ISO/TR 1281-1, λν = 0.83


def load_rating(bearing: TaperedBearing) -> jax.Array:
    """Basic dynamic load rating C of one row [N]."""
    diameter = 2.0 * geometry.mean_roller_radius(bearing)
    length = bearing.roller_length * jnp.cos(bearing.outer_angle)
    f_c = load_factor(gamma(bearing))
    return QUALITY * f_c * length ** (7 / 9) * bearing.rollers**0.75 * diameter ** (29 / 27)  # ISO 281, i = 1


def equivalent_load(bearing: TaperedBearing, radial: Real, axial: Real) -> jax.Array:
    """Dynamic equivalent radial load P [N] of one row."""
    tan = jnp.tan(bearing.outer_angle)
    light = axial <= 1.5 * tan * radial  # e and Y of ISO 281
    return jnp.where(light, radial, 0.4 * radial + 0.4 / tan * axial)


def basic(bearing: TaperedBearing, rating: Real, radial: Real, axial: Real) -> jax.Array:
    """Basic rating life L10 [million revolutions]."""
    return (rating / equivalent_load(bearing, radial, axial)) ** (10.0 / 3.0)  # ISO 281


def reference(bearing: TaperedBearing, rating: Real, inner_loads: jax.Array, outer_loads: jax.Array) -> jax.Array:
    """Basic reference rating life L10r [million revolutions], inner ring turning, from what every roller presses on
    inner and outer raceway [N], shape (rollers,), evenly along its length."""
    slower = (1.038 * _slower(gamma(bearing))) ** 4.5
    each = rating / (bearing.rollers * jnp.cos(bearing.outer_angle))
    inner_rating = each / 0.378 * (1.0 + slower) ** (2.0 / 9.0)  # ISO/TS 16281
    outer_rating = each / 0.364 * (1.0 + 1.0 / slower) ** (2.0 / 9.0)  # ISO/TS 16281
    inner = _mean(inner_loads, 4.0) / inner_rating
    outer = _mean(outer_loads, 4.5) / outer_rating
    return (inner**4.5 + outer**4.5) ** (-8.0 / 9.0)  # ISO/TS 16281


def _mean(loads: jax.Array, power: float) -> jax.Array:
    top = jnp.max(loads)
    return top * jnp.mean((loads / top) ** power) ** (1.0 / power)


def _slower(ratio: Real) -> Real:
    return ((1.0 - ratio) / (1.0 + ratio)) ** (143.0 / 108.0)
