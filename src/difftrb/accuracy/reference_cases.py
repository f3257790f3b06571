"""Contacts whose continuum solution is known, to compare with: the approach in the limit of ever finer grids.

One roller and one width of spall; healthy, and with rolling edges out of reach, in the contact and just beyond it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from difftrb.core.geometry import LineContact, Spall, contact_modulus

CONTACT = LineContact(radius=3.623, length=13.66, modulus=contact_modulus(2.1e5, 0.278), design_load=3000.0)
WIDTH, DEPTH = 1.0, 0.2
"""Of all spalls [mm]."""


class Truth(NamedTuple):
    """Load [N], length of the spall (0: healthy) and its offset [mm], continuum approach [mm] and an estimate of that
    number's own error [-]."""

    load: float
    length: float
    offset: float
    approach: float
    doubt: float

    @property
    def spall(self) -> Spall | None:
        """None is a healthy raceway."""
        return Spall(self.length, WIDTH, DEPTH) if self.length else None


# Polonsky–Keer on edge-aligned grids up to 640 × 1366 and 80 × 10928 cells, half width of the domain 2.8 Hertz half
# widths, Richardson-extrapolated.
TRUTHS = [Truth(*row) for row in (
    (100, 0, 0, 5.365688403e-04, 2.5e-07), (100, 2, 0, 6.137801635e-04, 2.1e-06),
    (100, 4, 0, 7.425538780e-04, 4.6e-07), (100, 6, 0, 9.291261844e-04, 2.7e-06),
    (100, 8, 0, 1.207644344e-03, 5.3e-06), (1000, 0, 0, 3.023218433e-03, 2.3e-06),
    (1000, 2, 0, 3.267867384e-03, 5.0e-07), (1000, 4, 0, 3.690234545e-03, 9.9e-07),
    (1000, 6, 0, 4.306116163e-03, 1.2e-06), (1000, 8, 0, 5.243200774e-03, 1.0e-06),
    (3000, 0, 0, 7.588983207e-03, 4.3e-06), (3000, 2, 0, 8.111204602e-03, 3.0e-06),
    (3000, 4, 0, 9.046521489e-03, 6.7e-06), (3000, 6, 0, 1.041452150e-02, 7.4e-06),
    (3000, 8, 0, 1.248768281e-02, 7.4e-06), (10000, 0, 0, 2.174177485e-02, 6.3e-06),
    (10000, 2, 0, 2.298730331e-02, 3.1e-05), (10000, 4, 0, 2.533746477e-02, 3.4e-05),
    (10000, 6, 0, 2.877591004e-02, 2.4e-05), (10000, 8, 0, 3.391902836e-02, 6.2e-06),
    (3000, 2, 0.2, 8.111234095e-03, 8.5e-06),
    (3000, 2, 0.3, 8.111234179e-03, 8.6e-06), (3000, 2, 0.36, 7.985099359e-03, 7.2e-05),
    (3000, 2, 0.4, 7.874553700e-03, 2.6e-05), (3000, 2, 0.46, 7.734098573e-03, 2.7e-05),
    (3000, 2, 0.48, 7.696276107e-03, 2.5e-05), (3000, 2, 0.5, 7.663558878e-03, 2.2e-05),
    (3000, 2, 0.54, 7.614832562e-03, 1.7e-05), (3000, 2, 0.56, 7.599585052e-03, 2.3e-05),
    (3000, 2, 0.6, 7.588990986e-03, 4.8e-06),
)]  # fmt: skip


def worst(approach: Callable[[Truth], float]) -> float:
    """Largest relative error of what `approach` [mm] says of all of them."""
    return max(abs(approach(truth) / truth.approach - 1.0) for truth in TRUTHS)
