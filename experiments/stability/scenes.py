"""Random valid scenes in batches: whether values or derivatives are ever NaN, and failures always flagged."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.core import geometry, status
from difftrb.core.geometry import Spall, TaperedBearing
from difftrb.law.base import Law
from difftrb.law.power import Palmgren
from difftrb.ring.load import needed_axial
from difftrb.scene import checks
from difftrb.scene.scene import Definition
from experiments.stability.hazards import BEARING


@dataclasses.dataclass(frozen=True)
class Kind:
    """Scenes of one shape, so of one compiled program; `law` "palmgren" goes with bearings of every geometry."""

    rollers: int
    spalls: int
    law: str
    definition: Definition


KINDS = (
    Kind(23, 1, "liu2018", "tangent"),
    Kind(23, 3, "liu2018", "secant"),
    Kind(3, 1, "palmgren", "tangent"),
    Kind(60, 2, "palmgren", "tangent"),
)


def random_scenes(kind: Kind, count: int, seed: int) -> trb.Scene:
    """`count` of them in one scene of arrays, shape (count,): loads over ten decades, axial ones from 1e-5 above the
    least possible, spalls of any size anywhere, cage phases anywhere; all as a scene file may have them."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> jax.Array:
        return jnp.asarray(rng.uniform(low, high, count))

    def decades(low: float, high: float) -> jax.Array:
        return 10.0 ** between(low, high)

    bearing = dataclasses.replace(jax.tree.map(lambda v: jnp.full(count, v), BEARING), rollers=kind.rollers)
    if kind.law == "palmgren":
        outer, small, slender = between(0.05, 1.4), decades(0.0, 2.0), between(0.8, 3.0)
        apart = np.sin(np.pi / kind.rollers)
        thickest = jnp.minimum(0.02, 0.8 * jnp.sin(outer) * apart / (1.0 + apart))  # thicker ones overlap
        roller = 0.001 + between(0.0, 1.0) * (thickest - 0.001)
        length = slender * small
        bearing = TaperedBearing(
            small, small + 2.0 * length * roller, length, kind.rollers, outer, outer - 2.0 * roller, roller,
            between(1.3, 1.8), decades(4.0, 6.0), between(0.0, 0.5), decades(-7.0, -4.0),
        )  # fmt: skip
    longest = 8.0 if kind.law == "liu2018" else 0.99 * bearing.roller_length
    widest = checks.WIDEST * 2.0 * jnp.pi * jax.vmap(geometry.arc_radius)(bearing)

    def spall() -> Spall:
        length, width, depth = between(1e-3, 1.0) * longest, jnp.minimum(decades(-2.0, 3.0), widest), decades(-6.0, 1.0)
        angle, offset = between(-6.28, 6.28), between(-0.499, 0.499) * (length + bearing.roller_length)
        return Spall(length, width, depth, angle, offset)

    spalls = tuple(spall() for _ in range(kind.spalls))
    phase, radial = between(-6.28, 6.28), decades(-3.0, 6.0)
    needed = jax.vmap(needed_axial)(bearing, radial, phase)
    axial = jnp.minimum(needed * (1.0 + decades(-5.0, 3.0)), 1e7)
    radial = jnp.where(needed * (1.0 + 1e-5) < 1e7, radial, 0.0)  # too heavy to be held by a load that a file may have
    law: Law = Palmgren(bearing.roller_length) if kind.law == "palmgren" else jax.tree.map(
        lambda v: jnp.broadcast_to(jnp.asarray(v), (count, *jnp.shape(v))), trb.liu2018()
    )  # fmt: skip
    return trb.Scene(
        bearing, trb.Load(radial, axial), spalls, law, jnp.full(count, 6500.0), 1e-3, kind.definition, phase
    )


def _solved(scene: trb.Scene) -> tuple[jax.Array, trb.Solution]:
    r = trb.solve(scene)
    return r.radial_stiffness + 1e-3 * r.axial_stiffness + 1e-3 * jnp.max(r.loads), r


_batch: Callable[[trb.Scene], Any] = jax.jit(jax.vmap(jax.value_and_grad(_solved, has_aux=True)))


def kkt(scene: trb.Scene, solution: trb.Solution) -> np.ndarray:
    """How far loads and displacements are from equilibrium and from contact without pull, in numpy and from the
    printed numbers alone: shape (count,), relative to the load."""
    angles, u, loads = (np.asarray(v) for v in (solution.angles, solution.displacement, solution.loads))
    outer = np.asarray(scene.bearing.outer_angle)[:, None]
    normals = np.stack([
        np.cos(outer) * np.cos(angles), np.cos(outer) * np.sin(angles), np.broadcast_to(np.sin(outer), angles.shape)
    ], axis=-1)  # fmt: skip
    radial, axial = np.asarray(scene.load.radial), np.asarray(scene.load.axial)
    force = np.stack([radial, np.zeros_like(radial), axial], axis=-1)
    size = np.linalg.norm(force, axis=-1)
    off = np.abs(np.einsum("rij,ri->rj", normals, loads) - force).max(axis=-1)
    approach = np.einsum("rij,rj->ri", normals, u)
    clear, pull = np.maximum(-approach, 0.0), np.maximum(-loads, 0.0)
    deep = np.abs(approach).max(axis=-1)
    return np.maximum(off, np.maximum(pull.max(axis=-1), (loads * clear).max(axis=-1) / deep)) / size


def run(count: int, seed: int = 0, batch: int = 2500, progress: Callable[[int, int], None] | None = None) -> dict:
    """Counts over all kinds."""
    found: dict[str, Any] = dict.fromkeys(
        ("scenes", "converged", "nan_values", "nan_gradients", "unflagged", "iterations", "kkt"), 0
    ) | {"statuses": {}}
    batch = min(batch, count // len(KINDS))
    for k, kind in enumerate(KINDS):
        for b in range(count // len(KINDS) // batch):
            scenes = random_scenes(kind, batch, seed + 1000 * k + b)
            (_, r), slopes = _batch(scenes)
            codes = np.asarray(r.status_code)
            good = codes == status.CONVERGED
            # a secant stiffness in a direction without displacement has no value: such numbers do not count
            values = np.concatenate(
                [np.asarray(v).reshape(batch, -1) for v in (r.loads, r.displacement, r.approach)], 1
            )
            gradients = [np.asarray(v).reshape(batch, -1) for v in jax.tree.leaves(slopes)]
            finite = np.all([np.isfinite(v).all(axis=1) for v in gradients], axis=0)
            worst = kkt(scenes, r)
            found["scenes"] += batch
            found["converged"] += int(good.sum())
            found["nan_values"] += int((~np.isfinite(values).all(axis=1) & good).sum())
            found["nan_gradients"] += int((~finite & good).sum())
            found["unflagged"] += int((good & ~(worst <= 1e-9)).sum())
            found["kkt"] = max(found["kkt"], float(worst[good].max(initial=0.0)))
            found["iterations"] = max(found["iterations"], int(np.asarray(r.iterations)[good].max(initial=0)))
            for code in codes[~good]:
                sentence = status.describe(int(code))
                found["statuses"][sentence] = found["statuses"].get(sentence, 0) + 1
            if progress is not None:
                progress(found["scenes"], count)
    return found
