"""A solved scene: loads and stiffness, with names and units; and one beside its healthy self."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from difftrb.contact import gap
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import Raceway, Spall
from difftrb.law.base import Law
from difftrb.ring import roller_places
from difftrb.ring.effects import Results
from difftrb.scene.scene import Definition, Picked, Scene, raceway_contact

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float, Int

AXES = ("radial", "lateral", "axial", "about_radial", "about_lateral")
"""Of displacements and stiffness, in their order; the last two where rings tilt."""
LENGTHS = "mm; about_…: rad"
STIFFNESSES = "N/mm; about_… by about_…: N mm/rad; mixed: N/rad, N mm/mm"
"""Of a whole array, whose entries differ where rings tilt."""


def length_of(name: str) -> str:
    """Unit of the displacement along or about an axis."""
    return "rad" if name.startswith("about") else "mm"


def stiffness_of(name: str, by: str | None = None) -> str:
    """Unit of the force along an axis (or the moment about it) by the motion along (about) another; default: itself."""
    force = "N mm" if name.startswith("about") else "N"
    return f"{force}/{length_of(name if by is None else by)}"


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, repr=False)
class Solution(status.Judged):
    """A solved scene.

    Attributes:
      angles: of the rollers from the load line [rad], shape (rollers,); with phase "mean" at its middle, half a pitch
        on. All else is then the mean over the phases: of one roller as it rolls on to the next one's place.
      displacement: radial, lateral, axial [mm], shape (3,); with the effect `Tilt` also about the radial and the
        lateral axis [rad], shape (5,), and stiffness of shape (5, 5).
      approach: of every roller [mm], shape (rollers,). loads: on the outer raceway [N], shape (rollers,).
      stiffness: [N/mm], shape (3, 3) over radial, lateral, axial: dF/du if `definition` is "tangent"; the diagonal of
        F/u if "secant" (0 for the lateral direction, which has no load; NaN for a direction without load,
        and for a mean over phases within which u changes its sign).
      load_span, stiffness_span: least and largest over the phases that are solved, shapes (2, rollers) and (2, 3, 3);
        the same twice at one phase.
      law: the roller law that was used, with its range and error.
      residual: largest unbalanced force relative to the load. iterations: Newton steps.
      status_code: see `difftrb.status`; `status` is its sentence.
      effects: what the scene's effects add, by name; empty without.
      picked: what the law "auto" became; None if the law was named.
      definition: "tangent" or "secant".
      remarks: what is to be said of these numbers, in sentences; mostly none.
    """

    angles: Float[Array, " rollers"]
    displacement: Float[Array, " axes"]
    approach: Float[Array, " rollers"]
    loads: Float[Array, " rollers"]
    stiffness: Float[Array, "axes axes"]
    load_span: Float[Array, "2 rollers"]
    stiffness_span: Float[Array, "2 axes axes"]
    law: Law
    residual: Float[Array, ""]
    iterations: Int[Array, ""]
    status_code: Int[Array, ""]
    effects: Results
    picked: Picked | None
    definition: Definition = dataclasses.field(metadata={"static": True})
    remarks: tuple[str, ...] = dataclasses.field(default=(), metadata={"static": True})

    @property
    def radial_stiffness(self) -> jax.Array:
        """Radial force per radial displacement [N/mm]."""
        return self.stiffness[0, 0]

    @property
    def axial_stiffness(self) -> jax.Array:
        """Axial force per axial displacement [N/mm]."""
        return self.stiffness[2, 2]

    def to_xarray(self) -> Any:
        """An `xarray.Dataset` with axes named radial, lateral, axial (and about_radial, about_lateral) and rollers by
        their angle: `displacement`, `stiffness` (of the force along `axis` by the motion along `motion`), `loads`,
        `approach`, residual and status. Needs xarray: `pip install '.[io]'`."""
        import xarray  # pyright: ignore[reportMissingImports]

        names = list(AXES[: np.shape(self.displacement)[0]])
        units = {"displacement": LENGTHS, "stiffness": STIFFNESSES, "loads": "N", "approach": "mm"}
        values = {
            "displacement": (("axis",), self.displacement),
            "stiffness": (("axis", "motion"), self.stiffness),
            "loads": (("roller",), self.loads),
            "approach": (("roller",), self.approach),
        }
        variables = {name: (dims, np.asarray(value), {"units": units[name]}) for name, (dims, value) in values.items()}
        variables["stiffness"][2]["definition"] = self.definition
        variables |= {"residual": ((), np.asarray(self.residual)), "status_code": ((), np.asarray(self.status_code))}
        angles = "angle", ("roller",), np.asarray(self.angles)
        coordinates = {"axis": names, "motion": names, angles[0]: (angles[1], angles[2], {"units": "rad"})}
        return xarray.Dataset(variables, coordinates, {"status": self.status, "law": self.law.name})

    def __repr__(self) -> str:
        """On a few lines: what it is of, displacement, stiffness, the largest load."""
        if not xp.are_numbers((self.stiffness, self.displacement, self.loads, self.status_code)):
            return f"Solution(traced, {self.definition})"
        if np.ndim(self.status_code):
            return f"Solution of {'×'.join(map(str, np.shape(self.status_code)))} scenes: {self.status}"
        names = AXES[: np.shape(self.displacement)[0]]
        moved, stiff = np.asarray(self.displacement), np.diagonal(np.asarray(self.stiffness))
        rows = [f"Solution: {self.status}; law {self.law.name}"]
        for name, u, k in zip(names, moved, stiff, strict=True):
            rows.append(f"  {name:13s} {u:12.5g} {length_of(name):3s}  {self.definition} {k:12.6g} "
                        f"{stiffness_of(name)}")  # fmt: skip
        loads, angles = np.asarray(self.loads), np.asarray(self.angles)
        if np.isfinite(loads).all():
            top = int(np.argmax(loads))
            rows.append(f"  {loads.size} rollers, up to {loads[top]:.1f} N at {angles[top]:.4f} rad")
        return "\n".join([*rows, *(f"  note: {remark}" for remark in self.remarks)])

    def loads_of(self, row: int) -> Any:
        """Of the rollers of one row, 1 or 2, on their outer raceway [N], shape (rollers,)."""
        return self.loads if row == 1 else self.effects["second_row_loads"]

    @property
    def both_stiffnesses(self) -> jax.Array:
        """Radial and axial [N/mm], shape (2,)."""
        return xp.stack([self.radial_stiffness, self.axial_stiffness])


def stiffness_loss(spalled: Any, healthy: Any) -> Any:
    """How much of a stiffness spalls take [%], of any shape."""
    return 100.0 * (1.0 - spalled / healthy)


class RollersAt(NamedTuple):
    """The rollers of one row beside a spall of it, shape (rollers,) each: their loads on its raceway [N], how far they
    are from its middle, and their contacts' half widths [mm]."""

    spall: Spall
    loads: np.ndarray
    distances: np.ndarray
    half_widths: np.ndarray

    @property
    def meeting(self) -> np.ndarray:
        """Which loaded rollers' contacts reach the spall."""
        return (np.abs(self.distances) < 0.5 * float(self.spall.width) + self.half_widths) & (self.loads > 0.0)

    @property
    def on_edges(self) -> np.ndarray:
        """Which loaded rollers' contacts reach over a rolling edge of it."""
        beside = np.abs(np.abs(self.distances) - 0.5 * float(self.spall.width))
        return (beside < self.half_widths) & (self.loads > 0.0)


def rollers_at(scene: Scene, at: Solution, spall: Spall, raceway: Raceway = "outer") -> RollersAt:
    """Of the solution `at` of a scene, beside one of its spalls."""
    loads = np.asarray(at.loads_of(spall.row) if raceway == "outer" else at.effects["inner_loads"])
    away = np.asarray(roller_places.distances(scene.bearing, (spall,), at.angles, raceway))[0]
    return RollersAt(spall, loads, away, np.asarray(gap.half_width(raceway_contact(scene, raceway), loads)))


class Assessment(NamedTuple):
    """A spalled bearing beside its healthy self.

    Attributes:
      spalled, healthy: the two solutions.
      loss: of radial and axial stiffness by the spalls [%], shape (2,).
      by_length, by_width: derivatives of radial and axial stiffness by every spall's length and width, the roller law
        held as prepared [N/mm per mm], shape (2, number of spalls); NaN where the stiffness is.
    """

    spalled: Solution
    healthy: Solution
    loss: Float[Array, " directions"]
    by_length: Float[Array, "directions spalls"]
    by_width: Float[Array, "directions spalls"]
