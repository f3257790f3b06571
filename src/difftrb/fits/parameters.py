"""What a fit may ask for: the spall's size and place, and what else the measurements depend on, each within bounds.

A fit moves in coordinates u without bounds: a value runs from its lower to its upper bound as 1/(1 + e⁻ᵘ) runs from 0
to 1, in its logarithm where it is a size.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import geometry, status
from difftrb.core.geometry import LineContact, Real
from difftrb.fits.measured import MeasuredError, Measurement
from difftrb.law.laws import Law
from difftrb.ring.ring import needed_axial
from difftrb.scene.scene import Scene

NAMES = ("length", "width", "depth", "angle", "axial_offset", "crown", "preload", "scale")
OF_SPALL = ("length", "width", "depth", "angle", "axial_offset")
SIGNED = ("angle", "axial_offset", "preload")
"""What is no size: its differences count, not its ratios."""
SHORTEST = 0.01
"""Smallest length, as a share of the longest."""
NARROWEST = 0.1
"""Smallest width [mm] for laws that take any."""
CROWN = 4.0
"""By what factor the crown may be off, if the law knows so much."""
SCALE = 0.1, 1.5
FARTHEST = 14.0
"""Coordinates beyond ± this are at the bound to 1e-6 of the range."""
NO_EFFECT = {
    "length": "without a spall that a roller meets nothing depends on its length",
    "width": "under this law width acts through the number of rollers inside only: give rows with phase = mean",
    "depth": "the spall is deeper than rollers sink, or the law does not know depth: leave depth out",
    "angle": "without a radial load all angles are alike: measure under a radial load, or leave angle out",
    "axial_offset": "the law is frozen at the scene's axial_offset: fit scenes with several and compare their χ²",
    "crown": "the law is frozen at the scene's design_load: use contact.law = 'table', or leave crown out",
    "preload": "nothing depends on the axial load here: leave preload out",
    "scale": "nothing depends on the scale here: leave it out",
}


@partial(jax.tree_util.register_dataclass, data_fields=["low", "high"], meta_fields=["names"])
@dataclasses.dataclass(frozen=True)
class Unknowns:
    """What is fitted: names, and bounds [mm, rad, N, –], shape (unknowns,) each."""

    names: tuple[str, ...]
    low: jax.Array
    high: jax.Array

    @property
    def logarithmic(self) -> np.ndarray:
        """Which are sizes, whose relative changes count; shape (unknowns,)."""
        return np.array([name not in SIGNED for name in self.names])

    def values(self, u: jax.Array) -> jax.Array:
        """Values at coordinates u, both of shape (unknowns,)."""
        low, high = self.ends()
        raw = low + (high - low) * jax.nn.sigmoid(u)
        return jnp.where(self.logarithmic, jnp.exp(jnp.where(self.logarithmic, raw, 0.0)), raw)

    def coordinates(self, values: jax.Array) -> jax.Array:
        """Coordinates of values, both of shape (…, unknowns); values at a bound or beyond are moved inside."""
        low, high = self.ends()
        raw = jnp.where(self.logarithmic, jnp.log(jnp.where(self.logarithmic, values, 1.0)), values)
        low, high = (jnp.broadcast_to(end, raw.shape) for end in (low, high))
        share = jnp.clip((raw - low) / (high - low), 1e-6, 1.0 - 1e-6)
        return jnp.log(share / (1.0 - share))

    def ends(self) -> tuple[jax.Array, jax.Array]:
        """The bounds, of sizes their logarithms; shape (unknowns,) each."""

        def raw(bound: jax.Array) -> jax.Array:
            return jnp.where(self.logarithmic, jnp.log(jnp.where(self.logarithmic, bound, 1.0)), bound)

        return raw(self.low), raw(self.high)


UNITS = {"length": "mm", "width": "mm", "depth": "mm", "angle": "rad", "axial_offset": "mm", "crown": "N",
         "preload": "N", "scale": "–"}  # fmt: skip


class Applied(NamedTuple):
    """A scene with the unknowns put in; `preload` [N] adds to every axial load, `scale` multiplies every stiffness."""

    scene: Scene
    preload: Real
    scale: Real


def apply(unknowns: Unknowns, scene: Scene, values: jax.Array) -> Applied:
    """Put values, shape (unknowns,), into a prepared scene; those of the spall into its first."""
    named: dict[str, Real] = dict(zip(unknowns.names, values, strict=True))
    of_spall = {name: named[name] for name in OF_SPALL if name in named}
    spalls = (dataclasses.replace(scene.spalls[0], **of_spall), *scene.spalls[1:])
    crown = named.get("crown", scene.design_load)
    changed = dataclasses.replace(scene, spalls=spalls, design_load=crown)
    return Applied(changed, named.get("preload", 0.0), named.get("scale", 1.0))


def own(scene: Scene, name: str) -> float:
    """The scene's own value of an unknown."""
    if name in OF_SPALL:
        return float(getattr(scene.spalls[0], name))
    return float({"crown": scene.design_load, "preload": 0.0, "scale": 1.0}[name])


def bounded(scene: Scene, rows: Sequence[Measurement], names: Sequence[str]) -> Unknowns:
    """Unknowns of a prepared scene with bounds from what its law knows; raises `MeasuredError`.

    length: from a hundredth of the longest spall that the law takes to that. width: from the narrowest it takes to half
    the raceway. depth, crown, axial_offset: as far as the law goes (crown at most a factor of 4; a "table" 0.02 mm to
    either side of the scene's axial_offset). angle: −π…π. preload: 0… the largest axial load measured. scale: 0.1…1.5.
    """
    for name in names:
        if name not in NAMES:
            raise MeasuredError(f"parameters: {name!r} is not known; use some of {', '.join(NAMES)}")
    if not names or len(set(names)) < len(names):
        raise MeasuredError(f"parameters = {', '.join(names)}: name at least one, and each once")
    if not scene.spalls:
        raise MeasuredError("the scene has no [[spall]] to fit: give one, with a guess of its size")
    ranges = _ranges(scene, rows, names)
    low, high = (jnp.array([ranges[name][k] for name in names]) for k in (0, 1))
    return Unknowns(tuple(names), low, high)


def _ranges(scene: Scene, rows: Sequence[Measurement], names: Sequence[str]) -> dict[str, tuple[float, float]]:
    longest, narrowest = map(float, _size_limits(scene))
    ranges = {
        "length": (SHORTEST * longest, longest),
        "width": (max(1.01 * narrowest, NARROWEST), float(_half_way(scene))),
        "angle": (-np.pi, np.pi),
        "preload": (0.0, max(float(row.axial) for row in rows) or 1.0),
        "scale": SCALE,
    }
    half = 0.5 * float(scene.bearing.roller_length)
    for name in ("depth", "axial_offset", "crown"):
        if name in names:
            if scene.law.hard:  # type: ignore[union-attr]  # such laws are frozen
                raise MeasuredError(f"parameters: {name} cannot be fitted: {NO_EFFECT[name]}")
            value = own(scene, name)
            farthest = {
                "depth": (0.1 * value, 10.0 * value),
                "axial_offset": (-half, half),
                "crown": (value / CROWN, CROWN * value),
            }[name]
            low, high = map(float, _other_limits(scene, jnp.asarray(longest), jnp.asarray(farthest), name))
            if not high - low > 1e-6 * max(abs(low), abs(high)):
                raise MeasuredError(f"parameters: {name} cannot be fitted: {NO_EFFECT[name]}")
            ranges[name] = low, high
    return ranges


def _half_way(scene: Scene) -> Real:
    """Half way round the raceway [mm]."""
    return jnp.pi * geometry.arc_radius(scene.bearing)


def _known(scene: Scene, **changed: Real) -> jax.Array:
    """Whether the law knows the scene's spalls, the first one changed; `crown` changes the rollers."""
    crown = changed.pop("crown", scene.design_load)
    law: Law = scene.law  # type: ignore[assignment]  # it is prepared
    at = law.at(LineContact.of(scene.bearing, "outer", crown))
    spalls = (dataclasses.replace(scene.spalls[0], **changed), *scene.spalls[1:])
    return at.judge(spalls, jnp.zeros((len(spalls), 1))) == status.CONVERGED


@jax.jit
def _size_limits(scene: Scene) -> tuple[jax.Array, jax.Array]:
    """The longest spall that the law takes and, of those, the narrowest [mm]."""
    length, half_way = scene.bearing.roller_length, _half_way(scene)
    longest = limit(lambda v: _known(scene, length=v, width=0.5 * half_way), 0.02 * length, length)
    return longest, limit(lambda v: _known(scene, length=longest, width=v), 0.5 * half_way, 0.01)


@partial(jax.jit, static_argnames="name")
def _other_limits(scene: Scene, longest: jax.Array, farthest: jax.Array, name: str) -> tuple[jax.Array, jax.Array]:
    """Between which depths, axial offsets [mm] or crowns [N], of those between the two `farthest`, the law knows the
    shortest and the longest spalls."""
    value = scene.design_load if name == "crown" else getattr(scene.spalls[0], name)

    def takes(v: jax.Array) -> jax.Array:
        each = [_known(scene, width=0.5 * _half_way(scene), length=l, **{name: v}) for l in (0.02 * longest, longest)]
        return each[0] & each[1]

    return limit(takes, value, farthest[0]), limit(takes, value, farthest[1])


def limit(holds: Callable[[jax.Array], jax.Array], inside: Real, outside: Real) -> jax.Array:
    """How far from `inside`, where it holds, towards `outside` it keeps holding."""

    def halve(_: int, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        middle = 0.5 * (ends[0] + ends[1])
        good = holds(middle)
        return jnp.where(good, middle, ends[0]), jnp.where(good, ends[1], middle)

    # one step beyond, so that an end where it holds is found, too
    beyond = inside + (outside - inside) * (1.0 + 1e-9)
    end = jax.lax.fori_loop(0, 50, halve, (jnp.asarray(inside, float), jnp.asarray(beyond, float)))[0]
    return jnp.where(outside > inside, jnp.minimum(end, outside), jnp.maximum(end, outside))


def check_loads(scene: Scene, rows: Sequence[Measurement], path: str = "measurements") -> None:
    """Refuse rows under which the ring has no equilibrium or the stiffness asked for does not exist."""
    for k, row in enumerate(rows, 1):
        phase = scene.phase if row.phase is None else row.phase
        worst = phase if isinstance(phase, float | int) else 0.5 * geometry.roller_pitch(scene.bearing)
        needed = float(needed_axial(scene.bearing, row.radial, worst))
        where = f"{path}: row {k}"
        if row.axial <= needed * (1.0 + 1e-6) or row.axial == 0.0:
            raise MeasuredError(
                f"{where}: axial = {row.axial:g} N is too small for an equilibrium: with radial = {row.radial:g} N it "
                f"must exceed {needed:.6g} N; check both loads of this row"
            )
        if (row.definition or scene.definition) == "secant" and row.radial == 0.0 and row.quantity[:6] == "radial":
            raise MeasuredError(
                f"{where}: quantity = {row.quantity!r}: a secant radial stiffness F/u needs a radial load; give "
                "definition = tangent, or leave the row out"
            )
