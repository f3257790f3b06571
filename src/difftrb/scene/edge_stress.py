"""What rating life does not see: the pressure beside the ends of a spall that a loaded roller stands over.

ISO 281 and ISO/TS 16281 know loads, not edges. Beside a sharp edge the pressure is K/√(2πs) at the distance s (see
`intensity`) and so has no limit; K has, and with it how near to the edge a given pressure is passed.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from difftrb.contact.contact_extent import ends_along
from difftrb.contact.height_map import HeightMap
from difftrb.contact.stress_intensity import edge_intensity
from difftrb.core import status
from difftrb.core.geometry import Raceway
from difftrb.law.direct_states import DirectByStates
from difftrb.ring import roller_places
from difftrb.ring.effects import Life, SeriesRaceways, Through
from difftrb.scene.cage_phases import nearest_phase
from difftrb.scene.scene import PitchMean, Scene, raceway_contact
from difftrb.scene.solution import Solution, rollers_at
from difftrb.scene.solving import solve

STATIC_LIMIT = 4000.0
"""Contact stress of roller bearings under their basic static load rating [MPa] (ISO 76): from there on raceways yield
for good."""


class EdgeStress(NamedTuple):
    """The most loaded roller whose contact meets one spall on one raceway.

    Attributes:
      spall, roller: their numbers, from 0. raceway: "outer" or "inner". load: of the roller there [N].
      land: mean load per length on the land that the spall's length leaves, by that on the whole roller [-].
      intensity: largest K along the spall's ends [N/mm^1.5]; NaN where a rolling edge, the spall's bottom or the
        roller's end is in reach.
      within: distance from the edge below which the pressure exceeds `STATIC_LIMIT` [mm], K²/(2π 4000²); NaN as K.
    """

    spall: int
    roller: int
    raceway: Raceway
    load: float
    land: float
    intensity: float
    within: float

    @property
    def sentence(self) -> str:
        """What to say beside a rating life."""
        said = (
            f"rating life does not see edges: roller {self.roller} ({self.load:.0f} N on the {self.raceway} raceway) "
            f"meets spall {self.spall}, the land beside it carries {self.land:.2f} times the mean load per length, and "
            "at a sharp edge the pressure has no limit: "
        )
        if math.isfinite(self.intensity):
            said += (
                f"K/√(2πs) at the distance s, K = {self.intensity:.0f} N/mm^1.5, so above {STATIC_LIMIT:.0f} MPa "
                f"(ISO 76) within {1e3 * self.within:.1f} µm of it; "
            )
        else:
            said += "K is not known here, for the contact reaches more than the spall's two straight ends; "
        return said + "take the life as an upper bound"


def edge_stresses(scene: Scene, solution: Solution) -> tuple[EdgeStress, ...]:
    """One for every spall, on every raceway, that a loaded roller's contact meets in `solution` of the prepared
    `scene`; none unless the scene names the effect `Life`.

    With phase "mean" the roller stands centred in the spall, for one does on every pass. With `Through` there are none:
    such spalls have no ends. Of a second row's inner raceway there are none. Outside jit only; not differentiable.
    """
    kinds = {type(effect) for effect in scene.effects}
    if Life not in kinds or Through in kinds or not bool(solution.converged):
        return ()
    found: list[EdgeStress] = []
    for number, spall in enumerate(scene.spalls):
        if isinstance(spall, HeightMap):  # it has no straight ends
            continue
        at = solution
        if isinstance(scene.phase, PitchMean):
            known = isinstance(scene.law, DirectByStates)  # at the phases of its mean alone
            near = nearest_phase(scene, float(spall.angle)) if known else dataclasses.replace(scene, phase=spall.angle)
            at = solve(near)
        raceways: tuple[Raceway, ...] = ("outer", "inner") if SeriesRaceways in kinds and spall.row == 1 else ("outer",)
        found += [
            met for raceway in raceways
            if roller_places.spalls_on((spall,), raceway) and (met := _most_loaded_over(scene, number, raceway, at))
        ]  # fmt: skip
    return tuple(found)


def _most_loaded_over(scene: Scene, number: int, raceway: Raceway, at: Solution) -> EdgeStress | None:
    """The most loaded roller over one spall, if there is any."""
    spall, contact = scene.spalls[number], raceway_contact(scene, raceway)
    near = rollers_at(scene, at, spall, raceway)
    loads = np.where(near.meeting, near.loads, 0.0)
    roller = int(np.argmax(loads))
    if loads[roller] == 0.0:
        return None
    solved = edge_intensity(contact, loads[roller], spall, float(near.distances[roller]))
    known = int(solved.status_code) == status.CONVERGED
    intensity = float(max(np.max(solved.low), np.max(solved.high))) if known else math.nan
    low, high = map(float, ends_along(contact, spall))
    left = 1.0 - (high - low) / float(contact.length)
    within = intensity**2 / (2.0 * math.pi * STATIC_LIMIT**2)
    return EdgeStress(number, roller, raceway, float(loads[roller]), 1.0 / left if left > 0.0 else math.inf,
                      intensity, within)  # fmt: skip
