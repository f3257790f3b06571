"""How far apart the roller laws are: each one's loads, stiffness and sensitivities against the law "direct".

python experiments/laws_of_ring.py [--narrow] [SCENES] [ACCURACY]   (default 50 random scenes of 32008J at 1e-3)

With --narrow spalls are so narrow that both edges are in a roller's reach, and only the table is compared.
"""

from __future__ import annotations

import dataclasses
import sys

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.core import geometry

LAWS = ("table", "power", "liu2018")


def random_scenes(count: int, accuracy: float, narrow: bool = False) -> list[trb.Scene]:
    """Loads, spall sizes and phases at random; in every other scene a roller stands on the ramp of an edge, over narrow
    spalls always."""
    rng = np.random.default_rng(4)
    bearing = trb.bearing("32008J")
    arc = float(geometry.arc_radius(bearing))
    scenes = []
    for k in range(count):
        radial = rng.uniform(7000.0, 12000.0)
        length, width = rng.uniform(1.0, 8.0), rng.uniform(2.0, 12.0)
        phase = rng.uniform(0.0, 0.27)
        if narrow:
            width = rng.uniform(0.05, 0.5)
            phase = rng.uniform(-0.5 * width - 0.05, 0.5 * width + 0.05) / arc
        elif k % 2:
            phase = (0.5 * width + rng.uniform(-0.1, 0.05)) / arc
        load = trb.Load(radial, radial * rng.uniform(0.35, 0.7))
        scene = trb.Scene(bearing, load, (trb.Spall(length, width),), "direct", accuracy=accuracy, phase=phase)
        scenes.append(scene)
    return scenes


@jax.jit
def answers(scene: trb.Scene) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Loads, radial and axial stiffness, their derivatives by length and width, status."""

    def stiffness(sizes: jax.Array) -> tuple[jax.Array, trb.Solution]:
        spall = dataclasses.replace(scene.spalls[0], length=sizes[0], width=sizes[1])
        s = trb.solve(dataclasses.replace(scene, spalls=(spall,)))
        return jnp.stack([s.radial_stiffness, s.axial_stiffness]), s

    sizes = jnp.stack([jnp.asarray(scene.spalls[0].length, float), jnp.asarray(scene.spalls[0].width, float)])
    slopes, s = jax.jacfwd(stiffness, has_aux=True)(sizes)
    return s.loads, jnp.stack([s.radial_stiffness, s.axial_stiffness]), slopes, s.status_code


def compare(scenes: list[trb.Scene], names: tuple[str, ...] = LAWS) -> dict[str, np.ndarray]:
    """For every law and scene: largest error of a load by the largest load, of the stiffness by itself, and of its
    derivatives by length and by width, each by the largest over all scenes; shape (scenes, 4)."""
    exact = [answers(trb.prepare(scene)) for scene in scenes]
    scale = np.max([np.abs(slopes).max(axis=0) for _, _, slopes, _ in exact], axis=0)  # of length, of width
    scale = np.maximum(scale, 1e-300)  # under a hard window width has no slope
    errors: dict[str, np.ndarray] = {}
    for name in names:
        rows = []
        for scene, (loads, stiffness, slopes, code) in zip(scenes, exact, strict=True):
            ours = answers(trb.prepare(dataclasses.replace(scene, law=name)))
            if int(code) or int(ours[3]):
                rows.append([np.nan] * 4)
                continue
            by_size = np.abs(ours[2] - slopes).max(axis=0) / scale
            rows.append([
                float(np.abs(ours[0] - loads).max() / loads.max()), float(np.abs(ours[1] / stiffness - 1.0).max()),
                *map(float, by_size),
            ])  # fmt: skip
        errors[name] = np.array(rows)
    return errors


def main() -> None:
    """Compare on random scenes and print the table."""
    narrow = "--narrow" in sys.argv
    if narrow:
        sys.argv.remove("--narrow")
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    accuracy = float(sys.argv[2]) if len(sys.argv) > 2 else 1e-3
    print(f"{count} random scenes, contacts to {accuracy:g}; median and largest difference from 'direct'")
    print(f"{'law':8s} {'not solved':>10s} {'loads':>20s} {'stiffness':>20s} {'d/d length':>20s} {'d/d width':>20s}")
    for name, rows in compare(random_scenes(count, accuracy, narrow), LAWS[:1] if narrow else LAWS).items():
        cells = [f"{np.nanmedian(column):.1e} … {np.nanmax(column):.1e}" for column in rows.T]
        print(f"{name:8s} {int(np.isnan(rows[:, 0]).sum()):10d} " + " ".join(f"{cell:>20s}" for cell in cells))


if __name__ == "__main__":
    main()
