"""What a ring costs once its law is prepared: one scene of a jitted batch, value and gradient, and the same by scipy.

taskset -c 0 python -m experiments.speed_of_ring [SCENES] [LAW]   (default 10000 power; pin one core to compare)

scipy finds one ring at a time, on the law's curves written out in numpy, which are taken as known, or on the law
itself. It has the same stiffness matrix and loads, and their derivatives by length and width from four rings more.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.law.base import Law
from difftrb.scene.scene import LawName
from experiments import by_scipy

PIECE = 500
"""Scenes of the batch that are computed at once: curves of all 10 000 do not fit into a core's cache, which takes
`table` 1.6 times as long."""


def seconds(function: Callable, *arguments: jax.Array) -> tuple[float, float]:
    """Seconds of the first call (tracing, compiling, running) and the median of seven more."""
    times = []
    for _ in range(8):
        started = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - started)
    return times[0], float(np.median(times[1:]))


VALUE, SLOPES = "loads", "stiffness, loads, all by length and width"


def the_scene(law: Law | str) -> trb.Scene:
    """The README's, with a law."""
    return trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law=law)


def measure(law: Law, count: int) -> dict[str, tuple[float, float]]:
    """First call [s] and time per scene [µs] for loads, where the width is a constant and where it changes, too; for
    stiffness with its length derivative, and for stiffness, loads and all their derivatives by length and width."""
    scene = the_scene(law)

    def at(length: jax.Array, axial: jax.Array, **sizes: jax.Array) -> trb.Solution:
        spalls = (dataclasses.replace(scene.spalls[0], length=length, **sizes),)
        return trb.solve(dataclasses.replace(scene, load=trb.Load(9000.0, axial), spalls=spalls))

    def of_any_width(length: jax.Array, axial: jax.Array) -> jax.Array:
        return at(length, axial, width=1.0 + length).loads

    def loads(length: jax.Array, axial: jax.Array) -> jax.Array:
        return at(length, axial).loads

    def sensitive(length: jax.Array, axial: jax.Array) -> tuple[jax.Array, jax.Array]:
        slope = jax.grad(lambda v: at(v, axial).stiffness[0, 0])(length)
        return at(length, axial).stiffness, slope

    def everything(length: jax.Array, axial: jax.Array) -> tuple:
        def both(sizes: jax.Array) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
            s = at(sizes[0], axial, width=sizes[1])
            return (s.stiffness, s.loads), (s.stiffness, s.loads)

        return jax.jacfwd(both, has_aux=True)(jnp.stack([length, jnp.asarray(7.0)]))

    batch = jnp.linspace(0.5, 8.0, count), jnp.linspace(4000.0, 6000.0, count)
    results = {}
    for name, function in (
        (VALUE, loads),
        ("loads, of spalls of any width", of_any_width),
        ("stiffness matrix and d(radial)/d(length)", sensitive),
        (SLOPES, everything),
    ):
        pieces = jax.jit(lambda *batch, one=function: jax.lax.map(lambda x: one(*x), batch, batch_size=PIECE))
        first, again = seconds(pieces, *batch)
        results[name] = first, 1e6 * again / count
    return results


def main() -> None:
    """Measure with the default scene's law and print."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10000
    name = sys.argv[2] if len(sys.argv) > 2 else "power"
    ready = trb.prepare(the_scene(name))
    assert not isinstance(ready.law, str | LawName)
    found = measure(ready.law, count)
    for what, (first, each) in found.items():
        print(f"{what:42s} first call {first:.2f} s, then {each:.2f} µs per scene in a batch of {count}")
    for way, pair in by_scipy.seconds(ready).items():
        for what, took in zip((VALUE, SLOPES), pair, strict=True):
            each = 1e6 * took
            print(f"{what:42s} by scipy on {way}: {each:.0f} µs, {each / found[what][1]:.0f} times that")


if __name__ == "__main__":
    main()
