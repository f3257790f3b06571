"""What an effect is, and the register of all there are.

An effect is one dataclass that declares all about itself: its key in a scene file, its fields with unit, range and
default, its label, what it excludes, what it adds to the equilibrium and to a solution. `register` makes it known.
Scene files, checks and reports take what they need from the register.
"""

from __future__ import annotations

import dataclasses
import enum
import keyword
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple, TypeVar, cast

import jax

from difftrb.core import fields, geometry
from difftrb.core.geometry import FILE_RULES, LineContact, Real, Spall, TaperedBearing
from difftrb.core.input_errors import shown
from difftrb.core.status import SceneError
from difftrb.core.taylor import goes_through
from difftrb.law.base import Law
from difftrb.ring import ring, roller_balance, roller_places
from difftrb.ring.load import Load
from difftrb.ring.ring import Equilibrium
from difftrb.ring.terms import PLAIN, Terms, beside

PART_OF_A_TURN = (
    "rollers differ, so the mean over one pitch is not that over the cage's turn: `difftrb stiffness` has that one"
)
Results = dict[str, jax.Array]
"""What an effect adds to a solution, by name."""


class Stage(enum.IntEnum):
    """When an effect acts; within a stage, effects act in the order in which they were registered."""

    ROWS = 0
    """How many rows there are."""
    SEAT = 1
    """What holds a roller besides the outer raceway."""
    FIT = 2
    """How thick rollers are, and where the rings are held."""
    SPEED = 3
    CONTACT = 4
    """How a roller carries."""
    OUTCOME = 5
    """What follows from the loads."""


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
        return roller_places.roller_angles(self.bearing, self.phase)

    def distances(self, raceway: geometry.Raceway, terms: Terms) -> jax.Array:
        """See `roller_places.distances`; with a second row those of its rollers behind."""
        spalls = roller_places.spalls_on(self.spalls, raceway)
        away = roller_places.distances(self.bearing, spalls, self.angles, raceway)
        return away if terms.pair is None else beside(away, spalls)

    def seat(self, terms: Terms) -> roller_balance.Seat:
        """What holds the rollers so far."""
        return roller_balance.seat(self.bearing) if terms.seat is None else terms.seat

    def equilibrium(self, terms: Terms) -> Equilibrium:
        """At rest with these terms."""
        outer = roller_places.spalls_on(self.spalls, "outer")
        return ring.equilibrium(self.bearing, self.load, outer, self.law, self.phase, terms)


class Asked(NamedTuple):
    """What an effect is asked for together with; `law` is its name, or a law that is made already."""

    bearing: TaperedBearing
    load: Load
    law: Law | str
    effects: tuple[Effect, ...]


class Effect:
    """Of all effects. What is not overridden adds nothing.

    Fields are numbers annotated with `Interval` and `Unit`, or `Literal` texts. Numbers are leaves of the pytree; texts
    and whole numbers have the metadata `{"static": True}`. Terms and results are over `core.arrays`, with the cage
    phases in front.
    """

    __pydantic_config__ = FILE_RULES
    key: ClassVar[str]
    """Its name in a scene file's `[effects]`."""
    label: ClassVar[str]
    """What acts, in a few words."""
    stage: ClassVar[Stage] = Stage.FIT
    excludes: ClassVar[dict[str, str]] = {}
    """Keys of effects that cannot be had together with this one, and why."""
    presses: ClassVar[bool] = False
    """Whether rollers may carry more with it than the bearing's load lets expect."""
    holds_axially: ClassVar[bool] = False
    """Whether the rings' axial position is given, and the axial force comes out."""
    per_turn: ClassVar[bool] = False
    """Whether rollers differ, so that a ring repeats once a turn of the cage, no longer once a pitch."""
    units: ClassVar[dict[str, str]] = {}
    """Units of what `results` has."""

    def __post_init__(self) -> None:
        fields.whole_to_float(self)

    def check(self, asked: Asked) -> None:
        """Raise `SceneError`, in one sentence, if this effect cannot be had so. Outside jit only."""

    def terms(self, terms: Terms, of: Ring) -> Terms:
        """The terms with this effect's added."""
        return terms

    def remarks(self, spalls: tuple[Spall, ...], law: Law | None, mean: bool) -> tuple[str, ...]:
        """What is to be said of results over `spalls` by a law of the outer raceway, in sentences; `mean`: over the
        phases of a pitch. None: the law is not made yet."""
        return ()

    def results(self, rest: Equilibrium, terms: Terms, of: Ring) -> Results:
        """What comes out beside the loads."""
        return {}


# ------------------------------------------------------------------------------------------------ the register

_REGISTER: dict[str, type[Effect]] = {}

Kind = TypeVar("Kind", bound=type[Effect])
One = TypeVar("One", bound=Effect)


def register(kind: Kind) -> Kind:
    """Make a dataclass an effect that scenes and scene files may name; for use as a decorator.

    Raises `SceneError` for a key that is no plain name or another effect's, and for a field without a range. A class of
    the same name and module replaces the one before, as when a notebook's cell runs again.
    """
    key, known = getattr(kind, "key", None), _REGISTER.get(getattr(kind, "key", ""))
    if not isinstance(key, str) or not key.isidentifier() or keyword.iskeyword(key):
        raise SceneError(f"{kind.__name__}.key = {shown(key)}: must be a plain name, say 'flange'")
    if known is not None and (known.__module__, known.__qualname__) != (kind.__module__, kind.__qualname__):
        raise SceneError(f"{kind.__name__}.key = {key!r} is that of {known.__qualname__}; choose another")
    if not getattr(kind, "label", ""):
        raise SceneError(f"{kind.__name__}.label is missing: say in a few words what acts")
    ranged = {field.name for field in fields.fields_of(kind)}
    for field in dataclasses.fields(cast(Any, kind)):
        if field.name not in ranged:
            raise SceneError(f"{kind.__name__}.{field.name} has no range: annotate it with Interval and Unit")
    _REGISTER[key] = kind
    return fields.register(kind)


def registered() -> tuple[type[Effect], ...]:
    """All effects there are, in the order in which they act."""
    return tuple(sorted(_REGISTER.values(), key=lambda kind: kind.stage))


def file_table(kinds: tuple[type[Effect], ...]) -> type:
    """The schema of a scene file's `[effects]`: a dataclass with a field for each of these effects, None if absent."""
    fields = [(kind.key, kind | None, dataclasses.field(default=None)) for kind in kinds]
    rules = {"__pydantic_config__": FILE_RULES}
    return dataclasses.make_dataclass("Effects", fields, frozen=True, namespace=rules)


# ------------------------------------------------------------------------------------------------ several at once


def in_order(effects: Any) -> tuple[Effect, ...]:
    """The effects, or the only one, in the order in which they act. Raises `SceneError` for what is none, one named
    twice, or two that exclude each other."""
    if isinstance(effects, Effect):
        effects = (effects,)
    if not isinstance(effects, Iterable):
        raise SceneError(f"effects = {shown(effects)}: must be a tuple of difftrb.effects, say (Life(),), or ()")
    for i, effect in enumerate(effects):
        if not isinstance(effect, Effect):
            raise SceneError(f"effects.{i} = {shown(effect)}: must be one of difftrb.effects, say Life()")
        if getattr(effect, "key", None) not in _REGISTER:
            raise SceneError(f"effects.{i} = {shown(effect)}: is not known; register its class: effects.register")
    keys = [effect.key for effect in effects]
    for effect in effects:
        if keys.count(effect.key) > 1:
            raise SceneError(f"effects.{effect.key} is named twice; name it once")
        for key in effect.excludes:
            if key in keys:
                raise SceneError(
                    f"effects.{effect.key} and effects.{key} exclude each other: {effect.excludes[key]}; name one"
                )
    order = [kind.key for kind in registered()]
    return tuple(sorted(effects, key=lambda effect: order.index(effect.key)))


def among(effects: tuple[Effect, ...], kind: type[One]) -> One | None:
    """The effect of this kind, or None."""
    return next((effect for effect in effects if isinstance(effect, kind)), None)


def remarks(
    effects: tuple[Effect, ...], spalls: tuple[Spall, ...], mean: bool = False, law: Law | None = None
) -> tuple[str, ...]:
    """What all effects have to say, as `Effect.remarks`, and what is to be said of all of them."""
    partial = (PART_OF_A_TURN,) if mean and differ(effects) else ()
    return (*partial, *(sentence for effect in effects for sentence in effect.remarks(spalls, law, mean)))


def differ(effects: tuple[Effect, ...]) -> bool:
    """Whether rollers differ from each other."""
    return any(effect.per_turn for effect in effects)


def terms(effects: tuple[Effect, ...], of: Ring) -> Terms:
    """What all effects add to the ring's equilibrium."""
    total = PLAIN
    for effect in effects:
        with goes_through(f"effects.{effect.key}"):
            total = effect.terms(total, of)
    return total


def results(effects: tuple[Effect, ...], rest: Equilibrium, total: Terms, of: Ring) -> Results:
    """What all effects add to the solution."""
    found: Results = {}
    for effect in effects:
        found |= effect.results(rest, total, of)
    return found


def units(effects: tuple[Effect, ...]) -> dict[str, str]:
    """Units of what all effects add to the solution, by name."""
    return {name: unit for effect in effects for name, unit in effect.units.items()}
