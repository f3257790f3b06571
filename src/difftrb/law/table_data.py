"""The smooth roller law as it is read: curves over load and spall length, and the ramps of spalls' edges.

Between lengths the coefficients of curves through contact solves are interpolated. Beside the middle of a spall a
roller carries what `ramp` says, with a share of the land's load fitted to solves at several lengths, approaches and
places of the edge. `table` builds it.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap
from difftrb.core import status, storage
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.law import direct, edge_ramp, load_curve, ramp_fit, samples
from difftrb.law.base import Rest, load_over, of_one_deep_spall, within_range
from difftrb.law.direct import ASIDE, MOVED
from difftrb.law.edge_ramp import Ramp, RollerCurves
from difftrb.law.load_curve import Curve
from difftrb.law.ramp_fit import Healthy
from difftrb.law.samples import AT, Case, Node, Progress

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float

LIGHTEST = 0.08
"""Least load of a solve at an edge, by what the roller carries on a healthy raceway: lighter ones tell nothing, and
over long spalls there is none."""
CHECKS = 24
NARROW_CHECKS = 16
NO_LAND = 1.0
"""Height of the crown [mm] that stands for what lies beyond the roller's end: no approach is as large."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Atlas:
    """A roller beside and over deep spalls of one axial offset.

    Attributes:
      given: `samples.inputs` of contact and spall as solved, length and width 0, shape (inputs,).
      log_loads: of the nodes [log N], shape (loads,).
      healthy, healthy_slopes: approaches [mm], shape (loads,), and by the inputs, (loads, inputs).
      half_width: see `Ramp`, shape (coefficients,).
      lengths: of spalls [mm], Chebyshev–Lobatto in `spread`, the first 0, shape (lengths,).
      full, full_slopes: approaches over a spall's middle, shape (lengths, loads), (lengths, loads, inputs).
      sunk: see `Ramp`, shape (lengths, coefficients).
      edge_lengths: logarithms of spalls' lengths [log mm], shape (edge lengths,).
      share, share_slopes: see `Ramp`, shape (edge lengths, powers, terms), and by the inputs, (…, inputs).
      error: largest error of a load against contact solves at random points that the table was not built from,
        relative to what a healthy roller carries at the same approach.
      status_code: worst status of all solves.
    """

    given: Float[Array, " inputs"]
    log_loads: Float[Array, " loads"]
    healthy: Float[Array, " loads"]
    healthy_slopes: Float[Array, "loads inputs"]
    half_width: Float[Array, " extents"]
    lengths: Float[Array, " lengths"]
    full: Float[Array, "lengths loads"]
    full_slopes: Float[Array, "lengths loads inputs"]
    sunk: Float[Array, "lengths extents"]
    edge_lengths: Float[Array, " edge_lengths"]
    share: Float[Array, "edge_lengths powers terms"]
    share_slopes: Float[Array, "edge_lengths powers terms inputs"]
    error: Real
    status_code: Real


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class TableLaw:
    """A roller law from `Atlas`es: the one numbered `which[i]` for the i-th spall of a scene.

    `contact` may differ a little from the atlases': approaches are carried along their exact slopes. `narrow_error` is
    as `Atlas.error`, of spalls with both edges in reach of a roller; None: the law is for wider ones only.
    """

    contact: LineContact
    atlases: tuple[Atlas, ...]
    which: tuple[int, ...] = dataclasses.field(metadata={"static": True})
    narrow_error: Real | None = None
    name = "table"
    hard = False

    @property
    def load_range(self) -> tuple[Real, Real]:
        """Smallest and largest load of the solves [N]."""
        return jnp.exp(self.atlases[0].log_loads[0]), jnp.exp(self.atlases[0].log_loads[-1])

    @property
    def error(self) -> Real:
        """See `Atlas`."""
        errors = [jnp.asarray(atlas.error) for atlas in self.atlases]
        return jnp.max(jnp.stack(errors if self.narrow_error is None else [*errors, jnp.asarray(self.narrow_error)]))

    @property
    def status_code(self) -> Real:
        """Worst of all solves."""
        return jnp.max(jnp.stack([jnp.asarray(atlas.status_code) for atlas in self.atlases]))

    def at(self, contact: LineContact) -> TableLaw:
        """The law carried to another contact near by."""
        return dataclasses.replace(self, contact=contact)

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> RollerCurves:
        """See `Law`. Spalls beyond those it was prepared for are for `judge` to refuse."""
        spalls, distances = spalls[: len(self.which)], distances[: len(self.which)]
        atlases = [self.atlases[which] for which in self.which[: len(spalls)]]
        healthy = _healthy(self.atlases[0], self.contact, _change(self.atlases[0], self.contact, None))
        beside = [ramp_of(atlas, self.contact, spall) for spall, atlas in zip(spalls, atlases, strict=True)]
        if self.narrow_error is not None:
            beside = [_narrow(one, self.contact, spall) for spall, one in zip(spalls, beside, strict=True)]
        ramps = [
            [dataclasses.replace(one, edge=ramp_fit.over(spall, distances[i], side)) for side in (1.0, -1.0)]
            for i, (spall, one) in enumerate(zip(spalls, beside, strict=True))
        ]
        return ramp_fit.roller_curves(healthy, [one.full for one in beside], ramps, spalls, distances)

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """See `Law`: deep spalls up to 85 % of the roller long, of an axial offset that the table was built for, on a
        contact that is the table's or a neighbour of it; narrow ones if the table was made for them."""
        code = status.worst(within_range(self.load_range, rest), of_one_deep_spall(spalls, distances, rest))
        for i, spall in enumerate(spalls):
            if i >= len(self.which):
                return jnp.asarray(status.OTHER_SCENE)
            atlas = self.atlases[self.which[i]]
            change = _change(atlas, self.contact, spall)
            moved = jnp.max(jnp.abs(atlas.full_slopes @ change / atlas.full))
            same = (moved < MOVED) & (jnp.abs(change[AT.spall_axial_offset]) < ASIDE)
            code = status.worst(code, jnp.where(same, status.CONVERGED, status.OTHER_SCENE))
            if self.narrow_error is None:
                beside = ramp_of(atlas, self.contact, spall)
                _, end = edge_ramp.extent(beside, load_curve.end(beside.full, 1.0))
                code = status.worst(code, jnp.where(0.5 * spall.width > end, status.CONVERGED, status.NARROW))
            known = spall.length <= atlas.lengths[-1]
            code = status.worst(code, jnp.where(known, status.CONVERGED, status.UNKNOWN_LENGTH))
        return code

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`."""
        beside = ramp_of(self.atlases[self.which[number]], self.contact, spall)
        low, high = edge_ramp.extent(beside, approach)
        return low, high if self.narrow_error is None else jnp.minimum(high, 0.5 * spall.width)


def _change(atlas: Atlas, contact: LineContact, spall: Spall | None) -> jax.Array:
    """Of the inputs that the atlas carries along slopes: all but length, width, depth and distance."""
    now = (
        None if spall is None else dataclasses.replace(spall, length=0.0, width=0.0, depth=atlas.given[AT.spall_depth])
    )
    return samples.inputs(contact, now, 0.0) - atlas.given


def _healthy(atlas: Atlas, contact: LineContact, change: jax.Array) -> Healthy:
    approaches, solved = atlas.healthy + atlas.healthy_slopes @ change, samples.contact_of(atlas.given)
    return ramp_fit.healthy_level(contact, solved, atlas.log_loads, approaches, atlas.half_width)


def _fulls(atlas: Atlas, contact: LineContact, like: Spall, change: jax.Array) -> Curve:
    """Curves over the middle of spalls of all lengths of the atlas, shape (lengths,)."""
    crowns = jax.vmap(lambda length: direct.shift_over(contact, dataclasses.replace(like, length=length)))
    approaches = atlas.full + atlas.full_slopes @ change
    return load_curve.through(atlas.log_loads, approaches.T, crowns(atlas.lengths))


def spread(length: Real, contact: LineContact, top: Real) -> jax.Array:
    """What curves are interpolated in for the length of a spall [mm], of any shape, up to a load `top` [N]: its root,
    rounded off where a spall is shorter than the contact is wide [√mm]. In the length itself it takes twice the nodes,
    for what a spall's ends take with them is all there once it is longer than that."""
    return jnp.sqrt(length + shortest(contact, top))


def shortest(contact: LineContact, top: Real) -> Real:
    """Width of the contact without a spall [mm]."""
    return 2.0 * gap.line_half_width(top / contact.length, contact.radius, contact.modulus)


def ramp_of(atlas: Atlas, contact: LineContact, spall: Spall) -> Ramp:
    """The ramp of this spall with its edge under the roller's middle."""
    change = _change(atlas, contact, spall)
    length = jnp.asarray(spall.length, float)
    solved, top = samples.contact_of(atlas.given), jnp.exp(atlas.log_loads[-1])
    at = load_curve.weights(spread(atlas.lengths, solved, top), spread(length, solved, top))
    fulls = _fulls(atlas, contact, spall, change)
    full = Curve(fulls.coefficients @ at, at @ fulls.middle, at @ fulls.reach, direct.shift_over(contact, spall))
    longer = jnp.log(jnp.maximum(length, jnp.exp(atlas.edge_lengths[0])))
    share = atlas.share + atlas.share_slopes @ change
    at_edge = load_curve.weights(atlas.edge_lengths, longer)
    return _healthy(atlas, contact, change).beside(
        jnp.zeros(()), full, at @ atlas.sunk, jnp.tensordot(at_edge, share, 1)
    )


def _narrow(beside: Ramp, contact: LineContact, spall: Spall) -> Ramp:
    """The ramp for both edges of the spall."""
    crown = gap.crown_at(spall.axial_offset + 0.5 * spall.length * jnp.asarray(edge_ramp.ALONG), contact)
    width = jnp.asarray(spall.width, float)
    return dataclasses.replace(beside, narrow=edge_ramp.NarrowSpall(width, jnp.minimum(crown, NO_LAND)))


# ------------------------------------------------------------------------------------------------ how far off it is


def plain_ramp(built: Atlas, contact: LineContact, length: jax.Array) -> Ramp:
    """The ramp beside a spall of this length as the atlas knows it, its edge under the roller's middle."""
    return ramp_of(built, contact, dataclasses.replace(samples.spall_of(built.given), length=length))


@jax.jit
def _between(built: Atlas, contact: LineContact, length: jax.Array, load: jax.Array) -> tuple[jax.Array, ...]:
    """`edge_ramp.between` at the approach of a roller that carries `load` [N] on a healthy raceway."""
    beside = plain_ramp(built, contact, length)
    return edge_ramp.between(beside, load_curve.approach(beside.healthy, load))


def _drawn(rng: np.random.Generator, contact: LineContact, built: Atlas) -> tuple[float, ...]:
    """A random length of spall [mm] and, at a random approach, what `edge_ramp.between` returns."""
    length = float(built.lengths[-1]) * rng.uniform(0.05, 1.0)
    load = float(np.exp(float(built.log_loads[-1]) - rng.uniform(0.0, np.log(30.0))))
    return length, *map(float, _between(built, contact, length, load))


def measured_error(
    contact: LineContact, built: Atlas, like: Spall, accuracy: float, progress: Progress | None
) -> float:
    """See `Atlas.error`: at random points in the middle of spalls, and with an edge on the ramp."""
    rng = np.random.default_rng(0)
    cases = []
    for k in range(CHECKS):
        length, healthy, full, low, high = _drawn(rng, contact, built)
        t = rng.uniform() if k % 2 else 1.0
        load = max(float(edge_ramp.guessed(*map(jnp.asarray, (healthy, full, t)))), LIGHTEST * healthy)
        shape = dataclasses.replace(like, length=length, width=4.0 * high)
        cases.append(Case(load, shape, 2.0 * high - (low + (high - low) * t) if k % 2 else 0.0))
    return _worst(TableLaw(contact, (built,), (0,)), cases, samples.all_solved(contact, cases, accuracy, progress))


def narrow_error(
    contact: LineContact, built: Atlas, like: Spall, accuracy: float, progress: Progress | None
) -> storage.Arrays:
    """See `TableLaw`: at random points with a roller near the middle of spalls whose edges are both in its reach."""
    rng = np.random.default_rng(1)
    cases = []
    for _ in range(NARROW_CHECKS):
        length, load, _, low, high = _drawn(rng, contact, built)
        shape = dataclasses.replace(like, length=length, width=2.0 * high * rng.uniform(0.05, 1.0))
        cases.append(Case(load, shape, -low * rng.uniform(0.0, 1.0)))
    law = TableLaw(contact, (built,), (0,), 0.0)
    return {"error": np.asarray(_worst(law, cases, samples.all_solved(contact, cases, accuracy, progress)))}


def _worst(law: TableLaw, cases: list[Case], solved: list[Node]) -> float:
    """The largest error of a load, by what a healthy roller carries there."""
    worst = 0.0
    for case, node in zip(cases, solved, strict=True):
        found, _ = _one(law, node.approach, case.spall, case.distance)
        healthy, _ = _one(law, node.approach)
        if float(healthy) > 0.0:  # else there is no solution, as its status says
            worst = max(worst, abs(float(found) - case.load) / float(healthy))
    return worst


_one = jax.jit(load_over)
