"""States of rollers: what was solved for those that meet spalls, or whose rings tilt; how far a scene may be off it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from difftrb.contact import crown, gap
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Spall
from difftrb.law import samples
from difftrb.law.base import Rest
from difftrb.law.direct_curves import ASIDE, MOVED

if TYPE_CHECKING:
    from jaxtyping import Float

    Array = jax.Array | np.ndarray

WITHIN = 0.2
"""By how much in its logarithm a roller's load may be off the one that its contacts were solved about."""
TURNED_WITHIN = 0.7
"""The same of its tilt, by how far its solves are spread to either side."""
CLEAR = 0.3
"""Overlap of a roller without a state, by the approach under the least load of the healthy curve, up to which it counts
as clear: it would carry a quarter of that, 1e-3 of the largest load."""
ALONGSIDE = 0.05
"""How far a spall's ends may move along the roller, by its length: as far as slopes tell loads to 3e-4."""
ALONG = np.linspace(-0.499, 0.499, 21)
"""Places by the roller's length at which overlap is looked at."""


class Leaning(NamedTuple):
    """What states have besides where rings tilt, one behind the other as there.

    Attributes:
      moments: about the rollers' middles [N mm]; with both raceways in series the outer one's have all of it.
      moment_slopes: by `States.given`.
      by_load, moment_by_load: of the inner raceway, how its approach [mm/N] and the moment [mm] go with its load; None
        of the outer one.
      own_tilts: of rollers against the outer raceway [rad]; None of the inner one.
    """

    moments: Float[Array, "*phases states loads"]
    moment_slopes: Float[Array, "*phases states loads inputs"]
    by_load: Float[Array, "*phases states loads"] | None = None
    moment_by_load: Float[Array, "*phases states loads"] | None = None
    own_tilts: Float[Array, "*phases states loads"] | None = None


class States(NamedTuple):
    """Rollers that meet spalls, or tilt by those on the other raceway, one behind the other along one axis of every
    field. In the mean the cage's phases are an axis in front of it.

    Attributes:
      at: which roller each is: a one among zeros; zeros alone where a row only fills up.
      met: which spalls are in its reach: ones in zeros.
      log_loads: of its solves [log N]. approaches: [mm].
      given: `samples.inputs` of the contact, all spalls, and its distances from them, as solved.
      slopes: of the approaches by these, the tilt held; 0 by spalls out of reach.
      tilts: of the roller in its solves, as this raceway sees it [rad].
      lowest: approaches below which rollers carry nothing [mm]: a rim may press before the raceway.
      leaning: of rings that tilt, whose solves are spread over tilts, too, those of the rings; None: they stay
        parallel.
    """

    at: Float[Array, "*phases states rollers"]
    met: Float[Array, "*phases states spalls"]
    log_loads: Float[Array, "*phases states loads"]
    approaches: Float[Array, "*phases states loads"]
    given: Float[Array, "*phases states inputs"]
    slopes: Float[Array, "*phases states loads inputs"]
    tilts: Float[Array, "*phases states loads"]
    lowest: Float[Array, "*phases states"]
    leaning: Leaning | None = None


def is_of(states: States, distances: Any) -> bool:
    """Whether states were made for so many spalls, and for so many phases: one stands for all phases that there are."""
    phases = [n for n in distances.shape[1:-1] if n != 1]
    return states.met.shape[-1] == distances.shape[0] and list(states.met.shape[:-2]) == phases


def as_made(states: States, of_rollers: Any) -> Any:
    """What all rollers have against all spalls, shape (spalls, …, rollers), with phases as the states have them."""
    return of_rollers.reshape(of_rollers.shape[0], *states.at.shape[:-2], of_rollers.shape[-1])


def keep_loads(states: States, least: Any, rest: Rest) -> Any:
    """Whether rollers carry about what they were solved under; less than the `least` [log N] is little."""
    load = xp.einsum("...sr,...r->...s", states.at, rest.loads.reshape(*states.at.shape[:-2], -1))
    solved = xp.mean(states.log_loads, axis=-1)
    load = xp.maximum(load, xp.exp(xp.minimum(least, solved)))
    off = xp.abs(xp.log(load) - solved) * xp.max(states.at, axis=-1)
    return xp.max(off) < WITHIN


def keep_spalls(states: States, contact: LineContact, spalls: tuple[Spall, ...], distances: Any) -> Any:
    """Whether spalls are about as they were solved, as far as rollers may feel it: a wall or a bottom out of reach
    has no slope that would tell how near it has come. `distances` with phases as the states have them."""
    away = xp.einsum("...sr,n...r->...sn", states.at, distances)
    most = xp.max(states.approaches + 0.5 * contact.length * xp.abs(states.tilts), axis=-1)
    there = states.met * xp.max(states.at, axis=-1)[..., None] > 0.0
    same: Any = np.asarray(True)
    for n, spall in enumerate(spalls):
        own, at = there[..., n], samples.places((n,), len(spalls))[len(samples.OF_CONTACT) :]
        solved_for = [states.given[..., k] for k in at]
        if not isinstance(spall, Spall):
            same = same & _keeps_map(spall, solved_for[:-1], own, contact)
            continue
        length, width, depth, offset, before = solved_for
        reach = gap.certain_reach(contact.radius, xp.maximum(most + spall.rim, 0.0))
        for side in (-1.0, 1.0):
            solved, now = before + side * 0.5 * width, away[..., n] + side * 0.5 * spall.width
            felt = (xp.minimum(xp.abs(solved), xp.abs(now)) < reach) | (solved * now < 0.0)
            same = same & ~xp.any(own & felt & (xp.abs(now - solved) > ASIDE))
            ends = offset + side * 0.5 * length, spall.axial_offset + side * 0.5 * spall.length
            same = same & ~xp.any(own & (xp.abs(ends[1] - ends[0]) > ALONGSIDE * contact.length))
        shallow = xp.minimum(depth, spall.depth)
        same = same & ~xp.any(own & (shallow < most) & (xp.abs(spall.depth - depth) > MOVED * shallow))
    return same


def _keeps_map(spall: Any, solved_for: list[Any], own: Any, contact: LineContact) -> Any:
    """The same of a height map: its pitches, scale and place along the roller, for those states that are its `own`."""
    pitch_y, pitch_x, scale, offset = solved_for
    off = xp.abs(spall.axial_offset - offset) > ALONGSIDE * contact.length
    for now, solved in ((spall.pitch_y, pitch_y), (spall.pitch_x, pitch_x), (spall.scale, scale)):
        off = off | (xp.abs(now - solved) > MOVED * xp.abs(solved))
    return ~xp.any(own & off)


def keep_tilts(states: States, contact: LineContact, raceways: float, clear: Any, rest: Rest) -> Any:
    """Whether rollers are turned as those that were solved, and all others overlap with so many `raceways` less than an
    upright one that approaches by `clear` [mm]."""
    middle, every = rest.rings if rest.rings is not None else (rest.approach, xp.zeros_like(rest.loads))
    crowned = raceways * crown.height(ALONG * contact.length, contact)
    overlap = mean_overlap(crowned, contact.length, middle, every)
    alone = xp.sum(states.at, axis=-2).reshape(every.shape) == 0.0
    pressed = xp.any(alone & (overlap > mean_overlap(crowned, contact.length, clear, xp.zeros_like(clear))))
    turned = -xp.einsum("...sr,...r->...s", states.at, every.reshape(*states.at.shape[:-2], -1))
    half = 0.5 * (xp.max(states.tilts, axis=-1) - xp.min(states.tilts, axis=-1))
    off = xp.abs(turned - xp.mean(states.tilts, axis=-1)) * xp.max(states.at, axis=-1)
    return (xp.max(off / half) < TURNED_WITHIN) & ~pressed


def mean_overlap(crowned: Any, length: Any, approach: Any, tilt: Any) -> Any:
    """Of rollers and raceways along a roller [mm], in the shape of the rings' approach [mm] and tilt [rad] there, from
    how far the crowns have risen at `ALONG` [mm]. A line contact carries about as this; one that is pressed at its end
    alone, less."""
    at = ALONG.reshape(-1, *[1] * np.ndim(approach))
    along = at * length * tilt[None] - crowned.reshape(at.shape)
    return xp.mean(xp.maximum(approach[None] + along, 0.0), axis=0)
