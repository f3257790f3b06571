"""The same numbers on every Python and with every jax, to 1e-9: what is pinned was measured, on Python 3.11."""

import dataclasses

import jax
import pytest

import difftrb as trb
from difftrb.contact import solver
from difftrb.core.jax_config import jit_quickly

pytestmark = [pytest.mark.portable, pytest.mark.exact]

AXIAL = 4500.0
PINNED: dict[str, dict[str, float]] = {
    "liu2018": {
        "load of roller 0": 1281.037760921, "load of roller 1": 1665.753545989, "load of roller 11": 36.32376652369,
        "axial displacement": 0.01103945963317, "radial stiffness": 3305437.156426, "radial to axial": 206193.5220777,
        "axial stiffness": 441988.1303446, "radial loss": 3.092136346252, "axial loss": 1.417722571033,
        "by length": -28726.26598059, "by width": 0.0, "by axial load": 504.1164014838,
        "by outer angle": -11085213.54633, "load by axial load": 0.1697623804402,
    },
    "power": {
        "load of roller 0": 1305.331932451, "load of roller 1": 1683.762602844, "load of roller 11": 57.35288038483,
        "axial displacement": 0.01127186134299, "radial stiffness": 3513750.858529, "radial to axial": 315459.2138925,
        "axial stiffness": 468443.03757, "radial loss": 2.480517025381, "axial loss": 1.061926730988,
        "by length": -32102.57612642, "by width": 0.0, "by axial load": 544.6589215252,
        "by outer angle": -11869462.74633, "load by axial load": 0.1632036475224,
    },
    "table": {
        "by angle": -6120374.216388, "by length": -4282.70078651, "by modulus": 15.38080203617,
        "by width": -106768.0799431, "load of roller 0": 1584.731804444, "radial stiffness": 3490225.754181,
    },
    "contact": {
        "approach": 0.008160926569886, "contact width": 0.2093580379787, "load": 2.226017129469e-06,
        "length": 4.584589788365e-05, "width": 0.0007991627089679, "offset": -0.001598325417936,
        "radius": -0.0001695687953508, "design_load": 1.336049520401e-07,
    },
}  # fmt: skip


def scene_by(bearing, law: str, phase: float = 0.0) -> trb.Scene:
    return trb.prepare(trb.Scene(bearing, trb.Load(9000.0, AXIAL), (trb.Spall(4.0, 7.0),), law, phase=phase))


def answers(scene: trb.Scene) -> dict[str, jax.Array]:
    """Loads, stiffness, loss, and derivatives of radial stiffness in reverse, of a load forward."""
    by = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene)

    def load(axial: jax.Array) -> jax.Array:
        return trb.solve(dataclasses.replace(scene, load=dataclasses.replace(scene.load, axial=axial))).loads[1]

    r = trb.assess(scene)
    return {
        "load of roller 0": r.spalled.loads[0],
        "load of roller 1": r.spalled.loads[1],
        "load of roller 11": r.spalled.loads[11],
        "axial displacement": r.spalled.displacement[2],
        "radial stiffness": r.spalled.stiffness[0, 0],
        "radial to axial": r.spalled.stiffness[0, 2],
        "axial stiffness": r.spalled.stiffness[2, 2],
        "radial loss": r.loss[0],
        "axial loss": r.loss[1],
        "by length": by.spalls[0].length,
        "by width": by.spalls[0].width,
        "by axial load": by.load.axial,
        "by outer angle": by.bearing.outer_angle,
        "load by axial load": jax.jvp(load, (AXIAL,), (1.0,))[1],
    }


def is_pinned(name: str, found: dict) -> None:
    assert {key: float(value) for key, value in found.items()} == pytest.approx(PINNED[name], rel=1e-9, abs=0.0)


@pytest.mark.parametrize("law", ["liu2018", "power"])
def test_default_scene(bearing, law: str) -> None:
    is_pinned(law, answers(scene_by(bearing, law)))


@jit_quickly()
def answers_at_edges(scene: trb.Scene) -> dict[str, jax.Array]:
    """Fewer, in one program: those of laws that know edges are large."""

    def stiffness(scene: trb.Scene) -> tuple[jax.Array, trb.Solution]:
        solution = trb.solve(scene)
        return solution.stiffness[0, 0], solution

    (radial, solution), by = jax.value_and_grad(stiffness, has_aux=True)(scene)
    return {
        "load of roller 0": solution.loads[0],
        "radial stiffness": radial,
        "by length": by.spalls[0].length,
        "by width": by.spalls[0].width,
        "by angle": by.spalls[0].angle,
        "by modulus": by.bearing.modulus,
    }


def test_a_roller_on_the_ramp(bearing) -> None:
    """Half a millimetre before the pitch between two rollers."""
    is_pinned("table", answers_at_edges(scene_by(bearing, "table", 0.1215)))


def test_a_contact_with_an_edge_in_it(contact) -> None:
    solution, slopes = solver.approach_and_slopes(contact, 3000.0, trb.Spall(2.0, 1.0), 0.5)
    is_pinned("contact", {"approach": solution.check().approach, "contact width": solution.contact_width} | slopes)
