"""The smooth roller law as it is built and kept: contact solves over load and spall length, and at spalls' edges.

Healthy, and over the middle of spalls of several lengths, contacts are solved at the same loads for `atlas`'s curves to
go through; ramps are fitted to solves at several lengths, approaches and places of the edge. The error is measured at
random contacts that it was not built from.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import status, storage
from difftrb.core.geometry import LineContact, Spall, as_floats
from difftrb.core.numeric import chebyshev_nodes, chebyshev_roots
from difftrb.law import base, direct, edge_ramp, load_curve, ramp_fit, samples
from difftrb.law.base import LENGTH_SHARE, Law, LawKind, Request
from difftrb.law.samples import AT, Case, Node, Progress
from difftrb.law.table_data import (
    CHECKS,
    LIGHTEST,
    NARROW_CHECKS,
    Atlas,
    TableLaw,
    measured_error,
    narrow_error,
    plain_ramp,
    ramp_of,
    shortest,
    spread,
)

LENGTHS = 13


class EdgeNodes(NamedTuple):
    """How many lengths, approaches and places of the edge ramps are fitted to, and how many times as long as another
    contact one there takes."""

    lengths: int
    approaches: int
    places: int
    takes: float


EDGE_NODES = EdgeNodes(6, 4, 8, 3.0)
FINER_NODES = EdgeNodes(8, 5, 10, 9.0)
"""For `direct.FINER_FROM` on."""
SHORTEST = 0.04
"""Shortest spall whose edges are solved, as a share of the longest; shorter ones have its share."""
BESIDE = 1.03
"""How far beyond its ends the ramp is solved to find the levels it joins, both on one and the same grid."""
SURELY = 1.2
"""By what squares of half-widths have to differ for a spall to be wide without asking."""


def edge_nodes(accuracy: float) -> EdgeNodes:
    """Of a table with contacts of this accuracy."""
    return FINER_NODES if accuracy <= direct.FINER_FROM else EDGE_NODES


def effort(accuracy: float) -> float:
    """Contact solves of one table, those at edges counted by the time that they take."""
    of = edge_nodes(accuracy)
    return LENGTHS * direct.LOADS + of.takes * of.lengths * of.approaches * (of.places + 2) + CHECKS


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
      spalls: of each, the axial offset is tabulated. Tables hold for deep spalls only.
      accuracy: relative accuracy of contact solves, 1e-2…1e-5; see `direct.accuracy_at_edges`.
      progress: told how many of how many solves are done, in each of three rounds.
    """
    contact = as_floats(contact)
    unit = float(contact.design_load) or 1000.0
    top = unit * 2.0 ** float(np.ceil(np.log2(direct.MARGIN * largest / unit)))
    offsets = list(dict.fromkeys(float(spall.axial_offset) for spall in spalls))
    made = []
    numbers = [(*jax.tree.leaves(contact), top, offset, accuracy) for offset in offsets]
    for offset, own in zip(offsets, numbers, strict=True):
        arrays = storage.kept(storage.key(own), partial(_arrays, contact, top, offset, accuracy, progress))
        made.append(Atlas(**{name: jnp.asarray(value) for name, value in arrays.items()}))
    which = tuple(offsets.index(float(spall.axial_offset)) for spall in spalls)
    law = TableLaw(contact, tuple(made), which)
    errors = [
        storage.kept(
            storage.key((*numbers[k], NARROW_CHECKS)),
            partial(narrow_error, contact, made[k], samples.spall_of(made[k].given), accuracy, progress),
        )["error"]
        for k in {k for k, spall in zip(which, spalls, strict=True) if _is_narrow(law, k, spall)}
    ]
    return dataclasses.replace(law, narrow_error=float(max(errors))) if errors else law


def _is_narrow(law: TableLaw, kind: int, spall: Spall) -> bool:
    """Whether a law that is not made for both edges at once refuses the spall."""
    # no ramp ends beyond this square's root, so most need not be judged, which takes a tenth of a second
    farthest = 2.0 * float(law.contact.radius) * float(np.max(law.atlases[kind].full))
    if (0.5 * float(spall.width)) ** 2 > SURELY * farthest:
        return False
    return int(dataclasses.replace(law, which=(kind,)).judge((spall,), jnp.zeros((1, 1)))) == status.NARROW


def _arrays(*arguments: Any) -> storage.Arrays:
    built = atlas(*arguments)
    return {field.name: np.asarray(getattr(built, field.name)) for field in dataclasses.fields(built)}


def atlas(
    contact: LineContact,
    top: float,
    axial_offset: float,
    accuracy: float = 1e-3,
    progress: Progress | None = None,
) -> Atlas:
    """Build the table for one contact and one axial offset [mm] of deep spalls.

    Args:
      contact: from `LineContact.of`. top: the largest load of the table [N]; it begins at a three-hundredth.
      accuracy: relative accuracy of contact solves, 1e-2…1e-5; see `direct.accuracy_at_edges`.
      progress: told how many of how many solves are done, in each of three rounds.

    Needs numbers, not tracers.
    """
    loads = direct.log_loads(top)
    longest = LENGTH_SHARE * float(contact.length)
    ends = (float(spread(length, contact, top)) for length in (0.0, longest))
    places = np.asarray(chebyshev_nodes(LENGTHS, *ends))
    lengths = np.maximum(places**2 - float(shortest(contact, top)), 0.0)
    deep = float(contact.radius)  # no roller sinks as far: whether one meets a bottom is judged at rest
    like = direct.wide(Spall(0.0, 0.0, deep, axial_offset=axial_offset))
    shapes = [dataclasses.replace(like, length=float(length)) for length in lengths[1:]]
    levels = direct.solved_levels(contact, shapes, loads, accuracy, progress)
    of = edge_nodes(accuracy)
    below = np.stack([ramp_fit.sunk(contact, level, loads) for level in levels[1:]])
    built = Atlas(
        given=samples.inputs(contact, dataclasses.replace(like, width=0.0), 0.0),
        log_loads=jnp.asarray(loads),
        healthy=_values(levels)[0],
        healthy_slopes=_slopes(levels)[0],
        half_width=jnp.asarray(ramp_fit.extents(loads, np.array([node.half_width for node in levels[0]]))),
        lengths=jnp.asarray(lengths),
        full=_values(levels),
        full_slopes=_slopes(levels),
        sunk=jnp.asarray(np.concatenate([_at_zero(places, below)[None], below])),
        edge_lengths=chebyshev_nodes(of.lengths, np.log(SHORTEST * longest), np.log(longest)),
        share=jnp.broadcast_to(edge_ramp.guess(of.approaches - 1), (of.lengths, of.approaches, edge_ramp.TERMS)),
        share_slopes=jnp.zeros((of.lengths, of.approaches, edge_ramp.TERMS, samples.INPUTS)),
        error=np.nan,
        status_code=samples.worst_status([node for level in levels for node in level]),
    )
    built = _with_edges(contact, built, like, accuracy, progress)
    return dataclasses.replace(built, error=measured_error(contact, built, like, accuracy, progress))


def _at_zero(places: np.ndarray, below: np.ndarray) -> np.ndarray:
    """What the first two spalls say of none at all: it has no middle to tell it."""
    return below[0] - (below[1] - below[0]) * (places[1] - places[0]) / (places[2] - places[1])


def _values(levels: list[list[Node]]) -> jax.Array:
    return jnp.asarray([[node.approach for node in level] for level in levels])


def _slopes(levels: list[list[Node]]) -> jax.Array:
    """By everything but length, width and distance, which the table has as variables."""
    slopes = np.array([[node.slopes for node in level] for level in levels])
    slopes[..., [AT.spall_length, AT.spall_width, AT.distance]] = 0.0
    return jnp.asarray(slopes)


def _with_edges(contact: LineContact, built: Atlas, like: Spall, accuracy: float, progress: Progress | None) -> Atlas:
    """The atlas with its ramps fitted to contact solves."""
    lengths, of = np.exp(built.edge_lengths), edge_nodes(accuracy)
    loads, edges = map(np.array, zip(*[_aims(built, contact, length, of) for length in lengths], strict=True))
    width = 4.0 * float(edges.max())
    cases = [
        Case(float(q), dataclasses.replace(like, length=float(length), width=width), 0.5 * width - float(edge))
        for length, *aims in zip(lengths, loads, edges, strict=True)
        for q, edge in zip(*map(np.ravel, aims), strict=True)
    ]
    solved = samples.all_solved(contact, cases, direct.accuracy_at_edges(accuracy), progress)
    approaches, compliances = (
        np.array([getattr(node, name) for node in solved]).reshape(loads.shape) for name in ("approach", "compliance")
    )
    slopes = _slopes([solved]).reshape(*loads.shape, samples.INPUTS)
    by_edge = (
        np.array([node.slopes[AT.distance] for node in solved]).reshape(loads.shape) / compliances
    )  # edge = −distance
    shares, by_inputs = zip(
        *[_fit(built, contact, *row) for row in zip(lengths, loads, edges, approaches, by_edge, slopes, strict=True)],
        strict=True,
    )
    code = max(float(built.status_code), samples.worst_status(solved))
    return dataclasses.replace(built, share=jnp.stack(shares), share_slopes=jnp.stack(by_inputs), status_code=code)


@partial(jax.jit, static_argnums=3)
def _aims(built: Atlas, contact: LineContact, length: jax.Array, of: EdgeNodes) -> tuple[jax.Array, jax.Array]:
    """Loads [N] and places of the edge [mm] at which the ramp of spalls of this length is solved, shape (approaches,
    places + 2), at nearly the same approaches and the same t: the first and the last place lie just beyond the ramp."""
    beside = plain_ramp(built, contact, length)
    t = jnp.asarray(0.5 * ramp_fit.LAST * (1.0 - chebyshev_roots(of.places)))

    def at(load: jax.Array) -> tuple[jax.Array, jax.Array]:
        healthy, full, low, high = edge_ramp.between(beside, load_curve.approach(beside.healthy, load))
        least = LIGHTEST * healthy
        last = jnp.maximum(full, least)
        _, end = edge_ramp.extent(beside, load_curve.approach(beside.full, last))
        loads = jnp.maximum(edge_ramp.guessed(healthy, full, t), least)
        places = [BESIDE * low[None], low + (high - low) * t, BESIDE * end[None]]
        return jnp.concatenate([healthy[None], loads, last[None]]), jnp.concatenate(places)

    top = built.log_loads[-1]
    return jax.vmap(at)(jnp.exp(chebyshev_nodes(of.approaches, top - np.log(edge_ramp.LEAST), top)))


@jax.jit
def _fit(
    built: Atlas, contact: LineContact, length: jax.Array, loads: jax.Array, edges: jax.Array, approaches: jax.Array,
    by_edge: jax.Array, slopes: jax.Array,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """A ramp's share, shape (powers, terms), and its slopes by the inputs, of solves at `_aims`."""
    beside = plain_ramp(built, contact, length)
    # the levels that edges join, as these solves have them and as the curves do
    first = load_curve.approach(beside.healthy, loads[:, :1]) / approaches[:, :1]
    last = load_curve.approach(beside.full, loads[:, -1:]) / approaches[:, -1:]
    way = (loads - loads[:, :1]) / (loads[:, -1:] - loads[:, :1])
    approaches = approaches * (first * (1.0 - way) + last * way)
    load, edge, approach, by_edge = (field[:, 1:-1].ravel() for field in (loads, edges, approaches, by_edge))
    by_inputs = slopes[:, 1:-1].reshape(-1, samples.INPUTS)
    at, degree = dataclasses.replace(beside, edge=edge), loads.shape[0] - 1
    share = ramp_fit.fitted(at, approach, load, by_edge, degree)

    def off(change: jax.Array) -> jax.Array:
        now = built.given + change
        here = dataclasses.replace(
            ramp_of(built, samples.contact_of(now), dataclasses.replace(samples.spall_of(now), length=length)),
            edge=edge,
        )
        return ramp_fit.residual(dataclasses.replace(here, share=share), approach + by_inputs @ change, load)

    matrix = ramp_fit.equations(at, approach, load, degree)
    return share, ramp_fit.least_squares(matrix, -jax.jacfwd(off)(jnp.zeros(samples.INPUTS))).reshape(*share.shape, -1)


def _made(of: Request) -> Law:
    largest = float(of.largest)
    if of.spalls:
        return table_law(of.contact, largest, of.spalls, of.accuracy, of.progress)
    return direct.without_edges(of.contact, largest, (), of.accuracy, of.progress)


base.register(
    LawKind(
        "table",
        "curves and ramps through contact solves over load, spall length and place of the edge",
        make=_made,
        by_samples=True,
        inner=True,
        frozen=None,
        effort=effort,
    )
)
