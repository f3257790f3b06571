"""The atlas: contacts of crowned rollers, solved once for all at Chebyshev nodes, and what lies between these.

`experiments/build_of_atlas.py` makes it, the law "table" reads it (`table`).
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.resources
from functools import cache, cached_property
from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import series, status, storage
from difftrb.core.taylor import Taylor
from difftrb.law import edge_ramp
from difftrb.law.atlas_place import Place

SEEDS = np.eye(2)
"""Of a place's length and aside, as the parameters of an expansion."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Atlas:
    """Contacts in their own units: loads by Q_d, approaches by Q_d/(πE'L), across the contact by √(2R·that).

    A place of a spall is its `length` variable and its `aside` variable, see `atlas_place`; the last place aside stands
    for spalls over the roller's end.

    Attributes:
      log_numbers: log λ of the nodes, shape (numbers,). log_loads: log Q/Q_d, shape (loads,).
      lengths, asides: of the nodes, shapes (lengths,), (asides,).
      healthy: log δ, shape (numbers, loads). half_width: see `Ramp`, shape (numbers, coefficients).
      full: log δ over a spall's middle, shape (numbers, lengths, asides + 1, loads).
      sunk: see `Ramp`, shape (numbers, lengths, asides + 1, coefficients).
      light: exponents to which curves over a spall's middle go under loads below the lightest node, by a contact at a
        tenth of that, shape (numbers, lengths, asides + 1).
      edge_numbers, edge_lengths, edge_asides: nodes at which ramps are solved.
      share: as `edge_ramp.in_powers` takes it, shape (edge numbers, edge lengths, edge asides + 1, levels, terms).
      shift: of the edge for both edges of a narrow spall, see `narrow_shift`, inside the roller and over its end, by
        powers of λ's, the length's and the level's number, shape (2, 4, 4, 4).
      errors: of a load, as a share of a healthy roller's, against contact solves between the nodes: what nine in ten
        keep, of spalls in the inner, the middle and the outer third of the places aside, and over the roller's end,
        shape (4,).
      narrow_error: the same of spalls with both edges in reach.
    """

    log_numbers: np.ndarray
    log_loads: np.ndarray
    lengths: np.ndarray
    asides: np.ndarray
    healthy: np.ndarray
    half_width: np.ndarray
    full: np.ndarray
    sunk: np.ndarray
    light: np.ndarray
    edge_numbers: np.ndarray
    edge_lengths: np.ndarray
    edge_asides: np.ndarray
    share: np.ndarray
    shift: np.ndarray
    errors: np.ndarray
    narrow_error: np.ndarray

    def __reduce__(self) -> Any:
        """A copy of the package's, in a pickle, too, is the package's: programs tell atlases apart by what they are."""
        return (shipped, ()) if self is shipped() else object.__reduce_ex__(self, 2)

    @cached_property
    def _digest(self) -> str:
        every = (np.ascontiguousarray(getattr(self, field.name)).tobytes() for field in dataclasses.fields(self))
        return hashlib.sha256(b"".join(every)).hexdigest()

    def __repr__(self) -> str:
        """The same in every process, for what is told apart by it: sweeps that go on in another one."""
        return f"Atlas({self._digest[:16]})"

    @cached_property
    def over_middle(self) -> np.ndarray:
        """`full`, `sunk` and `light`, one behind the other along a last axis: read at once."""
        return np.concatenate([self.full, self.sunk, self.light[..., None]], axis=-1)

    @cached_property
    def share_in_powers(self) -> np.ndarray:
        """As `Ramp` has it, shape (edge numbers, edge lengths, edge asides + 1, levels, terms)."""
        powers = edge_ramp.in_powers(self.share)
        return np.moveaxis(powers, (0, 1), (-2, -1))


FILE = "atlas.npz"


@cache
def shipped() -> Atlas:
    """The atlas that comes with the package; `experiments/build_of_atlas.py` made it."""
    with importlib.resources.as_file(importlib.resources.files("difftrb.law") / FILE) as path:
        arrays = storage.read(path, [field.name for field in dataclasses.fields(Atlas)])
    if arrays is None:
        raise status.SolveError(f"{FILE}: the package's file of contacts is damaged: install difftrb again")
    return Atlas(**arrays)


def node_weights(nodes: np.ndarray, x: Any) -> Any:
    """What values at the nodes count at `x`, shape (nodes,); beyond the nodes as at the last ones."""
    middle, reach = 0.5 * (nodes[-1] + nodes[0]), 0.5 * (nodes[-1] - nodes[0])
    z = (xp.within(x, nodes[0], nodes[-1]) - middle) / reach
    return xp.einsum("kn,k->n", _of_nodes(tuple((nodes - middle) / reach)), series.chebyshev(z, len(nodes)))


@cache
def _of_nodes(z: tuple[float, ...]) -> np.ndarray:
    """By Chebyshev polynomials, what the values at `z` count, shape (polynomials, nodes)."""
    return np.linalg.inv(np.polynomial.chebyshev.chebvander(np.array(z), len(z) - 1))


def interpolated(table: np.ndarray, nodes: tuple[np.ndarray, ...], number: Any, place: Place) -> Any:
    """What a table of shape (numbers, lengths, asides + 1, …) holds at a log λ and a place, shape (…): by its nodes.

    By the contact's number first: where that is one for a batch, this is done once. Derivatives by the number and the
    place come first, which are three, then those by what these depend on, which may be many.
    """
    moves, shifts = xp.by(number) is not None, xp.by(place.length) is not None or xp.by(place.aside) is not None
    at, beside = xp.value(number), xp.values(place)
    if moves:
        at = xp.variable(at)
    if shifts:
        beside = beside._replace(length=Taylor(beside.length, by=SEEDS[0]), aside=Taylor(beside.aside, by=SEEDS[1]))
    at, beside = node_weights(nodes[0], at), _at_place(nodes[1], nodes[2], beside)
    rows = xp.value(at)[None]
    if moves:
        rows = xp.concatenate([rows, xp.by(at)])
    held = xp.einsum("kn,n...->k...", rows, table)
    value, *by_number = xp.einsum("ij,kij...->k...", xp.value(beside), held)
    by_place = xp.einsum("mij,ij...->m...", xp.by(beside), held[0]) if shifts else (None, None)
    return xp.along(value, [by_number[0] if moves else None, *by_place], (number, place.length, place.aside))


def _at_place(lengths: np.ndarray, asides: np.ndarray, place: Place) -> Any:
    """What values at the nodes count, shape (lengths, asides + 1): the last place aside stands for those over the
    roller's end."""
    over_end = place.over_end
    inside = xp.where(over_end, 0.0, node_weights(asides, place.aside))
    aside = xp.concatenate([inside, xp.where(over_end, 1.0, 0.0)[None]])
    return node_weights(lengths, place.length)[:, None] * aside[None]
