"""Newton's method for a ring's equilibrium, and for rollers that settle between its raceways beside it.

Rollers only push, so the unbalanced force is the gradient of a convex energy. It is differentiated where it vanishes,
with the tangent stiffness that Newton's method has anyway.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import implicit
from difftrb.core.geometry import Real
from difftrb.law import roller_curves
from difftrb.law.roller_curves import RollerCurves
from difftrb.ring import roller_balance
from difftrb.ring.roller_balance import Seat, Settling

ITERATIONS = 150
"""Steps at most. Most rings take 3 … 15; where a roller is barely touched, and holds a direction alone, up to 100."""
TOLERANCE = 1e-12
"""Largest unbalanced force, relative to the load, at which an equilibrium counts as found. The search goes on to a
tenth of this."""
LEAST_DAMPING, FIRST_DAMPING, MOST_DAMPING = 1e-9, 1e-4, 1e6
"""What is added to the diagonal of the jacobian, in parts of its trace: it falls tenfold with every step that is taken,
to 0 below the least; grows tenfold with every one that is not, from 0 to the first; with more than the most no step
leads on."""
PER_MM = 1e3
"""What a displacement is measured by beside forces [1/mm]: about as a ring's stiffness by its load."""
RollerLoads = tuple[jax.Array, jax.Array]
"""Load [N] and its slope [N/mm] of every roller, both of shape (rollers,)."""


def _each(held: tuple[Seat | None, RollerCurves, Any], approach: jax.Array) -> RollerLoads:
    seat, curves, inside = held
    if seat is None:
        return roller_curves.roller_loads(curves, approach)
    return roller_balance.outer_loads(seat, curves, approach, inside)


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

    def carried(self, approach: Any, inside: Any = None) -> RollerLoads:
        """What every roller carries at that; `inside` as in `roller_balance`."""
        held = self.seat, self.curves, inside
        return implicit.pointwise(_each, held, approach) if xp.module_of(approach) is jnp else _each(held, approach)


def tangent(normals: Any, slopes: Any) -> Any:
    """Σ dQ/dδ n nᵀ [N/mm], shape (…, 3, 3)."""
    return xp.einsum("...r,...rij->...ij", slopes, normals[..., :, None] * normals[..., None, :])


def norm(force: Any) -> Any:
    """Of forces or of moments, shape (…, n), as numbers that are not differentiated."""
    force = xp.fixed(force)
    return xp.sqrt(xp.total(force * force))


def aligned(force: Any, u: Any) -> Any:
    """`force` with axes of length 1 in front, to broadcast against `u`."""
    return force.reshape(*(1,) * (u.ndim - force.ndim), *force.shape)


def of_each(rings: Any, value: Any) -> Any:
    """`rings`, shape () or (…), with axes of length 1 behind, to broadcast against `value`."""
    return rings.reshape(*rings.shape, *(1,) * (value.ndim - rings.ndim)) if np.ndim(rings) else rings


class System(NamedTuple):
    """What is to be in balance.

    Attributes:
      rollers: what pushes. force: what they push against [N], shape (3,) (with tilt (5,)), or (…, 3) of rings under
        loads of their own.
      start: the displacement to start from [mm], shape (…, 3). size: what forces are measured by [N], shape () or (…).
      axial: the axial displacement [mm] if that is held.
    """

    rollers: Rollers
    force: Any
    start: Any
    size: Any
    axial: Real | None = None


class Reported(NamedTuple):
    """Of a search: the largest unbalanced force by what forces are measured by, Newton steps, and where rollers rest
    `inside`, see `roller_balance`; None: nothing else holds them, or it does not give way."""

    residual: Any
    iterations: Any
    inside: Any = None


def found(system: System) -> tuple[jax.Array, RollerLoads, Reported]:
    """The displacement in equilibrium [mm], shape (3,) (with tilt (5,)), what rollers carry there, and how it was
    found."""
    # counted from the start: of rings with end play the whole way is much longer than what presses rollers
    start = system.start
    near = system._replace(
        rollers=system.rollers._replace(interference=system.rollers.approach(start)), start=xp.zeros_like(start),
        axial=None if system.axial is None else system.axial - start[..., 2],
    )  # fmt: skip
    if xp.of_jax(system):
        near = near._replace(start=jnp.asarray(near.start))
        way, carried, reported = implicit.root(_unbalanced, _carried, _newton, _respond, near)
    else:
        way, carried, reported = _newton(near)
    return start + way, carried, cast(Reported, reported)


def _carried(u: Any, system: System, reported: Reported | None = None) -> RollerLoads:
    inside = None if reported is None else reported.inside
    return system.rollers.carried(system.rollers.approach(u), inside)


def _unbalanced(u: jax.Array, carried: RollerLoads, system: System) -> jax.Array:
    """Force left over at displacement u, relative to the load, shape (3,)."""
    return _linearised(u, carried, system)[0]


def _linearised(u: jax.Array, carried: RollerLoads, system: System) -> tuple[jax.Array, jax.Array]:
    """The unbalanced force and its derivative by u, relative to the load."""
    (rollers, force, _, size, axial), (loads, slopes) = system, carried
    pushed = xp.einsum("...r,...ri->...i", loads, rollers.normals)
    unbalanced = (pushed - aligned(force, u)) / of_each(size, u)  # Liu et al. 2018, eq. (5)
    jacobian = tangent(rollers.normals, slopes)
    jacobian = jacobian / of_each(size, jacobian)
    return (unbalanced, jacobian) if axial is None else with_axial(axial, u, unbalanced, jacobian)


def with_axial(axial: Any, u: Any, unbalanced: Any, jacobian: Any) -> tuple[Any, Any]:
    """The unbalanced force and its derivative by u where in place of the axial force the axial displacement is given
    [mm]."""
    unit = np.eye(u.shape[-1])
    off, given = (u - of_each(axial, u)) * PER_MM, aligned(unit[2] > 0.0, u)
    moved = PER_MM * aligned(unit, jacobian)
    return xp.where(given, off, unbalanced), xp.where(given[..., None], moved, jacobian)


def _respond(u: jax.Array, carried: RollerLoads, system: System, right: jax.Array) -> jax.Array:
    """By how much the displacement changes for a change of the unbalanced force."""
    return solve(_linearised(u, carried, system)[1], right)


class _State(NamedTuple):
    """A search after some steps: displacements, what holds there, the step to try and how much it is damped; of rollers
    that have to settle, where they are tried next, alone in a tuple."""

    u: Any
    now: Any
    step: Any
    damping: Any
    count: Any
    inside: tuple[Any, ...] = ()


class RingBalance(NamedTuple):
    """What rollers carry at a displacement, the unbalanced force and its derivative, by what forces are measured by;
    the same of rollers that have to settle: how far from rest they are."""

    carried: RollerLoads
    residual: Any
    jacobian: Any
    settling: Settling | None = None
    unsettled: Any = None


Settle = Callable[[Settling, Any, Any], Any]
"""Where rollers are tried next: from where they are, and the displacement before the step and the step."""


def damped(
    balance: Callable[..., RingBalance], start: Any, inside: tuple[Any, ...] = (), settle: Settle | None = None
) -> tuple[Any, Any, Any, Any]:
    """Where `balance(u)`, at displacements u of shape (…, n), has a `residual` of 0; from its `jacobian`.

    Returns u, the balance there, the largest residual and the number of steps. A step p is taken unless the energy
    climbs again steeply at its end (force·p), else retaken shorter, by damping. Numbers are solved at once.

    Rollers that have to settle do so beside it: `balance(u, *inside)`, a step of Newton's method for theirs. After a
    step that is not taken the ring waits for them.
    """
    unit = np.eye(start.shape[-1])

    def tried(state: _State) -> _State:
        return stepped(state, balance(state.u + state.step, *state.inside))

    def stepped(state: _State, new: RingBalance) -> _State:
        u, now, p, damping, count, inside = state
        of, better = xp.module_of(new), _is_better(now, new, p)

        def kept(one: Any, other: Any) -> Any:
            return of.where(better.reshape(better.shape + (1,) * (one.ndim - better.ndim)), one, other)

        u, now = kept(u + p, u), jax.tree.map(kept, new, now)
        relaxed, stiffened = (
            of.where(damping > LEAST_DAMPING, 0.1 * damping, 0.0),
            of.where(damping > 0.0, 10.0 * damping, FIRST_DAMPING),
        )
        if settle is not None:
            relaxed = of.where(of.any(p != 0.0, axis=-1), relaxed, damping)
        damping = of.where(better, relaxed, stiffened)
        trace = of.trace(now.jacobian, axis1=-2, axis2=-1)
        more = of.where(trace > 0.0, damping * trace, PER_MM)
        p = -solve(now.jacobian + more[..., None, None] * unit.reshape((1,) * more.ndim + unit.shape), now.residual)
        p = of.where(_far(now)[..., None], p, 0.0)
        if settle is not None:
            p = of.where(better[..., None], p, 0.0)
            inside = (settle(cast(Settling, now.settling), u, p),)
        return _State(u, now, p, damping, count + 1, inside)

    def unfinished(state: _State) -> Any:
        of = xp.module_of(state.u)
        return of.any(_far(state.now) & (state.damping < MOST_DAMPING)) & (state.count < ITERATIONS)

    still, none = xp.zeros_like(start), xp.zeros_like(start[..., 0])
    if isinstance(start, jax.Array):  # a step of no length finds what is there
        balance = jax.jit(balance, inline=True)  # traced once
        blank = jax.tree.map(lambda v: jnp.zeros(v.shape), jax.eval_shape(balance, start, *inside))
        first = _State(start, blank._replace(residual=jnp.ones(start.shape)), still, none, jnp.asarray(-1), inside)
        last = jax.lax.while_loop(unfinished, tried, first)
    else:
        first = balance(start, *inside)
        last = stepped(_State(start, first, still, none, -1, inside), first)
        while unfinished(last):
            last = tried(last)
    off = _largest(last.now)
    return last.u, last.now, xp.module_of(off).max(off), last.count


def _is_better(now: RingBalance, new: RingBalance, p: Any) -> Any:
    """Whether a step p from `now` to `new` is taken, shape (…)."""
    of = xp.module_of(new)
    better = of.sum(new.residual * p, axis=-1) <= 0.5 * of.abs(of.sum(now.residual * p, axis=-1))
    better = better & of.isfinite(_largest(new))  # a step may be so long that loads overflow
    # or that no roller is loaded, from where the way back is short steps; short ones may cross a gap so
    short = of.max(of.abs(p), axis=-1) * PER_MM <= 1.0
    return better & ((new.jacobian[..., 0, 0] > 0.0) | (now.jacobian[..., 0, 0] == 0.0) | short)


def _largest(now: RingBalance) -> Any:
    """Of all residuals, shape (…)."""
    of = xp.module_of(now.residual)
    found = of.max(of.abs(now.residual), axis=-1)
    return found if now.unsettled is None else of.maximum(found, of.max(of.abs(now.unsettled), axis=-1))


def _far(now: RingBalance) -> Any:
    """Which residuals are not small enough yet."""
    return _largest(now) > 0.1 * TOLERANCE


def _newton(system: System) -> tuple[jax.Array, RollerLoads, Reported]:
    """The solution, what rollers carry there, and how it was found."""
    seat, curves = system.rollers.seat, system.rollers.curves
    if seat is not None and seat.gives_way:
        return _newton_settling(system, seat, curves)

    def balance(u: jax.Array) -> RingBalance:
        carried = _carried(u, system)
        return RingBalance(carried, *_linearised(u, carried, system))

    u, now, residual, count = damped(balance, system.start)
    return u, now.carried, Reported(residual, count)


def _newton_settling(system: System, seat: Seat, curves: RollerCurves) -> tuple[Any, RollerLoads, Reported]:
    """The same of rollers that have to settle between outer raceway and seat."""
    approach = system.rollers.approach

    def balance(u: Any, inside: Any) -> RingBalance:
        at = roller_balance.settling(seat, curves, approach(u), inside)
        carried = at.load, at.slope
        far = at.excess / of_each(system.size, at.excess)
        return RingBalance(carried, *_linearised(u, carried, system), at, far)

    def settle(at: Settling, u: Any, step: Any) -> Any:
        after = approach(u + step)
        return roller_balance.settled(seat, curves, at, after, after - approach(u))

    inside = roller_balance.half_way(seat, curves, approach(system.start))
    u, now, residual, count = damped(balance, system.start, (inside,), settle)
    return u, now.carried, Reported(residual, count, cast(Settling, now.settling).inside)


def solve(matrix: Any, right: Any) -> Any:
    """x with matrix · x = right, shapes (…, n, n), (…, n); of three by cofactors: in a batch many times faster than a
    factorisation."""
    if right.shape[-1] != 3:
        return xp.solved(matrix, right[..., None])[..., 0]
    rows, determinant = cofactors(matrix)
    x = right[..., 0:1] * rows[..., 0, :]
    x = x + right[..., 1:2] * rows[..., 1, :] + right[..., 2:3] * rows[..., 2, :]
    return x / determinant[..., None]


def cofactors(matrix: Any) -> tuple[Any, Any]:
    """Of matrices of shape (…, 3, 3), and their determinants."""
    of = xp.module_of(matrix)
    a, b, c = (matrix[..., k, :] for k in range(3))
    bc, ca, ab = of.cross(b, c), of.cross(c, a), of.cross(a, b)
    return of.stack([bc, ca, ab], axis=-2), of.sum(a * bc, axis=-1)
