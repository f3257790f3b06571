"""Two rows: one lifted off is not there; symmetry; closed forms; half a loaded circumference as in NSK's tables.

No published loads of a double row of tapered rollers were at hand whose bearing is given in full, so either row is held
against the integrals for a single one (Sjövall 1933, as in NSK E728g), which a pair without play makes exact.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import gap
from difftrb.core import geometry, status
from difftrb.core.jax_config import jit_quickly
from difftrb.law import base
from difftrb.law.power import Palmgren, PowerLaw
from difftrb.ring import double_row, effects, life, roller_places, terms
from difftrb.scene import cage_phases
from tests.bearings import of_many

pytestmark = pytest.mark.exact

LIU = trb.liu2018()
LOAD = trb.Load(9000.0, 4500.0)
SPALLS = (trb.Spall(6.0, 7.0),)


def scene(bearing, row: effects.DoubleRow, load=LOAD, spalls=SPALLS, roller_law=LIU, more=()) -> trb.Scene:
    return trb.Scene(bearing, load, spalls, roller_law, effects=(row, *more))


@pytest.mark.parametrize("more", [(), (effects.Diameters((1e-3,) * 23),)], ids=["plain", "diameters"])
def test_a_row_lifted_off_is_not_there(bearing, more) -> None:
    alone = trb.solve(trb.Scene(bearing, LOAD, SPALLS, LIU, effects=more))
    r = trb.solve(scene(bearing, effects.DoubleRow(-0.5), more=more)).check()
    np.testing.assert_allclose(r.loads, alone.loads, rtol=1e-12, atol=1e-12 * float(alone.loads.max()))
    np.testing.assert_allclose(r.stiffness, alone.stiffness, rtol=1e-12, atol=1e-12 * float(alone.stiffness.max()))
    moved = alone.displacement + np.array([0.0, 0.0, 0.25])  # from the middle between both rows' touching
    np.testing.assert_allclose(r.displacement, moved, rtol=1e-12, atol=1e-15)
    assert float(r.effects["second_row_share"]) == 0.0


@pytest.mark.parametrize(
    "row",
    [
        effects.DoubleRow(0.01),
        effects.DoubleRow(0.01, spacing=30.0),
        effects.DoubleRow(-0.02, "face_to_face", 30.0),
    ],
    ids=["parallel", "back to back", "face to face"],
)
def test_radial_load_is_shared_equally(bearing, row) -> None:
    r = trb.solve(scene(bearing, row, trb.Load(9000.0, 0.0), ())).check()
    np.testing.assert_allclose(r.effects["second_row_loads"], r.loads, rtol=1e-11, atol=1e-9)
    assert float(r.effects["first_row_radial"]) == pytest.approx(4500.0, rel=1e-11)
    assert float(r.effects["second_row_share"]) == pytest.approx(50.0, rel=1e-11)
    np.testing.assert_allclose(np.asarray(r.displacement)[2:], 0.0, atol=1e-15)


def test_without_play_half_of_either_row_is_loaded_as_in_nsk_e728g(bearing) -> None:
    """Q = 4.08 F/(Z cosα) and an axial force of 1.26 F tanα, F a row's radial load: ε = 0.5, line contact."""
    many = of_many(bearing, 201)
    r = trb.solve(scene(many, effects.DoubleRow(), trb.Load(9000.0, 0.0), (), Palmgren(bearing.roller_length)))
    alpha = float(bearing.outer_angle)
    assert float(r.check().loads.max()) == pytest.approx(4.08 * 4500.0 / (201 * np.cos(alpha)), rel=2e-3)
    assert float(r.effects["first_row_axial"]) == pytest.approx(1.26 * 4500.0 * np.tan(alpha), rel=2e-3)


def test_axial_load_on_a_preloaded_pair(bearing) -> None:
    """F = Z sinα K ((p/2 + u)ⁿ − (p/2 − u)ⁿ) sinⁿα; stiff by both rows until the second one is lifted off."""
    K, n = (float(v) for v in LIU.coefficients(jnp.zeros(())))
    sin = np.sin(float(bearing.outer_angle))
    for u in (0.001, 0.006, 0.02):
        rows = np.maximum(sin * np.array([0.005 + u, 0.005 - u]), 0.0)
        force = 23 * sin * K * (rows[0] ** n - rows[1] ** n)
        r = trb.solve(scene(bearing, effects.DoubleRow(0.01), trb.Load(0.0, force), ())).check()
        assert float(r.displacement[2]) == pytest.approx(u, rel=1e-11)
        assert float(r.axial_stiffness) == pytest.approx(23 * sin**2 * K * n * (rows ** (n - 1.0)).sum(), rel=1e-10)


@pytest.mark.parametrize(("arrangement", "side"), [("back_to_back", 1.0), ("face_to_face", -1.0)])
def test_spread_holds_the_tilt(bearing, arrangement, side: float) -> None:
    """Z k λ² about either axis, λ the distance of load centres from the middle, square to the normals."""
    row = effects.DoubleRow(0.02, arrangement, spacing=40.0)
    r = trb.solve(scene(bearing, row, trb.Load(1e-6, 0.0), ())).check()
    K, n = (float(v) for v in LIU.coefficients(jnp.zeros(())))
    alpha = float(bearing.outer_angle)
    slope = n * K * (0.01 * np.sin(alpha)) ** (n - 1.0)
    centre = float(geometry.outer_raceway_radius(bearing)) * np.tan(alpha)
    lever = np.cos(alpha) * (centre + side * 20.0)
    expected = 23 * slope * np.array([np.cos(alpha) ** 2] * 2 + [2.0 * np.sin(alpha) ** 2] + [lever**2] * 2)
    np.testing.assert_allclose(np.diag(r.stiffness), expected, rtol=1e-8)
    coupled = np.asarray(r.stiffness) - np.diag(np.diag(r.stiffness))
    np.testing.assert_allclose(coupled, 0.0, atol=1e-8 * expected.max())


def test_moments_and_loads_balance_and_stiffness_is_their_derivative(bearing) -> None:
    def solved(radial=0.0, axial=0.0, about=0.0) -> trb.Solution:
        row = effects.DoubleRow(0.02, spacing=30.0, moment_radial=-2e4, moment_lateral=1e5 + about)
        return trb.solve(scene(bearing, row, trb.Load(9000.0 + radial, 4500.0 + axial))).check()

    r = solved()
    every = np.concatenate([r.loads, r.effects["second_row_loads"]])
    reach = double_row.reach_of_pair(bearing, 30.0, True)
    angles = np.asarray(roller_places.roller_angles(bearing, 0.0))
    turned = float(reach) * np.stack([np.sin(angles), -np.cos(angles)])
    np.testing.assert_allclose(np.hstack([turned, -turned]) @ every, [-2e4, 1e5], atol=1e-9 * 3e5)
    normals = np.asarray(terms.of_rows(roller_places.directions(bearing, np.tile(angles, 2))))
    np.testing.assert_allclose(normals.T @ every, [9000.0, 0.0, 4500.0], atol=1e-9 * 9000.0)
    assert float(r.residual) < 1e-9
    compliance = np.linalg.inv(np.asarray(r.stiffness))
    for column, step in ((0, {"radial": 1.0}), (2, {"axial": 1.0}), (4, {"about": 10.0})):
        ((name, h),) = step.items()
        moved = (np.asarray(solved(**step).displacement) - np.asarray(solved(**{name: -h}).displacement)) / (2.0 * h)
        np.testing.assert_allclose(moved, compliance[:, column], rtol=1e-5, atol=1e-7 * np.abs(moved).max())


def test_slices_carry_a_pair_as_whole_rollers_do(bearing) -> None:
    """One slice is a whole roller without crown, c_L δ^(10/9); moments of both effects add up."""
    palmgren = Palmgren(bearing.roller_length)
    K = jnp.log(jnp.reshape(gap.lamina_stiffness(bearing.roller_length), 1))
    same = PowerLaw(jnp.zeros(1), K, jnp.array([10 / 9]), (0.0, np.inf), np.nan, 0.0, "given")
    row = effects.DoubleRow(0.02, spacing=30.0, moment_lateral=1e5)
    whole = trb.solve(scene(bearing, row, spalls=(), roller_law=same)).check()
    one = trb.solve(scene(bearing, row, spalls=(), roller_law=palmgren, more=(effects.Tilt(slices=1),))).check()
    np.testing.assert_allclose(one.stiffness, whole.stiffness, rtol=1e-9, atol=1e-9 * float(whole.stiffness.max()))
    halves = dataclasses.replace(row, moment_lateral=4e4), effects.Tilt(0.0, 6e4, slices=1)
    both = trb.solve(scene(bearing, halves[0], spalls=(), roller_law=palmgren, more=halves[1:])).check()
    np.testing.assert_allclose(both.loads, one.loads, rtol=1e-11)


def test_one_row_alone_holds_no_tilt(bearing) -> None:
    loose = effects.DoubleRow(-0.2, spacing=30.0)
    r = trb.solve(scene(bearing, loose, trb.Load(0.0, 4500.0), ()))
    assert int(r.status_code) == status.LOOSE
    assert bool(jnp.isnan(r.stiffness).all())
    sliced = scene(bearing, loose, trb.Load(0.0, 4500.0), (), Palmgren(bearing.roller_length), (effects.Tilt(),))
    alone = dataclasses.replace(
        sliced, effects=(effects.Tilt(reach=float(double_row.reach_of_pair(bearing, 30.0, True))),)
    )
    np.testing.assert_allclose(trb.solve(sliced).check().loads, trb.solve(alone).check().loads, rtol=1e-11)


@pytest.mark.parametrize("preload", [-1.0, -0.1, -1e-6, 0.0, 1e-9, 0.01, 1.0])
@pytest.mark.parametrize("load", [(9000.0, 0.0), (1.0, 100.0), (1e6, 2e5), (0.0, 4500.0), (0.0, 0.0)], ids=str)
@pytest.mark.parametrize("spacing", [None, 30.0], ids=["parallel", "tilting"])
def test_every_load_and_preload_has_an_equilibrium(bearing, preload: float, load, spacing) -> None:
    """And finite derivatives; but for a shaft that tilts, if nothing presses the second row."""
    deep = tuple(dataclasses.replace(spall, depth=10.0) for spall in SPALLS)  # 1e6 N press rollers on any other bottom
    start = scene(bearing, effects.DoubleRow(preload, spacing=spacing), trb.Load(*load), deep)
    r = _solved(start)
    if load == (0.0, 0.0) and preload <= 0.0:  # nothing presses
        assert int(r.status_code) in (status.NO_EQUILIBRIUM, status.UNPRESSED)
        return
    if spacing is not None and load == (0.0, 4500.0) and preload <= 0.01:  # 4500 N lift it off
        assert int(r.status_code) == status.LOOSE
        return
    if spacing is not None and load == (1.0, 100.0) and preload <= -0.1:  # one roller of the second row is touched
        assert int(r.status_code) == status.FREE
        return
    assert bool(r.converged)
    assert float(r.residual) < 1e-9
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(_slopes(start)))


_solved = jax.jit(trb.solve)
_slopes = jax.jit(jax.grad(lambda s: (lambda r: r.stiffness[0, 0] + r.loads[0])(trb.solve(s))))


@pytest.mark.parametrize(
    "name", ["radial", "axial", "preload", "spacing", "moment_lateral", "length", "width", "outer_angle"]
)
def test_derivatives_equal_differences(bearing, name: str) -> None:
    """In the mean over phases, all rollers loaded, so that nothing but the spall's edges has kinks; 1e-6."""
    value = {"radial": 3000.0, "axial": 4500.0, "preload": 0.05, "spacing": 30.0, "moment_lateral": 2e4,
             "length": 6.0, "width": 7.0, "outer_angle": float(bearing.outer_angle)}  # fmt: skip
    h = 1e-4 * value[name]
    slope = _mean_slope(value, {other: float(other == name) for other in value}, bearing)
    above, below = (_mean_values(value | {name: value[name] + side * h}, bearing) for side in (1.0, -1.0))
    differences = (np.asarray(above) - np.asarray(below)) / (2.0 * h)
    np.testing.assert_allclose(slope, differences, rtol=1e-6, atol=1e-6 * np.abs(differences).max())


def _of_mean(v: dict[str, jax.Array], bearing) -> jax.Array:
    """Stiffness and shares of the rows in the mean over phases."""
    row = effects.DoubleRow(v["preload"], spacing=v["spacing"], moment_lateral=v["moment_lateral"])
    mean = trb.Scene(
        dataclasses.replace(bearing, outer_angle=v["outer_angle"]), trb.Load(v["radial"], v["axial"]),
        (trb.Spall(v["length"], v["width"]),), LIU, phase="mean", effects=(row,),
    )  # fmt: skip
    r = trb.solve(mean)
    return jnp.stack([r.stiffness[0, 0], r.stiffness[2, 2], r.stiffness[4, 4], r.effects["second_row_radial"]])


_mean_values = jit_quickly()(_of_mean)
_mean_slope = jit_quickly()(lambda v, along, bearing: jax.jvp(lambda v: _of_mean(v, bearing), (v,), (along,))[1])
"""One program for every direction."""


def test_where_load_zones_end_phases_are_divided_for_both_rows(bearing) -> None:
    """The mean is that of 500 equal steps also where either row has unloaded rollers."""
    start = dataclasses.replace(scene(bearing, effects.DoubleRow(0.02), spalls=()), phase="mean")
    phases = (jnp.arange(500) + 0.5) / 500 * geometry.roller_pitch(bearing)
    every = jax.jit(jax.vmap(lambda p: trb.solve(dataclasses.replace(start, phase=p)).stiffness))(phases)
    borders = [jax.eval_shape(lambda one=one: cage_phases.pitch_borders(one)).size
               for one in (dataclasses.replace(start, effects=()), start)]  # fmt: skip
    assert borders == [4, 6]
    mean = jnp.mean(every, axis=0)
    np.testing.assert_allclose(trb.solve(start).stiffness, mean, atol=3e-5 * float(mean.max()))


def test_life_of_two_rows(bearing) -> None:
    """ISO 281: 2^(7/9) of a row's rating; both rows' reference life, equal ones living 2^(−8/9) as long."""
    one = float(life.load_rating(bearing))
    assert float(life.load_rating(bearing, 2)) == pytest.approx(2.0 ** (7 / 9) * one, rel=1e-12)
    assert float(life.equivalent_load(bearing, 1000.0, 0.0, 2)) == 1000.0
    tan = float(np.tan(bearing.outer_angle))
    assert float(life.equivalent_load(bearing, 1000.0, 300.0, 2)) == pytest.approx(1000.0 + 135.0 / tan, rel=1e-12)
    assert float(life.equivalent_load(bearing, 0.0, 300.0, 2)) == pytest.approx(201.0 / tan, rel=1e-12)
    radial = trb.Load(9000.0, 0.0)
    r = trb.solve(scene(bearing, effects.DoubleRow(), radial, (), more=(effects.Life(),))).check()
    row = life.reference(bearing, one, r.loads, r.loads)
    assert float(r.effects["reference_life"]) == pytest.approx(2.0 ** (-8 / 9) * float(row), rel=1e-9)
    off = trb.solve(scene(bearing, effects.DoubleRow(-0.5), spalls=(), more=(effects.Life(),))).check()
    alone = life.reference(bearing, one, off.loads, off.loads)
    assert float(off.effects["reference_life"]) == pytest.approx(float(alone), rel=1e-12)


def test_basic_life_of_a_preloaded_pair_is_that_of_its_rows(bearing) -> None:
    """Of the load alone it was 153 times as long as of one row held at half the preload under half the load."""
    pair = scene(bearing, effects.DoubleRow(0.03), trb.Load(3000.0, 0.0), (), more=(effects.Life(),))
    row = dataclasses.replace(pair, load=trb.Load(1500.0, 0.0), effects=(effects.Mounting(0.015), effects.Life()))
    both, alone = (trb.solve(each).check() for each in (pair, row))
    ratio = float(both.effects["basic_life"]) / float(alone.effects["basic_life"])
    assert ratio == pytest.approx(2.0 ** (-8 / 9), rel=1e-9)
    loaded = dataclasses.replace(pair, load=trb.Load(0.0, 4500.0), effects=(effects.DoubleRow(-0.1), effects.Life()))
    slope = jax.grad(lambda s: trb.solve(s).effects["basic_life"])(loaded).load.axial  # the second row carries nothing
    assert np.isfinite(float(slope))
    assert float(slope) < 0.0


def test_a_law_at_edges_meets_the_first_row_only(bearing, power) -> None:
    """A spall under all rollers of the first row is none to the second one."""
    wide = (trb.Spall(4.0, 174.0),)
    spalled, sound = (
        trb.solve(scene(bearing, effects.DoubleRow(0.02), trb.Load(0.0, 4500.0), spalls, power)).check()
        for spalls in (wide, ())
    )
    assert bool((spalled.loads < sound.loads).all())  # softer, so that the second row is relieved less
    mine = spalled.effects["second_row_loads"]
    np.testing.assert_allclose(mine, mine[0], rtol=1e-10)
    approach = 0.01 * np.sin(bearing.outer_angle) - spalled.displacement[2] * np.sin(bearing.outer_angle)
    assert float(base.load_over(power, jnp.asarray(approach))[0]) == pytest.approx(float(mine[0]), rel=1e-10)


def test_what_a_pair_cannot_have_is_said(bearing) -> None:
    def refused(message: str, row: effects.DoubleRow, *more, name="palmgren") -> None:
        with pytest.raises(ValueError, match=message):
            trb.solve(scene(bearing, row, spalls=(), roller_law=name, more=more))

    refused(r"spacing is missing: moment_lateral", effects.DoubleRow(moment_lateral=1.0))
    refused(r"effects\.double_row and effects\.mounting exclude", effects.DoubleRow(), effects.Mounting())
    refused(r"spacing is missing: effects\.tilt needs it", effects.DoubleRow(), effects.Tilt())
    refused(r"rings = 'parallel' and effects\.double_row\.spacing", effects.DoubleRow(spacing=9.0),
            effects.Tilt(rings="parallel"))  # fmt: skip
    refused(r"tilt\.reach must be 0", effects.DoubleRow(spacing=9.0), effects.Tilt(reach=1.0))
    together = 2.0 * float(geometry.outer_raceway_radius(bearing)) * np.tan(float(bearing.outer_angle))
    refused(r"load centres in one place", effects.DoubleRow(0.0, "face_to_face", together))
