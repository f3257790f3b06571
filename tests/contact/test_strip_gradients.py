"""Derivatives of the strips: against differences, zero where nothing is touched, smooth where an edge moves."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import solver as contacts
from difftrb.contact.contact_solution import Inputs
from difftrb.core.geometry import LineContact, Spall

pytestmark = pytest.mark.gradient

NAMES = ("load", "length", "width", "offset", "radius", "roller_length", "modulus", "design_load", "axial_offset")
HERE = (3.623, 13.66, 113794.5, 3000.0, 0.0)
POINTS = {
    "no edge in reach": (2900.0, 4.1, 7.0, 0.1),
    "edge in the contact": (2900.0, 2.1, 1.0, 0.47),
    "narrow": (2900.0, 2.1, 0.12, 0.03),
    "off the middle": (2900.0, 2.1, 1.0, 0.47, *HERE[:-1], 1.3),
}


def case(v) -> tuple[LineContact, float, Spall, float]:
    return LineContact(*v[4:8]), v[0], Spall(v[1], v[2], 0.2, 0.0, v[8]), v[3]


def at(point: str) -> tuple[float, ...]:
    given = POINTS[point]
    return (*given, *HERE[len(given) - 4 :])


def by_numbers(v: tuple[float, ...], accuracy: float) -> np.ndarray:
    solution, by = contacts.approach_and_gradient(*case(v), accuracy, "strips")
    assert int(solution.status_code) == 0
    return in_order(by)


def in_order(by: Inputs) -> np.ndarray:
    roller, spall = by.contact, by.spall
    assert isinstance(spall, Spall)
    every = (by.load, spall.length, spall.width, by.offset, roller.radius, roller.length, roller.modulus)
    return np.array([*map(float, every), float(roller.design_load), float(spall.axial_offset)])


@cache
def program(accuracy: float, way=jax.grad):
    return jax.jit(way(lambda v: trb.solve_contact(*case(v), accuracy, "strips").approach))


@pytest.mark.parametrize("point", [*(p for p in POINTS if p != "off the middle"),
                                   pytest.param("off the middle", marks=pytest.mark.slow)])  # fmt: skip
def test_gradient_matches_central_differences(point: str) -> None:
    """Of fourth order over 3e-3. Boundaries settle to a fifth of the accuracy, which is in either."""
    here = at(point)
    found = by_numbers(here, 1e-4)

    def value(index: int, by: float) -> float:
        moved = [v + by * (i == index) for i, v in enumerate(here)]
        return float(trb.solve_contact(*case(moved), 1e-4, "strips").check().approach)

    for i, name in enumerate(NAMES):
        if here[i] == 0.0:
            continue  # half the roller was solved
        h = 3e-3 * abs(here[i])
        one, two = (value(i, k * h) - value(i, -k * h) for k in (1, 2))
        difference = (8.0 * one - two) / (12.0 * h)
        scale = 5e-5 * value(i, 0.0) / here[i]  # what a derivative of the size of the value would be
        assert found[i] == pytest.approx(difference, rel=3e-3, abs=scale), name


@pytest.mark.slow
@pytest.mark.parametrize("point", ["edge in the contact", "off the middle"])
def test_a_program_has_the_derivatives_of_numbers(point: str) -> None:
    v = jnp.array(at(point))
    reverse = program(1e-2)(v)
    np.testing.assert_allclose(program(1e-2, jax.jacfwd)(v), reverse, rtol=1e-9)
    if point == "off the middle":
        np.testing.assert_allclose(by_numbers(at(point), 1e-2), reverse, rtol=1e-6)


def test_edges_out_of_the_contact_do_not_matter() -> None:
    here = (2900.0, 4.1, 1.0, 0.0, *HERE)
    for found in (by_numbers(here, 1e-2), program(1e-2)(jnp.array(here))):
        by = dict(zip(NAMES, found, strict=True))
        assert float(by["width"]) == 0.0
        assert float(by["offset"]) == 0.0


@pytest.mark.parametrize(("index", "reach", "share"), [(3, 0.01, 2e-4), (2, 0.02, 2e-4), (1, 0.02, 1e-4)])
def test_slopes_do_not_ripple_as_an_edge_moves(index: int, reach: float, share: float) -> None:
    """Slopes follow a cubic within 2e-4 over a tenth of a half-width: 3e-3 before frequencies faded out."""
    here = at("edge in the contact")
    steps = np.linspace(-reach, reach, 9)
    moved = [tuple(v + s * (i == index) for i, v in enumerate(here)) for s in steps]
    found = np.array([by_numbers(v, 1e-4)[index] for v in moved])
    curve = np.polyval(np.polyfit(steps, found, 3), steps)
    assert np.ptp(found - curve) < share * abs(found.mean())


def test_slivers_beyond_an_edge_move_with_it() -> None:
    """Land hardly touched beyond a spall's edge is an outline of the least width, at whose free end pressure does not
    vanish: that end stayed when the edge moved, and the slope by load was 31 % off, that by the edge's place 30 %."""
    contact, spall = LineContact(4.0991, 12.92, 113794.5, 2336.10), Spall(10.05498, 16.96386)
    load, offset = 289.93, 0.5 * spall.width - 0.1233

    def approach(load: float, offset: float) -> float:
        return float(trb.solve_contact(contact, load, spall, offset, 1e-3, "strips").check().approach)

    _, by = contacts.approach_and_gradient(contact, load, spall, offset, 1e-3, "strips")
    h, d = 3e-3 * load, 1e-3
    by_load = (approach(load + h, offset) - approach(load - h, offset)) / (2.0 * h)
    by_offset = (approach(load, offset + d) - approach(load, offset - d)) / (2.0 * d)
    assert float(by.load) == pytest.approx(by_load, rel=5e-3)
    assert float(by.offset) == pytest.approx(by_offset, rel=5e-3)


def test_by_the_load_alone_the_mesh_moves_too() -> None:
    """Differentiated by the load and nothing else, only the load that slices lack has a derivative: rows stood still,
    and the compliance of a light, strongly tilted roller was as if they did."""
    contact, load, tilt = LineContact(4.0, 13.0, 113794.5, 6500.0), 150.0, 4e-4
    _, by = contacts.approach_and_gradient(contact, load, accuracy=1e-2, method="strips", tilt=tilt)

    def approach(load: jax.Array) -> jax.Array:
        return trb.solve_contact(contact, load, accuracy=1e-2, method="strips", tilt=tilt).approach

    assert float(jax.grad(approach)(load)) == pytest.approx(float(by.load), rel=1e-6)


def test_half_a_roller_knows_no_axial_offset() -> None:
    """A spall in the middle moves to either side alike: the gradient was that of a spall that grows at both ends."""
    contact, spall = LineContact(4.0, 13.0, 113794.5, 6500.0), Spall(4.0, 1.0)
    for method in ("strips", "cells"):
        _, by = contacts.approach_and_gradient(contact, 3000.0, spall, 0.3, 1e-2, method)
        assert float(by.spall.axial_offset) == 0.0


def test_a_healthy_roller_by_its_length_in_a_program(contact: trb.LineContact) -> None:
    """On half the roller the ends of slices are its length by known numbers, which a traced index could not take from:
    the gradient by a whole contact raised."""

    def approach(of: trb.LineContact):
        return trb.solve_contact(of, 3000.0, None, 0.0, 1e-2, "strips").approach

    found = jax.jit(jax.grad(approach))(contact)
    _, by = contacts.approach_and_gradient(contact, 3000.0, None, 0.0, 1e-2, "strips")
    for name in ("radius", "length", "modulus", "design_load"):
        assert float(getattr(found, name)) == pytest.approx(float(getattr(by.contact, name)), rel=1e-7), name
