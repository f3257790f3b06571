"""The plain ring in any arithmetic: of numbers at once, without a program; of expansions with all their derivatives.

As `ring.equilibrium`, and its equal to rounding; of effects it knows all but rings that tilt. All cage phases are
solved together: arrays have phases, if there are several, before rollers. A scene of numbers takes milliseconds,
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
from difftrb.law.base import Law
from difftrb.ring import newton, newton_start, ring, roller_balance, roller_places
from difftrb.ring.newton import Rollers, System
from difftrb.ring.ring import Equilibrium, Load
from difftrb.ring.terms import PLAIN, Terms, beside, both


def equilibrium(
    bearing: TaperedBearing, load: Load, spalls: tuple[Spall, ...], law: Law, phase: Any,
    laws_status: Any = status.CONVERGED, terms: Terms = PLAIN,
) -> Equilibrium:  # fmt: skip
    """See `ring.equilibrium`; `phase` may have any shape, which is then in front of all else. So may the load's parts:
    each ring is then judged by itself. `laws_status` is the status of what else is known of the scene; the worst is
    returned. `terms` may be of effects that expand."""
    at = xp.fixed((bearing, load, spalls, phase))
    alone = bool(np.ndim(xp.value(load.radial)))
    valid, held = ring.is_valid(*at[1:]), ring.is_held(at[0], at[1], at[3], xp.fixed(terms))
    if not alone:
        valid, held = (xp.module_of(one).all(one) for one in (valid, held))
    radial, axial = xp.asarray(load.radial), xp.asarray(load.axial)
    force = xp.stack([radial, xp.zeros_like(radial), axial], axis=-1)
    if terms.extra is not None:
        force = newton.aligned(force, terms.extra) + terms.extra
    usable = valid & held
    unit = newton.aligned(np.array([0.0, 0.0, 1.0]), force)
    force = xp.where(newton.of_each(usable, force), force, unit)
    angles = roller_places.roller_angles(bearing, phase)
    away, normals = roller_places.distances(bearing, spalls, angles), roller_places.directions(bearing, angles)
    if terms.pair is not None:
        away, normals = beside(away, spalls), both(normals)
    fixed_law = xp.fixed(law)
    healthy = fixed_law.curves((), np.zeros((0, *normals.shape[:-1])))
    extra = None if terms.interference is None else newton.aligned(xp.asarray(terms.interference), angles)
    rollers = Rollers(normals, extra, law.curves(spalls, away), terms.seat)
    start = newton_start.start(rollers, healthy, force, terms)
    size = ring.size_of_forces(force, start, rollers, terms)
    system = System(rollers, force, start, size, terms.axial)
    u, _, (residual, iterations, inside) = newton.found(xp.values(system))
    rest = Equilibrium(*_expanded(system, u, inside), residual, iterations, np.asarray(status.CONVERGED))
    # a ring that nothing stands for carries nothing, and is no reason to refuse others
    approach, loads = (xp.where(newton.of_each(usable, each), each, 0.0) for each in (rest.approach, rest.loads))
    state, own = xp.fixed((dataclasses.replace(rest, approach=approach, loads=loads), terms))
    codes = (
        ring.status_of_laws(at[0], at[2], xp.fixed(away), fixed_law, state, own),
        ring.not_held(state, xp.fixed(normals), state.loads, own),
    )
    known, unpressed = codes if alone else (xp.module_of(code).max(code) for code in codes)
    rest = ring.judged(rest, valid, held, status.worst(laws_status, known), fixed_law, unpressed)
    return rest if terms.pair is None else ring.in_rows(rest)


def _expanded(system: System, u: Any, inside: Any) -> tuple[Any, Any, Any, Any]:
    """Displacement, approach, loads and tangent stiffness with derivatives: the conditions of rest are linearised
    (implicit function theorem)."""
    (rollers, force, start, size, axial), normals = system, system.rollers.normals
    approach = rollers.approach(u)  # as parameters move, at this displacement
    loads = roller_balance.expanded_loads(rollers.seat, rollers.curves, approach, inside)
    # the last parameter is the approach itself; without others there is nothing to follow
    (by, slope), (slope_by, bend) = ((part[:-1], part[-1]) for part in (loads.by, loads.mixed))
    if not len(by):
        by = slope_by = None
    pushed = xp.einsum("...r,...ri->...i", Taylor(loads.value, by), normals)
    unbalanced = (pushed - newton.aligned(force, u)) / newton.of_each(size, u)
    jacobian = newton.tangent(xp.value(normals), slope)
    jacobian = jacobian / newton.of_each(size, jacobian)
    if axial is not None:
        unbalanced, jacobian = newton.with_axial(axial, start, u, unbalanced, jacobian)
    moved = Taylor(u)
    if xp.by(unbalanced) is not None:
        moved = Taylor(u, by=-newton.solve(jacobian[None], unbalanced.by))
    # and as the displacement follows
    further = xp.einsum("...ri,...i->...r", xp.value(normals), moved).by
    held = Taylor(loads.value, plus(by, summed((further, slope))))
    slopes = Taylor(slope, plus(slope_by, summed((further, bend))))
    return moved, rollers.approach(moved), held, newton.tangent(normals, slopes)
