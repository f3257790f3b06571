"""What an effect is: terms that it adds to a ring's equilibrium, and results that it adds to a solution."""

from __future__ import annotations

from typing import Annotated, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from annotated_types import Interval, Unit

from difftrb.core import geometry, pytrees
from difftrb.core.geometry import FILE_RULES, LineContact, Real, Spall, TaperedBearing
from difftrb.law.laws import Law
from difftrb.ring import pair, ring, roller_balance
from difftrb.ring.ring import Equilibrium, Load, Terms

Length = Annotated[Real, Interval(ge=-1.0, le=1.0), Unit("mm")]
Moment = Annotated[Real, Interval(ge=-1e9, le=1e9), Unit("N mm")]
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

    def distances(self, raceway: geometry.Raceway, terms: Terms) -> jax.Array:
        """See `ring.distances`; with a second row those of its rollers behind."""
        away = ring.distances(self.bearing, ring.spalls_on(self.spalls, raceway), self.angles, raceway)
        return away if terms.pair is None else pair.beside(away)

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
    presses: ClassVar[bool] = False
    """Whether rollers may carry more with it than the bearing's load lets expect."""

    def __post_init__(self) -> None:
        pytrees.whole_to_float(self)

    def check(self, bearing: TaperedBearing, load: Load) -> None:
        """Raise ValueError, in one sentence, if this effect cannot be had so. Outside jit only."""

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """The terms with this effect's added."""
        return terms

    def remarks(self, spalls: tuple[Spall, ...]) -> tuple[str, ...]:
        """What is to be said of results over `spalls`, in sentences."""
        return ()

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """What comes out beside the loads."""
        return {}


def seat(terms: Terms, of: Ring) -> roller_balance.Seat:
    """What holds the rollers so far."""
    return roller_balance.seat(of.bearing) if terms.seat is None else terms.seat


def on_the_inner_ring(rest: Equilibrium, terms: Terms) -> Results:
    """Loads of inner raceway and flange [N], shape (rollers,)."""
    if terms.seat is None:
        return {}
    return {
        "inner_loads": roller_balance.inner_load(terms.seat, rest.loads),
        "flange_loads": roller_balance.flange_load(terms.seat, rest.loads),
    }


def held_by(rest: Equilibrium, terms: Terms, of: Ring) -> Results:
    """The axial force [N] that holds the rings where they are, if they are held."""
    if terms.axial is None:
        return {}
    pressed = jnp.sum(rest.loads)
    if rest.second_loads is not None:
        pressed = pressed - jnp.sum(rest.second_loads)
    return {"axial_force": pressed * jnp.sin(of.bearing.outer_angle)}


def thicker(terms: Terms, more: jax.Array) -> Terms:
    """Rollers too thick by `more` than they are so far [mm], shape () or (rollers,)."""
    return terms._replace(interference=more if terms.interference is None else terms.interference + more)
