"""How often rollers pass a defect, by rolling without slip on cones of one apex."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated

from annotated_types import Interval, Unit

from difftrb.core import arrays as xp
from difftrb.core import fields, geometry, packaged_bearings
from difftrb.core.geometry import Real, TaperedBearing
from difftrb.core.input_errors import shown
from difftrb.core.status import SceneError

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float


@fields.register
@dataclasses.dataclass(frozen=True)
class DefectFrequencies:
    """Frequencies [Hz] at a speed, positive for speeds above 0.

    Attributes:
      shaft: of the inner ring against the outer one.
      ftf: fundamental train: the cage against the outer ring.
      bpfo, bpfi: rollers passing a place on the outer, on the inner raceway.
      bsf: a roller's spin against the cage; a defect on it meets either raceway that often.
    """

    shaft: Float[Array, ""]
    ftf: Float[Array, ""]
    bpfo: Float[Array, ""]
    bpfi: Float[Array, ""]
    bsf: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class Speeds:
    """Of both rings [rev/min], either way: −1e6…1e6."""

    inner_rpm: Annotated[Real, Interval(ge=-1e6, le=1e6), Unit("rev/min")]
    outer_rpm: Annotated[Real, Interval(ge=-1e6, le=1e6), Unit("rev/min")] = 0.0


def defect_frequencies(bearing: TaperedBearing | str, inner_rpm: Real, outer_rpm: Real = 0.0) -> DefectFrequencies:
    """Defect frequencies of a bearing (or its name) with its inner ring at `inner_rpm` and its outer ring at
    `outer_rpm` [rev/min], −1e6…1e6, default 0.

    Of cones with one apex these are the textbook's formulas with D/D_pw cosα as tan γ/tan β, where γ is the roller's
    half cone angle and β its axis' angle (Harris, Rolling Bearing Analysis, §25.4, for contact angle β). Differentiable
    by bearing and speeds. Raises `SceneError` for a name that is not known, and for speeds out of range.
    """
    if isinstance(bearing, str):
        bearing = packaged_bearings.bearing(bearing)
    if not isinstance(bearing, TaperedBearing):
        raise SceneError(
            f"bearing = {shown(bearing)}: must be a name or a TaperedBearing; of a catalogue's give its .bearing"
        )
    if (sentence := fields.wrong(Speeds(inner_rpm, outer_rpm), "speed")) is not None:
        raise SceneError(sentence)
    shaft = (inner_rpm - outer_rpm) / 60.0
    cage = shaft * geometry.cage_share(bearing)
    numbers = shaft, cage, bearing.rollers * cage, bearing.rollers * (shaft - cage), cage * geometry.spin_share(bearing)
    return DefectFrequencies(*map(xp.asarray, numbers))
