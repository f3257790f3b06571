"""Bearings that come with the package, by their catalogue names: to add one, give its numbers and their source here."""

from __future__ import annotations

from difftrb.core.geometry import TaperedBearing
from difftrb.core.input_errors import shown
from difftrb.core.status import SceneError

BEARINGS = {
    # Liu et al. 2018, Tribology International 122, Table 1
    "32008J": TaperedBearing(
        roller_small_diameter=6.131,
        roller_large_diameter=6.846,
        roller_length=13.66,
        rollers=23,
        outer_angle=0.2473,
        inner_angle=0.1949,
        roller_angle=0.0262,
        flange_angle=1.5621,
        modulus=2.1e5,
        poisson=0.278,
    ),
}


def bearing(name: str) -> TaperedBearing:
    """A bearing by its catalogue name; raises `SceneError` with the known names if there is none."""
    return named(name, "a TaperedBearing, or bearing_from_catalogue for one by what its catalogue prints")


def named(name: str, instead: str) -> TaperedBearing:
    """As `bearing`; the error also says what may be given `instead` of a name."""
    if name not in BEARINGS:
        raise SceneError(f"bearing = {shown(name)} is unknown; use {', '.join(BEARINGS)}, or {instead}")
    return BEARINGS[name]


def name_of(of: object) -> str | None:
    """The catalogue name of a bearing that comes with the package; None of another one."""
    return next((name for name, known in BEARINGS.items() if of is known or _equal(of, known)), None)


def _equal(of: object, known: TaperedBearing) -> bool:
    """Whether both are bearings of the same numbers; traced ones are not known."""
    if not isinstance(of, TaperedBearing):
        return False
    pairs = [(getattr(of, name), getattr(known, name)) for name in known.__dataclass_fields__]
    return all(mine is theirs or (isinstance(mine, int | float) and mine == theirs) for mine, theirs in pairs)
