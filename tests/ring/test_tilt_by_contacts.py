"""Rings that tilt, by contacts solved around every roller's load and tilt (law "direct")."""

from __future__ import annotations

import dataclasses
import math

import jax
import numpy as np
import pytest

import difftrb as trb
from difftrb import effects
from difftrb.core import geometry, status
from difftrb.law import (
    direct_curves,
    healthy_tilt_table,
    roller_curves,
    samples,
    tilt_energy,
    tilted_state_solves,
)
from difftrb.law.samples import Case
from difftrb.law.state_solves import Reached

SPALL = trb.Spall(4.0, 7.0, axial_offset=1.0)


@pytest.fixture(scope="module")
def contact(bearing):
    return trb.LineContact.of(bearing, "outer", design_load=6500.0)


@pytest.fixture(scope="module")
def base(contact):
    return direct_curves.without_edges(contact, 2500.0, (), 1e-2)


@pytest.fixture(scope="module")
def table(base):
    return healthy_tilt_table.of_contact(base, None)


def scene(bearing, *more, spalls=(SPALL,), moment=1e4, **changes):
    own = effects.Tilt(moment_lateral=moment)
    return dataclasses.replace(
        trb.Scene(bearing, trb.Load(9000.0, 4500.0), spalls, law="direct", accuracy=1e-2, effects=(own, *more)),
        **changes,
    )


def polynomial(rng):
    """Energy of degree 4 in approach and tilt, with its slopes by both."""
    terms = {(i, j): rng.normal() for i in range(5) for j in range(5) if 1 <= i + j <= 4}

    def force(d, t):
        return sum(c * i * d ** (i - 1) * t**j for (i, j), c in terms.items() if i)

    def moment(d, t):
        return sum(c * j * d**i * t ** (j - 1) for (i, j), c in terms.items() if j)

    return force, moment


@pytest.mark.exact
def test_any_energy_of_degree_four_is_five_slices():
    """Force, moment and all their slopes of a polynomial come back, at places that were not given."""
    rng, length = np.random.default_rng(0), 10.0
    force, moment = polynomial(rng)
    d, t = (part.ravel() for part in np.meshgrid(np.linspace(1.0, 1.4, 5), np.linspace(-0.03, 0.01, 5)))
    loads = force(d, t * length)
    size = 100.0 + abs(loads).max()  # loads are positive
    own = tilt_energy.fitted_slices(
        (loads + size)[None], t[None], d[None], (length * moment(d, t * length))[None], np.asarray(length)
    )
    x = tilt_energy.points(length)

    def carried(approach, tilt):
        z = (approach + x * tilt - own.middle[0]) / own.reach[0]
        q = sum(own.coefficients[k, 0] * z**k for k in range(tilt_energy.DEGREE))
        return q.sum() - size, (x * q).sum()

    for approach, tilt in ((1.1, -0.02), (1.31, 0.004), (1.2, -0.011)):
        found = np.array(carried(approach, tilt))
        told = np.array([force(approach, tilt * length), length * moment(approach, tilt * length)])
        np.testing.assert_allclose(found, told, rtol=1e-7, atol=1e-6 * size)


@pytest.mark.exact
@pytest.mark.parametrize(("load", "turned"), [(1800.0, 0.0), (1800.0, 1.2), (50.0, -0.8), (400.0, 2.4)])
def test_table_is_the_contact(contact, table, load, turned):
    """Approach, moment and slopes, against a finer solve of the contact itself."""
    tilt = turned * table.reach(load)
    found, solved = table.at(load, tilt).nodes[0], samples.solved_with_tilt(contact, Case(load, tilt=tilt), 1e-3)
    assert table.knows(load, tilt)
    long = table.upright(load) + table.lift
    assert abs(found.approach - solved.approach) < 8e-4 * long
    assert abs(found.moment - solved.moment) < 1e-3 * load * float(contact.length)
    np.testing.assert_allclose(found.slopes[:4], solved.slopes[:4], atol=2e-2 * np.abs(solved.slopes[:4]).max())
    assert table.pressed_at(found.approach, tilt) == pytest.approx(load, rel=2e-3)


@pytest.mark.exact
def test_a_state_has_the_slopes_of_its_contact(contact, base, table):
    """Stiffness along both freedoms, and between them, of the slices near a state."""
    load, tilt = 1800.0, 3e-4
    rollers = tilted_state_solves.Rollers({"outer": base}, {"outer": ()}, table, (table,))
    law = tilted_state_solves.around(
        rollers, {"outer": [Reached(0, 0, (), ())]}, (1,), np.array([load]), np.array([tilt]), np.array([False]), True,
        {},
    )["outer"]  # fmt: skip
    node, x = samples.solved_with_tilt(contact, Case(load, tilt=tilt), 1e-3), tilt_energy.points(contact.length)
    loads, slopes = roller_curves.roller_loads(law.slices((), np.zeros((0, 1))), node.approach - x * tilt)
    assert loads.sum() == pytest.approx(load, rel=3e-4)
    assert (x * loads).sum() == pytest.approx(node.moment, rel=3e-4)
    stiff, leaned = 1.0 / node.compliance, -node.tilt_response.by_tilt
    assert slopes.sum() == pytest.approx(stiff, rel=1e-3)
    assert (x * slopes).sum() == pytest.approx(-leaned * stiff, rel=2e-2)
    assert (x**2 * slopes).sum() == pytest.approx(-node.tilt_response.moment_by_tilt + stiff * leaned**2, rel=6e-3)


@pytest.fixture(scope="module")
def ready(bearing):
    return trb.prepare(scene(bearing, phase=0.05))


@pytest.mark.exact
def test_a_ring_is_what_its_contacts_say(ready):
    """Contacts solved afresh at every roller's load and tilt; equilibrium of forces and moments."""
    found = trb.solve(ready).check()
    audit = trb.verify(ready, found)
    assert audit.load_error < 1e-3
    assert np.all(audit.stiffness_error < 2e-3)
    assert found.stiffness.shape == (5, 5)
    assert float(found.residual) < 1e-9
    assert np.abs(np.asarray(found.effects["roller_tilts"])).max() > 0.05
    assert not found.remarks


@pytest.mark.exact
def test_its_tangent_is_how_it_moves(ready):
    """Stiffness against the displacement by a little more load and moment."""
    own = effects.Tilt(moment_lateral=1e4 + 2.0)
    more = dataclasses.replace(ready, load=trb.Load(9001.0, 4501.5), effects=(own,))
    one, other = (trb.solve(each).check() for each in (ready, more))
    moved = np.asarray(one.stiffness) @ np.asarray(other.displacement - one.displacement)
    np.testing.assert_allclose(moved, [1.0, 0.0, 1.5, 0.0, 2.0], atol=5e-3)


@pytest.mark.gradient
@pytest.mark.slow
def test_its_derivatives_are_those_of_prepared_neighbours(bearing, ready):
    """By a spall's place and a load: of one prepared scene, against scenes prepared anew."""

    def values(of):
        return trb.solve(of).stiffness[np.array([0, 2, 4]), np.array([0, 2, 4])]

    for name, at, step in (("axial_offset", 1.0, 0.2), ("radial", 9000.0, 300.0)):
        slopes = jax.jacfwd(lambda x, name=name: values(ready.replace(**{name: x})))(at)
        base = scene(bearing, phase=0.05)
        ends = [np.asarray(values(trb.prepare(base.replace(**{name: at + way * step})))) for way in (1.0, -1.0)]
        told_anew = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(np.asarray(slopes)[:2], told_anew[:2], rtol=0.05, err_msg=name)
        np.testing.assert_allclose(np.asarray(slopes)[2], told_anew[2], rtol=0.2, err_msg=name)


@pytest.mark.hard
@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "changes"),
    [
        ((effects.Diameters(tuple(1e-3 * np.sin(np.arange(23)))),), {}),
        ((effects.DoubleRow(preload=0.01, spacing=30.0),), {}),
        ((), {"spalls": (trb.Spall(3.0, 4.0, axial_offset=-3.0), trb.Spall(3.0, 5.0, axial_offset=3.5, angle=0.02))}),
        ((), {"spalls": (trb.Spall(4.0, 7.0, depth=0.004),)}),
        ((), {"spalls": (trb.Spall(11.0, 9.0, angle=1.639),), "load": trb.Load(9000.0, 3000.0)}),
    ],
)  # fmt: skip
def test_other_rings_too(bearing, more, changes):
    """Unequal rollers, two rows, several spalls, a shallow one, a long one under a roller that is clear of its land."""
    made = trb.prepare(scene(bearing, *more, **changes))
    audit = trb.verify(made, trb.solve(made).check())
    assert audit.load_error < 1.5e-3
    assert np.all(audit.stiffness_error < 4e-3)


@pytest.mark.hard
def test_rollers_on_their_ends_are_refused(bearing):
    """A moment that turns rings until rollers press with their ends alone."""
    found = trb.solve(trb.prepare(scene(bearing, spalls=(), moment=1e5)))
    assert int(found.status_code) in (status.LEANS, status.NO_EQUILIBRIUM)
    assert np.isnan(np.asarray(found.loads)).all()


@pytest.mark.hard
def test_auto_solves_contacts_and_a_traced_one_says_it_cannot(bearing):
    """Law "auto" becomes "direct"; inside jit there are no numbers to solve contacts of."""
    made = trb.prepare(scene(bearing, spalls=(), law="auto", accuracy=1e-1))
    assert made.picked.law == "direct"
    assert trb.solve(made).check().displacement.shape == (5,)
    with pytest.raises(trb.SceneError, match="in numbers"):
        jax.jit(lambda load: trb.solve(dataclasses.replace(scene(bearing, law="auto"), load=load)).stiffness)(
            trb.Load(9000.0, 4500.0)
        )


def _of(length: float, diameter: float, pitch_radius: float, outer_angle: float, rollers: int) -> trb.TaperedBearing:
    """A bearing by its rollers [mm], the radius of their circle [mm], its outer angle [rad], and a common apex."""
    apex, half = pitch_radius / math.sin(outer_angle), 0.0
    for _ in range(200):
        half = math.atan(0.5 * diameter / apex)
        apex = pitch_radius / math.sin(outer_angle - half)
    more = math.tan(half) * length
    inner = outer_angle - 2.0 * half
    return trb.TaperedBearing(diameter - more, diameter + more, length, rollers, outer_angle, inner, half, 1.5)


@pytest.mark.hard
@pytest.mark.slow
def test_a_roller_on_the_edge_of_a_spall_at_its_end_is_what_its_contact_says() -> None:
    """Its edge 0.12 mm inside the contact: the roller's load was 7e-3 off, radial stiffness 3e-3."""
    bearing = _of(15.0, 9.0, 45.0, math.radians(14.0), 14)
    phase = 2.3775 / float(geometry.arc_radius(bearing))
    scene = trb.Scene(bearing, trb.Load(4000.0, 2000.0), trb.Spall(5.0, 5.0, axial_offset=5.0), "direct", 2000.0, 1e-2,
                      phase=phase, effects=(effects.Tilt(moment_lateral=8000.0),))  # fmt: skip
    ready = trb.prepare(scene)
    audit = trb.verify(ready, trb.solve(ready).check())
    assert audit.load_error < 1e-3
    assert audit.stiffness_error.max() < 1e-3


@pytest.mark.hard
@pytest.mark.slow
def test_a_roller_that_hardly_carries_may_come_back() -> None:
    """One of ten, turned farther than the table knows at its load, 0.3 % of the largest, counted as clear while loads
    were looked for; then it pressed, and the scene was refused as another one."""
    spalls = (
        trb.Spall(4.0, 5.0, axial_offset=2.5, angle=0.03),
        trb.Spall(3.0, 4.0, axial_offset=-2.0, angle=0.05, surface="inner"),
    )
    acting = effects.Tilt(moment_lateral=4000.0, moment_radial=2500.0), effects.Raceways()
    scene = trb.Scene(_of(12.0, 8.0, 40.0, math.radians(30.0), 10), trb.Load(3000.0, 3000.0), spalls, "direct", 2000.0,
                      1e-2, phase=0.06, effects=acting)  # fmt: skip
    ready = trb.prepare(scene)
    found = trb.solve(ready).check()
    assert 1e-3 < float(found.loads.min() / found.loads.max()) < 5e-3
    audit = trb.verify(ready, found)
    assert audit.load_error < 1e-3
    assert audit.stiffness_error.max() < 2e-3
