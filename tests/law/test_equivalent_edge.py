"""The one edge that stands for both of a narrow spall."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.core import arrays as xp
from difftrb.core.taylor import Taylor
from difftrb.law import edge_share, equivalent_edge, narrow_spall
from difftrb.law.equivalent_edge import ALONG, NarrowSpall

APPROACH, LOW, HIGH = 0.01, -0.15, 0.25
CROWN = 5e-3 * ALONG**2
"""Of a roller pressed to 0.01 mm, whose contact is 0.3 mm wide."""


def edge_of(edge, width):
    of, shape = xp.module_of(edge, width), np.shape(xp.value(edge))
    crown = of.asarray(CROWN.reshape(-1, *[1] * len(shape)) * np.ones((1, *shape)))
    rest = (of.full(shape, value) for value in (APPROACH, LOW, HIGH))
    return equivalent_edge.of_both(edge, NarrowSpall(width, crown), *rest)


def sunk(edge, near, width):
    """What the roller sinks over the one edge and over both, in the mean along the spall, as `_equivalent` has it."""
    left = 1.0 - CROWN / APPROACH
    weight = np.asarray(equivalent_edge.WEIGHTS) * left ** (equivalent_edge.ROW - 1.0)
    share = np.sqrt(edge_share.usual(edge_share.place(np.asarray(edge), LOW, HIGH)))
    own = -LOW * left ** (0.5 * equivalent_edge.ROW) * share
    one = np.sum(weight * narrow_spall.over_one(edge, own))
    return one, width**2 * np.sum(weight * narrow_spall.sinking(near, width, own))


@pytest.mark.exact
@pytest.mark.parametrize(("near", "width"), [(0.05, 0.1), (0.1, 0.2), (0.0, 0.12), (0.12, 0.25), (0.06, 0.2)])
def test_the_roller_sinks_as_far_over_it_as_over_both(near: float, width: float) -> None:
    """But for the stretch that brings a spall without width to the ramp's beginning."""
    found = float(edge_of(np.asarray(near), np.asarray(width)))
    stretch = (near - LOW) / (near - LOW * (1.0 - CROWN.min() / APPROACH) ** (0.5 * equivalent_edge.ROW))
    one, both = sunk(near + (found - near) / stretch, near, width)
    assert one == pytest.approx(both, rel=1e-12)
    assert found < near


@pytest.mark.parametrize(("near", "width"), [(0.1, 2.0), (-0.14, 0.6), (1.0, 2.0)])
def test_it_is_the_near_one_where_the_far_land_is_out_of_reach(near: float, width: float) -> None:
    """The rounds that are left out would have found it, too, and nothing else that moves it."""
    at = jnp.asarray(near), jnp.asarray(width)
    assert float(edge_of(*at)) == near
    crown = jnp.asarray(CROWN)
    always = equivalent_edge._equivalent(
        at[0], NarrowSpall(at[1], crown), APPROACH, jnp.asarray(LOW), jnp.asarray(HIGH)
    )
    if near < HIGH:
        assert float(always) == pytest.approx(near, abs=1e-14)
        rates = np.array(jax.jit(jax.grad(edge_of, argnums=(0, 1)))(*at))
        np.testing.assert_allclose(rates, [1.0, 0.0], atol=1e-14)
    else:  # no land is left either way
        assert float(always) > HIGH


@pytest.mark.gradient
@pytest.mark.parametrize("width", [0.08, 0.2, 0.6])
def test_expansions_in_batches_beside_jax_and_differences(width: float) -> None:
    """Some of the rollers reach the far land, others do not; by numbers, by programs, and by JAX's own rules."""
    edges = np.array([-0.1, 0.02, 0.5 * width, 0.24])
    both = np.ones(edges.shape)

    def by_expansion(edge, across):
        own = edge_of(Taylor(edge, xp.stack([both, 0.0 * both])), Taylor(across * both, xp.stack([0.0 * both, both])))
        return own.value, own.by

    numbers = by_expansion(edges, width)
    traced = jax.jit(by_expansion)(jnp.asarray(edges), jnp.asarray(width))
    for ours, theirs in zip(numbers, traced, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)
    at = jnp.asarray(edges), jnp.asarray(width * both)
    rates = jax.jit(jax.vmap(jax.grad(edge_of, argnums=(0, 1))))(*at)
    np.testing.assert_allclose(numbers[1], np.array(rates), rtol=1e-8, atol=1e-9)
    h = 1e-6
    for k, rate in enumerate(rates):
        up, down = (edge_of(edges + s * h * (k == 0), (width + s * h * (k == 1)) * both) for s in (1.0, -1.0))
        np.testing.assert_allclose(rate, (up - down) / (2.0 * h), rtol=2e-6, atol=2e-7)


@pytest.mark.hard
def test_rounds_end_at_rounding_for_any_ramp(monkeypatch: pytest.MonkeyPatch) -> None:
    """And in a spall `FAR` wider than its ramp a roller beyond the ramp's end stays so: it need not be looked for."""
    rng, n = np.random.default_rng(0), 4000

    def spread(low: float, high: float) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), n))

    low, approach = -spread(5e-3, 1.0), spread(1e-3, 0.1)
    high, width = -low * spread(0.5, 6.0), -low * spread(0.02, 5.0)
    near = low + (np.minimum(0.5 * width, high) - low) * rng.uniform(0.0, 1.0, n)
    crown = approach * (2.0 * rng.uniform(0.0, 1.0, n) * ALONG[:, None] ** 2 + 0.5 * rng.uniform(0.0, 1.0, n))
    found = {}
    for rounds in (equivalent_edge.ROUNDS, 60):
        monkeypatch.setattr(equivalent_edge, "ROUNDS", rounds)
        found[rounds] = equivalent_edge.of_both(near, NarrowSpall(width, crown), approach, low, high)
    np.testing.assert_array_less(np.abs(np.subtract(*found.values())), -1e-10 * low)

    width = high * spread(equivalent_edge.FAR, 100.0)
    near = high + (0.5 * width - high) * rng.uniform(0.0, 1.0, n) ** 3
    left_out = equivalent_edge._equivalent(near, NarrowSpall(width, crown), approach, low, high)
    assert np.all(left_out >= high)
