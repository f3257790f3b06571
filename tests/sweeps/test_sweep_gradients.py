"""A sweep's gradients: those of `jax.grad` member by member, and central differences along its axes."""

import dataclasses

import jax
import numpy as np
import pytest

import difftrb as trb

pytestmark = pytest.mark.gradient

KEYS = ("spall.0.length", "spall.0.width")


def test_gradients_are_those_of_solve_and_differences(bearing: trb.TaperedBearing) -> None:
    """Mean over phases, so that width acts under a hard window."""
    step = 1e-4
    base = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), trb.liu2018(), phase="mean")
    given = {"spall.0.length": [4.0 - step, 4.0, 4.0 + step], "spall.0.width": [5.0 - step, 5.0, 5.0 + step]}
    names = ("radial_stiffness", "axial_stiffness")
    swept = trb.sweep(names, base, given, KEYS)
    spall = dataclasses.replace(base.spalls[0], width=5.0)
    slopes = jax.grad(lambda s: trb.solve(s).radial_stiffness)(dataclasses.replace(base, spalls=(spall,)))
    found = swept.gradients["radial_stiffness"]
    assert found[KEYS[0]][1, 1] == pytest.approx(float(slopes.spalls[0].length), rel=1e-9)
    assert found[KEYS[1]][1, 1] == pytest.approx(float(slopes.spalls[0].width), rel=1e-9)
    for name in names:
        values = swept.values[name]
        differences = (values[2, 1] - values[0, 1]) / (2.0 * step), (values[1, 2] - values[1, 0]) / (2.0 * step)
        at_middle = [swept.gradients[name][key][1, 1] for key in KEYS]
        np.testing.assert_allclose(at_middle, differences, rtol=1e-5)
