"""What a single contact is asked: its inputs in one form, the ways there are, and which way can take what."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import jax
import jax.core
import jax.numpy as jnp

from difftrb.contact.height_map import HeightMap, height_map_is_sound
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real, Spall, as_floats, contact_is_sound, spall_is_sound

Method = Literal["auto", "strips", "cells", "lattice"]
Defect = Spall | HeightMap | tuple[Spall | HeightMap, ...] | None
"""What a roller stands over: nothing, one spall or height map, or several."""
Arguments = tuple[LineContact, jax.Array, Defect, jax.Array, jax.Array | None]
"""Contact, load, defect, offset (one per spall of several), tilt (None: known to be 0)."""


def given(
    contact: LineContact, load: Real, spall: Defect, offset: Real | Sequence[Real], tilt: Real, method: Method
) -> tuple[Arguments, bool, Method]:
    """The inputs as floats, whether half the roller will do, and the method for them.

    Refuses float32 and a method that is unknown or cannot take the case.
    """
    status.require_float64()
    if method not in get_args(Method):
        raise status.SceneError(f"method = {method!r} is unknown; use {', '.join(map(repr, get_args(Method)))}")
    place = jnp.asarray(offset, float)
    if isinstance(spall, tuple):
        if place.shape not in ((), (len(spall),)):
            raise status.SceneError(
                f"offset has shape {place.shape} for {len(spall)} spalls; give one number, or one for each"
            )
        place = jnp.broadcast_to(place, (len(spall),))
        if len(spall) < 2:
            spall, place = (spall[0], place[0]) if spall else (None, jnp.zeros(()))
    elif place.ndim:
        raise status.SceneError(
            f"offset has shape {place.shape}: one spall has one offset; give a tuple of spalls for several"
        )
    straight = is_zero(tilt)
    arguments = (
        as_floats(contact), jnp.asarray(load, float), as_floats(spall), place,
        None if straight else jnp.asarray(tilt, float),
    )  # fmt: skip
    if any(isinstance(each, HeightMap) for each in listed(spall)):
        if method not in ("auto", "lattice"):
            raise status.SceneError(f"method = {method!r} does not take height maps; use 'lattice'")
        method = "lattice"
    elif (isinstance(spall, tuple) or not straight) and method != "lattice":
        if method == "strips":
            raise status.SceneError(
                "method = 'strips' takes at most one spall and a roller that is not tilted; use 'cells'"
            )
        method = "cells"
    return arguments, straight and is_symmetric(spall), method


def is_symmetric(spall: Defect) -> bool:
    """Whether a contact is known to be symmetric about the roller's middle: every `axial_offset` there is a plain 0."""
    return all(is_zero(each.axial_offset) for each in listed(spall))


def listed(spall: Defect) -> tuple[Spall | HeightMap, ...]:
    """Every spall or height map of a defect."""
    return () if spall is None else spall if isinstance(spall, tuple) else (spall,)


def is_zero(number: Real) -> bool:
    """Whether a number is known to be 0: a traced one is not."""
    return not isinstance(number, jax.core.Tracer) and float(number) == 0.0


def is_given(number: Real) -> bool:
    """Whether a number is known not to be 0: a traced one is not."""
    return not isinstance(number, jax.core.Tracer) and float(number) != 0.0


def is_sound(arguments: Arguments) -> jax.Array:
    """Whether all numbers are finite and within what can be: see `status.BAD_INPUT`."""
    contact, load, spall, offset, tilt = arguments
    sound = contact_is_sound(contact) & (load > 0.0) & jnp.all(jnp.isfinite(offset))
    for each in listed(spall):
        sound = sound & (height_map_is_sound(each) if isinstance(each, HeightMap) else spall_is_sound(each))
    return sound if tilt is None else sound & jnp.isfinite(tilt)
