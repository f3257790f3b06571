"""The one law of all members of a sweep."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from operator import itemgetter

import jax.numpy as jnp

from difftrb.core import status
from difftrb.core.status import SweepError
from difftrb.law.base import LAWS, LawKind
from difftrb.law.samples import Progress
from difftrb.law.table import TableLaw
from difftrb.scene import largest_roller_load
from difftrb.scene.auto_law import by_table
from difftrb.scene.checks import of_one_shape
from difftrb.scene.scene import LawName, PitchMean, Scene, is_auto, outer_law, raceway_laws
from difftrb.scene.scene_laws import with_any_width
from difftrb.scene.solving import prepare
from difftrb.sweeps.axes import Axis, number_at, replaced


def with_shared_law(
    scene: Scene, axes: Sequence[Axis], gradients: Sequence[str] = (), progress: Progress | None = None
) -> Scene:
    """The scene with one law for all members, made once for the largest and smallest loads and the longest spalls.

    A prepared law is kept. "auto" is "table", whose status says of every member whether it knows it.

    Raises `SweepError` for a key on which a law by name does not depend, or that would need a law for every member.
    """
    ends = {key: (float(v.min()), float(v.max()))
            for axis in axes for key, v in zip(axis.keys, axis.values, strict=True)}  # fmt: skip
    if isinstance(scene.phase, PitchMean) and "stiffness.phase" in gradients and "stiffness.phase" not in ends:
        raise SweepError(
            "gradients: stiffness.phase = 'mean' has no derivative by the phase; give one phase, or leave it out"
        )
    if not isinstance(scene.law, LawName):
        return prepare(scene)
    if is_auto(scene):
        narrowest = by_table(_with_ends(scene, ends, 0))
        made = _of_any_width(narrowest, narrowest, ends)
        return dataclasses.replace(made, load=scene.load, spalls=scene.spalls)
    law = LAWS.get(scene.law.name)
    if law is not None:  # else `prepare` refuses it
        for key in (*ends, *gradients):
            _refuse_frozen(law, key, "gradients: " if key not in ends else "")
        if law.one_scene and scene.spalls:
            raise SweepError(
                f"contact.law = {law.name!r} holds for one scene and would be made anew for every member; use 'table'"
            )
        if law.one_shape and not of_one_shape(scene.spalls):
            raise SweepError(f"contact.{law.one_shape}")
    low, high = (_with_ends(scene, ends, side) for side in (0, 1))
    made = prepare(high, progress, largest_roller_load.largest_load(low))
    ready = prepare(dataclasses.replace(scene, law=made.law, effects=made.effects))
    for key in ends:
        _refuse_other(ready, key, ends[key])
    return _of_any_width(ready, dataclasses.replace(ready, spalls=low.spalls), ends)


def _of_any_width(ready: Scene, narrowest: Scene, ends: dict[str, tuple[float, float]]) -> Scene:
    """With a table that knows narrow spalls, too, where the `narrowest` may be narrow for the contact of a member: the
    bearing or its crown change on the axes."""
    keys = [key for key in ends if key.startswith(("bearing.", "contact."))]
    for values in itertools.product(*(ends[key] for key in keys)):
        corner = narrowest
        for key, value in zip(keys, values, strict=True):
            corner = replaced(corner, key, value)
        tables = [law for law in raceway_laws(corner) if isinstance(law, TableLaw) and not law.narrow]
        if not all(bool(law.is_wide(spall)) for law in tables for spall in corner.spalls):
            return with_any_width(ready) or ready
    return ready


def _refuse_frozen(law: LawKind, key: str, where: str) -> None:
    """Refuse a key through which a law does not act once it is made."""
    owner, field = key.split(".")[0], key.split(".")[-1]
    if law.frozen is None:
        return
    if owner == "spall" and field in law.frozen:
        made = "is fitted for one" if law.one_shape else "does not know the"
        why = f"{made} {field.replace('_', ' ')} of a spall"
    elif key == "contact.design_load" or (owner == "bearing" and field not in ("arc_radius", "outer_angle")):
        why = "would have to be made anew for every member"
    elif law.bearing is not None and key == "bearing.outer_angle":
        why = f"holds for the bearing {law.bearing} only"
    else:
        return
    raise SweepError(f"{where}{key}: contact.law = {law.name!r} {why}; use 'table'")


def _with_ends(scene: Scene, ends: dict[str, tuple[float, float]], side: int) -> Scene:
    """The scene with the smallest (0) or largest (1) loads and lengths on the axes, the smallest widths, and spalls as
    far off the middle as they come."""
    load = {name: ends[f"load.{name}"][side] for name in ("radial", "axial") if f"load.{name}" in ends}
    taken = {"length": itemgetter(side), "width": min, "axial_offset": lambda values: max(values, key=abs)}
    spalls = tuple(
        dataclasses.replace(
            spall, **{name: of(ends[key]) for name, of in taken.items() if (key := f"spall.{i}.{name}") in ends}
        )
        for i, spall in enumerate(scene.spalls)
    )
    return dataclasses.replace(scene, load=dataclasses.replace(scene.load, **load), spalls=spalls)


def _refuse_other(ready: Scene, key: str, ends: tuple[float, float]) -> None:
    """Refuse an axis at whose ends the law says that it was made for another scene."""
    if key.startswith("load.") or key.endswith((".length", ".width", ".angle", ".phase")):
        return
    for value in ends:
        scene = replaced(ready, key, value)
        law, away = outer_law(scene), jnp.zeros((len(scene.spalls), int(scene.bearing.rollers)))
        if int(law.judge(scene.spalls, away)) == status.OTHER_SCENE:
            raise SweepError(
                f"{key} = {value:g}: too far from the scene's {float(number_at(ready, key)):g}, for which contact.law "
                f"= {law.name!r} was made once for the whole sweep; stay near it, or run one sweep for each"
            )
