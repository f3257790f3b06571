"""What a catalogue prints of a bearing, and the relations between that and its inside.

ISO 281 ties e, Y and C to contact angle and rollers, ISO 76 Y0 and C0; the common apex ties the rollers' taper to
diameter, pitch and contact angle. What is left open are four ratios, which published bearings tell about: `RATIOS`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Interval, Unit

from difftrb.core import arrays as xp
from difftrb.core import fields, geometry
from difftrb.core.bearing_checks import Wrong, of_bearing
from difftrb.core.geometry import FILE_RULES, Real, TaperedBearing
from difftrb.core.status import SceneError
from difftrb.ring import life

CYLINDRICAL = math.radians(1.15)
"""Contact angle that stands for 0 [rad]: the ring's cones need an apex. Radial stiffness is 4e-4 off by it."""
LEAN = 1.0 / 3.0
"""How far the flange leans from a right angle with the inner raceway, by the roller's half cone angle: of 32008J (Liu
et al. 2018, Table 1). 0 touches rollers at the raceway, 1 at their axis."""
CROWN = 0.00035
"""Drop of ISO/TS 16281's roller profile, by the roller's diameter: 0.00035 D_w ln(1/(1 − (2x/l)²))."""

Size = Annotated[Real, Interval(ge=0.1, le=5000.0), Unit("mm")]
Rating = Annotated[Real, Interval(ge=1.0, le=1e9), Unit("N")]


@dataclasses.dataclass(frozen=True)
class Catalogue:
    """One line of a catalogue, and what else is known of the bearing.

    Attributes:
      d: bore [mm], 0.1…5000.
      D: outside diameter [mm], 0.1…5000.
      T: assembled width of both rings, not of one of them [mm], 0.1…5000.
      contact_angle_deg: of the outer raceway [°], 0…60; 0 is a cylindrical roller bearing. One of this, e, Y
        and Y0 is needed.
      e: limit of F_a/F_r [-], 1.5 tan α.
      Y: axial factor [-], 0.4 cot α.
      Y0: static axial factor [-], 0.22 cot α.
      B: width of the inner ring [mm], 0.1…5000; nothing hangs on it.
      C: basic dynamic load rating [N], 1…1e9; not the width of the cup, which some catalogues call C, too.
      C0: basic static load rating [N], 1…1e9.
      rollers: their number [-], 3…400.
      pitch_diameter: of the circle of their middles [mm].
      roller_diameter: at mid length [mm].
      roller_small_diameter, roller_large_diameter: at their ends, both, in place of roller_diameter [mm].
      roller_length: effective, along the generator [mm].
      modulus, poisson, density: as of `TaperedBearing`.
    """

    __pydantic_config__ = FILE_RULES

    d: Size
    D: Size
    T: Size
    contact_angle_deg: Annotated[Real, Interval(ge=0.0, le=60.0), Unit("°")] | None = None
    e: Annotated[Real, Interval(ge=0.01, le=2.6)] | None = None
    Y: Annotated[Real, Interval(ge=0.2, le=12.0)] | None = None
    Y0: Annotated[Real, Interval(ge=0.1, le=7.0)] | None = None
    B: Size | None = None
    C: Rating | None = None
    C0: Rating | None = None
    rollers: Annotated[int, Interval(ge=3, le=400)] | None = None
    pitch_diameter: Size | None = None
    roller_diameter: Size | None = None
    roller_small_diameter: Size | None = None
    roller_large_diameter: Size | None = None
    roller_length: Size | None = None
    modulus: Annotated[Real, Interval(ge=1e3, le=1e6), Unit("N/mm²")] = 2.1e5
    poisson: Annotated[Real, Interval(ge=0.0, le=0.5)] = 0.278
    density: Annotated[Real, Interval(ge=1e-7, le=1e-4), Unit("kg/mm³")] = 7.85e-6

    @property
    def mean_diameter(self) -> float | None:
        """Of the rollers at mid length [mm], if it is known."""
        if self.roller_small_diameter is None or self.roller_large_diameter is None:
            return self.roller_diameter
        return 0.5 * (self.roller_small_diameter + self.roller_large_diameter)


class Ratio(NamedTuple):
    """A ratio of tapered roller bearings: its mean, and the relative standard deviation from bearing to bearing."""

    mean: float
    spread: float


RATIOS = {
    "pitch": Ratio(1.0, 0.015),
    "diameter": Ratio(0.51, 0.10),
    "length": Ratio(0.68, 0.055),
    "fill": Ratio(0.86, 0.055),
}
"""Pitch diameter by the mean of d and D; roller diameter by (D − d)/2; effective length by T; and what part of the
pitch circle the rollers' diameters fill. Of 32008J (Liu et al. 2018, Table 1): 1.007, 0.463, 0.719, 0.874; of 32208
(Wingertszahn et al. 2023, Lubricants 11, 369, Table A2): 1.000, 0.500, 0.687, 0.902; of 32216 (the same, Table 4):
0.986, 0.567, 0.644, 0.798."""
RATING = 0.12
"""Relative standard deviation of a maker's C and C0 from ISO 281 and ISO 76; C0 of 32208 and 32216: −10 and +17 %."""
TAPER = 0.02
"""Of a taper given by two diameters, which are rounded."""
CROWN_SPREAD = 0.5 * math.log(2.0)
"""Standard deviation of ln Q_d, which nothing tells: a factor of 2 either way at k = 2."""
LEAN_SPREAD = 0.25
"""Of `Inside.lean`: the flange touches rollers between the raceway and their axis."""
ALIKE = 4.0
"""Standard deviations that two things given of one bearing may be apart."""


# ------------------------------------------------------------------------------------------------ geometry


class Inside(NamedTuple):
    """What a tapered roller bearing is made from: sizes [mm], the number of rollers, the contact angle [rad], and the
    flange's lean (`LEAN`)."""

    pitch_diameter: Real
    roller_diameter: Real
    roller_length: Real
    rollers: Any
    contact_angle: Real
    lean: Real = LEAN


def tapered(inside: Inside, modulus: Real = 2.1e5, poisson: Real = 0.278, density: Real = 7.85e-6) -> TaperedBearing:
    """The bearing with all cones on one apex. Differentiable by every number."""
    gamma = roller_angle(inside.roller_diameter / inside.pitch_diameter, inside.contact_angle)
    half = 0.5 * inside.roller_length * xp.tan(gamma)
    return TaperedBearing(
        roller_small_diameter=inside.roller_diameter - 2.0 * half,
        roller_large_diameter=inside.roller_diameter + 2.0 * half,
        roller_length=inside.roller_length,
        rollers=inside.rollers,
        outer_angle=inside.contact_angle,
        inner_angle=inside.contact_angle - 2.0 * gamma,
        roller_angle=gamma,
        flange_angle=0.5 * np.pi - inside.lean * gamma,
        modulus=modulus,
        poisson=poisson,
        density=density,
    )


def roller_angle(ratio: Real, contact_angle: Real) -> Real:
    """Half cone angle γ of rollers that share an apex with the raceways [rad]: tan γ = (D_w/D_pw) sin(α − γ).

    `ratio` is D_w/D_pw, below 0.5, where every round leaves less than half of the error.
    """
    gamma = ratio * contact_angle / (1.0 + ratio)
    for _ in range(24):
        gamma = xp.arctan(ratio * xp.sin(contact_angle - gamma))
    return gamma


def crown(bearing: TaperedBearing) -> Real:
    """Design load Q_d of a roller with ISO/TS 16281's profile [N]: that of a crown 0.00035 D_w deep."""
    modulus = geometry.contact_modulus(bearing.modulus, bearing.poisson)
    return CROWN * 2.0 * geometry.mean_roller_radius(bearing) * np.pi * modulus * bearing.roller_length


def check_rings(known: Catalogue, bearing: TaperedBearing) -> Wrong | None:
    """Why these rollers have no place between bore and outside, if they have none."""
    if bearing.roller_small_diameter <= 0.0 or bearing.inner_angle <= 0.0:
        return Wrong(
            "roller_length",
            f"bearing.roller_length = {bearing.roller_length:g}: rollers of this taper end at the common apex before "
            "their small end: there is no such bearing; use shorter ones or a smaller contact angle",
        )
    if (wrong := of_bearing(bearing)) is not None:
        return wrong
    width = bearing.roller_length * math.cos(geometry.roller_axis_angle(bearing))
    if width > known.T:
        long = f"bearing.roller_length = {bearing.roller_length:g}: must be less than the bearing's T = {known.T:g} mm"
        return Wrong("roller_length", long)
    at, half = geometry.slant_distance(bearing), 0.5 * bearing.roller_length
    inner, outer = 2.0 * (at - half) * math.sin(bearing.inner_angle), 2.0 * (at + half) * math.sin(bearing.outer_angle)
    if inner > known.d and outer < known.D:
        return None
    return Wrong(
        "roller_diameter",
        f"bearing.roller_diameter = {2.0 * geometry.mean_roller_radius(bearing):.4g} on pitch_diameter = "
        f"{2.0 * geometry.pitch_radius(bearing):.4g} mm: raceways of {inner:.4g} … {outer:.4g} mm leave no rings "
        f"between d = {known.d:g} and D = {known.D:g} mm",
    )


# ------------------------------------------------------------------------------------------------ what is given


class GivenValue(NamedTuple):
    """Something given of a bearing: `relation(inside)` is what it would be, `value` what was given, `spread` the
    standard deviation of the logarithm of their ratio."""

    key: str
    relation: Any
    value: float
    spread: float


def given(known: Catalogue) -> Iterator[GivenValue]:
    """All that a catalogue tells of the inside, exact sizes included."""
    exact = {"pitch_diameter": known.pitch_diameter, "roller_diameter": known.mean_diameter,
             "roller_length": known.roller_length, "rollers": known.rollers}  # fmt: skip
    for key, value in exact.items():
        if value is not None:
            yield GivenValue(key, lambda inside, key=key: getattr(inside, key), value, 1e-7)
    for key, value, rating in (("C", known.C, life.load_rating), ("C0", known.C0, life.static_rating)):
        if value is not None:
            yield GivenValue(key, lambda inside, rating=rating: rating(tapered(inside)), value, RATING)
    if known.roller_small_diameter is not None and known.roller_large_diameter is not None:
        taper = known.roller_large_diameter - known.roller_small_diameter

        def opening(inside: Inside) -> Real:
            bearing = tapered(inside)
            return bearing.roller_large_diameter - bearing.roller_small_diameter

        yield GivenValue("roller_large_diameter", opening, taper, TAPER)


def contact_angle(known: Catalogue) -> tuple[float, float]:
    """The contact angle [rad], and how exactly its tangent is given (relative standard deviation).

    Raises `SceneError` if nothing tells it, or two things tell different ones.
    """
    tangents = {}
    if known.contact_angle_deg is not None:
        angle = math.radians(known.contact_angle_deg) or CYLINDRICAL
        if angle < CYLINDRICAL:
            raise SceneError(
                f"bearing.contact_angle_deg = {known.contact_angle_deg:g}: must be 0, for cylindrical rollers, or in "
                f"{math.degrees(CYLINDRICAL):g} … 60 °; if it is in radians, it is "
                f"{math.degrees(known.contact_angle_deg):.4g} °"
            )
        tangents["contact_angle_deg"] = math.tan(angle), 1e-3
    if known.e is not None:  # printed to 0.01
        tangents["e"] = known.e / 1.5, 0.005 / math.sqrt(3.0) / known.e  # ISO 281
    if known.Y is not None:  # printed to 0.1, mostly
        tangents["Y"] = 0.4 / known.Y, 0.05 / math.sqrt(3.0) / known.Y  # ISO 281
    if known.Y0 is not None:
        tangents["Y0"] = 0.22 / known.Y0, 0.05 / math.sqrt(3.0) / known.Y0  # ISO 76
    if not tangents:
        raise SceneError("bearing.e is missing: give e or Y, which catalogues print, or contact_angle_deg")
    names, (first, *others) = list(tangents), tangents.values()
    for name, (tangent, spread) in zip(names[1:], others, strict=True):
        if abs(math.log(tangent / first[0])) > ALIKE * math.hypot(spread, first[1]):
            was, now = (math.degrees(math.atan(each)) for each in (first[0], tangent))
            raise SceneError(
                f"bearing.{name} = {getattr(known, name):g}: means a contact angle of {now:.1f}°, where "
                f"{names[0]} = {getattr(known, names[0]):g} means {was:.1f}°; leave the wrong one out"
            )
    tangent, spread = min(tangents.values(), key=lambda each: each[1])
    return math.atan(tangent), spread


def prior(known: Catalogue) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the ratios and of tan α, and their standard deviations, before sizes and ratings are given."""
    angle, exactly = contact_angle(known)
    means = [*(math.log(ratio.mean) for ratio in RATIOS.values()), math.log(math.tan(angle))]
    return np.array(means), np.array([*(ratio.spread for ratio in RATIOS.values()), exactly])


def check(known: Catalogue) -> None:
    """Raise `SceneError` for numbers that are out of their range, or cannot be together."""
    sentence = fields.wrong(known, "bearing")
    if sentence is None and known.d >= known.D:
        sentence = f"bearing.D = {known.D:g} must be larger than bearing.d = {known.d:g} mm"
    small, large = known.roller_small_diameter, known.roller_large_diameter
    if sentence is None and (small is None) != (large is None):
        missing = "small" if small is None else "large"
        sentence = f"bearing.roller_{missing}_diameter is missing: give both ends, or roller_diameter at mid length"
    if sentence is None and small is not None and large is not None and large <= small:
        sentence = f"bearing.roller_large_diameter = {large:g} must be larger than roller_small_diameter = {small:g} mm"
    if sentence is None and small is not None and known.roller_diameter is not None:
        sentence = "bearing.roller_diameter: is given by roller_small_diameter and roller_large_diameter; leave it out"
    if sentence is not None:
        raise SceneError(sentence)
