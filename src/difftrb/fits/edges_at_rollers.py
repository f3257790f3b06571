"""Spalls whose edges lie where rollers stood when they were measured, or half way between two of them.

A row at a phase of the cage changes with the place of an edge as long as a roller stands on it, over a fraction of a
millimetre, and with no other place of it. What explains all rows is therefore a thin line in width and angle, between
cliffs, which points spread over the range go past. In the places of both edges, though, there are few cases: each lies
at one of the rollers, or in one of the gaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import geometry
from difftrb.fits import conditions
from difftrb.fits.fit_problem import Problem
from difftrb.fits.parameters import OfSpall
from difftrb.law import load_curve
from difftrb.ring import roller_places
from difftrb.ring.load import largest_load
from difftrb.scene.scene import law_in_effect, outer_law

FIELDS = "width", "angle"
WIDEST = 2.5
"""Spalls up to this wide, of what parts two rollers; wider ones are left to points that are spread over the range."""
NARROW = 1.2, 2.5, 5.0
"""Widths, of a ramp's length, of spalls in the middle of a roller's contact, which no other roller need meet."""
NEAREST = 0.75
"""Which share of the cases that are tried are those nearest to the load line, if there are too many; the others are
spread over the rest of the ring."""
ON_RAMP = np.array([0.02, 0.15, 0.3, 0.5, 0.7, 0.85, 0.98])
"""Where on a ramp, of its length, an edge that is moved is tried."""
AWAY = 0.6
"""How far an edge is moved at most, of what parts two rollers."""


class Edges(NamedTuple):
    """A spall's ends that are sought.

    Attributes:
      own: which of the parameters they are, by field. width, angle: of the scene's spall [mm, rad], where not sought.
      radius: of the raceway [mm]. pitch: what parts two rollers [rad].
      rollers: angles at which they stood at any phase that was measured [rad], rising, shape (angles,).
      ramp: how far a roller has come over the spall where its load begins to drop, and where it has [mm].
    """

    own: dict[str, int]
    width: float
    angle: float
    radius: float
    pitch: float
    rollers: np.ndarray
    ramp: tuple[float, float]


def moved(problem: Problem, points: np.ndarray) -> np.ndarray:
    """These points, coordinates of shape (points, parameters), with other widths and angles as far as there are cases,
    of too many those nearest to the load line and some of the others; as they are where neither is sought, or no row is
    at a phase."""
    values = np.array(problem.bounds.values(points))
    for k, edges in enumerate(sought(problem)):
        cases = _cases(edges)
        near = int(NEAREST * len(points))
        if len(cases) > len(points):
            others = np.linspace(near, len(cases) - 1, len(points) - near).round().astype(int)
            cases = cases[[*range(near), *others]]
        if k:  # else both spalls were the same one
            cases = np.random.default_rng(k).permutation(cases)
        for field, i in edges.own.items():
            values[: len(cases), i] = cases[:, FIELDS.index(field)]
    return np.where(values == problem.bounds.values(points), points, _coordinates(problem, values))


def beside(problem: Problem, points: np.ndarray) -> np.ndarray:
    """These points, coordinates of shape (points, parameters), with one edge moved, or the whole spall, to where that
    edge is at a roller or between two of them; shape (more points, parameters)."""
    found = [np.zeros((0, points.shape[1]))]
    for edges in sought(problem):
        for values in problem.bounds.values(points):
            cases = _moves(edges, *_size(edges, values))
            more = np.tile(values, (len(cases), 1))
            for field, i in edges.own.items():
                more[:, i] = cases[:, FIELDS.index(field)]
            found.append(_coordinates(problem, more))
    return np.concatenate(found)


def kept(problem: Problem, every: Sequence[Edges], point: np.ndarray, i: int, at: float) -> np.ndarray:
    """The point, coordinates of shape (parameters,), with the i-th parameter `at` another coordinate and either edge of
    the spall where it is, shape (2, parameters). Of a parameter that is no width or angle of a spall of which both are
    sought: none, shape (0, parameters)."""
    found = np.zeros((0, len(point)))
    for edges in every:
        if len(edges.own) == 2 and i in edges.own.values():
            found = np.stack([point, point])
            found[:, i] = at
            values, there = problem.bounds.values(point), problem.bounds.values(found[0])
            width, angle = (edges.own[field] for field in FIELDS)
            for side, to in zip((-1.0, 1.0), found, strict=True):
                here = there.copy()
                if i == width:
                    here[angle] = values[angle] + side * 0.5 * (values[width] - there[width]) / edges.radius
                else:
                    here[width] = values[width] + side * 2.0 * (values[angle] - there[angle]) * edges.radius
                to[:] = _coordinates(problem, here)
                to[i] = at
    return found


def _coordinates(problem: Problem, values: np.ndarray) -> np.ndarray:
    return problem.bounds.coordinates(np.clip(values, problem.bounds.low, problem.bounds.high))


def room(problem: Problem) -> np.ndarray:
    """How far to move what moves edges, so that those in the middle of a ramp do not leave it, in coordinates in the
    middle of the range, shape (parameters,); infinite for what moves none."""
    low, high = problem.bounds.ends()
    found = np.full(len(problem.parameters), np.inf)
    for edges in sought(problem):
        most = 0.25 * (edges.ramp[1] - edges.ramp[0]) / edges.radius  # another quarter may come by the other one
        for field, i in edges.own.items():
            share = most if field == "angle" else 2.0 * most / edges.pitch
            found[i] = 4.0 * share / (high[i] - low[i])
    return found


def sought(problem: Problem) -> list[Edges]:
    """Of every spall of which width or angle is sought; none where no row is at a phase, or rollers are over an edge or
    not."""
    bearing, phases = problem.scene.bearing, conditions.phases(problem.conditions)
    if problem.scene.law.hard:  # type: ignore[union-attr]  # it is prepared
        return []
    those = [(i, p) for i, p in enumerate(problem.parameters) if isinstance(p, OfSpall) and p.field in FIELDS]
    found = []
    for number in sorted({parameter.number for _, parameter in those} if len(phases) else ()):
        spall = problem.scene.spalls[number]
        if spall.surface == "roller":
            continue
        own = {parameter.field: i for i, parameter in those if parameter.number == number}
        angles = np.mod(roller_places.roller_angles(bearing, phases), 2.0 * np.pi)
        found.append(Edges(
            own, float(spall.width), float(spall.angle), float(geometry.arc_radius(bearing, spall.surface)),
            float(geometry.roller_pitch(bearing)), np.unique(np.round(angles, 9)), _ramp(problem, number),
        ))  # fmt: skip
    return found


def _ramp(problem: Problem, number: int) -> tuple[float, float]:
    """Of the most loaded roller: see `Edges`."""
    scene = problem.scene
    law = xp.fixed(law_in_effect(scene, outer_law(scene)))
    healthy = load_curve.one_of(law.curves((), np.zeros((0, 1))).each, 0)
    approach = load_curve.approach(healthy, xp.asarray(largest_load(scene.bearing, scene.load)))
    low, high = law.ramp(number, scene.spalls[number], approach)
    return float(low), float(high)


def _cases(edges: Edges) -> np.ndarray:
    """Widths [mm] and angles [rad] of spalls from a roller or gap to another, shape (cases, 2)."""
    begins, ends = (_edge_angles(edges, side, np.array([0.5])) for side in (-1.0, 1.0))
    if len(edges.own) == 2:
        begins, ends = np.meshgrid(begins, ends, indexing="ij")
        apart = np.mod(ends - begins, 2.0 * np.pi)
        near = (apart > 0.0) & (apart <= WIDEST * edges.pitch)
        widths = (edges.ramp[1] - edges.ramp[0]) * np.array(NARROW)
        narrow, at = (each.ravel() for each in np.meshgrid(widths, edges.rollers))
        width = np.concatenate([edges.radius * apart[near], narrow])
        angle = np.concatenate([(begins + 0.5 * apart)[near], at])
    elif "angle" in edges.own:
        half = 0.5 * edges.width / edges.radius
        angle = np.concatenate([begins + half, ends - half])
        width = np.full(len(angle), edges.width)
    else:
        away = [side * geometry.wrapped(angles - edges.angle) for side, angles in ((-1.0, begins), (1.0, ends))]
        width = 2.0 * edges.radius * np.concatenate(away)
        width = width[(width > 0.0) & (width <= WIDEST * edges.pitch * edges.radius)]
        angle = np.full(len(width), edges.angle)
    angle = geometry.wrapped(angle)
    return np.stack([width, angle], axis=1)[np.argsort(np.abs(angle), kind="stable")]


def _size(edges: Edges, values: np.ndarray) -> tuple[float, float]:
    """Width [mm] and angle [rad] at these values of the parameters."""
    width, angle = (float(values[edges.own[f]]) if f in edges.own else getattr(edges, f) for f in FIELDS)
    return width, angle


def _moves(edges: Edges, width: float, angle: float) -> np.ndarray:
    """Widths [mm] and angles [rad] of a spall with an edge moved, or all of it, shape (cases, 2)."""
    half, found = 0.5 * width / edges.radius, list[np.ndarray]()
    for side in (-1.0, 1.0):
        angles = _edge_angles(edges, side, ON_RAMP)
        step = geometry.wrapped(angles - (angle + side * half))
        step = step[np.abs(step) <= AWAY * edges.pitch]
        if len(edges.own) == 2:
            found.append(np.stack([width + side * step * edges.radius, angle + 0.5 * step], axis=1))
        elif "angle" in edges.own:
            found.append(np.stack([np.full(len(step), width), angle + step], axis=1))
        else:
            found.append(np.stack([width + 2.0 * side * step * edges.radius, np.full(len(step), angle)], axis=1))
    every = np.concatenate(found)
    return np.stack([every[:, 0], geometry.wrapped(every[:, 1])], axis=1)[every[:, 0] > 0.0]


def _edge_angles(edges: Edges, side: float, shares: np.ndarray) -> np.ndarray:
    """Angles [rad] of a spall's edge on this side where it is at a roller, by shares of a ramp's length, or half way to
    the next one, shape (angles,)."""
    over = (edges.ramp[0] + shares * (edges.ramp[1] - edges.ramp[0])) / edges.radius
    gaps = edges.rollers + 0.5 * np.mod(np.roll(edges.rollers, -1) - edges.rollers, 2.0 * np.pi)
    return np.concatenate([(edges.rollers[:, None] + side * over).ravel(), gaps])
