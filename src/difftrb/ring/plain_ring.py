"""The plain ring in any arithmetic: of numbers at once, without a program; of expansions with all their derivatives.

As `ring.equilibrium`, and its equal to rounding; of effects it knows raceways in series and the flange. All cage phases
are solved together: arrays have phases, if there are several, before rollers. A scene of numbers takes milliseconds,
where compiling takes seconds; and the derivatives of a traced one come from one expansion, where differentiating its
program would make it many times as large.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import Spall, TaperedBearing
from difftrb.core.taylor import Taylor, plus, summed
from difftrb.law import load_curve
from difftrb.law.base import Law
from difftrb.law.edge_ramp import RollerCurves
from difftrb.ring import newton, newton_start, ring, roller_balance, roller_places
from difftrb.ring.newton import Rollers, System
from difftrb.ring.ring import Equilibrium, Load
from difftrb.ring.roller_balance import Seat
from difftrb.ring.terms import PLAIN, Terms


def equilibrium(
    bearing: TaperedBearing, load: Load, spalls: tuple[Spall, ...], law: Law, phase: Any,
    laws_status: Any = status.CONVERGED, terms: Terms = PLAIN,
) -> Equilibrium:  # fmt: skip
    """See `ring.equilibrium`; `phase` may have any shape, which is then in front of all else. So may the load's parts:
    each ring is then judged by itself. `laws_status` is the status of what else is known of the scene; the worst is
    returned. Of `terms` a seat that gives way is taken, and the inner raceway that it faces."""
    at = xp.fixed((bearing, load, spalls, phase))
    valid, held = ring.is_valid(*at[1:]), ring.is_enough(at[1].axial, ring.needed_axial(at[0], at[1].radial, at[3]))
    if not np.ndim(xp.value(load.radial)):
        valid, held = _all(valid), _all(held)
    radial, axial = xp.asarray(load.radial), xp.asarray(load.axial)
    force = xp.stack([radial, xp.zeros_like(radial), axial], axis=-1)
    usable, unit = valid & held, np.array([0.0, 0.0, 1.0])
    force = xp.where(usable[..., None], force, unit.reshape(*[1] * np.ndim(usable), 3))
    angles = roller_places.roller_angles(bearing, phase)
    away, normals = roller_places.distances(bearing, spalls, angles), roller_places.directions(bearing, angles)
    still = xp.fixed(law)
    healthy = still.curves((), np.zeros((0, *angles.shape)))
    curves, seat = law.curves(spalls, away), terms.seat
    start = _start(xp.fixed(normals), xp.fixed(curves), healthy, xp.fixed(force))
    rollers = Rollers(xp.values(normals), None, xp.values(curves), xp.values(seat))
    system = System(rollers, xp.values(force), start, newton.norm(force))
    u, _, (residual, iterations, inside) = newton.found(system)
    parts = _expanded(normals, curves, seat, force, system.size, u, inside)
    rest = Equilibrium(*parts, residual, iterations, np.asarray(status.CONVERGED))
    # a ring that nothing stands for carries nothing, and is no reason to refuse others
    approach, loads = (xp.where(newton.of_each(usable, each), each, 0.0) for each in (rest.approach, rest.loads))
    state = dataclasses.replace(rest, approach=approach, loads=loads)
    known = ring.status_of_laws(at[0], at[2], xp.fixed(away), still, *xp.fixed((state, terms)))
    return ring.judged(rest, valid, held, status.worst(laws_status, known), still)


def _all(condition: Any) -> Any:
    return xp.module_of(condition).all(condition)


def _start(normals: Any, curves: RollerCurves, healthy: RollerCurves, force: Any) -> Any:
    """See `newton_start.start`."""
    one = load_curve.one_of(healthy.each, 0)
    while one.middle.ndim:  # the same at all phases
        one = load_curve.one_of(one, 0)
    axial = normals.reshape(-1, 3)[0, 2]
    largest, narrow = newton_start.in_load_zone(one, force, normals.shape[-2], axial)
    clear = xp.module_of(curves.each.shift).min(curves.each.shift, axis=-1)
    return newton_start.pressed(one, largest, narrow, axial, xp.maximum(clear, 0.0))


def _expanded(
    normals: Any, curves: RollerCurves, seat: Seat | None, force: Any, size: Any, u: Any, inside: Any
) -> tuple[Any, Any, Any, Any]:
    """Displacement, approach, loads and tangent stiffness with derivatives: the conditions of rest are linearised
    (implicit function theorem)."""
    approach = _approach(normals, u)  # as parameters move, at this displacement
    loads = roller_balance.expanded_loads(seat, curves, approach, inside)
    # the last parameter is the approach itself; without others there is nothing to follow
    (by, slope), (slope_by, bend) = ((part[:-1], part[-1]) for part in (loads.by, loads.mixed))
    if not len(by):
        by = slope_by = None
    pushed = xp.einsum("...r,...ri->...i", Taylor(loads.value, by), normals)
    unbalanced = (pushed - newton.aligned(force, u)) / newton.of_each(size, u)
    moved = Taylor(u)
    if xp.by(unbalanced) is not None:
        jacobian = newton.tangent(xp.value(normals), slope)
        jacobian = jacobian / newton.of_each(size, jacobian)
        moved = Taylor(u, by=-newton.solve(jacobian[None], unbalanced.by))
    # and as the displacement follows
    further = _approach(xp.value(normals), moved).by
    held = Taylor(loads.value, plus(by, summed((further, slope))))
    slopes = Taylor(slope, plus(slope_by, summed((further, bend))))
    return moved, _approach(normals, moved), held, newton.tangent(normals, slopes)


def _approach(normals: Any, u: Any) -> Any:
    return xp.einsum("...ri,...i->...r", normals, u)
