"""What is said beside a rating life: which rollers meet a spall, and numbers of the edge's stress intensity."""

import dataclasses

import numpy as np
import pytest

import difftrb as trb
from difftrb.ring import effects, roller_places
from difftrb.scene.edge_stress import STATIC_LIMIT

pytestmark = pytest.mark.exact

LIU = trb.liu2018()


def scene(bearing, *spalls: trb.Spall, more=(), **others) -> trb.Scene:
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), spalls, LIU, effects=(effects.Life(), *more), **others)


def stresses(of: trb.Scene) -> tuple[trb.EdgeStress, ...]:
    return trb.edge_stresses(of, trb.solve(of).check())


def test_a_centred_roller_has_the_intensity_of_its_contact(bearing, contact) -> None:
    """And K/√(2πs) is the limit at the distance that is said, which lies well inside the contact."""
    of = scene(bearing, trb.Spall(4.0, 7.0))
    (met,) = stresses(of)
    load = trb.solve(of).loads[0]
    solved = trb.edge_intensity(contact, load, trb.Spall(4.0, 7.0)).check()
    assert (met.spall, met.roller, met.raceway, met.load) == (0, 0, "outer", float(load))
    assert met.intensity == pytest.approx(float(solved.high.max()), rel=1e-12)
    assert met.intensity / np.sqrt(2.0 * np.pi * met.within) == pytest.approx(STATIC_LIMIT, rel=1e-12)
    assert 1e-3 < met.within < 0.02
    assert met.land == pytest.approx(13.66 / 9.66, rel=1e-12)
    assert f"K = {met.intensity:.0f} N/mm^1.5" in met.sentence
    assert "has no limit" in met.sentence


def test_a_longer_spall_is_worse(bearing) -> None:
    short, long = (stresses(scene(bearing, trb.Spall(length, 7.0)))[0] for length in (3.0, 7.0))
    assert long.load < short.load
    assert long.land > short.land
    assert long.intensity > short.intensity


def test_without_a_loaded_roller_nothing_is_said(bearing) -> None:
    between = trb.Spall(4.0, 4.0, angle=0.5 * 2.0 * np.pi / 23)
    beside = scene(bearing, between)
    assert stresses(beside) == ()
    assert len(stresses(dataclasses.replace(beside, phase=between.angle))) == 1
    assert len(stresses(dataclasses.replace(beside, phase="mean"))) == 1
    unloaded = dataclasses.replace(beside, spalls=(trb.Spall(4.0, 7.0, angle=np.pi),), load=trb.Load(9000.0, 2500.0))
    assert stresses(unloaded) == ()
    assert trb.edge_stresses(dataclasses.replace(beside, effects=(), phase=between.angle), trb.solve(beside)) == ()
    assert stresses(scene(bearing, trb.Spall(4.0, 7.0), more=(effects.Through(),))) == ()


def test_a_rolling_edge_in_the_contact_leaves_no_intensity(bearing) -> None:
    """But the roller is found as soon as its contact, not its middle, reaches the spall."""
    radius = float(roller_places.distances(bearing, (trb.Spall(4.0, 7.0, angle=-1.0),), np.zeros(1))[0, 0])
    (met,) = stresses(scene(bearing, trb.Spall(4.0, 7.0, angle=-3.52 / radius)))
    assert np.isnan(met.intensity)
    assert np.isnan(met.within)
    assert "K is not known" in met.sentence
    assert stresses(scene(bearing, trb.Spall(4.0, 7.0, angle=-3.7 / radius))) == ()


def test_every_raceway_has_its_own(bearing) -> None:
    """The inner contact is narrower: a smaller radius."""
    series = effects.SeriesRaceways(None, LIU)
    of = scene(bearing, trb.Spall(4.0, 5.0), trb.Spall(4.0, 5.0, surface="inner"), more=(series,))
    outer, inner = stresses(of)
    assert (outer.raceway, inner.raceway, inner.spall) == ("outer", "inner", 1)
    assert inner.load == float(trb.solve(of).effects["inner_loads"][0])
    assert inner.intensity > outer.intensity
