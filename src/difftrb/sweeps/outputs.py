"""Outputs: what a sweep can be asked for by name. And the one roller law that all scenes of a sweep share.

An output declares its name, unit, label, dimensions and function in one place. Sweep files, stores, figures and
errors take them from there. A module that calls `register` adds an output; nothing else has to change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact.contact_solution import ContactSolution
from difftrb.core import status
from difftrb.core.bad_input import shown
from difftrb.core.status import SweepError
from difftrb.law.base import LAWS, LawKind
from difftrb.law.samples import Progress
from difftrb.scene import expected_loads
from difftrb.scene.auto_law import by_table
from difftrb.scene.checks import of_one_shape
from difftrb.scene.scene import LawName, PitchMean, Scene, healthy, is_auto, outer_law
from difftrb.scene.solution import Solution
from difftrb.scene.solving import prepare, solve
from difftrb.sweeps.axes import Axis, number_at, replaced

STATUS = "status_code"
"""Name under which a function of a member may give its status (`difftrb.status`), an integer of shape ()."""
DEFAULT = ("radial_stiffness", "axial_stiffness")


@dataclasses.dataclass(frozen=True)
class Output:
    """One result by name.

    Attributes:
      name: in sweep files, `difftrb.sweep` and files of results. unit: "" without one. label: in figures, without unit.
      of: gives the array from a `Solution`, or from a `ContactSolution` if `source` is "contact".
      dims: names of the array's own dimensions; default none: a number.
      source: what is solved. Default "ring".
      against_healthy: whether `of` also takes the solution without spalls, behind the other. Default False.
    """

    name: str
    unit: str
    label: str
    of: Callable[..., jax.Array]
    dims: tuple[str, ...] = ()
    source: Literal["ring", "contact"] = "ring"
    against_healthy: bool = False


RING: dict[str, Output] = {}
"""Outputs of a scene, by name."""
CONTACT: dict[str, Output] = {}
"""Outputs of one roller on its raceway, by name."""


def register(output: Output) -> Output:
    """Let sweeps ask for an output by its name; returns it. Raises `SweepError` for a name that is taken."""
    if output.name in registered() or not output.name.isidentifier():
        raise SweepError(f"{shown(output.name)}: is the name of an output already, or cannot be one; name it otherwise")
    {"ring": RING, "contact": CONTACT}[output.source][output.name] = output
    return output


def registered() -> dict[str, Output]:
    """All outputs by name."""
    return RING | CONTACT


def label_of(name: str) -> str:
    """Label of a result in figures; without a declaration, its name in words."""
    output = registered().get(name)
    return name.replace("_", " ") if output is None else output.label


def _loss(name: str) -> Callable[[Solution, Solution], jax.Array]:
    """Loss of a stiffness against the bearing without spalls [%]."""
    return lambda spalled, reference: 100.0 * (1.0 - getattr(spalled, name) / getattr(reference, name))


for _output in (
    Output("radial_stiffness", "N/mm", "radial stiffness", lambda s: s.radial_stiffness),
    Output("axial_stiffness", "N/mm", "axial stiffness", lambda s: s.axial_stiffness),
    Output("radial_loss", "%", "radial loss", _loss("radial_stiffness"), against_healthy=True),
    Output("axial_loss", "%", "axial loss", _loss("axial_stiffness"), against_healthy=True),
    Output("peak_load", "N", "peak load", lambda s: jnp.max(s.loads)),
    Output("radial_displacement", "mm", "radial displacement", lambda s: s.displacement[0]),
    Output("lateral_displacement", "mm", "lateral displacement", lambda s: s.displacement[1]),
    Output("axial_displacement", "mm", "axial displacement", lambda s: s.displacement[2]),
    Output("loads", "N", "loads", lambda s: s.loads, ("roller",)),
    Output("stiffness", "N/mm", "stiffness", lambda s: s.stiffness, ("force", "displacement")),
    Output("approach", "mm", "approach", lambda s: s.approach, source="contact"),
    Output("peak_pressure", "N/mm²", "peak pressure", lambda s: s.peak_pressure, source="contact"),
    Output("contact_width", "mm", "contact width", lambda s: s.contact_width, source="contact"),
    Output("loaded_fraction", "", "loaded fraction", lambda s: s.loaded_fraction, source="contact"),
):
    register(_output)


def function_of(
    names: Sequence[str], solved: Callable[[Any], ContactSolution] | None = None
) -> Callable[[Any], dict[str, jax.Array]]:
    """The function from a member to its status and the outputs `names`. Raises `SweepError` for unknown names.

    Members are scenes, and names those of `RING`; with `solved`, which gives a member's contact, those of `CONTACT`.
    """
    registry = CONTACT if solved else RING
    chosen = [registry[name] for name in checked(names, registry)]
    compared = any(output.against_healthy for output in chosen)

    def function(member: Any) -> dict[str, jax.Array]:
        solution = (solved or solve)(member)
        code, reference = solution.status_code, ()
        if compared:
            reference = (solve(healthy(member)),)
            code = status.worst(code, reference[0].status_code)
        return {STATUS: code} | {
            output.name: _value(output, solution, *reference[: output.against_healthy]) for output in chosen
        }

    return function


def _value(output: Output, *solutions: Any) -> jax.Array:
    """The array of one output; refuses one that has not the dimensions that it declares."""
    value = jnp.asarray(output.of(*solutions))
    if value.ndim != len(output.dims):
        names = ", ".join(output.dims) or "none"
        raise SweepError(f"outputs: {output.name} has shape {value.shape}, but declares as its dimensions: {names}")
    return value


def checked(names: Sequence[str], outputs: Mapping[str, Output]) -> Sequence[str]:
    """`names`; refuses those that `outputs` does not have, one that is there twice, and none at all."""
    if not names:
        raise SweepError(f"outputs is empty; name some of {', '.join(outputs)}")
    for name in names:
        if name not in outputs:
            raise SweepError(f"outputs: {shown(name)} is unknown; use some of {', '.join(outputs)}")
    if len(set(names)) < len(names):
        raise SweepError("outputs: a name is there twice; name each once")
    return names


# ------------------------------------------------------------------------------------------------ the shared law


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
        made = by_table(_with_ends(scene, ends, 0))
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
    made = prepare(high, progress, expected_loads.largest_load(low))
    ready = prepare(dataclasses.replace(scene, law=made.law, effects=made.effects))
    for key in ends:
        _refuse_other(ready, key, ends[key])
    return ready


def _refuse_frozen(law: LawKind, key: str, where: str) -> None:
    """Refuse a key through which a law does not act once it is made."""
    if law.frozen is None:
        return
    owner, _, field = key.partition(".")
    if owner == "spall":
        field = key.split(".")[-1]
    if owner == "spall" and field in law.frozen:
        made = "is fitted for one" if law.one_shape else "does not know the"
        raise SweepError(
            f"{where}{key}: contact.law = {law.name!r} {made} {field.replace('_', ' ')} of a spall; use 'table'"
        )
    crown = key == "contact.design_load"
    if crown or (owner == "bearing" and field not in ("arc_radius", "outer_angle")):
        raise SweepError(
            f"{where}{key}: contact.law = {law.name!r} would have to be made anew for every member; use 'table'"
        )
    if law.bearing is not None and key == "bearing.outer_angle":
        raise SweepError(
            f"{where}{key}: contact.law = {law.name!r} holds for the bearing {law.bearing} only; use 'table'"
        )


def _with_ends(scene: Scene, ends: dict[str, tuple[float, float]], side: int) -> Scene:
    """The scene with the smallest (0) or largest (1) loads and lengths, and the smallest widths, on the axes."""
    load = {name: ends[f"load.{name}"][side] for name in ("radial", "axial") if f"load.{name}" in ends}
    taken = {"length": side, "width": 0}
    spalls = tuple(
        dataclasses.replace(
            spall, **{name: ends[key][at] for name, at in taken.items() if (key := f"spall.{i}.{name}") in ends}
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
        law = outer_law(scene)
        away = jnp.zeros((len(scene.spalls), int(scene.bearing.rollers)))
        if int(law.judge(scene.spalls, away)) == status.OTHER_SCENE:
            at = float(np.asarray(number_at(ready, key)))
            made = f"for which contact.law = {law.name!r} was made once for the whole sweep"
            raise SweepError(
                f"{key} = {value:g}: too far from the scene's {at:g}, {made}; stay near it, or run one sweep for each"
            )
