"""A number that is stationary in what was found beside it, and how it is differentiated."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax

from difftrb.core.implicit import _moving, _zero_tangent


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def multiplier(moved: Callable, solver: Callable, parameters: Any) -> tuple[jax.Array, Any]:
    """A number that is stationary in all that `solver(parameters)` finds beside it; both.

    `moved(found, parameters)` knows how it changes with the parameters while the rest stays as found; the rest itself
    carries no derivative.
    """
    return solver(parameters)


def _multiplier_jvp(moved: Callable, solver: Callable, primals: tuple, tangents: tuple):
    (parameters,) = primals
    value, found = multiplier(moved, solver, parameters)
    moving, changes, among = _moving(parameters, tangents[0])
    _, change = jax.jvp(lambda some: moved(jax.lax.stop_gradient(found), among(some)), (moving,), (changes,))
    return (value, found), (change, jax.tree.map(_zero_tangent, found))


multiplier.defjvp(_multiplier_jvp, symbolic_zeros=True)
