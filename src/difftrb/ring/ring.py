"""The ring on its rollers: equilibrium, load distribution and stiffness of the plain bearing.

Three degrees of freedom of one ring against the other: radial (along the load line, angle 0), lateral (a quarter turn
on) and axial (pressing the rings together); where rings tilt two more, about both radial axes. One contact per roller,
the outer raceway's. What effects add to that are `Terms`; those that are None leave nothing in the compiled program.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry, status
from difftrb.core.geometry import Spall, TaperedBearing
from difftrb.core.taylor import Taylor, goes_through, plus, summed
from difftrb.law import roller_curves
from difftrb.law.base import Law, Rest
from difftrb.law.roller_curves import RollerCurves
from difftrb.law.tilt_energy import of_slices
from difftrb.ring import holding, newton, newton_start, roller_balance, roller_places
from difftrb.ring.load import Load
from difftrb.ring.newton import Rollers, System
from difftrb.ring.terms import PLAIN, Terms, beside, of_rows

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float, Int

OF_ONE_RACEWAY = 0.75
"""Share of a roller's approach by two raceways in series that is either contact's at the most."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Equilibrium:
    """A ring at rest.

    Attributes:
      displacement: radial, lateral, axial [mm], shape (3,); with tilt also about the radial and the lateral axis [rad],
        shape (5,).
      approach: of every roller [mm], shape (rollers,), negative where it is clear of the raceway.
      loads: of every roller on the outer raceway [N], shape (rollers,).
      tangent: dF/du [N/mm], shape (3, 3); with tilt [N/mm, N/rad, N mm/rad], shape (5, 5).
      residual: largest unbalanced force relative to the load, or to what presses without one. iterations: Newton steps.
      status_code: `difftrb.status`.
      second_approach, second_loads: as `approach` and `loads`, of a second row; None: there is none.
      tilts: of rings that tilt and rollers in slices, see `law.base.Rest.rings`; of all rows, without derivatives.
    """

    displacement: Float[Array, " axes"]
    approach: Float[Array, " rollers"]
    loads: Float[Array, " rollers"]
    tangent: Float[Array, "axes axes"]
    residual: Float[Array, ""]
    iterations: Int[Array, ""]
    status_code: Any
    second_approach: jax.Array | None = None
    second_loads: jax.Array | None = None
    tilts: jax.Array | None = None

    @property
    def is_found(self) -> Any:
        """Whether the search for it ended."""
        of = xp.module_of(self.residual)
        return (self.residual <= newton.TOLERANCE) & of.all(of.isfinite(xp.value(self.displacement)))

    @property
    def all_approaches(self) -> jax.Array:
        """Of the rollers of all rows, one row behind the other [mm]."""
        return _of_all_rows(self.approach, self.second_approach)

    @property
    def all_loads(self) -> jax.Array:
        """The same of their loads [N]."""
        return _of_all_rows(self.loads, self.second_loads)


def _of_all_rows(first: jax.Array, second: jax.Array | None) -> jax.Array:
    return first if second is None else xp.concatenate([first, second], axis=-1)


def axial_force(rest: Equilibrium, bearing: TaperedBearing) -> Any:
    """That rollers push the rings apart with [N]."""
    pressed = xp.total(rest.loads)
    if rest.second_loads is not None:
        pressed = pressed - xp.total(rest.second_loads)
    return pressed * xp.sin(bearing.outer_angle)


def equilibrium(
    bearing: TaperedBearing, load: Load, spalls: tuple[Spall, ...], law: Law, phase: Any, terms: Terms = PLAIN
) -> Equilibrium:
    """The ring's rest position under `load`, its roller loads and tangent stiffness.

    `spalls` are those met on the outer raceway (`roller_places.spalls_on`); `phase` is the angle of roller 0 from the
    load line [rad], of any shape, which is then in front of all else. So may the load's parts be: each ring is then
    judged by itself.

    In any arithmetic: numbers without a program; expansions with all their derivatives; arrays of JAX, differentiable
    by everything, forward and reverse, at the solution. Where there is no equilibrium the numbers are NaN and the
    status says so.
    """
    at = xp.fixed((bearing, load, spalls, phase))
    alone = bool(np.ndim(xp.value(load.radial)))
    valid, held = is_valid(*at[1:]), holding.is_held(at[0], at[1], at[3], xp.fixed(terms))
    if not alone:
        valid, held = (xp.module_of(one).all(one) for one in (valid, held))
    usable = valid & held
    angles = roller_places.roller_angles(bearing, phase)
    away = roller_places.distances(bearing, spalls, angles)
    if terms.pair is not None:
        away, angles = beside(away, spalls), xp.concatenate([angles, angles], axis=-1)
    with goes_through(f"law {law.name!r}"):
        curves = law.curves(spalls, away)
    system = _system(bearing, forces(load, usable, terms), angles, law, curves, terms)
    rest, pressed = _at_rest(system, angles.shape[-1], terms)
    # a ring that nothing stands for carries nothing, and is no reason to refuse others
    approach, loads = (xp.where(newton.of_each(usable, each), each, 0.0) for each in (rest.approach, rest.loads))
    state, own = xp.fixed((dataclasses.replace(rest, approach=approach, loads=loads), terms))
    codes = (
        status_of_laws(at[0], at[2], xp.fixed(away), xp.fixed(law), state, own),
        holding.not_held(state, xp.fixed(system.rollers.normals), xp.fixed(pressed), own),
    )
    known, unpressed = codes if alone else (xp.module_of(code).max(code) for code in codes)
    rest = judged(rest, valid, held, known, xp.fixed(law), unpressed)
    return rest if terms.pair is None else in_rows(rest)


def in_rows(rest: Equilibrium) -> Equilibrium:
    """With the rollers of both rows, which were behind each other, apart."""
    (near, far), (first, second) = (
        (part[..., : part.shape[-1] // 2], part[..., part.shape[-1] // 2 :]) for part in (rest.approach, rest.loads)
    )
    return dataclasses.replace(rest, approach=near, loads=first, second_approach=far, second_loads=second)


def is_valid(load: Load, spalls: tuple[Spall, ...], phase: Any) -> Any:
    """Whether loads, phase and spalls are what they may be."""
    finite = xp.module_of(load.radial, load.axial, phase).isfinite(load.radial + load.axial + phase)
    valid = (load.radial >= 0.0) & (load.axial >= 0.0) & finite
    for spall in spalls:
        valid = valid & geometry.spall_is_valid(spall)
    return valid


def forces(load: Load, usable: Any, terms: Terms) -> Any:
    """What rollers push against [N], shape (…, 3); a force that any ring holds where this one is not `usable`."""
    radial, axial = xp.asarray(load.radial), xp.asarray(load.axial)
    force = xp.stack([radial, xp.zeros_like(radial), axial], axis=-1)
    if terms.extra is not None:
        force = newton.aligned(force, terms.extra) + terms.extra
    unit = newton.aligned(np.array([0.0, 0.0, 1.0]), force)
    return xp.where(newton.of_each(usable, force), force, unit)


def _system(bearing: TaperedBearing, force: Any, angles: Any, law: Law, curves: RollerCurves, terms: Terms) -> System:
    """What presses the rollers of all rows, what they carry, and where Newton's method begins."""
    across = normals(bearing, angles, terms)
    fixed_law = xp.fixed(law)
    healthy = fixed_law.curves((), np.zeros((0, *across.shape[:-1])))
    extra = None if terms.interference is None else newton.aligned(xp.asarray(terms.interference), angles)
    rollers = Rollers(across, extra, curves, terms.seat)
    start = newton_start.start(rollers, healthy, force, terms)
    if terms.slices is not None:
        count = terms.slices.each.shift.shape[-1] // angles.shape[-1]
        angles = of_slices(angles, count)
        extra = extra if extra is None or extra.shape[-1] == 1 else of_slices(extra, count)
        rollers = Rollers(normals(bearing, angles, terms), extra, terms.slices)
    if terms.tilting is not None:
        rollers = rollers._replace(normals=terms.tilting.directions(rollers.normals, angles))
        force = terms.tilting.forces(force)
        start = xp.concatenate([start, xp.zeros_like(start[..., :2])], axis=-1)
    return System(rollers, force, start, size_of_forces(force, start, rollers, terms), terms.axial)


def normals(bearing: TaperedBearing, angles: Any, terms: Terms) -> Any:
    """Of all rollers or slices at these angles [rad], of both rows behind each other; shape (…, 3)."""
    found = roller_places.directions(bearing, angles)
    return found if terms.pair is None else of_rows(found)


def size_of_forces(force: Any, start: Any, rollers: Rollers, terms: Terms) -> Any:
    """What forces are measured by [N], shape () or of each ring, without derivatives: the load, or what presses without
    one, were the outer contacts alone to give way."""
    size = newton.norm(force)
    if terms.axial is None and terms.pair is None:
        return size
    still, fixed = start if terms.pair is None else xp.zeros_like(start), xp.fixed(rollers)
    return xp.maximum(size, xp.total(roller_curves.roller_loads(fixed.curves, fixed.approach(still))[0]))


def _at_rest(system: System, count: int, terms: Terms) -> tuple[Equilibrium, Any]:
    """Where the ring rests, by all `count` rollers of its rows, not judged yet; and what is carried [N] by all that was
    pressed, rollers or their slices."""
    u, (pressed, slopes), (residual, iterations, inside) = newton.found(xp.values(system))
    if xp.expands(system):
        u, approach, pressed, tangent = _expanded(system, u, inside)
    else:
        approach, tangent = system.rollers.approach(u), newton.tangent(system.rollers.normals, slopes)
    loads, tilts = pressed, None
    if terms.slices is not None:
        approach, loads = (part.reshape(*part.shape[:-1], count, -1) for part in (approach, pressed))
        tilts = None if terms.tilting is None else terms.tilting.of_rollers(xp.fixed(approach))
        approach, loads = xp.total(approach) / approach.shape[-1], xp.total(loads)
    if terms.tilting is not None:
        u, tangent = terms.tilting.in_radians(u, tangent)
    code = np.asarray(status.CONVERGED)
    return Equilibrium(u, approach, loads, tangent, residual, iterations, code, tilts=tilts), pressed


def status_of_laws(
    bearing: TaperedBearing, spalls: tuple[Spall, ...], away: Any, roller_law: Law, rest: Equilibrium, terms: Terms
) -> Any:
    """Status: whether the laws know the spalls met, and the states that rollers are in."""
    approach, loads = map(xp.fixed, (rest.approach, rest.loads))
    rings = None if terms.slices is None else (approach, xp.zeros_like(approach) if rest.tilts is None else rest.tilts)
    if terms.inner_raceway is not None:
        approach = OF_ONE_RACEWAY * approach
    state = Rest(geometry.equivalent_radius(bearing, "outer"), approach, loads, rings)
    code = roller_law.judge(spalls, away, state)
    if terms.laws_status is not None:
        code = status.worst(code, terms.laws_status)
    raceway, seat = terms.inner_raceway, terms.seat
    if raceway is None or seat is None:
        return code
    inner = state._replace(loads=roller_balance.inner_load(seat, loads))
    return status.worst(code, raceway.tilts(roller_law, spalls, away, state), raceway.judge(inner))


def judged(
    rest: Equilibrium, valid: Any, held: Any, laws_status: Any, law: Law, unpressed: Any = status.CONVERGED
) -> Equilibrium:
    """With its status, and with NaN for numbers that nothing stands for.

    What comes later says more: a ring that did not converge, that is not held (`unpressed`), whose laws do not know its
    state, under too small an axial load, with bad input.
    """
    of, usable = xp.module_of(rest.residual, laws_status, valid, held), valid & held
    code = of.where(rest.is_found, status.CONVERGED, status.NOT_CONVERGED)
    for other in (unpressed, laws_status):
        code = of.where(other == status.CONVERGED, code, other)
        usable = usable & (other == status.CONVERGED)
    code = of.where(held, code, status.NO_EQUILIBRIUM)
    code = of.where(valid, code, status.BAD_INPUT)
    code = status.worst(code, of.asarray(law.status_code).astype(int))
    numbers = rest.displacement, rest.approach, rest.loads, rest.tangent
    # so that derivatives are NaN, too: of a number put in its place they are 0, as at an optimum
    u, approach, loads, tangent = (value * of.where(newton.of_each(usable, value), 1.0, np.nan) for value in numbers)
    residual = xp.where(of.all(usable), rest.residual, np.nan)
    return Equilibrium(u, approach, loads, tangent, residual, rest.iterations, code, tilts=rest.tilts)


def _expanded(system: System, u: Any, inside: Any) -> tuple[Any, Any, Any, Any]:
    """Displacement, approach, loads and tangent stiffness with derivatives: the conditions of rest are linearised
    (implicit function theorem), and nothing is iterated again. In a traced scene, too, where differentiating the
    program would make it many times as large."""
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
