"""Rating life of a tapered roller bearing: ISO 281 from its size and load, ISO/TS 16281 from every roller's load."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from difftrb.core import geometry
from difftrb.core.geometry import Real, TaperedBearing

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


def load_rating(bearing: TaperedBearing, rows: int = 1) -> jax.Array:
    """Basic dynamic load rating C of a bearing of one row, or of two [N]."""
    diameter = 2.0 * geometry.mean_roller_radius(bearing)
    length = rows * bearing.roller_length * jnp.cos(bearing.outer_angle)
    f_c = load_factor(gamma(bearing))
    return QUALITY * f_c * length ** (7 / 9) * bearing.rollers**0.75 * diameter ** (29 / 27)  # ISO 281


def equivalent_load(bearing: TaperedBearing, radial: Real, axial: Real, rows: int = 1) -> jax.Array:
    """Dynamic equivalent radial load P [N] of one row, or of two back to back or face to face."""
    tan, axial = jnp.tan(bearing.outer_angle), jnp.abs(axial) if rows == 2 else axial
    light = axial <= 1.5 * tan * radial  # e, X and Y of ISO 281
    if rows == 2:
        return jnp.where(light, radial + 0.45 / tan * axial, 0.67 * radial + 0.67 / tan * axial)
    return jnp.where(light, radial, 0.4 * radial + 0.4 / tan * axial)


def basic(bearing: TaperedBearing, rating: Real, radial: Real, axial: Real, rows: int = 1) -> jax.Array:
    """Basic rating life L10 [million revolutions]; `rating` is that of all rows."""
    return (rating / equivalent_load(bearing, radial, axial, rows)) ** (10.0 / 3.0)  # ISO 281


def reference(bearing: TaperedBearing, rating: Real, inner_loads: jax.Array, outer_loads: jax.Array) -> jax.Array:
    """Basic reference rating life L10r [million revolutions], inner ring turning, from what every roller presses on
    inner and outer raceway [N], shape (rollers,) or (rows, rollers), evenly along its length; `rating` is that of all
    rows."""
    slower = (1.038 * _slower(gamma(bearing))) ** 4.5
    rows = outer_loads.size // bearing.rollers
    each = rating / (bearing.rollers * jnp.cos(bearing.outer_angle) * rows ** (7.0 / 9.0))
    inner_rating = each / 0.378 * (1.0 + slower) ** (2.0 / 9.0)  # ISO/TS 16281
    outer_rating = each / 0.364 * (1.0 + 1.0 / slower) ** (2.0 / 9.0)  # ISO/TS 16281
    inner = _mean(inner_loads, 4.0) / inner_rating
    outer = _mean(outer_loads, 4.5) / outer_rating
    return jnp.sum(inner**4.5 + outer**4.5) ** (-8.0 / 9.0)  # ISO/TS 16281: rows live as raceways do, all or none


def _mean(loads: jax.Array, power: float) -> jax.Array:
    """Over every row, shape () or (rows,)."""
    top = jnp.max(loads, axis=-1, keepdims=True)
    shares = loads / jnp.where(top > 0.0, top, 1.0)  # a row may carry nothing
    mean = jnp.mean(shares**power, axis=-1)
    return top[..., 0] * jnp.where(mean > 0.0, mean, 1.0) ** (1.0 / power)


def _slower(ratio: Real) -> Real:
    return ((1.0 - ratio) / (1.0 + ratio)) ** (143.0 / 108.0)
