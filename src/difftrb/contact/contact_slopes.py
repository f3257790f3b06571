"""The derivatives of a contact's approach by name: what a spall's size and place, the load and the radius change."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from difftrb.contact.contact_problem import Defect, Method
from difftrb.contact.contact_solution import ContactSolution
from difftrb.contact.solver import approach_and_gradient
from difftrb.core.geometry import LineContact, Real, Spall


def approach_slopes(
    contact: LineContact,
    load: Real,
    spall: Defect = None,
    offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3,
    method: Method = "auto",
    tilt: Real = 0.0,
) -> dict[str, Real | None]:
    """Derivatives of the approach [mm] by load [N], length, width, offset, radius [mm] and design_load [N].

    All from one linear solve (reverse mode). None where there is no spall to change, and for length, width and offset
    of a height map, whose steep walls stand still on the lattice until they cross a line; of several spalls, shape
    (spalls,), where those are NaN. Arguments as `solve_contact`.
    """
    _, slopes = approach_and_slopes(contact, load, spall, offset, accuracy, method, tilt)
    return slopes


def approach_and_slopes(
    contact: LineContact,
    load: Real,
    spall: Defect = None,
    offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3,
    method: Method = "auto",
    tilt: Real = 0.0,
) -> tuple[ContactSolution, dict[str, Real | None]]:
    """The solved contact and, from the same solve, `approach_slopes`."""
    solution, slopes = approach_and_gradient(contact, load, spall, offset, accuracy, method, tilt)
    by_contact, by_load, by_spall, by_offset, _ = slopes
    return solution, {
        "load": by_load,
        "length": _sizes(by_spall, "length"),
        "width": _sizes(by_spall, "width"),
        "offset": _offsets(by_spall, by_offset),
        "radius": by_contact.radius,
        "design_load": by_contact.design_load,
    }


def _sizes(by_spall: Defect, name: str) -> Real | None:
    """The derivative by one size of the spall, or of all spalls, shape (spalls,)."""
    if isinstance(by_spall, tuple):
        return jnp.stack([jnp.asarray(getattr(by, name, jnp.nan)) for by in by_spall])
    return getattr(by_spall, name, None)


def _offsets(by_spall: Defect, by_offset: jax.Array) -> jax.Array | None:
    """The derivative by the offset, or by all offsets, of spalls."""
    if isinstance(by_spall, tuple):
        return jnp.where(jnp.array([isinstance(by, Spall) for by in by_spall]), by_offset, jnp.nan)
    return by_offset if isinstance(by_spall, Spall) else None
