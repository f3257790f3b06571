"""Where rollers stand at a phase of the cage, which way they press, and how far they are from every spall."""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.geometry import Raceway, Spall, TaperedBearing


def roller_angles(bearing: TaperedBearing, phase: Any) -> Any:
    """Angle of every roller from the load line [rad], shape (…, rollers); roller 0 stands at `phase`, shape (…)."""
    phase = xp.asarray(phase)
    count = np.arange(bearing.rollers).reshape((1,) * phase.ndim + (-1,))
    return phase[..., None] + geometry.roller_pitch(bearing) * count


def directions(bearing: TaperedBearing, angles: Any) -> Any:
    """Unit normals of the rollers' contacts in (radial, lateral, axial), shape (…, rollers, 3)."""
    cos, sin = xp.cos(bearing.outer_angle), xp.sin(bearing.outer_angle)
    axial = sin * xp.ones_like(angles)
    return xp.stack([cos * xp.cos(angles), cos * xp.sin(angles), axial], axis=-1)  # Liu et al. 2018, eq. (5)


def spalls_on(spalls: tuple[Spall, ...], raceway: Raceway) -> tuple[Spall, ...]:
    """The spalls that rollers meet on a raceway: its own, and a roller's, which meets both, the inner one the other way
    round."""
    return tuple(spall.turned_over() if spall.surface != raceway and raceway == "inner" else spall
                 for spall in spalls if spall.surface in (raceway, "roller"))  # fmt: skip


def distances(bearing: TaperedBearing, spalls: tuple[Spall, ...], angles: Any, raceway: Raceway = "outer") -> Any:
    """From the centre of every spall met on a raceway to every roller's contact with it, along the raceway [mm], shape
    (spalls, …, rollers). A spall on a roller is on roller 0, its angle counted from the outer contact; to the others it
    is as far as can be."""
    if not spalls:
        return np.zeros((0, *angles.shape))
    radius = geometry.arc_radius(bearing, raceway)
    first = (np.arange(bearing.rollers) == 0).reshape((1,) * (angles.ndim - 1) + (-1,))

    def away(spall: Spall) -> Any:
        if spall.surface != "roller":
            return radius * geometry.wrapped(angles - spall.angle)
        # on the roller's other side an angle about its axis leads the other way along the cage's turn
        own = geometry.mean_roller_radius(bearing) * geometry.wrapped(
            spall.angle - np.pi if raceway == "inner" else -spall.angle
        )
        return xp.where(first, own, np.pi * radius) + 0.0 * angles

    return xp.stack([away(spall) for spall in spalls])
