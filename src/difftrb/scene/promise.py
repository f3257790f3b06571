"""How far off a roller law promises its loads to be at most, and what no law of its kind can promise."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import gap
from difftrb.core.geometry import Real, Spall
from difftrb.law import edge_ramp
from difftrb.law.base import LAWS, Law, Rest
from difftrb.law.direct import DirectLaw
from difftrb.law.local import LocalLaw
from difftrb.ring import ring
from difftrb.ring.effects import Through
from difftrb.scene import preparation
from difftrb.scene.scene import Scene
from difftrb.scene.solution import Solution

CONTACTS_KEEP = 3.0
"""Contacts are as exact as asked for in nine of ten cases, and never beyond so many times that."""
TABLES_KEEP = 2.0
"""A table's error is measured at some tens of random contacts; others are at most so many times as far off."""


def promised(of: Law, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest, largest: float) -> float:
    """What a law promises of the error of rollers' loads at rest, relative to the `largest` load [N]; NaN if nothing.

    Contacts hold what was asked for `CONTACTS_KEEP` times over, a table `TABLES_KEEP` times what was measured. A hard
    window knows no roller on a spall's rolling edge: it carries anything between what a healthy one would and one in
    the spall. A power law promises nothing of a ring whose rollers carry more than it was fitted to, and the paper's
    nothing at all: it is told by contacts that were cut off.
    """
    if isinstance(of, DirectLaw | LocalLaw):
        return CONTACTS_KEEP * float(of.error)
    error = float(of.error)
    if not of.hard:
        return TABLES_KEEP * error
    promises = of.name not in LAWS or LAWS[of.name].promises
    if not promises or float(jnp.max(rest.loads)) > float(of.load_range[1]) * (1.0 + 1e-9):
        return math.nan
    lost = 0.0
    for spall, away in zip(spalls, distances, strict=True):
        beside = jnp.abs(jnp.abs(away) - 0.5 * spall.width)
        on_edge = (beside**2 < 2.0 * rest.radius * rest.approach) & (rest.approach > 0.0)
        if bool(jnp.any(on_edge)):
            levels = [_carried(of, rest.approach, spall, place) for place in (spall.width + 1.0, 0.0)]
            lost = max(lost, float(jnp.max(jnp.where(on_edge, levels[0] - levels[1], 0.0))))
    return error + lost / largest


def rollers_on_edges(scene: Scene, found: Solution) -> int:
    """How many loaded rollers stand on a spall's rolling edge: their contact reaches over it. Of the first row, on the
    outer raceway, at one phase."""
    if any(isinstance(effect, Through) for effect in scene.effects):
        return 0
    spalls = ring.spalls_on(scene.spalls, "outer")
    contact = preparation.raceway_contact(scene, "outer")
    loads = np.asarray(found.loads)
    line_loads = jnp.maximum(found.loads, 0.0) / contact.length
    half = np.asarray(gap.line_half_width(line_loads, contact.radius, contact.modulus))
    on_edge = np.zeros(loads.size, bool)
    if spalls:
        for spall, away in zip(spalls, np.asarray(ring.distances(scene.bearing, spalls, found.angles)), strict=True):
            on_edge |= (np.abs(np.abs(away) - 0.5 * float(spall.width)) < half) & (loads > 0.0)
    return int(on_edge.sum())


def _carried(of: Law, approach: jax.Array, spall: Spall, place: Real) -> jax.Array:
    """What rollers at `approach` [mm], shape (rollers,), would carry if all stood so far from the spall [mm]."""
    curves = of.curves((spall,), jnp.broadcast_to(jnp.asarray(place), (1, approach.size)))
    return edge_ramp.roller_loads(curves, approach)[0]
