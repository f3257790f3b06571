"""Polynomials and bisection against numpy's and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.core import numeric, series

pytestmark = pytest.mark.exact


def test_nodes_and_polynomials_of_chebyshev() -> None:
    nodes = np.asarray(numeric.chebyshev_nodes(5, 2.0, 4.0))
    np.testing.assert_allclose(nodes, [2.0, 3.0 - np.sqrt(0.5), 3.0, 3.0 + np.sqrt(0.5), 4.0], rtol=1e-15)
    x = jnp.linspace(-1.0, 1.0, 7)
    for degree in (0, 1, 6):
        found = np.stack(series.chebyshev_by_recurrence(x, degree), axis=-1)
        np.testing.assert_allclose(found, np.polynomial.chebyshev.chebvander(x, degree), atol=1e-14)
    roots = jnp.asarray(numeric.chebyshev_roots(6))
    np.testing.assert_allclose(series.chebyshev_by_recurrence(roots, 6)[-1], 0.0, atol=1e-14)


def test_horner() -> None:
    x, coefficients = jnp.linspace(-2.0, 3.0, 11), np.array([0.5, -1.0, 2.0, 0.25])
    power = np.polynomial.Polynomial(coefficients)
    np.testing.assert_allclose(series.horner(coefficients, x), power(np.asarray(x)), rtol=1e-14)
    columns = jnp.asarray(np.tile(coefficients[:, None], 11))
    value, slope = series.with_slope(columns, x)
    np.testing.assert_allclose(value, power(np.asarray(x)), rtol=1e-14)
    np.testing.assert_allclose(slope, power.deriv()(np.asarray(x)), rtol=1e-13)
    alone = jax.jvp(series.with_slope, (columns[:1], x), (columns[1:2], x))  # once a slope without the value's shape
    np.testing.assert_allclose(alone[0], [columns[0], np.zeros(11)])
    np.testing.assert_allclose(alone[1], [columns[1], np.zeros(11)])
    for order in range(6):
        found = series.derivative(np.asarray(columns), np.asarray(x), order)
        np.testing.assert_allclose(found, power.deriv(order)(np.asarray(x)), rtol=1e-13)


def test_bisection_of_arrays_of_either_kind() -> None:
    squares = np.array([2.0, 3.0, 5.0])
    ends = numeric.bisected(lambda at: at * at < squares, np.zeros(3), np.full(3, 4.0))
    assert all(isinstance(end, np.ndarray) for end in ends)
    np.testing.assert_allclose(ends[0], np.sqrt(squares), rtol=1e-15)
    traced = jax.jit(lambda s: numeric.bisected(lambda at: at * at > s, jnp.full(3, 4.0), jnp.zeros(3), 55)[1])
    np.testing.assert_allclose(traced(squares), np.sqrt(squares), rtol=1e-15)
    assert float(jax.grad(lambda s: jnp.sum(traced(s)))(jnp.asarray(squares))[0]) == 0.0  # carries no derivative
