"""A plain ring's numbers are solved at once, by numpy; a traced one by a program, and differentiated by one expansion.
Both are the same, and the programs stay small."""

import copy
import dataclasses
import pickle
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.core.jax_config import jit_quickly
from difftrb.scene import prepared_scene
from difftrb.scene.cage_phases import phases

SCENES = {
    "wide": (9000.0, 4500.0, (trb.Spall(4.0, 7.0),)),
    "on the edge": (9000.0, 4500.0, (trb.Spall(5.0, 15.65, angle=0.01),)),
    "narrow": (6000.0, 6000.0, (trb.Spall(6.0, 0.12, angle=0.003),)),
    "aside": (9000.0, 7000.0, (trb.Spall(3.0, 7.0, angle=0.1, axial_offset=-2.5),)),
    "over the end": (9000.0, 7000.0, (trb.Spall(4.0, 7.0, axial_offset=5.5),)),
    "beyond the load zone": (9000.0, 2400.0, (trb.Spall(4.0, 7.0, angle=3.0),)),
    "several": (5000.0, 9000.0, (trb.Spall(4.0, 7.0), trb.Spall(2.0, 3.0, angle=-1.0))),
    "healthy": (5000.0, 9000.0, ()),
}
PHASES = (0.0, 0.1, "mean")
OWN = ("several", "healthy")
"""These take programs of their own."""


def scene_of(name: str, phase: float | str = 0.0, definition: str = "tangent") -> trb.Scene:
    radial, axial, spalls = SCENES[name]
    load = trb.Load(radial, axial)
    return trb.Scene("32008J", load, spalls, law="table", phase=phase, definition=definition)


by_program = jax.jit(trb.solve)


def assert_same(ours: trb.Solution, theirs: trb.Solution, rtol: float = 1e-11) -> None:
    """By the largest entry of every array."""
    assert int(ours.status_code) == int(theirs.status_code)
    for name in ("displacement", "approach", "loads", "stiffness", "load_span", "stiffness_span", "angles"):
        one, other = np.asarray(getattr(ours, name)), np.asarray(getattr(theirs, name))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=rtol * np.nanmax(np.abs(other)), err_msg=name)


@pytest.mark.exact
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in OWN)) for name in SCENES])
def test_numbers_are_those_of_the_program(name: str, phase: float | str) -> None:
    if name == "several" and phase == "mean":
        pytest.skip("one program more, for nothing new")
    scene = scene_of(name, phase)
    ours, theirs = trb.solve(scene), by_program(scene)
    assert ours.converged
    assert ours.residual < 1e-12
    assert_same(ours, theirs)


def test_phases_of_numbers_are_numbers_that_add_up() -> None:
    """As the audit of a mean takes them."""
    every, weights = phases(trb.prepare(scene_of("on the edge", "mean")))
    assert isinstance(every, np.ndarray)
    assert every.shape == weights.shape == (40,)
    assert weights.sum() == pytest.approx(1.0, rel=1e-14)


def test_secant_stiffness_is_that_of_the_program() -> None:
    scene = scene_of("wide", definition="secant")
    assert_same(trb.solve(scene), by_program(scene))
    without = dataclasses.replace(scene, load=trb.Load(0.0, 4500.0))
    assert np.isnan(trb.solve(without).stiffness[0, 0])
    assert np.isfinite(trb.solve(without).stiffness[2, 2])


@pytest.mark.hard
@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"load": trb.Load(9000.0, 1500.0)}, status.NO_EQUILIBRIUM),
        ({"load": trb.Load(float("nan"), 4500.0)}, status.BAD_INPUT),
        ({"load": trb.Load(9e5, 4.5e5)}, status.OUTSIDE),
        ({"spalls": (trb.Spall(4.0, 7.0, depth=1e-4),)}, status.BOTTOM),
        ({"spalls": (trb.Spall(1.0, 7.0, axial_offset=6.0),)}, status.SLIVER),
    ],
)
def test_what_cannot_be_solved_has_the_status_of_the_program(change: dict, code: int) -> None:
    scene = dataclasses.replace(scene_of("wide"), **change)
    ours, theirs = trb.solve(scene), by_program(scene)
    assert int(ours.status_code) == int(theirs.status_code) == code
    assert np.isnan(ours.loads).all()
    assert np.isnan(theirs.loads).all()


def stiffness(scene: trb.Scene) -> jax.Array:
    return trb.solve(scene).stiffness[0, 0]


gradient = jax.jit(jax.grad(stiffness))


def shifted(scene: trb.Scene, path: str, step: float) -> trb.Scene:
    """With one number changed."""
    owner, name = path.split(".")
    if owner == "spalls":
        one = dataclasses.replace(scene.spalls[0], **{name: getattr(scene.spalls[0], name) + step})
        return dataclasses.replace(scene, spalls=(one, *scene.spalls[1:]))
    own = getattr(scene, owner)
    return dataclasses.replace(scene, **{owner: dataclasses.replace(own, **{name: getattr(own, name) + step})})


@pytest.mark.gradient
@pytest.mark.parametrize("phase", [0.0, pytest.param("mean", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["wide", "on the edge", "narrow", "aside"])
def test_gradient_of_the_program_is_that_of_differences_of_numbers(name: str, phase: float | str) -> None:
    scene = scene_of(name, phase)
    found = gradient(scene)
    for path, step in (
        ("spalls.length", 1e-4), ("spalls.width", 1e-5), ("spalls.angle", 1e-6), ("spalls.axial_offset", 1e-4),
        ("load.radial", 1e-1), ("load.axial", 1e-1), ("bearing.outer_angle", 1e-7), ("bearing.roller_length", 1e-5),
        ("bearing.roller_large_diameter", 1e-6), ("bearing.modulus", 1.0),
    ):  # fmt: skip
        more, less = (float(stiffness(shifted(scene, path, s * step))) for s in (1.0, -1.0))
        owner, field = path.split(".")
        own = found.spalls[0] if owner == "spalls" else getattr(found, owner)
        size = abs(float(stiffness(scene))) * 1e-9 / step  # what rounding leaves of differences
        assert float(getattr(own, field)) == pytest.approx((more - less) / (2.0 * step), rel=2e-5, abs=size), path


@pytest.mark.gradient
@pytest.mark.parametrize("spall", [trb.Spall(8.0, 7.0), trb.Spall(4.0, 0.3), trb.Spall(4.0, 0.1, angle=0.002)])
def test_a_spall_in_the_middle_has_no_slope_by_its_axial_offset(spall: trb.Spall) -> None:
    """Stiffness is as large for either side."""
    found = jax.grad(stiffness)(dataclasses.replace(scene_of("wide"), spalls=(spall,)))
    assert abs(float(found.spalls[0].axial_offset)) < 1e-6


@pytest.mark.hard
@pytest.mark.parametrize("phase", [0.0, "mean"])
def test_a_roller_without_crown_is_for_the_status(phase: float | str) -> None:
    scene = dataclasses.replace(scene_of("wide", phase), design_load=0.0)
    assert int(trb.solve(scene).status_code) == status.OTHER_CONTACT
    assert int(trb.assess(scene).spalled.status_code) == status.OTHER_CONTACT
    assert int(trb.solve(dataclasses.replace(scene, spalls=(trb.Spall(-np.inf, 7.0),))).status_code) != status.CONVERGED


def test_copies_of_a_solution_match_it() -> None:
    solution = trb.solve(scene_of("wide"))
    for other in (copy.deepcopy(solution), pickle.loads(pickle.dumps(solution))):
        apart = jax.tree.map(lambda a, b: a - b, solution, other)
        assert not np.any(np.asarray(apart.loads))


def test_a_program_may_close_over_numbers() -> None:
    scene = scene_of("wide")
    found = jax.jit(lambda x: x * trb.solve(scene).stiffness[0, 0])(2.0)
    assert float(found) == pytest.approx(2.0 * float(stiffness(scene)), rel=1e-15)


@pytest.mark.slow
@pytest.mark.gradient
@pytest.mark.parametrize("name", ["wide", "narrow"])
def test_assessment_of_numbers_is_that_of_the_program(name: str) -> None:
    ready = trb.prepare(scene_of(name, "mean"))
    ours, theirs = prepared_scene.assess_prepared(ready), prepared_scene.assess_by_program(ready)
    for one, other in zip(ours[2:], theirs[2:], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * float(jnp.max(jnp.abs(other))))


@pytest.mark.slow
@pytest.mark.gradient
@pytest.mark.parametrize(("law", "phase"), [pytest.param("liu2018", "mean", marks=pytest.mark.portable),
                                            ("table", 0.1215)])  # fmt: skip
def test_hessian_is_that_of_differences_of_gradients(law: str, phase: float | str) -> None:
    """By length and width (Liu et al. 2018 have neither); the table's as of a spall that is known to be wide, whose
    program is a third as long."""
    wide = trb.prepare(dataclasses.replace(scene_of("wide", phase), law=law))

    def of_sizes(sizes: jax.Array) -> jax.Array:
        return stiffness(dataclasses.replace(wide, spalls=(trb.Spall(sizes[0], sizes[1]),)))

    at, step = jnp.array([4.0, 7.0]), 1e-4
    slopes = jax.jit(jax.grad(of_sizes))
    differences = [(slopes(at + step * v) - slopes(at - step * v)) / (2.0 * step) for v in jnp.eye(2)]
    np.testing.assert_allclose(jit_quickly()(jax.hessian(of_sizes))(at), jnp.stack(differences), rtol=1e-5)


# ------------------------------------------------------------------------------------------------ budgets


def programs(*command: str) -> int:
    """How many programs a command compiles, in a process of its own."""
    script = f"""
import jax
count = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, *_, **__: count.append(name) if name == "/jax/core/compile/backend_compile_duration" else None)
from difftrb.__main__ import main
assert main({["--no-cache", *command]!r}) == 0
print(len(count))
"""
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    return int(run.stdout.splitlines()[-1])


def test_gradients_of_numbers_outside_jit_compile_next_to_nothing() -> None:
    """What contracts an expansion with changes, forward and backward."""
    count: list[str] = []

    def listen(name: str, *_: object, **__: object) -> None:
        count.append(name)

    scene = scene_of("wide")
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        found = jax.grad(stiffness)(scene)
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert sum(name == "/jax/core/compile/backend_compile_duration" for name in count) < 25
    np.testing.assert_allclose(found.spalls[0].length, gradient(scene).spalls[0].length, rtol=1e-11)


@pytest.mark.parametrize(
    "command",
    [
        ("run",),
        ("run", "--mean", "--json"),
        ("run", "--out", "{out}/run"),
        ("check", "{scene}"),
        ("run", "{scene}", "--mean"),
        ("stiffness", "{scene}", "--speed", "1000", "--shaft", "1e6,2e6", "--out", "{out}/stiffness.csv"),
    ],
)
def test_commands_on_numbers_compile_nothing(command: tuple[str, ...], tmp_path) -> None:
    (tmp_path / "scene.toml").write_text(
        'bearing = "32008J"\n[load]\nradial = 9000\naxial = 4500\n[[spall]]\nlength = 4\nwidth = 7\n[effects]\n'
        "raceways = {}\ncentrifugal = { speed_rpm = 3000 }\ndouble_row = { preload = 0.01 }\nflange = {}\n",
        encoding="utf-8",
    )
    assert programs(*(part.format(scene=tmp_path / "scene.toml", out=tmp_path) for part in command)) == 0


@pytest.mark.parametrize(
    ("function", "phase", "most"),
    [(trb.solve, 0.0, 6200), (jax.grad(stiffness), 0.0, 12750)],
    ids=["value", "gradient"],
)
def test_programs_stay_small(function, phase: float | str, most: int) -> None:
    """Lines of StableHLO, with all numbers of the scene traced: compiling takes as long as they are many."""
    assert len(jax.jit(function).lower(scene_of("wide", phase)).as_text().splitlines()) < most
