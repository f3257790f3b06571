"""What a contact costs: value, value and all first derivatives, and compiling, at every accuracy.

taskset -c 0 python experiments/speed_of_contact.py [CASES]   (default 256)

Random geometries of 32008J's outer contact in one batch (`lax.map`): load, spall length, width and offset differ. Those
with the rolling edges out of reach of the contact, with one and with both in it are timed apart. Medians of three runs.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import track  # noqa: E402
from rich.table import Table  # noqa: E402

import difftrb as trb  # noqa: E402
from difftrb import contact as contacts  # noqa: E402
from difftrb import hertz, status  # noqa: E402

ACCURACIES = (1e-2, 1e-3, 1e-4, 3e-5, 1e-5)


def geometries(count: int, contact: trb.LineContact, edges: int) -> jax.Array:
    """Load [N], spall length, width and offset [mm], shape (count, 4); `edges`: rolling edges in the contact, 0…2."""
    rng = np.random.default_rng(0)
    load, length = np.exp(rng.uniform(np.log(300.0), np.log(1e4), count)), rng.uniform(0.5, 9.0, count)
    width = rng.uniform(3.0, 8.0, count)
    half_width = np.asarray(hertz.line_half_width(jnp.asarray(load) / contact.length, contact.radius, contact.modulus))
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


def measure(contact: trb.LineContact, cases: jax.Array, edges: int, accuracy: float) -> dict[str, float]:
    """Milliseconds by strips: value, value with all first derivatives; seconds to compile; share that converged."""

    def value(case: jax.Array) -> tuple[jax.Array, jax.Array]:
        arguments = contact, case[0], trb.Spall(case[1], case[2]), case[3]
        s = contacts._by_strips(*arguments, True, edges, accuracy)
        return s.approach, s.status_code

    def slopes(case: jax.Array) -> tuple[jax.Array, tuple]:
        def approach(*a) -> jax.Array:
            return contacts._by_strips(*a, True, edges, accuracy).approach

        arguments = contact, case[0], trb.Spall(case[1], case[2], 0.2, 0.0, 0.0), case[3]
        return jax.value_and_grad(approach, (0, 1, 2, 3))(*arguments)

    (_, codes), to_compile, each = timed(value, cases)
    _, to_compile_slopes, each_with_slopes = timed(slopes, cases)
    return {
        "value": 1e3 * each,
        "with slopes": 1e3 * each_with_slopes,
        "compile": to_compile,
        "compile with slopes": to_compile_slopes,
        "converged": float(np.mean(np.asarray(codes) == status.CONVERGED)),
    }


def main() -> None:
    """Measure everything and print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    contact = trb.LineContact.of(trb.bearing("32008J"))
    table = Table(title=f"{count} contacts by strips, one batch: ms for the value and with all slopes; compile in s")
    for heading in ("edges", "accuracy", "value", "+ slopes", "ratio", "compile", "+ slopes", "good"):
        table.add_column(heading, justify="right")
    for edges, accuracy in track(
        [(e, a) for e in range(3) for a in ACCURACIES], description="strips", transient=True
    ):
        m = measure(contact, geometries(count, contact, edges), edges, accuracy)
        row = f"{m['value']:.2f}", f"{m['with slopes']:.2f}", f"{m['with slopes'] / m['value']:.2f}"
        compiling = f"{m['compile']:.1f}", f"{m['compile with slopes']:.1f}"
        table.add_row(str(edges), f"{accuracy:g}", *row, *compiling, f"{100.0 * m['converged']:.0f} %")
    Console().print(table)


if __name__ == "__main__":
    main()
