"""The solution of a scene whose laws are built: loads, stiffness, and what spalls take of it.

A plain ring in numbers is solved at once, in numpy; what is traced, and what needs effects, by a program of JAX.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact.height_map import resized
from difftrb.core import arrays as xp
from difftrb.core import geometry, implicit, status
from difftrb.core.geometry import Real, Spall
from difftrb.core.jax_config import jit_quickly
from difftrb.core.taylor import Taylor
from difftrb.ring import effects, phase_rule, plain_ring, ring, roller_places
from difftrb.ring.effects import Results
from difftrb.ring.ring import Load
from difftrb.scene import checks
from difftrb.scene.cage_phases import at_all_phases, phases
from difftrb.scene.scene import PitchMean, Scene, healthy, is_plain, law_in_effect, outer_law, ring_at
from difftrb.scene.solution import Assessment, Solution


def assess_prepared(scene: Scene) -> Assessment:
    """`assess` of a scene whose laws are built: of a plain ring's numbers at once, else by a program."""
    if is_plain(scene) and xp.are_numbers(scene):
        with np.errstate(all="ignore"):
            return jax.device_put(_assess_numbers(xp.numbers(scene)))
    return assess_by_program(scene)


def _assess_numbers(scene: Scene) -> Assessment:
    count = len(scene.spalls)
    spalled = _expanded(with_sizes_expanded(scene))
    slopes = np.zeros((2, count, 2))
    stiffness = spalled.stiffness
    if isinstance(stiffness, Taylor) and stiffness.by is not None:
        slopes = np.stack([stiffness.by[:, k, k] for k in (0, 2)]).reshape(slopes.shape)
    spalled, whole = xp.values((spalled, _expanded(healthy(scene))))
    return _assessed(spalled, whole, slopes)


def _assessed(spalled: Solution, whole: Solution, slopes: Any) -> Assessment:
    """From both solutions, and the derivatives of radial and axial stiffness by length and width, shape (2, spalls,
    2)."""
    of = xp.module_of(spalled.stiffness)
    ours, theirs = (of.diagonal(each.stiffness)[np.array([0, 2])] for each in (spalled, whole))
    slopes = of.where(of.isnan(ours)[:, None, None], np.nan, slopes)
    return Assessment(spalled, whole, 100.0 * (1.0 - ours / theirs), slopes[..., 0], slopes[..., 1])


def by_sizes(of: Callable[[Scene], tuple[jax.Array, Any]], scene: Scene) -> tuple[jax.Array, Any]:
    """Derivatives of the first that `of` a scene gives by every spall's length and width, shape (…, spalls, 2), and the
    second."""

    def sized(sizes: jax.Array) -> tuple[jax.Array, Any]:
        spalls = (resized(s, *v) for s, v in zip(scene.spalls, sizes, strict=True))
        return of(dataclasses.replace(scene, spalls=tuple(spalls)))

    sizes = jnp.array([[spall.length, spall.width] for spall in scene.spalls]).reshape(-1, 2)
    return jax.jacfwd(sized, has_aux=True)(sizes)


@jit_quickly()
def assess_by_program(scene: Scene) -> Assessment:
    """See `assess_prepared`."""

    def both(scene: Scene) -> tuple[jax.Array, Solution]:
        solution = solve_prepared(scene)
        return solution.both_stiffnesses, solution

    slopes, spalled = by_sizes(both, scene)
    return _assessed(spalled, solve_prepared(healthy(scene)), slopes)


def solve_prepared(scene: Scene) -> Solution:
    """The solution of a scene whose laws are built: of a plain ring's numbers at once, else by a program."""
    return solve_plain(_as_it_is, scene) if is_plain(scene) else _by_program(_as_it_is, scene)


def _as_it_is(scene: Scene) -> Scene:
    return scene


Build = Callable[[Scene], Scene]
"""What builds a scene's laws, in any arithmetic."""


def solve_plain(build: Build, scene: Scene) -> Solution:
    """A plain ring: numbers at once, also those that `jax.grad` differentiates outside `jit`; else by a program. Its
    derivatives are those of its expansion."""
    if not xp.are_numbers(scene):
        return implicit.expanded(partial(_at_once_or_by_program, build), scene)
    solution = xp.values(_at_once_or_by_program(build, scene))
    with jax.ensure_compile_time_eval():  # numbers stay numbers where a program closes over them
        return jax.device_put(solution)


def _at_once_or_by_program(build: Build, scene: Scene) -> Solution:
    if not xp.are_numbers(scene):
        return _by_program(build, scene)
    with np.errstate(all="ignore"):
        return _solution(build, xp.numbers(scene))


def _solution(build: Build, scene: Scene) -> Solution:
    ready = build(scene)
    at_once = is_plain(ready) and (xp.are_numbers(ready) or xp.expands(ready))
    return _expanded(ready) if at_once else _traced(ready)


_by_program = jit_quickly(static_argnames=("build",))(_solution)


def _expanded(scene: Scene) -> Solution:
    """A plain ring's solution in any arithmetic."""
    each, weights = phases(scene)
    rest, here, terms = rings_at(scene, each)
    more = effects.results(scene.effects, rest, terms, here)
    more = {name: value if value.ndim else value + np.zeros(len(each)) for name, value in more.items()}
    return _of_phases(scene, rest, as_defined(scene, rest), weights, more)


def _of_phases(scene: Scene, every: ring.Equilibrium, stiffness: Any, weights: Any, more: Results) -> Solution:
    """The solution, of rings at rest at all phases."""

    def mean(value: Any) -> Any:
        rows = value.reshape(value.shape[0], -1)
        found = xp.einsum("p,pi->i", weights, rows)
        return found.reshape(*value.shape[1:]) if value.ndim > 1 else found[0]

    def span(value: Any) -> Any:
        of = xp.module_of(value)
        return xp.stack([xp.taken(value, pick(xp.value(value), axis=0)) for pick in (of.argmin, of.argmax)])

    if isinstance(scene.phase, PitchMean):
        middle: Any = 0.5 * geometry.roller_pitch(scene.bearing)
        of_every, stiffness = mean, without_poles(scene, every.displacement, stiffness)
    else:
        middle = scene.phase
        of_every = operator.itemgetter(0)
    of = xp.module_of(every.residual)
    return Solution(
        angles=roller_places.roller_angles(scene.bearing, middle),
        displacement=of_every(every.displacement),
        approach=of_every(every.approach),
        loads=of_every(every.loads),
        stiffness=of_every(stiffness),
        load_span=span(every.loads),
        stiffness_span=span(stiffness),
        law=outer_law(scene),
        residual=of.max(every.residual),
        iterations=of.max(every.iterations),
        status_code=of.max(every.status_code),
        effects=xp.tree_map(of_every, more),
        picked=scene.picked,
        definition=scene.definition,
        remarks=effects.remarks(scene.effects, scene.spalls, isinstance(scene.phase, PitchMean)),
    )


def without_poles(scene: Scene, displacement: Any, stiffness: Any) -> Any:
    """Stiffness [N/mm] of the rings of a mean, shape (phases, n, n), at their displacements [mm], shape (phases, n);
    NaN for a secant F/u whose displacement changes its sign within the pitch: it runs to infinity, and has no mean."""
    if scene.definition == "tangent":
        return stiffness
    u, values = xp.value(displacement), xp.value(stiffness)
    of = xp.module_of(u)
    turns = of.any(u > 0.0, axis=0) & of.any(u < 0.0, axis=0)
    poles = turns[:, None] & np.eye(turns.size, dtype=bool) & of.any(values != 0.0, axis=0)
    return xp.where(poles[None], np.nan, stiffness)


def _traced(scene: Scene) -> Solution:
    """The solution of a scene in arrays of JAX, with all its effects."""

    def at(phase: Any, scene: Scene) -> tuple[ring.Equilibrium, jax.Array, Results]:
        rest, more = at_phase(scene, phase)
        return rest, as_defined(scene, rest), more

    each, weights = phases(scene)
    every, stiffness, more = at_all_phases(at, scene, each)
    return _of_phases(scene, every, stiffness, weights, more)


def at_phase(scene: Scene, phase: Real) -> tuple[ring.Equilibrium, Results]:
    """The ring of a prepared scene at one cage phase, in arrays of JAX, and what its effects add."""
    acting, within = law_in_effect(scene, outer_law(scene)), checks.code(scene)
    here, terms = ring_at(scene, acting, phase)
    terms = terms._replace(laws_status=within if terms.laws_status is None else status.worst(within, terms.laws_status))
    rest = here.equilibrium(terms)
    return rest, effects.results(scene.effects, rest, terms, here)


def at_phases(
    scene: Scene, each: Any, loads: Load | None = None, spalls: tuple[Spall, ...] | None = None
) -> ring.Equilibrium:
    """The plain ring of a prepared scene at all cage phases `each` [rad], shape (phases,), in any arithmetic: what it
    has is of shape (phases, …). `loads`: at every phase its own, both of shape (phases,), in place of the scene's;
    `spalls`: the same, what differs between phases of shape (phases, 1)."""
    return rings_at(scene, each, loads, spalls)[0]


def rings_at(
    scene: Scene, each: Any, loads: Load | None = None, spalls: tuple[Spall, ...] | None = None
) -> tuple[ring.Equilibrium, effects.Ring, effects.Terms]:
    """As `at_phases`; and what effects act on there, and what they add to it."""
    within = checks.code(xp.fixed(scene))
    scene = dataclasses.replace(scene, load=loads or scene.load, spalls=scene.spalls if spalls is None else spalls)
    law, met = outer_law(scene), roller_places.spalls_on(scene.spalls, "outer")
    here, terms = ring_at(scene, law, each)
    return plain_ring.equilibrium(scene.bearing, scene.load, met, law, each, within, terms), here, terms


@np.errstate(all="ignore")
def still(scene: Scene, loads: np.ndarray) -> np.ndarray | None:
    """Displacement [mm] of a plain scene's healthy ring under radial and axial `loads` [N], shape (loads, 2), which no
    size of a spall changes; shape (loads, 3). None where rings are not `ALIKE` at other phases, and with raceways in
    series, of which a displacement does not tell how they share it."""
    if scene.effects:
        return None
    turned = np.arange(4) / 4.0 * float(geometry.roller_pitch(scene.bearing))
    each = Load(*np.repeat(loads, len(turned), axis=0).T)
    rest = at_phases(xp.numbers(healthy(scene)), np.tile(turned, len(loads)), each)
    found = xp.values(rest.displacement).reshape(len(loads), len(turned), 3)
    apart = np.ptp(found, axis=1).max(axis=1)
    return found[:, 0] if np.all(apart <= phase_rule.ALIKE * np.abs(found).max(axis=(1, 2))) else None


def with_sizes_expanded(scene: Scene) -> Scene:
    """The scene with the length and width of every spall as parameters of an expansion: 0 and 1 of the first, …"""
    count = len(scene.spalls)
    seeds = np.eye(2 * count).reshape(count, 2, 2 * count)
    spalls = tuple(
        resized(spall, Taylor(spall.length, by=rows[0]), Taylor(spall.width, by=rows[1]))
        for spall, rows in zip(scene.spalls, seeds, strict=True)
    )
    return dataclasses.replace(scene, spalls=spalls)


def as_defined(scene: Scene, rest: ring.Equilibrium) -> Any:
    """Stiffness, tangent or secant as the scene defines it [N/mm], shape (…, n, n)."""
    if scene.definition == "tangent":
        return rest.tangent
    load = scene.load
    if any(effect.holds_axially for effect in scene.effects):
        load = dataclasses.replace(load, axial=ring.axial_force(rest, scene.bearing))
    return _secant(load, rest.displacement)


def _secant(load: Load, displacement: Any) -> Any:
    """Force over displacement [N/mm] on a diagonal of the displacement's size, shape (…, n, n); 0 and NaN as in
    `Solution`."""
    count, parts = displacement.shape[-1], []
    for k in range(count):
        force, way = {0: load.radial, 2: load.axial}.get(k, 0.0), displacement[..., k]
        defined = (force > 0.0) & (way != 0.0)
        parts.append(xp.where(defined, force / xp.where(defined, way, 1.0), 0.0 if k == 1 else np.nan))
    diagonal = xp.stack(parts, axis=-1)[..., None, :]
    own = np.eye(count, dtype=bool).reshape((1,) * (diagonal.ndim - 2) + (count, count))
    return xp.where(own, diagonal, 0.0)
