"""Q(δ) of one roller: its normal load [N] by the approach of the bodies it is pressed between [mm].

Every law here is Q = K δⁿ with a pair (K, n) that depends on the length of the spall under the roller.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from difftrb import contact as contacts
from difftrb import given, hertz, status
from difftrb.geometry import LineContact, Real, Spall

NAMES = ("palmgren", "power", "liu2018")
LATER = ("table", "direct")

# Liu et al. 2018, Table 2: spall length [mm], K [N/mmⁿ], n, largest error of the fit
TABLE_2 = np.array(
    [
        [0.0, 9.386e5, 1.201, 0.0221],
        [2.0, 9.052e5, 1.215, 0.0237],
        [4.0, 8.270e5, 1.231, 0.0224],
        [6.0, 7.469e5, 1.244, 0.0250],
        [8.0, 6.162e5, 1.262, 0.0245],
    ]
)

LENGTH_SHARE = 0.85
"""The fitted law covers spalls up to this share of the roller's length."""
LENGTH_NODES = 7
LOAD_NODES = 9


class Law(Protocol):
    """What a law has to answer. `error` is the largest relative error of Q against what it was fitted to (NaN if
    unknown), inside `load_range` [N] and for spalls up to `longest` [mm]."""

    @property
    def name(self) -> str: ...
    @property
    def longest(self) -> Real: ...
    @property
    def load_range(self) -> tuple[Real, Real]: ...
    @property
    def error(self) -> Real: ...
    @property
    def status_code(self) -> Real: ...
    def coefficients(self, spall_length: jax.Array) -> tuple[jax.Array, jax.Array]: ...


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["lengths", "log_stiffness", "exponent", "load_range", "error", "status_code"],
    meta_fields=["name"],
)
@dataclasses.dataclass(frozen=True)
class PowerLaw:
    """Q = K δⁿ with log K and n interpolated in the spall's length by the polynomial through all nodes.

    Attributes:
      lengths: spall lengths of the nodes [mm], shape (m,), the first is 0 (healthy).
      log_stiffness: log of K [N/mmⁿ], shape (m,). exponent: n, shape (m,).
      load_range: smallest and largest load that were fitted [N].
      error: largest relative error of Q over all solves, fitted ones and others half-way between them in load and
        length (for Table 2: the paper's own figure).
      status_code: worst status of the contact solves behind the law (a float, so that a law can be differentiated).
      name: "power" or "liu2018".
    """

    lengths: jax.Array
    log_stiffness: jax.Array
    exponent: jax.Array
    load_range: tuple[Real, Real]
    error: Real
    status_code: Real
    name: str

    @property
    def longest(self) -> Real:
        """Longest spall the law knows [mm]."""
        return self.lengths[-1]

    def coefficients(self, spall_length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """K [N/mmⁿ] and n for spalls of `spall_length` [mm], any shape, 0…`longest`."""
        nodes = jnp.stack([self.log_stiffness, self.exponent], axis=-1)
        values = _lagrange(self.lengths, nodes, jnp.asarray(spall_length))
        return jnp.exp(values[..., 0]), values[..., 1]


@partial(jax.tree_util.register_dataclass, data_fields=["length"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Palmgren:
    """Palmgren's line contact of a whole roller between both rings, on the land that a spall leaves.

    δ = 3.84e-5 Q^0.9 / l^0.8, so n = 10/9; the spall shortens l. `length` is the roller's [mm]. Unlike the other laws
    it holds both raceways' compliance. Its error against the half-space is not known: NaN.
    """

    length: Real
    name = "palmgren"
    load_range = (0.0, np.inf)
    error = np.nan
    status_code = float(status.CONVERGED)

    @property
    def longest(self) -> Real:
        """Longest spall [mm]: 99 % of the roller."""
        return 0.99 * self.length

    def coefficients(self, spall_length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """K [N/mmⁿ] and n for spalls of `spall_length` [mm], any shape."""
        n = 10.0 / 9.0
        K = hertz.palmgren_approach(1.0, self.length - jnp.asarray(spall_length)) ** -n
        return K, jnp.full_like(K, n)


def load(law: Law, approach: jax.Array, spall_length: jax.Array) -> jax.Array:
    """Load Q = K δⁿ of rollers [N] at `approach` δ [mm] over spalls of `spall_length` [mm]; 0 where δ ≤ 0."""
    return power(approach, *law.coefficients(spall_length))[0]


def stiffness(law: Law, approach: jax.Array, spall_length: jax.Array) -> jax.Array:
    """dQ/dδ of rollers [N/mm]; 0 where δ ≤ 0."""
    return power(approach, *law.coefficients(spall_length))[1]


def power(approach: jax.Array, K: jax.Array, n: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Q = K δⁿ [N] and dQ/dδ [N/mm]; both 0 where δ ≤ 0."""
    touching = approach > 0.0
    depth = jnp.where(touching, approach, 1.0)
    slope = jnp.where(touching, n * K * depth ** (n - 1.0), 0.0)  # Liu et al. 2018, eq. (6)
    return slope * depth / n, slope


def named(name: str, contact: LineContact, load_range: tuple[Real, Real], spall: Spall | None, accuracy: float) -> Law:
    """The law called `name`: "power" (fitted now: see `power_law`), "liu2018" or "palmgren"."""
    if name == "power":
        return power_law(contact, load_range, spall, accuracy)
    if name == "liu2018":
        return liu2018()
    if name == "palmgren":
        return Palmgren(contact.length)
    raise ValueError(unknown(name))


def unknown(name: str) -> str:
    """The sentence for a law that cannot be had."""
    if name in LATER:
        return f"law = {name!r} is not available in this version; use one of {', '.join(NAMES)}"
    return f"law = {name!r} is unknown; use one of {', '.join(NAMES)}"


def liu2018() -> PowerLaw:
    """Table 2 of Liu et al. 2018 as printed: 32008J's outer raceway, spalls of 0…8 mm.

    The table does not give its load range; 1.5…10 kN is the range for which its errors come out again. It is softer
    than the half-space: its authors' solution domain cut the contact off. Use it to compare with the paper.
    """
    return PowerLaw(
        lengths=jnp.asarray(TABLE_2[:, 0]),
        log_stiffness=jnp.log(jnp.asarray(TABLE_2[:, 1])),
        exponent=jnp.asarray(TABLE_2[:, 2]),
        load_range=(1500.0, 10000.0),
        error=float(TABLE_2[:, 3].max()),
        status_code=float(status.CONVERGED),
        name="liu2018",
    )


def power_law(
    contact: LineContact,
    load_range: tuple[Real, Real] = (1500.0, 10000.0),
    spall: Spall | None = None,
    accuracy: float = 1e-3,
) -> PowerLaw:
    """Fit Q = K δⁿ to contact solves of this roller, crown and raceway, for spalls of 0…85 % of the roller.

    Args:
      contact: from `LineContact.of`.
      load_range: smallest and largest roller load of the fit [N]. δ(Q) of a crowned roller is no power law: the error
        grows from about 2 % over less than a decade to 30 % over two. Name the loads that matter.
      spall: its width, depth and axial offset are used, its length is not; None is a deep and wide one. Rollers are
        centred in it in the rolling direction.
      accuracy: relative accuracy of every contact solve, 1e-2…1e-4.

    Least squares in log Q over log δ at equally spaced log Q. Differentiable by everything in `contact` and `spall`.
    Prepare the law once and give it to `Scene(law=...)` to pay for the fit once.
    """
    status.require_float64()
    shape = spall if spall is not None else Spall(length=1.0, width=10.0)
    return _fit(contact, load_range, shape, accuracy, given.is_symmetric(shape))


@partial(jax.jit, static_argnames=("accuracy", "mirrored"))
def _fit(
    contact: LineContact, load_range: tuple[Real, Real], shape: Spall, accuracy: float, mirrored: bool
) -> PowerLaw:
    if mirrored:
        shape = dataclasses.replace(shape, axial_offset=0.0)
    angle = np.pi * (np.arange(LENGTH_NODES) / (LENGTH_NODES - 1))
    lengths = 0.5 * LENGTH_SHARE * contact.length * (1.0 - np.cos(angle))  # Chebyshev–Lobatto nodes
    between = 0.5 * (lengths[1:] + lengths[:-1])
    low, high = load_range
    loads = jnp.exp(jnp.linspace(jnp.log(low), jnp.log(high), LOAD_NODES))
    loads_between = jnp.sqrt(loads[1:] * loads[:-1])

    def approach(case: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        solution = contacts.solve_contact(
            contact, case[1], dataclasses.replace(shape, length=case[0]), 0.0, accuracy, "cells"
        )
        return solution.approach, solution.status_code

    fitted, checked = ([a.ravel() for a in jnp.meshgrid(*g, indexing="ij")] for g in
                       ((lengths, loads), (between, loads_between)))  # fmt: skip
    cases = tuple(jnp.concatenate(pair) for pair in zip(fitted, checked, strict=True))
    approaches, codes = jax.lax.map(approach, cases)
    nodes = jnp.log(approaches[: LENGTH_NODES * LOAD_NODES]).reshape(LENGTH_NODES, LOAD_NODES)
    intercept, slope = _regress(nodes, jnp.log(loads))
    law = PowerLaw(jnp.asarray(lengths), intercept, slope, (low, high), 0.0, jnp.max(codes).astype(float), "power")
    predicted = load(law, approaches, cases[0])
    error = jnp.max(jnp.abs(predicted / cases[1] - 1.0))
    return dataclasses.replace(law, error=jax.lax.stop_gradient(error))


def _regress(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Intercepts and slopes of least-squares lines y over x; x of shape (m, k), y of shape (k,)."""
    x_mean = jnp.mean(x, axis=1, keepdims=True)
    y_mean = jnp.mean(y)
    slope = jnp.sum((x - x_mean) * (y - y_mean)[None, :], axis=1) / jnp.sum((x - x_mean) ** 2, axis=1)
    return y_mean - slope * x_mean[:, 0], slope


def _lagrange(nodes: jax.Array, values: jax.Array, x: jax.Array) -> jax.Array:
    """The polynomial through (nodes, values) at x; nodes (m,), values (m, k), x any shape → x.shape + (k,)."""
    m = nodes.shape[0]
    other = ~np.eye(m, dtype=bool)

    def at(point: jax.Array) -> jax.Array:
        factors = (point - nodes)[None, :] / jnp.where(other, nodes[:, None] - nodes[None, :], 1.0)
        return jnp.prod(jnp.where(other, factors, 1.0), axis=-1) @ values

    return jax.vmap(at)(x.ravel()).reshape(*x.shape, -1)
