"""The law of a scene whose rings tilt, by contact solves around its rollers' loads and tilts, until both stay.

Every roller that carries has a state of its own, at one phase or at all of a mean.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import numpy as np

from difftrb.core import status
from difftrb.core.geometry import Spall
from difftrb.law import local_states, tilted_states
from difftrb.law.base import Rest
from difftrb.law.direct import DirectLaw
from difftrb.law.local import LocalLaw
from difftrb.law.local_states import Reached
from difftrb.law.samples import Progress
from difftrb.law.tilted_states import TiltTable
from difftrb.ring import roller_places
from difftrb.scene.local_laws import FARTHER, ROUNDS, STAYS, guess, holding, rest_at
from difftrb.scene.scene import PitchMean, Scene, healthy

LIGHT = 1e-3
"""Share of the largest load below which a roller that is turned farther than the table knows counts as clear."""

CLEAR = 0.05
"""Of the least load of the healthy curve: a roller over a spall whose contact would carry less counts as clear."""

At = tuple[int, int, tuple[int, ...]]
"""A phase, a roller, and the spalls that it may meet."""


class Now(NamedTuple):
    """Rollers of all rows at rest: those that carry or meet a spall, and how many there are, with the phases in front.
    Of those their loads [N] and tilts [rad], as contacts see them, and which are clear of the land beside a spall."""

    reached: list[Reached]
    rollers: tuple[int, ...]
    centres: dict[At, tuple[float, float]]
    clear: frozenset[At]


def tilted_law(scene: Scene, base: DirectLaw, progress: Progress | None) -> LocalLaw:
    """The law of the outer raceway for a scene, with and without its spalls, from that of healthy rollers.

    A scene whose loads do not stay keeps the last states, and its own status says that rollers are elsewhere.
    """
    table = tilted_states.table_of(base, progress)
    sound = _settled(healthy(scene), base, table, None)
    law = _settled(scene, base, table, progress) if scene.spalls else sound
    return dataclasses.replace(law, settling=False, sound=sound.states)


def _settled(scene: Scene, base: DirectLaw, table: TiltTable, progress: Progress | None) -> LocalLaw:
    """The law around the states in which the rollers of a scene end."""
    spalls = roller_places.spalls_on(scene.spalls, "outer")
    made = LocalLaw(base, None, settling=True)
    now = _at_rest(scene, made, spalls, table, frozenset())
    rollers = now.rollers[0 if isinstance(scene.phase, PitchMean) else 1 :]
    centres = dict(now.centres)
    found, known, leaned = False, {}, False
    for _ in range(ROUNDS):
        loads, tilts = np.array(list(centres.values())).reshape(-1, 2).T
        clear = np.array([at[:3] in now.clear for at in now.reached], bool)
        made = tilted_states.around(
            base, table, spalls, now.reached, rollers, loads, tilts, clear, found, known, progress
        )
        made, before = dataclasses.replace(made, sound=made.states), now.clear
        leans = int(made.status_code) == status.LEANS
        if leans and leaned:  # twice one after the other: they are not coming back
            break
        leaned = leans
        now = _at_rest(scene, made, spalls, table, before)
        ended, near = now.centres, STAYS if found else local_states.SEARCHED
        kept = {at: centres[at] if at in centres and _is_near(table, centres[at], own, near) else own
                for at, own in ended.items()}  # fmt: skip
        if kept != centres or now.clear != before:
            centres = kept
        elif found:
            break
        else:
            found, centres = True, ended
    return made


def _is_near(table: TiltTable, one: tuple[float, float], other: tuple[float, float], near: float) -> bool:
    """Whether two states are `near` each other, in the logarithm of the load, and half of that in tilt by approach over
    length."""
    turned = abs(one[1] - other[1]) * float(table.contact.length) / table.upright(one[0])
    return abs(np.log(one[0] / other[0])) < near and turned < 0.5 * near


def _at_rest(scene: Scene, made: LocalLaw, spalls: tuple[Spall, ...], table: TiltTable, before: frozenset[At]) -> Now:
    """What rollers carry at which tilt, and the spalls that they may meet. Healthy ones carry what the table has at
    their place, whatever law they were found by; those that were clear `before` what their contacts would."""
    ready = holding(scene, {"outer": made})
    every, away, approach, _, tilts = jax.tree.map(np.asarray, rest_at(ready))
    loads, tilts = every["outer"], -tilts
    deepest = approach + 0.5 * float(made.contact.length) * np.abs(tilts)
    rest = Rest(float(made.contact.radius), FARTHER * deepest, loads)
    met = [rest.in_reach(s, d) for s, d in zip(spalls, np.moveaxis(away["outer"], 1, 0), strict=True)]
    met = np.reshape(np.array(met, bool), (len(met), *approach.shape))
    least, first = float(np.exp(made.base.log_loads[0])), made.states is None
    reached, centres, clear = [], {}, set()
    for p, j in np.argwhere(deepest > 0.0):
        under = tuple(np.flatnonzero(met[:, p, j]).tolist())
        at = Reached(int(p), int(j), under, tuple(away["outer"][p, list(under), j].tolist()))
        if under:
            load = guess(scene, spalls, at, loads) if first else float(loads[p, j])
            load = load / tilted_states.NOTHING if at[:3] in before else load
            if load < CLEAR * least:
                clear.add(at[:3])
            load = max(load, least)
        else:
            load = table.load_at(float(approach[p, j]), float(tilts[p, j]))
            if np.isnan(load):
                load = float(loads[p, j]) if loads[p, j] > LIGHT * loads.max() else 0.0
        if load > 0.0:
            reached.append(at)
            centres[at[:3]] = load, float(tilts[p, j])
    return Now(reached, loads.shape, centres, frozenset(clear))
