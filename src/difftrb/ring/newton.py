"""The balance of forces on a ring, and Newton's method for it.

Rollers only push, so the unbalanced force is the gradient of a convex energy. It is differentiated where it vanishes,
with the tangent stiffness that Newton's method has anyway.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from difftrb.core import implicit
from difftrb.core.geometry import Real
from difftrb.law import edge_ramp
from difftrb.law.edge_ramp import Carried
from difftrb.ring import roller_balance
from difftrb.ring.roller_balance import Seat

ITERATIONS = 60
TOLERANCE = 1e-12
"""Largest unbalanced force, relative to the load, at which an equilibrium counts as found."""


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


RollerLoads = tuple[jax.Array, jax.Array]
"""Load [N] and its slope [N/mm] of every roller, both of shape (rollers,)."""


def _each(held: tuple[Seat | None, Carried], approach: jax.Array) -> RollerLoads:
    seat, curves = held
    return edge_ramp.carried(curves, approach) if seat is None else roller_balance.carried(seat, curves, approach)


class Rollers(NamedTuple):
    """What equilibrium needs of the rollers (or their slices): unit normals, shape (rollers, 3), interference [mm],
    shape (rollers,), what the outer raceway carries, and what else holds them."""

    normals: jax.Array
    interference: jax.Array
    curves: Carried
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


System = tuple[Rollers, jax.Array, jax.Array, jax.Array, Real | None]
"""Rollers, force [N] and a displacement to start from [mm], both of shape (3,), what forces are measured by [N], and
the axial displacement [mm] if that is held."""


def found(system: System) -> tuple[jax.Array, RollerLoads, tuple[jax.Array, jax.Array]]:
    """The displacement in equilibrium [mm], shape (3,) (with tilt (5,)), what rollers carry there, the largest
    unbalanced force by what forces are measured by, and Newton steps."""
    return implicit.root(_unbalanced, _carried, _newton, _respond, system)


def _carried(u: jax.Array, system: System) -> RollerLoads:
    return system[0].carried(system[0].approach(u))


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
    start = system[2]

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
