"""The exact law of every crowned roller: contacts solved once for all, in the two numbers that a contact has.

In units of Q_d/(πE'L) the approach of a roller with logarithmic crown depends on Q/Q_d and on λ = Q_d R/(E'L³) alone.
A deep spall adds where its ends lie along the roller, a rolling edge its place across it (`edge_ramp`). The atlas holds
contacts solved at Chebyshev nodes of these (by `experiments/build_of_atlas.py`), and reads what lies between by
polynomials: a pure function of contact, spall and state, to be differentiated by all of them. Nothing is prepared.
"""

from __future__ import annotations

import dataclasses
import importlib.resources
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap
from difftrb.core import implicit, status, storage
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.law import axial_place, base, direct, edge_ramp, load_curve, ramp_fit
from difftrb.law.axial_place import Place
from difftrb.law.base import LawKind, Rest, of_one_deep_spall, within_range
from difftrb.law.edge_ramp import NarrowSpall, Ramp, RollerCurves
from difftrb.law.ramp_fit import Healthy

LIGHTEST = 0.03
"""Least load of the most loaded roller by the design load; the lighter ones then weigh too little for their error."""
DEEPEST = 140.0
"""No approach in the atlas is larger, in its unit."""
NO_LAND = 1.0
"""Height of the crown [mm] that stands for what lies beyond the roller's end: no approach is as large."""


Numbers = np.ndarray | jax.Array


class Atlas(NamedTuple):
    """Contacts in their own units: loads by Q_d, approaches by Q_d/(πE'L), across the contact by √(2R·that).

    A place of a spall is its `length` variable and its `aside` variable, see `axial_place`; the last place aside stands
    for spalls over the roller's end.

    Attributes:
      log_numbers: log λ of the nodes, shape (numbers,). log_loads: log Q/Q_d, shape (loads,).
      lengths, asides: of the nodes, shapes (lengths,), (asides,).
      healthy: log δ, shape (numbers, loads). half_width: see `Ramp`, shape (numbers, coefficients).
      full: log δ over a spall's middle, shape (numbers, lengths, asides + 1, loads).
      sunk: see `Ramp`, shape (numbers, lengths, asides + 1, coefficients).
      edge_numbers, edge_lengths, edge_asides: nodes at which ramps are solved.
      share: see `Ramp`, shape (edge numbers, edge lengths, edge asides + 1, levels, terms).
      errors: of a load by a healthy roller's, against contact solves between the nodes: what nine in ten keep, of
        spalls in the inner, the middle and the outer third of the places aside, and over the roller's end, shape (4,).
      narrow_error: the same of spalls with both edges in reach.
    """

    log_numbers: Numbers
    log_loads: Numbers
    lengths: Numbers
    asides: Numbers
    healthy: Numbers
    half_width: Numbers
    full: Numbers
    sunk: Numbers
    edge_numbers: Numbers
    edge_lengths: Numbers
    edge_asides: Numbers
    share: Numbers
    errors: Numbers
    narrow_error: Numbers


FILE = "atlas.npz"


@cache
def shipped() -> Atlas:
    """The atlas that comes with the package; `experiments/build_of_atlas.py` made it."""
    with importlib.resources.as_file(importlib.resources.files("difftrb.law") / FILE) as path:
        arrays = storage.read(path, Atlas._fields)
    if arrays is None:
        raise status.SolveError(f"{FILE}: the package's file of contacts is damaged: install difftrb again")
    return Atlas(**arrays)


def number_of(contact: LineContact) -> Real:
    """λ = Q_d R/(E'L³)."""
    return contact.design_load * contact.radius / (contact.modulus * contact.length**3)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class AtlasLaw:
    """The law of every roller, read from an `Atlas` at this contact's number.

    `atlas`: None is the package's, written into every program that reads it. `error`: see `Atlas`, of the spalls that
    the law was made for.
    `narrow`: whether spalls may have both edges in reach at once; programs that know only wide ones compile in a third
    of the time.
    """

    contact: LineContact
    atlas: Atlas | None
    error: Real
    narrow: bool = dataclasses.field(default=True, metadata={"static": True})
    name = "table"
    hard = False

    @property
    def read(self) -> Atlas:
        """The atlas that it reads."""
        return _shipped() if self.atlas is None else self.atlas

    @property
    def light(self) -> AtlasLaw:
        """The same law without the package's arrays, of which results hold no copies."""
        return dataclasses.replace(self, atlas=None)

    @property
    def load_range(self) -> tuple[Real, Real]:
        """Smallest and largest load of the most loaded roller [N]."""
        return LIGHTEST * self.contact.design_load, jnp.exp(self.read.log_loads[-1]) * self.contact.design_load

    @property
    def status_code(self) -> Real:
        """All solves behind it converged."""
        return jnp.asarray(status.CONVERGED)

    def at(self, contact: LineContact) -> AtlasLaw:
        """The law of another contact."""
        return dataclasses.replace(self, contact=contact)

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> RollerCurves:
        """See `Law`."""
        healthy = self.healthy()
        beside = [self._beside(spall, healthy) for spall in spalls]
        if self.narrow:
            beside = [_narrow(one, self.contact, spall) for one, spall in zip(beside, spalls, strict=True)]
        ramps = [
            [dataclasses.replace(one, edge=ramp_fit.over(spall, distances[i], side)) for side in (1.0, -1.0)]
            for i, (spall, one) in enumerate(zip(spalls, beside, strict=True))
        ]
        return ramp_fit.roller_curves(healthy, [one.full for one in beside], ramps, spalls, distances)

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """See `Law`: deep spalls, one under a roller, that leave no slivers of land at the roller's end."""
        number = jnp.log(number_of(self.contact))
        inside = (number >= self.read.log_numbers[0]) & (number <= self.read.log_numbers[-1])
        code = jnp.where(inside, status.CONVERGED, status.OTHER_CONTACT)
        code = status.worst(code, within_range(self.load_range, rest), of_one_deep_spall(spalls, distances, rest))
        for spall in spalls:
            known = _place(self.contact, spall).known | (spall.length <= 0.0)
            code = status.worst(code, jnp.where(known, status.CONVERGED, status.SLIVER))
            if not self.narrow:
                wide = 0.5 * spall.width > _farthest(self.contact)
                code = status.worst(code, jnp.where(wide, status.CONVERGED, status.NARROW))
        return code

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`."""
        low, high = edge_ramp.extent(self.beside(spall), approach)
        return low, jnp.minimum(high, 0.5 * spall.width)

    def healthy(self) -> Healthy:
        """The curve of a healthy roller."""
        atlas, unit, number = self.read, gap.crown_scale(self.contact), jnp.log(number_of(self.contact))
        log_approaches, half_width = implicit.multilinear(_healthy_at, (_by_number,), (atlas, False), (number,))
        loads = jnp.asarray(atlas.log_loads) + jnp.log(self.contact.design_load)
        own = load_curve.through(loads, unit * jnp.exp(log_approaches), jnp.zeros(()))
        across = 0.5 * jnp.log(2.0 * self.contact.radius * unit)
        middle, reach = 0.5 * (loads[-1] + loads[0]), 0.5 * (loads[-1] - loads[0])
        return Healthy(own, half_width.at[0].add(across), jnp.stack([middle, reach]), self.contact.radius)

    def beside(self, spall: Spall) -> Ramp:
        """The ramp of this spall's edge, which stands under the roller's middle."""
        return self._beside(spall, self.healthy())

    def _beside(self, spall: Spall, healthy: Healthy) -> Ramp:
        atlas, contact, place = self.read, self.contact, _place(self.contact, spall)
        unit, at = gap.crown_scale(contact), (jnp.log(number_of(contact)), place.length, place.aside)
        weights = _by_number, _by_length, _by_aside
        log_full, sunk, share = implicit.multilinear(_beside_at, weights, (atlas, place.over_end), at)
        shift = direct.shift_over(contact, spall)
        approaches = jnp.maximum(unit * jnp.exp(log_full), shift * (1.0 + 1e-9))
        loads = jnp.asarray(atlas.log_loads) + jnp.log(contact.design_load)
        full = load_curve.through(loads, approaches, shift)
        by_load = jnp.log(unit / contact.design_load)
        rise = ramp_fit.rise_over(contact, spall)
        return healthy.beside(jnp.zeros(()), full, sunk.at[0].add(by_load), rise, share)


def _place(contact: LineContact, spall: Spall) -> Place:
    length = contact.length
    return axial_place.place_of(spall.length / length, spall.axial_offset / length, number_of(contact))


Read = tuple[Atlas, jax.Array | bool]
"""What is read, and whether at a place over the roller's end."""
Weights = tuple[jax.Array, ...]
"""What nodes count, without and with an edge in reach."""


def _by_number(read: Read, log_number: jax.Array) -> Weights:
    both = read[0].log_numbers, read[0].edge_numbers
    return tuple(load_curve.weights(nodes, load_curve.within(log_number, nodes[0], nodes[-1])) for nodes in both)


def _by_length(read: Read, length: jax.Array) -> Weights:
    nodes = read[0].edge_lengths
    at_edges = load_curve.weights(nodes, load_curve.within(length, nodes[0], 1.0))
    return load_curve.weights(read[0].lengths, length), at_edges


def _by_aside(read: Read, aside: jax.Array) -> Weights:
    """The last place aside stands for those over the roller's end."""
    over_end = jnp.asarray(read[1])
    inside = [load_curve.weights(nodes, aside) for nodes in (read[0].asides, read[0].edge_asides)]
    last = jnp.where(over_end, 1.0, 0.0)[None]
    return tuple(jnp.concatenate([jnp.where(over_end, 0.0, each), last]) for each in inside)


def _healthy_at(read: Read, told: list[Weights]) -> tuple[jax.Array, jax.Array]:
    """`Atlas.healthy` and `.half_width`."""
    ((at, _),) = told
    return at @ read[0].healthy, at @ read[0].half_width


def _beside_at(read: Read, told: list[Weights]) -> tuple[jax.Array, ...]:
    """`Atlas.full`, `.sunk` and `.share` at one place."""
    (at, at_edges), (lengths, edge_lengths), (asides, edge_asides) = told
    atlas, along, along_edges = read[0], jnp.outer(lengths, asides), jnp.outer(edge_lengths, edge_asides)
    # by the contact's number first: where that is one for a batch, this is done once
    log_full, sunk = (jnp.tensordot(along, jnp.tensordot(at, table, 1), 2) for table in (atlas.full, atlas.sunk))
    return log_full, sunk, jnp.tensordot(along_edges, jnp.tensordot(at_edges, atlas.share, 1), 2)


def _farthest(contact: LineContact) -> Real:
    """No edge farther than this from a roller's middle touches it [mm], under any load of the atlas."""
    return jnp.sqrt(2.0 * contact.radius * DEEPEST * gap.crown_scale(contact))


def _narrow(beside: Ramp, contact: LineContact, spall: Spall) -> Ramp:
    """The ramp for both edges of the spall."""
    crown = gap.crown_at(spall.axial_offset + 0.5 * spall.length * jnp.asarray(edge_ramp.ALONG), contact)
    width = jnp.asarray(spall.width, float)
    return dataclasses.replace(beside, narrow=NarrowSpall(width, jnp.minimum(crown, NO_LAND)))


def atlas_law(contact: LineContact, spalls: tuple[Spall, ...] | None = None) -> AtlasLaw:
    """The law of this contact, traced or not, for these spalls; None is for any."""
    narrow = spalls is None or not all(_is_wide(contact, spall) for spall in spalls)
    atlas = _shipped()
    return AtlasLaw(contact, atlas, _error(atlas, contact, spalls), narrow)


def _shipped() -> Atlas:
    return Atlas(*(jnp.asarray(field) for field in shipped()))


def _error(atlas: Atlas, contact: LineContact, spalls: tuple[Spall, ...] | None) -> jax.Array:
    """The largest of what is known of these spalls' places; of any spalls, if they are not given."""
    if spalls is None:
        return jnp.maximum(jnp.max(atlas.errors), atlas.narrow_error)
    error = jnp.asarray(atlas.errors[0])
    for spall in spalls:
        place = axial_place.place_of(
            spall.length / contact.length, spall.axial_offset / contact.length, number_of(contact)
        )
        third = jnp.minimum(jnp.floor(3.0 * jnp.sqrt(place.aside)), 2.0).astype(int)
        error = jnp.maximum(error, atlas.errors[jnp.where(place.over_end, 3, third)])
        wide = 0.5 * spall.width > _farthest(contact)
        error = jnp.maximum(error, jnp.where(wide, 0.0, atlas.narrow_error))
    return jax.lax.stop_gradient(error)


def _is_wide(contact: LineContact, spall: Spall) -> bool:
    """Whether the spall is known to be so wide that no roller meets both its edges: what is traced by jit is not known,
    what is differentiated outside of it is."""
    try:
        return bool(0.5 * spall.width > _farthest(contact))
    except jax.errors.ConcretizationTypeError:
        return False


base.register(
    LawKind(
        "table",
        "contacts of every crowned roller, solved once for all and read from the package's atlas",
        make=lambda of: atlas_law(of.contact, of.spalls),
        inner=True,
        frozen=None,
    )
)
