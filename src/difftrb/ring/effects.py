"""All effects: what a scene may ask for beyond the plain ring, nothing paid for when it is absent.

Here are those of one row on rings that stay parallel; `tilt`, `double_row` and `life` have theirs. Scenes name effects
in any order. A module of this room that registers an effect is found without being named here.
"""

from __future__ import annotations

import dataclasses
import importlib
import itertools
import pkgutil
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from annotated_types import Interval, Unit

import difftrb.ring
from difftrb.contact.contact_solution import is_given
from difftrb.core import arrays as xp
from difftrb.core import fields, geometry
from difftrb.core.geometry import Real, TaperedBearing
from difftrb.core.status import SceneError
from difftrb.law import direct_states, power
from difftrb.law.base import LAWS, Law
from difftrb.law.direct_states import DirectByStates
from difftrb.ring import roller_places
from difftrb.ring.double_row import DoubleRow
from difftrb.ring.effect_base import (
    Asked,
    Effect,
    Results,
    Ring,
    Stage,
    among,
    register,
    registered,
    remarks,
    results,
    terms,
)
from difftrb.ring.life import Life
from difftrb.ring.ring import Equilibrium, axial_force
from difftrb.ring.roller_balance import inside
from difftrb.ring.terms import InnerRaceway, Terms
from difftrb.ring.tilt import Tilt

__all__ = [
    "Asked", "Centrifugal", "Diameters", "DoubleRow", "Effect", "Flange", "Life", "Mounting", "Raceways", "Results",
    "Ring", "SeriesRaceways", "Stage", "Terms", "Through", "Tilt", "register", "registered", "remarks", "results",
    "terms",
]  # fmt: skip

Length = Annotated[Real, Interval(ge=-1.0, le=1.0), Unit("mm")]
Diameter = Annotated[Real, Interval(ge=0.1, le=5000.0), Unit("mm")]
ON_THE_INNER_RING = {"inner_loads": "N", "flange_loads": "N"}


@register
@dataclasses.dataclass(frozen=True)
class Raceways(Effect):
    """Outer and inner raceway in series, each with its own radius, crown and spalls, and the flange between.

    Without it the inner ring does not give way, as in Liu et al. 2018. Laws "palmgren" and "liu2018" know the outer one
    only: both are refused.

    A roller over a spall off its middle tilts between the raceways until the moments of both contacts balance. That
    is known by contact solves, law "direct" or "auto"; other laws hold rollers upright, and say so where
    it counts.

    Attributes:
      inner_design_load: Q_d of the crown against the inner raceway [N], 0…1e7. Default: the scene's.
      rollers: "free" to tilt between the raceways (default), or held "upright", as in Liu et al. 2018: the approach
        then rises too little over a spall off the middle, by 13 … 40 % for 2 … 8 mm at the end of a 32008J's roller.
    """

    key = "raceways"
    label = "outer and inner raceway in series"
    stage = Stage.SEAT
    units = {**ON_THE_INNER_RING, "roller_tilts": "mrad"}  # noqa: RUF012

    inner_design_load: Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")] | None = None
    rollers: Literal["free", "upright"] = dataclasses.field(default="free", kw_only=True, metadata={"static": True})

    def check(self, asked: Asked) -> None:
        """A law of one contact."""
        if isinstance(asked.law, str) and asked.law in LAWS and not LAWS[asked.law].inner:
            raise SceneError(
                f"contact.law = {asked.law!r} does not know the inner raceway alone: with effects.raceways use "
                "'power', 'table' or 'direct'"
            )


@fields.register
@dataclasses.dataclass(frozen=True)
class SeriesRaceways(Raceways):
    """`Raceways` prepared: with the inner raceway's law."""

    law: Law | None = None

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """Inner contacts that give way."""
        spalls, away = roller_places.spalls_on(of.spalls, "inner"), of.distances("inner", terms)
        law = cast(Law, self.law) if of.spalls else direct_states.without_spalls(cast(Law, self.law))
        free = self.rollers == "free" and not isinstance(of.law, power.AllThrough)  # which leaves nothing to lean on
        inner = InnerRaceway(law, spalls, away, geometry.equivalent_radius(of.bearing, "inner"), free)
        return terms._replace(seat=of.seat(terms)._replace(inner_curves=law.curves(spalls, away)), inner_raceway=inner)

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`inner_loads`, `flange_loads` [N], shape (rollers,); where rollers may tilt `roller_tilts` [mrad], without
        derivatives."""
        found = inside(terms.seat, rest.loads)
        if not isinstance(of.law, DirectByStates) or not of.law.free_to_tilt or terms.slices is not None:  # see `Tilt`
            return found
        return {**found, "roller_tilts": 1e3 * xp.fixed(of.law).roller_tilts(xp.fixed(rest.loads))}


def are_free(effects: tuple[Effect, ...]) -> bool:
    """Whether rollers between two raceways in series may tilt."""
    series = among(effects, Raceways)
    return series is not None and series.rollers == "free"


@register
@dataclasses.dataclass(frozen=True)
class Flange(Effect):
    """The flange of the inner ring, against which the raceways wedge the rollers' large ends.

    Attributes:
      compliance: "rigid" (default) or "hertz": ball on plane.
      end_radius: radius of the rollers' spherical large ends [mm], 0.1…5000; needed for "hertz".
    """

    key = "flange"
    label = "the flange of the inner ring"
    stage = Stage.SEAT
    units = {**ON_THE_INNER_RING, "flange_angle": "rad"}  # noqa: RUF012

    compliance: Literal["rigid", "hertz"] = dataclasses.field(default="rigid", metadata={"static": True})
    end_radius: Diameter | None = None

    def check(self, asked: Asked) -> None:
        """A radius to be soft by."""
        if self.compliance == "hertz" and self.end_radius is None:
            raise SceneError("effects.flange.end_radius is missing: compliance = 'hertz' needs it; give a number in mm")
        if self.compliance == "rigid" and self.end_radius is not None:
            raise SceneError(
                "effects.flange.end_radius is of no use to a rigid flange: set compliance = 'hertz', or leave it out"
            )

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """A flange that gives way, if asked."""
        if self.end_radius is None or self.compliance == "rigid":
            return terms._replace(seat=of.seat(terms))
        modulus = geometry.contact_modulus(of.bearing.modulus, of.bearing.poisson)
        soft = (9.0 / (16.0 * self.end_radius * modulus**2)) ** (1.0 / 3.0)  # Johnson 1985, eq. (4.23)
        return terms._replace(seat=of.seat(terms)._replace(flange_compliance=soft))

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`inner_loads`, `flange_loads` [N], shape (rollers,); `flange_angle` of the force from the axis [rad]."""
        return {**inside(terms.seat, rest.loads), "flange_angle": xp.asarray(of.seat(terms).flange)}


@register
@dataclasses.dataclass(frozen=True)
class Centrifugal(Effect):
    """Centrifugal force on the rollers: outer loads stay, inner ones fall and flange loads rise at a given axial load;
    at a given axial position outer loads rise, if the inner raceway gives way (`Raceways`).

    Attributes:
      speed_rpm: of the inner ring, the outer one at rest [rev/min], 0…1e5.
      control: "force" (default): the axial load is given. "position": the rings keep the axial position that they have
        under it at rest.
      convention: "balance" (default): every roller is at rest between outer raceway, inner raceway and flange (Liu et
        al. 2022, eq. 5). "printed": the forces are added to the ring's, as in Liu et al. 2018, eq. (5); they cancel.
    """

    key = "centrifugal"
    label = "centrifugal force on the rollers"
    stage = Stage.SPEED
    presses = True
    units = {**ON_THE_INNER_RING, "centrifugal_force": "N", "axial_force": "N"}  # noqa: RUF012

    speed_rpm: Annotated[Real, Interval(ge=0.0, le=1e5), Unit("rev/min")]
    control: Literal["force", "position"] = dataclasses.field(default="force", metadata={"static": True})
    convention: Literal["balance", "printed"] = dataclasses.field(default="balance", metadata={"static": True})

    @property
    def holds_axially(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Where it is that at rest."""
        return self.control == "position"

    def force(self, bearing: TaperedBearing) -> Any:
        """On one roller [N]."""
        metres = 1e-3 * geometry.pitch_radius(bearing)
        return xp.asarray(geometry.roller_mass(bearing) * metres * geometry.cage_rate(bearing, self.speed_rpm) ** 2)

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """Rollers thrown outwards; the ring held where it is at rest if asked."""
        if self.control == "position" and terms.axial is None:
            rest = of.equilibrium(terms)
            terms = terms._replace(axial=rest.displacement[..., 2], laws_status=rest.status_code)
        if self.convention == "printed":
            force = (1 if terms.pair is None else 2) * self.force(of.bearing)
            thrown = [-force * xp.total(function(of.angles)) for function in (xp.cos, xp.sin)]
            return terms._replace(extra=xp.stack([*thrown, xp.zeros_like(thrown[0])], axis=-1))  # Liu 2018, eq. (5)
        return terms._replace(seat=of.seat(terms)._replace(centrifugal=self.force(of.bearing)))

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`centrifugal_force` on one roller [N]; loads of inner ring and flange unless "printed"; `axial_force` that
        holds the rings [N] if a position is held."""
        found = {**inside(terms.seat, rest.loads), "centrifugal_force": self.force(of.bearing)}
        return found if terms.axial is None else {**found, "axial_force": axial_force(rest, of.bearing)}


@register
@dataclasses.dataclass(frozen=True)
class Diameters(Effect):
    """Rollers of different diameters (Liu et al. 2022).

    Attributes:
      deviations: of every roller's diameter from the nominal [mm], −1…1, as many as there are rollers.
    """

    key = "diameters"
    label = "rollers of different diameters"
    presses = True
    per_turn = True

    deviations: tuple[Length, ...]

    def check(self, asked: Asked) -> None:
        """One for every roller."""
        if len(self.deviations) != asked.bearing.rollers:
            raise SceneError(
                f"effects.diameters.deviations has {len(self.deviations)} entries for {asked.bearing.rollers} rollers; "
                "give one for each"
            )

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """Added to the rollers' approach."""
        more = xp.stack(self.deviations)
        return terms.thicker(more if terms.pair is None else xp.concatenate([more, xp.zeros_like(more)]))


@register
@dataclasses.dataclass(frozen=True)
class Mounting(Effect):
    """Rings held at an axial position in place of an axial load (which has to be 0): preload or end play, changed by
    interference fits and by warmth.

    Attributes:
      preload: how far the rings are pressed together beyond touching, without fits and warmth [mm], −1…1; negative is
        axial clearance (end play).
      shaft_interference, housing_interference: of the diameters [mm], −1…1. Default 0.
      bore, outside: of the bearing [mm], 0.1…5000; needed for the interferences.
      shaft_bore, housing_outside: of a hollow shaft and of the housing [mm]; defaults: solid and infinite.
      warmer: temperature of inner ring and rollers above the outer ring's [K], −500…500. Default 0.
      expansion: coefficient of thermal expansion [1/K], 0…1e-3. Default 1.25e-5 (NSK E728g, bearing steel).
    """

    key = "mounting"
    label = "rings held at a position, with fits and warmth"
    presses = True
    holds_axially = True
    units = {"axial_force": "N", "tightened": "mm"}  # noqa: RUF012

    preload: Length = 0.0
    shaft_interference: Length = 0.0
    housing_interference: Length = 0.0
    bore: Diameter | None = None
    outside: Diameter | None = None
    shaft_bore: Annotated[Real, Interval(ge=0.0, le=5000.0), Unit("mm")] = 0.0
    housing_outside: Diameter | None = None
    warmer: Annotated[Real, Interval(ge=-500.0, le=500.0), Unit("K")] = 0.0
    expansion: Annotated[Real, Interval(ge=0.0, le=1e-3), Unit("1/K")] = 1.25e-5

    def check(self, asked: Asked) -> None:
        """Diameters to fit by, and no axial load beside the position."""
        for size, needs in (("bore", "shaft_interference"), ("bore", "shaft_bore"),
                            ("outside", "housing_interference"), ("outside", "housing_outside")):  # fmt: skip
            if getattr(self, size) is None and getattr(self, needs) is not None and is_given(getattr(self, needs)):
                raise SceneError(f"effects.mounting.{size} is missing: {needs} needs it; give a number in mm")
        self._check_that_one_fits_into_another(asked.bearing)
        if is_given(asked.load.axial):
            raise SceneError(
                "load.axial must be 0 with effects.mounting, which holds the rings at a position: the axial force is "
                "what comes out; set it to 0"
            )

    def _check_that_one_fits_into_another(self, bearing: TaperedBearing) -> None:
        if self.bore is None and self.outside is None:
            return
        inner, outer = self.raceways(bearing)
        outwards = {"shaft_bore": self.shaft_bore, "bore": self.bore, "the inner raceway": inner,
                    "the outer raceway": outer, "outside": self.outside,
                    "housing_outside": self.housing_outside}  # fmt: skip
        known = [(name, float(size)) for name, size in outwards.items() if size is not None and xp.are_numbers(size)]
        for (small, low), (large, high) in itertools.pairwise(known):
            if low >= high:
                raise SceneError(
                    f"effects.mounting: {small} is {low:.4g} mm wide and {large}, which is around it, {high:.4g} mm; "
                    "give diameters that fit into each other"
                )

    def raceways(self, bearing: TaperedBearing) -> tuple[Real, Real]:
        """Diameters of inner and outer raceway at the rollers' middles [mm]."""
        outer = 2.0 * geometry.outer_raceway_radius(bearing)
        return outer * xp.sin(bearing.inner_angle) / xp.sin(bearing.outer_angle), outer

    def tightened(self, bearing: TaperedBearing) -> Real:
        """What inner raceway and rollers grow into the outer raceway by, in diameter [mm]: fits and warmth."""
        inner, outer = self.raceways(bearing)
        grown = self.expansion * self.warmer * outer  # NSK E728g: inner ring and rollers together
        if self.bore is not None:
            k, hollow = self.bore / inner, self.shaft_bore / self.bore
            grown += self.shaft_interference * k * (1.0 - hollow**2) / (1.0 - k**2 * hollow**2)  # NSK E728g
        if self.outside is not None:
            h = outer / self.outside
            thin = 0.0 if self.housing_outside is None else self.outside / self.housing_outside
            grown += self.housing_interference * h * (1.0 - thin**2) / (1.0 - h**2 * thin**2)  # NSK E728g
        return grown

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """The axial position, and rollers that are too thick."""
        normal = 0.5 * self.tightened(of.bearing) * xp.cos(of.bearing.outer_angle)
        return terms.thicker(normal)._replace(axial=xp.asarray(self.preload))

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`axial_force` that holds the rings [N]; `tightened`: growth of inner raceway and rollers [mm]."""
        held = axial_force(rest, of.bearing)
        return {"axial_force": held, "tightened": xp.asarray(self.tightened(of.bearing))}


@register
@dataclasses.dataclass(frozen=True)
class Through(Effect):
    """Spalls on the outer raceway as long as the rollers, the assumption before Liu et al. 2018: a roller drops in and
    carries nothing until it meets the bottom. To compare with."""

    key = "through"
    label = "spalls as long as the rollers"
    stage = Stage.CONTACT


for _module in pkgutil.iter_modules(difftrb.ring.__path__):  # those with effects register them
    importlib.import_module(f"{difftrb.ring.__name__}.{_module.name}")


if not TYPE_CHECKING:

    def __getattr__(name: str) -> type[Effect]:
        """An effect that somebody else registered, by the name of its class."""
        for kind in registered():
            if kind.__name__ == name:
                return kind
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
