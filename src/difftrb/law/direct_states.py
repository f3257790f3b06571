"""Law "direct" around the states of one scene: for every roller that meets spalls, contact solves near its own load.

Nothing is assumed of what is under a roller: several spalls, touching ones, a bottom that carries. Beyond the solves it
was made from the law knows nothing, and says so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import LineContact, Spall
from difftrb.core.numeric import least_squares
from difftrb.law import load_curve, roller_states, samples, tilt_energy
from difftrb.law.base import Law, Rest, of_base
from difftrb.law.direct_curves import ASIDE, MOVED, DirectByCurves
from difftrb.law.load_curve import Curve
from difftrb.law.roller_curves import NearState, RollerCurves
from difftrb.law.roller_states import CLEAR, States, as_made, is_of

SPREAD = 0.3
"""By how much in the logarithm the loads of a state's solves are spread to either side. Closer together, errors of
solves make more of the derivatives of stiffness; farther apart, the curve does."""
DEGREE = 3
"""Of a state's curve, log Q over log δ. With 2 it bends less than the load does on a ramp: stiffness is off by up to
5e-4."""
NARROWER = 0.25
"""Factor on the spread of loads where the curve bends, as it does where a bottom or an edge is just met. So close
together they tell no more than a quadratic."""
TILT_DEGREE = 2
"""Of a state's tilt over the logarithm of its load."""
NOTHING = 1e-12
"""Of a coefficient, where solves do not tell it: so that it is 0."""


Beyond = Callable[[Any], tuple[Any, Any]]
"""What the inner raceway and the flange add to approach [mm] and moment [N mm], of loads on the outer one [N]."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class DirectByStates:
    """Curves of a healthy roller and, for those that meet spalls, of each by itself.

    Attributes:
      base: the curve of a healthy roller, and the contact.
      states: of the rollers that meet spalls, of rings that tilt of all that carry; None: there are none.
      healthy_states: of rings that tilt, those without spalls.
      settling: while states are looked for, none is refused.
      free_to_tilt: whether rollers were, between both raceways.
      stays: whether the scene that it was made for ends in its states.
    """

    base: DirectByCurves
    states: States | None
    settling: bool = dataclasses.field(default=False, metadata={"static": True})
    free_to_tilt: bool = dataclasses.field(default=False, metadata={"static": True})
    healthy_states: States | None = None
    stays: bool = dataclasses.field(default=True, metadata={"static": True})
    name = "direct"
    hard = False

    contact, load_range, error, status_code = map(of_base, ("contact", "load_range", "error", "status_code"))
    kinks_by_table = of_base("kinks_by_table")

    def at(self, contact: LineContact) -> DirectByStates:
        """The law carried to another contact near by."""
        return dataclasses.replace(self, base=self.base.at(contact))

    def curves(self, spalls: tuple[Spall, ...], distances: Any) -> RollerCurves:
        """See `Law`. Other spalls than it was made for are for `judge` to refuse."""
        every = self.base.curves((), distances[:0]).each
        if self.states is None or self.states.leaning is not None or not is_of(self.states, distances):
            return RollerCurves(every)
        approaches = self._carried(self.states, self.states.approaches, self.states.slopes, spalls, distances)
        own = through(self.states.log_loads, approaches, self.states.lowest)
        at, here = self.states.at, xp.sum(self.states.at, axis=-2) > 0.0

        def chosen(of_all: Any, of_own: Any) -> Any:
            of_own = xp.einsum("...s,...sr->...r", of_own, at).reshape(*of_all.shape)
            return xp.where(xp.broadcast_to(here, of_all.shape), of_own, of_all)

        return RollerCurves(load_curve.replaced(every, chosen, own))

    def slices(
        self, spalls: tuple[Spall, ...], distances: Any, beyond: Beyond | None = None, least: Any = 0.0
    ) -> RollerCurves:
        """What every slice of the rollers carries whose rings tilt, at `tilt_energy.points`, shape (…, rollers ·
        slices), roller by roller; other arguments as of `curves`. `beyond` is what approaches [mm] and moments [N mm]
        have besides those of the outer contact, of its loads [N]. A roller without a state of its own carries the
        `least` [N]; before there are any, all are healthy, and each slice carries its share."""
        every, count = self.base.curves((), distances[:0]).each, tilt_energy.SLICES
        every = xp.tree_map(lambda field: tilt_energy.of_slices(field, count), every)
        each = dataclasses.replace(every, coefficients=_shared(every.coefficients, count))
        states = self.states
        if states is None or states.leaning is None or not is_of(states, distances):
            softer = 2.0 if self.free_to_tilt else 1.0  # two raceways, about alike
            return RollerCurves(dataclasses.replace(each, middle=each.middle + np.log(softer)))
        loads = xp.exp(states.log_loads)
        approaches, moments = self.leaning(spalls, distances)
        if beyond is not None:
            more, turned = beyond(loads)
            approaches, moments = approaches + more, moments + turned
        own = tilt_energy.fitted_slices(loads, -states.tilts, approaches, moments, xp.fixed(self.contact.length))

        def of_rollers(of_states: Any) -> Any:
            """Of every state's slices, for all rollers' slices."""
            found = xp.einsum("...sk,...sr->...rk", of_states, states.at)
            return found.reshape(*each.shift.shape[:-1], -1)

        clear = tilt_energy.of_slices(1.0 - xp.sum(states.at, axis=-2), count).reshape(each.shift.shape)
        coefficients = [of_rollers(one) for one in own.coefficients]
        coefficients[0] = coefficients[0] + clear * (least / count)
        return RollerCurves(
            each, near=NearState(xp.stack(coefficients), of_rollers(own.middle), of_rollers(own.reach) + clear)
        )

    def leaning(self, spalls: tuple[Spall, ...], distances: Any, loads: Any = None) -> tuple[Any, Any]:
        """Approaches [mm] and moments [N mm] of the solves of rollers whose rings tilt, shape (…, states, loads),
        carried to what rollers meet now and, on the inner raceway, to their `loads` [N] there; needs states."""
        states = self.states
        assert states is not None
        assert states.leaning is not None
        own = states.leaning
        approaches = self._carried(states, states.approaches, states.slopes, spalls, distances)
        moments = self._carried(states, own.moments, own.moment_slopes, spalls, distances)
        if loads is None or own.by_load is None or own.moment_by_load is None:
            return approaches, moments
        more = loads - xp.exp(states.log_loads)
        return approaches + own.by_load * more, moments + own.moment_by_load * more

    def _carried(self, states: States, solved: Any, slopes: Any, spalls: tuple[Spall, ...], distances: Any) -> Any:
        """What was `solved`, of shape (…, states, loads), carried along its `slopes` to what rollers meet now."""
        distances = as_made(states, distances)
        sizes = samples.count(len(spalls)) - len(spalls)
        alike = samples.inputs(self.contact, spalls, np.zeros(len(spalls)))[:sizes]
        there = xp.any(states.at > 0.0, axis=-1)[..., None]
        for change, by in (
            (alike[(None,) * (states.given.ndim - 1)] - states.given[..., :sizes], slopes[..., :sizes]),
            (self._apart(states, distances), slopes[..., sizes:]),
        ):
            solved = solved + xp.einsum("...kli,...ki->...kl", by, xp.where(there, change, 0.0))
        return solved

    def _apart(self, states: States, distances: Any) -> Any:
        """How far rollers have moved against the spalls since they were solved [mm], shape (…, states, spalls)."""
        away = xp.einsum("...sr,n...r->...sn", states.at, distances)
        return away - states.given[..., states.given.shape[-1] - distances.shape[0] :]

    def judge(self, spalls: tuple[Spall, ...], distances: Any, rest: Rest | None = None) -> Any:
        """See `Law`: only the scene it was made for, or its neighbours, or the same bearing without spalls."""
        if self.settling:
            return np.asarray(status.CONVERGED)
        states, other = self.states, status.OTHER_SCENE if self.stays else status.UNSETTLED
        if rest is not None and rest.rings is not None:  # an end may be pressed in where the middle is not
            rest = rest._replace(approach=rest.approach + 0.5 * self.contact.length * xp.abs(rest.rings[1]))
        code = self.base.judge((), distances[:0], self._within(rest))
        if not spalls and (states is None or states.met.shape[-1]):  # the healthy bearing, of a law made for spalls
            return code
        met = np.zeros(distances.shape, bool)
        if rest is not None and spalls:
            met = xp.stack([rest.in_reach(spall, away) for spall, away in zip(spalls, distances, strict=True)])
        if states is None:
            return xp.where(xp.any(met), other, code)
        if not is_of(states, distances):
            return np.asarray(status.OTHER_SCENE)
        distances, met = as_made(states, distances), as_made(states, met)
        moved = self._carried(states, states.approaches, states.slopes, spalls, distances) - states.approaches
        moved = moved / xp.max(xp.abs(states.approaches), axis=-1)[..., None]
        apart = self._apart(states, distances) * states.met
        same = (xp.max(xp.abs(moved)) < MOVED) & (xp.max(xp.abs(apart), initial=0.0) < ASIDE)
        same = same & roller_states.keep_spalls(states, self.contact, spalls, distances)
        if rest is not None:
            unknown = xp.moveaxis(met, 0, -2) & (xp.einsum("...sn,...sr->...nr", states.met, states.at) == 0.0)
            same = same & roller_states.keep_loads(states, self.base.log_loads[0], rest) & ~xp.any(unknown)
            if states.leaning is not None:
                raceways = 2.0 if self.free_to_tilt else 1.0  # a roller between two may turn until neither is touched
                clear = raceways * CLEAR * self.base.healthy[0]
                same = same & roller_states.keep_tilts(states, self.contact, raceways, clear, rest)
        return xp.where(same, code, other)

    def _within(self, rest: Rest | None) -> Rest | None:
        """Rollers at rest, those with states of their own within the range of the healthy curve, which they do not ask:
        one on a rim may carry far more."""
        if rest is None or self.states is None or self.states.at.size // self.states.at.shape[-2] != rest.loads.size:
            return rest
        own = xp.sum(self.states.at, axis=-2).reshape(rest.loads.shape) > 0.0
        return rest._replace(loads=xp.where(own, xp.minimum(rest.loads, self.base.load_range[1]), rest.loads))

    def roller_tilts(self, loads: Any, turned: Any = None) -> Any:
        """Tilt of every roller of the first row [rad] at its load on this raceway [N], both of shape (…, rollers), by
        those of its solves; `turned` is that of the rings, as contacts see it."""
        states = self.states
        if states is None:
            return xp.zeros_like(loads)
        at = states.at[..., : loads.shape[-1]]

        def of_states(of_rollers: Any) -> Any:
            return xp.einsum("...sr,...r->...s", at, of_rollers.reshape(*at.shape[:-2], -1))

        middle = xp.mean(states.log_loads, axis=-1)
        apart = states.log_loads - middle[..., None]
        powers, tilts = [apart**k for k in range(TILT_DEGREE + 1)], states.tilts
        here = xp.log(xp.maximum(of_states(loads), 1e-9)) - middle
        asked = [here**k for k in range(TILT_DEGREE + 1)]
        if states.leaning is not None and states.leaning.own_tilts is not None and turned is not None:
            centre, tilts = xp.mean(states.tilts, axis=-1), states.leaning.own_tilts
            size = xp.max(states.tilts, axis=-1) - centre
            beside = (states.tilts - centre[..., None]) / size[..., None]
            there = (of_states(turned) - centre) / size
            powers += [beside, beside * apart, beside**2]
            asked += [there, there * here, there**2]
        found = least_squares(xp.stack(powers, axis=-1), tilts, NOTHING)
        own = xp.einsum("...s,...sr->...r", xp.sum(found * xp.stack(asked, axis=-1), axis=-1), at)
        return own.reshape(*loads.shape)

    def ramp(self, number: int, spall: Spall, approach: Any) -> tuple[Any, Any]:
        """See `Law`: from where the edge enters a healthy contact to where it surely has left it, whatever else is
        under the roller."""
        return self.base.certain_ramp(approach + spall.rim)


def _shared(coefficients: Any, count: int) -> Any:
    """Of curves each of which carries its share of a roller's load: log Q falls by log `count`."""
    first = (np.arange(coefficients.shape[0]) == 0).reshape(-1, *[1] * (coefficients.ndim - 1))
    return coefficients - np.log(count) * first


def through(log_loads: Any, approaches: Any, lowest: Any) -> Curve:
    """log Q as polynomials in log(δ − `lowest`), nearest to each state's solves, both of shape (…, states, loads), or
    (…, states); straight beyond them."""
    x = xp.log(approaches - lowest[..., None])
    middle, reach = 0.5 * (x[..., -1] + x[..., 0]), 0.5 * (x[..., -1] - x[..., 0])
    z = (x - middle[..., None]) / reach[..., None]
    powers = [0.0 * z + 1.0, z]
    for _ in range(2, min(DEGREE, z.shape[-1] - 1) + 1):
        powers.append(powers[-1] * z)
    narrowed = 0.5 * (log_loads[..., -1] - log_loads[..., 0]) < 0.5 * (1.0 + NARROWER) * SPREAD  # see `NARROWER`
    powers[3:] = [xp.where(narrowed[..., None], 0.0, power) for power in powers[3:]]
    found = least_squares(xp.stack(powers, axis=-1), log_loads, NOTHING)
    return Curve(xp.moveaxis(found, -1, 0), middle, reach, lowest + xp.zeros_like(middle))


def without_spalls(law: Law) -> Law:
    """The law of the same bearing without spalls, of one that may hold states of rollers that meet some."""
    return dataclasses.replace(law, states=law.healthy_states) if isinstance(law, DirectByStates) else law


def at_phase(law: DirectByStates, k: int, healthy: bool) -> DirectByStates:
    """The law of a mean at the `k`-th of its phases: of the `healthy` ring, or of the one with spalls."""
    own = jax.tree.map(lambda of: of[k], law.healthy_states if healthy else law.states)
    return dataclasses.replace(law, states=own, healthy_states=own if healthy else None)


def without_states(law: Law) -> Law:
    """The law without any states: of healthy rollers, upright."""
    return dataclasses.replace(law, states=None, healthy_states=None) if isinstance(law, DirectByStates) else law
