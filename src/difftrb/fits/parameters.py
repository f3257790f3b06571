"""The numbers that a fit can find: each declares its unit, range and start, and what it does, beside its own code.

A new one is a class of `Parameter` under `@register`; nothing else needs to know its name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core import geometry, status
from difftrb.core.geometry import LineContact, Real
from difftrb.core.input_errors import did_you_mean
from difftrb.core.jax_config import jit_quickly
from difftrb.core.numeric import bisected
from difftrb.fits.least_squares import Bounds
from difftrb.fits.measured import MeasuredError, Measurement
from difftrb.law.base import Law
from difftrb.ring.load import Load
from difftrb.scene.scene import Scene


class Parameter:
    """A number that a fit can find. Methods that are not overridden change nothing."""

    name: ClassVar[str]
    unit: ClassVar[str]
    no_effect: ClassVar[str]
    """Why measurements may not depend on it, and what to do: the end of an error sentence."""
    label: ClassVar[str] = ""
    """In figures. Default: the name."""
    low: ClassVar[float]
    high: ClassVar[float]
    """Range that is searched [unit], unless `limits` says it."""
    default: ClassVar[float]
    """Value without a fit, where the first start lies [unit], unless `start` says it."""
    prior: ClassVar[float] = 5.0
    """Standard deviation before any measurement [coordinates]; 5 is the whole range."""
    logarithmic: ClassVar[bool] = True
    """Whether it is a size, above 0, whose ratios count; else its differences count."""
    wide: ClassVar[float] = 1.5
    """An interval whose ends differ by more does not determine it: by this factor or, if not logarithmic, [unit]."""
    period: ClassVar[float | None] = None
    """Values that differ by this much are one [unit]; its range goes once round, and on a little beyond either end, so
    that nothing ends there."""
    natural: ClassVar[tuple[bool, bool]] = (False, False)
    """Whether its range ends, low and high, where nature ends it, so that nothing lies beyond what is searched."""
    multiplies: ClassVar[bool] = False
    """Whether all losses are more or less with it by about one factor: few of its values are tried."""
    in_products: ClassVar[bool] = True
    """Whether to say how well a product of it and other sizes is determined."""
    changes_healthy: ClassVar[bool] = True
    """Whether the healthy bearing's stiffness depends on it (`measured` apart)."""
    suspect: ClassVar[str] = ""
    """What may be wrong with measurements that a fit misses but does not when this is fitted, too: the end of a
    sentence. Empty: nothing."""

    def in_words(self, value: float, digits: int = 3) -> str:
        """This value in a sentence, with its name."""
        return f"{self.name} {value:.{digits}g} {self.unit}".removesuffix(" –")

    def limits(self, scene: Scene, rows: Sequence[Measurement]) -> tuple[float, float]:
        """The range that is searched [unit]; an empty one refuses the parameter."""
        return self.low, self.high

    def start(self, scene: Scene) -> float:
        """The scene's own value [unit]."""
        return self.default

    def apart(self, scene: Scene) -> float:
        """How far apart two values may lead to two answers: by this factor's logarithm or, if not logarithmic, [unit].
        Default: a sixth of the range, or a factor of 1.5."""
        return float(np.log(1.5)) if self.logarithmic else (self.high - self.low) / 6.0

    def scene(self, scene: Scene, value: Real) -> Scene:
        """The prepared scene with this value."""
        return scene

    def load(self, load: Load, value: Real) -> Load:
        """The load on the bearing where `load` was measured [N]."""
        return load

    def measured(self, healthy: jax.Array, added: jax.Array, value: Real) -> tuple[jax.Array, jax.Array]:
        """What is measured of the bearing: its healthy stiffness [N/mm], and the share of the healthy compliance that
        spalls add, shape (rows,) each."""
        return healthy, added


PARAMETERS: dict[str, Parameter] = {}
"""What can be fitted, by name."""


def register(kind: type[Parameter]) -> type[Parameter]:
    """Add a parameter to `PARAMETERS`: a decorator. Raises `MeasuredError` if its declaration cannot be right."""
    name = kind.name
    if name in PARAMETERS:
        raise MeasuredError(f"parameter {name}: there is one of this name; choose another")
    if kind.limits is Parameter.limits:
        low, high, above = kind.low, kind.high, " above 0" if kind.logarithmic else ""
        if not low < high or (above and low <= 0.0):
            raise MeasuredError(f"parameter {name}: low = {low:g}, high = {high:g}: give a range{above}")
        if kind.start is Parameter.start and not low <= kind.default <= high:
            raise MeasuredError(
                f"parameter {name}: default = {kind.default:g}: must be in {low:g} … {high:g} {kind.unit}"
            )
    PARAMETERS[name] = kind()
    return kind


class OfSpall(Parameter):
    """A field of one of the scene's spalls."""

    changes_healthy = False
    number: ClassVar[int] = 0
    """Which spall's."""

    @property
    def field(self) -> str:
        """Of a spall."""
        return self.name.removesuffix("_2")

    def leading(self, scene: Scene) -> Scene:
        """The scene with this spall first."""
        spalls = list(scene.spalls)
        return dataclasses.replace(scene, spalls=(spalls.pop(self.number), *spalls))

    def start(self, scene: Scene) -> float:
        return float(getattr(scene.spalls[self.number], self.field))

    def scene(self, scene: Scene, value: Real) -> Scene:
        spalls = list(scene.spalls)
        spalls[self.number] = dataclasses.replace(spalls[self.number], **{self.field: value})
        return dataclasses.replace(scene, spalls=tuple(spalls))


class KnownToLaw(Parameter):
    """What laws know within limits, and frozen ones not at all."""

    def farthest(self, scene: Scene) -> tuple[float, float]:
        """The widest range to look for the law's limits in [unit]."""
        raise NotImplementedError

    def limits(self, scene: Scene, rows: Sequence[Measurement]) -> tuple[float, float]:
        """As far as the law goes."""
        if scene.law.hard:  # type: ignore[union-attr]  # such laws are frozen
            return self.start(scene), self.start(scene)
        between = np.array([self.start(scene), *self.farthest(scene)], float)
        longest = 0.99 * _size_limits(scene)[0]  # else it is the length that the law no longer knows
        low, high = map(float, _limits_of_law(self, scene, longest, between))
        return low, high


@register
class Length(OfSpall):
    """Of the spall, along the roller: from a hundredth of the longest that the law takes to that."""

    name, unit = "length", "mm"
    multiplies = True
    no_effect = "without a spall that a roller meets nothing depends on its length"

    def limits(self, scene: Scene, rows: Sequence[Measurement]) -> tuple[float, float]:
        longest = float(_size_limits(self.leading(scene))[0])
        return 0.01 * longest, longest


@register
class Width(OfSpall):
    """Of the spall, in the rolling direction: from the narrowest that the law takes, or 0.1 mm, to half way round."""

    name, unit = "width", "mm"
    no_effect = "under this law width acts through the number of rollers inside only: give rows with phase = mean"

    def limits(self, scene: Scene, rows: Sequence[Measurement]) -> tuple[float, float]:
        return max(1.01 * float(_size_limits(self.leading(scene))[1]), 0.1), float(_half_way(self.leading(scene)))


@register
class Depth(OfSpall, KnownToLaw):
    """Of the spall: as far as the law goes, a factor of 10 at most."""

    name, unit = "depth", "mm"
    no_effect = "the spall is deeper than rollers sink, or the law does not know depth: leave depth out"

    def farthest(self, scene: Scene) -> tuple[float, float]:
        return 0.1 * self.start(scene), 10.0 * self.start(scene)


@register
class Angle(OfSpall):
    """Of the spall's centre from the load line: −π … π. An interval may go on beyond."""

    name, unit = "angle", "rad"
    low, high, logarithmic, wide = -1.15 * np.pi, 1.15 * np.pi, False, 0.5
    period, natural = 2.0 * np.pi, (True, True)
    no_effect = "without a radial load all angles are alike: measure under a radial load, or leave angle out"
    suspect = "the spall stands elsewhere than the scene's angle says"

    def apart(self, scene: Scene) -> float:
        """A quarter of what parts two rollers: over each of them the spall measures much alike."""
        return 0.25 * float(geometry.roller_pitch(scene.bearing))


def wrapped(parameters: Sequence[Parameter], values: np.ndarray, about: np.ndarray | float = 0.0) -> np.ndarray:
    """The same values, shape (…, parameters), of what has a period within half of it about others, shape
    (parameters,)."""
    goes_round = np.array([parameter.period is not None for parameter in parameters])
    period = np.array([parameter.period or 1.0 for parameter in parameters])
    return values - period * np.where(goes_round, np.round((values - about) / period), 0.0)


@register
class AxialOffset(OfSpall, KnownToLaw):
    """Of the spall from the roller's middle: as far as the law goes, half the roller at most."""

    name, unit = "axial_offset", "mm"
    logarithmic, wide, natural = False, 1.0, (True, True)
    no_effect = "the law is frozen at the scene's axial_offset: fit scenes with several and compare their χ²"

    def farthest(self, scene: Scene) -> tuple[float, float]:
        return -0.5 * float(scene.bearing.roller_length), 0.5 * float(scene.bearing.roller_length)

    def apart(self, scene: Scene) -> float:
        return float(scene.bearing.roller_length) / 6.0


@register
class SecondLength(Length):
    """Of a second spall: as `length`."""

    name, number, in_products = "length_2", 1, False


@register
class SecondWidth(Width):
    """Of a second spall: as `width`."""

    name, number, in_products = "width_2", 1, False


@register
class SecondAngle(Angle):
    """Of a second spall: as `angle`."""

    name, number, suspect = "angle_2", 1, ""


@register
class Crown(KnownToLaw):
    """Design load of the rollers' crown: as far as the law goes, a factor of 4 at most."""

    name, unit, in_products = "crown", "N", False
    no_effect = "the law is frozen at the scene's design_load: use contact.law = 'table', or leave crown out"
    suspect = "rollers are crowned otherwise than contact.design_load says"

    def farthest(self, scene: Scene) -> tuple[float, float]:
        return self.start(scene) / 4.0, 4.0 * self.start(scene)

    def start(self, scene: Scene) -> float:
        return float(scene.design_load)

    def scene(self, scene: Scene, value: Real) -> Scene:
        return dataclasses.replace(scene, design_load=value)


@register
class Preload(Parameter):
    """Axial load that adds to every measured one: from 0 to the largest of them."""

    name, unit, default, logarithmic, wide, natural = "preload", "N", 0.0, False, np.inf, (True, False)
    no_effect = "nothing depends on the axial load here: leave preload out"
    suspect = "an axial load acts that was not measured"

    def limits(self, scene: Scene, rows: Sequence[Measurement]) -> tuple[float, float]:
        return 0.0, max(float(row.axial) for row in rows) or 1.0

    def apart(self, scene: Scene) -> float:
        return 1e3 / 6.0

    def load(self, load: Load, value: Real) -> Load:
        return Load(load.radial, load.axial + value)


@register
class Scale(Parameter):
    """The bearing's share s in the healthy compliance that is measured, the rest being housing and shaft: 0.1 … 1.5.

    1/K = 1/K_bearing + (1/s − 1)/K_healthy: it multiplies all healthy stiffness and makes losses smaller.
    """

    name, unit, low, high, default, changes_healthy = "scale", "–", 0.1, 1.5, 1.0, False
    no_effect = "nothing depends on the scale here: leave it out"
    suspect = "housing and shaft give way, too"

    def measured(self, healthy: jax.Array, added: jax.Array, value: Real) -> tuple[jax.Array, jax.Array]:
        return value * healthy, value * added


@register
class Reference(Parameter):
    """The healthy bearing's stiffness that losses are told by, over its true one: 0.9 … 1.1; rows of stiffness keep."""

    name, unit, low, high, default, changes_healthy = "reference", "–", 0.9, 1.1, 1.0, False
    in_products, no_effect = False, "stiffness does not depend on it: measure losses, or leave reference out"
    suspect = "the healthy bearing that losses are told by was stiffer or softer, so that all losses are off"

    def measured(self, healthy: jax.Array, added: jax.Array, value: Real) -> tuple[jax.Array, jax.Array]:
        return value * healthy, value * (1.0 + added) - 1.0


@register
class LoadFactor(Parameter):
    """By what all loads have to be multiplied: 0.5 … 2."""

    name, unit, low, high, default, in_products = "load_factor", "–", 0.5, 2.0, 1.0, False
    label = "load factor"
    no_effect = "nothing depends on the loads here: leave it out"
    suspect = "all loads are off by a factor"

    def load(self, load: Load, value: Real) -> Load:
        return Load(load.radial * value, load.axial * value)


def named(names: Sequence[str]) -> tuple[Parameter, ...]:
    """The parameters of these names; raises `MeasuredError`."""
    if isinstance(names, str):
        raise MeasuredError(f"parameters = {names!r}: give a list of names, say ({names!r},)")
    for name in names:
        if not isinstance(name, str):
            raise MeasuredError(f"parameters: {name!r} is no name; say ('length',)")
        if name not in PARAMETERS:
            parted = "; part names by commas" if len(name.split()) > 1 else ""
            raise MeasuredError(f"parameters: {name!r} is not known; {did_you_mean(name, PARAMETERS)}{parted}")
    if not names or len(set(names)) < len(names):
        raise MeasuredError(f"parameters = {', '.join(names)}: name at least one, and each once")
    return tuple(PARAMETERS[name] for name in names)


def bounds(parameters: Sequence[Parameter], scene: Scene, rows: Sequence[Measurement]) -> Bounds:
    """Limits of these parameters of a prepared scene; raises `MeasuredError`."""
    if not scene.spalls:
        raise MeasuredError("the scene has no [[spall]] to fit: give one, with a guess of its size")
    ends = []
    for parameter in parameters:
        if isinstance(parameter, OfSpall) and parameter.number >= len(scene.spalls):
            raise MeasuredError(
                f"parameters: {parameter.name} needs a second [[spall]] in the scene: add a guess of it"
            )
        low, high = parameter.limits(scene, rows)
        if not high - low > 1e-6 * max(abs(low), abs(high)):
            raise MeasuredError(f"parameters: {parameter.name} cannot be fitted: {parameter.no_effect}")
        ends.append((low, high))
    low, high = np.array(ends, float).T
    return Bounds(low, high, tuple(parameter.logarithmic for parameter in parameters))


def put(parameters: Sequence[Parameter], scene: Scene, values: Iterable[Real]) -> Scene:
    """The prepared scene with these values."""
    for parameter, value in zip(parameters, values, strict=True):
        scene = parameter.scene(scene, value)
    return scene


def _half_way(scene: Scene) -> Real:
    """Half way round what the scene's first spall lies on [mm]."""
    return 0.5 * geometry.once_round(scene.bearing, scene.spalls[0].surface)


def _known(scene: Scene, **changed: Real) -> jax.Array:
    """Whether the law knows the scene's first spall with fields changed, beside those on the same surface."""
    law: Law = scene.law  # type: ignore[assignment]  # it is prepared
    first, *others = scene.spalls
    at = law.at(LineContact.of(scene.bearing, "inner" if first.surface == "inner" else "outer", scene.design_load))
    spalls = (dataclasses.replace(first, **changed), *(one for one in others if one.surface == first.surface))
    return at.judge(spalls, jnp.zeros((len(spalls), 1))) == status.CONVERGED


@jit_quickly()
def _size_limits(scene: Scene) -> tuple[jax.Array, jax.Array]:
    """The longest spall that the law takes and, of those, the narrowest [mm]."""
    length, half_way = scene.bearing.roller_length, _half_way(scene)
    longest = _limit(lambda v: _known(scene, length=v, width=0.5 * half_way), 0.02 * length, length)
    return longest, _limit(lambda v: _known(scene, length=longest, width=v), 0.5 * half_way, 0.01)


@jit_quickly(static_argnames=("parameter",))
def _limits_of_law(parameter: Parameter, scene: Scene, longest: jax.Array, between: Real) -> jax.Array:
    """Between which values the law knows the shortest and the longest spalls, going from the first of `between` towards
    the other two."""

    def takes(value: jax.Array) -> jax.Array:
        at, width = parameter.scene(scene, value), 0.5 * _half_way(scene)
        return _known(at, width=width, length=0.02 * longest) & _known(at, width=width, length=longest)

    return jnp.stack([_limit(takes, between[0], end) for end in between[1:]])


def _limit(holds: Callable[[jax.Array], jax.Array], inside: Real, outside: Real) -> jax.Array:
    """How far from `inside`, where it holds, towards `outside` it keeps holding: by bisection."""
    # one step beyond, so that an end where it holds is found, too
    beyond = inside + (outside - inside) * (1.0 + 1e-9)
    end = bisected(holds, jnp.asarray(inside, float), jnp.asarray(beyond, float), 50)[0]
    return jnp.where(outside > inside, jnp.minimum(end, outside), jnp.maximum(end, outside))
