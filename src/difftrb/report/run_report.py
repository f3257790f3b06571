"""What `difftrb run` does: a scene and, where wanted, its mean, an audit and other bearings of its catalogue."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import jax

from difftrb.report import catalogue_uncertainty, console, remarks, run_text
from difftrb.report.console import EXIT_NO_SOLUTION, EXIT_OK, Figures
from difftrb.ring.effect_base import differ
from difftrb.scene import scene_file, solving
from difftrb.scene.audit import verify
from difftrb.scene.edge_stress import edge_stresses


def deliver(options: Any, source: str, path: str) -> int:
    """Solve the scene of a file's text, print it and write it where `options` ask; the exit code."""
    file = scene_file.parse(source, path)
    scene_file.check_ring(file, path)
    console.remark(path, *remarks.of_ring(file))
    started = time.perf_counter()
    with console.bar("solving contacts for the roller law") as progress:
        scene = jax.block_until_ready(solving.prepare(file.scene(), progress))
    with console.busy("solving the ring"):
        result = jax.device_get(solving.assess(scene))
        edges = edge_stresses(scene, result.spalled)
    mean = None
    if (options.mean or not differ(scene.effects)) and bool(result.spalled.converged):
        with (console.bar if options.mean else console.busy)("solving the ring at all phases") as progress:
            mean = jax.device_get(solving.assess_mean(scene, file.scene() if options.mean else None, progress))
    if mean is not None and not bool(mean.spalled.converged):
        console.remark(path, f"no mean over the cage's turn: {mean.spalled.status}")
    elif mean is None and options.mean and any(spall.surface == "roller" for spall in scene.spalls):
        console.remark(path, "no mean over the cage's turn: a spall on a roller belongs to that one")
    checked = None
    if options.verify and bool(result.spalled.converged):
        with console.bar("solving the rollers' contacts afresh") as progress:
            checked = verify(scene, result.spalled, progress)
    known = None
    if file.catalogue is not None:
        with console.busy("asking other bearings of this catalogue line"):
            stiffness = result.spalled.both_stiffnesses
            known = catalogue_uncertainty.estimated(scene, file.scene(), file.catalogue, stiffness)
    record = run_text.run_json(scene, result, time.perf_counter() - started, edges, checked, mean, known)

    missing: list[str] = []

    def figures() -> Figures:
        from difftrb.report import run_figures

        yield from run_figures.figures(scene, result, mean, missing)
        for sentence in set(missing).difference(run_figures.BY_DESIGN):
            console.say(f"{path}: {sentence}")

    def page(figures: dict[str, str]) -> str:
        from difftrb.report.html_report import Run
        from difftrb.report.html_report import page as written

        return written(Run(path, source, scene, record, result, mean, edges, checked, known), figures, missing)

    text = partial(run_text.run_text, scene, result, edges, checked, mean, known)
    code = console.deliver(options, path, record, text, figures, page)
    if code == EXIT_OK and checked is not None and not checked.kept:
        return console.refuse(f"{path}: the audit does not confirm what is promised", EXIT_NO_SOLUTION)
    return code
