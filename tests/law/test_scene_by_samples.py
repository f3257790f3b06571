"""Scenes by the law "direct" where a closed form stands in for the contact solver."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core.jax_config import jit_quickly
from difftrb.law import samples
from tests import closed_form, shapes

pytestmark = pytest.mark.exact

SPALL = trb.Spall(4.0, 7.0)


def prepared(bearing, roller_law: str, **changes) -> trb.Scene:
    # half a millimetre before the pitch between two rollers, one stands on the ramp
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (SPALL,), law=roller_law, phase=0.1215)
    return trb.prepare(dataclasses.replace(scene, **changes))


@jit_quickly(static_argnames=("derivative",))
def slopes(scene: trb.Scene, derivative: Callable) -> tuple[jax.Array, trb.Solution]:
    """Of radial stiffness by length, width, angle, design load and modulus; the solution."""

    def at(x: jax.Array) -> tuple[jax.Array, trb.Solution]:
        spall = dataclasses.replace(scene.spalls[0], length=x[0], width=x[1], angle=x[2])
        bearing = dataclasses.replace(scene.bearing, modulus=x[4])
        moved = dataclasses.replace(scene, spalls=(spall, *scene.spalls[1:]), design_load=x[3], bearing=bearing)
        solution = trb.solve(moved)
        return solution.stiffness[0, 0], solution

    spall = scene.spalls[0]
    values = spall.length, spall.width, spall.angle, scene.design_load, scene.bearing.modulus
    return derivative(at, has_aux=True)(jnp.stack([jnp.asarray(value, float) for value in values]))


def test_results_have_the_shapes_that_they_say(closed, bearing) -> None:
    """A roller stands on the ramp."""
    ready, mean = prepared(bearing, "direct"), prepared(bearing, "direct", phase="mean")
    assert len(ready.law.states.at)
    assert len(mean.law.edges[0].loads)
    for result in (ready.law.states, trb.solve(ready), mean.law, mean.law.edges[0], trb.solve(mean)):
        shapes.check(result)


@pytest.mark.slow
def test_errors_of_solves_hardly_move_a_derivative(closed, bearing) -> None:
    """Approaches 3e-5 off and their slopes 1e-3, as of contacts at 1e-4: loads closer together make more of it."""
    scene, rng = prepared(bearing, "direct"), np.random.default_rng(0)
    states = scene.law.states
    wanted = np.asarray(slopes(scene, jax.grad)[0])
    for _ in range(5):
        off = rng.standard_normal(states.approaches.shape)
        noisy = states._replace(
            approaches=states.approaches * (1.0 + 3e-5 * off), slopes=states.slopes * (1.0 + 1e-3 * off[..., None])
        )
        moved = dataclasses.replace(scene.law, states=noisy)
        got = np.asarray(slopes(dataclasses.replace(scene, law=moved), jax.grad)[0])
        assert got[:2] == pytest.approx(wanted[:2], rel=2e-2)


def test_an_edge_just_out_of_reach_tells_nothing(closed, bearing) -> None:
    """At larger loads that the roller is solved at it is in reach, and the derivative by width was of these."""
    wide = prepared(bearing, "direct", phase=0.0)
    contact, load = wide.law.contact, trb.solve(wide).loads[0]
    reach = float(closed_form.reach(contact, closed_form.approach(contact, load, SPALL, 0.0), SPALL))
    beyond = dataclasses.replace(SPALL, width=2.0 * 1.1 * reach)
    by, solution = slopes(prepared(bearing, "direct", phase=0.0, spalls=(beyond,)), jax.grad)
    assert bool(solution.converged)
    assert float(by[1]) == 0.0
    assert float(by[0]) < 0.0


@pytest.mark.parametrize(("accuracy", "at"), [(1e-2, 1e-2), (1e-3, 1e-3), (1e-4, 3e-5)])
def test_exact_laws_solve_more_exact_edges(closed, bearing, monkeypatch, accuracy: float, at: float) -> None:
    asked: list[float] = []
    solved = samples.all_solved

    def all_solved(contact, cases, accuracy, *more):
        asked.append(accuracy)
        return solved(contact, cases, accuracy, *more)

    monkeypatch.setattr(samples, "all_solved", all_solved)
    prepared(bearing, "direct", accuracy=accuracy)
    assert asked[0] == accuracy
    assert len(asked) > 2
    assert asked[1:] == pytest.approx([at] * len(asked[1:]))


STEPS = {"length": 1e-3, "width": 1e-4, "angle": 1e-6, "axial_offset": 1e-3, "radial": 1.0, "design_load": 5.0,
         "phase": 1e-6, "modulus": 20.0, "preload": 1e-6}  # fmt: skip


@pytest.mark.parametrize("leaf", ["length", *(pytest.param(leaf, marks=pytest.mark.slow) for leaf in [*STEPS][1:])])
def test_direct_scene_derivatives_are_differences_of_direct_scenes(closed, bearing, leaf: str) -> None:
    """Both ends of the difference prepared afresh: nothing of the law is held."""
    h = STEPS[leaf]
    aside = trb.Spall(4.0, 7.0, axial_offset=0.5)

    def moved(step: float) -> dict:
        if leaf == "axial_offset":
            return {"spalls": (dataclasses.replace(aside, axial_offset=0.5 + step),)}
        if leaf == "preload":  # where the rings stand decides, not the axial load
            return {"load": trb.Load(9000.0, 0.0), "effects": (trb.effects.Mounting(0.002 + step),)}
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
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (SPALL,), law="direct")
    with pytest.raises(ValueError, match="prepare the scene first"):
        jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene)


def test_prepared_direct_law_refuses_another_scene(closed, bearing) -> None:
    scene = prepared(bearing, "direct")
    for other in (
        {"phase": 0.1225},
        {"spalls": (trb.Spall(8.0, 7.0),)},
        {"spalls": (SPALL, SPALL)},
        {"design_load": 65000.0},
    ):
        assert "another scene" in trb.solve(dataclasses.replace(scene, **other)).status
    assert bool(trb.solve(trb.healthy(scene)).converged)


@pytest.mark.slow
def test_a_law_that_is_there_is_not_solved_again(closed, bearing) -> None:
    """The outer raceway's law named anew beside the inner one's as prepared: one was solved again, and traced it ended
    in a traceback."""
    inner = dataclasses.replace(SPALL, surface="inner")
    ready = prepared(bearing, "direct", spalls=(SPALL, inner), effects=trb.effects.Raceways())
    law = ready.effects[0].law
    assert law.states.log_loads.size
    before = len(closed)
    again = trb.prepare(dataclasses.replace(ready, law="direct"))
    assert len(closed) > before
    outer = float(again.law.contact.radius)
    assert all(float(contact.radius) == outer for contact, case, _ in closed[before:] if case.spall is not None)
    np.testing.assert_array_equal(again.effects[0].law.states.approaches, law.states.approaches)


@pytest.mark.slow
def test_spalls_on_both_raceways_have_a_mean(closed, bearing) -> None:
    """Their phases hang on both laws: contacts were solved where one alone would ask for them, and the ring asked
    elsewhere."""
    inner = trb.Spall(2.0, 3.0, angle=0.03, surface="inner")
    scene = prepared(bearing, "direct", spalls=(SPALL, inner), phase="mean", effects=trb.effects.Raceways())
    assert trb.solve(scene).check().status == "converged"
