"""difftrb: a differentiable model of a tapered roller bearing with natural spalls.

N, mm, MPa and rad throughout. Float64 is needed: `jax.config.update("jax_enable_x64", True)`.
"""

from difftrb.contact import ContactSolution, approach_slopes, solve_contact
from difftrb.geometry import LineContact, Spall, TaperedBearing, bearing
from difftrb.law import PowerLaw, liu2018, power_law
from difftrb.ring import Load
from difftrb.scene import Assessment, Scene, Solution, assess, healthy, prepare, solve
from difftrb.scenefile import SceneError, load_scene
from difftrb.status import SolveError

__all__ = [
    "Assessment", "ContactSolution", "LineContact", "Load", "PowerLaw", "Scene", "SceneError", "Solution", "SolveError",
    "Spall", "TaperedBearing", "approach_slopes", "assess", "bearing", "healthy", "liu2018", "load_scene", "power_law",
    "prepare", "solve", "solve_contact",
]  # fmt: skip
