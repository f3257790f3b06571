"""Expansions carry the derivatives that JAX has, through every function of `core.arrays` and `core.series`."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.core import arrays as xp
from difftrb.core import loops, series
from difftrb.core.taylor import Taylor

pytestmark = pytest.mark.gradient

AT = np.array([0.3, -0.45, 0.8])
RATE, BEND = np.array([0.7, -0.2, 1.1]), np.array([0.4, 0.9, -0.6])
BY = np.array([[0.5, -1.0, 0.25], [0.1, 0.3, -0.7]])
SLOPE_BY = np.array([[0.2, 0.6, -0.1], [-0.3, 0.8, 0.45]])
FIRST = Taylor(AT, np.stack([*BY, RATE]), np.stack([*SLOPE_BY, BEND]))
"""x at δ = 0, θ = 0; δ is the last parameter."""


def first(d: Any, p: Any) -> jax.Array:
    """The function of δ and two parameters θ that `FIRST` expands."""
    return AT + RATE * d + 0.5 * BEND * d * d + p @ BY + d * (p @ SLOPE_BY)


COLUMNS = np.arange(1.0, 13.0).reshape(4, 3) / 7.0
MOVING = Taylor(COLUMNS, np.stack([COLUMNS**2, -0.3 * COLUMNS, 0.0 * COLUMNS]))


def moving(p: Any) -> jax.Array:
    """The coefficients that `MOVING` expands."""
    return COLUMNS + p[0] * COLUMNS**2 - 0.3 * p[1] * COLUMNS


FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sin": xp.sin, "cos": xp.cos, "tan": xp.tan, "exp": xp.exp, "arccos": xp.arccos,
    "log": lambda x: xp.log(1.7 + x), "log1p": xp.log1p, "sqrt": lambda x: xp.sqrt(1.0 + x),
    "product": lambda x: x * (2.0 - x) * x[::-1], "quotient": lambda x: (1.0 + x) / (2.0 + x * x),
    "quotient of a number": lambda x: 2.0 / (3.0 + x), "power": lambda x: (1.5 + x) ** 2.6, "square": lambda x: x**2,
    "where": lambda x: xp.where(x > 0.2, x * x, 1.0 - x), "within": lambda x: xp.within(x, -0.4, 0.5) * x,
    "maximum": lambda x: xp.maximum(x, 0.5 - x), "minimum": lambda x: xp.minimum(x * x, 0.3),
    "magnitude": xp.magnitude, "mod": lambda x: xp.mod(5.0 * x, 1.0) * x, "stack": lambda x: xp.stack([x, x * x, AT]),
    "stack behind": lambda x: xp.stack([x, 2.0 * x], axis=-1), "concatenate": lambda x: xp.concatenate([x[1:], x * x]),
    "total": lambda x: xp.total(x * x), "leading total": lambda x: xp.leading_total(xp.stack([x, x * x])),
    "largest": lambda x: xp.largest(xp.stack([x, x * x, 0.5 - x])), "index": lambda x: x[np.array([2, 0])] * x[1],
    "largest of equals": lambda x: xp.largest(xp.stack([x * x, x * x, x - 9.0, x * x])),
    "broadcast": lambda x: xp.broadcast_to(x[None], (2, 3)), "reshape": lambda x: (x * x).reshape(3, 1),
    "einsum": lambda x: xp.einsum("ij,j->i", COLUMNS, x), "einsum of two": lambda x: xp.einsum("i,j->ij", x, x * x),
    "taken": lambda x: xp.taken(xp.stack([x, x * x]), np.array([1, 0, 1])),
    "polynomial": lambda x: series.polynomial(COLUMNS, x), "straight": lambda x: series.polynomial(
        COLUMNS, 2.0 * x, straight=True), "polynomial of one": lambda x: series.polynomial(COLUMNS[:, :1], x),
    "known": lambda x: xp.with_rates(lambda y: (xp.sin(y), xp.cos(y), -xp.sin(y)), x),
    "repeated": lambda x: loops.repeated(3, lambda y: 0.5 * y * y + x, x),
    "number and array": lambda x: x[0] * COLUMNS + x[None],
}  # fmt: skip


def compared(found: Taylor, function: Callable[[Any, Any], Any]) -> None:
    """The parts of an expansion beside JAX's derivatives of the same function."""
    close = {"rtol": 1e-12, "atol": 1e-12}
    slope = jax.jacfwd(function)
    every = function, jax.jacfwd(function, 1), slope, jax.jacfwd(slope, 1), jax.jacfwd(slope)
    value, by, rate, rate_by, bend = jax.jit(lambda d, p: [one(d, p) for one in every])(jnp.zeros(()), jnp.zeros(2))
    np.testing.assert_allclose(found.value, value, **close)
    for part, (sizes, last) in zip((found.by, found.mixed), ((by, rate), (rate_by, bend)), strict=True):
        truth = np.concatenate([np.moveaxis(np.asarray(sizes), -1, 0), last[None]])
        np.testing.assert_allclose(part, truth, **close)
        assert np.shape(part) == truth.shape


@pytest.mark.parametrize("name", FUNCTIONS)
def test_expansion_has_the_derivatives_of_jax(name: str) -> None:
    compared(FUNCTIONS[name](FIRST), lambda d, p: FUNCTIONS[name](first(d, p)))


def test_the_largest_knows_nothing_of_what_is_infinite() -> None:
    """As the crown at a roller's ends, among equals and alone."""
    by = np.eye(6).reshape(6, 3, 2)
    by[:, 0, 0] = np.inf
    found = xp.largest(Taylor(np.array([[-np.inf, 2.0], [1.0, np.inf], [1.0, -np.inf]]), by))
    np.testing.assert_array_equal(found.value, [1.0, np.inf])
    np.testing.assert_array_equal(found.by[:, 0], [0.0, 0.0, 0.5, 0.0, 0.5, 0.0])


@pytest.mark.parametrize("straight", [False, True])
def test_polynomial_whose_coefficients_move(straight: bool) -> None:
    found = series.polynomial(MOVING, 2.0 * FIRST, straight)
    compared(found, lambda d, p: series.polynomial(moving(p), 2.0 * first(d, p), straight))
    found = series.polynomial(MOVING * FIRST[None], FIRST)
    compared(found, lambda d, p: series.polynomial(moving(p) * first(d, p)[None], first(d, p)))


def test_chebyshev_polynomials_by_parameters() -> None:
    for at in (0.3, 1.0, -1.0):
        found = series.chebyshev(Taylor(np.asarray(at), by=np.array([2.0])), 6)
        rows = np.polynomial.chebyshev.chebvander(at, 5).ravel()
        np.testing.assert_allclose(found.value, rows, rtol=0.0, atol=1e-14)
        rates = [np.polynomial.chebyshev.chebval(at, np.polynomial.chebyshev.chebder(row)) for row in np.eye(6)]
        np.testing.assert_allclose(found.by[0], 2.0 * np.array(rates), rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(
            jax.jacfwd(lambda z: series.chebyshev(z, 6))(jnp.asarray(at)), rates, rtol=1e-13, atol=1e-13
        )


def test_arrays_of_jax_give_the_same() -> None:
    as_jax = jax.tree.map(jnp.asarray, FIRST)
    for name, function in FUNCTIONS.items():
        ours, theirs = function(FIRST), function(as_jax)
        for part, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
            np.testing.assert_allclose(part, other, rtol=1e-13, atol=1e-15, err_msg=name)


def test_second_derivatives_are_not_computed_unless_wanted() -> None:
    found = xp.exp(Taylor(AT, RATE[None])) * Taylor(AT, RATE[None])
    assert found.mixed is None
    np.testing.assert_allclose(found.by[0], np.exp(AT) * (1.0 + AT) * RATE, rtol=1e-15)


def test_expansions_by_other_parameters_are_refused() -> None:
    with pytest.raises(TypeError, match="by 3 and by 2 parameters"):
        FIRST + Taylor(AT, BY)


def test_one_more_parameter_beside_those_of_others() -> None:
    """Of a formula in a moving array and a variable that does not move with it."""
    for x, moved in ((AT, 0.0), (Taylor(AT, BY), 1.0)):
        at, (columns, still) = xp.with_variable(x, (Taylor(COLUMNS, np.stack([COLUMNS**2, -0.3 * COLUMNS])), AT))
        assert still is AT
        compared(
            xp.einsum("ij,j->i", columns, at * at * still),
            lambda d, p, moved=moved: moving(p) @ ((AT + moved * (p @ BY) + d) ** 2 * AT),
        )


def test_numbers_are_computed_by_numpy() -> None:
    found = FUNCTIONS["straight"](FIRST)
    assert all(isinstance(part, np.ndarray) for part in jax.tree.leaves(found))
