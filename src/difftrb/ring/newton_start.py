"""Where Newton's method for a ring's equilibrium begins.

At the load zone of a ring of so many rollers that sums over them are integrals. Rings that stay parallel press a roller
by δ(ψ) = δ_max (1 − s (1 − cos ψ)), ψ from the load line: s is 0 under an axial load alone, 1 with half of the rollers
loaded, and grows without limit as the zone becomes a point.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import series
from difftrb.law import load_curve
from difftrb.law.load_curve import Curve
from difftrb.law.roller_curves import RollerCurves
from difftrb.ring.newton import Rollers, norm, of_each
from difftrb.ring.terms import Terms

EXPONENTS = 1.1, 1.3
"""n of Q = K δⁿ between which everything is taken as straight: line contacts have 1.1, crowned ones more."""
NARROWEST = 0.98
"""Of F_r tan α/F_a, up to which the integrals stand for the sums: beyond, two or three rollers carry all."""
DEGREE = 8
LEAST = 1e-9
"""Load [N] from which a pair of rows begins that none presses but its preload."""
AHEAD = 0.4
"""Cosine from the load line up to which a roller is looked at where the rings are held axially: of three there is
one."""


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


def load_zone(ratio: Any, exponent: Any) -> tuple[Any, Any]:
    """How narrow the load zone is, s [-], and the largest roller load by F_a/(Z sin α) [-], at F_r tan α/F_a and n, any
    shape, both to some per cent."""
    ratio = xp.within(ratio, 0.0, NARROWEST)
    way = xp.within((exponent - EXPONENTS[0]) / (EXPONENTS[1] - EXPONENTS[0]), 0.0, 2.0)
    ends = [[series.horner(one, ratio) for one in fits] for fits in _FITS]
    narrow, wide = (low + way * (high - low) for low, high in zip(*ends, strict=True))
    return narrow * ratio / (1.0 - ratio), xp.sqrt(wide / (1.0 - ratio))


def in_load_zone(healthy: Curve, force: Any, rollers: int, axial: Any) -> tuple[Any, Any]:
    """The most loaded roller's load [N], and s, of a healthy ring under `force` [N], shape (…, 3); `axial`: share of a
    roller's load along the axis."""
    radial = xp.sqrt(1.0 - axial**2)
    # less than that holds no load; thrown rollers may take it
    push = xp.maximum(force[..., 2], axial * norm(force))
    share = push / (rollers * axial)
    _, exponent = load_curve.approach_and_exponent(healthy, share)
    narrow, largest = load_zone(force[..., 0] * axial / (radial * push), exponent)
    return share * largest, narrow


def pressed(deep: Any, narrow: Any, axial: Any) -> Any:
    """The displacement [mm], shape (…, 3), that presses the most loaded roller of that zone by `deep` [mm]."""
    radial = xp.sqrt(1.0 - axial**2)
    return xp.stack([deep * (narrow / radial), xp.zeros_like(deep), deep * ((1.0 - narrow) / axial)], axis=-1)


def start(rollers: Rollers, healthy: RollerCurves, force: Any, terms: Terms) -> Any:
    """Where Newton's method begins [mm], shape (…, 3): the load zone of a healthy ring; of a pair of rows, all rollers
    as loaded as were the load shared equally; of rings held axially, moved until a roller carries half the load. If all
    are clear of what they stand over, beyond the least of these gaps, and beyond what speed alone presses them by:
    without a loaded roller Newton's method knows no way. All of these are numbers, or of one ring."""
    rollers, healthy, force, terms = xp.fixed((rollers, healthy, force, terms))
    count, axial = rollers.normals.shape[-2], rollers.normals.reshape(-1, 3)[0, 2]
    curve = load_curve.one_of(healthy.each, 0)
    while curve.middle.ndim:  # the same at all phases
        curve = load_curve.one_of(curve, 0)
    shift = rollers.curves.each.shift
    if terms.slices is not None:  # by the one that is touched first
        shift = terms.slices.each.shift
        shift = xp.module_of(shift).min(shift.reshape(*shift.shape[:-1], count, -1), axis=-1)
    clear = shift if rollers.interference is None else shift - rollers.interference
    least = 0.0 if terms.seat is None else terms.seat.least_outer_load
    if terms.axial is not None:
        return held_axially(curve, rollers.normals, force, clear, least, terms.axial)
    if terms.pair is None:
        largest, narrow = in_load_zone(curve, force, count, axial)
    else:
        total = norm(force)
        if terms.tilting is not None:  # moments may be all that presses
            total = total + norm(terms.tilting.moments / terms.tilting.longest)
        largest, narrow = least + xp.maximum(total, LEAST) / (count * axial), 0.0
    of = xp.module_of(clear)
    deep = load_curve.approach(curve, largest)
    u = pressed(deep + xp.maximum(of.min(clear, axis=-1), 0.0), narrow, axial)
    if terms.pair is not None:  # the first row pressed by the load, or both by the preload
        return xp.stack([u[..., 0], u[..., 1], xp.maximum(u[..., 2] - 0.5 * terms.pair.preload, 0.0)], axis=-1)
    if rollers.interference is None:
        return u
    # thick rollers may be elsewhere than in the load zone
    deepest = of.max(xp.einsum("...ri,...i->...r", rollers.normals, u) - clear, axis=-1)
    missing = xp.maximum(0.5 * deep - deepest, 0.0)
    return xp.stack([u[..., 0], u[..., 1], u[..., 2] + missing / axial], axis=-1)


def held_axially(healthy: Curve, normals: Any, force: Any, clear: Any, least: Any, axial: Any) -> Any:
    """At the displacement `axial` [mm], and along the load line as far as a roller there needs to carry half the load
    and `least` [N], shape (…, 3); `clear` as it is of every roller [mm]."""
    load, along = norm(force), normals[..., 0]
    deep = load_curve.approach(healthy, least + 0.5 * xp.maximum(load, LEAST))
    ahead = along > AHEAD * xp.sqrt(along**2 + normals[..., 1] ** 2)
    missing = (clear + deep - of_each(axial, clear) * normals[..., 2]) / xp.where(ahead, along, 1.0)
    of = xp.module_of(missing)
    way = of.maximum(of.min(of.where(ahead, missing, np.inf), axis=-1), 0.0)
    way = of.where(force[..., 0] > 0.0, way, 0.0)
    return of.stack([way, of.zeros_like(way), way * 0.0 + axial], axis=-1)
