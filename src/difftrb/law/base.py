"""What a roller law is, what laws share, and the registry of laws that scenes can name.

A law gives the load of a roller from its approach and the spalls under it. To add one, write a module in this room
that ends with `register(LawKind(...))`. Nothing else has to change: scene files, checks, sweeps and the command line
read the registry. A law of one's own is registered in the same way from anywhere, before it is named.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import packaged_bearings, status
from difftrb.core.geometry import LineContact, Real, Spall, TaperedBearing
from difftrb.core.input_errors import shown
from difftrb.law import load_curve, roller_curves
from difftrb.law.load_curve import Curve
from difftrb.law.roller_curves import RollerCurves
from difftrb.law.samples import Progress

AUTO = "auto"
"""Instead of a law's name: the table where it knows the scene, else contact solves (`scene.solving.prepare`)."""
LENGTH_SHARE = 0.85
"""Laws from contact solves cover spalls up to this share of the roller's length."""
OF_CONTACT = ("roller_small_diameter", "roller_large_diameter", "roller_length", "outer_angle", "inner_angle",
              "roller_angle", "modulus", "poisson")  # fmt: skip
"""Fields of a bearing that decide on the contact of its rollers with the outer raceway."""


class Rest(NamedTuple):
    """Rollers at rest on one raceway, as far as a law is judged by it.

    Attributes:
      radius: equivalent radius of the contacts [mm], shape ().
      approach: of every roller's contact, or more [mm], shape (rollers,).
      loads: [N], shape (rollers,).
      rings: of rings that tilt, how far they have approached each other at every roller's middle [mm], and by how much
        they are turned against each other in its plane [rad], its end towards positive places pressed in; both of shape
        (rollers,). None: they stay parallel.
    """

    radius: Real
    approach: Any
    loads: Any
    rings: tuple[Any, Any] | None = None

    def in_reach(self, spall: Spall, distances: Any) -> Any:
        """Whether each roller, its contact at `distances` [mm] from the spall's middle, may meet it, shape (rollers,).

        See `gap.certain_reach`.
        """
        of = xp.module_of(distances, spall.width, spall.rim)
        beside = of.maximum(of.abs(distances) - 0.5 * spall.width, 0.0)
        approach = self.approach + spall.rim
        return (beside**2 < 2.0 * self.radius * approach) & (approach > 0.0) & (spall.length > 0.0)


class Law(Protocol):
    """What a law has to answer. `distances` are of the rollers' contacts from the spalls' centres in the rolling
    direction [mm], shape (spalls, …, rollers). Formulas are over `core.arrays`: numbers are solved by numpy, and
    derivatives come from one expansion.

    Attributes:
      name: as in a scene file.
      hard: whether a roller is in a spall or not, with nothing in between.
      load_range: smallest and largest load that the law was made for [N].
      error: largest relative error of Q in that range against what the law was fitted to; NaN if unknown.
      status_code: worst status of the contact solves behind the law.
    """

    @property
    def name(self) -> str: ...
    @property
    def hard(self) -> bool: ...
    @property
    def load_range(self) -> tuple[Real, Real]: ...
    @property
    def error(self) -> Real: ...
    @property
    def status_code(self) -> Real: ...

    def at(self, contact: LineContact) -> Law:
        """Rebind to another contact; frozen laws return themselves."""
        ...

    def curves(self, spalls: tuple[Spall, ...], distances: jax.Array) -> RollerCurves:
        """Q(δ) of every roller."""
        ...

    def judge(self, spalls: tuple[Spall, ...], distances: jax.Array, rest: Rest | None = None) -> jax.Array:
        """Status: whether the law knows such spalls, distances and, if given, the rollers' states at `rest`."""
        ...

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Interval of edge positions [mm], positive over the spall numbered `number`, over which the load drops at this
        approach [mm], of any shape."""
        ...


class HardWindow:
    """Laws in which a roller is over a spall or not: the load drops in a step."""

    hard = True

    def ramp(self, number: int, spall: Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `Law`: a step."""
        return xp.zeros_like(approach), xp.zeros_like(approach)


def load_over(
    law: Law, approach: jax.Array, spall: Spall | None = None, distance: Real = 0.0
) -> tuple[jax.Array, jax.Array]:
    """Load [N] and its slope [N/mm] of one roller at an approach [mm], all of shape (), whose contact stands `distance`
    [mm] from the middle of `spall`, or on a healthy raceway."""
    spalls = () if spall is None else (spall,)
    curves = law.curves(spalls, jnp.full((len(spalls), 1), distance))
    load, slope = roller_curves.roller_loads(curves, jnp.reshape(approach, (1,)))
    return load[0], slope[0]


def of_base(name: str) -> Any:
    """A property that a law has of its `base`."""
    return property(lambda self: getattr(self.base, name), doc="The other law's.")


def lengths_of(spalls: tuple[Spall, ...]) -> Any:
    """Lengths of no spall and of every spall [mm], shape (1 + spalls,)."""
    return xp.stack([0.0, *(spall.length for spall in spalls)])


def in_window(curves: Curve, spalls: tuple[Spall, ...], distances: jax.Array) -> RollerCurves:
    """Every roller's curve in a hard window, of `curves` over no spall and over every spall, shape (1 + spalls,)."""
    return RollerCurves(load_curve.chosen(curves, roller_curves.spalls_under(spalls, distances)))


# ------------------------------------------------------------------------------------------------ judging


def known_up_to(longest: Any, spalls: tuple[Spall, ...]) -> Any:
    """Status: whether no spall is longer than `longest` [mm]."""
    of = xp.module_of(longest, *jax.tree.leaves(spalls))
    return of.where(of.asarray(longest) >= of.max(lengths_of(spalls)), status.CONVERGED, status.UNKNOWN_LENGTH)


def of_one_deep_spall(spalls: tuple[Spall, ...], distances: Any, rest: Rest | None) -> Any:
    """Status: whether no roller meets several spalls, or may meet a spall's bottom."""
    if rest is None or not spalls:
        return np.asarray(status.CONVERGED)
    of = xp.module_of(rest.approach, distances, *jax.tree.leaves(spalls))
    met = of.stack([rest.in_reach(spall, away) for spall, away in zip(spalls, distances, strict=True)])
    shallow = [of.any(own & (spall.depth < rest.approach)) for spall, own in zip(spalls, met, strict=True)]
    code = of.where(of.any(of.stack(shallow)), status.BOTTOM, status.CONVERGED)
    if len(spalls) < 2:
        return code
    return of.where(of.any(of.sum(met, axis=0) > 1), status.SEVERAL, code)


def within_range(load_range: tuple[Any, Any], rest: Rest | None) -> Any:
    """Status: whether the most loaded roller is in the range of loads [N] that a law was made for."""
    if rest is None:
        return np.asarray(status.CONVERGED)
    of = xp.module_of(rest.loads, *load_range)
    largest = of.max(rest.loads, axis=-1)
    inside = (largest >= load_range[0]) & (largest <= load_range[1])
    return of.max(of.where(inside | (largest <= 0.0), status.CONVERGED, status.OUTSIDE))


# ------------------------------------------------------------------------------------------------ registry


class Request(NamedTuple):
    """What a law is made for.

    Attributes:
      contact: of the rollers with the raceway.
      least, largest: estimated largest roller load [N] of the lightest loaded scene and of this one; NaN for a law that
        is of all loads.
      spalls: on this raceway.
      accuracy: relative, of contact solves.
      progress: told how many of how many contacts are solved.
    """

    contact: LineContact
    least: Real
    largest: Real
    spalls: tuple[Spall, ...]
    accuracy: float
    progress: Progress | None = None


@dataclasses.dataclass(frozen=True)
class LawKind:
    """A law that scenes can name.

    Attributes:
      name: in scene files and as `Scene(law=...)`. summary: what it is, in a few words.
      make: the law for a `Request`.
      by_samples: its contacts are solved one by one, outside of jit, so it needs numbers.
      solves: contacts are solved to make it, so it has an accuracy.
      of_all_loads: it is made without looking at the loads.
      longest: the longest spall that it knows [mm], of the roller's length [mm]; longer ones are refused by this.
      inner: whether it knows the inner raceway by itself, as effects.raceways needs.
      bearing: the only bearing that it is for; None is all.
      frozen: fields of a spall that no longer act once the law is made, nor does the bearing's contact; None: all do
        that it knows of.
      one_shape: the sentence that refuses spalls of several widths, depths or axial offsets; "": they are taken.
      one_scene: made for one scene only, so a sweep cannot share it.
      promises: whether its error is kept against contact solves.
      maps: whether it knows height maps.
    """

    name: str
    summary: str
    make: Callable[[Request], Law]
    by_samples: bool = False
    solves: bool = False
    of_all_loads: bool = False
    longest: Callable[[float], float] = lambda roller_length: LENGTH_SHARE * roller_length
    inner: bool = False
    bearing: str | None = None
    frozen: tuple[str, ...] | None = ("depth", "axial_offset")
    one_shape: str = ""
    one_scene: bool = False
    promises: bool = True
    maps: bool = False

    @property
    def at_once(self) -> bool:
        """Whether it holds for any bearing without solving a contact."""
        return not self.by_samples and not self.solves and self.bearing is None

    def is_for(self, bearing: TaperedBearing) -> bool:
        """Whether the law holds for this bearing's outer contacts, as far as is known: traced numbers are not."""
        if self.bearing is None:
            return True
        only = packaged_bearings.bearing(self.bearing)
        return all(
            isinstance(own := getattr(bearing, name), jax.core.Tracer) or float(own) == getattr(only, name)
            for name in OF_CONTACT
        )


def _not_by_name(request: Request) -> Law:
    raise status.SceneError("a law that is not registered cannot be made by its name")


OWN = LawKind("", "", make=_not_by_name)
"""What a law is that is not registered."""
LAWS: dict[str, LawKind] = {}
"""Every law that a scene can name; filled by `register`."""


def register(kind: LawKind) -> None:
    """Let scenes, scene files and the command line name a law. Raises `SceneError` for a name that is taken."""
    if kind.name in names():
        raise status.SceneError(f"law {kind.name!r} is there already: choose another name")
    LAWS[kind.name] = kind


def names() -> tuple[str, ...]:
    """All that `contact.law` takes."""
    return (*sorted(LAWS), AUTO)


def unknown(name: str) -> str:
    """The sentence for a law that cannot be had."""
    return f"law = {shown(name)} is unknown; use one of {', '.join(names())}"


def kind(name: str) -> LawKind:
    """The law called `name`; of one that is not registered, the user's own, what laws are unless they say otherwise."""
    return LAWS.get(name, OWN)


def made(name: str, request: Request) -> Law:
    """The law called `name`; raises `SceneError` for an unknown one."""
    if name not in LAWS:
        raise status.SceneError(unknown(name))
    return LAWS[name].make(request)
