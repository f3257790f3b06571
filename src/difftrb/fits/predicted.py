"""What the model says of measurements: every condition solved once, every row read from it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import status
from difftrb.core.geometry import Real
from difftrb.fits import parameters as unknown
from difftrb.fits.measured import Measurement
from difftrb.fits.parameters import Unknowns
from difftrb.ring.ring import Load
from difftrb.scene import solution, solving
from difftrb.scene.scene import Definition, PitchMean, Scene, healthy

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


def predicted(
    unknowns: Unknowns, scene: Scene, todo: Plan, values: jax.Array, sound: jax.Array | None = None
) -> tuple[jax.Array, jax.Array]:
    """What the model says of every row [% or N/mm], shape (rows,), and the worst status of all solves.

    `scene` is prepared; `values` of shape (unknowns,); `sound` from `healthy_stiffness` where no unknown changes it.
    Differentiable by all of it.

    A `scale` s is the share that the bearing has in the healthy compliance that is measured, the rest being housing and
    shaft: 1/K = 1/K_bearing + (1/s − 1)/K_healthy. So it multiplies all healthy stiffness, and makes losses smaller.
    """
    at, preload, scale = unknown.apply(unknowns, scene, values)
    stiffness, code = _stiffness(at, todo, preload)
    if sound is None:
        sound, other = _stiffness(healthy(at), todo, preload)
        code = status.worst(code, other)
    spalled, sound = (pair[todo.place, todo.axis] for pair in (stiffness, sound))
    left = 1.0 / (1.0 + scale * (sound / spalled - 1.0))
    return jnp.where(todo.loss, 100.0 * (1.0 - left), scale * sound * left), code


@jax.jit
def healthy_stiffness(scene: Scene, todo: Plan) -> jax.Array:
    """Of the prepared scene without spalls, radial and axial, of every condition [N/mm], shape (conditions, 2)."""
    return _stiffness(healthy(scene), todo, 0.0)[0]


def _stiffness(scene: Scene, todo: Plan, preload: Real) -> tuple[jax.Array, jax.Array]:
    """Radial and axial stiffness of every condition [N/mm], shape (conditions, 2), and the worst status.

    All phases of all conditions are solved side by side: a program for one and one for means would be compiled twice.
    """

    def under(condition: jax.Array, mean: bool) -> Scene:
        load = Load(condition[0], condition[1] + preload)
        return dataclasses.replace(scene, load=load, phase=PitchMean() if mean else condition[2])

    def phases(condition: jax.Array, mean: bool) -> tuple[jax.Array, jax.Array]:
        at, weights = solution.phases(under(condition, mean))
        return jnp.stack([jnp.broadcast_to(v, at.shape) for v in (condition[0], condition[1], at)], 1), weights

    every: dict[int, jax.Array] = {}
    codes = []
    definitions: dict[Definition, None] = dict.fromkeys(definition for definition, _ in todo.kinds)
    for definition in definitions:

        def one(condition: jax.Array, definition: Definition = definition) -> tuple[jax.Array, jax.Array]:
            solved = solving.solve(dataclasses.replace(under(condition, False), definition=definition))
            return jnp.stack([solved.radial_stiffness, solved.axial_stiffness]), solved.status_code

        own = [k for k, kind in enumerate(todo.kinds) if kind[0] == definition]
        parts = [jax.vmap(partial(phases, mean=todo.kinds[k][1]))(todo.conditions[k]) for k in own]
        stiffness, code = jax.vmap(one)(jnp.concatenate([at.reshape(-1, 3) for at, _ in parts]))
        codes.append(jnp.max(code))
        ends = np.cumsum([weights.size for _, weights in parts])[:-1]
        for k, (_, weights), found in zip(own, parts, jnp.split(stiffness, ends), strict=True):
            every[k] = jnp.einsum("cp,cpd->cd", weights, found.reshape(*weights.shape, 2))
    return jnp.concatenate([every[k] for k in range(len(todo.kinds))]), status.worst(*codes)


ROBUST = ("squares", "huber", "student")
HUBER = 1.345
"""Deviations beyond this many sigma count linearly: 95 % efficient on normal errors (Huber 1981)."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t for data with outliers (Lange, Little and Taylor 1989)."""
LOST = 1e3
"""Deviation [sigma] of a row that the model has no solution for."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["unknowns", "scene", "todo", "measured", "sigma", "sound", "common", "robust"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class Problem:
    """Measurements against the model: unknowns, prepared scene, plan, values and their sigma, shape (rows,) each,
    `healthy_stiffness` unless an unknown changes it, the model's own relative error, common to all losses and to all
    stiffnesses, and how deviations count: the number of a name in `ROBUST`."""

    unknowns: Unknowns
    scene: Scene
    todo: Plan
    measured: jax.Array
    sigma: jax.Array
    sound: jax.Array | None
    common: Real
    robust: int | jax.Array


def residual(problem: Problem, u: jax.Array) -> jax.Array:
    """What least squares is made of, shape (rows,), at coordinates u: see `counted`."""
    return counted(problem, predictions(problem, u)[0])


def predictions(problem: Problem, u: jax.Array) -> tuple[jax.Array, jax.Array]:
    """See `predicted`, at coordinates u."""
    return predicted(problem.unknowns, problem.scene, problem.todo, problem.unknowns.values(u), problem.sound)


def _without_common(r: jax.Array, along: jax.Array, common: Real) -> jax.Array:
    """Deviations r whose errors are independent but for one of size `common` in the direction `along`, all of shape
    (rows,), turned into independent ones: by the root of the inverse of 1 + common² along alongᵀ."""
    size = jnp.vdot(along, along)
    share = (1.0 - 1.0 / jnp.sqrt(1.0 + common**2 * size)) / jnp.where(size > 0.0, size, 1.0)
    return r - share * jnp.vdot(along, r) * along


def counted(problem: Problem, told: jax.Array) -> jax.Array:
    """Predicted minus measured in sigma as it counts, shape (rows,): half the sum of squares is the negative log
    likelihood up to a constant."""
    known = jnp.isfinite(told)
    r = jnp.where(known, (told - problem.measured) / problem.sigma, LOST)
    common = jnp.where(problem.robust == ROBUST.index("squares"), problem.common, 0.0)
    # of what is predicted: a share of the measured values would pull every fit below them
    scale = jnp.where(known, told, problem.measured) / problem.sigma
    for kind in (problem.todo.loss, ~problem.todo.loss):
        r = _without_common(r, jnp.where(kind, scale, 0.0), common)
    size, sign = jnp.abs(r), jnp.sign(r)
    beyond, far = size > HUBER, size > 1e-6
    huber = jnp.sqrt(HUBER * (2.0 * jnp.where(beyond, size, HUBER) - HUBER))
    student = jnp.sqrt((FREEDOM + 1.0) * jnp.log1p(jnp.where(far, size, 1.0) ** 2 / FREEDOM))
    ways = {
        "squares": r,
        "huber": jnp.where(beyond, sign * huber, r),
        "student": jnp.where(far, sign * student, r * np.sqrt((FREEDOM + 1.0) / FREEDOM)),
    }
    return jnp.select([problem.robust == k for k in range(len(ROBUST))], [ways[name] for name in ROBUST], r)
