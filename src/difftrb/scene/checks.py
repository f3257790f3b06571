"""What a scene cannot have, in one sentence: one set of checks for scene files and for scenes made in Python.

Keys are those of a scene file. Numbers that are traced are passed over; inside jit what is wrong with them is a status
of the result (`code`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import PurePath
from typing import Any, cast, get_args

import jax
import jax.core
import numpy as np

from difftrb.contact.height_map import HIGHEST, HeightMap
from difftrb.core import arrays as xp
from difftrb.core import fields, geometry, packaged_bearings, status
from difftrb.core.bearing_checks import across, as_numbers, first, fit_together
from difftrb.core.geometry import LineContact, Spall, TaperedBearing
from difftrb.core.input_errors import number_in, shown
from difftrb.core.status import SceneError
from difftrb.law import base as laws
from difftrb.law.base import Law
from difftrb.law.direct_states import DirectByStates
from difftrb.ring import effect_base, effects, roller_places
from difftrb.ring.catalogue_inference import CatalogueBearing
from difftrb.ring.effects import Effect
from difftrb.ring.load import Load, needed_axial, too_light
from difftrb.scene.scene import Accuracy, AutoAccuracy, LawName, PitchMean, Scene

WIDEST = 0.97
"""Of once round: the most that a spall takes. Edges that come close again, all but all round, are one edge to a law."""
HELD_PHASES = 16
"""Over one pitch, at which rings that tilt are looked at."""
KEYS = {"design_load": "contact.design_load", "definition": "stiffness.definition", "phase": "stiffness.phase"}
"""Of a scene's own numbers in a file."""


def checked(scene: Scene) -> Scene:
    """The scene in floats. Raises `SolveError` without float64, `SceneError` for what cannot be had."""
    status.require_float64()
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {shown(scene)}: must be a Scene; read a file's by difftrb.load_scene")
    refuse(scene)
    return geometry.as_floats(scene)


def refuse(scene: Scene) -> None:
    """Raise `SceneError` if something is wrong with a scene."""
    sentence = wrong(scene)
    if sentence is not None:
        raise SceneError(sentence)


def wrong(scene: Scene) -> str | None:
    """What is wrong with a scene, in one sentence; None if nothing is. Whether there is an equilibrium is not asked,
    and NaN and infinite loads, spalls and phases are passed over, but for laws from contact solves one by one."""
    every = _of_kinds, lambda read: across(read.bearing, read.spalls), _of_law, _of_spalls, _of_effects
    return first(*every, of=_read(scene))


def _read(scene: Scene) -> Scene:
    """The scene with numbers in arrays read once: to read one takes longer than to check it."""
    numbers = {"bearing": scene.bearing, "load": scene.load, "spalls": scene.spalls, "design_load": scene.design_load,
               "phase": scene.phase}  # fmt: skip
    leaves, structure = jax.tree.flatten(numbers)
    known = [isinstance(leaf, jax.Array) and not isinstance(leaf, jax.core.Tracer) for leaf in leaves]
    if not any(known):
        return scene
    read = [np.asarray(leaf) if own else leaf for leaf, own in zip(leaves, known, strict=True)]
    read = [leaf.item() if own and not leaf.ndim else leaf for leaf, own in zip(read, known, strict=True)]
    return dataclasses.replace(scene, **jax.tree.unflatten(structure, read))


# ------------------------------------------------------------------------------------------------ one key at a time


def _of_kinds(scene: Scene) -> str | None:
    """Every field for itself: what it is, and its range."""
    solved = isinstance(scene.law, LawName) and laws.kind(scene.law.name).by_samples
    if isinstance(scene.bearing, CatalogueBearing):
        return "bearing = a CatalogueBearing: give its .bearing, and as design_load its .design_load"
    if not isinstance(scene.bearing, TaperedBearing):
        return (
            f"bearing = {shown(scene.bearing)}: must be a name ({', '.join(map(repr, packaged_bearings.BEARINGS))}) "
            "or a TaperedBearing"
        )
    if not isinstance(scene.load, Load):
        return f"load = {shown(scene.load)}: must be a Load, say Load(radial=9000.0, axial=4500.0)"
    if not isinstance(scene.spalls, tuple):
        return f"spall = {shown(scene.spalls)}: must be a Spall, or a tuple of them"
    for i, spall in enumerate(scene.spalls):
        if not isinstance(spall, Spall | HeightMap):
            other = ", or a height map, load_height_map(path)" if isinstance(spall, str | PurePath) else ""
            return f"spall.{i} = {shown(spall)}: must be a Spall, say Spall(length=4.0, width=7.0){other}"
        if isinstance(spall, HeightMap) and getattr(spall.height, "ndim", 0) != 2:
            return f"spall.{i}.height: must be an array of heights [mm], rows along the roller, at least 2 × 2"
    for i, effect in enumerate(scene.effects):
        if not isinstance(effect, Effect):
            return f"effects.{i} = {shown(effect)}: must be one of difftrb.effects"
    for key, owner, not_finite in _owners(scene):
        if (sentence := fields.wrong(owner, key, not_finite and not solved)) is not None:
            return sentence
    for field in fields.fields_of(Scene):
        value = getattr(scene, field.name)
        if field.name not in KEYS or isinstance(value, PitchMean):
            continue
        passed = field.name == "phase" and not solved
        if (sentence := fields.of_field(field, value, KEYS[field.name], passed)) is not None:
            return sentence
    return None


def _owners(scene: Scene) -> Iterator[tuple[str, Any, bool]]:
    """Everything in a scene that has numbers: its key, itself, and whether numbers that are not finite end as a status
    of the result."""
    yield "bearing", scene.bearing, False
    yield "load", scene.load, True
    for i, spall in enumerate(scene.spalls):
        yield f"spall.{i}", spall, isinstance(spall, Spall)
    for effect in scene.effects:
        yield f"effects.{effect.key}", effect, False


# ------------------------------------------------------------------------------------------------ across keys


def _of_law(scene: Scene) -> str | None:
    """The law, its accuracy, and the lengths of spalls that it knows."""
    if not isinstance(scene.law, LawName):
        if not hasattr(scene.law, "curves"):
            known = ", ".join(map(repr, laws.names()))
            return f"contact.law = {shown(scene.law)}: must be one of {known}, or a law made"
        return None
    name = scene.law.name
    if name not in laws.names():
        return f"contact.{laws.unknown(name)}"
    if not laws.kind(name).is_for(scene.bearing):
        return f"contact.law = {name!r} holds for the bearing {laws.kind(name).bearing} only; use 'auto'"
    return _accuracy(scene, name)


def _accuracy(scene: Scene, law: str) -> str | None:
    limits = get_args(AutoAccuracy if law == laws.AUTO else Accuracy)[1]
    value, least, most = scene.accuracy, limits.ge, limits.le
    if not isinstance(value, int | float) or isinstance(value, bool):
        return f"contact.accuracy = {shown(value)}: must be {number_in(least, most)}"
    if least <= value <= most:
        return None
    of = "with law = 'auto', of stiffness and peak load" if law == laws.AUTO else "for the ring"
    more = "; `difftrb contact` goes further" if value < least else ""
    return f"contact.accuracy = {value:g}: must be {number_in(least, most)} {of}{more}"


def _of_spalls(scene: Scene) -> str | None:
    """Spalls on the ring, by the law that is named."""
    for i, spall in enumerate(scene.spalls):
        if isinstance(spall, HeightMap) and (sentence := _of_map(scene, i, spall)) is not None:
            return sentence
    law = scene.law.name if isinstance(scene.law, LawName) else None
    roller = as_numbers(scene.bearing.roller_length)
    for i, spall in enumerate(scene.spalls):
        length, width, around = as_numbers(spall.length), as_numbers(spall.width), _once_round(scene.bearing, spall)
        if law is not None and length and roller and isinstance(spall, Spall):
            longest = laws.kind(law).longest(roller[0])
            if length[0] > longest * (1.0 + 1e-12):
                return (
                    f"spall.{i}.length = {length[0]:g}: contact.law = {law!r} knows 0 … {longest:g} mm; shorten the "
                    "spall or choose another law"
                )
        if width and around and width[0] > WIDEST * around * (1.0 + 1e-12):
            return (
                f"spall.{i}.width = {width[0]:g}: must be at most {100.0 * WIDEST:g} % of once round the "
                f"{_lies_on(spall)}, {WIDEST * around:.6g} mm; make it narrower"
            )
    one_shape = laws.kind(law or "").one_shape
    for raceway in ("outer", "inner"):
        if one_shape and not of_one_shape(roller_places.spalls_on(scene.spalls, raceway)):
            return f"spall: contact.{one_shape}"
    return None


def _of_map(scene: Scene, i: int, measured: HeightMap) -> str | None:
    """What a height map in the ring cannot have: contacts on it are solved one by one, by nothing else."""
    named = isinstance(scene.law, LawName)
    law = getattr(scene.law, "name", "")
    known = law == laws.AUTO or laws.kind(law).maps if named else isinstance(scene.law, DirectByStates)
    if not known:
        return f"spall.{i}.height_map: contact.law = {shown(law)} knows rectangular spalls; use 'auto' or 'direct'"
    if named and not xp.are_numbers(scene):
        return f"spall.{i}.height_map: needs numbers: prepare the scene first, difftrb.prepare(scene)"
    if effect_base.among(scene.effects, effects.Through) is not None:
        return f"spall.{i}.height_map: effects.through takes rectangular spalls; leave one of both out"
    if isinstance(measured.height, jax.core.Tracer):
        return None
    heights = np.asarray(measured.height)
    if min(heights.shape) < 2 or not (np.abs(heights) <= HIGHEST).all():
        return f"spall.{i}.height: must be a grid of at least 2 × 2 heights in {-HIGHEST:g} … {HIGHEST:g} mm"
    return None


def _lies_on(spall: Spall) -> str:
    return "roller" if spall.surface == "roller" else f"{spall.surface} raceway"


def _once_round(bearing: TaperedBearing, spall: Spall) -> float | None:
    """`geometry.once_round`; None if the bearing's numbers are traced."""
    numbers, made_of = jax.tree.flatten(bearing)
    known = as_numbers(*numbers)
    return None if known is None else float(geometry.once_round(made_of.unflatten(known), spall.surface))


def of_one_shape(spalls: tuple[Spall, ...]) -> bool:
    """Whether all spalls are known to have one width, depth and axial offset; traced numbers are not known."""
    shapes = [(spall.width, spall.depth, spall.axial_offset) for spall in spalls]
    if len(shapes) < 2 or any(isinstance(value, jax.core.Tracer) for shape in shapes for value in shape):
        return len(shapes) < 2
    return len({tuple(float(value) for value in shape) for shape in shapes}) == 1


def _of_effects(scene: Scene) -> str | None:
    """What keeps the scene's spalls and effects from being had together."""
    name = scene.law.name if isinstance(scene.law, LawName) else None
    for i, spall in enumerate(scene.spalls):
        if spall.surface == "roller" and isinstance(scene.phase, PitchMean):
            return (
                f"spall.{i}.surface = 'roller' belongs to one roller, so phase = 'mean' has no meaning for it; give a "
                "phase in rad"
            )
        if spall.row == 2 and effect_base.among(scene.effects, effects.DoubleRow) is None:
            return f"spall.{i}.row = 2: needs the effect double_row; add [effects.double_row], or leave row out"
    asked = effects.Asked(scene.bearing, scene.load, name or cast(Law, scene.law), scene.effects)
    for effect in scene.effects:
        try:
            effect.check(asked)
        except SceneError as error:
            return str(error)
    return None


# ------------------------------------------------------------------------------------------------ the ring's load


def not_held(scene: Scene, key: str = "") -> str | None:
    """Why no phase of the scene's has an equilibrium under its load, in one sentence; None if nothing is known against
    it. `key` stands before the loads' names."""
    if effect_base.among(scene.effects, effects.Mounting) is not None:
        return None
    bearing, load = scene.bearing, scene.load
    tilt = effect_base.among(scene.effects, effects.Tilt)
    row = effect_base.among(scene.effects, effects.DoubleRow)
    moments = [m for one in (tilt, row) if one is not None for m in (one.moment_radial, one.moment_lateral)]
    held = row is not None and (any(moments) or row.preload > 0.0)
    if load.axial == load.radial == 0.0 and not held:
        return f"{key}axial = 0 N and {key}radial = 0 N: there is nothing to hold; give a load"
    if row is not None:  # one of both rows is pressed by any load
        return None
    tilting = None
    if tilt is not None and tilt.rings == "free":
        tilting = tilt.of_one_row(bearing, tilt.places(LineContact.of(bearing)), tilt.reach)
    if isinstance(scene.phase, PitchMean):  # without moments the worst has the load line between two rollers
        shares = np.array([0.5]) if tilting is None else np.arange(HELD_PHASES) / HELD_PHASES
        phases = shares * geometry.roller_pitch(bearing)
    else:
        phases = np.array([float(cast(float, scene.phase))])
    needed = max(float(needed_axial(bearing, load.radial, phase, tilting)) for phase in phases)
    beside = " and the moments of effects.tilt" if any(moments) else ""
    sentence = too_light(float(load.axial), float(load.radial), needed, key, beside)
    if sentence is None:
        return None
    return f"{sentence} (about radial × tan(outer_angle){' without them' if beside else ''})"


# ------------------------------------------------------------------------------------------------ inside jit


def code(scene: Scene) -> Any:
    """Status inside jit: whether every number of the scene is within its range, and the bearing's fit together."""
    owners = [scene, *(owner for _, owner, _ in _owners(scene))]
    within = fields.all_within(number for owner in owners for number in fields.traced(owner))
    bearing = xp.fixed(scene.bearing)
    within = within & fit_together(bearing)
    for spall in scene.spalls:
        around = geometry.once_round(bearing, spall.surface)
        within = within & (xp.fixed(spall.width) <= WIDEST * around * (1.0 + 1e-12))
        within = within & (
            xp.abs(xp.fixed(spall.axial_offset)) < 0.5 * (bearing.roller_length + xp.fixed(spall.length))
        )
    return xp.module_of(within).where(within, status.CONVERGED, status.BAD_INPUT)
