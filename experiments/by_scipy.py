"""The same ring by scipy, `optimize.root` with derivatives, to compare with: on a law's curves written out in numpy, or
on the law itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

import difftrb as trb
from difftrb.core import machine
from difftrb.law import load_curve, roller_curves
from difftrb.law.base import Law
from difftrb.law.roller_curves import RollerCurves
from difftrb.ring import roller_places

STEP = 1e-3
"""Of differences by a spall's sizes [mm]."""
Answer = tuple[np.ndarray, np.ndarray]
"""Tangent stiffness [N/mm], shape (3, 3), and loads [N], shape (rollers,)."""
Rollers = Callable[[np.ndarray], Answer]
"""From approaches [mm] to loads [N] and their slopes [N/mm], all of shape (rollers,)."""


class Task(NamedTuple):
    """What is known before the clock starts: normals, shape (rollers, 3); the load [N], shape (3,); displacements to
    start from [mm], shape (3,), at which all rollers alike would carry the load."""

    normals: np.ndarray
    force: np.ndarray
    start: np.ndarray


def task(scene: trb.Scene) -> Task:
    """Of a prepared scene."""
    normals = np.asarray(roller_places.directions(scene.bearing, _angles(scene)))
    force = np.array([scene.load.radial, 0.0, scene.load.axial], float)
    share = np.sum(force) / (normals.shape[0] * normals[0, 2])
    alike = float(load_curve.approach(load_curve.one_of(_curves(scene).each, 1), jnp.asarray(share)))
    return Task(normals, force, np.array([0.0, 0.0, alike / normals[0, 2]]))


def root(task: Task, rollers: Rollers) -> Answer:
    """In equilibrium."""

    def unbalanced(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        loads, slopes = rollers(task.normals @ u)
        return task.normals.T @ loads - task.force, (task.normals.T * slopes) @ task.normals

    # its types, which are inferred from its code, took a quarter of the time to check all
    found = cast(Any, optimize).root(unbalanced, task.start, jac=True, tol=1e-10)
    assert found.success
    loads, slopes = rollers(task.normals @ found.x)
    return (task.normals.T * slopes) @ task.normals, loads


def _angles(scene: trb.Scene) -> jax.Array:
    return roller_places.roller_angles(scene.bearing, cast(float, scene.phase))


@jax.jit
def _curves(scene: trb.Scene) -> RollerCurves:
    return cast(Law, scene.law).curves(
        scene.spalls, roller_places.distances(scene.bearing, scene.spalls, _angles(scene))
    )


_carried = jax.jit(roller_curves.roller_loads)


def in_numpy(scene: trb.Scene) -> Callable[[], Answer]:
    """Of a prepared scene without a roller on a ramp: its curves are taken over, and only the root is left to find."""
    curve = jax.tree.map(np.asarray, _curves(scene).each)
    coefficients, reach, shift = curve.coefficients, curve.reach, curve.shift
    bend, known = 0.0 if curve.bend is None else curve.bend, task(scene)

    def rollers(delta: np.ndarray) -> Answer:
        touching = delta > shift
        depth = np.where(touching, delta - shift, 1.0)
        z = (np.log(depth) - curve.middle) / reach
        inside = np.clip(z, -1.0, 1.0) if len(coefficients) > 2 else z
        value, rate = coefficients[-1], np.zeros_like(z)
        for c in coefficients[-2::-1]:
            value, rate = value * inside + c, rate * inside + value
        below = np.minimum(reach * (z + 1.0), 0.0)
        Q = np.where(touching, np.exp(value + rate * (z - inside) + bend * (below + 1.0 - np.exp(below))), 0.0)
        return Q, Q * (rate / reach + bend * (1.0 - np.exp(below))) / depth

    return lambda: root(known, rollers)


def on_law(scene: trb.Scene) -> Callable[[], Answer]:
    """Of any prepared scene: its law is asked for its curves, as every scene of a batch has to, and for loads on them,
    by difftrb's compiled programs."""
    known = task(scene)

    def solved() -> Answer:
        curves = _curves(scene)
        return root(known, lambda delta: cast(Answer, tuple(map(np.asarray, _carried(curves, delta)))))

    return solved


def with_slopes(scene: trb.Scene, way: Callable[[trb.Scene], Callable[[], Answer]]) -> Callable[[], list[Answer]]:
    """The answer and its derivatives by length and width of the first spall, by central differences."""
    spall = scene.spalls[0]
    moved = [
        way(dataclasses.replace(scene, spalls=(dataclasses.replace(spall, **{name: getattr(spall, name) + step}),)))
        for name in ("length", "width") for step in (STEP, -STEP)
    ]  # fmt: skip
    here = way(scene)

    def solved() -> list[Answer]:
        ends = [one() for one in moved]
        pairs = zip(ends[::2], ends[1::2], strict=True)
        return [here(), *(((a[0] - b[0]) / (2.0 * STEP), (a[1] - b[1]) / (2.0 * STEP)) for a, b in pairs)]

    return solved


def seconds(scene: trb.Scene) -> dict[str, tuple[float, float]]:
    """Of one ring, without and with derivatives, each way; medians."""
    return {
        name: (machine.timed(way(scene), 21)[1], machine.timed(with_slopes(scene, way), 21)[1])
        for name, way in (("its curves in numpy", in_numpy), ("the law itself", on_law))
    }
