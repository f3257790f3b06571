"""Which way a contact is solved: by strips, by cells or on a lattice, of numbers and in programs.

What strips can take is `strip_reach`'s to say, before they are tried; what they found, `strip_model`'s; maps, and
several spalls in a program, leave no choice (`contact_solution`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import cell_solve, contact_cells, hollows, host_call, strip_model, strip_reach
from difftrb.contact.contact_solution import ContactSolution, Inputs, Method, assembled
from difftrb.contact.grids import GRIDS, accuracy_met, grid_for
from difftrb.contact.hollows import Beneath
from difftrb.contact.strip_model import Way
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.jax_config import jit_quickly

THIN, FINER = 1.0, 2
"""By the accuracy, what slivers beyond a rolling edge may leave in the approach that are too thin for strips' waves:
with more, they are solved again with waves half as long, at most so many times. Numbers only: a program is as it is."""


# ------------------------------------------------------------------------------------------ of numbers


def first_that_does(
    method: Method,
    inputs: Inputs,
    mirrored: bool,
    accuracy: float,
    by: Callable[[Method, Beneath | None, float], tuple],
) -> tuple:
    """What the way named by `method` returns or, for "auto", strips if they do, else strips of another fineness, else
    cells. For numbers only.

    `by` takes a way, what strips have beneath, and an accuracy; it returns a `ContactSolution` first.
    """
    with np.errstate(all="ignore"):  # what comes of bad inputs has a status
        if method in ("cells", "lattice"):
            return by(method, None, accuracy)
        beneath, fits, within = strip_reach.judged(inputs, mirrored)
        beneath = beneath._replace(edges=int(beneath.edges))
        if method == "strips":
            return by("strips", beneath, accuracy)
        suited = fits and (within or not _is_strict(accuracy))
        for own in (accuracy, *_others(accuracy)) if suited else ():
            result = by("strips", beneath, own)
            code = int(result[0].status_code)
            if code == status.CONVERGED:
                return result
            if code != status.NOT_CONVERGED:  # finer ones say the same
                break
        if method == "numpy":
            return by("strips", beneath, accuracy)
        # beside a sliver of land at the roller's end cells are ten times as far off: finer ones, where there are any
        return by("cells", None, _others(accuracy)[0] if fits and not within else accuracy)


def _is_strict(accuracy: float) -> bool:
    """Whether strips must not stand over a spall that goes on to the roller's end: `strip_reach.ends_within`."""
    return accuracy_met(accuracy) < max(GRIDS)


def _others(accuracy: float) -> list[float]:
    """The two next finer accuracies; where there are not two, coarser ones."""
    own = accuracy_met(accuracy)
    return ([a for a in GRIDS if a < own] + [a for a in reversed(GRIDS) if a > own])[:2]


def of_numbers(
    inputs: Inputs, mirrored: bool, gradients: int, method: Method, beneath: Beneath | None, accuracy: float
) -> tuple[Any, ...]:
    """The solved contact and so many gradients by its inputs: of the approach, of the moment. Strips and where cells
    lie are computed by numpy."""
    if beneath is not None:
        solution, found, way = strips_of_numbers(inputs, mirrored, beneath, accuracy)
        return solution, *(strip_model.gradients(found, inputs, way, gradients) if gradients else ())
    if method == "cells":
        cells = grid_for(accuracy).cells_over(inputs.spall)
        solution, every = cell_solve.solve_numbers(inputs, cells, mirrored, accuracy, gradients)
        return solution, *every
    return _lattice_slopes(inputs, accuracy, gradients) if gradients else (in_program(method, inputs, False, accuracy),)


def strips_of_numbers(
    inputs: Inputs, mirrored: bool, beneath: Beneath, accuracy: float
) -> tuple[ContactSolution, strip_model.Strips, Way]:
    """The contact by strips, finer ones where slivers are too thin for these; what they found, and by which."""
    way = _way(mirrored, beneath, accuracy)
    found = strip_model.solve_numbers(inputs, way)
    for _ in range(FINER):
        if not found.settled.unresolved > THIN * accuracy:
            break
        way = way._replace(fine=way.fine.finer)
        found = strip_model.solve_numbers(inputs, way)
    return _laid_out(inputs, found, way, accuracy), found, way


@jit_quickly(static_argnames=("accuracy", "gradients"))
def _lattice_slopes(inputs: Inputs, accuracy: float, gradients: int) -> tuple:
    """The same on a lattice: of the approach and, if two are asked for, of the moment."""

    def both(inputs: Inputs) -> tuple[jax.Array, ContactSolution]:
        solution = in_program("lattice", inputs, False, accuracy)
        return jnp.stack([solution.approach, solution.moment][:gradients]), solution

    _, back, solution = jax.vjp(both, inputs, has_aux=True)
    return solution, *(back(row)[0] for row in jnp.eye(gradients))


# ------------------------------------------------------------------------------------------ in programs


def in_program(method: Method, inputs: Inputs, mirrored: bool, accuracy: float) -> ContactSolution:
    """Of tracers or height maps, by the `method` that `contact_solution.given` returned."""
    if method == "auto":
        return _by_either(inputs, mirrored, accuracy)
    if method == "numpy":
        return _by_numpy(inputs, mirrored, accuracy)
    if method == "strips":
        return by_strips(inputs, mirrored, 2, accuracy)
    grid = grid_for(accuracy)
    if method == "cells":
        return cell_solve.solve(inputs, grid.cells_over(inputs.spall), mirrored, accuracy)
    return cell_solve.solve(inputs, grid.lattice, False, accuracy)


@jit_quickly(static_argnames=("mirrored", "accuracy"))
def _by_either(inputs: Inputs, mirrored: bool, accuracy: float) -> ContactSolution:
    """By strips and, where they do not do, by cells; chosen as it runs."""
    counts = (0,) if inputs.spall is None else (0, 2)  # those for one edge compile for as long, and run for two thirds
    branches = [partial(by_strips, mirrored=mirrored, edges=count, accuracy=accuracy) for count in counts]
    first = jax.lax.switch(xp.minimum(strip_reach.judged(inputs, mirrored).beneath.edges, 1), branches, inputs)
    cells = grid_for(accuracy).cells
    return jax.lax.cond(
        first.status_code == status.CONVERGED,
        lambda first, _: first,
        lambda _, inputs: cell_solve.solve(inputs, cells, mirrored, accuracy),
        first, inputs,
    )  # fmt: skip


def _by_numpy(inputs: Inputs, mirrored: bool, accuracy: float) -> ContactSolution:
    """By strips of numbers that a program asks for as it runs."""

    def solve(inputs: Inputs, with_gradient: bool) -> tuple[ContactSolution, Inputs | None]:
        found = partial(of_numbers, inputs, mirrored, int(with_gradient))
        solution, *by = first_that_does("numpy", inputs, mirrored, accuracy, found)
        return solution, (by[0] if by else None)

    cells, gap, _ = contact_cells.stage(inputs, grid_for(accuracy).cells_over(inputs.spall), mirrored)
    return assembled(inputs, cells, gap, accuracy, host_call.found(solve, gap.shape, inputs))


@jit_quickly(static_argnames=("mirrored", "edges", "accuracy"))
def by_strips(inputs: Inputs, mirrored: bool, edges: int, accuracy: float) -> ContactSolution:
    """By strips, of tracers; `edges` says how many rolling edges may be in reach."""
    way = _way(mirrored, hollows.of_one(inputs, edges), accuracy)
    return _laid_out(inputs, strip_model.solve(inputs, way), way, accuracy)


# ------------------------------------------------------------------------------------------ by strips


def _way(mirrored: bool, beneath: Beneath, accuracy: float) -> Way:
    """Of strips, with this beneath."""
    fine = grid_for(accuracy).strips
    return Way(mirrored, beneath, fine, strip_model.SETTLED * accuracy, _is_strict(accuracy))


def _laid_out(inputs: Inputs, found: strip_model.Strips, way: Way, accuracy: float) -> ContactSolution:
    """The solution by strips; the pressure is laid on the accuracy's cells."""
    cells, gap, _ = contact_cells.stage(inputs, grid_for(accuracy).cells_over(inputs.spall), way.mirrored)
    return assembled(inputs, cells, gap, accuracy, strip_model.on_cells(found, inputs, way, cells, accuracy))
