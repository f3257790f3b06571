"""Where Newton's method for a ring's equilibrium begins, and its steps.

Rollers only push, so the unbalanced force is the gradient of a convex energy. It is differentiated where it vanishes,
with the tangent stiffness that Newton's method has anyway.

It begins at the load zone of a ring of so many rollers that sums over them are integrals. Rings that stay parallel
press a roller by δ(ψ) = δ_max (1 − s (1 − cos ψ)), ψ from the load line: s is 0 under an axial load alone, 1 with half
of the rollers loaded, and grows without limit as the zone becomes a point.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import implicit, numeric
from difftrb.core.geometry import Real
from difftrb.law import edge_ramp, load_curve
from difftrb.law.edge_ramp import RollerCurves
from difftrb.law.load_curve import Curve
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
RollerLoads = tuple[jax.Array, jax.Array]
"""Load [N] and its slope [N/mm] of every roller, both of shape (rollers,)."""


def _each(held: tuple[Seat | None, RollerCurves], approach: jax.Array) -> RollerLoads:
    seat, curves = held
    return edge_ramp.roller_loads(curves, approach) if seat is None else roller_balance.carried(seat, curves, approach)


class Rollers(NamedTuple):
    """What equilibrium needs of the rollers (or their slices): unit normals, shape (rollers, 3), interference [mm],
    shape (rollers,) or None, what the outer raceway carries, and what else holds them."""

    normals: Any
    interference: Any
    curves: RollerCurves
    seat: Seat | None = None

    def approach(self, u: Any) -> Any:
        """Approach of the ring to every roller at displacement u [mm], shape (rollers,)."""
        pressed = xp.einsum("...ri,...i->...r", self.normals, u)
        return pressed if self.interference is None else pressed + self.interference

    def carried(self, approach: Any) -> RollerLoads:
        """What every roller carries at that."""
        held = self.seat, self.curves
        return implicit.pointwise(_each, held, approach) if xp.of(approach) is jnp else _each(held, approach)


def tangent(normals: Any, slopes: Any) -> Any:
    """Σ dQ/dδ n nᵀ [N/mm], shape (…, 3, 3)."""
    return xp.einsum("...r,...rij->...ij", slopes, normals[..., :, None] * normals[..., None, :])


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


def load_zone(ratio: Any, exponent: Any) -> LoadZone:
    """The load zone at F_r tan α/F_a and n, any shape, both to some per cent."""
    ratio = xp.within(ratio, 0.0, NARROWEST)
    way = xp.within((exponent - EXPONENTS[0]) / (EXPONENTS[1] - EXPONENTS[0]), 0.0, 2.0)
    ends = [[numeric.horner(one, ratio) for one in fits] for fits in _FITS]
    narrow, wide = (low + way * (high - low) for low, high in zip(*ends, strict=True))
    return LoadZone(narrow * ratio / (1.0 - ratio), xp.sqrt(wide / (1.0 - ratio)))


def in_load_zone(healthy: Curve, force: Any, rollers: int, axial: Any) -> tuple[Any, Any]:
    """The most loaded roller's load [N], and s, of a healthy ring under `force` [N], shape (3,); `axial`: share of a
    roller's load along the axis."""
    radial = xp.sqrt(1.0 - axial**2)
    # less than that holds no load; thrown rollers may take it
    push = xp.maximum(force[2], axial * norm(force))
    share = push / (rollers * axial)
    at_share = load_curve.approach(healthy, share)
    load, slope = load_curve.load(healthy, at_share)
    zone = load_zone(force[0] * axial / (radial * push), at_share * slope / load)
    return share * zone.largest, zone.narrowness


def pressed(healthy: Curve, largest: Any, narrow: Any, axial: Any, clear: Any) -> Any:
    """The displacement [mm], shape (…, 3), in that zone, and `clear` [mm], shape (…), more."""
    deep = load_curve.approach(healthy, largest) + clear
    radial = xp.sqrt(1.0 - axial**2)
    return xp.stack([deep * (narrow / radial), xp.zeros_like(deep), deep * ((1.0 - narrow) / axial)], axis=-1)


def norm(force: Any) -> Any:
    """Of a force or of moments, as a number that is not differentiated."""
    force = xp.fixed(force)
    return xp.sqrt(xp.total(force * force))


def start(rollers: Rollers, healthy: RollerCurves, force: jax.Array, terms: Terms) -> jax.Array:
    """Where Newton's method begins: the load zone of a healthy ring, or, of a pair of rows, all rollers as loaded as
    were the load shared equally. If all are clear of what they stand over, beyond the least of these gaps: without a
    loaded roller Newton's method knows no way."""
    if terms.axial is not None:
        return jnp.zeros(3).at[2].set(terms.axial)
    sound, count, axial = load_curve.of(healthy.each, 0), rollers.normals.shape[0], rollers.normals[0, 2]
    force = xp.fixed(force)
    if terms.pair is None:
        largest, narrow = in_load_zone(sound, force, count, axial)
    else:
        total = norm(force)
        if terms.tilting is not None:  # moments may be all that presses
            total = total + norm(terms.tilting.moments / terms.tilting.longest)
        largest, narrow = total / (count * axial), jnp.zeros(())
    clear = jnp.maximum(jnp.min(rollers.curves.each.shift - rollers.interference), 0.0)
    u = xp.fixed(pressed(sound, largest, narrow, axial, clear))
    if terms.pair is None:
        return u
    # the first row pressed by the load, or both by the preload
    return u.at[2].set(jnp.maximum(u[2] - 0.5 * jax.lax.stop_gradient(terms.pair.preload), 0.0))


# ------------------------------------------------------------------------------------------------ the steps


class System(NamedTuple):
    """What is to be in balance.

    Attributes:
      rollers: what pushes. force: what they push against [N], shape (3,) (with tilt (5,)).
      start: the displacement to start from [mm], shape (…, 3). size: what forces are measured by [N].
      axial: the axial displacement [mm] if that is held.
    """

    rollers: Rollers
    force: Any
    start: Any
    size: Any
    axial: Real | None = None


def found(system: System) -> tuple[jax.Array, RollerLoads, tuple[jax.Array, jax.Array]]:
    """The displacement in equilibrium [mm], shape (3,) (with tilt (5,)), what rollers carry there, the largest
    unbalanced force by what forces are measured by, and Newton steps."""
    if xp.of(system.start) is np:
        return _newton(system)
    return implicit.root(_unbalanced, _carried, _newton, _respond, system)


def _carried(u: Any, system: System) -> RollerLoads:
    return system.rollers.carried(system.rollers.approach(u))


def _unbalanced(u: jax.Array, carried: RollerLoads, system: System) -> jax.Array:
    """Force left over at displacement u, relative to the load, shape (3,)."""
    return _linearised(u, carried, system)[0]


def _linearised(u: jax.Array, carried: RollerLoads, system: System) -> tuple[jax.Array, jax.Array]:
    """The unbalanced force and its derivative by u, relative to the load."""
    (rollers, force, start, size, axial), (loads, slopes) = system, carried
    opposed = force.reshape((1,) * (u.ndim - 1) + force.shape)
    unbalanced = (xp.einsum("...r,...ri->...i", loads, rollers.normals) - opposed) / size  # Liu et al. 2018, eq. (5)
    jacobian = tangent(rollers.normals, slopes) / size
    if axial is None:
        return unbalanced, jacobian
    free = jnp.arange(u.size) != 2
    scale = 1.0 / jax.lax.stop_gradient(jnp.maximum(jnp.abs(start[2]), 1e-9))  # forces and [mm] in one size
    unbalanced = jnp.where(free, unbalanced, (u - axial) * scale)
    return unbalanced, jnp.where(free[:, None], jacobian, scale * jnp.eye(u.size))


def _respond(u: jax.Array, carried: RollerLoads, system: System, right: jax.Array) -> jax.Array:
    """By how much the displacement changes for a change of the unbalanced force."""
    return solve(_linearised(u, carried, system)[1], right)


class _State(NamedTuple):
    """A search after some steps: displacements, what holds there, the step to try and how much it is damped."""

    u: Any
    now: Any
    step: Any
    damping: Any
    count: Any


def damped(balance: Callable[[Any], Any], start: Any) -> tuple[Any, Any, Any, Any]:
    """Where `balance(u)`, at displacements u of shape (…, n), has a `residual` of 0; from its `jacobian`.

    Returns u, the balance there, the largest residual and the number of steps. A step p is taken unless the energy
    climbs again steeply at its end (force·p), else retaken shorter, by damping. Numbers are solved at once.
    """
    unit = np.eye(start.shape[-1])

    def tried(state: _State) -> _State:
        u, now, p, damping, count = state
        new = balance(u + p)
        of = xp.of(new)
        better = of.sum(new.residual * p, axis=-1) <= 0.5 * of.abs(of.sum(now.residual * p, axis=-1))

        def kept(one: Any, other: Any) -> Any:
            return of.where(better.reshape(better.shape + (1,) * (one.ndim - better.ndim)), one, other)

        u, now = kept(u + p, u), jax.tree.map(kept, new, now)
        relaxed, stiffened = of.where(damping > 1e-9, 0.1 * damping, 0.0), of.maximum(10.0 * damping, 1e-4)
        damping = of.where(better, relaxed, stiffened)
        more = damping * of.trace(now.jacobian, axis1=-2, axis2=-1)
        p = -solve(now.jacobian + more[..., None, None] * unit.reshape((1,) * more.ndim + unit.shape), now.residual)
        return _State(u, now, of.where(_far(now)[..., None], p, 0.0), damping, count + 1)

    def unfinished(state: _State) -> Any:
        of = xp.of(state.u)
        return of.any(_far(state.now) & (state.damping < 1e6)) & (state.count < ITERATIONS)

    still, none = xp.zeros_like(start), xp.zeros_like(start[..., 0])
    if isinstance(start, jax.Array):  # a step of no length finds what is there
        balance = jax.jit(balance)  # traced once
        blank = jax.tree.map(lambda v: jnp.zeros(v.shape), jax.eval_shape(balance, start))
        first = _State(start, blank._replace(residual=jnp.ones(start.shape)), still, none, jnp.asarray(-1))
        last = jax.lax.while_loop(unfinished, tried, first)
    else:
        last = tried(_State(start, balance(start), still, none, -1))
        while unfinished(last):
            last = tried(last)
    of = xp.of(last.u)
    return last.u, last.now, of.max(of.abs(last.now.residual)), last.count


def _far(now: Any) -> Any:
    """Which residuals are not small enough yet."""
    of = xp.of(now.residual)
    return of.max(of.abs(now.residual), axis=-1) > 0.1 * TOLERANCE


class _Balance(NamedTuple):
    """What rollers carry at a displacement, the unbalanced force and its derivative."""

    carried: RollerLoads
    residual: jax.Array
    jacobian: jax.Array


def _newton(system: System) -> tuple[jax.Array, RollerLoads, tuple[jax.Array, jax.Array]]:
    """The solution, what rollers carry there, the largest unbalanced force and the number of steps."""

    def balance(u: jax.Array) -> _Balance:
        carried = _carried(u, system)
        return _Balance(carried, *_linearised(u, carried, system))

    u, now, residual, count = damped(balance, system.start)
    return u, now.carried, (residual, count)


def solve(matrix: Any, right: Any) -> Any:
    """x with matrix · x = right, shapes (…, n, n), (…, n); of three by cofactors: in a batch many times faster than a
    factorisation."""
    of = xp.of(matrix, right)
    if right.shape[-1] != 3:
        return of.linalg.solve(matrix, right[..., None])[..., 0]
    a, b, c = (matrix[..., k, :] for k in range(3))
    bc, ca, ab = of.cross(b, c), of.cross(c, a), of.cross(a, b)
    x = right[..., 0:1] * bc + right[..., 1:2] * ca + right[..., 2:3] * ab
    return x / of.sum(a * bc, axis=-1, keepdims=True)
