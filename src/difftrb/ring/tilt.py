"""Rings that tilt against each other: rollers in slices.

Slices follow ISO/TS 16281: q = (c/n) (δ − x ψ − 2P(x))^(10/9) at x along the roller, ψ the tilt in the roller's plane
and P the profile. Each carries by its own approach; one over a spall by the part of it that has land beneath.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval, Unit

from difftrb.contact import crown, gap
from difftrb.contact.contact_solution import is_given
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Real, Spall, TaperedBearing
from difftrb.core.status import SceneError
from difftrb.law import load_curve, tilt_energy
from difftrb.law.base import AUTO, Law
from difftrb.law.direct_states import DirectByStates
from difftrb.law.roller_curves import RollerCurves, spalls_under
from difftrb.ring import newton, roller_balance, roller_places
from difftrb.ring.double_row import DoubleRow, Moment
from difftrb.ring.effect_base import Asked, Effect, Results, Ring, Stage, among, register
from difftrb.ring.ring import Equilibrium
from difftrb.ring.roller_balance import Seat
from difftrb.ring.terms import LEAST, InnerRaceway, Terms, Tilting

HARD_SLICES = (
    "effects.tilt: slices beside a spall do not help those over it, so its loss of stiffness is overstated, two to "
    "three times where it was compared with contacts solved exactly"
)
ROUGH_MEANS = (
    "effects.tilt: where the load zone ends every slice has a kink of its own, which the mean over phases does not "
    "know: radial and axial stiffness are right to 4e-4, lateral to 1e-3, against tilt to 2.5e-3, derivatives by "
    "loads, moments and angles to tens of per cent or not at all; take them at single phases, and their mean"
)


def places(contact: LineContact, count: int) -> Any:
    """Middles of `count` slices along the roller from its own middle [mm], shape (count,)."""
    return contact.length * ((np.arange(count) + 0.5) / count - 0.5)


def sliced(contact: LineContact, spalls: tuple[Spall, ...], distances: Any, count: int) -> RollerCurves:
    """What every slice carries of rollers at `distances` [mm] from `spalls`, shape (spalls, …, rollers), in `count`
    slices each; shape (…, rollers · slices), roller by roller."""
    at = places(contact, count)
    stiffness = gap.lamina_stiffness(contact.length) / count  # ISO/TS 16281:2008, eq. (38)
    land = xp.stack([np.ones(count), *(1.0 - _covered(contact, spall, at) for spall in spalls)])
    under = spalls_under(spalls, distances)
    kinds = np.arange(1 + len(spalls)).reshape(*[1] * under.ndim, -1)
    left = xp.einsum("...k,ks->...s", (under[..., None] == kinds) * 1.0, land)  # no gather: slow in a batch
    K = (stiffness * xp.maximum(left, LEAST)).reshape(*under.shape[:-1], -1)
    slices = load_curve.power(K, gap.LOAD_EXPONENT * xp.ones_like(K))
    profile = xp.ones_like(left) * newton.aligned(2.0 * crown.height(at, contact), left)  # both raceways
    return RollerCurves(dataclasses.replace(slices, shift=profile.reshape(*under.shape[:-1], -1)))


def _covered(contact: LineContact, spall: Spall, places: Any) -> Any:
    """What part of every slice a spall takes the land from, 0…1."""
    half = 0.5 * contact.length / places.size
    begins, ends = spall.ends
    low = xp.maximum(places - half, begins)
    high = xp.minimum(places + half, ends)
    return xp.maximum(high - low, 0.0) / (2.0 * half)


def _beyond(seat: Seat, inner_raceway: InnerRaceway | None, loads: Any) -> tuple[Any, Any]:
    """What inner raceway and flange add to approach [mm] and moment [N mm] of rollers under `loads` [N] on the outer
    raceway, at the states of their laws."""
    approach, moment = roller_balance.flange_approach(seat, loads), 0.0
    if inner_raceway is None or not isinstance(inner_raceway.law, DirectByStates) or inner_raceway.law.states is None:
        return approach, moment
    inner = roller_balance.inner_load(seat, loads)
    more, moment = inner_raceway.law.leaning(inner_raceway.spalls, inner_raceway.distances, inner)
    return approach + more / seat.ratio, moment


@register
@dataclasses.dataclass(frozen=True)
class Tilt(Effect):
    """Rings that tilt, rollers loaded unevenly along their length: five degrees of freedom, stiffness 5 × 5.

    With law "direct", or "auto", every roller that carries gets contacts solved around its load and its tilt: force
    and moment of the outer contact, with whatever spalls are under it. With `Raceways` both contacts are solved, and
    the roller between them, at the tilt at which their moments balance. That takes numbers; prepare a scene before it
    is differentiated or batched.

    With law "palmgren" rollers are cut into slices by ISO/TS 16281, both contacts together; of the law only the start
    is used. Slices beside a spall do not help those over it: of 32008J under 9000/4500 N a spall of 8 × 7 mm takes
    9.7 % of the radial stiffness, of 4 × 7 mm 4.4 %, where contacts solved exactly on both raceways (law "table",
    effect `Raceways`) lose 4.3 % and 1.5 %. `Solution.remarks` says so.

    Attributes:
      moment_radial, moment_lateral: about the radial and the lateral axis [N mm], −1e9…1e9. Default 0.
      reach: how far the tilting centre lies along the rollers from the middle of the contacts, towards their small
        ends [mm], −1000…1000. Default 0: where the contacts' normals meet the axis, the bearing's load centre. With
        `DoubleRow` it is the middle between the rows, and moments add to that effect's.
      slices: of every roller with law "palmgren", 1…200. Default 30, which ISO/TS 16281 asks for at least.
      rings: "free" to tilt (default), or "parallel": three degrees of freedom, slices alone.
    """

    key = "tilt"
    label = "rings that tilt"
    stage = Stage.CONTACT
    presses = True
    units = {"roller_tilts": "mrad", "inner_tilts": "mrad"}  # noqa: RUF012
    excludes = {"through": "a roller over a spall as long as it is leaves no moment to tilt by"}  # noqa: RUF012

    moment_radial: Moment = 0.0
    moment_lateral: Moment = 0.0
    reach: Annotated[Real, Interval(ge=-1000.0, le=1000.0), Unit("mm")] = 0.0
    slices: Annotated[int, Interval(ge=1, le=200)] = dataclasses.field(default=30, metadata={"static": True})
    rings: Literal["free", "parallel"] = dataclasses.field(default="free", metadata={"static": True})

    def check(self, asked: Asked) -> None:
        """The law of slices, and a second row that tilts as this one does."""
        name = asked.law if isinstance(asked.law, str) else asked.law.name
        if name not in ("palmgren", "direct", AUTO):
            raise SceneError(
                f"effects.tilt: contact.law = {name!r} knows no tilted roller; set contact.law = 'palmgren' for slices "
                "of ISO/TS 16281 or, for one scene in numbers, 'auto' or 'direct' for contacts"
            )
        for effect in asked.effects:
            self._check_beside(effect, name)
        if self.rings == "parallel" and (is_given(self.moment_radial) or is_given(self.moment_lateral)):
            name = "moment_radial" if is_given(self.moment_radial) else "moment_lateral"
            raise SceneError(
                f"effects.tilt.{name} must be 0 with rings = 'parallel', which no moment tilts; leave it out"
            )
        row = among(asked.effects, DoubleRow)
        if row is None:
            if self.rings == "free" and self.slices < 2:
                raise SceneError(
                    "effects.tilt.slices = 1: one slice does not hold a tilt; give a whole number in 2 … 200"
                )
            return
        if is_given(self.reach):
            raise SceneError(
                "effects.tilt.reach must be 0 with effects.double_row, whose shaft tilts about the middle between its "
                "rows; leave it out"
            )
        if self.rings == "free" and row.spacing is None:
            raise SceneError(
                "effects.double_row.spacing is missing: effects.tilt needs it, or rings = 'parallel'; give one of both"
            )
        if self.rings == "parallel" and row.spacing is not None:
            raise SceneError(
                "effects.tilt.rings = 'parallel' and effects.double_row.spacing exclude each other: rings with a "
                "spacing tilt; leave one out"
            )

    @staticmethod
    def _check_beside(effect: Effect, law: str) -> None:
        """What holds rollers besides the outer raceway, as far as a roller that tilts can be held so."""
        if law == "palmgren" and effect.stage in (Stage.SEAT, Stage.SPEED):
            raise SceneError(
                f"effects.{effect.key}: slices of ISO/TS 16281 (effects.tilt with contact.law = 'palmgren') stand for "
                "both contacts together; set contact.law = 'auto'"
            )
        if getattr(effect, "rollers", "free") == "upright":
            raise SceneError(
                "effects.raceways.rollers = 'upright': rings that tilt (effects.tilt) turn their rollers; set it to "
                "'free'"
            )
        if effect.stage == Stage.SPEED and effect.holds_axially:
            raise SceneError(
                f"effects.{effect.key}.control = 'position': rings that tilt (effects.tilt) are not held where they "
                "are at rest; set it to 'force'"
            )

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """Rollers in slices."""
        outer, away = roller_places.spalls_on(of.spalls, "outer"), of.distances("outer", terms)
        if isinstance(of.law, DirectByStates):
            seat = terms.seat
            beyond = None if seat is None else partial(_beyond, seat, terms.inner_raceway)
            slices = of.law.slices(outer, away, beyond, 0.0 if seat is None else seat.least_outer_load)
            at = tilt_energy.points(xp.fixed(of.contact.length))
        else:
            slices, at = sliced(of.contact, outer, away, self.slices), self.places(of.contact)
        terms = terms._replace(slices=slices)
        if self.rings == "parallel":
            return terms
        if terms.pair is None or terms.pair.reach is None or terms.tilting is None:
            return terms._replace(tilting=self.of_one_row(of.bearing, at, self.reach))
        levers, moments = self.of_one_row(of.bearing, at, terms.pair.reach)
        moments = moments + terms.tilting.moments
        return terms._replace(tilting=Tilting(xp.concatenate([levers, -levers]), moments))

    def places(self, contact: LineContact) -> Any:
        """Middles of slices of ISO/TS 16281 along the roller [mm], shape (slices,)."""
        return places(contact, self.slices)

    def of_one_row(self, bearing: TaperedBearing, at: Any, reach: Real) -> Tilting:
        """What the tilt does to slices `at` places along the rollers [mm] of one row, about a centre at `reach`
        [mm]."""
        levers = at + reach
        every = xp.broadcast_to(levers[None], (bearing.rollers, *levers.shape)).reshape(-1)
        return Tilting(every, xp.stack([xp.asarray(m) for m in (self.moment_radial, self.moment_lateral)]))

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`roller_tilts` [mrad] against the outer raceway, as `contact.tilt`, and with both raceways in series
        `inner_tilts` against the inner one, shape (rollers,), without derivatives; of contacts, not of slices."""
        if not isinstance(of.law, DirectByStates):
            return {}
        turned = xp.zeros_like(rest.loads) if rest.tilts is None else -rest.tilts[..., : of.bearing.rollers]
        if not of.law.free_to_tilt:
            return {"roller_tilts": 1e3 * turned}
        turned, loads, law = xp.fixed((turned, rest.loads, of.law))
        own = law.roller_tilts(loads, turned)
        meets = xp.where(loads > 0.0, turned - own, 0.0)
        return {"roller_tilts": 1e3 * own, "inner_tilts": 1e3 * meets}

    def remarks(self, spalls: tuple[Spall, ...], law: Law | None, mean: bool) -> tuple[str, ...]:
        """That slices of ISO/TS 16281 are cut hard, and what their means are."""
        if isinstance(law, DirectByStates):
            return ()
        hard = (HARD_SLICES,) if roller_places.spalls_on(spalls, "outer") else ()
        return (ROUGH_MEANS, *hard) if mean else hard
