"""Stiffness, displacement and loads over the cage's angle, with their derivatives by the spalls' sizes.

Cage phases are solved together, as one axis: numbers by numpy, what is traced by one program. As the cage turns by Δ,
the outer ring at rest, the inner ring turns by Δ / cage_share, and rollers spin by spin_share Δ against the cage:
spalls on these surfaces move along.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import fields, geometry, implicit, status
from difftrb.core.geometry import Real, TaperedBearing
from difftrb.core.input_errors import is_whole
from difftrb.core.jax_config import jit_quickly
from difftrb.core.status import SceneError
from difftrb.law import base
from difftrb.law.samples import Progress
from difftrb.ring import effect_base
from difftrb.scene import auto_law, checks, prepared_scene, solving
from difftrb.scene.scene import COARSEST, PitchMean, Scene, has_map, is_auto, named

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Complex, Float, Int

TURN_PHASES = 64
ENOUGH = 16
"""Phases a roller's passage from which orders are told where rollers differ: with fewer, those of its passage stand
among those of the cage."""
MOST = 4096
FINEST = 1e-4
"""Accuracy of contact solves that "auto" may need to fall back on."""
Repeats = Literal["pitch", "turn", "never"]
"""After which angle of the cage all is as before: one roller pitch, its whole turn (rollers differ), or none (spalls
move along with the inner ring or with rollers)."""


class Orders(NamedTuple):
    """Fourier coefficients over what repeats: value(θ) = Re Σ c_n exp(i n θ), θ = 2π (cage − first)/span.

    Attributes:
      order: n, shape (orders,), from 0: multiples of BPFO, or of FTF where rollers differ.
      stiffness: [N/mm], shape (orders, axes, axes). displacement: [mm], shape (orders, axes).
    """

    order: Int[Array, " orders"]
    stiffness: Complex[Array, "orders axes axes"]
    displacement: Complex[Array, "orders axes"]


@fields.register
@dataclasses.dataclass(frozen=True, repr=False)
class CageTurn(status.Judged):
    """A ring over the angle of its cage. All arrays have phases first.

    Attributes:
      cage: angle of roller 0 from the load line [rad], shape (phases,), evenly spaced, `span` apart in all.
      displacement: radial, lateral, axial [mm] (with rings that tilt also about radial and lateral [rad]), shape
        (phases, axes): the quasi-static waveform under the constant load.
      loads: on the outer raceway [N], shape (phases, rollers).
      stiffness: tangent dF/du [N/mm] (with tilt also [N/rad], [N mm/rad]), shape (phases, axes, axes).
      by_length, by_width: derivatives of the stiffness by every spall's size [per mm], shape (phases, axes, axes,
        spalls); None if they were not asked for.
      status_code: of every phase, shape (phases,); `status` is the worst one's sentence.
      span: angle of the cage that the phases divide [rad]. bearing: whose cage it is.
      repeats: "pitch", "turn" or "never": see `Repeats`.
    """

    cage: Float[Array, " phases"]
    displacement: Float[Array, "phases axes"]
    loads: Float[Array, "phases rollers"]
    stiffness: Float[Array, "phases axes axes"]
    by_length: Float[Array, "phases axes axes spalls"] | None
    by_width: Float[Array, "phases axes axes spalls"] | None
    status_code: Int[Array, " phases"]
    span: Real
    bearing: TaperedBearing
    repeats: Repeats = dataclasses.field(metadata={"static": True})

    @property
    def no_orders(self) -> str | None:
        """Why no orders are told, in one sentence: nothing repeats, or a roller's passage would pass for one of the
        cage's orders. None: they are."""
        if self.repeats == "never":
            return "nothing repeats over this span; leave span out, and spalls on other surfaces"
        count, least = self.cage.shape[0], ENOUGH * self.bearing.rollers
        if self.repeats == "turn" and count < least:
            return (
                f"{count} phases of a whole turn do not tell a roller's passage from the cage's turn; give phases = "
                f"{least} or more"
            )
        return None

    @property
    def mean_stiffness(self) -> jax.Array:
        """Over the phases [N/mm], shape (axes, axes)."""
        return jax.device_put(_told(self.stiffness).mean(axis=0))

    @property
    def waveform(self) -> jax.Array:
        """Displacement against its mean [mm], shape (phases, axes): what a sensor would see at creeping speed."""
        own = _told(self.displacement)
        return jax.device_put(own - own.mean(axis=0, keepdims=True))

    def time(self, speed_rpm: Real) -> jax.Array:
        """When the cage is there [s], shape (phases,), from 0, the inner ring at `speed_rpm`, the outer at rest."""
        if xp.are_numbers(speed_rpm) and not _is_above_0(speed_rpm):
            raise SceneError(f"speed_rpm = {speed_rpm!r}: must be a number above 0 rev/min, and finite")
        cage, bearing, speed_rpm = _told((self.cage, self.bearing, speed_rpm))
        return jax.device_put((cage - cage[0]) / geometry.cage_rate(bearing, speed_rpm))

    def orders(self, highest: int = 16) -> Orders:
        """Fourier orders 0 … `highest` (at most half the phases) of stiffness and displacement. Raises `SceneError` if
        nothing repeats, or there are too few phases: 16 a roller where rollers differ."""
        if (sentence := self.no_orders) is not None:
            raise SceneError(f"orders: {sentence}")
        count = self.cage.shape[0]
        if not is_whole(highest, 0, count // 2):
            raise SceneError(f"highest = {highest!r}: must be a whole number in 0 … {count // 2}, half of the phases")

        order = np.arange(highest + 1)
        doubled = np.where((order > 0) & (2 * order < count), 2.0, 1.0)

        def coefficients(values: Any) -> Any:
            found = xp.module_of(values).fft.rfft(values, axis=0)[: highest + 1] / count
            return found * doubled.reshape(-1, *[1] * (values.ndim - 1))

        own = _told((self.stiffness, self.displacement))
        return Orders(*jax.device_put((order, *map(coefficients, own))))

    def in_series(self, *others: Any) -> CageTurn:
        """With springs in series, a shaft and a housing, say: each the stiffness of one [N/mm] along all axes, shape
        (axes,), or a matrix, shape (axes, axes); radial, lateral, axial. The load stays: it passes through all.
        Displacements stay those of the bearing."""
        axes = self.stiffness.shape[-1]
        matrices = [_as_matrix(other, axes) for other in others]
        stiffness, *slopes, matrices = _told((self.stiffness, self.by_length, self.by_width, matrices))
        of, unit = xp.module_of((stiffness, matrices)), np.eye(axes)
        give = sum((of.linalg.inv(matrix) for matrix in matrices), np.zeros((axes, axes)))
        own = unit[None] + of.einsum("pij,jk->pik", stiffness, give)
        total = of.linalg.solve(own, stiffness)  # (K⁻¹ + C)⁻¹ = (1 + K C)⁻¹ K
        # dK_total = (1 + K C)⁻¹ dK (1 + C K)⁻¹, whose ends are each other's mirror where C is symmetric alone
        left, right = of.linalg.inv(own), unit[None] - of.einsum("ij,pjk->pik", give, total)

        def through(slopes: Any) -> jax.Array | None:
            return None if slopes is None else jax.device_put(of.einsum("pij,pjks,pkl->pils", left, slopes, right))

        by = [through(each) for each in slopes]
        return dataclasses.replace(self, stiffness=jax.device_put(total), by_length=by[0], by_width=by[1])

    def __repr__(self) -> str:
        """On one line."""
        if not xp.are_numbers((self.cage, self.stiffness)):
            return f"CageTurn(traced, {self.cage.shape[0]} phases)"
        stiffness = np.asarray(self.stiffness)
        parts = [f"{name} {stiffness[:, k, k].min():.6g} … {stiffness[:, k, k].max():.6g}"
                 for k, name in ((0, "radial"), (2, "axial"))]  # fmt: skip
        return f"CageTurn of {stiffness.shape[0]} phases: {', '.join(parts)} N/mm; {self.status}"


def _is_above_0(value: Any) -> bool:
    try:
        return not isinstance(value, str) and 0.0 < float(value) < np.inf
    except (TypeError, ValueError):
        return False


def _told(values: Any) -> Any:
    """Numbers as numpy's, for which nothing is compiled; what is traced as it is."""
    return xp.numbers(values) if xp.are_numbers(values) else values


def _as_matrix(stiffness: Any, axes: int) -> Any:
    try:
        given = jnp.asarray(stiffness, float) if xp.of_jax(stiffness) else np.asarray(stiffness, float)
    except (TypeError, ValueError):
        raise SceneError(f"a stiffness in series = {stiffness!r}: must be numbers [N/mm]") from None
    if xp.are_numbers(given) and given.shape in ((axes,), (axes, axes)):
        own = np.diag(given) if given.ndim == 1 else np.asarray(given)
        if not np.isfinite(own).all() or not (np.linalg.eigvalsh(0.5 * (own + own.T)) > 0.0).all():
            raise SceneError("a stiffness in series must be above 0 N/mm along every axis, and finite")
    if given.shape == (axes,):
        return given[:, None] * np.eye(axes)
    if given.shape == (axes, axes):
        return given
    raise SceneError(f"a stiffness in series has shape {given.shape}: give ({axes},) or ({axes}, {axes}) [N/mm]")


# ------------------------------------------------------------------------------------------------ solving


def stiffness(
    scene: Scene, phases: int | None = None, span: float | None = None, slopes: bool | None = None,
    progress: Progress | None = None,
) -> CageTurn:  # fmt: skip
    """A scene over its cage's angle, from `scene.phase` on (from 0 for "mean").

    `phases` is how many, 1…4096, default 64, and where rollers differ so many a roller, at most 4096. `span` is the
    angle they divide [rad]: by default one roller pitch, after which spalls on the outer raceway meet the next roller
    alike; where rollers differ the cage's whole turn; with
    spalls on the inner raceway or a roller one turn of the inner ring. Law "auto" is "table" where that knows all
    phases, else contacts are solved phase by phase, which takes minutes; `progress` is told. `slopes` asks for
    derivatives by the spalls' sizes; default: where they cost next to nothing, of numbers.

    Differentiable by every number of the scene, `jit` and `vmap` as `solve`. Raises `SceneError` as `solve`; phases
    without a solution have NaN and a status.
    """
    if phases is not None and not is_whole(phases, 1, MOST):
        raise SceneError(f"phases = {phases!r}: must be a whole number in 1 … {MOST}")
    scene = checks.checked(scene)
    start: Any = 0.0 if isinstance(scene.phase, PitchMean) else scene.phase
    repeats, natural = _repetition(scene)
    if span is not None:
        if xp.are_numbers(span) and not _is_above_0(span):
            raise SceneError(f"span = {span!r}: must be a number above 0 rad, and finite")
        repeats, natural = "never", span
    if phases is None:
        phases = min(TURN_PHASES * (scene.bearing.rollers if repeats == "turn" else 1), MOST)
    spread = natural * (np.arange(phases) / phases)
    found = _solved(dataclasses.replace(scene, phase=start), spread, slopes, progress)
    return CageTurn(jax.device_put(start + spread), *found, natural, scene.bearing, repeats)


def _repetition(scene: Scene) -> tuple[Repeats, Real]:
    if any(getattr(spall, "surface", "outer") != "outer" for spall in scene.spalls):
        return "never", 2.0 * np.pi * geometry.cage_share(scene.bearing)
    if effect_base.differ(scene.effects):
        return "turn", 2.0 * np.pi
    return "pitch", geometry.roller_pitch(scene.bearing)


class _Found(NamedTuple):
    """As in `CageTurn`."""

    displacement: Any
    loads: Any
    stiffness: Any
    by_length: Any
    by_width: Any
    status_code: Any


def _solved(scene: Scene, spread: Any, slopes: bool | None, progress: Progress | None) -> _Found:
    """At the scene's phase and angles of the cage beyond it [rad], shape (phases,)."""
    by_table, accuracy = is_auto(scene), min(max(scene.accuracy, FINEST), COARSEST)
    if by_table and has_map(scene):
        return _one_by_one(named(scene, "direct", accuracy), spread, slopes, progress)
    if not by_table and base.kind(getattr(scene.law, "name", "")).one_scene:
        return _one_by_one(scene, spread, slopes, progress)
    ready = auto_law.by_table(scene) if by_table else solving.prepare(scene, progress)
    numbers = xp.are_numbers((ready, spread))
    found = _by_numbers(ready, spread) if numbers and slopes is not False else _traced(ready, spread, bool(slopes))
    if by_table and numbers and np.isin(np.asarray(found.status_code), auto_law.UNKNOWN).any():
        return _one_by_one(named(scene, "direct", accuracy), spread, slopes, progress)
    return found


@np.errstate(all="ignore")
def _by_numbers(scene: Scene, spread: Any) -> _Found:
    """At all phases at once, in numpy, with slopes."""
    return jax.device_put(_with_slopes(xp.numbers(scene), np.asarray(spread, float)))


def _traced(scene: Scene, spread: Any, slopes: bool) -> _Found:
    """Any ring: without slopes by one expansion, whose derivatives outside `jit` compile nothing; else by a program."""
    if slopes:
        return _program_with_slopes(scene, spread)
    rest = implicit.expanded(partial(_at_rest, spread), scene)
    return _Found(rest.displacement, rest.loads, rest.tangent, None, None, rest.status_code)


def _with_slopes(scene: Scene, spread: Any) -> _Found:
    """In any arithmetic."""
    rest, count = _at_rest(spread, prepared_scene.with_sizes_expanded(scene)), len(scene.spalls)
    tangent, by = xp.value(rest.tangent), xp.by(rest.tangent)
    of = xp.module_of(tangent)
    slopes = np.zeros((2 * count, *tangent.shape)) if by is None else by
    slopes = of.moveaxis(slopes.reshape(count, 2, *tangent.shape), (0, 1), (-2, -1))
    slopes = of.where(of.isnan(tangent)[..., None, None], np.nan, slopes)
    code = of.broadcast_to(rest.status_code, tangent.shape[:1])  # laws may judge all phases together
    return _Found(xp.value(rest.displacement), xp.value(rest.loads), tangent, slopes[..., 0], slopes[..., 1], code)


_program_with_slopes = jit_quickly()(_with_slopes)


def _at_rest(spread: Any, scene: Scene) -> Any:
    cage = xp.asarray(scene.phase) + spread
    return prepared_scene.at_phases(scene, cage, spalls=_turned(scene, cage[:, None]).spalls)


def _turned(scene: Scene, cage: Any) -> Scene:
    """The scene with the cage at this angle, and spalls on inner raceway and roller moved along."""
    turn = cage - scene.phase
    ways = {"inner": 1.0 / geometry.cage_share(scene.bearing), "roller": -geometry.spin_share(scene.bearing)}
    spalls = tuple(
        spall if spall.surface == "outer"
        else dataclasses.replace(spall, angle=geometry.wrapped(spall.angle + ways[spall.surface] * turn))
        for spall in scene.spalls
    )  # fmt: skip
    return dataclasses.replace(scene, phase=cage, spalls=spalls)


def _one_by_one(scene: Scene, spread: Any, slopes: bool | None, progress: Progress | None) -> _Found:
    """Contacts solved for each phase; needs numbers."""
    if not xp.are_numbers((scene, spread)):
        raise SceneError("contact.law = 'direct': solves contacts phase by phase and cannot be traced; use 'table'")
    found = []
    for k, more in enumerate(np.asarray(spread, float)):
        ready = solving.prepare(_turned(scene, scene.phase + more))
        found.append(_by_numbers(ready, np.zeros(1)))
        if progress is not None:
            progress(k + 1, len(spread))
    every = jax.tree.map(lambda *parts: jnp.concatenate(parts), *found)
    return every if slopes is not False else every._replace(by_length=None, by_width=None)
