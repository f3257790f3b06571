"""Derivative rules of the package, and nothing else; those of some functions stand beside them (`series`,
`contact.halfspace`, `law.narrow_spall`).

A solve is differentiated at its solution, not through its iterations: the conditions that hold there are linearised
(implicit function theorem), in forward and, by transposition, in reverse mode.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from difftrb.core import arrays as xp
from difftrb.core import series, status, taylor
from difftrb.core.taylor import Taylor

Pytree = Any
Pressed = tuple[jax.Array, jax.Array, jax.Array, jax.Array]


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2, 3))
def root(
    residual: Callable, outcome: Callable, solver: Callable, respond: Callable, parameters: Pytree
) -> tuple[jax.Array, Pytree, Pytree]:
    """The vector x, shape (n,), with `residual(x, y, parameters)` = 0 for y = `outcome(x, parameters, reported)`; that
    y; and what else `solver` has `reported`.

    `solver(parameters)` returns all three; the last carries no derivative. `respond(x, y, parameters, right)` solves
    with the (n, n) Jacobian of the residual by x, through y too, which must be invertible at x; where it is not,
    derivatives are NaN and the solver's status has to say so.
    """
    return solver(parameters)


def _root_jvp(
    residual: Callable, outcome: Callable, solver: Callable, respond: Callable, primals: tuple, tangents: tuple
):
    (parameters,) = primals
    x, y, auxiliary = root(residual, outcome, solver, respond, parameters)
    moving, changes, among = _moving(parameters, tangents[0])
    # y by parameters and by x apart: the former is all that the residual needs of it
    _, by_parameters = jax.jvp(lambda p: outcome(x, among(p), auxiliary), (moving,), (changes,))
    x_change = _of_jaxopt()(
        lambda x, y, p: residual(x, y, among(p)), x, (y, moving), (by_parameters, changes),
        solve=lambda _, right: respond(x, y, parameters, right),
    )  # fmt: skip
    _, by_x = jax.jvp(lambda v: outcome(v, parameters, auxiliary), (x,), (x_change,))
    y_change = jax.tree.map(jnp.add, by_parameters, by_x)
    return (x, y, auxiliary), (x_change, y_change, jax.tree.map(zero_tangent, auxiliary))


root.defjvp(_root_jvp, symbolic_zeros=True)


@cache
def _of_jaxopt() -> Callable[..., Any]:
    """`root_jvp`, imported where it is needed: that takes half a second."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # jaxopt says at import that it is no longer developed
        from jaxopt.implicit_diff import root_jvp
    return root_jvp


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def settled(residual: Callable, x: jax.Array, parameters: Pytree) -> jax.Array:
    """`x`, where `residual(x, parameters)` is 0 entry by entry, as it moves with the parameters."""
    return x


def _settled_jvp(residual: Callable, primals: tuple, tangents: tuple):
    x, parameters = primals
    moving, changes, among = _moving(parameters, tangents[1])
    at = settled(residual, x, parameters)
    if not moving:
        return at, jnp.zeros_like(at)
    _, by_parameters = jax.jvp(lambda p: residual(at, among(p)), (moving,), (changes,))
    _, slope = jax.jvp(lambda x: residual(x, parameters), (at,), (jnp.ones_like(at),))
    return at, -by_parameters / slope


settled.defjvp(_settled_jvp, symbolic_zeros=True)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def pointwise(function: Callable, parameters: Pytree, x: jax.Array) -> Pytree:
    """y = `function(parameters, x)`, a pytree whose leaves have the shape of x and know x entry by entry.

    dy/dx is then as large as y, and is computed once for however many changes of x; so is its own derivative.
    """
    return function(parameters, x)


def _pointwise_jvp(function: Callable, primals: tuple, tangents: tuple):
    (parameters, x), (_, x_change) = primals, tangents
    moving, changes, among = _moving(parameters, tangents[0])
    parts = []
    if moving:
        parts.append(jax.jvp(lambda some: function(among(some), x), (moving,), (changes,))[1])
    if not isinstance(x_change, SymbolicZero):
        by_x = pointwise(partial(_rates, function), parameters, x)
        parts.append(jax.tree.map(lambda rate: rate * x_change, by_x))
    return pointwise(function, parameters, x), jax.tree.map(lambda *of: sum(of[1:], of[0]), *parts)


pointwise.defjvp(_pointwise_jvp, symbolic_zeros=True)


def _rates(function: Callable, parameters: Pytree, x: jax.Array) -> Pytree:
    return jax.jvp(lambda at: function(parameters, at), (x,), (jnp.ones_like(x),))[1]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def expanded(function: Callable[[Pytree], Pytree], parameters: Pytree) -> Pytree:
    """`function(parameters)`, in which expansions may stand for numbers.

    Its derivatives are those of one expansion by all numbers that change, whatever is asked of them: forward or
    reverse, one change or many. Where arrays change, it is differentiated like any function.
    """
    return taylor.values(function(parameters))


def _expanded_jvp(function: Callable[[Pytree], Pytree], primals: tuple, tangents: tuple):
    (parameters,) = primals
    moving, changes, among = _moving(parameters, tangents[0])
    if any(jnp.ndim(leaf) for leaf in moving):
        return jax.jvp(lambda some: taylor.values(function(among(some))), (moving,), (changes,))
    leaves, form = jax.tree.flatten(
        function(among(taylor.parameters(moving))), is_leaf=lambda leaf: isinstance(leaf, Taylor)
    )
    found = [jnp.asarray(taylor.value(leaf)) for leaf in leaves]
    rates = {k: leaf.by for k, leaf in enumerate(leaves) if isinstance(leaf, Taylor) and leaf.by is not None}
    moved = [zero_tangent(leaf) for leaf in found]
    for k, change in zip(rates, _moved(changes, list(rates.values())), strict=True):
        moved[k] = change
    return form.unflatten(found), form.unflatten(moved)


@jax.jit
def _moved(changes: list[jax.Array], rates: list[jax.Array]) -> list[jax.Array]:
    """What the derivatives by parameters, shapes (parameters, …), make of their changes."""
    change = jnp.stack(changes) if changes else jnp.zeros(0)
    return [jnp.tensordot(change, rate, 1, precision=jax.lax.Precision.HIGHEST) for rate in rates]


expanded.defjvp(_expanded_jvp, symbolic_zeros=True)


def standing_in(kept: Callable[[Pytree], Pytree], function: Callable[[Pytree], Pytree], parameters: Pytree) -> Pytree:
    """`kept(parameters)`, a program that can neither be differentiated nor mapped, where it stands in for `function`,
    which can."""
    mapped = jax.custom_batching.custom_vmap(kept)

    @mapped.def_vmap
    def _(size: int, batched: Sequence[Pytree], parameters: Pytree) -> tuple[Pytree, Pytree]:
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, batched[0])
        found = jax.vmap(function, in_axes=(axes,), axis_size=size)(parameters)
        return found, jax.tree.map(lambda _: True, found)

    alone = jax.custom_jvp(mapped)

    def by_function(primals: tuple, tangents: tuple) -> tuple[Pytree, Pytree]:
        moving, changes, among = _moving(primals[0], tangents[0])
        return jax.jvp(lambda some: function(among(some)), (moving,), (changes,))

    alone.defjvp(by_function, symbolic_zeros=True)
    return alone(parameters)


def _moving(tree: Pytree, tangents: Pytree) -> tuple[list, list, Callable[[list], Pytree]]:
    """The leaves that change, their tangents, and what puts such leaves back among the others: XLA would compute with
    zeros what becomes of those that do not."""
    leaves, form = jax.tree.flatten(tree)
    changes = form.flatten_up_to(tangents)
    which = [k for k, change in enumerate(changes) if not isinstance(change, SymbolicZero)]

    def among(moving: list) -> Pytree:
        replaced = dict(zip(which, moving, strict=True))
        return form.unflatten([replaced.get(k, leaf) for k, leaf in enumerate(leaves)])

    return [leaves[k] for k in which], [changes[k] for k in which], among


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def pressed(
    solver: Callable[[Pytree, Pytree, jax.Array, jax.Array], Pressed],
    respond: Callable[[Pytree, jax.Array, jax.Array | None], tuple[jax.Array, jax.Array]],
    guess: Pytree,
    operator: Any,
    gap: jax.Array,
    load: jax.Array,
) -> Pressed:
    """Forces f ≥ 0 with Σf = load and approach δ with W f + gap = δ wherever f > 0.

    `operator.displacement(f)` is W f, W symmetric. `solver(guess, operator, gap, load)` returns (f, δ, residual,
    iterations), the last two without derivative. `respond(operator, loaded, right)` returns (w, μ) with W w = right + μ
    on the loaded cells, w = 0 elsewhere and Σw = 0 if `right` is not None, else W w = μ and Σw = 1.

    dδ/dθ needs one linear solve whatever the number of inputs: with v = ∂f/∂load and dr the change of W f + gap at
    fixed f, dδ = v·dr + (∂δ/∂load) dload.
    """
    return solver(guess, operator, gap, load)


@pressed.defjvp
def _pressed_jvp(solver: Callable, respond: Callable, primals: tuple, tangents: tuple):
    guess, operator, gap, load = primals
    _, operator_change, gap_change, load_change = tangents
    force, approach, residual, iterations = pressed(solver, respond, guess, operator, gap, load)
    force = jax.lax.stop_gradient(force)
    loaded = force > 0.0
    per_load, compliance = first_only(respond(operator, loaded, None))
    _, moved = jax.jvp(lambda op: op.displacement(force), (operator,), (operator_change,))
    moved = jnp.where(loaded, moved + gap_change, 0.0)
    approach_change = jnp.vdot(per_load, moved) + compliance * load_change

    def solve(_: Callable, right: jax.Array) -> jax.Array:
        return respond(operator, loaded, right)[0]

    # W w = μ − moved on Σw = 0; the operator below is W seen from that subspace, its own transpose
    relaxed = jax.lax.custom_linear_solve(
        lambda w: jnp.where(loaded, operator.displacement(w), 0.0), -moved, solve, symmetric=True
    )
    force_change = relaxed + per_load * load_change
    out = force, approach, residual, iterations
    return out, (force_change, approach_change, jnp.zeros_like(residual), jnp.zeros_like(iterations))


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def stationary(moved: Callable, solver: Callable, parameters: Pytree) -> tuple[jax.Array, Pytree]:
    """A number that is stationary in all that `solver(parameters)` finds beside it; both.

    `moved(found, parameters)` tells by an expansion how it changes with the parameters, all scalars, while the rest
    stays as found; the rest itself carries no derivative.
    """
    return solver(parameters)


def _stationary_jvp(moved: Callable, solver: Callable, primals: tuple, tangents: tuple):
    (parameters,) = primals
    value, found = stationary(moved, solver, parameters)
    moving, changes, among = _moving(parameters, tangents[0])
    by = rates(lambda some: moved(jax.lax.stop_gradient(found), among(some)), moving)
    if by is not None:
        by = first_only(by)
        by = jnp.where(jnp.isfinite(by), by, 0.0)  # where there is no solution another may be taken: 0 · NaN is NaN
    change = jnp.zeros_like(value) if by is None else _moved(changes, [by])[0]
    return (value, found), (change, jax.tree.map(zero_tangent, found))


stationary.defjvp(_stationary_jvp, symbolic_zeros=True)


@jax.custom_jvp
def first_only(tree: Pytree) -> Pytree:
    """The same, of what a first derivative is made: a second one would lack how the solution itself moves."""
    return tree


@first_only.defjvp
def _first_only_jvp(*_: Any) -> Any:
    raise status.SceneError("a contact has first derivatives only: take differences of gradients for second ones")


def rates(function: Callable[[list], Any], scalars: list) -> Any:
    """Derivatives of `function(scalars)` by all of them, shape (scalars, …), from one expansion; None if there are
    none."""
    return xp.by(function(taylor.parameters(scalars)))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def interpolant(fit: Callable[[jax.Array, jax.Array], jax.Array], places: jax.Array, values: jax.Array) -> jax.Array:
    """Coefficients, shape (n, …), in rising powers of the polynomials through `values` at `places`, both (n, …).

    They are found by `fit(places, values)`, which is linear in the values.

    When places move by dz and values by dy, the polynomial P changes by the one through dy − P′ dz at the old places:
    one more fit, where differentiating through the fit would cost twenty.
    """
    return fit(places, values)


@interpolant.defjvp
def _interpolant_jvp(fit: Callable, primals: tuple, tangents: tuple):
    places, values = primals
    places_change, values_change = tangents
    coefficients = interpolant(fit, places, values)
    rate = series.derivative(coefficients[:, None], places, 1)
    return coefficients, interpolant(fit, places, values_change - rate * places_change)


def zero_tangent(leaf: jax.Array) -> Any:
    """Of what carries no derivative."""
    inexact = jnp.issubdtype(leaf.dtype, jnp.inexact)
    return jnp.zeros_like(leaf) if inexact else jnp.zeros(leaf.shape, jax.dtypes.float0)
