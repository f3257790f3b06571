"""Phases of the cage over one roller pitch, and their weights in a mean.

Stiffness and loads have kinks (or jumps) where a roller meets an edge of a spall, and weaker ones where a roller takes
up load. Between them Gauss–Legendre points are few and exact; they move with the kinks, so that derivatives of a mean
hold what the kinks' motion adds: of a hard window that is all there is by width.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import geometry
from difftrb.core.geometry import Raceway, Spall, TaperedBearing
from difftrb.law import load_curve
from difftrb.law.base import Law
from difftrb.ring import ring
from difftrb.ring.ring import Load

POINTS = 10
"""Gauss–Legendre points between two kinks: 60 phases with one spall of soft edges."""


class Met(NamedTuple):
    """Spalls met on one raceway, and the law of rollers there."""

    raceway: Raceway
    spalls: tuple[Spall, ...]
    law: Law


def phases(
    bearing: TaperedBearing, load: Load, met: tuple[Met, ...], terms: ring.Terms = ring.PLAIN
) -> tuple[jax.Array, jax.Array]:
    """Angles of roller 0 [rad] over one pitch and their weights, which add up to 1; both of shape (phases,).

    The laws met, the outer raceway's first, say how far their edges reach; where the load zone ends is taken from the
    healthy bearing, at rest with `terms`.
    """
    rest = ring.equilibrium(bearing, load, (), met[0].law, 0.0, terms)
    rest = jax.tree.map(jnp.nan_to_num, rest)  # without an equilibrium any phases will do: each of them will say so
    alpha = bearing.outer_angle
    rows = (rest.displacement,) if terms.pair is None else terms.pair.rows(rest.displacement, alpha)
    kinks: list[jax.Array] = []
    for u in rows:
        cos_end = -u[2] * jnp.tan(alpha) / jnp.where(u[0] > 0.0, u[0], 1.0)
        partly = (jnp.abs(cos_end) < 1.0) & (u[0] > 0.0)
        zone = jnp.where(partly, jnp.arccos(jnp.where(partly, cos_end, 0.0)), 0.0)
        kinks += [zone, -zone]
    u = rows[0]  # whose rollers meet the spalls
    for raceway, spalls, law in met:
        radius = geometry.arc_radius(bearing, raceway)
        for i, spall in enumerate(spalls):
            for side in (1.0, -1.0):
                edge = jnp.asarray(spall.angle + side * 0.5 * spall.width / radius)
                if law.hard:
                    kinks.append(jnp.asarray(edge))
                    continue
                normal = ring.directions(bearing, jnp.reshape(edge, (1,)))[0]
                approach = jnp.dot(normal, u[:3], precision=jax.lax.Precision.HIGHEST)
                if terms.seat is not None:
                    approach = approach * _share(law, rest)
                for end in law.ramp(i, spall, approach):
                    kinks.append(jnp.asarray(edge - side * end / radius))
    whole = geometry.roller_pitch(bearing)
    starts = jnp.sort(jnp.stack([jnp.mod(kink, whole) for kink in kinks]))
    ends = jnp.concatenate([starts[1:], starts[:1] + whole])
    points, weights = np.polynomial.legendre.leggauss(POINTS)
    length = ends - starts
    at = starts[:, None] + length[:, None] * (0.5 + 0.5 * points)[None, :]
    share = (length / whole)[:, None] * (0.5 * weights)[None, :]
    return at.ravel(), share.ravel()


def _share(law: Law, rest: ring.Equilibrium) -> jax.Array:
    """What part of the ring's approach to the most loaded roller is the contact's in which `law` holds."""
    top = jnp.argmax(rest.loads)
    healthy = law.curves((), jnp.zeros((0, 1))).each
    own = load_curve.approach(load_curve.of(healthy, 0), jnp.maximum(rest.loads[top], 1.0))
    return own / jnp.maximum(rest.approach[top], own)
