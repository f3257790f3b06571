"""Nested sampling over the unit cube: the evidence of data, and weighted points of what they leave of the prior.

A quarter of the points, the lowest ones, die together; others that live move in their place, along slices of what lies
above the highest of the dead (Skilling 2006; Handley, Hobson and Lasenby 2015). All slices of a round ask for one point
each at a time, and these are computed at once. It takes long, but never longer than that: where posteriors are ridges
with kinks, nautilus drew points from its networks for minutes without one that it could use, and where they are level
dynesty from its ellipsoids.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from difftrb.law.samples import Progress

TIE = 1e-6
"""Slope of the logarithm of the likelihood that is added along every side of the cube. Where data do not depend on the
parameters all points are equal, and how much of the prior lies below one could not be told."""
SLICES = 2
"""Of every new point, for each dimension."""
DYING = 4
"""One in so many points dies in a round. With every other one the evidence scatters by half as much again."""
LEFT = 0.01
"""Share of the evidence that living points may still add in the end."""
OUT = 6
"""Times that a slice is lengthened at either end, at most."""
LEAST = 1e-12
"""A slice as short as this, of what is living, has found nothing but the point where it began."""
BEHIND = 5.0
"""About how far the prior shrinks beyond the width of the likelihood, by factors of e: for the bar."""

LogLikelihood = Callable[[np.ndarray], np.ndarray]
"""Of points of the cube, shape (points, dimensions); shape (points,)."""


class Sampled(NamedTuple):
    """Points of the cube, shape (points, dimensions), and each one's share of the evidence, shape (points,); the
    logarithm of the evidence and its standard error; how many points were computed."""

    points: np.ndarray
    shares: np.ndarray
    log_evidence: float
    error: float
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

    `progress` is told how many of about how many points are dead, if the data shrink the prior by `nats`.
    """
    rng, ramp, computed = np.random.default_rng(seed), TIE * (np.arange(dimensions) + 1.0), 0
    about = int(live * (nats + BEHIND))

    def tilted(points: np.ndarray) -> np.ndarray:
        nonlocal computed
        computed += len(points)
        return log_likelihood(points) + points @ ramp

    points = rng.random((live, dimensions))
    logs = tilted(points)
    dying, volume, evidence = live // DYING, 0.0, -np.inf
    shrinking = -1.0 / np.arange(live, live - dying, -1.0)  # of the prior's logarithm, one point after the other
    before = np.concatenate([[0.0], np.cumsum(shrinking)[:-1]]) + np.log(-np.expm1(shrinking))
    dead: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    while not np.logaddexp.reduce(logs) - np.log(live) + volume < evidence + np.log(LEFT):
        order = np.argsort(logs, kind="stable")
        low, high = order[:dying], order[dying:]
        dead.append((points[low], logs[low], volume + before))
        evidence = float(np.logaddexp(evidence, np.logaddexp.reduce(logs[low] + volume + before)))
        volume += float(np.sum(shrinking))
        axes = np.linalg.cholesky(np.cov(points, rowvar=False).reshape(dimensions, -1) + 1e-14 * np.eye(dimensions))
        starts, least = rng.choice(high, dying), float(logs[low[-1]])
        moved, told = points[starts], logs[starts]
        for _ in range(SLICES * dimensions):
            moved, told = _moved(tilted, moved, told, least, axes, rng)
        points[low], logs[low] = moved, told
        if progress is not None:
            progress(min(dying * len(dead), about - 1), about)
    if progress is not None:
        progress(about, about)
    dead.append((points, logs, np.full(live, volume - np.log(live))))
    every, of_every, volumes = (np.concatenate(each) for each in zip(*dead, strict=True))
    log_evidence = float(np.logaddexp.reduce(of_every + volumes))
    shares = np.exp(of_every + volumes - log_evidence)
    narrower = max(float(shares @ of_every) - log_evidence, 1.0)
    # Skilling 2006, of points that die one by one 1/live
    scatter = float(np.sum(shrinking**2) / -np.sum(shrinking))
    return Sampled(every, shares, log_evidence, float(np.sqrt(narrower * scatter)), computed)


def _moved(
    log_likelihood: LogLikelihood, points: np.ndarray, logs: np.ndarray, least: float, axes: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Each point moved along a slice of its own, in a random direction, to where the likelihood is above `least`; and
    the likelihoods there."""
    turns = rng.standard_normal(points.shape)
    ways = 2.0 * (turns / np.linalg.norm(turns, axis=1, keepdims=True)) @ axes.T

    def at(each: np.ndarray, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of these points so far along their ways."""
        tried = points[each] + far[:, None] * ways[each]
        found, inside = np.full(len(each), -np.inf), np.all((tried > 0.0) & (tried < 1.0), axis=1)
        if inside.any():
            found[inside] = log_likelihood(tried[inside])
        return found, tried

    low = -rng.random(len(points))
    high = low + 1.0
    for end, step in ((low, -1.0), (high, 1.0)):
        each = np.arange(len(points))
        for _ in range(OUT):
            each = each[at(each, end[each])[0] > least]
            end[each] += step
    moved, told, each = points.copy(), logs.copy(), np.arange(len(points))
    while len(each):
        far = low[each] + rng.random(len(each)) * (high - low)[each]
        found, tried = at(each, far)
        good = found > least
        moved[each[good]], told[each[good]] = tried[good], found[good]
        low[each], high[each] = np.where(far < 0.0, far, low[each]), np.where(far < 0.0, high[each], far)
        each = each[~good & ((high - low)[each] > LEAST)]
    return moved, told
