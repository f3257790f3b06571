"""The same ring by scipy, `optimize.root` with derivatives, to compare with: on a law's curves written out in numpy, or
on the law itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

import difftrb as trb
from difftrb import clock, curve, ramp, ring
from difftrb.law import Law
from difftrb.ramp import Carried

STEP = 1e-3
"""Of differences by a spall's sizes [mm]."""
Answer = tuple[np.ndarray, np.ndarray]
"""Tangent stiffness [N/mm], shape (3, 3), and loads [N], shape (rollers,)."""
Rollers = Callable[[np.ndarray], Answer]
"""From approaches [mm] to loads [N] and their slopes [N/mm], all of shape (rollers,)."""


def root(scene: trb.Scene, rollers: Rollers, start: float) -> Answer:
    """In equilibrium, from an approach of all rollers alike [mm]."""
    normals = np.asarray(ring.directions(scene.bearing, _angles(scene)))
    force = np.array([scene.load.radial, 0.0, scene.load.axial], float)

    def unbalanced(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        loads, slopes = rollers(normals @ u)
        return normals.T @ loads - force, (normals.T * slopes) @ normals

    found = optimize.root(unbalanced, [0.0, 0.0, start / normals[0, 2]], jac=True, tol=1e-10)
    assert found.success
    return unbalanced(found.x)[1], rollers(normals @ found.x)[0]


def alike(scene: trb.Scene) -> float:
    """The approach [mm] with which all rollers alike carry the load."""
    curves = _curves(scene).each
    angle = float(scene.bearing.outer_angle)
    share = (scene.load.radial + scene.load.axial) / (scene.bearing.rollers * np.sin(angle))
    return float(curve.approach(curve.of(curves, 1), jnp.asarray(share)))


def _angles(scene: trb.Scene) -> jax.Array:
    return ring.roller_angles(scene.bearing, cast(float, scene.phase))


@jax.jit
def _curves(scene: trb.Scene) -> Carried:
    return cast(Law, scene.law).curves(scene.spalls, ring.distances(scene.bearing, scene.spalls, _angles(scene)))


_carried = jax.jit(ramp.carried)


def in_numpy(scene: trb.Scene) -> Callable[[], Answer]:
    """Of a prepared scene without a roller on a ramp: its curves are taken over, and only the root is left to find."""
    coefficients, middle, reach, shift = (np.asarray(field) for field in jax.tree.leaves(_curves(scene).each))
    start = alike(scene)

    def rollers(delta: np.ndarray) -> Answer:
        touching = delta > shift
        depth = np.where(touching, delta - shift, 1.0)
        z = (np.log(depth) - middle) / reach
        inside = np.clip(z, -1.0, 1.0) if len(coefficients) > 2 else z
        value, rate = coefficients[-1], np.zeros_like(z)
        for c in coefficients[-2::-1]:
            value, rate = value * inside + c, rate * inside + value
        Q = np.where(touching, np.exp(value + rate * (z - inside)), 0.0)
        return Q, Q * rate / (reach * depth)

    return lambda: root(scene, rollers, start)


def on_law(scene: trb.Scene) -> Callable[[], Answer]:
    """Of any prepared scene: its law is asked for its curves, as every scene of a batch has to, and for loads on them,
    by difftrb's compiled programs."""
    start = alike(scene)

    def solved() -> Answer:
        curves = _curves(scene)
        return root(scene, lambda delta: cast(Answer, tuple(map(np.asarray, _carried(curves, delta)))), start)

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
        name: (clock.timed(way(scene), 21)[1], clock.timed(with_slopes(scene, way), 21)[1])
        for name, way in (("its curves in numpy", in_numpy), ("the law itself", on_law))
    }
