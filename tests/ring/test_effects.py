"""Effects: switched to zero they leave the plain ring; closed forms; they combine; absent ones leave no trace."""

import dataclasses
import io
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console
from scipy.optimize import linprog

import difftrb as trb
from difftrb.core import geometry, status
from difftrb.core.jax_config import jit_quickly
from difftrb.law import load_curve, roller_curves
from difftrb.law.power import Palmgren, PowerLaw
from difftrb.report import run_text
from difftrb.ring import effects, life, ring, roller_balance, roller_places, tilt
from difftrb.scene import prepared_scene

pytestmark = pytest.mark.exact

LIU = trb.liu2018()
SOLID = PowerLaw(jnp.zeros(1), jnp.log(jnp.array([1e21])), jnp.array([1.2]), (0.0, np.inf), np.nan, 0.0, "given")
SERIES = effects.SeriesRaceways(None, LIU)
LOAD = trb.Load(9000.0, 4500.0)
SPALLS = (trb.Spall(6.0, 7.0),)


def plain(bearing, roller_law=LIU, load=LOAD) -> trb.Scene:
    return trb.Scene(bearing, load, SPALLS, roller_law)


def same(one: trb.Solution, other: trb.Solution, rtol: float = 1e-12) -> None:
    for name in ("loads", "stiffness", "displacement"):
        ours, theirs = (np.asarray(getattr(s, name)) for s in (one, other))
        np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=rtol * np.abs(theirs).max(), err_msg=name)


@pytest.mark.parametrize(
    "nothing",
    [
        effects.Centrifugal(0.0),
        effects.Centrifugal(0.0, "position"),
        effects.Centrifugal(7100.0, "force", "printed"),
        effects.Diameters((0.0,) * 23),
        effects.Flange(),
        effects.SeriesRaceways(None, SOLID),
        effects.Life(),
    ],
    ids=["centrifugal", "centrifugal, position", "centrifugal, printed", "diameters", "flange, rigid",
         "raceways, inner one hard", "life"],
)  # fmt: skip
def test_what_is_zero_leaves_the_plain_ring(bearing, nothing) -> None:
    same(trb.solve(dataclasses.replace(plain(bearing), effects=(nothing,))).check(), trb.solve(plain(bearing)))


def test_a_flange_as_hard_as_can_be_is_a_rigid_one(bearing) -> None:
    contact = trb.LineContact.of(bearing)
    here = effects.Ring(bearing, LOAD, SPALLS, LIU, contact, 0.0)
    hard, rigid = (here.equilibrium(flange.terms(ring.PLAIN, here)) for flange in
                   (effects.Flange("hertz", 1e60), effects.Flange()))  # fmt: skip
    np.testing.assert_allclose(hard.loads, rigid.loads, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(hard.displacement, rigid.displacement, rtol=1e-12, atol=1e-15)


def test_rings_that_have_no_rest_to_be_held_at_say_why(bearing) -> None:
    """The status is that of the state at rest, not of a search from nowhere."""
    two = (trb.Spall(3.0, 7.0, axial_offset=-3.0), trb.Spall(3.0, 7.0, axial_offset=3.0))
    held = (effects.Centrifugal(7100.0, "position"),)
    r = trb.solve(dataclasses.replace(plain(bearing), spalls=two, effects=held))
    assert r.status == status.SENTENCES[status.SEVERAL]
    r = trb.solve(dataclasses.replace(plain(bearing, load=trb.Load(9000.0, 500.0)), effects=held))
    assert r.status == status.SENTENCES[status.NO_EQUILIBRIUM]


def test_rings_held_where_they_rest_stay_there(bearing) -> None:
    rest = trb.solve(plain(bearing))
    held = plain(bearing, load=trb.Load(9000.0, 0.0))
    held = trb.solve(dataclasses.replace(held, effects=(effects.Mounting(rest.displacement[2]),))).check()
    same(held, rest, 1e-11)
    assert float(held.effects["axial_force"]) == pytest.approx(4500.0, rel=1e-11)


def test_a_through_spall_of_no_depth_is_none(bearing) -> None:
    shallow = dataclasses.replace(plain(bearing), spalls=(trb.Spall(6.0, 7.0, depth=1e-16),))
    same(
        trb.solve(dataclasses.replace(shallow, effects=(effects.Through(),))),
        trb.solve(dataclasses.replace(shallow, spalls=())),
    )
    deep = trb.solve(dataclasses.replace(plain(bearing), effects=(effects.Through(),)))
    assert float(deep.loads[0]) == 0.0


def test_one_slice_of_parallel_rings_is_a_power_law(bearing) -> None:
    """Without a crown at its middle: c_L δ^(10/9), over the spall nothing."""
    tilted = dataclasses.replace(plain(bearing, "palmgren"), effects=(effects.Tilt(slices=1, rings="parallel"),))
    K = float(35948.0 * bearing.roller_length ** (8 / 9))
    land = jnp.array([1.0, 1.0 - 6.0 / bearing.roller_length])
    two = PowerLaw(jnp.array([0.0, 6.0]), jnp.log(K * land), jnp.full(2, 10 / 9), (0.0, np.inf), np.nan, 0.0, "given")
    same(trb.solve(tilted).check(), trb.solve(plain(bearing, two)), 1e-11)


def test_a_roller_is_at_rest_between_its_three_forces(bearing) -> None:
    """Outer, inner, flange and centrifugal force add to nothing, along the axis and across it."""
    seat = roller_balance.seat(bearing)._replace(centrifugal=10.0)
    for load in (roller_load := jnp.array([seat.least_outer_load, 30.0, 800.0])):
        inner, flange = roller_balance.inner_load(seat, load), roller_balance.flange_load(seat, load)
        across = -load * jnp.cos(seat.outer) + inner * jnp.cos(seat.inner) - flange * jnp.sin(seat.flange) + 10.0
        along = load * jnp.sin(seat.outer) - inner * jnp.sin(seat.inner) - flange * jnp.cos(seat.flange)
        np.testing.assert_allclose([across, along], 0.0, atol=1e-12 * float(roller_load.max()))
    assert float(roller_balance.inner_load(seat, seat.least_outer_load)) == pytest.approx(0.0, abs=1e-12)


def test_two_equal_power_laws_in_series(bearing) -> None:
    """D = (Q/K)^(1/n) (1 + κ^(1 + 1/n)), κ the inner force by the outer one."""
    each = load_curve.power(jnp.full(3, 9e5), jnp.full(3, 1.2))
    seat = roller_balance.seat(bearing)._replace(inner_curves=roller_curves.RollerCurves(each))
    loads = jnp.array([1e-3, 50.0, 2000.0])
    ratio = seat.outer_cos / seat.inner_cos
    approach = (loads / 9e5) ** (1 / 1.2) * (1.0 + ratio ** (1.0 + 1 / 1.2))
    found, slope = roller_balance.outer_loads(seat, roller_curves.RollerCurves(each), approach)
    np.testing.assert_allclose(found, loads, rtol=1e-12)
    np.testing.assert_allclose(slope, 1.2 * loads / approach, rtol=1e-11)
    outside, _ = roller_balance.outer_loads(seat, roller_curves.RollerCurves(each), -approach)
    assert np.all(np.asarray(outside) == 0.0)


def test_a_soft_flange_adds_its_part(bearing) -> None:
    """δ_f sin(α − β)/cos(β − φ) with δ_f = (9 Q_f²/(16 R E'²))^(1/3)."""
    each = load_curve.power(jnp.full(2, 9e5), jnp.full(2, 1.2))
    hard = roller_balance.seat(bearing)._replace(inner_curves=roller_curves.RollerCurves(each))
    soft = hard._replace(flange_compliance=(9.0 / (16.0 * 100.0 * 113794.0**2)) ** (1 / 3))
    loads = jnp.array([50.0, 2000.0])
    seat_angle = jnp.sin(hard.outer - hard.inner) / hard.inner_cos
    sunk = soft.flange_compliance * roller_balance.flange_load(soft, loads) ** (2 / 3)
    ratio = hard.outer_cos / hard.inner_cos
    approach = (loads / 9e5) ** (1 / 1.2) * (1.0 + ratio ** (1.0 + 1 / 1.2)) + seat_angle * sunk
    found, _ = roller_balance.outer_loads(soft, roller_curves.RollerCurves(each), approach)
    np.testing.assert_allclose(found, loads, rtol=1e-11)


@pytest.mark.hard
def test_rollers_that_settle_beside_the_ring_rest_as_they_do_alone(bearing) -> None:
    """Both raceways, a soft flange and a fast cage: one Newton step of the rollers a step of the ring finds what a
    bracketed search finds, roller by roller."""
    rng = np.random.default_rng(1)
    acting = (SERIES, effects.Flange("hertz", 50.0), effects.Centrifugal(20000.0))

    @jit_quickly()
    def apart(axial: jax.Array, ratio: jax.Array, angle: jax.Array) -> tuple[jax.Array, ...]:
        met = (trb.Spall(8.0, 9.0, angle=angle), trb.Spall(6.0, 9.0, angle=-angle, surface="inner"))
        contact = geometry.LineContact.of(bearing)
        here = effects.Ring(bearing, trb.Load(ratio * axial, axial), met, LIU, contact, angle)
        terms = effects.terms(acting, here)
        rest = here.equilibrium(terms)
        curves = LIU.curves(met[:1], here.distances("outer", terms))
        alone, _ = roller_balance.outer_loads(terms.seat, curves, rest.approach)
        return jnp.max(jnp.abs(alone - rest.loads)) / jnp.max(alone), rest.status_code, rest.iterations

    axial, ratio, angle = 10 ** rng.uniform(1.0, 4.5, 200), rng.uniform(0.0, 2.0, 200), rng.uniform(-1.0, 1.0, 200)
    off, code, steps = map(np.asarray, jax.vmap(apart)(axial, ratio, angle))
    known = code == status.CONVERGED
    assert np.mean(known) > 0.4
    assert set(code[~known]) <= {status.NO_EQUILIBRIUM, status.OUTSIDE}
    assert np.max(off[known]) < 1e-11
    assert np.max(steps[known]) <= 20


def test_inner_spalls_are_met_by_the_inner_law_only(bearing) -> None:
    """With one law on both raceways and one angle, an inner spall does almost what an outer one does."""

    def on(surface) -> trb.Solution:
        spalls = (trb.Spall(6.0, 5.0, surface=surface),)
        return trb.solve(trb.Scene(bearing, LOAD, spalls, LIU, effects=(SERIES,))).check()

    outer, inner, on_roller = on("outer"), on("inner"), on("roller")
    assert float(outer.radial_stiffness) == pytest.approx(float(inner.radial_stiffness), rel=3e-3)
    np.testing.assert_allclose(on_roller.loads, outer.loads, rtol=1e-12)  # roller 0 turns its spall outwards
    turned = trb.Scene(bearing, LOAD, (trb.Spall(6.0, 5.0, angle=np.pi, surface="roller"),), LIU, effects=(SERIES,))
    np.testing.assert_allclose(trb.solve(turned).loads, inner.loads, rtol=1e-12)


@pytest.mark.parametrize(("speed", "force"), [(3000.0, 1.9), (5000.0, 5.2), (7100.0, 10.4)])
def test_centrifugal_force_of_a_roller(bearing, speed: float, force: float) -> None:
    assert float(effects.Centrifugal(speed).force(bearing)) == pytest.approx(force, abs=0.06)


def test_speed_under_a_given_load_and_at_a_given_position(bearing) -> None:
    """Outer loads stay and inner ones fall under force control; at a given position the outer ones rise."""

    def at(speed: float, control) -> trb.Solution:
        acting = (SERIES, effects.Centrifugal(speed, control))
        return trb.solve(trb.Scene(bearing, trb.Load(0.0, 600.0), (), LIU, effects=acting)).check()

    still, force, position = at(0.0, "force"), at(7100.0, "force"), at(7100.0, "position")
    np.testing.assert_allclose(force.loads, still.loads, rtol=1e-11)
    assert jnp.all(force.effects["inner_loads"] < still.effects["inner_loads"])
    assert jnp.all(force.effects["flange_loads"] > still.effects["flange_loads"])
    assert jnp.all(position.loads > still.loads)
    assert float(position.effects["axial_force"]) > 600.0


def test_unloaded_rollers_are_thrown_outwards(bearing) -> None:
    acting = (SERIES, effects.Centrifugal(7100.0))
    r = trb.solve(trb.Scene(bearing, trb.Load(9000.0, 2500.0), (), LIU, effects=acting)).check()
    least = float(jnp.min(r.loads))
    assert least == pytest.approx(10.4, abs=0.2)
    assert float(jnp.min(r.effects["inner_loads"])) == pytest.approx(0.0, abs=1e-9)


def test_rollers_thrown_outwards_can_push_the_rings_apart(bearing) -> None:
    """23 rollers of 10.2 N press 57.5 N axially: under 120 and 60 N (Liu et al. 2018, Fig. 15 a) nothing is left."""
    at_speed = trb.Scene(bearing, trb.Load(120.0, 60.0), (), LIU, effects=(effects.Centrifugal(7100.0),))
    assert int(trb.solve(at_speed).status_code) == status.NO_EQUILIBRIUM
    assert bool(trb.solve(dataclasses.replace(at_speed, load=trb.Load(120.0, 90.0))).converged)


def test_tightening_is_an_axial_preload(bearing) -> None:
    """Rollers thicker by the normal part of Δ/2 press like the rings moved by Δ/(2 tanα); NSK's factors for a fit."""
    fit = effects.Mounting(0.005, shaft_interference=0.02, bore=40.0, shaft_bore=20.0, warmer=10.0)
    inner = 2.0 * float(geometry.outer_raceway_radius(bearing)) * np.sin(0.1949) / np.sin(0.2473)
    k = 40.0 / inner
    by_fit = 0.02 * k * 0.75 / (1.0 - 0.25 * k**2)
    by_warmth = 1.25e-5 * 10.0 * 2.0 * float(geometry.outer_raceway_radius(bearing))
    assert float(fit.tightened(bearing)) == pytest.approx(by_fit + by_warmth, rel=1e-12)
    moved = effects.Mounting(0.005 + float(fit.tightened(bearing)) / (2.0 * np.tan(bearing.outer_angle)))
    base = plain(bearing, load=trb.Load(500.0, 0.0))
    one, other = (trb.solve(dataclasses.replace(base, effects=(e,))).check() for e in (fit, moved))
    np.testing.assert_allclose(one.loads, other.loads, rtol=1e-10, atol=1e-9)


def test_tilt_has_five_degrees_of_freedom_and_their_stiffness(bearing) -> None:
    base = dataclasses.replace(plain(bearing, "palmgren"), effects=(effects.Tilt(2000.0, 3000.0, reach=2.0),))

    def moved(radial=0.0, about_lateral=0.0) -> np.ndarray:
        load = trb.Load(9000.0 + radial, 4500.0)
        acting = (effects.Tilt(2000.0, 3000.0 + about_lateral, reach=2.0),)
        return np.asarray(trb.solve(dataclasses.replace(base, load=load, effects=acting)).displacement)

    r = trb.solve(base).check()
    assert r.stiffness.shape == (5, 5)
    np.testing.assert_allclose(r.stiffness, r.stiffness.T, rtol=1e-10, atol=1e-4)
    assert np.all(np.linalg.eigvalsh(np.asarray(r.stiffness)) > 0.0)
    compliance = np.linalg.inv(np.asarray(r.stiffness))
    np.testing.assert_allclose((moved(radial=1.0) - moved(radial=-1.0)) / 2.0, compliance[:, 0], rtol=1e-5, atol=1e-12)
    by_moment = (moved(about_lateral=1.0) - moved(about_lateral=-1.0)) / 2.0
    np.testing.assert_allclose(by_moment, compliance[:, 4], rtol=1e-5, atol=1e-13)


def test_load_factor_is_the_table_of_iso_281() -> None:
    """f_c of radial roller bearings, ISO 281, by D_we cosα/D_pw."""
    table = {0.01: 52.1, 0.05: 74.1, 0.1: 84.2, 0.14: 87.7, 0.18: 88.8, 0.22: 88.2, 0.3: 83.8}
    for ratio, factor in table.items():
        assert float(life.load_factor(ratio)) == pytest.approx(factor, abs=0.06)


def test_reference_life_is_the_basic_one_where_that_is_defined(bearing) -> None:
    """One million revolutions under F_r = C with half the rollers loaded."""
    rating = float(life.load_rating(bearing))
    load = trb.Load(rating, 1.26 * rating * float(np.tan(bearing.outer_angle)))
    many = dataclasses.replace(bearing, rollers=23)
    r = ring.equilibrium(many, load, (), Palmgren(bearing.roller_length), 0.0)
    assert float(life.reference(bearing, rating, r.loads, r.loads)) == pytest.approx(1.0, rel=0.1)
    assert float(life.basic(bearing, rating, load.radial, load.axial)) == pytest.approx(1.0, rel=1e-9)
    light = trb.solve(dataclasses.replace(plain(bearing), effects=(effects.Life(60000.0),)))
    assert float(light.effects["load_rating"]) == 60000.0


KINDS = {
    "double_row": effects.DoubleRow(0.01, spacing=30.0, moment_lateral=1e4),
    "raceways": SERIES,
    "flange": effects.Flange("hertz", 100.0),
    "diameters": effects.Diameters(tuple(1e-3 * np.cos(np.arange(23.0)))),
    "mounting": effects.Mounting(0.02, shaft_interference=0.01, bore=40.0, warmer=10.0),
    "centrifugal": effects.Centrifugal(6000.0, "position"),
    "through": effects.Through(),
    "tilt": effects.Tilt(500.0, 800.0, slices=8),
    "life": effects.Life(),
}
BY_CONTACTS = {"raceways", "flange", "centrifugal"}
"""With `tilt` by contacts alone, not by slices: `test_tilt_between_raceways.py`."""
PAIRS = [
    pair for pair in itertools.combinations(KINDS, 2)
    if not any(a in KINDS[b].excludes for a, b in itertools.permutations(pair))
    and not ("tilt" in pair and BY_CONTACTS & set(pair))
]  # fmt: skip


LEAN = {("raceways", "flange"), ("centrifugal", "mounting"), ("diameters", "through"), ("tilt", "double_row"),
        ("life", "double_row")}  # fmt: skip
"""By programs, in as few pairs as can be."""


def in_few(pair: tuple[str, str]) -> bool:
    return bool({pair, pair[::-1]} & LEAN)


@pytest.mark.parametrize(
    "pair", [pytest.param(pair, marks=[pytest.mark.portable] * in_few(pair)) for pair in PAIRS], ids="+".join
)
def test_any_two_combine(bearing, pair: tuple[str, str]) -> None:
    """In equilibrium to 1e-9, and their derivatives equal central differences to 1e-6."""
    roller_law = Palmgren(bearing.roller_length) if "tilt" in pair else LIU
    held = "mounting" in pair
    acting = tuple(KINDS[name] for name in pair)

    def answer(by: jax.Array) -> tuple[jax.Array, jax.Array]:
        def solved(by: jax.Array) -> tuple[jax.Array, jax.Array]:
            numbers, treedef = jax.tree.flatten(acting)
            more = jax.tree.unflatten(treedef, [v * (1.0 + by) for v in numbers])
            more = acting if roller_law is LIU and "raceways" in pair else more  # the law is no number
            spalls = (trb.Spall(6.0 + by, 7.0, angle=0.01),)
            load = trb.Load(9000.0 * (1.0 + by), 0.0 if held else 4500.0)
            r = trb.solve(trb.Scene(bearing, load, spalls, roller_law, effects=more))
            numbers = jnp.concatenate([r.loads / 1e3, r.stiffness.ravel()[:3] / 1e6])
            every = r.loads + r.effects.get("second_row_loads", 0.0)
            return numbers, jnp.concatenate([every, r.residual[None], r.status_code[None]])

        value, slope, more = jax.jvp(solved, (by,), (jnp.ones(()),), has_aux=True)
        return jnp.stack([value, slope]), more

    answer = jit_quickly()(answer) if in_few(pair) else answer
    found, more = answer(jnp.zeros(()))
    loads, residual, code = more[:-2], more[-2], more[-1]
    assert int(code) == 0
    assert float(residual) < 1e-9
    normals = np.asarray(roller_places.directions(bearing, roller_places.roller_angles(bearing, 0.0)))
    np.testing.assert_allclose((normals.T @ np.asarray(loads))[:2], [9000.0, 0.0], atol=1e-9 * 9000.0)
    h, slope = 1e-6, found[1]
    differences = (answer(jnp.asarray(h))[0][0] - answer(jnp.asarray(-h))[0][0]) / (2.0 * h)
    np.testing.assert_allclose(slope, differences, rtol=1e-6, atol=1e-6 * float(jnp.abs(differences).max()))


@pytest.mark.parametrize("name", sorted(BY_CONTACTS))
def test_slices_refuse_what_only_contacts_know(bearing, name: str) -> None:
    scene = dataclasses.replace(plain(bearing, Palmgren(bearing.roller_length)), effects=(KINDS["tilt"], KINDS[name]))
    with pytest.raises(trb.SceneError, match=rf"effects\.{name}: slices of ISO/TS 16281 .* set contact.law = 'auto'"):
        trb.solve(scene)


def test_absent_effects_leave_no_trace(bearing, monkeypatch: pytest.MonkeyPatch) -> None:
    """The traced program is the one of a package in which effects do nothing at all."""
    prepared = trb.prepare(plain(bearing))
    ours = str(jax.make_jaxpr(prepared_scene._solved)(prepared))
    monkeypatch.setattr(effects, "terms", lambda *_: ring.PLAIN)
    monkeypatch.setattr(effects, "results", lambda *_: {})
    monkeypatch.setattr(prepared_scene, "law_in_effect", lambda _, roller_law: roller_law)
    assert str(jax.make_jaxpr(prepared_scene._solved)(prepared)) == ours
    assert trb.solve(plain(bearing)).effects == {}


def test_twice_or_against_each_other_is_said(bearing) -> None:
    def named(*acting) -> trb.Scene:
        return dataclasses.replace(plain(bearing), effects=acting)

    with pytest.raises(ValueError, match=r"effects = None: must be a tuple"):
        dataclasses.replace(plain(bearing), effects=None)
    with pytest.raises(ValueError, match=r"effects\.life is named twice"):
        named(effects.Life(), effects.Life())
    with pytest.raises(ValueError, match=r"effects\.tilt and effects\.through exclude each other"):
        named(effects.Through(), effects.Tilt())
    with pytest.raises(ValueError, match=r"contact\.law = 'palmgren'"):
        trb.solve(named(effects.Tilt()))
    with pytest.raises(ValueError, match=r"deviations has 2 entries for 23 rollers"):
        trb.solve(named(effects.Diameters((0.0, 0.0))))
    with pytest.raises(ValueError, match=r"load\.axial must be 0"):
        trb.solve(named(effects.Mounting(0.01)))
    with pytest.raises(ValueError, match=r"mounting\.bore is missing"):
        trb.solve(dataclasses.replace(named(effects.Mounting(0.01, shaft_interference=0.02)), load=trb.Load(1.0, 0.0)))
    for wrong, sentence in {
        effects.Mounting(shaft_bore=20.0): "bore is missing: shaft_bore needs it",
        effects.Mounting(housing_outside=90.0): "outside is missing: housing_outside needs it",
        effects.Mounting(bore=70.0): "bore is 70 mm wide and the inner raceway, which is around it, ",
        effects.Mounting(bore=40.0, shaft_bore=45.0): "shaft_bore is 45 mm wide and bore, which is around it, 40 mm",
        effects.Mounting(outside=50.0): "mm wide and outside, which is around it, 50 mm",
        effects.Mounting(outside=68.0, housing_outside=60.0): "outside is 68 mm wide and housing_outside",
    }.items():
        with pytest.raises(ValueError, match=sentence):
            trb.solve(dataclasses.replace(named(wrong), load=trb.Load(1.0, 0.0)))
    with pytest.raises(ValueError, match=r"end_radius is of no use to a rigid flange"):
        trb.solve(named(effects.Flange(end_radius=100.0)))
    with pytest.raises(ValueError, match=r"end_radius is missing"):
        trb.solve(named(effects.Flange("hertz")))
    with pytest.raises(ValueError, match=r"raceways needs a law"):
        trb.solve(named(effects.Raceways()))
    with pytest.raises(ValueError, match=r"'liu2018' does not know the inner raceway"):
        trb.solve(dataclasses.replace(named(effects.Raceways()), law="liu2018"))
    with pytest.raises(ValueError, match=r"raceways needs a law"):  # which an inner spall calls for
        trb.solve(dataclasses.replace(plain(bearing), spalls=(trb.Spall(4.0, 7.0, surface="inner"),)))
    on_roller = (trb.Spall(4.0, 7.0, surface="roller"),)
    with pytest.raises(ValueError, match=r"'roller' belongs to one roller"):
        trb.solve(dataclasses.replace(named(SERIES), spalls=on_roller, phase="mean"))


# ------------------------------------------------------------------------------------------------ moments


def most_moment(bearing, load, direction, reach, phase) -> float:
    """The largest moment along `direction` [N mm] that forces of slices which only push can hold: linear programming
    over all of them."""
    at = np.tile(np.asarray(tilt.places(trb.LineContact.of(bearing), 30)) + reach, bearing.rollers)
    angles = np.repeat(np.asarray(roller_places.roller_angles(bearing, phase)), 30)
    cos, sin = np.cos(bearing.outer_angle), np.sin(bearing.outer_angle)
    pushes = np.stack([cos * np.cos(angles), cos * np.sin(angles), np.full(at.size, sin), at * np.sin(angles),
                       -at * np.cos(angles)])  # fmt: skip
    held = np.concatenate([pushes, -np.array([[0.0], [0.0], [0.0], [direction[0]], [direction[1]]])], axis=1)
    answer = linprog(
        np.append(np.zeros(at.size), -1.0), A_eq=held, b_eq=[load.radial, 0.0, load.axial, 0.0, 0.0], bounds=(0, None)
    )
    return float(-answer.fun)


def tilted(bearing, load, moments, reach=0.0, phase=0.0, spalls=()) -> trb.Scene:
    tilt = effects.Tilt(moments[0], moments[1], reach)
    return trb.Scene(bearing, load, spalls, Palmgren(bearing.roller_length), effects=(tilt,), phase=phase)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, -1.0), (0.6, -0.8)], ids=str)
@pytest.mark.parametrize(("radial", "reach"), [(0.0, 0.0), (9000.0, 0.0), (1000.0, 20.0)])
def test_moments_are_held_up_to_where_pushing_slices_can(bearing, direction, radial: float, reach: float) -> None:
    """On either side of the limit: solved, and known to have no equilibrium; not "iteration limit" any more."""
    load, phase = trb.Load(radial, 4500.0), 0.07
    most = most_moment(bearing, load, direction, reach, phase)
    for share in (0.5, 0.99, 0.9999, 1.0001, 2.0, 1e3):
        r = trb.solve(tilted(bearing, load, [share * most * d for d in direction], reach, phase))
        assert int(r.status_code) == (status.CONVERGED if share < 1.0 else status.NO_EQUILIBRIUM), share
        if share < 1.0:
            assert float(r.residual) < 1e-12
        else:
            assert "moments" in r.status
            assert jnp.isnan(r.loads).all()


def test_slices_over_a_spall_hold_no_moment(bearing) -> None:
    """Slices without land keep a trace of stiffness, and once held what the others could not by a tilt of 1e8 rad."""
    load = trb.Load(1000.0, 4500.0)
    most = most_moment(bearing, load, (1.0, 0.0), 0.0, 0.07)
    spall = trb.Spall(8.0, 60.0, angle=1.5, axial_offset=3.0)  # under the ends that the moment presses
    codes = [int(trb.solve(tilted(bearing, load, (share * most, 0.0), 0.0, 0.07, (spall,))).status_code)
             for share in (0.3, 0.7, 0.99)]  # fmt: skip
    assert codes == [status.CONVERGED, status.NO_EQUILIBRIUM, status.NO_EQUILIBRIUM]


@pytest.mark.parametrize("preload", [-0.01, 0.0, 0.02])
def test_a_pair_with_a_spacing_holds_any_moment(bearing, preload: float) -> None:
    """Its rows press against each other, whatever the moment, without any load beside it, too."""
    for moment in (1e4, 1e8):
        row = effects.DoubleRow(preload, spacing=30.0, moment_lateral=moment)
        r = trb.solve(trb.Scene(bearing, trb.Load(0.0, 0.0), (), Palmgren(bearing.roller_length), effects=(row,)))
        assert bool(r.converged), r.status
        rows = float(r.effects["first_row_radial"]), float(r.effects["second_row_radial"])
        assert rows[0] == pytest.approx(-rows[1], rel=1e-9)


def test_gradients_beside_moments_that_nothing_holds(bearing) -> None:
    load = trb.Load(1000.0, 4500.0)

    def stiffness(moment: jax.Array) -> jax.Array:
        return trb.solve(tilted(bearing, load, (moment, 0.0))).stiffness[0, 0]

    slopes = np.asarray(jax.vmap(jax.grad(stiffness))(jnp.array([5e4, 5e6])))
    assert np.isfinite(slopes[0])
    assert float(slopes[0]) == pytest.approx(float(jax.grad(stiffness)(5e4)), rel=1e-9)


@pytest.mark.slow
def test_results_over_sliced_spalls_say_that_they_overstate(bearing) -> None:
    made = tilted(bearing, LOAD, (0.0, 0.0), spalls=SPALLS)
    found = trb.assess(made)
    (sentence,) = found.spalled.remarks
    assert "overstated" in sentence
    assert found.healthy.remarks == ()
    assert run_text.run_json(made, found, 0.0)["remarks"] == [sentence]
    console = Console(width=400, file=io.StringIO(), markup=False)
    console.print(run_text.run_text(made, found))
    assert sentence in console.file.getvalue()  # type: ignore[attr-defined]
    assert "remarks" not in run_text.run_json(made, trb.assess(plain(bearing)), 0.0)
