"""What happened in a solve, as a number inside jit and as a sentence outside it; and the errors that all rooms raise.

JAX is imported by the functions that need it, so that errors can be named without it.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, Self

import numpy as np

if TYPE_CHECKING:
    import jax

# of several the largest counts (`worst`): what says more has the larger number
CONVERGED = 0
NOT_CONVERGED = 1
TOUCHES_BORDER = 2
NO_EQUILIBRIUM = 3
BAD_INPUT = 4
UNRESOLVED = 5
UNKNOWN_LENGTH = 6
UNSUITED = 7
OTHER_SCENE = 8
NARROW = 9
LOOSE = 10
SEVERAL = 11
BOTTOM = 12
OUTSIDE = 13
SLIVER = 14
OTHER_CONTACT = 15
TILTS = 16
UNPRESSED = 17
FREE = 18
LEANS = 19
UNSETTLED = 20
UNDEFINED = 100

SENTENCES = {
    CONVERGED: "converged",
    NOT_CONVERGED: "the iteration limit was reached before the tolerance: ask for less accuracy or check the inputs",
    TOUCHES_BORDER: "pressure touches the border of the solution domain, so the contact is cut off: report this case",
    NO_EQUILIBRIUM: "no equilibrium: the axial load is too small to hold the radial load and the moments at this "
    "contact angle; raise load.axial, or lower load.radial or the moments",
    BAD_INPUT: "an input is not a number, is outside its range, or does not fit the others: check load, sizes and "
    "angles",
    UNRESOLVED: "a spall, or the ridge between two, is narrower than one cell of the grid: ask for more accuracy (a "
    "smaller number), or make it wider",
    UNSUITED: "this way of solving cannot describe this contact (a roller without crown or loaded far beyond it, one "
    "that may reach the spall's bottom, too short a loaded land; spalls that overlap or nearly touch, or go on to the "
    "roller's end, at a rolling edge; for an edge's intensity a rolling edge in reach): use solve_contact with method "
    "'cells'",
    OTHER_SCENE: "the roller law was prepared for another scene: prepare this one, by naming its law",
    NARROW: "a spall is so narrow that both its edges may be in reach of a roller at once, and the table was prepared "
    "for wider ones: prepare this scene, by naming its law",
    LOOSE: "one of two rows carries nothing, and the other one alone does not hold the shaft's tilt: raise "
    "effects.double_row.preload, leave its spacing out, or name effects.tilt, too",
    SEVERAL: "several spalls are under one roller at once, and this roller law knows one: use contact.law = 'direct'",
    BOTTOM: "a roller may meet the bottom of a spall, which this roller law does not know: use contact.law = 'direct', "
    "or give the spall its true depth",
    OUTSIDE: "rollers carry loads below or above the range that the roller law was made for: use contact.law = "
    "'direct' or 'auto', or another design load; where these say so, 'power' goes on to any load",
    UNKNOWN_LENGTH: "a spall is longer than the roller law knows: shorten it, or choose another contact.law",
    SLIVER: "a spall ends close to the roller's end, or takes more than 0.85 of its length, which the table does not "
    "know: use contact.law = 'direct' or 'auto', or move or shorten it",
    OTHER_CONTACT: "the roller is crowned too little, or too small or large for its crown, for the table: use "
    "contact.law = 'direct' or 'auto', or another design load",
    TILTS: "a roller between both raceways tilts over a spall off its middle, which this roller law does not know: use "
    "contact.law = 'direct', or hold rollers by effects.raceways.rollers = 'upright'",
    UNPRESSED: "no roller is pressed, so nothing resists: raise load.radial, or the preload above the end play",
    FREE: "the rollers that carry leave the ring free to move in one direction, so it has no one place, no stiffness "
    "and no derivatives: raise load.axial or the preload, or turn the cage (phase)",
    LEANS: "rings are turned against each other so far that rollers press with little more than their ends, which is "
    "not known: lower the moments, raise load.axial, or crown the rollers more (a larger design load)",
    UNSETTLED: "rollers do not stay where contacts were solved for them, which is tried eight times: use contact.law = "
    "'table' if that knows the scene, or change loads, moments or the phase a little",
    UNDEFINED: "the function that was swept gave no number here: check it at this member",
}


class DifftrbError(Exception):
    """Whatever difftrb raises on purpose; the message is one sentence. The command line ends with `exit_code`."""

    exit_code = 2


class SceneError(DifftrbError, ValueError):
    """A scene, or its file, that cannot be used; the message is one sentence: key, value, what is allowed."""


class SweepError(DifftrbError, ValueError):
    """A sweep that cannot be run, or not go on; the message is one sentence."""


class SolveError(DifftrbError, RuntimeError):
    """A solve ended without a trustworthy answer; the message is the status's sentence."""

    exit_code = 1


class Judged:
    """A result that knows from its `status_code` how far to trust it."""

    status_code: jax.Array

    @property
    def converged(self) -> jax.Array:
        """Whether the solve can be trusted."""
        import jax
        from jax.core import Tracer

        code = self.status_code
        if isinstance(code, jax.Array) and not isinstance(code, Tracer):
            return jax.device_put(np.asarray(code) == CONVERGED)  # nothing is compiled for it
        return code == CONVERGED

    @property
    def status(self) -> str:
        """What happened, as a sentence. Outside jit only."""
        return describe(self.status_code)

    def check(self) -> Self:
        """Itself; raises `SolveError` with the status's sentence unless everything converged. Outside jit only."""
        if int(np.max(np.asarray(self.status_code))) != CONVERGED:
            raise SolveError(self.status)
        return self


def worst(*codes: Any) -> Any:
    """The status that matters most of several, of all rings or of each: the largest code that is not `CONVERGED`."""
    import jax.core

    if not any(isinstance(code, jax.core.Tracer) for code in codes):
        return functools.reduce(np.maximum, map(np.asarray, codes))
    import jax.numpy as jnp

    return functools.reduce(jnp.maximum, map(jnp.asarray, codes))


def describe(code: int | jax.Array) -> str:
    """The sentence of one status code (of the worst one, if an array is given)."""
    return SENTENCES[int(np.max(np.asarray(code)))]


def require_float64() -> None:
    """Raise unless JAX computes in float64: influence coefficients cancel to nothing in float32."""
    import jax

    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise SolveError(
            "difftrb needs float64: call jax.config.update('jax_enable_x64', True) before the first computation"
        )
