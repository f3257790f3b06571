"""What a contact grid costs and how far it is from the truth: the measurements behind the cells of `grids.GRIDS`.

python experiments/accuracy_of_contact.py [CASES]   (default 40)

Random contacts of 32008J (peak pressures of 600…2500 N/mm², spalls of any length, one rolling edge anywhere from
outside to the middle of the contact, or none) on every grid, against the finest grid. Times are medians per solve.
"""

from __future__ import annotations

import sys
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb
from difftrb.contact import cell_solve, grids
from difftrb.contact.contact_cells import Resolution
from difftrb.contact.contact_solution import Inputs

FINEST = Resolution(96, 96, 24)
GRIDS = [*dict.fromkeys(g.cells for g in grids.GRIDS.values()), Resolution(24, 20, 8), Resolution(48, 48, 12)]


def random_cases(count: int, contact: trb.LineContact) -> jax.Array:
    """Load [N], spall length, width and offset [mm], shape (count, 4)."""
    rng = np.random.default_rng(0)
    pressure = 600.0 * (2500.0 / 600.0) ** rng.random(count)
    load = pressure**2 * np.pi * float(contact.radius) * float(contact.length) / float(contact.modulus)
    half_width = 2.0 * load / (np.pi * float(contact.length) * pressure)
    width = rng.uniform(1.0, 7.0, count)
    edge = np.where(rng.random(count) < 0.5, 0.0, 0.5 * width + half_width * rng.uniform(-1.5, 1.5, count))
    return jnp.asarray(np.stack([load, rng.uniform(0.5, 9.0, count), width, edge], axis=1))


def approaches(grid: Resolution, contact: trb.LineContact, cases: jax.Array) -> tuple[np.ndarray, float, float]:
    """Approach of every case [mm], seconds to compile and seconds per solve."""

    def one(case: jax.Array) -> jax.Array:
        inputs = Inputs(contact, case[0], trb.Spall(case[1], case[2]), case[3])
        return cell_solve.solve(inputs, grid, True, 1e-3).approach

    batch = jax.jit(lambda c: jax.lax.map(one, c))
    started = time.perf_counter()
    compiled = batch.lower(cases).compile()
    to_compile = time.perf_counter() - started
    times = []
    for _ in range(3):
        started = time.perf_counter()
        result = jax.block_until_ready(compiled(cases))
        times.append(time.perf_counter() - started)
    return np.asarray(result), to_compile, float(np.median(times)) / len(cases)


def main() -> None:
    """Measure all grids and print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    contact = trb.LineContact.of(trb.bearing("32008J"))
    cases = random_cases(count, contact)
    truth, _, _ = approaches(FINEST, contact, cases)
    table = Table(title=f"{count} random contacts against {FINEST}")
    for heading in ("grid", "cells", "worst error", "rms", "ms per solve", "compile s"):
        table.add_column(heading, justify="right")
    for grid in track(GRIDS, description="grids", transient=True):
        result, to_compile, seconds = approaches(grid, contact, cases)
        error = np.abs(result / truth - 1.0)
        name = f"{grid.columns} × ({grid.land} + {grid.spall})"
        cells = grid.columns * (grid.land + grid.spall)
        row = f"{error.max():.1e}", f"{np.sqrt(np.mean(error**2)):.1e}", f"{1e3 * seconds:.2f}", f"{to_compile:.1f}"
        table.add_row(name, str(cells), *row)
    Console().print(table)


if __name__ == "__main__":
    main()
