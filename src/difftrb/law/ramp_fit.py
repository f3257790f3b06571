"""Ramps fitted to contact solves: where they begin and end, and the share of the land's load that is left on them.

Also who stands on which ramp (`roller_curves`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.core.numeric import chebyshev
from difftrb.law import edge_ramp, load_curve
from difftrb.law.base import spalls_under
from difftrb.law.edge_ramp import GUESS, Ramp, RollerCurves
from difftrb.law.load_curve import Curve
from difftrb.law.samples import Node

EXTENT_DEGREE = 5
"""Of the polynomials that say where a ramp begins and ends."""
LAST = 0.985
"""t beyond which a share is too small to be told from the error of a contact solve."""
RIDGE = 5e-4
"""Ridge weight: sample noise over coefficient size."""
NEAR_RIDGE = 5e-6
"""The same of solves at one place. A tenth of it makes errors of derivatives of stiffness by width six times as large,
up to 2e-2 of the largest: those of the solves. Ten times as much makes the fit's own error as large."""
ROUNDS = 6
"""Rounds of the fit of a share; in each, outliers count less."""
NOISE = 5e-4
"""Usual error of a solve's share."""
SLOPES_COUNT = 0.05
"""Weight of a share's derivative by t beside that of a share: solves give it less exactly."""


class Healthy(NamedTuple):
    """A roller on a healthy raceway: its curve, and what `Ramp` needs of it: half-width, loads, radius."""

    curve: Curve
    half_width: jax.Array
    loads: jax.Array
    radius: Real

    def beside(self, edge: jax.Array, full: Curve, sunk: jax.Array, share: jax.Array) -> Ramp:
        """The ramp from here to a curve over the middle of a spall."""
        return Ramp(edge, self.curve, full, self.half_width, sunk, self.loads, self.radius, share)


def healthy_level(
    contact: LineContact, solved: LineContact, log_loads: jax.Array, approaches: jax.Array, half_width: jax.Array
) -> Healthy:
    """For `contact`, of solves of a neighbour of it, `solved`, at `log_loads` [log N], shape (loads,): approaches
    carried to `contact` [mm], shape (loads,), and `Ramp.half_width` as solved."""
    middle, reach = 0.5 * (log_loads[-1] + log_loads[0]), 0.5 * (log_loads[-1] - log_loads[0])
    own = load_curve.through(log_loads, approaches, jnp.zeros(()))
    wider = 0.5 * jnp.log(contact.radius / solved.radius * solved.modulus / contact.modulus)  # as of a line contact
    return Healthy(own, half_width.at[0].add(wider), jnp.stack([middle, reach]), contact.radius)


def extents(log_loads: np.ndarray, half_widths: np.ndarray) -> np.ndarray:
    """Coefficients of `Ramp.half_width`, shape (EXTENT_DEGREE + 1, …), of half-widths of shape (loads, …)."""
    x = (2.0 * log_loads - log_loads[-1] - log_loads[0]) / (log_loads[-1] - log_loads[0])
    told = np.where(half_widths > 0.0, half_widths, np.nan)  # without a solution there is none, as its status says
    return np.polynomial.polynomial.polyfit(x, np.log(told), EXTENT_DEGREE)


def sunk(contact: LineContact, solved: Sequence[Node], log_loads: np.ndarray) -> np.ndarray:
    """Coefficients of `Ramp.sunk`, of solves over the middle of one spall at `log_loads` [log N]."""
    depth = [node.approach - node.reach**2 / (2.0 * float(contact.radius)) for node in solved]
    return extents(log_loads, np.array(depth) / np.exp(log_loads))


def roller_curves(
    healthy: Healthy, fulls: Sequence[Curve], ramps: Sequence[Sequence[Ramp]], spalls: tuple[Spall, ...],
    distances: jax.Array,
) -> RollerCurves:  # fmt: skip
    """Q(δ) of rollers at `distances` [mm] from `spalls`, shape (spalls, rollers): `fulls` are curves over the middle of
    each spall, `ramps` of each those of the two rollers `next_to` its edges."""
    under = spalls_under(spalls, distances)
    each = load_curve.chosen(load_curve.joined(healthy.curve, *fulls), under)
    if not spalls:
        return RollerCurves(each)
    at: list[jax.Array] = []
    for i, spall in enumerate(spalls):
        for side in (1.0, -1.0):
            here = next_to(spall, distances[i], side) & ((under == 0) | (under == i + 1))
            for taken in at:  # no roller twice: it may be the nearest to both edges
                here = here & ~taken
            at.append(here)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[ramp for pair in ramps for ramp in pair])
    return RollerCurves(each, stacked, jnp.stack(at).astype(float))


def next_to(spall: Spall, distances: jax.Array, side: float) -> jax.Array:
    """Which roller, of those at `distances` [mm] from the spall's middle, is nearest to its edge on one `side` (±1).

    Only that one can stand on the ramp: rollers are farther apart than it is long.
    """
    apart = jnp.abs(distances - side * 0.5 * spall.width)
    return jnp.argmin(apart) == jnp.arange(distances.size)


def over(spall: Spall, distances: jax.Array, side: float) -> jax.Array:
    """How far the edge stands beyond that roller's middle [mm], positive over the spall."""
    beyond = 0.5 * spall.width - jnp.abs(distances)
    return jnp.sum(jnp.where(next_to(spall, distances, side), beyond, 0.0))  # no gather: slow in a batch


def fitted(ramp: Ramp, approach: jax.Array, load: jax.Array, by_edge: jax.Array, degree: int) -> jax.Array:
    """`Ramp.share` of many contact solves with edges at `ramp.edge` on one and the same spall, else of shape ().

    Args:
      approach [mm], load [N]: of the solves, shape (n,). by_edge: dQ/d(edge) at fixed approach [N/mm], shape (n,).
      degree: of y in log Qₕ.

    Outliers count less.
    """
    seen = _seen(ramp, approach, load)
    rows, right, weight = _equations(seen, degree)
    slope_rows, slope_right = _slope_equations(seen, by_edge, degree)
    matrix = jnp.concatenate([weight[:, None] * rows, SLOPES_COUNT * weight[:, None] * slope_rows])
    start = edge_ramp.guess(degree)
    values = jnp.concatenate([weight * right, SLOPES_COUNT * weight * slope_right]) - matrix @ start.ravel()
    found, count = jnp.zeros(start.size), jnp.ones(values.shape[0])
    for _ in range(ROUNDS):
        found = least_squares(count[:, None] * matrix, count * values)
        off = jnp.abs(matrix @ found - values)
        count = 1.0 / jnp.sqrt(1.0 + (off / (3.0 * jnp.median(off) + NOISE)) ** 2)
    return start + found.reshape(start.shape)


def through(ramp: Ramp, approach: jax.Array, load: jax.Array) -> jax.Array:
    """`Ramp.share` of contact solves with one edge at one place, through all of them, nearly; as `fitted`."""
    rows, right, weight = _equations(_seen(ramp, approach, load), 0)
    found = least_squares(weight[:, None] * rows, weight * (right - rows @ GUESS), NEAR_RIDGE)
    return edge_ramp.guess() + found[None]


def least_squares(matrix: jax.Array, right: jax.Array, ridge: float = RIDGE) -> jax.Array:
    """x with `matrix` · x nearest to `right`, shape (n,) or (n, k); what the rows do not tell stays small."""
    q, r = jnp.linalg.qr(jnp.concatenate([matrix, ridge * jnp.eye(matrix.shape[1])]))
    return jax.scipy.linalg.solve_triangular(r, q[: matrix.shape[0]].T @ right)


def residual(ramp: Ramp, approach: jax.Array, load: jax.Array) -> jax.Array:
    """How far `load`s [N] at `approach`es [mm] are from the ramp's, in the equations that y is fitted by; (n,)."""
    rows, right, weight = _equations(_seen(ramp, approach, load), ramp.share.shape[0] - 1)
    return weight * (rows @ ramp.share.ravel() - right)


def equations(ramp: Ramp, approach: jax.Array, load: jax.Array, degree: int) -> jax.Array:
    """The weighted matrix of the same equations, shape (n, (degree + 1)·TERMS)."""
    rows, _, weight = _equations(_seen(ramp, approach, load), degree)
    return weight[:, None] * rows


def _basis(t: jax.Array, level: jax.Array, degree: int) -> jax.Array:
    """Shape (n, (degree + 1)·TERMS)."""
    levels = jnp.stack(chebyshev(level, degree), axis=1)
    return (levels[:, :, None] * jnp.stack(edge_ramp.terms(t), axis=1)[:, None]).reshape(t.shape[0], -1)


class _Seen(NamedTuple):
    """A solve as the ramp sees it: t, share W, Qₕ and Qₕ − Qₛ [N], extent of the ramp [mm], level of y."""

    t: jax.Array
    share: jax.Array
    healthy: jax.Array
    loss: jax.Array
    extent: jax.Array
    level: jax.Array


def _seen(ramp: Ramp, approach: jax.Array, load: jax.Array) -> _Seen:
    healthy, full, low, high = edge_ramp.between(ramp, approach)
    t, loss = edge_ramp.place(ramp.edge, low, high), healthy - full
    return _Seen(t, (load - full) / loss, healthy, loss, high - low, edge_ramp.level(ramp, healthy))


def _equations(seen: _Seen, degree: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """W t² y = 1 − t² − W, one row a solve, and what each counts: such that errors are those of Q by Qₕ."""
    t, share = seen.t, seen.share
    known = (t < LAST) & (share > 0.0)
    weight = jnp.where(known, share / jnp.where(known, 1.0 - t * t, 1.0), 0.0) * seen.loss / seen.healthy
    rows = (share * t * t)[:, None] * _basis(t, seen.level, degree)
    return rows, 1.0 - t * t - share, jax.lax.stop_gradient(weight)


def _slope_equations(seen: _Seen, by_edge: jax.Array, degree: int) -> tuple[jax.Array, jax.Array]:
    """The same, differentiated by t."""
    t, share = seen.t, seen.share
    basis, rate = jax.jvp(lambda v: _basis(v, seen.level, degree), (t,), (jnp.ones_like(t),))
    slope = by_edge * seen.extent / seen.loss
    rows = (slope * t * t + 2.0 * t * share)[:, None] * basis + (share * t * t)[:, None] * rate
    return rows, -2.0 * t - slope
