"""A map in the ring: on which side of its middle its damage lies, along the roller and in the rolling direction."""

import dataclasses

import numpy as np
import pytest

import difftrb as trb
from difftrb.core import geometry

PITCH = 0.2
ALONG, ACROSS = (np.arange(80) - 39.5) * PITCH, (np.arange(60) - 29.5) * PITCH
"""Places of a map's rows and columns [mm]."""
UPRIGHT = trb.effects.Raceways(rollers="upright")


def pit(rows: np.ndarray, columns: np.ndarray, **more) -> trb.HeightMap:
    return trb.HeightMap(np.where(rows[:, None] & columns[None, :], -0.2, 0.0), PITCH, PITCH, **more)


def on_one_side(**more) -> trb.HeightMap:
    """Damaged from 0.5 to 3.5 mm ahead of its middle."""
    return pit(np.abs(ALONG) < 2.0, (ACROSS > 0.5) & (ACROSS < 3.5), **more)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("surface", "angle", "phase"),
    [("outer", 0.0, 0.03), ("outer", 0.0, -0.03), ("inner", 0.0, 0.03), ("roller", 0.0, 0.0), ("roller", np.pi, 0.0)],
)
def test_columns_follow_the_angle(bearing: trb.TaperedBearing, surface: str, angle: float, phase: float) -> None:
    """As a spall's place does: in the ring maps stood the other way round, 1649 N were carried over a pit for 1285."""
    radius = geometry.mean_roller_radius(bearing) if surface == "roller" else geometry.arc_radius(bearing, surface)
    acting = () if surface == "outer" else (UPRIGHT,)
    for ahead in (-2.0, 2.0) if surface == "roller" else (0.0,):
        place = angle + ahead / radius
        scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), on_one_side(surface=surface, angle=place), phase=phase,
                          effects=acting, accuracy=1e-2)  # fmt: skip
        alike = trb.Spall(4.0, 3.0, angle=place + 2.0 / radius, surface=surface)
        loads = [float(trb.solve(each).check().loads[0]) for each in (scene, scene.replace(spalls=alike))]
        assert loads[0] == pytest.approx(loads[1], rel=0.02)  # walls of a map slope over a pitch


@pytest.mark.slow
def test_rollers_lean_away_from_what_lies_aside_in_a_map(bearing: trb.TaperedBearing) -> None:
    """They stayed upright unless `axial_offset` said that it is aside: the loss was 7 … 22 % short."""
    columns = np.abs(ACROSS) < 3.5
    aside = pit(np.abs(ALONG - 2.8) < 2.25, columns)
    scenes = [
        trb.Scene(bearing, trb.Load(9000.0, 4500.0), each, effects=(trb.effects.Raceways(),))
        for each in (aside, pit(np.abs(ALONG) < 2.25, columns, axial_offset=2.8))
    ]
    one, other = (trb.solve(scene).check() for scene in scenes)
    np.testing.assert_allclose(one.stiffness, other.stiffness, rtol=1e-9, atol=1.0)
    np.testing.assert_allclose(one.effects["roller_tilts"], other.effects["roller_tilts"], atol=1e-9)
    assert abs(one.effects["roller_tilts"][0]) > 0.1


def test_which_maps_are_alike_at_both_ends() -> None:
    middle = pit(np.abs(ALONG) < 2.0, np.abs(ACROSS) < 3.0)
    assert not middle.off_middle
    assert dataclasses.replace(middle, axial_offset=1.0).off_middle
    assert pit(ALONG > 0.0, np.abs(ACROSS) < 3.0).off_middle
    one = on_one_side()
    np.testing.assert_array_equal(one.turned_over().height, one.height[:, ::-1])
    assert trb.Spall(1.0, 1.0, axial_offset=0.5).off_middle
