"""What a wider spall does to stiffness: at one cage phase under a hard window (a staircase), at one phase with the
edge's ramp, and in the mean over phases; and the mean's derivative by width against brute force.

python experiments/width_and_phase.py [FOLDER]   (figure width_and_phase.png and .svg; default: out)
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.core import geometry

WIDTH = 5.0
STEP = 0.1


def sized(scene: trb.Scene, width: jax.Array | float) -> trb.Scene:
    """The scene with its spall of this width [mm]."""
    return dataclasses.replace(scene, spalls=(dataclasses.replace(scene.spalls[0], width=width),))


def radial(scene: trb.Scene) -> jax.Array:
    """Radial stiffness [N/mm]."""
    return trb.solve(scene).stiffness[0, 0]


def brute_force(scene: trb.Scene, phases: int) -> tuple[float, float]:
    """Mean radial stiffness over equal steps of one pitch, and its derivative by width from central differences.

    Not from the slopes at the steps: where the roller leaves the land stiffness all but jumps, and no step sees that.
    """
    steps = (jnp.arange(phases) + 0.5) / phases * geometry.roller_pitch(scene.bearing)

    def mean(width: jax.Array) -> jax.Array:
        at = sized(scene, width)
        return jnp.mean(jax.lax.map(lambda p: radial(dataclasses.replace(at, phase=p)), steps, batch_size=100))

    mean = jax.jit(mean)
    below, value, above = (float(mean(jnp.asarray(WIDTH + step))) for step in (-STEP, 0.0, STEP))
    return value, (above - below) / (2.0 * STEP)


def curves(scene: trb.Scene, widths: np.ndarray) -> dict[str, np.ndarray]:
    """Radial stiffness over width; `scene` is one prepared with the law "table"."""
    hard = dataclasses.replace(scene, law=trb.liu2018())
    kinds = {
        "one phase, hard window (Liu et al. 2018)": hard,
        "one phase, ramp": scene,
        "mean over phases, hard window": dataclasses.replace(hard, phase="mean"),
        "mean over phases, ramp": dataclasses.replace(scene, phase="mean"),
    }
    lines = {}
    for name, one in kinds.items():
        own = jax.jit(lambda width, one=one: jax.lax.map(lambda w: radial(sized(one, w)), width))
        lines[name] = np.asarray(own(jnp.asarray(widths)))
    return lines


def draw(lines: dict[str, np.ndarray], widths: np.ndarray, folder: Path) -> None:
    """All lines in one figure."""
    import matplotlib.pyplot as plt

    from difftrb.report import figure_style

    _, ax = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    for (name, line), colour in zip(lines.items(), ("#CCBB44", "#EE6677", "#BBBBBB", "#4477AA"), strict=True):
        ax.plot(widths, line / 1e6, color=colour, label=name, linestyle="--" if "hard" in name else "-")
    ax.set_xlabel("width of the spall [mm]")
    ax.set_ylabel("radial tangent stiffness [kN/µm]")
    ax.legend(frameon=False)
    folder.mkdir(parents=True, exist_ok=True)
    figure_style.save(ax, folder, "width_and_phase")


def main() -> None:
    """Draw the figure and compare the mean with 20 000 phases."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
    spall = trb.Spall(4.0, WIDTH)
    scene = trb.prepare(trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (spall,), "table", phase=0.09))
    mean = dataclasses.replace(scene, phase="mean")
    value, slope = jax.jit(jax.value_and_grad(lambda w: radial(sized(mean, w))))(jnp.asarray(WIDTH))
    print(f"mean by 60 phases: {value:.1f} N/mm, by width {slope:.2f} N/mm per mm")
    truth, truth_slope = brute_force(scene, 20_000)
    print(f"mean by 20 000 phases: {truth:.1f} N/mm, by width {truth_slope:.2f} N/mm per mm")
    print(f"differences: {value / truth - 1.0:+.1e}, {slope / truth_slope - 1.0:+.1e}")
    widths = np.linspace(1.0, 18.0, 341)
    draw(curves(scene, widths), widths, folder)


if __name__ == "__main__":
    main()
