"""The roller law around the states of one scene: for every roller that meets spalls, contact solves near its own load.

Nothing is assumed of what is under a roller: several spalls, touching ones, a bottom that carries. Beyond the solves it
was made from the law knows nothing, and says so.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb import curve, nodes, status
from difftrb.curve import Curve
from difftrb.direct import ASIDE, MOVED, DirectLaw
from difftrb.geometry import LineContact, Real, Spall
from difftrb.law import Rest
from difftrb.ramp import Carried

WITHIN = 0.2
"""By how much in its logarithm a roller's load may be off the one that its contacts were solved about."""


class State(NamedTuple):
    """What one roller meets.

    Attributes:
      log_loads: of its solves [log N], shape (loads,). approaches: [mm], shape (loads,).
      given: `nodes.inputs` of the contact, the spalls in reach and the distances from them, as solved, shape (inputs,).
      slopes: of the approaches by these, shape (loads, inputs).
    """

    log_loads: jax.Array
    approaches: jax.Array
    given: jax.Array
    slopes: jax.Array


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["base", "states"],
    meta_fields=["rollers", "under", "spalls", "settling"],
)
@dataclasses.dataclass(frozen=True)
class LocalLaw:
    """Curves of a healthy roller and, for those that meet spalls, of each by itself.

    Attributes:
      base: the curve of a healthy roller, and the contact.
      states: of the rollers that meet spalls.
      rollers: which they are. under: which spalls each of them meets. spalls: how many there are.
      settling: while states are looked for, none is refused.
    """

    base: DirectLaw
    states: tuple[State, ...]
    rollers: tuple[int, ...]
    under: tuple[tuple[int, ...], ...]
    spalls: int
    settling: bool = False
    name = "direct"
    hard = False

    @property
    def contact(self) -> LineContact:
        """Now."""
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

    @property
    def contacts(self) -> int:
        """How many were solved."""
        return self.base.contacts + sum(state.log_loads.size for state in self.states)

    def at(self, contact: LineContact) -> LocalLaw:
        """The law carried to another contact near by."""
        return dataclasses.replace(self, base=self.base.at(contact))

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> Carried:
        """See `Law`."""
        healthy = curve.of(self.base.curves((), distances[:0]).each, 0)
        own = [self._own(k, spalls, distances) for k in range(len(self.states) if spalls else 0)]
        fields = []
        for name in ("coefficients", "middle", "reach", "shift"):
            every = jnp.repeat(getattr(healthy, name)[..., None], distances.shape[1], axis=-1)
            for roller, each in zip(self.rollers, own, strict=False):
                value = getattr(each, name)
                missing = [(0, every.shape[0] - value.shape[0])] if value.ndim else []
                every = every.at[..., roller].set(jnp.pad(value, missing) if missing else value)
            fields.append(every)
        return Carried(Curve(*fields))

    def _approaches(self, k: int, spalls: tuple[Spall, ...], distances: jax.Array) -> jax.Array:
        """Of a state's solves, carried to what the roller meets now [mm]."""
        state, under = self.states[k], self.under[k]
        away = [distances[i, self.rollers[k]] for i in under]
        now = nodes.inputs(self.contact, tuple(spalls[i] for i in under), jnp.stack(away))
        return state.approaches + state.slopes @ (now - state.given)

    def _own(self, k: int, spalls: tuple[Spall, ...], distances: jax.Array) -> Curve:
        return through(self.states[k].log_loads, self._approaches(k, spalls, distances))

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """See `Law`: only the scene it was made for, or its neighbours, or the same bearing without spalls."""
        if self.settling:
            return jnp.asarray(status.CONVERGED)
        if len(spalls) not in (0, self.spalls):
            return jnp.asarray(status.OTHER_SCENE)
        code = self.base.judge((), distances[:0], rest)
        if not spalls:
            return code
        same = jnp.asarray(True)
        for k, (state, under) in enumerate(zip(self.states, self.under, strict=True)):
            moved = self._approaches(k, spalls, distances) / state.approaches - 1.0
            apart = jnp.stack([distances[i, self.rollers[k]] for i in under]) - state.given[-len(under) :]
            same = same & (jnp.max(jnp.abs(moved)) < MOVED) & (jnp.max(jnp.abs(apart)) < ASIDE)
            if rest is not None:
                load = jnp.maximum(rest.loads[self.rollers[k]], jnp.exp(self.base.log_loads[0]))
                same = same & (jnp.abs(jnp.log(load) - jnp.mean(state.log_loads)) < WITHIN)
        if rest is not None:  # no other roller meets a spall
            known = np.zeros((len(spalls), distances.shape[1]), bool)
            for roller, under in zip(self.rollers, self.under, strict=True):
                known[list(under), roller] = True
            met = jnp.stack([rest.in_reach(spall, away) for spall, away in zip(spalls, distances, strict=True)])
            same = same & ~jnp.any(met & ~known)
        return jnp.where(same, code, status.OTHER_SCENE)

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`: not known, for there is no mean over phases."""
        return jnp.zeros(()), jnp.zeros(())


def through(log_loads: jax.Array, approaches: jax.Array) -> Curve:
    """log Q as a quadratic in log δ, nearest to a state's solves; straight beyond them."""
    x = jnp.log(approaches)
    middle, reach = 0.5 * (x[-1] + x[0]), 0.5 * (x[-1] - x[0])
    z = (x - middle) / reach
    powers = jnp.stack([jnp.ones_like(z), z, z * z], axis=1)
    product = partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST)
    coefficients = jnp.linalg.solve(product(powers.T, powers), product(powers.T, log_loads))
    return Curve(coefficients, middle, reach, jnp.zeros(()))
