"""Which figures a run has, and why one is missing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from difftrb.report import bearing_drawing, plot, stiffness_plot
from difftrb.scene.scene import PitchMean, Scene
from difftrb.scene.solution import Assessment
from difftrb.turning import spall_loss

NO_TURN = (
    "Stiffness over the cage's turn is drawn for scenes without effects, whose law holds at every phase; `difftrb "
    "stiffness` tells it of all."
)
NO_MAP = (
    "Loss over length and width is drawn for scenes without effects, whose law holds at every phase, and for a wide "
    "spall on the outer raceway; `difftrb sweep` over spall.0.length and spall.0.width does it for all."
)
BY_DESIGN = (NO_TURN, NO_MAP)
"""What need not be said but on the page."""


def figures(scene: Scene, result: Assessment, mean: Assessment | None, missing: list[str]) -> Iterator[tuple[str, Any]]:
    """Names and Axes, or Figures, of a solved and prepared scene; `missing` gets a sentence for each left out."""
    yield "bearing", bearing_drawing.bearing(scene, result.spalled)
    yield "load_distribution", plot.load_distribution(result, scene)
    pressed = plot.contacts_at_spall(scene, result.spalled)
    if all(bool(one.solution.converged) for one in pressed):
        yield "pressure", plot.pressures(pressed)
    else:
        missing.append(f"no pressure map: {next(o.solution.status for o in pressed if not bool(o.solution.converged))}")
    turn = spall_loss.over_turn(scene)
    if turn is None:
        missing.append(NO_TURN)
    else:
        yield "stiffness", stiffness_plot.over_turn(turn, scene)
    if not scene.spalls:
        return
    mean = result if mean is None and turn is not None and isinstance(scene.phase, PitchMean) else mean
    found = None if mean is None else spall_loss.loss_map(scene, *spall_loss.sizes_around(scene))
    if found is None or mean is None:
        missing.append(NO_MAP)
    else:
        yield "loss", stiffness_plot.loss_over_sizes(found, scene, mean)
