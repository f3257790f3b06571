"""Both edges of a pit narrower than the contact: plane strain against a solve on cells, and its limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb.law import narrow_spall as pit

pytestmark = pytest.mark.exact


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
    return width**2 * float(pit.sinking(*map(jnp.asarray, (near, width, half_width))))


@pytest.mark.parametrize(("width", "away"), [(0.3, 0.0), (0.3, 0.5), (0.3, 0.9), (0.3, 1.05), (1.2, 0.5), (1.2, 1.2),
                                         (3.0, 0.2), (3.0, 0.5), (3.0, 2.4)])  # fmt: skip
def test_roller_sinks_as_far_as_on_cells(width: float, away: float) -> None:
    edges = away - 0.5 * width, away + 0.5 * width
    more = pressed([(-2.5, edges[0]), (edges[1], edges[1] + 1.5)]) - pressed([(-2.5, 2.5)])
    assert sunk(0.5 * width - away, width) == pytest.approx(more, rel=5e-3, abs=2e-4)


@pytest.mark.parametrize("width", [1e-3, 0.1, 1.0, 4.0, 20.0])
def test_in_the_middle_it_is_the_chord(width: float) -> None:
    """w²/8R exactly, whatever the load."""
    for half_width in (0.9, 1.0, 1.3):
        assert sunk(0.5 * width, width, half_width) == pytest.approx(width**2 / 8.0, rel=1e-12)


def test_wide_pit_has_one_edge_and_a_far_one_none() -> None:
    for near in (-0.9, 0.0, 0.7):
        assert sunk(near, 9.0) == pytest.approx(float(pit.over_one(jnp.asarray(near), jnp.asarray(1.0))), rel=1e-12)
    assert sunk(-1.0, 0.4) == sunk(-1.2, 0.4) == 0.0


@pytest.mark.parametrize("width", [0.05, 0.4, 2.0, 9.0, 30.0])
def test_sinking_is_continuous_where_the_far_land_begins_to_touch(width: float) -> None:
    away = np.linspace(0.0, 0.5 * width + 1.0, 20001)
    values = jax.vmap(pit.sinking, (0, None, None))(jnp.asarray(0.5 * width - away), jnp.asarray(width), jnp.ones(()))
    steps = np.abs(np.diff(values))
    assert steps.max() < 12.0 * 0.125 * (away[1] - away[0]) * (1.0 + 1.0 / width)
    assert np.all(np.diff(values) < 1e-4)  # falls with the distance, to the polynomial's error


@pytest.mark.parametrize("width", [0.0, 1e-9, 1e-4, 0.3, 40.0])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_derivatives_are_numbers_and_those_of_differences(width: float, share: float) -> None:
    at = jnp.asarray(0.5 * width - share * (1.0 + 0.5 * width)), jnp.asarray(width), jnp.asarray(1.1)
    both = [np.array(jax.jit(way(pit.sinking, (0, 1, 2)))(*at)) for way in (jax.grad, jax.jacfwd)]
    assert np.isfinite(both).all()
    np.testing.assert_allclose(*both, rtol=1e-9, atol=1e-9)
    if width > 0.1 and share < 1.0:
        for i in range(3):
            h = 1e-6
            up, down = (pit.sinking(*(a + (s * h if k == i else 0.0) for k, a in enumerate(at))) for s in (1.0, -1.0))
            assert float(both[0][i]) == pytest.approx(float(up - down) / (2 * h), abs=1e-6)


def test_slope_of_one_edge() -> None:
    for near in (-0.99, 0.0, 3.0):
        at = jnp.asarray(near), jnp.asarray(0.7)
        assert float(pit.over_one_slope(*at)) == pytest.approx(float(jax.grad(pit.over_one)(*at)), rel=1e-9, abs=1e-12)
