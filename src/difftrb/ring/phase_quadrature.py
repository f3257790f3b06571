"""Phases of the cage over one roller pitch, and their weights in a mean.

Stiffness and loads have kinks (or jumps) where a roller meets an edge of a spall, and weaker ones where a roller takes
up load. Between them (`phase_kinks`) a rule of few points is exact; they move with the kinks, so that derivatives of a
mean hold what the kinks' motion adds: of a hard window that is all there is by width.
"""

from __future__ import annotations

from typing import Any

from difftrb.core.numeric import gauss_legendre

POINTS_BETWEEN_KINKS = 8
"""Of `crowded`, between two kinks: 56 phases with one spall of soft edges and two ends of a load zone. Stiffness in the
mean is within 1e-6 of that of many phases, of seven rollers over a long spall within 1e-5."""
POINTS_IN_FITS = 4
"""The same of fits: by the table 3e-4 and 5e-4 of 30 random spalls, as with 6 and 10 points, whose kinks are as they
are here; a tenth of the noise of good measurements."""
POINTS_BY_CONTACTS = 4
"""The same where contacts are solved for every phase."""
ROUGH_POINTS = 2
"""The same where fits look for minima: 5e-4 and 4e-3."""

Rule = tuple[Any, Any]
"""Places in −1 … 1 and weights, which add up to 2, of a mean between two kinks, shape (points,) each."""


def between(borders: Any, rule: Rule | None = None) -> tuple[Any, Any]:
    """Angles of roller 0 [rad] and their weights, which add up to 1, by a rule between every two of the `borders`.

    None: `crowded`, of `POINTS_BETWEEN_KINKS`. Both of shape (phases,).
    """
    starts, length = borders[:-1], borders[1:] - borders[:-1]
    places, weights = rule or crowded(POINTS_BETWEEN_KINKS)
    at = starts[:, None] + length[:, None] * (0.5 + 0.5 * places)[None, :]
    share = (length / borders[-1])[:, None] * (0.5 * weights)[None, :]
    return at.reshape(-1), share.reshape(-1)


def crowded(count: int) -> Rule:
    """Gauss's rule in t of the place 3t² − 2t³: points crowd at both ends, from where stiffness goes off as a square
    root, for there a roller takes up load. In t it is smooth."""
    places, weights = gauss_legendre(count)
    t = 0.5 + 0.5 * places
    return 2.0 * t * t * (3.0 - 2.0 * t) - 1.0, weights * 6.0 * t * (1.0 - t)
