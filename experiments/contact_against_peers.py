"""Error against time of one roller contact: difftrb beside Tamaas and ContactMechanics, on one core.

taskset -c 0 python experiments/contact_against_peers.py [--json FILE] [--out DIR] [--repeats N]

The same contacts of 32008J's outer raceway for everybody, with their continuum limits. The peers get what a user of
theirs would give them: a uniform grid over the roller and ± 2.8 Hertz half-widths, the paper's sharp mask on its cells
(Liu et al. 2018, eq. 3), the free-space half-space, and the loosest tolerance (in decades) at which every approach
stands within 1e-6 of that grid's own. Their kernels are ready before the clock starts; difftrb's are inside its times.
difftrb is timed in one jitted batch (`jax.lax.map`) and as single calls of `solve_contact`. Times are means over the
contacts of medians over repeats, in the processor's time, which other programs on that core do not add to; compiling is
apart. Peers that are not installed are left out (`pip install 'difftrb[peers]'`).
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import itertools
import json
import os
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import difftrb as trb
from difftrb.accuracy.ladder import CONTACT, DEPTH, TRUTHS, WIDTH, Truth
from difftrb.contact import gap as gaps
from difftrb.contact import ways
from difftrb.contact.contact_solution import Inputs
from difftrb.contact.grids import GRIDS
from difftrb.report import figure_style

OUT, IN = "rolling edges out of reach", "a rolling edge in the contact"
CHOSEN = {
    OUT: ((3000.0, 0.0, 0.0), (3000.0, 2.0, 0.0), (1000.0, 4.0, 0.0), (3000.0, 8.0, 0.0), (10000.0, 8.0, 0.0)),
    IN: ((3000.0, 2.0, 0.40), (3000.0, 2.0, 0.46), (3000.0, 2.0, 0.50)),
}
CASES = {group: tuple(case for case in TRUTHS if case[:3] in of) for group, of in CHOSEN.items()}
Way = Literal["strips", "cells"]
ACCURACIES: dict[Way, tuple[float, ...]] = {"strips": tuple(GRIDS), "cells": (1e-2, 1e-3, 1e-4)}  # cells end at 1e-4
UNIFORM = ((40, 400), (80, 800))
REACH = 2.8  # of a peer's grid, in Hertz half-widths
DECADES = tuple(10.0**-k for k in range(3, 11))
SETTLED = 1e-6  # relative to a grid's own approach

PEERS = {"Tamaas": "tamaas", "ContactMechanics": "ContactMechanics"}  # name and module


@dataclasses.dataclass(frozen=True)
class Row:
    """What one way to solve reached on one group of contacts: errors relative to the continuum, ms per solve, seconds
    before the first answer (compiling), unknowns, and how many times slower it is than the fastest batch of difftrb's
    that is no less exact (None without one)."""

    group: str
    solver: str
    setting: str
    unknowns: int
    worst: float
    median: float
    milliseconds: float
    compile_seconds: float = 0.0
    ratio: float | None = None


# ---------------------------------------------------------------------------------------------------------- peers


def uniform(case: Truth, columns: int, rows: int) -> tuple[tuple[float, float], np.ndarray]:
    """Sides of the domain and the gap at the cells' middles [mm], shape (columns, rows)."""
    b = float(gaps.line_half_width(case.load / CONTACT.length, CONTACT.radius, CONTACT.modulus))
    sides = 2.0 * REACH * b, float(CONTACT.length)
    x, y = (side * ((np.arange(n) + 0.5) / n - 0.5) for side, n in zip(sides, (columns, rows), strict=True))
    scale = float(CONTACT.design_load / (np.pi * CONTACT.modulus * CONTACT.length))
    gap = (x**2 / (2.0 * CONTACT.radius))[:, None] - scale * np.log1p(-((2.0 * y / CONTACT.length) ** 2))[None, :]
    hollow = (np.abs(x - case.offset) < 0.5 * WIDTH)[:, None] & (np.abs(y) < 0.5 * case.length)[None, :]
    return sides, gap + DEPTH * hollow


def by_tamaas(module: Any, sides: tuple[float, float], gap: np.ndarray, load: float) -> Callable[[float], Callable]:
    """Tamaas, ready to solve; returns a function of the tolerance that solves and returns how to read the approach."""
    module.set_log_level(module.LogLevel.error)
    model = module.ModelFactory.createModel(module.model_type.basic_2d, list(sides), list(gap.shape))
    model.E, model.nu = float(CONTACT.modulus), 0.0
    module.ModelFactory.registerNonPeriodic(model, "free")

    def approach() -> float:
        pressure, lifted = np.array(model.traction), np.zeros(gap.shape)
        model.operators["free"](pressure, lifted)
        return float(np.vdot(pressure, lifted + gap) / np.sum(pressure))

    def solve(tolerance: float) -> Callable:
        model.traction[:] = 0.0
        solver = module.PolonskyKeerRey(model, -gap, tolerance)
        solver.setIntegralOperator("free")
        solver.max_iter = 20000
        return approach if solver.solve(load / (sides[0] * sides[1])) <= tolerance else lambda: float("nan")

    return solve


def by_contactmechanics(
    module: Any, sides: tuple[float, float], gap: np.ndarray, load: float
) -> Callable[[float], Callable]:
    """ContactMechanics, as `by_tamaas`; its tolerance is a penetration, here relative to the deepest undeformed one."""
    topography = importlib.import_module("SurfaceTopography").Topography(-gap, sides)
    substrate = module.FreeFFTElasticHalfSpace(gap.shape, float(CONTACT.modulus), sides)
    system = module.Systems.NonSmoothContactSystem(substrate, topography)
    b = float(gaps.line_half_width(load / CONTACT.length, CONTACT.radius, CONTACT.modulus))
    depth = b * b / (2.0 * float(CONTACT.radius))

    def solve(tolerance: float) -> Callable:
        bounds = {"pentol": tolerance * depth, "forcetol": tolerance * load, "thermotol": tolerance}
        found = system.minimize_proxy(external_force=load, maxiter=20000, **bounds)
        return lambda: float(found.offset) if found.success else float("nan")

    return solve


BY = {"Tamaas": by_tamaas, "ContactMechanics": by_contactmechanics}


def installed(name: str) -> Any:
    """The peer's module, or None if it is not installed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ContactMechanics warns at import that it runs without MPI
        try:
            module = importlib.import_module(PEERS[name])
            if name == "ContactMechanics":
                importlib.import_module("ContactMechanics.Systems")
            return module
        except ImportError:
            return None


def loosest(solves: Sequence[Callable[[float], Callable]]) -> tuple[float, np.ndarray]:
    """The loosest tolerance at which all approaches stand within `SETTLED` of the tightest, and these approaches."""
    final = np.array([solve(DECADES[-1])() for solve in solves])
    for tolerance in DECADES:
        found = np.array([solve(tolerance)() for solve in solves])
        if np.all(np.abs(found / final - 1.0) <= SETTLED):
            return tolerance, found
    raise RuntimeError(f"no tolerance down to {DECADES[-1]:g} settles the approach to {SETTLED:g}")


def peer_row(name: str, group: str, cases: Sequence[Truth], size: tuple[int, int], repeats: int) -> Row:
    """One peer on one uniform grid; the peer must be installed."""
    module = installed(name)
    solves = [BY[name](module, *uniform(case, *size), case.load) for case in cases]
    tolerance, found = loosest(solves)
    seconds = [clock(lambda solve=solve: solve(tolerance), repeats) for solve in solves]
    setting = f"{size[0]} × {size[1]}, tolerance {tolerance:.0e}"
    return Row(group, name, setting, size[0] * size[1], *errors(found, cases), 1e3 * float(np.mean(seconds)))


# -------------------------------------------------------------------------------------------------------- difftrb


def batch_row(method: Way, group: str, cases: Sequence[Truth], accuracy: float, repeats: int) -> Row:
    """difftrb, all contacts of a group in one jitted `jax.lax.map`."""

    def one(case: jax.Array) -> tuple[jax.Array, jax.Array]:
        arguments = CONTACT, case[0], trb.Spall(case[1], WIDTH, DEPTH), case[2]
        if method == "strips":
            s = ways.by_strips(
                Inputs(*arguments), True, int(group == IN), accuracy
            )  # what "auto" chooses for this group
        else:
            s = trb.solve_contact(*arguments, accuracy, method)
        return s.approach, s.unknowns

    rows = jnp.array([(c.load, c.length, c.offset) for c in cases])
    started = time.process_time()
    compiled = jax.jit(lambda r: jax.lax.map(one, r)).lower(rows).compile()
    to_compile = time.process_time() - started
    found, unknowns = compiled(rows)
    each = clock(lambda: jax.block_until_ready(compiled(rows)), repeats) / len(cases)
    return own_row(method, group, f"{accuracy:g}, batch", unknowns, np.asarray(found), cases, each, to_compile)


def single_row(method: Way, group: str, cases: Sequence[Truth], accuracy: float, repeats: int) -> Row:
    """difftrb, one public call for every contact."""

    def one(case: Truth) -> trb.ContactSolution:
        spall = trb.Spall(case.length, WIDTH, DEPTH)
        return jax.block_until_ready(trb.solve_contact(CONTACT, case.load, spall, case.offset, accuracy, method))

    started = time.process_time()
    one(cases[0])
    first = time.process_time() - started
    solutions = [one(case) for case in cases]
    found = np.array([float(s.approach) for s in solutions])
    seconds = [clock(lambda case=case: one(case), repeats) for case in cases]
    unknowns = np.array([int(s.unknowns) for s in solutions])
    setting = f"{accuracy:g}, single"
    return own_row(method, group, setting, unknowns, found, cases, float(np.mean(seconds)), first - seconds[0])


def own_row(
    method: Way,
    group: str,
    setting: str,
    unknowns: Any,
    found: np.ndarray,
    cases: Sequence[Truth],
    each: float,
    to_compile: float,
) -> Row:
    reached = errors(found, cases)
    return Row(group, f"difftrb, {method}", setting, int(np.max(unknowns)), *reached, 1e3 * each, to_compile)


# ---------------------------------------------------------------------------------------------------- measuring


def clock(function: Callable, repeats: int) -> float:
    """Median seconds of the processor's time of a call."""
    times = []
    for _ in range(repeats):
        started = time.process_time()
        function()
        times.append(time.process_time() - started)
    return float(np.median(times))


def errors(found: np.ndarray, cases: Sequence[Truth]) -> tuple[float, float]:
    """Worst and median error relative to the continuum; NaN if a solve failed."""
    error = np.abs(found / np.array([case.approach for case in cases]) - 1.0)
    return float(np.max(error)), float(np.median(error))


def with_ratios(rows: Sequence[Row]) -> list[Row]:
    """The rows with their time divided by that of the fastest difftrb batch no less exact."""

    def ratio(row: Row) -> float | None:
        batches = [r for r in rows if r.group == row.group and r.setting.endswith("batch") and r.worst <= row.worst]
        return row.milliseconds / min(r.milliseconds for r in batches) if batches else None

    return [dataclasses.replace(row, ratio=ratio(row)) for row in rows]


def tasks(
    groups: Mapping[str, Sequence[Truth]],
    peers: Sequence[str],
    grids: Sequence[tuple[int, int]],
    accuracies: dict[Way, tuple[float, ...]],
    repeats: int,
) -> Iterator[Callable[[], Row]]:
    """Everything to measure, as functions without arguments."""
    for group, cases in groups.items():
        for name in peers:
            for size in grids:
                yield lambda n=name, g=group, c=cases, s=size: peer_row(n, g, c, s, repeats)
        for method, levels in accuracies.items():
            for accuracy, row in itertools.product(levels, (batch_row, single_row)):
                yield lambda f=row, m=method, g=group, c=cases, a=accuracy: f(m, g, c, a, repeats)


LOOKS: dict[str, tuple[str, str]] = {  # colour-blind safe (Tol, bright): colour, marker
    "Tamaas": (figure_style.SPALLED, "s"),
    "ContactMechanics": ("#CCBB44", "D"),
    "difftrb, strips": (figure_style.HEALTHY, "o"),
    "difftrb, cells": ("#AA3377", "^"),
}


def draw(rows: Sequence[Row], ax: Axes, group: str, doubt: float) -> None:
    """Worst error over time for one group of contacts; below `doubt` the truths themselves are in doubt."""
    ax.axhspan(1e-12, doubt, color="0.9", zorder=0, lw=0)
    ax.text(
        0.99,
        0.015,
        "grey: the continuum values are in doubt",
        transform=ax.transAxes,
        ha="right",
        fontsize=8,
        color="0.35",
    )
    for solver, (colour, marker) in LOOKS.items():
        for kind, line in (("batch", "-"), ("single", ":"), ("", "--")):
            chosen = [r for r in rows if r.group == group and r.solver == solver and kind_of(r) == kind]
            if not chosen:
                continue
            name = f"{solver}{', ' + kind if kind else ''}"
            times, worst = [r.milliseconds for r in chosen], [r.worst for r in chosen]
            face = "white" if kind == "single" else colour
            ax.loglog(times, worst, line, color=colour, marker=marker, mfc=face, ms=7, lw=1.5, label=name)
            if solver == "Tamaas" or kind == "batch":
                for r in chosen:
                    note(ax, r, colour)
    ax.set_xlabel("time per solve [ms], one core")
    ax.set_title(group)
    ax.grid(True, which="major", color="0.85", lw=0.6)
    ax.set_axisbelow(True)


def note(ax: Axes, row: Row, colour: str) -> None:
    """The row's grid or accuracy beside its mark."""
    text = row.setting.split(",")[0]
    above = "×" in text
    name = text if above else f"{float(text):.0e}".replace("e-0", "e-")
    right = "cells" in row.solver
    beside = (0, 9) if above else (8, 3) if right else (-7, -4)
    style = {
        "ha": "center" if above else "left" if right else "right", "va": "bottom" if above or right else "top",
        "fontsize": 8, "color": colour,
    }  # fmt: skip
    ax.annotate(name, (row.milliseconds, row.worst), beside, textcoords="offset points", **style)


def kind_of(row: Row) -> str:
    """ "batch", "single", or "" for a peer."""
    return row.setting.rsplit(", ", 1)[1] if row.solver.startswith("difftrb") else ""


def figure(rows: Sequence[Row], groups: Mapping[str, Sequence[Truth]], folder: Path) -> None:
    """Work–precision diagram into `folder`, PNG and SVG."""
    drawing, axes = plt.subplots(
        1, len(groups), figsize=(5.4 * len(groups), 5.0), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for ax, (group, cases) in zip(axes[0], groups.items(), strict=True):
        draw(rows, ax, group, max(case.doubt for case in cases))
    axes[0, 0].set_ylabel("worst error of the approach against the continuum [-]")
    worst = [r.worst for r in rows if np.isfinite(r.worst)]
    axes[0, 0].set_ylim(0.3 * min(worst), 3.0 * max(worst))
    axes[0, 0].margins(x=0.1)
    handles = {name: handle for ax in axes[0] for handle, name in zip(*ax.get_legend_handles_labels(), strict=True)}
    drawing.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3, frameon=False)
    folder.mkdir(parents=True, exist_ok=True)
    figure_style.save(axes[0, 0], folder, "contact_against_peers")


def table(rows: Sequence[Row], group: str) -> Table:
    """One group's rows as a table."""
    printed = Table(title=f"{group}; error of the approach against the continuum", title_style="")
    for heading in ("solver", "setting", "unknowns", "worst", "median", "ms", "ratio", "compile s"):
        printed.add_column(heading, justify="left" if heading in ("solver", "setting") else "right")
    for r in rows:
        if r.group == group:
            ratio = "–" if r.ratio is None else f"{r.ratio:.3g}"
            numbers = f"{r.worst:.1e}", f"{r.median:.1e}", f"{r.milliseconds:.3g}", ratio, f"{r.compile_seconds:.1f}"
            printed.add_row(r.solver, r.setting, str(r.unknowns), *numbers)
    return printed


def main() -> None:
    """Measure all, print the tables, write what was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the figure, PNG and SVG")
    parser.add_argument("--repeats", type=int, default=5, help="of every timing (default 5)")
    given = parser.parse_args()
    console = Console()
    there = [name for name in PEERS if installed(name) is not None]
    for name in PEERS.keys() - there:
        console.print(f"{name} is not installed and left out: pip install 'difftrb[peers]'")
    work = list(tasks(CASES, there, UNIFORM, ACCURACIES, given.repeats))
    rows = []
    with Progress(console=console, transient=True) as progress:
        for task in progress.track(work, description="solvers"):
            rows.append(task())
    rows = with_ratios(rows)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    for group in CASES:
        console.print(table(rows, group))
    console.print(f"ratio: time by that of the fastest difftrb batch no less exact; cores in use: {cores}")
    if given.json:
        record = {"cores": cores, "repeats": given.repeats, "rows": [dataclasses.asdict(r) for r in rows]}
        given.json.write_text(json.dumps(record, indent=1), encoding="utf-8")
    if given.out:
        figure(rows, CASES, given.out)


if __name__ == "__main__":
    main()
