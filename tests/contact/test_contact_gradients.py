"""Derivatives of a contact: AD against central differences, and against derivations that share nothing with it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import crown, gap, halfspace
from difftrb.contact import solver as contacts
from difftrb.contact.contact_cells import stage
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.grids import GRIDS
from difftrb.core.geometry import LineContact, Spall
from difftrb.core.jax_config import jit_quickly

pytestmark = pytest.mark.gradient

NAMES = (
    "load",
    "length",
    "width",
    "offset",
    "axial_offset",
    "depth",
    "radius",
    "design_load",
    "modulus",
    "roller_length",
)
# edges in the contact; wide and centred; off the middle of the roller; shallow: the roller touches the bottom
POINTS = {
    "edge": (2900.0, 2.1, 1.0, 0.47, 0.3, 0.2),
    "wide": (1300.0, 4.3, 7.0, 0.05, 0.0, 0.2),
    "shallow": (2500.0, 3.1, 7.0, 0.0, 1.2, 0.0021),
}


@jax.jit
def approach(inputs: jax.Array) -> jax.Array:
    load, length, width, offset, axial_offset, depth, radius, design_load, modulus, roller_length = inputs
    contact = LineContact(radius, roller_length, modulus, design_load)
    return trb.solve_contact(
        contact, load, Spall(length, width, depth, 0.0, axial_offset), offset, 1e-2, "cells"
    ).approach


def inputs_at(point: str, contact: LineContact) -> jax.Array:
    ends = (contact.radius, contact.design_load, contact.modulus, contact.length)
    return jnp.array([float(v) for v in (*POINTS[point], *ends)])


gradient = jax.jit(jax.grad(approach))


@pytest.mark.parametrize("point", POINTS)
def test_gradient_matches_central_differences(point: str, contact: LineContact) -> None:
    at = inputs_at(point, contact)
    slopes = gradient(at)
    delta = float(approach(at))
    for i, name in enumerate(NAMES):
        size = max(abs(float(at[i])), 0.01)
        step = 1e-5 * size
        difference = (approach(at.at[i].add(step)) - approach(at.at[i].add(-step))) / (2.0 * step)
        assert float(slopes[i]) == pytest.approx(float(difference), rel=1e-6, abs=1e-9 * delta / size), name


def test_length_derivative_of_the_continuum(contact: LineContact) -> None:
    """3 kN, 2 mm, crown of 3 kN: 3.80e-4 mm/mm (differences of continuum solutions)."""
    paper = LineContact(3.623, 13.66, 2.1e5 / (2.0 * (1.0 - 0.278**2)), 3000.0)
    slopes = trb.approach_slopes(paper, 3000.0, Spall(2.0, 7.0), accuracy=1e-3)
    assert float(slopes["length"]) == pytest.approx(3.80e-4, rel=5e-3)  # type: ignore[arg-type]


@pytest.mark.portable
def test_forward_and_reverse_agree(contact: LineContact) -> None:
    at = inputs_at("edge", contact)
    np.testing.assert_allclose(jax.jacfwd(approach)(at), gradient(at), rtol=1e-9, atol=1e-16)


@pytest.mark.slow
def test_approach_slopes_are_the_gradient(contact: LineContact) -> None:
    at = inputs_at("edge", contact)
    load, length, width, offset, axial_offset, depth = (float(v) for v in at[:6])
    slopes = trb.approach_slopes(contact, load, Spall(length, width, depth, 0.0, axial_offset), offset, 1e-2, "cells")
    expected = dict(zip(NAMES, gradient(at), strict=True))
    for name, value in slopes.items():
        assert float(value) == pytest.approx(float(expected[name]), rel=1e-9), name
    healthy = trb.approach_slopes(contact, load, None, 0.0, 1e-2, "cells")
    assert healthy["length"] is healthy["width"] is healthy["offset"] is None


def test_approach_and_gradient_is_by_every_input(contact: LineContact) -> None:
    """Each in the form of the input itself, against central differences; a tilt that is not there has none."""
    at = inputs_at("edge", contact)
    load, length, width, offset, axial_offset, depth = (float(v) for v in at[:6])
    spall = Spall(length, width, depth, 0.0, axial_offset)
    solution, (by_contact, by_load, by_spall, by_offset, by_tilt) = contacts.approach_and_gradient(
        contact, load, spall, offset, 1e-2, "cells"
    )
    assert by_tilt is None
    found = [by_load, by_spall.length, by_spall.width, by_offset, by_spall.axial_offset, by_spall.depth]
    found += [by_contact.radius, by_contact.design_load, by_contact.modulus, by_contact.length]
    assert float(solution.approach) == pytest.approx(float(approach(at)), rel=1e-12)
    for i, name in enumerate(NAMES):
        size = float(at[i])
        ahead, behind = (float(approach(at.at[i].multiply(1.0 + side * 1e-5))) for side in (1.0, -1.0))
        rounding = 1e-9 * float(solution.approach) / size
        assert float(found[i]) == pytest.approx((ahead - behind) / (2e-5 * size), rel=1e-6, abs=rounding), name


@pytest.mark.slow
def test_second_derivation_dense_linear_algebra(contact: LineContact) -> None:
    """The same derivative from the dense contact equations of the loaded cells, differentiated by hand in numpy."""
    spall, load, offset = Spall(2.1, 1.0), 2900.0, 0.47
    s = trb.solve_contact(contact, load, spall, offset, 1e-2, "cells")

    @jax.jit
    def system(length: float) -> tuple[jax.Array, jax.Array]:
        changed = dataclasses.replace(spall, length=length)
        inputs = Inputs(contact, jnp.asarray(load), changed, jnp.asarray(offset))
        cells = stage(inputs, GRIDS[1e-2].cells, True).cells
        W = halfspace.influence(cells, jnp.asarray(contact.modulus))
        g = gap.curvature(cells, contact.radius) + crown.mean_of_rows(cells.lines, contact)[:, None]
        units = jnp.eye(s.force.size).reshape(-1, *s.force.shape)
        columns = jax.lax.map(lambda e: W.displacement(e).ravel(), units)
        return columns.T, jnp.broadcast_to(g, s.force.shape).ravel()

    def solve(length: float) -> float:
        W, g = map(np.asarray, system(length))
        on = np.flatnonzero(np.asarray(s.force).ravel() > 0.0)
        A = np.block([[W[np.ix_(on, on)], -np.ones((on.size, 1))], [np.ones((1, on.size)), np.zeros((1, 1))]])
        return float(np.linalg.solve(A, np.append(-g[on], load))[-1])

    assert solve(2.1) == pytest.approx(float(s.approach), rel=1e-10)
    h = 1e-5
    slopes = trb.approach_slopes(contact, load, spall, offset, 1e-2, "cells")
    assert float(slopes["length"]) == pytest.approx((solve(2.1 + h) - solve(2.1 - h)) / (2 * h), rel=1e-6)


def test_second_derivation_energy(contact: LineContact) -> None:
    """δ = dE/dQ, so dδ/dR is the load derivative of ∂E/∂R at fixed forces (Maxwell's relation)."""
    spall, offset = Spall(4.0, 7.0), 0.0

    def by_radius(load: float) -> float:
        s = trb.solve_contact(contact, load, spall, offset, 1e-2, "cells")
        second_moment = s.cells.x**2 + s.cells.pitch**2 / 12.0
        return -float(jnp.sum(s.force * second_moment[None, :])) / (2.0 * float(contact.radius) ** 2)

    # differences over 20 % of the load average the lattice's ripple
    h = 300.0
    reference = (by_radius(1500.0 + h) - by_radius(1500.0 - h)) / (2 * h)
    slopes = trb.approach_slopes(contact, 1500.0, spall, offset, 1e-2, "cells")
    assert float(slopes["radius"]) == pytest.approx(float(reference), rel=3e-2)


def test_compliance_is_the_load_derivative_of_the_approach(contact: LineContact) -> None:
    """dδ/dQ from one linear solve against the secant of two solves 1 % apart."""
    solve = [float(trb.solve_contact(contact, q, Spall(4.0, 7.0), accuracy=1e-2).approach) for q in (1485.0, 1515.0)]
    slopes = trb.approach_slopes(contact, 1500.0, Spall(4.0, 7.0), accuracy=1e-2)
    assert float(slopes["load"]) == pytest.approx((solve[1] - solve[0]) / 30.0, rel=5e-3)


def test_width_and_offset_of_a_spall_that_covers_the_contact_do_not_matter(contact: LineContact) -> None:
    slopes = trb.approach_slopes(contact, 2000.0, Spall(4.0, 7.0), 0.1, 1e-2)
    assert float(slopes["width"]) == 0.0
    assert float(slopes["offset"]) == 0.0
    assert float(slopes["length"]) > 0.0


@pytest.mark.slow
def test_peak_pressure_and_forces_are_differentiable(contact: LineContact) -> None:
    def peak(load: jax.Array) -> jax.Array:
        return trb.solve_contact(contact, load, None, accuracy=1e-2, method="cells").peak_pressure

    load, h = jnp.asarray(1500.0), 1e-3
    difference = (peak(load + h) - peak(load - h)) / (2 * h)
    reverse, forward = (float(jit_quickly()(way(peak))(load)) for way in (jax.grad, jax.jacfwd))
    assert reverse == pytest.approx(float(difference), rel=1e-4)
    assert forward == pytest.approx(reverse, rel=1e-8)
