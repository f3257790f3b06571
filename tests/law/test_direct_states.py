"""Rollers over several spalls, or on a spall's bottom: right by contacts solved around their own load, else refused."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.law.direct_states import DirectByStates
from difftrb.scene.prepared_scene import solve_prepared

pytestmark = pytest.mark.exact

LOAD = trb.Load(9000.0, 4500.0)
ENDS = (trb.Spall(3.0, 7.0, axial_offset=-3.5), trb.Spall(3.0, 7.0, axial_offset=3.5))


def direct(bearing: trb.TaperedBearing, spalls: tuple[trb.Spall, ...], load: trb.Load = LOAD) -> trb.Scene:
    return trb.prepare(trb.Scene(bearing, load, spalls, law="direct", accuracy=1e-2))


@pytest.fixture(scope="module")
def two(bearing: trb.TaperedBearing) -> trb.Scene:
    return direct(bearing, ENDS)


@pytest.fixture(scope="module")
def shallow(bearing: trb.TaperedBearing) -> trb.Scene:
    """A bottom at 5 µm, which carries."""
    return direct(bearing, (trb.Spall(6.3, 9.0, depth=5e-3),), trb.Load(12000.0, 7000.0))


@pytest.fixture(scope="module")
def inside(bearing: trb.TaperedBearing) -> trb.Scene:
    """A roller in the middle of a wide, deep spall off its own middle."""
    spalls = (trb.Spall(4.0, 7.0, axial_offset=1.0),)
    return trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 4500.0), spalls, law="direct", accuracy=1e-2))


@pytest.mark.slow
def test_every_spall_under_a_roller_counts(two: trb.Scene) -> None:
    """Not only the longest: of two alike the loss was that of one, and the derivative by the second's length 0."""
    assert isinstance(two.law, DirectByStates)
    both = trb.assess(two)
    assert bool(both.spalled.converged)
    assert trb.verify(two, both.spalled).load_error < 3e-3
    one = trb.assess(trb.prepare(trb.Scene(two.bearing, LOAD, ENDS[:1], law="direct", accuracy=1e-2)))
    assert 1.9 < float(both.loss[0] / one.loss[0]) < 2.4
    assert jnp.all(both.by_length[0] < -2e4)
    assert abs(float(both.by_length[0, 0] / both.by_length[0, 1]) - 1.0) < 0.02  # mirror images


@pytest.mark.slow
def test_spalls_that_touch_leave_no_land(bearing: trb.TaperedBearing) -> None:
    """Two of 4 × 5 mm side by side are one of 4 × 10 mm."""
    half = 2.5 / 28.65
    parts = tuple(trb.Spall(4.0, 5.0, angle=angle) for angle in (-half, half))
    apart, whole = (trb.solve(direct(bearing, spalls)).check() for spalls in (parts, (trb.Spall(4.0, 10.0),)))
    assert abs(float(apart.radial_stiffness / whole.radial_stiffness) - 1.0) < 2e-3
    assert float(jnp.max(jnp.abs(apart.loads - whole.loads))) < 0.01 * float(whole.loads.max())


@pytest.mark.slow
def test_a_bottom_carries(shallow: trb.Scene, bearing: trb.TaperedBearing) -> None:
    """Its kink is not smoothed away by a curve over all loads: dK/dlength came out as +12 366, and is about −5 000."""
    found = trb.assess(shallow)
    audit = trb.verify(shallow, found.spalled)
    assert audit.load_error < 5e-3
    assert audit.stiffness_error.max() < 5e-3
    assert -9e3 < float(found.by_length[0, 0]) < -2e3
    deep = trb.solve(direct(bearing, (trb.Spall(6.3, 9.0),), trb.Load(12000.0, 7000.0)))
    assert float(found.spalled.loads[0]) > 1.04 * float(deep.loads[0])


@pytest.mark.slow
def test_the_local_law_by_two_routes(two: trb.Scene) -> None:
    """Reverse mode against central differences, along every spall's length and offset, load and crown."""

    def stiffness(scene: trb.Scene) -> jax.Array:
        return solve_prepared(scene).stiffness[0, 0]

    slopes = jax.jit(jax.grad(stiffness))(two)
    for number, name, h in ((0, "length", 1e-4), (1, "axial_offset", 1e-4), (1, "depth", 1e-3)):

        def changed(step: float, number: int = number, name: str = name) -> trb.Scene:
            own = dataclasses.replace(two.spalls[number], **{name: getattr(two.spalls[number], name) + step})
            return dataclasses.replace(two, spalls=tuple(own if i == number else s for i, s in enumerate(two.spalls)))

        wanted = float(stiffness(changed(h)) - stiffness(changed(-h))) / (2.0 * h)
        assert float(getattr(slopes.spalls[number], name)) == pytest.approx(wanted, rel=1e-4, abs=1.0)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves((slopes.bearing, slopes.load)))


def test_a_local_law_knows_its_scene_only(two: trb.Scene) -> None:
    codes = {
        "loads": dataclasses.replace(two, load=trb.Load(4500.0, 2250.0)),
        "place": dataclasses.replace(two, phase=0.1),
        "spalls": dataclasses.replace(two, spalls=ENDS[:1]),
    }
    for scene in codes.values():
        assert int(solve_prepared(scene).status_code) == status.OTHER_SCENE
    assert int(solve_prepared(dataclasses.replace(two, spalls=())).status_code) == status.CONVERGED


@pytest.mark.hard
@pytest.mark.parametrize(
    "change", [{"depth": 0.002}, {"width": 0.3}, {"width": 6.0, "angle": 0.035}, {"axial_offset": -1.0}]
)
def test_a_wall_or_a_bottom_that_comes_into_reach_makes_another_scene(inside: trb.Scene, change: dict) -> None:
    """Out of reach they have no slope that would tell: loads were 3 … 19 % off, and "converged" all the same."""
    assert trb.solve(inside).converged
    assert trb.solve(inside.replace(width=6.5)).converged  # out of reach before and after
    assert trb.solve(inside.replace(depth=0.5)).converged
    assert int(trb.solve(inside.replace(**change)).status_code) == status.OTHER_SCENE


@pytest.mark.parametrize("acting", [(), (trb.effects.Tilt(),), (trb.effects.Mounting(preload=-0.005),)])
def test_nothing_that_presses_is_said(bearing: trb.TaperedBearing, acting: tuple) -> None:
    """There are no contacts to solve; least squares of nothing did not converge."""
    nothing = trb.Scene(bearing, trb.Load(0.0, 0.0), law="direct", effects=acting)
    with pytest.raises(trb.SceneError, match="nothing presses the rollers"):
        trb.prepare(nothing)


@pytest.mark.parametrize("law", ["liu2018", "palmgren"])
@pytest.mark.parametrize(
    ("spalls", "code"),
    [
        (ENDS, status.SEVERAL),
        ((trb.Spall(4.0, 5.0, angle=-0.0873), trb.Spall(4.0, 5.0, angle=0.0873)), status.SEVERAL),
        ((trb.Spall(6.3, 9.0, depth=3e-3),), status.BOTTOM),
        ((trb.Spall(4.0, 5.0, angle=-0.5), trb.Spall(4.0, 5.0, angle=0.5)), status.CONVERGED),
    ],
)
def test_laws_of_one_deep_spall_say_so(
    law: str, spalls: tuple[trb.Spall, ...], code: int, bearing: trb.TaperedBearing
) -> None:
    found = trb.solve(trb.Scene(bearing, LOAD, spalls, law=law))
    assert int(found.status_code) == code
    assert bool(jnp.all(jnp.isnan(found.loads))) == (code != status.CONVERGED)


def test_a_fitted_law_says_so_too(scene: trb.Scene) -> None:
    shallow = dataclasses.replace(scene, spalls=(trb.Spall(4.0, 7.0, depth=1e-3),))
    assert int(solve_prepared(shallow).status_code) == status.BOTTOM


def test_a_law_is_made_for_what_effects_press(bearing: trb.TaperedBearing) -> None:
    """`difftrb example mounting` was made for 61 … 439 N where all rollers carry thousands, and the one over the spall
    more than its neighbours."""
    fit = trb.effects.Mounting(preload=0.01, shaft_interference=0.02, bore=40.0, warmer=15.0)
    scene = trb.prepare(
        trb.Scene(bearing, trb.Load(2000.0, 0.0), (trb.Spall(4.0, 7.0),), accuracy=1e-2, effects=(fit,))
    )
    found = trb.solve(scene).check()
    low, high = found.law.load_range
    assert float(low) < float(found.loads.min())
    assert float(found.loads.max()) < float(high)
    assert float(found.loads[0]) < 0.95 * float(found.loads[1])


def test_loads_outside_the_range_are_said(two: trb.Scene, bearing: trb.TaperedBearing) -> None:
    """A law of curves through solves knows nothing beyond them."""
    light = trb.prepare(trb.Scene(bearing, trb.Load(90.0, 45.0), law="direct", accuracy=1e-2))
    assert int(solve_prepared(light).status_code) == status.CONVERGED
    assert int(solve_prepared(dataclasses.replace(light, load=LOAD)).status_code) == status.OUTSIDE


@pytest.mark.slow
def test_a_light_roller_on_an_edge_has_its_own_curve() -> None:
    """One of 0.2 % of the design load in a ring of six: contacts were solved under nearly twice its load, and its curve
    ran on straight. Stiffness was 0.7 % off, of a result called converged."""
    bearing = trb.TaperedBearing(29.9077, 32.8888, 35.17, 6, 0.149442, 0.0647305, 0.0423557, 1.5621)
    spalls = (
        trb.Spall(12.343035, 128.8015, axial_offset=6.5638959),
        trb.Spall(22.630475, 5.74186, angle=-3.088978, axial_offset=-7.831389),
    )
    scene = trb.prepare(trb.Scene(bearing, trb.Load(11330.0, 3484.0), spalls, "direct", 35301.0))
    audit = trb.verify(scene)
    assert audit.kept
    assert audit.stiffness_error.max() < 2e-3
