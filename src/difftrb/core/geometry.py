"""Material and tapered-roller bearing: the maker's numbers in; cones, radii, angles and masses out.

All three cones (outer raceway, inner raceway, roller) share one apex on the bearing axis, which is what makes a
tapered roller roll without slip. Lengths in mm, angles in rad, modulus in MPa, mass in kg.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args

import jax
import jax.numpy as jnp
import numpy as np
from annotated_types import Interval, Unit

from difftrb.core import arrays as xp
from difftrb.core.fields import SHRINKS, register, whole_to_float
from difftrb.core.status import SceneError

Tree = TypeVar("Tree")
DESIGN_LOAD = 6500.0
"""Q_d of the rollers' crown [N] with which Liu et al. 2018, Table 2 comes out."""
Raceway = Literal["outer", "inner"]
if TYPE_CHECKING:
    Real = Any
    """A number: a float when it comes from a file; an array, a tracer or an expansion when computed with."""
else:
    Real = float  # what a file may hold

FILE_RULES = {"extra": "forbid", "strict": True, "allow_inf_nan": False}
"""How a dataclass is read from a file: unknown keys, numbers as text, NaN and infinity are refused."""


@register
@dataclasses.dataclass(frozen=True)
class TaperedBearing:
    """A tapered roller bearing by the entries of Liu et al. 2018, Table 1.

    Every float is a leaf of the pytree, so `jax.grad` by any of them works; `rollers` is static.

    Attributes:
      roller_small_diameter: roller diameter at its small end [mm], 0.1…500.
      roller_large_diameter: roller diameter at its large end [mm], 0.1…500, larger than the small one.
      roller_length: effective roller length along its generator [mm], 0.1…1000.
      rollers: number of rollers [-], 3…400.
      outer_angle: half cone angle of the outer raceway [rad]; it is the contact angle of the load (eq. 5).
      inner_angle: half cone angle of the inner raceway [rad].
      roller_angle: half cone angle of the roller [rad]; (outer_angle − inner_angle)/2 for a common apex.
      flange_angle: angle between the flange's face and the inner raceway's generator [rad]; the direction of the
        flange's force.
      modulus: Young's modulus of rollers and rings [N/mm²].
      poisson: Poisson's ratio [-].
      density: mass density of the rollers [kg/mm³]; bearing steel 7.85e-6. For the roller's mass.
      arc_radius: radius on which a spall's width becomes an angle [mm]. Default (None): the outer raceway at the
        roller's small end, the choice that reproduces the pairs 7 mm/0.24 rad and 49 mm/1.71 rad of Liu et al. 2018.
        Name `outer_raceway_radius(bearing)` (30.3 mm for 32008J) if the width was measured at the raceway's middle.
    """

    __pydantic_config__ = FILE_RULES

    roller_small_diameter: Annotated[Real, Interval(ge=0.1, le=500.0), Unit("mm")]
    roller_large_diameter: Annotated[Real, Interval(ge=0.1, le=500.0), Unit("mm")]
    roller_length: Annotated[Real, Interval(ge=0.1, le=1000.0), Unit("mm")]
    rollers: Annotated[int, Interval(ge=3, le=400)] = dataclasses.field(metadata={"static": True})
    outer_angle: Annotated[Real, Interval(ge=0.01, le=1.5), Unit("rad")]
    inner_angle: Annotated[Real, Interval(ge=0.001, le=1.5), Unit("rad")]
    roller_angle: Annotated[Real, Interval(ge=0.001, le=0.5), Unit("rad")]
    flange_angle: Annotated[Real, Interval(ge=1.0, le=2.0), Unit("rad")]
    modulus: Annotated[Real, Interval(ge=1e3, le=1e6), Unit("N/mm²")] = 2.1e5
    poisson: Annotated[Real, Interval(ge=0.0, le=0.5)] = 0.278
    density: Annotated[Real, Interval(ge=1e-7, le=1e-4), Unit("kg/mm³")] = 7.85e-6
    arc_radius: Annotated[Real, Interval(ge=0.1, le=5000.0), Unit("mm")] | None = None

    def __post_init__(self) -> None:
        whole_to_float(self)


@register
@dataclasses.dataclass(frozen=True)
class Spall:
    """A natural spall: a rectangular depression with vertical walls.

    Attributes:
      length: along the roller [mm], > 0, at most the roller's (from a file: at least 0.01).
      width: along the rolling direction [mm], > 0 (from a file: 0.01…1000).
      depth: of the flat bottom below the raceway [mm], > 0, up to 10; a roller that reaches it is carried by it. The
        default is that of Liu et al. 2018, Fig. 11.
      angle: of its centre from the load line [rad], −2π…2π.
      axial_offset: of its centre from the roller's middle, along the roller [mm], −1000…1000.
      surface: "outer"; in `difftrb contact`, and in the ring with the effect `raceways`, also "inner" (where the inner
        ring stands now) and "roller" (roller 0, `angle` from its outer contact).
      row: 1, or 2 with the effect `double_row`; places along its rollers count as in the first row.
    """

    __pydantic_config__ = FILE_RULES

    length: Annotated[Real, Interval(ge=0.01, le=1000.0), Unit("mm"), SHRINKS]
    width: Annotated[Real, Interval(ge=0.01, le=1000.0), Unit("mm"), SHRINKS]
    depth: Annotated[Real, Interval(ge=1e-6, le=10.0), Unit("mm"), SHRINKS] = 0.2
    angle: Annotated[Real, Interval(ge=-6.2832, le=6.2832), Unit("rad")] = 0.0
    axial_offset: Annotated[Real, Interval(ge=-1000.0, le=1000.0), Unit("mm")] = 0.0
    surface: Literal["outer", "inner", "roller"] = dataclasses.field(default="outer", metadata={"static": True})
    row: Annotated[int, Interval(ge=1, le=2)] = dataclasses.field(default=1, metadata={"static": True})

    def __post_init__(self) -> None:
        whole_to_float(self)

    @property
    def ends(self) -> tuple[Real, Real]:
        """Where it begins and ends along the roller, from the roller's middle [mm]; also beyond the roller's ends."""
        return self.axial_offset - 0.5 * self.length, self.axial_offset + 0.5 * self.length

    @property
    def walls(self) -> Any:
        """Its rolling edges, ahead and behind, from its middle in the rolling direction [mm], shape (2,). A `HeightMap`
        has more."""
        return xp.stack([0.5 * self.width, -0.5 * self.width])

    @property
    def rim(self) -> Real:
        """How high it stands out of the raceway [mm]: not at all. A `HeightMap` may."""
        return 0.0

    @property
    def off_middle(self) -> Any:
        """Whether it is another one at either end of the roller."""
        return self.axial_offset != 0.0

    def turned_over(self) -> Spall:
        """As seen against the rolling direction: the same. A `HeightMap` is another one."""
        return self


@register
@dataclasses.dataclass(frozen=True)
class LineContact:
    """One roller on one raceway: all that the half-space contact problem needs of the bearing.

    Attributes:
      radius: equivalent radius in the rolling direction [mm], > 0.
      length: effective roller length [mm], > 0.
      modulus: contact modulus E' = E/(2(1−ν²)) for two equal materials [N/mm²], > 0.
      design_load: Q_d of the logarithmic crown [N], ≥ 0; 0 is a straight roller. Default 6500.
    """

    radius: Real
    length: Real
    modulus: Real
    design_load: Real = DESIGN_LOAD

    def __post_init__(self) -> None:
        whole_to_float(self)

    @classmethod
    def of(cls, bearing: TaperedBearing, raceway: Raceway = "outer", design_load: Real = DESIGN_LOAD) -> LineContact:
        """The contact of `bearing`'s rollers with one raceway, "outer" or "inner"; `design_load` Q_d of the crown [N].
        Raises `SceneError` for another one."""
        if raceway not in get_args(Raceway):
            raise SceneError(f"raceway = {raceway!r}: must be one of {', '.join(map(repr, get_args(Raceway)))}")
        return cls(
            radius=equivalent_radius(bearing, raceway),
            length=bearing.roller_length,
            modulus=contact_modulus(bearing.modulus, bearing.poisson),
            design_load=design_load,
        )


def as_floats(tree: Tree) -> Tree:
    """The same pytree with whole Python numbers turned into floats, so that `Spall(4, 7)` can be differentiated, and
    shorter floats into float64: one float32 among weakly typed numbers makes all that it meets float32."""

    def as_float(leaf: Any) -> Any:
        if isinstance(leaf, int):
            return float(leaf)
        kind = getattr(leaf, "dtype", None)
        short = kind is not None and kind != np.float64 and jnp.issubdtype(kind, jnp.floating)
        return jnp.asarray(leaf, float) if short else leaf

    return jax.tree.map(as_float, tree)


def spall_is_valid(spall: Spall) -> Any:
    """Whether all numbers of a spall are finite, and its sizes not negative."""
    sizes = spall.length, spall.width, spall.depth
    place = spall.angle, spall.axial_offset
    finite = xp.module_of(*sizes, *place).isfinite(sum(sizes) + spall.angle + spall.axial_offset)
    return (spall.length >= 0.0) & (spall.width >= 0.0) & (spall.depth >= 0.0) & finite


def contact_is_valid(contact: LineContact) -> Any:
    """Whether all numbers of a contact are finite and positive, its design load at least zero."""
    sizes = contact.radius, contact.length, contact.modulus
    positive = (contact.radius > 0.0) & (contact.length > 0.0) & (contact.modulus > 0.0)
    return positive & (contact.design_load >= 0.0) & xp.isfinite(sum(sizes) + contact.design_load)


def contact_modulus(modulus: Real, poisson: Real) -> Real:
    """E' of two equal bodies [N/mm²]."""
    return modulus / (2.0 * (1.0 - poisson**2))  # Liu et al. 2018, eq. (1)


def mean_roller_radius(bearing: TaperedBearing) -> Real:
    """Radius of the roller at half length, at right angles to its axis [mm]."""
    return (bearing.roller_small_diameter + bearing.roller_large_diameter) / 4.0


def apex_distance(bearing: TaperedBearing) -> Real:
    """Distance from the common apex to the roller's middle, along the roller's axis [mm]."""
    taper = (bearing.roller_large_diameter - bearing.roller_small_diameter) / 2.0 / bearing.roller_length
    return mean_roller_radius(bearing) / taper  # similar triangles on the roller's cone


def slant_distance(bearing: TaperedBearing) -> Real:
    """Distance from the apex to the contact's middle along the raceway's generator [mm]."""
    return apex_distance(bearing) * xp.cos(bearing.roller_angle)  # foot of the normal from the roller's middle


def roller_axis_angle(bearing: TaperedBearing) -> Real:
    """Angle between the roller's axis and the bearing's axis [rad]."""
    return bearing.outer_angle - bearing.roller_angle  # common apex


def pitch_radius(bearing: TaperedBearing) -> Real:
    """Radius of the circle on which the rollers' middles run [mm]."""
    return apex_distance(bearing) * xp.sin(roller_axis_angle(bearing))


def roller_normal_radius(bearing: TaperedBearing) -> Real:
    """Principal radius of the roller's cone at mid length, normal to its generator [mm]."""
    return slant_distance(bearing) * xp.tan(bearing.roller_angle)  # cone: ρ = s tan γ (Johnson 1985, §4.1)


def raceway_normal_radius(bearing: TaperedBearing, raceway: Raceway) -> Real:
    """Principal radius of a raceway's cone under the roller's middle, normal to its generator [mm], positive."""
    return slant_distance(bearing) * xp.tan(_cone_angle(bearing, raceway))  # ρ = s tan γ


def equivalent_radius(bearing: TaperedBearing, raceway: Raceway) -> Real:
    """Radius R of the gap x²/(2R) between roller and raceway [mm]; the outer raceway is concave."""
    sign = -1.0 if raceway == "outer" else 1.0
    curvature = 1.0 / roller_normal_radius(bearing) + sign / raceway_normal_radius(bearing, raceway)
    return 1.0 / curvature  # Johnson 1985, eq. (4.3)


def outer_raceway_radius(bearing: TaperedBearing, along_roller: Real = 0.0) -> Real:
    """Radius of the outer raceway about the bearing's axis [mm], `along_roller` mm from the roller's middle
    towards its large end (range ± half the roller's length, default the middle)."""
    return (slant_distance(bearing) + along_roller) * xp.sin(bearing.outer_angle)


def arc_radius(bearing: TaperedBearing, raceway: Raceway = "outer") -> Real:
    """Radius that turns a spall's width into an angle [mm]: see `TaperedBearing.arc_radius`; on the inner raceway at
    the same place along the roller."""
    outer = bearing.arc_radius
    if outer is None:
        outer = outer_raceway_radius(bearing, -bearing.roller_length / 2.0)
    return outer * xp.sin(_cone_angle(bearing, raceway)) / xp.sin(bearing.outer_angle) if raceway == "inner" else outer


def once_round(bearing: TaperedBearing, surface: str) -> Real:
    """How far it is once round what a spall lies on [mm], where its width is measured."""
    radius = mean_roller_radius(bearing) if surface == "roller" else arc_radius(bearing, surface)  # type: ignore[arg-type]
    return 2.0 * np.pi * radius


def flange_force_angle(bearing: TaperedBearing) -> Real:
    """Angle between the flange's force on a roller and the bearing's axis [rad].

    Assumes that `flange_angle`, which Liu et al. 2018 print without a drawing, is the angle between the flange's face
    and the inner raceway's generator.
    """
    return bearing.inner_angle + 0.5 * np.pi - bearing.flange_angle  # normal to the flange's face


def roller_mass(bearing: TaperedBearing) -> Real:
    """Mass of one roller, a frustum of a cone without recesses [kg]."""
    d, D = bearing.roller_small_diameter, bearing.roller_large_diameter
    volume = np.pi * bearing.roller_length / 12.0 * (d * d + d * D + D * D)
    return bearing.density * volume


def wrapped(angle: Any, whole: float = 2.0 * np.pi) -> Any:
    """The same angle within half of a `whole` turn of 0 [rad], any shape; of rollers a pitch may be one."""
    return xp.mod(angle + 0.5 * whole, whole) - 0.5 * whole


def roller_pitch(bearing: TaperedBearing) -> Real:
    """Angle between neighbouring rollers [rad]."""
    return 2.0 * np.pi / bearing.rollers


def cage_share(bearing: TaperedBearing) -> Real:
    """How far the cage turns in one turn of the inner ring, the outer one at rest, 0…0.5."""
    inner, outer = xp.sin(bearing.inner_angle), xp.sin(bearing.outer_angle)
    return inner / (inner + outer)  # rolling without slip on both raceways


def cage_rate(bearing: TaperedBearing, speed_rpm: Real) -> Real:
    """Angular speed of the cage [rad/s], the inner ring at `speed_rpm` and the outer one at rest."""
    return speed_rpm * (np.pi / 30.0) * cage_share(bearing)


def spin_share(bearing: TaperedBearing) -> Real:
    """How often a roller turns about its axis in one turn of the cage, the outer ring at rest."""
    return xp.sin(bearing.outer_angle) / xp.sin(bearing.roller_angle)  # rolling on the outer raceway's cone


def _cone_angle(bearing: TaperedBearing, raceway: Raceway) -> Real:
    return {"outer": bearing.outer_angle, "inner": bearing.inner_angle}[raceway]
