"""How far strips are from far finer ones where a rolling edge stands anywhere on its way through the contact, and over
spalls narrower than it: the measurements behind `grids.GRIDS`, and the way's hardest part apart.

python experiments/accuracy_of_strips.py [CASES] [ACCURACIES …]   (default 24 1e-2 1e-3 1e-4 3e-5)

Random contacts of 32008J: loads of 0.3 … 9 kN, spalls 1 … 9 mm long. `edge`: one edge anywhere from the beginning of
its ramp to where the roller no longer meets the land beyond; `sliver`: in the last 0.4 of that, where only a sliver of
land is left; `both`: two edges less apart than that. Times are medians of single solves, by numpy.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb
from difftrb.contact import strip_model
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.grids import grid_for
from difftrb.contact.hollows import Beneath
from difftrb.contact.strip_model import Way
from difftrb.contact.strip_plan import Fineness
from difftrb.contact.strip_waves import Frequencies
from difftrb.core import arrays as xp
from difftrb.core.geometry import as_floats
from difftrb.law import samples
from difftrb.law.direct_curves import wide

FINEST = Fineness(44, 14, 3, 2, 30, Frequencies(6, 18, 40, 40.0), Frequencies(6, 18, 440, 440.0), 22)
KINDS = {"edge": (0.0, 1.0), "sliver": (0.6, 0.985), "both": (0.1, 1.0)}
"""Where the edge stands on its ramp; of `both`, how wide a spall is, by twice the ramp's end."""
WIDTH = 4.0


def random_cases(kind: str, count: int, contact: trb.LineContact) -> np.ndarray:
    """Load [N], spall length, width and offset [mm], shape (count, 4)."""
    rng = np.random.default_rng(11)
    rows = []
    for _ in range(count):
        load, length = 300.0 * 30.0 ** rng.random(), rng.uniform(1.0, 9.0)
        over = samples.solved(contact, samples.Case(load, wide(trb.Spall(length, WIDTH))), 1e-3)
        healthy = samples.solved(contact, samples.Case(load), 1e-3)
        place = rng.uniform(*KINDS[kind])
        if kind == "both":
            width = 2.0 * over.reach * place
            rows.append((load, length, width, 0.5 * width * rng.random()))
        else:
            edge = place * (over.reach + healthy.half_width) - healthy.half_width
            rows.append((load, length, WIDTH, 0.5 * WIDTH - edge))
    return np.array(rows)


def approaches(
    fineness: Fineness, accuracy: float, contact: trb.LineContact, cases: np.ndarray, edges: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Approach of every case [mm], whether it converged, and milliseconds of one, by numpy."""
    way = Way(True, Beneath(((0, 0),), edges), fineness, strip_model.SETTLED * accuracy, True)
    results, times = [], []
    for load, length, width, offset in cases:
        inputs = xp.numbers(Inputs(as_floats(contact), load, trb.Spall(float(length), float(width)), offset))
        started = time.perf_counter()
        found = strip_model.solve_numbers(inputs, way)
        times.append(time.perf_counter() - started)
        results.append((float(found.approach), bool(found.still) and float(found.settled.error) <= way.tolerance))
    approach, settled = map(np.array, zip(*results, strict=True))
    return approach, settled, 1e3 * float(np.median(times))


def compare(count: int, accuracies: Sequence[float], finest: Fineness = FINEST) -> Table:
    """Errors of each accuracy's strips, of contacts that converged on both."""
    contact = trb.LineContact.of(trb.bearing("32008J"), "outer", design_load=6500.0)
    table = Table("contacts", "accuracy", "median", "90 %", "worst", "not converged", "ms")
    for kind in track(KINDS, "kinds", transient=True):
        cases, edges = random_cases(kind, count, contact), 1 + (kind == "both")
        truth, known, _ = approaches(finest, 1e-5, contact, cases, edges)
        for accuracy in accuracies:
            strips = grid_for(accuracy).strips
            found, settled, milliseconds = approaches(strips, accuracy, contact, cases, edges)
            error = np.abs(found / truth - 1.0)[known & settled]
            figures = [f"{np.quantile(error, q):.1e}" for q in (0.5, 0.9, 1.0)]
            table.add_row(kind, f"{accuracy:g}", *figures, f"{np.sum(~settled)} of {count}", f"{milliseconds:.1f}")
        table.add_row(kind, "truth", "", "", "", f"{np.sum(~known)} of {count}", "", end_section=True)
    return table


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 24
    Console().print(compare(count, [float(a) for a in sys.argv[2:]] or [1e-2, 1e-3, 1e-4, 3e-5]))


if __name__ == "__main__":
    main()
