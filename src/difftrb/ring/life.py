"""Rating life of a tapered roller bearing: ISO 281 from its size and load, ISO/TS 16281 from every roller's load."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

from annotated_types import Interval, Unit

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.core.geometry import Real, TaperedBearing
from difftrb.ring import roller_balance
from difftrb.ring.effect_base import Effect, Results, Ring, Stage, register
from difftrb.ring.ring import Equilibrium, axial_force
from difftrb.ring.terms import Terms

QUALITY = 1.1
"""b_m of tapered roller bearings of today's steel (ISO 281)."""


def gamma(bearing: TaperedBearing) -> Any:
    """D_we cosα/D_pw."""
    return geometry.mean_roller_radius(bearing) * xp.cos(bearing.outer_angle) / geometry.pitch_radius(bearing)


def load_factor(ratio: Real) -> Any:
    """f_c of radial roller bearings by D_we cosα/D_pw, 0.01…0.3: the formula behind the table of ISO 281."""
    raceways = (1.0 + (1.04 * _slower(ratio)) ** 4.5) ** (-2.0 / 9.0)
    size = ratio ** (2.0 / 9.0) * (1.0 - ratio) ** (29.0 / 27.0) / (1.0 + ratio) ** 0.25
    return 0.83 * 207.9 * size * raceways  # ISO/TR 1281-1, λν = 0.83


def load_rating(bearing: TaperedBearing, rows: int = 1) -> Any:
    """Basic dynamic load rating C of a bearing of one row, or of two [N]."""
    diameter = 2.0 * geometry.mean_roller_radius(bearing)
    length = rows * bearing.roller_length * xp.cos(bearing.outer_angle)
    f_c = load_factor(gamma(bearing))
    return QUALITY * f_c * length ** (7 / 9) * bearing.rollers**0.75 * diameter ** (29 / 27)  # ISO 281


def static_rating(bearing: TaperedBearing) -> Any:
    """Basic static load rating C0 of a bearing of one row [N]."""
    projected = 2.0 * geometry.mean_roller_radius(bearing) * xp.cos(bearing.outer_angle)
    return 44.0 * (1.0 - gamma(bearing)) * bearing.rollers * bearing.roller_length * projected  # ISO 76


def equivalent_load(bearing: TaperedBearing, radial: Real, axial: Real, rows: int = 1) -> Any:
    """Dynamic equivalent radial load P [N] of one row, or of two back to back or face to face."""
    tan, axial = xp.tan(bearing.outer_angle), xp.magnitude(axial) if rows == 2 else axial
    light = axial <= 1.5 * tan * radial  # e, X and Y of ISO 281
    if rows == 2:
        return xp.where(light, radial + 0.45 / tan * axial, 0.67 * radial + 0.67 / tan * axial)
    return xp.where(light, radial, 0.4 * radial + 0.4 / tan * axial)


def basic(bearing: TaperedBearing, rating: Real, radial: Real, axial: Real, rows: int = 1) -> Any:
    """Basic rating life L10 [million revolutions]; `rating` is that of all rows."""
    return (rating / equivalent_load(bearing, radial, axial, rows)) ** (10.0 / 3.0)  # ISO 281


def reference(bearing: TaperedBearing, rating: Real, inner_loads: Any, outer_loads: Any, rows: int = 1) -> Any:
    """Basic reference rating life L10r [million revolutions], inner ring turning, from what every roller presses on
    inner and outer raceway [N], shape (…, rollers), of two rows (…, 2, rollers), evenly along its length; `rating` is
    that of all rows. Neither the stress at the rollers' ends is counted, nor what raceways are rated more for then
    (1/λν): under a radial load that half of the rollers share that is about (C/P)⁴."""
    slower = (1.038 * _slower(gamma(bearing))) ** 4.5
    each = rating / (bearing.rollers * xp.cos(bearing.outer_angle) * rows ** (7.0 / 9.0))
    inner_rating = each / 0.378 * (1.0 + slower) ** (2.0 / 9.0)  # ISO/TS 16281
    outer_rating = each / 0.364 * (1.0 + 1.0 / slower) ** (2.0 / 9.0)  # ISO/TS 16281
    inner = _mean(inner_loads, 4.0) / inner_rating
    outer = _mean(outer_loads, 4.5) / outer_rating
    worn = inner**4.5 + outer**4.5
    # ISO/TS 16281: rows live as raceways do, all or none
    return (worn if rows == 1 else xp.total(worn)) ** (-8.0 / 9.0)


def _mean(loads: Any, power: float) -> Any:
    """Over the rollers of every row, shape (…)."""
    top = xp.module_of(loads).max(xp.fixed(loads), axis=-1)
    top = xp.where(top > 0.0, top, 1.0)  # a row may carry nothing
    mean = xp.total((loads / top[..., None]) ** power) / loads.shape[-1]
    some = mean > 0.0
    return top * xp.where(some, xp.where(some, mean, 1.0) ** (1.0 / power), 0.0)


def _slower(ratio: Real) -> Real:
    return ((1.0 - ratio) / (1.0 + ratio)) ** (143.0 / 108.0)


def _of_rows(of: Ring, rating: Real, loads: Any) -> Any:
    """Basic rating life [million revolutions] of two rows by what each of them carries, shape (…, 2, rollers): by
    `rating` of both a preload would not count."""
    alpha = of.bearing.outer_angle
    along, across = (xp.einsum("...ir,...r->...i", loads, function(of.angles)) for function in (xp.cos, xp.sin))
    square = along * along + across * across
    some = square > 0.0  # a row may carry nothing
    radial = xp.cos(alpha) * xp.where(some, xp.sqrt(xp.where(some, square, 1.0)), 0.0)
    axial = xp.sin(alpha) * xp.total(loads)
    worn = equivalent_load(of.bearing, radial, axial) * (2.0 ** (7.0 / 9.0) / rating)
    return xp.total(worn**3.75) ** (-8.0 / 9.0)  # ISO 281: rows live as raceways do, all or none


@register
@dataclasses.dataclass(frozen=True)
class Life(Effect):
    """Rating life: basic, of a catalogue's load rating (ISO 281), and reference, of the loads of every roller
    (ISO/TS 16281), which is taken as even along the roller. With phase "mean" the mean of lives. The basic one of two
    rows with a preload, which a catalogue's equivalent load does not know, is that of what each row carries: a tenth
    less, under a radial load, with the least preload than with none.

    Attributes:
      load_rating: basic dynamic load rating C [N], 1…1e9, with `DoubleRow` the pair's. Default: by ISO 281 from the
        bearing's numbers.
    """

    key = "life"
    label = "rating life"
    stage = Stage.OUTCOME
    units = {  # noqa: RUF012
        "load_rating": "N", "basic_life": "million revolutions", "reference_life": "million revolutions"
    }  # fmt: skip

    load_rating: Annotated[Real, Interval(ge=1.0, le=1e9), Unit("N")] | None = None

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """`load_rating` [N] of all rows, `basic_life`, `reference_life` [million revolutions]."""
        rows = 1 if terms.pair is None else 2
        rating = load_rating(of.bearing, rows)
        rating = xp.asarray(rating if self.load_rating is None else self.load_rating)
        axial = of.load.axial if terms.axial is None else axial_force(rest, of.bearing)
        loads, second = rest.loads, rest.second_loads
        outer = loads if second is None else xp.stack([loads, second], axis=loads.ndim - 1)
        life = xp.asarray(basic(of.bearing, rating, of.load.radial, axial, rows))
        if terms.pair is not None:
            life = xp.where(terms.pair.preload > 0.0, _of_rows(of, rating, outer), life)
        inner = outer if terms.seat is None else roller_balance.inner_load(terms.seat, outer)
        return {
            "load_rating": rating,
            "basic_life": life,
            "reference_life": reference(of.bearing, rating, inner, outer, rows),
        }
