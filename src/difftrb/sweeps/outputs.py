"""What a sweep can ask by name of a scene or of a single contact, and the one roller law that all its scenes share."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact.contact_solution import ContactSolution
from difftrb.core import status
from difftrb.core.files import shown
from difftrb.core.status import SweepError
from difftrb.law.samples import Progress
from difftrb.ring import ring
from difftrb.scene import auto_law
from difftrb.scene.checks import SEVERAL_SHAPES, of_one_shape
from difftrb.scene.scene import LawName, PitchMean, Scene, healthy, is_auto, named
from difftrb.scene.solving import Solution, outer_law, prepare, solve
from difftrb.sweeps.axes import Axis, number_at, replaced

STATUS = "status_code"
"""Name under which a function of a member may give its status (`difftrb.status`), an integer of shape ()."""


class Output(NamedTuple):
    """One result by name.

    Attributes:
      of: from a solution and, of the ring, its healthy counterpart. unit: of it. dims: names of its own dimensions.
      beside: whether it needs the healthy counterpart.
    """

    of: Callable[..., jax.Array]
    unit: str
    dims: tuple[str, ...] = ()
    beside: bool = False


def _loss(name: str) -> Output:
    def of(spalled: Solution, sound: Solution) -> jax.Array:
        return 100.0 * (1.0 - getattr(spalled, name) / getattr(sound, name))

    return Output(of, "%", beside=True)


RING: dict[str, Output] = {
    "radial_stiffness": Output(lambda s, _: s.radial_stiffness, "N/mm"),
    "axial_stiffness": Output(lambda s, _: s.axial_stiffness, "N/mm"),
    "radial_loss": _loss("radial_stiffness"),
    "axial_loss": _loss("axial_stiffness"),
    "peak_load": Output(lambda s, _: jnp.max(s.loads), "N"),
    "radial_displacement": Output(lambda s, _: s.displacement[0], "mm"),
    "lateral_displacement": Output(lambda s, _: s.displacement[1], "mm"),
    "axial_displacement": Output(lambda s, _: s.displacement[2], "mm"),
    "loads": Output(lambda s, _: s.loads, "N", ("roller",)),
    "stiffness": Output(lambda s, _: s.stiffness, "N/mm", ("force", "displacement")),
}
"""Of a scene: see `Solution`; losses are of stiffness against the bearing without spalls."""

CONTACT: dict[str, Output] = {
    "approach": Output(lambda s: s.approach, "mm"),
    "peak_pressure": Output(lambda s: s.peak_pressure, "N/mm²"),
    "contact_width": Output(lambda s: s.contact_width, "mm"),
    "loaded_fraction": Output(lambda s: s.loaded_fraction, ""),
}
"""Of one roller on its raceway: see `ContactSolution`."""

DEFAULT = ("radial_stiffness", "axial_stiffness")


def of_scene(names: Sequence[str]) -> Callable[[Scene], dict[str, jax.Array]]:
    """The function that solves a scene for the results `names` of `RING`. Raises `SweepError`."""
    chosen = {name: RING[name] for name in known(names, RING)}

    def function(scene: Scene) -> dict[str, jax.Array]:
        spalled = solve(scene)
        code, sound = spalled.status_code, None
        if any(output.beside for output in chosen.values()):
            sound = solve(healthy(scene))
            code = status.worst(code, sound.status_code)
        return {STATUS: code} | {name: output.of(spalled, sound) for name, output in chosen.items()}

    return function


def of_contact(names: Sequence[str], solved: Callable[[Any], ContactSolution]) -> Callable[[Any], dict[str, jax.Array]]:
    """The function that gives the results `names` of `CONTACT` of what `solved` returns. Raises `SweepError`."""
    chosen = {name: CONTACT[name] for name in known(names, CONTACT)}

    def function(tree: Any) -> dict[str, jax.Array]:
        solution = solved(tree)
        return {STATUS: solution.status_code} | {name: output.of(solution) for name, output in chosen.items()}

    return function


def known(names: Sequence[str], outputs: dict[str, Output]) -> Sequence[str]:
    """`names`; refuses those that `outputs` does not have, one that is there twice, and none at all."""
    if not names:
        raise SweepError(f"outputs is empty; name some of {', '.join(outputs)}")
    for name in names:
        if name not in outputs:
            raise SweepError(f"outputs: {shown(name)} is unknown; use some of {', '.join(outputs)}")
    if len(set(names)) < len(names):
        raise SweepError("outputs: a name is there twice; name each once")
    return names


# ------------------------------------------------------------------------------------------------ the law of all

FITTED_FOR = {"power": ("width", "depth", "axial_offset"), "liu2018": ("depth", "axial_offset"),
              "palmgren": ("depth", "axial_offset")}  # fmt: skip
"""Of a spall, what a law by this name is made for one value of, or does not know at all."""
JUDGED_AT = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
"""How far along every axis the members are that the law "auto" is judged by."""


def prepared(
    scene: Scene, axes: Sequence[Axis], gradients: Sequence[str] = (), progress: Progress | None = None
) -> Scene:
    """The scene with one law for all members: made once, for the largest and smallest loads and longest spalls on the
    axes. A law that the scene brings prepared is kept; "auto" is judged by four members, from end to end of all axes,
    and by "direct" there: with derivatives by where edges stand at one phase it becomes a table, whose ramps have them.

    Raises `SweepError` for a key through which a law by name does not act, or would have to be made for every member.
    """
    ends = {
        key: (float(v.min()), float(v.max())) for axis in axes for key, v in zip(axis.keys, axis.values, strict=True)
    }
    if isinstance(scene.phase, PitchMean) and "stiffness.phase" in gradients and "stiffness.phase" not in ends:
        raise SweepError(
            "gradients: stiffness.phase = 'mean' has no derivative by the phase; give one phase, or leave it out"
        )
    if not isinstance(scene.law, LawName):
        return prepare(scene)
    if is_auto(scene):
        edges = any(key.endswith((".width", ".angle", ".phase")) for key in gradients)
        return auto_law.shared(
            _members(scene, axes),
            lambda law, accuracy: prepared(named(scene, law, accuracy), axes, gradients, progress),
            auto_law.SOFT if edges and not isinstance(scene.phase, PitchMean) else auto_law.SHARED,
        )
    name = scene.law.name
    for key in (*ends, *gradients):
        _refuse_frozen(name, key, "gradients: " if key not in ends else "")
    if name == "direct" and scene.spalls:
        raise SweepError(
            "contact.law = 'direct' holds for one scene and would be made anew for every member; use 'table'"
        )
    if name == "power" and not of_one_shape(scene.spalls):
        raise SweepError(f"contact.{SEVERAL_SHAPES}")
    low, high = (_with_ends(scene, ends, side) for side in (0, 1))
    made = prepare(high, progress, ring.largest_load(low.bearing, low.load))
    ready = prepare(dataclasses.replace(scene, law=made.law, effects=made.effects))
    for key in ends:
        _refuse_other(ready, key, ends[key])
    return ready


def _members(scene: Scene, axes: Sequence[Axis]) -> list[Scene]:
    """Some of a sweep's scenes, from end to end of all axes, by which a law can be judged."""
    found = []
    for share in JUDGED_AT:
        member = scene
        for axis in axes:
            for key, values in zip(axis.keys, axis.values, strict=True):
                member = replaced(member, key, float(values[round(share * (axis.count - 1))]))
        found.append(member)
    return found


def _refuse_frozen(name: str, key: str, where: str) -> None:
    owner, _, field = key.partition(".")
    if owner == "spall":
        field = key.split(".")[-1]
    if name in FITTED_FOR and owner == "spall" and field in FITTED_FOR[name]:
        made = "is fitted for one" if name == "power" else "does not know the"
        raise SweepError(
            f"{where}{key}: contact.law = {name!r} {made} {field.replace('_', ' ')} of a spall; use 'table'"
        )
    crown = key == "contact.design_load"
    if name in FITTED_FOR and (crown or (owner == "bearing" and field not in ("arc_radius", "outer_angle"))):
        raise SweepError(
            f"{where}{key}: contact.law = {name!r} would have to be made anew for every member; use 'table'"
        )
    if name == "liu2018" and key == "bearing.outer_angle":
        raise SweepError(f"{where}{key}: contact.law = 'liu2018' holds for the bearing 32008J only; use 'table'")


def _with_ends(scene: Scene, ends: dict[str, tuple[float, float]], side: int) -> Scene:
    """The scene with the smallest (0) or largest (1) loads and lengths on the axes."""
    load = {name: ends[f"load.{name}"][side] for name in ("radial", "axial") if f"load.{name}" in ends}
    spalls = tuple(
        dataclasses.replace(spall, length=ends[f"spall.{i}.length"][side]) if f"spall.{i}.length" in ends else spall
        for i, spall in enumerate(scene.spalls)
    )
    return dataclasses.replace(scene, load=dataclasses.replace(scene.load, **load), spalls=spalls)


def _refuse_other(ready: Scene, key: str, ends: tuple[float, float]) -> None:
    """Refuse an axis on whose ends the law that was made says that it is another scene's."""
    if key.startswith("load.") or key.endswith((".length", ".width", ".angle", ".phase")):
        return
    for value in ends:
        scene = replaced(ready, key, value)
        law = outer_law(scene)
        away = jnp.zeros((len(scene.spalls), int(scene.bearing.rollers)))
        if int(law.judge(scene.spalls, away)) == status.OTHER_SCENE:
            at = float(np.asarray(number_at(ready, key)))
            made = f"for which contact.law = {law.name!r} was made once for the whole sweep"
            raise SweepError(
                f"{key} = {value:g}: too far from the scene's {at:g}, {made}; stay near it, or run one sweep for each"
            )
