"""Rings that the rollers that carry leave free to move are told so; others near them come to rest."""

import dataclasses

import jax
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.ring import holding

pytestmark = pytest.mark.hard
END_PLAY = trb.effects.Mounting(preload=-0.3)


def loose(bearing: trb.TaperedBearing, phase: float, *effects: trb.effects.Effect) -> trb.Scene:
    """Under a light radial load that few rollers carry."""
    return trb.Scene(bearing, trb.Load(300.0, 0.0), design_load=1500.0, phase=phase, effects=effects)


def unbalanced(scene: trb.Scene, solution: trb.Solution) -> float:
    """Force that is left over by the load, from the rollers' loads alone."""
    bearing, loads = scene.bearing, np.asarray(solution.loads)
    rows = [(1.0, loads)]
    if solution.effects.get("second_row_loads") is not None:
        rows.append((-1.0, np.asarray(solution.effects["second_row_loads"])))
    angles = scene.phase + 2.0 * np.pi * np.arange(bearing.rollers) / bearing.rollers
    alpha, force = bearing.outer_angle, np.zeros(3)
    for way, of_row in rows:
        along = np.stack(
            [np.cos(angles) * np.cos(alpha), np.sin(angles) * np.cos(alpha), 0.0 * angles + way * np.sin(alpha)]
        )
        force = force + along @ of_row
    return float(
        np.abs(force - [scene.load.radial, 0.0, scene.load.axial]).max() / max(scene.load.radial, scene.load.axial)
    )


def test_one_roller_alone_leaves_the_ring_free(bearing) -> None:
    """Nothing resists aside: no number stands for that, by numbers and in a program."""
    scene = loose(bearing, 0.0, END_PLAY)
    for solution in (trb.solve(scene), jax.jit(trb.solve)(scene)):
        assert int(solution.status_code) == status.FREE
        assert np.isnan(solution.stiffness).all()
    with pytest.raises(trb.SolveError, match="free to move"):
        trb.solve(scene).check()


@pytest.mark.parametrize("phase", [1e-6, 1e-3, 0.1])
def test_two_rollers_hold_it(bearing, phase: float) -> None:
    """However little the second one carries: its share is that by which the load points past the first."""
    solution = trb.solve(loose(bearing, phase, END_PLAY)).check()
    pressed = np.asarray(solution.loads) > 0.0
    assert pressed.sum() == 2
    pitch = 2.0 * np.pi / bearing.rollers
    first = 300.0 * np.sin(pitch - phase) / np.sin(pitch) / np.cos(bearing.outer_angle)
    assert float(solution.loads[0]) == pytest.approx(first, rel=1e-9)
    assert np.linalg.eigvalsh(np.asarray(solution.stiffness)[:2, :2])[0] > 0.0


@pytest.mark.parametrize("speed", [(), (trb.effects.Centrifugal(4000.0),)], ids=["at rest", "turning"])
@pytest.mark.parametrize("seed", range(3))
def test_two_thick_rollers_opposite_each_other_leave_the_ring_free(bearing, seed: int, speed) -> None:
    """Whatever rounding leaves to a third one, whose stiffness rises steeply as it is touched."""
    bearing = dataclasses.replace(bearing, rollers=10)
    thicker = np.random.default_rng(seed).uniform(-1e-3, 1e-3, 10) + 3e-3 * (np.arange(10) % 5 == 0)
    thicker[[0, 5]] = thicker[0]
    solution = trb.solve(
        trb.Scene(
            bearing, trb.Load(0.0, 300.0), law="palmgren", phase=0.3,
            effects=(trb.effects.Diameters(tuple(thicker)), *speed),
        )
    )  # fmt: skip
    assert int(solution.status_code) == status.FREE


@pytest.mark.parametrize("load", [(200.0, 200.0), (50.0, 25.0), (1.0, 0.0)], ids=str)
@pytest.mark.parametrize("rpm", [3000.0, 7000.0, 15000.0])
def test_thrown_rollers_of_a_pair_come_to_rest(bearing, load, rpm: float) -> None:
    """Also where speed alone presses all of them by more than the load does."""
    scene = trb.Scene(
        bearing, trb.Load(*load), law="palmgren", phase=0.1,
        effects=(trb.effects.DoubleRow(), trb.effects.Centrifugal(rpm)),
    )  # fmt: skip
    assert unbalanced(scene, trb.solve(scene).check()) < 1e-11


def test_where_counting_of_rollers_begins_does_not_matter(bearing) -> None:
    """Of four that differ, loaded at the edge of the cone that holds them."""
    bearing = dataclasses.replace(bearing, rollers=4)
    rng, found = np.random.default_rng(4), []
    thicker = np.array([-4.585198872530103e-05, -0.0007447586270078608, -0.0005549862681074551, 0.00012410318019941873])
    cases = [(thicker, trb.Load(60.26414212702018, 45.64427645791585))]
    cases += [(rng.uniform(-1e-3, 1e-3, 4), trb.Load(60.0, axial)) for axial in rng.uniform(21.0, 60.0, 20)]
    for thicker, load in cases:
        found = []
        for turns in range(4):
            scene = trb.Scene(
                bearing, load, law="palmgren", phase=np.pi / 4 + turns * np.pi / 2,
                effects=(trb.effects.Diameters(tuple(np.roll(thicker, -turns))),),
            )  # fmt: skip
            solution = trb.solve(scene).check()
            assert unbalanced(scene, solution) < 1e-11
            found.append(np.roll(np.asarray(solution.loads), turns))
        np.testing.assert_allclose(found, np.broadcast_to(found[0], (4, 4)), rtol=1e-8, atol=1e-8)


def test_what_holds_a_ring_is_a_matter_of_directions() -> None:
    """Three neighbours of 400 rollers hold it, as do two where it is held axially; two opposite ones do not."""
    alpha = np.radians(10.0)
    angle = 2.0 * np.pi * np.arange(400) / 400
    normals = np.stack([np.cos(angle) * np.cos(alpha), np.sin(angle) * np.cos(alpha), 0.0 * angle + np.sin(alpha)], -1)

    def free(*which: int, axial: bool = False, share: float = 1.0) -> bool:
        loads = np.zeros(400)
        loads[list(which)] = 1.0
        loads[which[-1]] = share
        return bool(holding.is_free(normals, loads, axial))

    assert not free(0, 1, 2)
    assert not free(0, 1, axial=True)
    assert not free(0, 1, 2, share=1e-8)
    assert free(0, 1)
    assert free(0, 1, 2, share=1e-10)
    assert free(0, 200, axial=True)
    assert free(7, axial=True)


@pytest.mark.parametrize(("preload", "load"), [(-1.0, 1.0), (-0.3, 10.0), (-1.0, 100.0)])
def test_much_end_play_under_a_light_load_is_no_matter_of_rounding(bearing, preload: float, load: float) -> None:
    """The way to the other raceway is ten thousand times what the load presses rollers by."""
    play = trb.effects.Mounting(preload=preload)
    for phase in np.random.default_rng(0).uniform(-3.0, 3.0, 20):
        scene = trb.Scene(bearing, trb.Load(load, 0.0), law="palmgren", phase=float(phase), effects=(play,))
        assert float(trb.solve(scene).check().residual) <= 1e-12


@pytest.mark.parametrize(
    ("load", "slices", "design_load", "more"),
    [(1.0, 30, 6500.0, ()), (500.0, 10, 1e5, ()), (300.0, 2, 6500.0, ()),
     (60.0, 10, 6500.0, (trb.effects.DoubleRow(spacing=30.0),))],
)  # fmt: skip
def test_slices_are_touched_where_the_search_begins(
    bearing, load: float, slices: int, design_load: float, more
) -> None:
    """They stand off by the crown, which a light load does not press flat."""
    scene = trb.Scene(
        bearing, trb.Load(load, 0.5 * load), law="palmgren", phase=0.1, design_load=design_load,
        effects=(trb.effects.Tilt(slices=slices), *more),
    )  # fmt: skip
    assert unbalanced(scene, trb.solve(scene).check()) < 1e-11


@pytest.mark.parametrize(("preload", "moment"), [(0.0, 5.0), (-0.05, 300.0)])
def test_a_second_row_barely_touched_holds_the_tilt(bearing, preload: float, moment: float) -> None:
    row = trb.effects.DoubleRow(preload, spacing=20.0, moment_radial=moment, moment_lateral=-0.3 * moment)
    scene = trb.Scene(bearing, trb.Load(0.0, 5000.0), law="palmgren", phase=0.1, effects=(row,))
    solution = trb.solve(scene).check()
    assert np.linalg.eigvalsh(np.asarray(solution.stiffness))[0] > 0.0
    assert 0.0 < float(solution.effects["second_row_share"]) < 0.2
    assert unbalanced(scene, solution) < 1e-11


def test_means_with_tilt_say_what_their_derivatives_are_worth(bearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 6000.0), law="palmgren", phase="mean", effects=(trb.effects.Tilt(),))
    assert any("every slice has a kink" in remark for remark in trb.solve(scene).remarks)
    assert not trb.solve(scene.replace(phase=0.1)).remarks
