"""Whether contacts keep the accuracy that was asked for: random ones of random rollers, at 1e-2, 1e-3, 1e-4 and 1e-5.

python -m experiments.contacts_promised [SEED]   (default 5; five minutes)

Rollers 5 … 50 mm long, loads of 0.05 … 1.2 of the design load, spalls of 0.1 … 0.7 of the roller, every second single
one off its middle, every fourth roller tilted. Of 60 one third has a rolling edge in reach, one sixth a spall narrower
than the contact, one sixth a sliver of land beyond an edge, the others wide spalls, none, or two of them. The truth is
strips far finer, with as many waves as their highest frequency, and more where slivers are too thin for these: that
strips come to what cells and lattices come to is for tests. Derivatives are of the
approach by load, the spall's length, width and axial offset, its offset, radius, roller length, design load and tilt.
Their errors are by themselves or, if that is more, by a tenth of what a derivative of the size of the value would be.
Milliseconds are medians of single calls by numpy.

The second table is of what holds at any accuracy: cells carry the load and none pulls; a load one thousandth larger
sinks the roller deeper (the least step by the one that the derivative says); of tilted rollers the moment's derivative
by the load is the approach's by the tilt, for both are second ones of one energy (by half the roller's length).
"""

from __future__ import annotations

import dataclasses
import sys
import time
from typing import Any, NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb
from difftrb.contact import hollows, solver, strip_model, strip_reach
from difftrb.contact.contact_solution import Inputs, given
from difftrb.contact.strip_model import Way
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, as_floats
from experiments.accuracy_of_strips import FINEST

ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5)
KINDS = {"edge": 20, "narrow": 10, "sliver": 10, "wide": 12, "none": 3, "two spalls": 5}
SETTLED, THIN = 1e-6, 3e-6
SIZE = 0.1  # derivatives count as at least so much of the value by the input
STEP = 1e-3  # of the load


class Contact(NamedTuple):
    """A contact to solve, and what is special about it."""

    kind: str
    contact: LineContact
    load: float
    spall: Any
    offset: Any
    tilt: float


def random_contacts(seed: int) -> list[Contact]:
    """In the order of `KINDS`."""
    rng = np.random.default_rng(seed)
    kinds = [kind for kind, count in KINDS.items() for _ in range(count)]
    return [_random(rng, i, kind) for i, kind in enumerate(kinds)]


def _random(rng: np.random.Generator, i: int, kind: str) -> Contact:
    length = 5.0 * 10.0 ** rng.random()
    radius, number = length * 0.1 * 6.0 ** rng.random(), 1e-5 * 30.0 ** rng.random()
    known = as_floats(trb.LineContact.of(trb.bearing("32008J"), "outer"))
    contact = dataclasses.replace(
        known, radius=radius, length=length, design_load=number * known.modulus * length**3 / radius
    )
    load = float(contact.design_load) * 0.05 * 24.0 ** rng.random()
    healthy = _reach(Inputs(contact, load, None, 0.0, None))
    half, depth = float(healthy.unit), 100.0 * float(healthy.approach)
    tilt = float(rng.uniform(-0.7, 0.7) * healthy.approach / length) if i % 4 == 1 else 0.0
    long = length * rng.uniform(0.1, 0.7)
    aside = rng.uniform(-1.0, 1.0) * (0.42 * length - 0.5 * long) if i % 2 else 0.0
    wide = trb.Spall(long, 30.0 * half, depth, axial_offset=aside)
    if kind == "none":
        return Contact(kind, contact, load, None, 0.0, tilt)
    if kind == "wide":
        return Contact(kind, contact, load, wide, rng.uniform(-1.0, 1.0) * half, tilt)
    if kind == "two spalls":
        first = trb.Spall(0.2 * length, 30.0 * half, depth, axial_offset=-0.2 * length)
        other = trb.Spall(0.15 * length, 2.0 * half if i % 2 else 30.0 * half, depth, axial_offset=0.15 * length)
        return Contact(kind, contact, load, (first, other), (0.0, 0.3 * half), tilt)
    sunk = _reach(Inputs(contact, load, wide, 0.0, tilt or None)).approach
    reach = float(np.sqrt(2.0 * radius * sunk))
    if kind == "narrow":
        width = 2.0 * reach * rng.uniform(0.1, 1.0)
        return Contact(kind, contact, load, dataclasses.replace(wide, width=width), 0.5 * width * rng.random(), tilt)
    place = rng.random() if kind == "edge" else rng.uniform(0.6, 0.985)
    offset = 0.5 * float(wide.width) - (place * (reach + half) - half)
    return Contact(kind, contact, load, wide, offset * rng.choice([-1.0, 1.0]), tilt)


def _reach(inputs: Inputs) -> strip_reach.Reach:
    """With no rolling edge in reach."""
    return strip_reach.reach_of(inputs, hollows.of_one(inputs, 0), False)


def truth(case: Contact) -> tuple[float, np.ndarray]:
    """Approach [mm] and its derivatives by the logarithms of the inputs, by itself."""
    inputs, mirrored, _ = given(*case[1:5], case.tilt, "auto")
    inputs = xp.numbers(inputs)
    with np.errstate(all="ignore"):
        beneath = strip_reach.judged(inputs, mirrored).beneath
        way = Way(mirrored, beneath._replace(edges=int(beneath.edges)), FINEST, SETTLED, True)
        found = strip_model.solve_numbers(inputs, way)
        if found.settled.unresolved > THIN:
            way = way._replace(fine=FINEST.finer)
            found = strip_model.solve_numbers(inputs, way)
        (by,) = strip_model.gradients(found, inputs, way, 1)
    assert found.still
    assert found.settled.error < 10.0 * SETTLED
    return float(found.approach), by_logarithm(case, by, float(found.approach))


def by_logarithm(case: Contact, by: Inputs, approach: float) -> np.ndarray:
    """∂ ln δ / ∂ ln of every input that is not zero."""
    leaves = [
        (case.load, by.load), (case.contact.radius, by.contact.radius), (case.contact.length, by.contact.length),
        (case.contact.design_load, by.contact.design_load),
    ]  # fmt: skip
    spalls = case.spall if isinstance(case.spall, tuple) else () if case.spall is None else (case.spall,)
    slopes: Any = by.spall if isinstance(by.spall, tuple) else (by.spall,)
    for spall, slope in zip(spalls, slopes, strict=False):
        leaves += [(spall.length, slope.length), (spall.width, slope.width), (spall.axial_offset, slope.axial_offset)]
    leaves += list(zip(np.ravel(case.offset), np.ravel(by.offset), strict=True)) if spalls else []
    leaves += [(case.tilt, by.tilt)] if case.tilt else []
    return np.array([float(value) * float(slope) / approach for value, slope in leaves])


def measure(cases: list[Contact]) -> Table:
    """Errors of the approach and of its derivatives by accuracy: how many keep it, median and worst."""
    known = [truth(case) for case in track(cases, "truths", transient=True)]
    table = Table(
        "accuracy", "within", "within 3 ×", "median", "worst", "derivatives: median", "90 %", "within 30 ×", "ms"
    )
    for accuracy in ACCURACIES:
        off, slopes, times = [], [], []
        for case, (approach, by) in track(list(zip(cases, known, strict=True)), f"{accuracy:g}", transient=True):
            started = time.perf_counter()
            solution = trb.solve_contact(*case[1:5], accuracy, tilt=case.tilt).check()
            times.append(1e3 * (time.perf_counter() - started))
            _, gradient = solver.approach_and_gradient(*case[1:5], accuracy, tilt=case.tilt)
            off.append(abs(float(solution.approach) / approach - 1.0))
            error = by_logarithm(case, gradient, approach) - by
            slopes.append(float(np.max(np.abs(error) / np.maximum(np.abs(by), SIZE))))
        count = len(cases)
        table.add_row(
            f"{accuracy:g}",
            f"{np.sum(np.array(off) <= accuracy)} of {count}",
            f"{np.sum(np.array(off) <= 3.0 * accuracy)} of {count}",
            *(f"{np.quantile(off, q):.1e}" for q in (0.5, 1.0)),
            *(f"{np.quantile(slopes, q):.1e}" for q in (0.5, 0.9)),
            f"{np.sum(np.array(slopes) <= 30.0 * accuracy)} of {count}",
            f"{np.median(times):.1f}",
        )
    return table


def laws(cases: list[Contact]) -> Table:
    """What any contact does: the worst of all of them, by accuracy."""
    table = Table(
        "accuracy", "force by load less one", "least force by load", "least step by its derivative",
        "∂M/∂Q less ∂δ/∂tilt: median", "worst",
    )  # fmt: skip
    for accuracy in ACCURACIES:
        force, pull, step, moment = [], [], [], []
        for case in track(cases, f"{accuracy:g}", transient=True):
            solution, by, moment_by = solver.approach_and_gradient(*case[1:5], accuracy, tilt=case.tilt, moment=True)
            forces, load = np.asarray(solution.force), case.load
            force.append(abs(forces.sum() / load - 1.0))
            pull.append(forces.min() / load)
            more = trb.solve_contact(case.contact, load * (1.0 + STEP), *case[3:5], accuracy, tilt=case.tilt)
            step.append((float(more.approach) - float(solution.approach)) / (STEP * load * float(by.load)))
            if case.tilt:
                moment.append(2.0 * abs(float(moment_by.load) - float(by.tilt)) / float(case.contact.length))
        table.add_row(
            f"{accuracy:g}", f"{max(force):.1e}", f"{min(pull):.1e}", f"{min(step):.2f}", f"{np.median(moment):.1e}",
            f"{max(moment):.1e}",
        )  # fmt: skip
    return table


def main() -> None:
    cases, console = random_contacts(int(sys.argv[1]) if len(sys.argv) > 1 else 5), Console(width=140)
    console.print(measure(cases))
    console.print(laws(cases))


if __name__ == "__main__":
    main()
