"""Rollers that take up load several times within a pitch, for the ring sinks faster than they leave."""

import dataclasses

import jax
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.ring import load_zone_ends, phase_kinks
from difftrb.scene import cage_phases, prepared_scene

pytestmark = pytest.mark.exact

MANY = 8000
SMALL = trb.TaperedBearing(2.22221, 3.16815, 7.56302, 7, 0.245451, 0.120539, 0.0624558, 1.5621)
WIDE = trb.TaperedBearing(3.70211, 4.37277, 6.39021, 17, 0.440232, 0.335377, 0.0524275, 1.5621)
SHORT = trb.TaperedBearing(13.2332, 21.1189, 41.2608, 7, 0.371569, 0.18103, 0.0952697, 1.5621)
SCENES = {
    "one leaves, comes back and leaves": trb.Scene(
        SMALL, trb.Load(107.434, 40.3686), (trb.Spall(3.2628, 3.38233, depth=0.06, angle=0.125212),),
        "table", design_load=564.599, phase="mean"),
    "of seventeen": trb.Scene(
        WIDE, trb.Load(3058.16, 1800.73), (trb.Spall(3.80744, 7.38558, depth=0.09, angle=0.15647),),
        "table", design_load=673.363, phase="mean"),
    "aside": trb.Scene(
        SHORT, trb.Load(34606.2, 20227.5),
        (trb.Spall(21.9077, 9.4372, depth=0.4, angle=-0.1991, axial_offset=7.36568),),
        "table", design_load=30872.2, phase="mean"),
    "of a packaged bearing": trb.Scene(
        "32008J", trb.Load(9000.0, 2500.0), (trb.Spall(10.0, 9.0, angle=0.1),), "table", phase="mean"),
}  # fmt: skip
STEP = 1e-3
"""Of differences, of the values."""


def diagonal(scene: trb.Scene) -> jax.Array:
    return trb.solve(scene).stiffness.diagonal()


@pytest.mark.parametrize("name", SCENES)
def test_stiffness_is_that_of_many_phases(name: str) -> None:
    """It was up to 1.5e-3 off."""
    scene = SCENES[name]
    at = (np.arange(MANY) + 0.5) / MANY * float(geometry.roller_pitch(scene.bearing))
    with np.errstate(all="ignore"):
        many = xp.values(prepared_scene.at_phases(xp.numbers(trb.prepare(scene)), at))
    np.testing.assert_allclose(diagonal(scene), many.tangent.mean(0).diagonal(), rtol=1e-5)


@pytest.mark.gradient
@pytest.mark.parametrize("name", SCENES)
def test_derivatives_are_those_of_differences(name: str) -> None:
    """They were up to a factor of two off, some with the wrong sign: slopes were those of secants across the kink."""
    scene = SCENES[name]
    slopes = jax.jacrev(diagonal)(scene)
    for field in ("radial", "length", "width", "angle"):
        part = slopes.load if field == "radial" else slopes.spalls[0]
        value = float(getattr(scene.load if field == "radial" else scene.spalls[0], field))
        more, less = (np.asarray(diagonal(scene.replace(**{field: value * (1.0 + s * STEP)}))) for s in (1.0, -1.0))
        wanted = (more - less) / (2.0 * STEP * value)
        size = 5e-3 * np.abs(wanted).max()
        np.testing.assert_allclose(getattr(part, field), wanted, rtol=5e-3, atol=size, err_msg=field)


def test_a_program_finds_as_many_ends() -> None:
    """It has phases for all that there may be; those of ends that are not there weigh nothing."""
    scene = SCENES["of a packaged bearing"]
    ours, theirs = trb.solve(scene), jax.jit(trb.solve)(scene)
    for name in ("stiffness", "loads", "load_span", "stiffness_span"):
        one, other = np.asarray(getattr(ours, name)), np.asarray(getattr(theirs, name))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-11 * np.abs(other).max(), err_msg=name)


@pytest.mark.parametrize("of", ["numbers", "program"])
@pytest.mark.parametrize("steep", [1.0, 1e3, 1e6])
def test_ends_are_found_between_phases(of: str, steep: float) -> None:
    """Where rings give way nearly at once, too; a jump is none."""
    places = np.array([0.23, 0.81])

    def near(at):
        smooth = at[..., None] - places
        bent = np.sign(smooth) * np.abs(smooth) ** np.array([3.0, 1.0])
        jump = np.where(at[..., None] > 0.5, steep, -1.0)
        return np.concatenate([np.where(smooth > 0.0, steep, 1.0) * bent, jump], axis=-1)

    def as_wanted(found):
        return jax.numpy.asarray(found) if of == "program" else found

    even = np.linspace(0.0, 1.0, 5)
    passing = load_zone_ends.between(as_wanted(even), as_wanted(near(even)), 4)
    for _ in range(phase_kinks.MOST_ROUNDS):
        at = passing.next
        passing = load_zone_ends.closer(passing, at, as_wanted(near(np.asarray(at))))
    there = np.asarray(load_zone_ends.are_there(passing, as_wanted(near(even))))
    assert sorted(np.asarray(passing.rollers)[there]) == [0, 1]
    np.testing.assert_allclose(np.sort(np.asarray(passing.front)[there]), places, atol=2e-2)


def test_what_is_not_there_takes_no_phases_of_numbers() -> None:
    """All rollers are loaded: four kinks of the spall's edges."""
    scene = trb.prepare(trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "table", phase="mean"))
    assert cage_phases.phases(scene)[0].size == 5 * 8
    light = dataclasses.replace(scene, load=trb.Load(9000.0, 2600.0))
    assert cage_phases.phases(light)[0].size == 7 * 8
