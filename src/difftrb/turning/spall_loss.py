"""What spalls cost as the cage turns, and what spalls of other sizes would cost in the mean over its turn: of
numbers, many rings at a time, nothing compiled. What figures are drawn from."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple, cast

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry, status
from difftrb.core.taylor import Taylor
from difftrb.law import base
from difftrb.law.base import Law
from difftrb.ring import effect_base
from difftrb.ring.phase_kinks import HealthyRing
from difftrb.scene.cage_phases import healthy_ring
from difftrb.scene.cage_phases import phases as phases_of
from difftrb.scene.prepared_scene import as_defined, at_phases, solve_prepared
from difftrb.scene.scene import PitchMean, Scene, healthy, outer_law
from difftrb.scene.solution import stiffness_loss

CROWDED = 1.5
"""Power by which lengths of a map crowd towards the longest."""


class Turn(NamedTuple):
    """A ring at many phases of its cage.

    Attributes:
      phases: angle of roller 0 from the load line [rad], shape (phases,).
      stiffness, healthy: with spalls and without [N/mm], shape (phases, 3, 3).
      loads, healthy_loads: of the rollers, with spalls and without [N], shape (phases, rollers).
    """

    phases: np.ndarray
    stiffness: np.ndarray
    healthy: np.ndarray
    loads: np.ndarray
    healthy_loads: np.ndarray


class LossMap(NamedTuple):
    """What a spall of any size costs in the mean over the cage's turn.

    Attributes:
      lengths, widths: of the first spall [mm], shapes (lengths,) and (widths,).
      loss: of radial and axial stiffness [%], shape (2, lengths, widths); NaN where the law does not know the spall.
      by_length, by_width: its exact derivatives [% per mm], the same shape.
    """

    lengths: np.ndarray
    widths: np.ndarray
    loss: np.ndarray
    by_length: np.ndarray
    by_width: np.ndarray


def over_turn(scene: Scene, count: int = 240, alike: Turn | None = None) -> Turn | None:
    """The stiffness of a prepared scene at `count` phases over one roller pitch, both ends among them. None where
    rollers differ from each other, its law is made for one phase, a spall turns along, or there is no solution.
    `alike`: the same with other spalls, whose healthy rings are this one's, too."""
    if not _is_for_all_phases(scene):
        return None
    scene = xp.numbers(scene)
    phases = np.linspace(0.0, float(geometry.roller_pitch(scene.bearing)), count)
    found = _rings(scene, phases)
    whole = (alike.healthy, alike.healthy_loads) if alike else _rings(healthy(scene), phases)
    if found is None or whole is None:
        return None
    return Turn(phases, found[0], whole[0], found[1], whole[1])


@np.errstate(all="ignore")
def _rings(scene: Scene, phases: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Stiffness [N/mm] and loads [N] at these phases; None without a solution."""
    rest = at_phases(scene, phases)
    return None if int(rest.status_code) != status.CONVERGED else xp.values((as_defined(scene, rest), rest.loads))


def loss_map(scene: Scene, lengths: np.ndarray, widths: np.ndarray) -> LossMap | None:
    """The loss of stiffness of a prepared scene, in the mean over the cage's turn, as its first spall has other sizes
    [mm]. None as in `over_turn`, without a spall on the outer raceway, and for one so narrow that a roller may meet
    both its edges: such spalls are solved one at a time."""
    if not _is_for_all_phases(scene) or not scene.spalls or scene.spalls[0].surface != "outer":
        return None
    if getattr(scene.law, "narrow", False):
        return None
    scene = xp.numbers(scene)
    mean = solve_prepared(dataclasses.replace(healthy(scene), phase=PitchMean()))
    whole = xp.numbers(mean).both_stiffnesses
    values = np.full((3, 2, len(lengths), len(widths)), np.nan)
    known = healthy_ring(scene, np.array([[scene.load.radial, scene.load.axial]], float))
    at_rest = None if known is None else HealthyRing(*(part[0] for part in known))
    with np.errstate(all="ignore"):
        for i, length in enumerate(lengths):
            rows = _losses(scene, whole, float(length), widths, at_rest)
            if np.isnan(rows).all():  # one that the law does not know spoils all
                alone = [_losses(scene, whole, float(length), w[None], at_rest) for w in widths]
                rows = np.concatenate(alone, axis=-1)
            values[:, :, i] = rows
    return LossMap(lengths, widths, *values)


def sizes_around(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Six lengths and five widths [mm] about the first spall's of a prepared scene: from an eighth of it to two and a
    half times the length, twice the width, as far as the law goes. Lengths are closer together where the loss rises
    steeply: what is drawn between is then within 0.1 % of stiffness; between even ones it was 0.4 off."""
    scene = xp.numbers(scene)
    spall, law = scene.spalls[0], outer_law(scene)

    def known(**size: float) -> bool:
        other = dataclasses.replace(spall, **size)
        return int(law.judge((other,), cast(Any, np.zeros((1, 1))))) == status.CONVERGED

    def until(name: str, far: float) -> float:
        """The farthest size that the law knows, between the spall's own and one far from it."""
        own = float(getattr(spall, name))
        steps = far + np.linspace(0.0, 1.0, 15) * (own - far)
        return next((float(size) for size in steps if known(**{name: float(size)})), own)

    length, width = float(spall.length), float(spall.width)
    longest = min(2.5 * length, base.kind(law.name).longest(float(scene.bearing.roller_length)))
    shortest, longest = until("length", length / 8.0), until("length", longest)
    lengths = shortest + (longest - shortest) * (1.0 - np.linspace(1.0, 0.0, 6) ** CROWDED)
    return lengths, np.linspace(until("width", width / 8.0), until("width", 2.0 * width), 5)


def _is_for_all_phases(scene: Scene) -> bool:
    stays = all(spall.surface == "outer" for spall in scene.spalls) and not effect_base.differ(scene.effects)
    return stays and not base.kind(cast(Law, scene.law).name).one_scene


def _losses(
    scene: Scene, whole: np.ndarray, length: float, widths: np.ndarray, at_rest: HealthyRing | None
) -> np.ndarray:
    """Loss [%] and its derivatives by length and width [% per mm] of spalls of one length and several widths, shape (3,
    2, widths), all their phases at once; NaN without a solution. `at_rest`: the healthy ring, if all phases have the
    same."""
    first, *others = scene.spalls
    along, across = Taylor(np.asarray(length), by=np.array([1.0, 0.0])), np.array([0.0, 1.0])
    every = [dataclasses.replace(first, length=along, width=Taylor(np.asarray(w), by=across)) for w in widths]
    mean = dataclasses.replace(scene, phase=PitchMean())
    found = [phases_of(dataclasses.replace(mean, spalls=(one, *others)), at_rest) for one in every]
    phases, weights = (xp.concatenate(parts) for parts in zip(*found, strict=True))
    count = len(phases) // len(widths)
    if len(widths) == 1:
        spall = every[0]
    else:
        width = np.repeat(widths, count)[:, None]
        wide = Taylor(width, by=across[:, None, None] * np.ones_like(width))
        spall = dataclasses.replace(first, length=along, width=wide)
    rest = at_phases(scene, phases, spalls=(spall, *others))
    if int(rest.status_code) != status.CONVERGED:
        return np.full((3, 2, len(widths)), np.nan)
    stiffness = as_defined(scene, rest)
    both = xp.stack([stiffness[..., k, k] for k in (0, 2)])
    shares = (both * weights).reshape(2, len(widths), count)
    means = xp.total(shares)
    return np.stack([stiffness_loss(means.value, whole[:, None]), *(-100.0 * means.by / whole[:, None])])
