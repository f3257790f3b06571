"""What every effect changes, in stiffness, loads and gradient of three scenes, and what it costs; and what rings by
contacts cost where rollers or rings tilt.

taskset -c 0 python experiments/effects_and_their_cost.py [--batch 1000] [--out DIR]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb
from difftrb.law import base
from difftrb.law.power import Palmgren
from difftrb.ring import effects

BEARING = trb.bearing("32008J")
LOADS = {"combined": trb.Load(9000.0, 4500.0), "axial": trb.Load(0.0, 4500.0), "light": trb.Load(240.0, 120.0)}


class Row(NamedTuple):
    """One effect: changes by scene of radial stiffness, largest load and d(stiffness)/d(length) [%], cost by ratios."""

    effect: str
    stiffness: list[float]
    load: list[float]
    slope: list[float]
    compile_seconds: float
    microseconds: float
    program: int


def kinds(raceway_law: base.Law) -> dict[str, tuple[effects.Effect, ...]]:
    """The effects to compare, by what they are called."""
    series = effects.SeriesRaceways(None, raceway_law)
    deviations = tuple(float(v) for v in 1e-3 * np.random.default_rng(1).uniform(-0.5, 0.5, BEARING.rollers))
    return {
        "none": (),
        "raceways": (series,),
        "flange, rigid": (effects.Flange(),),
        "flange, Hertz": (effects.Flange("hertz", 100.0),),
        "diameters ±0.5 µm": (effects.Diameters(deviations),),
        "centrifugal 7100 rpm": (effects.Centrifugal(7100.0),),
        "… and raceways, position": (series, effects.Centrifugal(7100.0, "position")),
        "through": (effects.Through(),),
        "life": (effects.Life(),),
        "mounting, 15 µm": (effects.Mounting(0.015),),
        "tilt": (effects.Tilt(),),
        "double row, 20 µm": (effects.DoubleRow(0.02),),
        "… and it tilts": (effects.DoubleRow(0.02, spacing=30.0),),
    }


def scene(acting: tuple[effects.Effect, ...], load: trb.Load, roller_law: base.Law) -> trb.Scene:
    """A spall of 6 × 7 mm under a centred roller."""
    if any(effect.key == "mounting" for effect in acting):
        load = trb.Load(load.radial, 0.0)
    if any(effect.key == "tilt" for effect in acting):
        roller_law = Palmgren(BEARING.roller_length)
    return trb.Scene(BEARING, load, (trb.Spall(6.0, 7.0),), roller_law, effects=acting)


def answers(length: jax.Array, of: trb.Scene) -> tuple[jax.Array, jax.Array]:
    """Radial stiffness (axial, where there is no radial load) and its derivative by the spall's length; largest load,
    status."""

    def solved(length: jax.Array) -> tuple[jax.Array, jax.Array]:
        r = trb.solve(dataclasses.replace(of, spalls=(dataclasses.replace(of.spalls[0], length=length),)))
        return r.radial_stiffness, jnp.stack([jnp.max(r.loads), r.status_code.astype(float)])

    value, slope, more = jax.jvp(solved, (length,), (jnp.ones(()),), has_aux=True)
    return jnp.stack([value, slope]), more


def median_seconds(function: Callable[[], Any], repeats: int = 5) -> float:
    """Of several calls, each to its end."""
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - started)
    return statistics.median(times)


def measure(name: str, acting: tuple[effects.Effect, ...], roller_law: base.Law, loads: Sequence[trb.Load], batch: int):
    """Values for every load, and the costs."""
    lengths = jnp.linspace(5.0, 7.0, batch)
    every = jax.jit(jax.vmap(answers, in_axes=(0, None)))
    first = scene(acting, loads[0], roller_law)
    lowered = every.lower(lengths, first)
    started = time.perf_counter()
    compiled = lowered.compile()
    seconds = time.perf_counter() - started
    run = median_seconds(lambda: compiled(lengths, first))
    found = []
    for load in loads:
        values, more = compiled(jnp.full(batch, 6.0), scene(acting, load, roller_law))
        if int(more[0, 1]):
            raise SystemExit(f"{name}: status {int(more[0, 1])}")
        found.append([float(values[0, 0]), float(more[0, 0]), float(values[0, 1])])
    size = len(str(jax.make_jaxpr(answers)(jnp.asarray(6.0), first)).splitlines())
    return np.array(found), seconds, 1e6 * run / batch, size


def compare(batch: int, loads: dict[str, trb.Load] = LOADS, names: Sequence[str] | None = None) -> list[Row]:
    """Every effect beside none."""
    roller_law = trb.liu2018()
    chosen = {name: acting for name, acting in kinds(roller_law).items() if names is None or name in names}
    rows, plain = [], None
    for name, acting in track(chosen.items(), "effects", transient=True, console=Console(stderr=True)):
        found, seconds, microseconds, size = measure(name, acting, roller_law, list(loads.values()), batch)
        plain = found if plain is None else plain
        changes = 100.0 * (found / plain - 1.0)
        stiffness, load, slope = (list(map(float, column)) for column in changes.T)
        rows.append(Row(name, stiffness, load, slope, seconds, microseconds, size))
    return rows


def by_contacts(batch: int, names: Sequence[str] | None = None) -> dict[str, float]:
    """Microseconds a ring by law "direct", prepared, with its derivative by the radial load, in a batch of loads."""
    free, tilt = effects.Raceways(), effects.Tilt(moment_lateral=1e4)
    every: dict[str, tuple[effects.Effect, ...]] = {
        "none": (), "raceways": (free,), "tilt": (tilt,), "tilt, raceways": (free, tilt),
        "tilt, raceways, flange, speed": (free, tilt, effects.Flange("hertz", 100.0), effects.Centrifugal(7100.0)),
    }  # fmt: skip
    spall, shares = trb.Spall(4.0, 7.0, axial_offset=1.0), jnp.linspace(0.999, 1.001, batch)
    found = {}
    for name, acting in every.items():
        if names is not None and name not in names:
            continue
        scene = trb.Scene(BEARING, LOADS["combined"], (spall,), "direct", accuracy=1e-2, phase=0.05, effects=acting)
        ready = trb.prepare(scene)

        def one(share: jax.Array, ready: trb.Scene = ready) -> tuple[jax.Array, jax.Array, jax.Array]:
            def solved(share: jax.Array) -> tuple[jax.Array, jax.Array]:
                r = trb.solve(dataclasses.replace(ready, load=trb.Load(9000.0 * share, 4500.0)))
                return r.radial_stiffness, r.status_code

            return jax.jvp(solved, (share,), (jnp.ones(()),), has_aux=True)

        run = jax.jit(jax.vmap(one))
        if np.any(run(shares)[2]):
            raise SystemExit(f"{name}: a status")
        found[name] = 1e6 * median_seconds(lambda run=run: run(shares)) / batch
    return found


def draw(rows: list[Row], loads: Sequence[str], folder: Path) -> None:
    """Changes of stiffness and largest load, and run time, side by side."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = rows[1:][::-1]
    figure, axes = plt.subplots(1, 3, figsize=(10.5, 4.2), sharey=True, layout="constrained")
    colours = ["#4477AA", "#EE6677", "#228833"]
    places = np.arange(len(shown))
    for ax, field, title in zip(axes, ("stiffness", "load"), ("radial stiffness", "largest roller load"), strict=False):
        for k, (label, colour) in enumerate(zip(loads, colours, strict=False)):
            values = [getattr(row, field)[k] for row in shown]
            ax.barh(places + 0.26 * (1 - k), values, 0.24, color=colour, label=f"{label} load")
        ax.axvline(0.0, color="black", lw=0.8)
        ax.set_xscale("symlog", linthresh=1.0, linscale=0.5)
        ax.set_xticks([-100, -10, -1, 0, 1, 10, 100], ["−100", "−10", "−1", "0", "1", "10", "100"])
        ax.minorticks_off()
        ax.set_xlabel(f"change of {title} [%]")
    axes[0].set_yticks(places, [row.effect for row in shown])
    axes[1].legend(frameon=False, fontsize=8)
    axes[1].set_xlim(-10.0, 300.0)
    axes[2].barh(places, [row.microseconds / rows[0].microseconds for row in shown], 0.6, color="#BBBBBB")
    axes[2].axvline(1.0, color="black", lw=0.8)
    axes[2].set_xlabel("time by that of the plain ring [–]")
    folder.mkdir(parents=True, exist_ok=True)
    for kind in ("png", "svg"):
        figure.savefig(folder / f"effects.{kind}", dpi=160)
    plt.close(figure)


def main() -> None:
    """Print the table; write figure and numbers if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch", type=int, default=1000)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = compare(options.batch)
    table = Table(title="Change [%] of radial stiffness, largest load, d(stiffness)/d(length), by scene; cost")
    for heading in ("effect", *(f"{name}: K, Q, dK" for name in LOADS), "compile [s]", "µs", "× plain", "program"):
        table.add_column(heading, justify="left" if heading == "effect" else "right")
    for row in rows:
        cells = [", ".join(f"{v:+.2g}" for v in each) for each in zip(row.stiffness, row.load, row.slope, strict=True)]
        ratio = row.microseconds / rows[0].microseconds
        table.add_row(
            row.effect,
            *cells,
            f"{row.compile_seconds:.1f}",
            f"{row.microseconds:.1f}",
            f"{ratio:.2f}",
            str(row.program),
        )
    Console(width=150).print(table)
    contacts = by_contacts(options.batch)
    for name, microseconds in contacts.items():
        print(
            f"by contacts: {name}: {microseconds:.1f} µs, {microseconds / contacts['none']:.2f} times the plain ring's"
        )
    if options.out is not None:
        draw(rows, list(LOADS), options.out)
        (options.out / "effects.json").write_text(json.dumps([row._asdict() for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
