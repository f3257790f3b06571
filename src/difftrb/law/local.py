"""The roller law around the states of one scene: for every roller that meets spalls, contact solves near its own load.

Nothing is assumed of what is under a roller: several spalls, touching ones, a bottom that carries. Beyond the solves it
was made from the law knows nothing, and says so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import series, status
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.core.numeric import chebyshev_nodes
from difftrb.law import load_curve, ramp_fit, samples
from difftrb.law.base import Law, Rest
from difftrb.law.direct import ASIDE, MOVED, DirectLaw, accuracy_at_edges
from difftrb.law.edge_ramp import RollerCurves
from difftrb.law.load_curve import Curve
from difftrb.law.roller_tilt import UPRIGHT, TiltCurve
from difftrb.law.samples import Node, Progress, Turning

if TYPE_CHECKING:
    from jaxtyping import Float

    Array = jax.Array | np.ndarray

WITHIN = 0.2
"""By how much in its logarithm a roller's load may be off the one that its contacts were solved about."""
FEW, SEARCHED = 3, 0.35
"""Solves of a state while its load is looked for, and by how much in the logarithm they are spread to either side."""
MANY, SPREAD = 9, 0.3
"""The same once it is found. Closer together, errors of solves make more of the derivatives of stiffness; farther
apart, the curve does."""
DEGREE = 3
"""Of a state's curve, log Q over log δ. With 2 it bends less than the load does on a ramp: stiffness is off by up to
5e-4."""
NARROWER = 0.25
"""Factor on the spread of loads where the curve bends, as it does where a bottom or an edge is just met. So close
together they tell no more than a quadratic."""
BENDS = 5e-4
"""Residual of a state's curve, in the logarithm of the load, above which it counts as bent."""
TILT_DEGREE = 2
"""Of a state's tilt over the logarithm of its load."""
TOGETHER = 4
"""States are filled up to a multiple of this: every number of them would be a program of its own."""

NOTHING = 1e-12
"""Of a coefficient, where solves do not tell it: so that it is 0."""


class Reached(NamedTuple):
    """Spalls that one roller may meet on a raceway: the roller, which spalls, how far from them it is [mm], and how
    many rollers there are."""

    roller: int
    under: tuple[int, ...]
    away: tuple[float, ...]
    rollers: int


class States(NamedTuple):
    """Rollers that meet spalls, or tilt by those on the other raceway, one behind the other along the first axis of
    every field.

    Attributes:
      at: which roller each is: a one among zeros; zeros alone where a row only fills up.
      met: which spalls are in its reach: ones in zeros.
      log_loads: of its solves [log N]. approaches: [mm].
      given: `samples.inputs` of the contact, all spalls, and its distances from them, as solved.
      slopes: of the approaches by these, the tilt held; 0 by spalls out of reach.
      tilts: of the roller in its solves, as this raceway sees it [rad].
    """

    at: Float[Array, "states rollers"]
    met: Float[Array, "states spalls"]
    log_loads: Float[Array, "states loads"]
    approaches: Float[Array, "states loads"]
    given: Float[Array, "states inputs"]
    slopes: Float[Array, "states loads inputs"]
    tilts: Float[Array, "states loads"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LocalLaw:
    """Curves of a healthy roller and, for those that meet spalls, of each by itself.

    Attributes:
      base: the curve of a healthy roller, and the contact.
      states: of the rollers that meet spalls; None: none does.
      settling: while states are looked for, none is refused.
      free_to_tilt: whether rollers were, between both raceways.
    """

    base: DirectLaw
    states: States | None
    settling: bool = dataclasses.field(default=False, metadata={"static": True})
    free_to_tilt: bool = dataclasses.field(default=False, metadata={"static": True})
    name = "direct"
    hard = False
    expands = True

    @property
    def contact(self) -> LineContact:
        """The roller's with this raceway, as it is now."""
        return self.base.contact

    @property
    def load_range(self) -> tuple[Real, Real]:
        """Smallest and largest load of the solves [N]."""
        return self.base.load_range

    @property
    def error(self) -> Real:
        """Of the contact solves [-], as asked for."""
        return self.base.error

    @property
    def status_code(self) -> Real:
        """Worst of all solves."""
        return self.base.status_code

    def at(self, contact: LineContact) -> LocalLaw:
        """The law carried to another contact near by."""
        return dataclasses.replace(self, base=self.base.at(contact))

    def curves(self, spalls: tuple[Spall, ...], distances: Any) -> RollerCurves:
        """See `Law`, of one phase. Other spalls than it was made for are for `judge` to refuse."""
        every = self.base.curves((), distances[:0]).each
        if self.states is None or self.states.met.shape[1] != len(spalls):
            return RollerCurves(every)
        own = through(self.states.log_loads, self._approaches(self.states, spalls, _of_one_phase(distances)))
        missing = every.coefficients.shape[0] - own.coefficients.shape[0]
        more = np.zeros((missing, own.coefficients.shape[1]))
        own = dataclasses.replace(own, coefficients=xp.concatenate([own.coefficients, more]))
        at, here = self.states.at, xp.sum(self.states.at, axis=0) > 0.0

        def chosen(of_all: Any, of_own: Any) -> Any:
            of_own = xp.einsum("...s,sr->...r", of_own, at).reshape(*of_all.shape)
            return xp.where(xp.broadcast_to(here.reshape(*[1] * (of_all.ndim - 1), -1), of_all.shape), of_own, of_all)

        return RollerCurves(xp.tree_map(chosen, every, own))

    def _approaches(self, states: States, spalls: tuple[Spall, ...], distances: Any) -> Any:
        """Of the solves, carried to what rollers meet now [mm], shape (states, loads)."""
        sizes = samples.count(len(spalls)) - len(spalls)
        alike = samples.inputs(self.contact, spalls, np.zeros(len(spalls)))[:sizes]
        away = xp.einsum("sr,nr->sn", states.at, distances)
        moved = xp.concatenate(
            [alike[None] - states.given[:, :sizes], away - states.given[:, sizes:]], axis=-1
        )  # fmt: skip
        change = xp.where(xp.any(states.at > 0.0, axis=1)[:, None], moved, 0.0)
        return states.approaches + xp.einsum("kli,ki->kl", states.slopes, change)

    def judge(self, spalls: tuple[Spall, ...], distances: Any, rest: Rest | None = None) -> Any:
        """See `Law`: only the scene it was made for, or its neighbours, or the same bearing without spalls."""
        if self.settling:
            return np.asarray(status.CONVERGED)
        code, states = self.base.judge((), distances[:0], rest), self.states
        if not spalls and (states is None or states.met.shape[1]):  # the healthy bearing, of a law made for spalls
            return code
        distances, met = _of_one_phase(distances), np.zeros((len(spalls), distances.shape[-1]), bool)
        if rest is not None:
            rest = rest._replace(approach=rest.approach.reshape(-1), loads=rest.loads.reshape(-1))
            if spalls:
                met = xp.stack([rest.in_reach(spall, away) for spall, away in zip(spalls, distances, strict=True)])
        if states is None:
            return xp.where(xp.any(met), status.OTHER_SCENE, code)
        if states.met.shape[1] != len(spalls):
            return np.asarray(status.OTHER_SCENE)
        moved = self._approaches(states, spalls, distances) / states.approaches - 1.0
        first = states.given.shape[1] - len(spalls)
        apart = (xp.einsum("sr,nr->sn", states.at, distances) - states.given[:, first:]) * states.met
        same = (xp.max(xp.abs(moved)) < MOVED) & (xp.max(xp.abs(apart), initial=0.0) < ASIDE)
        if rest is not None:
            load = xp.maximum(xp.einsum("sr,r->s", states.at, rest.loads), xp.exp(self.base.log_loads[0]))
            off = xp.abs(xp.log(load) - xp.mean(states.log_loads, axis=1)) * xp.max(states.at, axis=1)
            unknown = met & (xp.einsum("sn,sr->nr", states.met, states.at) == 0.0)
            same = same & (xp.max(off) < WITHIN) & ~xp.any(unknown)
        return xp.where(same, code, status.OTHER_SCENE)

    def roller_tilts(self, loads: Any) -> Any:
        """Tilt of every roller of the first row [rad] at its load on this raceway [N], both of shape (rollers,), by
        those of its solves."""
        states = self.states
        if states is None:
            return xp.zeros_like(loads)
        at = states.at[:, : loads.shape[0]]
        middle = xp.mean(states.log_loads, axis=1)
        apart = states.log_loads - middle[:, None]
        powers = xp.stack([apart**k for k in range(TILT_DEGREE + 1)], axis=-1)
        found = ramp_fit.least_squares(powers, states.tilts, NOTHING)
        here = xp.log(xp.maximum(xp.einsum("sr,r->s", at, loads), 1e-9)) - middle
        return xp.einsum("s,sr->r", series.polynomial(xp.moved_last(found), here), at)

    def ramp(self, number: int, spall: Spall, approach: Any) -> tuple[Any, Any]:
        """See `Law`: not known, for there is no mean over phases."""
        return xp.zeros_like(approach), xp.zeros_like(approach)


def _of_one_phase(distances: Any) -> Any:
    """Without the axis that it may have for phases, shape (spalls, rollers)."""
    return distances.reshape(distances.shape[0], distances.shape[-1])


def through(log_loads: Any, approaches: Any) -> Curve:
    """log Q as polynomials in log δ, nearest to each state's solves, both of shape (states, loads); straight beyond
    them."""
    x = xp.log(approaches)
    middle, reach = 0.5 * (x[:, -1] + x[:, 0]), 0.5 * (x[:, -1] - x[:, 0])
    z = (x - middle[:, None]) / reach[:, None]
    powers = [0.0 * z + 1.0, z]
    for _ in range(2, min(DEGREE, z.shape[1] - 1) + 1):
        powers.append(powers[-1] * z)
    narrowed = 0.5 * (log_loads[:, -1] - log_loads[:, 0]) < 0.5 * (1.0 + NARROWER) * SPREAD  # see `NARROWER`
    powers[3:] = [xp.where(narrowed[:, None], 0.0, power) for power in powers[3:]]
    found = ramp_fit.least_squares(xp.stack(powers, axis=-1), log_loads, NOTHING)
    return Curve(xp.moved_last(found), middle, reach, xp.zeros_like(middle))


def around(
    base: DirectLaw, spalls: tuple[Spall, ...], reached: Sequence[Reached], loads: np.ndarray, found: bool,
    tilts: Sequence[TiltCurve] | None = None, progress: Progress | None = None,
) -> LocalLaw:  # fmt: skip
    """The law of rollers that carry about `loads` [N], shape (rollers reached,), from that of healthy ones.

    Contacts are solved around these loads: few and far apart while the loads are looked for, more once they are
    `found`. `tilts` are of every roller reached; None: all are held upright. Needs numbers, not tracers. What comes out
    is `settling`: it refuses nothing.
    """
    spread, way = spread_of(found)
    logs = np.log(loads)[:, None] + spread * way
    curves = [UPRIGHT] * len(reached) if tilts is None else tilts
    solved = _solved(base, spalls, reached, logs, curves, progress)
    for k, own in enumerate(solved):
        if found and (_bend(logs[k], own) > BENDS or _touches_at_some(own, len(reached[k].under))):
            logs[k] = np.log(loads[k]) + NARROWER * spread * way
            of = slice(k, k + 1)
            (solved[k],) = _solved(base, spalls, reached[of], logs[of], curves[of], progress)
    code = max(float(base.status_code), samples.worst_status([node for own in solved for node in own]))
    states = _stacked(base, spalls, reached, logs, solved, curves) if reached else None
    return LocalLaw(dataclasses.replace(base, status_code=code), states, settling=True, free_to_tilt=tilts is not None)


def spread_of(found: bool, count: int | None = None) -> tuple[float, np.ndarray]:
    """By how much in their logarithm the loads of one roller's solves are spread to either side, and where between −1
    and 1 they stand; `count` of them, default as many as `around` solves."""
    own, spread = (MANY, SPREAD) if found else (FEW, SEARCHED)
    return spread, np.asarray(chebyshev_nodes(own if count is None else count, -1.0, 1.0))


def healthy(law: Law) -> Law:
    """The law of the same bearing without spalls, of one that may hold states of rollers that meet some."""
    return dataclasses.replace(law, states=None) if isinstance(law, LocalLaw) else law


def _solved(
    base: DirectLaw, spalls: tuple[Spall, ...], reached: Sequence[Reached], log_loads: np.ndarray,
    tilts: Sequence[TiltCurve], progress: Progress | None,
) -> list[list[Node]]:  # fmt: skip
    """Contacts of every roller reached at its `log_loads` [log N], shape (rollers reached, loads)."""
    cases = [
        samples.case_under(load, [spalls[i] for i in each.under], each.away)._replace(tilt=float(tilt))
        for each, row, curve in zip(reached, log_loads, tilts, strict=True)
        for load, tilt in zip(np.exp(row), curve.tilt(row), strict=True)
    ]
    solve = samples.all_turning if any(curve is not UPRIGHT for curve in tilts) else samples.all_solved
    solved = solve(base.contact, cases, accuracy_at_edges(float(base.error)), progress)
    count = log_loads.shape[1]
    return [solved[k : k + count] for k in range(0, len(solved), count)]


def _slopes(solved: Sequence[Node], log_loads: np.ndarray, curve: TiltCurve, inputs: int) -> np.ndarray:
    """Of one roller's approaches, by as many inputs, shape (loads, inputs), with what its tilt makes of them."""
    slopes = np.array([node.slopes[:inputs] for node in solved])
    if curve is UPRIGHT:
        return slopes
    moments = np.array([cast(Turning, node.turning).moment_slopes[:inputs] for node in solved])
    return slopes + curve.gain(log_loads)[:, None] * moments


def _bend(log_loads: np.ndarray, solved: Sequence[Node]) -> float:
    """How far solves are from the curve nearest to them, at most, in log Q."""
    approaches = np.array([[node.approach for node in solved]])
    found, _ = load_curve.load(through(log_loads[None], approaches), approaches.T)
    return float(np.max(np.abs(np.log(found[:, 0]) - log_loads)))


def _touches_at_some(solved: Sequence[Node], spalls: int) -> bool:
    """Whether an edge of the spalls is in the contact at some of the loads, and at others not: there is a kink."""
    by_away = np.array([node.slopes[samples.count(spalls) - spalls : samples.count(spalls)] for node in solved])
    touches = by_away != 0.0
    return bool(np.any(np.any(touches, axis=0) & ~np.all(touches, axis=0)))


def _stacked(
    base: DirectLaw, spalls: tuple[Spall, ...], reached: Sequence[Reached], logs: np.ndarray,
    solved: Sequence[Sequence[Node]], tilts: Sequence[TiltCurve],
) -> States:  # fmt: skip
    """All that was solved; filled up to a multiple of `TOGETHER` states, so that scenes share programs."""
    count = len(spalls)
    slopes = np.zeros((len(reached), logs.shape[1], samples.count(count)))
    given, met = np.zeros((len(reached), slopes.shape[2])), np.zeros((len(reached), count))
    for k, (each, own) in enumerate(zip(reached, solved, strict=True)):
        under = list(each.under)
        met[k, under] = 1.0
        inputs = samples.count(len(under))  # those of a healthy contact name a spall of no size, too
        slopes[k][:, samples.places(under, count)] = _slopes(own, logs[k], tilts[k], inputs)
        away = np.zeros(count)
        away[under] = each.away
        given[k] = samples.inputs(base.contact, spalls, away)
    at = np.zeros((len(reached), reached[0].rollers))
    at[np.arange(len(reached)), [each.roller for each in reached]] = 1.0
    approaches = np.array([[node.approach for node in own] for own in solved])
    more = -len(reached) % TOGETHER
    leaning = np.array([curve.tilt(row) for curve, row in zip(tilts, logs, strict=True)])
    filled = [np.concatenate([field, np.repeat(field[:1], more, axis=0)])
              for field in (met, logs, approaches, given, slopes, leaning)]  # fmt: skip
    at = np.concatenate([at, np.zeros((more, at.shape[1]))])
    filled[0][len(reached) :] = 0.0
    return States(at, *filled)
