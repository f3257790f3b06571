"""One roller on one raceway: the half-space contact problem with a spall, by strips or by projected gradient on cells.

Minimise ½ f·W f + f·gap over cell forces f ≥ 0 with Σf = load. The approach δ is the multiplier of the load: the
displaced gap W f + gap equals δ where cells are loaded and exceeds it elsewhere (Liu et al. 2018, eqs 1, 4).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Literal, get_args

import jax
import jax.core
import jax.numpy as jnp

from difftrb import gap as gaps
from difftrb import status, strip_model
from difftrb.domain import Resolution, fitted_cells
from difftrb.geometry import LineContact, Real, Spall, as_floats, contact_is_sound, spall_is_sound
from difftrb.halfspace import Cells
from difftrb.press import TOLERANCE, press
from difftrb.strip_model import Fineness
from difftrb.strips import Frequencies


@dataclasses.dataclass(frozen=True)
class Grid:
    """What one accuracy is solved on: cells, and strips where these can describe the contact."""

    cells: Resolution
    strips: Fineness


# Relative accuracy of the approach, and the grids measured to meet it (experiments/accuracy_of_contact.py).
GRIDS = {
    1e-2: Grid(Resolution(16, 12, 6), Fineness(6, 3, 2, 2, 3, Frequencies(4, 8, 12, 9.0), Frequencies(4, 8, 14, 12.0))),
    1e-3: Grid(
        Resolution(32, 20, 8), Fineness(8, 3, 3, 2, 3, Frequencies(4, 10, 14, 10.0), Frequencies(4, 10, 20, 17.0))
    ),
    1e-4: Grid(
        Resolution(64, 64, 16), Fineness(16, 5, 3, 2, 3, Frequencies(4, 12, 18, 12.0), Frequencies(4, 12, 42, 30.0))
    ),
    3e-5: Grid(
        Resolution(64, 64, 16), Fineness(24, 6, 4, 2, 3, Frequencies(6, 16, 24, 16.0), Frequencies(5, 14, 60, 40.0))
    ),
    1e-5: Grid(
        Resolution(64, 64, 16), Fineness(34, 8, 5, 2, 4, Frequencies(6, 18, 40, 25.0), Frequencies(6, 18, 80, 50.0))
    ),
}


Method = Literal["auto", "strips", "cells"]


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "approach", "force", "cells", "load", "spall", "offset", "gap", "contact_width", "loaded_fraction", "residual",
        "iterations", "unknowns", "status_code",
    ],
    meta_fields=["accuracy"],
)  # fmt: skip
@dataclasses.dataclass(frozen=True)
class ContactSolution(status.Judged):
    """A solved contact.

    Attributes:
      approach: δ of the two bodies, contact alone [mm].
      force: of every cell [N], shape (rows, columns); a mirrored cell counts both halves.
      cells: the grid: `cells.x`, `cells.y` centres [mm].
      load: [N]. spall, offset: what was given. gap: initial gap [mm], shape of `force`.
      contact_width: longest extent of the contact in the rolling direction [mm].
      loaded_fraction: share of the roller's length on which some cell is loaded [-].
      residual: by cells, the largest violation of the contact conditions relative to the approach; by strips, the last
        change of a free boundary relative to the contact's half-width.
      iterations: applications of the influence matrix, or passes over the strips.
      unknowns: of the solve: cells, or modes of all strips.
      status_code: see `difftrb.status`; `status` is its sentence.
      accuracy: the relative accuracy of the approach that was asked for.
    """

    approach: jax.Array
    force: jax.Array
    cells: Cells
    load: jax.Array
    spall: Spall | None
    offset: jax.Array
    gap: jax.Array
    contact_width: jax.Array
    loaded_fraction: jax.Array
    residual: jax.Array
    iterations: jax.Array
    unknowns: jax.Array
    status_code: jax.Array
    accuracy: float

    @property
    def pressure(self) -> jax.Array:
        """Mean pressure of every cell [N/mm²], shape (rows, columns)."""
        return self.force / self.cells.area[:, None]

    @property
    def peak_pressure(self) -> jax.Array:
        """Largest cell pressure [N/mm²]. Singular at a spall's sharp edge: there it depends on the cell size."""
        return jnp.max(self.pressure)


def solve_contact(
    contact: LineContact,
    load: Real,
    spall: Spall | None = None,
    offset: Real = 0.0,
    accuracy: float = 1e-3,
    method: Method = "auto",
) -> ContactSolution:
    """Press a roller on a raceway, with or without a spall between them.

    Args:
      contact: radius, length, modulus and crown, from `LineContact.of`.
      load: normal load of the roller [N], > 0.
      spall: None is a healthy raceway.
      offset: of the spall's centre from the contact's, in the rolling direction [mm].
      accuracy: relative accuracy of the approach, 1e-2…1e-5; a smaller number costs time. Cells end at about 1e-4, and
        where a sliver of contact laps over a rolling edge it is not met: README, Limits.
      method: "strips" are fast and smooth and take one rectangular spall, deeper than the approach, and a crowned
        roller. "cells" take every case. "auto" takes strips and, where they cannot describe the contact or do not
        converge, cells.

    A spall whose `axial_offset` is 0, and not being traced, is solved on half the roller. Differentiable by every
    number in `contact`, `spall`, `load` and `offset`, forward and reverse; `jit` and `vmap` as you like (`lax.map` is
    faster for batches on a CPU). With numbers, "auto" compiles what this case needs; inside `jit`, `grad` or `vmap` it
    compiles all and chooses as it runs. Raises ValueError for an accuracy out of range, SolveError without float64;
    everything else ends as a status in the result.
    """
    arguments, mirrored = _given(contact, load, spall, offset, method)
    grid = grid_for(accuracy)
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments))
    if traced and method == "auto":
        return _by_either(*arguments, mirrored, accuracy)

    def by_strips(edges: int) -> tuple[ContactSolution]:
        return (_by_strips(*arguments, mirrored, edges, accuracy),)

    def by_cells() -> tuple[ContactSolution]:
        return (_by_cells(*arguments, grid.cells, mirrored, accuracy),)

    if traced and method == "strips":
        return by_strips(2)[0]
    return _first_that_does(method, arguments, by_strips, by_cells)[0]


def approach_slopes(
    contact: LineContact,
    load: Real,
    spall: Spall | None = None,
    offset: Real = 0.0,
    accuracy: float = 1e-3,
    method: Method = "auto",
) -> dict[str, Real | None]:
    """Derivatives of the approach [mm] by load [N], length, width, offset, radius [mm] and design_load [N].

    All from one linear solve (reverse mode). None where there is no spall to change. Arguments as `solve_contact`.
    """
    _, slopes = approach_and_slopes(contact, load, spall, offset, accuracy, method)
    return slopes


def approach_and_slopes(
    contact: LineContact,
    load: Real,
    spall: Spall | None = None,
    offset: Real = 0.0,
    accuracy: float = 1e-3,
    method: Method = "auto",
) -> tuple[ContactSolution, dict[str, Real | None]]:
    """The solved contact and, from the same solve, `approach_slopes`."""
    arguments, mirrored = _given(contact, load, spall, offset, method)
    grid_for(accuracy)
    solution, slopes = _first_that_does(
        method,
        arguments,
        lambda edges: _slopes(*arguments, mirrored, edges, accuracy, True),
        lambda: _slopes(*arguments, mirrored, 0, accuracy, False),
    )
    by_contact, by_load, by_spall, by_offset = slopes
    there = by_spall is not None
    return solution, {
        "load": by_load,
        "length": by_spall.length if there else None,
        "width": by_spall.width if there else None,
        "offset": by_offset if there else None,
        "radius": by_contact.radius,
        "design_load": by_contact.design_load,
    }


def _given(
    contact: LineContact, load: Real, spall: Spall | None, offset: Real, method: Method
) -> tuple[tuple[LineContact, jax.Array, Spall | None, jax.Array], bool]:
    """The four inputs as floats, and whether half the roller will do; refuses float32 and an unknown method."""
    status.require_float64()
    if method not in get_args(Method):
        raise ValueError(f"method = {method!r} is unknown; use {', '.join(map(repr, get_args(Method)))}")
    arguments = as_floats(contact), jnp.asarray(load, float), as_floats(spall), jnp.asarray(offset, float)
    return arguments, is_symmetric(spall)


def _first_that_does(
    method: Method, arguments: tuple, by_strips: Callable[[int], tuple], by_cells: Callable[[], tuple]
) -> tuple:
    """What the way named by `method` returns or, for "auto", strips if they do and else cells. For numbers only.

    Both ways return a `ContactSolution` first; strips are told how many rolling edges may be in reach.
    """
    if method == "cells":
        return by_cells()
    edges, suited = _outlook(*arguments)
    if method == "strips" or suited:
        result = by_strips(int(edges))
        if method == "strips" or result[0].status_code == status.CONVERGED:
            return result
    return by_cells()


def grid_for(accuracy: float) -> Grid:
    """The cheapest grid measured to reach a relative `accuracy` of the approach."""
    enough = [a for a in GRIDS if a <= accuracy * (1.0 + 1e-9)]
    if not enough or not accuracy <= max(GRIDS):
        raise ValueError(f"accuracy = {accuracy!r} is out of range: {min(GRIDS):g} … {max(GRIDS):g}")
    return GRIDS[max(enough)]


def is_symmetric(spall: Spall | None) -> bool:
    """Whether the contact is known to be symmetric about the roller's middle: no spall, or `axial_offset` a plain 0."""
    if spall is None:
        return True
    known = not isinstance(spall.axial_offset, jax.core.Tracer)
    return known and float(spall.axial_offset) == 0.0


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
    spall: Spall | None,
    offset: jax.Array,
    resolution: Resolution,
    mirrored: bool,
    accuracy: float,
) -> ContactSolution:
    """By projected gradient on cells."""
    cells, domain_status, gap = _stage(contact, load, spall, offset, resolution, mirrored)
    level = jax.lax.stop_gradient(0.4 * jnp.max(gaps.curvature(cells, contact.radius)))
    force, approach, residual, iterations = press(cells, contact.modulus, gap, load, level)
    code = status.worst(
        domain_status, _verdict(approach, residual, TOLERANCE), _border(cells, force > 0.0, approach, contact)
    )
    loaded = jnp.any(force > 0.0, axis=0)
    extent = jnp.max(jnp.where(loaded, cells.x, -jnp.inf)) - jnp.min(jnp.where(loaded, cells.x, jnp.inf))
    return _solution(
        contact, load, spall, offset, gap, cells, accuracy, approach=approach, force=force, width=extent + cells.pitch,
        residual=residual, iterations=iterations, unknowns=force.size, code=code,
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
    code = _verdict(solved.approach, solved.change, strip_model.SETTLED)
    return _solution(
        contact, load, spall, offset, gap, cells, accuracy, approach=solved.approach, force=solved.force,
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


@partial(jax.jit, static_argnums=(4, 5, 6, 7))
def _slopes(
    contact: LineContact, load: jax.Array, spall: Spall | None, offset: jax.Array, mirrored: bool, edges: int,
    accuracy: float, strips: bool,
) -> tuple[ContactSolution, tuple]:  # fmt: skip
    """The solved contact and the derivatives of its approach by the first four arguments."""

    def approach(*a) -> tuple[jax.Array, ContactSolution]:
        if strips:
            solution = _by_strips(*a, mirrored, edges, accuracy)
        else:
            solution = _by_cells(*a, grid_for(accuracy).cells, mirrored, accuracy)
        return solution.approach, solution

    (_, solution), slopes = jax.value_and_grad(approach, (0, 1, 2, 3), has_aux=True)(contact, load, spall, offset)
    return solution, slopes


def _stage(
    contact: LineContact,
    load: jax.Array,
    spall: Spall | None,
    offset: jax.Array,
    resolution: Resolution,
    mirrored: bool,
) -> tuple[Cells, jax.Array, jax.Array]:
    """Cells, whether they do, and the initial gap on them."""
    cells, domain_status = fitted_cells(contact, load, spall, offset, resolution, mirrored)
    gap = gaps.curvature(cells, contact.radius) + gaps.crown(cells, contact)
    return cells, domain_status, gap if spall is None else gap + gaps.depression(cells, spall, offset)


def _solution(
    contact: LineContact, load: jax.Array, spall: Spall | None, offset: jax.Array, gap: jax.Array, cells: Cells,
    accuracy: float, *, approach: jax.Array, force: jax.Array, width: jax.Array, residual: jax.Array,
    iterations: jax.Array, unknowns: int, code: jax.Array,
) -> ContactSolution:  # fmt: skip
    sound = contact_is_sound(contact) & (load > 0.0) & jnp.isfinite(offset)
    if spall is not None:
        sound = sound & spall_is_sound(spall)
    rows = jnp.where(jnp.any(force > 0.0, axis=1), cells.area, 0.0)
    fraction = jnp.sum(rows) / (cells.pitch * contact.length)
    return ContactSolution(
        approach, force, cells, load, spall, offset, gap, jax.lax.stop_gradient(width), jax.lax.stop_gradient(fraction),
        jax.lax.stop_gradient(residual), iterations.astype(int), jnp.asarray(unknowns),
        jnp.where(sound, code, status.BAD_INPUT), accuracy,
    )  # fmt: skip


def _verdict(approach: jax.Array, residual: jax.Array, tolerance: float) -> jax.Array:
    converged = jnp.where(residual <= tolerance, status.CONVERGED, status.NOT_CONVERGED)
    return jnp.where(jnp.isfinite(approach), converged, status.BAD_INPUT)


def _border(cells: Cells, loaded: jax.Array, approach: jax.Array, contact: LineContact) -> jax.Array:
    """Whether pressure is cut off by the domain's border: not by a roller's end, nor where the crown is too high."""
    crown = gaps.crown_at(cells.lines, contact)
    touched = jnp.any(loaded[:, 0] | loaded[:, -1]) | (jnp.any(loaded[-1]) & (crown[-1] < approach))
    if not cells.mirrored:
        touched = touched | (jnp.any(loaded[0]) & (crown[0] < approach))
    return jnp.where(touched, status.TOUCHES_BORDER, status.CONVERGED)
