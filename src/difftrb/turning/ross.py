"""Into ROSS (rotordynamics): the bearing as an element of its rotors, and the force of rollers that pass a spall.

ROSS has x and y across the shaft and z along it, in metres; its own bearing element knows kxx … kyy and kzz. difftrb's
radial axis is the load's line: `load_angle` from x towards y, by default −y, as gravity pulls; lateral is a quarter
turn on, as x turns to y; axial is ±z, the way in which the shaft presses the rings together. Displacements are the
shaft's against its housing. Needs ROSS: `pip install '.[ross]'`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from difftrb.core.geometry import cage_rate
from difftrb.core.status import SceneError
from difftrb.turning.cage_turn import CageTurn

DOWN = -0.5 * np.pi
PER_METRE = 1e3
"""N/m in a N/mm."""
RPM = 30.0 / np.pi
"""rev/min in a rad/s."""
Axial = Literal[1, -1]


def stiffness_in_metres(solution: Any, load_angle: float = DOWN, axial: Axial = 1) -> np.ndarray:
    """Stiffness over x, y, z [N/m], shape (3, 3), of a `Solution` (its tangent), of a `CageTurn` (its mean), or of a
    matrix over radial, lateral, axial [N/mm]. Of rings that tilt the part without tilt: tilt held at 0."""
    if isinstance(solution, CageTurn):
        matrix = solution.check().mean_stiffness
    elif hasattr(solution, "stiffness"):
        if solution.definition != "tangent":
            raise SceneError("stiffness.definition = 'secant': a rotor needs the tangent; solve with 'tangent'")
        matrix = solution.check().stiffness
    else:
        matrix = solution
    across = axes(load_angle, axial)
    return PER_METRE * across @ np.asarray(matrix, float)[:3, :3] @ across.T


def axes(load_angle: float = DOWN, axial: Axial = 1) -> np.ndarray:
    """Radial, lateral and axial direction over x, y, z, as columns, shape (3, 3)."""
    if axial not in (1, -1):
        raise SceneError(f"axial = {axial}: must be 1 (z presses the rings together) or -1")
    if not np.isfinite(load_angle):
        raise SceneError(f"load_angle = {load_angle}: must be an angle in rad, of the load from x")
    cos, sin = np.cos(load_angle), np.sin(load_angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, axial]])


def over_axes(turn: CageTurn, load_angle: float = DOWN, axial: Axial = 1) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness [N/m], shape (phases, 3, 3), and waveform [m], shape (phases, 3), over x, y, z. Raises `SceneError` if
    a phase has no solution, nothing repeats, or phases are too few to tell passages from the cage's turn."""
    turn.check()
    if (sentence := turn.no_orders) is not None:
        raise SceneError(sentence)
    across = axes(load_angle, axial)
    stiff = PER_METRE * np.einsum("ai,pij,bj->pab", across, np.asarray(turn.stiffness)[:, :3, :3], across)
    return stiff, np.einsum("ai,pi->pa", across, np.asarray(turn.waveform)[:, :3]) / PER_METRE


def bearing_element(
    solution: Any, n: int, cxx: float = 0.0, load_angle: float = DOWN, axial: Axial = 1, coupled: bool = True,
    **options: Any,
) -> Any:  # fmt: skip
    """A `ross.BearingElement` at node `n` with kxx, kxy, kyx, kyy, kzz [N/m] of a solution: see `stiffness_in_metres`.

    `coupled` (default) keeps what ROSS's own element has no place for, the terms between axial and the others, in an
    element that is ROSS's with a K of its own; with False it is ROSS's plain one. `cxx` is the damping across [N s/m],
    default 0; `options` are ROSS's (czz, cyy, n_link, tag, …).
    """
    K = stiffness_in_metres(solution, load_angle, axial)
    given = {"n": n, "kxx": K[0, 0], "kxy": K[0, 1], "kyx": K[1, 0], "kyy": K[1, 1], "kzz": K[2, 2], "cxx": cxx}
    given = {name: value if name == "n" else float(value) for name, value in given.items()}
    if not coupled:
        return _ross().BearingElement(**given, **options)
    element = _coupled()(**given, **options)
    element.cross = np.array([K[0, 2], K[1, 2]])
    return element


def passage_force(
    turn: CageTurn, rotor: Any, n: int, speed: float, t: Any, load_angle: float = DOWN, axial: Axial = 1
) -> Callable[..., np.ndarray]:
    """For `add_to_RHS` of `rotor.run_time_response(speed, F, t, method="newmark")`: what the bearing at node `n` adds
    as rollers pass, beside the element with its mean stiffness.

    At displacement q from the mean place, f = K(φ) (u(φ) − ū) − (K(φ) − K̄) q, where u(φ) is where the shaft rests
    under the constant load at cage angle φ: `turn` interpolated, and φ is the cage's while the rotor turns at `speed`
    [rad/s], the outer ring at rest. `t` are the response's times [s]. Forces in N, shape (rotor.ndof,).
    """
    stiff, moved = over_axes(turn, load_angle, axial)
    mean, count = stiff.mean(axis=0), len(stiff)
    place = np.asarray(t, float) * float(cage_rate(turn.bearing, speed * RPM)) / float(turn.span) * count
    first = rotor.number_dof * n

    def force(step: int, disp_resp: Any, **_: Any) -> np.ndarray:
        low = int(np.floor(place[step]))
        share = place[step] - low
        K = (1.0 - share) * stiff[low % count] + share * stiff[(low + 1) % count]
        u = (1.0 - share) * moved[low % count] + share * moved[(low + 1) % count]
        total = np.zeros(rotor.ndof)
        total[first : first + 3] = K @ u - (K - mean) @ np.asarray(disp_resp)[first : first + 3]
        return total

    return force


def _ross() -> Any:
    try:
        import ross  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise SceneError(f"ROSS is not here ({error}): pip install '.[ross]' in difftrb's folder") from None
    return ross


@functools.cache
def _coupled() -> type:
    class TaperedRollerBearing(_ross().BearingElement):
        """ROSS's bearing element with stiffness between z and x, y: `cross` is kxz, kyz [N/m]."""

        cross = np.zeros(2)

        def K(self, *speeds: Any, **named: Any) -> np.ndarray:  # of whirl, and from ROSS 3 on of the rotor
            K = np.array(super().K(*speeds, **named), float)  # of the node, or of both nodes
            for row in range(0, len(K), 3):
                for column in range(0, len(K), 3):
                    sign = 1.0 if row == column else -1.0
                    K[row : row + 2, column + 2] = sign * self.cross
                    K[row + 2, column : column + 2] = sign * self.cross
            return K

    return TaperedRollerBearing
