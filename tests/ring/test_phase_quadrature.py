"""The mean over cage phases, against many phases."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.scene import cage_phases, largest_roller_load, prepared_scene

pytestmark = pytest.mark.exact

MANY = 2000


@pytest.fixture(scope="module")
def scene(bearing) -> trb.Scene:
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 5.0),), law="liu2018", phase="mean")


def brute(scene: trb.Scene, values) -> jax.Array:
    """The mean of `values(solution)` over many equal steps of phase."""
    phases = (jnp.arange(MANY) + 0.5) / MANY * geometry.roller_pitch(scene.bearing)
    every = jax.jit(jax.vmap(lambda p, s: values(trb.solve(dataclasses.replace(s, phase=p))), (0, None)))
    return jnp.mean(every(phases, scene), axis=0)


def test_weights_are_a_mean(scene) -> None:
    phases, weights = cage_phases.phases(trb.prepare(scene))
    assert phases.shape == weights.shape == (24,)  # all rollers are loaded: there are two kinks
    assert float(weights.sum()) == pytest.approx(1.0, abs=1e-12)
    assert float(weights.min()) > -1e-15  # two kinks may coincide
    assert 0.0 <= float(phases.min()) <= float(phases.max()) <= float(geometry.roller_pitch(scene.bearing))


def test_mean_is_that_of_many_phases(scene) -> None:
    """50 phases against 2000, whose own error is a jump of 3 % times one step in 2000."""
    r = trb.solve(scene).check()
    stiffness, loads = brute(scene, lambda s: s.stiffness), brute(scene, lambda s: s.loads)
    np.testing.assert_allclose(r.stiffness, stiffness, atol=3e-5 * float(stiffness.max()))
    np.testing.assert_allclose(r.loads, loads, atol=1e-4 * float(loads.max()))
    assert (np.asarray(r.stiffness_span[0]) <= np.asarray(r.stiffness) + 1e-6).all()
    assert (np.asarray(r.stiffness_span[1]) >= np.asarray(r.stiffness) - 1e-6).all()


@pytest.mark.gradient
@pytest.mark.parametrize("spall", [None, trb.Spall(6.0, 6.0, angle=-0.9)])
def test_rollers_that_differ_take_up_load_each_at_its_own_place(bearing, spall: trb.Spall | None) -> None:
    """With kinks where all would be alike stiffness was 1.3e-3 off, and its derivatives 9 … 28 %."""
    few = dataclasses.replace(bearing, rollers=8)
    acting = trb.effects.Diameters((-0.0018, -0.0014, -0.0034, 0.0014, -0.003, -0.002, 0.001, 0.001))
    spalls = () if spall is None else (spall,)
    mean = trb.prepare(trb.Scene(few, trb.Load(9000.0, 4200.0), spalls, "table", phase="mean", effects=(acting,)))
    phases = (np.arange(MANY) + 0.5) / MANY * geometry.roller_pitch(few)

    def stiffness(axial: float) -> tuple[np.ndarray, np.ndarray]:
        at = mean.replace(axial=axial)
        many = prepared_scene.at_phases(xp.numbers(at.replace(phase=0.0)), phases).tangent
        return np.diag(np.asarray(trb.solve(at).stiffness)), np.diag(many.mean(axis=0))

    np.testing.assert_allclose(*stiffness(4200.0), rtol=3e-5)
    ends = [stiffness(axial) for axial in (4198.0, 4202.0)]
    of_mean, of_many = (np.subtract(b, a) / 4.0 for a, b in zip(*ends, strict=True))
    slope = jax.jacfwd(lambda axial: trb.solve(mean.replace(axial=axial)).stiffness)(4200.0)
    np.testing.assert_allclose(np.diag(np.asarray(slope)), of_mean, rtol=2e-3)
    np.testing.assert_allclose(of_mean, of_many, rtol=1e-2)


@pytest.mark.parametrize(
    "spalls",
    [
        (trb.Spall(6.147, 4.575, angle=0.451),),
        (trb.Spall(6.995, 6.567, angle=-0.265),),
        (trb.Spall(5.0, 5.0), trb.Spall(4.0, 6.0, angle=0.6), trb.Spall(5.0, 4.0, angle=0.3, surface="inner")),
    ],
)
def test_with_both_raceways_losses_are_those_of_many_phases(bearing, spalls: tuple[trb.Spall, ...]) -> None:
    """A roller over a spall leaves more of the approach to its contact there: with the healthy share 2e-3 off."""
    acting = trb.effects.Raceways(rollers="upright")
    mean = trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 4500.0), spalls, "table", phase="mean", effects=(acting,)))
    phases = (np.arange(2 * MANY) + 0.5) / (2 * MANY) * geometry.roller_pitch(bearing)
    every = prepared_scene.at_phases(xp.numbers(mean.replace(phase=0.0)), phases).tangent.mean(axis=0)
    whole = np.asarray(trb.assess(mean).healthy.both_stiffnesses)
    exact = 100.0 * (1.0 - np.diag(every)[[0, 2]] / whole)
    np.testing.assert_allclose(trb.assess(mean).loss, exact, rtol=6e-4)


def test_width_acts_on_the_mean_through_the_window_alone(scene) -> None:
    """A hard window is open for a share of the pitch that grows with width: the slope is the jump times that."""

    def stiffness(s: trb.Scene) -> jax.Array:
        return trb.solve(s).stiffness[0, 0]

    def wide(width: float) -> trb.Scene:
        return dataclasses.replace(scene, spalls=(trb.Spall(4.0, width),))

    slope = float(jax.grad(stiffness)(scene).spalls[0].width)
    h = 0.2
    assert slope == pytest.approx(float(stiffness(wide(5 + h)) - stiffness(wide(5 - h))) / (2 * h), rel=1e-2)
    change = brute(wide(5 + h), lambda s: s.stiffness[0, 0]) - brute(wide(5 - h), lambda s: s.stiffness[0, 0])
    assert slope == pytest.approx(float(change) / (2 * h), rel=1e-2)
    assert slope < -1e3


@pytest.mark.portable
@pytest.mark.parametrize("leaf", ["length", "angle", "width"])
def test_derivatives_forward_and_reverse(scene, leaf: str) -> None:
    moved = dataclasses.replace(scene, spalls=(trb.Spall(4.0, 5.0, angle=0.1),))

    def stiffness(value: jax.Array) -> jax.Array:
        spall = dataclasses.replace(moved.spalls[0], **{leaf: value})
        return trb.solve(dataclasses.replace(moved, spalls=(spall,))).stiffness[2, 2]

    at = jnp.asarray(getattr(moved.spalls[0], leaf))
    forward, reverse = float(jax.jacfwd(stiffness)(at)), float(jax.grad(stiffness)(at))
    h = 1e-4
    assert forward == pytest.approx(reverse, rel=1e-8, abs=1e-6)
    assert forward == pytest.approx(float(stiffness(at + h) - stiffness(at - h)) / (2 * h), rel=1e-4)


def test_the_load_zone_moves_with_the_load(bearing) -> None:
    """Its ends are kinks, too. Held fast, they left the derivative by the load of a narrow zone 40 % off."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 2650.0), law="liu2018", phase="mean")

    def stiffness(radial: jax.Array | float) -> jax.Array:
        return trb.solve(dataclasses.replace(scene, load=trb.Load(radial, 2650.0))).stiffness[0, 0]

    def many(radial: float) -> jax.Array:
        return brute(dataclasses.replace(scene, load=trb.Load(radial, 2650.0)), lambda s: s.stiffness[0, 0])

    slope = float(jax.grad(stiffness)(9000.0))
    assert slope == pytest.approx(float(stiffness(9000.1) - stiffness(8999.9)) / 0.2, rel=1e-5)
    assert slope == pytest.approx(float(many(9010.0) - many(8990.0)) / 20.0, rel=0.1)  # of the power law near its zero


def test_pure_axial_load_and_no_spall_have_a_mean(bearing) -> None:
    """No kinks at all, or as good as none: still a mean, of what does not change."""
    scene = trb.Scene(bearing, trb.Load(0.0, 4500.0), law="liu2018", phase="mean")
    r = trb.solve(scene).check()
    one = trb.solve(dataclasses.replace(scene, phase=0.03))
    np.testing.assert_allclose(r.stiffness, one.stiffness, atol=1e-9 * float(one.stiffness.max()))


def fewer(bearing: trb.TaperedBearing, rollers: int, axial: float, *spalls: trb.Spall, **more) -> trb.Scene:
    """As many of its rollers with their share of 9000 N; with little more than the least axial load a few carry it."""
    share = rollers / bearing.rollers
    less = dataclasses.replace(bearing, rollers=rollers)
    return trb.prepare(trb.Scene(less, trb.Load(9000.0 * share, axial * share), spalls, **more))


@pytest.mark.parametrize(
    ("rollers", "axial", "spalls", "within"),
    [(5, 3500.0, (), 5e-6), (6, 2900.0, (trb.Spall(4.0, 7.0),), 1e-5), (12, 2600.0, (), 5e-6),
     (23, 2600.0, (trb.Spall(4.0, 7.0, angle=0.2),), 5e-6)],
)  # fmt: skip
def test_with_few_rollers_loaded_the_mean_is_that_of_many_phases(bearing, rollers, axial, spalls, within) -> None:
    """Of every roller, too, as it rolls from its place to the next one's: loads were those of a pitch that began at the
    first kink, up to 37 % of the largest off; and kinks were where the ring at phase 0 has them, 5e-3 of stiffness."""
    scene = fewer(bearing, rollers, axial, *spalls)
    at = (np.arange(4000) + 0.5) / 4000 * float(geometry.roller_pitch(scene.bearing))
    with np.errstate(all="ignore"):
        many = xp.values(prepared_scene.at_phases(xp.numbers(scene), at))
    mean = trb.solve(dataclasses.replace(scene, phase="mean")).check()
    assert np.abs(np.asarray(mean.loads) - many.loads.mean(0)).max() < 3e-5 * float(mean.loads.max())
    wanted = many.tangent.mean(0)
    for k in (0, 2):
        assert float(mean.stiffness[k, k]) == pytest.approx(wanted[k, k], rel=within)
    np.testing.assert_allclose(mean.load_span[1], many.loads.max(0), atol=0.01 * float(mean.loads.max()))


ROUND = {
    "narrow zone": (2650.0, (trb.Spall(4.0, 7.0),)),
    "one that turns the ring": (4500.0, (trb.Spall(11.0, 6.0),)),
    "two rollers in long ones": (4500.0, (trb.Spall(11.0, 6.0, angle=-0.13), trb.Spall(11.0, 6.0, angle=0.13))),
}


@pytest.mark.gradient
@pytest.mark.parametrize("size", ["length", "width"])
@pytest.mark.parametrize("name", ROUND)
def test_kinks_are_where_the_rings_over_spalls_have_them(bearing, name: str, size: str) -> None:
    """They were where healthy rings have them: derivatives of the mean were 10 … 50 % off."""
    axial, spalls = ROUND[name]
    scene = trb.prepare(trb.Scene(bearing, trb.Load(9000.0, axial), spalls, "table"))
    at = (np.arange(4000) + 0.5) / 4000 * float(geometry.roller_pitch(bearing))

    def with_size(value: float) -> trb.Scene:
        return dataclasses.replace(scene, spalls=(dataclasses.replace(spalls[0], **{size: value}), *spalls[1:]))

    def many(value: float) -> np.ndarray:
        with np.errstate(all="ignore"):
            return xp.values(prepared_scene.at_phases(xp.numbers(with_size(value)), at)).tangent.mean(0)

    def mean(value: float) -> jax.Array:
        return trb.solve(dataclasses.replace(with_size(value), phase="mean")).stiffness

    own, step = float(getattr(spalls[0], size)), 0.02
    slopes = np.asarray(jax.jacfwd(mean)(own))
    wanted = (many(own + step) - many(own - step)) / (2.0 * step)
    for k in (0, 2):
        assert slopes[k, k] == pytest.approx(wanted[k, k], rel=1e-2)
        assert float(mean(own)[k, k]) == pytest.approx(many(own)[k, k], rel=1e-4)


@pytest.mark.slow
@pytest.mark.gradient
def test_kinks_of_contact_solves_are_where_the_table_has_them(bearing) -> None:
    """They were where healthy rings have them: the derivative by length was a fifth off, stiffness 2e-4."""
    axial, spalls = ROUND["two rollers in long ones"]
    of = partial(trb.Scene, bearing, trb.Load(9000.0, axial), spalls, phase="mean")
    table, direct = (trb.assess(trb.prepare(scene)) for scene in (of(law="table"), of(law="direct", accuracy=1e-3)))
    np.testing.assert_allclose(direct.spalled.stiffness[0, 0], table.spalled.stiffness[0, 0], rtol=1.5e-4)
    for own, other in ((direct.by_length, table.by_length), (direct.by_width, table.by_width)):
        np.testing.assert_allclose(own, other, rtol=1e-2)


def test_a_healthy_mean_is_its_mirror_image(bearing) -> None:
    loads = np.asarray(trb.solve(trb.Scene(bearing, trb.Load(9000.0, 2600.0), phase="mean")).check().loads)
    np.testing.assert_allclose(loads, loads[-1 - np.arange(loads.size)], atol=1e-4 * loads.max())


def test_rings_with_loads_of_their_own_are_those_of_one_load_each(bearing) -> None:
    """Each is judged by itself, too: what cannot hold its load spoils no other."""
    scene = xp.numbers(trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 5.0),), "table")))
    radial, axial = np.array([9000.0, 3000.0, 9000.0, 0.0]), np.array([4500.0, 4500.0, 100.0, 3000.0])
    at = np.array([0.0, 0.1, 0.0, 0.2])
    with np.errstate(all="ignore"):
        every = xp.values(prepared_scene.at_phases(scene, at, trb.Load(radial, axial)))
        assert every.status_code.tolist() == [0, 0, 3, 0]
        for k in (0, 1, 3):
            one = dataclasses.replace(scene, load=trb.Load(float(radial[k]), float(axial[k])))
            alone = xp.values(prepared_scene.at_phases(one, at[k : k + 1]))
            np.testing.assert_allclose(every.loads[k], alone.loads[0], atol=1e-9 * alone.loads.max())
            np.testing.assert_allclose(every.tangent[k], alone.tangent[0], atol=1e-9 * alone.tangent.max())
    assert np.isnan(every.loads[2]).all()


def test_a_secant_across_a_pole_has_no_mean(bearing) -> None:
    """Within the pitch the ring's axial displacement runs through 0, and F/u to infinity on either side."""
    scene = fewer(bearing, 6, 2700.0, definition="secant")
    at = np.linspace(0.0, float(geometry.roller_pitch(scene.bearing)), 40)
    with np.errstate(all="ignore"):
        u = xp.values(prepared_scene.at_phases(xp.numbers(scene), at)).displacement
    assert u[:, 2].min() < 0.0 < u[:, 2].max()
    assert u[:, 0].min() > 0.0
    mean = trb.solve(dataclasses.replace(scene, phase="mean"))
    assert np.isnan(mean.stiffness[2, 2])
    assert np.isnan(mean.stiffness_span[:, 2, 2]).all()
    assert float(mean.stiffness[0, 0]) > 0.0
    assert float(trb.solve(dataclasses.replace(scene, phase="mean", definition="tangent")).stiffness[2, 2]) > 0.0


@pytest.mark.parametrize("rollers", [5, 8, 23])
def test_laws_by_contact_solves_reach_the_load_of_a_narrow_zone(bearing, rollers: int) -> None:
    """They refused rings in which a few rollers carry all, for loads beyond their range."""
    for ratio in (1.001, 1.02, 1.1, 1.3, 2.0):
        least = float(np.tan(bearing.outer_angle)) * 9000.0
        scene = fewer(bearing, rollers, ratio * least, law="liu2018")
        at = 0.0 if ratio < 1.5 else 0.1
        loads = np.asarray(trb.solve(dataclasses.replace(scene, phase=at)).check().loads)
        assert 0.95 * loads.max() < largest_roller_load.largest_for_curves(scene) < 1.6 * loads.max()


@pytest.mark.parametrize("effect", [trb.effects.Mounting(-0.02), trb.effects.DoubleRow(0.02)])
def test_what_holds_a_ring_without_axial_load_is_no_narrow_zone(bearing, effect) -> None:
    """The load alone holds no ring here: a roller that carries all of it made ranges four and fourteen times as far."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 0.0), law="liu2018", effects=(effect,))
    top = float(trb.solve(scene).check().loads.max())
    assert top < largest_roller_load.largest_for_curves(scene) < 4.0 * top


def test_another_word_for_the_mean_is_refused(scene) -> None:
    with pytest.raises(ValueError, match="give an angle"):
        dataclasses.replace(scene, phase="average")


def test_sizes_that_are_none_warn_of_nothing(bearing: trb.TaperedBearing) -> None:
    """Warnings are errors here; a solve says what is wrong by its status."""
    ready = trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "table", phase="mean"))
    nothing = dataclasses.replace(ready, spalls=(trb.Spall(float("nan"), 7.0),))
    assert cage_phases.pitch_borders(nothing).size == 8
    assert "not a number" in trb.solve(nothing).status


def test_means_of_many_loads_are_divided_at_once_as_one_by_one(bearing: trb.TaperedBearing) -> None:
    """With what divides them following the spall's length and width."""
    both = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "table", phase="mean",
                     effects=(trb.effects.Raceways(rollers="upright"),))  # fmt: skip
    ready = trb.prepare(both)
    radial, axial = np.array([9000.0, 3000.0]), np.array([4500.0, 4500.0])
    for scene in (ready, prepared_scene.with_sizes_expanded(ready)):
        every = cage_phases.pitch_borders(dataclasses.replace(scene, load=trb.Load(radial, axial)))
        for k, load in enumerate(zip(radial.tolist(), axial.tolist(), strict=True)):
            one = cage_phases.pitch_borders(dataclasses.replace(scene, load=trb.Load(*load)))
            np.testing.assert_allclose(xp.value(every)[k], xp.value(one), atol=1e-12)
            if xp.by(one) is not None:
                np.testing.assert_allclose(xp.by(every)[:, k], xp.by(one), atol=1e-12)
