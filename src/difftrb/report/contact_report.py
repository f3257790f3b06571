"""What `difftrb contact` does: one roller on its raceway solved, and its result for people and for machines."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import jax
import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from difftrb.contact.contact_solution import ContactSolution
from difftrb.contact.solver import approach_and_slopes, pressure_patches
from difftrb.report import console, remarks
from difftrb.report.console import Figures
from difftrb.report.tables import house_table, number, plain
from difftrb.scene import scene_file
from difftrb.scene.file_schema import SceneFile

CONTACT_INPUTS = ("load", "length", "width", "offset", "radius", "design_load")


def deliver(options: Any, file: SceneFile, path: str) -> int:
    """Solve a file's contact, print it and write it where `options` ask; the exit code."""
    scene_file.check_contact(file, path)
    console.remark(path, remarks.odd_contact_load(file))
    started = time.perf_counter()
    with console.busy("solving the contact"):
        solution, slopes = jax.block_until_ready(approach_and_slopes(**file.single_contact()))
    record = contact_json(solution, slopes, time.perf_counter() - started)

    def figures() -> Figures:
        from difftrb.report import pressure_figure

        yield "pressure", pressure_figure.pressure_map(solution, patches=pressure_patches(**file.single_contact())[1])

    return console.deliver(options, path, record, partial(contact_text, solution, slopes), figures)


def contact_json(solution: ContactSolution, slopes: dict[str, Any], seconds: float) -> dict[str, Any]:
    """A single contact's result; `slopes` are derivatives of the approach [mm per unit of the input], by the sizes of
    several spalls one each."""
    return plain({
        "status": solution.status,
        "converged": bool(solution.converged),
        "approach": solution.approach,
        "peak_pressure": solution.peak_pressure,
        "contact_width": solution.contact_width,
        "loaded_fraction": solution.loaded_fraction,
        "residual": solution.residual,
        "iterations": solution.iterations,
        "unknowns": solution.unknowns,
        "sensitivity": slopes,
        "accuracy": solution.accuracy,
        "seconds": seconds,
    })  # fmt: skip


def contact_text(solution: ContactSolution, slopes: dict[str, Any]) -> RenderableType:
    """A single contact's result for people."""
    table = house_table("Contact")
    table.show_header = False
    table.add_row("load", f"{solution.load:,.1f} N (contact.load, of one roller; not load.radial)")
    table.add_row("approach", f"{1e3 * solution.approach:.4f} µm")
    table.add_row("peak pressure", f"{solution.peak_pressure:,.0f} MPa (a cell's mean; singular at a sharp edge)")
    table.add_row("contact width", f"{solution.contact_width:.4f} mm")
    table.add_row("loaded length", f"{100.0 * solution.loaded_fraction:.1f} % of the roller")
    units = {"load": "N"} | dict.fromkeys(CONTACT_INPUTS[1:5], "mm") | {"design_load": "N"}
    derivatives = house_table("Derivative of the approach")
    derivatives.add_column("by")
    derivatives.add_column("", justify="right")
    for name, value in slopes.items():
        each = "–" if value is None else ", ".join(number(1e3 * v, "+.5g") for v in np.atleast_1d(np.asarray(value)))
        derivatives.add_row(name, each if each == "–" else f"{each} µm/{units[name]}")
    rows, columns = solution.force.shape
    last = (
        f"{solution.status}; {rows} × {columns} cells, settled to {solution.residual:.1e} of the approach after "
        f"{solution.iterations} steps; accuracy asked for {solution.accuracy:g}"
    )
    return Group(table, derivatives, Text(last))
