"""The bearing's load, what axial part of it is needed at least, and about how much the most loaded roller carries."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any

import jax
import numpy as np
from annotated_types import Interval, Unit

from difftrb.core import arrays as xp
from difftrb.core import fields, geometry
from difftrb.core.geometry import FILE_RULES, Real, TaperedBearing
from difftrb.ring import roller_places

if TYPE_CHECKING:
    from difftrb.ring.terms import Tilting


@fields.register
@dataclasses.dataclass(frozen=True)
class Load:
    """The bearing's load.

    Attributes:
      radial: along the load line [N], 0…1e7.
      axial: pressing the rings together [N], 0…1e7; needs to exceed about radial × tan(outer_angle).
    """

    __pydantic_config__ = FILE_RULES

    radial: Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]
    axial: Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]

    def __post_init__(self) -> None:
        fields.whole_to_float(self)


def needed_axial(bearing: TaperedBearing, radial: Real, phase: Real, tilting: Tilting | None = None) -> jax.Array:
    """The axial load [N] that must be exceeded for an equilibrium under `radial` [N] and, of rings that tilt, moments.

    Rollers push only: the load must lie inside the cone spanned by their normals, that is, the point
    radial·tanα/axial on the load line inside the polygon of the rollers' angles. Of rollers that carry along their
    length it is enough to look at those loaded at their two ends: force and moments part uniquely into one force at all
    first ends and one at all second ends, and each must lie inside its share of the polygon.
    """
    half = 0.5 * geometry.roller_pitch(bearing)
    edges = roller_places.roller_angles(bearing, phase) + half
    if tilting is None:
        reach = xp.module_of(edges).max(xp.cos(edges), axis=-1) / np.cos(half)
        return radial * xp.tan(bearing.outer_angle) * reach
    levers, (about_radial, about_lateral) = xp.fixed(tuple(tilting))
    low, high = levers.min(), levers.max()
    upper = (-about_lateral - low * radial / xp.cos(bearing.outer_angle)) / (high - low), about_radial / (high - low)
    lower = radial / xp.cos(bearing.outer_angle) - upper[0], -upper[1]
    of, beyond = xp.module_of(edges, upper), 0.0
    for along, aside in (upper, lower):
        along, aside = (part[..., None] if np.ndim(part) else part for part in (along, aside))
        beyond = beyond + of.max(along * xp.cos(edges) + aside * xp.sin(edges), axis=-1)
    return xp.sin(bearing.outer_angle) * beyond / np.cos(half)


def is_enough(axial: Real, needed: Real) -> Any:
    """Whether an axial load is more than what is needed, by more than rounding."""
    return axial > needed * (1.0 + 1e-6)


def too_light(axial: float, radial: float, needed: float, key: str = "", beside: str = "") -> str | None:
    """The sentence for an axial load [N] that holds no equilibrium under `radial` [N] and what is named `beside`; None
    if it does. `key` stands before the loads' names."""
    if axial != 0.0 and is_enough(axial, needed):
        return None
    return (
        f"{key}axial = {axial:g} N is too small for an equilibrium: with {key}radial = {radial:g} N{beside} it must "
        f"exceed {needed:.6g} N"
    )


def largest_load(bearing: TaperedBearing, load: Load) -> Real:
    """A first estimate of the most loaded roller's load [N]."""
    half_zone = 4.08 * load.radial / (bearing.rollers * xp.cos(bearing.outer_angle))  # NSK E728g, line contact
    shared = load.axial / (bearing.rollers * xp.sin(bearing.outer_angle))
    all_loaded = shared + 2.0 * load.radial / (bearing.rollers * xp.cos(bearing.outer_angle))  # a cosine on a mean
    return xp.maximum(half_zone, all_loaded)
