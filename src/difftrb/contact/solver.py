"""One roller on one raceway: the half-space contact problem with spalls, by strips or by projected gradient on cells.

Minimise ½ f·W f + f·gap over cell forces f ≥ 0 with Σf = load. The approach δ is the multiplier of the load: the
displaced gap W f + gap equals δ where cells are loaded and exceeds it elsewhere (Liu et al. 2018, eqs 1, 4).

In this order: what is asked, which way is chosen, each way. What strips can take is `strip_reach`'s to say, before they
are tried; what they found, `strip_model`'s; maps, and several spalls in a program, leave no choice
(`contact_solution`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import cell_solve, contact_cells, hollows, host_call, strip_model, strip_reach
from difftrb.contact.contact_solution import (
    ContactSolution,
    Defect,
    Inputs,
    Method,
    assembled,
    given,
    gradient_by_name,
)  # fmt: skip
from difftrb.contact.grids import GRIDS, accuracy_met, grid_for
from difftrb.contact.hollows import Beneath
from difftrb.contact.strip_model import Patch, Way
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real
from difftrb.core.jax_config import jit_quickly

THIN, FINER = 1.0, 2
"""By the accuracy, what slivers beyond a rolling edge may leave in the approach that are too thin for strips' waves:
with more, they are solved again with waves half as long, at most so many times. Numbers only: a program is as it is."""

# ------------------------------------------------------------------------------------------ what is asked


def solve_contact(
    contact: LineContact,
    load: Real,
    spall: Defect = None,
    offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3,
    method: Method = "auto",
    tilt: Real = 0.0,
) -> ContactSolution:
    """Press a roller on a raceway, with or without spalls between them.

    Args:
      contact: radius, length, modulus and crown, from `LineContact.of`.
      load: normal load of the roller [N], > 0.
      spall: None is a healthy raceway; a tuple is several spalls, which merge where they overlap (the deeper counts).
        A `HeightMap` may stand where a spall can.
      offset: of the spall's centre from the contact's, in the rolling direction [mm]; of several spalls one number for
        all or one for each.
      accuracy: relative accuracy of the approach, 1e-2…1e-5; a smaller number costs time. Cells end at about 1e-4, and
        where a sliver of contact laps over a rolling edge it is not met: docs/limits.md.
      method: "strips" are fast and smooth and take a crowned roller, tilted or not, over rectangular spalls deeper than
        the approach: one or, of numbers, several that are half a contact width apart along the roller or, with no
        rolling edge in reach, overlap. The loaded land is at least two contact widths long, and a spall with an edge in
        reach ends within the contact. "cells" take all spalls. "lattice" takes height maps too, and is a second opinion
        on the others: its error falls with the first power of a cell, so `accuracy` only names its size. "auto" takes
        strips; where they do not converge those of the two next finer accuracies (of the finest, of coarser ones);
        cells where they do not either or cannot describe the contact; the lattice for height maps. "numpy" is
        "auto" without cells, for programs: see below.
      tilt: of the roller about its middle [rad]: the gap grows by `tilt`·y along it. The approach is the middle's.
        −0.1…0.1; from 0.02 on it presses with a tenth of its length or less. Default 0.

    A contact of which every `axial_offset` and the tilt are 0, and not being traced, is solved on half the roller.
    The approach is differentiable by every number in `contact`, `spall`, `load`, `offset` and `tilt`, forward and
    reverse; pressures are by cells, while those of strips count as constant. `jit` and `vmap` as you like (`lax.map` is
    faster for batches on a CPU). Of numbers, strips are solved by numpy and compile nothing, cells compile one small
    program for all contacts of as many cells; inside `jit`, `grad` or `vmap`, "auto" compiles strips of this accuracy
    and cells, for half a minute, and chooses as it runs. There "numpy" has contacts solved by numpy outside of the
    program, one after another: it compiles in a second and takes several spalls by strips, too, but a contact takes
    some ten times as long. It is for programs that solve tens of contacts.

    Raises `SceneError` for an accuracy or a tilt out of range, a method that cannot take the case, offsets that are not
    as many as spalls, and what is no contact; SolveError without float64; everything else ends as a status in the
    result.
    """
    inputs, mirrored, method = given(contact, load, spall, offset, tilt, method)
    grid_for(accuracy)
    if xp.are_numbers(inputs):
        found = _first_that_does(method, inputs, mirrored, accuracy, partial(_of_numbers, inputs, mirrored, 0))[0]
        return jax.device_put(found)
    if method == "auto":
        return _by_either(inputs, mirrored, accuracy)
    if method == "numpy":
        return _by_numpy(inputs, mirrored, accuracy)
    return _by(method, inputs, mirrored, 2, accuracy)


def pressure_patches(
    contact: LineContact, load: Real, spall: Defect = None, offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3, tilt: Real = 0.0,
) -> tuple[ContactSolution, tuple[Patch, ...]]:  # fmt: skip
    """`solve_contact` of numbers, and its pressure point by point; where strips do not do there are no points, but
    cells of 1e-3 at the finest."""
    inputs, mirrored, method = given(contact, load, spall, offset, tilt, "auto")
    grid_for(accuracy)

    def by(way: Method, beneath: Beneath | None, own: float) -> tuple[ContactSolution, tuple[Patch, ...]]:
        if beneath is None:
            return _of_numbers(inputs, mirrored, 0, way, beneath, max(own, 1e-3))[0], ()
        solution, found, strips = _strips_of_numbers(inputs, mirrored, beneath, own)
        return solution, strip_model.patches(found, inputs, strips)

    return _first_that_does(method, inputs, mirrored, accuracy, by)  # type: ignore[return-value]


def on_lattice(
    size: tuple[int, int], contact: LineContact, load: Real, spall: Defect = None,
    offset: Real | Sequence[Real] = 0.0, accuracy: float = 1e-3, tilt: Real = 0.0,
) -> ContactSolution:  # fmt: skip
    """As `solve_contact` by a lattice of any `size`, cells across and along the roller, to compare with; `accuracy`
    changes nothing."""
    inputs, _, _ = given(contact, load, spall, offset, tilt, "lattice")
    return cell_solve.solve(inputs, (size[1], size[0]), False, accuracy)


def approach_slopes(
    contact: LineContact,
    load: Real,
    spall: Defect = None,
    offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3,
    method: Method = "auto",
    tilt: Real = 0.0,
) -> dict[str, Real | None]:
    """Derivatives of the approach [mm] by load [N], length, width, offset, radius [mm] and design_load [N].

    All from one linear solve (reverse mode). None where there is no spall to change, and for length, width and offset
    of a height map, whose steep walls stand still on the lattice until they cross a line; of several spalls, shape
    (spalls,), where those are NaN. Arguments as `solve_contact`.
    """
    return jax.device_put(approach_and_slopes(contact, load, spall, offset, accuracy, method, tilt)[1])


def approach_and_slopes(
    contact: LineContact, load: Real, spall: Defect = None, offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3, method: Method = "auto", tilt: Real = 0.0,
) -> tuple[ContactSolution, dict[str, Real | None]]:  # fmt: skip
    """The solved contact and, from the same solve, `approach_slopes`."""
    solution, gradient = approach_and_gradient(contact, load, spall, offset, accuracy, method, tilt)
    return solution, gradient_by_name(gradient)


def approach_and_gradient(
    contact: LineContact, load: Real, spall: Defect = None, offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3, method: Method = "auto", tilt: Real = 0.0, moment: bool = False,
) -> tuple[Any, ...]:  # fmt: skip
    """The solved contact and, from the same solve, the gradient of its approach: `Inputs` by contact, load, spall,
    offset and tilt, each in the form of the input itself (None where that is None, or a tilt of 0); and, if asked for,
    that of its `moment` [N mm]. For numbers, not tracers; by strips in numpy's."""
    inputs, mirrored, method = given(contact, load, spall, offset, tilt, method)
    grid_for(accuracy)
    solution, *by = _first_that_does(
        method, inputs, mirrored, accuracy, partial(_of_numbers, inputs, mirrored, 2 if moment else 1)
    )
    return solution, *(map(_of_half, by) if solution.cells.mirrored else by)


def _of_half(by: Inputs) -> Inputs:
    """A gradient from half the roller, which would shift both of its halves outwards: it is 0 by axial offsets."""

    def still(spall: Any) -> Any:
        return dataclasses.replace(spall, axial_offset=0.0 * spall.axial_offset)

    spall = by.spall
    return by._replace(spall=tuple(map(still, spall)) if isinstance(spall, tuple) else spall and still(spall))


# ------------------------------------------------------------------------------------------ which way is chosen


def _first_that_does(
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
        # beside a sliver of land at the roller's end cells are ten times as far off as elsewhere
        return by("cells", None, _others(accuracy)[0] if fits and not within else accuracy)


def _by_numpy(inputs: Inputs, mirrored: bool, accuracy: float) -> ContactSolution:
    """By strips of numbers that a program asks for as it runs."""

    def solve(inputs: Inputs, with_gradient: bool) -> tuple[ContactSolution, Inputs | None]:
        found = partial(_of_numbers, inputs, mirrored, int(with_gradient))
        solution, *by = _first_that_does("numpy", inputs, mirrored, accuracy, found)
        return solution, (by[0] if by else None)

    cells, gap, _ = contact_cells.stage(inputs, grid_for(accuracy).cells_over(inputs.spall), mirrored)
    return assembled(inputs, cells, gap, accuracy, host_call.found(solve, gap.shape, inputs))


def _is_strict(accuracy: float) -> bool:
    """Whether strips must not stand over a spall that goes on to the roller's end: `strip_reach.ends_within`."""
    return accuracy_met(accuracy) < max(GRIDS)


def _others(accuracy: float) -> list[float]:
    """The two next finer accuracies; where there are not two, coarser ones."""
    own = accuracy_met(accuracy)
    return ([a for a in GRIDS if a < own] + [a for a in reversed(GRIDS) if a > own])[:2]


@jit_quickly(static_argnames=("mirrored", "accuracy"))
def _by_either(inputs: Inputs, mirrored: bool, accuracy: float) -> ContactSolution:
    """By strips and, where they do not do, by cells; chosen as it runs."""
    counts = (0,) if inputs.spall is None else (0, 2)  # those for one edge compile for as long, and run for two thirds
    branches = [partial(_by_strips, mirrored=mirrored, edges=count, accuracy=accuracy) for count in counts]
    first = jax.lax.switch(xp.minimum(strip_reach.judged(inputs, mirrored).beneath.edges, 1), branches, inputs)
    cells = grid_for(accuracy).cells
    return jax.lax.cond(
        first.status_code == status.CONVERGED,
        lambda first, _: first,
        lambda _, inputs: cell_solve.solve(inputs, cells, mirrored, accuracy),
        first, inputs,
    )  # fmt: skip


# ------------------------------------------------------------------------------------------ each way


def _by(method: Method, inputs: Inputs, mirrored: bool, edges: int, accuracy: float) -> ContactSolution:
    """By one way, of tracers or height maps: "strips", "cells" or "lattice"."""
    if method == "strips":
        return _by_strips(inputs, mirrored, edges, accuracy)
    grid = grid_for(accuracy)
    if method == "cells":
        return cell_solve.solve(inputs, grid.cells_over(inputs.spall), mirrored, accuracy)
    return cell_solve.solve(inputs, grid.lattice, False, accuracy)


def _of_numbers(
    inputs: Inputs, mirrored: bool, gradients: int, method: Method, beneath: Beneath | None, accuracy: float
) -> tuple[Any, ...]:
    """The solved contact and so many gradients by its inputs: of the approach, of the moment. Strips and where cells
    lie are computed by numpy."""
    if beneath is not None:
        solution, found, way = _strips_of_numbers(inputs, mirrored, beneath, accuracy)
        return solution, *(strip_model.gradients(found, inputs, way, gradients) if gradients else ())
    if method == "cells":
        cells = grid_for(accuracy).cells_over(inputs.spall)
        solution, every = cell_solve.solve_numbers(inputs, cells, mirrored, accuracy, gradients)
        return solution, *every
    return _lattice_slopes(inputs, accuracy, gradients) if gradients else (_by(method, inputs, False, 0, accuracy),)


@jit_quickly(static_argnames=("accuracy", "gradients"))
def _lattice_slopes(inputs: Inputs, accuracy: float, gradients: int) -> tuple:
    """The same on a lattice: of the approach and, if two are asked for, of the moment."""

    def both(inputs: Inputs) -> tuple[jax.Array, ContactSolution]:
        solution = _by("lattice", inputs, False, 0, accuracy)
        return jnp.stack([solution.approach, solution.moment][:gradients]), solution

    _, back, solution = jax.vjp(both, inputs, has_aux=True)
    return solution, *(back(row)[0] for row in jnp.eye(gradients))


def _way(mirrored: bool, beneath: Beneath, accuracy: float) -> Way:
    """Of strips, with this beneath."""
    fine = grid_for(accuracy).strips
    return Way(mirrored, beneath, fine, strip_model.SETTLED * accuracy, _is_strict(accuracy))


def _strips_of_numbers(
    inputs: Inputs, mirrored: bool, beneath: Beneath, accuracy: float
) -> tuple[ContactSolution, strip_model.Strips, Way]:
    way = _way(mirrored, beneath, accuracy)
    found = strip_model.solve_numbers(inputs, way)
    for _ in range(FINER):
        if not found.settled.unresolved > THIN * accuracy:
            break
        way = way._replace(fine=way.fine.finer)
        found = strip_model.solve_numbers(inputs, way)
    return _laid_out(inputs, found, way, accuracy), found, way


@jit_quickly(static_argnames=("mirrored", "edges", "accuracy"))
def _by_strips(inputs: Inputs, mirrored: bool, edges: int, accuracy: float) -> ContactSolution:
    """By strips, of tracers; `edges` says how many rolling edges may be in reach."""
    way = _way(mirrored, hollows.of_one(inputs, edges), accuracy)
    return _laid_out(inputs, strip_model.solve(inputs, way), way, accuracy)


def _laid_out(inputs: Inputs, found: strip_model.Strips, way: Way, accuracy: float) -> ContactSolution:
    """The solution by strips; the pressure is laid on the accuracy's cells."""
    cells, gap, _ = contact_cells.stage(inputs, grid_for(accuracy).cells_over(inputs.spall), way.mirrored)
    return assembled(inputs, cells, gap, accuracy, strip_model.on_cells(found, inputs, way, cells, accuracy))
