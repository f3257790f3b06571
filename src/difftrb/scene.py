"""Scene: what is simulated and nothing more."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Annotated, Literal

import jax
import jax.core
from annotated_types import Interval, Unit

from difftrb import effects
from difftrb.effects import Effect
from difftrb.geometry import Real, Spall, TaperedBearing
from difftrb.given import is_given
from difftrb.law import Law, Palmgren
from difftrb.ring import Load

Definition = Literal["tangent", "secant"]
DesignLoad = Annotated[Real, Interval(ge=0.0, le=1e7), Unit("N")]
Accuracy = Annotated[float, Interval(ge=1e-4, le=1e-2)]
Phase = Annotated[Real, Interval(ge=-6.2832, le=6.2832), Unit("rad")]


@partial(jax.tree_util.register_dataclass, data_fields=[], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class PitchMean:
    """In place of a phase: the mean over one roller pitch."""


@partial(jax.tree_util.register_dataclass, data_fields=[], meta_fields=["name"])
@dataclasses.dataclass(frozen=True)
class LawName:
    """A law that is not prepared yet: `solve` builds it from the scene."""

    name: str


@partial(jax.tree_util.register_dataclass, data_fields=["accuracy", "seconds"], meta_fields=["law"])
@dataclasses.dataclass(frozen=True)
class Finer:
    """The next more exact law: its name, the accuracy of its contacts [-], and how many seconds it would take to make
    here at least, by the contacts that were solved before."""

    law: str
    accuracy: Real
    seconds: Real


@partial(jax.tree_util.register_dataclass, data_fields=["accuracy", "asked", "error", "finer"], meta_fields=["law"])
@dataclasses.dataclass(frozen=True)
class Picked:
    """What the law "auto" became.

    Attributes:
      law: its name. accuracy: of its contacts [-].
      asked: the scene's `accuracy`. error: how far radial stiffness, axial stiffness and the largest roller load are
        known to be off at most, relative [-]; larger than `asked` if nothing keeps that, NaN if a scene without a
        solution tells nothing.
      finer: None if there is none.
    """

    law: str
    accuracy: Real
    asked: Real
    error: Real
    finer: Finer | None


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["bearing", "load", "spalls", "law", "design_load", "phase", "effects", "picked"],
    meta_fields=["accuracy", "definition"],
)
@dataclasses.dataclass(frozen=True)
class Scene:
    """A bearing, its load and its spalls, and how to compute with them. A pytree: every number is a leaf.

    Attributes:
      bearing: from `difftrb.bearing("32008J")` or your own `TaperedBearing`.
      load: radial and axial [N].
      spalls: on the outer raceway, or with the effect `Raceways` on the inner one and on roller 0, too; empty is
        healthy.
      law: "power" (default), "liu2018", "palmgren", "table", "direct", "auto" (chosen: see `prepare`), or a law made
        before (then nothing is fitted here). "table", "direct" and "auto" need `prepare` before the scene is
        differentiated, jitted or batched.
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
    law: Law | LawName | str = "power"
    design_load: DesignLoad = 6500.0
    accuracy: Accuracy = 1e-3
    definition: Definition = "tangent"
    phase: Phase | PitchMean | Literal["mean"] = 0.0
    effects: tuple[Effect, ...] = ()
    picked: Picked | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", effects.in_order(self.effects))
        if isinstance(self.phase, str):
            if self.phase != "mean":
                raise ValueError(f"phase = {self.phase!r} is unknown; give an angle [rad] or 'mean'")
            object.__setattr__(self, "phase", PitchMean())
        if isinstance(self.law, str):
            object.__setattr__(self, "law", LawName(self.law))


def healthy(scene: Scene) -> Scene:
    """The same scene without spalls. Prepare first, so that both share one law."""
    return dataclasses.replace(scene, spalls=())


def unmet(scene: Scene) -> str | None:
    """What keeps the scene's spalls and effects from being had together, in one sentence; None if nothing does."""
    keys = {effect.key for effect in scene.effects}
    name = scene.law.name if isinstance(scene.law, LawName) else None
    for i, spall in enumerate(scene.spalls):
        if spall.surface != "outer" and "raceways" not in keys:
            return (
                f"spall.{i}.surface = {spall.surface!r}: the plain ring meets spalls on the 'outer' raceway only; name "
                "effects.raceways"
            )
        if spall.surface == "roller" and isinstance(scene.phase, PitchMean):
            return (
                f"spall.{i}.surface = 'roller' belongs to one roller, so phase = 'mean' has no meaning for it; give a "
                "phase in rad"
            )
    if "raceways" in keys and name in ("palmgren", "liu2018"):
        return (
            f"contact.law = {name!r} does not know the inner raceway alone: with effects.raceways use 'power', 'table' "
            "or 'direct'"
        )
    if "tilt" in keys and not isinstance(scene.law, Palmgren) and name != "palmgren":
        return "effects.tilt carries by slices of ISO/TS 16281: set contact.law = 'palmgren'"
    if {"tilt", "double_row"} <= keys and (sentence := _tilting_pair(scene.effects)) is not None:
        return sentence
    for effect in scene.effects:
        try:
            effect.check(scene.bearing, scene.load)
        except ValueError as error:
            return str(error)
    return None


def _tilting_pair(acting: tuple[Effect, ...]) -> str | None:
    """What keeps slices and a second row from being had together; None if nothing does."""
    tilt = next(effect for effect in acting if isinstance(effect, effects.Tilt))
    row = next(effect for effect in acting if isinstance(effect, effects.DoubleRow))
    if is_given(tilt.reach):
        return (
            "effects.tilt.reach must be 0 with effects.double_row, whose shaft tilts about the middle between its "
            "rows; leave it out"
        )
    if tilt.rings == "free" and row.spacing is None:
        return "effects.double_row.spacing is missing: effects.tilt needs it, or rings = 'parallel'; give one of both"
    if tilt.rings == "parallel" and row.spacing is not None:
        return (
            "effects.tilt.rings = 'parallel' and effects.double_row.spacing exclude each other: rings with a spacing "
            "tilt; leave one out"
        )
    return None
