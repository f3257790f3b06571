"""Nested sampling over the unit cube: the evidence of data, and weighted points of what they leave of the prior.

First many points are drawn from the prior and the lowest of them die, until those are left that go on: whatever has a
share of the prior is among them, however many answers there are. Then a quarter of the points, the lowest ones, die
together; others that live move in their place, along slices of what lies above the highest of the dead (Skilling 2006;
Handley, Hobson and Lasenby 2015). Slices go whither two other points lie apart, and as far: within a narrow answer as
along a ridge. All that are under way ask for one point each at a time, and these are computed at once. It takes long,
but never longer than that: where posteriors are ridges with kinks, nautilus drew points from its networks for minutes
without one that it could use, and where they are level dynesty from its ellipsoids.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from difftrb.law.samples import Progress

TIE = 1e-6
"""Slope of the logarithm of the likelihood that is added along every side of the cube. Where data do not depend on the
parameters all points are equal, and how much of the prior lies below one could not be told."""
FIRST = 300
"""So many times the living points are drawn from the prior first: these cost an evaluation each, later ones dozens."""
PARTS = 20
"""In which these are computed: for the bar."""
SLICES = 3
"""Of every new point, for each dimension."""
DYING = 4
"""One in so many points dies in a round. With every other one the evidence scatters by half as much again."""
LEFT = 0.01
"""Share of the evidence that living points may still add in the end."""
LONG = 5.0
"""Length of a slice by the standard deviation of points: a ball is 4 … 5 across."""
LEAST = 1e-12
"""A slice as short as this has found nothing but the point where it began."""
BEHIND = 5.0
"""About how far the prior shrinks beyond the width of the likelihood, by factors of e: for the bar."""

LogLikelihood = Callable[[np.ndarray], np.ndarray]
"""Of points of the cube, shape (points, dimensions); shape (points,)."""


class Sampled(NamedTuple):
    """Points of the cube, shape (points, dimensions), and each one's share of the evidence, shape (points,); the
    logarithm of the evidence and its standard error; the highest logarithm of a likelihood; how many were computed."""

    points: np.ndarray
    shares: np.ndarray
    log_evidence: float
    error: float
    highest: float
    evaluations: int

    @property
    def effective(self) -> float:
        """As many points of equal weight would tell as much."""
        return float(1.0 / np.sum(self.shares**2))

    def drawn(self, count: int, seed: int) -> np.ndarray:
        """So many points of equal weight, shape (count, dimensions), in random order."""
        rng = np.random.default_rng(seed)
        # systematic: it adds the least of noise
        each = np.searchsorted(np.cumsum(self.shares), (rng.random() + np.arange(count)) / count)
        return self.points[rng.permutation(np.minimum(each, len(self.points) - 1))]


def sampled(
    log_likelihood: LogLikelihood, dimensions: int, live: int, seed: int, nats: float = 10.0,
    progress: Progress | None = None,
) -> Sampled:  # fmt: skip
    """By `live` points, until those that live add less than `LEFT` of the evidence.

    `progress` is told how many of about how many parts are done, if the data shrink the prior by `nats`.
    """
    rng, ramp, computed = np.random.default_rng(seed), TIE * (np.arange(dimensions) + 1.0), 0
    about = PARTS + max(int(DYING * (nats + BEHIND - np.log(FIRST))), 1)

    def tilted(points: np.ndarray) -> np.ndarray:
        nonlocal computed
        computed += len(points)
        return log_likelihood(points) + points @ ramp

    points = rng.random((FIRST * live, dimensions))
    parts = []
    for k, part in enumerate(np.array_split(points, PARTS)):
        parts.append(tilted(part))
        if progress is not None:
            progress(k + 1, about)
    logs = np.concatenate(parts)
    order = np.argsort(logs, kind="stable")
    weight, volume = _dying(len(points), len(points) - live)
    dead = [(points[order[:-live]], logs[order[:-live]], weight)]
    evidence = float(np.logaddexp.reduce(logs[order[:-live]] + weight))
    points, logs = points[order[-live:]], logs[order[-live:]]
    dying = live // DYING
    own, shrunk = _dying(live, dying)
    while not np.logaddexp.reduce(logs) - np.log(live) + volume < evidence + np.log(LEFT):
        order = np.argsort(logs, kind="stable")
        low, high = order[:dying], order[dying:]
        dead.append((points[low], logs[low], volume + own))
        evidence = float(np.logaddexp(evidence, np.logaddexp.reduce(logs[low] + volume + own)))
        volume += shrunk
        starts = rng.choice(high, dying, replace=False)  # answers keep their numbers better
        points[low], logs[low] = _moved(tilted, points[starts], logs[starts], float(logs[low[-1]]), points[high], rng)
        if progress is not None:
            progress(min(PARTS + len(dead) - 1, about - 1), about)
    if progress is not None:
        progress(about, about)
    dead.append((points, logs, np.full(live, volume - np.log(live))))
    every, of_every, volumes = (np.concatenate(each) for each in zip(*dead, strict=True))
    log_evidence = float(np.logaddexp.reduce(of_every + volumes))
    shares = np.exp(of_every + volumes - log_evidence)
    # of points that die one by one 1/live (Skilling 2006), and of how many of the first are where the evidence is
    information, known = float(shares @ of_every) - log_evidence, float(np.log(FIRST))
    variance = float(np.sum(1.0 / np.arange(live, live - dying, -1.0) ** 2) / -shrunk) * max(information - known, 0.0)
    error = float(np.sqrt(variance + np.exp(min(information, known)) / (FIRST * live)))
    return Sampled(every, shares, log_evidence, error, float(np.max(of_every)), computed)


def _dying(living: int, count: int) -> tuple[np.ndarray, float]:
    """Of the lowest `count` points of so many that live: logarithms of the shares of the prior that each stands for;
    and by how much the logarithm of what is left shrinks."""
    steps = -1.0 / np.arange(living, living - count, -1.0)
    return np.concatenate([[0.0], np.cumsum(steps)[:-1]]) + np.log(-np.expm1(steps)), float(np.sum(steps))


def _moved(
    log_likelihood: LogLikelihood, points: np.ndarray, logs: np.ndarray, least: float, living: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Each point moved along slices of its own, one after the other, to where the likelihood is above `least` (Neal
    2003, of slices that only shrink); and the likelihoods there. Ways are those between two points that live."""
    moved, moved_logs, (count, dimensions) = points.copy(), logs.copy(), points.shape
    ways, low, high = np.empty_like(points), np.empty(count), np.empty(count)
    left = np.full(count, SLICES * dimensions + 1)
    new = np.arange(count)
    while True:
        first = rng.integers(len(living), size=len(new))
        other = (first + rng.integers(1, len(living), size=len(new))) % len(living)
        ways[new] = LONG / np.sqrt(2.0 * dimensions) * (living[first] - living[other])
        low[new] = -rng.random(len(new))
        high[new] = low[new] + 1.0
        left[new] -= 1
        each = np.flatnonzero(left)
        if not len(each):
            return moved, moved_logs
        far = low[each] + rng.random(len(each)) * (high - low)[each]
        tried = moved[each] + far[:, None] * ways[each]
        found, inside = np.full(len(each), -np.inf), np.all((tried > 0.0) & (tried < 1.0), axis=1)
        if inside.any():
            found[inside] = log_likelihood(tried[inside])
        good = found > least
        moved[each[good]], moved_logs[each[good]] = tried[good], found[good]
        low[each], high[each] = np.where(far < 0.0, far, low[each]), np.where(far < 0.0, high[each], far)
        new = each[good | ((high - low)[each] <= LEAST)]
