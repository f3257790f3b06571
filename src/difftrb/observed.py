"""What the model says of measurements: every condition solved once, every row read from it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb import scene as scenes
from difftrb import status
from difftrb import unknowns as unknown
from difftrb.measured import Measurement
from difftrb.ring import Load
from difftrb.scene import Definition, PitchMean, Scene
from difftrb.unknowns import Unknowns

Kind = tuple[Definition, bool]
"""Of stiffness, and whether it is the mean over phases."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["conditions", "place", "axis", "loss"],
    meta_fields=["kinds"],
)
@dataclasses.dataclass(frozen=True)
class Plan:
    """What to solve for rows of measurements, and where each row finds itself in it.

    Attributes:
      kinds: of stiffness and phase; conditions: for each kind radial load [N], axial load [N], phase [rad], shape
        (conditions, 3). place: of every row among the conditions of all kinds one after the other, shape (rows,).
      axis: 0 radial, 1 axial, shape (rows,). loss: whether it is a loss, shape (rows,).
    """

    kinds: tuple[Kind, ...]
    conditions: tuple[jax.Array, ...]
    place: jax.Array
    axis: jax.Array
    loss: jax.Array


def plan(scene: Scene, rows: Sequence[Measurement]) -> Plan:
    """The plan for `rows`; what they leave open is the scene's."""
    found: dict[Kind, list[tuple[float, float, float]]] = {}
    seen = []
    for row in rows:
        phase = scene.phase if row.phase is None else row.phase
        mean = isinstance(phase, str | PitchMean)
        kind: Kind = (row.definition or scene.definition, mean)
        condition = float(row.radial), float(row.axial), 0.0 if mean else float(phase)  # type: ignore[arg-type]
        of_kind = found.setdefault(kind, [])
        if condition not in of_kind:
            of_kind.append(condition)
        seen.append((kind, of_kind.index(condition)))
    kinds = tuple(found)
    first = dict(zip(kinds, np.cumsum([0, *(len(found[kind]) for kind in kinds)]).tolist(), strict=False))
    return Plan(
        kinds=kinds,
        conditions=tuple(jnp.asarray(found[kind]) for kind in kinds),
        place=jnp.array([first[kind] + k for kind, k in seen]),
        axis=jnp.array([0 if row.quantity.startswith("radial") else 1 for row in rows]),
        loss=jnp.array([row.is_loss for row in rows]),
    )


def predicted(unknowns: Unknowns, scene: Scene, todo: Plan, values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """What the model says of every row [% or N/mm], shape (rows,), and the worst status of all solves.

    `scene` is prepared; `values` of shape (unknowns,). Differentiable by all of it.

    A `scale` s is the share that the bearing has in the healthy compliance that is measured, the rest being housing and
    shaft: 1/K = 1/K_bearing + (1/s − 1)/K_healthy. So it multiplies all healthy stiffness, and makes losses smaller.
    """
    at, preload, scale = unknown.apply(unknowns, scene, values)
    every, codes = [], []
    for (definition, mean), conditions in zip(todo.kinds, todo.conditions, strict=True):

        def one(condition: jax.Array, definition: Definition = definition, mean: bool = mean):
            load = Load(condition[0], condition[1] + preload)
            phase = PitchMean() if mean else condition[2]
            own = dataclasses.replace(at, load=load, definition=definition, phase=phase)
            spalled, sound = scenes.solve(own), scenes.solve(scenes.healthy(own))
            pair = jnp.stack([jnp.stack([s.radial_stiffness, s.axial_stiffness]) for s in (spalled, sound)])
            return pair, status.worst(spalled.status_code, sound.status_code)

        stiffness, code = jax.vmap(one)(conditions)
        every.append(stiffness)
        codes.append(jnp.max(code))
    stiffness = jnp.concatenate(every)[todo.place, :, todo.axis]
    spalled, sound = stiffness[:, 0], stiffness[:, 1]
    left = 1.0 / (1.0 + scale * (sound / spalled - 1.0))
    return jnp.where(todo.loss, 100.0 * (1.0 - left), scale * sound * left), status.worst(*codes)


ROBUST = ("squares", "huber", "student")
HUBER = 1.345
"""Deviations beyond this many sigma count linearly: 95 % efficient on normal errors (Huber 1981)."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t for data with outliers (Lange, Little and Taylor 1989)."""
LOST = 1e3
"""Deviation [sigma] of a row that the model has no solution for."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["unknowns", "scene", "todo", "measured", "sigma"],
    meta_fields=["robust"],
)
@dataclasses.dataclass(frozen=True)
class Problem:
    """Measurements against the model: unknowns, prepared scene, plan, values and their sigma, shape (rows,) each, and
    how deviations count: "squares", "huber" or "student"."""

    unknowns: Unknowns
    scene: Scene
    todo: Plan
    measured: jax.Array
    sigma: jax.Array
    robust: str


def residual(problem: Problem, u: jax.Array) -> jax.Array:
    """What least squares is made of, shape (rows,), at coordinates u: see `counted`."""
    return counted(problem, predicted(problem.unknowns, problem.scene, problem.todo, problem.unknowns.values(u))[0])


def counted(problem: Problem, told: jax.Array) -> jax.Array:
    """Predicted minus measured in sigma as it counts, shape (rows,): half the sum of squares is the negative log
    likelihood up to a constant."""
    r = jnp.where(jnp.isfinite(told), (told - problem.measured) / problem.sigma, LOST)
    size = jnp.abs(r)
    far = size > 1e-6
    safe = jnp.where(far, size, 1.0)
    if problem.robust == "huber":
        beyond = size > HUBER
        counted = jnp.sqrt(HUBER * (2.0 * jnp.where(beyond, size, HUBER) - HUBER))
        return jnp.where(beyond, jnp.sign(r) * counted, r)
    if problem.robust == "student":
        counted = jnp.sqrt((FREEDOM + 1.0) * jnp.log1p(safe**2 / FREEDOM))
        return jnp.where(far, jnp.sign(r) * counted, r * np.sqrt((FREEDOM + 1.0) / FREEDOM))
    return r


class Evaluated(NamedTuple):
    """The model at many places: predictions [% or N/mm], shape (places, rows); `residual` and its slopes by
    coordinates, shapes (places, rows) and (places, rows, unknowns); worst status of each place."""

    told: jax.Array
    residual: jax.Array
    slopes: jax.Array
    code: jax.Array

    @property
    def cost(self) -> np.ndarray:
        """Half the sums of squares, shape (places,)."""
        return 0.5 * np.sum(np.asarray(self.residual) ** 2, axis=1)


@jax.jit
def evaluated(problem: Problem, places: jax.Array) -> Evaluated:
    """Everything about rows of coordinates, shape (places, unknowns), in one batch."""

    def at(u: jax.Array) -> Evaluated:
        def both(v: jax.Array):
            told, code = predicted(problem.unknowns, problem.scene, problem.todo, problem.unknowns.values(v))
            r = counted(problem, told)
            return r, (told, r, code)

        slopes, (told, r, code) = jax.jacfwd(both, has_aux=True)(u)
        return Evaluated(told, r, slopes, code)

    return jax.vmap(at)(places)
