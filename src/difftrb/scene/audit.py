"""The audit of a solution: contacts are solved afresh for the states in which the rollers ended.

Every distinct contact, with all the spalls in its reach, finer than the law's own. How much more or less a roller
would carry at its approach is the error of its load; what these errors, and the contacts' own slopes, do to the ring
is the error of the stiffness. Both are compared with what the law promises.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from difftrb.contact.grids import GRIDS
from difftrb.core import arrays as xp
from difftrb.core.geometry import Raceway, Real, Spall
from difftrb.law import roller_curves
from difftrb.law.base import Law, Rest, kind
from difftrb.law.direct_curves import DirectByCurves
from difftrb.law.direct_states import DirectByStates
from difftrb.law.samples import Node, Progress
from difftrb.ring import effect_base, roller_balance, roller_places
from difftrb.ring.effects import Raceways, SeriesRaceways, Through, Tilt
from difftrb.scene import checks, solving
from difftrb.scene.audit_states import AtPhase, Key, State, at_phase, solve_contacts
from difftrb.scene.cage_phases import at_phase_numbered, phases
from difftrb.scene.prepared_scene import solve_prepared
from difftrb.scene.scene import LawName, PitchMean, Scene, raceway_contact
from difftrb.scene.solution import Solution

AUDITED_PHASES = 7
"""Of a mean over phases so many are audited, spread over all of them."""
CONTACTS_KEEP = 5.0
"""Contacts are as exact as asked for in nine of ten cases. Of 300 random scenes one was 3.4 times as far off, at 1e-4:
all its rollers stood on a sliver of land between a spall and the roller's end."""
TABLES_KEEP = 12.0
"""Nine in ten random contacts are as exact as the table says, others at most so many times as far off, of 400."""


class Audited(NamedTuple):
    """One roller, audited.

    Attributes:
      phase: of the cage [rad]. roller: its number, of a second row counted on.
      spalls: numbers of the spalls in its reach.
      load: by the law [N]. error: what its contacts would carry more at the same approach [N].
    """

    phase: float
    roller: int
    spalls: tuple[int, ...]
    load: float
    error: float


@dataclasses.dataclass(frozen=True)
class Audit:
    """What contact solves say of a solution.

    Attributes:
      rollers: every one that was audited.
      load_error: the largest error of a load, relative to the largest load of the ring [-].
      stiffness_error: of radial and axial stiffness, relative [-], shape (2,): what they would be by these contacts.
      promised: what the law promises of `load_error`; NaN if it promises nothing.
      accuracy: of the contacts. contacts: how many were solved.
      failed: of how many rollers contacts did not converge; these are left out.
      remark: why there is nothing to audit, or what was left out; empty else.
    """

    rollers: tuple[Audited, ...]
    load_error: float
    stiffness_error: np.ndarray
    promised: float
    accuracy: float
    contacts: int
    failed: int
    remark: str = ""

    @property
    def kept(self) -> bool:
        """Whether nothing is farther off than promised, as far as anything is. A contact that did not converge, where
        something is promised, leaves that open: then not."""
        return not self.load_error > self.promised and not (self.failed and math.isfinite(self.promised))

    @property
    def sentence(self) -> str:
        """All of it, for people."""
        if not self.rollers:
            return f"audit: {self.remark}"
        worst = max(self.rollers, key=lambda each: abs(each.error))
        promise = f"promised {self.promised:.1e}" if math.isfinite(self.promised) else "nothing is promised"
        text = (
            f"audit: {self.contacts} contacts solved to {self.accuracy:g}; loads are off by up to "
            f"{self.load_error:.1e} of the largest ({promise}), worst at roller {worst.roller}; stiffness by "
            f"{self.stiffness_error[0]:.1e} radial, {self.stiffness_error[1]:.1e} axial"
        )
        if self.load_error > self.promised:
            text += ": that is more than promised"
        if self.failed:
            text += f"; contacts of {self.failed} rollers did not converge, so that these are not audited"
        return text + (f"; {self.remark}" if self.remark else "")

    def record(self) -> dict[str, Any]:
        """All of it, for machines."""
        worst = max(self.rollers, key=lambda each: abs(each.error), default=None)
        return {
            "load_error": self.load_error,
            "promised": self.promised,
            "kept": self.kept,
            "stiffness_error": dict(zip(("radial", "axial"), self.stiffness_error.tolist(), strict=True)),
            "worst": None if worst is None else worst._asdict(),
            "accuracy": self.accuracy,
            "contacts": self.contacts,
            "failed": self.failed,
            "remark": self.remark,
        }


def verify(scene: Scene, found: Solution | None = None, progress: Progress | None = None) -> Audit:
    """Audit the solution of a scene, by contacts solved afresh for the states in which its rollers ended.

    Args:
      scene: as solved: prepared, or with its law by name.
      found: the solution: what `solve` returned for it; None solves it first.
      progress: told how many of how many contacts are solved.

    Of a mean over phases `AUDITED_PHASES` are audited. Contacts are solved finer than the law's: a power law's to 1e-3,
    others to the next finer accuracy. Slices of ISO/TS 16281 (`effects.Tilt` with law "palmgren") have no contacts to
    compare with: their audit is empty, and says so. Raises SolveError for a solution that did not converge. Outside jit
    only; not differentiable.
    """
    scene = checks.checked(scene)
    if found is None:
        scene = solving.prepare(scene)
        found = solve_prepared(scene)
    found = found.check()
    if effect_base.among(scene.effects, Tilt) is not None and not isinstance(found.law, DirectByStates):
        return _nothing("effects.tilt goes by slices, which have no contact to compare with")
    ready = _ready(scene, found)
    parts = [at_phase(each) for each in _at_phases(ready)]
    accuracy = finer(found.law)
    nodes = solve_contacts([state for part in parts for state in part.states], accuracy, progress)
    judged = [_judged(part, nodes, accuracy) for part in parts]
    rollers = tuple(each for part in judged for each in part.rollers)
    if not rollers:
        return _nothing("no roller carries a load")
    worst = max(judged, key=lambda part: part.load_error - np.nan_to_num(part.promised, nan=np.inf))
    errors = np.max([part.stiffness_error for part in judged], axis=0)
    failed = sum(part.failed for part in judged)
    return dataclasses.replace(worst, rollers=rollers, stiffness_error=errors, failed=failed)


def _nothing(remark: str) -> Audit:
    return Audit((), math.nan, np.full(2, math.nan), math.nan, math.nan, 0, 0, remark)


def finer(of: Law) -> float:
    """The accuracy of contacts to audit a law by."""
    if of.hard:
        return 1e-3
    own = float(of.error) if isinstance(of, DirectByCurves | DirectByStates) else 1e-3
    return max((a for a in GRIDS if a < 0.5 * own), default=min(GRIDS))


def _ready(scene: Scene, found: Solution) -> Scene:
    """The scene as it was prepared."""
    inner_missing = any(isinstance(e, Raceways) and not isinstance(e, SeriesRaceways) for e in scene.effects)
    if isinstance(scene.law, LawName) and not inner_missing:
        return dataclasses.replace(scene, law=found.law)
    return solving.prepare(scene)


def _at_phases(scene: Scene) -> list[Scene]:
    """The scene at the cage phases to audit."""
    if not isinstance(scene.phase, PitchMean):
        return [dataclasses.replace(scene, phase=float(cast(float, scene.phase)))]
    each = np.asarray(phases(scene)[0])
    every = np.unique(each, return_index=True)[1]  # kinks that coincide leave the same phase many times
    numbers = every[np.unique(np.linspace(0, every.size - 1, AUDITED_PHASES).astype(int))]
    return [at_phase_numbered(scene, int(k), float(each[k])) for k in numbers]


def _judged(part: AtPhase, nodes: Mapping[Key, Node], accuracy: float) -> Audit:
    """The audit of one phase."""
    largest = float(np.max(part.loads))
    rollers, failed = [], 0
    stiffness, powers, errors = np.zeros(part.loads.size), np.ones(part.loads.size), np.zeros(part.loads.size)
    tilted: list[tuple[int, Node]] = []
    for state in part.states:
        own = [nodes[each.key] for each in state.contacts]
        if any(node.status_code for node in own):
            failed += 1
            continue
        j, load = state.roller, state.contacts[0].case.load
        approach, compliance = _approach(part, state, own)
        powers[j] = approach / (compliance * load)
        carried, stiffness[j] = _carried_there(state, part, load, approach, powers[j])
        error = max(carried, 0.0) - part.loads[j]
        errors[j] = error
        tilted.append((j, dataclasses.replace(own[0], compliance=compliance)))
        spalls = tuple(number for each in state.contacts for number in each.spalls)
        rollers.append(Audited(float(part.here.phase), j, spalls, float(part.loads[j]), float(error)))
    load_error = max((abs(each.error) for each in rollers), default=0.0) / largest
    if part.turns is None:
        stiffness_error = _stiffness_error(part, errors, stiffness, powers)
    else:
        stiffness_error = _tilted_stiffness_error(part, part.turns, tilted)
    return Audit(tuple(rollers), load_error, stiffness_error, _promised(part), accuracy, len(nodes), failed)


def _carried_there(state: State, part: AtPhase, load: float, approach: float, power: float) -> tuple[float, float]:
    """What a roller's contacts, solved at this `load` [N] and `approach` [mm], with d log Q/d log δ the `power`, carry
    where it is [N], and their stiffness there [N/mm]. One that carries hardly anything was pressed more than it is: by
    that power, unless a spall is under it, where load may begin at any approach."""
    at, own, slope = float(part.approach[state.roller]), float(part.loads[state.roller]), power * load / approach
    carried = load + (at - approach) * slope
    if carried >= load or own >= load:
        return carried, slope
    if at <= 0.0 or any(each.spalls for each in state.contacts):
        return carried, 0.0
    carried = load * (at / approach) ** power
    return carried, power * carried / at


def _approach(part: AtPhase, state: State, own: list[Node]) -> tuple[float, float]:
    """How far a roller approaches under the load of its contacts [mm], and by how much more under more [mm/N]: contacts
    and flange in series, over a through spall by its depth."""
    seat, load = part.terms.seat, state.contacts[0].case.load
    approach, compliance = own[0].approach + _depth(part, state.roller), own[0].compliance
    if len(own) > 1 and seat is not None:
        ratio = float(seat.ratio)
        approach += own[1].approach / ratio
        compliance += own[1].compliance / ratio**2
    if seat is not None and seat.flange_compliance is not None:
        along = roller_balance.flange_approach(seat, xp.variable(np.asarray(load)))
        approach += float(along.value)
        compliance += float(along.by[0])
    return approach, compliance


def _depth(part: AtPhase, j: int) -> float:
    """How far a through spall lets this roller down [mm]."""
    if effect_base.among(part.scene.effects, Through) is None:
        return 0.0
    spalls, away = roller_places.spalls_on(part.scene.spalls, "outer"), part.here.distances("outer", part.terms)
    under = int(roller_curves.spalls_under(spalls, away)[j]) if spalls else 0
    return float(spalls[under - 1].depth) if under else 0.0


def _stiffness_error(part: AtPhase, errors: np.ndarray, stiffness: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Of radial and axial stiffness: the ring once more, by contacts' loads and slopes, to the first order."""
    normals = part.normals
    tangent = (normals.T * stiffness) @ normals
    free = np.ones(normals.shape[1], bool)
    if part.terms.axial is not None:
        free[2] = False
    moved = np.zeros(free.size)
    moved[free] = -np.linalg.lstsq(tangent[np.ix_(free, free)], (normals.T @ errors)[free], rcond=None)[0]
    change = errors + stiffness * (normals @ moved)
    loaded = part.loads > 0.0
    relative = np.where(loaded, change / np.where(loaded, part.loads, 1.0), 0.0)
    corrected = stiffness * np.maximum(1.0 + (1.0 - 1.0 / powers) * np.clip(relative, -0.5, 0.5), 0.0)
    found = np.asarray(part.found.stiffness)[[0, 2], [0, 2]]
    if part.found.definition == "secant":
        u = np.asarray(part.found.displacement)[:3]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.abs(u[[0, 2]] / (u + moved[:3])[[0, 2]] - 1.0) + 0.0 * found
    tangent = (normals.T * corrected) @ normals
    return np.abs(np.array([tangent[0, 0], tangent[2, 2]]) / found - 1.0)


def _tilted_stiffness_error(part: AtPhase, turns: np.ndarray, tilted: list[tuple[int, Node]]) -> np.ndarray:
    """The same of rings that tilt: stiffness by the contacts' own slopes, under the loads and tilts that were found."""
    if part.found.definition == "secant":
        return np.full(2, math.nan)
    tangent = np.zeros((5, 5))
    for j, node in tilted:
        if node.tilt_response is None or part.loads[j] <= 0.0:
            continue
        along, turned = part.normals[j], turns[j]
        # a contact's tilt lifts what the ring's presses in
        stiff, leaned = 1.0 / node.compliance, -node.tilt_response.by_tilt
        crossed = -stiff * leaned * np.outer(along, turned)
        own = -node.tilt_response.moment_by_tilt + stiff * leaned**2
        tangent += stiff * np.outer(along, along) + crossed + crossed.T + own * np.outer(turned, turned)
    found = np.asarray(part.found.stiffness)
    return np.abs(np.array([tangent[k, k] / found[k, k] for k in (0, 2)]) - 1.0)


# ------------------------------------------------------------------------------------------------ promises


def _promised(part: AtPhase) -> float:
    """What the laws promise of a load's error, relative to the largest load."""
    largest = float(np.max(part.loads))

    def rest(raceway: Raceway, loads: np.ndarray) -> Rest:
        return Rest(raceway_contact(part.scene, raceway).radius, part.approach, loads)

    spalls, away = roller_places.spalls_on(part.scene.spalls, "outer"), part.here.distances("outer", part.terms)
    every = [promised(part.here.law, spalls, away, rest("outer", part.loads), largest)]
    inner_raceway, seat = part.terms.inner_raceway, part.terms.seat
    if inner_raceway is not None and seat is not None:
        inner = rest("inner", np.asarray(roller_balance.inner_load(seat, part.loads)))
        every.append(promised(inner_raceway.law, inner_raceway.spalls, inner_raceway.distances, inner, largest))
    return float(np.max(every))  # NaN stays


def promised(of: Law, spalls: tuple[Spall, ...], distances: Any, rest: Rest, largest: float) -> float:
    """What a law promises of the error of rollers' loads at rest, relative to the `largest` load [N]; NaN if nothing.

    Contacts hold what was asked for `CONTACTS_KEEP` times over, the table what was measured `TABLES_KEEP` times. A hard
    window knows no roller on a spall's rolling edge: it carries anything between what a healthy one would and one in
    the spall. A power law promises nothing of a ring whose rollers carry more than it was fitted to, and the paper's
    nothing at all: it is told by contacts that were cut off.
    """
    if isinstance(of, DirectByCurves | DirectByStates):
        return CONTACTS_KEEP * float(of.error)
    error = float(of.error)
    if not of.hard:
        return TABLES_KEEP * error
    promises = kind(of.name).promises
    if not promises or float(np.max(rest.loads)) > float(of.load_range[1]) * (1.0 + 1e-9):
        return math.nan
    lost = 0.0
    for spall, away in zip(spalls, distances, strict=True):
        beside = np.abs(np.abs(away) - 0.5 * spall.width)
        on_edge = (beside**2 < 2.0 * rest.radius * rest.approach) & (rest.approach > 0.0)
        if bool(np.any(on_edge)):
            levels = [_carried(of, rest.approach, spall, place) for place in (spall.width + 1.0, 0.0)]
            lost = max(lost, float(np.max(np.where(on_edge, levels[0] - levels[1], 0.0))))
    return error + lost / largest


def _carried(of: Law, approach: jax.Array, spall: Spall, place: Real) -> jax.Array:
    """What rollers at `approach` [mm], shape (rollers,), would carry if all stood so far from the spall [mm]."""
    every: Any = np.broadcast_to(np.asarray(place), (1, approach.size))
    curves = of.curves((spall,), every)
    return roller_curves.roller_loads(curves, approach)[0]
