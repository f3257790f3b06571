"""A scene's `local` law: contacts are solved around the rollers' loads, and the ring on them, until these stay."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core.geometry import Raceway, Spall
from difftrb.core.numeric import chebyshev_nodes
from difftrb.law import load_curve, samples
from difftrb.law.base import Law, Rest
from difftrb.law.direct import DirectLaw
from difftrb.law.local import LocalLaw, States, through
from difftrb.law.samples import Node, Progress
from difftrb.ring import effects, ring, roller_balance
from difftrb.ring.effects import DoubleRow, Raceways, SeriesRaceways
from difftrb.scene.scene import Scene

ROUNDS = 8
FEW, SEARCHED = 3, 0.35
"""Solves of a state while its load is looked for, and by how much in the logarithm they are spread to either side."""
MANY, SPREAD = 7, 0.25
"""The same once it is found."""
NARROWER = 0.25
"""Where the curve bends, as it does where a bottom is met, by what its loads are spread less."""
BENDS = 5e-4
"""Residual of a state's curve, in the logarithm of the load, beyond which it does."""
FOUND = 0.1
"""Change of a load, in its logarithm, below which it is found."""
FARTHER = 1.05
"""By how much more than it approaches its raceway a roller is taken to reach for spalls."""
TOGETHER = 4
"""States are filled up to a multiple of this: every number of them would be a program of its own."""
LEAST_SHARE = 0.15
"""Least share of a healthy roller's load that one over a spall is taken to carry at first."""


class Reached(NamedTuple):
    """Spalls that one roller may meet on a raceway: the roller, which spalls, how far from them it is [mm], and how
    many rollers there are."""

    roller: int
    under: tuple[int, ...]
    away: tuple[float, ...]
    rollers: int


Bases = Mapping[Raceway, DirectLaw]
Laws = dict[Raceway, LocalLaw]


def with_laws(scene: Scene, laws: Mapping[Raceway, LocalLaw]) -> Scene:
    """The scene with a law for every raceway that gives way."""
    acting = tuple(
        SeriesRaceways(effect.inner_design_load, cast(Law, laws["inner"])) if isinstance(effect, Raceways) else effect
        for effect in scene.effects
    )
    return dataclasses.replace(scene, law=cast(Law, laws["outer"]), effects=acting)


def settled(scene: Scene, bases: Bases, progress: Progress | None = None) -> Laws:
    """The laws of every raceway for a scene at one phase, from those of healthy rollers. Needs numbers, not tracers.

    A scene that does not settle keeps the last laws, and its own status says that rollers are elsewhere.
    """
    spalls: dict[Raceway, tuple[Spall, ...]] = {way: ring.spalls_on(scene.spalls, way) for way in bases}
    laws: Laws = {raceway: LocalLaw(base, None, settling=True) for raceway, base in bases.items()}
    loads, reached = _at_rest(scene, laws, spalls)
    centres = {raceway: [_guess(scene, spalls[raceway], each, loads[raceway]) for each in reached[raceway]]
               for raceway in bases}  # fmt: skip
    found = False
    for _ in range(ROUNDS):
        way = (MANY, SPREAD) if found else (FEW, SEARCHED)
        laws = {
            raceway: _law(base, spalls[raceway], reached[raceway], np.array(centres[raceway]), *way, progress)
            for raceway, base in bases.items()
        }
        loads, now = _at_rest(scene, laws, spalls)
        least = {raceway: float(jnp.exp(base.log_loads[0])) for raceway, base in bases.items()}
        following = {
            raceway: [max(float(loads[raceway][each.roller]), least[raceway]) for each in now[raceway]]
            for raceway in bases
        }
        stays = _under(now) == _under(reached) and all(
            abs(np.log(a / b)) < FOUND
            for raceway in bases for a, b in zip(following[raceway], centres[raceway], strict=True)
        )  # fmt: skip
        if stays and found:
            break
        found, centres, reached = stays, following, now
    return {raceway: dataclasses.replace(law, settling=False) for raceway, law in laws.items()}


def _under(reached: Mapping[Raceway, Sequence[Reached]]) -> dict[Raceway, list[tuple]]:
    return {raceway: [each[:2] for each in every] for raceway, every in reached.items()}


def _guess(scene: Scene, spalls: tuple[Spall, ...], reached: Reached, loads: np.ndarray) -> float:
    """About the load [N] of a roller, from that on a healthy ring: by the land that is left."""
    length = float(scene.bearing.roller_length)
    land = 1.0 - sum(min(float(spalls[i].length), length) for i in reached.under) / length
    return float(loads[reached.roller]) * max(land, LEAST_SHARE) + 1e-3 * float(loads.max())


def _at_rest(
    scene: Scene, laws: Laws, spalls: Mapping[Raceway, tuple[Spall, ...]]
) -> tuple[dict[Raceway, np.ndarray], dict[Raceway, list[Reached]]]:
    """What rollers carry on every raceway [N], and the spalls that they may meet there."""
    found, away, approach = _solved(with_laws(scene, laws))
    pair = any(isinstance(effect, DoubleRow) for effect in scene.effects)
    share = FARTHER * (ring.OWN if "inner" in laws else 1.0)
    reached: dict[Raceway, list[Reached]] = {}
    for raceway in laws:
        rest = Rest(float(laws[raceway].contact.radius), share * approach, found[raceway])
        distances = np.asarray(away[raceway])
        rollers = scene.bearing.rollers * (2 if pair else 1)
        met = np.array([np.asarray(rest.in_reach(s, d)) for s, d in zip(spalls[raceway], distances, strict=True)])
        reached[raceway] = [
            Reached(
                int(j), tuple(map(int, np.flatnonzero(met[:, j]))), tuple(distances[met[:, j], j].tolist()), rollers
            )
            for j in (np.flatnonzero(met.any(axis=0)) if met.size else ())
        ]
    return {raceway: np.asarray(loads) for raceway, loads in found.items()}, reached


@jax.jit
def _solved(
    scene: Scene,
) -> tuple[dict[Raceway, jax.Array], dict[Raceway, jax.Array], jax.Array]:
    """Loads of the first row's rollers on every raceway [N], their distances from the spalls there [mm], and the
    ring's approach [mm], of a scene with laws."""
    law = cast(LocalLaw, scene.law)
    here = effects.Ring(scene.bearing, scene.load, scene.spalls, law, law.contact, scene.phase)  # type: ignore[arg-type]
    terms = effects.terms(scene.effects, here)
    rest = here.equilibrium(terms)
    loads: dict[Raceway, jax.Array] = {"outer": rest.loads}
    if terms.facing is not None and terms.seat is not None:
        loads["inner"] = roller_balance.inner_load(terms.seat, rest.loads)
    away: dict[Raceway, jax.Array] = {raceway: here.distances(raceway, ring.PLAIN) for raceway in loads}
    return loads, away, rest.approach


def _law(
    base: DirectLaw, spalls: tuple[Spall, ...], reached: Sequence[Reached], centres: np.ndarray, count: int,
    spread: float, progress: Progress | None,
) -> LocalLaw:  # fmt: skip
    """The law of rollers that carry about `centres` [N], shape (rollers reached,)."""
    way = np.asarray(chebyshev_nodes(count, -1.0, 1.0))
    logs = np.log(centres)[:, None] + spread * way
    solved = _cases(base, spalls, reached, logs, progress)
    for k, own in enumerate(solved):
        if count == MANY and _bend(logs[k], own) > BENDS:
            logs[k] = np.log(centres[k]) + NARROWER * spread * way
            (solved[k],) = _cases(base, spalls, reached[k : k + 1], logs[k : k + 1], progress)
    code = max(float(base.status_code), samples.worst_status([node for own in solved for node in own]))
    states = _stacked(base, spalls, reached, logs, solved) if reached else None
    return LocalLaw(dataclasses.replace(base, status_code=code), states, settling=True)


def _stacked(
    base: DirectLaw, spalls: tuple[Spall, ...], reached: Sequence[Reached], logs: np.ndarray,
    solved: Sequence[Sequence[Node]],
) -> States:  # fmt: skip
    """All that was solved; filled up to a multiple of `TOGETHER` states, so that scenes share programs."""
    count = len(spalls)
    slopes = np.zeros((len(reached), logs.shape[1], samples.count(count)))
    given, met = np.zeros((len(reached), slopes.shape[2])), np.zeros((len(reached), count))
    for k, (each, own) in enumerate(zip(reached, solved, strict=True)):
        under = list(each.under)
        met[k, under] = 1.0
        slopes[k][:, samples.places(under, count)] = [node.slopes for node in own]
        away = np.zeros(count)
        away[under] = each.away
        given[k] = samples.inputs(base.contact, spalls, jnp.asarray(away))
    at = np.zeros((len(reached), reached[0].rollers))
    at[np.arange(len(reached)), [each.roller for each in reached]] = 1.0
    approaches = np.array([[node.approach for node in own] for own in solved])
    more = -len(reached) % TOGETHER
    filled = [np.concatenate([field, np.repeat(field[:1], more, axis=0)])
              for field in (met, logs, approaches, given, slopes)]  # fmt: skip
    at = np.concatenate([at, np.zeros((more, at.shape[1]))])
    filled[0][len(reached) :] = 0.0
    return States(jnp.asarray(at), *map(jnp.asarray, filled))


def _cases(
    base: DirectLaw, spalls: tuple[Spall, ...], reached: Sequence[Reached], log_loads: np.ndarray,
    progress: Progress | None,
) -> list[list[Node]]:  # fmt: skip
    """Contacts of every roller reached at its `log_loads` [log N], shape (rollers reached, loads)."""
    cases = [
        samples.case_under(load, [spalls[i] for i in each.under], each.away)
        for each, row in zip(reached, log_loads, strict=True)
        for load in np.exp(row)
    ]
    solved = samples.all_solved(base.contact, cases, float(base.error), progress)
    count = log_loads.shape[1]
    return [solved[k : k + count] for k in range(0, len(solved), count)]


def _bend(log_loads: np.ndarray, solved: Sequence[Node]) -> float:
    """How far solves are from the curve nearest to them, at most, in log Q."""
    approaches = jnp.asarray([node.approach for node in solved])
    found, _ = load_curve.load(through(jnp.asarray(log_loads), approaches), approaches)
    return float(jnp.max(jnp.abs(jnp.log(found) - log_loads)))
