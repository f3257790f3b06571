"""Bearings for tests that need many rollers."""

import dataclasses

import difftrb as trb


def of_many(bearing: trb.TaperedBearing, rollers: int) -> trb.TaperedBearing:
    """With that many rollers, thinner ones if they would not fit side by side, and the same outer raceway."""
    thinner = min(1.0, bearing.rollers / rollers)
    angle = thinner * bearing.roller_angle
    return dataclasses.replace(
        bearing, rollers=rollers, roller_angle=angle, inner_angle=bearing.outer_angle - 2.0 * angle,
        roller_small_diameter=thinner * bearing.roller_small_diameter,
        roller_large_diameter=thinner * bearing.roller_large_diameter,
    )  # fmt: skip
