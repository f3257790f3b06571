"""The table and the direct law on a contact with a closed form, which stands in for the solver: only interpolation
is at work, so tolerances are tight; and the direct law on the solver itself."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import gap, nodes, status, store, table
from difftrb.law import load_over
from experiments import build_of_table


def half_width(contact, load):
    return jnp.sqrt(4.0 * load * contact.radius / (jnp.pi * contact.modulus * contact.length))


def healthy(contact, delta):
    """Load on a healthy raceway."""
    return 4.0 * contact.modulus * contact.length**0.9 * jnp.maximum(delta, 1e-300) ** 1.12 * contact.design_load**0.02


def full(contact, delta, spall):
    """Load over the middle of a wide spall."""
    crown = gap.crown_at(jnp.maximum(0.5 * spall.length - jnp.abs(spall.axial_offset), 0.0), contact)
    return healthy(contact, delta - crown) * (1.0 - spall.length / contact.length) ** 0.9


def reach(contact, delta, spall):
    free = delta - 0.3 * full(contact, delta, spall) / (contact.modulus * contact.length)
    return jnp.sqrt(2.0 * contact.radius * jnp.maximum(free, 1e-12))


def load_at(contact, delta, spall, distance):
    """What the closed form gives: an edge takes the land's load away as a narrow line contact loses it."""
    sound = healthy(contact, delta)
    if spall is None:
        return sound
    over = full(contact, delta, spall)
    low, high = -half_width(contact, sound), reach(contact, delta, spall)
    t = jnp.clip((0.5 * spall.width - jnp.abs(distance) - low) / (high - low), 0.0, 1.0)
    y = 0.1 + 0.1 * t + 0.02 * jnp.log(delta / 0.005) - 0.25 * jnp.log(jnp.maximum(1.0 - t, 1e-12))
    return over + (sound - over) * (1.0 - t * t) / (1.0 + t * t * y)


def approach(contact, load, spall, distance):
    """Its inverse, by halving; the last step, Newton's, carries the derivatives."""

    def halve(_, ends):
        middle = jnp.sqrt(ends[0] * ends[1])
        low = load_at(contact, middle, spall, distance) < load
        return jnp.where(low, middle, ends[0]), jnp.where(low, ends[1], middle)

    low, high = jax.lax.fori_loop(0, 60, halve, (jnp.asarray(1e-7), jnp.asarray(0.3)))
    delta = jax.lax.stop_gradient(jnp.sqrt(low * high))
    slope = jax.lax.stop_gradient(jax.grad(load_at, 1)(contact, delta, spall, distance))
    return delta - (load_at(contact, delta, spall, distance) - load) / slope


@jax.jit
def _by_form(contact, load, spall, distance):
    value, slopes = jax.value_and_grad(approach, (0, 1, 2, 3))(contact, load, spall, distance)
    return value, slopes, half_width(contact, load), 0.0 if spall is None else reach(contact, value, spall)


def closed_form(contact, case, accuracy):
    arguments = contact, jnp.asarray(float(case.load)), case.spall, jnp.asarray(float(case.distance))
    value, (by_contact, by_load, by_spall, by_distance), width, end = _by_form(*arguments)
    slopes = np.array(nodes.inputs(by_contact, by_spall, by_distance))
    return nodes.Node(float(value), float(by_load), slopes, status.CONVERGED, float(width), float(end))


@pytest.fixture(scope="module")
def closed(tmp_path_factory):
    """The solver replaced by the closed form, the cache by an empty folder; the number of solves so far."""
    patch = pytest.MonkeyPatch()
    solves = []
    patch.setattr(nodes, "solved", lambda *a: (solves.append(a), closed_form(*a))[1])
    folder = tmp_path_factory.mktemp("cache")
    patch.setattr(store, "folder", lambda: folder)
    patch.setattr(store, "keeping", True)  # whatever ran before
    yield solves
    patch.undo()


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

    got = nodes.inputs(*jax.grad(by_table, (0, 1, 2))(*arguments))
    forward = nodes.inputs(*jax.jacfwd(by_table, (0, 1, 2))(*arguments))
    wanted = nodes.inputs(*jax.grad(by_form, (0, 1, 2))(*arguments))
    np.testing.assert_allclose(got, forward, rtol=1e-8, atol=1e-9 * float(jnp.max(jnp.abs(got))))
    for i in (0, 1, 2, 3, 4, 5, 8):
        size = abs(float(nodes.inputs(*arguments)[i]))
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
    assert found["error"] == float(law.error)
    assert found["bytes"] > 1e4


def test_law_says_what_it_does_not_know(law) -> None:
    def code(spall, contact=law.contact):
        return int(law.at(contact).judge((spall,), jnp.zeros((1, 1))))

    assert code(trb.Spall(4.0, 7.0)) == status.CONVERGED
    assert code(trb.Spall(4.0, 7.0, depth=0.3)) == status.CONVERGED  # as deep: out of reach
    assert code(trb.Spall(12.0, 7.0)) == status.UNKNOWN_LENGTH
    assert code(trb.Spall(4.0, 0.1)) == status.NARROW
    assert code(trb.Spall(4.0, 7.0, depth=1e-3)) == status.OTHER_SCENE
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


def test_narrow_law_says_what_it_does_not_know(law, narrow) -> None:
    def code(spall):
        return int(narrow.judge((spall,), jnp.zeros((1, 1))))

    assert code(trb.Spall(4.0, 0.1)) == code(trb.Spall(4.0, 7.0)) == status.CONVERGED
    assert code(trb.Spall(12.0, 0.1)) == status.UNKNOWN_LENGTH
    shallow = dataclasses.replace(
        law, atlases=(dataclasses.replace(law.atlases[0], given=law.atlases[0].given.at[-3].set(5e-3)),)
    )
    for error in (None, 0.0):
        over = dataclasses.replace(shallow, narrow_error=error)
        assert int(over.judge((trb.Spall(4.0, 0.1, depth=5e-3),), jnp.zeros((1, 1)))) == status.NARROW


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


narrow_load, by_reverse, by_forward = map(jax.jit, (_narrow_load, jax.jacrev(_narrow_load), jax.jacfwd(_narrow_load)))


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


SPALL = trb.Spall(4.0, 7.0)


def prepared(bearing, roller_law: str, **changes) -> trb.Scene:
    # half a millimetre before the pitch between two rollers, one stands on the ramp
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (SPALL,), law=roller_law, phase=0.1215)
    return trb.prepare(dataclasses.replace(scene, **changes))


def agree(one: trb.Scene, two: trb.Scene) -> trb.Scene:
    """Loads to 1e-4, stiffness to 1e-3, its derivatives by length and width to 1e-2; the first one's derivatives."""

    @jax.jit
    def both(scene: trb.Scene) -> tuple[trb.Scene, trb.Solution]:
        solution = trb.solve(scene)
        return jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene), solution

    (ours, a), (theirs, b) = both(one), both(two)
    np.testing.assert_allclose(a.check().loads, b.check().loads, atol=1e-4 * float(b.loads.max()))
    np.testing.assert_allclose(a.stiffness, b.stiffness, rtol=1e-3, atol=1e-3 * float(b.stiffness.max()))
    for size in ("length", "width", "angle"):
        assert float(getattr(ours.spalls[0], size)) == pytest.approx(
            float(getattr(theirs.spalls[0], size)), rel=1e-2, abs=1e-4 * float(b.stiffness[0, 0])
        )
    assert float(ours.spalls[0].width) < 0.0
    assert float(ours.design_load) == pytest.approx(float(theirs.design_load), rel=1e-2)
    assert float(ours.bearing.modulus) == pytest.approx(float(theirs.bearing.modulus), rel=1e-2)
    return ours


def test_scene_by_table_is_the_scene_by_direct(closed, bearing) -> None:
    """A roller stands on the ramp."""
    one, two = (prepared(bearing, name) for name in ("table", "direct"))
    assert [len(edges.loads) for edges in two.law.edges] == [1]
    agree(one, two)


def test_mean_by_table_is_the_mean_by_direct(closed, bearing) -> None:
    agree(*(prepared(bearing, name, phase="mean") for name in ("table", "direct")))


STEPS = {"length": 1e-3, "width": 1e-4, "angle": 1e-6, "axial_offset": 1e-3, "radial": 1.0, "design_load": 5.0,
         "phase": 1e-6, "modulus": 20.0, "preload": 1e-6}  # fmt: skip


@pytest.mark.parametrize("leaf", STEPS)
def test_direct_scene_derivatives_are_differences_of_direct_scenes(closed, bearing, leaf: str) -> None:
    """Both ends of the difference prepared afresh: nothing of the law is held."""
    h = STEPS[leaf]
    aside = trb.Spall(4.0, 7.0, axial_offset=0.5)

    def moved(step: float) -> dict:
        if leaf == "axial_offset":
            return {"spalls": (dataclasses.replace(aside, axial_offset=0.5 + step),)}
        if leaf == "preload":  # where the rings stand decides, not the axial load
            return {"load": trb.Load(9000.0, 0.0), "effects": (trb.effects.Mounting(0.012 + step),)}
        if leaf in ("length", "width", "angle"):
            return {"spalls": (dataclasses.replace(SPALL, **{leaf: getattr(SPALL, leaf) + step}),)}
        if leaf == "radial":
            return {"load": trb.Load(9000.0 + step, 4500.0)}
        if leaf == "modulus":
            return {"bearing": dataclasses.replace(bearing, modulus=bearing.modulus + step)}
        return {leaf: {"design_load": 6500.0, "phase": 0.1215}[leaf] + step}

    def stiffness(step: float) -> float:
        scene = {"bearing": bearing} | moved(step)
        return float(trb.solve(prepared(scene.pop("bearing"), "direct", **scene)).stiffness[0, 0])

    scene = {"bearing": bearing} | moved(0.0)
    slopes = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(prepared(scene.pop("bearing"), "direct", **scene))
    if leaf in ("radial", "modulus", "preload"):
        owner = {"radial": slopes.load, "modulus": slopes.bearing, "preload": slopes.effects and slopes.effects[0]}[
            leaf
        ]
    else:
        owner = slopes.spalls[0] if hasattr(SPALL, leaf) else slopes
    got = getattr(owner, leaf)
    assert float(got) == pytest.approx((stiffness(h) - stiffness(-h)) / (2 * h), rel=2e-3)


def test_laws_by_nodes_need_numbers(bearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (SPALL,), law="table")
    with pytest.raises(ValueError, match="prepare the scene first"):
        jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene)


def test_prepared_direct_law_refuses_another_scene(closed, bearing) -> None:
    scene = prepared(bearing, "direct")
    for other in (
        {"phase": 0.1225},
        {"spalls": (trb.Spall(8.0, 7.0),)},
        {"spalls": (SPALL, SPALL)},
        {"design_load": 9000.0},
    ):
        assert "another scene" in trb.solve(dataclasses.replace(scene, **other)).status
    assert bool(trb.solve(trb.healthy(scene)).converged)


def test_two_spalls_of_their_own_depth_and_place(closed, bearing) -> None:
    """Each from its own atlas; direct says the same."""
    spalls = SPALL, trb.Spall(3.0, 5.0, angle=0.27, axial_offset=1.0)
    one, two = (trb.solve(prepared(bearing, name, spalls=spalls, phase=0.0)).check() for name in ("table", "direct"))
    assert one.law.which == (0, 1)
    np.testing.assert_allclose(one.loads, two.loads, atol=1e-4 * float(two.loads.max()))
