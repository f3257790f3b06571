"""The curve that rings are made of: through its nodes, straight beyond, differentiable everywhere."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.core import series
from difftrb.core.numeric import chebyshev_nodes
from difftrb.core.taylor import Taylor
from difftrb.law import load_curve

pytestmark = pytest.mark.exact

SHIFT = 1e-4
load_of, approach_of = jax.jit(load_curve.load), jax.jit(load_curve.approach)


def approach(load):
    """A smooth law that no power describes."""
    return 3e-5 * load**0.9 * (1.0 + 0.1 * jnp.log1p(load / 300.0)) + SHIFT


@partial(jax.jit, static_argnums=0)
def through(count: int) -> load_curve.Curve:
    at = chebyshev_nodes(count, np.log(3.0), np.log(3000.0))
    return load_curve.through(at, approach(jnp.exp(at)), jnp.asarray(SHIFT))


def test_a_power_law_is_a_curve_of_degree_one() -> None:
    delta = jnp.array([1e-6, 3e-3, 0.7])
    loads, slopes = load_of(load_curve.power(jnp.full(3, 9e5), jnp.full(3, 1.2)), delta)
    np.testing.assert_allclose(loads, 9e5 * delta**1.2, rtol=1e-12)
    np.testing.assert_allclose(slopes, 1.2 * 9e5 * delta**0.2, rtol=1e-12)


@pytest.mark.parametrize("count", [2, 7, 12, 16])
def test_curve_goes_through_its_nodes(count: int) -> None:
    at = chebyshev_nodes(count, np.log(3.0), np.log(3000.0))
    loads = jax.vmap(lambda d: load_of(through(count), d)[0])(approach(jnp.exp(at)))
    np.testing.assert_allclose(loads, jnp.exp(at), rtol=1e-9)


def test_error_falls_exponentially_with_nodes() -> None:
    between = jnp.geomspace(3.0, 3000.0, 101)

    def error(count: int) -> float:
        loads = jax.vmap(lambda d: load_of(through(count), d)[0])(approach(between))
        return float(jnp.max(jnp.abs(loads / between - 1.0)))

    assert error(6) < 1e-3
    assert error(12) < 3e-6
    assert error(16) < 2e-7


@pytest.mark.parametrize("exponent", [None, 1.5])
@pytest.mark.parametrize("delta", [1.2e-4, 1.5e-4, 2e-4, 3e-3, 5e-2, 0.2])
def test_slopes_by_three_ways(delta: float, exponent: float | None) -> None:
    """The slope that `load` states, forward, reverse and by differences; below, inside and above the nodes."""
    own, at, h = through(12), jnp.asarray(delta), 1e-6 * delta
    own = own if exponent is None else load_curve.lighter(own, exponent)
    stated = float(load_of(own, at)[1])

    def load(d: jax.Array) -> jax.Array:
        return load_of(own, d)[0]

    assert float(jax.jacfwd(load)(at)) == pytest.approx(stated, rel=1e-12)
    assert float(jax.grad(load)(at)) == pytest.approx(stated, rel=1e-12)
    assert float(load(at + h) - load(at - h)) / (2 * h) == pytest.approx(stated, rel=1e-6)

    def slope(d: jax.Array) -> jax.Array:
        return load_of(own, d)[1]

    assert float(slope(at + h) - slope(at - h)) / (2 * h) == pytest.approx(float(jax.grad(slope)(at)), rel=1e-5)


@pytest.mark.parametrize("exponent", [None, 1.5])
def test_value_and_slope_are_continuous_where_the_nodes_end(exponent: float | None) -> None:
    own = through(12) if exponent is None else load_curve.lighter(through(12), exponent)
    for end in approach(jnp.array([3.0, 3000.0])):
        for k in (0, 1):
            below, above = (float(load_of(own, end * (1.0 + s * 1e-10))[k]) for s in (-1.0, 1.0))
            assert below == pytest.approx(above, rel=1e-8)


def test_second_derivative_at_an_end_is_that_of_a_side() -> None:
    """It was that of neither: what goes on straight and what does not both left the end itself out."""
    coefficients = np.asarray(through(12).coefficients)

    def second(z: float) -> float:
        at = Taylor(np.asarray(z), by=np.ones(1), mixed=np.zeros(1))
        return float(series.polynomial(coefficients, at, straight=True).mixed[0])

    for end in (-1.0, 1.0):
        assert second(end) != 0.0
        assert second(end) == pytest.approx(second(end * (1.0 - 1e-9)), rel=1e-6)


def test_beyond_the_nodes_it_is_a_power_law() -> None:
    depth = jnp.array([1.0, 2.0, 4.0])  # of log–log: equal steps in, equal steps out
    loads = [float(load_of(through(12), SHIFT + 0.3 * d)[0]) for d in depth]
    assert loads[2] / loads[1] == pytest.approx(loads[1] / loads[0], rel=1e-10)


def test_under_light_loads_it_becomes_another_power_law() -> None:
    """Between the nodes nothing changes; below them the exponent nears the other one in proportion to δ − δ₀."""
    straight = through(12)
    own = load_curve.lighter(straight, 1.5)
    for delta in (2e-3, 5e-2, 0.2):
        assert float(load_of(own, delta)[0]) == float(load_of(straight, delta)[0])
    lowest = float(jnp.exp(own.middle - own.reach))

    def exponent(curve: load_curve.Curve, share: float) -> float:
        load, slope = map(float, load_of(curve, SHIFT + share * lowest))
        return slope * share * lowest / load

    end = exponent(straight, 0.5)
    for share in (0.9, 0.5, 0.1, 1e-6):
        assert exponent(own, share) == pytest.approx(1.5 + (end - 1.5) * share, rel=1e-9)


@pytest.mark.parametrize("exponent", [None, 1.5])
def test_no_load_and_no_nan_up_to_the_shift(exponent: float | None) -> None:
    own = through(12) if exponent is None else load_curve.lighter(through(12), exponent)
    for delta in (-1.0, 0.0, SHIFT):
        loads, slopes = load_of(own, jnp.asarray(delta))
        assert (float(loads), float(slopes)) == (0.0, 0.0)
        for k in (0, 1):
            by_curve, by_delta = jax.grad(lambda c, d, k=k: load_of(c, d)[k], (0, 1))(own, jnp.asarray(delta))
            assert all(np.isfinite(np.asarray(leaf)).all() for leaf in (*jax.tree.leaves(by_curve), by_delta))


def test_gradient_by_the_nodes() -> None:
    """By approaches and shift, against differences."""
    at = chebyshev_nodes(8, np.log(3.0), np.log(3000.0))

    @jax.jit
    def load(scale: jax.Array, shift: jax.Array) -> jax.Array:
        nodes = approach(jnp.exp(at)) * scale ** jnp.arange(8)
        return load_of(load_curve.through(at, nodes, shift), jnp.asarray(6e-3))[0]

    arguments, h = (jnp.asarray(1.01), jnp.asarray(SHIFT)), (1e-6, 1e-10)
    for i in (0, 1):
        moved = [load(*(a + (s * h[i] if k == i else 0.0) for k, a in enumerate(arguments))) for s in (1.0, -1.0)]
        difference = float(moved[0] - moved[1]) / (2 * h[i])
        assert float(jax.grad(load, i)(*arguments)) == pytest.approx(difference, rel=1e-5)
        assert float(jax.jacfwd(load, i)(*arguments)) == pytest.approx(difference, rel=1e-5)


def test_start_value_inverts() -> None:
    for own in (through(12), load_curve.lighter(through(12), 1.5)):
        for load in (0.5, 80.0, 9000.0):
            assert float(load_of(own, approach_of(own, jnp.asarray(load)))[0]) == pytest.approx(load, rel=1e-6)


def test_weights_reproduce_polynomials() -> None:
    places = chebyshev_nodes(5, 0.0, 2.0)
    x = jnp.array([[0.1, 2.0], [1.3, 2.3]])
    np.testing.assert_allclose(load_curve.weights(places, x) @ places**4, x**4, rtol=1e-12)


def test_joined_curves_keep_their_own() -> None:
    one, two = through(6), jax.tree.map(lambda v: 1.1 * v, through(6))
    both = load_curve.joined(one, two)
    for k, single in enumerate((one, two)):
        assert jax.tree.map(float, jax.tree.leaves(load_curve.one_of(both, k))[1:]) == jax.tree.map(
            float, jax.tree.leaves(single)[1:]
        )
        np.testing.assert_array_equal(load_curve.one_of(both, k).coefficients, single.coefficients)


def test_curves_that_bend_go_with_those_that_do_not() -> None:
    own, straight = load_curve.lighter(through(12), 1.5), through(12)
    both = load_curve.joined(own, straight)
    low = SHIFT + 0.1 * float(jnp.exp(own.middle - own.reach))
    for k, single in enumerate((own, straight)):
        assert float(load_of(load_curve.one_of(both, k), low)[0]) == float(load_of(single, low)[0])
