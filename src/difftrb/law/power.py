"""Power laws Q = K δⁿ with a pair (K, n) for every length of the spall underneath: fitted, printed, and Palmgren's."""

from __future__ import annotations

import dataclasses
from dataclasses import field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import contact_solution, gap
from difftrb.contact import solver as contacts
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.core.jax_config import jit_quickly
from difftrb.law import base, load_curve, roller_curves
from difftrb.law.base import HardWindow, Law, LawKind, Request, Rest, of_base
from difftrb.law.roller_curves import RollerCurves

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
LENGTH_NODES = 7
LOAD_NODES = 9
ALIKE = 0.05
"""Relative difference at which a contact is another than the fitted one: loads then change by about a hundredth, which
is less than the error of a power law."""
PALMGREN_SHARE = 0.99
"""Palmgren's law covers spalls up to this share of the roller's length."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PowerLaw(HardWindow):
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
    name: str = field(metadata={"static": True})
    fitted: tuple[LineContact, Real] | None = None
    contact: LineContact | None = None

    def coefficients(self, spall_length: Any) -> tuple[Any, Any]:
        """K [N/mmⁿ] and n for spalls of `spall_length` [mm], shape (n,), up to the longest node."""
        at = load_curve.weights(self.lengths, spall_length)
        K, n = (xp.einsum("...m,m->...", at, nodes) for nodes in (self.log_stiffness, self.exponent))
        return xp.exp(K), n

    def at(self, contact: LineContact) -> PowerLaw:
        """See `Law`: frozen; the contact is only judged."""
        return dataclasses.replace(self, contact=contact)

    def curves(self, spalls: tuple[Spall, ...], distances: Any) -> RollerCurves:
        """See `Law`."""
        return base.in_window(load_curve.power(*self.coefficients(base.lengths_of(spalls))), spalls, distances)

    def judge(self, spalls: tuple[Spall, ...], distances: Any, rest: Rest | None = None) -> Any:
        """See `Law`: a contact within `ALIKE` of the one fitted."""
        code = status.worst(base.known_up_to(self.lengths[-1], spalls), base.of_one_deep_spall(spalls, distances, rest))
        if self.fitted is None or self.contact is None:
            return code
        (fitted, offset), contact = xp.fixed((self.fitted, self.contact))
        pairs = zip(jax.tree.leaves(fitted), jax.tree.leaves(contact), strict=True)
        alike = np.asarray(True)
        for own, now in pairs:
            alike = alike & (xp.magnitude(now - own) <= ALIKE * own)
        for spall in spalls:
            alike = alike & (xp.magnitude(spall.axial_offset - offset) <= ALIKE * fitted.length)
        return xp.where(alike, code, status.OTHER_SCENE)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Palmgren(HardWindow):
    """Palmgren's line contact of a roller and one raceway, on the land that a spall leaves.

    δ = 3.84e-5 Q^0.9 / l^0.8, so n = 10/9; the spall shortens l. `length` is the roller's [mm]. It knows no crown:
    a 32008J under 9000/4500 N is a third stiffer by it than by contact solves. Its error against the half-space is not
    known: NaN.
    """

    length: Real
    name = "palmgren"
    load_range = (0.0, np.inf)
    error = np.nan
    status_code = float(status.CONVERGED)

    def at(self, contact: LineContact) -> Palmgren:
        """See `Law`: frozen."""
        return self

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> RollerCurves:
        """See `Law`."""
        K = gap.palmgren_approach(1.0, self.length - base.lengths_of(spalls)) ** -gap.LOAD_EXPONENT
        return base.in_window(load_curve.power(K, gap.LOAD_EXPONENT * xp.ones_like(K)), spalls, distances)

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """See `Law`: up to 99 % of the roller."""
        longest = PALMGREN_SHARE * self.length
        return status.worst(base.known_up_to(longest, spalls), base.of_one_deep_spall(spalls, distances, rest))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class AllThrough(HardWindow):
    """Spalls as long as the rollers, by the healthy curve of another law: over one a roller carries nothing until it
    meets the bottom, and beyond that what a healthy one would."""

    base: Law

    name, load_range, error, status_code = map(of_base, ("name", "load_range", "error", "status_code"))

    def at(self, contact: LineContact) -> AllThrough:
        """See `Law`."""
        return AllThrough(self.base.at(contact))

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> RollerCurves:
        """See `Law`."""
        each = self.base.curves((), distances[:0]).each
        under = roller_curves.spalls_under(spalls, distances)
        depth = sum((xp.where(under == i + 1, spall.depth, 0.0) for i, spall in enumerate(spalls)), 0.0)
        return RollerCurves(dataclasses.replace(each, shift=each.shift + depth))

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """See `Law`: one spall under a roller, whose bottom it knows."""
        deep = tuple(dataclasses.replace(spall, depth=np.inf) for spall in spalls)
        return status.worst(self.base.judge((), distances[:0], rest), base.of_one_deep_spall(deep, distances, rest))


def liu2018() -> PowerLaw:
    """Table 2 of Liu et al. 2018 as printed: 32008J's outer raceway, spalls of 0…8 mm.

    The table does not give its load range; 1.5…10 kN is the range for which its errors come out again. It is softer
    than the half-space: its authors' solution domain cut the contact off. Use it to compare with the paper.
    """
    lengths, stiffness, exponent, error = TABLE_2.T
    return PowerLaw(
        lengths=jnp.asarray(lengths.copy()),
        log_stiffness=jnp.asarray(np.log(stiffness)),
        exponent=jnp.asarray(exponent.copy()),
        load_range=(1500.0, 10000.0),
        error=float(error.max()),
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
    return _fit(contact, load_range, shape, accuracy, contact_solution.is_symmetric(shape))


@jit_quickly(static_argnames=("accuracy", "mirrored"))
def _fit(
    contact: LineContact, load_range: tuple[Real, Real], shape: Spall, accuracy: float, mirrored: bool
) -> PowerLaw:
    if mirrored:
        shape = dataclasses.replace(shape, axial_offset=0.0)
    angle = np.pi * (np.arange(LENGTH_NODES) / (LENGTH_NODES - 1))
    lengths = 0.5 * base.LENGTH_SHARE * contact.length * (1.0 - np.cos(angle))  # Chebyshev–Lobatto nodes
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


def _fitted_for(request: Request) -> PowerLaw:
    """From a sixth of the largest roller load to be expected in the lightest loaded scene to 1.2 times this scene's."""
    spall = request.spalls[0] if request.spalls else None
    return power_law(request.contact, (request.least / 6.0, 1.2 * request.largest), spall, request.accuracy)


base.register(
    LawKind(
        "palmgren",
        "Palmgren's line contact of one raceway, without crown, on the land that a spall leaves",
        make=lambda request: Palmgren(request.contact.length),
        of_all_loads=True,
        longest=lambda roller_length: PALMGREN_SHARE * roller_length,
    )
)
base.register(
    LawKind(
        "power",
        "Q = K δⁿ fitted to contact solves of this roller",
        make=_fitted_for,
        solves=True,
        inner=True,
        frozen=("width", "depth", "axial_offset"),
        one_shape="law = 'power' is fitted for spalls of one width, depth and axial offset; make them equal, use "
        "another law, or give the scene a law prepared with power_law",
    )
)
base.register(
    LawKind(
        "liu2018",
        "Q = K δⁿ as printed in Table 2 of Liu et al. 2018",
        make=lambda request: liu2018(),
        of_all_loads=True,
        longest=lambda roller_length: float(TABLE_2[-1, 0]),
        bearing="32008J",
        promises=False,  # told by contacts that were cut off
    )
)
