"""Scene: what is simulated and nothing more."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

import jax
from annotated_types import Interval, Unit

from difftrb.contact.height_map import HeightMap
from difftrb.core import arrays as xp
from difftrb.core import fields, packaged_bearings
from difftrb.core.geometry import DESIGN_LOAD, LineContact, Raceway, Real, Spall, TaperedBearing
from difftrb.core.input_errors import did_you_mean, is_whole, shown
from difftrb.core.status import SceneError
from difftrb.law import base as laws
from difftrb.law import direct_states, power, table
from difftrb.law.base import Law
from difftrb.ring import effect_base, effects, roller_places
from difftrb.ring.effect_base import Effect
from difftrb.ring.load import Load

Definition = Literal["tangent", "secant"]
DesignLoad = Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]
DEFAULT_LAW = laws.AUTO
"""Of scenes, in files and in Python."""
COARSEST = 1e-2
"""Largest accuracy of a contact solve; only "auto" is asked for less, and of something else."""
SHOWN = 4
"""Spalls that a scene's `repr` names."""
Accuracy = Annotated[float, Interval(ge=1e-4, le=COARSEST)]
AutoAccuracy = Annotated[float, Interval(ge=1e-3, le=1e-1)]
"""What can be asked of the law "auto": below, contact solves at 1e-4 are not known to suffice; above, why ask."""
Phase = Annotated[Real, Interval(ge=-6.2832, le=6.2832), Unit("rad")]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PitchMean:
    """In place of a phase: the mean over one roller pitch."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LawName:
    """A law that is not prepared yet: `solve` builds it from the scene."""

    name: str = dataclasses.field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Finer:
    """The next more exact law: its name, the accuracy of its contacts [-], and how many seconds it would take to make
    here at least, by the contacts that were solved before."""

    law: str = dataclasses.field(metadata={"static": True})
    accuracy: Real
    seconds: Real


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Picked:
    """What the law "auto" became.

    Attributes:
      law: its name. accuracy: of its contacts [-].
      asked: the scene's `accuracy`. error: how far radial stiffness, axial stiffness and the largest roller load are
        off, relative [-]: at most as far as contact solves tell, by the table nine in ten; larger than `asked` if
        nothing keeps that, NaN if a scene without a solution tells nothing.
      finer: None if there is none.
    """

    law: str = dataclasses.field(metadata={"static": True})
    accuracy: Real
    asked: Real
    error: Real
    finer: Finer | None


@fields.register
@dataclasses.dataclass(frozen=True, repr=False)
class Scene:
    """A bearing, its load and its spalls, and how to compute with them. A pytree: every number is a leaf.

    What a scene file would refuse, `solve` and all others refuse as `SceneError` (a ValueError), in the same sentence:
    numbers out of their range, cones without a common apex, rollers that overlap, spalls longer than the law knows or
    that leave less than 3 % of their way round, effects that cannot be had together. Loads, spalls and phases that are
    not finite, numbers traced inside jit, and loads without an equilibrium end as a status of the result. Making a
    scene raises for an unknown bearing, a phase in other words, and effects that exclude each other. Whole numbers
    become floats.

    Attributes:
      bearing: its name, say "32008J", or your own `TaperedBearing`.
      load: radial and axial [N].
      spalls: a tuple of them, or one; on the outer raceway, on the inner one or on roller 0; empty is healthy. Those
        not on the outer raceway call for the effect `Raceways`: the scene has it then, named or not.
      law: "auto" (default: "table" where it knows the scene, else "direct"), "table", "direct", "power", "liu2018",
        "palmgren", or a law made before. "direct" needs `prepare` before the scene is differentiated, jitted or
        batched; traced, "auto" is "table", whose status says what it does not know.
      design_load: Q_d of the rollers' crown [N], 0…1e7. Default 6500, with which Liu et al. 2018, Table 2 comes out.
      accuracy: relative accuracy of the contact solves behind the law, 1e-2…1e-4. Default 1e-3: a power law is not
        worth more. With law "auto" it is that of stiffness and the largest roller load, 1e-1…1e-3.
      definition: of stiffness, "tangent" (dF/du, default) or "secant" (F/u, as in Liu et al. 2018, Fig. 17).
      phase: angle of roller 0 from the load line [rad], −2π…2π, or "mean": everything is averaged over one roller
        pitch of cage phases.
      effects: what else acts, from `difftrb.effects`; empty is the plain ring.
      picked: filled in by `prepare` for the law "auto": what was chosen, at the scene that was prepared.
    """

    bearing: TaperedBearing
    load: Load
    spalls: tuple[Spall, ...] = ()
    law: Law | LawName | str = DEFAULT_LAW
    design_load: DesignLoad = DESIGN_LOAD
    accuracy: Accuracy = dataclasses.field(default=1e-3, metadata={"static": True})
    definition: Definition = dataclasses.field(default="tangent", metadata={"static": True})
    phase: Phase | PitchMean | Literal["mean"] = 0.0
    effects: tuple[Effect, ...] = ()
    picked: Picked | None = None

    def __post_init__(self) -> None:
        tidy: dict[str, Any] = {}
        if isinstance(self.bearing, str):
            tidy["bearing"] = packaged_bearings.bearing(self.bearing)
        if isinstance(self.spalls, Spall | HeightMap | list):
            tidy["spalls"] = tuple(self.spalls) if isinstance(self.spalls, list) else (self.spalls,)
        tidy["effects"] = _with_called_for(effect_base.in_order(self.effects), tidy.get("spalls", self.spalls))
        if isinstance(self.phase, str):
            if self.phase != "mean":
                raise SceneError(f"phase = {self.phase!r} is unknown; give an angle [rad] or 'mean'")
            tidy["phase"] = PitchMean()
        if isinstance(self.law, str):
            tidy["law"] = LawName(self.law)
        for name, value in tidy.items():
            object.__setattr__(self, name, value)
        fields.whole_to_float(self, ("design_load", "phase"))

    def replace(self, *, spall: int | None = None, **values: Any) -> Scene:
        """The scene with other values by their names: of its own fields, of the load (`radial`, `axial`), of the
        bearing (`roller_length`, …), or of a spall (`length`, `width`, `depth`, `angle`, `axial_offset`, `surface`,
        `row`).

        `spall` says which one, from 0; default the only one; it is `spalls` that replaces them. Raises `SceneError` for
        a name that nothing has, and for a spall's without a spall or with several.
        """
        if spall is not None and not is_whole(spall):
            raise SceneError(f"spall = {shown(spall)}: must be the number of a spall, from 0; spalls = … replaces them")
        parts: dict[str, dict[str, Any]] = {"scene": {}, "load": {}, "bearing": {}, "spall": {}}
        owners: dict[str, list[type]] = {"scene": [Scene], "load": [Load], "bearing": [TaperedBearing]}
        owners["spall"] = list(dict.fromkeys(map(type, self.spalls))) or [Spall]
        names = {part: [field.name for one in own for field in dataclasses.fields(one)] for part, own in owners.items()}
        for name, value in values.items():
            part = next((part for part, own in names.items() if name in own), None)
            if part is None:
                raise SceneError(
                    f"{name} is not known; {did_you_mean(name, [n for own in names.values() for n in own])}"
                )
            parts[part][name] = value
        scene = dataclasses.replace(self, **parts["scene"])
        for part in ("load", "bearing"):
            if parts[part]:
                scene = dataclasses.replace(scene, **{part: dataclasses.replace(getattr(scene, part), **parts[part])})
        if not parts["spall"]:
            if spall is not None:
                raise SceneError(
                    f"spall = {spall}: says whose values to replace, and none is given; name one, say length"
                )
            return scene
        count = len(scene.spalls)
        which = 0 if spall is None and count == 1 else spall
        if which is None or not 0 <= which < count:
            raise SceneError(f"{next(iter(parts['spall']))}: the scene has {count} spalls; say which by spall = 0 …")
        own = scene.spalls[which]
        for name in parts["spall"]:
            if name not in {field.name for field in dataclasses.fields(own)}:
                raise SceneError(f"{name}: spall {which} is a {type(own).__name__}, which has none")
        changed = dataclasses.replace(cast(Any, own), **parts["spall"])
        return dataclasses.replace(scene, spalls=(*scene.spalls[:which], changed, *scene.spalls[which + 1 :]))

    def __repr__(self) -> str:
        """On a few lines: bearing, load, every spall, law, phase and effects."""
        name = packaged_bearings.name_of(self.bearing) or "own bearing"
        rollers = getattr(self.bearing, "rollers", "?")
        law = getattr(self.law, "name", type(self.law).__name__)
        rows = [f"Scene: {name}, {rollers} rollers; {self.load}; law {law}, {self.definition}", f"  phase {self.phase}"]
        rows += [f"  {spall}" for spall in self.spalls[:SHOWN]]
        if len(self.spalls) > SHOWN:
            rows.append(f"  and {len(self.spalls) - SHOWN} more spalls")
        return "\n".join([*rows, *(f"  effect: {each.label}" for each in self.effects)])


def _with_called_for(named: tuple[Effect, ...], spalls: Any) -> tuple[Effect, ...]:
    """The effects named, and what the spalls call for: one on the inner raceway or on a roller, both raceways."""
    surfaces = {getattr(spall, "surface", "outer") for spall in (spalls if isinstance(spalls, tuple) else ())}
    if surfaces <= {"outer"} or effect_base.among(named, effects.Raceways) is not None:
        return named
    return effect_base.in_order((*named, effects.Raceways()))


def raceway_contact(scene: Scene, raceway: Raceway) -> LineContact:
    """The contact of the rollers with one raceway."""
    design_load = scene.design_load
    series = effect_base.among(scene.effects, effects.Raceways)
    if raceway == "inner" and series is not None and series.inner_design_load is not None:
        design_load = series.inner_design_load
    return LineContact.of(scene.bearing, raceway, design_load)


def outer_law(scene: Scene) -> Law:
    """The law that a prepared scene has on the outer raceway, carried to the contact that it has now."""
    law = cast(Law, scene.law).at(raceway_contact(scene, "outer"))
    return law if scene.spalls else direct_states.without_spalls(law)


def inner_law(scene: Scene) -> Law | None:
    """The law that a prepared scene has on the inner raceway, if this gives way, likewise."""
    series = effect_base.among(scene.effects, effects.SeriesRaceways)
    return None if series is None else cast(Law, series.law).at(raceway_contact(scene, "inner"))


def raceway_laws(scene: Scene) -> tuple[Law, ...]:
    """The laws of a prepared scene, of every raceway that gives way: that of the outer one first."""
    inner = inner_law(scene)
    return (outer_law(scene),) if inner is None else (outer_law(scene), inner)


def laws_error(scene: Scene) -> Any:
    """The error that the laws of a prepared scene state [-], the larger one of both raceways'."""
    series = effect_base.among(scene.effects, effects.SeriesRaceways)
    every = [scene.law] if series is None else [scene.law, series.law]
    return functools.reduce(xp.maximum, [cast(Law, law).error for law in every])


def on_raceways(scene: Scene, made: Mapping[Raceway, Law], rollers: Literal["free", "upright"] | None = None) -> Scene:
    """The scene with these laws on its raceways, between which `rollers` may tilt as before, or as it is said here."""
    acting = tuple(
        effects.SeriesRaceways(each.inner_design_load, made["inner"], rollers=rollers or each.rollers)
        if isinstance(each, effects.Raceways) and "inner" in made
        else each
        for each in scene.effects
    )
    return dataclasses.replace(scene, law=made["outer"], effects=acting)


def upright_by_table(scene: Scene) -> Scene:
    """The scene with the table on all raceways that give way, and rollers held upright, in any arithmetic."""
    series = effect_base.among(scene.effects, effects.Raceways)
    raceways: tuple[Raceway, ...] = ("outer",) if series is None else ("outer", "inner")
    made: dict[Raceway, Law] = {
        each: table.table_law(raceway_contact(scene, each), roller_places.spalls_on(scene.spalls, each))
        for each in raceways
    }
    return on_raceways(scene, made, "upright")


def law_in_effect(scene: Scene, law: Law) -> Law:
    """The outer raceway's law as the scene's effects have it."""
    return power.AllThrough(law) if effect_base.among(scene.effects, effects.Through) is not None else law


def ring_at(scene: Scene, law: Law, phase: Any) -> tuple[effects.Ring, effects.Terms]:
    """The ring of a scene at a cage phase, or at many, by this law of the outer raceway, and what its effects make of
    it: the inner raceway's law is carried to the contact that it has now."""
    here = effects.Ring(scene.bearing, scene.load, scene.spalls, law, raceway_contact(scene, "outer"), phase)
    inner = inner_law(scene)
    acting = (dataclasses.replace(each, law=inner) if isinstance(each, effects.SeriesRaceways) else each
              for each in scene.effects)  # fmt: skip
    return here, effects.terms(tuple(acting), here)


def has_map(scene: Scene) -> bool:
    """Whether one of the spalls is a height map."""
    return any(isinstance(spall, HeightMap) for spall in scene.spalls)


def is_auto(scene: Scene) -> bool:
    """Whether the scene leaves its law to be chosen."""
    return isinstance(scene.law, LawName) and scene.law.name == laws.AUTO


def named(scene: Scene, law: str, accuracy: float) -> Scene:
    """The scene with a law by name and the accuracy of its contacts."""
    return dataclasses.replace(scene, law=LawName(law), accuracy=accuracy)


def healthy(scene: Scene) -> Scene:
    """The same scene without spalls. Prepare first, so that both share one law."""
    return dataclasses.replace(scene, spalls=())
