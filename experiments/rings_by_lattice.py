"""Rings whose contacts are solved without the package against rings by law "table".

    python -m experiments.rings_by_lattice [SCENE …]   (of `rings_of_atlas`; some minutes a scene)

A contact at a given approach is solved on a uniform lattice of rectangles by conjugate gradients (Polonsky and Keer
1999, Wear 231), numpy and scipy only. The lattice's lines follow a spall's edges, where pressure is singular and the
error falls as the first power of the spacing: loads of the two finest lattices are extrapolated. The ring is scipy's.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import NamedTuple, cast

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from numpy.polynomial import chebyshev, legendre
from scipy import fft

import difftrb as trb
from difftrb.core import geometry
from difftrb.ring import roller_places
from experiments import by_scipy, rings_of_atlas

SCENES = 17, 24, 59
"""A short spall, a long one, and one off the middle, each with a roller on a rolling edge."""
ACROSS, ALONG, LEVELS = 24, 96, 5
"""Cells of the coarsest lattice over the contact, and how many lattices there are, each with twice as many both ways;
the last two are computed."""
ALIKE, OWN = 9, 5
"""Approaches at which a healthy roller is solved, and one that meets the spall."""
LEAST, AROUND = 0.03, 0.06
"""Smallest of a healthy roller's approaches by the largest; how far the others lie to either side of a roller's own."""
ROUNDS = 3000


class Contact(NamedTuple):
    """Equivalent radius [mm], length [mm], contact modulus [MPa], design load of the crown [N]."""

    radius: float
    length: float
    modulus: float
    design_load: float

    @property
    def crown(self) -> float:
        """What multiplies the crown's logarithm [mm]."""
        return self.design_load / (np.pi * self.modulus * self.length)


class Hole(NamedTuple):
    """Where a deep spall leaves no land: its ends across and along the contact [mm]."""

    across: tuple[float, float]
    along: tuple[float, float]


class Lines(NamedTuple):
    """Evenly spaced lines: the first, the spacing, how many cells are between them."""

    first: float
    step: float
    cells: int

    @property
    def all(self) -> np.ndarray:
        """Their places, shape (cells + 1,)."""
        return self.first + self.step * np.arange(self.cells + 1)

    def halved(self, times: int) -> Lines:
        """With every cell in two, so many times."""
        return Lines(self.first, self.step / 2**times, self.cells * 2**times)


def lines(low: float, high: float, edges: Sequence[float], cells: int) -> Lines:
    """About `cells` of them from `low` to `high`, a line on each of one or two edges between."""
    inside = [edge for edge in edges if low < edge < high]
    step = (high - low) / cells
    if len(inside) == 2:
        apart = inside[1] - inside[0]
        step = apart / max(1, round(apart / step))
    start = inside[0] if inside else low
    first = start - step * np.ceil((start - low) / step - 1e-9)
    return Lines(first, step, int(np.ceil((high - first) / step - 1e-9)))


def pressed(contact: Contact, hole: Hole | None, approach: float, x: Lines, y: Lines) -> np.ndarray:
    """Pressure [MPa] on every cell, shape (cells of x, cells of y)."""
    points, weights = legendre.leggauss(4)
    rows = 0.5 * (y.all[1:] + y.all[:-1])[:, None] + 0.5 * y.step * points
    share = np.minimum((2.0 * rows / contact.length) ** 2, 1.0 - 1e-15)
    crown = 0.5 * (-contact.crown * np.log1p(-share)) @ weights
    curved = (x.all[1:] ** 3 - x.all[:-1] ** 3) / x.step / (6.0 * contact.radius)
    overlap = approach - curved[:, None] - crown[None, :]
    may = overlap > 0.0
    if hole is not None:
        under = [
            (at.all[1:] > low + 0.5 * at.step) & (at.all[:-1] < high - 0.5 * at.step)
            for at, (low, high) in zip((x, y), hole, strict=True)
        ]
        may &= ~(under[0][:, None] & under[1][None, :])
    whole = _transformed(contact, x, y)
    shape = 2 * x.cells, 2 * y.cells

    def sunk(pressure: np.ndarray) -> np.ndarray:
        return np.asarray(fft.irfft2(fft.rfft2(pressure, shape) * whole, shape))[: x.cells, : y.cells]

    pressure = np.where(may, overlap, 0.0)
    pressure *= approach / np.max(sunk(pressure))
    way, before, keeps = np.zeros_like(pressure), 1.0, 0.0
    for _ in range(ROUNDS):
        loaded = pressure > 0.0
        left = sunk(pressure) - overlap
        if np.max(np.abs(left[loaded])) < 1e-7 * approach and np.all(left[may & ~loaded] >= -1e-7 * approach):
            return pressure
        size = np.sum(left[loaded] ** 2)
        way = np.where(loaded, left + keeps * size / before * way, 0.0)
        before = size
        step = np.sum(left[loaded] * way[loaded]) / np.sum(sunk(way)[loaded] * way[loaded])
        pressure = np.maximum(pressure - step * way, 0.0)
        overlapping = may & (pressure <= 0.0) & (left < 0.0)
        pressure = np.where(overlapping, -step * left, pressure)
        keeps = 0.0 if overlapping.any() else 1.0
    raise RuntimeError(f"no contact found at an approach of {approach} mm")


def _transformed(contact: Contact, x: Lines, y: Lines) -> np.ndarray:
    """Transform of the deflection at cells' middles by a unit pressure on one (Love 1929), around which it is even."""
    across, along = (each.step * (np.arange(-each.cells, each.cells + 1) - 0.5) for each in (x, y))
    a, b = across[:, None], along[None, :]
    corner = a * np.arcsinh(b / np.abs(a)) + b * np.arcsinh(a / np.abs(b))
    each = np.diff(np.diff(corner, axis=0), axis=1) / (np.pi * contact.modulus)
    return np.asarray(fft.rfft2(np.roll(each, (-x.cells, -y.cells), (0, 1))))


def load(contact: Contact, hole: Hole | None, approach: float) -> float:
    """Q [N] at an approach [mm]."""
    wide = np.sqrt(2.0 * contact.radius * approach)  # beyond, the undeformed gap is wider than the approach
    long = 0.5 * contact.length * np.sqrt(-np.expm1(-approach / contact.crown))
    across, along = ((), ()) if hole is None else hole
    x, y = lines(-wide, wide, across, 64), lines(-long, long, along, 48)
    rough = pressed(contact, hole, approach, x, y) > 0.0
    ends = []
    for at, axis, limit in ((x, 1, wide), (y, 0, long)):
        touched = np.flatnonzero(rough.any(axis))
        low, high = at.all[touched[0]] - at.step, at.all[touched[-1] + 1] + at.step
        ends.append((max(low, -limit), min(high, limit)))
    (left, right), (low, high) = ends
    x, y = lines(left, right, across, ACROSS), lines(low, high, along, ALONG)
    loads = [
        float(np.sum(pressed(contact, hole, approach, x.halved(k), y.halved(k)))) * x.step * y.step / 4.0**k
        for k in (LEVELS - 2, LEVELS - 1)
    ]
    return loads[1] if hole is None else 2.0 * loads[1] - loads[0]


class Curve(NamedTuple):
    """log Q as a Chebyshev series in log δ."""

    series: np.ndarray
    ends: tuple[float, float]

    def at(self, approach: float) -> tuple[float, float]:
        """Q [N] and dQ/dδ [N/mm]."""
        reach = 0.5 * (self.ends[1] - self.ends[0])
        z = (np.log(approach) - 0.5 * (self.ends[1] + self.ends[0])) / reach
        inside = np.clip(z, -1.0, 1.0)
        rate = chebyshev.chebval(inside, chebyshev.chebder(self.series))
        Q = np.exp(chebyshev.chebval(inside, self.series) + rate * (z - inside))
        return Q, Q * rate / (reach * approach)


def curve(contact: Contact, hole: Hole | None, low: float, high: float, count: int) -> Curve:
    """Of approaches between `low` and `high` [mm]."""
    z = np.cos(np.pi * np.arange(count) / (count - 1))
    ends = np.log(low), np.log(high)
    logs = 0.5 * (ends[1] + ends[0]) + 0.5 * (ends[1] - ends[0]) * z
    loads = [load(contact, hole, float(np.exp(each))) for each in logs]
    return Curve(chebyshev.chebfit(z, np.log(loads), count - 1), ends)


def compared(scene: trb.Scene) -> tuple[float, float, float]:
    """How far loads of the ring by law "table" are off, by the largest, and its radial and axial stiffness."""
    ready = trb.prepare(scene)
    ours = trb.solve(ready).check()
    of = trb.LineContact.of(scene.bearing, "outer", scene.design_load)
    contact = Contact(float(of.radius), float(of.length), float(of.modulus), float(of.design_load))
    (spall,) = scene.spalls
    angles = roller_places.roller_angles(scene.bearing, cast(float, scene.phase))
    away = np.asarray(roller_places.distances(scene.bearing, scene.spalls, angles))[0]
    approach = np.asarray(ours.approach)
    half, middle = 0.5 * float(spall.length), float(spall.axial_offset)
    healthy = curve(contact, None, LEAST * approach.max(), 1.05 * approach.max(), ALIKE)
    curves = [healthy] * len(away)
    for k, own in enumerate(approach):
        if own > 0.0 and abs(away[k]) < 0.5 * spall.width + np.sqrt(2.0 * contact.radius * own):
            sides = away[k] - 0.5 * spall.width, away[k] + 0.5 * spall.width
            hole = Hole(sides, (middle - half, middle + half))
            curves[k] = curve(contact, hole, (1.0 - AROUND) * own, (1.0 + AROUND) * own, OWN)

    def rollers(delta: np.ndarray) -> by_scipy.Answer:
        found = [one.at(d) if d > 0.0 else (0.0, 0.0) for one, d in zip(curves, delta, strict=True)]
        loads, slopes = np.array(found).T
        return loads, slopes

    tangent, loads = by_scipy.root(by_scipy.task(ready), rollers)
    theirs = tangent[0, 0], tangent[2, 2]
    off = float(np.max(np.abs(np.asarray(ours.loads) - loads)) / loads.max())
    radial, axial = (float(a / b - 1.0) for a, b in zip(ours.both_stiffnesses, theirs, strict=True))
    return off, radial, axial


def main() -> None:
    for number in [int(v) for v in sys.argv[1:]] or SCENES:
        started = time.perf_counter()
        scene = geometry.as_floats(rings_of_atlas.drawn(number, 20))
        loads, radial, axial = compared(scene)
        print(f"scene {number}: loads {loads:.1e}, radial stiffness {radial:+.1e}, axial {axial:+.1e}, "
              f"{time.perf_counter() - started:.0f} s", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
