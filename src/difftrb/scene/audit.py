"""The audit of a solution: contacts are solved afresh for the states in which the rollers ended.

Every distinct contact, with all the spalls in its reach, finer than the law's own. How much more or less a roller
would carry at its approach is the error of its load; what these errors, and the contacts' own slopes, do to the ring
is the error of the stiffness.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import solver as contacts
from difftrb.core.geometry import LineContact, Raceway, Spall
from difftrb.law import base as laws
from difftrb.law import samples
from difftrb.law.base import Law, Rest
from difftrb.law.direct import DirectLaw
from difftrb.law.local import LocalLaw
from difftrb.law.samples import Case, Node, Progress
from difftrb.ring import effects, ring, roller_balance
from difftrb.ring.effects import Raceways, SeriesRaceways, Through, Tilt
from difftrb.scene import preparation, solution
from difftrb.scene.auto_law import prepare
from difftrb.scene.promise import promised
from difftrb.scene.scene import LawName, PitchMean, Scene
from difftrb.scene.solution import Solution

PHASES = 7
"""Of a mean over phases so many are audited, spread over all of them."""
LIGHT = 1e-3
"""Share of the largest load at which the contact of a roller that carries nothing is solved."""


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
        text += ": that is more than promised" if self.load_error > self.promised else ""
        return (
            text
            + (
                f"; contacts of {self.failed} rollers did not converge, so that these are not audited"
                if self.failed
                else ""
            )
            + (f"; {self.remark}" if self.remark else "")
        )

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
    """Audit the `solution` of a scene, by contacts solved afresh for the states in which its rollers ended.

    Args:
      scene: as solved: prepared, or with its law by name.
      found: what `solve` returned for it; None solves it first.
      progress: told how many of how many contacts are solved.

    Of a mean over phases `PHASES` are audited. Contacts are solved finer than the law's: a power law's to 1e-3, others
    to the next finer accuracy. Slices of `effects.Tilt` have no contacts to compare with: its audit is empty, and says
    so. Raises SolveError for a solution that did not converge. Outside jit only; not differentiable.
    """
    scene = preparation.checked(scene)
    found = (solution.solved(prepare(scene)) if found is None else found).check()
    if any(isinstance(effect, Tilt) for effect in scene.effects):
        return _nothing("effects.tilt goes by slices, which have no contact to compare with")
    ready = _ready(scene, found)
    parts = [_at(ready, phase) for phase in _phases(ready)]
    accuracy = finer(found.law)
    wanted = [(part, state) for part in parts for state in part.states]
    solved = _solved([state for _, state in wanted], accuracy, progress)
    judged = []
    for part in parts:
        own = [node for (owner, _), node in zip(wanted, solved, strict=True) if owner is part]
        judged.append(_judged(ready, part, own))
    contacts_solved = len({key for _, state in wanted for key in state.keys})
    rollers = tuple(each for part in judged for each in part.rollers)
    if not rollers:
        return _nothing("no roller carries a load")
    worst = max(judged, key=lambda part: part.load_error - np.nan_to_num(part.promised, nan=np.inf))
    errors = np.max([part.stiffness_error for part in judged], axis=0)
    failed = sum(part.failed for part in judged)
    return Audit(rollers, worst.load_error, errors, worst.promised, accuracy, contacts_solved, failed)


def _nothing(remark: str) -> Audit:
    return Audit((), math.nan, np.full(2, math.nan), math.nan, math.nan, 0, 0, remark)


def finer(of: Law) -> float:
    """The accuracy of contacts to audit a law by."""
    if of.hard:
        return 1e-3
    own = float(of.error) if isinstance(of, DirectLaw | LocalLaw) else 1e-3
    return max((a for a in contacts.GRIDS if a < 0.5 * own), default=min(contacts.GRIDS))


def _ready(scene: Scene, found: Solution) -> Scene:
    """The scene as it was prepared."""
    inner_missing = any(isinstance(e, Raceways) and not isinstance(e, SeriesRaceways) for e in scene.effects)
    if isinstance(scene.law, LawName) and not inner_missing:
        return dataclasses.replace(scene, law=found.law)
    return prepare(scene) if isinstance(scene.law, LawName) else preparation.with_law(scene)


def _phases(scene: Scene) -> list[float]:
    """Cage phases to audit [rad]."""
    if not isinstance(scene.phase, PitchMean):
        return [float(cast(float, scene.phase))]
    every = np.unique(np.asarray(solution.phases(scene)[0]))  # kinks that coincide leave the same phase many times
    return [float(every[k]) for k in np.unique(np.linspace(0, every.size - 1, PHASES).astype(int))]


class _State(NamedTuple):
    """One roller at rest: its contacts with the raceways, one case each, and what they are known by."""

    roller: int
    raceways: tuple[Raceway, ...]
    contacts: tuple[LineContact, ...]
    cases: tuple[Case, ...]
    keys: tuple[tuple, ...]
    spalls: tuple[int, ...]


class _Part(NamedTuple):
    """A scene at one phase: its solution, what holds the rollers, approaches [mm] and loads [N] of all rows' rollers,
    and those to be audited."""

    phase: float
    found: Solution
    terms: ring.Terms
    normals: np.ndarray
    approach: np.ndarray
    loads: np.ndarray
    states: list[_State]
    promised: float


class _Judged(NamedTuple):
    rollers: list[Audited]
    load_error: float
    stiffness_error: np.ndarray
    promised: float
    failed: int


def _at(scene: Scene, phase: float) -> _Part:
    """The scene at one phase, with the contacts to solve."""
    at = dataclasses.replace(scene, phase=phase)
    found = solution.solved(at)
    outer = preparation.raceway_contact(at, "outer")
    acting = preparation.law_in_effect(at, found.law)
    here = effects.Ring(at.bearing, at.load, at.spalls, acting, outer, phase)
    terms = effects.terms(at.effects, here)
    angles, loads, approach = here.angles, np.asarray(found.loads), np.asarray(found.approach)
    normals = ring.directions(at.bearing, angles)
    if terms.pair is not None:
        pressed = 0.5 * terms.pair.preload * jnp.sin(at.bearing.outer_angle)  # in both, the rows' places and thickness
        second = terms.pair.rows(found.displacement, at.bearing.outer_angle)[1]
        thicker = jnp.broadcast_to(0.0 if terms.interference is None else terms.interference, (2 * angles.size,))
        more = jnp.matmul(normals, second, precision=jax.lax.Precision.HIGHEST) + (thicker - pressed)[angles.size :]
        loads = np.concatenate([loads, np.asarray(found.effects["second_row_loads"])])
        approach = np.concatenate([approach, np.asarray(more)])
        normals = jnp.concatenate([normals, normals * jnp.array([[1.0, 1.0, -1.0]])])
    if terms.tilting is not None:
        normals = terms.tilting.directions(normals, jnp.tile(angles, normals.shape[0] // angles.size))
    states = _states(at, here, terms, approach, loads)
    return _Part(phase, found, terms, np.asarray(normals), approach, loads, states,
                 _promised(at, acting, here, terms, approach, loads))  # fmt: skip


def _states(
    scene: Scene, here: effects.Ring, terms: ring.Terms, approach: np.ndarray, loads: np.ndarray
) -> list[_State]:
    """Rollers that carry a load, or may, each with the contacts that hold it."""
    largest = float(np.max(loads))
    through = any(isinstance(effect, Through) for effect in scene.effects)
    raceways: tuple[Raceway, ...] = ("outer", "inner") if terms.facing is not None else ("outer",)
    least = float(terms.seat.least) if terms.seat is not None else 0.0
    share = ring.OWN if len(raceways) > 1 else 1.0
    met: dict[Raceway, tuple[tuple[Spall, ...], np.ndarray, np.ndarray]] = {}
    for raceway in raceways:
        spalls = () if through else ring.spalls_on(scene.spalls, raceway)
        away = np.asarray(here.distances(raceway, terms))[: len(spalls)]
        rest = Rest(
            preparation.raceway_contact(scene, raceway).radius, share * jnp.asarray(approach), jnp.asarray(loads)
        )
        reached = [np.asarray(rest.in_reach(s, jnp.asarray(d))) for s, d in zip(spalls, away, strict=True)]
        met[raceway] = spalls, away, np.array(reached).reshape(len(spalls), loads.size)
    states = []
    for j, load in enumerate(loads):
        if approach[j] <= 0.0:
            continue
        pressed = max(float(load), LIGHT * largest)
        if least > 0.0 and pressed <= least * (
            1.0 + 1e-9
        ):  # held by its own weight's throw, clear of the inner raceway
            continue
        every = {"outer": pressed}
        if len(raceways) > 1:
            every["inner"] = float(roller_balance.inner_load(terms.seat, jnp.asarray(pressed)))  # type: ignore[arg-type]
        cases, keys, own = [], [], []
        for raceway in raceways:
            spalls, away, reached = met[raceway]
            under = [i for i in range(len(spalls)) if reached[i, j]]
            places = [float(away[i, j]) for i in under]
            cases.append(samples.case_under(every[raceway], [spalls[i] for i in under], places))
            own += [scene.spalls.index(spalls[i]) for i in under]
            keys.append(_key(raceway, every[raceway], under, places))
        states.append(_State(
            j, raceways, tuple(preparation.raceway_contact(scene, raceway) for raceway in raceways), tuple(cases),
            tuple(keys), tuple(own),
        ))  # fmt: skip
    return states


def _key(raceway: Raceway, load: float, under: Sequence[int], places: Sequence[float]) -> tuple:
    """Equal for contacts that are one: the same, or mirror images in the rolling direction."""
    side = -1.0 if places and places[0] < 0.0 else 1.0
    return raceway, f"{load:.6e}", tuple(under), tuple(f"{side * place:.6f}" for place in places)


def _solved(states: Sequence[_State], accuracy: float, progress: Progress | None) -> list[tuple[Node, ...]]:
    """The contacts of every state; equal ones are solved once."""
    wanted: dict[tuple, tuple[LineContact, Case]] = {}
    for state in states:
        for key, contact, case in zip(state.keys, state.contacts, state.cases, strict=True):
            wanted.setdefault(key, (contact, case))
    solved: dict[tuple, Node] = {}
    for raceway in ("outer", "inner"):
        keys = [key for key in wanted if key[0] == raceway]
        if keys:
            found = samples.all_solved(wanted[keys[0]][0], [wanted[key][1] for key in keys], accuracy, progress)
            solved |= dict(zip(keys, found, strict=True))
    return [tuple(solved[key] for key in state.keys) for state in states]


def _judged(scene: Scene, part: _Part, solved: Sequence[tuple[Node, ...]]) -> _Judged:
    """Errors of one phase."""
    largest = float(np.max(part.loads))
    seat = part.terms.seat
    rollers, failed = [], 0
    stiffness, powers, errors = np.zeros(part.loads.size), np.ones(part.loads.size), np.zeros(part.loads.size)
    for state, own in zip(part.states, solved, strict=True):
        if any(node.status_code for node in own):
            failed += 1
            continue
        j, load = state.roller, state.cases[0].load
        approach, compliance = own[0].approach + _depth(scene, part, j), own[0].compliance
        if len(own) > 1 and seat is not None:
            ratio = float(seat.inner_cos / seat.outer_cos)
            approach += own[1].approach / ratio
            compliance += own[1].compliance / ratio**2
        if seat is not None and seat.flange_compliance is not None:
            force, wedge = float(roller_balance.flange_load(seat, jnp.asarray(load))), float(seat.wedge)
            if force > 0.0:
                approach += wedge * float(seat.flange_compliance) * force ** (2.0 / 3.0)
                compliance += wedge**2 * float(seat.flange_compliance) * (2.0 / 3.0) * force ** (-1.0 / 3.0)
        carried = load + (part.approach[j] - approach) / compliance
        error = max(carried, 0.0) - part.loads[j]
        errors[j], powers[j] = error, approach / (compliance * load)
        stiffness[j] = 1.0 / compliance if carried >= load or part.loads[j] >= load else 0.0
        rollers.append(Audited(part.phase, j, state.spalls, float(part.loads[j]), float(error)))
    load_error = max((abs(each.error) for each in rollers), default=0.0) / largest
    return _Judged(rollers, load_error, _stiffness_error(scene, part, errors, stiffness, powers), part.promised, failed)


def _depth(scene: Scene, part: _Part, j: int) -> float:
    """How far a through spall lets this roller down [mm]."""
    if j >= part.found.loads.size or not any(isinstance(effect, Through) for effect in scene.effects):
        return 0.0
    spalls = ring.spalls_on(scene.spalls, "outer")
    away = ring.distances(scene.bearing, spalls, part.found.angles)
    under = int(laws.spalls_under(spalls, away)[j]) if spalls else 0
    return float(spalls[under - 1].depth) if under else 0.0


def _stiffness_error(
    scene: Scene, part: _Part, errors: np.ndarray, stiffness: np.ndarray, powers: np.ndarray
) -> np.ndarray:
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
    found = np.array([part.found.stiffness[0, 0], part.found.stiffness[2, 2]])
    if scene.definition == "secant":
        u = np.asarray(part.found.displacement)[:3]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.abs(u[[0, 2]] / (u + moved[:3])[[0, 2]] - 1.0) + 0.0 * found
    tangent = (normals.T * corrected) @ normals
    return np.abs(np.array([tangent[0, 0], tangent[2, 2]]) / found - 1.0)


def _promised(
    scene: Scene, of: Law, here: effects.Ring, terms: ring.Terms, approach: np.ndarray, loads: np.ndarray
) -> float:
    """What the laws promise of a load's error, relative to the largest load."""
    largest = float(np.max(loads))
    spalls, away = ring.spalls_on(scene.spalls, "outer"), here.distances("outer", terms)
    every = [promised(of, spalls, away, _rest(scene, "outer", approach, loads), largest)]
    if terms.facing is not None and terms.seat is not None:
        inner = np.asarray(roller_balance.inner_load(terms.seat, jnp.asarray(loads)))
        rest = _rest(scene, "inner", approach, inner)
        every.append(promised(terms.facing.law, terms.facing.spalls, terms.facing.distances, rest, largest))
    return float(np.max(every))  # NaN stays


def _rest(scene: Scene, raceway: Raceway, approach: np.ndarray, loads: np.ndarray) -> Rest:
    return Rest(preparation.raceway_contact(scene, raceway).radius, jnp.asarray(approach), jnp.asarray(loads))
