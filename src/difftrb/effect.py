"""What an effect is: terms that it adds to a ring's equilibrium, and results that it adds to a solution."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from difftrb import geometry, ring, roller
from difftrb.geometry import FILE_RULES, LineContact, Real, Spall, TaperedBearing
from difftrb.law import Law
from difftrb.ring import Equilibrium, Load, Terms

Results = dict[str, jax.Array]
"""What an effect adds to a solution, by name."""


class Ring(NamedTuple):
    """What effects act on: a ring at one cage phase. `law` and `contact` are the outer raceway's."""

    bearing: TaperedBearing
    load: Load
    spalls: tuple[Spall, ...]
    law: Law
    contact: LineContact
    phase: Real

    @property
    def angles(self) -> jax.Array:
        """Of the rollers [rad]."""
        return ring.roller_angles(self.bearing, self.phase)

    def distances(self, raceway: geometry.Raceway) -> jax.Array:
        """See `ring.distances`."""
        return ring.distances(self.bearing, ring.spalls_on(self.spalls, raceway), self.angles, raceway)

    def equilibrium(self, terms: Terms) -> Equilibrium:
        """At rest with these terms."""
        outer = ring.spalls_on(self.spalls, "outer")
        return ring.equilibrium(self.bearing, self.load, outer, self.law, self.phase, terms)


class Effect:
    """Of all effects: `key` names it in a scene file. What is not overridden adds nothing."""

    __pydantic_config__ = FILE_RULES
    key: ClassVar[str]
    excludes: ClassVar[dict[str, str]] = {}
    """Keys of effects that cannot be had together with this one, and why."""

    def check(self, bearing: TaperedBearing, load: Load) -> None:
        """Raise ValueError, in one sentence, if this effect cannot be had so. Outside jit only."""

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """The terms with this effect's added."""
        return terms

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """What comes out beside the loads."""
        return {}


def seat(terms: Terms, of: Ring) -> roller.Seat:
    """What holds the rollers so far."""
    return roller.seat(of.bearing) if terms.seat is None else terms.seat


def on_the_inner_ring(rest: Equilibrium, terms: Terms) -> Results:
    """Loads of inner raceway and flange [N], shape (rollers,)."""
    if terms.seat is None:
        return {}
    return {
        "inner_loads": roller.inner_load(terms.seat, rest.loads),
        "flange_loads": roller.flange_load(terms.seat, rest.loads),
    }


def held_by(rest: Equilibrium, terms: Terms, of: Ring) -> Results:
    """The axial force [N] that holds the rings where they are, if they are held."""
    if terms.axial is None:
        return {}
    return {"axial_force": jnp.sum(rest.loads) * jnp.sin(of.bearing.outer_angle)}


def thicker(terms: Terms, more: jax.Array) -> Terms:
    """Rollers too thick by `more` than they are so far [mm], shape () or (rollers,)."""
    return terms._replace(interference=more if terms.interference is None else terms.interference + more)
