"""The cage phases at which a scene is solved: one, or those of a mean over the roller pitch, whose places move with
what the rollers meet. See `ring.phase_quadrature`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, cast

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.geometry import Raceway
from difftrb.core.numeric import gauss_legendre
from difftrb.law import base, direct_states
from difftrb.law.base import Law
from difftrb.law.direct_states import DirectByStates
from difftrb.ring import phase_kinks, phase_quadrature, roller_places
from difftrb.ring.load import Load
from difftrb.ring.phase_kinks import Borders, HealthyRing, Turning
from difftrb.scene.scene import (
    PitchMean,
    Scene,
    healthy,
    inner_law,
    law_in_effect,
    outer_law,
    ring_at,
    upright_by_table,
)


def phases(scene: Scene, healthy_ring: HealthyRing | None = None) -> tuple[Any, Any]:
    """Cage phases at which a prepared scene is solved [rad] and their weights in its mean, shape (phases,) each;
    `healthy_ring` as in `pitch_borders`."""
    if not isinstance(scene.phase, PitchMean):
        return xp.asarray(scene.phase)[None], np.ones(1)
    by_states = isinstance(scene.law, DirectByStates)
    rule = gauss_legendre(phase_quadrature.POINTS_BY_CONTACTS) if by_states else None
    at, there = _borders(scene, healthy_ring, few=by_states)
    if xp.are_numbers(scene) and not base.kind(cast(Law, scene.law).name).one_scene:
        at = at[there]  # laws of one scene have as many phases in any arithmetic
    found = phase_quadrature.between(at, rule)
    return found if xp.expands(scene) else xp.values(found)


def nearest_phase(scene: Scene, angle: float) -> Scene:
    """A prepared scene at the phase of its mean at which roller 0, or another, stands nearest to an angle [rad]."""
    pitch, each = float(geometry.roller_pitch(scene.bearing)), np.asarray(phases(scene)[0])
    k = int(np.argmin(np.abs(geometry.wrapped(each - angle, pitch))))
    return at_phase_numbered(scene, k, float(each[k]))


def at_phase_numbered(scene: Scene, k: int, phase: float) -> Scene:
    """A prepared scene at the `k`-th phase of its mean [rad]."""
    plain = not scene.spalls
    return _of_laws(dataclasses.replace(scene, phase=phase), lambda law: direct_states.at_phase(law, k, plain))


def _of_laws(scene: Scene, change: Callable[[DirectByStates], Any]) -> Scene:
    """The scene with the laws by contact solves on all raceways changed so."""

    def is_local(part: Any) -> bool:
        return isinstance(part, DirectByStates)

    parts, made_of = jax.tree.flatten(scene, is_leaf=is_local)
    return made_of.unflatten([change(part) if is_local(part) else part for part in parts])


def pitch_borders(scene: Scene, healthy_ring: HealthyRing | None = None) -> Any:
    """Between which phases a prepared scene has no kink [rad], as many for any: `phase_kinks.Borders.at` where few ends
    of load zones are looked for. `healthy_ring`: if it is known and the same at all phases: then none is solved. Loads
    may be several."""
    return _borders(scene, healthy_ring, few=True).at


@np.errstate(all="ignore")
def _borders(scene: Scene, healthy_ring: HealthyRing | None, few: bool) -> Borders:
    """Where a prepared scene has its kinks. Laws of one scene know its rollers at the phases alone: then kinks are
    where rings by the table have them, and of rollers that this does not know where healthy rings do."""
    scene = xp.numbers(scene) if xp.are_numbers(scene) else scene
    if getattr(scene.law, "kinks_by_table", False):
        scene = upright_by_table(scene)
    return phase_kinks.borders(_turning, (scene, healthy_ring), few)


def _turning(given: tuple[Scene, HealthyRing | None]) -> Turning:
    """A prepared scene while its cage turns, whose healthy ring may be known."""
    scene, healthy_ring = given
    met, loads = _met(scene), np.shape(xp.value(scene.load.radial))
    acting = direct_states.without_states(met[0].law)
    rings = _of_laws(healthy(scene), direct_states.without_states) if base.kind(acting.name).one_scene else scene
    terms = ring_at(rings, acting, 0.0)[1]

    def at_rest(each: Any) -> tuple[Any, list[Any]]:
        def of_phases(part: Any) -> Any:
            return xp.broadcast_to(part[:, None], each.shape) if np.ndim(part) else part

        load = xp.tree_map(of_phases, scene.load)
        here, own = ring_at(dataclasses.replace(rings, load=load), acting, each)
        rest = here.equilibrium(own)
        return rest.displacement, phase_kinks.shares(met, rest, terms)

    def known(each: Any) -> tuple[Any, list[Any]]:
        assert healthy_ring is not None
        u = xp.broadcast_to(healthy_ring.displacement[..., None, :], (*each.shape, 3))
        own = (xp.broadcast_to(share[..., None], each.shape) for share in xp.moveaxis(healthy_ring.shares, -1, 0))
        return u, [phase_kinks.WHOLE for _ in met] if terms.seat is None else list(own)

    return Turning(scene.bearing, met, terms, loads, at_rest if healthy_ring is None else known)


def _met(scene: Scene) -> tuple[phase_kinks.Met, ...]:
    """Spalls and laws of the raceways that give way, the outer one's first."""
    laws: dict[Raceway, Law | None] = {"outer": law_in_effect(scene, outer_law(scene)), "inner": inner_law(scene)}
    return tuple(
        phase_kinks.Met(raceway, roller_places.spalls_on(scene.spalls, raceway), law)
        for raceway, law in laws.items()
        if law is not None
    )


@np.errstate(all="ignore")
def healthy_ring(scene: Scene, loads: np.ndarray) -> HealthyRing | None:
    """A prepared scene's healthy ring under radial and axial `loads` [N], shape (loads, 2), which no size of a spall
    changes. None where rings are not `ALIKE` at other phases, or tilt."""
    scene = xp.numbers(healthy(scene))
    turned = np.arange(4) / 4.0 * float(geometry.roller_pitch(scene.bearing))
    each = Load(*np.repeat(loads, len(turned), axis=0).T)
    met = _met(scene)
    here, terms = ring_at(dataclasses.replace(scene, load=each), met[0].law, np.tile(turned, len(loads)))
    rest = here.equilibrium(terms)
    found = xp.values(rest.displacement).reshape(len(loads), len(turned), -1)
    apart = np.ptp(found, axis=1).max(axis=1)
    if found.shape[-1] != 3 or not np.all(apart <= phase_kinks.ALIKE * np.abs(found).max(axis=(1, 2))):
        return None
    shares = [np.broadcast_to(share, each.radial.shape) for share in phase_kinks.shares(met, rest, terms)]
    return HealthyRing(found[:, 0], np.stack(shares, axis=-1)[:: len(turned)])
