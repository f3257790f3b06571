"""Rollers free to tilt between both raceways: the tilt ψ at which their contacts' moments balance.

A spall off the roller's middle shifts the load along it. Held upright, the roller would need a moment from nowhere;
free, it tilts until the moments about its middle are equal, M_outer(Q, ψ) = M_inner(Q_inner, τ − ψ), τ being the tilt
of the rings against each other: what turns towards one raceway turns away from the other. The flange is taken to press
where a healthy roller rests upright.

When a contact changes, so does the tilt; what that makes of the approach of both together, D, is
∂D/∂ψ · dψ with dψ = −d(M_outer − M_inner) / ∂(M_outer − M_inner)/∂ψ. That is what `gain` is for.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from difftrb.core import status
from difftrb.core.geometry import LineContact
from difftrb.law import samples
from difftrb.law.samples import Case, Node, Progress, TiltResponse

BALANCED, NEARLY = 1e-5, 2.5e-2
"""Difference of both moments, by load and roller length, at which a roller rests; and from which one more step of the
secant is enough where contacts tell how they answer to tilt, of a first step a tenth of that."""
ROUNDS = 20
"""Of the secant method between brackets, at most; two or three do."""
SEARCHED, FOUND = 3, 5
"""Loads of one roller at which its tilt is looked for while its load is, and once that is found."""

Over = Callable[[np.ndarray], np.ndarray]
"""Of the logarithm of a roller's load [log N]."""


Lookup = tuple[Callable[[Case], Node | None], Callable[[Case], Node | None]]
"""What is known of contacts with the outer and with the inner raceway."""


def _unknown(case: Case) -> None:
    return None


NOTHING_KNOWN: Lookup = (_unknown, _unknown)


class TiltCurve(NamedTuple):
    """Of one roller, over the logarithm of its load on a raceway, as that raceway sees it: its tilt [rad], and its
    approach there by a moment that the raceway adds [mm/(N mm)], for both raceways together."""

    tilt: Over
    gain: Over


class RollerContacts(NamedTuple):
    """One roller between two raceways: spalls in its reach on either, and how far away [mm]; outer raceway first; and
    by how much the rings are tilted against each other there, as contacts see it [rad]."""

    contacts: tuple[LineContact, LineContact]
    spalls: tuple[Sequence[Any], Sequence[Any]]
    away: tuple[Sequence[float], Sequence[float]]
    turned: float = 0.0

    @property
    def leans(self) -> bool:
        """Whether the rings or a spall off the roller's middle may tilt it."""
        return self.turned != 0.0 or any(bool(spall.off_middle) for own in self.spalls for spall in own)

    def cases(self, loads: tuple[float, float], tilt: float = 0.0) -> tuple[Case, Case]:
        """Its contacts under these loads [N] at a tilt [rad] against the outer raceway."""
        outer, inner = (
            samples.case_under(load, own, away)._replace(tilt=turned)
            for load, own, away, turned in zip(loads, self.spalls, self.away, (tilt, self.turned - tilt), strict=True)
        )
        return outer, inner


class Resting(NamedTuple):
    """A roller at rest under its loads: its tilt [rad] and both contacts."""

    tilt: float
    outer: Node
    inner: Node

    def gain(self, ratio: float) -> float:
        """See `TiltCurve`, of the outer raceway; `ratio` is outer by inner load."""
        outer, inner = self.outer.tilt_response, self.inner.tilt_response
        assert outer is not None
        assert inner is not None
        softer, stiffer = outer.by_tilt - inner.by_tilt / ratio, outer.moment_by_tilt + inner.moment_by_tilt
        return -softer / stiffer if stiffer < 0.0 else 0.0

    def balanced(self) -> Resting:
        """The roller where both moments are equal, by how contacts near there go with the tilt; as it is where they
        were solved without."""
        one, other = self.outer.tilt_response, self.inner.tilt_response
        if one is None or other is None or not one.moment_by_tilt + other.moment_by_tilt < 0.0:
            return self
        more = (self.inner.moment - self.outer.moment) / (one.moment_by_tilt + other.moment_by_tilt)

        def turned(node: Node, by: TiltResponse, more: float) -> Node:
            approach, moment = node.approach + by.by_tilt * more, node.moment + by.moment_by_tilt * more
            return dataclasses.replace(node, approach=approach, moment=moment)

        return Resting(self.tilt + more, turned(self.outer, one, more), turned(self.inner, other, -more))

    def shares(self, ratio: float) -> tuple[Node, Node]:
        """Each contact's part in the approach D and the moment M of both together, the roller's tilt following:
        D = δ_outer + δ_inner/ratio, M = M_outer. `ratio` is outer by inner load.

        Slopes, of D by the outer contact's inputs and load and of ratio · D by the inner one's, are at a fixed tilt of
        the rings and at a fixed load on the other raceway. The outer part has the moment, and how D and M go with the
        rings' tilt; `by_tilt` of the inner one is the moment by the inner load. Without `tilt_response` contacts are as
        solved.
        """
        if self.outer.tilt_response is None or self.inner.tilt_response is None:
            return self.outer, dataclasses.replace(self.inner, moment=0.0)
        (outer, one), (inner, other) = (self.outer, self.outer.tilt_response), (self.inner, self.inner.tilt_response)
        gain, both = self.gain(ratio), one.moment_by_tilt + other.moment_by_tilt
        from_outer = other.moment_by_tilt / both if both < 0.0 else 0.0
        from_inner = one.moment_by_tilt / both if both < 0.0 else 0.0
        # a moment by the load is the approach by the tilt (Maxwell)
        of_outer = TiltResponse(
            other.by_tilt / ratio - gain * other.moment_by_tilt, from_outer * one.moment_by_tilt,
            from_outer * one.moment_slopes,
        )  # fmt: skip
        of_inner = TiltResponse(from_inner * other.by_tilt, 0.0, from_inner * other.moment_slopes)
        return (
            dataclasses.replace(
                outer, compliance=outer.compliance + gain * one.by_tilt, slopes=outer.slopes + gain * one.moment_slopes,
                tilt_response=of_outer,
            ),
            dataclasses.replace(
                inner, compliance=inner.compliance - ratio * gain * other.by_tilt, moment=0.0,
                slopes=inner.slopes - ratio * gain * other.moment_slopes, tilt_response=of_inner,
            ),
        )  # fmt: skip


def at_rest(
    roller: RollerContacts,
    loads: tuple[float, float],
    accuracy: float,
    start: float | None = None,
    tilt_response: bool = False,
    known: Lookup = NOTHING_KNOWN,
) -> Resting:
    """The roller at the tilt at which both moments are equal; `start` is a guess of it [rad]; `tilt_response` asks
    for that of the contacts at the end. Contacts that are `known` are not solved: a function of either's case, None
    where it does not know it.

    The outer moment less the inner one falls with the tilt: a secant between brackets cannot miss. A contact that has
    no solution ends the search; its status says so. Slopes are asked for at its end alone.
    """
    length = float(roller.contacts[0].length)
    whole = max(loads) * length

    def at(tilt: float, by: Callable[[LineContact, Case, float], Any]) -> list[Any]:
        cases = zip(roller.contacts, roller.cases(loads, tilt), known, strict=True)
        return [
            by(contact, case, accuracy) if (node := there(case)) is None else node for contact, case, there in cases
        ]

    tilt, before = 0.5 * roller.turned if start is None else start, None
    low, high = -np.inf, np.inf
    for _ in range(ROUNDS):
        outer, inner = at(tilt, samples.pressed)
        unbalanced = float(outer.moment - inner.moment)
        if status.worst(outer.status_code, inner.status_code) != status.CONVERGED or unbalanced == 0.0:
            break
        # two uniform line contacts in parallel, each with Q/δ along its length
        soft = sum(load / float(each.approach) for load, each in zip(loads, (outer, inner), strict=True))
        fall = -soft * length**2 / 12.0
        slope = fall if before is None else (before[1] - unbalanced) / (before[0] - tilt)
        low, high = (max(low, tilt), high) if unbalanced > 0.0 else (low, min(high, tilt))
        step = tilt - unbalanced / (slope if slope < 0.0 else fall)
        near = BALANCED if not tilt_response else NEARLY if before else 0.1 * NEARLY
        balanced = abs(unbalanced) < near * whole
        if not (balanced or low < step < high):
            step = 0.5 * (low + high) if np.isfinite(low + high) else tilt - unbalanced / fall
        before, tilt = (tilt, unbalanced), float(step)
        if balanced:
            break
    return Resting(tilt, *at(tilt, samples.solved_with_tilt if tilt_response else samples.solved)).balanced()


def tilt_curves(
    rollers: Sequence[RollerContacts], log_loads: np.ndarray, inner_load: Callable[[float], float], accuracy: float,
    starts: Sequence[TiltCurve | None], tilt_response: bool, progress: Progress | None = None,
) -> list[TiltCurve]:  # fmt: skip
    """Of every roller over its outer load, through what is solved at `log_loads` [log N], shape (rollers, loads).

    `inner_load` is the inner load [N] of an outer one; `starts` are tilts known before; without `tilt_response` there
    is no gain. Rollers that do not lean are upright. Needs numbers, not tracers.
    """
    curves = [UPRIGHT] * len(rollers)
    leaning = [k for k, roller in enumerate(rollers) if roller.leans]
    asked = [(k, float(log_load)) for k in leaning for log_load in log_loads[k]]

    def solve(case: tuple[int, float]) -> tuple[float, float]:
        k, log_load = case
        load, start = float(np.exp(log_load)), starts[k]
        loads = load, inner_load(load)
        guess = None if start is None else float(start.tilt(np.asarray(log_load)))
        rest = at_rest(rollers[k], loads, accuracy, guess, tilt_response)
        return rest.tilt, rest.gain(loads[0] / loads[1]) if tilt_response else 0.0

    solved = np.reshape(samples.mapped(solve, asked, accuracy, progress), (len(leaning), log_loads.shape[1], 2))
    for k, own in zip(leaning, solved, strict=True):
        ends = log_loads[k][[0, -1]]
        curves[k] = TiltCurve(*(np.polynomial.Chebyshev.fit(log_loads[k], part, len(own) - 1, ends) for part in own.T))
    return curves


UPRIGHT = TiltCurve(np.zeros_like, np.zeros_like)
"""Of a roller that does not lean."""
