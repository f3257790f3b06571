"""Several spalls and a tilted roller: what they must come to where the answer is known from elsewhere."""

import jax
import jax.numpy as jnp
import pytest

import difftrb as trb

pytestmark = pytest.mark.exact

LOAD, OFFSET = 3000.0, 0.47  # one rolling edge stands in the contact
WHOLE = trb.Spall(3.0, 1.0, axial_offset=1.0)
FAR = trb.Spall(4.0, 1.0)
# what each tuple of spalls with its offsets merges to
AS_ONE = {
    "one out of reach": ((WHOLE, FAR), (OFFSET, 3.0)),
    "out of reach, first": ((FAR, WHOLE), (3.0, OFFSET)),
    "halves along the roller": (
        (trb.Spall(1.5, 1.0, axial_offset=0.25), trb.Spall(1.5, 1.0, axial_offset=1.75)),
        OFFSET,
    ),
    "halves across it": ((trb.Spall(3.0, 0.5, axial_offset=1.0),) * 2, (OFFSET - 0.25, OFFSET + 0.25)),
    "twice the same": ((WHOLE, WHOLE), OFFSET),
    "a shallow one inside": ((WHOLE, trb.Spall(1.0, 0.7, 0.001, axial_offset=1.2)), OFFSET),
}


@pytest.fixture(scope="module")
def whole(contact: trb.LineContact) -> trb.ContactSolution:
    return trb.solve_contact(contact, LOAD, WHOLE, OFFSET, 1e-2, "cells").check()


@pytest.mark.parametrize("name", AS_ONE)
def test_spalls_that_merge_to_one(contact: trb.LineContact, whole: trb.ContactSolution, name: str) -> None:
    spalls, offsets = AS_ONE[name]
    s = trb.solve_contact(contact, LOAD, spalls, offsets, 1e-2).check()
    healthy = 8.0767e-3  # the whole spall adds 2.7 % to it
    assert float(s.approach) - healthy == pytest.approx(float(whole.approach) - healthy, rel=0.06)
    assert float(s.approach) == pytest.approx(float(whole.approach), rel=1.5e-3)


@pytest.mark.parametrize("load", [100.0, LOAD])
def test_halves_leave_no_ridge_between_them(contact: trb.LineContact, load: float) -> None:
    """They meet under the middle of the contact, out of which the whole spall's edges are."""
    whole = trb.solve_contact(contact, load, WHOLE, 0.0, 1e-2, "cells").check()
    for name, offsets in (("halves along the roller", (0.0, 0.0)), ("halves across it", (-0.25, 0.25))):
        for order in (1, -1):
            s = trb.solve_contact(contact, load, AS_ONE[name][0][::order], offsets[::order], 1e-2).check()
            assert float(s.approach) == pytest.approx(float(whole.approach), rel=2e-3)


@pytest.mark.parametrize("share", [0.5, 0.8])
@pytest.mark.parametrize("load", [0.1, 1.0])
def test_halves_that_meet_under_the_middle_of_long_spalls(contact: trb.LineContact, share: float, load: float) -> None:
    """Their common edge counted as land: pressure touched the border, and the roller sank 1 % too far."""
    half = trb.Spall(share * float(contact.length), 3.5)
    force = load * float(contact.design_load)
    whole = trb.solve_contact(contact, force, trb.Spall(half.length, 7.0), 0.0, 1e-2, "cells").check()
    s = trb.solve_contact(contact, force, (half, half), (1.75, -1.75), 1e-2).check()
    assert float(s.approach) == pytest.approx(float(whole.approach), rel=3e-3)


def test_a_ridge_that_cells_miss_is_said(contact: trb.LineContact) -> None:
    """Elastic ones take a fifth of the approach; narrower ones stand for spalls that touch."""
    half = trb.Spall(6.0, 3.5)
    for ridge, known in ((0.0, True), (3e-4, True), (4e-3, False)):
        s = trb.solve_contact(contact, 2000.0, (half, half), (1.75 + 0.5 * ridge, -1.75 - 0.5 * ridge), 1e-2)
        assert bool(s.converged) == known


def test_two_spalls_let_the_roller_down_more_than_either(contact: trb.LineContact, whole: trb.ContactSolution) -> None:
    other = trb.Spall(2.0, 7.0, axial_offset=-3.0)
    both = trb.solve_contact(contact, LOAD, (WHOLE, other), (OFFSET, 0.0), 1e-2).check()
    alone = trb.solve_contact(contact, LOAD, other, 0.0, 1e-2, "cells").check()
    assert float(both.approach) > float(alone.approach) > float(whole.approach)
    over = jnp.abs(both.cells.y + 3.0) < 1.0
    assert float(jnp.max(both.force[over])) == 0.0
    assert len(both.spalls) == 2


def test_a_tuple_of_one_is_that_one(contact: trb.LineContact, whole: trb.ContactSolution) -> None:
    s = trb.solve_contact(contact, LOAD, (WHOLE,), (OFFSET,), 1e-2, "cells")
    assert float(s.approach) == float(whole.approach)


def test_reversed_tilt_mirrors_the_pressure(contact: trb.LineContact) -> None:
    one = trb.solve_contact(contact, LOAD, WHOLE, OFFSET, 1e-2, tilt=5e-4).check()
    mirrored = trb.Spall(3.0, 1.0, axial_offset=-1.0)
    other = trb.solve_contact(contact, LOAD, mirrored, OFFSET, 1e-2, tilt=-5e-4).check()
    assert float(one.approach) == pytest.approx(float(other.approach), rel=1e-12)
    assert jnp.allclose(one.pressure, other.pressure[::-1], rtol=0.0, atol=1e-9 * float(one.peak_pressure))
    assert float(jnp.sum(one.force * one.cells.y[:, None])) < 0.0  # the end at y > 0 is lifted


def test_a_tilt_of_nearly_nothing_is_none(contact: trb.LineContact) -> None:
    level = trb.solve_contact(contact, LOAD, None, 0.0, 1e-2, "cells")
    nearly = trb.solve_contact(contact, LOAD, None, 0.0, 1e-2, "cells", tilt=1e-12).check()
    assert float(nearly.approach) == pytest.approx(float(level.approach), rel=1e-10)
    assert nearly.force.shape[0] == 2 * level.force.shape[0]


def test_tilt_obeys_maxwell(contact: trb.LineContact) -> None:
    """Moment and load derive from one energy: dδ/d(tilt) = dM/d(load)."""

    def both(v: jax.Array) -> jax.Array:
        s = trb.solve_contact(contact, v[0], None, 0.0, 1e-2, "cells", tilt=v[1])
        return jnp.stack([s.approach, jnp.sum(s.force * s.cells.y[:, None])])

    slopes = jax.jacfwd(both)(jnp.array([LOAD, 6e-4]))
    assert float(slopes[0, 1]) == pytest.approx(float(slopes[1, 0]), rel=0.03)  # the grid breathes with both


def test_a_roller_tilted_off_its_land_rests_on_its_end(contact: trb.LineContact) -> None:
    for tilt in (0.02, -0.02):
        s = trb.solve_contact(contact, LOAD, None, 0.0, 1e-2, tilt=tilt).check()
        loaded = s.cells.y[jnp.any(s.force > 0.0, axis=1)]
        assert bool(jnp.all(loaded * tilt < 0.0))
        assert float(s.approach) < 0.0  # the middle is above the raceway
