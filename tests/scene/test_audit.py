"""The audit: contacts solved afresh say how far a law is off, and find one that lies."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.law import samples
from difftrb.law.power import PowerLaw
from difftrb.report import remarks
from difftrb.scene import audit_states
from difftrb.scene.audit_states import key_of
from difftrb.scene.scene import ring_at

pytestmark = pytest.mark.exact


def test_a_power_law_keeps_its_promise(scene: trb.Scene) -> None:
    """And its stiffness is off by what the ladder of accuracy measures otherwise: 3 % radial, 1.3 % axial."""
    audit = trb.verify(scene)
    assert audit.kept
    assert 1e-3 < audit.load_error < audit.promised < 0.1
    assert audit.stiffness_error == pytest.approx([3.0e-2, 1.3e-2], abs=5e-3)
    assert audit.failed == 0
    assert audit.contacts == 12  # of 23 rollers: the others are their mirror images
    assert {each.roller for each in audit.rollers} == set(range(23))
    assert [each.spalls for each in audit.rollers if each.spalls] == [(0,)]


def test_a_law_that_lies_is_found(scene: trb.Scene) -> None:
    law = scene.law
    assert isinstance(law, PowerLaw)
    softer = dataclasses.replace(law, log_stiffness=law.log_stiffness + jnp.log(0.85))
    audit = trb.verify(dataclasses.replace(scene, law=softer))
    assert not audit.kept
    assert audit.load_error == pytest.approx(0.15, abs=0.05)
    assert "more than promised" in audit.sentence


def test_a_roller_on_an_edge_is_not_promised(scene: trb.Scene) -> None:
    """A hard window knows no rolling edge; what is promised there covers anything between land and spall."""
    on_edge = dataclasses.replace(scene, phase=0.12)
    found = trb.solve(on_edge).check()
    audit = trb.verify(on_edge, found)
    assert audit.kept
    assert audit.load_error > 0.1
    assert len(remarks.of_solution(on_edge, found)) == 1
    assert not remarks.of_solution(scene, trb.solve(scene))


def test_a_secant_that_is_no_stiffness_is_said() -> None:
    """10 N on a ring held by 4500 N: the spall alone moves it 20 times as far, and F/u loses 96 %, or 105 %."""
    light = trb.Scene("32008J", trb.Load(10.0, 4500.0), trb.Spall(4.0, 7.0), law="table", definition="secant")
    for load, sentences in ((light.load, 1), (trb.Load(9000.0, 4500.0), 0)):
        ready = trb.prepare(dataclasses.replace(light, load=load))
        found = remarks.of_result(ready, trb.assess(ready))
        assert len(found) == sentences
    ready = trb.prepare(light)
    (sentence,) = remarks.of_result(ready, trb.assess(ready))
    assert sentence.startswith("radial: the secant F/u loses 95.7 % and the tangent 1.53 %")


def test_rollers_beyond_the_range_are_said_first(scene: trb.Scene) -> None:
    heavy = dataclasses.replace(scene, load=trb.Load(40000.0, 20000.0))
    found = trb.solve(heavy).check()
    (sentence,) = remarks.of_solution(heavy, found)
    assert "made for" in sentence
    assert np.isnan(trb.verify(heavy, found).promised)


@pytest.mark.parametrize(
    "effect",
    [
        trb.effects.Flange("hertz", 50.0), trb.effects.Centrifugal(5000.0), trb.effects.Through(),
        trb.effects.Diameters((0.001,) + (0.0,) * 22), trb.effects.DoubleRow(preload=0.005, spacing=30.0),
    ],
    ids=lambda effect: effect.key,
)  # fmt: skip
def test_the_audit_holds_rollers_as_effects_do(effect: trb.effects.Effect, scene: trb.Scene) -> None:
    """A wrong balance of the roller would show as an error of all loads, far beyond the law's."""
    audit = trb.verify(dataclasses.replace(scene, effects=(effect,)))
    assert audit.load_error < 0.05


def test_rollers_that_hardly_carry_count_in_the_stiffness(bearing: trb.TaperedBearing) -> None:
    """One carries 2e-4 of the largest load: its stiffness was taken for 0, and the audit said 3.5 %."""
    ready = trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 2300.0), law="table", phase=0.1165121101526997))
    assert np.max(trb.verify(ready, trb.solve(ready)).stiffness_error) < 3e-3


def test_a_roller_that_carries_next_to_nothing_has_a_stiffness(bearing: trb.TaperedBearing) -> None:
    """One carries 9e-6 of the largest load, and was solved under a thousandth: carried on straight to no load at all,
    it had no stiffness, and the audit said 2.4e-3."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 3149.8586891442756), law="table", phase=0.1)
    found = trb.solve(scene)
    lightest = min(load for load in np.asarray(found.loads) if load > 0.0)
    assert 1e-7 < lightest / np.max(found.loads) < 1e-5
    assert np.max(trb.verify(scene, found).stiffness_error) < 3e-4


def test_slices_have_no_audit(bearing: trb.TaperedBearing) -> None:
    tilted = trb.Scene(bearing, trb.Load(9000.0, 4500.0), law="palmgren", effects=(trb.effects.Tilt(),))
    audit = trb.verify(tilted)
    assert np.isnan(audit.load_error)
    assert "slices" in audit.sentence


@pytest.mark.slow
def test_the_mean_is_audited_at_some_phases(scene: trb.Scene) -> None:
    audit = trb.verify(dataclasses.replace(scene, phase="mean"))
    assert len({each.phase for each in audit.rollers}) == 7
    assert audit.kept


def test_mirror_images_are_one_contact() -> None:
    """In the rolling direction. Between two spalls a roller has one on either side: that is no image of both on one."""
    same = key_of("outer", 900.0, (0, 1), (0.5, 0.25))
    assert same == key_of("outer", 900.0, (0, 1), (-0.5, -0.25))
    assert same != key_of("outer", 900.0, (0, 1), (0.5, -0.25))
    assert same != key_of("inner", 900.0, (0, 1), (0.5, 0.25))
    assert same != key_of("outer", 901.0, (0, 1), (0.5, 0.25))


def test_contacts_that_do_not_converge_keep_no_promise(scene: trb.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not audited is not kept; and a law that promises nothing breaks nothing."""
    solved = samples.all_solved

    def one_fails(*arguments: Any) -> list[samples.Node]:
        first, *others = solved(*arguments)
        return [dataclasses.replace(first, status_code=status.NOT_CONVERGED), *others]

    monkeypatch.setattr(samples, "all_solved", one_fails)
    found = trb.verify(scene)
    assert found.failed == 1
    assert found.load_error < found.promised
    assert not found.kept
    assert "contacts of 1 rollers did not converge" in found.sentence
    assert "more than promised" not in found.sentence
    assert dataclasses.replace(found, promised=np.nan).kept


def test_spalls_that_are_equal_are_told_apart(bearing):
    """By which they are, not by their numbers."""
    both = tuple(trb.HeightMap(jnp.full((3, 3), -0.1), 1.0, 1.0, angle=angle) for angle in (3.0, 0.0))
    made = trb.Scene(bearing, trb.Load(9000.0, 4500.0), both, law="power")
    here, terms = ring_at(made, trb.prepare(dataclasses.replace(made, spalls=())).law, 0.0)
    zeros = np.zeros(bearing.rollers)
    states = audit_states._states(made, here, terms, zeros + 8e-3, zeros + 1e3, zeros)
    assert {number for state in states for each in state.contacts for number in each.spalls} == {0, 1}
