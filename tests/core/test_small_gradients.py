"""Derivatives of the small functions that others build on: AD both ways against central differences, and at kinks."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import contact_extent, crown
from difftrb.contact.height_map import HeightMap, height_at
from difftrb.core import packaged_bearings, series
from difftrb.core.geometry import LineContact, Spall
from difftrb.ring.load import largest_load, needed_axial

pytestmark = pytest.mark.gradient

Function = Callable[[jax.Array], jax.Array]
HEIGHTS = jnp.array([[0.3, -1.0, 0.2], [0.5, -2.0, 0.1], [0.4, -0.7, 0.6]])
HALF = 0.5 * 13.66


def roller(v: jax.Array) -> LineContact:
    return LineContact(v[0], v[1], v[2], v[3])


def height(v: jax.Array) -> jax.Array:
    """Of a map whose heights, pitches, axial offset and offset differ, at a place that differs, too."""
    m = HeightMap(HEIGHTS * v[0], v[1], v[2], v[3])
    return height_at(m, v[4], v[5:6], v[6:7])[0, 0]


def bearing(v: jax.Array) -> trb.TaperedBearing:
    values, tree = jax.tree.flatten(trb.bearing("32008J"))
    place = [i for i, value in enumerate(values) if value == packaged_bearings.bearing("32008J").outer_angle]
    values[place[0]] = v
    return jax.tree.unflatten(tree, values)


def polynomial(v: jax.Array) -> jax.Array:
    """A curve's logarithm, its slope and the change of that, within and beyond the nodes."""

    def straight(z: jax.Array) -> jax.Array:
        return series.polynomial(jnp.tile(v[:4, None], z.size), z, straight=True)

    def rates(z: jax.Array) -> jax.Array:
        return jax.grad(lambda z: jnp.sum(straight(z)))(z)

    value, rate, bend = straight(v[4:]), rates(v[4:]), jax.grad(lambda z: jnp.sum(rates(z)))(v[4:])
    return jnp.vdot(jnp.concatenate([value, rate, bend]), jnp.arange(1.0, 13.0))


SMOOTH: dict[str, tuple[Function, list[float]]] = {
    "height_at": (height, [1.3, 0.03, 0.05, 0.004, 0.007, 0.021, -0.017]),
    "crown_scale": (lambda v: jnp.asarray(crown.scale(roller(v))), [3.6, 13.66, 1.1e5, 6500.0]),
    "crown_at": (lambda v: crown.height(v[4], roller(v)), [3.6, 13.66, 1.1e5, 6500.0, 6.2]),
    "crown_at, straight": (lambda v: crown.height(v[1], LineContact(3.6, v[0], 1.1e5, v[2])), [13.66, 6.2, 10.0]),
    "straight": (polynomial, [5.3, 2.9, -0.14, 0.05, -1.3, -0.4, 0.7, 1.2]),
    "needed_axial": (lambda v: needed_axial(bearing(v[0]), v[1], v[2]), [0.25, 9000.0, 0.09]),
    "largest_load, part loaded": (
        lambda v: jnp.asarray(largest_load(bearing(v[0]), trb.Load(v[1], v[2]))), [0.25, 9000.0, 3000.0],
    ),
    "largest_load, all loaded": (
        lambda v: jnp.asarray(largest_load(bearing(v[0]), trb.Load(v[1], v[2]))), [0.25, 1000.0, 9000.0],
    ),
}  # fmt: skip


def central(function: Function, at: np.ndarray, relative: float = 1e-5) -> np.ndarray:
    def slope(i: int) -> float:
        step = np.zeros_like(at)
        step[i] = relative * abs(at[i])
        return float(function(jnp.asarray(at + step)) - function(jnp.asarray(at - step))) / (2.0 * step[i])

    return np.array([slope(i) for i in range(at.size)])


@pytest.mark.parametrize("name", SMOOTH)
def test_both_modes_match_central_differences(name: str) -> None:
    function, values = SMOOTH[name]
    at = np.array(values)
    reverse = np.asarray(jax.jit(jax.grad(function))(jnp.asarray(at)))
    np.testing.assert_allclose(reverse, central(jax.jit(function), at), rtol=1e-6, atol=1e-9 * np.abs(reverse).max())
    np.testing.assert_allclose(jax.jit(jax.jacfwd(function))(jnp.asarray(at)), reverse, rtol=1e-11)


EVEN = 2.08 * 9000.0 * np.tan(0.2473)  # the axial load under which both estimates of the largest load agree
KINKS: dict[str, Function] = {
    "height_at": lambda x: height_at(HeightMap(HEIGHTS, 0.03, 0.05), 0.0, x[None], jnp.array([0.01]))[0, 0],
    "needed_axial": lambda x: needed_axial(trb.bearing("32008J"), 9000.0, x),
    "largest_load": lambda x: jnp.asarray(largest_load(trb.bearing("32008J"), trb.Load(9000.0, EVEN * (1.0 + x)))),
}


@pytest.mark.parametrize("name", KINKS)
def test_at_a_kink_the_slope_lies_between_both_sides(name: str) -> None:
    """At a point of the map, under a roller on the load line, and where the rollers are just all loaded."""
    function, step = KINKS[name], 1e-7
    value, after, before = (float(function(jnp.asarray(x))) for x in (0.0, step, -step))
    sides = (value - before) / step, (after - value) / step
    room = 1e-5 * max(map(abs, sides))
    assert abs(sides[1] - sides[0]) > 100.0 * room  # it is one
    for slope in (jax.grad(function)(0.0), jax.jacfwd(function)(0.0)):
        assert min(sides) - room <= float(slope) <= max(sides) + room
    if name == "height_at":
        assert float(jax.grad(function)(0.0)) == pytest.approx(0.5 * sum(sides), abs=room)  # as promised


def test_the_crown_at_the_rollers_end_spoils_no_derivative(contact: trb.LineContact) -> None:
    """It is infinite there; a choice that leaves it out has the derivative of what it takes."""

    def lowest(y: jax.Array) -> jax.Array:
        return jnp.min(crown.height(jnp.stack([y, jnp.asarray(HALF), jnp.asarray(HALF + 1.0)]), contact))

    assert np.isinf(float(crown.height(jnp.asarray(HALF), contact)))
    expected = central(lambda v: lowest(v[0]), np.array([5.0]))[0]
    for slope in (jax.grad(lowest)(5.0), jax.jacfwd(lowest)(5.0)):
        assert float(slope) == pytest.approx(float(expected), rel=1e-6)


@pytest.mark.parametrize("delta", [0.0, 0.005, 1.5**2 / (2.0 * 3.6), 0.4])
def test_clear_of_spall_is_a_choice_without_derivative(delta: float) -> None:
    """From no approach at all, whose root is steep, through the one that just reaches an edge, to the bottom."""
    spall = Spall(4.0, 4.0, 0.3)

    def chosen(v: jax.Array) -> jax.Array:
        roller = LineContact(v[0], 13.66, 1.1e5)
        return jnp.where(contact_extent.clear_of_spall(roller, spall, v[1], v[2]), 3.0 * v[2], v[0] * v[2])

    at = jnp.array([3.6, 0.5, delta])
    clear = bool(contact_extent.clear_of_spall(LineContact(3.6, 13.66, 1.1e5), spall, at[1], at[2]))
    assert clear == (delta < 0.3)
    expected = [0.0, 0.0, 3.0] if clear else [delta, 0.0, 3.6]
    for slopes in (jax.grad(chosen)(at), jax.jacfwd(chosen)(at)):
        np.testing.assert_allclose(slopes, expected, rtol=1e-15)
