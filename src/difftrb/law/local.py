"""The roller law around the states of one scene: for every roller that meets spalls, contact solves near its own load.

Nothing is assumed of what is under a roller: several spalls, touching ones, a bottom that carries. Beyond the solves it
was made from the law knows nothing, and says so.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import series, status
from difftrb.core.geometry import LineContact, Spall
from difftrb.law import ramp_fit, samples
from difftrb.law.base import Law, Rest, of_base
from difftrb.law.direct import ASIDE, MOVED, DirectLaw
from difftrb.law.edge_ramp import RollerCurves
from difftrb.law.load_curve import Curve

if TYPE_CHECKING:
    from jaxtyping import Float

    Array = jax.Array | np.ndarray

WITHIN = 0.2
"""By how much in its logarithm a roller's load may be off the one that its contacts were solved about."""
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


class States(NamedTuple):
    """Rollers that meet spalls, or tilt by those on the other raceway, one behind the other along one axis of every
    field. In the mean the cage's phases are an axis in front of it.

    Attributes:
      at: which roller each is: a one among zeros; zeros alone where a row only fills up.
      met: which spalls are in its reach: ones in zeros.
      log_loads: of its solves [log N]. approaches: [mm].
      given: `samples.inputs` of the contact, all spalls, and its distances from them, as solved.
      slopes: of the approaches by these, the tilt held; 0 by spalls out of reach.
      tilts: of the roller in its solves, as this raceway sees it [rad].
      lowest: approaches below which rollers carry nothing [mm]: a rim may press before the raceway.
    """

    at: Float[Array, "*phases states rollers"]
    met: Float[Array, "*phases states spalls"]
    log_loads: Float[Array, "*phases states loads"]
    approaches: Float[Array, "*phases states loads"]
    given: Float[Array, "*phases states inputs"]
    slopes: Float[Array, "*phases states loads inputs"]
    tilts: Float[Array, "*phases states loads"]
    lowest: Float[Array, "*phases states"]


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

    contact, load_range, error, status_code = map(of_base, ("contact", "load_range", "error", "status_code"))

    def at(self, contact: LineContact) -> LocalLaw:
        """The law carried to another contact near by."""
        return dataclasses.replace(self, base=self.base.at(contact))

    def curves(self, spalls: tuple[Spall, ...], distances: Any) -> RollerCurves:
        """See `Law`. Other spalls than it was made for are for `judge` to refuse."""
        every = self.base.curves((), distances[:0]).each
        if self.states is None or not _is_of(self.states, distances):
            return RollerCurves(every)
        approaches = self._approaches(self.states, spalls, _as_made(self.states, distances))
        own = through(self.states.log_loads, approaches, self.states.lowest)
        missing = every.coefficients.shape[0] - own.coefficients.shape[0]
        more = np.zeros((missing, *own.coefficients.shape[1:]))
        own = dataclasses.replace(own, coefficients=xp.concatenate([own.coefficients, more]))
        at, here = self.states.at, xp.sum(self.states.at, axis=-2) > 0.0

        def chosen(of_all: Any, of_own: Any) -> Any:
            of_own = xp.einsum("...s,...sr->...r", of_own, at).reshape(*of_all.shape)
            return xp.where(xp.broadcast_to(here, of_all.shape), of_own, of_all)

        return RollerCurves(xp.tree_map(chosen, every, own))

    def _approaches(self, states: States, spalls: tuple[Spall, ...], distances: Any) -> Any:
        """Of the solves, carried to what rollers meet now [mm], shape (…, states, loads)."""
        sizes = samples.count(len(spalls)) - len(spalls)
        alike = samples.inputs(self.contact, spalls, np.zeros(len(spalls)))[:sizes]
        there = xp.any(states.at > 0.0, axis=-1)[..., None]
        moved = states.approaches
        for change, slopes in (
            (alike[(None,) * (states.given.ndim - 1)] - states.given[..., :sizes], states.slopes[..., :sizes]),
            (self._apart(states, distances), states.slopes[..., sizes:]),
        ):
            moved = moved + xp.einsum("...kli,...ki->...kl", slopes, xp.where(there, change, 0.0))
        return moved

    def _apart(self, states: States, distances: Any) -> Any:
        """How far rollers have moved against the spalls since they were solved [mm], shape (…, states, spalls)."""
        away = xp.einsum("...sr,n...r->...sn", states.at, distances)
        return away - states.given[..., states.given.shape[-1] - distances.shape[0] :]

    def judge(self, spalls: tuple[Spall, ...], distances: Any, rest: Rest | None = None) -> Any:
        """See `Law`: only the scene it was made for, or its neighbours, or the same bearing without spalls."""
        if self.settling:
            return np.asarray(status.CONVERGED)
        states = self.states
        code = self.base.judge((), distances[:0], self._within(rest))
        if not spalls and (states is None or states.met.shape[-1]):  # the healthy bearing, of a law made for spalls
            return code
        met = np.zeros(distances.shape, bool)
        if rest is not None and spalls:
            met = xp.stack([rest.in_reach(spall, away) for spall, away in zip(spalls, distances, strict=True)])
        if states is None:
            return xp.where(xp.any(met), status.OTHER_SCENE, code)
        if not _is_of(states, distances):
            return np.asarray(status.OTHER_SCENE)
        distances, met = _as_made(states, distances), _as_made(states, met)
        moved = self._approaches(states, spalls, distances) / states.approaches - 1.0
        apart = self._apart(states, distances) * states.met
        same = (xp.max(xp.abs(moved)) < MOVED) & (xp.max(xp.abs(apart), initial=0.0) < ASIDE)
        if rest is not None:
            load = xp.einsum("...sr,...r->...s", states.at, rest.loads.reshape(*states.at.shape[:-2], -1))
            load = xp.maximum(load, xp.exp(self.base.log_loads[0]))
            off = xp.abs(xp.log(load) - xp.mean(states.log_loads, axis=-1)) * xp.max(states.at, axis=-1)
            unknown = xp.moveaxis(met, 0, -2) & (xp.einsum("...sn,...sr->...nr", states.met, states.at) == 0.0)
            same = same & (xp.max(off) < WITHIN) & ~xp.any(unknown)
        return xp.where(same, code, status.OTHER_SCENE)

    def _within(self, rest: Rest | None) -> Rest | None:
        """Rollers at rest, those with states of their own within the range of the healthy curve, which they do not ask:
        one on a rim may carry far more."""
        if rest is None or self.states is None or self.states.at.size // self.states.at.shape[-2] != rest.loads.size:
            return rest
        own = xp.sum(self.states.at, axis=-2).reshape(rest.loads.shape) > 0.0
        return rest._replace(loads=xp.where(own, xp.minimum(rest.loads, self.base.load_range[1]), rest.loads))

    def roller_tilts(self, loads: Any) -> Any:
        """Tilt of every roller of the first row [rad] at its load on this raceway [N], both of shape (…, rollers), by
        those of its solves."""
        states = self.states
        if states is None:
            return xp.zeros_like(loads)
        at = states.at[..., : loads.shape[-1]]
        middle = xp.mean(states.log_loads, axis=-1)
        apart = states.log_loads - middle[..., None]
        powers = xp.stack([apart**k for k in range(TILT_DEGREE + 1)], axis=-1)
        found = ramp_fit.least_squares(powers, states.tilts, NOTHING)
        here = xp.log(xp.maximum(xp.einsum("...sr,...r->...s", at, loads), 1e-9)) - middle
        return xp.einsum("...s,...sr->...r", series.polynomial(xp.moveaxis(found, -1, 0), here), at)

    def ramp(self, number: int, spall: Spall, approach: Any) -> tuple[Any, Any]:
        """See `Law`: from where the edge enters a healthy contact to where it surely has left it, whatever else is
        under the roller."""
        return self.base.certain_ramp(approach + spall.rim)


def _is_of(states: States, distances: Any) -> bool:
    """Whether states were made for so many spalls, and for so many phases: one stands for all phases that there are."""
    phases = [n for n in distances.shape[1:-1] if n != 1]
    return states.met.shape[-1] == distances.shape[0] and list(states.met.shape[:-2]) == phases


def _as_made(states: States, of_rollers: Any) -> Any:
    """What all rollers have against all spalls, shape (spalls, …, rollers), with phases as the states have them."""
    return of_rollers.reshape(of_rollers.shape[0], *states.at.shape[:-2], of_rollers.shape[-1])


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
    found = ramp_fit.least_squares(xp.stack(powers, axis=-1), log_loads, NOTHING)
    return Curve(xp.moveaxis(found, -1, 0), middle, reach, lowest + xp.zeros_like(middle))


def healthy(law: Law) -> Law:
    """The law of the same bearing without spalls, of one that may hold states of rollers that meet some."""
    return dataclasses.replace(law, states=None) if isinstance(law, LocalLaw) else law
