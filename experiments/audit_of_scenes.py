"""Random scenes, every law and effect: is what converges within what it promises, and are its derivatives right?

    taskset -c 0 python -m experiments.audit_of_scenes --scenes 300 --out audit.csv [--first 0] [--laws direct,table]

Bearings with rollers of 3 … 60 mm, one to three spalls, short, long, narrow, wide, shallow, off the middle, over the
roller's end, at the load zone's ends; every scene by one law, at one phase or in the mean. Each converged result is
audited by contact solves (`difftrb.verify`); every third one's derivatives are compared with central differences. One
row a scene, written as it comes; rows that are there are not computed again. Ends with what was refused, how often and
why, what was farther off than promised, and which derivatives were not finite or not right.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

import difftrb as trb
from difftrb.contact import gap
from difftrb.core import geometry
from difftrb.law.power import TABLE_2
from difftrb.ring import effects as E
from difftrb.scene.prepared_scene import solve_prepared
from experiments.programs import let_go

LAWS = ("power", "table", "direct", "liu2018", "palmgren", "auto")
ROLLERS = (17,)
"""Beside 32008J's 23: every number is a program of its own."""
CHECKED = 3
"""Every so many scenes derivatives are compared."""
MANY = 12_000
"""Memory maps beyond which programs are let go: at twice as many they take 7 GB."""
STEP = 1e-5
"""Of central differences, by the size of the number."""
FIELDS: tuple[str, ...] = (
    "seed", "law", "kind", "status", "load_error", "promised", "kept", "radial_error", "axial_error", "failed",
    "finite", "derivative_error", "seconds",
)  # fmt: skip


class Drawn(NamedTuple):
    """A random scene and, in a word each, what it is of."""

    scene: trb.Scene
    kind: str


def bearing(rng: np.random.Generator) -> trb.TaperedBearing:
    """A bearing with rollers of 3 … 60 mm that fit, and one apex."""
    if rng.uniform() < 0.2:
        return trb.bearing("32008J")
    length, rollers = float(np.exp(rng.uniform(np.log(3.0), np.log(60.0)))), int(rng.choice(ROLLERS))
    diameter, alpha = length * rng.uniform(0.35, 0.7), rng.uniform(0.18, 0.5)
    apart = rng.uniform(1.2, 1.4) / np.sin(np.pi / rollers)  # pitch diameter by roller diameter
    gamma = float(np.arctan(np.sin(alpha) / (apart + np.cos(alpha))))
    taper = length * np.tan(gamma)
    return trb.TaperedBearing(
        roller_small_diameter=float(diameter - taper), roller_large_diameter=float(diameter + taper),
        roller_length=length, rollers=rollers, outer_angle=float(alpha), inner_angle=float(alpha - 2.0 * gamma),
        roller_angle=gamma, flange_angle=1.5621,
    )  # fmt: skip


def load_at(contact: trb.LineContact, pressure: float) -> float:
    """Roller load [N] at which a long contact has this pressure [MPa] in its middle."""
    radius, length, modulus = (float(v) for v in (contact.radius, contact.length, contact.modulus))
    return float(np.pi * radius * pressure**2 / modulus * length)  # Johnson 1985, eq. (4.45)


def radial_load(of: trb.TaperedBearing, largest: float) -> float:
    """Radial load [N] at which the most loaded roller carries about `largest` [N]."""
    return largest * of.rollers * float(np.cos(of.outer_angle)) / 4.08


def spall(rng: np.random.Generator, of: trb.TaperedBearing, contact: trb.LineContact, load: float) -> trb.Spall:
    """One spall of any kind."""
    size, pitch = float(of.roller_length), float(geometry.roller_pitch(of)) * float(geometry.arc_radius(of))
    half = float(gap.line_half_width(load / size, float(contact.radius), float(contact.modulus)))
    length = size * (rng.uniform(0.1, 0.6) if rng.uniform() < 0.7 else rng.uniform(0.02, 0.84))
    width = {
        "usual": pitch * rng.uniform(0.2, 0.9), "wide": pitch * rng.uniform(1.0, 5.0),
        "narrow": half * rng.uniform(0.5, 4.0),
    }[rng.choice(["usual", "wide", "narrow"], p=[0.6, 0.25, 0.15])]  # fmt: skip
    depth = 0.02 * float(of.roller_large_diameter)
    if rng.uniform() < 0.15:
        depth = float(gap.palmgren_approach(load, size)) * rng.uniform(0.05, 1.2)
    offset = 0.0 if rng.uniform() < 0.5 else rng.uniform(-0.5, 0.5) * (size - length * rng.uniform(0.0, 1.0))
    angle = {"load": rng.uniform(-0.2, 0.2), "end": rng.uniform(1.0, 2.2), "any": rng.uniform(-3.1, 3.1)}[
        rng.choice(["load", "end", "any"], p=[0.7, 0.2, 0.1])
    ]
    return trb.Spall(
        max(length, 0.011), max(width, 0.011), depth=max(depth, 1e-6), angle=float(angle), axial_offset=float(offset)
    )


def drawn(seed: int, laws: tuple[str, ...]) -> Drawn:
    """The scene of one seed."""
    rng = np.random.default_rng(seed)
    law = laws[seed % len(laws)]
    of = trb.bearing("32008J") if law == "liu2018" else bearing(rng)
    contact = trb.LineContact.of(of, "outer")
    crown, largest = load_at(contact, rng.uniform(1500.0, 3000.0)), load_at(contact, rng.uniform(500.0, 2600.0))
    radial = radial_load(of, largest)
    axial = radial * float(np.tan(of.outer_angle)) * rng.uniform(1.1, 4.0)
    count = int(rng.choice([1, 2, 3], p=[0.6, 0.3, 0.1]))
    spalls = [spall(rng, of, contact, largest) for _ in range(count)]
    if law == "liu2018":
        spalls = [dataclasses.replace(s, length=min(s.length, float(TABLE_2[-1, 0]))) for s in spalls]
    if law in ("power", "liu2018", "palmgren"):  # one shape for the first, the middle for the others
        like = spalls[0]
        spalls = [dataclasses.replace(s, width=like.width, depth=like.depth, axial_offset=like.axial_offset)
                  for s in spalls]  # fmt: skip
    kinds = ["plain", "raceways", "series", "mounting", "double_row", "diameters", "centrifugal", "through", "life"]
    kind = str(rng.choice(kinds, p=[0.36] + [0.08] * 8)) if law not in ("liu2018", "palmgren") else "plain"
    if law == "palmgren" and rng.uniform() < 0.5:
        kind = "tilt"
    approach = float(gap.palmgren_approach(largest, float(of.roller_length)))
    load, acting = trb.Load(radial, axial), ()
    if kind == "raceways":
        acting = (E.Raceways(),)
        if rng.uniform() < 0.5:
            spalls[0] = dataclasses.replace(spalls[0], surface="inner")
    elif kind == "series":
        acting = (E.Raceways(), E.Flange("hertz", 10.0 * float(of.roller_large_diameter)), E.Centrifugal(500.0))
    elif kind == "mounting":
        load, acting = (
            trb.Load(radial, 0.0),
            (E.Mounting(preload=approach / float(np.sin(of.outer_angle)) * rng.uniform(0.5, 2.0)),),
        )
    elif kind == "double_row":
        acting = (E.DoubleRow(preload=approach * rng.uniform(0.0, 2.0)),)
    elif kind == "diameters":
        acting = (E.Diameters(tuple((0.2 * approach * rng.standard_normal(of.rollers)).tolist())),)
    elif kind == "centrifugal":
        acting = (E.Centrifugal(rng.uniform(100.0, 2000.0), control=str(rng.choice(["force", "position"]))),)  # type: ignore[arg-type]
    elif kind == "through":
        acting = (E.Through(),)
    elif kind == "life":
        acting = (E.Life(),)
    elif kind == "tilt":
        acting = (E.Tilt(moment_radial=0.05 * radial * float(geometry.pitch_radius(of))),)
    phase: Any = float(rng.uniform(0.0, float(geometry.roller_pitch(of))))
    if rng.uniform() < 0.3:  # a roller on a rolling edge
        edge = spalls[0].angle + 0.5 * spalls[0].width / float(geometry.arc_radius(of))
        phase = float(np.mod(edge + rng.normal(0.0, 0.003), 6.28))
    if rng.uniform() < 0.15 and "roller" not in kind:
        phase = "mean"
    accuracy = float({"direct": rng.choice([1e-2, 1e-3]), "auto": rng.choice([1e-2, 1e-3])}.get(law, 1e-2))
    definition: Any = rng.choice(["tangent", "secant"], p=[0.8, 0.2])
    scene = trb.Scene(of, load, tuple(spalls), law, crown, accuracy, str(definition), phase, acting)  # type: ignore[arg-type]
    return Drawn(scene, f"{kind} {count} {'mean' if phase == 'mean' else 'phase'}")


@jax.jit
def _slopes(scene: trb.Scene) -> trb.Scene:
    """By every number of a prepared scene: of radial and axial stiffness and loads, by their sizes."""

    def total(scene: trb.Scene) -> jax.Array:
        found = solve_prepared(scene)
        size = jax.lax.stop_gradient(jnp.array([found.stiffness[0, 0], found.stiffness[2, 2]]))
        return jnp.sum(jnp.array([found.stiffness[0, 0], found.stiffness[2, 2]]) / size)

    return jax.grad(total)(scene)


def derivatives(scene: trb.Scene) -> tuple[bool, float]:
    """Whether all derivatives of a prepared scene are finite, and how far those by spall and load are from central
    differences, by themselves or, where they are small, by a stiffness and its length or load [-]."""
    scene = geometry.as_floats(scene)
    own = dataclasses.replace(scene, law=jax.tree.map(jnp.asarray, scene.law))
    slopes = _slopes(own)
    parts = (slopes.bearing, slopes.load, slopes.spalls, slopes.design_load)
    finite = all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(parts))

    def value(changed: trb.Scene) -> np.ndarray:
        found = solve_prepared(changed)
        return np.array([found.stiffness[0, 0], found.stiffness[2, 2]])

    at, worst = value(scene), 0.0
    for name, got, replaced in _directions(scene, slopes):
        h = STEP * name
        up, down = value(replaced(h)), value(replaced(-h))
        wanted = float(np.sum((up - down) / at)) / (2.0 * h)
        worst = max(worst, abs(float(got) - wanted) / (1.0 / name + abs(wanted)))
    return finite, worst


def _directions(scene: trb.Scene, slopes: trb.Scene) -> list[tuple[float, Any, Any]]:
    """Sizes, derivatives and ways to change the loads and the first spall's length."""
    first = scene.spalls[0]

    def of_load(name: str) -> Any:
        return lambda h: dataclasses.replace(
            scene, load=dataclasses.replace(scene.load, **{name: getattr(scene.load, name) + h})
        )

    def of_length(h: float) -> trb.Scene:
        changed = dataclasses.replace(first, length=first.length + h)
        return dataclasses.replace(scene, spalls=(changed, *scene.spalls[1:]))

    found = [(float(first.length), slopes.spalls[0].length, of_length)]
    for name in ("radial", "axial"):
        if (size := float(getattr(scene.load, name))) > 0.0:
            found.append((size, getattr(slopes.load, name), of_load(name)))
    return found


def row(seed: int, laws: tuple[str, ...]) -> dict[str, Any]:
    """One scene: solved, audited, differentiated."""
    started = time.perf_counter()
    scene, kind = drawn(seed, laws)
    found: dict[str, Any] = {"seed": seed, "law": laws[seed % len(laws)], "kind": kind}
    try:
        ready = trb.prepare(scene)
        solution = trb.solve(ready)
    except ValueError as refusal:
        return found | {"status": f"refused: {refusal}", "seconds": time.perf_counter() - started}
    found["status"] = solution.status
    if bool(solution.converged):
        audit = trb.verify(ready, solution)
        found |= {
            "load_error": audit.load_error, "promised": audit.promised, "kept": audit.kept, "failed": audit.failed,
            "radial_error": audit.stiffness_error[0], "axial_error": audit.stiffness_error[1],
        }  # fmt: skip
        if seed // len(laws) % CHECKED == 0:
            found["finite"], found["derivative_error"] = derivatives(ready)
    return found | {"seconds": time.perf_counter() - started}


def summary(path: Path) -> None:
    """What all rows say."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    solved_rows = [row for row in rows if row["status"] == "converged"]
    print(f"{len(rows)} scenes, {len(solved_rows)} converged; the others:")
    for sentence, count in Counter(r["status"][:100] for r in rows if r["status"] != "converged").most_common():
        print(f"  {count:4d} {sentence}")
    for law in LAWS:
        own = [row for row in solved_rows if row["law"] == law and row["load_error"] not in ("", "nan")]
        if own:
            errors = np.array([float(row["load_error"]) for row in own])
            radial = np.array([float(row["radial_error"]) for row in own])
            print(f"{law:9s} {len(own):4d} audited: loads off by {np.median(errors):.1e} … {errors.max():.1e} of the "
                  f"largest, radial stiffness by {np.nanmedian(radial):.1e} … {np.nanmax(radial):.1e}")  # fmt: skip
    broken = [row for row in solved_rows if row["kept"] == "False"]
    print(f"beyond what is promised: {len(broken)} {[(r['seed'], r['law']) for r in broken]}")
    compared = [row for row in solved_rows if row["finite"]]
    lost = [row["seed"] for row in compared if row["finite"] != "True"]
    wrong = np.array([float(row["derivative_error"]) for row in compared])
    print(f"derivatives: {len(compared)} scenes, not finite: {lost}; off central differences "
          f"by {np.median(wrong) if wrong.size else 0.0:.1e} … {wrong.max(initial=0.0):.1e}")  # fmt: skip


def add_rows(path: Path, fields: Sequence[str], numbers: Iterable[int], row: Callable[[int], dict[str, Any]]) -> None:
    """Compute the rows of these numbers that are not there and write each as it comes; a row's number is its first
    field."""
    done = set()
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            done = {int(each[fields[0]]) for each in csv.DictReader(file)}
    with path.open("a", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, fields)
        if not done:
            writer.writeheader()
        for number in numbers:
            if number not in done:
                writer.writerow(row(number))
                file.flush()
                let_go(MANY)


def arguments(scenes: int, out: str) -> argparse.ArgumentParser:
    """What both audits take."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=scenes)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--step", type=int, default=1, help="take every so many, for several processes")
    parser.add_argument("--out", type=Path, default=Path(out))
    return parser


def main() -> None:
    parser = arguments(300, "audit.csv")
    parser.add_argument("--laws", default=",".join(LAWS))
    options = parser.parse_args()
    laws = tuple(options.laws.split(","))
    add_rows(options.out, FIELDS, range(options.first, options.scenes, options.step), lambda seed: row(seed, laws))
    summary(options.out)


if __name__ == "__main__":
    main()
