"""What a result is worth whose bearing was estimated from its catalogue."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from difftrb.core.geometry import TaperedBearing
from difftrb.law.base import LAWS
from difftrb.ring.catalogue_inference import CatalogueBearing
from difftrb.scene.prepared import solve_prepared
from difftrb.scene.scene import Scene, is_plain


class Estimated(NamedTuple):
    """A catalogue's bearing, and the expanded uncertainty (k = 2) of radial and axial stiffness by what it does not
    print [N/mm], shape (2,), at stiffnesses [N/mm]; None where the roller law does not follow the bearing."""

    catalogue: CatalogueBearing
    stiffness: np.ndarray
    uncertainty: np.ndarray | None

    def record(self) -> dict[str, Any]:
        """For JSON."""
        values = {name: {"value": each.value, "uncertainty": each.uncertainty, "unit": each.unit, "given": each.given}
                  for name, each in self.catalogue.estimates.items()}  # fmt: skip
        by = None if self.uncertainty is None else dict(zip(("radial", "axial"), self.uncertainty, strict=True))
        return {"values": values, "stiffness_uncertainty": by}

    @property
    def sentence(self) -> str:
        """What was estimated, and what that leaves of stiffness."""
        own = self.catalogue.estimates
        main = ("rollers", "pitch_diameter", "roller_diameter", "roller_length", "design_load")
        told = "; ".join(f"{name.replace('_', ' ')} {own[name]}" for name in main if not own[name].given)
        text = f"bearing estimated from its catalogue (± at k = 2): {told}"
        if self.uncertainty is None:
            return text
        radial, axial = 100.0 * self.uncertainty / np.abs(self.stiffness)
        if not np.isfinite([radial, axial]).all():
            return f"{text}; what that leaves of stiffness is not known: the law does not know all these bearings"
        return f"{text}; that leaves stiffness within ± {radial:.0f} % radial, ± {axial:.0f} % axial"


def estimated(scene: Scene, catalogue: CatalogueBearing, stiffness: Any) -> Estimated:
    """Of a prepared scene and its radial and axial stiffness [N/mm], shape (2,)."""
    kind = LAWS.get(getattr(scene.law, "name", ""))
    follows = is_plain(scene) and kind is not None and kind.at_once

    def stiffnesses(bearing: TaperedBearing, design_load: float) -> np.ndarray:
        solution = solve_prepared(dataclasses.replace(scene, bearing=bearing, design_load=design_load))
        return np.asarray(solution.both_stiffnesses)

    known = np.asarray(stiffness, float)
    return Estimated(catalogue, known, catalogue.uncertainty(stiffnesses) if follows else None)


def table(catalogue: CatalogueBearing, empty: Table) -> Table:
    """All of the bearing's numbers, in an `empty` table of the house."""
    for heading in ("", "value", "± (k = 2)", "unit"):
        empty.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for name, each in catalogue.estimates.items():
        value, _, uncertainty = str(each).removesuffix(each.unit).strip().partition(" ± ")
        empty.add_row(name, value, uncertainty or "given", each.unit)
    return empty
