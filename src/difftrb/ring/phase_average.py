"""Phases of the cage over one roller pitch, and their weights in a mean.

Stiffness and loads have kinks (or jumps) where a roller meets an edge of a spall, and weaker ones where a roller takes
up load. Between them Gauss–Legendre points are few and exact; they move with the kinks, so that derivatives of a mean
hold what the kinks' motion adds: of a hard window that is all there is by width.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.geometry import Raceway, Spall, TaperedBearing
from difftrb.law import load_curve
from difftrb.law.base import Law
from difftrb.ring import ring
from difftrb.ring.ring import Load

POINTS = 10
"""Gauss–Legendre points between two kinks: 60 phases with one spall of soft edges. Losses are within 2e-5 of themselves
by the median of 30 random spalls, and within 7e-4 at worst."""


Rule = tuple[Any, Any]
"""Places in −1 … 1 and weights, which add up to 2, of a mean between two kinks, shape (points,) each."""


def gauss(points: int) -> Rule:
    """Gauss and Legendre's."""
    return np.polynomial.legendre.leggauss(points)


class Met(NamedTuple):
    """Spalls met on one raceway, and the law of rollers there."""

    raceway: Raceway
    spalls: tuple[Spall, ...]
    law: Law


def phases(
    bearing: TaperedBearing, load: Load, met: tuple[Met, ...], terms: ring.Terms = ring.PLAIN,
    rest: ring.Equilibrium | None = None, rule: Rule | None = None,
) -> tuple[Any, Any]:  # fmt: skip
    """Angles of roller 0 [rad] over one pitch and their weights, which add up to 1; both of shape (phases,).

    The laws met, the outer raceway's first, say how far their edges reach; where the load zone ends is taken from the
    healthy bearing, at `rest` with `terms` at phase 0; None: not known yet. `rule`: between two kinks; None: `gauss`
    with `POINTS`.
    """
    if rest is None:
        rest = ring.equilibrium(bearing, load, (), met[0].law, 0.0, terms)
    # without an equilibrium any phases will do: each of them will say so
    displacement = xp.where(xp.of(rest.displacement).isfinite(xp.value(rest.displacement)), rest.displacement, 0.0)
    alpha = bearing.outer_angle
    rows = (displacement,) if terms.pair is None else terms.pair.rows(displacement, alpha)
    kinks: list[Any] = []
    for u in rows:
        radial = u[0] > 0.0
        cos_end = -u[2] * xp.tan(alpha) / xp.where(radial, u[0], 1.0)
        partly = (cos_end > -1.0) & (cos_end < 1.0) & radial
        zone = xp.where(partly, xp.arccos(xp.where(partly, cos_end, 0.0)), 0.0)
        kinks += [zone, -zone]
    u = rows[0]  # whose rollers meet the spalls
    for raceway, spalls, law in met:
        radius = geometry.arc_radius(bearing, raceway)
        for i, spall in enumerate(spalls):
            sides = np.array([1.0, -1.0])
            edges = spall.angle + sides * (0.5 * spall.width / radius)
            if law.hard:
                kinks += [edges[0], edges[1]]
                continue
            approach = xp.einsum("si,i->s", ring.directions(bearing, edges), u[:3])
            if terms.seat is not None:
                approach = approach * _share(law, rest)
            for end in law.ramp(i, spall, approach):
                moved = edges - sides * end / radius
                kinks += [moved[0], moved[1]]
    whole = geometry.roller_pitch(bearing)
    kink = xp.stack([xp.mod(kink, whole) for kink in kinks])
    # a law that does not know its ramps says so itself
    kink = xp.where(xp.of(kink).isfinite(xp.value(kink)), kink, 0.0)
    starts = kink[xp.of(kink).argsort(xp.value(kink))]
    ends = xp.concatenate([starts[1:], starts[:1] + whole])
    places, weights = rule or gauss(POINTS)
    length = ends - starts
    at = starts[:, None] + length[:, None] * (0.5 + 0.5 * places)[None, :]
    share = (length / whole)[:, None] * (0.5 * weights)[None, :]
    return at.reshape(-1), share.reshape(-1)


def _share(law: Law, rest: ring.Equilibrium) -> jax.Array:
    """What part of the ring's approach to the most loaded roller is the contact's in which `law` holds."""
    top = jnp.argmax(rest.loads)
    healthy = law.curves((), jnp.zeros((0, 1))).each
    own = load_curve.approach(load_curve.of(healthy, 0), jnp.maximum(rest.loads[top], 1.0))
    return own / jnp.maximum(rest.approach[top], own)
