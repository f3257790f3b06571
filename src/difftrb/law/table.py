"""Law "table", the exact one of every crowned roller: contacts solved once for all, in the two numbers a contact has.

In units of Q_d/(πE'L) the approach of a roller with logarithmic crown depends on Q/Q_d and on λ = Q_d R/(E'L³) alone.
A deep spall adds where its ends lie along the roller, a rolling edge its place across it (`edge_ramp`). The `atlas`
holds such contacts, and what lies between is read by polynomials: a pure function of contact, spall and state, to be
differentiated by all of them. Nothing is prepared.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from difftrb.contact import contact_extent, crown, gap
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.law import (
    atlas_place,
    base,
    edge_ramp,
    load_curve,
    narrow_shift,
    narrow_spall,
    ramp_fit,
    roller_curves,
)
from difftrb.law.atlas import Atlas, interpolated, node_weights, shipped
from difftrb.law.atlas_place import Place
from difftrb.law.base import LawKind, Rest, of_one_deep_spall, within_range
from difftrb.law.edge_ramp import Ramp
from difftrb.law.narrow_spall import NarrowSpall
from difftrb.law.ramp_fit import Healthy
from difftrb.law.roller_curves import RollerCurves, edge_beyond

LIGHTEST = 0.03
"""Least load of the most loaded roller, as a share of the design load; lighter ones then weigh too little for their
error."""
DEEPEST = 140.0
"""No roller of a ring comes nearer, in the atlas's unit: a healthy one has come by 43 under its largest load."""
NO_LAND = 1.0
"""Height of the crown [mm] that stands for what lies beyond the roller's end: no approach is as large."""


def number_of(contact: LineContact) -> Real:
    """λ = Q_d R/(E'L³)."""
    return contact.design_load * contact.radius / (contact.modulus * contact.length**3)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class TableLaw:
    """The law of every roller, read from an `Atlas` at this contact's number.

    `error`: see `Atlas`, of the spalls that the law was made for.
    `narrow`: whether spalls may have both edges in reach at once; programs that know only wide ones compile in a third
    of the time.
    `atlas`: the package's. Its numbers are written into programs, for nothing is differentiated by them.
    """

    contact: LineContact
    error: Real
    narrow: bool = dataclasses.field(default=True, metadata={"static": True})
    atlas: Atlas = dataclasses.field(default_factory=shipped, metadata={"static": True})
    name = "table"
    hard = False

    @property
    def load_range(self) -> tuple[Real, Real]:
        """Smallest and largest load of the most loaded roller [N]."""
        return LIGHTEST * self.contact.design_load, np.exp(self.atlas.log_loads[-1]) * self.contact.design_load

    @property
    def status_code(self) -> Real:
        """All solves behind it converged."""
        return np.asarray(status.CONVERGED)

    def at(self, contact: LineContact) -> TableLaw:
        """The law of another contact."""
        return dataclasses.replace(self, contact=contact)

    def curves(self, spalls: tuple[Spall, ...], distances: Any) -> RollerCurves:
        """See `Law`."""
        healthy = self.healthy()
        beside = [self._beside(spall, healthy) for spall in spalls]
        if self.narrow:
            beside = [self.of_both_edges(one, spall) for one, spall in zip(beside, spalls, strict=True)]
        ramps = [
            [dataclasses.replace(one, edge=edge_beyond(spall, distances[i], side)) for side in (1.0, -1.0)]
            for i, (spall, one) in enumerate(zip(spalls, beside, strict=True))
        ]
        return roller_curves.with_ramps(healthy.curve, [one.full for one in beside], ramps, spalls, distances)

    def judge(self, spalls: tuple[Spall, ...], distances: Any, rest: Rest | None = None) -> Any:
        """See `Law`: deep spalls, one under a roller, that leave no slivers of land at the roller's end."""
        contact = self.contact
        number, ends = number_of(contact), np.exp(self.atlas.log_numbers[[0, -1]])
        inside = (number >= ends[0]) & (number <= ends[1])
        code = xp.module_of(number).where(inside, status.CONVERGED, status.OTHER_CONTACT)
        code = status.worst(code, within_range(self.load_range, rest), of_one_deep_spall(spalls, distances, rest))
        for spall in spalls:
            known = _place(contact, spall).known | (spall.length <= 0.0)
            code = status.worst(code, xp.module_of(known).where(known, status.CONVERGED, status.SLIVER))
            if not self.narrow:
                wide = self.is_wide(spall)  # widths may come one a phase
                of = xp.module_of(wide)
                code = status.worst(code, of.where(of.all(wide), status.CONVERGED, status.NARROW))
        return code

    def is_wide(self, spall: Spall) -> Any:
        """Whether no roller meets both its edges: a law that is not `narrow` knows wide ones alone."""
        return _is_wide(self.contact, spall)

    def of_any_width(self) -> TableLaw:
        """The same for narrow spalls, too."""
        error = max(float(self.error), float(self.atlas.narrow_error))
        return dataclasses.replace(self, error=error, narrow=True)

    def ramp(self, number: int, spall: Spall, approach: Any) -> tuple[Any, Any]:
        """See `Law`."""
        low, high = edge_ramp.extent(edge_ramp.spread(self.beside(spall), np.ndim(approach)), approach)
        return low, xp.minimum(high, 0.5 * spall.width)

    def healthy(self) -> Healthy:
        """The curve of a healthy roller."""
        atlas, contact, unit = self.atlas, self.contact, crown.scale(self.contact)
        at = node_weights(atlas.log_numbers, xp.log(number_of(contact)))
        loads = atlas.log_loads + xp.log(contact.design_load)
        approaches = unit * xp.exp(xp.einsum("n,nq->q", at, atlas.healthy))
        own = ramp_fit.healthy_curve(loads, approaches, 1.0 / (1.0 + np.exp(atlas.log_loads[0])))
        across = 0.5 * xp.log(2.0 * contact.radius * unit)
        half_width = _plus(xp.einsum("n,nc->c", at, atlas.half_width), across)
        middle, reach = 0.5 * (loads[-1] + loads[0]), 0.5 * (loads[-1] - loads[0])
        return Healthy(own, half_width, xp.stack([middle, reach]), contact.radius)

    def place_among(self, spall: Spall) -> tuple[Any, Any, Any]:
        """log λ and the length of the spall's place in the atlas, both brought to −1…1; whether it is over the end."""
        place, (low, high) = _place(self.contact, spall), self.atlas.log_numbers[[0, -1]]
        number = (2.0 * xp.log(number_of(self.contact)) - low - high) / (high - low)
        return number, 2.0 * place.length - 1.0, place.over_end

    def beside(self, spall: Spall) -> Ramp:
        """The ramp of this spall's edge, which stands under the roller's middle."""
        return self._beside(spall, self.healthy())

    def _beside(self, spall: Spall, healthy: Healthy) -> Ramp:
        atlas, contact, place = self.atlas, self.contact, _place(self.contact, spall)
        number, unit = xp.log(number_of(contact)), crown.scale(contact)
        nodes = atlas.log_numbers, atlas.lengths, atlas.asides
        over, loads = interpolated(atlas.over_middle, nodes, number, place), len(atlas.log_loads)
        shift = ramp_fit.shift_over(contact, spall)
        approaches = xp.maximum(unit * xp.exp(over[:loads]), (shift * (1.0 + 1e-9))[None])
        full = load_curve.through(atlas.log_loads + xp.log(contact.design_load), approaches, shift)
        full = load_curve.lighter(full, over[-1])
        nodes = atlas.edge_numbers, atlas.edge_lengths, atlas.edge_asides
        share = interpolated(atlas.share_in_powers, nodes, number, place)
        by_load = xp.log(unit / contact.design_load)
        rise = ramp_fit.rise_over(contact, spall)
        return healthy.beside(np.zeros(()), full, _plus(over[loads:-1], by_load), rise, share)

    def of_both_edges(self, beside: Ramp, spall: Spall) -> Ramp:
        """The ramp of the spall's edge for both of them."""
        low, high = contact_extent.ends_along(self.contact, spall)
        height = crown.height(0.5 * (low + high) + 0.5 * (high - low) * np.asarray(narrow_spall.ALONG), self.contact)
        number, length, over_end = self.place_among(spall)
        inside, over = self.atlas.shift
        shift = narrow_shift.by_level(xp.where(over_end, over, inside), number, length)
        narrow = NarrowSpall(xp.asarray(spall.width), xp.minimum(height, NO_LAND), shift)
        return dataclasses.replace(beside, narrow=narrow)


def _plus(coefficients: Any, first: Any) -> Any:
    """Of a polynomial and a number."""
    return coefficients + np.eye(1, len(coefficients))[0] * first


def _place(contact: LineContact, spall: Spall) -> Place:
    length = contact.length
    return atlas_place.place_of(spall.length / length, spall.axial_offset / length, number_of(contact))


def _farthest(contact: LineContact) -> Any:
    """No edge farther than this from a roller's middle touches it [mm]."""
    return gap.certain_reach(contact.radius, DEEPEST * crown.scale(contact))


@np.errstate(all="ignore")
def table_law(contact: LineContact, spalls: tuple[Spall, ...] | None = None) -> TableLaw:
    """The law of this contact, traced or not, for these spalls; None is for any."""
    narrow = spalls is None or not all(_is_known_wide(contact, spall) for spall in spalls)
    return TableLaw(contact, _error(contact, spalls), narrow)


def _error(contact: LineContact, spalls: tuple[Spall, ...] | None) -> Any:
    """The largest of what is known of these spalls' places; of any spalls, if they are not given."""
    atlas = shipped()
    if spalls is None:
        return max(np.max(atlas.errors), float(atlas.narrow_error))
    error, contact = np.asarray(atlas.errors[0]), xp.fixed(contact)
    for spall in xp.fixed(spalls):
        place = _place(contact, spall)
        thirds = 3.0 * xp.sqrt(place.aside)
        own = xp.where(thirds < 1.0, atlas.errors[0], xp.where(thirds < 2.0, atlas.errors[1], atlas.errors[2]))
        error = xp.maximum(error, xp.where(place.over_end, atlas.errors[3], own))
        known = _is_wide(contact, spall) | (spall.width * spall.length <= 0.0)
        error = xp.maximum(error, xp.where(known, 0.0, atlas.narrow_error))
    return error


def _is_wide(contact: LineContact, spall: Spall) -> Any:
    """Whether no roller meets both edges of the spall."""
    return 0.5 * spall.width > _farthest(contact)


def _is_known_wide(contact: LineContact, spall: Spall) -> bool:
    """The same, if it is known: what is traced by jit is not, what is differentiated outside of it is."""
    try:
        return bool(xp.value(_is_wide(contact, spall)))
    except jax.errors.ConcretizationTypeError:
        return False


base.register(
    LawKind(
        "table",
        "contacts of every crowned roller, solved once for all and read from the package's atlas",
        make=lambda of: table_law(of.contact, of.spalls),
        of_all_loads=True,
        inner=True,
        frozen=None,
    )
)
