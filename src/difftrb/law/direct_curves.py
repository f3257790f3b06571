"""Law "direct" of one scene in the mean over phases: curves through contact solves over all loads, healthy, over the
middle of every spall, and at the places where rollers stand near its edges. At one phase, and where rollers meet more
than one deep rectangular spall, it is `direct_states.DirectByStates`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from difftrb.contact import gap
from difftrb.contact.grids import GRIDS
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real, Spall, as_floats
from difftrb.core.numeric import chebyshev_nodes
from difftrb.law import base, edge_ramp, edge_share, load_curve, ramp_fit, roller_curves, samples
from difftrb.law.base import LENGTH_SHARE, LawKind, Rest, known_up_to, of_one_deep_spall, within_range
from difftrb.law.edge_ramp import Ramp
from difftrb.law.load_curve import Curve
from difftrb.law.ramp_fit import Healthy
from difftrb.law.roller_curves import RollerCurves
from difftrb.law.samples import AT, Case, Node, Progress

if TYPE_CHECKING:
    from jaxtyping import Float

    Array = jax.Array | np.ndarray

LOADS = 12
"""Contact solves of one curve: enough for 1e-4 over `DECADES` of load."""
DECADES = 2.5
"""With three, derivatives of stiffness by what moves the land along the roller are ten times as far off: the lightest
solves are the noisiest, and one curve for all of them bends."""
EDGE_LOADS = 6
"""With 12, losses are 3e-4 of themselves and stiffness 6e-6 elsewhere, and derivatives as far off as with 8."""
WINDOW = 0.8, 1.25
"""Of the approach that is expected of a roller at an edge: between these the contact is solved. With 0.65 … 1.5 one
share for all these loads bends: stiffness is ten times as far off, its derivative by width by a third."""
NEAR_RIDGE = 2e-5
"""Noise of a share by the size of s's coefficients, of solves at one place."""
MARGIN = 1.3
MOVED = 0.05
"""By how much of itself an approach may be carried along its slopes before a prepared law calls the scene another."""
FINER_FROM = 1.5e-4
"""Accuracy from which on contacts at edges are more exact than the others: alike, they leave loads and stiffness twice
as far off."""
FINER = 0.3
ASIDE = 0.02
"""How far [mm] rollers and edges may move against each other before a prepared "direct" law calls the scene another."""


def log_loads(top: float) -> np.ndarray:
    """Logarithms of the loads [N] that curves go through, up to `top` [N]."""
    return np.asarray(chebyshev_nodes(LOADS, np.log(top) - DECADES * np.log(10.0), np.log(top)))


def accuracy_at_edges(accuracy: float) -> float:
    """Of contacts with a rolling edge in reach, where that of the others is `accuracy`."""
    return max(FINER * accuracy, min(GRIDS)) if accuracy <= FINER_FROM else accuracy


class Edges(NamedTuple):
    """Contact solves with a rolling edge of one spall at several places: spall and distance as `samples.inputs`, shape
    (places, inputs); loads [N], approaches [mm] and their slopes by the inputs, of shape (places, loads, …)."""

    given: Float[Array, "places inputs"]
    loads: Float[Array, "places edge_loads"]
    approaches: Float[Array, "places edge_loads"]
    slopes: Float[Array, "places edge_loads inputs"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class DirectByCurves:
    """Contact solves for one scene. Exact at the scene it was prepared for; approaches are carried to its neighbours
    along their exact slopes, so all first derivatives are right.

    Attributes:
      contact: now. log_loads: of the solves without an edge in reach [log N], shape (loads,).
      spalls: as prepared. given: `samples.inputs` of the contact as prepared.
      healthy, healthy_slopes: approaches [mm], shape (loads,), and by the inputs, (loads, inputs).
      full, full_slopes: over the middle of every spall, shape (spalls, loads), (spalls, loads, inputs).
      half_width, sunk: see `Ramp`; `sunk` of shape (spalls, coefficients).
      edges: of every spall, at the places where rollers stand on its ramps.
      error: of the contact solves [-], as asked for. status_code: worst of all solves.
      kinks_by_table: whether the table knows all rollers of its scene, over spalls, too: then rings by the table tell
        the kinks of a mean over phases. Else healthy rings do.
    """

    contact: LineContact
    log_loads: Float[Array, " loads"]
    spalls: tuple[Spall, ...]
    given: Float[Array, " inputs"]
    healthy: Float[Array, " loads"]
    healthy_slopes: Float[Array, "loads inputs"]
    half_width: Float[Array, " extents"]
    full: Float[Array, "spalls loads"]
    full_slopes: Float[Array, "spalls loads inputs"]
    sunk: Float[Array, "spalls extents"]
    edges: tuple[Edges, ...]
    error: Real
    status_code: Real
    kinks_by_table: bool = dataclasses.field(default=False, metadata={"static": True})
    name = "direct"
    hard = False

    @property
    def load_range(self) -> tuple[Real, Real]:
        """Smallest and largest load of the solves [N]."""
        return xp.exp(self.log_loads[0]), xp.exp(self.log_loads[-1])

    def at(self, contact: LineContact) -> DirectByCurves:
        """The law carried to another contact near by."""
        return dataclasses.replace(self, contact=contact)

    def curves(self, spalls: tuple[Spall, ...], distances: Any) -> RollerCurves:
        """See `Law`. Spalls beyond those it was prepared for are for `judge` to refuse."""
        spalls, distances = spalls[: len(self.spalls)], distances[: len(self.spalls)]
        healthy = self._level()
        fulls = [self._over(i, spall) for i, spall in enumerate(spalls)]
        ramps = [
            [self._ramp(i, spall, healthy, full, distances[i], side) for side in (1.0, -1.0)]
            for i, (spall, full) in enumerate(zip(spalls, fulls, strict=True))
        ]
        return roller_curves.with_ramps(healthy.curve, fulls, ramps, spalls, distances)

    def _ramp(self, i: int, spall: Spall, healthy: Healthy, full: Curve, distances: Any, side: float) -> Ramp:
        """Of the place nearest to where the roller is now; `distances` [mm] of shape (…, rollers)."""
        edges, edge = self.edges[i], roller_curves.edge_beyond(spall, distances, side)
        distance = xp.total(xp.where(roller_curves.next_to(spall, distances, side), xp.magnitude(distances), 0.0))
        rise = ramp_fit.rise_over(self.contact, spall)
        blank = healthy.beside(edge, full, self.sunk[i], rise, edge_ramp.guess())
        count = edges.loads.shape[0]
        if not count:
            return blank
        away = xp.abs(xp.fixed(distance)[..., None] - edges.given[:, AT.distance])
        here = (xp.argmin(away, axis=-1)[..., None] == np.arange(count)).astype(float)
        given, loads, approaches, slopes = (xp.tensordot(here, leaf, 1) for leaf in edges)
        # beyond this distance another ramp applies, or none
        apart = xp.within(distance - given[..., AT.distance], -ASIDE, ASIDE)
        now = samples.inputs(self.contact, spall, 0.0)[: AT.distance]
        moved = xp.einsum("...li,...i->...l", slopes[..., : AT.distance], now - given[..., : AT.distance])
        approaches = approaches + moved + slopes[..., AT.distance] * apart[..., None]
        at = edge_ramp.spread(dataclasses.replace(blank, edge=0.0), approaches.ndim)
        share = ramp_fit.through(dataclasses.replace(at, edge=edge[..., None]), approaches, loads, NEAR_RIDGE)
        return dataclasses.replace(blank, share=edge_ramp.in_powers(share))

    def levels(self, i: int, spall: Spall) -> tuple[Healthy, Curve]:
        """A healthy roller and the curve over the middle of the `i`-th spall."""
        return self._level(), self._over(i, spall)

    def _level(self) -> Healthy:
        solved = samples.contact_of(self.given)
        return ramp_fit.healthy_level(self.contact, solved, self.log_loads, self._healthy(), self.half_width)

    def _over(self, i: int, spall: Spall) -> Curve:
        return load_curve.through(self.log_loads, self._full(i, spall), ramp_fit.shift_over(self.contact, spall))

    def _healthy(self) -> Any:
        change = samples.inputs(self.contact, None, 0.0) - self.given
        return self.healthy + xp.einsum("li,i->l", self.healthy_slopes, change)

    def _full(self, i: int, spall: Spall) -> Any:
        change = samples.inputs(self.contact, wide(spall), 0.0) - samples.inputs(
            samples.contact_of(self.given), wide(self.spalls[i]), 0.0
        )
        return self.full[i] + xp.einsum("li,i->l", self.full_slopes[i], change)

    def ramp(self, number: int, spall: Spall, approach: Any) -> tuple[Any, Any]:
        """See `Law`."""
        healthy, full = self.levels(number, spall)
        rise = ramp_fit.rise_over(self.contact, spall)
        beside = healthy.beside(np.zeros(()), full, self.sunk[number], rise, edge_ramp.guess())
        return edge_ramp.extent(edge_ramp.spread(beside, np.ndim(approach)), approach)

    def certain_ramp(self, approach: Any) -> tuple[Any, Any]:
        """As `ramp`, of whatever spall: from where an edge enters a healthy contact to where nothing may reach it."""
        healthy = edge_ramp.spread(self._level(), np.ndim(approach))
        half_width = edge_ramp.half_width_at(healthy, load_curve.carried(healthy.curve, approach))
        pressed = approach > 0.0
        reach = gap.certain_reach(self.contact.radius, xp.where(pressed, approach, 1.0))
        return -half_width, xp.where(pressed, reach, 0.0)

    def judge(self, spalls: tuple[Spall, ...], distances: Any, rest: Rest | None = None) -> Any:
        """See `Law`: only the scene it was prepared for, or its neighbours, or the same bearing without spalls; no
        roller over several spalls or on a bottom: that is `direct_states.DirectByStates`'s."""
        same = xp.max(xp.abs(self._healthy() / self.healthy - 1.0)) < MOVED
        if len(spalls) not in (0, len(self.spalls)):
            return np.asarray(status.OTHER_SCENE)
        for i, spall in enumerate(spalls):
            same = same & (xp.max(xp.abs(self._full(i, spall) / self.full[i] - 1.0)) < MOVED)
            low, high = self.ramp(i, spall, self.full[i, -1])
            for side in (1.0, -1.0):
                edge = roller_curves.edge_beyond(spall, distances[i], side)
                apart = xp.abs(self.edges[i].given[:, AT.distance] - (0.5 * spall.width - edge)[..., None])
                near = xp.min(apart, axis=-1, initial=np.inf) < ASIDE
                same = same & xp.all(near | (edge < low) | (edge > high))
        code = status.worst(
            within_range(self.load_range, rest), of_one_deep_spall(spalls, distances, rest),
            known_up_to(LENGTH_SHARE * self.contact.length, spalls),
        )  # fmt: skip
        return xp.where(same, code, status.OTHER_SCENE)


def without_edges(
    contact: LineContact, largest: float, spalls: tuple[Spall, ...], accuracy: float = 1e-3,
    progress: Progress | None = None,
) -> DirectByCurves:  # fmt: skip
    """The law of a healthy roller and of one over the middle of every spall; for rollers at an edge add `with_edges`.

    Args:
      contact: from `LineContact.of`.
      largest: estimate of the largest roller load [N]; curves reach 1.3 times it and begin at a three-hundredth of
        that.
      accuracy: relative accuracy of every contact solve, 1e-2…1e-5; see `accuracy_at_edges`.
      progress: told how many of how many solves are done.

    Needs numbers, not tracers.
    """
    contact, spalls = as_floats(contact), as_floats(spalls)
    loads = log_loads(MARGIN * largest)
    levels = solved_levels(contact, [wide(spall) for spall in spalls], loads, accuracy, progress)
    approaches = np.asarray([[node.approach for node in level] for level in levels])
    slopes = np.asarray([[node.slopes for node in level] for level in levels])
    half_width = ramp_fit.extents(loads, np.array([node.half_width for node in levels[0]]))
    sunk = np.asarray(
        [ramp_fit.sunk(contact, spall, level, loads) for spall, level in zip(spalls, levels[1:], strict=True)]
    )
    return DirectByCurves(
        contact, np.asarray(loads), spalls, np.asarray(samples.inputs(contact, None, 0.0)), approaches[0], slopes[0],
        np.asarray(half_width), approaches[1:], slopes[1:], sunk.reshape(len(spalls), ramp_fit.EXTENT_DEGREE + 1),
        tuple(_edges(contact, spall, [], np.zeros((0, EDGE_LOADS)), []) for spall in spalls), accuracy,
        samples.worst_status([node for level in levels for node in level]),
    )  # fmt: skip


def solved_levels(
    contact: LineContact, spalls: Sequence[Spall], log_loads: np.ndarray, accuracy: float, progress: Progress | None
) -> list[list[Node]]:
    """Contacts at all `log_loads` [log N], healthy and then over the middle of every spall."""
    shapes, loads = [None, *spalls], np.exp(log_loads)
    solved = samples.all_solved(contact, [Case(q, shape) for shape in shapes for q in loads], accuracy, progress)
    return [solved[k : k + loads.size] for k in range(0, len(solved), loads.size)]


def with_edges(
    law: DirectByCurves, places: Sequence[Sequence[tuple[float, float]]], progress: Progress | None = None
) -> DirectByCurves:
    """The law with contacts solved at `places`: for each spall, distances [mm] of rollers from its middle at which an
    edge may be in reach, each with about the approach [mm] that the roller will have there."""
    edges, codes = [], [float(law.status_code)]
    for i, (spall, own) in enumerate(zip(law.spalls, places, strict=True)):
        healthy, full = law.levels(i, spall)
        loads = np.zeros((len(own), EDGE_LOADS))
        for k, (distance, approach) in enumerate(own):
            edge, rise = np.asarray(0.5 * spall.width - distance), ramp_fit.rise_over(law.contact, spall)
            beside = healthy.beside(edge, full, law.sunk[i], rise, edge_ramp.guess())
            at = approach * np.geomspace(*WINDOW, EDGE_LOADS)
            healthy_loads, full_loads, low, high = edge_ramp.between(beside, np.asarray(at))
            left = edge_share.usual(edge_share.place(beside.edge, low, high))  # before any solve at the edge
            loads[k] = np.maximum(full_loads + (healthy_loads - full_loads) * left, np.exp(law.log_loads[0]))
        distances = [distance for distance, _ in own]
        cases = [Case(q, spall, d) for d, row in zip(distances, loads, strict=True) for q in row]
        solved = samples.all_solved(law.contact, cases, accuracy_at_edges(float(law.error)), progress)
        edges.append(_edges(law.contact, spall, distances, loads, solved))
        codes.append(samples.worst_status(solved))
    return dataclasses.replace(law, edges=tuple(edges), status_code=max(codes))


def _edges(
    contact: LineContact, spall: Spall, distances: Sequence[float], loads: np.ndarray, solved: Sequence[Node]
) -> Edges:
    def field(name: str, *shape: int) -> np.ndarray:
        return np.asarray([getattr(node, name) for node in solved], float).reshape(*loads.shape, *shape)

    given = [samples.inputs(contact, spall, d) for d in distances]
    return Edges(
        np.asarray(given, float).reshape(len(distances), samples.INPUTS), np.asarray(loads), field("approach"),
        field("slopes", samples.INPUTS),
    )  # fmt: skip


def wide(spall: Spall) -> Spall:
    """The same spall so wide that its rolling edges are out of reach from its middle."""
    return dataclasses.replace(spall, width=1000.0)


base.register(
    LawKind(
        "direct",
        "contact solves for exactly the states that the rollers of one scene are in",
        make=lambda of: without_edges(of.contact, float(of.largest), of.spalls, of.accuracy, of.progress),
        by_samples=True,
        solves=True,
        inner=True,
        frozen=None,
        one_scene=True,
        maps=True,
    )
)
