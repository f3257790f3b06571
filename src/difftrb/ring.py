"""The ring on its rollers: equilibrium, load distribution and stiffness of the plain bearing.

Three degrees of freedom of one ring against the other: radial (along the load line, angle 0), lateral (a quarter turn
on) and axial (pressing the rings together). One contact per roller, the outer raceway's.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
from annotated_types import Interval, Unit

from difftrb import curve, geometry, implicit, ramp, status
from difftrb.geometry import FILE_RULES, Real, Spall, TaperedBearing
from difftrb.law import Law
from difftrb.ramp import Carried

ITERATIONS = 60
TOLERANCE = 1e-12
"""Largest unbalanced force, relative to the load, at which an equilibrium counts as found."""


@partial(jax.tree_util.register_dataclass, data_fields=["radial", "axial"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Load:
    """The bearing's load.

    Attributes:
      radial: along the load line [N], 0…1e7.
      axial: pressing the rings together [N], 0…1e7; needs to exceed about radial × tan(outer_angle).
    """

    __pydantic_config__ = FILE_RULES

    radial: Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]
    axial: Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["displacement", "approach", "loads", "tangent", "residual", "iterations", "status_code"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class Equilibrium:
    """A ring at rest.

    Attributes:
      displacement: radial, lateral, axial [mm], shape (3,).
      approach: of every roller [mm], shape (rollers,), negative where it is clear of the raceway.
      loads: of every roller [N], shape (rollers,).
      tangent: dF/du [N/mm], shape (3, 3).
      residual: largest unbalanced force relative to the load. iterations: Newton steps. status_code: `difftrb.status`.
    """

    displacement: jax.Array
    approach: jax.Array
    loads: jax.Array
    tangent: jax.Array
    residual: jax.Array
    iterations: jax.Array
    status_code: jax.Array


def roller_angles(bearing: TaperedBearing, phase: Real) -> jax.Array:
    """Angle of every roller from the load line [rad], shape (rollers,); roller 0 stands at `phase`."""
    return phase + geometry.roller_pitch(bearing) * jnp.arange(bearing.rollers)


def directions(bearing: TaperedBearing, angles: jax.Array) -> jax.Array:
    """Unit normals of the rollers' contacts in (radial, lateral, axial), shape (rollers, 3)."""
    cos, sin = jnp.cos(bearing.outer_angle), jnp.sin(bearing.outer_angle)
    axial = jnp.broadcast_to(sin, angles.shape)
    return jnp.stack([cos * jnp.cos(angles), cos * jnp.sin(angles), axial], axis=-1)  # Liu et al. 2018, eq. (5)


def distances(bearing: TaperedBearing, spalls: tuple[Spall, ...], angles: jax.Array) -> jax.Array:
    """From every spall's centre to every roller's contact, along the raceway [mm], shape (spalls, rollers)."""
    centres = jnp.stack([jnp.asarray(spall.angle, float) for spall in spalls]) if spalls else jnp.zeros(0)
    away = jnp.mod(angles[None, :] - centres[:, None] + jnp.pi, 2.0 * jnp.pi) - jnp.pi
    return geometry.arc_radius(bearing) * away


def needed_axial(bearing: TaperedBearing, radial: Real, phase: Real) -> jax.Array:
    """The axial load [N] that must be exceeded for an equilibrium under `radial` [N].

    Rollers push only: the load must lie inside the cone spanned by their normals, that is, the point
    radial·tanα/axial on the load line inside the polygon of the rollers' angles.
    """
    edges = roller_angles(bearing, phase) + 0.5 * geometry.roller_pitch(bearing)
    reach = jnp.max(jnp.cos(edges)) / jnp.cos(0.5 * geometry.roller_pitch(bearing))
    return radial * jnp.tan(bearing.outer_angle) * reach


def largest_load(bearing: TaperedBearing, load: Load) -> Real:
    """A first estimate of the most loaded roller's load [N]."""
    half_zone = 4.08 * load.radial / (bearing.rollers * jnp.cos(bearing.outer_angle))  # NSK E728g, line contact
    shared = load.axial / (bearing.rollers * jnp.sin(bearing.outer_angle))
    all_loaded = shared + 2.0 * load.radial / (bearing.rollers * jnp.cos(bearing.outer_angle))  # a cosine on a mean
    return jnp.maximum(half_zone, all_loaded)


def equilibrium(
    bearing: TaperedBearing,
    load: Load,
    spalls: tuple[Spall, ...],
    roller_law: Law,
    phase: Real,
    interference: Real = 0.0,
) -> Equilibrium:
    """The ring's rest position under `load`, its roller loads and tangent stiffness.

    `phase` is the angle of roller 0 from the load line [rad]; `interference` what every roller is too thick, added to
    its approach [mm], one number or shape (rollers,). Differentiable by everything, forward and reverse, at
    the solution. Where there is no equilibrium the numbers are NaN and the status says so.
    """
    angles = roller_angles(bearing, phase)
    normals = directions(bearing, angles)
    valid = (load.radial >= 0.0) & (load.axial >= 0.0) & jnp.isfinite(load.radial + load.axial + phase)
    for spall in spalls:
        valid = valid & geometry.spall_is_sound(spall)
    held = load.axial > needed_axial(bearing, load.radial, phase) * (1.0 + 1e-6)
    force = jnp.stack([jnp.asarray(load.radial, float), jnp.zeros(()), jnp.asarray(load.axial, float)])
    safe = jnp.where(valid & held, force, jnp.array([0.0, 0.0, 1.0]))

    away = distances(bearing, spalls, angles)
    known = roller_law.judge(spalls, away)
    extra = jnp.broadcast_to(interference, angles.shape)
    sound = Rollers(normals, extra, roller_law.curves((), away[:0]))
    start = _start(sound, safe)
    rollers = Rollers(normals, extra, roller_law.curves(spalls, away)) if spalls else sound
    u, (residual, iterations) = implicit.root(_unbalanced, _newton, solve_3x3, (rollers, safe, start))
    approach = rollers.approach(u)
    loads, slopes = ramp.carried(rollers.curves, approach)
    tangent = _tangent(normals, slopes)

    converged = (residual <= TOLERANCE) & jnp.all(jnp.isfinite(u))
    code = jnp.where(converged, status.CONVERGED, status.NOT_CONVERGED)
    code = jnp.where(known == status.CONVERGED, code, known)
    code = jnp.where(held, code, status.NO_EQUILIBRIUM)
    code = jnp.where(valid, code, status.BAD_INPUT)
    code = status.worst(code, jnp.asarray(roller_law.status_code).astype(int))
    usable = valid & held & (known == status.CONVERGED)

    def only_if_usable(value: jax.Array) -> jax.Array:
        return jnp.where(usable, value, jnp.nan)

    u, approach, loads, tangent, residual = map(only_if_usable, (u, approach, loads, tangent, residual))
    return Equilibrium(u, approach, loads, tangent, residual, iterations, code)


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


class Rollers(NamedTuple):
    """What equilibrium needs of the rollers: unit normals, shape (rollers, 3), interference [mm], shape (rollers,), and
    what they carry."""

    normals: jax.Array
    interference: jax.Array
    curves: Carried

    def approach(self, u: jax.Array) -> jax.Array:
        """Approach of every roller at displacement u [mm], shape (rollers,)."""
        return _dot(self.normals, u) + self.interference


def _tangent(normals: jax.Array, slopes: jax.Array) -> jax.Array:
    """Σ dQ/dδ n nᵀ [N/mm], shape (3, 3)."""
    return _dot(normals.T * slopes[None, :], normals)


Ring = tuple[Rollers, jax.Array, jax.Array]
"""Rollers, force [N] and a displacement to start from [mm], both of shape (3,)."""


def _unbalanced(u: jax.Array, parameters: Ring) -> jax.Array:
    """Force left over at displacement u, relative to the load, shape (3,)."""
    return _system(u, parameters)[0]


def _system(u: jax.Array, parameters: Ring) -> tuple[jax.Array, jax.Array]:
    """The unbalanced force and its derivative by u, relative to the load."""
    rollers, force, _ = parameters
    loads, slopes = ramp.carried(rollers.curves, rollers.approach(u))
    unbalanced = _dot(rollers.normals.T, loads) - force  # Liu et al. 2018, eq. (5)
    return unbalanced / _size(force), _tangent(rollers.normals, slopes) / _size(force)


def _size(force: jax.Array) -> jax.Array:
    return jnp.linalg.norm(jax.lax.stop_gradient(force))


def _start(rollers: Rollers, force: jax.Array) -> jax.Array:
    """All rollers as loaded as the first one would be, were the load shared equally."""
    axial = rollers.normals[0, 2]
    share = _size(force) / (rollers.normals.shape[0] * axial)
    return jnp.zeros(3).at[2].set(curve.approach(curve.of(rollers.curves.each, 0), share) / axial)


def _newton(parameters: Ring) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """Newton's method on a convex energy, of which the unbalanced force is the gradient.

    A step p is taken unless it climbs again steeply at its end (force·p), else retaken shorter, by damping.
    """
    *_, start = parameters

    def step(state):
        u, r, J, damping, k = state
        p = -solve_3x3(J + damping * jnp.trace(J) * jnp.eye(3), r)
        r_new, J_new = _system(u + p, parameters)
        better = jnp.vdot(r_new, p) <= 0.5 * jnp.abs(jnp.vdot(r, p))
        relaxed, stiffened = jnp.where(damping > 1e-9, 0.1 * damping, 0.0), jnp.maximum(10.0 * damping, 1e-4)
        u, r, J = (jnp.where(better, new, old) for new, old in ((u + p, u), (r_new, r), (J_new, J)))
        return u, r, J, jnp.where(better, relaxed, stiffened), k + 1

    def unfinished(state):
        _, r, _, damping, k = state
        return (jnp.max(jnp.abs(r)) > 0.01 * TOLERANCE) & (k < ITERATIONS) & (damping < 1e6)

    state = start, *_system(start, parameters), jnp.zeros(()), jnp.asarray(0)
    u, r, _, _, k = jax.lax.while_loop(unfinished, step, state)
    return u, (jnp.max(jnp.abs(r)), k)


def solve_3x3(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """x with matrix · x = right, by cofactors: in a batch many times faster than a factorisation."""
    a, b, c = matrix
    bc, ca, ab = jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)
    return (right[0] * bc + right[1] * ca + right[2] * ab) / jnp.vdot(a, bc)
