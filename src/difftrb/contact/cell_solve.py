"""A contact solved on cells or on a lattice by projected gradient.

Of numbers the cells are laid by numpy, with the derivatives of every line and gap, and one small program presses them:
it knows nothing of bearings and spalls, so that contacts of as many cells share it. What is traced is one program, as
are height maps, whose every height has a derivative.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import contact_cells, halfspace
from difftrb.contact import gap as gaps
from difftrb.contact.contact_cells import LaidContact, Resolution
from difftrb.contact.contact_solution import (
    ContactSolution,
    Found,
    Inputs,
    assembled,
    cut_off,
    moment_of,
    verdict,
    width_of,
)
from difftrb.contact.gap import Cells, Uneven
from difftrb.contact.projected_gradient import TOLERANCE, press_by
from difftrb.core import arrays as xp
from difftrb.core import status, taylor
from difftrb.core.jax_config import jit_quickly
from difftrb.core.taylor import Taylor

Gradients = tuple[Inputs, ...]
"""Of the approach and, if it is asked for, of the moment, in the form of the inputs."""


class Bed(NamedTuple):
    """All that forces on cells depend on: `Cells.pitch`, `x`, `lines` and borders (None: even), gap above its least,
    load, modulus."""

    pitch: Any
    x: Any
    lines: Any
    borders: Any
    gap: Any
    load: Any
    modulus: Any


class PressedCells(NamedTuple):
    """Forces of the cells [N], approach above the gap's least [mm], moment [N mm], residual, and iterations."""

    force: Any
    approach: Any
    moment: Any
    residual: Any
    iterations: Any


@jit_quickly(static_argnames=("on", "mirrored", "accuracy"))
def solve(inputs: Inputs, on: Resolution | tuple[int, int], mirrored: bool, accuracy: float) -> ContactSolution:
    """What is traced, or has height maps: on cells of a resolution, or on a lattice of so many rows and columns."""
    if isinstance(on, Resolution):
        stage, operator = contact_cells.stage(inputs, on, mirrored), halfspace.influence
    else:
        stage, operator = contact_cells.uniform_stage(inputs, on), halfspace.uniform_influence
    cells, lowest = stage.cells, jax.lax.stop_gradient(jnp.min(stage.gap))
    matrix = operator(cells, jnp.asarray(inputs.contact.modulus))
    level = gaps.first_level(cells, inputs.contact.radius)
    found = _pressed(matrix, cells, stage.gap - lowest, inputs.load, level)
    return _solution(inputs, stage, found._replace(approach=found.approach + lowest), accuracy)


def solve_numbers(
    inputs: Inputs, resolution: Resolution, mirrored: bool, accuracy: float, gradients: int = 0
) -> tuple[ContactSolution, Gradients]:
    """On cells, of numbers, and so many `gradients`: of the approach, of the moment."""
    leaves, form = jax.tree.flatten(inputs)
    seeds = form.unflatten(taylor.parameters(leaves) if gradients else leaves)
    laid = contact_cells.stage(seeds, resolution, mirrored)
    stage = xp.values(laid)
    cells, lowest = stage.cells, np.min(stage.gap)
    bed = _bed(laid.cells, laid.gap - lowest, seeds)
    columns = None if cells.uneven is None else cells.uneven.columns
    level = gaps.first_level(cells, inputs.contact.radius)
    found, slopes = jax.device_get(_program(xp.values(bed), level, columns, mirrored, gradients))
    solution = _solution(inputs, stage, found._replace(approach=found.approach + lowest), accuracy)
    return solution, tuple(_by_inputs(leaves, form, bed, by) for by in slopes)


@jit_quickly(static_argnames=("mirrored", "gradients"))
def _program(
    bed: Bed, level: Any, columns: Any, mirrored: bool, gradients: int
) -> tuple[PressedCells, tuple[Bed, ...]]:
    """The forces, and derivatives of the approach and the moment by all of the bed."""

    def pressed(bed: Bed) -> tuple[Any, PressedCells]:
        uneven = None if columns is None else Uneven(columns, bed.borders)
        cells = Cells(bed.pitch, bed.x, bed.lines, mirrored, uneven)
        found = _pressed(halfspace.influence(cells, bed.modulus), cells, bed.gap, bed.load, level)
        return (found.approach, found.moment)[:gradients], found

    if not gradients:
        return pressed(bed)[1], ()
    _, back, found = jax.vjp(pressed, bed, has_aux=True)
    return found, tuple(back(tuple(row))[0] for row in np.eye(gradients))


def _pressed(matrix: halfspace.Operator, cells: Cells, gap: jax.Array, load: Any, level: Any) -> PressedCells:
    """On a gap whose least is 0."""
    force, approach, residual, iterations = press_by(matrix, cells.area, gap, load, level)
    return PressedCells(force, approach, moment_of(cells, force), residual, iterations)


def _solution(inputs: Inputs, stage: LaidContact, pressed: PressedCells, accuracy: float) -> ContactSolution:
    """The contact that was pressed, with its status."""
    (cells, gap, code), force, approach = stage, pressed.force, pressed.approach
    touched = cut_off(cells, force > 0.0, approach, gap, inputs.contact)
    code = status.worst(code, verdict(approach, pressed.residual, TOLERANCE), touched)
    width = width_of(cells, force)
    size = np.asarray(force.size)
    found = Found(approach, force, pressed.moment, width, pressed.residual, pressed.iterations, size, code)
    return assembled(inputs, cells, gap, accuracy, found)


# ------------------------------------------------------------------------------------------ derivatives of numbers


def _bed(cells: Cells, gap: Any, inputs: Inputs) -> Bed:
    borders = None if cells.uneven is None else cells.uneven.borders
    return Bed(cells.pitch, cells.x, cells.lines, borders, gap, inputs.load, inputs.contact.modulus)


def _by_inputs(leaves: list[Any], form: Any, bed: Bed, by_bed: Bed) -> Inputs:
    """Derivatives by all inputs, from those by the bed that they make."""
    parts = zip(bed, by_bed, strict=True)
    by = sum(
        np.tensordot(part.by, by, np.ndim(by)) for part, by in parts if isinstance(part, Taylor) and part.by is not None
    )
    sizes = [np.size(leaf) for leaf in leaves]
    split = np.split(by, np.cumsum(sizes)[:-1])
    return form.unflatten([own.reshape(np.shape(leaf)) for own, leaf in zip(split, leaves, strict=True)])
