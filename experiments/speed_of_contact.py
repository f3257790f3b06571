"""What a contact costs: value, value with all slopes, compiling, at every accuracy; and how far it is off.

taskset -c 0 python experiments/speed_of_contact.py [CASES [TRUTHS]]   (default 256, 16)
taskset -c 0,1 python experiments/speed_of_contact.py --cores [CASES]   (how much faster two threads are; default 64)
python experiments/speed_of_contact.py --own [ACCURACY]   (in a program of one's own; default 1e-4)

Random geometries of 32008J's outer contact in one batch (`lax.map`): load, spall length, width and offset differ. Those
with the rolling edges out of reach of the contact, with one and with both in it are timed apart. Medians of three runs.
Errors are those of the first TRUTHS geometries against cells of 96 columns, themselves good to about 3e-5.

In a program of one's own: seconds to trace and to compile a contact and its gradient, with this package's compiler
options and without, nothing kept, and lines of StableHLO; and what `vmap` over 64 positions of a spall's edge takes by
what `lax.map` does.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb
from difftrb.contact import cell_solve, gap, ways
from difftrb.contact.contact_cells import Resolution
from difftrb.contact.contact_solution import Inputs, Method
from difftrb.contact.grids import grid_for
from difftrb.core import status

ACCURACIES = (1e-2, 1e-3, 1e-4, 3e-5, 1e-5)
FINEST = Resolution(96, 96, 24)


def geometries(count: int, contact: trb.LineContact, edges: int) -> jax.Array:
    """Load [N], spall length, width and offset [mm], shape (count, 4); `edges`: rolling edges in the contact, 0…2."""
    rng = np.random.default_rng(0)
    load, length = np.exp(rng.uniform(np.log(300.0), np.log(1e4), count)), rng.uniform(0.5, 9.0, count)
    width = rng.uniform(3.0, 8.0, count)
    half_width = np.asarray(gap.line_half_width(jnp.asarray(load) / contact.length, contact.radius, contact.modulus))
    offset = 0.5 * width + half_width * rng.uniform(-0.8, 0.8, count) if edges == 1 else np.zeros(count)
    if edges == 2:
        width, offset = half_width * rng.uniform(0.2, 1.6, count), half_width * rng.uniform(-0.5, 0.5, count)
    return jnp.asarray(np.stack([load, length, width, offset], axis=1))


def timed(function: Callable[[jax.Array], tuple], cases: jax.Array) -> tuple[tuple, float, float]:
    """Result, seconds to compile, seconds per case."""
    started = time.perf_counter()
    compiled = jax.jit(lambda c: jax.lax.map(function, c)).lower(cases).compile()
    to_compile = time.perf_counter() - started
    times, result = [], ()
    for _ in range(3):
        started = time.perf_counter()
        result = jax.block_until_ready(compiled(cases))
        times.append(time.perf_counter() - started)
    return result, to_compile, float(np.median(times)) / len(cases)


def truths(contact: trb.LineContact, cases: jax.Array, grid: Resolution) -> np.ndarray:
    """Approaches by cells [mm], shape (cases,)."""

    def approach(case: jax.Array) -> jax.Array:
        inputs = Inputs(contact, case[0], trb.Spall(case[1], case[2]), case[3])
        return cell_solve.solve(inputs, grid, True, 1e-4).approach

    return np.asarray(jax.jit(lambda c: jax.lax.map(approach, c))(cases))


def measure(
    contact: trb.LineContact, cases: jax.Array, edges: int, accuracy: float, truth: np.ndarray
) -> dict[str, float]:
    """Milliseconds by strips: value, value with all first derivatives; seconds to compile; share that converged; worst
    and root mean square error of the first cases, those with a `truth`."""

    def value(case: jax.Array) -> tuple[jax.Array, jax.Array]:
        arguments = contact, case[0], trb.Spall(case[1], case[2]), case[3]
        s = ways.by_strips(Inputs(*arguments), True, edges, accuracy)
        return s.approach, s.status_code

    def slopes(case: jax.Array) -> tuple[jax.Array, tuple]:
        def approach(*a) -> jax.Array:
            return ways.by_strips(Inputs(*a), True, edges, accuracy).approach

        arguments = contact, case[0], trb.Spall(case[1], case[2], 0.2, 0.0, 0.0), case[3]
        return jax.value_and_grad(approach, (0, 1, 2, 3))(*arguments)

    (approaches, codes), to_compile, each = timed(value, cases)
    error = np.asarray(approaches)[: len(truth)] / truth - 1.0
    _, to_compile_slopes, each_with_slopes = timed(slopes, cases)
    return {
        "value": 1e3 * each,
        "with slopes": 1e3 * each_with_slopes,
        "compile": to_compile,
        "compile with slopes": to_compile_slopes,
        "converged": float(np.mean(np.asarray(codes) == status.CONVERGED)),
        "worst": float(np.max(np.abs(error))),
        "rms": float(np.sqrt(np.mean(error**2))),
    }


def on_two_threads(function: Callable[[jax.Array], jax.Array], cases: jax.Array) -> float:
    """How much faster a batch is as two halves in a thread each than whole in one; medians of nine runs in turns."""
    batch = jax.jit(lambda c: jax.lax.map(function, c))
    halves = jnp.split(cases, 2)
    functions: list[Callable[[], object]] = [
        lambda: jax.block_until_ready(batch(cases)),
        lambda: list(pool.map(lambda half: jax.block_until_ready(batch(half)), halves)),
    ]
    seconds: list[list[float]] = [[], []]
    with ThreadPoolExecutor(2) as pool:
        for run in range(10):
            for way, times in zip(functions, seconds, strict=True):
                started = time.perf_counter()
                way()
                if run:  # the first compiles
                    times.append(time.perf_counter() - started)
    return float(np.median(seconds[0]) / np.median(seconds[1]))


def cores(count: int, contact: trb.LineContact, accuracy: float = 1e-3) -> dict[str, float]:
    """The gain of two threads by the way of solving, rolling edges out of reach."""
    grid = grid_for(accuracy).cells

    def arguments(case: jax.Array) -> tuple:
        return contact, case[0], trb.Spall(case[1], case[2]), case[3]

    functions = {
        "strips": lambda case: ways.by_strips(Inputs(*arguments(case)), True, 0, accuracy).approach,
        "cells": lambda case: cell_solve.solve(Inputs(*arguments(case)), grid, True, accuracy).approach,
    }
    return {name: on_two_threads(way, geometries(count, contact, 0)) for name, way in functions.items()}


def own_programs(contact: trb.LineContact, accuracy: float) -> Table:
    """A contact and its gradient by the ways there are: trace, compile, lines."""
    table = Table(title=f"jax {jax.__version__}, {accuracy:g}")
    for heading in ("method", "what", "trace [s]", "compile [s]", "as JAX does [s]", "lines"):
        table.add_column(heading, justify="right")
    methods: tuple[Method, ...] = ("numpy", "strips", "auto")
    for method in methods:

        def approach(load, length, width, offset, method: Method = method):
            return trb.solve_contact(contact, load, trb.Spall(length, width), offset, accuracy, method).approach

        programs = {"value": approach, "with its gradient": jax.value_and_grad(approach, (0, 1, 2, 3))}
        for what, program in programs.items():
            seconds = []
            for options in (trb.compiler_options(), {}):
                jax.clear_caches()
                started = time.perf_counter()
                lowered = jax.jit(program, compiler_options=options).lower(3000.0, 4.0, 7.0, 3.4)
                traced = time.perf_counter()
                lowered.compile()
                seconds.append((traced - started, time.perf_counter() - traced))
            (trace, quick), (_, plain) = seconds
            lines = len(lowered.as_text().splitlines())
            table.add_row(method, what, *(f"{s:.1f}" for s in (trace, quick, plain)), str(lines))
    return table


def of_vmap(contact: trb.LineContact, accuracy: float) -> dict[int, float]:
    """How much longer `vmap` over 64 positions takes than `lax.map`, by rolling edges in reach; medians of five."""
    found = {}
    for edges in (0, 1):
        load, length, width, offset = geometries(1, contact, edges)[0]
        offsets = offset + jnp.linspace(-0.05, 0.05, 64)

        def one(offset, load=load, length=length, width=width, edges=edges):
            return ways.by_strips(Inputs(contact, load, trb.Spall(length, width), offset), True, edges, accuracy)

        times = []
        for batch in (jax.vmap(one), lambda x, one=one: jax.lax.map(one, x)):
            program, each = jax.jit(lambda x, batch=batch: batch(x).approach), []
            for _ in range(6):
                started = time.perf_counter()
                jax.block_until_ready(program(offsets))
                each.append(time.perf_counter() - started)
            times.append(np.median(each[1:]))
        found[edges] = float(times[0] / times[1])
    return found


def main() -> None:
    """Measure everything and print the table."""
    if sys.argv[1:2] == ["--own"]:
        contact, accuracy = trb.LineContact.of(trb.bearing("32008J")), float((*sys.argv[2:3], "1e-4")[0])
        Console(width=110).print(own_programs(contact, accuracy))
        for edges, ratio in of_vmap(contact, accuracy).items():
            print(f"vmap over 64 positions, {edges} rolling edges in reach: {ratio:.2f} × lax.map")
        return
    if sys.argv[1:2] == ["--cores"]:
        count = int(sys.argv[2]) if len(sys.argv) > 2 else 64
        for way, gain in cores(count, trb.LineContact.of(trb.bearing("32008J"))).items():
            print(f"{count} contacts by {way} in two threads: {gain:.2f} times as fast as in one")
        return
    count, known = (int(sys.argv[i]) if len(sys.argv) > i else default for i, default in ((1, 256), (2, 16)))
    contact = trb.LineContact.of(trb.bearing("32008J"))
    table = Table(title=f"{count} contacts by strips, one batch: ms for the value and with all slopes; compile in s")
    for heading in ("edges", "accuracy", "value", "+ slopes", "ratio", "compile", "+ slopes", "good", "worst", "rms"):
        table.add_column(heading, justify="right")
    known_of = {}
    for edges, accuracy in track([(e, a) for e in range(3) for a in ACCURACIES], description="strips", transient=True):
        cases = geometries(count, contact, edges)
        if edges not in known_of:
            known_of[edges] = truths(contact, cases[:known], FINEST)
        m = measure(contact, cases, edges, accuracy, known_of[edges])
        row = f"{m['value']:.2f}", f"{m['with slopes']:.2f}", f"{m['with slopes'] / m['value']:.2f}"
        compiling = f"{m['compile']:.1f}", f"{m['compile with slopes']:.1f}"
        errors = f"{100.0 * m['converged']:.0f} %", f"{m['worst']:.1e}", f"{m['rms']:.1e}"
        table.add_row(str(edges), f"{accuracy:g}", *row, *compiling, *errors)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
