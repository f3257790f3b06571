"""The smooth roller law: a table of contact solves over load, spall length and the place of a spall's rolling edge.

At a load Q the approach is δ = δₕ + (δₛ − δₕ) S(t): healthy, in the middle of the spall, and the share S of the way
that an edge at t has let the roller down. t runs from 0, where the edge enters the contact, to 1, where the roller
leaves the land beyond it; both places are known (the healthy half-width; where the roller over the spall's middle
stands level with the raceway), so S is smooth, flat at both ends, nearly the same for all loads and lengths, and few
solves are enough. Beyond 0 and 1 the roller is healthy or over the spall, exactly.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb import curve, direct, nodes, status, store
from difftrb.curve import Curve
from difftrb.direct import ASIDE, MOVED
from difftrb.geometry import LineContact, Real, Spall, as_floats
from difftrb.law import LENGTH_SHARE, curve_over, spalls_under
from difftrb.nodes import Case, Node, Progress

LENGTHS = 10
EDGE_LOADS = 3
EDGE_LOAD_RANGE = 60.0
"""Largest by smallest load at which edges are solved; below, S is as at the smallest: such loads matter little."""
EDGE_LENGTHS = 4
EDGE_PLACES = 10
DEGREE = 6
"""Of the polynomial that S carries beside its ends: less than there are places, because each has value and slope."""
SHORTEST = 0.04
"""Shortest spall whose edges are solved, as a share of the longest; shorter ones follow the curves of the longer."""
BESIDE = 1.03
"""How far beyond its ends the ramp is solved to find the levels it joins, both on one and the same grid."""
CHECKS = 24
MAKERS = (
    "contact", "curve", "direct", "domain", "edges", "gap", "geometry", "given", "halfspace", "hertz", "implicit",
    "law", "nodes", "press", "rows", "special", "strip_model", "strips", "table",
)  # fmt: skip
"""Modules that a table is made by: a change in one makes another table."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["given", "log_loads", "healthy", "healthy_slopes", "lengths", "full", "full_slopes", "low", "high",
                 "edge_lengths", "edge_loads", "ramp", "ramp_slopes", "error", "status_code"],
    meta_fields=[],
)  # fmt: skip
@dataclasses.dataclass(frozen=True)
class Atlas:
    """Approaches [mm] of a roller beside and over spalls of one depth and axial offset.

    Attributes:
      given: `nodes.inputs` of contact and spall as solved, length and width 0, shape (inputs,).
      log_loads: of the nodes [log N], shape (loads,).
      healthy, healthy_slopes: shape (loads,) and, by the inputs, (loads, inputs).
      lengths: of spalls [mm], Chebyshev–Lobatto, the first 0, shape (lengths,).
      full, full_slopes: over a spall's middle, shape (lengths, loads), (lengths, loads, inputs).
      low: distance of the rolling edge from the roller's middle at which the ramp begins [mm], positive over the spall,
        shape (loads,). high: that at which it ends, its square by `full` [mm], shape (lengths, loads).
      edge_lengths: of spalls [mm], shape (edge lengths,). edge_loads: [log N], shape (edge loads,).
      ramp, ramp_slopes: Chebyshev coefficients of (S − 3t² + 2t³)/(t²(1−t)²) in 2t − 1, shape (edge lengths,
        coefficients, edge loads) and (…, inputs).
      error: largest relative error of a load against contact solves at random points that the table was not built from.
      status_code: worst status of all solves.
    """

    given: jax.Array
    log_loads: jax.Array
    healthy: jax.Array
    healthy_slopes: jax.Array
    lengths: jax.Array
    full: jax.Array
    full_slopes: jax.Array
    low: jax.Array
    high: jax.Array
    edge_lengths: jax.Array
    edge_loads: jax.Array
    ramp: jax.Array
    ramp_slopes: jax.Array
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

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array, expected: jax.Array) -> Curve:
        """See `Law`. Besides the middle of every spall, only the two rollers next to its edges have curves of their
        own: rollers are farther apart than a ramp is long."""
        atlas = self.atlases[0]
        columns, shifts, log_loads = [self._healthy(atlas)], [jnp.zeros(())], [atlas.log_loads]
        index = jnp.maximum(3 * spalls_under(spalls, distances) - 2, 0)  # of the middles of spalls: 1, 4, …
        for i, spall in enumerate(spalls):
            atlas = self.atlases[self.which[i]]
            over = 0.5 * spall.width - jnp.abs(distances[i])
            levels = self._levels(atlas, spall)
            columns.append(levels.crown + jnp.exp(levels.log_healthy + levels.excess))
            shifts.append(levels.crown)
            log_loads.append(atlas.log_loads)
            for k, side in enumerate((1.0, -1.0)):
                next_to = jnp.argmin(jnp.abs(distances[i] - side * 0.5 * spall.width)) == jnp.arange(over.size)
                load = jnp.sum(jnp.where(next_to, expected, 0.0))  # no gather: slow in a batch
                about = direct.around(load, atlas.log_loads[0], atlas.log_loads[-1])
                state, shift = _at_edge(atlas, levels, jnp.sum(jnp.where(next_to, over, 0.0)), about)
                columns.append(state)
                shifts.append(shift)
                log_loads.append(about)
                own = next_to & (over > atlas.low[-1]) & ((index == 0) | (index == 3 * i + 1))
                index = jnp.where(own, 3 * i + 2 + k, index)
        curves = curve.through(jnp.stack(log_loads, axis=1), jnp.stack(columns, axis=1), jnp.stack(shifts))
        return curve.chosen(curves, index)

    def _healthy(self, atlas: Atlas) -> jax.Array:
        change = nodes.inputs(self.contact, None, 0.0) - atlas.given
        return atlas.healthy + atlas.healthy_slopes @ change

    def _change(self, atlas: Atlas, spall: Spall) -> jax.Array:
        return nodes.inputs(self.contact, dataclasses.replace(spall, length=0.0, width=0.0), 0.0) - atlas.given

    def _levels(self, atlas: Atlas, spall: Spall) -> _Levels:
        change = self._change(atlas, spall)
        length = jnp.asarray(spall.length, float)
        at, at_edge = curve.weights(atlas.lengths, length), curve.weights(atlas.edge_lengths, length)
        healthy = self._healthy(atlas)

        def crown(length: jax.Array) -> jax.Array:
            return direct.shift_over(self.contact, dataclasses.replace(spall, length=length))

        carried = atlas.full + atlas.full_slopes @ change - jax.vmap(crown)(atlas.lengths)[:, None]
        return _Levels(
            jnp.log(healthy), crown(length), at @ jnp.log(carried / healthy[None]), _ramp_end(atlas, length),
            jnp.tensordot(at_edge, atlas.ramp + atlas.ramp_slopes @ change, 1),
        )  # fmt: skip

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array) -> jax.Array:
        """See `Law`: spalls up to 85 % of the roller long, wider than the contact, of a depth and axial offset that
        the table was built for, on a contact that is the table's or a neighbour of it."""
        code = jnp.asarray(status.CONVERGED)
        for i, spall in enumerate(spalls):
            if i >= len(self.which):
                return jnp.asarray(status.OTHER_SCENE)
            atlas = self.atlases[self.which[i]]
            change = self._change(atlas, spall)
            moved = jnp.max(jnp.abs(atlas.full_slopes @ change / atlas.full))
            deepest = jnp.max(atlas.full)
            deep = (spall.depth > deepest) & (atlas.given[-3] > deepest)
            same = (moved < MOVED) & (deep | (jnp.abs(change[-3]) < MOVED * atlas.given[-3]))
            same = same & (jnp.abs(change[-2]) < ASIDE)
            code = status.worst(code, jnp.where(same, status.CONVERGED, status.OTHER_SCENE))
            wide = 0.5 * spall.width > _ramp_end(atlas, jnp.asarray(spall.length, float))[-1]
            code = status.worst(code, jnp.where(wide, status.CONVERGED, status.NARROW))
            known = spall.length <= atlas.lengths[-1]
            code = status.worst(code, jnp.where(known, status.CONVERGED, status.UNKNOWN_LENGTH))
        return code

    def ramp(self, number: int, spall: Spall, load: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`."""
        atlas = self.atlases[self.which[number]]
        high = _ramp_end(atlas, jnp.asarray(spall.length, float))
        at = jnp.log(jnp.maximum(load, 1e-300))
        return jnp.interp(at, atlas.log_loads, atlas.low), jnp.interp(at, atlas.log_loads, high)


def _ramp_end(atlas: Atlas, length: jax.Array) -> jax.Array:
    """Where the ramp ends beside a spall of this length, at every load [mm]; of the contact as it was solved."""
    shape = nodes.spall_of(atlas.given)
    contact = nodes.contact_of(atlas.given)

    def crown(length: jax.Array) -> jax.Array:
        return direct.shift_over(contact, dataclasses.replace(shape, length=length))

    at = curve.weights(atlas.lengths, length)
    excess = (atlas.full - jax.vmap(crown)(atlas.lengths)[:, None]) / atlas.healthy[None]
    full = crown(length) + atlas.healthy * jnp.exp(at @ jnp.log(excess))
    return jnp.sqrt((at @ atlas.high) * full)


class _Levels(NamedTuple):
    """One spall in an atlas: logarithms of the healthy approach and, relative to it, of what the approach over the
    spall's middle exceeds the crown by; the end of the ramp; each of shape (loads,); crown [mm]; ramp's coefficients,
    shape (coefficients, edge loads)."""

    log_healthy: jax.Array
    crown: jax.Array
    excess: jax.Array
    high: jax.Array
    ramp: jax.Array


def _at_edge(atlas: Atlas, levels: _Levels, over: jax.Array, log_loads: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Approaches at `log_loads` [log N] with an edge `over` [mm] beyond the roller, and their curve's shift."""
    at = curve.weights(atlas.log_loads, log_loads)
    healthy = jnp.exp(at @ levels.log_healthy)
    full = levels.crown + healthy * jnp.exp(at @ levels.excess)
    low, high = at @ atlas.low, at @ levels.high
    at_edge = curve.weights(atlas.edge_loads, jnp.maximum(log_loads, atlas.edge_loads[0]))
    share = _share(levels.ramp @ at_edge.T, jnp.clip((over - low) / (high - low), 0.0, 1.0))
    return healthy + (full - healthy) * share, levels.crown * jnp.clip(share[0], 0.0, 1.0)


def _share(ramp: jax.Array, t: jax.Array) -> jax.Array:
    """S at places `t` in 0…1, shape (loads,), of coefficients of shape (coefficients, loads)."""
    x = 2.0 * t - 1.0
    one, two = jnp.zeros_like(t), jnp.zeros_like(t)
    for c in ramp[:0:-1]:  # Clenshaw
        one, two = 2.0 * x * one - two + c, one
    series = x * one - two + ramp[0]
    return t * t * (3.0 - 2.0 * t + (1.0 - t) ** 2 * series)


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
      accuracy: relative accuracy of every contact solve, 1e-2…1e-4.
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
      contact: from `LineContact.of`. top: the largest load of the table [N]; it begins at a thousandth.
      accuracy: relative accuracy of every contact solve, 1e-2…1e-4.
      progress: told how many of how many solves are done, in each of three rounds.

    Needs numbers, not tracers.
    """
    loads = direct.log_loads(top)
    longest = LENGTH_SHARE * float(contact.length)
    lengths = np.asarray(curve.chebyshev(LENGTHS, 0.0, longest))

    def spall(length: float, width: float = 1000.0) -> Spall:
        return Spall(length, width, depth, axial_offset=axial_offset)

    shapes = [None, *(spall(length) for length in lengths[1:])]
    solved = nodes.all_solved(contact, [Case(np.exp(q), shape) for shape in shapes for q in loads], accuracy, progress)
    levels = _grid(solved, LENGTHS, loads.size)
    low = -np.array([node.half_width for node in levels[0]])
    high = np.array([[node.reach for node in row] for row in levels])
    high = high**2 / np.array([[node.approach for node in row] for row in levels])
    high[0] = high[1] - (high[2] - high[1]) * lengths[1] / (lengths[2] - lengths[1])  # it has no middle to tell it

    built = Atlas(
        given=nodes.inputs(contact, spall(0.0, 0.0), 0.0),
        log_loads=jnp.asarray(loads),
        healthy=_values(levels[0]),
        healthy_slopes=_slopes(levels[0]),
        lengths=jnp.asarray(lengths),
        full=jnp.stack([_values(row) for row in levels]),
        full_slopes=jnp.stack([_slopes(row) for row in levels]),
        low=jnp.asarray(low),
        high=jnp.asarray(high),
        edge_lengths=curve.chebyshev(EDGE_LENGTHS, SHORTEST * longest, longest),
        edge_loads=curve.chebyshev(EDGE_LOADS, loads[-1] - np.log(EDGE_LOAD_RANGE), loads[-1]),
        ramp=jnp.zeros((EDGE_LENGTHS, DEGREE + 1, EDGE_LOADS)),
        ramp_slopes=jnp.zeros((EDGE_LENGTHS, DEGREE + 1, EDGE_LOADS, nodes.INPUTS)),
        error=np.nan,
        status_code=nodes.worst_status(solved),
    )

    edge_lengths, edge_loads = np.asarray(built.edge_lengths), np.asarray(built.edge_loads)
    places = np.asarray(curve.chebyshev(EDGE_PLACES, 0.0, 1.0))
    begins = np.asarray(curve.weights(loads, edge_loads)) @ low
    onto = np.asarray(curve.weights(loads, edge_loads))
    ends = np.stack([onto @ np.asarray(_ramp_end(built, length)) for length in jnp.asarray(edge_lengths)])
    furthest = float(np.max(ends))
    cases = []
    for i, length in enumerate(edge_lengths):
        for j, q in enumerate(edge_loads):
            edges = begins[j] + (ends[i, j] - begins[j]) * places
            edges[0], edges[-1] = BESIDE * edges[0], BESIDE * edges[-1]
            width = 4.0 * furthest
            cases.extend(Case(float(np.exp(q)), spall(float(length), width), 0.5 * width - e) for e in edges)
    beside = nodes.all_solved(contact, cases, accuracy, progress)
    ramp, ramp_slopes = _ramps(_grid(beside, EDGE_LENGTHS, EDGE_LOADS, EDGE_PLACES), places, ends - begins[None, :])
    built = dataclasses.replace(
        built,
        ramp=jnp.asarray(ramp),
        ramp_slopes=jnp.asarray(ramp_slopes),
        status_code=max(built.status_code, nodes.worst_status(beside)),
    )
    error = _error(contact, built, spall(1.0), accuracy, progress)
    return dataclasses.replace(built, error=error)


def _grid(solved: list[Node], *shape: int) -> np.ndarray:
    grid = np.empty(len(solved), object)
    grid[:] = solved
    return grid.reshape(shape)


def _values(row: np.ndarray) -> jax.Array:
    return jnp.asarray([node.approach for node in row])


def _slopes(row: np.ndarray) -> jax.Array:
    """By everything but length, width and distance, which the table has as variables."""
    slopes = np.array([node.slopes for node in row])
    slopes[:, [4, 5, 8]] = 0.0
    return jnp.asarray(slopes)


def _ramps(solved: np.ndarray, places: np.ndarray, extents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of every ramp and their slopes, shape (lengths, coefficients, loads) and (…, inputs), by least
    squares over values and slopes of S; solves that stand out are weighed down."""
    inner = places[1:-1]
    window = inner**2 * (1.0 - inner) ** 2
    window_rate = 2.0 * inner * (1.0 - inner) * (1.0 - 2.0 * inner)
    basis = np.polynomial.chebyshev.chebvander(2.0 * inner - 1.0, DEGREE)
    rates = np.stack(
        [2.0 * np.polynomial.chebyshev.chebval(2.0 * inner - 1.0, np.polynomial.chebyshev.chebder(row))
         for row in np.eye(DEGREE + 1)], axis=1,
    )  # fmt: skip
    values = window[:, None] * basis
    slopes = window_rate[:, None] * basis + window[:, None] * rates
    scale = 0.1  # a slope's weight beside a value's: about the distance between places
    matrix = np.concatenate([values, scale * slopes])
    lengths, loads, _ = solved.shape
    ramp = np.zeros((lengths, DEGREE + 1, loads))
    by_inputs = np.zeros((*ramp.shape, nodes.INPUTS))
    for i, j in np.ndindex(lengths, loads):
        row = solved[i, j]
        approach = np.array([node.approach for node in row])
        by = np.array([node.slopes for node in row])
        drop = approach[-1] - approach[0]
        share = (approach[1:-1] - approach[0]) / drop
        rate = -by[1:-1, -1] * extents[i, j] / drop  # the distance falls as the edge goes over
        right = np.concatenate([
            share - inner**2 * (3.0 - 2.0 * inner), scale * (rate - 6.0 * inner * (1.0 - inner))
        ])  # fmt: skip
        lost = (inner > 0.3) & (rate < 1e-3)  # the contact beyond the edge, though the roller is below the raceway
        weight = trusted = np.tile(np.where(lost, 0.0, 1.0), 2)
        for _ in range(8):
            ramp[i, :, j] = np.linalg.lstsq(weight[:, None] * matrix, weight * right, rcond=None)[0]
            off = np.abs(matrix @ ramp[i, :, j] - right)
            weight = trusted / np.sqrt(1.0 + (off / (3.0 * np.median(off) + 1e-9)) ** 2)
        change = (by[1:-1] - by[0] - share[:, None] * (by[-1] - by[0])) / drop
        change[:, [4, 5, 8]] = 0.0
        few = DEGREE - 1
        by_inputs[i, :few, j] = np.linalg.lstsq(values[~lost, :few], change[~lost], rcond=None)[0]
    return ramp, by_inputs


def _error(contact: LineContact, built: Atlas, like: Spall, accuracy: float, progress: Progress | None) -> float:
    """Largest relative error of a load at random points: in the middle of spalls, and with an edge on the ramp."""
    rng = np.random.default_rng(0)
    table = TableLaw(contact, (built,), (0,))
    top, longest = float(built.log_loads[-1]), float(built.lengths[-1])
    cases = []
    for k in range(CHECKS):
        length, load = longest * rng.uniform(0.05, 1.0), top - rng.uniform(0.0, np.log(30.0))
        high = float(_ramp_end(built, jnp.asarray(length))[-1])
        width = 4.0 * high
        edge = rng.uniform(float(built.low[-1]), high) if k % 2 else 0.5 * width
        shape = dataclasses.replace(like, length=length, width=width)
        cases.append(Case(float(np.exp(load)), shape, 0.5 * width - edge))
    solved = nodes.all_solved(contact, cases, accuracy, progress)
    worst = 0.0
    for case, node in zip(cases, solved, strict=True):
        assert case.spall is not None
        own = _one(table, case.spall, jnp.asarray(case.distance), jnp.asarray(case.load))
        found, _ = curve.load(own, jnp.asarray(node.approach))
        worst = max(worst, abs(float(found) / case.load - 1.0))
    return worst


_one = jax.jit(curve_over)
