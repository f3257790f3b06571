"""Q(δ) of every roller of a ring, or of every slice of one: which roller is over which spall, which stands on a ramp.

A roller on no ramp has a curve of its own. The roller nearest to a rolling edge has the edge's ramp.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import series
from difftrb.core.geometry import Spall
from difftrb.core.numeric import value_and_slope
from difftrb.core.taylor import Taylor
from difftrb.law import edge_ramp, load_curve
from difftrb.law.edge_ramp import Ramp
from difftrb.law.load_curve import Curve


class NearState(NamedTuple):
    """Load near one approach, as a polynomial in it that goes on straight beyond: of slices that push or pull, of which
    only a whole roller's are a contact.

    Attributes:
      coefficients: cₖ of Q = Σ cₖ zᵏ [N], z = (δ − middle)/reach, shape (degree + 1, …, slices).
      middle, reach: [mm], shape (…, slices).
    """

    coefficients: Any
    middle: Any
    reach: Any


class RollerCurves(NamedTuple):
    """Q(δ) of every roller of a ring, or of every slice of its rollers.

    Attributes:
      each: the curve of every roller that is on no ramp, shape (rollers,).
      ramps: along an axis behind every field's own; None: there is none.
      at: which roller stands on which ramp: ones in zeros, shape (ramps, rollers).
      near: what stands for all curves near the states that slices are in; None: nothing does.
    """

    each: Curve
    ramps: Ramp | None = None
    at: jax.Array | None = None
    near: NearState | None = None


def roller_loads(curves: RollerCurves, approach: Any) -> tuple[Any, Any]:
    """Load [N] and its slope [N/mm] of every roller at its approach [mm], all of shape (rollers,)."""
    return value_and_slope(partial(carried_loads, curves), approach)


def carried_loads(curves: RollerCurves, approach: Any) -> Any:
    """Load [N] of every roller at its approach [mm], both of shape (rollers,)."""
    if curves.near is not None:
        coefficients, middle, reach = curves.near
        return series.polynomial(coefficients, (approach - middle) / reach, straight=True)
    loads = load_curve.carried(curves.each, approach)
    if curves.ramps is None or curves.at is None:
        return loads
    # products of matrices, for what one of them takes is computed once and not for every roller
    there = edge_ramp.carried(curves.ramps, xp.einsum("e...r,...r->e...", curves.at, approach))
    return loads * (1.0 - curves.at.sum(axis=0)) + xp.einsum("e...,e...r->...r", there, curves.at)


def expanded_loads(curves: RollerCurves, approach: Any) -> Taylor:
    """Load of every roller [N] as an expansion by parameters and, last, by its approach: `approach` [mm] holds how it
    changes with the parameters alone."""
    variable, curves = xp.with_variable(approach, curves)
    return carried_loads(curves, variable)


def spalls_under(spalls: tuple[Spall, ...], distances: Any) -> Any:
    """Which spall every roller is over, counted from 1; 0 is none; shape (…, rollers).

    A hard window: a roller is over a spall while the middle of its contact is, so width changes only the number of
    rollers inside. Of several spalls the longest counts. `distances` as in `Law`.
    """
    away, spalls = xp.values((distances, spalls))
    of = xp.module_of(away, *jax.tree.leaves(spalls))
    over = of.zeros(away.shape[1:], int)
    longest = of.full(away.shape[1:], -1.0)  # a spall of no length counts: its curve is healthy, its slope is not
    for i, spall in enumerate(spalls):
        inside = (of.abs(away[i]) < 0.5 * spall.width) & (spall.length > longest)  # Liu et al. 2018, eq. (7)
        over, longest = of.where(inside, i + 1, over), of.where(inside, spall.length, longest)
    return over


def with_ramps(
    healthy: Curve, fulls: Sequence[Curve], ramps: Sequence[Sequence[Ramp]], spalls: tuple[Spall, ...],
    distances: Any,
) -> RollerCurves:  # fmt: skip
    """Q(δ) of rollers at `distances` [mm] from `spalls`, shape (spalls, …, rollers): `fulls` are curves over the middle
    of each spall, `ramps` of each those of the two rollers `next_to` its edges."""
    under = spalls_under(spalls, distances)
    each = load_curve.chosen(load_curve.joined(healthy, *fulls), under)
    if not spalls:
        return RollerCurves(each)
    at: list[Any] = []
    nearest = _nearest_edges(spalls, distances) if len(spalls) > 1 else None
    for i, spall in enumerate(spalls):
        for side in (1.0, -1.0):
            here = next_to(spall, distances[i], side)
            if nearest is not None:
                here = here & ((under == 0) & (nearest == i) | (under == i + 1))
            for taken in at:  # no roller twice: it may be the nearest to both edges
                here = here & ~taken
            at.append(here)
    every = [ramp for pair in ramps for ramp in pair]
    phases = under.ndim - 1

    def stacked(*leaves: Any) -> Any:
        found = xp.stack([xp.asarray(leaf) for leaf in leaves], axis=-1)
        return found.reshape(*found.shape, *[1] * phases)

    edges = xp.stack([ramp.edge for ramp in every])
    if any(ramp.share.ndim > 2 for ramp in every):  # ramps that know the phase
        share = xp.stack([_at_phases(ramp.share, ramp.edge.shape) for ramp in every], axis=2)
    else:
        share = stacked(*(ramp.share for ramp in every))
    alike = xp.tree_map(stacked, *[dataclasses.replace(ramp, edge=0.0, share=0.0) for ramp in every])
    together = dataclasses.replace(alike, edge=edges, share=share)
    return RollerCurves(each, together, xp.module_of(under).stack(at).astype(float))


def _nearest_edges(spalls: tuple[Spall, ...], distances: Any) -> Any:
    """Of which spall an edge is nearest to every roller, shape (…, rollers): between two spalls that lie closer than
    rollers a roller may be the nearest to an edge of the one and stand on the ramp of the other."""
    away, widths = xp.value(distances), [xp.value(spall.width) for spall in spalls]
    of = xp.module_of(away, *widths)
    beside = [of.abs(of.abs(away[i]) - 0.5 * width) for i, width in enumerate(widths)]
    return of.argmin(of.stack(beside), axis=0)


def _at_phases(share: Any, phases: tuple[int, ...]) -> Any:
    """A ramp's share with the phases as axes behind its own two."""
    if share.ndim > 2:
        return share
    return xp.broadcast_to(share.reshape(*share.shape, *[1] * len(phases)), (*share.shape, *phases))


def next_to(spall: Spall, distances: Any, side: float) -> Any:
    """Which roller, of those at `distances` [mm] from the spall's middle, is nearest to its edge on one `side` (±1);
    shape (…, rollers).

    Only that one can stand on the ramp: rollers are farther apart than it is long.
    """
    away, width = xp.value(distances), xp.value(spall.width)
    of = xp.module_of(away, width)
    nearest = of.argmin(of.abs(away - side * 0.5 * width), axis=-1)[..., None]
    return nearest == np.arange(away.shape[-1]).reshape((1,) * (nearest.ndim - 1) + (-1,))


def edge_beyond(spall: Spall, distances: Any, side: float) -> Any:
    """How far the edge stands beyond that roller's middle [mm], positive over the spall; shape (…)."""
    beyond = 0.5 * spall.width - xp.magnitude(distances)
    return xp.total(xp.where(next_to(spall, distances, side), beyond, 0.0))  # no gather: slow in a batch
