"""The cage phases at which a scene is solved: one, or those of a mean over the roller pitch, whose places move with
what the rollers meet. See `ring.phase_rule`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.numeric import gauss_legendre
from difftrb.law.local import LocalLaw, States
from difftrb.ring import phase_rule, ring, roller_places
from difftrb.scene.scene import PitchMean, Scene, healthy, inner_law, is_plain, law_in_effect, outer_law, ring_at


def phases(scene: Scene, still: Any = None) -> tuple[Any, Any]:
    """Cage phases at which a prepared scene is solved [rad] and their weights in its mean, shape (phases,) each;
    `still` as in `pitch_borders`."""
    if not isinstance(scene.phase, PitchMean):
        return xp.asarray(scene.phase)[None], np.ones(1)
    rule = gauss_legendre(phase_rule.POINTS_BY_CONTACTS) if isinstance(scene.law, LocalLaw) else None
    found = phase_rule.between(pitch_borders(scene, still), rule)
    return found if xp.expands(scene) else xp.values(found)


def at_all_phases(solve: Callable[[Any, Scene], Any], scene: Scene, each: Any) -> Any:
    """`solve(phase, scene)` of a prepared scene at the phases `each` [rad], in arrays of JAX with the phases in front.
    A law by contacts of every phase of a mean is given it as of that phase."""
    if not isinstance(scene.phase, PitchMean):
        return jax.tree.map(lambda value: jnp.asarray(value)[None], solve(each[0], scene))
    parts, made_of = jax.tree.flatten(scene, is_leaf=_is_states)
    of_phases = [_is_states(part) for part in parts]
    if not scene.spalls:  # a healthy bearing has other phases, and no roller over a spall
        parts = [None if own else part for part, own in zip(parts, of_phases, strict=True)]
    axes = made_of.unflatten([0 if own and scene.spalls else None for own in of_phases])
    return jax.vmap(solve, in_axes=(0, axes))(each, made_of.unflatten(parts))


def nearest_phase(scene: Scene, angle: float) -> Scene:
    """A prepared scene at the phase of its mean at which roller 0, or another, stands nearest to an angle [rad]."""
    pitch, each = float(geometry.roller_pitch(scene.bearing)), np.asarray(phases(scene)[0])
    k = int(np.argmin(np.abs((each - angle + 0.5 * pitch) % pitch - 0.5 * pitch)))
    return at_phase_numbered(scene, k, float(each[k]))


def at_phase_numbered(scene: Scene, k: int, phase: float) -> Scene:
    """A prepared scene at the `k`-th phase of its mean [rad]."""
    parts, made_of = jax.tree.flatten(dataclasses.replace(scene, phase=phase), is_leaf=_is_states)
    return made_of.unflatten([jax.tree.map(lambda of: of[k], part) if _is_states(part) else part for part in parts])


def _is_states(part: Any) -> bool:
    return isinstance(part, States)


@np.errstate(all="ignore")
def pitch_borders(scene: Scene, still: Any = None) -> Any:
    """Between which phases a prepared scene has no kink [rad]; `still` if it is plain: see `phase_rule.borders`. Of a
    plain one loads may be several."""
    if is_plain(scene) and xp.are_numbers(scene):
        scene = xp.numbers(scene)
    acting = law_in_effect(scene, outer_law(scene))
    met = [phase_rule.Met("outer", roller_places.spalls_on(scene.spalls, "outer"), acting)]
    if (inner := inner_law(scene)) is not None:
        met.append(phase_rule.Met("inner", roller_places.spalls_on(scene.spalls, "inner"), inner))
    sound = healthy(scene)
    here, terms = ring_at(sound, acting, 0.0)

    def at_once(each: Any) -> ring.Equilibrium:
        def of_phases(part: Any) -> Any:
            return xp.broadcast_to(part[:, None], each.shape) if np.ndim(part) else part

        load = xp.tree_map(of_phases, scene.load)
        here, own = ring_at(dataclasses.replace(sound, load=load), acting, each)
        return here.equilibrium(own)

    def by_program(each: Any) -> ring.Equilibrium:
        return jax.vmap(lambda phase: here._replace(phase=phase).equilibrium(terms))(each)

    at_rest = at_once if is_plain(scene) and (xp.are_numbers(scene) or xp.expands(scene)) else by_program
    return phase_rule.borders(scene.bearing, scene.load, tuple(met), at_rest, terms, still)
