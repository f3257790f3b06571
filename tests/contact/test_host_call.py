"""Contacts that a program has solved by numpy while it runs: the numbers that numbers get, and their gradient."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact.solver import approach_and_gradient
from difftrb.core import status
from difftrb.core.jax_config import jit_quickly

CASE = 3000.0, 4.0, 7.0, 3.4
PAIR = (trb.Spall(2.0, 7.0, axial_offset=-3.0), trb.Spall(2.0, 7.0, axial_offset=2.0))
LINES = {"numpy": 50, "strips": 17_000}
"""Of StableHLO for an approach with its gradient, at most."""


@pytest.fixture(scope="module")
def both(contact: trb.LineContact):
    def approach(load, length, width, offset):
        solution = trb.solve_contact(contact, load, trb.Spall(length, width), offset, 1e-2, "numpy")
        return solution.approach, solution

    return jax.jit(jax.value_and_grad(approach, (0, 1, 2, 3), has_aux=True))


def test_a_program_gets_what_numbers_get(contact: trb.LineContact, both) -> None:
    (_, solution), slopes = both(*CASE)
    load, length, width, offset = CASE
    exact, by = approach_and_gradient(contact, load, trb.Spall(length, width), offset, 1e-2)
    for name in ("approach", "moment", "contact_width", "residual", "iterations", "unknowns", "status_code"):
        assert float(getattr(solution, name)) == float(getattr(exact, name)), name
    np.testing.assert_allclose(solution.force, exact.force, rtol=1e-12, atol=1e-12 * load)
    assert isinstance(by.spall, trb.Spall)
    expected = [by.load, by.spall.length, by.spall.width, by.offset]
    np.testing.assert_allclose(slopes, np.array(expected, float), rtol=1e-12)


def test_the_gradient_is_what_differences_say(both) -> None:
    case = np.array(CASE)
    for k in range(4):
        step = 1e-4 * case * np.eye(4)[k]
        ((ahead, _), _), ((behind, _), _) = both(*(case + step)), both(*(case - step))
        assert float(both(*CASE)[1][k]) == pytest.approx(float(ahead - behind) / (2.0 * step[k]), rel=3e-3)


def test_forward_in_a_batch_and_in_a_loop(contact: trb.LineContact, both) -> None:
    offsets = jnp.linspace(3.0, 3.6, 3)

    def approach(offset):
        return trb.solve_contact(contact, CASE[0], trb.Spall(*CASE[1:3]), offset, 1e-2, "numpy").approach

    one_by_one = [both(*CASE[:3], float(offset)) for offset in offsets]
    value, slope = jit_quickly()(jax.vmap(lambda x: jax.jvp(approach, (x,), (jnp.ones(()),))))(offsets)
    np.testing.assert_allclose(value, [float(value) for (value, _), _ in one_by_one], rtol=1e-12)
    np.testing.assert_allclose(slope, [float(slopes[3]) for _, slopes in one_by_one], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(jit_quickly()(lambda x: jax.lax.map(approach, x))(offsets), value, rtol=1e-12)


def test_several_spalls_by_strips_in_a_program(contact: trb.LineContact) -> None:
    """Which programs cannot compile."""

    def approach(length, offset):
        first = dataclasses.replace(PAIR[0], length=length)
        return trb.solve_contact(contact, CASE[0], (first, PAIR[1]), (offset, 0.0), 1e-2, "numpy").approach

    value, slopes = jit_quickly()(jax.value_and_grad(approach, (0, 1)))(2.0, 3.4)
    exact, by = approach_and_gradient(contact, CASE[0], PAIR, (3.4, 0.0), 1e-2)
    assert isinstance(by.spall, tuple)
    assert isinstance(by.spall[0], trb.Spall)
    assert float(value) == pytest.approx(float(exact.approach), rel=1e-12)
    np.testing.assert_allclose(slopes, [float(by.spall[0].length), float(by.offset[0])], rtol=1e-12)


def test_what_it_cannot_do_has_a_status(contact: trb.LineContact) -> None:
    """And a derivative that is a number, for another way may be taken there."""
    straight = dataclasses.replace(contact, design_load=1e-3)

    def approach(load, of):
        solution = trb.solve_contact(of, load, None, 0.0, 1e-2, "numpy")
        return solution.approach, solution.status_code

    program = jit_quickly()(jax.value_and_grad(approach, has_aux=True))
    (_, code), slope = program(3000.0, straight)
    assert int(code) == status.UNSUITED
    assert np.isfinite(slope)
    (_, code), slope = program(np.nan, contact)
    assert int(code) == status.BAD_INPUT
    assert np.isfinite(slope)
    with pytest.raises(status.SceneError, match="does not take height maps"):
        trb.solve_contact(contact, 3000.0, trb.HeightMap(np.zeros((8, 8)), 1.0, 1.0), 0.0, 1e-2, "numpy")


@pytest.mark.parametrize("method", ["numpy", "strips", "cells"])
def test_second_derivatives_are_refused(contact: trb.LineContact, method) -> None:
    """They were NaN by cells, and wrong by strips: what is found was held still."""

    def approach(offset):
        return trb.solve_contact(contact, CASE[0], trb.Spall(*CASE[1:3]), offset, 1e-2, method).approach

    with pytest.raises(status.SceneError, match="first derivatives only"):
        jax.jit(jax.hessian(approach)).lower(3.4)


@pytest.mark.parametrize("method", LINES)
def test_programs_keep_their_size(contact: trb.LineContact, method) -> None:
    def approach(load, length, width, offset):
        return trb.solve_contact(contact, load, trb.Spall(length, width), offset, 1e-2, method).approach

    program = jax.jit(jax.value_and_grad(approach, (0, 1, 2, 3)))
    assert len(program.lower(*CASE).as_text().splitlines()) < LINES[method]
