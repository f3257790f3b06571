"""The solution of a scene whose laws are built: loads, stiffness, and what spalls take of it.

Numbers are solved at once, in numpy; what is traced by a program of JAX, of the same functions.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np

from difftrb.contact.height_map import resized
from difftrb.core import arrays as xp
from difftrb.core import geometry, implicit, status
from difftrb.core.geometry import Spall
from difftrb.core.jax_config import jit_quickly
from difftrb.core.taylor import Taylor
from difftrb.law.base import Law
from difftrb.ring import effects, ring, roller_places
from difftrb.ring.effects import Results
from difftrb.ring.load import Load
from difftrb.scene import checks
from difftrb.scene.cage_phases import phases
from difftrb.scene.scene import PitchMean, Scene, healthy, law_in_effect, outer_law, ring_at
from difftrb.scene.solution import Assessment, Solution, stiffness_loss


def assess_prepared(scene: Scene) -> Assessment:
    """`assess` of a scene whose laws are built: of numbers at once, else by a program."""
    if not xp.are_numbers(scene):
        return assess_by_program(scene)
    with np.errstate(all="ignore"):
        return jax.device_put(_assess(xp.numbers(scene)))


def _assess(scene: Scene) -> Assessment:
    count = len(scene.spalls)
    spalled = _solved(with_sizes_expanded(scene))
    stiffness, slopes = spalled.stiffness, np.zeros((2, count, 2))
    if isinstance(stiffness, Taylor) and stiffness.by is not None:
        of = xp.module_of(stiffness.by)
        slopes = of.stack([stiffness.by[:, k, k] for k in (0, 2)]).reshape(slopes.shape)
    spalled, unspalled = xp.values((spalled, _solved(healthy(scene))))
    return _assessed(spalled, unspalled, slopes)


assess_by_program = jit_quickly(within=True)(_assess)


def _assessed(spalled: Solution, unspalled: Solution, slopes: Any) -> Assessment:
    """From both solutions, and the derivatives of radial and axial stiffness by length and width, shape (2, spalls,
    2)."""
    of = xp.module_of(spalled.stiffness)
    ours, theirs = (of.diagonal(each.stiffness)[np.array([0, 2])] for each in (spalled, unspalled))
    slopes = of.where(of.isnan(ours)[:, None, None], np.nan, slopes)
    return Assessment(spalled, unspalled, stiffness_loss(ours, theirs), slopes[..., 0], slopes[..., 1])


Build = Callable[[Scene], Scene]
"""What builds a scene's laws, in any arithmetic."""


def solve_prepared(scene: Scene, build: Build | None = None) -> Solution:
    """The solution of a scene whose laws are built, or that `build` gives its laws. Numbers are solved at once, also
    those that `jax.grad` differentiates outside `jit`; what is traced, by a program. Derivatives are those of its
    expansion."""
    if not xp.are_numbers(scene):
        return implicit.expanded(partial(_at_once_or_by_program, build=build), scene)
    solution = xp.values(_at_once_or_by_program(scene, build))
    with jax.ensure_compile_time_eval():  # numbers stay numbers where a program closes over them
        return jax.device_put(solution)


def _at_once_or_by_program(scene: Scene, build: Build | None) -> Solution:
    if not xp.are_numbers(scene):
        return _by_program(scene, build)
    with np.errstate(all="ignore"):
        return _solved(xp.numbers(scene), build)


def _solved(scene: Scene, build: Build | None = None) -> Solution:
    """The solution in any arithmetic."""
    scene = scene if build is None else build(scene)
    (each, weights), law = phases(scene), outer_law(scene)
    rest, here, terms = rings_at(scene, each, law=law)
    more = effects.results(scene.effects, rest, terms, here)
    more = {name: value if value.ndim else value + np.zeros(len(each)) for name, value in more.items()}
    return _of_phases(scene, law, rest, as_defined(scene, rest), weights, more)


_by_program = jit_quickly(static_argnames=("build",), within=True)(_solved)


def _of_phases(
    scene: Scene, law: Law, every: ring.Equilibrium, stiffness: Any, weights: Any, more: Results
) -> Solution:
    """The solution, of rings at rest at all phases by the `law` of the outer raceway."""

    def mean(value: Any) -> Any:
        rows = value.reshape(value.shape[0], -1)
        found = xp.einsum("p,pi->i", weights, rows)
        return found.reshape(*value.shape[1:]) if value.ndim > 1 else found[0]

    def span(value: Any) -> Any:
        of, value = xp.module_of(value), value if counting is None else value[counting]
        return xp.stack([xp.taken(value, pick(xp.value(value), axis=0)) for pick in (of.argmin, of.argmax)])

    if isinstance(scene.phase, PitchMean):
        middle: Any = 0.5 * geometry.roller_pitch(scene.bearing)
        of_every, stiffness = mean, without_poles(scene, every.displacement, stiffness)
        share = xp.value(weights)  # 0 where a program has phases to make up their number
        counting = xp.where(share > 0.0, np.arange(len(share)), xp.module_of(share).argmax(share))
    else:
        middle = scene.phase
        of_every, counting = operator.itemgetter(0), None
    of = xp.module_of(every.residual)
    return Solution(
        angles=roller_places.roller_angles(scene.bearing, middle),
        displacement=of_every(every.displacement),
        approach=of_every(every.approach),
        loads=of_every(every.loads),
        stiffness=of_every(stiffness),
        load_span=span(every.loads),
        stiffness_span=span(stiffness),
        law=law,
        residual=of.max(every.residual),
        iterations=of.max(every.iterations),
        status_code=of.max(every.status_code),
        effects=xp.tree_map(of_every, more),
        picked=scene.picked,
        definition=scene.definition,
        remarks=effects.remarks(scene.effects, scene.spalls, isinstance(scene.phase, PitchMean), law),
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


def at_phases(
    scene: Scene, each: Any, loads: Load | None = None, spalls: tuple[Spall, ...] | None = None
) -> ring.Equilibrium:
    """The ring of a prepared scene at all cage phases `each` [rad], shape (phases,), in any arithmetic: what it
    has is of shape (phases, …). `loads`: at every phase its own, both of shape (phases,), in place of the scene's;
    `spalls`: the same, what differs between phases of shape (phases, 1)."""
    return rings_at(scene, each, loads, spalls)[0]


def rings_at(
    scene: Scene, each: Any, loads: Load | None = None, spalls: tuple[Spall, ...] | None = None, law: Law | None = None
) -> tuple[ring.Equilibrium, effects.Ring, effects.Terms]:
    """As `at_phases`; and what effects act on there, and what they add to it. `law`: of the outer raceway, if it is
    carried to its contact already."""
    within = checks.code(xp.fixed(scene))
    scene = dataclasses.replace(scene, load=loads or scene.load, spalls=scene.spalls if spalls is None else spalls)
    here, terms = ring_at(scene, law_in_effect(scene, law or outer_law(scene)), each)
    terms = terms._replace(laws_status=within if terms.laws_status is None else status.worst(within, terms.laws_status))
    return here.equilibrium(terms), here, terms


@np.errstate(all="ignore")
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
