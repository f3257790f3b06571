"""One contact: what is asked, in one form; what comes back, in one type; and how an answer is judged."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from difftrb.contact import crown
from difftrb.contact.gap import Cells
from difftrb.contact.height_map import HeightMap, height_map_is_valid
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import LineContact, Real, Spall, as_floats, contact_is_valid, spall_is_valid
from difftrb.core.input_errors import number_in, shown

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float, Int

MOST_TILT = 0.1
"""Of a roller against its raceway [rad]: from 0.02 on it presses with a tenth of its length or less."""
Method = Literal["auto", "strips", "cells", "lattice", "numpy"]
Defect = Spall | HeightMap | tuple[Spall | HeightMap, ...] | None
"""What a roller stands over: nothing, one spall or height map, or several."""


# ------------------------------------------------------------------------------------------ what is asked


class Inputs(NamedTuple):
    """All numbers of one contact: the load [N], `offset` one per spall of several [mm], and the tilt [rad], which is
    None where it is known to be 0."""

    contact: LineContact
    load: Real
    spall: Defect
    offset: Real
    tilt: Real | None = None


def given(
    contact: LineContact, load: Real, spall: Defect, offset: Real | Sequence[Real], tilt: Real, method: Method
) -> tuple[Inputs, bool, Method]:
    """The inputs as floats, whether half the roller will do, and the method for them.

    Refuses what is no contact, float32, arrays in place of numbers, a tilt of a roller on its end, and a method that is
    unknown or cannot take the case.
    """
    if not isinstance(contact, LineContact):
        raise status.SceneError(f"contact = {shown(contact)}: must be a LineContact, say LineContact.of(bearing)")
    status.require_float64()
    if method not in get_args(Method):
        raise status.SceneError(f"method = {method!r} is unknown; use {', '.join(map(repr, get_args(Method)))}")
    place = xp.stack([xp.asarray(each) for each in offset]) if isinstance(offset, list | tuple) else xp.asarray(offset)
    if isinstance(spall, tuple):
        if place.shape not in ((), (len(spall),)):
            raise status.SceneError(
                f"offset has shape {place.shape} for {len(spall)} spalls; give one number, or one for each"
            )
        place = xp.module_of(place).broadcast_to(place, (len(spall),))
        if len(spall) < 2:
            spall, place = (spall[0], place[0]) if spall else (None, np.zeros(()))
    elif place.ndim:
        raise status.SceneError(
            f"offset has shape {place.shape}: one spall has one offset; give a tuple of spalls for several"
        )
    _refuse_arrays(contact=contact, load=load, tilt=tilt, spall=spall)
    if not isinstance(tilt, jax.core.Tracer) and abs(float(tilt)) > MOST_TILT:
        wanted = number_in(-MOST_TILT, MOST_TILT, "rad")
        raise status.SceneError(f"tilt = {float(tilt):g}: must be {wanted}: turned farther, a roller stands on its end")
    straight = is_zero(tilt)
    inputs = Inputs(
        as_floats(contact), xp.asarray(load), as_floats(spall), place, None if straight else xp.asarray(tilt)
    )
    traced = not xp.are_numbers(inputs)
    inputs = jax.tree.map(jnp.asarray, inputs) if traced else xp.numbers(inputs)
    return inputs, straight and is_symmetric(spall), _method_for(spall, method, traced)


def _refuse_arrays(**inputs: Any) -> None:
    """Raise if a number, or a number of a contact or spall, is an array; maps have theirs."""
    every = jax.tree_util.tree_leaves_with_path(inputs, is_leaf=lambda leaf: isinstance(leaf, HeightMap))
    for path, leaf in every:
        if not isinstance(leaf, HeightMap) and np.ndim(leaf):
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            raise status.SceneError(
                f"{name} has shape {np.shape(leaf)}: a contact takes one number; use jax.vmap for many at once"
            )


def _method_for(spall: Defect, method: Method, traced: bool) -> Method:
    """`method`, or the only one that takes the case; refuses a named one that does not."""
    if any(isinstance(each, HeightMap) for each in listed(spall)):
        if method not in ("auto", "lattice"):
            raise status.SceneError(f"method = {method!r} does not take height maps; use 'lattice'")
        return "lattice"
    if isinstance(spall, tuple) and traced and method in ("auto", "strips"):
        if method == "strips":
            raise status.SceneError(
                "method = 'strips' takes at most one spall inside jit, grad or vmap; use 'numpy' or 'cells'"
            )
        return "cells"
    return method


def is_symmetric(spall: Defect) -> bool:
    """Whether a contact is known to be symmetric about the roller's middle."""
    return all(is_zero(each.off_middle) for each in listed(spall))


def listed(spall: Defect) -> tuple[Spall | HeightMap, ...]:
    """Every spall or height map of a defect."""
    return () if spall is None else spall if isinstance(spall, tuple) else (spall,)


def is_zero(number: Real) -> bool:
    """Whether a number is known to be 0: a traced one is not."""
    return not isinstance(number, jax.core.Tracer) and float(number) == 0.0


def is_given(number: Real) -> bool:
    """Whether a number is known not to be 0: a traced one is not."""
    return not isinstance(number, jax.core.Tracer) and float(number) != 0.0


# ------------------------------------------------------------------------------------------ what comes back


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ContactSolution(status.Judged):
    """A solved contact.

    Attributes:
      approach: δ of the two bodies, contact alone [mm].
      force: of every cell [N], shape (rows, columns); a mirrored cell counts both halves.
      cells: the grid: `cells.x`, `cells.y` centres [mm].
      load: [N]. spall, offset, tilt: as given; `offset` one per spall of several, `tilt` None where it is 0.
      gap: initial gap [mm], shape of `force`.
      moment: Σ f·y of the forces about the roller's middle [N mm]; 0 where half the roller was solved.
      contact_width: longest extent of the contact in the rolling direction [mm].
      loaded_fraction: share of the roller's length on which some cell is loaded [-].
      residual: by cells, the largest violation of the contact conditions relative to the approach; by strips, what the
        places of free boundaries may leave in it, by the deepest overlap, those of slivers too thin for the waves with
        them: inside jit, where these are not solved again, it may be more than the accuracy of what has converged.
      iterations: applications of the influence matrix, or passes over the strips.
      unknowns: of the solve: cells, or modes of all strips.
      status_code: see `difftrb.status`; `status` is its sentence.
      accuracy: relative accuracy of the approach of this solve: as asked or, where strips of that did not converge or
        only know a spall's end about, another.
    """

    approach: Float[Array, ""]
    force: Float[Array, "rows columns"]
    cells: Cells
    load: Float[Array, ""]
    spall: Defect
    offset: Float[Array, "*spalls"]
    tilt: jax.Array | None
    gap: Float[Array, "rows columns"]
    moment: Float[Array, ""]
    contact_width: Float[Array, ""]
    loaded_fraction: Float[Array, ""]
    residual: Float[Array, ""]
    iterations: Int[Array, ""]
    unknowns: Int[Array, ""]
    status_code: Int[Array, ""]
    accuracy: float = dataclasses.field(metadata={"static": True})

    @property
    def pressure(self) -> jax.Array:
        """Mean pressure of every cell [N/mm²], shape (rows, columns)."""
        return self.force / self.cells.area

    @property
    def spalls(self) -> tuple[tuple[Spall | HeightMap, jax.Array], ...]:
        """Every spall or height map, and its offset [mm]."""
        spalls = listed(self.spall)
        return tuple(zip(spalls, xp.module_of(self.offset).broadcast_to(self.offset, (len(spalls),)), strict=True))

    @property
    def peak_pressure(self) -> jax.Array:
        """Largest cell pressure [N/mm²]. Singular at a spall's sharp edge: there it depends on the cell size."""
        return xp.max(self.pressure)


class Found(NamedTuple):
    """What one way of solving finds: approach [mm], force of every cell [N], moment [N mm], width of the contact [mm];
    the rest as in `ContactSolution`, `status_code` not yet of the inputs."""

    approach: Any
    force: Any
    moment: Any
    width: Any
    residual: Any
    iterations: Any
    unknowns: Any
    status_code: Any


def assembled(inputs: Inputs, cells: Cells, gap: jax.Array, accuracy: float, found: Found) -> ContactSolution:
    """The solution, whichever way found it."""
    force = found.force
    rows = xp.where(xp.any(force > 0.0, axis=1), xp.sum(cells.area, axis=1), 0.0)
    fraction = xp.sum(rows) / (xp.sum(cells.widths) * inputs.contact.length)
    width, fraction, residual = xp.fixed((found.width, fraction, found.residual))
    passes = found.iterations.astype(int)
    return ContactSolution(
        found.approach, force, cells, *inputs[1:], gap, found.moment, width, fraction, residual, passes,
        found.unknowns, checked(inputs, found.status_code), accuracy,
    )  # fmt: skip


def gradient_by_name(by: Inputs) -> dict[str, Real | None]:
    """The entries of a gradient that are reported, by name: see `solver.approach_slopes`."""

    def by_size(name: str) -> Real | None:
        if isinstance(by.spall, tuple):
            every = (getattr(each, name) if isinstance(each, Spall) else np.nan for each in by.spall)
            return xp.stack([xp.asarray(value) for value in every])
        return getattr(by.spall, name) if isinstance(by.spall, Spall) else None

    if isinstance(by.spall, tuple):
        offset = xp.where(np.array([isinstance(each, Spall) for each in by.spall]), by.offset, np.nan)
    else:
        offset = by.offset if isinstance(by.spall, Spall) else None
    return {
        "load": by.load, "length": by_size("length"), "width": by_size("width"), "offset": offset,
        "radius": by.contact.radius, "design_load": by.contact.design_load,
    }  # fmt: skip


# ------------------------------------------------------------------------------------------ how it is judged


def settled(residual: jax.Array, tolerance: float) -> jax.Array:
    """The status that an iteration's last `residual` earns."""
    return xp.where(residual <= tolerance, status.CONVERGED, status.NOT_CONVERGED)


def verdict(approach: jax.Array, residual: jax.Array, tolerance: float) -> jax.Array:
    """`settled`; an approach that is no number comes from an input that is none."""
    return xp.where(xp.isfinite(approach), settled(residual, tolerance), status.BAD_INPUT)


def checked(inputs: Inputs, code: jax.Array, suited: jax.Array | bool = True) -> jax.Array:
    """A solve's status `code`, where inputs are finite and within what can be and the way of solving is `suited`."""
    valid = contact_is_valid(inputs.contact) & (inputs.load > 0.0) & xp.all(xp.isfinite(inputs.offset))
    for each in listed(inputs.spall):
        valid = valid & (height_map_is_valid(each) if isinstance(each, HeightMap) else spall_is_valid(each))
    if inputs.tilt is not None:
        valid = valid & xp.isfinite(inputs.tilt)
    return xp.where(valid, xp.where(suited, code, status.UNSUITED), status.BAD_INPUT)


def moment_of(cells: Cells, force: Any) -> Any:
    """Of the cells' forces about the roller's middle [N mm]."""
    return 0.0 * xp.sum(force) if cells.mirrored else xp.sum(force * cells.y[:, None])


def width_of(cells: Cells, force: jax.Array) -> jax.Array:
    """From the first to the last loaded column [mm]."""
    loaded, borders = xp.any(force > 0.0, axis=0), cells.borders
    return xp.max(xp.where(loaded, borders[1:], -np.inf)) - xp.min(xp.where(loaded, borders[:-1], np.inf))


def cut_off(cells: Cells, loaded: jax.Array, approach: jax.Array, gap: jax.Array, contact: LineContact) -> jax.Array:
    """The status `TOUCHES_BORDER` where the domain's border cuts pressure off: not at a roller's end, nor where the gap
    there, the crown's beyond the mean of the last row, exceeds the approach."""
    ends = np.array([0, -1])
    rise = crown.height(cells.lines, contact)[ends] - crown.mean_of_rows(cells.lines, contact)[ends]
    at_ends = loaded[ends] & (gap[ends] + rise[:, None] < approach)
    touched = xp.any(loaded[:, 0] | loaded[:, -1]) | xp.any(at_ends[1 if cells.mirrored else 0 :])
    return xp.where(touched, status.TOUCHES_BORDER, status.CONVERGED)
