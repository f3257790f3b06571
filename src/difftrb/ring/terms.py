"""What effects add to the ring's equilibrium: `Terms`, and what they are made of.

A term that is None leaves nothing in the compiled program.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import Real, Spall
from difftrb.law import direct_states
from difftrb.law.base import Law, Rest
from difftrb.law.roller_curves import RollerCurves
from difftrb.ring import newton
from difftrb.ring.roller_balance import Seat

NOWHERE = 1e4
"""Distance from a spall [mm] that none is wide enough for."""
LEAST = 1e-12
"""Share of a slice's land that is left where a spall takes all of it: its logarithm is needed."""


class InnerRaceway(NamedTuple):
    """The inner raceway as it is judged: its law, the spalls met there, their distances from the rollers' contacts
    [mm], shape (spalls, rollers), the contacts' equivalent radius [mm], and whether rollers are free to tilt."""

    law: Law
    spalls: tuple[Spall, ...]
    distances: Any
    radius: Real
    free: bool = False

    def judge(self, rest: Rest) -> Any:
        """Status: whether the law knows what it meets; `rest` as of the outer raceway."""
        met = self.spalls, self.distances, rest._replace(radius=self.radius)
        made = xp.asarray(self.law.status_code).astype(int)
        return status.worst(self.law.judge(*met), self.tilts(self.law, *met), made)

    def tilts(self, law: Law, spalls: tuple[Spall, ...], distances: Any, rest: Rest) -> Any:
        """Status: whether `law` was made for rollers that may tilt as these do, or need not, for none meets a spall off
        its middle."""
        if isinstance(law, direct_states.DirectByStates):
            other = law.states is not None and law.free_to_tilt != self.free
            return np.asarray(status.OTHER_SCENE if other else status.CONVERGED)
        leans: Any = np.asarray(False)
        for spall, away in zip(spalls, distances, strict=True) if self.free else ():
            leans = leans | xp.any(rest.in_reach(spall, away) & spall.off_middle)
        return xp.where(leans, status.TILTS, status.CONVERGED)


class Pair(NamedTuple):
    """A second row of the same bearing on the same shaft, the other way round.

    The shaft's axial load presses the first row's rings together and takes the second one's apart. Rollers of both
    stand at the same angles. A tilt about the middle between the rows moves each row by the distance of its load centre
    from there, so back to back is stiffer than face to face.

    Attributes:
      preload: axial way by which both rows together are pressed beyond touching [mm]; negative is end play.
      reach: of the middle between the rows from the first row's load centre, along its rollers towards their small
        ends [mm]: its lever about that middle; the second row's is opposite. None: the shaft does not tilt.
    """

    preload: Real
    reach: Real | None = None

    def rows(self, displacement: Any, outer_angle: Real) -> tuple[Any, Any]:
        """Radial, lateral and axial displacement [mm] of the rings of either row, both of shape (…, 3), at the shaft's
        `displacement` ([mm] and, if it tilts, [rad]); without the preload, which is among `Terms.interference`."""
        u, aside = [displacement[..., k] for k in range(displacement.shape[-1])], (0.0, 0.0)
        if self.reach is not None:
            lever = self.reach / xp.cos(outer_angle)
            aside = -lever * u[4], lever * u[3]
        first = xp.stack([u[0] + aside[0], u[1] + aside[1], u[2]], axis=-1)
        return first, xp.stack([u[0] - aside[0], u[1] - aside[1], -u[2]], axis=-1)


def of_rows(normals: Any) -> Any:
    """Normals in (radial, lateral, axial), shape (…, rollers of both rows, 3): the second row's point the other way."""
    count, _ = normals.shape[-2:]
    towards = np.where(np.arange(count)[:, None] < count // 2, 1.0, [1.0, 1.0, -1.0])
    return normals * towards.reshape(*[1] * (normals.ndim - 2), count, 3)


def beside(distances: Any, spalls: tuple[Spall, ...]) -> Any:
    """`distances` from the `spalls` [mm], shape (spalls, …, 2 · rollers), from those of one row, shape (spalls, …,
    rollers): from a row's rollers to the other row's spalls it is far."""
    first = np.array([spall.row == 1 for spall in spalls], bool).reshape(-1, *[1] * (distances.ndim - 1))
    return xp.concatenate([xp.where(own, distances, NOWHERE) for own in (first, ~first)], axis=-1)


def about(levers: Any, angles: Any) -> Any:
    """How tilts about the radial and the lateral axis move points at `levers` from the centre, of rollers at `angles`
    [rad], along their normals: n·(θ × p) = (θ_r sinφ − θ_l cosφ) x; shape (…, 2)."""
    return xp.stack([levers * xp.sin(angles), -levers * xp.cos(angles)], axis=-1)


class Tilting(NamedTuple):
    """Rings that tilt against each other: two more degrees of freedom, about the radial and about the lateral axis.

    Attributes:
      levers: of every roller's (or slice's) normal about the tilting centre [mm], shape (rollers · slices,), roller by
        roller: its approach per tilt in its own plane.
      moments: about the radial and the lateral axis through that centre [N mm], shape (2,).
    """

    levers: Any
    moments: Any

    def directions(self, normals: Any, angles: Any) -> Any:
        """Directions in (radial, lateral, axial, about radial, about lateral), the last two times the longest lever;
        from normals of shape (…, 3) of rollers or slices at `angles` [rad], shape (…,)."""
        turned = about(newton.aligned(self.levers / self.longest, angles), angles)
        return xp.concatenate([normals, turned], axis=-1)

    def of_whole(self, normals: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions in which rollers, not their slices, approach and are turned in their planes, each of shape
        (rollers, 5), of numbers, tilts in [rad]; arguments as of `directions`, of rollers at one phase."""
        levers = np.asarray(self.levers).reshape(len(angles), -1)
        towards = np.sign(levers[:, -1] - levers[:, 0])
        pressed = np.concatenate([normals, about(levers.mean(axis=1), angles)], axis=1)
        return pressed, np.concatenate([0.0 * normals, about(towards, angles)], axis=1)

    def forces(self, force: Any) -> Any:
        """Forces [N], shape (…, 3), with the moments by the longest lever behind them, shape (…, 5)."""
        moments = newton.aligned(self.moments / self.longest, force)
        return xp.concatenate([force, xp.broadcast_to(moments, (*force.shape[:-1], 2))], axis=-1)

    def of_rollers(self, approach: Any) -> Any:
        """Tilt of every roller's rings in its plane [rad], shape (…, rollers), from its slices' approaches [mm], shape
        (…, rollers, slices): interference is the same for all of them."""
        levers = xp.fixed(self.levers).reshape(-1, approach.shape[-1])
        if levers.shape[-1] < 2:
            return xp.zeros_like(approach[..., 0])
        apart = approach[..., -1] - approach[..., 0]
        return apart / newton.aligned(xp.abs(levers[:, -1] - levers[:, 0]), apart)

    @property
    def longest(self) -> Any:
        """The longest lever [mm], without derivatives."""
        return abs(xp.fixed(self.levers)).max()

    def in_radians(self, displacement: Any, tangent: Any) -> tuple[Any, Any]:
        """Displacement [mm], [rad] and stiffness of the same units, from those by tilt times the longest lever."""
        longest = self.longest
        scale = xp.stack([1.0, 1.0, 1.0, longest, longest])
        by_two = newton.aligned(scale[:, None] * scale[None, :], tangent)
        return displacement / newton.aligned(scale, displacement), tangent * by_two


def without_land(slices: RollerCurves) -> Any:
    """Which slices a spall takes all land from, shape (…, rollers · slices)."""
    stiffness = xp.fixed(slices.each.coefficients[0])  # its logarithm
    return stiffness < stiffness.max() + 0.5 * np.log(LEAST)


class Terms(NamedTuple):
    """What effects add to the plain ring.

    Attributes:
      interference: what rollers are too thick, added to their approach [mm], one number or shape (rollers,).
      seat: what holds rollers besides the outer raceway; None: an inner ring that does not give way.
      axial: axial displacement [mm] at which the rings are held, whatever axial force that takes, one number or of
        each ring; None: the load's.
      slices: what slices of rollers carry, shape (rollers · slices,), roller by roller; None: rollers are whole.
      tilting: of rings that tilt; None: they stay parallel.
      extra: force on the ring beside the load [N], shape (3,) or, of several rings, (…, 3).
      laws_status: status of what else is known of the scene; None: nothing is.
      inner_raceway: the inner raceway's law and spalls, where there is one that gives way; None: there is none.
      pair: a second row; None: there is none. With it, rollers in all else are those of both rows, the first's first.
    """

    interference: Real | None = None
    seat: Seat | None = None
    axial: Real | None = None
    slices: RollerCurves | None = None
    tilting: Tilting | None = None
    extra: jax.Array | None = None
    laws_status: jax.Array | None = None
    inner_raceway: InnerRaceway | None = None
    pair: Pair | None = None

    def thicker(self, more: Any) -> Terms:
        """Rollers too thick by `more` than they are so far [mm], shape () or (rollers,)."""
        return self._replace(interference=more if self.interference is None else self.interference + more)


PLAIN = Terms()
