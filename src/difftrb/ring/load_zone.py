"""The load zone of a ring of so many rollers that sums over them are integrals: where Newton's method begins.

Rings that stay parallel press a roller by δ(ψ) = δ_max (1 − s (1 − cos ψ)), ψ from the load line: s is 0 under an axial
load alone, 1 with half of the rollers loaded, and grows without limit as the zone becomes a point.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

EXPONENTS = 1.1, 1.3
"""n of Q = K δⁿ between which everything is taken as straight: line contacts have 1.1, crowned ones more."""
NARROWEST = 0.98
"""Of F_r tan α/F_a, up to which the integrals stand for the sums: beyond, two or three rollers carry all."""
DEGREE = 8


def _integrals(s: np.ndarray, exponent: float) -> tuple[np.ndarray, np.ndarray]:
    """Axial and radial load by what they would be were all rollers loaded as the first (Sjövall's integrals)."""
    angle = np.pi * (np.arange(2000) + 0.5) / 2000
    load = np.maximum(1.0 - s[:, None] * (1.0 - np.cos(angle)), 0.0) ** exponent
    return load.mean(axis=1), (load * np.cos(angle)).mean(axis=1)


def _fits(exponent: float) -> np.ndarray:
    """Coefficients in rising powers of F_r tan α/F_a of s and of the axial integral squared, both by how they end as
    the zone closes, shape (2, DEGREE + 1)."""
    s = np.concatenate([np.linspace(1e-3, 2.0, 200), np.geomspace(2.0, 20.0, 200)])
    axial, radial = _integrals(s, exponent)
    ratio = radial / axial
    values = s * (1.0 - ratio) / ratio, (1.0 - ratio) / axial**2
    return np.array([np.polynomial.Polynomial.fit(ratio, each, DEGREE).convert().coef for each in values])


_FITS = np.array([_fits(exponent) for exponent in EXPONENTS])


class Zone(NamedTuple):
    """s [-], and the largest roller load by F_a/(Z sin α) [-], any one shape."""

    narrowness: jax.Array
    largest: jax.Array


def of(ratio: jax.Array, exponent: jax.Array) -> Zone:
    """The load zone at F_r tan α/F_a and n, any shape, both to some per cent."""
    ratio = jnp.clip(ratio, 0.0, NARROWEST)
    way = jnp.clip((exponent - EXPONENTS[0]) / (EXPONENTS[1] - EXPONENTS[0]), 0.0, 2.0)
    ends = [[jnp.polyval(jnp.asarray(one[::-1]), ratio) for one in fits] for fits in _FITS]
    narrow, wide = (low + way * (high - low) for low, high in zip(*ends, strict=True))
    return Zone(narrow * ratio / (1.0 - ratio), jnp.sqrt(wide / (1.0 - ratio)))
