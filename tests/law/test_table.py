"""The atlas against contacts solved afresh, and what follows from it being a function."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import crown
from difftrb.core import geometry, status
from difftrb.core.jax_config import jit_quickly
from difftrb.law import atlas, atlas_place, direct_curves, edge_ramp, load_curve, samples, table
from difftrb.law.base import Rest, load_over
from difftrb.scene import audit, scene_laws
from difftrb.scene.scene import named
from experiments import build_of_atlas
from tests import hertz

pytestmark = pytest.mark.exact
AFRESH = 40
ACCURACY = 1e-4


@pytest.fixture(scope="module")
def law(contact: trb.LineContact) -> table.TableLaw:
    return table.table_law(trb.LineContact(*map(float, dataclasses.astuple(contact))))


@pytest.fixture(scope="module")
def wide(law: table.TableLaw) -> table.TableLaw:
    """The same for spalls that are known to be wide."""
    return table.table_law(law.contact, (trb.Spall(4.0, 7.0),))


@jax.jit
def q_over(law, spall, distance, delta):
    return load_over(law, delta, spall, distance)[0]


@jax.jit
def carried_at(curve, delta):
    return load_curve.load(curve, delta)[0]


# ------------------------------------------------------------------------------------------------ against contacts


@pytest.mark.parametrize("number", [1e-6, 1.5e-5, 2e-4, 3e-3])
def test_hardly_loaded_rollers_are_hertzian(law: table.TableLaw, number: float) -> None:
    """Far below the atlas's lightest node a healthy roller's contact is Hertz's ellipse, on the crown's curvature, and
    on the way there as it is solved; by `direct`, too. Straight on, it carried up to 48 % more."""
    c = law.contact
    light = dataclasses.replace(c, design_load=number * c.modulus * c.length**3 / c.radius)
    solved = direct_curves.without_edges(light, 3.0 * light.design_load, (), 1e-3)
    curves = law.at(light).healthy().curve, load_curve.one_of(solved.curves((), np.zeros((0, 1))).each, 0)
    across = c.length**2 / (8.0 * crown.scale(light))  # t² of the crown's logarithm
    for share in (1e-8, 1e-6):
        load = share * light.design_load
        there = hertz.ellipse(load, c.radius, across, c.modulus).approach
        for curve in curves:
            assert float(carried_at(curve, there)) == pytest.approx(load, rel=4e-3)
    for share in (3e-3, 1e-3, 1e-4):
        load = share * light.design_load
        there = samples.pressed(light, samples.Case(load), 1e-3).approach
        for curve in curves:
            assert float(carried_at(curve, there)) == pytest.approx(load, rel=4e-3)


@pytest.mark.parametrize("times", [12.0, 50.0])
def test_hardly_crowned_rollers_leave_the_line_later(law: table.TableLaw, times: float) -> None:
    """The lightest solves of `direct` are then at loads at which a contact is a line: it comes to Hertz's ellipse below
    these. By a switch at 0.05 of the design load, loads were up to 21 % off and jumped by as much with the crown."""
    c = law.contact
    c = dataclasses.replace(c, design_load=1e-4 * c.modulus * c.length**3 / c.radius)
    solved = direct_curves.without_edges(c, times * c.design_load, (), 1e-3)
    curve = load_curve.one_of(solved.curves((), np.zeros((0, 1))).each, 0)
    for share in (0.3, 0.1):
        load = share * float(solved.load_range[0])
        there = samples.pressed(c, samples.Case(load), 1e-3).approach
        assert float(carried_at(curve, there)) == pytest.approx(load, rel=1e-2)


@pytest.mark.slow
def test_nodes_solved_afresh() -> None:
    """Without an edge in reach, at random ones of the atlas's own nodes; light loads count less, as in its build. At
    a tenth of the lightest, too, where curves run on."""
    shipped, rng, off, light = atlas.shipped(), np.random.default_rng(0), [], []
    for _ in range(AFRESH):
        k, i, a, q = (int(rng.integers(size)) for size in np.shape(shipped.full))
        number, over_end = float(np.exp(shipped.log_numbers[k])), a == len(shipped.asides)
        contact = build_of_atlas.contact_at(number)
        aside = 0.0 if over_end else float(shipped.asides[a])
        spall = build_of_atlas.spall_at(number, float(shipped.lengths[i]), aside, over_end)
        load = float(np.exp(shipped.log_loads[q]))
        solved = samples.solved(contact, samples.Case(load * build_of_atlas.DESIGN_LOAD, spall), ACCURACY)
        assert solved.status_code == status.CONVERGED
        approach = solved.approach / float(crown.scale(contact))
        off.append(min(load, 1.0) ** build_of_atlas.LIGHT * abs(approach / np.exp(shipped.full[k, i, a, q]) - 1.0))
        load = build_of_atlas.LIGHTER * build_of_atlas.DESIGN_LOAD
        pressed = samples.pressed(contact, samples.Case(load, spall if i else None), ACCURACY)
        assert int(pressed.status_code) == status.CONVERGED
        light.append(abs(float(carried_at(table.table_law(contact).beside(spall).full, pressed.approach)) / load - 1.0))
    assert np.median(off) < 0.5 * ACCURACY
    assert np.quantile(off, 0.9) < 3.0 * ACCURACY
    assert max(off) < 30.0 * ACCURACY
    assert np.median(light) < 10.0 * ACCURACY
    assert max(light) < 1e-2


@pytest.mark.slow
def test_an_atlas_is_read_as_it_was_built(tmp_path) -> None:
    """The smallest one: what one step put together to be read was kept for the next ones, before all was there."""
    size = build_of_atlas.Size(
        numbers=2, loads=4, solved_loads=6, lengths=3, asides=2, edge_numbers=2, edge_lengths=2, solved_lengths=2,
        edge_asides=2, levels=2, solved_levels=2, places=2, narrow=(20, 10), accuracy=1e-2, edge_accuracy=1e-2,
        narrow_accuracy=1e-2,
    )  # fmt: skip
    built = build_of_atlas.build(tmp_path, size)
    for name in ("healthy", "half_width", "full", "sunk", "light", "share", "shift"):
        assert np.isfinite(getattr(built, name)).all(), name
    np.testing.assert_array_equal(
        built.over_middle, np.concatenate([built.full, built.sunk, built.light[..., None]], -1)
    )
    number, load = float(np.exp(built.log_numbers[1])), build_of_atlas.LIGHTER * build_of_atlas.DESIGN_LOAD
    contact, spall = (
        build_of_atlas.contact_at(number),
        build_of_atlas.spall_at(number, float(built.lengths[2]), 0.0, False),
    )
    curve = build_of_atlas.law_of(built, contact).beside(spall).full
    approach = samples.pressed(contact, samples.Case(load, spall), 1e-2).approach
    assert build_of_atlas.EXPONENTS[0] < built.light[1, 2, 0] < build_of_atlas.EXPONENTS[1]
    assert float(carried_at(curve, approach)) == pytest.approx(load, rel=1e-6)


@pytest.mark.parametrize("region", [*(pytest.param(k, marks=pytest.mark.slow) for k in range(4)), 4])
def test_between_the_nodes_it_is_as_exact_as_it_says(region: int) -> None:
    """Over spalls and on ramps of random contacts: in the thirds of the places aside, over the roller's end; and over
    narrow spalls."""
    shipped = atlas.shipped()
    off = np.abs([check.error for check in build_of_atlas.checks(shipped, 12, 7, region)])
    said = float(shipped.narrow_error if region == build_of_atlas.BOTH_EDGES else shipped.errors[region])
    assert np.median(off) < said
    assert max(off) < audit.TABLES_KEEP * said


# ------------------------------------------------------------------------------------------------ a function


def test_only_two_numbers_of_a_contact_count(law: table.TableLaw) -> None:
    """Another size, modulus and crown with the same λ: all is the same in the contact's units."""
    c = law.contact
    other = trb.LineContact(2.0 * c.radius, 3.0 * c.length, 0.6 * c.modulus, 0.6 * 27.0 / 2.0 * c.design_load)
    assert float(table.number_of(other)) == pytest.approx(float(table.number_of(c)), rel=1e-12)
    wide, high = float(crown.scale(other) / crown.scale(c)), other.design_load / c.design_load
    across = float(np.sqrt(other.radius / c.radius * wide))
    for length, width, distance in ((4.0, 7.0, 0.0), (4.0, 7.0, 3.45), (4.0, 0.2, 0.02), (9.0, 7.0, 3.6)):
        mine = q_over(law, trb.Spall(length, width, axial_offset=0.5), distance, 4e-3)
        spall = trb.Spall(3.0 * length, across * width, axial_offset=1.5)
        theirs = q_over(law.at(other), spall, across * distance, 4e-3 * wide)
        assert float(theirs) == pytest.approx(high * float(mine), rel=1e-9)


def test_out_of_reach_is_exactly_healthy_or_exactly_over_the_middle(law: table.TableLaw) -> None:
    spall = trb.Spall(4.0, 7.0)
    beside = law.beside(spall)
    for delta in (2e-3, 8e-3):
        healthy, full = (float(load_curve.load(curve, delta)[0]) for curve in (beside.healthy, beside.full))
        assert float(q_over(law, spall, 3.5 + 0.4, delta)) == pytest.approx(healthy, rel=1e-12)
        assert float(q_over(law, spall, 0.0, delta)) == pytest.approx(full, rel=1e-12)


@pytest.mark.slow
def test_scene_by_table_needs_no_preparing(bearing: trb.TaperedBearing) -> None:
    """Bearing, crown, length, offset and angle traced: the gradient is of differences; "auto" is the same."""

    def radial(v: jax.Array, law: str = "table") -> jax.Array:
        changed = dataclasses.replace(bearing, modulus=v[0])
        spall = trb.Spall(v[2], 7.0, axial_offset=v[3], angle=v[4])
        scene = trb.Scene(changed, trb.Load(9000.0, 4500.0), (spall,), law, v[1], phase=0.12)
        return trb.solve(scene).stiffness[0, 0]

    at = jnp.array([2.1e5, 6500.0, 4.0, 0.5, 0.002])
    value = jax.jit(radial)
    slopes = jax.jit(jax.grad(radial))(at)
    assert float(radial(at, "auto")) == pytest.approx(float(value(at)), rel=1e-12)
    for i, h in enumerate((1.0, 1e-2, 1e-4, 1e-4, 1e-7)):
        step = jnp.zeros(5).at[i].set(h)
        difference = (value(at + step) - value(at - step)) / (2.0 * h)
        assert float(slopes[i]) == pytest.approx(float(difference), rel=2e-4), i


@pytest.mark.slow
@pytest.mark.gradient
@pytest.mark.parametrize("over", [-0.03, 0.0, 0.08])
def test_ramp_has_the_right_slopes(wide: table.TableLaw, over: float) -> None:
    """By radius, length, modulus, crown and by length, width, offset, distance and approach: reverse, forward,
    differences."""
    c = wide.contact
    start = jnp.array([c.radius, c.length, c.modulus, c.design_load, 4.0, 7.0, 0.3, 3.5 - over, 4e-3])
    reverse, forward = by_reverse(start, wide), by_forward(start, wide)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8, atol=1e-9 * float(jnp.max(jnp.abs(forward * start))))
    for i in range(start.size):
        h = 1e-6 * (float(start[i]) if i != 7 else 0.1)
        step = jnp.zeros(start.size).at[i].set(h)
        difference = (load_of(start + step, wide) - load_of(start - step, wide)) / (2.0 * h)
        assert float(reverse[i]) * h == pytest.approx(float(difference) * h, rel=1e-4, abs=1e-12 * 2000.0), i


def _load_of(v, law):
    own = law.at(trb.LineContact(*v[:4]))
    return load_over(own, v[8], trb.Spall(v[4], v[5], axial_offset=v[6]), v[7])[0]


load_of, by_reverse, by_forward = (jit_quickly()(one) for one in (_load_of, jax.grad(_load_of), jax.jacfwd(_load_of)))


@pytest.mark.slow
def test_scene_by_table_is_the_scene_by_direct(bearing: trb.TaperedBearing) -> None:
    """Half a millimetre before the pitch between two rollers, where one stands on the ramp."""

    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "table", phase=0.1215)
    # finer than files may ask of a ring: with contacts at 1e-4 the derivative by width is 2 % off
    exact = scene_laws.with_laws(named(geometry.as_floats(scene), "direct", 1e-5))
    (ours, our_slopes), (theirs, their_slopes) = slopes(trb.prepare(scene)), slopes(exact)
    np.testing.assert_allclose(ours.check().loads, theirs.check().loads, atol=2e-4 * float(theirs.loads.max()))
    np.testing.assert_allclose(ours.stiffness, theirs.stiffness, atol=1e-3 * float(theirs.stiffness.max()))
    for name in ("length", "width", "angle"):
        one, two = (float(getattr(by.spalls[0], name)) for by in (our_slopes, their_slopes))
        assert one == pytest.approx(two, rel=1e-2, abs=1e-4 * float(theirs.stiffness[0, 0])), name


@jit_quickly()
def slopes(scene: trb.Scene) -> tuple[trb.Solution, trb.Scene]:
    """The solution, and its radial stiffness by everything."""

    def radial(scene: trb.Scene) -> tuple[jax.Array, trb.Solution]:
        solution = trb.solve(scene)
        return solution.stiffness[0, 0], solution

    by, solution = jax.grad(radial, has_aux=True)(scene)
    return solution, by


# ------------------------------------------------------------------------------------------------ what it knows


def test_law_says_what_it_does_not_know(law: table.TableLaw, wide: table.TableLaw) -> None:
    def code(spall, contact=law.contact):
        return int(law.at(contact).judge((spall,), jnp.zeros((1, 1))))

    length = law.contact.length
    assert code(trb.Spall(4.0, 7.0)) == code(trb.Spall(4.0, 0.01)) == status.CONVERGED
    assert int(wide.judge((trb.Spall(4.0, 0.01),), jnp.zeros((1, 1)))) == status.NARROW
    assert code(trb.Spall(4.0, 7.0, axial_offset=0.45 * length - 2.0)) == status.CONVERGED
    assert code(trb.Spall(4.0, 7.0, axial_offset=-0.45 * length + 1.99)) == status.SLIVER
    assert code(trb.Spall(4.0, 7.0, axial_offset=0.5 * length - 2.0)) == status.CONVERGED  # up to the roller's end
    assert code(trb.Spall(0.1, 7.0, axial_offset=0.5 * length)) == status.SLIVER
    assert code(trb.Spall(0.86 * length, 7.0)) == status.SLIVER
    assert code(trb.Spall(4.0, 7.0), dataclasses.replace(law.contact, design_load=0.0)) == status.OTHER_CONTACT
    assert code(trb.Spall(4.0, 7.0), dataclasses.replace(law.contact, radius=300.0)) == status.OTHER_CONTACT
    shallow, away = trb.Spall(4.0, 7.0, depth=1e-3), jnp.zeros((1, 1))
    assert code(shallow) == status.CONVERGED  # whether one meets a bottom is judged at rest
    for approach, load, wanted in ((2e-3, 500.0, status.BOTTOM), (5e-4, 500.0, status.CONVERGED),
                                   (5e-4, 50.0, status.OUTSIDE), (5e-4, 25_000.0, status.OUTSIDE)):  # fmt: skip
        rest = Rest(law.contact.radius, jnp.array([approach]), jnp.array([load]))
        assert int(law.judge((shallow,), away, rest)) == wanted


@pytest.mark.gradient
def test_slopes_at_the_ends_of_what_it_knows() -> None:
    """A spall in the middle, and the longest: there its places' range ends, not how it changes."""
    aside = [float(jax.grad(lambda o: atlas_place.place_of(0.3, o, 1e-4).aside)(at)) for at in (0.0, 1e-6)]
    bend = float(jax.hessian(lambda o: atlas_place.place_of(0.3, o, 1e-4).aside)(0.0))
    assert aside[0] == 0.0
    assert bend == pytest.approx(aside[1] / 1e-6, rel=1e-6)
    assert bend > 1.0
    bearing = trb.bearing("32008J")
    longest = atlas_place.LONGEST * bearing.roller_length

    def stiffness(length: float) -> jax.Array:
        scene = trb.Scene(bearing, trb.Load(9000.0, 6000.0), (trb.Spall(length, 5.0),), law="table")
        return trb.solve(scene).stiffness[0, 0]

    slopes = [float(jax.grad(stiffness)(length)) for length in (longest, np.nextafter(longest, 0.0), longest - 1e-6)]
    less = float(stiffness(longest - 1e-4))
    np.testing.assert_allclose(slopes, (float(stiffness(longest)) - less) / 1e-4, rtol=1e-3)


def test_places_come_back() -> None:
    """Length and offset to the atlas's variables and back."""
    for length, aside, over_end in ((0.0, 0.3, False), (0.4, 1.0, False), (1.0, 0.0, False), (0.3, 0.0, True)):
        spall, whole = build_of_atlas.spall_at(1e-4, length, aside, over_end), build_of_atlas.LENGTH
        place = atlas_place.place_of(spall.length / whole, spall.axial_offset / whole, 1e-4)
        np.testing.assert_allclose(place, (length, aside, over_end, True), atol=1e-9)


# ------------------------------------------------------------------------------------------------ narrow spalls


@pytest.mark.slow
def test_narrow_law_is_continuous_in_width_and_distance(law: table.TableLaw) -> None:
    """From none to wide, through where the far land ceases to touch, is one curve that falls; away from it one that
    rises."""
    delta = jnp.asarray(4e-3)
    sound = float(q_over(law, trb.Spall(4.0, 7.0), 9.0, delta))

    def at(width, distance):
        return q_over(law, trb.Spall(4.0, width), distance, delta)

    for values, sign in ((jax.vmap(at, (0, None))(jnp.linspace(0.0, 1.2, 1201), 0.01), -1.0),
                         (jax.vmap(at, (None, 0))(0.2, jnp.linspace(0.0, 0.6, 1201)), 1.0)):  # fmt: skip
        steps = sign * np.diff(values) / sound
        assert steps.min() > -1e-4
        assert steps.max() < 1e-2
    assert float(at(0.0, 0.01)) == pytest.approx(sound, rel=1e-8)


def _narrow_load(v, law):
    """Load and stiffness by length, width, distance, approach, crown."""
    own = law.at(dataclasses.replace(law.contact, design_load=v[4]))
    return jnp.stack(load_over(own, v[3], trb.Spall(v[0], v[1]), v[2]))


narrow_load, narrow_reverse, narrow_forward = (
    jit_quickly()(one) for one in (_narrow_load, jax.jacrev(_narrow_load), jax.jacfwd(_narrow_load))
)


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.0, 1e-9, 1e-5, 1e-3])
@pytest.mark.parametrize("distance", [0.0, 0.03, 0.2])
def test_spalls_of_hardly_any_width_do_next_to_nothing(law: table.TableLaw, width: float, distance: float) -> None:
    v = jnp.asarray([4.0, width, distance, 4e-3, float(law.contact.design_load)])
    sound = float(q_over(law, None, 0.0, v[3]))
    assert float(narrow_load(v, law)[0]) == pytest.approx(sound, rel=1e-4 * width / 1e-3 + 1e-8)
    assert np.isfinite(narrow_reverse(v, law)).all()


@pytest.mark.slow
@pytest.mark.gradient
@pytest.mark.parametrize(("width", "distance"), [(0.05, 0.01), (0.12, 0.03), (0.25, 0.02), (0.12, 0.11)])
def test_narrow_slopes_by_three_ways(law: table.TableLaw, width: float, distance: float) -> None:
    """Reverse, forward and by differences."""
    start = jnp.asarray([4.0, width, distance, 4e-3, float(law.contact.design_load)])
    reverse, forward = narrow_reverse(start, law), narrow_forward(start, law)
    np.testing.assert_allclose(reverse, forward, rtol=1e-7, atol=1e-9 * float(jnp.abs(forward).max()))
    assert float(reverse[0, 3]) == pytest.approx(float(narrow_load(start, law)[1]), rel=1e-10)
    for i, h in enumerate((1e-5, 1e-7, 1e-7, 1e-10, 1e-2)):
        step = jnp.zeros(5).at[i].set(h)
        difference = (narrow_load(start + step, law) - narrow_load(start - step, law)) / (2 * h)
        off = np.abs((reverse[:, i] - difference) * start[i])
        assert (off <= 1e-4 * np.abs(difference * start[i]) + 1e-6 * narrow_load(start, law)).all(), (i, off)


def test_ramp_ends_where_it_says(law: table.TableLaw) -> None:
    """At the interval's ends the load is the healthy one and the one over the middle."""
    spall, delta = trb.Spall(4.0, 7.0, axial_offset=0.5), jnp.asarray(4e-3)
    low, high = law.ramp(0, spall, delta)
    healthy, full, *_ = edge_ramp.between(law.beside(spall), delta)
    assert float(q_over(law, spall, 3.5 - low, delta)) == pytest.approx(float(healthy), rel=1e-9)
    assert float(q_over(law, spall, 3.5 - high, delta)) == pytest.approx(float(full), rel=1e-9)


@pytest.mark.slow
def test_direct_knows_where_ramps_of_spalls_off_the_middle_end() -> None:
    """Land that lifts a roller as far as it sinks: the ramp's end was NaN, no roller stood on it, and a load was 9e-2
    of the largest off, converged."""
    contact = trb.LineContact(2.07826558, 7.111586407, 113794.4936, 3650.104329)
    spall = trb.Spall(1.1901421, 3.352038377, 0.35557932, axial_offset=1.873746654)
    law = direct_curves.without_edges(contact, 201.4747809, (spall,), 1e-3)
    assert np.isfinite(np.asarray(law.sunk)).all()
    low, high = law.ramp(0, spall, law.full[0, -1])
    assert float(low) < 0.0 < float(high)
