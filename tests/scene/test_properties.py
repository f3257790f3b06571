"""What holds for every contact and every ring, whatever the numbers: by hypothesis."""

import dataclasses

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import halfspace
from difftrb.core import status
from difftrb.core.geometry import LineContact, Spall
from difftrb.law import base
from difftrb.ring import roller_places
from difftrb.ring.load import needed_axial

pytestmark = pytest.mark.hard

BEARING = trb.bearing("32008J")
CONTACT = LineContact.of(BEARING, "outer", 6500.0)
LENGTH = float(BEARING.roller_length)
few = hypothesis.settings(max_examples=25, derandomize=True, deadline=None, database=None)


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda v: 10.0**v)


LOADS, SIZES = decades(-2.0, 5.0), st.floats(0.01, 0.95).map(lambda v: v * LENGTH)
WIDTHS, DEPTHS, SHARES = decades(-0.3, 2.0), decades(-3.0, 1.0), st.floats(-1.2, 1.2)


@jax.jit
def pressed(load, length, width, depth, offset, radius, roller, modulus, design_load):
    """By cells: the solution, and the gap that is left under every cell [mm]."""
    contact = LineContact(radius, roller, modulus, design_load)
    s = trb.solve_contact(contact, load, Spall(length, width, depth), offset, 1e-2, "cells")
    W = halfspace.influence(s.cells, jnp.asarray(modulus))
    displaced = W.displacement(s.force)
    return s, displaced + s.gap - s.approach, displaced


def solved(load, length, width, depth, share, size=1.0, modulus=1.0):
    """The same of 32008J, with all lengths times `size`, the modulus times `modulus`, loads times both that takes."""
    lengths = (length, width, depth, 0.5 * share * width, CONTACT.radius, LENGTH)
    more = size**2 * modulus
    numbers = (load * more, *(v * size for v in lengths), CONTACT.modulus * modulus, CONTACT.design_load * more)
    return pressed(*(float(v) for v in numbers))


@few
@hypothesis.given(LOADS, SIZES, WIDTHS, DEPTHS, SHARES)
def test_contact_neither_pulls_nor_overlaps(load, length, width, depth, share) -> None:
    """p ≥ 0, gap ≥ 0, p · gap = 0, and the whole load."""
    s, gap, _ = solved(load, length, width, depth, share)
    delta = float(s.approach)
    assert bool(s.converged)
    assert float(jnp.min(s.force)) >= 0.0
    assert float(jnp.min(gap)) >= -1e-9 * delta
    assert float(jnp.sum(s.force * jnp.abs(gap))) <= 1e-9 * load * delta
    assert float(jnp.sum(s.force)) == pytest.approx(load, rel=1e-12)


@few
@hypothesis.given(LOADS, SIZES, WIDTHS, DEPTHS, SHARES, st.floats(1.05, 2.0))
def test_approach_grows_with_load_and_length(load, length, width, depth, share, factor) -> None:
    """By more than the accuracy: longer by an amount that a grid of 1e-2 can tell apart."""
    delta = float(solved(load, length, width, depth, share)[0].approach)
    assert float(solved(factor * load, length, width, depth, share)[0].approach) > delta
    longer = float(solved(load, min(factor * length, LENGTH), width, depth, share)[0].approach)
    assert longer > delta * (1.0 - 5e-3)


@few
@hypothesis.given(LOADS, SIZES, WIDTHS, DEPTHS, SHARES)
def test_approach_is_between_healthy_and_a_depth_more(load, length, width, depth, share) -> None:
    healthy = float(solved(load, 1e-6, 7.0, 1e-9, 0.0)[0].approach)
    delta = float(solved(load, length, width, depth, share)[0].approach)
    assert healthy * (1.0 - 1e-2) <= delta <= (healthy + depth) * (1.0 + 1e-2)


@few
@hypothesis.given(LOADS, SIZES, WIDTHS, DEPTHS, SHARES)
def test_energy(load, length, width, depth, share) -> None:
    """Load × approach is twice the elastic energy and the work against the gap, and dE/dload is the approach."""
    s, _, displaced = solved(load, length, width, depth, share)
    elastic, work = float(jnp.vdot(s.force, displaced)), float(jnp.vdot(s.force, s.gap))
    assert load * float(s.approach) == pytest.approx(elastic + work, rel=1e-9)
    assert elastic > 0.0

    def energy(load: float) -> float:
        s, _, displaced = solved(load, length, width, depth, share)
        return float(0.5 * jnp.vdot(s.force, displaced) + jnp.vdot(s.force, s.gap))

    # cells move with the load, so this holds to their accuracy
    step = 1e-3 * load
    slope = (energy(load + step) - energy(load - step)) / (2.0 * step)
    assert slope == pytest.approx(float(s.approach), rel=1e-2)


@few
@hypothesis.given(LOADS, SIZES, WIDTHS, DEPTHS, SHARES)
def test_contact_is_symmetric(load, length, width, depth, share) -> None:
    """A spall to the left is one to the right: to rounding, but for a lattice that has to round one way."""
    one, other = (float(solved(load, length, width, depth, side * share)[0].approach) for side in (1.0, -1.0))
    assert one == pytest.approx(other, rel=2e-3)


@few
@hypothesis.given(LOADS, SIZES, WIDTHS, DEPTHS, SHARES, decades(-2.0, 2.0), decades(-2.0, 2.0))
def test_contact_has_no_scale(load, length, width, depth, share, size, modulus) -> None:
    """All lengths times s and the modulus times m, loads times s² m: the approach times s."""
    delta = float(solved(load, length, width, depth, share)[0].approach)
    scaled, *_ = solved(load, length, width, depth, share, size, modulus)
    assert float(scaled.approach) == pytest.approx(delta * size, rel=1e-8)


def test_a_batch_of_contacts_is_its_members() -> None:
    """To rounding, for mapped programs fuse sums differently."""
    rng = np.random.default_rng(0)
    rows = jnp.asarray(
        np.stack([10.0 ** rng.uniform(-2, 5, 8), rng.uniform(0.1, 12.0, 8), rng.uniform(0.5, 9.0, 8)], 1)
    )

    rest = (0.2, 0.3, float(CONTACT.radius), LENGTH, float(CONTACT.modulus), 6500.0)
    together = jax.jit(lambda rows: jax.lax.map(lambda row: pressed(*row, *rest)[0].approach, rows))(rows)
    alone = [float(pressed(*(float(v) for v in row), *rest)[0].approach) for row in rows]
    np.testing.assert_allclose(together, alone, rtol=1e-11)


# ------------------------------------------------------------------------------------------------------------- rings


def scene_of(radial, axial, phase, length, width, angle) -> trb.Scene:
    spall = Spall(length, width, depth=10.0, angle=angle)  # so deep that no load presses a roller on its bottom
    return trb.Scene(BEARING, trb.Load(radial, axial), (spall,), law="liu2018", phase=phase)


@jax.jit
def rest(*numbers):
    """The spalled ring and the healthy one."""
    scene = scene_of(*numbers)
    spalled, sound = trb.solve(scene), trb.solve(dataclasses.replace(scene, spalls=()))
    return spalled, sound


RADIALS, MARGINS, PHASES = decades(-1.0, 6.0), decades(-3.0, 2.0), st.floats(-6.0, 6.0)
ANY_RING = (RADIALS, MARGINS, PHASES, st.floats(0.0, 8.0), WIDTHS, st.floats(-3.0, 3.0))


def ring_of(radial, margin, phase, length, width, angle):
    axial = float(needed_axial(BEARING, radial, phase)) * (1.0 + margin)
    return axial, rest(radial, axial, phase, length, width, angle)


@few
@hypothesis.given(*ANY_RING)
def test_ring_is_in_equilibrium(radial, margin, phase, length, width, angle) -> None:
    """Loads push and balance to 1e-10; stiffness is symmetric and positive definite; a roller that is clear is idle."""
    axial, (r, _) = ring_of(radial, margin, phase, length, width, angle)
    assert bool(r.converged)
    normals = roller_places.directions(BEARING, r.angles)
    force = np.array([radial, 0.0, axial])
    np.testing.assert_allclose(normals.T @ r.loads, force, atol=1e-10 * np.linalg.norm(force))
    assert float(jnp.min(r.loads)) >= 0.0
    np.testing.assert_array_equal(np.asarray(r.loads > 0.0), np.asarray(r.approach > 0.0))
    K = np.asarray(r.stiffness)
    np.testing.assert_allclose(K, K.T, atol=1e-12 * np.abs(K).max())
    assert np.linalg.eigvalsh(K)[0] > 0.0


@few
@hypothesis.given(*ANY_RING)
def test_a_spall_only_softens(radial, margin, phase, length, width, angle) -> None:
    """The ring sinks in further, in the sense of the work of the load."""
    axial, (r, sound) = ring_of(radial, margin, phase, length, width, angle)
    force = jnp.array([radial, 0.0, axial])
    work, without = float(jnp.vdot(force, r.displacement)), float(jnp.vdot(force, sound.displacement))
    assert work >= without - 1e-9 * float(jnp.linalg.norm(force) * jnp.linalg.norm(sound.displacement))


@few
@hypothesis.given(LOADS, st.floats(0.0, 1.5), st.floats(0.0, 8.0), st.floats(0.5, 170.0))
def test_loss_of_stiffness_is_no_gain(axial, share, length, width) -> None:
    """Of a ring that is loaded all round, with a spall at the load line; radially and axially, tangent.

    To 1e-3: below half a millimetre Table 2's exponent grows with length so fast that rollers stiffen by up to 5e-4.
    """
    r, sound = rest(share * axial, axial, 0.0, length, width, 0.0)
    for i in (0, 2):
        assert float(r.stiffness[i, i]) <= float(sound.stiffness[i, i]) * (1.0 + 1e-3)


@few
@hypothesis.given(*ANY_RING)
def test_ring_is_symmetric_and_turns(radial, margin, phase, length, width, angle) -> None:
    """Mirrored about the load line; and with all rollers one place on."""
    _, (r, _) = ring_of(radial, margin, phase, length, width, angle)
    axial = float(needed_axial(BEARING, radial, phase)) * (1.0 + margin)
    turn = 2.0 * np.pi / BEARING.rollers
    away = np.abs(np.asarray(roller_places.distances(BEARING, (Spall(length, width, angle=angle),), r.angles))[0])
    hypothesis.assume(np.abs(away - 0.5 * width).min() > 1e-9)  # else rounding decides who is in the spall
    mirrored, _ = rest(radial, axial, -phase, length, width, -angle)
    size = float(jnp.max(jnp.abs(r.displacement)))
    np.testing.assert_allclose(mirrored.displacement, r.displacement * np.array([1.0, -1.0, 1.0]), atol=1e-7 * size)
    turned, _ = rest(radial, axial, phase + turn, length, width, angle)
    np.testing.assert_allclose(turned.displacement, r.displacement, atol=1e-7 * size)


@few
@hypothesis.given(*ANY_RING, decades(-2.0, 2.0))
def test_healthy_ring_scales_with_its_load(radial, margin, phase, length, width, angle, factor) -> None:
    """One power n for all rollers: displacements go with load^(1/n), stiffness with load^(1 − 1/n)."""
    axial, (_, sound) = ring_of(radial, margin, phase, length, width, angle)
    _, more = rest(factor * radial, factor * axial, phase, length, width, angle)
    n = float(trb.liu2018().exponent[0])
    np.testing.assert_allclose(more.displacement, sound.displacement * factor ** (1.0 / n),
                               atol=1e-7 * float(jnp.max(jnp.abs(more.displacement))))  # fmt: skip
    size = float(jnp.max(jnp.abs(more.stiffness)))
    np.testing.assert_allclose(more.stiffness, sound.stiffness * factor ** (1.0 - 1.0 / n), atol=1e-6 * size)


def test_a_batch_of_rings_is_its_members() -> None:
    """To rounding, as far as Newton's method ends at another bit: 1e-10 of the largest load."""
    rng = np.random.default_rng(0)
    radial, phase = 10.0 ** rng.uniform(-1, 5, 32), rng.uniform(-6, 6, 32)
    axial = np.array([float(needed_axial(BEARING, r, p)) for r, p in zip(radial, phase, strict=True)])
    axial = axial * (1.0 + 10.0 ** rng.uniform(-3, 2, 32))
    rows = [radial, axial, phase, rng.uniform(0, 8, 32), rng.uniform(1, 100, 32), rng.uniform(-3, 3, 32)]
    together, _ = jax.vmap(rest)(*map(jnp.asarray, rows))
    assert (np.asarray(together.status_code) == status.CONVERGED).all()
    for k in range(32):
        alone, _ = rest(*(float(row[k]) for row in rows))
        np.testing.assert_allclose(together.loads[k], alone.loads, atol=1e-10 * float(jnp.max(alone.loads)))


@jax.jit
def carried(approach, length):
    """Load and slope of a roller over the middle of a spall."""
    return base.load_over(trb.liu2018(), approach, Spall(length, 7.0))


@few
@hypothesis.given(st.floats(1e-9, 1.0), st.floats(0.0, 8.0))
def test_law_and_its_slope(approach, length) -> None:
    """dQ/dδ as the law says it, against a difference; Q and its slope positive."""
    step = 1e-5 * approach
    (load, slope), (ahead, _), (behind, _) = (carried(approach + side * step, length) for side in (0.0, 1.0, -1.0))
    load, slope, ahead, behind = map(float, (load, slope, ahead, behind))
    assert load > 0.0
    assert slope == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-6)
