"""What numbers of one bearing and its spalls cannot be together, in one sentence; traced ones are passed over."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.core

from difftrb.core import arrays as xp
from difftrb.core.geometry import Spall, TaperedBearing

APEX, TAPER = 0.02, 0.05
"""How far cone angles may be from one apex, and the roller's angle from its diameters, relative."""


T = TypeVar("T")


class Wrong(NamedTuple):
    """A bearing that cannot be: the field that is blamed, and a sentence."""

    key: str
    sentence: str


def as_numbers(*values: Any) -> list[float] | None:
    """Numbers as floats; None if one of them is traced."""
    if any(isinstance(value, jax.core.Tracer) for value in values):
        return None
    return [float(value) for value in values]


def across(bearing: TaperedBearing, spalls: tuple[Any, ...]) -> str | None:
    """What the fields of a bearing, and spalls on its rollers' length, cannot be together."""
    wrong = of_bearing(bearing)
    if wrong is not None:
        return wrong.sentence
    for i, spall in enumerate(spalls):
        sizes = as_numbers(spall.length, bearing.roller_length, spall.axial_offset)
        if sizes is None:
            continue
        length, roller, offset = sizes
        if isinstance(spall, Spall) and length > roller * (1.0 + 1e-12):
            return f"spall.{i}.length = {length:g}: must be at most the roller's length, {roller:g} mm"
        farthest = 0.5 * (roller + length)
        if abs(offset) >= farthest > 0.0:
            return (
                f"spall.{i}.axial_offset = {offset:g}: the spall lies beside the roller, which is {roller:g} mm long; "
                f"give {-farthest:.6g} … {farthest:.6g} mm, from the roller's middle"
            )
    return None


def of_bearing(bearing: TaperedBearing) -> Wrong | None:
    """What the fields of a bearing cannot be together."""
    return first(_diameters, _apex, _taper, _neighbours, of=bearing)


def _wrong(key: str, rest: str) -> Wrong:
    return Wrong(key, f"bearing.{key}{rest}")


def _diameters(bearing: TaperedBearing) -> Wrong | None:
    known = as_numbers(bearing.roller_large_diameter, bearing.roller_small_diameter)
    if known is None or known[0] > known[1]:
        return None
    return _wrong(
        "roller_large_diameter",
        f" = {known[0]:g} must be larger than bearing.roller_small_diameter = {known[1]:g} mm",
    )


def _apex(bearing: TaperedBearing) -> Wrong | None:
    known = as_numbers(bearing.inner_angle, bearing.roller_angle, bearing.outer_angle)
    if known is None:
        return None
    inner, roller, outer = known
    if _share_an_apex(inner, roller, outer):
        return None
    return _wrong(
        "outer_angle",
        f" = {outer:g} must be inner_angle + 2 roller_angle = {inner + 2.0 * roller:g} rad within "
        f"{100.0 * APEX:g} %, so that all cones share one apex",
    )


def _taper(bearing: TaperedBearing) -> Wrong | None:
    known = as_numbers(bearing.roller_large_diameter, bearing.roller_small_diameter, bearing.roller_length,
                   bearing.roller_angle)  # fmt: skip
    if known is None:
        return None
    large, small, length, angle = known
    taper = (large - small) / (2.0 * length)
    if _tapers_by(angle, taper):
        return None
    return _wrong(
        "roller_angle",
        f" = {angle:g} does not fit the roller's diameters and length, which give {taper:.4g} rad; "
        f"they must agree within {100.0 * TAPER:g} %",
    )


def _neighbours(bearing: TaperedBearing) -> Wrong | None:
    """Rollers side by side: at either end the chord between their axes must exceed the diameter there."""
    known = as_numbers(bearing.roller_large_diameter, bearing.roller_small_diameter, bearing.roller_length,
                   bearing.outer_angle, bearing.roller_angle)  # fmt: skip
    if known is None:
        return None
    fit = bearing.rollers
    for diameter, radius in _ends(*known):
        if 2.0 * radius * math.sin(math.pi / bearing.rollers) <= diameter:
            fit = min(fit, math.floor(math.pi / math.asin(min(1.0, 0.5 * diameter / max(radius, 1e-300)))))
            fit -= 2.0 * radius * math.sin(math.pi / max(fit, 1)) <= diameter  # those that touch do not turn
    if fit == bearing.rollers:
        return None
    return _wrong(
        "rollers",
        f" = {bearing.rollers}: rollers of these diameters overlap where they run; at most "
        f"{max(fit, 0)} fit side by side: use fewer or thinner ones",
    )


def fit_together(bearing: TaperedBearing) -> Any:
    """Whether diameters, angles and rollers can be of one bearing, as `across` says it; of traced numbers, too."""
    own = xp.fixed(bearing)
    large, small, length = own.roller_large_diameter, own.roller_small_diameter, own.roller_length
    outer, roller, tapered = own.outer_angle, own.roller_angle, large > small
    fit = tapered & _share_an_apex(own.inner_angle, roller, outer)
    fit = fit & _tapers_by(roller, (large - small) / (2.0 * length))
    for diameter, radius in _ends(xp.where(tapered, large, 2.0 * small), small, length, outer, roller):
        fit = fit & (2.0 * radius * math.sin(math.pi / bearing.rollers) > diameter)
    return fit


def _share_an_apex(inner: Any, roller: Any, outer: Any) -> Any:
    return abs(inner + 2.0 * roller - outer) <= APEX * outer


def _tapers_by(angle: Any, taper: Any) -> Any:
    return abs(taper - angle) <= TAPER * angle


def _ends(large: Any, small: Any, length: Any, outer: Any, roller: Any) -> list[tuple[Any, Any]]:
    """A roller's diameter at either end [mm], and how far its axis is there from the bearing's [mm]."""
    away = (large + small) * length / (2.0 * (large - small))  # of the roller's middle from the apex, along its axis
    ends = (small, away - 0.5 * length), (large, away + 0.5 * length)
    return [(diameter, end * xp.sin(outer - roller)) for diameter, end in ends]


def first(*checks: Callable[[Any], T | None], of: Any) -> T | None:
    """What the first check finds that finds something."""
    return next((found for check in checks if (found := check(of)) is not None), None)
