"""Rings that tilt with both raceways in series, the flange and speed: rollers at rest between two contacts."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

import difftrb as trb
from difftrb import effects
from difftrb.law import direct_curves, direct_states, healthy_tilt_table, tilt_equilibrium
from difftrb.law.healthy_tilt_table import Between
from difftrb.law.tilt_equilibrium import RollerContacts
from difftrb.scene import cage_phases

OUTER, INNER = trb.Spall(4.0, 7.0, axial_offset=1.0), trb.Spall(5.0, 6.0, axial_offset=-1.0, angle=0.3, surface="inner")
BETWEEN = Between(1.04, 60.0)
TILT = effects.Tilt(moment_lateral=1e4)


@pytest.fixture(scope="module")
def contacts(bearing):
    return tuple(trb.LineContact.of(bearing, raceway, design_load=6500.0) for raceway in ("outer", "inner"))


def at_rest(contacts, pressed=1500.0, tilt=3e-4, outer=OUTER, loads=None):
    roller = RollerContacts(contacts, ((outer,), ()), ((0.5,), ()), tilt)
    loads = BETWEEN.loads(pressed) if loads is None else loads
    return tilt_equilibrium.at_rest(roller, loads, 1e-3, tilt_response=True)


def whole(rest):
    """Approach and moment of both contacts together."""
    return np.array([rest.outer.approach + rest.inner.approach / BETWEEN.ratio, rest.outer.moment])


@pytest.mark.gradient
def test_shares_are_how_a_roller_at_rest_moves(contacts):
    """By either load, the rings' tilt, and sizes on both raceways, against differences of rollers at rest."""
    rest = at_rest(contacts)
    outer, inner = rest.shares(BETWEEN.ratio)
    assert abs(rest.outer.moment - rest.inner.moment) < 1e-9 * 1560.0 * 13.66
    roller = RollerContacts(contacts, ((OUTER,), ()), ((0.5,), ()), 3e-4)
    settled = tilt_equilibrium.at_rest(roller, BETWEEN.loads(1500.0), 1e-3)  # until they are equal within 1e-5
    np.testing.assert_allclose(whole(rest), whole(settled), rtol=3e-5)
    assert rest.tilt == pytest.approx(settled.tilt, rel=1e-4)

    def difference(step, up, down):
        return (whole(up) - whole(down)) / (2.0 * step)

    def sized(k, more):
        changed = dataclasses.replace(contacts[k], radius=contacts[k].radius + more)
        return at_rest(tuple(changed if i == k else each for i, each in enumerate(contacts)))

    (q, p), r = BETWEEN.loads(1500.0), BETWEEN.ratio
    told = {
        "inner load": ((inner.compliance / r, inner.tilt_response.by_tilt), difference(
            20.0, at_rest(contacts, loads=(q, p + 20.0)), at_rest(contacts, loads=(q, p - 20.0)))),
        "tilt": ((outer.tilt_response.by_tilt, outer.tilt_response.moment_by_tilt), difference(
            2e-5, at_rest(contacts, tilt=3.2e-4), at_rest(contacts, tilt=2.8e-4))),
        "outer radius": ((outer.slopes[0], outer.tilt_response.moment_slopes[0]), difference(
            0.5, sized(0, 0.5), sized(0, -0.5))),
        "inner radius": ((inner.slopes[0] / r, inner.tilt_response.moment_slopes[0]), difference(
            0.5, sized(1, 0.5), sized(1, -0.5))),
        "axial offset": ((outer.slopes[7], outer.tilt_response.moment_slopes[7]), difference(
            0.2, *(at_rest(contacts, outer=dataclasses.replace(OUTER, axial_offset=at)) for at in (1.2, 0.8)))),
    }  # fmt: skip
    for name, (ours, theirs) in told.items():
        np.testing.assert_allclose(ours, theirs, rtol=3e-2, err_msg=name)  # moments balance to 0.2 N mm
    # pressing both: what the approach has by the tilt the moment has by the load (Maxwell)
    both = difference(20.0, at_rest(contacts, 1520.0), at_rest(contacts, 1480.0))
    compliance = outer.compliance + inner.compliance / r**2
    np.testing.assert_allclose(both, [compliance, outer.tilt_response.by_tilt], rtol=2e-2)


@pytest.mark.exact
@pytest.mark.slow
@pytest.mark.parametrize(("pressed", "turned"), [(1500.0, 0.0), (1500.0, 1.2), (50.0, -0.8), (400.0, 2.4)])
def test_the_table_of_both_is_a_roller_between_them(contacts, table, pressed, turned):
    """Approach, moment, tilt and slopes of healthy rollers, against contacts solved for each."""
    tilt = turned * table.reach(pressed)
    roller = RollerContacts(contacts, ((), ()), ((), ()), tilt)
    rest = tilt_equilibrium.at_rest(roller, BETWEEN.loads(pressed), 1e-2, tilt_response=turned != 0.0)
    found = table.at(pressed, tilt)
    outer, inner = found.nodes
    long = table.upright(pressed) + table.lift
    np.testing.assert_allclose([outer.approach + inner.approach / 1.04, 1e-3 * outer.moment / pressed],
                               [whole(rest)[0], 1e-3 * rest.outer.moment / pressed], atol=1e-3 * long)  # fmt: skip
    assert found.tilt == pytest.approx(rest.tilt, abs=2e-3 * table.reach(pressed))
    if turned:
        for ours, theirs in zip(found.nodes, rest.shares(1.04), strict=True):
            np.testing.assert_allclose(ours.slopes[:4], theirs.slopes[:4], atol=3e-2 * np.abs(theirs.slopes[:4]).max())
            assert ours.compliance == pytest.approx(theirs.compliance, rel=3e-2)
    assert table.pressed_at(outer.approach + inner.approach / 1.04, tilt) == pytest.approx(pressed, rel=2e-3)


@pytest.fixture(scope="module")
def table(contacts):
    bases = (direct_curves.without_edges(contact, 2500.0, (), 1e-2) for contact in contacts)
    tables = tuple(healthy_tilt_table.of_contact(base, None) for base in bases)
    return healthy_tilt_table.between_rings(tables, BETWEEN, 1e-2)


def scene(bearing, *acting, spalls=(OUTER,), speed=8000.0, moment=1e4, **changes):
    acting = acting or (
        effects.Tilt(moment_lateral=moment), effects.Raceways(), effects.Flange("hertz", 100.0),
        effects.Centrifugal(speed),
    )  # fmt: skip
    made = trb.Scene(bearing, trb.Load(9000.0, 4500.0), spalls, law="direct", accuracy=1e-2, effects=acting, phase=0.05)
    return dataclasses.replace(made, **changes)


@pytest.mark.exact
@pytest.mark.gradient
@pytest.mark.slow
def test_a_ring_with_all_that_holds_rollers_is_what_its_contacts_say(bearing):
    """Both raceways with a spall each, a soft flange, speed: contacts solved afresh at every roller's own tilt.
    Derivatives are those of scenes prepared anew: by speed, which presses outer contacts alone, and by the inner
    spall's length, which change about as much; both at once, so that two scenes are enough."""
    ready = trb.prepare(scene(bearing, spalls=(OUTER, INNER)))
    found = trb.solve(ready).check()
    audit = trb.verify(ready, found)
    assert audit.load_error < 1e-3
    assert audit.failed == 0
    assert np.all(audit.stiffness_error < 2e-3)
    assert float(found.residual) < 1e-9
    assert np.asarray(found.effects["centrifugal_force"]) > 1.0
    outside, inside = (np.asarray(found.effects[name]) for name in ("roller_tilts", "inner_tilts"))
    assert np.abs(outside).max() > 0.05
    assert np.abs(inside).max() > 0.05

    def values(of):
        found = trb.solve(of)
        return found.stiffness[np.array([0, 2]), np.array([0, 2])]

    def changed(way):
        acting = (effects.Centrifugal(8000.0 + 800.0 * way) if isinstance(e, effects.Centrifugal) else e
                  for e in ready.effects)  # fmt: skip
        longer = dataclasses.replace(INNER, length=5.0 + 0.2 * way)
        return dataclasses.replace(ready, effects=tuple(acting), spalls=(OUTER, longer))

    ends = []
    for way in (1.0, -1.0):
        spalls = OUTER, dataclasses.replace(INNER, length=5.0 + 0.2 * way)
        ends.append(np.asarray(values(trb.prepare(scene(bearing, spalls=spalls, speed=8000.0 + 800.0 * way)))))
    slopes = jax.jacfwd(lambda way: values(changed(way)))(0.0)
    np.testing.assert_allclose(slopes, 0.5 * (ends[0] - ends[1]), rtol=0.03)


@pytest.mark.exact
@pytest.mark.slow
def test_without_a_moment_or_a_spall_tilting_rings_are_parallel_ones(bearing):
    """Under an axial load alone nothing tilts: as both raceways in series on rings that stay parallel."""
    alone = {"spalls": (), "load": trb.Load(0.0, 4500.0)}
    tilting = trb.solve(trb.prepare(scene(bearing, effects.Tilt(), effects.Raceways(), **alone))).check()
    parallel = trb.solve(trb.prepare(scene(bearing, effects.Raceways(), **alone))).check()
    np.testing.assert_allclose(tilting.loads, parallel.loads, rtol=1e-6)
    np.testing.assert_allclose(tilting.displacement[:3], parallel.displacement, atol=3e-4 * parallel.displacement[2])
    np.testing.assert_allclose(tilting.stiffness[2, 2], parallel.stiffness[2, 2], rtol=1e-3)


@pytest.mark.hard
@pytest.mark.slow
def test_phases_of_a_mean_do_not_hang_on_the_states_that_were_solved(bearing):
    """They are asked for before there are any, and after: the inner raceway's own refused every other phase."""
    made = trb.prepare(scene(bearing, TILT, effects.Raceways(), spalls=(), phase="mean"))
    assert trb.solve(made).converged
    spalled = dataclasses.replace(made, spalls=(OUTER, INNER))
    series = next(e for e in spalled.effects if isinstance(e, effects.SeriesRaceways))
    bare = dataclasses.replace(series, law=direct_states.without_states(series.law))
    acting = tuple(bare if e is series else e for e in spalled.effects)
    before = dataclasses.replace(spalled, law=direct_states.without_states(spalled.law), effects=acting)
    for ours, theirs in zip(cage_phases.phases(spalled), cage_phases.phases(before), strict=True):
        assert len(np.unique(theirs)) > 10
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.hard
@pytest.mark.parametrize(
    ("acting", "law", "sentence"),
    [
        ((TILT, effects.Raceways(rollers="upright")), "direct", "rollers = 'upright'"),
        ((TILT, effects.Centrifugal(3000.0, "position")), "direct", "control = 'position'"),
        ((effects.Tilt(moment_radial=5.0, rings="parallel"),), "palmgren", r"tilt\.moment_radial must be 0 with rings"),
        ((TILT, effects.Flange()), "palmgren", r"effects\.flange: slices of ISO/TS 16281"),
        ((TILT, effects.SeriesRaceways(law=trb.liu2018())), "direct", r"effects\.raceways has a law already"),
    ],
)
def test_what_cannot_be_is_said(bearing, acting, law, sentence):
    with pytest.raises(trb.SceneError, match=sentence):
        trb.prepare(scene(bearing, *acting, law=law))
