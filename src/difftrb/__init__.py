"""difftrb: a differentiable model of a tapered roller bearing with natural spalls.

N, mm, MPa and rad throughout. Float64 is needed: `jax.config.update("jax_enable_x64", True)`.

Names are imported when first used, so that the command line can set up JAX before anything loads it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from difftrb.axes import SweepError
    from difftrb.chunks import write_sweep
    from difftrb.contact import solve_contact
    from difftrb.contact_slopes import approach_slopes
    from difftrb.contact_solution import ContactSolution
    from difftrb.gathered import load_sweep
    from difftrb.geometry import LineContact, Spall, TaperedBearing, bearing
    from difftrb.heightmap import HeightMap, HeightMapError, example_map, load_height_map
    from difftrb.intensity import EdgeIntensity, edge_intensity
    from difftrb.law import PowerLaw, liu2018, power_law
    from difftrb.line import LineSolution, line_contact
    from difftrb.ring import Load
    from difftrb.scene import Assessment, Scene, Solution, assess, healthy, prepare, solve
    from difftrb.scenefile import SceneError, load_scene
    from difftrb.status import SolveError
    from difftrb.sweeping import sweep
    from difftrb.swept import Swept

_HOMES = {
    "contact": ("solve_contact",),
    "contact_slopes": ("approach_slopes",),
    "contact_solution": ("ContactSolution",),
    "intensity": ("EdgeIntensity", "edge_intensity"),
    "geometry": ("LineContact", "Spall", "TaperedBearing", "bearing"),
    "heightmap": ("HeightMap", "HeightMapError", "example_map", "load_height_map"),
    "law": ("PowerLaw", "liu2018", "power_law"),
    "line": ("LineSolution", "line_contact"),
    "ring": ("Load",),
    "scene": ("Assessment", "Scene", "Solution", "assess", "healthy", "prepare", "solve"),
    "scenefile": ("SceneError", "load_scene"),
    "status": ("SolveError",),
    "axes": ("SweepError",),
    "chunks": ("write_sweep",),
    "gathered": ("load_sweep",),
    "sweeping": ("sweep",),
    "swept": ("Swept",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'difftrb' has no attribute {name!r}")
    return getattr(importlib.import_module(f"difftrb.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
