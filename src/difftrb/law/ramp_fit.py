"""Ramps fitted to contact solves: where they begin and end, and the share of the land's load that is left on them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from difftrb.contact import crown
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.core.numeric import least_squares
from difftrb.core.series import chebyshev_by_recurrence
from difftrb.law import edge_ramp, edge_share, load_curve
from difftrb.law.edge_ramp import Ramp
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
    known = np.where(half_widths > 0.0, half_widths, np.nan)  # without a solution there is none, as its status says
    return np.polynomial.polynomial.polyfit(x, np.log(known), EXTENT_DEGREE)


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
    terms = u[..., None] * xp.stack(chebyshev_by_recurrence(2.0 * u - 1.0, edge_ramp.TERMS - 1), axis=-1)
    return (weight * first)[..., None] * terms, weight * ((load - full) / loss - first)
