"""One roller between the outer raceway, the inner raceway and the flange: what each of them carries.

The ring pushes a roller by the approach D along the outer normal; outer contact, inner contact and flange share that so
that the roller rests. Angles are from the bearing's radial plane, in a plane through its axis: the outer normal's α,
the inner normal's β, and φ of the flange's face, to which the flange's force is square.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.geometry import Real, TaperedBearing
from difftrb.core.taylor import Taylor, parameters_of
from difftrb.law import roller_curves
from difftrb.law.roller_curves import RollerCurves

ROUNDS = 40
"""Of the bracketed Newton method for the inner approach, at most: the laws are nearly straight, four or five do."""
CLOSE = 1e-4
"""Last step, relative to what it led to, after which two more of Newton's method end at rounding."""


class Seat(NamedTuple):
    """What holds a roller besides the outer raceway.

    Attributes:
      outer, inner, flange: the angles α, β, φ [rad].
      centrifugal: force on every roller, away from the bearing's axis [N], shape (); None: there is none.
      inner_curves: what the inner raceway carries; None: it does not give way.
      flange_compliance: c in c Q^(2/3), the approach of roller and flange [mm/N^(2/3)]; None: it does not give way.
    """

    outer: Real
    inner: Real
    flange: Real
    centrifugal: Real | None = None
    inner_curves: RollerCurves | None = None
    flange_compliance: Real | None = None

    @property
    def gives_way(self) -> bool:
        """Whether where a roller rests between outer raceway and seat has to be looked for."""
        return self.inner_curves is not None or self.flange_compliance is not None

    @property
    def outer_cos(self) -> Any:
        """Share of an outer force along the flange's face."""
        return xp.cos(self.outer - self.flange)

    @property
    def inner_cos(self) -> Any:
        """Share of an inner force along the flange's face."""
        return xp.cos(self.inner - self.flange)

    @property
    def ratio(self) -> Any:
        """Of the outer raceway's force by the inner one's, without what is thrown outwards."""
        return self.inner_cos / self.outer_cos

    @property
    def centrifugal_force(self) -> Any:
        """Centrifugal force [N], 0 if there is none."""
        return 0.0 if self.centrifugal is None else self.centrifugal

    @property
    def centrifugal_along_flange(self) -> Any:
        """Centrifugal force along the flange's face [N]."""
        return self.centrifugal_force * xp.cos(self.flange)

    @property
    def wedge(self) -> Any:
        """Share of an outer force that the flange takes of a roller between both raceways."""
        return xp.sin(self.outer - self.inner) / self.inner_cos

    @property
    def least_outer_load(self) -> Any:
        """What the outer raceway carries of a roller that the inner one does not touch [N]."""
        return self.centrifugal_along_flange / self.outer_cos


def seat(bearing: TaperedBearing) -> Seat:
    """Angles of `bearing`; an inner raceway and a flange that do not give way."""
    return Seat(bearing.outer_angle, bearing.inner_angle, geometry.flange_force_angle(bearing))


def inner_load(seat: Seat, outer_load: Any) -> Any:
    """Force of the inner raceway [N] on a roller at rest that carries `outer_load` [N], any shape."""
    # forces along the flange's face, which its own force is square to: Liu et al. 2022, eq. (5)
    return xp.maximum(outer_load * seat.outer_cos - seat.centrifugal_along_flange, 0.0) / seat.inner_cos


def flange_load(seat: Seat, outer_load: Any) -> Any:
    """Force of the flange [N] on a roller at rest that carries `outer_load` [N], any shape."""
    # forces square to the inner normal, or to none if the inner raceway is not touched: Liu et al. 2022, eq. (5)
    free = outer_load * xp.sin(seat.outer - seat.flange) + seat.centrifugal_force * xp.sin(seat.flange)
    return xp.where(outer_load * seat.outer_cos > seat.centrifugal_along_flange, _wedged(seat, outer_load), free)


def inside(seat: Seat | None, outer_load: Any) -> dict[str, Any]:
    """`inner_loads` and `flange_loads` [N] of rollers at rest that carry `outer_load` [N]; none without a seat."""
    if seat is None:
        return {}
    return {"inner_loads": inner_load(seat, outer_load), "flange_loads": flange_load(seat, outer_load)}


def _wedged(seat: Seat, outer_load: Any) -> Any:
    """Of a roller that touches both raceways."""
    return outer_load * seat.wedge + seat.centrifugal_force * xp.sin(seat.inner) / seat.inner_cos


def outer_loads(
    seat: Seat, outer_curves: RollerCurves, approach: jax.Array, inside: jax.Array | None = None
) -> tuple[jax.Array, jax.Array]:
    """Outer load [N] and its slope [N/mm] of every roller whose ring has approached it by `approach` [mm], all of shape
    (rollers,). Q is at least what the centrifugal force presses outwards. `inside`: where rollers rest, if it is known,
    see `Settling`; without derivatives."""
    if not seat.gives_way:
        load, slope = roller_curves.roller_loads(outer_curves, approach)
        if seat.centrifugal is None:
            return load, slope
        return xp.maximum(load, seat.least_outer_load), xp.where(load > seat.least_outer_load, slope, 0.0)
    near = _looked_for(seat, outer_curves, approach) if inside is None else inside
    pressed = _followed(seat, outer_curves, approach, near)
    rest = _balance(seat, outer_curves, approach, pressed)
    touched = pressed > 0.0
    return jnp.where(touched, rest.load, seat.least_outer_load), jnp.where(touched, rest.slope, 0.0)


def expanded_loads(seat: Seat | None, outer_curves: RollerCurves, approach: Any, inside: Any) -> Taylor:
    """As `roller_curves.expanded_loads`, of rollers that rest at `inside` between outer raceway and a seat that gives
    way: where they rest is carried along (implicit function theorem)."""
    count = parameters_of((approach, seat, outer_curves))

    def spread(of: Any) -> Any:  # by as many parameters as all the rest
        return of + Taylor(np.zeros([1] * of.ndim), np.zeros((count, *[1] * of.ndim))) if count else of

    if seat is None or (seat.centrifugal is None and not seat.gives_way):
        return roller_curves.expanded_loads(outer_curves, approach)
    if not seat.gives_way:
        loads = roller_curves.expanded_loads(outer_curves, spread(approach))
        least = xp.with_variable(approach, seat)[1].least_outer_load
        return xp.where(loads > least, loads, least)
    if xp.module_of(inside) is jnp:  # JAX, too, may differentiate
        own_seat, own_curves, at = xp.values((seat, outer_curves, approach))
        inside = _followed(own_seat, own_curves, at, inside)

    place, held = xp.with_variable(spread(inside), seat)
    inner, moved = _placed(held, place)
    outside = spread(approach) - Taylor(moved.value, moved.by[:-1]) if count else approach - moved.value
    outer = roller_curves.expanded_loads(outer_curves, outside)
    slope, rate, pace = outer.by[-1:], inner.by[-1:], moved.by[-1:]
    falling = slope * pace + rate
    falling = xp.where(falling > 0.0, falling, 1.0)
    last = (np.arange(count + 1) == count).reshape(-1, *[1] * inner.ndim)  # by the ring's approach
    follows = xp.where(last, slope, outer.by - inner.by) / falling

    def along(at: Any, of: Taylor, way: Any) -> Taylor:  # its slope, as parameters and the ring move
        return Taylor(at[0], xp.where(last, 0.0, of.mixed) + of.mixed[-1:] * way)

    outer_slope = along(slope, outer, last - pace * follows)
    inner_slope, own_pace = along(rate, inner, follows), along(pace, moved, follows)
    whole = outer_slope * own_pace + inner_slope
    by_approach = outer_slope * inner_slope / xp.where(whole > 0.0, whole, 1.0)
    pressed = Taylor(inner.value, xp.where(last, 0.0, inner.by) + rate * follows, by_approach.by)
    return xp.where(inside > 0.0, pressed, held.least_outer_load)


def _placed(seat: Seat, inside: Any) -> tuple[Any, Any]:
    """Outer load of a roller in balance [N], and by how much it is displaced along the outer normal [mm]: at an inner
    approach [mm], or, if the inner raceway does not give way, at an inner load [N]."""
    ratio = seat.ratio
    if seat.inner_curves is None:
        inner, approach = inside, 0.0 * inside
    else:
        inner, approach = roller_curves.carried_loads(seat.inner_curves, inside), inside
    load, moved = inner * ratio + seat.least_outer_load, approach / ratio
    return load, moved if seat.flange_compliance is None else moved + flange_approach(seat, load)


def flange_approach(seat: Seat, outer_load: Any) -> Any:
    """By how much the flange lets a roller that carries `outer_load` [N] be displaced along the outer normal [mm], any
    shape; 0 if it does not give way."""
    if seat.flange_compliance is None:
        return 0.0
    force = _wedged(seat, outer_load)
    positive = force > 0.0
    sunk = xp.where(positive, seat.flange_compliance * xp.where(positive, force, 1.0) ** (2.0 / 3.0), 0.0)
    # the roller may not follow the flange's normal without leaving the inner raceway: it slides along that instead
    return seat.wedge * sunk


class RollerPlace(NamedTuple):
    """A place of the roller between the raceways: outer load by the balance of the roller and its slope [N], [N/mm];
    displacement of the roller along the outer normal [mm] and its slope [–]; both by what `inside` finds."""

    load: Any
    rate: Any
    moved: Any
    pace: Any


def _between(seat: Seat, inside: Any) -> RollerPlace:
    """`_placed`, with its slopes by `inside`."""
    load, moved = _placed(seat, xp.variable(inside))
    return RollerPlace(load.value, load.by[0], moved.value, moved.by[0])


class RollerBalance(NamedTuple):
    """How far a roller is from rest: what the outer raceway carries too much [N], how fast that falls, the outer load
    [N] and its slope by the ring's approach [N/mm] there, and by the outer contact's own [N/mm]; the place itself."""

    excess: Any
    falling: Any
    load: Any
    slope: Any
    outer_slope: Any
    place: RollerPlace


def _balance(seat: Seat, outer_curves: RollerCurves, approach: Any, inside: Any) -> RollerBalance:
    place = _between(seat, inside)
    load, slope = roller_curves.roller_loads(outer_curves, approach - place.moved)
    falling = slope * place.pace + place.rate
    falling = xp.where(falling > 0.0, falling, 1.0)
    return RollerBalance(load - place.load, falling, load, slope * place.rate / falling, slope, place)


class Settling(NamedTuple):
    """Rollers on their way to rest, shape (rollers,) each.

    Attributes:
      inside: inner approach [mm], or inner load [N]: see `_placed`; 0 where the inner raceway is not touched.
      load, slope: outer load [N] of rollers that one more step would bring to rest, and its slope by the ring's
        approach [N/mm].
      excess: how far from rest they are [N]. step: of `inside` towards it. follows: `inside` by the ring's approach.
    """

    inside: Any
    load: Any
    slope: Any
    excess: Any
    step: Any
    follows: Any


def settling(seat: Seat, outer_curves: RollerCurves, approach: Any, inside: Any) -> Settling:
    """Rollers at `inside` whose ring has approached them by `approach` [mm]."""
    at = _balance(seat, outer_curves, approach, inside)
    touched = (inside > 0.0) | (at.excess > 0.0)
    step, follows = (xp.where(touched, rate / at.falling, 0.0) for rate in (at.excess, at.outer_slope))
    load = xp.where(touched, at.place.load + at.place.rate * step, seat.least_outer_load)
    return Settling(inside, load, at.slope, xp.where(touched, at.excess, 0.0), step, follows)


def settled(seat: Seat, outer_curves: RollerCurves, at: Settling, approach: Any, more: Any) -> Any:
    """`inside` for the next try: one step of Newton's method, at `approach` [mm], which is `more` than before."""
    top = _most(seat, outer_curves, approach)
    after = xp.clip(at.inside + at.step + at.follows * more, 0.0, top)
    return xp.where((at.inside == 0.0) & (at.excess > 0.0), 0.5 * top, after)


def half_way(seat: Seat, outer_curves: RollerCurves, approach: Any) -> Any:
    """`inside` to begin with."""
    return 0.5 * _most(seat, outer_curves, approach)


def _most(seat: Seat, outer_curves: RollerCurves, approach: Any) -> Any:
    """No `inside` is larger."""
    if seat.inner_curves is None:
        return roller_curves.roller_loads(outer_curves, approach)[0] / seat.inner_cos
    return xp.maximum(approach, 0.0) * seat.ratio


def _looked_for(seat: Seat, outer_curves: RollerCurves, approach: jax.Array) -> jax.Array:
    """`inside` of rollers at rest to about `CLOSE`, without derivatives."""
    fixed = jax.lax.stop_gradient((seat, outer_curves, approach))
    top = jnp.maximum(_most(*fixed), 1e-12)
    held = _balance(*fixed, jnp.zeros_like(top)).excess > 0.0

    def narrowed(state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        low, high, at, _, rounds = state
        now = _balance(*fixed, at)
        low, high = jnp.where(now.excess > 0.0, at, low), jnp.where(now.excess > 0.0, high, at)
        newton = now.excess / now.falling
        step = at + newton
        there = jnp.abs(newton) <= CLOSE * at  # where rounding may lead out of the bracket
        step = jnp.where(there | ((step > low) & (step < high)), step, 0.5 * (low + high))
        moved = jnp.max(jnp.where(held, jnp.abs(step - at) / jnp.maximum(step, 1e-300), 0.0))
        return low, high, step, moved, rounds + 1

    def unfinished(state: tuple[jax.Array, ...]) -> jax.Array:
        *_, moved, rounds = state
        return (moved > CLOSE) & (rounds < ROUNDS)

    start = jnp.zeros_like(top), top, 0.5 * top, jnp.ones(()), jnp.asarray(0)
    return jnp.where(held, jax.lax.while_loop(unfinished, narrowed, start)[2], 0.0)


def _followed(seat: Seat, outer_curves: RollerCurves, approach: jax.Array, near: jax.Array) -> jax.Array:
    """`near` at rest, differentiable twice: two steps of Newton's method follow the solution."""
    touched = near > 0.0
    found = jnp.where(touched, near, 0.5 * jnp.maximum(_most(seat, outer_curves, approach), 1e-12))

    @partial(jax.jit, inline=True)  # traced once
    def closer(found: jax.Array) -> jax.Array:
        now = _balance(seat, outer_curves, approach, found)
        return jnp.where(touched, found + now.excess / now.falling, found)

    return jnp.where(touched, closer(closer(found)), 0.0)
