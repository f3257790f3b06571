"""difftrb: a differentiable model of a tapered roller bearing with natural spalls.

N, mm, MPa and rad throughout. Float64 is needed: `jax.config.update("jax_enable_x64", True)`.

Names are imported when first used, so that the command line can set up JAX before anything loads it.
"""

from __future__ import annotations

import importlib
from importlib import metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from difftrb import effects
    from difftrb.audit import Audit, verify
    from difftrb.axes import SweepError
    from difftrb.choice import prepare
    from difftrb.chunks import write_sweep
    from difftrb.contact import solve_contact
    from difftrb.contact_slopes import approach_slopes
    from difftrb.contact_solution import ContactSolution
    from difftrb.edge_stress import EdgeStress, edge_stresses
    from difftrb.fitted import Fit
    from difftrb.fitting import fit
    from difftrb.gathered import load_sweep
    from difftrb.geometry import LineContact, Spall, TaperedBearing, bearing
    from difftrb.heightmap import HeightMap, HeightMapError, example_map, load_height_map
    from difftrb.intensity import EdgeIntensity, edge_intensity
    from difftrb.law import PowerLaw, liu2018, power_law
    from difftrb.line import LineSolution, line_contact
    from difftrb.measured import MeasuredError, Measurement, load_measured
    from difftrb.optimal_design import Suggestion, next_measurements
    from difftrb.ring import Load
    from difftrb.scene import Scene, healthy
    from difftrb.scenefile import load_scene
    from difftrb.solution import Solution
    from difftrb.solving import Assessment, assess, solve
    from difftrb.status import SceneError, SolveError
    from difftrb.sweeping import sweep
    from difftrb.swept import Swept

_HOMES = {
    "audit": ("Audit", "verify"),
    "choice": ("prepare",),
    "contact": ("solve_contact",),
    "contact_slopes": ("approach_slopes",),
    "contact_solution": ("ContactSolution",),
    "fitting": ("fit",),
    "edge_stress": ("EdgeStress", "edge_stresses"),
    "fitted": ("Fit",),
    "intensity": ("EdgeIntensity", "edge_intensity"),
    "geometry": ("LineContact", "Spall", "TaperedBearing", "bearing"),
    "heightmap": ("HeightMap", "HeightMapError", "example_map", "load_height_map"),
    "law": ("PowerLaw", "liu2018", "power_law"),
    "line": ("LineSolution", "line_contact"),
    "measured": ("MeasuredError", "Measurement", "load_measured"),
    "optimal_design": ("Suggestion", "next_measurements"),
    "ring": ("Load",),
    "scene": ("Scene", "healthy"),
    "scenefile": ("load_scene",),
    "solution": ("Solution",),
    "solving": ("Assessment", "assess", "solve"),
    "status": ("SceneError", "SolveError"),
    "axes": ("SweepError",),
    "chunks": ("write_sweep",),
    "gathered": ("load_sweep",),
    "sweeping": ("sweep",),
    "swept": ("Swept",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted([*_HOME_OF, "effects"])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return metadata.version("difftrb")  # pyproject.toml's
    if name == "effects":
        return importlib.import_module("difftrb.effects")
    if name not in _HOME_OF:
        raise AttributeError(f"module 'difftrb' has no attribute {name!r}")
    return getattr(importlib.import_module(f"difftrb.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
