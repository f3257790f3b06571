"""Contact solves around the loads of rollers that meet spalls: the states that a `DirectByStates` is made of."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from difftrb.core.geometry import Spall
from difftrb.core.numeric import chebyshev_nodes
from difftrb.law import load_curve, samples
from difftrb.law.direct_curves import DirectByCurves, accuracy_at_edges
from difftrb.law.direct_states import NARROWER, SPREAD, DirectByStates, through
from difftrb.law.roller_states import Leaning, States
from difftrb.law.samples import Node, Progress, TiltResponse
from difftrb.law.tilt_equilibrium import UPRIGHT, TiltCurve

FEW, SEARCHED = 3, 0.35
"""Solves of a state while its load is looked for, and by how much in the logarithm they are spread to either side."""
MANY = 9
"""The same once it is found, spread by `SPREAD`."""
IN_A_MEAN = 5
"""The same at every phase of a mean, in which errors of solves cancel."""
BENDS = 5e-4
"""Residual of a state's curve, in the logarithm of the load, above which it counts as bent."""
TOGETHER = 4
"""States are filled up to a multiple of this: every number of them would be a program of its own."""


class Reached(NamedTuple):
    """Spalls that one roller may meet on a raceway: which roller at which of the phases, which spalls, and how far from
    them it is [mm]."""

    phase: int
    roller: int
    under: tuple[int, ...]
    away: tuple[float, ...]


SolvedContacts = dict[tuple[bool, tuple[int, ...], tuple[float, ...], float, float], Node]
"""Contacts solved on one raceway: whether with `TiltResponse`, spalls, distances [mm], load [N], tilt [rad]."""


def around(
    base: DirectByCurves, spalls: tuple[Spall, ...], reached: Sequence[Reached], rollers: tuple[int, ...],
    loads: np.ndarray, found: bool, known: SolvedContacts, tilts: Sequence[TiltCurve] | None = None,
    progress: Progress | None = None,
) -> DirectByStates:  # fmt: skip
    """The law of rollers that carry about `loads` [N], shape (rollers reached,), from that of healthy ones.

    `rollers` is the shape of the ring's rollers, with the phases of a mean in front. Contacts are solved around these
    loads: few and far apart while the loads are looked for, more once they are `found`; those already `known` are not
    solved again. `tilts` are of every roller reached; None: all are held upright. Needs numbers, not tracers. What
    comes out is `settling`: it refuses nothing.
    """
    spread, way = spread_of(found, IN_A_MEAN if found and len(rollers) > 1 else None)
    logs = np.log(loads)[:, None] + spread * way
    curves = [UPRIGHT] * len(reached) if tilts is None else tilts
    tilt_response = any(curve is not UPRIGHT for curve in curves)

    def at(numbers: Sequence[int]) -> list[list[Node]]:
        own = [reached[k] for k in numbers]
        turned = np.array([curves[k].tilt(logs[k]) for k in numbers]).reshape(len(own), logs.shape[1])
        return solved_at(base, spalls, own, np.exp(logs[numbers]), turned, tilt_response, known, progress)

    solved = at(range(len(reached)))
    if found:
        bent = [
            k for k, (each, own) in enumerate(zip(reached, solved, strict=True))
            if _bend(logs[k], own, _lowest(spalls, each)) > BENDS or _touches_at_some(own, len(each.under))
        ]  # fmt: skip
        logs[bent] = np.log(loads[bent])[:, None] + NARROWER * spread * way
        for k, own in zip(bent, at(bent), strict=True):
            solved[k] = own
    code = max(float(base.status_code), samples.worst_status([node for own in solved for node in own]))
    states = None
    if reached:
        turned = np.array([curve.tilt(row) for curve, row in zip(curves, logs, strict=True)])
        slopes = [_slopes(*each) for each in zip(solved, logs, curves, strict=True)]
        states = stacked(base, spalls, reached, rollers, logs, turned, solved, slopes)
    base = dataclasses.replace(base, status_code=code)
    return DirectByStates(base, states, settling=True, free_to_tilt=tilts is not None)


def spread_of(found: bool, count: int | None = None) -> tuple[float, np.ndarray]:
    """By how much in their logarithm the loads of one roller's solves are spread to either side, and where between −1
    and 1 they stand; `count` of them, default as many as `around` solves."""
    own, spread = (MANY, SPREAD) if found else (FEW, SEARCHED)
    return spread, np.asarray(chebyshev_nodes(own if count is None else count, -1.0, 1.0))


def solved_at(
    base: DirectByCurves, spalls: tuple[Spall, ...], reached: Sequence[Reached], loads: np.ndarray, tilts: np.ndarray,
    tilt_response: bool, known: SolvedContacts, progress: Progress | None,
) -> list[list[Node]]:  # fmt: skip
    """Contacts of every roller reached under its `loads` [N] at its `tilts` [rad], shape (rollers reached, loads)."""
    asked = [
        [
            (tilt_response, each.under, each.away, float(load), float(tilt))
            for load, tilt in zip(own, turned, strict=True)
        ]
        for each, own, turned in zip(reached, loads, tilts, strict=True)
    ]
    missing = list(dict.fromkeys(key for row in asked for key in row if key not in known))
    cases = [
        samples.case_under(load, [spalls[i] for i in under], away)._replace(tilt=tilt)
        for _, under, away, load, tilt in missing
    ]
    if missing:
        solved = samples.all_solved(base.contact, cases, accuracy_at_edges(float(base.error)), progress, tilt_response)
        known.update(zip(missing, solved, strict=True))
    return [[known[key] for key in row] for row in asked]


def _slopes(solved: Sequence[Node], log_loads: np.ndarray, curve: TiltCurve) -> np.ndarray:
    """Of one roller's approaches by their inputs, shape (loads, inputs), with what its tilt makes of them."""
    slopes = np.array([node.slopes for node in solved])
    if curve is UPRIGHT:
        return slopes
    moments = np.array([cast(TiltResponse, node.tilt_response).moment_slopes for node in solved])
    return slopes + curve.gain(log_loads)[:, None] * moments


def _lowest(spalls: tuple[Spall, ...], reached: Reached) -> float:
    """Approach below which a roller carries nothing [mm]: that of the highest rim."""
    return -max((float(spalls[i].rim) for i in reached.under), default=0.0)


def _bend(log_loads: np.ndarray, solved: Sequence[Node], lowest: float) -> float:
    """How far solves are from the curve nearest to them, at most, in log Q."""
    approaches = np.array([[node.approach for node in solved]])
    found, _ = load_curve.load(through(log_loads[None], approaches, np.array([lowest])), approaches.T)
    return float(np.max(np.abs(np.log(found[:, 0]) - log_loads)))


def _touches_at_some(solved: Sequence[Node], spalls: int) -> bool:
    """Whether an edge of the spalls is in the contact at some of the loads, and at others not: there is a kink."""
    by_away = np.array([node.slopes[samples.count(spalls) - spalls : samples.count(spalls)] for node in solved])
    touches = by_away != 0.0
    return bool(np.any(np.any(touches, axis=0) & ~np.all(touches, axis=0)))


def stacked(
    base: DirectByCurves, spalls: tuple[Spall, ...], reached: Sequence[Reached], rollers: tuple[int, ...],
    logs: np.ndarray, tilts: np.ndarray, solved: Sequence[Sequence[Node]], slopes: Sequence[np.ndarray],
    own_tilts: np.ndarray | None = None, leaning: bool = False,
) -> States:  # fmt: skip
    """All that was solved, by phases; filled up to a multiple of `TOGETHER` states, so that scenes share programs.
    `tilts` are as `logs`; slopes of every roller's solves are by the inputs of its own contact. Where rings tilt
    (`leaning`) rollers have `own_tilts` against the outer raceway; None: this is the inner one."""
    count, phases, loads = len(spalls), rollers[:-1], logs.shape[1]
    turn = [each.phase for each in reached]
    place = [turn[:k].count(phase) for k, phase in enumerate(turn)]
    most = max(place) + 1
    shape = (*phases, most + -most % TOGETHER)

    def filled(rows: Any, *own: int) -> np.ndarray:
        """States by phases; where there is none, the first one, which counts for no roller."""
        every = np.broadcast_to(np.asarray(rows, float)[0], (*shape, *own)).copy()
        every.reshape(math.prod(phases), shape[-1], *own)[turn, place] = rows
        return every

    def by_all(own: Sequence[np.ndarray]) -> np.ndarray:
        """By the inputs under all spalls; those of a healthy contact name a spall of no size, too."""
        found = np.zeros((*logs.shape, samples.count(count)))
        for k, (each, of_one) in enumerate(zip(reached, own, strict=True)):
            found[k][:, samples.places(each.under, count)] = of_one[:, : samples.count(len(each.under))]
        return filled(found, *found.shape[1:])

    at, met = np.zeros((len(reached), rollers[-1])), np.zeros((len(reached), count))
    given = np.zeros((len(reached), samples.count(count)))
    for k, each in enumerate(reached):
        under = list(each.under)
        at[k, each.roller] = 1.0
        met[k, under] = 1.0
        away = np.zeros(count)
        away[under] = each.away
        given[k] = samples.inputs(base.contact, spalls, away)
    there = np.zeros(shape)
    there.reshape(math.prod(phases), shape[-1])[turn, place] = 1.0
    states = States(
        filled(at, rollers[-1]) * there[..., None], filled(met, count) * there[..., None], filled(logs, loads),
        filled([[node.approach for node in own] for own in solved], loads), filled(given, given.shape[1]),
        by_all(slopes), filled(tilts, loads), filled([_lowest(spalls, each) for each in reached]),
    )  # fmt: skip
    if not leaning:
        return states
    moments = filled([[node.moment for node in own] for own in solved], loads)
    responses = [[_tilt_response(node) for node in own] for own in solved]
    moment_slopes = by_all([np.array([each.moment_slopes for each in own]) for own in responses])
    if own_tilts is not None:
        return states._replace(leaning=Leaning(moments, moment_slopes, own_tilts=filled(own_tilts, loads)))
    by_load = filled([[node.compliance for node in own] for own in solved], loads)
    moment_by_load = filled([[each.by_tilt for each in own] for own in responses], loads)  # see `Resting.shares`
    return states._replace(leaning=Leaning(moments, moment_slopes, by_load, moment_by_load))


def _tilt_response(node: Node) -> TiltResponse:
    return TiltResponse(0.0, 0.0, np.zeros_like(node.slopes)) if node.tilt_response is None else node.tilt_response
