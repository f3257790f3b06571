"""Loads so small that their unit may be wrong: a remark, never an error."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from difftrb.core.geometry import Real, TaperedBearing
from difftrb.ring import effect, effects, life
from difftrb.scene.scene_file import SceneFile

LEAST = 0.02
"""Equivalent load by load rating under which a maker's tapered rollers may slide instead of roll: SKF, Rolling
bearings, "Requisite minimum load"."""
THOUSAND = 1000.0
"""N in a kN."""


def of_scene(file: SceneFile) -> str | None:
    """The remark on a ring's `load.radial` and `load.axial`, if there is one; none with `effects.mounting`, which sets
    the axial load itself."""
    if effect.among(file.effects, effects.Mounting) is not None:
        return None
    rows = 1 if effect.among(file.effects, effects.DoubleRow) is None else 2
    share = float(_share(file.bearing, file.load.radial, file.load.axial, rows))
    given = f"load.radial = {file.load.radial:g} N, load.axial = {file.load.axial:g} N"
    return _remark(given, share)


def of_contact(file: SceneFile) -> str | None:
    """The same on `contact.load`, as if it were the largest roller load of a bearing."""
    bearing, load = file.bearing, float(file.contact.load)
    whole = load * bearing.rollers * float(np.cos(bearing.outer_angle)) / 4.08  # half of the rollers loaded: Stribeck
    return _remark(f"contact.load = {load:g} N", float(_share(bearing, whole, 0.0)))


def of_rows(bearing: TaperedBearing, rows: Sequence[Any]) -> str | None:
    """The same on the lightest of measured rows, `fits.measured.Measurement`."""
    shares = [float(_share(bearing, row.radial, row.axial)) for row in rows]
    k = int(np.argmin(np.where(np.array(shares) > 0.0, shares, np.inf)))
    return _remark(f"row {k + 1}: radial = {rows[k].radial:g} N, axial = {rows[k].axial:g} N", shares[k])


@partial(jax.jit, static_argnames="rows")
def _share(bearing: TaperedBearing, radial: Real, axial: Real, rows: int = 1) -> jax.Array:
    """Dynamic equivalent load by basic dynamic load rating, both ISO 281."""
    return life.equivalent_load(bearing, radial, axial, rows) / life.load_rating(bearing, rows)


def _remark(given: str, share: float) -> str | None:
    """In one sentence, what is `given` and why its unit may be wrong."""
    if not 0.0 < share < LEAST:
        return None
    light = f"{given}: the equivalent load is {share:.2g} of the bearing's dynamic load rating C (ISO 281)"
    if share * THOUSAND <= 1.0:
        return f"{light}; loads are in N, and this looks like kN"
    return (
        f"{light}, less than the {LEAST:g} C its rollers need to roll; loads are in N: check for a lost factor of ten"
    )
