"""One way to compute a scene's ring or its single contact, timed."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp

from difftrb.accuracy.ladder import Row, Rung
from difftrb.contact import reference_cases
from difftrb.contact.contact_solution import ContactSolution
from difftrb.contact.solver import on_lattice, solve_contact
from difftrb.core import cache, machine
from difftrb.core.compiling import jit_quickly
from difftrb.scene import scene_file
from difftrb.scene.scene import PitchMean, Scene
from difftrb.scene.scene_file import SceneFile
from difftrb.scene.solving import prepare, solve

BATCH_THERE = 16384
"""Scenes of a batch on an accelerator, which needs many to be busy."""


def on_ring(rung: Rung, file: SceneFile, path: str | Path, batch: int, accelerator: Any = None) -> tuple[Row, Scene]:
    """Prepare and solve the scene by one law, and a batch of it, on an accelerator (a device of JAX's), too, if there
    is one; also the prepared scene."""
    file = dataclasses.replace(file, contact=dataclasses.replace(file.contact, law=cast(Any, rung.way), accuracy=1e-3))
    scene_file.check_ring(file, path)
    scene = dataclasses.replace(file.scene(), accuracy=rung.accuracy)  # to 1e-5, which a file may not ask for
    with _nothing_kept():
        started = time.perf_counter()
        ready = _of_one_program(prepare(scene))
        solution = jax.block_until_ready(solve(ready))
        first = time.perf_counter() - started
        started = time.perf_counter()
        jax.block_until_ready(prepare(scene))
        again = time.perf_counter() - started
    _, single = machine.timed(lambda: solve(ready))
    _, each = machine.timed(lambda: _batch(_spread(ready, batch), ready))
    there = math.nan
    if accelerator is not None:
        own = jax.device_put((_spread(ready, BATCH_THERE), ready), accelerator)
        there = machine.timed(lambda: _batch(*own))[1] / BATCH_THERE
    top = int(jnp.argmax(solution.loads))
    values = {
        "approach": float(solution.approach[top]),
        "load": float(solution.loads[top]),
        "radial_stiffness": float(solution.radial_stiffness),
        "axial_stiffness": float(solution.axial_stiffness),
    }
    row = Row(
        rung, first, again, single, each / batch, math.nan, machine.memory(), values, solution.status, there=there
    )
    return row, ready


def with_gradient(row: Row, ready: Scene, batch: int) -> Row:
    """The row with derivatives by the first spall's sizes and what they cost."""
    (_, slopes), seconds = machine.timed(lambda: _batch_with_gradient(_spread(ready, batch), ready))
    values = dict(row.values)
    if ready.spalls:
        values["by_length"] = float(slopes[0, 0])
        if isinstance(ready.phase, PitchMean):  # else it is a staircase under a hard window
            values["by_width"] = float(slopes[0, 1])
    return dataclasses.replace(row, each_with_gradient=seconds / batch, values=values, memory=machine.memory())


def _spread(ready: Scene, batch: int) -> jax.Array:
    """Radial loads [N], the scene's first; the others are less, so in equilibrium, too."""
    return ready.load.radial * (1.0 - 0.1 * jnp.arange(batch) / batch)


def _of_one_program(ready: Scene) -> Scene:
    """A prepared scene without the accuracy it was prepared with, which would only compile it once more."""
    return dataclasses.replace(ready, accuracy=1e-3)


def _radial(sizes: jax.Array, radial: jax.Array, ready: Scene) -> jax.Array:
    """Radial stiffness [N/mm] for the first spall's length and width [mm], or a factor on the load if healthy."""
    if ready.spalls:
        sized = dataclasses.replace(ready.spalls[0], length=sizes[0], width=sizes[1])
        ready = dataclasses.replace(ready, spalls=(sized, *ready.spalls[1:]))
    else:
        radial = radial * sizes[0]
    return solve(dataclasses.replace(ready, load=dataclasses.replace(ready.load, radial=radial))).radial_stiffness


def _sizes(ready: Scene) -> jax.Array:
    spall = ready.spalls[0] if ready.spalls else None
    return jnp.stack([jnp.asarray(v, float) for v in ((spall.length, spall.width) if spall else (1.0, 1.0))])


@jit_quickly()
def _batch(loads: jax.Array, ready: Scene) -> jax.Array:
    return jax.vmap(lambda radial: _radial(_sizes(ready), radial, ready))(loads)


@jit_quickly()
def _batch_with_gradient(loads: jax.Array, ready: Scene) -> tuple[jax.Array, jax.Array]:
    def one(radial: jax.Array) -> tuple[jax.Array, jax.Array]:
        def twice(sizes: jax.Array) -> tuple[jax.Array, jax.Array]:
            stiffness = _radial(sizes, radial, ready)
            return stiffness, stiffness

        slopes, stiffness = jax.jacfwd(twice, has_aux=True)(_sizes(ready))
        return stiffness, slopes

    return jax.vmap(one)(loads)


def on_contact(rung: Rung, file: SceneFile, path: str | Path, known: bool = False) -> Row:
    """Solve the single contact by one method and, if asked, the contacts of which the continuum solution is known."""
    file = dataclasses.replace(file, contact=dataclasses.replace(file.contact, accuracy=rung.accuracy))
    scene_file.check_contact(file, path)
    given = file.single_contact()

    started = time.perf_counter()
    solution = jax.block_until_ready(_pressed(rung, **given))
    first = time.perf_counter() - started
    _, single = machine.timed(lambda: _pressed(rung, **given))
    off = math.nan
    if known:
        off = reference_cases.worst(lambda t: float(_pressed(
            rung, contact=reference_cases.CONTACT, load=t.load, spall=t.spall, offset=t.offset, accuracy=rung.accuracy
        ).approach))  # fmt: skip
    nan = math.nan
    return Row(
        rung, first, nan, single, nan, nan, machine.memory(), {"approach": float(solution.approach)}, solution.status,
        continuum=off,
    )  # fmt: skip


def _pressed(rung: Rung, **given: Any) -> ContactSolution:
    if rung.size is not None:
        return on_lattice(rung.size, **given)
    return solve_contact(**given, method=cast(Any, rung.way))


@contextlib.contextmanager
def _nothing_kept() -> Iterator[None]:
    """Tables are made, not read from disk."""
    before, cache.keeping = cache.keeping, False
    try:
        yield
    finally:
        cache.keeping = before
