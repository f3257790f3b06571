"""A spall narrower than the contact: plane strain against a solve on cells, its limits, and the one edge for both."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.core import arrays as xp
from difftrb.core.taylor import Taylor
from difftrb.law import edge_share, narrow_shift, narrow_spall
from difftrb.law.narrow_spall import ALONG, ROW, WEIGHTS, NarrowSpall, over_one, over_one_slope, sinking

APPROACH, LOW, HIGH, LEVEL = 0.01, -0.15, 0.25, 0.4
CROWN = 5e-3 * ALONG**2
"""Of a roller pressed to 0.01 mm, whose contact is 0.3 mm wide."""


def pressed(lands: list[tuple[float, float]]) -> float:
    """Approach of a parabola x²/2 on lands in plane strain, under the load with which Hertz's half-width is 1: even
    pressure on cells that crowd at the lands' ends, none where it would pull."""
    share = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 161)))
    lines = [low + (high - low) * share for low, high in lands]
    left, right = (np.concatenate([line[side] for line in lines]) for side in (slice(None, -1), slice(1, None)))
    x = 0.5 * (left + right)

    def integral(t: np.ndarray) -> np.ndarray:
        return t * np.log(np.abs(t)) - t

    matrix = integral(x[:, None] - right[None]) - integral(x[:, None] - left[None])  # −∫ ln|x − s| ds
    loaded = np.ones(x.size, bool)
    while True:
        size = int(loaded.sum())
        system = np.zeros((size + 1, size + 1))
        system[:size, :size] = matrix[np.ix_(loaded, loaded)]
        system[:size, size], system[size, :size] = -1.0, (right - left)[loaded]
        found = np.linalg.solve(system, np.append(-0.5 * x[loaded] ** 2, 0.5))
        if (found[:size] > 0.0).all():
            return float(found[size])
        loaded[np.flatnonzero(loaded)[found[:size] <= 0.0]] = False


def sunk(near: float, width: float, half_width: float = 1.0) -> float:
    return width**2 * float(sinking(*map(jnp.asarray, (near, width, half_width))))


@pytest.mark.exact
@pytest.mark.parametrize(("width", "away"), [(0.3, 0.0), (0.3, 0.5), (0.3, 0.9), (0.3, 1.05), (1.2, 0.5), (1.2, 1.2),
                                         (3.0, 0.2), (3.0, 0.5), (3.0, 2.4)])  # fmt: skip
def test_roller_sinks_as_far_as_on_cells(width: float, away: float) -> None:
    edges = away - 0.5 * width, away + 0.5 * width
    more = pressed([(-2.5, edges[0]), (edges[1], edges[1] + 1.5)]) - pressed([(-2.5, 2.5)])
    assert sunk(0.5 * width - away, width) == pytest.approx(more, rel=5e-3, abs=2e-4)


@pytest.mark.exact
@pytest.mark.parametrize("width", [1e-3, 0.1, 1.0, 4.0, 20.0])
def test_in_the_middle_it_is_the_chord(width: float) -> None:
    """w²/8R exactly, whatever the load."""
    for half_width in (0.9, 1.0, 1.3):
        assert sunk(0.5 * width, width, half_width) == pytest.approx(width**2 / 8.0, rel=1e-12)


@pytest.mark.exact
def test_wide_spall_has_one_edge_and_a_far_one_none() -> None:
    for near in (-0.9, 0.0, 0.7):
        assert sunk(near, 9.0) == pytest.approx(float(over_one(jnp.asarray(near), jnp.asarray(1.0))), rel=1e-12)
    assert sunk(-1.0, 0.4) == sunk(-1.2, 0.4) == 0.0


@pytest.mark.exact
@pytest.mark.parametrize("width", [0.05, 0.4, 2.0, 9.0, 30.0])
def test_sinking_is_continuous_where_the_far_land_begins_to_touch(width: float) -> None:
    away = np.linspace(0.0, 0.5 * width + 1.0, 20001)
    values = jax.vmap(sinking, (0, None, None))(jnp.asarray(0.5 * width - away), jnp.asarray(width), jnp.ones(()))
    steps = np.abs(np.diff(values))
    assert steps.max() < 12.0 * 0.125 * (away[1] - away[0]) * (1.0 + 1.0 / width)
    assert np.all(np.diff(values) < 1e-4)  # falls with the distance, to the polynomial's error


@pytest.mark.exact
@pytest.mark.parametrize("width", [0.0, 1e-9, 1e-4, 0.3, 40.0])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_derivatives_are_numbers_and_those_of_differences(width: float, share: float) -> None:
    at = jnp.asarray(0.5 * width - share * (1.0 + 0.5 * width)), jnp.asarray(width), jnp.asarray(1.1)
    both = [np.array(jax.jit(way(sinking, (0, 1, 2)))(*at)) for way in (jax.grad, jax.jacfwd)]
    assert np.isfinite(both).all()
    np.testing.assert_allclose(*both, rtol=1e-9, atol=1e-9)
    if width > 0.1 and share < 1.0:
        for i in range(3):
            h = 1e-6
            up, down = (sinking(*(a + (s * h if k == i else 0.0) for k, a in enumerate(at))) for s in (1.0, -1.0))
            assert float(both[0][i]) == pytest.approx(float(up - down) / (2 * h), abs=1e-6)


@pytest.mark.exact
def test_slope_of_one_edge() -> None:
    for near in (-0.99, 0.0, 3.0):
        at = jnp.asarray(near), jnp.asarray(0.7)
        assert float(over_one_slope(*at)) == pytest.approx(float(jax.grad(over_one)(*at)), rel=1e-9, abs=1e-12)


def edge_of(edge, width, shift=None):
    of, shape = xp.module_of(edge, width), np.shape(xp.value(edge))
    crown = of.asarray(CROWN.reshape(-1, *[1] * len(shape)) * np.ones((1, *shape)))
    rest = (of.full(shape, value) for value in (APPROACH, LOW, HIGH, LEVEL))
    if shift is not None:
        shift = of.asarray(shift.reshape(*shift.shape, *[1] * len(shape)) * np.ones(shape))
    return narrow_spall.equivalent_edge(edge, NarrowSpall(width, crown, shift), *rest)


def sunk_over_either(edge, near, width):
    """What the roller sinks over the one edge and over both, in the mean along the spall, as `_in_rounds` has it."""
    left = 1.0 - CROWN / APPROACH
    weight = np.asarray(WEIGHTS) * left ** (ROW - 1.0)
    share = np.sqrt(edge_share.usual(edge_share.place(np.asarray(edge), LOW, HIGH)))
    own = -LOW * left ** (0.5 * ROW) * share
    one = np.sum(weight * over_one(edge, own))
    return one, width**2 * np.sum(weight * sinking(near, width, own))


@pytest.mark.exact
@pytest.mark.parametrize(("near", "width"), [(0.05, 0.1), (0.1, 0.2), (0.0, 0.12), (0.12, 0.25), (0.06, 0.2)])
def test_the_roller_sinks_as_far_over_it_as_over_both(near: float, width: float) -> None:
    """But for the stretch that brings a spall without width to the ramp's beginning."""
    found = float(edge_of(np.asarray(near), np.asarray(width)))
    stretch = (near - LOW) / (near - LOW * (1.0 - CROWN.min() / APPROACH) ** (0.5 * ROW))
    one, both = sunk_over_either(near + (found - near) / stretch, near, width)
    assert one == pytest.approx(both, rel=1e-12)
    assert found < near


@pytest.mark.parametrize(("near", "width"), [(0.1, 2.0), (-0.14, 0.6), (1.0, 2.0)])
def test_it_is_the_near_one_where_the_far_land_is_out_of_reach(near: float, width: float) -> None:
    """The rounds that are left out would have found it, too, and nothing else that moves it."""
    at = jnp.asarray(near), jnp.asarray(width)
    assert float(edge_of(*at)) == near
    crown = jnp.asarray(CROWN)
    always = narrow_spall._in_rounds(at[0], NarrowSpall(at[1], crown), APPROACH, jnp.asarray(LOW), jnp.asarray(HIGH))
    if near < HIGH:
        assert float(always) == pytest.approx(near, abs=1e-14)
        rates = np.array(jax.jit(jax.grad(edge_of, argnums=(0, 1)))(*at))
        np.testing.assert_allclose(rates, [1.0, 0.0], atol=1e-14)
    else:  # no land is left either way
        assert float(always) > HIGH


@pytest.mark.exact
@pytest.mark.parametrize("by", [-20.0, -0.4, 0.7, 20.0])
def test_what_rows_make_of_each_other_moves_it_between_its_limits(by: float) -> None:
    """Not where the spall has no width or the far land is too far; and evenly about the spall's middle."""
    shift = by * np.eye(1, 4)[0]
    for near, width in ((0.05, 0.1), (0.1, 0.2), (0.0, 0.12), (0.06, 0.2)):
        plane, found = (float(edge_of(np.asarray(near), np.asarray(width), own)) for own in (None, shift))
        c = np.clip(by, -narrow_shift.FARTHEST, narrow_shift.FARTHEST)
        rest = np.prod([1.0 - ((plane - LOW) / (edge - LOW)) ** 6 for edge in (near, width - near)])
        assert found == pytest.approx(plane + (plane - LOW) * rest * c, rel=1e-12)
        assert LOW < found < near
    middle, h = 0.05, 1e-6
    slope = float(edge_of(np.asarray(middle - h), np.asarray(0.1), shift)) - float(
        edge_of(np.asarray(middle), np.asarray(0.1), shift)
    )
    assert abs(slope) < 2e-2 * h  # what the stretch in plane strain leaves
    for near, width in ((-0.14, 0.6), (1.0, 2.0), (0.1, 2.0)):
        assert float(edge_of(np.asarray(near), np.asarray(width), shift)) == near
    none = np.array([float(edge_of(np.asarray(0.0), np.asarray(1e-9), own)) for own in (None, shift)])
    np.testing.assert_allclose(none, LOW, rtol=1e-4)


@pytest.mark.gradient
@pytest.mark.parametrize("shift", [None, 0.1 * np.random.default_rng(3).standard_normal(4)], ids=["plane", "space"])
@pytest.mark.parametrize("width", [0.08, 0.2, 0.6])
def test_expansions_in_batches_beside_jax_and_differences(width: float, shift: np.ndarray | None) -> None:
    """Some of the rollers reach the far land, others do not; by numbers, by programs, and by JAX's own rules."""
    edges = np.array([-0.1, 0.02, 0.5 * width, 0.4 * width])
    both = np.ones(edges.shape)

    def by_expansion(edge, across):
        moving = Taylor(edge, xp.stack([both, 0.0 * both])), Taylor(across * both, xp.stack([0.0 * both, both]))
        own = edge_of(*moving, shift)
        return own.value, own.by

    numbers = by_expansion(edges, width)
    traced = jax.jit(by_expansion)(jnp.asarray(edges), jnp.asarray(width))
    for ours, theirs in zip(numbers, traced, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)
    at = jnp.asarray(edges), jnp.asarray(width * both)
    rates = jax.jit(jax.vmap(jax.grad(lambda *at: edge_of(*at, shift), argnums=(0, 1))))(*at)
    np.testing.assert_allclose(numbers[1], np.array(rates), rtol=1e-8, atol=1e-9)
    h = 1e-6
    for k, rate in enumerate(rates):
        up, down = (edge_of(edges + s * h * (k == 0), (width + s * h * (k == 1)) * both, shift) for s in (1.0, -1.0))
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
    for rounds in (narrow_spall.ROUNDS, 60):
        monkeypatch.setattr(narrow_spall, "ROUNDS", rounds)
        found[rounds] = narrow_spall.equivalent_edge(near, NarrowSpall(width, crown), approach, low, high, low)
    np.testing.assert_array_less(np.abs(np.subtract(*found.values())), -1e-10 * low)

    width = high * spread(narrow_spall.FAR, 100.0)
    near = high + (0.5 * width - high) * rng.uniform(0.0, 1.0, n) ** 3
    left_out = narrow_spall._in_rounds(near, NarrowSpall(width, crown), approach, low, high)
    assert np.all(left_out >= high)
