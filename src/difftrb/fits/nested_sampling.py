"""Nested sampling over the unit cube: the evidence of data, and weighted points of what they leave of the prior.

The library is nautilus: importance nested sampling (Lange 2023), which uses every point that it has computed. Of two
parameters it computes 8 000 and knows the evidence to 0.02, dynesty 28 000, and 0.17; slices, as blackjax has them,
need some thirty for every point that they keep.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from difftrb.fits.measured import MeasuredError
from difftrb.law.samples import Progress

TIE = 1e-6
"""Slope of the logarithm of the likelihood that is added along every side of the cube. Where data do not depend on the
parameters all points are equal, and how much of the prior lies below one could not be told."""
NETWORK = {"solver": "lbfgs", "alpha": 1e-4, "hidden_layer_sizes": (32, 16), "max_iter": 200}
"""A small one tells well enough where points are worth computing, and takes a tenth of the time to train."""
TOGETHER = 128
"""Points that are computed at once."""
PER_NAT = 1.2
"""About how often `live` points are computed for every factor of e that the prior shrinks by: for the bar alone."""

LogLikelihood = Callable[[np.ndarray], np.ndarray]
"""Of points of the cube, shape (points, dimensions); shape (points,)."""


class Sampled(NamedTuple):
    """Points of the cube, shape (points, dimensions), and the logarithm of how much each counts, shape (points,); the
    logarithm of the evidence and its standard error; how many points were computed."""

    points: np.ndarray
    log_weights: np.ndarray
    log_evidence: float
    error: float
    evaluations: int

    @property
    def effective(self) -> float:
        """As many points of equal weight would tell as much."""
        weights = self._weights()
        return float(1.0 / np.sum(weights**2))

    def drawn(self, count: int, seed: int) -> np.ndarray:
        """So many points of equal weight, shape (count, dimensions), in random order."""
        rng = np.random.default_rng(seed)
        # systematic: it adds the least of noise
        each = np.searchsorted(np.cumsum(self._weights()), (rng.random() + np.arange(count)) / count)
        return self.points[rng.permutation(np.minimum(each, len(self.points) - 1))]

    def _weights(self) -> np.ndarray:
        weights = np.exp(self.log_weights - np.max(self.log_weights))
        return weights / np.sum(weights)


def sampled(
    log_likelihood: LogLikelihood, dimensions: int, live: int, effective: int, seed: int, nats: float = 10.0,
    progress: Progress | None = None,
) -> Sampled:  # fmt: skip
    """By `live` points, until there are as many as `effective` ones of equal weight would tell.

    `progress` is told how many of about how many points are computed, if the data shrink the prior by `nats`.
    """
    try:
        from nautilus import Sampler
    except ImportError:
        raise MeasuredError("nested sampling needs nautilus: pip install 'difftrb[posterior]'") from None
    ramp, done, about = TIE * (np.arange(dimensions) + 1.0), 0, int(live * PER_NAT * (nats + 10.0))

    def tilted(points: np.ndarray) -> np.ndarray:
        nonlocal done
        found = log_likelihood(points) + points @ ramp
        done += len(points)
        if progress is not None:
            progress(min(done, about - 1), about)
        return found

    sampler = Sampler(np.copy, tilted, dimensions, n_live=live, n_batch=TOGETHER, n_networks=1, vectorized=True,
                      neural_network_kwargs=NETWORK, pass_dict=False, seed=seed)  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that its networks might be trained further
        sampler.run(n_eff=effective)
    if progress is not None:
        progress(about, about)
    points, log_weights, *_ = map(np.asarray, sampler.posterior())
    shells = np.exp(sampler.shell_log_l + sampler.shell_log_v - sampler.log_z)
    error = float(np.sqrt(np.sum(shells**2 / np.maximum(sampler.shell_n_eff, 1.0))))
    return Sampled(points, log_weights, float(np.asarray(sampler.log_z)), error, done)
