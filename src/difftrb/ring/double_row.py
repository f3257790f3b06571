"""A second row of rollers on the same shaft."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal

import jax
import jax.core
import numpy as np
from annotated_types import Interval, Unit

from difftrb.contact.contact_solution import is_given
from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.geometry import Real, TaperedBearing
from difftrb.core.status import SceneError
from difftrb.ring.effect_base import Asked, Effect, Results, Ring, Stage, register
from difftrb.ring.ring import Equilibrium
from difftrb.ring.terms import Pair, Terms, Tilting

LEAST_REACH = 0.01
"""Distance of the load centres from the middle between the rows, by what it is without spacing, below which the shaft's
tilt counts as not held."""
Moment = Annotated[Real, Interval(ge=-1e9, le=1e9), Unit("N mm")]


def reach_of_pair(bearing: TaperedBearing, spacing: Real, back_to_back: bool) -> Any:
    """See `Pair`; `spacing` is the distance between the middles of both rows' outer contacts [mm]."""
    # the contacts' normals meet the axis R tanα from the rows, behind the rollers' large ends
    apart = 0.5 * spacing * xp.cos(bearing.outer_angle)
    centre = geometry.outer_raceway_radius(bearing) * xp.sin(bearing.outer_angle)
    return xp.asarray(centre + apart if back_to_back else centre - apart)


@register
@dataclasses.dataclass(frozen=True)
class DoubleRow(Effect):
    """Two rows of the same bearing on one shaft, the second one the other way round; one load, one displacement.

    Spalls with `row = 2` are on the second row. The scene's diameters are the first row's, and so are `Solution.loads`
    and what other effects give of rollers; the axial load presses the first row's rings together. Displacement is
    counted from the middle between the places where either row alone would touch. The rollers of both rows stand at the
    same angles.

    Attributes:
      preload: how far both rows together are pressed axially beyond touching [mm], −1…1; negative is end play. Default
        0.
      arrangement: "back_to_back" (default): load centres outside the rows, or "face_to_face": inside.
      spacing: between the middles of both rows' outer contacts [mm], 0.1…1000. With it the shaft tilts about the
        middle between them: five degrees of freedom, stiffness 5 × 5; rollers are held by their middles, or by slices
        with `Tilt`. Default: none, rings stay parallel, and the arrangement does not matter.
      moment_radial, moment_lateral: about the radial and the lateral axis through that middle [N mm], −1e9…1e9; need
        the spacing. Default 0.
    """

    key = "double_row"
    label = "a second row on the same shaft"
    stage = Stage.ROWS
    presses = True
    excludes = {"mounting": "a pair's own preload or end play places its rings, and the axial load is given"}  # noqa: RUF012
    units = {  # noqa: RUF012
        "second_row_loads": "N", "first_row_radial": "N", "first_row_axial": "N", "second_row_radial": "N",
        "second_row_axial": "N", "second_row_share": "%",
    }  # fmt: skip

    preload: Annotated[Real, Interval(ge=-1.0, le=1.0), Unit("mm")] = 0.0
    arrangement: Literal["back_to_back", "face_to_face"] = dataclasses.field(
        default="back_to_back", metadata={"static": True}
    )
    spacing: Annotated[Real, Interval(ge=0.1, le=1000.0), Unit("mm")] | None = None
    moment_radial: Moment = 0.0
    moment_lateral: Moment = 0.0

    def reach(self, bearing: TaperedBearing) -> Any | None:
        """See `Pair`."""
        return (
            None if self.spacing is None else reach_of_pair(bearing, self.spacing, self.arrangement == "back_to_back")
        )

    def check(self, asked: Asked) -> None:
        """A spacing for moments, and load centres apart."""
        reach = self.reach(asked.bearing)
        if reach is None or self.spacing is None:
            for name in ("moment_radial", "moment_lateral"):
                if is_given(getattr(self, name)):
                    raise SceneError(f"effects.double_row.spacing is missing: {name} needs it; give a number in mm")
            return
        alone = reach_of_pair(asked.bearing, 0.0, back_to_back=True)
        if not isinstance(reach, jax.core.Tracer) and abs(float(reach)) < LEAST_REACH * float(alone):
            raise SceneError(
                f"effects.double_row.spacing = {float(self.spacing):g}: puts both rows' load centres in "
                "one place, which does not hold the shaft's tilt; change it, or leave it out"
            )

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """A second row, both pressed by half the preload, and the shaft's tilt."""
        reach = self.reach(of.bearing)
        pressed = 0.5 * self.preload * xp.sin(of.bearing.outer_angle)
        terms = terms.thicker(xp.asarray(pressed))._replace(pair=Pair(self.preload, reach))
        if reach is None:
            return terms
        moments = xp.stack([xp.asarray(m) for m in (self.moment_radial, self.moment_lateral)])
        levers = np.ones(of.bearing.rollers) * reach
        return terms._replace(tilting=Tilting(xp.concatenate([levers, -levers]), moments))

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`second_row_loads` on its outer raceway [N], shape (rollers,); `first_row_radial`, `first_row_axial`,
        `second_row_radial`, `second_row_axial`: what either row carries along the load line and the axis, pushing its
        rings apart [N]; `second_row_share` of all rollers' loads [%]."""
        second = rest.second_loads
        assert second is not None  # for there is a pair among the terms
        alpha = of.bearing.outer_angle
        found: Results = {"second_row_loads": second}
        for name, loads in (("first", rest.loads), ("second", second)):
            found[f"{name}_row_radial"] = xp.cos(alpha) * xp.total(loads * xp.cos(of.angles))
            found[f"{name}_row_axial"] = xp.sin(alpha) * xp.total(loads)
        found["second_row_share"] = 100.0 * xp.total(second) / (xp.total(rest.loads) + xp.total(second))
        return found
