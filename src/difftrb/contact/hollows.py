"""Hollows: stretches of the roller's line that stand over spalls, in their order along it, with land between them."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

from difftrb.contact.contact_extent import ends_along
from difftrb.contact.contact_solution import Inputs, listed
from difftrb.core import arrays as xp
from difftrb.core.geometry import Spall


class Beneath(NamedTuple):
    """What is static of the hollows under a roller: for each, the spall that it begins with, the one that it ends with,
    and those that it is made of besides, more than one where spalls overlap; how many rolling edges of each may be in
    reach, 0…2 (if one, the nearer, which is then looked at as if it were the left one); and whether this describes
    them: where spalls overlap along the roller, none has a rolling edge in reach."""

    hollows: tuple[tuple[int, ...], ...]
    edges: Any
    described: bool = True


class Hollow(NamedTuple):
    """Where it begins and ends along the roller, not beyond the roller's ends, and where its rolling edges are from the
    roller's middle, all [mm]; the least depth of what it is made of [mm]."""

    low: Any
    high: Any
    left: Any
    right: Any
    depth: Any

    @property
    def edge(self) -> Any:
        """How far the nearer rolling edge is from the roller's middle [mm]; negative where that is not over it."""
        return 0.5 * (self.right - self.left) - xp.magnitude(0.5 * (self.left + self.right))


def of_one(inputs: Inputs, edges: Any) -> Beneath:
    """Of at most one spall, with so many rolling edges in reach; traced, where only their number is wanted."""
    return Beneath((), 0) if inputs.spall is None else Beneath(((0, 0),), edges)


def hollows_of(inputs: Inputs, beneath: Beneath) -> tuple[Hollow, ...]:
    """The hollows, in their order along the roller."""
    every = _each(inputs)

    def one(first: int, last: int, *others: int) -> Hollow:
        depth = every[first].depth
        for i in (last, *others):
            depth = depth if i == first else xp.minimum(depth, every[i].depth)
        return every[first]._replace(high=every[last].high, depth=depth)

    return tuple(one(*parts) for parts in beneath.hollows)


def of_several(inputs: Inputs, reach: Any) -> Beneath:
    """Of spalls that are numbers: those that a contact meets which reaches so far from the roller's middle [mm]."""
    every = xp.fixed(_each(inputs))
    near = [i for i, hollow in enumerate(every) if hollow.edge > -reach]
    out = {i: bool(every[i].edge >= reach) for i in near}
    merged: list[list[int]] = []
    described = True
    for i in sorted(near, key=lambda i: float(every[i].low)):
        if merged and every[i].low <= every[merged[-1][1]].high:
            own = merged[-1]
            described = described and out[i] and all(out[j] for j in own)
            farther = every[i].high > every[own[1]].high
            own[1:2] = [i, own[1]] if farther else [own[1], i]
        else:
            merged.append([i, i])
    edges = 0 if all(out.values()) else 2
    return Beneath(tuple(map(tuple, merged)), edges, described)


def _each(inputs: Inputs) -> list[Hollow]:
    """Of every spall."""
    spalls = cast(tuple[Spall, ...], listed(inputs.spall))
    offsets = [inputs.offset] if len(spalls) == 1 else [inputs.offset[i] for i in range(len(spalls))]

    def one(spall: Spall, offset: Any) -> Hollow:
        low, high = ends_along(inputs.contact, spall)
        return Hollow(low, high, offset - 0.5 * spall.width, offset + 0.5 * spall.width, spall.depth)

    return [one(spall, offset) for spall, offset in zip(spalls, offsets, strict=True)]
