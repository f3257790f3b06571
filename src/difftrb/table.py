"""The smooth roller law: a table of contact solves over load and spall length, with the ramps of spalls' edges.

Healthy, and over the middle of spalls of several lengths, contacts are solved at the same loads; curves go through
them, and between lengths their coefficients are interpolated. Beside the middle a roller carries what `ramp` says, with
a share of the land's load fitted to solves at several lengths, loads and places of the edge.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb import curve, direct, nodes, ramp, status, store
from difftrb.curve import Curve
from difftrb.direct import ASIDE, MOVED, Healthy
from difftrb.geometry import LineContact, Real, Spall, as_floats
from difftrb.law import LENGTH_SHARE, load_over
from difftrb.nodes import Case, Node, Progress
from difftrb.ramp import Carried, Ramp

LENGTHS = 10
EDGE_LENGTHS = 6
EDGE_LOADS = 4
EDGE_PLACES = 8
DEGREE = 3
"""Of a ramp's share in log Q."""
SHORTEST = 0.04
"""Shortest spall whose edges are solved, as a share of the longest; shorter ones have its share."""
BESIDE = 1.03
"""How far beyond its ends the ramp is solved to find the levels it joins, both on one and the same grid."""
CHECKS = 24
MAKERS = (
    "contact", "contact_solution", "curve", "direct", "domain", "edges", "gap", "geometry", "given", "halfspace",
    "hertz", "implicit", "law", "nodes", "press", "ramp", "rows", "special", "strip_model", "strips", "table",
)  # fmt: skip
"""Modules that a table is made by: a change in one makes another table."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["given", "log_loads", "healthy", "healthy_slopes", "half_width", "lengths", "full", "full_slopes",
                 "sunk", "edge_lengths", "share", "share_slopes", "error", "status_code"],
    meta_fields=[],
)  # fmt: skip
@dataclasses.dataclass(frozen=True)
class Atlas:
    """A roller beside and over spalls of one depth and axial offset.

    Attributes:
      given: `nodes.inputs` of contact and spall as solved, length and width 0, shape (inputs,).
      log_loads: of the nodes [log N], shape (loads,).
      healthy, healthy_slopes: approaches [mm], shape (loads,), and by the inputs, (loads, inputs).
      half_width: see `Ramp`, shape (coefficients,).
      lengths: of spalls [mm], Chebyshev–Lobatto, the first 0, shape (lengths,).
      full, full_slopes: approaches over a spall's middle, shape (lengths, loads), (lengths, loads, inputs).
      sunk: see `Ramp`, shape (lengths, coefficients).
      edge_lengths: logarithms of spalls' lengths [log mm], shape (edge lengths,).
      share, share_slopes: see `Ramp`, shape (edge lengths, powers, terms), and by the inputs, (…, inputs).
      error: largest error of a load against contact solves at random points that the table was not built from,
        relative to what a healthy roller carries at the same approach.
      status_code: worst status of all solves.
    """

    given: jax.Array
    log_loads: jax.Array
    healthy: jax.Array
    healthy_slopes: jax.Array
    half_width: jax.Array
    lengths: jax.Array
    full: jax.Array
    full_slopes: jax.Array
    sunk: jax.Array
    edge_lengths: jax.Array
    share: jax.Array
    share_slopes: jax.Array
    error: Real
    status_code: Real


@partial(jax.tree_util.register_dataclass, data_fields=["contact", "atlases"], meta_fields=["which"])
@dataclasses.dataclass(frozen=True)
class TableLaw:
    """A roller law from `Atlas`es: the one numbered `which[i]` for the i-th spall of a scene.

    `contact` may differ a little from the atlases': approaches are carried along their exact slopes.
    """

    contact: LineContact
    atlases: tuple[Atlas, ...]
    which: tuple[int, ...]
    name = "table"
    hard = False

    @property
    def load_range(self) -> tuple[Real, Real]:
        """Smallest and largest load of the solves [N]."""
        return jnp.exp(self.atlases[0].log_loads[0]), jnp.exp(self.atlases[0].log_loads[-1])

    @property
    def error(self) -> Real:
        """See `Atlas`."""
        return jnp.max(jnp.stack([jnp.asarray(atlas.error) for atlas in self.atlases]))

    @property
    def status_code(self) -> Real:
        """Worst of all solves."""
        return jnp.max(jnp.stack([jnp.asarray(atlas.status_code) for atlas in self.atlases]))

    def at(self, contact: LineContact) -> TableLaw:
        """The law carried to another contact near by."""
        return dataclasses.replace(self, contact=contact)

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> Carried:
        """See `Law`. Spalls beyond those it was prepared for are for `judge` to refuse."""
        spalls, distances = spalls[: len(self.which)], distances[: len(self.which)]
        atlases = [self.atlases[which] for which in self.which[: len(spalls)]]
        healthy = _healthy(self.atlases[0], self.contact, _change(self.atlases[0], self.contact, None))
        ramps = [
            [_ramp(atlas, self.contact, spall, direct.over(spall, distances[i], side)) for side in (1.0, -1.0)]
            for i, (spall, atlas) in enumerate(zip(spalls, atlases, strict=True))
        ]
        return direct.carried_by(healthy, [pair[0].full for pair in ramps], ramps, spalls, distances)

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array) -> jax.Array:
        """See `Law`: spalls up to 85 % of the roller long, wider than the contact, of a depth and axial offset that
        the table was built for, on a contact that is the table's or a neighbour of it."""
        code = jnp.asarray(status.CONVERGED)
        for i, spall in enumerate(spalls):
            if i >= len(self.which):
                return jnp.asarray(status.OTHER_SCENE)
            atlas = self.atlases[self.which[i]]
            change = _change(atlas, self.contact, spall)
            moved = jnp.max(jnp.abs(atlas.full_slopes @ change / atlas.full))
            deepest = jnp.max(atlas.full)
            deep = (spall.depth > deepest) & (atlas.given[-3] > deepest)
            same = (moved < MOVED) & (deep | (jnp.abs(change[-3]) < MOVED * atlas.given[-3]))
            same = same & (jnp.abs(change[-2]) < ASIDE)
            code = status.worst(code, jnp.where(same, status.CONVERGED, status.OTHER_SCENE))
            beside = _ramp(atlas, self.contact, spall, jnp.zeros(()))
            _, end = ramp.extent(beside, curve.end(beside.full, 1.0))
            code = status.worst(code, jnp.where(0.5 * spall.width > end, status.CONVERGED, status.NARROW))
            known = spall.length <= atlas.lengths[-1]
            code = status.worst(code, jnp.where(known, status.CONVERGED, status.UNKNOWN_LENGTH))
        return code

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`."""
        beside = _ramp(self.atlases[self.which[number]], self.contact, spall, jnp.zeros(()))
        return ramp.extent(beside, approach)


def _change(atlas: Atlas, contact: LineContact, spall: Spall | None) -> jax.Array:
    """Of the inputs that the atlas carries along slopes: all but length, width and distance."""
    now = None if spall is None else dataclasses.replace(spall, length=0.0, width=0.0)
    return nodes.inputs(contact, now, 0.0) - atlas.given


def _healthy(atlas: Atlas, contact: LineContact, change: jax.Array) -> Healthy:
    approaches, solved = atlas.healthy + atlas.healthy_slopes @ change, nodes.contact_of(atlas.given)
    return direct.healthy_level(contact, solved, atlas.log_loads, approaches, atlas.half_width)


def _fulls(atlas: Atlas, contact: LineContact, like: Spall, change: jax.Array) -> Curve:
    """Curves over the middle of spalls of all lengths of the atlas, shape (lengths,)."""
    crowns = jax.vmap(lambda length: direct.shift_over(contact, dataclasses.replace(like, length=length)))
    approaches = atlas.full + atlas.full_slopes @ change
    return curve.through(atlas.log_loads, approaches.T, crowns(atlas.lengths))


def _ramp(atlas: Atlas, contact: LineContact, spall: Spall, edge: jax.Array) -> Ramp:
    """The ramp of this spall with its edge `edge` [mm] beyond the roller."""
    change = _change(atlas, contact, spall)
    length = jnp.asarray(spall.length, float)
    at = curve.weights(atlas.lengths, length)
    fulls = _fulls(atlas, contact, spall, change)
    full = Curve(fulls.coefficients @ at, at @ fulls.middle, at @ fulls.reach, direct.shift_over(contact, spall))
    longer = jnp.log(jnp.maximum(length, jnp.exp(atlas.edge_lengths[0])))
    share = atlas.share + atlas.share_slopes @ change
    at_edge = curve.weights(atlas.edge_lengths, longer)
    return _healthy(atlas, contact, change).beside(edge, full, at @ atlas.sunk, jnp.tensordot(at_edge, share, 1))


def table_law(
    contact: LineContact,
    largest: float,
    spalls: tuple[Spall, ...],
    accuracy: float = 1e-3,
    progress: Progress | None = None,
) -> TableLaw:
    """The table for `spalls` of any length and width: from the user's cache folder, or built and kept there.

    Args:
      contact: from `LineContact.of`.
      largest: estimate of the largest roller load [N]. Tables reach 1.3 times it or more: the design load halved or
        doubled so often, so that neighbouring scenes share one.
      spalls: of each, depth and axial offset are tabulated.
      accuracy: relative accuracy of every contact solve, 1e-2…1e-5.
      progress: told how many of how many solves are done, in each of three rounds.
    """
    contact = as_floats(contact)
    unit = float(contact.design_load) or 1000.0
    top = unit * 2.0 ** float(np.ceil(np.log2(direct.MARGIN * largest / unit)))
    kinds: list[tuple[float, float]] = []
    for spall in spalls:
        kind = float(spall.depth), float(spall.axial_offset)
        if kind not in kinds:
            kinds.append(kind)
    made = []
    for depth, axial_offset in kinds:
        numbers = *jax.tree.leaves(contact), top, depth, axial_offset, accuracy
        arrays = store.kept(
            store.key(numbers, MAKERS),
            partial(_arrays, contact, top, depth, axial_offset, accuracy, progress),
        )
        made.append(Atlas(**{name: jnp.asarray(value) for name, value in arrays.items()}))
    which = tuple(kinds.index((float(s.depth), float(s.axial_offset))) for s in spalls)
    return TableLaw(contact, tuple(made), which)


def _arrays(*arguments: Any) -> store.Arrays:
    built = atlas(*arguments)
    return {field.name: np.asarray(getattr(built, field.name)) for field in dataclasses.fields(built)}


def atlas(
    contact: LineContact,
    top: float,
    depth: float,
    axial_offset: float,
    accuracy: float = 1e-3,
    progress: Progress | None = None,
) -> Atlas:
    """Build the table for one contact and one depth and axial offset [mm] of spalls.

    Args:
      contact: from `LineContact.of`. top: the largest load of the table [N]; it begins at a three-hundredth.
      accuracy: relative accuracy of every contact solve, 1e-2…1e-5.
      progress: told how many of how many solves are done, in each of three rounds.

    Needs numbers, not tracers.
    """
    loads = direct.log_loads(top)
    longest = LENGTH_SHARE * float(contact.length)
    lengths = np.asarray(curve.chebyshev(LENGTHS, 0.0, longest))
    like = direct.wide(Spall(0.0, 0.0, depth, axial_offset=axial_offset))
    shapes = [dataclasses.replace(like, length=float(length)) for length in lengths[1:]]
    levels = direct.solved_levels(contact, shapes, loads, accuracy, progress)
    below = np.stack([direct.sunk(contact, level, loads) for level in levels[1:]])
    built = Atlas(
        given=nodes.inputs(contact, dataclasses.replace(like, width=0.0), 0.0),
        log_loads=jnp.asarray(loads),
        healthy=_values(levels)[0],
        healthy_slopes=_slopes(levels)[0],
        half_width=jnp.asarray(direct.extents(loads, np.array([node.half_width for node in levels[0]]))),
        lengths=jnp.asarray(lengths),
        full=_values(levels),
        full_slopes=_slopes(levels),
        sunk=jnp.asarray(np.concatenate([_at_zero(lengths, below)[None], below])),
        edge_lengths=curve.chebyshev(EDGE_LENGTHS, np.log(SHORTEST * longest), np.log(longest)),
        share=jnp.broadcast_to(ramp.guess(DEGREE), (EDGE_LENGTHS, DEGREE + 1, ramp.TERMS)),
        share_slopes=jnp.zeros((EDGE_LENGTHS, DEGREE + 1, ramp.TERMS, nodes.INPUTS)),
        error=np.nan,
        status_code=nodes.worst_status([node for level in levels for node in level]),
    )
    built = _with_edges(contact, built, like, accuracy, progress)
    return dataclasses.replace(built, error=_error(contact, built, like, accuracy, progress))


def _at_zero(lengths: np.ndarray, below: np.ndarray) -> np.ndarray:
    """What the first two spalls say of none at all: it has no middle to tell it."""
    return below[0] - (below[1] - below[0]) * lengths[1] / (lengths[2] - lengths[1])


def _values(levels: list[list[Node]]) -> jax.Array:
    return jnp.asarray([[node.approach for node in level] for level in levels])


def _slopes(levels: list[list[Node]]) -> jax.Array:
    """By everything but length, width and distance, which the table has as variables."""
    slopes = np.array([[node.slopes for node in level] for level in levels])
    slopes[..., [4, 5, 8]] = 0.0
    return jnp.asarray(slopes)


def _with_edges(contact: LineContact, built: Atlas, like: Spall, accuracy: float, progress: Progress | None) -> Atlas:
    """The atlas with its ramps fitted to contact solves."""
    lengths = np.exp(built.edge_lengths)
    loads, edges = map(np.array, zip(*[_aims(built, contact, length) for length in lengths], strict=True))
    width = 4.0 * float(edges.max())
    cases = [
        Case(float(q), dataclasses.replace(like, length=float(length), width=width), 0.5 * width - float(edge))
        for length, *aims in zip(lengths, loads, edges, strict=True)
        for q, edge in zip(*map(np.ravel, aims), strict=True)
    ]
    solved = nodes.all_solved(contact, cases, accuracy, progress)
    approaches, compliances = (
        np.array([getattr(node, name) for node in solved]).reshape(loads.shape) for name in ("approach", "compliance")
    )
    slopes = _slopes([solved]).reshape(*loads.shape, nodes.INPUTS)
    by_edge = np.array([node.slopes[-1] for node in solved]).reshape(loads.shape) / compliances  # edge = −distance
    shares, by_inputs = zip(
        *[_fit(built, contact, *row) for row in zip(lengths, loads, edges, approaches, by_edge, slopes, strict=True)],
        strict=True,
    )
    code = max(float(built.status_code), nodes.worst_status(solved))
    return dataclasses.replace(built, share=jnp.stack(shares), share_slopes=jnp.stack(by_inputs), status_code=code)


@jax.jit
def _aims(built: Atlas, contact: LineContact, length: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Loads [N] and places of the edge [mm] at which the ramp of spalls of this length is solved, shape (loads,
    places): the first and the last place lie just beyond the ramp, the others at the same t for all loads, nearly."""
    beside = _plain(built, contact, length)
    spread = 0.5 * ramp.LAST * (1.0 - np.cos(np.pi * (np.arange(EDGE_PLACES) + 0.5) / EDGE_PLACES))

    def at(load: jax.Array) -> tuple[jax.Array, jax.Array]:
        ends = curve.approach(beside.healthy, load), curve.approach(beside.full, load)

        def edge(t: jax.Array) -> jax.Array:
            def halve(_: int, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
                middle = jnp.sqrt(ends[0] * ends[1])
                more = ramp.guessed(*ramp.between(beside, middle)[:2], t) > load
                return jnp.where(more, ends[0], middle), jnp.where(more, middle, ends[1])

            low, high = ramp.extent(beside, jax.lax.fori_loop(0, 40, halve, ends)[0])
            return low + (high - low) * t

        (low, _), (_, high) = (ramp.extent(beside, end) for end in ends)
        places = jnp.concatenate([BESIDE * low[None], jax.vmap(edge)(jnp.asarray(spread)), BESIDE * high[None]])
        return jnp.broadcast_to(load, places.shape), places

    top = built.log_loads[-1]
    return jax.vmap(at)(jnp.exp(curve.chebyshev(EDGE_LOADS, top - np.log(ramp.LEAST), top)))


@jax.jit
def _fit(
    built: Atlas, contact: LineContact, length: jax.Array, loads: jax.Array, edges: jax.Array, approaches: jax.Array,
    by_edge: jax.Array, slopes: jax.Array,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """A ramp's share, shape (powers, terms), and its slopes by the inputs, of solves at `_aims`."""
    beside = _plain(built, contact, length)
    # the levels that edges join, as these solves have them and as the curves do
    first = curve.approach(beside.healthy, loads[:, :1]) / approaches[:, :1]
    last = curve.approach(beside.full, loads[:, :1]) / approaches[:, -1:]
    way = (approaches - approaches[:, :1]) / (approaches[:, -1:] - approaches[:, :1])
    approaches = approaches * (first * (1.0 - way) + last * way)
    load, edge, approach, by_edge = (field[:, 1:-1].ravel() for field in (loads, edges, approaches, by_edge))
    carried = slopes[:, 1:-1].reshape(-1, nodes.INPUTS)
    at = dataclasses.replace(beside, edge=edge)
    share = ramp.fitted(at, approach, load, by_edge, DEGREE)

    def off(change: jax.Array) -> jax.Array:
        now = built.given + change
        here = _ramp(built, nodes.contact_of(now), dataclasses.replace(nodes.spall_of(now), length=length), edge)
        return ramp.residual(dataclasses.replace(here, share=share), approach + carried @ change, load)

    matrix = ramp.equations(at, approach, load, DEGREE)
    return share, ramp.least_squares(matrix, -jax.jacfwd(off)(jnp.zeros(nodes.INPUTS))).reshape(*share.shape, -1)


def _plain(built: Atlas, contact: LineContact, length: jax.Array) -> Ramp:
    """The ramp beside a spall of this length as the atlas knows it, its edge under the roller's middle."""
    return _ramp(built, contact, dataclasses.replace(nodes.spall_of(built.given), length=length), jnp.zeros(()))


@jax.jit
def _extent(built: Atlas, contact: LineContact, length: jax.Array, load: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where the ramp begins and ends [mm] for a roller that carries `load` [N] over the middle of the spall."""
    beside = _plain(built, contact, length)
    return ramp.extent(beside, curve.approach(beside.full, load))


def _error(contact: LineContact, built: Atlas, like: Spall, accuracy: float, progress: Progress | None) -> float:
    """See `Atlas.error`: at random points in the middle of spalls, and with an edge on the ramp."""
    rng = np.random.default_rng(0)
    table = TableLaw(contact, (built,), (0,))
    top, longest = float(built.log_loads[-1]), float(built.lengths[-1])
    cases = []
    for k in range(CHECKS):
        length, load = longest * rng.uniform(0.05, 1.0), float(np.exp(top - rng.uniform(0.0, np.log(30.0))))
        low, high = map(float, _extent(built, contact, length, load))
        shape = dataclasses.replace(like, length=length, width=4.0 * high)
        cases.append(Case(load, shape, 2.0 * high - rng.uniform(low, high) if k % 2 else 0.0))
    solved = nodes.all_solved(contact, cases, accuracy, progress)
    worst = 0.0
    for case, node in zip(cases, solved, strict=True):
        found, _ = _one(table, node.approach, case.spall, case.distance)
        sound, _ = _one(table, node.approach)
        worst = max(worst, abs(float(found) - case.load) / float(sound))
    return worst


_one = jax.jit(load_over)
