"""What a scene may ask for beyond the plain ring: each effect one small class, nothing paid for when it is absent.

An effect adds `Terms` to the ring's equilibrium and names what more comes out. Scenes name effects in any order; they
act in the order of `EFFECTS`.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal, cast

import jax
import jax.core
import jax.numpy as jnp
from annotated_types import Interval, Unit

from difftrb.contact.contact_problem import is_given
from difftrb.core import geometry, pytrees
from difftrb.core.files import shown
from difftrb.core.geometry import LineContact, Real, Spall, TaperedBearing
from difftrb.core.status import SceneError
from difftrb.law.laws import Law
from difftrb.ring import life, ring, roller_balance, slices
from difftrb.ring.double_row import DoubleRow
from difftrb.ring.effect import Effect, Length, Moment, Results, Ring, held_by, on_the_inner_ring, seat, thicker
from difftrb.ring.ring import Equilibrium, Load, Terms
from difftrb.ring.tilting import Tilting

HARD_SLICES = (
    "effects.tilt: slices beside a spall do not help those over it, so its loss of stiffness is overstated, two to "
    "three times where it was compared with contacts solved exactly"
)

Diameter = Annotated[Real, Interval(ge=0.1, le=5000.0), Unit("mm")]


@dataclasses.dataclass(frozen=True)
class Raceways(Effect):
    """Outer and inner raceway in series, each with its own radius, crown and spalls, and the flange between.

    Without it the inner ring does not give way, as in Liu et al. 2018. Law "palmgren" holds both contacts already and
    "liu2018" knows the outer one only: both are refused.

    Attributes:
      inner_design_load: Q_d of the crown against the inner raceway [N], 0…1e7. Default: the scene's.
    """

    key = "raceways"

    inner_design_load: Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")] | None = None


@dataclasses.dataclass(frozen=True)
class SeriesRaceways(Raceways):
    """`Raceways` prepared: with the inner raceway's law."""

    law: Law | None = None

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """Inner contacts that give way."""
        law, spalls, away = cast(Law, self.law), ring.spalls_on(of.spalls, "inner"), of.distances("inner", terms)
        facing = ring.Facing(law, spalls, away, geometry.equivalent_radius(of.bearing, "inner"))
        return terms._replace(seat=seat(terms, of)._replace(inner_curves=law.curves(spalls, away)), facing=facing)

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`inner_loads`, `flange_loads` [N], shape (rollers,)."""
        return on_the_inner_ring(rest, terms)


@dataclasses.dataclass(frozen=True)
class Flange(Effect):
    """The flange of the inner ring, against which the raceways wedge the rollers' large ends.

    Attributes:
      compliance: "rigid" (default) or "hertz": ball on plane.
      end_radius: radius of the rollers' spherical large ends [mm], 0.1…5000; needed for "hertz".
    """

    key = "flange"

    compliance: Literal["rigid", "hertz"] = dataclasses.field(default="rigid", metadata={"static": True})
    end_radius: Diameter | None = None

    def check(self, bearing: TaperedBearing, load: Load) -> None:
        """A radius to be soft by."""
        if self.compliance == "hertz" and self.end_radius is None:
            raise ValueError("effects.flange.end_radius is missing: compliance = 'hertz' needs it; give a number in mm")

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """A flange that gives way, if asked."""
        if self.end_radius is None or self.compliance == "rigid":
            return terms._replace(seat=seat(terms, of))
        modulus = geometry.contact_modulus(of.bearing.modulus, of.bearing.poisson)
        soft = (9.0 / (16.0 * self.end_radius * modulus**2)) ** (1.0 / 3.0)  # Johnson 1985, eq. (4.23)
        return terms._replace(seat=seat(terms, of)._replace(flange_compliance=soft))

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`inner_loads`, `flange_loads` [N], shape (rollers,); `flange_angle` of the force from the axis [rad]."""
        return {**on_the_inner_ring(rest, terms), "flange_angle": jnp.asarray(seat(terms, of).flange)}


def cage_share(bearing: TaperedBearing) -> jax.Array:
    """How far the cage turns in one turn of the inner ring, the outer one at rest, 0…0.5."""
    inner, outer = jnp.sin(bearing.inner_angle), jnp.sin(bearing.outer_angle)
    return inner / (inner + outer)  # rolling without slip on both raceways


@dataclasses.dataclass(frozen=True)
class Centrifugal(Effect):
    """Centrifugal force on the rollers: outer loads stay, inner ones fall and flange loads rise at a given axial load;
    at a given axial position outer loads rise.

    Attributes:
      speed_rpm: of the inner ring, the outer one at rest [rev/min], 0…1e5.
      control: "force" (default): the axial load is given. "position": the rings keep the axial position that they have
        under it at rest.
      convention: "balance" (default): every roller is at rest between outer raceway, inner raceway and flange (Liu et
        al. 2022, eq. 5). "printed": the forces are added to the ring's, as in Liu et al. 2018, eq. (5); they cancel.
    """

    key = "centrifugal"
    presses = True

    speed_rpm: Annotated[Real, Interval(ge=0.0, le=1e5), Unit("rev/min")]
    control: Literal["force", "position"] = dataclasses.field(default="force", metadata={"static": True})
    convention: Literal["balance", "printed"] = dataclasses.field(default="balance", metadata={"static": True})

    def force(self, bearing: TaperedBearing) -> jax.Array:
        """On one roller [N]."""
        turning = self.speed_rpm * jnp.pi / 30.0
        cage = turning * cage_share(bearing)
        metres = 1e-3 * geometry.pitch_radius(bearing)
        return jnp.asarray(geometry.roller_mass(bearing) * metres * cage**2)

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """Rollers thrown outwards; the ring held where it is at rest if asked."""
        if self.control == "position" and terms.axial is None:
            rest = of.equilibrium(terms)
            terms = terms._replace(axial=rest.displacement[2], known=rest.status_code)
        if self.convention == "printed":
            rows = 1 if terms.pair is None else 2
            thrown = (
                rows * self.force(of.bearing) * jnp.stack([jnp.sum(jnp.cos(of.angles)), jnp.sum(jnp.sin(of.angles))])
            )
            return terms._replace(extra=-jnp.append(thrown, 0.0))  # Liu et al. 2018, eq. (5)
        return terms._replace(seat=seat(terms, of)._replace(centrifugal=self.force(of.bearing)))

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`centrifugal_force` on one roller [N]; loads of inner ring and flange unless "printed"."""
        return {
            **on_the_inner_ring(rest, terms),
            "centrifugal_force": self.force(of.bearing),
            **held_by(rest, terms, of),
        }


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
    presses = True

    preload: Length = 0.0
    shaft_interference: Length = 0.0
    housing_interference: Length = 0.0
    bore: Diameter | None = None
    outside: Diameter | None = None
    shaft_bore: Annotated[Real, Interval(ge=0.0, le=5000.0), Unit("mm")] = 0.0
    housing_outside: Diameter | None = None
    warmer: Annotated[Real, Interval(ge=-500.0, le=500.0), Unit("K")] = 0.0
    expansion: Annotated[Real, Interval(ge=0.0, le=1e-3), Unit("1/K")] = 1.25e-5

    def check(self, bearing: TaperedBearing, load: Load) -> None:
        """Diameters to fit by, and no axial load beside the position."""
        for fit, size in (("shaft_interference", "bore"), ("housing_interference", "outside")):
            if is_given(getattr(self, fit)) and getattr(self, size) is None:
                raise ValueError(f"effects.mounting.{size} is missing: {fit} needs it; give a number in mm")
        if is_given(load.axial):
            raise ValueError(
                "load.axial must be 0 with effects.mounting, which holds the rings at a position: the axial force is "
                "what comes out; set it to 0"
            )

    def tightened(self, bearing: TaperedBearing) -> Real:
        """What inner raceway and rollers grow into the outer raceway by, in diameter [mm]: fits and warmth."""
        outer = 2.0 * geometry.outer_raceway_radius(bearing)
        inner = outer * jnp.sin(bearing.inner_angle) / jnp.sin(bearing.outer_angle)
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
        normal = 0.5 * self.tightened(of.bearing) * jnp.cos(of.bearing.outer_angle)
        return thicker(terms, normal)._replace(axial=jnp.asarray(self.preload, float))

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`axial_force` that holds the rings [N]; `tightened`: growth of inner raceway and rollers [mm]."""
        return {**held_by(rest, terms, of), "tightened": jnp.asarray(self.tightened(of.bearing), float)}


@dataclasses.dataclass(frozen=True)
class Diameters(Effect):
    """Rollers of different diameters (Liu et al. 2022).

    Attributes:
      deviations: of every roller's diameter from the nominal [mm], −1…1, as many as there are rollers.
    """

    key = "diameters"
    presses = True

    deviations: tuple[Length, ...]

    def check(self, bearing: TaperedBearing, load: Load) -> None:
        """One for every roller."""
        if len(self.deviations) != bearing.rollers:
            raise ValueError(
                f"effects.diameters.deviations has {len(self.deviations)} entries for {bearing.rollers} rollers; give "
                "one for each"
            )

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """Added to the rollers' approach."""
        more = jnp.stack([jnp.asarray(deviation, float) for deviation in self.deviations])
        return thicker(terms, more if terms.pair is None else jnp.concatenate([more, jnp.zeros_like(more)]))


@dataclasses.dataclass(frozen=True)
class Through(Effect):
    """Spalls on the outer raceway as long as the rollers, the assumption before Liu et al. 2018: a roller drops in and
    carries nothing until it meets the bottom. To compare with."""

    key = "through"


@dataclasses.dataclass(frozen=True)
class Tilt(Effect):
    """Rings that tilt, rollers loaded unevenly along their length: five degrees of freedom, stiffness 5 × 5.

    Rollers are cut into slices by ISO/TS 16281 (see `slices`), both contacts together; the scene's law is then
    "palmgren", of which only the start is used. Slices beside a spall do not help those over it: of 32008J under
    9000/4500 N a spall of 8 × 7 mm takes 9.7 % of the radial stiffness, of 4 × 7 mm 4.4 %, where contacts solved
    exactly on both raceways (law "table", effect `Raceways`) lose 4.3 % and 1.5 %. `Solution.remarks` says so.

    Attributes:
      moment_radial, moment_lateral: about the radial and the lateral axis [N mm], −1e9…1e9. Default 0.
      reach: how far the tilting centre lies along the rollers from the middle of the contacts, towards their small
        ends [mm], −1000…1000. Default 0: where the contacts' normals meet the axis, the bearing's load centre. With
        `DoubleRow` it is the middle between the rows, and moments add to that effect's.
      slices: of every roller, 1…200. Default 30, which ISO/TS 16281 asks for at least.
      rings: "free" to tilt (default), or "parallel": three degrees of freedom, slices alone.
    """

    key = "tilt"
    excludes = dict.fromkeys(("raceways", "flange", "centrifugal", "through"), "slices hold both contacts together")

    moment_radial: Moment = 0.0
    moment_lateral: Moment = 0.0
    reach: Annotated[Real, Interval(ge=-1000.0, le=1000.0), Unit("mm")] = 0.0
    slices: Annotated[int, Interval(ge=1, le=200)] = dataclasses.field(default=30, metadata={"static": True})
    rings: Literal["free", "parallel"] = dataclasses.field(default="free", metadata={"static": True})

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """Rollers in slices."""
        outer = ring.spalls_on(of.spalls, "outer")
        terms = terms._replace(slices=slices.sliced(of.contact, outer, of.distances("outer", terms), self.slices))
        if self.rings == "parallel":
            return terms
        if terms.pair is None or terms.pair.reach is None or terms.tilting is None:
            return terms._replace(tilting=self.of_one_row(of.bearing, of.contact, self.reach))
        levers, moments = self.of_one_row(of.bearing, of.contact, terms.pair.reach)
        moments = moments + terms.tilting.moments
        return terms._replace(tilting=Tilting(jnp.concatenate([levers, -levers]), moments))

    def of_one_row(self, bearing: TaperedBearing, contact: LineContact, reach: Real) -> Tilting:
        """What the tilt does to the slices of one row about a centre at `reach` [mm]."""
        moments = jnp.stack([jnp.asarray(m, float) for m in (self.moment_radial, self.moment_lateral)])
        return Tilting(jnp.tile(slices.places(contact, self.slices) + reach, bearing.rollers), moments)

    def remarks(self, spalls: tuple[Spall, ...]) -> tuple[str, ...]:
        """That spalls are cut hard."""
        return (HARD_SLICES,) if ring.spalls_on(spalls, "outer") else ()


@dataclasses.dataclass(frozen=True)
class Life(Effect):
    """Rating life: basic, of a catalogue's load rating (ISO 281), and reference, of the loads of every roller
    (ISO/TS 16281). With phase "mean" the mean of lives.

    Attributes:
      load_rating: basic dynamic load rating C [N], 1…1e9, with `DoubleRow` the pair's. Default: by ISO 281 from the
        bearing's numbers.
    """

    key = "life"

    load_rating: Annotated[Real, Interval(ge=1.0, le=1e9), Unit("N")] | None = None

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`load_rating` [N] of all rows, `basic_life`, `reference_life` [million revolutions]."""
        rows = 1 if terms.pair is None else 2
        rating = life.load_rating(of.bearing, rows)
        rating = rating if self.load_rating is None else jnp.asarray(self.load_rating, float)
        axial = of.load.axial if terms.axial is None else held_by(rest, terms, of)["axial_force"]
        outer = rest.loads if rest.second_loads is None else jnp.stack([rest.loads, rest.second_loads])
        inner = outer if terms.seat is None else roller_balance.inner_load(terms.seat, outer)
        return {
            "load_rating": rating,
            "basic_life": life.basic(of.bearing, rating, of.load.radial, axial, rows),
            "reference_life": life.reference(of.bearing, rating, inner, outer),
        }


EFFECTS: tuple[type[Effect], ...] = (
    DoubleRow, Raceways, Flange, Diameters, Mounting, Centrifugal, Through, Tilt, Life,
)  # fmt: skip
"""All there are, in the order in which they act."""

for _cls in (*EFFECTS, SeriesRaceways):
    pytrees.register(_cls)


def in_order(effects: Any) -> tuple[Effect, ...]:
    """The effects, or the only one, in the order in which they act. Raises `SceneError` for what is none, one named
    twice, or two that exclude each other."""
    if isinstance(effects, Effect):
        effects = (effects,)
    for i, effect in enumerate(effects):
        if not isinstance(effect, Effect):
            raise SceneError(f"effects.{i} = {shown(effect)}: must be one of difftrb.effects, say Life()")
    keys = [effect.key for effect in effects]
    for effect in effects:
        if keys.count(effect.key) > 1:
            raise SceneError(f"effects.{effect.key} is named twice; name it once")
        for key in effect.excludes:
            if key in keys:
                raise SceneError(
                    f"effects.{effect.key} and effects.{key} exclude each other: {effect.excludes[key]}; name one"
                )
    order = [kind.key for kind in EFFECTS]
    return tuple(sorted(effects, key=lambda effect: order.index(effect.key)))


def remarks(effects: tuple[Effect, ...], spalls: tuple[Spall, ...]) -> tuple[str, ...]:
    """What all effects have to say of results over these spalls, in sentences."""
    return tuple(sentence for effect in effects for sentence in effect.remarks(spalls))


def terms(effects: tuple[Effect, ...], of: Ring) -> Terms:
    """What all effects add to the ring's equilibrium."""
    total = ring.PLAIN
    for effect in effects:
        total = effect.terms(total, of)
    return total


def results(effects: tuple[Effect, ...], rest: Equilibrium, total: Terms, of: Ring) -> Results:
    """What all effects add to the solution."""
    found: Results = {}
    for effect in effects:
        found |= effect.results(rest, total, of)
    return found
