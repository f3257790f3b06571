"""What comes of every hazard: status, residual, iterations, and its derivatives against differences."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.core import status
from experiments.stability.hazards import (
    BEARING,
    CONTACTS,
    NUMBERS,
    RING_NUMBERS,
    RINGS,
    ContactHazard,
    RingHazard,
)  # fmt: skip

LEAST = {"length": 0.01, "width": 0.01, "depth": 1e-3, "offset": 0.01, "axial_offset": 0.01, "design_load": 1.0,
         "phase": 0.01, "angle": 0.01}  # fmt: skip
"""What a number is taken as, if it is smaller, for the step of a difference [mm, N, rad]."""
FLOOR = 1e-3
"""A derivative is measured by itself, or by this part of value / number."""


@dataclasses.dataclass(frozen=True)
class Found:
    """What came of one hazard.

    Attributes:
      name: of the hazard. status: a code of `difftrb.status`; will_do: whether it is one that was asked for.
      value: approach of the contact, or displacement of the ring [mm].
      residual, iterations: of the solve.
      finite: whether all derivatives are finite.
      error: largest relative difference between a derivative and a central difference; at a kink, from the side that
        it is nearer to. NaN if the solve did not converge.
      where: the number by which that was. one_sided: numbers by which it was compared with one side.
    """

    name: str
    status: int
    will_do: bool
    value: float
    residual: float
    iterations: int
    finite: bool
    error: float
    where: str
    one_sided: tuple[str, ...]


def contact_approach(numbers: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    """By cells at 1e-2; `numbers` as `NUMBERS`."""
    a = dict(zip(NUMBERS, numbers, strict=True))
    contact = trb.LineContact(a["radius"], a["roller_length"], a["modulus"], a["design_load"])
    spall = trb.Spall(a["length"], a["width"], a["depth"], 0.0, a["axial_offset"])
    s = trb.solve_contact(contact, a["load"], spall, a["offset"], 1e-2, "cells")
    return s.approach, (s.status_code, s.residual, s.iterations)


def ring_displacement(rollers: int, numbers: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    """Radial and axial together; `numbers` as `RING_NUMBERS`."""
    a = dict(zip(RING_NUMBERS, numbers, strict=True))
    outer = a["outer_angle"]
    inner = outer - 2.0 * BEARING.roller_angle  # one apex
    bearing = dataclasses.replace(BEARING, rollers=rollers, outer_angle=outer, inner_angle=inner)
    spall = trb.Spall(a["length"], a["width"], angle=a["angle"])
    scene = trb.Scene(bearing, trb.Load(a["radial"], a["axial"]), (spall,), law="liu2018", phase=a["phase"])
    r = trb.solve(scene)
    return r.displacement[0] + r.displacement[2], (r.status_code, r.residual, r.iterations, jnp.min(r.approach))


Solve = Callable[[jax.Array], Any]
_contacts: Solve = jax.jit(partial(jax.lax.map, jax.value_and_grad(contact_approach, has_aux=True)))
_approaches: Solve = jax.jit(partial(jax.lax.map, lambda numbers: contact_approach(numbers)[0]))


@partial(jax.jit, static_argnums=0)
def _rings(rollers: int, numbers: jax.Array) -> Any:
    return jax.vmap(jax.value_and_grad(partial(ring_displacement, rollers), has_aux=True))(numbers)


@partial(jax.jit, static_argnums=0)
def _displacements(rollers: int, numbers: jax.Array) -> Any:
    return jax.vmap(lambda row: ring_displacement(rollers, row)[0])(numbers)


def contacts(hazards: Sequence[ContactHazard] = CONTACTS) -> list[Found]:
    """All of them, in one batch, and all that they are compared with in another."""
    return _compared(hazards, NUMBERS, np.stack([h.numbers for h in hazards]), _contacts, _approaches)


def rings(hazards: Sequence[RingHazard] = RINGS) -> list[Found]:
    """All of them, in one batch for every number of rollers."""
    found: dict[str, Found] = {}
    for rollers in sorted({h.rollers for h in hazards}):
        own = [h for h in hazards if h.rollers == rollers]
        numbers = np.stack([h.numbers for h in own])
        numbers[np.isposinf(numbers[:, 1]), 1] = np.nan if rollers != BEARING.rollers else touching(9000.0)
        found |= {
            f.name: f
            for f in _compared(own, RING_NUMBERS, numbers, partial(_rings, rollers), partial(_displacements, rollers))
        }
    return [found[h.name] for h in hazards]


def touching(radial: float, count: int = 64) -> float:
    """The axial load at which the least pressed roller of the healthy main scene has an approach of 0 [N]."""
    low, high = radial * 0.3, radial
    while high - low > 1e-15 * high:
        axial = np.linspace(low, high, count)
        rows = np.tile(RingHazard("", radial=radial, length=0.0).numbers, (count, 1))
        rows[:, 1] = axial
        (_, (*_, least)), _ = _rings(BEARING.rollers, jnp.asarray(rows))
        k = int(np.searchsorted(np.asarray(least), 0.0))
        if (low, high) == (axial[k - 1], axial[k]):
            break
        low, high = axial[k - 1], axial[k]
    return float(high)


def _compared(
    hazards: Sequence[ContactHazard | RingHazard], names: Sequence[str], numbers: np.ndarray, solve: Solve,
    value: Solve,
) -> list[Found]:  # fmt: skip
    """Each hazard by `solve`, with derivatives; a step to either side by every number by `value`, without."""
    count, width = numbers.shape
    scale = np.maximum(np.abs(numbers), [LEAST.get(name, 0.0) for name in names])
    other = scale[:, names.index("axial") if "axial" in names else 0, None]  # a radial load of 0 beside the axial one
    scale = np.where(scale > 0.0, scale, 1e-3 * other)
    step = np.array([[hazard.step] for hazard in hazards]) * scale
    aside = numbers[:, None, None] + np.array([1.0, -1.0])[None, :, None, None] * np.eye(width) * step[:, None, None]
    (values, (codes, residuals, iterations, *_)), slopes = jax.tree.map(np.asarray, solve(jnp.asarray(numbers)))
    beside = np.asarray(value(jnp.asarray(aside.reshape(-1, width)))).reshape(count, 2, width)
    found = []
    for i, hazard in enumerate(hazards):
        right, left = (beside[i, 0] - values[i]) / step[i], (values[i] - beside[i, 1]) / step[i]
        floor = FLOOR * np.abs(values[i]) / scale[i]

        def off(other: np.ndarray, own: np.ndarray = slopes[i], floor: np.ndarray = floor) -> np.ndarray:
            return np.abs(own - other) / np.maximum(np.maximum(np.abs(own), np.abs(other)), floor)

        error = off(0.5 * (right + left))
        one_sided = np.array([name in hazard.kinks for name in names])
        error = np.where(one_sided, np.fmin(off(right), off(left)), error)
        good = int(codes[i]) == status.CONVERGED
        worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
        found.append(Found(
            hazard.name, int(codes[i]), int(codes[i]) in hazard.ends, float(values[i]), float(residuals[i]),
            int(iterations[i]), bool(np.isfinite(slopes[i]).all()), float(error[worst]) if good else np.nan,
            names[worst] if good else "", tuple(hazard.kinks) if good else (),
        ))  # fmt: skip
    return found
