"""Rings by the atlas against rings by contact solves of their own states: random bearings, random spalls.

    taskset -c 0 python -m experiments.rings_of_atlas --out rings.csv [--bearings 20] [--scenes 200] [--accuracy 1e-5]

Rollers of 3 … 60 mm; spalls short, long, off the middle, narrow, in turn; every other scene has a roller on a rolling
edge. Compared are loads, by the largest; stiffness; and derivatives of the logarithms of radial and axial stiffness by
that of every number, by the largest of these or, where it is smaller, a tenth of the largest by any of the spall's
numbers. One row a scene, written as it comes; rows that are there are not computed again.
"""

from __future__ import annotations

import csv
import dataclasses
import time
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

import difftrb as trb
from difftrb.contact import gap
from difftrb.core import geometry, status
from difftrb.law import atlas_place
from difftrb.scene import scene_laws
from difftrb.scene.prepared_scene import solve_prepared
from difftrb.scene.scene import named
from experiments.audit_of_scenes import add_rows, arguments, bearing, load_at, radial_load

BY = ("length", "width", "offset", "angle", "crown", "radius")
"""Of the first spall; design load of the crown; both of a roller's diameters at once."""
KINDS = ("short", "long", "aside", "narrow")
SMALL = 0.1
"""Derivatives by a spall's number smaller than this share of the largest are compared with that share."""
FIELDS: tuple[str, ...] = ("scene", "kind", "edge", "status", "loads", "radial", "axial", *BY, "seconds")


def drawn(number: int, bearings: int) -> trb.Scene:
    """The scene of this number: a deep spall on one of so many bearings, with law "table"."""
    of = bearing(np.random.default_rng([7, number % bearings]))
    rng, contact = np.random.default_rng([8, number]), trb.LineContact.of(of, "outer")
    size = float(of.roller_length)
    crown, largest = load_at(contact, rng.uniform(1500.0, 3000.0)), load_at(contact, rng.uniform(700.0, 2600.0))
    radial = radial_load(of, largest)
    axial = radial * float(np.tan(of.outer_angle)) * rng.uniform(1.1, 3.0)
    kind = KINDS[number // bearings % len(KINDS)]
    shares = {"short": (0.05, 0.3), "long": (0.4, 0.8), "aside": (0.1, 0.6), "narrow": (0.1, 0.7)}
    length = rng.uniform(*shares[kind])
    offset = rng.uniform(-1.0, 1.0) * (atlas_place.INNER - 0.5 * length) if kind == "aside" else 0.0
    pitch = float(geometry.roller_pitch(of)) * float(geometry.arc_radius(of))
    half = float(gap.line_half_width(largest / size, float(contact.radius), float(contact.modulus)))
    width = half * rng.uniform(0.5, 4.0) if kind == "narrow" else pitch * rng.uniform(0.3, 2.0)
    angle = rng.uniform(-0.2, 0.2)
    phase = rng.uniform(0.0, float(geometry.roller_pitch(of)))
    if _on_edge(number, bearings):
        edge = 0.5 * width - half * rng.uniform(-1.0, 3.0) if kind != "narrow" else half * rng.uniform(0.0, 1.0)
        phase = angle + edge / float(geometry.arc_radius(of))
    spall = trb.Spall(length * size, width, 0.05 * size, angle=angle, axial_offset=offset * size)
    return trb.Scene(of, trb.Load(radial, axial), (spall,), "table", crown, phase=phase)


def _on_edge(number: int, bearings: int) -> bool:
    return number // bearings // len(KINDS) % 2 == 0


def _moved(scene: trb.Scene, by: jax.Array) -> trb.Scene:
    """The scene with what `BY` names changed."""
    length, width, offset, angle, crown, radius = by
    first = scene.spalls[0]
    spall = dataclasses.replace(
        first, length=first.length + length, width=first.width + width, axial_offset=first.axial_offset + offset,
        angle=first.angle + angle,
    )  # fmt: skip
    of = dataclasses.replace(
        scene.bearing, roller_small_diameter=scene.bearing.roller_small_diameter + 2.0 * radius,
        roller_large_diameter=scene.bearing.roller_large_diameter + 2.0 * radius,
        arc_radius=geometry.arc_radius(scene.bearing),
    )  # fmt: skip
    return dataclasses.replace(scene, bearing=of, spalls=(spall,), design_load=scene.design_load + crown)


def _all(scene: trb.Scene) -> tuple[trb.Solution, jax.Array]:
    """The solution, and derivatives of log K, radial and axial, by `BY`, shape (2, 6)."""

    def logs(by: jax.Array) -> tuple[jax.Array, trb.Solution]:
        solution = solve_prepared(_moved(scene, by))
        return jnp.log(solution.both_stiffnesses), solution

    slopes, solution = jax.jacfwd(logs, has_aux=True)(jnp.zeros(len(BY)))
    return solution, slopes


def row(number: int, bearings: int, accuracy: float) -> dict[str, Any]:
    """One scene by both laws."""
    started = time.perf_counter()
    scene = geometry.as_floats(drawn(number, bearings))
    found: dict[str, Any] = {
        "scene": number, "kind": KINDS[number // bearings % len(KINDS)], "edge": _on_edge(number, bearings)
    }  # fmt: skip
    try:
        solution, slopes = _all(trb.prepare(scene))
        code = int(solution.status_code)
        if code == status.CONVERGED:
            # finer than scene files may ask of a ring
            truth, right = _all(scene_laws.with_laws(named(scene, "direct", accuracy)))
            code = int(truth.status_code)
    except ValueError as refusal:
        return found | {"status": f"refused: {refusal}", "seconds": time.perf_counter() - started}
    found |= {"status": status.describe(code), "seconds": time.perf_counter() - started}
    if code == status.CONVERGED:
        loads = jnp.max(jnp.abs(solution.loads - truth.loads)) / jnp.max(truth.loads)
        stiffness = jnp.abs(solution.both_stiffnesses / truth.both_stiffnesses - 1.0)
        first = scene.spalls[0]
        pitch = float(geometry.roller_pitch(scene.bearing))
        size = 0.5 * (scene.bearing.roller_small_diameter + scene.bearing.roller_large_diameter)
        sizes = np.array([first.length, first.width, first.length, pitch, scene.design_load, 0.5 * size])
        large = sizes * np.max(np.abs(right), axis=0)
        off = sizes * np.max(np.abs(slopes - right), axis=0) / np.maximum(large, SMALL * np.max(large[:4]))
        found |= {"loads": float(loads), "radial": float(stiffness[0]), "axial": float(stiffness[1])}
        found |= dict(zip(BY, map(float, off), strict=True))
    return found


def summary(path: Path) -> None:
    """Medians, nine in ten, and the worst with its scene."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    compared = [each for each in rows if each["loads"]]
    print(f"{len(rows)} scenes, {len(compared)} compared")
    for each in rows:
        if not each["loads"]:
            print(f"  {each['scene']} {each['kind']}: {each['status']}")
    for kinds in (KINDS, *((kind,) for kind in KINDS)):
        own = [each for each in compared if each["kind"] in kinds]
        if not own:
            continue
        print(f"{' '.join(kinds)}: {len(own)}")
        for name in ("loads", "radial", "axial", *BY):
            off = np.array([float(each[name]) for each in own])
            if name in BY:
                off = off[off > 0.0]
            if off.size:
                worst = own[int(np.argmax([float(each[name]) for each in own]))]["scene"]
                print(f"  {name:7s} {np.median(off):.1e} {np.quantile(off, 0.9):.1e} {off.max():.1e} (scene {worst})")


def main() -> None:
    parser = arguments(200, "rings.csv")
    parser.add_argument("--bearings", type=int, default=20)
    parser.add_argument("--accuracy", type=float, default=1e-5, help="of the contacts of 'direct'")
    options = parser.parse_args()
    of = partial(row, bearings=options.bearings, accuracy=options.accuracy)
    add_rows(options.out, FIELDS, range(options.first, options.scenes, options.step), of)
    summary(options.out)


if __name__ == "__main__":
    main()
