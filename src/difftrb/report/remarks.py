"""Remarks, never errors: loads and angles whose unit may be wrong, and what limits a solution."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from difftrb.core.geometry import Real, TaperedBearing
from difftrb.ring import effect_base, effects, life, roller_places
from difftrb.ring.effects import Through
from difftrb.scene.file_schema import SceneFile
from difftrb.scene.prepared_scene import assess_prepared
from difftrb.scene.scene import PitchMean, Scene, has_map
from difftrb.scene.solution import Assessment, Solution, rollers_at

LEAST = 0.02
"""Equivalent load by load rating under which a maker's tapered rollers may slide instead of roll: SKF, Rolling
bearings, "Requisite minimum load"."""
LEAST_LOSS = 0.5
"""Losses of secant and tangent stiffness that differ by less are alike [%]."""
THOUSAND = 1000.0
"""N in a kN."""


def of_ring(file: SceneFile) -> tuple[str | None, ...]:
    """What may be wrong with a ring's file that is in order, each if there is one."""
    return odd_ring_load(file), far_angle(file)


def odd_ring_load(file: SceneFile) -> str | None:
    """The remark on a ring's `load.radial` and `load.axial`, if there is one; none with `effects.mounting`, which sets
    the axial load itself, or where a preload presses two rows besides."""
    pair = effect_base.among(file.effects, effects.DoubleRow)
    if effect_base.among(file.effects, effects.Mounting) is not None or (pair is not None and pair.preload > 0.0):
        return None
    rows = 1 if pair is None else 2
    share = float(_share(file.bearing, file.load.radial, file.load.axial, rows))
    given = f"load.radial = {file.load.radial:g} N, load.axial = {file.load.axial:g} N"
    return _odd(given, share)


def far_angle(file: SceneFile) -> str | None:
    """The remark on an angle of more than half a turn, which may be in degrees, if there is one."""
    for i, spall in enumerate(file.spall):
        if abs(spall.angle) > np.pi:
            return (
                f"spall.{i}.angle = {spall.angle:g} rad is {np.degrees(spall.angle):.4g}°, more than half a turn; if "
                f"it is in degrees, give {np.radians(spall.angle):.4g}"
            )
    return None


def odd_contact_load(file: SceneFile) -> str | None:
    """The same on `contact.load`, as if it were the largest roller load of a bearing."""
    bearing, load = file.bearing, float(file.contact.load)
    whole = load * bearing.rollers * float(np.cos(bearing.outer_angle)) / 4.08  # half of the rollers loaded: Stribeck
    return _odd(f"contact.load = {load:g} N", float(_share(bearing, whole, 0.0)))


def odd_measured_load(bearing: TaperedBearing, rows: Sequence[Any]) -> str | None:
    """The same on the heaviest or the lightest of measured rows, `fits.measured.Measurement`."""
    shares = [float(_share(bearing, row.radial, row.axial)) for row in rows]
    k = int(np.argmax(shares))
    if shares[k] <= 1.0:
        k = int(np.argmin(np.where(np.array(shares) > 0.0, shares, np.inf)))
    where = f"row {k + 1}" if rows[k].origin is None else f"line {rows[k].origin.line}"
    return _odd(f"{where}: radial = {rows[k].radial:g} N, axial = {rows[k].axial:g} N", shares[k])


def all_in_kn(bearing: TaperedBearing, rows: Sequence[Any]) -> bool:
    """Whether the loads of all measured rows look like kN."""
    return max(float(_share(bearing, row.radial, row.axial)) for row in rows) * THOUSAND <= 1.0


def _share(bearing: TaperedBearing, radial: Real, axial: Real, rows: int = 1) -> Any:
    """Dynamic equivalent load by basic dynamic load rating, both ISO 281."""
    return life.equivalent_load(bearing, radial, axial, rows) / life.load_rating(bearing, rows)


def _odd(given: str, share: float) -> str | None:
    """In one sentence, what is `given` and why its unit may be wrong."""
    if share > 1.0:
        return (
            f"{given}: the equivalent load is {share:.2g} times the bearing's dynamic load rating C (ISO 281): its "
            "steel would yield, which the model does not know; loads are in N: check them"
        )
    if not 0.0 < share < LEAST:
        return None
    light = f"{given}: the equivalent load is {share:.2g} of the bearing's dynamic load rating C (ISO 281)"
    if share * THOUSAND <= 1.0:
        return f"{light}; loads are in N, and this looks like kN"
    return (
        f"{light}, less than the {LEAST:g} C its rollers need to roll; loads are in N: check for a lost factor of ten"
    )


def of_result(scene: Scene, result: Assessment) -> list[str]:
    """What a reader has to know before the numbers of a prepared scene, a sentence each."""
    return [*of_solution(scene, result.spalled), *_of_secants(scene, result)]


def of_solution(scene: Scene, solution: Solution) -> list[str]:
    """The same of one solution."""
    found, of = list(solution.remarks), solution.law
    loads, (low, high) = np.asarray(solution.loads), (float(v) for v in of.load_range)
    if has_map(scene):
        found.append(
            "slopes by a height map's size are not told: those of a sampled surface with walls may be wrong by "
            "factors; take differences over some cells, 0.1 mm say"
        )
    if float(loads.max()) > high * (1.0 + 1e-9):
        found.append(
            f"rollers carry up to {loads.max():,.0f} N, and law {of.name!r} was made for {low:,.0f} … {high:,.0f} N: "
            "its error there is not known; name the law anew, or use 'direct'"
        )
    if of.hard and not isinstance(scene.phase, PitchMean) and (count := _rollers_on_edges(scene, solution)):
        found.append(
            f"{count} roller{'s stand' if count > 1 else ' stands'} on a spall's rolling edge, which law {of.name!r} "
            "does not know: in or out, with nothing between; use 'table' or 'direct'"
        )
    return found


def _of_secants(scene: Scene, result: Assessment) -> list[str]:
    """Where F/u is no measure of stiffness, for the rings do not lie at u = 0 without that force: a preload or a spall
    moves them. It is told by the loss of tangent stiffness, which is about the same elsewhere."""
    if scene.definition == "tangent" or isinstance(scene.phase, PitchMean) or not bool(result.spalled.converged):
        return []
    tangent = np.asarray(assess_prepared(dataclasses.replace(scene, definition="tangent")).loss)
    found = []
    for name, own, other in zip(("radial", "axial"), np.asarray(result.loss), tangent, strict=True):
        if np.isfinite(own) and abs(own - other) > max(LEAST_LOSS, 0.5 * max(abs(own), abs(other))):
            found.append(
                f"{name}: the secant F/u loses {own:.3g} % and the tangent {other:.3g} %: a preload or the spall "
                "moves the rings without this force, so F/u is no measure of stiffness here; use "
                "stiffness.definition = 'tangent'"
            )
    return found


def _rollers_on_edges(scene: Scene, found: Solution) -> int:
    """How many loaded rollers stand on a spall's rolling edge: their contact reaches over it. On the outer raceway, at
    one phase."""
    if effect_base.among(scene.effects, Through) is not None:
        return 0
    on_edge = set[tuple[int, int]]()
    for spall in roller_places.spalls_on(scene.spalls, "outer"):
        near = rollers_at(scene, found, spall).on_edges
        on_edge.update((spall.row, int(j)) for j in np.flatnonzero(near))
    return len(on_edge)
