"""What a roller law is, and the power laws: Q = K δⁿ with a pair (K, n) for every length of the spall underneath."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import NamedTuple, Protocol

import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from difftrb.contact import contact_solution, gap
from difftrb.contact import solver as contacts
from difftrb.core import geometry, status
from difftrb.core.geometry import LineContact, Real, Spall, TaperedBearing
from difftrb.core.messages import shown
from difftrb.law import edge_ramp, load_curve
from difftrb.law.edge_ramp import Carried

AUTO = "auto"
"""In place of a law's name: one is to be chosen by the accuracy asked for (`difftrb.choice`)."""
NAMES = ("palmgren", "power", "liu2018", "table", "direct", AUTO)

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

OF_CONTACT = ("roller_small_diameter", "roller_large_diameter", "roller_length", "outer_angle", "inner_angle",
              "roller_angle", "modulus", "poisson")  # fmt: skip
"""What of a bearing decides on the contact of its rollers with the outer raceway."""

LENGTH_SHARE = 0.85
"""A law from contact solves covers spalls up to this share of the roller's length."""
LENGTH_NODES = 7
LOAD_NODES = 9
ALIKE = 0.05
"""By how much of itself a contact may differ from the one that a law was fitted for: loads then change by about a
hundredth, which is less than the error of a power law."""
CONTACTS = LENGTH_NODES * LOAD_NODES + (LENGTH_NODES - 1) * (LOAD_NODES - 1)
"""Contact solves of a power law: fitted, and between."""


class Rest(NamedTuple):
    """Rollers at rest on one raceway, as far as a law is judged by it.

    Attributes:
      radius: equivalent radius of the contacts [mm], shape ().
      approach: of every roller's contact, or more [mm], shape (rollers,).
      loads: [N], shape (rollers,).
    """

    radius: Real
    approach: jax.Array
    loads: jax.Array

    def in_reach(self, spall: Spall, distances: jax.Array) -> jax.Array:
        """Whether each roller, its contact at `distances` [mm] from the spall's middle, may meet it, shape (rollers,).

        Beyond √(2Rδ) from the contact's middle the gap exceeds the approach.
        """
        beside = jnp.maximum(jnp.abs(distances) - 0.5 * spall.width, 0.0)
        return (beside**2 < 2.0 * self.radius * self.approach) & (self.approach > 0.0) & (spall.length > 0.0)


class Law(Protocol):
    """What a law has to answer.

    `error` is the largest relative error of Q against what it was fitted to (NaN if unknown), inside `load_range` [N];
    `hard` says whether a roller is in a spall or not, with nothing in between. `curves` gives what every roller
    carries, Q(δ), from the distances of their contacts from the spalls' centres in the rolling direction [mm], shape
    (spalls, rollers). `judge` a status: whether the law knows such spalls and distances and, if the rollers are `at`
    rest, the states they are in. `ramp` says between which
    distances from its rolling edge [mm], positive over the spall, the spall numbered `number` lets down a roller whose
    approach [mm] is given. `at` is the law for a contact of other numbers: the same law, unless it knows better.
    """

    @property
    def name(self) -> str: ...
    @property
    def hard(self) -> bool: ...
    @property
    def load_range(self) -> tuple[Real, Real]: ...
    @property
    def error(self) -> Real: ...
    @property
    def status_code(self) -> Real: ...
    def at(self, contact: LineContact) -> Law: ...
    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> Carried: ...
    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array: ...
    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]: ...


def load_over(
    law: Law, approach: jax.Array, spall: Spall | None = None, distance: Real = 0.0
) -> tuple[jax.Array, jax.Array]:
    """Load [N] and its slope [N/mm] of one roller at an approach [mm], all of shape (), whose contact stands `distance`
    [mm] from the middle of `spall`, or on a healthy raceway."""
    spalls = () if spall is None else (spall,)
    carried = law.curves(spalls, jnp.full((len(spalls), 1), distance))
    load, slope = edge_ramp.carried(carried, jnp.reshape(approach, (1,)))
    return load[0], slope[0]


def spalls_under(spalls: tuple[Spall, ...], distances: jax.Array) -> jax.Array:
    """Which spall every roller is over, counted from 1; 0 is none; shape (rollers,).

    A hard window: a roller is over a spall while the middle of its contact is, so nothing changes with width but the
    number of rollers inside. Of several, the longest counts. `distances` as in `Law.curves`.
    """
    over = jnp.zeros(distances.shape[1:], int)
    longest = jnp.full(distances.shape[1:], -1.0)  # a spall of no length counts: its curve is healthy, its slope is not
    for i, spall in enumerate(spalls):
        inside = (jnp.abs(distances[i]) < 0.5 * spall.width) & (spall.length > longest)  # Liu et al. 2018, eq. (7)
        over, longest = jnp.where(inside, i + 1, over), jnp.where(inside, spall.length, longest)
    return over


def _lengths(spalls: tuple[Spall, ...]) -> jax.Array:
    """Lengths of no spall and of every spall [mm], shape (1 + spalls,)."""
    return jnp.stack([jnp.zeros(()), *(jnp.asarray(spall.length, float) for spall in spalls)])


def known_up_to(longest: Real, spalls: tuple[Spall, ...]) -> jax.Array:
    """Status: whether no spall is longer than `longest` [mm]."""
    return jnp.where(jnp.asarray(longest) >= jnp.max(_lengths(spalls)), status.CONVERGED, status.UNKNOWN_LENGTH)


def of_one_deep_spall(spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None) -> jax.Array:
    """Status: whether no roller meets several spalls, or may meet a spall's bottom."""
    if rest is None or not spalls:
        return jnp.asarray(status.CONVERGED)
    met = jnp.stack([rest.in_reach(spall, away) for spall, away in zip(spalls, distances, strict=True)])
    depths = jnp.stack([jnp.asarray(spall.depth, float) for spall in spalls])
    shallow = jnp.any(met & (depths[:, None] < rest.approach[None]))
    code = jnp.where(shallow, status.BOTTOM, status.CONVERGED)
    if len(spalls) < 2:
        return code
    return jnp.where(jnp.any(jnp.sum(met, axis=0) > 1), status.SEVERAL, code)


def within_range(load_range: tuple[Real, Real], rest: Rest | None) -> jax.Array:
    """Status: whether the most loaded roller is in the range of loads [N] that a law was made for."""
    if rest is None:
        return jnp.asarray(status.CONVERGED)
    largest = jnp.max(rest.loads)
    inside = (largest >= load_range[0]) & (largest <= load_range[1])
    return jnp.where(inside | (largest <= 0.0), status.CONVERGED, status.OUTSIDE)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["lengths", "log_stiffness", "exponent", "load_range", "error", "status_code", "fitted", "contact"],
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
      fitted: the contact, and the axial offset of spalls [mm], that it was fitted for; None: not known, and not judged.
      contact: the one it is used for.
    """

    lengths: jax.Array
    log_stiffness: jax.Array
    exponent: jax.Array
    load_range: tuple[Real, Real]
    error: Real
    status_code: Real
    name: str
    fitted: tuple[LineContact, Real] | None = None
    contact: LineContact | None = None
    hard = True

    def coefficients(self, spall_length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """K [N/mmⁿ] and n for spalls of `spall_length` [mm], any shape, up to the longest node."""
        nodes = jnp.stack([self.log_stiffness, self.exponent], axis=-1)
        values = load_curve.weights(self.lengths, jnp.asarray(spall_length)) @ nodes
        return jnp.exp(values[..., 0]), values[..., 1]

    def at(self, contact: LineContact) -> PowerLaw:
        """See `Law`: frozen, but for what it is judged by."""
        return dataclasses.replace(self, contact=contact)

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> Carried:
        """See `Law`."""
        under = spalls_under(spalls, distances)
        return Carried(load_curve.chosen(load_curve.power(*self.coefficients(_lengths(spalls))), under))

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """See `Law`: a contact within `ALIKE` of the one fitted."""
        code = status.worst(known_up_to(self.lengths[-1], spalls), of_one_deep_spall(spalls, distances, rest))
        if self.fitted is None or self.contact is None:
            return code
        fitted, offset = jax.lax.stop_gradient(self.fitted)
        pairs = zip(jax.tree.leaves(fitted), jax.tree.leaves(jax.lax.stop_gradient(self.contact)), strict=True)
        alike = jnp.stack([jnp.abs(now - own) <= ALIKE * own for own, now in pairs])
        moved = [jnp.abs(spall.axial_offset - offset) <= ALIKE * fitted.length for spall in spalls]
        return jnp.where(jnp.all(alike) & jnp.all(jnp.stack([jnp.asarray(True), *moved])), code, status.OTHER_SCENE)

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`: a step."""
        return jnp.zeros(()), jnp.zeros(())


@partial(jax.tree_util.register_dataclass, data_fields=["length"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Palmgren:
    """Palmgren's line contact of a whole roller between both rings, on the land that a spall leaves.

    δ = 3.84e-5 Q^0.9 / l^0.8, so n = 10/9; the spall shortens l. `length` is the roller's [mm]. Unlike the other laws
    it holds both raceways' compliance. Its error against the half-space is not known: NaN.
    """

    length: Real
    name = "palmgren"
    hard = True
    load_range = (0.0, np.inf)
    error = np.nan
    status_code = float(status.CONVERGED)

    def at(self, contact: LineContact) -> Palmgren:
        """See `Law`: frozen."""
        return self

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> Carried:
        """See `Law`."""
        n = 10.0 / 9.0
        K = gap.palmgren_approach(1.0, self.length - _lengths(spalls)) ** -n
        return Carried(load_curve.chosen(load_curve.power(K, jnp.full_like(K, n)), spalls_under(spalls, distances)))

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """See `Law`: up to 99 % of the roller."""
        return status.worst(known_up_to(0.99 * self.length, spalls), of_one_deep_spall(spalls, distances, rest))

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`: a step."""
        return jnp.zeros(()), jnp.zeros(())


@partial(jax.tree_util.register_dataclass, data_fields=["base"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Through:
    """Spalls as long as the rollers, by the healthy curve of another law: over one a roller carries nothing until it
    meets the bottom, and what a healthy one would beyond. A hard window."""

    base: Law
    hard = True

    @property
    def name(self) -> str:
        """The other law's."""
        return self.base.name

    @property
    def load_range(self) -> tuple[Real, Real]:
        """The other law's."""
        return self.base.load_range

    @property
    def error(self) -> Real:
        """The other law's."""
        return self.base.error

    @property
    def status_code(self) -> Real:
        """The other law's."""
        return self.base.status_code

    def at(self, contact: LineContact) -> Through:
        """See `Law`."""
        return Through(self.base.at(contact))

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> Carried:
        """See `Law`."""
        each = self.base.curves((), distances[:0]).each
        under = spalls_under(spalls, distances)
        depth = sum((jnp.where(under == i + 1, spall.depth, 0.0) for i, spall in enumerate(spalls)), jnp.zeros(()))
        return Carried(dataclasses.replace(each, shift=each.shift + depth))

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """See `Law`: one spall under a roller; of its bottom it knows."""
        deep = tuple(dataclasses.replace(spall, depth=jnp.inf) for spall in spalls)
        return status.worst(self.base.judge((), distances[:0], rest), of_one_deep_spall(deep, distances, rest))

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`: a step."""
        return jnp.zeros(()), jnp.zeros(())


def named(name: str, contact: LineContact, load_range: tuple[Real, Real], spall: Spall | None, accuracy: float) -> Law:
    """The law called `name`: "power" (fitted now: see `power_law`), "liu2018" or "palmgren"."""
    if name == "power":
        return power_law(contact, load_range, spall, accuracy)
    if name == "liu2018":
        return liu2018()
    if name == "palmgren":
        return Palmgren(contact.length)
    raise status.SceneError(unknown(name))


def unknown(name: str) -> str:
    """The sentence for a law that cannot be had."""
    return f"law = {shown(name)} is unknown; use one of {', '.join(NAMES)}"


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


def is_of_liu2018(bearing: TaperedBearing) -> bool:
    """Whether Table 2 is of this bearing's rollers and outer raceway, as far as is known: traced numbers are not."""
    theirs = geometry.bearing("32008J")
    return all(
        isinstance(own := getattr(bearing, name), jax.core.Tracer) or float(own) == getattr(theirs, name)
        for name in OF_CONTACT
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
    return _fit(contact, load_range, shape, accuracy, contact_solution.is_symmetric(shape))


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
    law = PowerLaw(
        jnp.asarray(lengths), intercept, slope, (low, high), 0.0, jnp.max(codes).astype(float), "power",
        (contact, shape.axial_offset),
    )  # fmt: skip
    predicted, _ = load_curve.load(load_curve.power(*law.coefficients(cases[0])), approaches)
    error = jnp.max(jnp.abs(predicted / cases[1] - 1.0))
    return dataclasses.replace(law, error=jax.lax.stop_gradient(error))


def _regress(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Intercepts and slopes of least-squares lines y over x; x of shape (m, k), y of shape (k,)."""
    x_mean = jnp.mean(x, axis=1, keepdims=True)
    y_mean = jnp.mean(y)
    slope = jnp.sum((x - x_mean) * (y - y_mean)[None, :], axis=1) / jnp.sum((x - x_mean) ** 2, axis=1)
    return y_mean - slope * x_mean[:, 0], slope
