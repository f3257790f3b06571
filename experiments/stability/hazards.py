"""Every hazard by name: what is hard about it, the numbers that make it so, and what has to come of it.

One list for the page and for the tests (tests/scene/test_hazards.py).
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, Literal, get_args

import numpy as np

import difftrb as trb
from difftrb.contact import gap
from difftrb.core import geometry, status
from difftrb.ring.load import needed_axial

BEARING = trb.bearing("32008J")
CONTACT = trb.LineContact.of(BEARING, "outer", 6500.0)
LENGTH, RADIUS = float(BEARING.roller_length), float(CONTACT.radius)
ROUND = 2.0 * np.pi * float(geometry.arc_radius(BEARING))
"""Of the raceway [mm]."""
GOOD, COARSE, BAD = status.CONVERGED, status.UNRESOLVED, status.BAD_INPUT
STEP = 1e-5
"""Of differences, relative to the number, if nothing else is said."""
Number = Literal[
    "load", "length", "width", "depth", "offset", "axial_offset", "radius", "roller_length", "modulus", "design_load"
]


NUMBERS: tuple[Number, ...] = get_args(Number)
RING_NUMBERS = ("radial", "axial", "phase", "length", "width", "angle", "outer_angle")


@dataclasses.dataclass(frozen=True)
class Hazard:
    """Of both kinds.

    Attributes:
      name: what is hard. ends: statuses that will do. step: of differences, relative to each number.
      kinks: numbers by which the answer has a kink, jumps or is refused on one side: its derivative is the other's.
    """

    names: ClassVar[tuple[str, ...]]
    name: str
    ends: tuple[int, ...] = (GOOD,)
    kinks: tuple[str, ...] = ()
    step: float = STEP

    @property
    def numbers(self) -> np.ndarray:
        """All that can be differentiated by, in the order of `names`."""
        return np.array([getattr(self, name) for name in self.names])


@dataclasses.dataclass(frozen=True)
class ContactHazard(Hazard):
    """One roller over one spall. Kinks: a spall's end reaches the roller's, a crown can only grow, the last few loaded
    cells change.

    Attributes:
      load, length, width, depth, offset, axial_offset, radius, roller_length, modulus, design_load: of the contact.
    """

    names = NUMBERS
    load: float = 3000.0
    length: float = 4.0
    width: float = 7.0
    depth: float = 0.2
    offset: float = 0.0
    axial_offset: float = 0.0
    radius: float = RADIUS
    roller_length: float = LENGTH
    modulus: float = float(CONTACT.modulus)
    design_load: float = 6500.0


HALF_WIDTH = float(gap.line_half_width(3000.0 / LENGTH, RADIUS, CONTACT.modulus))
"""Of the contact at 3 kN [mm], about."""

CONTACTS = (
    ContactHazard("load 1e-3 N", load=1e-3),
    ContactHazard("load 1 N", load=1.0),
    ContactHazard("load 1e5 N", load=1e5),
    ContactHazard("no load", load=0.0, ends=(BAD,)),
    ContactHazard("load that is no number", load=np.nan, ends=(BAD,)),
    ContactHazard("spall of length 0", length=0.0),
    ContactHazard("spall of length 1e-6 mm", length=1e-6),
    ContactHazard(
        "spall as long as the roller but for 1e-6 mm", length=LENGTH - 1e-6, kinks=("length", "roller_length")
    ),
    ContactHazard("spall as long as the roller", length=LENGTH, kinks=("length", "roller_length")),
    ContactHazard("spall longer than the roller", length=2.0 * LENGTH),
    ContactHazard(
        "spall as long as the roller, light load", length=LENGTH, load=0.1, kinks=("length", "roller_length")
    ),
    ContactHazard("spall of width 0", width=0.0),
    ContactHazard("spall thinner than a cell", width=0.01, ends=(COARSE,)),
    ContactHazard("spall wider than the ring", width=1.1 * ROUND),
    ContactHazard("edge just touches", width=1.0, offset=0.5 + HALF_WIDTH),
    ContactHazard("edge just leaves", width=1.0, offset=0.5 - HALF_WIDTH),
    ContactHazard("edge in the middle", width=1.0, offset=0.5),
    ContactHazard("both edges in the contact", width=0.08),
    ContactHazard("exactly centred", width=1.0),
    ContactHazard("spall far away", offset=1000.0),
    ContactHazard("spall of depth 0", depth=0.0),
    ContactHazard("spall of depth 1 nm", depth=1e-6),
    ContactHazard("bottom about to be touched", depth=0.0097),
    ContactHazard("spall of depth 10 mm", depth=10.0),
    ContactHazard("no crown", design_load=0.0, kinks=("design_load",)),
    ContactHazard(
        "no crown, spall as long as the roller",
        design_load=0.0,
        length=LENGTH,
        kinks=("design_load", "length", "roller_length"),
    ),
    ContactHazard("crown for 1e7 N", design_load=1e7),
    ContactHazard("crown for 1e7 N, load 1e-3 N", design_load=1e7, load=1e-3, kinks=("load", "radius")),
    ContactHazard("modulus 1e3 MPa", modulus=1e3),
    ContactHazard("modulus 1e7 MPa", modulus=1e7),
    ContactHazard("roller as short as wide", roller_length=0.5, length=0.2),
    ContactHazard("radius 0.1 mm", radius=0.1),
    ContactHazard("radius 1e4 mm", radius=1e4),
    ContactHazard("almost full contact", load=3e5, depth=0.002, length=3.0),
    ContactHazard("spall over the roller's end", axial_offset=0.5 * LENGTH),
    ContactHazard("spall beside the roller", axial_offset=LENGTH),
    ContactHazard("sliver of land at one end", length=LENGTH - 0.01, axial_offset=0.005),
    ContactHazard("negative length", length=-1.0, ends=(BAD,)),
    ContactHazard("offset that is no number", offset=np.nan, ends=(BAD,)),
)

# ------------------------------------------------------------------------------------------------------------- rings

PITCH = float(geometry.roller_pitch(BEARING))
NEEDED = float(needed_axial(BEARING, 9000.0, 0.0))
"""Axial load that 9000 N radial need at phase 0 [N]."""
NONE, LONG = status.NO_EQUILIBRIUM, status.UNKNOWN_LENGTH
EDGE = 3.5 / float(geometry.arc_radius(BEARING))
"""Half of 7 mm on the raceway [rad]."""


@dataclasses.dataclass(frozen=True)
class RingHazard(Hazard):
    """A ring under a load, by law "liu2018".

    Attributes:
      radial, axial, phase, length, width, angle, outer_angle: of the scene; the axial load of "touching" is found so
        that the least pressed roller just touches.
      rollers: how many.
    """

    names = RING_NUMBERS
    radial: float = 9000.0
    axial: float = 4500.0
    phase: float = 0.0
    length: float = 4.0
    width: float = 7.0
    angle: float = 0.0
    outer_angle: float = float(BEARING.outer_angle)
    rollers: int = BEARING.rollers


RINGS = (
    RingHazard("main scene"),
    RingHazard("pure axial load", radial=0.0, kinks=("radial",)),
    RingHazard("radial load 1e-12 N", radial=1e-12),
    RingHazard("axial load 1e-9 N", radial=0.0, axial=1e-9, kinks=("radial",)),
    RingHazard("1e-30 N", radial=1e-30, axial=1e-30),
    RingHazard("1e7 N", radial=1e7, axial=1e7, ends=(status.BOTTOM,)),
    RingHazard("1e300 N", radial=1e300, axial=1e300, ends=(BAD,)),
    RingHazard("one loaded roller: 1e-4 above the least axial load", axial=NEEDED * (1.0 + 1e-4)),
    RingHazard("1e-5 above the least axial load", axial=NEEDED * (1.0 + 1e-5), step=1e-8),
    RingHazard("at the least axial load", axial=NEEDED, ends=(NONE,)),
    RingHazard("below the least axial load", axial=0.5 * NEEDED, ends=(NONE,)),
    RingHazard("pure radial load", axial=0.0, ends=(NONE,)),
    RingHazard("no load", radial=0.0, axial=0.0, ends=(NONE,)),
    RingHazard("load that is no number", radial=np.nan, ends=(BAD,)),
    RingHazard("negative load", axial=-1.0, ends=(BAD,)),
    RingHazard("a roller just touches", radial=9000.0, axial=np.inf),
    RingHazard("spall of length 0", length=0.0, kinks=("length",)),
    RingHazard("spall of width 0", width=0.0, phase=0.3 * PITCH, kinks=("width",)),
    RingHazard("spall all but all the way round", width=0.96 * ROUND),
    RingHazard("spall all the way round", width=ROUND, ends=(BAD,)),
    RingHazard("spall as long as the law knows", length=8.0, kinks=("length",)),
    RingHazard("spall longer than the law knows", length=8.0 + 1e-9, ends=(LONG,)),
    RingHazard("a roller exactly at the spall's edge", phase=EDGE, kinks=("phase", "width", "angle", "outer_angle")),
    RingHazard("a roller a hair inside the edge", phase=EDGE * (1.0 - 1e-3)),
    RingHazard("phase of one pitch", phase=PITCH),
    RingHazard("angle −2π", angle=-2.0 * np.pi),
    RingHazard("spall opposite to the load", angle=np.pi),
    RingHazard("contact angle 0.01 rad", radial=100.0, outer_angle=0.01, ends=(BAD,)),
    RingHazard("contact angle 1e-6 rad", radial=100.0, outer_angle=1e-6, ends=(BAD,)),
    RingHazard("contact angle 1.5 rad", radial=100.0, outer_angle=1.5),
    RingHazard("contact angle π/2 but for 1e-9", radial=100.0, outer_angle=0.5 * np.pi - 1e-9, ends=(NONE,)),
    RingHazard("3 rollers", radial=1000.0, rollers=3),
    RingHazard("200 rollers, which overlap", rollers=200, ends=(BAD,)),
)  # fmt: skip
