"""A ring at rest with the derivatives of all that is known of it, of an expansion: nothing is iterated again.

In a traced scene, too, where differentiating the program would make it many times as large.
"""

from __future__ import annotations

from typing import Any

from difftrb.core import arrays as xp
from difftrb.core.taylor import Taylor, plus, summed
from difftrb.ring import newton, roller_balance
from difftrb.ring.newton import System


def expanded(system: System, u: Any, inside: Any) -> tuple[Any, Any, Any, Any]:
    """Displacement, approach, loads and tangent stiffness with derivatives: the conditions of rest are linearised
    (implicit function theorem)."""
    (rollers, force, _, size, axial), normals = system, system.rollers.normals
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
        unbalanced, jacobian = newton.with_axial(axial, u, unbalanced, jacobian)
    moved = Taylor(u)
    if xp.by(unbalanced) is not None:
        moved = Taylor(u, by=-newton.solve(jacobian[None], unbalanced.by))
    # and as the displacement follows
    further = xp.einsum("...ri,...i->...r", xp.value(normals), moved).by
    held = Taylor(loads.value, plus(by, summed((further, slope))))
    slopes = Taylor(slope, plus(slope_by, summed((further, bend))))
    return moved, rollers.approach(moved), held, newton.tangent(normals, slopes)
