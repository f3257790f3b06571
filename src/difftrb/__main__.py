"""The command line: `difftrb run | contact | accuracy | fit | sweep | stiffness | check | example`; see `COMMANDS`.

Modules are imported by the commands that need them: `--version` and `example` load no JAX.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import difftrb
from difftrb.core import jax_config, messages
from difftrb.core.status import DifftrbError, SceneError
from difftrb.report import terminal
from difftrb.report.terminal import EXIT_BAD_FILE, EXIT_INTERRUPTED, EXIT_NO_SOLUTION, EXIT_OK, EXIT_PIPE, Figures


def _read(options: Any) -> tuple[Any, str]:
    from difftrb.scene import scene_file

    if options.scene is None:
        name = "contact" if options.command.name == "contact" else "spall"
        return scene_file.parse(scene_file.example(name), name), name
    return scene_file.read(options.scene), options.scene


def _run(options: Any) -> int:
    import jax

    from difftrb.report import estimated, remarks, run_report
    from difftrb.scene import scene_file, solving
    from difftrb.scene.scene import is_plain

    file, path = _read(options)
    scene_file.check_ring(file, path)
    terminal.remark(remarks.light_ring_load(file), path)
    started = time.perf_counter()
    with terminal.bar("solving contacts for the roller law") as progress:
        scene = jax.block_until_ready(difftrb.prepare(file.scene(), progress))
    with terminal.busy("solving the ring"):
        result = jax.device_get(difftrb.assess(scene))
        edges = difftrb.edge_stresses(scene, result.spalled)
    mean = None
    if (options.mean or is_plain(scene)) and bool(result.spalled.converged):
        with terminal.busy("solving the ring at all phases"):
            mean = jax.device_get(solving.assess_mean(scene))
    checked = None
    if options.verify and bool(result.spalled.converged):
        with terminal.bar("solving the rollers' contacts afresh") as progress:
            checked = difftrb.verify(scene, result.spalled, progress)
    known = None
    if file.catalogue is not None:
        known = estimated.estimated(scene, file.catalogue, result.spalled.both_stiffnesses)
    record = run_report.run_json(scene, result, time.perf_counter() - started, edges, checked, mean, known)

    def figures(plot: Any) -> Figures:
        yield "load_distribution", plot.load_distribution(result, scene)
        yield "stiffness", plot.stiffness_bars(result, scene)[0]
        pressed = plot.contact_under_spall(file.scene(), result.spalled)
        if bool(pressed.converged):
            yield "pressure", plot.pressure_map(pressed)
        else:
            terminal.say(f"{path}: no pressure map: {pressed.status}")

    text = partial(run_report.run_text, scene, result, edges, checked, mean, known)
    code = terminal.deliver(options, path, record, text, figures)
    if code == EXIT_OK and checked is not None and not checked.kept:
        return terminal.refuse(f"{path}: the audit does not confirm what is promised", EXIT_NO_SOLUTION)
    return code


def _contact(options: Any) -> int:
    import jax

    from difftrb.contact.solver import approach_and_slopes
    from difftrb.report import remarks, run_report
    from difftrb.scene import scene_file

    file, path = _read(options)
    scene_file.check_contact(file, path)
    terminal.remark(remarks.light_contact_load(file), path)
    started = time.perf_counter()
    with terminal.busy("solving the contact"):
        solution, slopes = jax.block_until_ready(approach_and_slopes(**file.single_contact()))
    record = run_report.contact_json(solution, slopes, time.perf_counter() - started)

    text = partial(run_report.contact_text, solution, slopes)
    return terminal.deliver(options, path, record, text, lambda plot: [("pressure", plot.pressure_map(solution))])


def _accuracy(options: Any) -> int:
    from difftrb.accuracy import accuracy_report, ladder, timing
    from difftrb.report import remarks

    if options.accuracy is not None and not 1e-6 <= options.accuracy <= 1.0:
        raise SceneError(f"--accuracy = {options.accuracy:g}: must be a number in 1e-06 … 1")
    file, path = _read(options)
    terminal.remark(remarks.light_ring_load(file), path)
    full = options.full
    rungs, limit = ladder.rungs(full), float("inf") if full else timing.LIMIT
    with terminal.bar("measuring what accuracy costs") as progress:
        measured = timing.measure(file, path, rungs, options.accuracy, limit, progress=progress, thorough=options.full)

    def figures(_: Any) -> Figures:
        if any(row.error > 0.0 for row in measured.rows):
            yield "accuracy", accuracy_report.work_precision(measured)

    record = accuracy_report.accuracy_json(measured)
    return terminal.deliver(options, path, record, lambda: accuracy_report.accuracy_text(measured), figures)


def _fit(options: Any) -> int:
    from difftrb.fits import fit_report, measured
    from difftrb.fits.fitting import fit, prepare_fit
    from difftrb.fits.optimal_design import next_measurements
    from difftrb.report import remarks
    from difftrb.scene import scene_file

    file, path = _read(options)
    scene_file.check_ring(file, path)
    rows = measured.load_measured(options.measured)
    terminal.remark(remarks.light_measured_load(file.bearing, rows), options.measured)
    started = time.perf_counter()
    with terminal.bar("solving contacts for the roller law") as progress:
        scene = prepare_fit(file.scene(), rows, progress)
    terminal.say_picked(scene)
    with terminal.busy("fitting"):
        result = fit(scene, rows, [name.strip() for name in options.parameters.split(",")], options.robust)
        suggestions = next_measurements(result) if bool(result.converged) else ()
    record = fit_report.fit_json(result, suggestions, time.perf_counter() - started)

    text = partial(fit_report.fit_text, result, suggestions)
    return terminal.deliver(options, path, record, text, lambda _: [("fit", fit_report.fit_panels(result))])


def _sweep(options: Any) -> int:
    from difftrb.core import machine
    from difftrb.report import remarks
    from difftrb.sweeps import chunks, sweep_file, sweeping

    folder: Path = options.out
    if folder is None and not options.dry_run:
        return terminal.refuse("sweep needs --out DIR, or --dry-run", EXIT_BAD_FILE)
    machine.join(options.coordinator, options.processes, options.process)  # before anything is computed
    file = sweep_file.read(options.scene)
    if not {"load.radial", "load.axial", "contact.load"} & set(file.axes):
        light = remarks.light_contact_load if file.of_contact else remarks.light_ring_load
        terminal.remark(light(file.scene), options.scene)
    with terminal.bar("preparing the roller law") as progress:
        plan = file.plan(options.batch, progress)
    terminal.say_picked(plan.base)
    if options.dry_run:
        with terminal.busy("measuring a small batch"):
            print(sweeping.forecast(plan, options.devices, folder))
        return EXIT_OK
    with terminal.members("sweeping") as progress:
        ended = chunks.run(plan, folder, file.text, options.resume, options.devices, progress, terminal.say)
    if ended.file is not None:
        try:
            from difftrb.sweeps import sweep_plot

            shown: Any = ended.shown
            names = [name for name in shown.values if not shown.own_dims[name]]
            terminal.draw(folder, lambda _: ((name, sweep_plot.swept(shown, name)) for name in names))
        except OSError as error:
            reason = f"{error.filename}: {error.strerror or error}: {ended.file.name} is whole, figures are missing"
            reason += "; make room or allow writing there, and go on with --resume"
            return terminal.refuse(reason, EXIT_BAD_FILE)
        print(ended.sentence(folder))
    return EXIT_OK if ended.failed == 0 else EXIT_NO_SOLUTION


def _stiffness(options: Any) -> int:
    from difftrb.report import stiffness_report

    return stiffness_report.deliver(options, *_read(options))


def _check(options: Any) -> int:
    from difftrb.report import remarks
    from difftrb.scene import scene_file

    file, path = _read(options)
    scene_file.check_ring(file, path)
    terminal.remark(remarks.light_ring_load(file), path)
    spalls = f"{len(file.spall)} spall{'s' if len(file.spall) > 1 else ''}" if file.spall else "healthy"
    print(f"{path}: in order: {file.bearing.rollers} rollers, {spalls}, radial {file.load.radial:g} N, "
          f"axial {file.load.axial:g} N, law {file.contact.law}")  # fmt: skip
    if file.catalogue is not None:
        from difftrb.report import estimated, run_report

        terminal.show(estimated.table(file.catalogue, run_report.house_table("Bearing estimated from its catalogue")))
    return EXIT_OK


def _example(options: Any) -> int:
    texts = messages.packaged(".toml") | messages.packaged(".csv")
    if options.name is None:
        for name, text in texts.items():
            print(f"{name:16s} {text.splitlines()[0].removeprefix('# ')}")
    elif options.name not in texts:
        name = messages.shown(options.name)
        return terminal.refuse(f"no example named {name}; there are {', '.join(texts)}", EXIT_BAD_FILE)
    else:
        print(texts[options.name], end="")
    return EXIT_OK


def _option(name: str, **rules: Any) -> tuple[str, dict[str, Any]]:
    """An argument of a command, as `argparse` takes it."""
    return name, rules


class Command(NamedTuple):
    """What a command does, its arguments, and the function that carries it out and returns the exit code."""

    name: str
    run: Callable[[Any], int]
    text: str
    options: tuple[tuple[str, dict[str, Any]], ...]
    jax: bool = True


SCENE = _option("scene", nargs="?", metavar="SCENE", help="a scene file (TOML); see `difftrb example`")
OUTPUT = (
    _option("--json", action="store_true", help="print one JSON object instead of text"),
    _option("--out", metavar="DIR", type=Path, help="also write figures (PNG and SVG) and result.json there"),
)
COMMANDS = (
    Command("run", _run,
            "Loads, stiffness, its loss by the spall and its gradients (no SCENE: 32008J, spall 4 × 7 mm).", (
        SCENE, *OUTPUT,
        _option("--mean", action="store_true",
                help="the mean over the cage's turn also where it takes seconds: with effects, or law direct"),
        _option("--verify", action="store_true",
                help="solve the rollers' contacts afresh, and say how far off the law is"),
    )),
    Command("contact", _contact, "One roller on its raceway: approach, pressure and derivatives (no SCENE: 32008J).",
            (SCENE, *OUTPUT)),
    Command("accuracy", _accuracy, "What accuracy costs in time, here and for this scene (no SCENE: as run).", (
        SCENE, *OUTPUT,
        _option("--full", action="store_true", help="measure every way; takes minutes, not one"),
        _option("--accuracy", metavar="X", type=float, help="of stiffness, to recommend a law for"),
    )),
    Command("fit", _fit, "From measured stiffness, or its loss, to the spall's size, with its uncertainty.", (
        _option("scene", metavar="SCENE", help="a scene file with a first guess of the spall; `difftrb example fit`"),
        _option("measured", metavar="MEASURED", help="rows of measurements (CSV); see `difftrb example measured`"),
        _option("--parameters", default="length,width", metavar="NAMES", help="what to fit (default length,width)"),
        _option("--robust", default="squares", help="huber or student where single rows may be far off"), *OUTPUT,
    )),
    Command("sweep", _sweep, "Many scenes: a scene file's [sweep] names axes, outputs and gradients.", (
        _option("scene", metavar="SCENE"),
        _option("--out", metavar="DIR", type=Path, help="where chunks, manifest.json, sweep.nc and figures go"),
        _option("--resume", action="store_true", help="go on with the sweep in DIR"),
        _option("--dry-run", action="store_true", help="say members, memory, disk and time, and compute nothing"),
        _option("--devices", type=int, metavar="N", help="devices, or threads of a CPU, to use (default: all)"),
        _option("--batch", type=int, metavar="N", help="members computed at once (default: by size and platform)"),
        _option("--coordinator", metavar="HOST:PORT", help="of several processes: where the first one listens"),
        _option("--processes", type=int, metavar="N", help="of several processes: how many there are"),
        _option("--process", type=int, metavar="I", help="of several processes: this one's number, from 0"),
    )),
    Command("stiffness", _stiffness, "Stiffness over the cage's angle, for rotordynamics (no SCENE: as run).", (
        SCENE,
        _option("--phases", type=int, default=64, metavar="N", help="of the cage over one roller pitch (default 64)"),
        _option("--out", metavar="FILE", type=Path, help="write a table: .csv, .json or .npz"),
        _option("--units", choices=("mm", "si"), default="mm", help="N/mm (default) or N/m"),
        _option("--speed", type=float, metavar="RPM", help="of the inner ring: times and defect frequencies"),
        _option("--shaft", metavar="R,A", help="radial and axial stiffness of the shaft in series [N/mm]"),
        _option("--housing", metavar="R,A", help="radial and axial stiffness of the housing in series [N/mm]"),
        _option("--slopes", action="store_true", help="derivatives by spall sizes also where they take long: effects"),
        _option("--json", action="store_true", help="print one JSON object instead of text"),
    )),
    Command("check", _check, "Check a scene file without computing anything.", (_option("scene", metavar="SCENE"),)),
    Command("example", _example, "Print a packaged scene file; without a NAME, list them.",
            (_option("name", nargs="?", metavar="NAME"),), jax=False),
)  # fmt: skip


def _parser() -> argparse.ArgumentParser:
    about = "Load distribution and stiffness of a spalled tapered roller bearing, with gradients."
    parser = argparse.ArgumentParser(prog="difftrb", description=about)
    parser.add_argument("--version", action="version", version=f"difftrb {difftrb.__version__}")
    about = "do not keep compiled programs on disk"
    parser.add_argument("--no-cache", dest="cache", action="store_false", help=about)
    parsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        sub = parsers.add_parser(command.name, help=command.text, description=command.text)
        sub.set_defaults(command=command)
        for name, rules in command.options:
            sub.add_argument(name, **rules)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; the exit code: 0 all converged, 1 no solution, 2 a bad file or bad arguments."""
    options = _parser().parse_args(arguments)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal without µ and █ gets question marks, not a traceback
    if options.command.jax:
        jax_config.set_up_jax(options.cache)
    try:
        return options.command.run(options)
    except DifftrbError as error:
        return terminal.refuse(error, error.exit_code)
    except KeyboardInterrupt:
        return terminal.refuse("interrupted", EXIT_INTERRUPTED)
    except BrokenPipeError:  # the reader, say `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE
    except OSError as error:
        return terminal.refuse(f"{error.filename or 'output'}: {error.strerror or error}", EXIT_BAD_FILE)


if __name__ == "__main__":
    sys.exit(main())
