"""The energy a spall's end releases: from the stress intensity along it, and as the energy's derivative by the length.

python experiments/energy_release.py [FOLDER]   (default out)

Both come from the same solve, the first from the pressure beside the edge, the second by automatic differentiation of
½ load·approach + ½ Σ force·gap. Prints their ratio at rising numbers of rows; draws K along the edge and the errors.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb

LANDS = (32, 48, 64, 96, 128)
CASES = ((2500.0, 4.0), (500.0, 4.0), (8000.0, 4.0), (2500.0, 1.0), (2500.0, 8.0))  # load [N], length [mm]
COLOURS = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE")


class Measured(NamedTuple):
    """Rows on the land, the energy's derivative [N mm/mm], the same from K, and K along the edge."""

    land: int
    slope: float
    release: float
    x: np.ndarray
    intensity: np.ndarray


def measure(contact: trb.LineContact, load: float, length: float, land: int, columns: int = 48) -> Measured:
    """One contact on one grid."""

    def energy(length: jax.Array) -> tuple[jax.Array, trb.EdgeIntensity]:
        found = trb.edge_intensity(contact, load, trb.Spall(length, 7.0), 0.0, land, columns)
        return found.energy, found

    slope, found = jax.grad(energy, has_aux=True)(length)
    found.check()
    return Measured(land, float(slope), 0.5 * float(found.release.sum()), np.asarray(found.x), np.asarray(found.high))


def draw(results: dict[tuple[float, float], list[Measured]], path: Path) -> None:
    """K along the edge on the finest grid, and the error of the release against the rows."""
    figure, (along, error) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
    for colour, ((load, length), rows) in zip(COLOURS, results.items(), strict=False):
        name = f"{load / 1e3:g} kN, {length:g} mm"
        along.plot(rows[-1].x, rows[-1].intensity, color=colour, label=name)
        errors = [100.0 * abs(r.release / r.slope - 1.0) for r in rows]
        error.loglog([r.land for r in rows], errors, "o-", color=colour, label=name)
    along.set(xlabel="across the contact [mm]", ylabel="K at the spall's end [N/mm$^{1.5}$]", ylim=(0.0, None))
    error.axhline(0.5, color="#BBBBBB", lw=1.0)
    lands = [r.land for r in next(iter(results.values()))]
    error.set(xlabel="rows on the land", ylabel="release against dE/dlength [%]")
    error.set_xticks(lands, [str(n) for n in lands])
    error.minorticks_off()
    along.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    """Measure, print the table, draw the figure."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out")
    folder.mkdir(parents=True, exist_ok=True)
    contact = trb.LineContact.of(trb.bearing("32008J"), "outer", design_load=3000.0)
    jobs = [(case, land) for land in LANDS for case in CASES]
    results: dict[tuple[float, float], list[Measured]] = {case: [] for case in CASES}
    for case, land in track(jobs, description="contacts", transient=True):
        results[case].append(measure(contact, *case, land))
    table = Table(title="∫K² dx/(2E') by dE/dlength; design load 3 kN")
    for heading in ("load N", "length mm", "dE/dlength N", *(f"{n} rows" for n in LANDS)):
        table.add_column(heading, justify="right")
    for (load, length), rows in results.items():
        ratios = (f"{r.release / r.slope:.4f}" for r in rows)
        table.add_row(f"{load:g}", f"{length:g}", f"{rows[-1].slope:.5f}", *ratios)
    Console().print(table)
    draw(results, folder / "energy_release.png")


if __name__ == "__main__":
    main()
