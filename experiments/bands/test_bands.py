"""Contacts by bands: their parts against plain formulas, their answers against converged lattices."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

import difftrb as trb
from difftrb.contact import contact_cells
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.solver import GRIDS
from difftrb.core.geometry import as_floats, contact_modulus
from experiments.bands import choice, solution, waves
from experiments.bands import contact as bands
from experiments.bands.choice import Quadratic

CONTACT = trb.LineContact(radius=3.623, length=13.66, modulus=float(contact_modulus(2.1e5, 0.278)), design_load=3000.0)
FINE = solution.FINENESS[1e-4]
# load [N], spall's length [mm], offset [mm] of a spall 1 mm wide, edges in reach, approach [mm] in the continuum:
# Polonsky-Keer on edge-aligned lattices up to 640 × 1366 and 80 × 10928, extrapolated; within 1e-6 … 3e-5
CONTINUUM = [
    (100.0, 4.0, 0.0, 0, 7.425538780e-04),
    (1000.0, 8.0, 0.0, 0, 5.243200774e-03),
    (3000.0, 2.0, 0.0, 0, 8.111204602e-03),
    (3000.0, 6.0, 0.0, 0, 1.041452150e-02),
    (3000.0, 2.0, 0.4, 1, 7.874553700e-03),
    (3000.0, 2.0, 0.5, 1, 7.663558878e-03),
    (3000.0, 2.0, 0.54, 1, 7.614832562e-03),
]


def inputs(load: float, length: float, offset: float, width: float = 1.0, tilt: float | None = None) -> Inputs:
    spall = trb.Spall(length, width, 0.2) if length else None
    numbers = [None if v is None else jnp.asarray(v, float) for v in (load, offset, tilt)]
    return Inputs(as_floats(CONTACT), numbers[0], as_floats(spall), numbers[1], numbers[2])  # type: ignore[arg-type]


def solved(given: Inputs, mirrored: bool, edges: int) -> bands.Bands:
    return bands.solve(given, mirrored, edges, FINE)[0]


@cache
def program(edges: int):
    """Approach and gradient, and all else."""

    def approach(given: Inputs) -> tuple[jax.Array, bands.Bands]:
        found = solved(given, True, edges)
        return found.approach, found

    return jax.jit(jax.value_and_grad(approach, has_aux=True))


def test_bessel_functions() -> None:
    x = np.linspace(0.0, 200.0, 4001)
    for order, found in zip((0, 1, 2), waves.bessel((0, 1, 2), jnp.asarray(x)), strict=True):
        np.testing.assert_allclose(np.asarray(found), scipy.special.jv(order, x), atol=1e-10)


def test_active_set_ends_at_the_projected_gradients_fixed_point() -> None:
    random = np.random.default_rng(3)
    root = random.normal(size=(30, 30))
    weight = jnp.asarray(random.uniform(0.5, 1.5, 30))
    problem = Quadratic(
        jnp.asarray(root @ root.T + 3.0 * np.eye(30)), jnp.asarray(random.normal(size=30)), weight, jnp.asarray(2.0)
    )
    found, active, still = jax.jit(partial(choice.solve, rounds=20))(problem, jnp.ones(30, bool))
    w, gradient = found.loads, problem.matrix @ found.loads + problem.gap - found.approach * weight
    assert bool(still)
    assert 2 < int(jnp.sum(active)) < 28
    for metric in (0.01, 1.0):
        np.testing.assert_allclose(np.asarray(jnp.maximum(w - metric * gradient, 0.0)), np.asarray(w), atol=1e-12)
    assert float(jnp.vdot(weight, w)) == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize(("load", "length", "offset", "edges", "approach"), CONTINUUM)
def test_approach_of_the_continuum(load: float, length: float, offset: float, edges: int, approach: float) -> None:
    (found, rest), _ = program(edges)(inputs(load, length, offset))
    assert float(found) == pytest.approx(approach, rel=1.2e-4)
    assert bool(rest.still)


@pytest.mark.parametrize("edges", [0, 1])
def test_gradient_is_that_of_differences(edges: int) -> None:
    """By load, radius, crown and spall; the value's own steps are as large as its error."""
    given = inputs(3000.0, 4.0, 0.45 if edges else 0.0)
    (_, rest), slopes = program(edges)(given)
    assert float(rest.compliance) == pytest.approx(float(slopes.load), rel=3e-3)

    def by_difference(change) -> float:
        low, high = (float(program(edges)(change(1.0 + h))[0][0]) for h in (-3e-3, 3e-3))
        return (high - low) / 6e-3

    spall, contact = given.spall, given.contact
    pairs = [
        (slopes.load * given.load, lambda s: given._replace(load=given.load * s)),
        (
            slopes.contact.radius * contact.radius,
            lambda s: given._replace(contact=trb.LineContact(contact.radius * s, contact.length, contact.modulus, 3e3)),
        ),
        (
            slopes.contact.design_load * contact.design_load,
            lambda s: given._replace(
                contact=trb.LineContact(contact.radius, contact.length, contact.modulus, contact.design_load * s)
            ),
        ),
        (
            slopes.spall.length * spall.length,  # type: ignore[union-attr]
            lambda s: given._replace(spall=trb.Spall(spall.length * s, spall.width, spall.depth)),  # type: ignore
        ),
    ]
    if edges:
        pairs.append((slopes.offset * given.offset, lambda s: given._replace(offset=given.offset * s)))
    for slope, change in pairs:
        assert float(slope) == pytest.approx(by_difference(change), rel=2e-2)


def test_moment_of_a_tilted_roller() -> None:
    """∂M/∂load = ∂δ/∂tilt: both are second derivatives of one energy; M steps with its rows."""

    def both(given: Inputs) -> tuple[jax.Array, bands.Bands]:
        found = solved(given, False, 0)
        return found.approach, found

    run = jax.jit(jax.value_and_grad(both, has_aux=True))
    (_, _), slopes = run(inputs(3000.0, 0.0, 0.0, tilt=1e-4))
    low, high = (run(inputs(load, 0.0, 0.0, tilt=1e-4))[0][1] for load in (2970.0, 3030.0))
    assert float(high.moment) < 0.0
    assert (float(high.moment) - float(low.moment)) / 60.0 == pytest.approx(float(slopes.tilt), rel=2e-2)


def test_pressure_on_cells() -> None:
    given = inputs(3000.0, 2.0, -0.5)
    cells, _, _ = contact_cells.stage(given, GRIDS[1e-3].cells, True)
    found = jax.jit(lambda given, cells: solution.solve(given, True, 1, 1e-4, cells))(given, cells)
    assert float(jnp.sum(found.force)) == pytest.approx(3000.0, rel=1e-10)
    assert float(jnp.min(found.force)) >= 0.0
    assert int(found.status_code) == 0
