"""Where Newton's method for a ring's equilibrium begins, and its steps.

Rollers only push, so the unbalanced force is the gradient of a convex energy. It is differentiated where it vanishes,
with the tangent stiffness that Newton's method has anyway.

It begins at the load zone of a ring of so many rollers that sums over them are integrals. Rings that stay parallel
press a roller by δ(ψ) = δ_max (1 − s (1 − cos ψ)), ψ from the load line: s is 0 under an axial load alone, 1 with half
of the rollers loaded, and grows without limit as the zone becomes a point.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import implicit
from difftrb.core.geometry import Real
from difftrb.law import edge_ramp, load_curve
from difftrb.law.edge_ramp import RollerCurves
from difftrb.ring import roller_balance
from difftrb.ring.roller_balance import Seat
from difftrb.ring.terms import Terms

ITERATIONS = 60
TOLERANCE = 1e-12
"""Largest unbalanced force, relative to the load, at which an equilibrium counts as found."""
EXPONENTS = 1.1, 1.3
"""n of Q = K δⁿ between which everything is taken as straight: line contacts have 1.1, crowned ones more."""
NARROWEST = 0.98
"""Of F_r tan α/F_a, up to which the integrals stand for the sums: beyond, two or three rollers carry all."""
DEGREE = 8


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


RollerLoads = tuple[jax.Array, jax.Array]
"""Load [N] and its slope [N/mm] of every roller, both of shape (rollers,)."""


def _each(held: tuple[Seat | None, RollerCurves], approach: jax.Array) -> RollerLoads:
    seat, curves = held
    return edge_ramp.roller_loads(curves, approach) if seat is None else roller_balance.carried(seat, curves, approach)


class Rollers(NamedTuple):
    """What equilibrium needs of the rollers (or their slices): unit normals, shape (rollers, 3), interference [mm],
    shape (rollers,), what the outer raceway carries, and what else holds them."""

    normals: jax.Array
    interference: jax.Array
    curves: RollerCurves
    seat: Seat | None = None

    def approach(self, u: jax.Array) -> jax.Array:
        """Approach of the ring to every roller at displacement u [mm], shape (rollers,)."""
        return _dot(self.normals, u) + self.interference

    def carried(self, approach: jax.Array) -> RollerLoads:
        """What every roller carries at that."""
        return implicit.pointwise(_each, None, (self.seat, self.curves), approach)


def tangent(normals: jax.Array, slopes: jax.Array) -> jax.Array:
    """Σ dQ/dδ n nᵀ [N/mm], shape (3, 3)."""
    squares = normals[:, :, None] * normals[:, None, :]
    return _dot(slopes, squares.reshape(slopes.size, -1)).reshape(squares.shape[1:])


# ------------------------------------------------------------------------------------------------ the start


def _integrals(s: np.ndarray, exponent: float) -> tuple[np.ndarray, np.ndarray]:
    """Axial and radial load by what they would be were all rollers loaded as the first (Sjövall's integrals)."""
    angle = np.pi * (np.arange(2000) + 0.5) / 2000
    load = np.maximum(1.0 - s[:, None] * (1.0 - np.cos(angle)), 0.0) ** exponent
    return load.mean(axis=1), (load * np.cos(angle)).mean(axis=1)


def _fits(exponent: float) -> np.ndarray:
    """Coefficients in rising powers of F_r tan α/F_a of s and of the axial integral squared, both by how they end as
    the zone closes, shape (2, DEGREE + 1)."""
    s = np.concatenate([np.linspace(1e-3, 2.0, 200), np.geomspace(2.0, 20.0, 200)])
    axial, radial = _integrals(s, exponent)
    ratio = radial / axial
    values = s * (1.0 - ratio) / ratio, (1.0 - ratio) / axial**2
    return np.array([np.polynomial.Polynomial.fit(ratio, each, DEGREE).convert().coef for each in values])


_FITS = np.array([_fits(exponent) for exponent in EXPONENTS])


class LoadZone(NamedTuple):
    """s [-], and the largest roller load by F_a/(Z sin α) [-], any one shape."""

    narrowness: jax.Array
    largest: jax.Array


def load_zone(ratio: jax.Array, exponent: jax.Array) -> LoadZone:
    """The load zone at F_r tan α/F_a and n, any shape, both to some per cent."""
    ratio = jnp.clip(ratio, 0.0, NARROWEST)
    way = jnp.clip((exponent - EXPONENTS[0]) / (EXPONENTS[1] - EXPONENTS[0]), 0.0, 2.0)
    ends = [[jnp.polyval(jnp.asarray(one[::-1]), ratio) for one in fits] for fits in _FITS]
    narrow, wide = (low + way * (high - low) for low, high in zip(*ends, strict=True))
    return LoadZone(narrow * ratio / (1.0 - ratio), jnp.sqrt(wide / (1.0 - ratio)))


def norm(force: jax.Array) -> jax.Array:
    """Of a force or of moments, as a number that is not differentiated."""
    return jnp.linalg.norm(jax.lax.stop_gradient(force))


def start(rollers: Rollers, healthy: RollerCurves, force: jax.Array, terms: Terms) -> jax.Array:
    """Where Newton's method begins: the load zone of a healthy ring, or, of a pair of rows, all rollers as loaded as
    were the load shared equally. If all are clear of what they stand over, beyond the least of these gaps: without a
    loaded roller Newton's method knows no way."""
    if terms.axial is not None:
        return jnp.zeros(3).at[2].set(terms.axial)
    sound, count, axial = load_curve.of(healthy.each, 0), rollers.normals.shape[0], rollers.normals[0, 2]
    radial = jnp.sqrt(1.0 - axial**2)
    total = norm(force)
    if terms.tilting is not None:  # moments may be all that presses
        total = total + norm(terms.tilting.moments / terms.tilting.longest)
    largest, narrow = total / (count * axial), jnp.zeros(())
    if terms.pair is None:
        push = jnp.maximum(force[2], axial * norm(force))  # less than that holds no load; thrown rollers may take it
        share = push / (count * axial)
        at_share = load_curve.approach(sound, share)
        load, slope = load_curve.load(sound, at_share)
        zone = load_zone(force[0] * axial / (radial * push), at_share * slope / load)
        largest, narrow = share * zone.largest, zone.narrowness
    clear = jnp.maximum(jnp.min(rollers.curves.each.shift - rollers.interference), 0.0)
    pressed = load_curve.approach(sound, largest) + clear
    u = jax.lax.stop_gradient(pressed * jnp.stack([narrow / radial, jnp.zeros(()), (1.0 - narrow) / axial]))
    if terms.pair is None:
        return u
    # the first row pressed by the load, or both by the preload
    return u.at[2].set(jnp.maximum(u[2] - 0.5 * jax.lax.stop_gradient(terms.pair.preload), 0.0))


# ------------------------------------------------------------------------------------------------ the steps


class System(NamedTuple):
    """What is to be in balance.

    Attributes:
      rollers: what pushes. force: what they push against [N], shape (3,) (with tilt (5,)).
      start: the displacement to start from [mm], of the same shape. size: what forces are measured by [N].
      axial: the axial displacement [mm] if that is held.
    """

    rollers: Rollers
    force: jax.Array
    start: jax.Array
    size: jax.Array
    axial: Real | None


def found(system: System) -> tuple[jax.Array, RollerLoads, tuple[jax.Array, jax.Array]]:
    """The displacement in equilibrium [mm], shape (3,) (with tilt (5,)), what rollers carry there, the largest
    unbalanced force by what forces are measured by, and Newton steps."""
    return implicit.root(_unbalanced, _carried, _newton, _respond, system)


def _carried(u: jax.Array, system: System) -> RollerLoads:
    return system.rollers.carried(system.rollers.approach(u))


def _unbalanced(u: jax.Array, carried: RollerLoads, system: System) -> jax.Array:
    """Force left over at displacement u, relative to the load, shape (3,)."""
    return _linearised(u, carried, system)[0]


def _linearised(u: jax.Array, carried: RollerLoads, system: System) -> tuple[jax.Array, jax.Array]:
    """The unbalanced force and its derivative by u, relative to the load."""
    (rollers, force, start, size, axial), (loads, slopes) = system, carried
    unbalanced = (_dot(rollers.normals.T, loads) - force) / size  # Liu et al. 2018, eq. (5)
    jacobian = tangent(rollers.normals, slopes) / size
    if axial is None:
        return unbalanced, jacobian
    free = jnp.arange(u.size) != 2
    scale = 1.0 / jax.lax.stop_gradient(jnp.maximum(jnp.abs(start[2]), 1e-9))  # forces and [mm] in one size
    unbalanced = jnp.where(free, unbalanced, (u - axial) * scale)
    return unbalanced, jnp.where(free[:, None], jacobian, scale * jnp.eye(u.size))


def _respond(u: jax.Array, carried: RollerLoads, system: System, right: jax.Array) -> jax.Array:
    """By how much the displacement changes for a change of the unbalanced force."""
    return _solve(_linearised(u, carried, system)[1], right)


def _newton(system: System) -> tuple[jax.Array, RollerLoads, tuple[jax.Array, jax.Array]]:
    """A step p is taken unless the energy climbs again steeply at its end (force·p), else retaken shorter, by
    damping."""
    start = system.start

    def step(state):
        (u, carried, r, J), p, damping, k = state
        carried_new = _carried(u + p, system)
        r_new, J_new = _linearised(u + p, carried_new, system)
        better = jnp.vdot(r_new, p) <= 0.5 * jnp.abs(jnp.vdot(r, p))
        relaxed, stiffened = jnp.where(damping > 1e-9, 0.1 * damping, 0.0), jnp.maximum(10.0 * damping, 1e-4)
        now, before = (u + p, carried_new, r_new, J_new), (u, carried, r, J)
        u, carried, r, J = jax.tree.map(lambda new, old: jnp.where(better, new, old), now, before)
        damping = jnp.where(better, relaxed, stiffened)
        p = -_solve(J + damping * jnp.trace(J) * jnp.eye(start.size), r)
        return (u, carried, r, J), p, damping, k + 1

    def unfinished(state):
        (_, _, r, _), _, damping, k = state
        return (jnp.max(jnp.abs(r)) > 0.1 * TOLERANCE) & (k < ITERATIONS) & (damping < 1e6)

    none = jax.tree.map(lambda v: jnp.zeros(v.shape), jax.eval_shape(_carried, start, system))
    unknown = start, none, jnp.ones(start.size), jnp.zeros((start.size, start.size))
    first = unknown, jnp.zeros(start.size), jnp.zeros(()), jnp.asarray(-1)  # a step of no length finds what is there
    (u, carried, r, _), _, _, k = jax.lax.while_loop(unfinished, step, first)
    return u, carried, (jnp.max(jnp.abs(r)), k)


def _solve(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """x with matrix · x = right; of three by cofactors: in a batch many times faster than a factorisation."""
    if right.size != 3:
        return jnp.linalg.solve(matrix, right)
    a, b, c = matrix
    bc, ca, ab = jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)
    return (right[0] * bc + right[1] * ca + right[2] * ab) / jnp.vdot(a, bc)
