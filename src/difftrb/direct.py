"""The roller law with nothing in between: contact solves for exactly the states that a scene's rollers are in."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from difftrb import curve, nodes, status
from difftrb import gap as gaps
from difftrb.curve import Curve
from difftrb.geometry import LineContact, Real, Spall, as_floats
from difftrb.nodes import Case, Progress

LOADS = 12
"""Contact solves of one curve: enough for 1e-4 over three decades of load."""
DECADES = 3.0
WINDOW, ABOVE = 2.3, 0.8
"""Of a curve that an edge bends: how far it reaches, and how far above the load that is expected [log N]."""
MARGIN = 1.3
MOVED = 0.05
"""By how much of itself an approach may be carried along its slopes before a prepared law calls the scene another."""
ASIDE = 0.02
"""How far [mm] rollers and edges may move against each other before a prepared "direct" law calls the scene another."""


def log_loads(top: float) -> np.ndarray:
    """Logarithms of the loads [N] that curves go through, up to `top` [N]."""
    return np.asarray(curve.chebyshev(LOADS, np.log(top) - DECADES * np.log(10.0), np.log(top)))


def around(load: Real, bottom: Real, top: Real) -> jax.Array:
    """Logarithms of loads [log N] around `load` [N], for a curve that an edge bends; between `bottom` and `top`, which
    are logarithms and WINDOW or more apart."""
    high = jnp.clip(jnp.log(jnp.maximum(load, 1e-300)) + ABOVE, bottom + WINDOW, top)
    return curve.chebyshev(LOADS, high - WINDOW, high)


def shift_over(contact: LineContact, spall: Spall) -> jax.Array:
    """Approach [mm] from which a roller in the middle of a wide and deep spall carries load: the crown at the land."""
    ends = 0.5 * spall.length - spall.axial_offset, 0.5 * spall.length + spall.axial_offset
    nearest = jnp.maximum(jnp.minimum(*ends), 0.0)  # no |…|: its slope at 0 would not be 0
    half = 0.5 * contact.length
    return gaps.crown_at(jnp.minimum(nearest, half * (1.0 - 1e-9)), contact)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["contact", "log_loads", "spalls", "distances", "approaches", "slopes", "given", "error",
                 "status_code"],
    meta_fields=["states", "index"],
)  # fmt: skip
@dataclasses.dataclass(frozen=True)
class DirectLaw:
    """Curves through contact solves for one scene. Exact at the scene it was prepared for; approaches are carried to
    its neighbours along their exact slopes, so all first derivatives are right.

    Attributes:
      contact: now. log_loads: of the nodes [log N], shape (states, loads).
      spalls, distances: as prepared; distances [mm] of shape (spalls, rollers).
      approaches: [mm], shape (states, loads). slopes: by `nodes.inputs`, shape (states, loads, inputs).
      given: those inputs as prepared, shape (states, inputs).
      error: of the contact solves [-], as asked for. status_code: worst of all solves.
      states: (spall, roller) of every state; (-1, -1) is healthy, roller −1 in the middle of a spall. index:
        the number of every roller's state.
    """

    contact: LineContact
    log_loads: jax.Array
    spalls: tuple[Spall, ...]
    distances: jax.Array
    approaches: jax.Array
    slopes: jax.Array
    given: jax.Array
    error: Real
    status_code: Real
    states: tuple[tuple[int, int], ...]
    index: tuple[int, ...]
    name = "direct"
    hard = False

    @property
    def load_range(self) -> tuple[Real, Real]:
        """Smallest and largest load of the solves [N]."""
        return jnp.exp(self.log_loads[0, 0]), jnp.exp(self.log_loads[0, -1])

    def at(self, contact: LineContact) -> DirectLaw:
        """The law carried to another contact near by."""
        return dataclasses.replace(self, contact=contact)

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array, expected: jax.Array) -> Curve:
        """See `Law`."""
        healthy = self._moved(0, None, jnp.zeros(()))
        if not spalls:
            sound = curve.through(self.log_loads[0], healthy, jnp.zeros(()))
            return curve.of(curve.joined(sound), jnp.zeros(distances.shape[1], int))
        full = {i: self._moved(k, spalls[i], jnp.zeros(())) for k, (i, j) in enumerate(self.states) if i >= 0 > j}
        columns, shifts = [], []
        for k, (i, j) in enumerate(self.states):
            if i < 0:
                columns.append(healthy)
                shifts.append(jnp.zeros(()))
                continue
            state = full[i] if j < 0 else self._moved(k, spalls[i], distances[i, j])
            at = curve.weights(self.log_loads[0], self.log_loads[k, 0])
            low, high = (jnp.exp(at @ jnp.log(level)) for level in (healthy, full[i]))
            share = (state[0] - low) / (high - low)
            columns.append(state)
            shifts.append(shift_over(self.contact, spalls[i]) * jnp.clip(share, 0.0, 1.0))
        curves = curve.through(self.log_loads.T, jnp.stack(columns, axis=1), jnp.stack(shifts))
        return curve.chosen(curves, jnp.asarray(self.index))

    def _moved(self, k: int, spall: Spall | None, distance: jax.Array) -> jax.Array:
        change = nodes.inputs(self.contact, spall, distance) - self.given[k]
        return self.approaches[k] + self.slopes[k] @ change

    def ramp(self, number: int, spall: Spall, load: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`: not known; this law holds for one phase."""
        return jnp.zeros(()), jnp.zeros(())

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array) -> jax.Array:
        """See `Law`: only the scene it was prepared for, or its neighbours, or the same bearing without spalls."""
        same = jnp.max(jnp.abs(self._moved(0, None, jnp.zeros(())) / self.approaches[0] - 1.0)) < MOVED
        if spalls:
            if len(spalls) != len(self.spalls) or distances.shape != self.distances.shape:
                return jnp.asarray(status.OTHER_SCENE)
            same = same & (jnp.max(jnp.abs(distances - self.distances)) < ASIDE)
            for now, then in zip(spalls, self.spalls, strict=True):
                same = same & (jnp.abs(now.width - then.width) < ASIDE)
            for k, (i, j) in enumerate(self.states):
                if i >= 0:
                    away = distances[i, j] if j >= 0 else jnp.zeros(())
                    moved = self._moved(k, spalls[i], away) / self.approaches[k] - 1.0
                    same = same & (jnp.max(jnp.abs(moved)) < MOVED)
        return jnp.where(same, status.CONVERGED, status.OTHER_SCENE)


def direct_law(
    contact: LineContact,
    largest: float,
    spalls: tuple[Spall, ...],
    distances: np.ndarray,
    expected: np.ndarray,
    accuracy: float = 1e-3,
    progress: Progress | None = None,
) -> DirectLaw:
    """Solve the contact of every distinct state of rollers at `distances` [mm], shape (spalls, rollers), from `spalls`.

    Args:
      contact: from `LineContact.of`.
      largest: estimate of the largest roller load [N]; curves reach 1.3 times it and begin at a thousandth of that.
      expected: about the rollers' loads [N], shape (rollers,): where curves that an edge bends are made.
      accuracy: relative accuracy of every contact solve, 1e-2…1e-4.
      progress: told how many of how many solves are done.

    Healthy once, the middle of each spall once, and each roller from which an edge is in reach, twelve loads each.
    Needs numbers, not tracers.
    """
    contact, spalls, top = as_floats(contact), as_floats(spalls), MARGIN * largest
    loads = log_loads(top)
    healthy = nodes.solved(contact, Case(top), accuracy)
    states: list[tuple[int, int]] = [(-1, -1)]
    index = np.zeros(distances.shape[1], int)
    for i, spall in enumerate(spalls):
        full = nodes.solved(contact, Case(top, wide(spall)), accuracy)
        over = 0.5 * float(spall.width) - np.abs(distances[i])
        longer = np.array(
            [index[j] == 0 or spalls[states[index[j]][0]].length < spall.length for j in range(index.size)]
        )
        near = longer & (over > -1.05 * healthy.half_width)
        if near.any():
            states.append((i, -1))
            index[near] = len(states) - 1
            at_edge = near & (np.minimum(over, 0.5 * float(spall.width)) < 1.05 * full.reach)
            for j in np.flatnonzero(at_edge):
                states.append((i, int(j)))
                index[j] = len(states) - 1
    shapes = [None if i < 0 else (wide(spalls[i]) if j < 0 else spalls[i]) for i, j in states]
    away = [0.0 if j < 0 else float(distances[i, j]) for i, j in states]
    at = np.stack([loads if j < 0 else np.asarray(around(expected[j], loads[0], loads[-1])) for _, j in states])
    cases = [Case(float(np.exp(q)), shape, d) for shape, d, row in zip(shapes, away, at, strict=True) for q in row]
    solved = nodes.all_solved(contact, cases, accuracy, progress)
    count = len(states), loads.size
    approaches = np.array([node.approach for node in solved]).reshape(count)
    slopes = np.array([node.slopes for node in solved]).reshape(*count, nodes.INPUTS)
    given = [nodes.inputs(contact, None if i < 0 else spalls[i], d) for (i, _), d in zip(states, away, strict=True)]
    return DirectLaw(
        contact, jnp.asarray(at), spalls, jnp.asarray(distances), jnp.asarray(approaches), jnp.asarray(slopes),
        jnp.stack(given), accuracy, nodes.worst_status(solved), tuple(states), tuple(index.tolist()),
    )  # fmt: skip


def wide(spall: Spall) -> Spall:
    """The same spall so wide that its rolling edges are out of reach from its middle."""
    return dataclasses.replace(spall, width=1000.0)
