"""Outputs: what a sweep can be asked for by name.

An output declares its name, unit, label, dimensions and function in one place. Sweep files, stores, figures and
errors take them from there. A module that calls `register` adds an output; nothing else has to change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp

from difftrb.contact.contact_solution import ContactSolution
from difftrb.core import status
from difftrb.core.input_errors import shown
from difftrb.core.status import SweepError
from difftrb.scene.scene import healthy
from difftrb.scene.solution import Solution, stiffness_loss
from difftrb.scene.solving import solve

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


OUTPUTS: dict[str, Output] = {}
"""By name, of a scene ("ring") and of one roller on its raceway ("contact")."""


def register(output: Output) -> Output:
    """Let sweeps ask for an output by its name; returns it. Raises `SweepError` for a name that is taken."""
    if output.name in OUTPUTS or not output.name.isidentifier():
        raise SweepError(f"{shown(output.name)}: is the name of an output already, or cannot be one; name it otherwise")
    OUTPUTS[output.name] = output
    return output


def label_of(name: str) -> str:
    """Label of a result in figures; without a declaration, its name in words."""
    return OUTPUTS[name].label if name in OUTPUTS else name.replace("_", " ")


def _loss(name: str) -> Callable[[Solution, Solution], jax.Array]:
    """Loss of a stiffness against the bearing without spalls [%]."""
    return lambda spalled, healthy: stiffness_loss(getattr(spalled, name), getattr(healthy, name))


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


def of_contact(names: Sequence[str]) -> bool:
    """Whether all are of a single contact. Raises `SweepError` for unknown names, none, one that is there twice, and
    for names of contacts beside the ring's."""
    if not names:
        raise SweepError(f"outputs is empty; name some of {', '.join(OUTPUTS)}")
    for name in names:
        if name not in OUTPUTS:
            raise SweepError(f"outputs: {shown(name)} is unknown; use some of {', '.join(OUTPUTS)}")
    if len(set(names)) < len(names):
        raise SweepError("outputs: a name is there twice; name each once")
    if len({OUTPUTS[name].source for name in names}) > 1:
        contacts = ", ".join(name for name, output in OUTPUTS.items() if output.source == "contact")
        raise SweepError(f"outputs: {contacts} are of a single contact and do not go with the ring's")
    return OUTPUTS[names[0]].source == "contact"


def function_of(
    names: Sequence[str], solved: Callable[[Any], ContactSolution] | None = None
) -> Callable[[Any], dict[str, jax.Array]]:
    """The function from a member to its status and the outputs `names`; errors as of `of_contact`.

    Members are scenes; or `solved` gives a member's contact.
    """
    if of_contact(names) != (solved is not None):
        raise SweepError(f"outputs: {names[0]} is {'not ' if solved else ''}of a single contact; name others")
    chosen = [OUTPUTS[name] for name in names]

    def function(member: Any) -> dict[str, jax.Array]:
        solution = (solved or solve)(member)
        code, reference = solution.status_code, ()
        if any(output.against_healthy for output in chosen):
            reference = (solve(healthy(member)),)
            code = status.worst(code, reference[0].status_code)
        found = {STATUS: code}
        for output in chosen:
            value = jnp.asarray(output.of(solution, *reference[: output.against_healthy]))
            if value.ndim != len(output.dims):
                declared = ", ".join(output.dims) or "none"
                raise SweepError(
                    f"outputs: {output.name} has shape {value.shape}, but declares as its dimensions: {declared}"
                )
            found[output.name] = value
        return found

    return function
