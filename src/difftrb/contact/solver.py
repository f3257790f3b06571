"""One roller on one raceway: the half-space contact problem with a spall, by strips or by projected gradient on cells.

Minimise ½ f·W f + f·gap over cell forces f ≥ 0 with Σf = load. The approach δ is the multiplier of the load: the
displaced gap W f + gap equals δ where cells are loaded and exceeds it elsewhere (Liu et al. 2018, eqs 1, 4).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import jax
import jax.core
import jax.numpy as jnp

from difftrb.contact import gap as gaps
from difftrb.contact import halfspace, multi_spall_grid, strip_model, uniform_grid
from difftrb.contact.contact_extent import Resolution, fitted_cells
from difftrb.contact.contact_problem import Arguments, Defect, Method, given, listed
from difftrb.contact.contact_solution import ContactSolution, assembled, border, extent, verdict
from difftrb.contact.halfspace import Cells
from difftrb.contact.projected_gradient import TOLERANCE, press_by
from difftrb.contact.strip_fourier import Frequencies
from difftrb.contact.strip_model import Fineness
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real, Spall
from difftrb.core.jax_config import jit_quickly


@dataclasses.dataclass(frozen=True)
class Grid:
    """What one accuracy is solved on: cells, strips where these can describe the contact, a lattice (rows, columns)."""

    cells: Resolution
    strips: Fineness
    lattice: tuple[int, int]


# Relative accuracy of the approach, and the grids measured to meet it: experiments/accuracy_of_contact.py and
# accuracy_of_strips.py.
GRIDS = {
    1e-2: Grid(
        Resolution(16, 12, 6),
        Fineness(6, 4, 2, 2, 3, Frequencies(4, 8, 10, 9.0), Frequencies(4, 8, 20, 30.0)),
        (256, 32),
    ),
    1e-3: Grid(
        Resolution(32, 20, 8),
        Fineness(11, 5, 3, 2, 3, Frequencies(4, 12, 12, 12.0), Frequencies(4, 10, 36, 60.0)),
        (512, 48),
    ),
    1e-4: Grid(
        Resolution(64, 64, 16),
        Fineness(20, 6, 3, 2, 3, Frequencies(6, 16, 16, 16.0), Frequencies(5, 14, 64, 120.0)),
        (1024, 64),
    ),
    3e-5: Grid(
        Resolution(64, 64, 16),
        Fineness(26, 9, 4, 2, 3, Frequencies(6, 16, 16, 16.0), Frequencies(5, 14, 110, 200.0)),
        (1024, 64),
    ),
    1e-5: Grid(
        Resolution(64, 64, 16),
        Fineness(32, 12, 5, 2, 3, Frequencies(6, 18, 26, 25.0), Frequencies(6, 18, 160, 250.0)),
        (1024, 64),
    ),
}


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
        where a sliver of contact laps over a rolling edge it is not met: README, Limits.
      method: "strips" are fast and smooth and take one rectangular spall, deeper than the approach, and a crowned
        roller that is not tilted. "cells" take all spalls. "lattice" takes height maps too, and is a second opinion on
        the others: its error falls with the first power of a cell, so `accuracy` only names its size. "auto" takes
        strips; where they do not converge those of the two next finer accuracies (of the finest, of coarser ones);
        cells where they do not either or cannot describe the contact; the lattice for height maps.
      tilt: of the roller about its middle [rad]: the gap grows by `tilt`·y along it. The approach is the middle's.
        Any size at which the roller still meets the raceway as a line, ± 0.01 or so. Default 0.

    A contact of which every `axial_offset` and the tilt are 0, and not being traced, is solved on half the roller.
    Differentiable by every number in `contact`, `spall`, `load`, `offset` and `tilt`, forward and reverse; `jit` and
    `vmap` as you like (`lax.map` is faster for batches on a CPU). With numbers, "auto" compiles what this case needs;
    inside `jit`, `grad` or `vmap` it compiles strips of this accuracy and cells and chooses as it runs. Raises
    ValueError for an accuracy out of range, a method that cannot take the case, or offsets that are not as many as
    spalls; SolveError without float64; everything else ends as a status in the result.
    """
    arguments, mirrored, method = given(contact, load, spall, offset, tilt, method)
    grid_for(accuracy)
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments))
    if traced and method == "auto":
        return _by_either(*arguments[:4], mirrored, accuracy)

    solve = _by if traced else _alone

    def by(method: Method, edges: int, accuracy: float) -> tuple[ContactSolution]:
        return (solve(method, arguments, mirrored, edges, accuracy),)

    if traced and method == "strips":
        return by("strips", 2, accuracy)[0]
    return _first_that_does(method, arguments, accuracy, by)[0]


def on_lattice(
    size: tuple[int, int],
    contact: LineContact,
    load: Real,
    spall: Defect = None,
    offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3,
    tilt: Real = 0.0,
) -> ContactSolution:
    """As `solve_contact` by a lattice of any `size`, cells across and along the roller, to compare with; `accuracy`
    changes nothing."""
    arguments, _, _ = given(contact, load, spall, offset, tilt, "lattice")
    return _by_lattice(*arguments, (size[1], size[0]), accuracy)


def approach_and_gradient(
    contact: LineContact,
    load: Real,
    spall: Defect = None,
    offset: Real | Sequence[Real] = 0.0,
    accuracy: float = 1e-3,
    method: Method = "auto",
    tilt: Real = 0.0,
) -> tuple[ContactSolution, tuple]:
    """The solved contact and, from the same solve, the gradient of its approach: by contact, load, spall, offset and
    tilt, each in the form of the input itself (None where that is None, or a tilt of 0). For numbers, not tracers."""
    arguments, mirrored, method = given(contact, load, spall, offset, tilt, method)
    grid_for(accuracy)

    def by(way: Method, edges: int, accuracy: float) -> tuple[ContactSolution, tuple]:
        return _slopes(*arguments, mirrored, edges, accuracy, way)

    return _first_that_does(method, arguments, accuracy, by)


def _first_that_does(
    method: Method, arguments: Arguments, accuracy: float, by: Callable[[Method, int, float], tuple]
) -> tuple:
    """What the way named by `method` returns or, for "auto", strips if they do, else strips of another fineness, else
    cells. For numbers only.

    `by` takes a way, how many rolling edges may be in reach of strips, and an accuracy; it returns a `ContactSolution`
    first.
    """
    if method in ("cells", "lattice"):
        return by(method, 0, accuracy)
    edges, suited = _outlook(*arguments[:4])
    if method == "strips":
        return by("strips", int(edges), accuracy)
    for own in (accuracy, *_others(accuracy)) if suited else ():
        result = by("strips", int(edges), own)
        code = int(result[0].status_code)
        if code == status.CONVERGED:
            return result
        if code != status.NOT_CONVERGED:  # finer ones say the same
            break
    return by("cells", 0, accuracy)


@jit_quickly(static_argnums=(0, 2, 3, 4))
def _alone(method: Method, arguments: Arguments, mirrored: bool, edges: int, accuracy: float) -> ContactSolution:
    """`_by`, outside any other `jit`."""
    return _by(method, arguments, mirrored, edges, accuracy)


def _by(method: Method, arguments: Arguments, mirrored: bool, edges: int, accuracy: float) -> ContactSolution:
    """By one way: "strips", "cells" or "lattice"."""
    grid = grid_for(accuracy)
    if method == "strips":
        return _by_strips(*arguments[:4], mirrored, edges, accuracy)
    if method == "lattice":
        return _by_lattice(*arguments, grid.lattice, accuracy)
    return _by_cells(*arguments[:4], grid.cells, mirrored, accuracy, arguments[4])


def grid_for(accuracy: float) -> Grid:
    """The cheapest grid measured to reach a relative `accuracy` of the approach."""
    return GRIDS[_reached(accuracy)]


def _reached(accuracy: float) -> float:
    """What `grid_for` is known for."""
    enough = [a for a in GRIDS if a <= accuracy * (1.0 + 1e-9)]
    if not enough or not accuracy <= max(GRIDS):
        raise status.SceneError(f"accuracy = {accuracy!r} is out of range: {min(GRIDS):g} … {max(GRIDS):g}")
    return max(enough)


def _others(accuracy: float) -> list[float]:
    """The two next finer accuracies; where there are not two, coarser ones."""
    own = _reached(accuracy)
    return ([a for a in GRIDS if a < own] + [a for a in reversed(GRIDS) if a > own])[:2]


@jax.jit
def _outlook(
    contact: LineContact, load: jax.Array, spall: Spall | None, offset: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """How many rolling edges may be in reach of the contact, and whether strips can be expected to describe it."""
    return strip_model.outlook(contact, load, spall, offset)


@partial(jax.jit, static_argnames=("resolution", "mirrored", "accuracy"))
def _by_cells(
    contact: LineContact,
    load: jax.Array,
    spall: Defect,
    offset: jax.Array,
    resolution: Resolution,
    mirrored: bool,
    accuracy: float,
    tilt: jax.Array | None = None,
) -> ContactSolution:
    """By projected gradient on cells."""
    cells, code, gap = _stage(contact, load, spall, offset, resolution, mirrored, tilt)
    matrix = halfspace.influence(cells, jnp.asarray(contact.modulus))
    return _pressed(contact, load, spall, offset, tilt, cells, gap, matrix, code, accuracy)


@partial(jax.jit, static_argnames=("size", "accuracy"))
def _by_lattice(
    contact: LineContact,
    load: jax.Array,
    spall: Defect,
    offset: jax.Array,
    tilt: jax.Array | None,
    size: tuple[int, int],
    accuracy: float,
) -> ContactSolution:
    """By projected gradient on a uniform lattice."""
    defects = listed(spall)
    cells, depth = uniform_grid.fitted(contact, load, defects, jnp.broadcast_to(offset, (len(defects),)), size, tilt)
    gap = gaps.undeformed(cells, contact, tilt) + depth
    matrix = uniform_grid.influence(cells, jnp.asarray(contact.modulus))
    code = jnp.asarray(status.CONVERGED)
    return _pressed(contact, load, spall, offset, tilt, cells, gap, matrix, code, accuracy)


def _pressed(
    contact: LineContact, load: jax.Array, spall: Defect, offset: jax.Array, tilt: jax.Array | None, cells: Cells,
    gap: jax.Array, matrix: halfspace.Operator, code: jax.Array, accuracy: float,
) -> ContactSolution:  # fmt: skip
    """The solution on cells by their influence `matrix`; `code` says whether the cells do."""
    lowest = jax.lax.stop_gradient(jnp.min(gap))
    force, approach, residual, iterations = press_by(
        matrix, cells.area, gap - lowest, load, gaps.first_level(cells, contact.radius)
    )
    approach = approach + lowest
    touched = border(cells, force > 0.0, approach, gap, contact)
    code = status.worst(code, verdict(approach, residual, TOLERANCE), touched)
    return assembled(
        contact, load, spall, offset, gap, cells, accuracy, tilt, approach=approach, force=force,
        width=extent(cells, force), residual=residual, iterations=iterations, unknowns=force.size, code=code,
    )  # fmt: skip


@partial(jax.jit, static_argnames=("mirrored", "edges", "accuracy"))
def _by_strips(
    contact: LineContact,
    load: jax.Array,
    spall: Spall | None,
    offset: jax.Array,
    mirrored: bool,
    edges: int,
    accuracy: float,
) -> ContactSolution:
    """By strips; `edges` says how many rolling edges may be in reach. The pressure is laid on the accuracy's cells."""
    grid = grid_for(accuracy)
    cells, _, gap = _stage(contact, load, spall, offset, grid.cells, mirrored)
    edges = edges if spall is not None else 0
    solved = strip_model.solve(contact, load, spall, offset, mirrored, edges, grid.strips, cells)
    code = verdict(solved.approach, solved.change, strip_model.SETTLED)
    code = jnp.where(solved.approach > 0.0, code, status.NOT_CONVERGED)  # boundaries may settle where no contact is
    code = status.worst(code, verdict(solved.approach, solved.tension, strip_model.TENSION * accuracy))
    return assembled(
        contact, load, spall, offset, gap, cells, accuracy, None, approach=solved.approach, force=solved.force,
        width=solved.width, residual=solved.change, iterations=solved.passes, unknowns=solved.unknowns,
        code=jnp.where(solved.suited, code, status.UNSUITED),
    )  # fmt: skip


@partial(jax.jit, static_argnames=("mirrored", "accuracy"))
def _by_either(
    contact: LineContact, load: jax.Array, spall: Spall | None, offset: jax.Array, mirrored: bool, accuracy: float
) -> ContactSolution:
    """By strips and, where they do not do, by cells; chosen as it runs."""
    arguments = contact, load, spall, offset
    edges, _ = strip_model.outlook(*arguments)

    def strips(edges: int) -> Callable[..., ContactSolution]:
        return lambda *a: _by_strips(*a, mirrored, edges, accuracy)

    branches = [strips(count) for count in range(1 if spall is None else 3)]
    first = jax.lax.switch(edges, branches, *arguments)
    cells = grid_for(accuracy).cells
    return jax.lax.cond(
        first.status_code == status.CONVERGED,
        lambda first, *_: first,
        lambda _, *a: _by_cells(*a, cells, mirrored, accuracy),
        first, *arguments,
    )  # fmt: skip


@jit_quickly(static_argnums=(5, 6, 7, 8))
def _slopes(
    contact: LineContact, load: jax.Array, spall: Defect, offset: jax.Array, tilt: jax.Array | None, mirrored: bool,
    edges: int, accuracy: float, method: Method,
) -> tuple[ContactSolution, tuple]:  # fmt: skip
    """The solved contact and the derivatives of its approach by the first five arguments."""

    def approach(*a: Any) -> tuple[jax.Array, ContactSolution]:
        solution = _by(method, a, mirrored, edges, accuracy)
        return solution.approach, solution

    arguments = contact, load, spall, offset, tilt
    (_, solution), slopes = jax.value_and_grad(approach, (0, 1, 2, 3, 4), has_aux=True)(*arguments)
    return solution, slopes


def _stage(
    contact: LineContact,
    load: jax.Array,
    spall: Defect,
    offset: jax.Array,
    resolution: Resolution,
    mirrored: bool,
    tilt: jax.Array | None = None,
) -> tuple[Cells, jax.Array, jax.Array]:
    """Cells, whether they do, and the initial gap on them. Spalls only: height maps are for the lattice."""
    spall = cast(Spall | tuple[Spall, ...] | None, spall)
    if isinstance(spall, tuple):
        cells, depression, code = multi_spall_grid.fitted(contact, load, spall, offset, resolution, mirrored, tilt)
    else:
        cells, code = fitted_cells(contact, load, spall, offset, resolution, mirrored, tilt)
        depression = jnp.zeros((1, 1)) if spall is None else gaps.depression(cells, spall, offset)
    return cells, code, gaps.undeformed(cells, contact, tilt) + depression
