"""How many spalls measurements call for: none, one or two, by the evidence of each.

The evidence of a number of spalls is the chance density of the rows as they were measured, whatever the spalls' sizes
and places; it is less for more spalls unless the rows need them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from difftrb.core import status
from difftrb.fits import fit_problem, measured
from difftrb.fits import posterior as posteriors
from difftrb.fits.measured import MeasuredError, Measurement
from difftrb.fits.parameters import PARAMETERS, OfSpall
from difftrb.fits.posterior import DRAWS, LIVE, Posterior
from difftrb.fits.predicted import healthy_rows
from difftrb.law.samples import Progress
from difftrb.scene.scene import Scene

MOST = 2
"""Spalls that are counted."""
NATS = 5.0
"""About how much rows shrink the prior of a parameter."""


@dataclasses.dataclass(frozen=True, repr=False)
class SpallCount:
    """What speaks for each number of spalls.

    Attributes:
      counts: the numbers that were tried. log_evidences, errors: of each, and their standard errors.
      shares: of the probability, if all counts were equally likely before.
      posteriors: of the spalls' parameters, the second one's behind the first one's, which has the smaller angle; None
        of no spall.
    """

    counts: tuple[int, ...]
    log_evidences: np.ndarray
    errors: np.ndarray
    shares: np.ndarray
    posteriors: tuple[Posterior | None, ...]

    @property
    def likeliest(self) -> int:
        """The number of spalls that most speaks for."""
        return self.counts[int(np.argmax(self.log_evidences))]

    def __repr__(self) -> str:
        """A line for each count."""
        lines = [
            f"  {count}: log evidence {value:.2f} ± {error:.2f}, {100.0 * share:.3g} %"
            for count, value, error, share in zip(
                self.counts, self.log_evidences, self.errors, self.shares, strict=True
            )
        ]
        return "\n".join([f"SpallCount, likeliest {self.likeliest}", *lines])


def count_spalls(
    scene: Scene,
    rows: Sequence[Measurement],
    counts: Sequence[int] = (0, 1, 2),
    parameters: Sequence[str] = ("length", "width", "angle"),
    live: int = LIVE,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Progress | None = None,
) -> SpallCount:
    """How likely measurements make no spall, one and two.

    Args:
      scene: as for `difftrb.fit`; of its spalls the first one counts, and the second if there is one: what is not among
        the parameters is as there.
      rows: with sigma.
      counts: some of 0, 1, 2, each once.
      parameters: of the spalls, each spall's own; with two of them "angle" has to be one. Priors are even over the
        ranges that a fit searches, of sizes in their logarithm.
      live, draws, seed: as for `difftrb.posterior`.
      progress: told how many of how many parts are done.

    Two spalls that one roller may meet at once are left out: no law that can be fitted knows them. Raises
    `MeasuredError`.
    """
    status.require_float64()
    counts, rows = tuple(counts), measured.listed(rows)
    check(scene, rows, counts, parameters)
    ready = fit_problem.prepare_fit(dataclasses.replace(scene, spalls=scene.spalls[:1]), rows)
    measured.check_loads(ready, rows)
    spalls = _spalls(scene)
    found: list[Posterior | None] = []
    evidences, errors = np.zeros(len(counts)), np.zeros(len(counts))
    for k, count in enumerate(counts):
        names = [*parameters, *(f"{name}_2" for name in parameters)][: max(count, 1) * len(parameters)]
        world = dataclasses.replace(ready, spalls=spalls[: max(count, 1)])
        problem, _ = fit_problem.problem_of(world, rows, tuple(names), "squares", None)
        if count == 0:
            evidences[k] = float(posteriors.log_density(problem, healthy_rows(problem)[None])[0])
            found.append(None)
            continue
        of_all = None if progress is None else _part(progress, k, len(counts))
        own = posteriors.posterior_of(problem, 1.0, live, draws, seed, NATS * len(names), of_all)
        evidences[k], errors[k] = own.log_evidence, own.error
        found.append(own if count == 1 else _in_order(own, len(parameters)))
    shares = np.exp(evidences - np.max(evidences))
    return SpallCount(counts, evidences, errors, shares / np.sum(shares), tuple(found))


def check(scene: Scene, rows: Sequence[Measurement], counts: Sequence[int], parameters: Sequence[str]) -> None:
    """Raises `MeasuredError` for what cannot be counted."""
    if not counts or len(set(counts)) < len(counts) or not set(counts) <= set(range(MOST + 1)):
        raise MeasuredError(f"spalls = {', '.join(map(str, counts))}: must be some of 0 … {MOST}, each once")
    if not scene.spalls:
        raise MeasuredError("the scene has no [[spall]]: give one, with a guess of its size")
    for name in parameters:
        if not isinstance(PARAMETERS.get(name), OfSpall) or f"{name}_2" not in PARAMETERS:
            known = ", ".join(name.removesuffix("_2") for name in PARAMETERS if name.endswith("_2"))
            raise MeasuredError(f"parameters: {name!r}: to count spalls, name some of {known}")
    if max(counts) > 1 and "angle" not in parameters:
        raise MeasuredError("parameters: angle is missing: two spalls are told apart by it; name it, too")
    for k, row in enumerate(rows, 1):
        if row.sigma is None:
            raise MeasuredError(
                f"{measured.where(row, k)}: {measured.column('sigma', row.origin)} is empty: how many spalls rows need "
                "depends on it; give it in all rows"
            )


def _spalls(scene: Scene) -> tuple:
    """Two of them: without a second one the first, half way round."""
    first = scene.spalls[0]
    return scene.spalls[:2] if len(scene.spalls) > 1 else (first, dataclasses.replace(first, angle=first.angle + np.pi))


def _part(progress: Progress, k: int, of: int) -> Progress:
    """The k-th part of it."""
    return lambda done, about: progress(int(1000 * (k + done / about) / of), 1000)


def _in_order(own: Posterior, each: int) -> Posterior:
    """Draws with the spall of the smaller angle first: which is called the first means nothing."""
    at = [own.parameters.index("angle"), own.parameters.index("angle_2")]
    turned = own.values[:, at[0]] > own.values[:, at[1]]
    other = np.roll(own.values, each, axis=1)
    return dataclasses.replace(own, values=np.where(turned[:, None], other, own.values))
