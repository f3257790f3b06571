"""How far a contact by bands may reach along the roller, and the units that it is solved in."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import contact_extent, strip_model
from difftrb.contact import gap as gaps
from difftrb.contact.contact_solution import Inputs


class Reach(NamedTuple):
    """Where rows end below and above the roller's middle, as distances [mm]; mean line load [N/mm] and its Hertz
    half-width [mm], the units; an estimate of the approach [mm]."""

    bottom: jax.Array
    top: jax.Array
    line_load: jax.Array
    unit: jax.Array
    approach: jax.Array


def spall_edges(inputs: Inputs) -> tuple[jax.Array, jax.Array]:
    """Where the spall begins and ends along the roller [mm]; both 0 without one."""
    return strip_model._spall_edges(inputs.contact, inputs.spall)  # type: ignore[arg-type]


def reach_of(inputs: Inputs, edges: int) -> Reach:
    """By slices with the stiffness of a line contact of each land's length: see `contact_extent.reach_of_strips`.

    A tilted roller's slices begin to carry where its gap is least.
    """
    contact, load, spall, offset, tilt = inputs
    offset = jnp.abs(offset) if edges == 1 else offset
    tip, line_load, unit, approach = strip_model._reach(contact, load, spall, offset, edges)  # type: ignore[arg-type]
    if tilt is None:
        return Reach(tip, tip, line_load, unit, approach)
    low, high = spall_edges(inputs)
    half = 0.5 * contact.length
    stiff = jnp.maximum(2.0 * jnp.log(4.0 * (2.0 * tip - high + low) / unit) - 1.0, 1.0)
    needed = load / (np.pi * contact.modulus)
    sunk = contact_extent._sunk(contact, needed, low, high, jnp.full(2, 1.0) / stiff, tilt)
    least = contact_extent._least_rest(contact, tilt)
    share = jnp.maximum(1.0 - 1.5 / stiff, 0.2)
    level = least + share * (sunk - least)
    bottom, top = (contact_extent._reach(contact, level, tilt, side) for side in (-1.0, 1.0))
    line_load = load / jnp.maximum(top - bottom - (high - low), 0.05 * half)
    unit = jnp.asarray(gaps.line_half_width(line_load, contact.radius, contact.modulus))
    return Reach(-bottom, top, line_load, unit, sunk)


def carried_along(reach: Reach, inputs: Inputs, edges: int) -> Reach:
    """The same reach, with about its derivatives by the inputs: half-widths like those of a line contact on the land
    that there is (of the whole roller, if it may stand beyond a rolling edge), and ends where the gap has grown like
    the approach."""
    contact, load, *_, tilt = inputs
    low, high = spall_edges(inputs) if not edges else (jnp.zeros(()), jnp.zeros(()))
    land = jnp.maximum(reach.top + reach.bottom - (high - low), 0.02 * contact.length)
    line_load = load / (contact.modulus * land)
    line_load = line_load / jax.lax.stop_gradient(line_load)  # 1
    bent = contact.radius / jax.lax.stop_gradient(contact.radius)

    def end(y: jax.Array) -> jax.Array:
        frozen, tilted = jax.lax.stop_gradient((contact, tilt))
        rest, slope = jax.jvp(lambda at: gaps.rest_at(at, frozen, tilted), (y,), (jnp.ones_like(y),))
        return y + (rest * line_load - gaps.rest_at(y, contact, tilt)) / slope

    return Reach(
        -end(-reach.bottom), end(reach.top), reach.line_load * contact.modulus * line_load
        / jax.lax.stop_gradient(contact.modulus), reach.unit * jnp.sqrt(line_load * bent), reach.approach,
    )  # fmt: skip
