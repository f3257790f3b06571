"""Contacts by bands beside strips: how far off the continuum, and how long.

    taskset -c 1 python -m experiments.bands [ACCURACY]
    python -m pytest -n 0 experiments/bands

Over `ladder.TRUTHS`, whose continuum solution is known. Where it stands: with an edge in reach bands take a quarter of
strips' time or less, and slivers of land that strips do not take. At 1e-4 slivers are up to 3e-4 off, derivatives by
the width of a narrow spall 2 … 5 %, by the length of a spall whose edge is just met 9 … 13 %. Rows that end where the
contact does leave a saw of 3e-5: a parabola through neighbouring ends should take it away. There is no certificate
yet, and no several spalls.
"""

from __future__ import annotations

import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

from difftrb.accuracy.ladder import CONTACT, TRUTHS, Truth
from difftrb.contact import contact_cells, solver
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.gap import line_half_width
from difftrb.contact.solver import grid_for
from difftrb.core import machine
from difftrb.core.geometry import as_floats
from experiments.bands import solution


def measured(truth: Truth, accuracy: float) -> tuple[float, float, float, float]:
    """Errors [-] and milliseconds by bands and by strips."""
    numbers = jnp.asarray(truth.load, float), jnp.asarray(truth.offset, float)
    given = Inputs(as_floats(CONTACT), numbers[0], as_floats(truth.spall), numbers[1], None)
    reach = 2.0 * float(line_half_width(truth.load / CONTACT.length, CONTACT.radius, CONTACT.modulus))
    edges = int(truth.spall is not None and abs(abs(truth.offset) - 0.5) < reach)
    found = []
    for solve in (
        lambda given: solution.solve(given, True, edges, accuracy, _cells(given, accuracy)).approach,
        lambda given: solver._by_strips(given, True, edges, accuracy).approach,
    ):
        run = partial(jax.jit(solve), given)
        approach = float(run())
        found += [approach / truth.approach - 1.0, 1e3 * machine.timed(run)[1]]
    return found[0], found[1], found[2], found[3]


def _cells(given: Inputs, accuracy: float):
    return contact_cells.stage(given, grid_for(accuracy).cells, True)[0]


def main() -> None:
    accuracy = float(sys.argv[1]) if len(sys.argv) > 1 else 1e-4
    print("   load  length  offset   bands off      ms   strips off      ms")
    rows = [measured(truth, accuracy) for truth in TRUTHS]
    for truth, row in zip(TRUTHS, rows, strict=True):
        print(f"{truth.load:7.0f} {truth.length:7.1f} {truth.offset:7.2f} "
              f"{row[0]:11.1e} {row[1]:7.2f} {row[2]:12.1e} {row[3]:7.2f}")  # fmt: skip
    print("worst", *(f"{np.max(np.abs(np.array(rows)[:, i])):.1e}" for i in (0, 2)))


if __name__ == "__main__":
    main()
