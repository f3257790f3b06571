"""About how much the most loaded roller of a scene will carry, before there is a law: what laws are made to reach."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, cast

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.geometry import Real
from difftrb.law import power
from difftrb.law.base import Law
from difftrb.ring import load, ring, roller_places
from difftrb.ring.effect_base import among
from difftrb.ring.effects import Raceways, Through
from difftrb.scene.scene import Scene, healthy, law_in_effect, ring_at

WIDE, SPARE = 1.0, 2.5
"""Width of a spall, by the rollers' pitch, from which curves reach `SPARE` times the largest load; so do those of
effects that press."""
TRIED_PHASES = 9
"""Over one pitch, at which the largest load beside through spalls is looked for."""


def largest_load(scene: Scene) -> Real:
    """A first estimate of the most loaded roller's load [N], by the load and by what else presses."""
    largest = load.largest_load(scene.bearing, scene.load)
    through = is_through(scene)
    if not through and not any(effect.presses for effect in scene.effects):
        return largest
    alone = single(scene, power.Palmgren(scene.bearing.roller_length))
    alone = alone if through else healthy(alone)
    return xp.maximum(largest, _pressed(alone))


def largest_for_curves(scene: Scene) -> float:
    """The same for laws that know nothing beyond their loads: more, where spalls may take their load from several
    rollers, or all of it from one."""
    pitch = float(geometry.roller_pitch(scene.bearing) * geometry.arc_radius(scene.bearing))
    through, presses = is_through(scene), any(effect.presses for effect in scene.effects)
    wide = not through and any(float(spall.width) > WIDE * pitch for spall in scene.spalls)
    plain = float(load.largest_load(scene.bearing, scene.load))
    # effects may hold the ring where the load alone does not
    largest = float(largest_load(scene)) if through or presses else max(plain, _in_narrow_zone(scene))
    # in steps: what presses a little more shares the nodes, so that neighbouring scenes differ by physics alone
    halves = max(math.ceil(2.0 * math.log2(largest / plain)), 0) if plain > 0.0 else 0
    pressed = plain * 2.0 ** (0.5 * halves) if plain > 0.0 else largest
    return pressed * (SPARE if wide or (presses and halves) else 1.0)


def _in_narrow_zone(scene: Scene) -> float:
    """The largest load [N] on the healthy ring by Palmgren's law, over one pitch: where little more than the least
    axial load acts, a few rollers carry all."""
    at = float(geometry.roller_pitch(scene.bearing)) * np.linspace(0.0, 1.0, TRIED_PHASES)
    law = power.Palmgren(scene.bearing.roller_length)
    one_carries_all = float(scene.load.radial / np.cos(scene.bearing.outer_angle))
    loads = rings(healthy(dataclasses.replace(scene, effects=())), law, at).loads
    return float(np.max(np.where(np.isfinite(loads), loads, one_carries_all)))  # at some phases there may be no rest


@np.errstate(all="ignore")
def rings(scene: Scene, law: Law, phases: Any) -> ring.Equilibrium:
    """Of a scene at phases of shape (phases,), by a law; without derivatives where these are expanded."""
    if xp.are_numbers((scene, law)):
        scene, law, phases = xp.numbers((scene, law, phases))
    here, terms = ring_at(scene, law, phases)
    return xp.values(here.equilibrium(terms))


def is_through(scene: Scene) -> bool:
    """Whether rollers over spalls carry nothing, so that the others carry their share."""
    met = roller_places.spalls_on(scene.spalls, "outer")
    return bool(met) and among(scene.effects, Through) is not None


def single(scene: Scene, law: Law) -> Scene:
    """The scene with one law, and without the inner raceway's, which is not made yet."""
    acting = tuple(effect for effect in scene.effects if not isinstance(effect, Raceways))
    return dataclasses.replace(scene, law=law, effects=acting, accuracy=1e-3)  # one accuracy is one program for all


def _pressed(scene: Scene) -> Any:
    """The largest load [N] on the ring by Palmgren's law, with through spalls at several phases: by a third or so too
    large for one contact alone, and by more if the inner one gives way, too."""
    turned = np.linspace(0.0, 1.0, TRIED_PHASES) if scene.spalls else np.zeros(1)
    acting = law_in_effect(scene, cast(Law, scene.law))
    loads = rings(scene, acting, geometry.roller_pitch(scene.bearing) * turned).all_loads
    return xp.module_of(loads).nan_to_num(loads).max()
