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
    from difftrb.contact.contact_solution import ContactSolution
    from difftrb.contact.height_map import HeightMap, HeightMapError, example_map, load_height_map
    from difftrb.contact.solver import approach_slopes, solve_contact
    from difftrb.contact.stress_intensity import EdgeIntensity, edge_intensity
    from difftrb.core.geometry import LineContact, Spall, TaperedBearing
    from difftrb.core.jax_config import compiler_options
    from difftrb.core.packaged_bearings import bearing
    from difftrb.core.status import DifftrbError, SceneError, SolveError, SweepError
    from difftrb.core.user_cache import keep_compiled
    from difftrb.fits.fit_result import Fit
    from difftrb.fits.fitting import fit
    from difftrb.fits.measured import MeasuredError, Measurement
    from difftrb.fits.measured_table import load_measured
    from difftrb.fits.optimal_design import Suggestion, next_measurements
    from difftrb.fits.posterior import Posterior, posterior
    from difftrb.fits.spall_count import SpallCount, count_spalls
    from difftrb.law.power import PowerLaw, liu2018, power_law
    from difftrb.ring import effects
    from difftrb.ring.catalogue_inference import CatalogueBearing, Estimate, bearing_from_catalogue
    from difftrb.ring.load import Load
    from difftrb.scene.audit import Audit, verify
    from difftrb.scene.edge_stress import EdgeStress, edge_stresses
    from difftrb.scene.scene import Scene, healthy
    from difftrb.scene.scene_file import load_scene
    from difftrb.scene.solution import Assessment, Solution
    from difftrb.scene.solving import assess, prepare, solve
    from difftrb.sweeps.chunk_sharing import compute_chunk, write_sweep
    from difftrb.sweeps.store import load_sweep
    from difftrb.sweeps.sweep_file import load_plan
    from difftrb.sweeps.sweeping import plan_sweep, sweep
    from difftrb.sweeps.swept import Swept
    from difftrb.turning import fmu, ross
    from difftrb.turning.cage_turn import CageTurn, stiffness
    from difftrb.turning.defect_frequencies import DefectFrequencies, defect_frequencies

_HOMES = {
    "scene.audit": ("Audit", "verify"),
    "contact.solver": ("approach_slopes", "solve_contact"),
    "contact.contact_solution": ("ContactSolution",),
    "fits.fitting": ("fit",),
    "scene.edge_stress": ("EdgeStress", "edge_stresses"),
    "fits.fit_result": ("Fit",),
    "contact.stress_intensity": ("EdgeIntensity", "edge_intensity"),
    "core.jax_config": ("compiler_options",),
    "core.user_cache": ("keep_compiled",),
    "core.geometry": ("LineContact", "Spall", "TaperedBearing"),
    "core.packaged_bearings": ("bearing",),
    "contact.height_map": ("HeightMap", "HeightMapError", "example_map", "load_height_map"),
    "law.power": ("PowerLaw", "liu2018", "power_law"),
    "fits.measured": ("MeasuredError", "Measurement"),
    "fits.measured_table": ("load_measured",),
    "fits.optimal_design": ("Suggestion", "next_measurements"),
    "fits.posterior": ("Posterior", "posterior"),
    "fits.spall_count": ("SpallCount", "count_spalls"),
    "ring.catalogue_inference": ("CatalogueBearing", "Estimate", "bearing_from_catalogue"),
    "ring.load": ("Load",),
    "scene.scene": ("Scene", "healthy"),
    "scene.scene_file": ("load_scene",),
    "scene.solution": ("Assessment", "Solution"),
    "scene.solving": ("assess", "prepare", "solve"),
    "core.status": ("DifftrbError", "SceneError", "SolveError", "SweepError"),
    "sweeps.chunk_sharing": ("compute_chunk", "write_sweep"),
    "sweeps.store": ("load_sweep",),
    "sweeps.sweep_file": ("load_plan",),
    "sweeps.sweeping": ("plan_sweep", "sweep"),
    "sweeps.swept": ("Swept",),
    "turning.cage_turn": ("CageTurn", "stiffness"),
    "turning.defect_frequencies": ("DefectFrequencies", "defect_frequencies"),
}
_MODULES = {"effects": "ring.effects", "fmu": "turning.fmu", "ross": "turning.ross"}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted([*_HOME_OF, *_MODULES])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return metadata.version("difftrb")  # pyproject.toml's
    if name in _MODULES:
        return importlib.import_module(f"difftrb.{_MODULES[name]}")
    if name not in _HOME_OF:
        raise AttributeError(f"module 'difftrb' has no attribute {name!r}")
    return getattr(importlib.import_module(f"difftrb.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
