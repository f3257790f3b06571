"""A contact that a program solves by numpy, outside of itself, while it runs: there is next to nothing to compile.

For programs that solve tens of contacts: one takes some ten times as long as compiled, which takes ten seconds to half
a minute first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact.contact_solution import ContactSolution, Found, Inputs
from difftrb.core import implicit

Solve = Callable[[Inputs, bool], tuple[ContactSolution, Inputs | None]]
"""Of numbers: the solved contact and, if asked for, the gradient of its approach."""


def found(solve: Solve, shape: tuple[int, ...], inputs: Inputs) -> Found:
    """What `solve` finds for these inputs, forces of this shape. The approach is differentiable once by all inputs, the
    rest carries no derivative."""

    @jax.custom_jvp
    def called(inputs: Inputs) -> Found:
        return _call(lambda inputs: _of(solve(inputs, False)[0]), _like(shape), inputs)

    @called.defjvp
    def _(primals: tuple, tangents: tuple) -> tuple[Found, Found]:
        def both(inputs: Inputs) -> tuple[Found, Inputs]:
            solution, by = solve(inputs, True)
            rates = jax.tree.map(lambda rate: np.nan_to_num(rate, nan=0.0, posinf=0.0, neginf=0.0), by)
            return _of(solution), rates

        (inputs,), (change,) = primals, tangents
        here, by = _call(both, (_like(shape), jax.tree.map(_of_shape, inputs)), implicit.first_only(inputs))
        moved = sum(jnp.vdot(rate, d) for rate, d in zip(jax.tree.leaves(by), jax.tree.leaves(change), strict=True))
        still = jax.tree.map(implicit.zero_tangent, here)
        return here, still._replace(approach=moved)

    return called(inputs)


def _call(function: Callable[[Inputs], Any], like: Any, inputs: Inputs) -> Any:
    """What the function returns, which is `like` this."""

    def of_numbers(inputs: Inputs) -> Any:
        known = function(jax.tree.map(np.asarray, inputs))
        return jax.tree.map(lambda x, at: np.asarray(x, at.dtype), known, like)

    return jax.pure_callback(of_numbers, like, inputs, vmap_method="sequential")


def _of(solution: ContactSolution) -> Found:
    s = solution
    return Found(
        s.approach, s.force, s.moment, s.contact_width, s.residual, s.iterations, s.unknowns, s.status_code
    )  # fmt: skip


def _like(shape: tuple[int, ...]) -> Found:
    number, count = jax.ShapeDtypeStruct((), float), jax.ShapeDtypeStruct((), int)
    return Found(
        number, jax.ShapeDtypeStruct(shape, float), number, number, number, count, count, count
    )  # type: ignore[arg-type]  # fmt: skip


def _of_shape(x: jax.Array) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(jnp.shape(x), float)
