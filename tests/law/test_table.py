"""The table on a contact with a closed form, which stands in for the solver, so tolerances are tight."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.core.jax_config import jit_quickly
from difftrb.law import samples, table
from difftrb.law.base import Rest, load_over
from experiments import build_of_table
from tests.closed_form import approach, healthy, load_at

pytestmark = pytest.mark.exact


@pytest.fixture(scope="module")
def law(closed, contact: trb.LineContact) -> table.TableLaw:
    return table.table_law(trb.LineContact(*map(float, dataclasses.astuple(contact))), 1650.0, (trb.Spall(4.0, 7.0),))


@jax.jit
def q_over(law, spall, distance, delta):
    return load_over(law, delta, spall, distance)[0]


@pytest.mark.parametrize("length", [0.7, 4.0, 9.7])
def test_table_is_the_closed_form(law, length: float) -> None:
    """Beside the spall, on its ramp, in its middle."""
    spall = trb.Spall(length, 7.0)
    for load in (100.0, 700.0, 1500.0):
        for over in (-0.2, -0.04, 0.02, 0.09, 0.16, 1.0):
            delta = approach(law.contact, load, spall, 3.5 - over)
            sound = float(healthy(law.contact, delta))
            assert float(q_over(law, spall, 3.5 - over, delta)) == pytest.approx(load, abs=1e-3 * sound)
    assert float(law.error) < 1e-3


class Asked(Exception):
    """Carries how many contacts a table wanted solved, and how exactly."""


@pytest.mark.parametrize(("accuracy", "solves", "at"), [(1e-3, 240, 1e-3), (1e-4, 480, 3e-5), (1e-5, 480, 1e-5)])
def test_exact_tables_solve_more_and_more_exact_edges(law, monkeypatch, accuracy, solves, at) -> None:
    """But none more exact than there is a grid for; and it is known beforehand what a table takes."""

    def all_solved(contact, cases, accuracy, progress):
        raise Asked(len(cases), accuracy)

    monkeypatch.setattr(samples, "all_solved", all_solved)
    atlas, of = law.atlases[0], table.edge_nodes(accuracy)
    built = dataclasses.replace(
        atlas,
        edge_lengths=jnp.linspace(atlas.edge_lengths[0], atlas.edge_lengths[-1], of.lengths),
        share=jnp.broadcast_to(atlas.share[0], (of.lengths, *atlas.share.shape[1:])),
        share_slopes=jnp.broadcast_to(atlas.share_slopes[0], (of.lengths, *atlas.share_slopes.shape[1:])),
    )
    with pytest.raises(Asked) as asked:
        table._with_edges(law.contact, built, trb.Spall(0.0, 0.0), accuracy, None)
    assert asked.value.args == (solves, pytest.approx(at))
    others = table.LENGTHS * law.atlases[0].log_loads.size + table.CHECKS
    assert table.effort(accuracy) == of.takes * solves + others


def test_out_of_reach_is_exactly_healthy_or_exactly_over_the_middle(law) -> None:
    """At the solver's own loads, where nothing is interpolated but in length."""
    spall = trb.Spall(float(law.atlases[0].lengths[4]), 7.0)
    for node in (3, 8):
        load = float(jnp.exp(law.atlases[0].log_loads[node]))
        sound, over = (approach(law.contact, load, shape, 0.0) for shape in (None, spall))
        assert float(q_over(law, spall, 3.5 + 0.3, sound)) == pytest.approx(load, rel=1e-9)
        assert float(q_over(law, spall, 0.0, over)) == pytest.approx(load, rel=1e-9)


@pytest.mark.parametrize("over", [-0.03, 0.0, 0.08])
def test_ramp_has_the_right_slopes(law, over: float) -> None:
    """By length, width, distance, crown, radius and modulus: the table's, and the closed form's; each as the change of
    load [N] by a change of the input by itself."""
    arguments = law.contact, trb.Spall(4.0, 7.0, 0.2, axial_offset=0.0), jnp.asarray(3.5 - over)
    delta = approach(law.contact, 900.0, *arguments[1:])

    def by_table(contact, spall, distance):
        return q_over(law.at(contact), spall, distance, delta)

    def by_form(contact, spall, distance):
        return load_at(contact, delta, spall, distance)

    got = samples.inputs(*jax.grad(by_table, (0, 1, 2))(*arguments))
    forward = samples.inputs(*jax.jacfwd(by_table, (0, 1, 2))(*arguments))
    wanted = samples.inputs(*jax.grad(by_form, (0, 1, 2))(*arguments))
    np.testing.assert_allclose(got, forward, rtol=1e-8, atol=1e-9 * float(jnp.max(jnp.abs(got))))
    for i in (0, 1, 2, 3, 4, 5, 8):
        size = abs(float(samples.inputs(*arguments)[i]))
        assert float(got[i]) * size == pytest.approx(float(wanted[i]) * size, rel=1e-2, abs=1e-3 * 900.0), i


def test_second_use_reads_what_the_first_has_built(closed, law) -> None:
    before = len(closed)
    again = table.table_law(law.contact, 1500.0, (trb.Spall(9.0, 3.0),))
    assert len(closed) == before
    for one, two in zip(jax.tree.leaves(law), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, two)


def test_building_and_loading_are_timed(closed, law, tmp_path) -> None:
    found = build_of_table.measure(law.contact, 1e-3, tmp_path)
    assert 0.0 < found["load"] < found["build, compiled"]
    assert found["load"] < 0.05  # wide spalls are not judged to be so: that takes a tenth of a second
    assert found["error"] == float(law.error)
    assert found["bytes"] > 1e4


def test_law_says_what_it_does_not_know(law) -> None:
    def code(spall, contact=law.contact):
        return int(law.at(contact).judge((spall,), jnp.zeros((1, 1))))

    assert code(trb.Spall(4.0, 7.0)) == status.CONVERGED
    assert code(trb.Spall(4.0, 7.0, depth=0.3)) == status.CONVERGED  # as deep: out of reach
    assert code(trb.Spall(12.0, 7.0)) == status.UNKNOWN_LENGTH
    assert code(trb.Spall(4.0, 0.1)) == status.NARROW
    assert code(trb.Spall(4.0, 7.0, depth=1e-3)) == status.CONVERGED  # whether one meets a bottom is judged at rest
    shallow = trb.Spall(4.0, 7.0, depth=1e-3)
    rest = Rest(law.contact.radius, jnp.array([2e-3]), jnp.array([500.0]))
    assert int(law.judge((shallow,), jnp.zeros((1, 1)), rest)) == status.BOTTOM
    assert code(trb.Spall(4.0, 7.0, axial_offset=1.0)) == status.OTHER_SCENE
    softer = dataclasses.replace(law.contact, modulus=0.5 * law.contact.modulus)
    assert code(trb.Spall(4.0, 7.0), softer) == status.OTHER_SCENE


@pytest.fixture(scope="module")
def narrow(closed, law) -> table.TableLaw:
    """The same table, for spalls with both edges in reach, too."""
    return table.table_law(law.contact, 1500.0, (trb.Spall(4.0, 0.1),))


def test_only_narrow_spalls_make_a_narrow_law(closed, law, narrow) -> None:
    assert law.narrow_error is None
    before = len(closed)
    again = table.table_law(law.contact, 1500.0, (trb.Spall(4.0, 7.0), trb.Spall(9.0, 0.02)))
    assert len(closed) == before
    assert again.narrow_error == narrow.narrow_error > 0.0
    assert float(narrow.error) == max(float(narrow.narrow_error), float(law.error))
    for one, two in zip(jax.tree.leaves(law.atlases), jax.tree.leaves(narrow.atlases), strict=True):
        np.testing.assert_array_equal(one, two)


def test_narrow_law_says_what_it_does_not_know(narrow) -> None:
    def code(spall):
        return int(narrow.judge((spall,), jnp.zeros((1, 1))))

    assert code(trb.Spall(4.0, 0.1)) == code(trb.Spall(4.0, 7.0)) == status.CONVERGED
    assert code(trb.Spall(12.0, 0.1)) == status.UNKNOWN_LENGTH


@pytest.mark.parametrize("length", [0.7, 4.0, 9.7])
def test_narrow_law_is_the_wide_one_where_one_edge_is_in_reach(law, narrow, length: float) -> None:
    """Beyond the width at which both begin to act, and on either side of a narrower spall."""
    for delta in (2e-4, 5e-4, 1e-3):
        _, high = (float(end) for end in law.ramp(0, trb.Spall(length, 7.0), jnp.asarray(delta)))
        sound = float(q_over(law, trb.Spall(length, 7.0), 9.0, delta))
        for width, distance in ((7.0, 3.5), (7.0, 0.0), (2.001 * high, 0.0), (2.2 * high, 0.3 * high),
                                (1.5 * high, 1.2 * high), (0.4 * high, 3.0 * high)):  # fmt: skip
            one, two = (float(q_over(each, trb.Spall(length, width), distance, delta)) for each in (law, narrow))
            assert one == pytest.approx(two, abs=5e-4 * sound)


def test_narrow_law_is_continuous_in_width_and_distance(narrow) -> None:
    """From none to wide, through where the far land ceases to touch, is one curve that falls; away from it one that
    rises."""
    delta = jnp.asarray(6e-4)
    sound = float(q_over(narrow, trb.Spall(4.0, 7.0), 9.0, delta))

    def at(width, distance):
        return q_over(narrow, trb.Spall(4.0, width), distance, delta)

    for values, sign in ((jax.vmap(at, (0, None))(jnp.linspace(0.0, 0.6, 1201), 0.01), -1.0),
                         (jax.vmap(at, (None, 0))(0.1, jnp.linspace(0.0, 0.3, 1201)), 1.0)):  # fmt: skip
        steps = sign * np.diff(values) / sound
        assert steps.min() > -1e-5
        assert steps.max() < 1e-2
    assert float(at(0.0, 0.01)) == pytest.approx(sound, rel=1e-10)


def _narrow_load(v, narrow):
    """Load and stiffness by length, width, distance, approach, crown."""
    law = narrow.at(dataclasses.replace(narrow.contact, design_load=v[4]))
    return jnp.stack(load_over(law, v[3], trb.Spall(v[0], v[1]), v[2]))


narrow_load, by_reverse, by_forward = (
    jit_quickly()(one) for one in (_narrow_load, jax.jacrev(_narrow_load), jax.jacfwd(_narrow_load))
)


@pytest.mark.parametrize("width", [0.0, 1e-9, 1e-5, 1e-3])
@pytest.mark.parametrize("distance", [0.0, 0.03, 0.2])
def test_spalls_of_hardly_any_width_do_next_to_nothing(narrow, width: float, distance: float) -> None:
    v = jnp.asarray([4.0, width, distance, 6e-4, float(narrow.contact.design_load)])
    sound = float(q_over(narrow, None, 0.0, v[3]))
    assert float(narrow_load(v, narrow)[0]) == pytest.approx(sound, rel=1e-4 * width / 1e-3 + 1e-10)
    assert np.isfinite(by_reverse(v, narrow)).all()


@pytest.mark.parametrize(("width", "distance"), [(0.05, 0.01), (0.12, 0.03), (0.25, 0.02), (0.12, 0.11)])
def test_narrow_slopes_by_three_ways(narrow, width: float, distance: float) -> None:
    """Reverse, forward and by differences."""
    start = jnp.asarray([4.0, width, distance, 6e-4, float(narrow.contact.design_load)])

    def both(v):
        return narrow_load(v, narrow)

    reverse, forward = by_reverse(start, narrow), by_forward(start, narrow)
    np.testing.assert_allclose(reverse, forward, rtol=1e-7, atol=1e-9 * float(jnp.abs(forward).max()))
    assert float(reverse[0, 3]) == pytest.approx(float(both(start)[1]), rel=1e-10)
    for i, h in enumerate((1e-5, 1e-7, 1e-7, 1e-10, 1e-2)):
        step = jnp.zeros(5).at[i].set(h)
        difference = (both(start + step) - both(start - step)) / (2 * h)
        off = np.abs((reverse[:, i] - difference) * start[i])
        assert (off <= 1e-4 * np.abs(difference * start[i]) + 1e-6 * both(start)).all(), (i, off, difference * start[i])
