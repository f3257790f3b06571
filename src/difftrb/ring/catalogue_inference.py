"""A bearing's inside from one line of a catalogue, with the uncertainty of all that was not printed.

The logarithms of four ratios and of the contact angle's tangent are Gaussian as published bearings scatter, and are
conditioned on what is given (`catalogue_relations.given`): the most likely inside by Gauss and Newton, its covariance
from the same linearisation. The number of rollers is then rounded, and all else moved to where that makes it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from difftrb.core.geometry import TaperedBearing
from difftrb.core.input_errors import did_you_mean
from difftrb.core.status import SceneError
from difftrb.ring import catalogue_relations
from difftrb.ring.catalogue_relations import (  # fmt: skip
    ALIKE,
    CROWN_SPREAD,
    LEAN,
    LEAN_SPREAD,
    Catalogue,
    GivenValue,
    Inside,
    tapered,
)

COVERED = 2.0
"""Coverage factor k of all uncertainties that are given: about 95 of 100 (GUM)."""
ROUNDS = 12
STEP = 1e-5
RATINGS = "C", "C0"
OTHER_UNIT = 8.0
"""Load ratings farther from those of bearings of this size, by this factor, are none of these."""

Function = Callable[[TaperedBearing, float], Any]
"""Of a bearing and its rollers' design load [N]."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A value [unit] and its expanded uncertainty (k = 2); 0 for what was given."""

    value: float
    uncertainty: float
    unit: str

    @property
    def given(self) -> bool:
        """Whether it was given, and not estimated."""
        return self.uncertainty == 0.0

    def __str__(self) -> str:
        if self.given:
            return f"{self.value:.5g} {self.unit}".rstrip()
        if not self.unit:  # a number of rollers
            return f"{self.value:.0f} ± {math.ceil(self.uncertainty)}"
        digits = max(0, 1 - math.floor(math.log10(self.uncertainty)))
        return f"{self.value:.{digits}f} ± {self.uncertainty:.{digits}f} {self.unit}".rstrip()


class _Belief(NamedTuple):
    """Logarithms of the ratios and of tan α, shape (5,), and a square root of their covariance, shape (5, n): columns
    are independent of each other, the last one along the number of rollers, if that is not given."""

    known: Catalogue
    mean: np.ndarray
    columns: np.ndarray
    rollers: int
    per_roller: np.ndarray | None


@dataclasses.dataclass(frozen=True)
class CatalogueBearing:
    """A bearing estimated from its catalogue line.

    Attributes:
      catalogue: what was given. bearing: for `Scene`. design_load: of ISO/TS 16281's crown [N], for `Scene`, too.
      estimates: by name, value and expanded uncertainty (k = 2) of the bearing's numbers, of pitch and mean roller
        diameter and of the design load; uncertainty 0 where the value was given.
    """

    catalogue: Catalogue
    bearing: TaperedBearing
    design_load: float
    estimates: dict[str, Estimate]
    belief: _Belief = dataclasses.field(repr=False)

    def uncertainty(self, function: Function) -> Any:
        """Expanded uncertainty (k = 2) of `function(bearing, design_load)`, a number or an array, by what is not known
        of the bearing. The function is asked some fourteen times, at one standard deviation either way along each
        independent direction; it need not be differentiable."""
        return _spread(self.belief, function)

    def __repr__(self) -> str:
        k = self.catalogue
        rows = (f"  {name:22s} {estimate}{' (given)' if estimate.given else ''}"
                for name, estimate in self.estimates.items())  # fmt: skip
        return "\n".join([f"CatalogueBearing {k.d:g} × {k.D:g} × {k.T:g} mm, ± at k = 2:", *rows])


def bearing_from_catalogue(
    d: float, D: float, T: float, contact_angle_deg: float | None = None, **known: Any
) -> CatalogueBearing:
    """A bearing estimated from what its catalogue prints.

    `d`, `D`, `T` [mm] and one of `contact_angle_deg` [°], `e`, `Y` and `Y0` are needed; whatever else is known makes
    it more certain: `C`, `C0` [N], `rollers`, `pitch_diameter`, `roller_diameter` (at mid length) or
    `roller_small_diameter` and `roller_large_diameter`, `roller_length` [mm], and `modulus`, `poisson`, `density`; see
    `Catalogue`.
    Contact angle 0 is a cylindrical roller bearing, for scenes with `effects.Mounting`, which holds the rings axially.
    In a scene file: `bearing = { d = 30, D = 62, T = 17.25, e = 0.37 }`.

    Sources: e = 1.5 tan α, Y = 0.4 cot α and C of ISO 281, Y0 = 0.22 cot α and C0 of ISO 76, all cones on one apex;
    what these leave open is as in published bearings (`catalogue_relations.RATIOS`). Takes plain numbers. Raises
    `SceneError`, one sentence, for what is out of range or cannot be together.
    """
    names = [field.name for field in dataclasses.fields(Catalogue)]
    if unknown := set(known) - set(names):
        raise SceneError(f"bearing.{min(unknown)} is not known; {did_you_mean(min(unknown), names)}")
    return estimated(Catalogue(d, D, T, contact_angle_deg, **known))


def estimated(known: Catalogue) -> CatalogueBearing:
    """See `bearing_from_catalogue`."""
    catalogue_relations.check(known)
    belief = _believed(known)
    bearing, design_load = _made(belief, belief.mean, belief.rollers)
    wrong = catalogue_relations.check_rings(known, bearing)
    unusual = _usual(known, *catalogue_relations.prior(known), belief.mean)
    if unusual is not None and (wrong is None or getattr(known, wrong.key, None) is None):
        raise SceneError(unusual)  # what was not given cannot be blamed
    if wrong is not None:
        raise SceneError(wrong.sentence)

    values = _numbers(bearing, design_load)
    uncertain = _spread(belief, lambda *made: np.array([value for value, _ in _numbers(*made).values()]))
    estimates = {name: Estimate(float(value), 0.0 if about < 1e-5 * abs(value) else float(about), unit)
                 for (name, (value, unit)), about in zip(values.items(), uncertain, strict=True)}  # fmt: skip
    return CatalogueBearing(known, bearing, design_load, estimates, belief)


def _numbers(bearing: TaperedBearing, design_load: float) -> dict[str, tuple[float, str]]:
    """What is estimated, by name, with units."""
    small, large = bearing.roller_small_diameter, bearing.roller_large_diameter
    diameter = 0.5 * (small + large)
    pitch = diameter * math.sin(bearing.outer_angle - bearing.roller_angle) / math.tan(bearing.roller_angle)
    return {
        "rollers": (bearing.rollers, ""), "pitch_diameter": (pitch, "mm"), "roller_diameter": (diameter, "mm"),
        "roller_length": (bearing.roller_length, "mm"), "contact_angle": (math.degrees(bearing.outer_angle), "°"),
        "roller_small_diameter": (small, "mm"), "roller_large_diameter": (large, "mm"),
        "outer_angle": (bearing.outer_angle, "rad"), "inner_angle": (bearing.inner_angle, "rad"),
        "roller_angle": (bearing.roller_angle, "rad"), "flange_angle": (bearing.flange_angle, "rad"),
        "design_load": (design_load, "N"),
    }  # fmt: skip


# ------------------------------------------------------------------------------------------------ conditioning


def _inside(known: Catalogue, x: np.ndarray) -> Inside:
    pitch, diameter, length, fill, tangent = np.exp(x)
    pitch, diameter = pitch * 0.5 * (known.d + known.D), diameter * 0.5 * (known.D - known.d)
    return Inside(pitch, diameter, length * known.T, fill * np.pi * pitch / diameter, math.atan(tangent))


def _believed(known: Catalogue) -> _Belief:
    """What is believed of a bearing after all that was given; raises `SceneError` for what cannot be together."""
    prior, spread = catalogue_relations.prior(known)
    every = list(catalogue_relations.given(known))

    def apart(x: np.ndarray) -> np.ndarray:
        """From the prior, and from what was given, in standard deviations."""
        inside = _inside(known, x)
        off = [math.log(each.relation(inside) / each.value) / each.spread for each in every]
        return np.array([*((x - prior) / spread), *off])

    _right_size(known, every, prior)
    x = prior
    for _ in range(ROUNDS):
        slopes = _slopes(apart, x)
        # below half a turn of the ratios' logarithm a round, so that no size leaves the range of its formula
        x = x - np.clip(np.linalg.lstsq(slopes, apart(x), rcond=None)[0], -0.3, 0.3)
    _agree(known, every, prior, x)
    root = np.linalg.pinv(_slopes(apart, x))  # root · rootᵀ is the covariance

    along = np.array([1.0, -1.0, 0.0, 1.0, 0.0])  # of ln(rollers), by the logarithms
    share = along @ root
    uncertain = float(share @ share)
    number = float(_inside(known, x).rollers)
    if known.rollers is not None:
        return _Belief(known, x, root, known.rollers, None)
    per_log = root @ share / uncertain
    rollers = max(3, round(number))
    while rollers > 3 and _overlap(known, x + per_log * math.log(rollers / number), rollers):
        rollers -= 1
    x = x + per_log * math.log(rollers / number)
    rest = root - np.outer(per_log, share)  # of what is left when their number is known
    return _Belief(known, x, np.column_stack([rest, per_log * math.sqrt(uncertain)]), rollers, per_log)


def _overlap(known: Catalogue, x: np.ndarray, rollers: int) -> bool:
    """Whether so many rollers overlap."""
    wrong = catalogue_relations.check_rings(known, _bearing(known, x, rollers))
    return wrong is not None and wrong.key == "rollers"


def _slopes(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    steps = STEP * np.eye(x.size)
    return np.stack([(function(x + step) - function(x - step)) / (2.0 * STEP) for step in steps], axis=1)


def _agree(known: Catalogue, every: list[GivenValue], prior: np.ndarray, x: np.ndarray) -> None:
    """Refuse what is given if the most likely inside is far from it."""
    for each in every:
        value = float(each.relation(_inside(known, x)))
        if abs(math.log(value / each.value)) <= ALIKE * each.spread:
            continue
        if each.key in RATINGS:
            raise _wrong_rating(known, each, prior)
        large = known.roller_large_diameter or 0.0
        raise SceneError(
            f"bearing.{each.key} = {large:g}: has no common apex with the raceways; with all else given it would "
            f"have to be {large - each.value + value:.4g} mm"
        )


def _right_size(known: Catalogue, every: list[GivenValue], prior: np.ndarray) -> None:
    """Refuse a rating that is far from those of bearings of this size, for it is in another unit, say: there may be no
    bearing with what is sought for both."""
    for each in every:
        if each.key in RATINGS:
            off = math.log(float(each.relation(_inside(known, prior))) / each.value)
            if abs(off) > math.log(OTHER_UNIT):
                raise _wrong_rating(known, each, prior)


def _wrong_rating(known: Catalogue, rating: GivenValue, prior: np.ndarray) -> SceneError:
    usual = float(rating.relation(_inside(known, prior)))
    cup = ", or leave it out: the cup's width has no place here" if rating.key == "C" and rating.value < known.D else ""
    return SceneError(
        f"bearing.{rating.key} = {rating.value:g}: is the load rating [N], of which bearings of this size have about "
        f"{usual:,.0f}; check it and its unit{cup}"
    )


def _usual(known: Catalogue, prior: np.ndarray, spread: np.ndarray, x: np.ndarray) -> str | None:
    """What is far from every bearing that was published, in a sentence, if something is."""
    names = ("pitch_diameter", "roller_diameter", "roller_length", "rollers")
    worst = int(np.argmax(np.abs(x - prior)[:4] / spread[:4]))
    if abs(x - prior)[worst] <= 2.0 * ALIKE * spread[worst]:
        return None
    value, usual = (getattr(_inside(known, at), names[worst]) for at in (x, prior))
    return (
        f"bearing.{names[worst]} = {value:.4g}: follows from what is given, but bearings of this size have about "
        f"{usual:.3g}; check d, D, T, the ratings' unit [N] and the rollers"
    )


# ------------------------------------------------------------------------------------------------ what follows


def _bearing(known: Catalogue, x: np.ndarray, rollers: int, lean: float = LEAN) -> TaperedBearing:
    """With the number of rollers, and exact values exact."""
    inside = _inside(known, x)._replace(rollers=rollers, lean=lean)
    exact = {"pitch_diameter": known.pitch_diameter, "roller_diameter": known.mean_diameter,
             "roller_length": known.roller_length}  # fmt: skip
    inside = inside._replace(**{key: value for key, value in exact.items() if value is not None})
    numbers = Inside(*map(float, inside))._replace(rollers=rollers)
    made = tapered(numbers, known.modulus, known.poisson, known.density)
    made = jax.tree.map(float, made)
    if known.roller_small_diameter is None:
        return made
    return dataclasses.replace(
        made, roller_small_diameter=known.roller_small_diameter, roller_large_diameter=known.roller_large_diameter
    )


_Made = tuple[TaperedBearing, float]


def _made(belief: _Belief, x: np.ndarray, rollers: int, lean: float = LEAN, log_crown: float = 0.0) -> _Made:
    """A bearing that is believed in, and its design load [N]."""
    bearing = _bearing(belief.known, x, rollers, lean)
    return bearing, float(catalogue_relations.crown(bearing)) * math.exp(log_crown)


def _pairs(belief: _Belief) -> Iterator[tuple[_Made, _Made, float]]:
    """Along every independent direction two bearings either way, and how many of their half distances are one standard
    deviation."""
    x, z = belief.mean, belief.rollers
    columns = belief.columns if belief.per_roller is None else belief.columns[:, :-1]
    _, sizes, directions = np.linalg.svd(columns.T, full_matrices=False)
    for size, direction in zip(sizes, directions, strict=True):
        if size > 1e-6:
            step = size * direction
            yield _made(belief, x + step, z), _made(belief, x - step, z), 1.0
    if belief.per_roller is not None:
        per_log = belief.per_roller
        spread = math.hypot(float(np.linalg.norm(belief.columns[:, -1]) / np.linalg.norm(per_log)) * z, 1.0 / 12.0**0.5)
        steps = [(x + per_log * math.log((z + k) / z), z + k) for k in (1, -1) if z + k >= 3]
        ends = [_made(belief, *step) if not _overlap(belief.known, *step) else _made(belief, x, z)
                for step in steps]  # fmt: skip
        yield ends[0], ends[-1], spread * 2.0 / max(abs(ends[0][0].rollers - ends[-1][0].rollers), 1)
    leans = [_made(belief, x, z, lean=LEAN + sign * LEAN_SPREAD) for sign in (1.0, -1.0)]
    yield leans[0], leans[1], 1.0
    crowns = [_made(belief, x, z, log_crown=sign * CROWN_SPREAD) for sign in (1.0, -1.0)]
    yield crowns[0], crowns[1], 1.0


def _spread(belief: _Belief, function: Function) -> Any:
    total: Any = 0.0
    for plus, minus, deviations in _pairs(belief):
        apart = 0.5 * deviations * (np.asarray(function(*plus)) - np.asarray(function(*minus)))
        total = total + apart**2
    return COVERED * np.sqrt(total)
