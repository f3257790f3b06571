"""The bearing as an FMU (FMI 2.0, co-simulation), for Simulink, OpenModelica, Dymola and others that couple models.

Inputs are the shaft's place x, y, z [m] against its housing, from the mean place under the constant load, and the inner
ring's speed [rad/s]; outputs the force of the bearing on the shaft fx, fy, fz [N] without that load, the cage's angle
[rad], and the stiffness now, kxx … kzz [N/m]. At every step f = -K(φ) (q - u(φ) + ū): the stiffness and the place at
rest over the cage's angle, interpolated, linear about the load. Axes are ROSS's (`ross.axes`). No mass, no damping.

Written by PythonFMU (`pip install '.[fmu]'`). The FMU holds its numbers and a small script, and runs wherever
there is a Python, without JAX or difftrb.
"""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
from importlib import resources
from pathlib import Path

from difftrb.core import geometry, storage
from difftrb.core.input_errors import named
from difftrb.core.status import SceneError
from difftrb.turning.cage_turn import CageTurn
from difftrb.turning.ross import DOWN, RPM, Axial, over_axes

SCRIPT = "fmu_slave.py"


def write(turn: CageTurn, path: str | Path, speed_rpm: float = 0.0, load_angle: float = DOWN, axial: Axial = 1) -> None:
    """Write a cage's turn as an FMU, whole or not at all.

    `speed_rpm` [rev/min] is the speed that its input begins with, default 0. `load_angle` and `axial` are
    `ross.axes`'s. Raises `SceneError` if PythonFMU is not here, the file does not end with .fmu, a phase has no
    solution, or nothing repeats; OSError if it cannot be written.
    """
    path = Path(path)
    if path.suffix != ".fmu" or path.is_dir():
        raise SceneError(f"{named(path)}: cannot be written; name a file that ends with .fmu")
    stiffness, waveform = over_axes(turn, load_angle, axial)
    try:
        from pythonfmu import FmuBuilder  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise SceneError(f"PythonFMU is not here ({error}): pip install '.[fmu]' in difftrb's folder") from None
    held = {
        "stiffness": stiffness.tolist(), "waveform": waveform.tolist(), "span": float(turn.span),
        "cage_share": float(geometry.cage_share(turn.bearing)), "speed": float(speed_rpm) / RPM,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder, storage.replacing(path) as scratch, _search_path_as_it_was():
        script, numbers = Path(folder) / SCRIPT, Path(folder) / "turn.json"
        script.write_text((resources.files("difftrb.turning") / SCRIPT).read_text(encoding="utf-8"), encoding="utf-8")
        numbers.write_text(json.dumps(held), encoding="utf-8")
        made = FmuBuilder.build_FMU(script, Path(folder), [numbers], needsExecutionTool=True)
        scratch.write_bytes(Path(made).read_bytes())


@contextlib.contextmanager
def _search_path_as_it_was():
    """PythonFMU imports the script from its folder, and leaves both among what Python knows."""
    before = list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = before
        sys.modules.pop(Path(SCRIPT).stem, None)
