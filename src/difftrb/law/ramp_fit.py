"""Ramps fitted to contact solves: where they begin and end, and the share of the land's load that is left on them.

Also who stands on which ramp (`roller_curves`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import crown
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.core.numeric import chebyshev, least_squares
from difftrb.law import edge_ramp, edge_share, load_curve
from difftrb.law.base import spalls_under
from difftrb.law.edge_ramp import Ramp, RollerCurves
from difftrb.law.load_curve import Curve
from difftrb.law.samples import Node

SHALLOWEST = 1e-4
"""Least depth by the approach that counts for where a ramp ends."""
EXTENT_DEGREE = 5
"""Of the polynomials that say where a ramp begins and ends."""
POINT = 1.5
"""d log Q/d log δ of a crowned roller under vanishing loads: its contact is Hertz's ellipse."""


class Healthy(NamedTuple):
    """A roller on a healthy raceway: its curve, and what `Ramp` needs of it: half-width, loads, radius."""

    curve: Curve
    half_width: Any
    loads: Any
    radius: Real

    def beside(self, edge: Any, full: Curve, sunk: Any, rise: Any, share: Any) -> Ramp:
        """The ramp from here to a curve over the middle of a spall."""
        return Ramp(edge, self.curve, full, self.half_width, sunk, rise, self.loads, self.radius, share)


def healthy_level(
    contact: LineContact, solved: LineContact, log_loads: Any, approaches: Any, half_width: Any
) -> Healthy:
    """For `contact`, of solves of a neighbour of it, `solved`, at `log_loads` [log N], shape (loads,): approaches
    carried to `contact` [mm], shape (loads,), and `Ramp.half_width` as solved."""
    middle, reach = 0.5 * (log_loads[-1] + log_loads[0]), 0.5 * (log_loads[-1] - log_loads[0])
    share = contact.design_load / (contact.design_load + xp.exp(log_loads[0]))
    own = healthy_curve(log_loads, approaches, share)
    wider = 0.5 * xp.log(contact.radius / solved.radius * solved.modulus / contact.modulus)  # as of a line contact
    half_width = half_width + np.eye(1, len(half_width))[0] * wider
    return Healthy(own, half_width, xp.stack([middle, reach]), contact.radius)


def healthy_curve(log_loads: Any, approaches: Any, share: Any) -> Curve:
    """A healthy roller's curve through solves at `log_loads` [log N], `approaches` [mm], both of shape (loads,), which
    under vanishing loads goes over to Hertz's ellipse by this `share` [-]: one by one plus the least load by the design
    load. The larger that is, the later a contact leaves a line."""
    own = load_curve.lighter(load_curve.through(log_loads, approaches, np.zeros(())), POINT)
    return dataclasses.replace(own, bend=own.bend * share)


def extents(log_loads: np.ndarray, half_widths: np.ndarray) -> np.ndarray:
    """Coefficients of `Ramp.half_width`, shape (EXTENT_DEGREE + 1, …), of half-widths of shape (loads, …)."""
    x = (2.0 * log_loads - log_loads[-1] - log_loads[0]) / (log_loads[-1] - log_loads[0])
    told = np.where(half_widths > 0.0, half_widths, np.nan)  # without a solution there is none, as its status says
    return np.polynomial.polynomial.polyfit(x, np.log(told), EXTENT_DEGREE)


def sunk(contact: LineContact, spall: Spall, solved: Sequence[Node], log_loads: np.ndarray) -> np.ndarray:
    """Coefficients of `Ramp.sunk`, of solves over the middle of one spall at `log_loads` [log N]."""
    approach, reach = (np.array([getattr(node, name) for node in solved]) for name in ("approach", "reach"))
    risen = reach**2 / (2.0 * float(contact.radius)) + float(rise_over(contact, spall))
    return extents(log_loads, depth(approach, risen) / np.exp(log_loads))


def depth(approach: np.ndarray, risen: np.ndarray) -> np.ndarray:
    """How far rollers sink into a spall: their approach less what the crown and the land beside it have `risen`.

    Where land lifts a roller as far as it sinks, rounding decides the sign: then the ramp ends where the gap closes.
    """
    return np.maximum(approach - risen, SHALLOWEST * approach)


def shift_over(contact: LineContact, spall: Spall) -> Any:
    """Approach [mm] from which a roller in the middle of a wide and deep spall carries load: the crown at the land."""
    nearest = xp.maximum(0.5 * spall.length - xp.magnitude(spall.axial_offset), 0.0)
    half = 0.5 * contact.length
    return crown.height(xp.minimum(nearest, half * (1.0 - 1e-9)), contact)


def rise_over(contact: LineContact, spall: Spall) -> Any:
    """The crown [mm] where the spall is nearest to the roller's middle."""
    nearest = xp.magnitude(xp.asarray(spall.axial_offset)) - 0.5 * spall.length
    return crown.height(xp.within(nearest, 0.0, 0.5 * contact.length * (1.0 - 1e-9)), contact)


def roller_curves(
    healthy: Healthy, fulls: Sequence[Curve], ramps: Sequence[Sequence[Ramp]], spalls: tuple[Spall, ...],
    distances: Any,
) -> RollerCurves:  # fmt: skip
    """Q(δ) of rollers at `distances` [mm] from `spalls`, shape (spalls, …, rollers): `fulls` are curves over the middle
    of each spall, `ramps` of each those of the two rollers `next_to` its edges."""
    under = spalls_under(spalls, distances)
    each = load_curve.chosen(load_curve.joined(healthy.curve, *fulls), under)
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


def over(spall: Spall, distances: Any, side: float) -> Any:
    """How far the edge stands beyond that roller's middle [mm], positive over the spall; shape (…)."""
    beyond = 0.5 * spall.width - xp.magnitude(distances)
    return xp.total(xp.where(next_to(spall, distances, side), beyond, 0.0))  # no gather: slow in a batch


def through(ramp: Ramp, approach: Any, load: Any, ridge: float) -> Any:
    """What `edge_ramp.in_powers` takes, for contact solves with edges at `ramp.edge`, through all of them, nearly;
    shape (…, 1, TERMS).

    `approach` [mm], `load` [N] of the solves, shape (…, n). `ridge`: noise of a share by the size of coefficients. What
    the solves do not tell stays small.
    """
    return least_squares(*asked(ramp, approach, load), ridge)[..., None, :]


def asked(ramp: Ramp, approach: Any, load: Any) -> tuple[Any, Any]:
    """What contact solves as in `through` ask of the coefficients of s by u, each solve by how much land's load counts
    in it: matrix and right side, shapes (…, n, TERMS) and (…, n)."""
    healthy, full, low, high = edge_ramp.between(ramp, approach)
    t, loss = edge_share.place(ramp.edge, low, high), healthy - full
    first, weight = edge_share.usual(t), xp.fixed(loss / healthy)
    u = edge_share.beyond(t)
    terms = u[..., None] * xp.stack(chebyshev(2.0 * u - 1.0, edge_ramp.TERMS - 1), axis=-1)
    return (weight * first)[..., None] * terms, weight * ((load - full) / loss - first)
