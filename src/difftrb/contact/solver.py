"""One roller on one raceway: the half-space contact problem with spalls, by strips or by projected gradient on cells.

Minimise ½ f·W f + f·gap over cell forces f ≥ 0 with Σf = load. The approach δ is the multiplier of the load: the
displaced gap W f + gap equals δ where cells are loaded and exceeds it elsewhere (Liu et al. 2018, eqs 1, 4).

This is what is asked, and returned; which way it is solved, `ways` chooses.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from difftrb.contact import cell_solve, strip_model, ways
from difftrb.contact.contact_solution import (
    ContactSolution,
    Defect,
    Inputs,
    Method,
    given,
    gradient_by_name,
)  # fmt: skip
from difftrb.contact.grids import grid_for
from difftrb.contact.hollows import Beneath
from difftrb.contact.strip_model import Patch
from difftrb.core import arrays as xp
from difftrb.core.geometry import LineContact, Real


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
        −0.1…0.1; from 0.02 on it presses with a tenth of its length or less. Default 0. A traced one out of range has
        a status, and what is returned beside that means nothing.

    A contact of which every `axial_offset` and the tilt are 0, and not being traced, is solved on half the roller.
    The approach is differentiable by every number in `contact`, `spall`, `load`, `offset` and `tilt`, forward and
    reverse; pressures are by cells, while those of strips count as constant. `jit` and `vmap` as you like (`lax.map` is
    faster for batches on a CPU). Of numbers, strips are solved by numpy and compile nothing, cells compile one small
    program for all contacts of as many cells; inside `jit`, `grad` or `vmap`, "auto" compiles strips of this accuracy
    and cells, for ten seconds to half a minute, and chooses as it runs. There "numpy" has contacts solved by numpy
    outside of the program, one after another: it compiles in a second and takes several spalls by strips, too, but a
    contact takes some ten times as long. It is for programs that solve tens of contacts.

    Raises `SceneError` for an accuracy or a tilt out of range, a method that cannot take the case, offsets that are not
    as many as spalls, and what is no contact; SolveError without float64; everything else ends as a status in the
    result.
    """
    inputs, mirrored, method = given(contact, load, spall, offset, tilt, method)
    grid_for(accuracy)
    if xp.are_numbers(inputs):
        by = partial(ways.of_numbers, inputs, mirrored, 0)
        return jax.device_put(ways.first_that_does(method, inputs, mirrored, accuracy, by)[0])
    return ways.in_program(method, inputs, mirrored, accuracy)


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
            return ways.of_numbers(inputs, mirrored, 0, way, beneath, max(own, 1e-3))[0], ()
        solution, found, strips = ways.strips_of_numbers(inputs, mirrored, beneath, own)
        return solution, strip_model.patches(found, inputs, strips)

    return ways.first_that_does(method, inputs, mirrored, accuracy, by)  # type: ignore[return-value]


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
    that of its `moment` [N mm], for which a tilt of 0 is one as well. For numbers, not tracers; by strips in numpy's.
    """
    inputs, mirrored, method = given(contact, load, spall, offset, tilt, method)
    if moment:  # what turns a roller is the difference of its halves
        mirrored, inputs = False, inputs._replace(tilt=np.asarray(tilt, float))
    grid_for(accuracy)
    with_gradients = partial(ways.of_numbers, inputs, mirrored, 2 if moment else 1)
    solution, *by = ways.first_that_does(method, inputs, mirrored, accuracy, with_gradients)
    return solution, *(map(_of_half, by) if solution.cells.mirrored else by)


def _of_half(by: Inputs) -> Inputs:
    """A gradient from half the roller, which would shift both of its halves outwards: it is 0 by axial offsets."""

    def still(spall: Any) -> Any:
        return dataclasses.replace(spall, axial_offset=0.0 * spall.axial_offset)

    spall = by.spall
    return by._replace(spall=tuple(map(still, spall)) if isinstance(spall, tuple) else spall and still(spall))
