"""Rollers free to tilt between both raceways: where their moments balance, and what that does to the ring."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import effects
from difftrb.contact import solver
from difftrb.core import status
from difftrb.core.geometry import LineContact
from difftrb.law.direct_states import DirectByStates
from difftrb.law.tilt_equilibrium import RollerContacts, at_rest
from difftrb.scene.prepared_scene import solve_prepared

pytestmark = pytest.mark.exact

LOAD = trb.Load(9000.0, 4500.0)
END = trb.Spall(6.0, 7.0, axial_offset=3.0)


def between(bearing: trb.TaperedBearing, spall: trb.Spall) -> RollerContacts:
    outer, inner = (LineContact.of(bearing, raceway) for raceway in ("outer", "inner"))  # type: ignore[arg-type]
    return RollerContacts((outer, inner), ((spall,), ()), ((0.0,), ()))


@pytest.fixture(scope="module")
def free(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.prepare(trb.Scene(bearing, LOAD, (END,), law="direct", accuracy=1e-2, effects=effects.Raceways()))


@pytest.mark.parametrize(
    ("length", "middle", "held", "rolled"),  # µm of both contacts under 1300 N, solved by others than this package
    [(8.0, 2.83, 11.52, 13.62), (6.0, 3.83, 10.04, 10.93), (4.0, 4.83, 9.12, 9.39), (4.0, 4.0, 9.247, 9.395)],
)
def test_a_roller_tilts_until_its_moments_balance(
    bearing: trb.TaperedBearing, length: float, middle: float, held: float, rolled: float
) -> None:
    roller, loads = between(bearing, trb.Spall(length, 7.0, axial_offset=middle)), (1300.0, 1300.0)
    rest = at_rest(roller, loads, 1e-3)
    assert abs(rest.outer.moment - rest.inner.moment) < 1e-5 * 1300.0 * 13.66
    assert rest.tilt < -1e-4
    assert 1e3 * (rest.outer.approach + rest.inner.approach) == pytest.approx(rolled, rel=2e-3)
    upright = [trb.solve_contact(c, 1300.0, s, accuracy=1e-3)
               for c, s in zip(roller.contacts, (roller.spalls[0][0], None), strict=True)]  # fmt: skip
    assert 1e3 * float(sum(each.approach for each in upright)) == pytest.approx(held, rel=2e-3)


@pytest.mark.gradient
@pytest.mark.parametrize(
    ("spall", "offset", "tilt"), [(END, 3.47, -2e-4), (None, 0.0, 2e-4), (trb.Spall(4.0, 7.0), 0.0, 0.0)],
    ids=["on an edge", "healthy", "upright"],
)  # fmt: skip
def test_the_moment_has_the_right_slopes(
    bearing: trb.TaperedBearing, spall: trb.Spall | None, offset: float, tilt: float
) -> None:
    """Against central differences; and by load it is what the approach is by tilt (Maxwell)."""
    contact = LineContact.of(bearing)
    _, by_approach, by = solver.approach_and_gradient(contact, 1300.0, spall, offset, 1e-4, tilt=tilt, moment=True)
    assert by_approach.tilt is not None
    assert float(by.load) == pytest.approx(float(by_approach.tilt), abs=0.01)

    def moment(contact: LineContact = contact, spall: Any = spall, **more: float) -> float:
        place, turned = more.get("offset", offset), more.get("tilt", tilt)
        return float(trb.solve_contact(contact, 1300.0, spall, place, 1e-4, tilt=turned).moment)

    def check(own: Any, high: float, low: float, step: float) -> None:
        assert float(own) == pytest.approx((high - low) / (2.0 * step), rel=0.02, abs=1e-4)

    check(by.tilt, moment(tilt=tilt + 2e-5), moment(tilt=tilt - 2e-5), 2e-5)
    for name, step in (("radius", 0.02), ("length", 0.02), ("design_load", 50.0)):
        moved = [dataclasses.replace(contact, **{name: getattr(contact, name) + s}) for s in (step, -step)]
        check(getattr(by.contact, name), moment(moved[0]), moment(moved[1]), step)
    if spall is None:
        return
    check(by.offset, moment(offset=offset + 3e-3), moment(offset=offset - 3e-3), 3e-3)
    for name, step in (("length", 0.02), ("axial_offset", 0.02), ("width", 5e-3)):
        sizes = [dataclasses.replace(spall, **{name: getattr(spall, name) + s}) for s in (step, -step)]
        check(getattr(by.spall, name), moment(spall=sizes[0]), moment(spall=sizes[1]), step)


@pytest.mark.slow
def test_a_spall_at_the_end_takes_more_where_rollers_may_tilt(free: trb.Scene) -> None:
    held = trb.Scene(free.bearing, LOAD, (END,), law="direct", accuracy=1e-2,
                     effects=effects.Raceways(rollers="upright"))  # fmt: skip
    found, upright = trb.solve(free).check(), trb.solve(held).check()
    whole = solve_prepared(dataclasses.replace(free, spalls=())).check()
    lost = [float(1.0 - each.radial_stiffness / whole.radial_stiffness) for each in (found, upright)]
    assert 1.1 < lost[0] / lost[1] < 1.6
    tilts = np.asarray(found.effects["roller_tilts"])
    assert -1.0 < tilts[0] < -0.1
    assert not np.any(tilts[1:])
    assert np.allclose(whole.loads, whole.loads[jnp.array([0, *range(22, 0, -1)])], rtol=1e-9)  # no tilt is left in it
    audit = trb.verify(free, found)
    assert audit.load_error < 3e-3
    assert audit.stiffness_error.max() < 2e-2


@pytest.mark.slow
@pytest.mark.gradient
def test_slopes_hold_what_the_tilt_makes_of_them(free: trb.Scene) -> None:
    """A scene prepared elsewhere, carried here along its slopes, is the one that was prepared here."""
    here = solve_prepared(free).check()
    for name, step in (("length", 0.1), ("axial_offset", 0.1)):
        spall = dataclasses.replace(END, **{name: getattr(END, name) + step})
        moved = dataclasses.replace(free, spalls=(spall,))
        carried, made = solve_prepared(moved).check(), trb.solve(dataclasses.replace(moved, law="direct",
                                                                 effects=effects.Raceways())).check()  # fmt: skip
        change = [float(each.loads[0] - here.loads[0]) for each in (carried, made)]
        assert change[0] == pytest.approx(change[1], rel=0.1)


@pytest.mark.slow
def test_symmetric_spalls_tilt_nothing(bearing: trb.TaperedBearing) -> None:
    ends = tuple(trb.Spall(3.0, 7.0, axial_offset=way * 3.5) for way in (-1.0, 1.0))
    both = RollerContacts(between(bearing, END).contacts, (ends, ()), ((0.0, 0.0), ()))
    rest = at_rest(both, (1300.0, 1300.0), 1e-2)
    assert abs(rest.tilt) < 2e-6


def test_laws_that_do_not_know_the_tilt_say_so(bearing: trb.TaperedBearing) -> None:
    def found(**raceways: Any) -> trb.Solution:
        return trb.solve(trb.Scene(bearing, LOAD, (END,), law="table", effects=effects.Raceways(**raceways)))

    free, upright = found(), found(rollers="upright")
    assert int(free.status_code) == status.TILTS
    assert bool(jnp.all(jnp.isnan(free.loads)))
    assert bool(upright.converged)


def test_through_spalls_tilt_nothing(bearing: trb.TaperedBearing) -> None:
    """They leave nothing to lean on, wherever they are said to be."""
    found = [
        trb.solve(trb.Scene(bearing, LOAD, (trb.Spall(6.0, 7.0, axial_offset=place),), law="table",
                            effects=(effects.Raceways(), effects.Through()))).check()
        for place in (0.0, 1.0)
    ]  # fmt: skip
    np.testing.assert_allclose(found[0].loads, found[1].loads, rtol=1e-12)


def test_a_prepared_scene_knows_whether_rollers_were_free(free: trb.Scene) -> None:
    (series,) = free.effects
    held = dataclasses.replace(free, effects=(dataclasses.replace(series, rollers="upright"),))  # type: ignore[call-arg]
    assert int(solve_prepared(held).status_code) == status.OTHER_SCENE
    moved = dataclasses.replace(free, load=trb.Load(4500.0, 2250.0))
    assert int(solve_prepared(moved).status_code) == status.OTHER_SCENE


def test_an_inner_spall_calls_for_both_raceways(bearing: trb.TaperedBearing) -> None:
    inner = trb.Spall(4.0, 7.0, surface="inner")
    scene = trb.Scene(bearing, LOAD, (inner,), law="table")
    assert isinstance(scene.effects[0], effects.Raceways)
    named = dataclasses.replace(scene, effects=effects.Raceways())
    assert float(trb.solve(scene).check().radial_stiffness) == float(trb.solve(named).radial_stiffness)
    assert "outer and inner raceway" in repr(scene)
    assert jax.tree.structure(scene) == jax.tree.structure(named)


def test_a_free_roller_is_a_state_on_both_raceways(free: trb.Scene) -> None:
    (series,) = free.effects
    for law in (free.law, series.law):  # type: ignore[attr-defined]
        assert isinstance(law, DirectByStates)
        assert law.free_to_tilt
        assert law.states is not None


def test_a_scene_without_a_spall_off_the_middle_is_as_if_held(bearing: trb.TaperedBearing) -> None:
    """Nothing leans, so nothing is looked for."""
    spall = trb.Spall(4.0, 1.0, angle=2.5)
    found = [
        trb.solve(trb.Scene(bearing, LOAD, (spall,), law="direct", accuracy=1e-2,
                            effects=effects.Raceways(rollers=rollers))).check()  # type: ignore[arg-type]
        for rollers in ("free", "upright")
    ]  # fmt: skip
    assert float(found[0].radial_stiffness) == pytest.approx(float(found[1].radial_stiffness), rel=1e-9)
