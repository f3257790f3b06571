"""What `difftrb stiffness` says and writes."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from rich.table import Table

from difftrb.report import run_report, terminal
from difftrb.scene import scene_file
from difftrb.turning import turn_file
from difftrb.turning.cage_turn import CageTurn, stiffness

SHOWN = 3
"""Axes whose own stiffness is shown: radial, lateral, axial."""


def deliver(options: Any, file: scene_file.SceneFile, path: str) -> int:
    """Solve a scene over its cage's angle, print it and write it where `options` ask; the exit code."""
    scene_file.check_ring(file, path)
    with terminal.bar("solving the ring over the cage's angle") as progress:
        turn = stiffness(file.scene(), options.phases, slopes=options.slopes or None, progress=progress)
    if not np.all(np.asarray(turn.converged)):
        return terminal.refuse(f"{path}: {turn.status}", terminal.EXIT_NO_SOLUTION)
    turn = turn.in_series(*(springs(one, turn) for one in (options.shaft, options.housing) if one is not None))
    found = turn_file.table(turn, options.units, options.speed)
    if options.out is not None:
        turn_file.write(turn, options.out, options.units, options.speed)
    if options.json:
        print(json.dumps(turn_file.record(found), indent=1))
        return terminal.EXIT_OK
    terminal.show(text(found))
    if found.frequencies is not None:
        hertz = (f"{name.upper()} {float(value):.4g}" for name, value in vars(found.frequencies).items())
        terminal.show(f"frequencies [Hz] at {options.speed:g} rev/min: {', '.join(hertz)}")
    if options.out is not None:
        terminal.show(f"written to {options.out}")
    return terminal.EXIT_OK


def springs(given: str, turn: CageTurn) -> np.ndarray:
    """ "RADIAL,AXIAL" [N/mm] as stiffness along all axes; rigid against tilt. Raises `SceneError`."""
    try:
        radial, axial = (float(part) for part in given.split(","))
    except ValueError:
        radial = axial = -1.0
    if not (0.0 < radial < np.inf and 0.0 < axial < np.inf):
        raise scene_file.SceneError(f"a stiffness in series = {given}: give RADIAL,AXIAL in N/mm, both above 0")
    return np.array([radial, radial, axial, *[1e30] * (turn.stiffness.shape[-1] - SHOWN)])


def text(found: turn_file.Table) -> Table:
    """Mean, least, largest, and the first orders of every axis' own stiffness."""
    unit = found.unit["stiffness"][0][0]
    table = run_report.house_table(f"Stiffness over the cage's angle, tangent dF/du [{unit}]")
    names = ["mean", "least", "largest", *(f"order {n}" for n in found.orders.get("order", [])[1:4])]
    for heading in ("", *names):
        table.add_column(heading, justify="right" if heading else "left")
    for k, axis in enumerate(found.axes[:SHOWN]):
        own = found.arrays["stiffness"][:, k, k]
        sizes = np.abs(found.orders["stiffness"][1:4, k, k]) if found.orders else []
        table.add_row(axis, *(f"{value:.5g}" for value in (own.mean(), own.min(), own.max(), *sizes)))
    return table
