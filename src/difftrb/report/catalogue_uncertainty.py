"""What a result is worth whose bearing was estimated from its catalogue."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple, cast

import numpy as np
from rich.table import Table

from difftrb.core.geometry import TaperedBearing
from difftrb.core.status import SceneError
from difftrb.law.base import LAWS
from difftrb.report.tables import house_table
from difftrb.ring.catalogue_inference import CatalogueBearing
from difftrb.scene import solving
from difftrb.scene.auto_law import PREPARED
from difftrb.scene.prepared_scene import solve_prepared
from difftrb.scene.scene import Scene, healthy
from difftrb.scene.scene_laws import with_any_width


class Estimated(NamedTuple):
    """A catalogue's bearing, and the expanded uncertainty (k = 2) by what it does not print, of radial and axial
    stiffness [N/mm], shape (2,), at stiffnesses [N/mm], and of what the spalls take of them, relative, shape (2,); None
    where the roller law does not follow the bearing."""

    catalogue: CatalogueBearing
    stiffness: np.ndarray
    uncertainty: np.ndarray | None
    of_loss: np.ndarray | None

    def record(self) -> dict[str, Any]:
        """For JSON."""
        values = {name: {"value": each.value, "uncertainty": each.uncertainty, "unit": each.unit, "given": each.given}
                  for name, each in self.catalogue.estimates.items()}  # fmt: skip
        by = None if self.uncertainty is None else dict(zip(("radial", "axial"), self.uncertainty, strict=True))
        loss = None if self.of_loss is None else dict(zip(("radial", "axial"), self.of_loss, strict=True))
        return {"values": values, "stiffness_uncertainty": by, "relative_loss_uncertainty": loss}

    @property
    def sentence(self) -> str:
        """What was estimated, and what that leaves of stiffness."""
        text = told(self.catalogue)
        if self.uncertainty is None:
            return (
                f"{text}; what that leaves of stiffness is not known: rectangular spalls on rings that do not tilt tell"
            )
        radial, axial = 100.0 * self.uncertainty / np.abs(self.stiffness)
        if not np.isfinite([radial, axial]).all():
            return f"{text}; what that leaves of stiffness is not known: the law does not know all these bearings"
        text = f"{text}; that leaves stiffness within ± {radial:.0f} % radial, ± {axial:.0f} % axial"
        if self.of_loss is None:
            return text
        radial, axial = 100.0 * self.of_loss
        return f"{text}, and what the spall takes of it within ± {radial:.0f} % and ± {axial:.0f} % of that"


def told(catalogue: CatalogueBearing) -> str:
    """What was estimated, in a sentence."""
    own = catalogue.estimates
    main = ("rollers", "pitch_diameter", "roller_diameter", "roller_length", "design_load")
    values = "; ".join(f"{name.replace('_', ' ')} {own[name]}" for name in main if not own[name].given)
    return f"bearing estimated from its catalogue (± at k = 2): {values}"


def estimated(scene: Scene, anew: Scene, catalogue: CatalogueBearing, stiffness: Any) -> Estimated:
    """Of a prepared scene and its radial and axial stiffness [N/mm], shape (2,). Where its law does not follow another
    bearing, the table tells by how many per cent stiffness moves, for `anew`, the scene before it was prepared."""
    known = np.asarray(stiffness, float)
    kind = LAWS.get(getattr(scene.law, "name", ""))
    if kind is None or not kind.at_once:
        try:
            scene = solving.prepare(dataclasses.replace(anew, law="table", accuracy=PREPARED))
        except SceneError:  # rings that tilt, maps
            return Estimated(catalogue, known, None, None)
    scene = with_any_width(scene) or scene  # with another crown's load a roller may reach both edges of a spall

    def both(bearing: TaperedBearing, design_load: float) -> np.ndarray:
        other = dataclasses.replace(scene, bearing=bearing, design_load=design_load)
        spalled, whole = (np.asarray(solve_prepared(each).both_stiffnesses) for each in (other, healthy(other)))
        return np.stack([spalled, 1.0 - spalled / whole])

    own, loss = both(scene.bearing, cast(float, scene.design_load))
    about = catalogue.uncertainty(both)
    return Estimated(catalogue, known, about[0] / own * known, about[1] / loss if (loss > 0.0).all() else None)


def table(catalogue: CatalogueBearing) -> Table:
    """All of the bearing's numbers."""
    rows = house_table("Bearing estimated from its catalogue", "", "value", "± (k = 2)", "unit")
    for name, each in catalogue.estimates.items():
        value, _, uncertainty = str(each).removesuffix(each.unit).strip().partition(" ± ")
        rows.add_row(name, value, uncertainty or "given", each.unit)
    return rows
