"""Error against time of a ring: difftrb's laws beside scipy on the same law, and beside the paper's own procedure.

taskset -c 0 python -m experiments.ring_against_peers [--json FILE] [--out DIR]

32008J under 9000/4500 N with a spall of 4 × 7 mm under one roller. Everybody's radial and axial tangent stiffness is
compared with that by contacts solved at 1e-4. scipy (`optimize.root`, with derivatives, in numpy) finds the equilibrium
on the curves of the table and of the power law that difftrb made. The paper's procedure is 75 contacts on 40 × 400
uniform cells by conjugate gradients and Fourier transforms, a power law fitted to them for each of five lengths, and
scipy: on the domain with which its Table 2 comes out, which cuts the contact off, and on one that holds it. Compiling
is apart; times are medians.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import cast

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import difftrb as trb
from difftrb.accuracy import timing
from difftrb.accuracy.accuracy_report import WAYS
from difftrb.accuracy.ladder import Measured, Rung
from difftrb.core import machine
from difftrb.law.base import Law
from difftrb.report import figure_style
from difftrb.scene import scene_file
from difftrb.scene.scene import raceway_contact
from experiments import by_scipy
from experiments.paper import clipped, common

RUNGS = tuple(
    Rung("ring", way, a)
    for way, a in (
        ("liu2018", 1e-3), ("palmgren", 1e-3), ("power", 1e-2), ("power", 1e-3), ("direct", 1e-2), ("direct", 1e-3),
        ("direct", 1e-4), ("table", 1e-3), ("table", 1e-4),
    )
)  # fmt: skip
BATCH = 4096
WHOLE = 1.4
"""Half width of a domain that holds the contact, by Hertz's."""
PEERS = {"scipy": ("P", "#228833"), "the paper's procedure": ("X", "#AA3377")}


@dataclasses.dataclass(frozen=True)
class Row:
    """One way to the ring's stiffness: its error, the larger of radial and axial [-]; seconds to make the law once
    compiled, to solve one ring by it, and one of a batch (None: there are no batches)."""

    solver: str
    setting: str
    error: float
    law: float
    ring: float
    each: float | None


def own_rows(measured: Measured) -> list[Row]:
    """difftrb's."""
    return [
        Row("difftrb", row.rung.name, row.error, row.again, row.single, row.each)
        for row in measured.rows if row.status == "converged"
    ]  # fmt: skip


def by_paper(contact: trb.LineContact, reach: float, size: tuple[int, int]) -> tuple[trb.PowerLaw, float]:
    """Its law from 75 contacts on a domain of ±`reach` Hertz half widths, and seconds for that."""
    loads, lengths = jnp.asarray(clipped.LOADS), jnp.asarray(common.LENGTHS)

    def fit() -> trb.PowerLaw:
        found = clipped.approaches(contact, loads, lengths, reach, size)
        return common.as_law(clipped.power_fit(clipped.LOADS, np.asarray(found)), clipped.LOADS)

    return machine.timed(fit, 3)


def peer_rows(
    scene: trb.Scene, measured: Measured, scipy_on: tuple[str, ...] = ("table 1e-3", "power 1e-3"),
    size: tuple[int, int] = clipped.PAPER_GRID,
) -> list[Row]:  # fmt: skip
    """scipy's on laws that difftrb made and measured, and the paper's."""
    truth = measured.truth("ring")
    assert truth is not None
    exact = np.array([truth.values["radial_stiffness"], truth.values["axial_stiffness"]])

    def row(solver: str, setting: str, law: Law, seconds: float) -> Row:
        (stiffness, _), each = machine.timed(by_scipy.in_numpy(dataclasses.replace(scene, law=law)), 21)
        found = np.diag(stiffness)[[0, 2]]
        return Row(solver, setting, float(np.max(np.abs(found / exact - 1.0))), seconds, each, None)

    rows = []
    for own in measured.rows:
        if own.rung.name in scipy_on:
            law = trb.prepare(dataclasses.replace(scene, law=own.rung.way, accuracy=own.rung.accuracy)).law
            rows.append(row("scipy", own.rung.name, cast(Law, law), own.again))
    contact = raceway_contact(scene, "outer")
    for name, reach in (("40×400, clipped", clipped.NARROWED), ("40×400, whole", WHOLE)):
        rows.append(row("the paper's procedure", name, *by_paper(contact, reach, size)))
    return rows


def draw(rows: list[Row], known_to: float, out: Path) -> None:
    """Error against the time of a new scene, law and all, and against that of one more ring by the same law."""
    _, panels = plt.subplots(1, 2, figsize=(9.6, 4.0), sharey=True, layout="constrained")
    for ax, more in zip(panels, (False, True), strict=True):
        ax.axhspan(1e-12, known_to, color="0.9", lw=0, zorder=0)
        for solver, way in dict.fromkeys((r.solver, r.setting.split()[0]) for r in rows):
            own = [r for r in rows if r.solver == solver and (solver != "difftrb" or r.setting.split()[0] == way)]
            marker, colour = WAYS[way] if solver == "difftrb" else PEERS[solver]
            style = {"marker": marker, "color": colour, "ms": 8, "lw": 1.0, "linestyle": "none", "mec": "black",
                     "mew": 0.6, "label": f"difftrb, {way}" if solver == "difftrb" else solver}  # fmt: skip
            errors = [r.error for r in own]
            ax.loglog([r.ring if more else r.law + r.ring for r in own], errors, **style)
            for note, at in _notes(own) if solver != "scipy" and not more else ():
                ax.annotate(note, at, (3, 5), textcoords="offset points", rotation=40, fontsize=8)
            if more and solver == "difftrb":
                ax.loglog([r.each for r in own], errors, **style | {"mfc": "none", "mec": colour, "label": None})
        ax.grid(which="major", color="#DDDDDD", lw=0.6)
        ax.set_axisbelow(True)
        ax.margins(0.12)
        ax.set_xlabel("one more ring by that law [s]; hollow: in a batch" if more else "a new scene, law and ring [s]")
    worst = [r.error for r in rows if r.error > 0.0]
    panels[0].set_ylim(0.5 * min(worst), 2.0 * max(worst))
    panels[0].set_ylabel("error of stiffness [–]")
    panels[0].text(0.02, 0.02, "grey: the truth is in doubt", transform=panels[0].transAxes, fontsize=8)
    handles = dict(zip(*reversed(panels[0].get_legend_handles_labels()), strict=True))
    panels[0].figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False)
    out.mkdir(parents=True, exist_ok=True)
    figure_style.save(panels[0], out, "ring_against_peers")


def _notes(own: list[Row]) -> list[tuple[str, tuple[float, float]]]:
    """What to write at rows of one way, in order, and where; neighbours that would be written over share a note."""
    notes: list[tuple[str, tuple[float, float]]] = []
    for r in own:
        note, at = r.setting.partition(" ")[2], (r.law + r.ring, r.error)
        if notes and np.hypot(*np.log10(np.divide(at, notes[-1][1]))) < 0.3:
            note = f"{notes.pop()[0].partition(' … ')[0]} … {note}"
        notes.append((note, at))
    return notes


def main() -> None:
    """Measure, print, and write what was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the figure, PNG and SVG")
    given = parser.parse_args()
    file = scene_file.parse(scene_file.example("spall"))
    with Progress(transient=True) as progress:
        task = progress.add_task("laws")
        measured = timing.measure(
            file, rungs=RUNGS, limit=np.inf, batch=BATCH,
            progress=lambda done, total: progress.update(task, completed=done, total=total + 1),
        )  # fmt: skip
        rows = own_rows(measured) + peer_rows(file.scene(), measured)
    truth = measured.truth("ring")
    assert truth is not None
    table = Table(title=f"stiffness against contacts at 1e-4, themselves known to {truth.error:.1e}", title_style="")
    for heading in ("solver", "law", "error", "law [s]", "ring [µs]", "in a batch [µs]"):
        table.add_column(heading, justify="left" if heading in ("solver", "law") else "right")
    for r in rows:
        each = "–" if r.each is None else f"{1e6 * r.each:.3g}"
        table.add_row(r.solver, r.setting, f"{r.error:.1e}", f"{r.law:.3g}", f"{1e6 * r.ring:.3g}", each)
    Console(width=100).print(table)
    if given.json:
        given.json.write_text(json.dumps([dataclasses.asdict(r) for r in rows], indent=1) + "\n", encoding="utf-8")
    if given.out:
        draw(rows, truth.error, given.out)


if __name__ == "__main__":
    main()
