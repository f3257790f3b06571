"""Derivatives through the whole road against central differences of scenes that are prepared afresh by "direct".

python experiments/sensitivities_of_ring.py [ACCURACY]   (default contacts to 1e-4; a minute or two)
"""

from __future__ import annotations

import dataclasses
import sys
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb


class Input(NamedTuple):
    """What a scene is differentiated by: its value, and the step of a difference large enough to tell from the error of
    contact solves."""

    value: float
    step: float


INPUTS = {
    "length": Input(4.0, 0.05),
    "width": Input(7.0, 0.04),
    "depth": Input(0.003, 1e-4),  # so shallow that the roller in the middle is carried by its bottom
    "angle": Input(0.0, 1.4e-3),
    "axial_offset": Input(0.5, 0.05),
    "radial": Input(9000.0, 100.0),
    "design_load": Input(6500.0, 200.0),
    "preload": Input(0.012, 1e-4),
}
OUTPUTS = ("radial stiffness", "axial stiffness", "peak load", "load of the roller at the edge")


def scene(name: str, value: float, law: str, accuracy: float) -> trb.Scene:
    """One roller in the middle of a spall, or one on the ramp of an edge for what moves that."""
    at_edge = name in ("width", "angle")
    phase = 0.1215 if at_edge else 0.0
    spall = trb.Spall(4.0, 7.0)
    load, acting, design_load = trb.Load(9000.0, 4500.0), (), 6500.0
    if hasattr(spall, name):
        spall = dataclasses.replace(spall, **{name: value})
    elif name == "radial":
        load = trb.Load(value, 4500.0)
    elif name == "design_load":
        design_load = value
    else:
        load, acting = trb.Load(9000.0, 0.0), (trb.effects.Mounting(value),)
    return trb.prepare(
        trb.Scene(trb.bearing("32008J"), load, (spall,), law, design_load, accuracy, phase=phase, effects=acting)
    )


def leaf(of: trb.Scene, name: str) -> float:
    """The derivative by `name` in a scene of derivatives."""
    owners = {"radial": of.load, "design_load": of}
    owner = of.effects[0] if name == "preload" else owners.get(name, of.spalls[0])
    return float(getattr(owner, name))


@jax.jit
def outputs(of: trb.Scene) -> jax.Array:
    """`OUTPUTS`, shape (4,)."""
    r = trb.solve(of)
    return jnp.stack([r.radial_stiffness, r.axial_stiffness, jnp.max(r.loads), r.loads[0]])


@jax.jit
def slopes(of: trb.Scene) -> trb.Scene:
    """Their derivatives: a scene of arrays of shape (4,)."""
    return jax.jacrev(outputs)(of)


def compare(name: str, law: str, accuracy: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives by autodiff and by differences, each of shape (4,)."""
    value, step = INPUTS[name]
    by_ad = slopes(scene(name, value, law, accuracy))
    ours = np.array([leaf(jax.tree.map(lambda v, k=k: v[k], by_ad), name) for k in range(len(OUTPUTS))])
    ends = [np.asarray(outputs(scene(name, value + side * step, law, accuracy))) for side in (1.0, -1.0)]
    return ours, (ends[0] - ends[1]) / (2.0 * step)


def main() -> None:
    """Compare by all inputs and print the table."""
    accuracy = float(sys.argv[1]) if len(sys.argv) > 1 else 1e-4
    table = Table(title=f"d(output)/d(input): autodiff / central difference, contacts to {accuracy:g}")
    for heading in ("by", *OUTPUTS):
        table.add_column(heading, justify="left" if heading == "by" else "right")
    for name in track(INPUTS, "inputs", transient=True, console=Console(stderr=True)):
        ours, theirs = compare(name, "direct", accuracy)
        table.add_row(name, *(f"{a:+.5g} / {b:+.5g}" for a, b in zip(ours, theirs, strict=True)))
    Console(width=150).print(table)


if __name__ == "__main__":
    main()
