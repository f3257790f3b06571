"""Rings with effects by numbers and expansions: against arrays of JAX that JAX differentiates, and differences."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.ring import roller_balance
from difftrb.scene import prepared_scene

IN_SERIES = (trb.effects.Raceways(rollers="upright"),)
FASTER = trb.effects.Centrifugal(8000.0)
UNEQUAL = trb.effects.Diameters(tuple(1e-3 * np.sin(np.arange(23.0))))
PAIR = trb.effects.DoubleRow(preload=0.01)
ACTING: dict[str, tuple[trb.effects.Effect, ...]] = {
    "outer": (*IN_SERIES, trb.effects.Flange("hertz", 120.0)),
    "inner": (trb.effects.Flange("hertz", 120.0), *IN_SERIES),
    "flange": (trb.effects.Flange("hertz", 120.0),),
    "rigid": (trb.effects.Flange(),),
    "speed": (FASTER,),
    "position": (trb.effects.Centrifugal(8000.0, control="position"), *IN_SERIES),
    "printed": (trb.effects.Centrifugal(8000.0, convention="printed"), UNEQUAL),
    "mounted": (trb.effects.Mounting(preload=0.01, warmer=10.0), trb.effects.Life()),
    "pair": (PAIR, trb.effects.Life(), UNEQUAL),
    "every": (*IN_SERIES, trb.effects.Flange("hertz", 120.0), FASTER, UNEQUAL, trb.effects.Life(), PAIR),
}
SCENES = {
    "outer": (9000.0, 4500.0, (trb.Spall(4.0, 7.0),), 0.15),
    "inner": (9000.0, 4500.0, (trb.Spall(3.0, 5.0, surface="inner"),), 0.09),
    "roller": (9000.0, 4500.0, (trb.Spall(3.0, 0.3, surface="roller"),), 0.0),
    "flange": (9000.0, 4500.0, (trb.Spall(4.0, 7.0),), 0.15),
    "rigid": (9000.0, 4500.0, (trb.Spall(4.0, 7.0),), 0.15),
    "speed": (9000.0, 4500.0, (trb.Spall(4.0, 7.0),), 0.15),
    "position": (9000.0, 4500.0, (trb.Spall(4.0, 7.0),), 0.15),
    "printed": (9000.0, 4500.0, (trb.Spall(4.0, 7.0),), 0.15),
    "mounted": (2000.0, 0.0, (trb.Spall(4.0, 7.0),), 0.15),
    "pair": (9000.0, 4500.0, (trb.Spall(4.0, 7.0), trb.Spall(2.0, 3.0, angle=0.2, row=2)), 0.14),
    "every": (9000.0, 4500.0, (trb.Spall(4.0, 7.0), trb.Spall(2.0, 3.0, angle=0.2, surface="inner")), 0.14),
    "both": (5000.0, 9000.0, (trb.Spall(4.0, 7.0), trb.Spall(2.0, 3.0, angle=0.2, surface="inner")), 0.14),
}


def scene_of(name: str) -> trb.Scene:
    radial, axial, spalls, phase = SCENES[name]
    acting = ACTING.get(name, IN_SERIES)
    return trb.Scene("32008J", trb.Load(radial, axial), spalls, law="table", phase=phase, effects=acting)


def by_jax(scene: trb.Scene) -> trb.Solution:
    """In arrays of JAX, without expansions: each step of the solve has its derivative by JAX."""
    return prepared_scene._solved(trb.prepare(scene))


def slopes_by_jax(scene: trb.Scene) -> tuple[jax.Array, trb.Solution]:
    """Of radial and axial stiffness by every spall's length and width, shape (2, spalls, 2), so; and the solution."""

    def sized(sizes: jax.Array) -> tuple[jax.Array, trb.Solution]:
        spalls = (dataclasses.replace(s, length=v[0], width=v[1]) for s, v in zip(scene.spalls, sizes, strict=True))
        solution = by_jax(dataclasses.replace(scene, spalls=tuple(spalls)))
        return solution.both_stiffnesses, solution

    @jax.jit  # one way at a time: half of the program that has all ways at once
    def along(way: jax.Array) -> tuple[jax.Array, trb.Solution]:
        _, slope, solution = jax.jvp(sized, (sizes,), (way,), has_aux=True)
        return slope, solution

    sizes = jnp.array([[spall.length, spall.width] for spall in scene.spalls])
    found = [along(way) for way in jnp.eye(sizes.size).reshape(sizes.size, *sizes.shape)]
    slopes = jnp.stack([slope for slope, _ in found], axis=-1)
    return slopes.reshape(2, *sizes.shape), found[0][1]


def assert_same(ours: trb.Solution, theirs: trb.Solution, near: float = 1e-11) -> None:
    assert ours.converged
    assert ours.residual < 1e-12
    for field in ("displacement", "approach", "loads", "stiffness", "load_span", "stiffness_span"):
        one, other = np.asarray(getattr(ours, field)), np.asarray(getattr(theirs, field))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=near * np.abs(other).max(), err_msg=field)
    assert set(ours.effects) == set(theirs.effects)
    for key, own in theirs.effects.items():
        np.testing.assert_allclose(ours.effects[key], own, atol=near * np.abs(own).max(), err_msg=key)


@pytest.mark.slow
@pytest.mark.exact
def test_numbers_are_those_of_the_program() -> None:
    """Slopes, too, which are those of a differentiated program that takes a minute to compile."""
    scene = scene_of("both")
    ours = trb.assess(scene)
    slopes, theirs = slopes_by_jax(scene)
    assert_same(ours.spalled, theirs)
    by_size = np.stack([ours.by_length, ours.by_width], axis=-1)
    np.testing.assert_allclose(by_size, slopes, rtol=1e-8, atol=1e-8 * np.abs(slopes).max(initial=1.0))


@pytest.mark.slow
@pytest.mark.exact
@pytest.mark.parametrize("name", ["every", "position", "mounted"])
@pytest.mark.parametrize("mean", [False, True], ids=["phase", "mean"])
def test_effects_are_those_of_the_program(name: str, mean: bool) -> None:
    scene = scene_of(name)
    scene = dataclasses.replace(scene, phase="mean") if mean else scene
    if name == "mounted":  # the force that holds the rings, over how far they went
        secant = trb.solve(dataclasses.replace(scene, definition="secant")).check()
        force = trb.solve(dataclasses.replace(scene, phase=0.15)).effects["axial_force"]
        np.testing.assert_allclose(secant.stiffness[2, 2], force / 0.01, rtol=1e-2 if mean else 1e-12)
    # where rings at rest place those at speed, the phases of a mean differ by what those leave unbalanced
    near = 1e-10 if mean and name == "position" else 1e-11
    assert_same(trb.solve(scene), jax.jit(by_jax)(scene), near)


def stiffness(scene: trb.Scene) -> jax.Array:
    return trb.solve(scene).stiffness[0, 0]


LEAVES: dict[str, tuple[Callable[[trb.Scene], float], float]] = {
    "radial": (lambda s: s.load.radial, 0.1),
    "axial": (lambda s: s.load.axial, 0.1),
    "outer_angle": (lambda s: s.bearing.outer_angle, 1e-7),
    "inner_angle": (lambda s: s.bearing.inner_angle, 1e-7),
    "flange_angle": (lambda s: s.bearing.flange_angle, 1e-5),
    "roller_length": (lambda s: s.bearing.roller_length, 1e-5),
    "modulus": (lambda s: s.bearing.modulus, 1.0),
    "design_load": (lambda s: s.design_load, 0.1),
    "phase": (lambda s: s.phase, 1e-6),
}


@pytest.mark.gradient
@pytest.mark.parametrize("name", list(SCENES))
def test_gradients_are_those_of_differences(name: str) -> None:
    """By every kind of leaf, outside of jit: nothing is compiled but sums."""
    scene = scene_of(name)
    found = jax.grad(stiffness)(scene)
    for leaf, (of, step) in LEAVES.items():
        if not of(scene):  # no axial load where the rings are held
            continue
        more, less = (float(stiffness(scene.replace(**{leaf: of(scene) + s * step}))) for s in (1.0, -1.0))
        size = abs(float(stiffness(scene))) * 1e-9 / step  # what rounding leaves of differences
        assert float(of(found)) == pytest.approx((more - less) / (2.0 * step), rel=2e-5, abs=size), leaf
    for k, spall in enumerate(scene.spalls):
        for field, step in (("length", 1e-4), ("width", 1e-5), ("angle", 1e-6)):
            changed = [scene.replace(spall=k, **{field: getattr(spall, field) + s * step}) for s in (1.0, -1.0)]
            more, less = (float(stiffness(each)) for each in changed)
            size = abs(float(stiffness(scene))) * 1e-9 / step
            own = float(getattr(found.spalls[k], field))
            assert own == pytest.approx((more - less) / (2.0 * step), rel=2e-5, abs=size), (k, field)


@pytest.mark.exact
def test_rollers_rest_and_the_ring_with_them() -> None:
    """Forces of ring and rollers, from what the solution says."""
    scene = scene_of("both")
    found = trb.solve(scene).check()
    angles, loads = np.asarray(found.angles), np.asarray(found.loads)
    alpha, seat = float(scene.bearing.outer_angle), roller_balance.seat(scene.bearing)
    radial, axial = loads * np.cos(alpha), loads * np.sin(alpha)
    force = [np.sum(radial * np.cos(angles)), np.sum(radial * np.sin(angles)), np.sum(axial)]
    np.testing.assert_allclose(force, [5000.0, 0.0, 9000.0], atol=1e-7)
    inner, flange = (np.asarray(found.effects[key]) for key in ("inner_loads", "flange_loads"))
    outwards, inwards = seat.outer - seat.flange, seat.inner - seat.flange  # from the flange's face
    np.testing.assert_allclose(loads * np.cos(outwards), inner * np.cos(inwards), rtol=1e-12)
    np.testing.assert_allclose(loads * np.sin(outwards), inner * np.sin(inwards) + flange, rtol=1e-9)
    stiff = scene_of("outer")
    assert float(stiffness(dataclasses.replace(stiff, effects=()))) > 1.7 * float(stiffness(stiff))


@pytest.mark.gradient
def test_the_mean_follows_its_kinks() -> None:
    """Of both raceways' spalls: derivatives by sizes against differences of whole means."""
    scene = dataclasses.replace(scene_of("both"), phase="mean")
    found = trb.assess(scene)
    for k in range(2):
        for field, own in (("length", found.by_length), ("width", found.by_width)):
            size = getattr(scene.spalls[k], field)
            more, less = (trb.solve(scene.replace(spall=k, **{field: size + s * 1e-4})) for s in (1.0, -1.0))
            for row, axis in ((0, 0), (1, 2)):
                slope = float(more.stiffness[axis, axis] - less.stiffness[axis, axis]) / 2e-4
                assert float(own[row, k]) == pytest.approx(slope, rel=1e-3), (k, field, axis)
