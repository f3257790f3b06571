"""The command line: `difftrb run | contact | fit | sweep | accuracy | check | example`."""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import difftrb
from difftrb.core import terminal
from difftrb.core.atomic_io import write_folder
from difftrb.core.jax_config import set_up_jax

EXIT_OK, EXIT_NO_SOLUTION, EXIT_BAD_FILE, EXIT_INTERRUPTED, EXIT_PIPE = 0, 1, 2, 130, 141


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; the exit code: 0 all converged, 1 no solution, 2 a bad file or bad arguments."""
    options = _parser().parse_args(arguments)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal without µ and █ gets question marks, not a traceback
    set_up_jax(options.cache)
    from difftrb.core import cache
    from difftrb.core.status import SolveError, SweepError
    from difftrb.fits import measured
    from difftrb.scene import scene_file

    cache.keeping = options.cache
    try:
        return options.command(options)
    except scene_file.NoEquilibriumError as error:
        return _refuse(error, EXIT_NO_SOLUTION)
    except SolveError as error:
        return _refuse(error, EXIT_NO_SOLUTION)
    except (scene_file.SceneError, measured.MeasuredError, SweepError) as error:
        return _refuse(error, EXIT_BAD_FILE)
    except KeyboardInterrupt:
        return _refuse("interrupted", EXIT_INTERRUPTED)
    except BrokenPipeError:  # the reader, say `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE
    except OSError as error:
        return _refuse(f"{error.filename or 'output'}: {error.strerror or error}", EXIT_BAD_FILE)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="difftrb",
        description="Load distribution and stiffness of a spalled tapered roller bearing, with gradients.",
    )
    parser.add_argument("--version", action="version", version=f"difftrb {difftrb.__version__}")
    parser.add_argument(
        "--no-cache", dest="cache", action="store_false", help="do not keep compiled programs and tables on disk"
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, function: Callable[[Any], int], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(command=function)
        return sub

    for name, function, text in (
        ("run", _run, "Loads, stiffness, its loss by the spall and its gradients (no SCENE: 32008J, spall 4 × 7 mm)."),
        ("contact", _contact, "One roller on its raceway: approach, pressure and derivatives (no SCENE: 32008J)."),
        ("accuracy", _accuracy, "What accuracy costs in time, here and for this scene (no SCENE: as run)."),
    ):
        sub = command(name, function, text)
        sub.add_argument("scene", nargs="?", metavar="SCENE", help="a scene file (TOML); see `difftrb example`")
        _add_output(sub)
        if name == "run":
            text = "solve the rollers' contacts afresh, and say how far off the law is"
            sub.add_argument("--verify", action="store_true", help=text)
        if name == "accuracy":
            sub.add_argument("--full", action="store_true", help="measure every way; takes minutes, not one")
            sub.add_argument("--accuracy", metavar="X", type=float, help="of stiffness, to recommend a law for")
    sub = command("fit", _fit, "From measured stiffness, or its loss, to the spall's size, with its uncertainty.")
    sub.add_argument(
        "scene", metavar="SCENE", help="a scene file with a first guess of the spall; `difftrb example fit`"
    )
    sub.add_argument("measured", metavar="MEASURED", help="rows of measurements (CSV); see `difftrb example measured`")
    sub.add_argument("--parameters", default="length,width", metavar="NAMES", help="what to fit (default length,width)")
    sub.add_argument("--robust", default="squares", help="huber or student where single rows may be far off")
    _add_output(sub)
    sub = command("sweep", _sweep, "Many scenes: a scene file's [sweep] names axes, outputs and gradients.")
    sub.add_argument("scene", metavar="SCENE")
    sub.add_argument("--out", metavar="DIR", type=Path, help="where chunks, manifest.json, sweep.nc and figures go")
    sub.add_argument("--resume", action="store_true", help="go on with the sweep in DIR")
    sub.add_argument("--dry-run", action="store_true", help="say members, memory, disk and time, and compute nothing")
    sub.add_argument("--devices", type=int, metavar="N", help="devices, or threads of a CPU, to use (default: all)")
    sub.add_argument("--batch", type=int, metavar="N", help="members computed at once (default: by size and platform)")
    sub.add_argument("--coordinator", metavar="HOST:PORT", help="of several processes: where the first one listens")
    sub.add_argument("--processes", type=int, metavar="N", help="of several processes: how many there are")
    sub.add_argument("--process", type=int, metavar="I", help="of several processes: this one's number, from 0")
    sub = command("check", _check, "Check a scene file without computing anything.")
    sub.add_argument("scene", metavar="SCENE")
    sub = command("example", _example, "Print a packaged scene file; without a NAME, list them.")
    sub.add_argument("name", nargs="?", metavar="NAME")
    return parser


def _add_output(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    sub.add_argument("--out", metavar="DIR", type=Path, help="also write figures (PNG and SVG) and result.json there")


def _refuse(reason: object, code: int) -> int:
    print(f"difftrb: {reason}", file=sys.stderr)
    return code


def _read(options: Any) -> tuple[Any, str]:
    from difftrb.scene import scene_file

    if options.scene is None:
        name = "contact" if options.command is _contact else "spall"
        return scene_file.parse(scene_file.example(name), name), name
    return scene_file.read(options.scene), options.scene


def _run(options: Any) -> int:
    import jax

    from difftrb.report import remarks, run_report
    from difftrb.scene import scene_file
    from difftrb.scene.audit import verify
    from difftrb.scene.edge_stress import edge_stresses
    from difftrb.scene.solving import assess, prepare

    file, path = _read(options)
    scene_file.check_ring(file, path)
    _remark(remarks.light_ring_load(file), path)
    started = time.perf_counter()
    if file.contact.law in ("table", "direct", "auto"):
        with terminal.bar("solving contacts for the roller law") as progress:
            scene = jax.block_until_ready(prepare(file.scene(), progress))
    else:
        with terminal.busy("fitting the roller law to contact solves"):
            scene = jax.block_until_ready(prepare(file.scene()))
    with terminal.busy("solving the ring"):
        result = jax.block_until_ready(assess(scene))
        edges = edge_stresses(scene, result.spalled)
    checked = None
    if options.verify and bool(result.spalled.converged):
        with terminal.bar("solving the rollers' contacts afresh") as progress:
            checked = verify(scene, result.spalled, progress)
    record = run_report.run_json(scene, result, time.perf_counter() - started, edges, checked)

    def figures(folder: Path) -> None:
        from difftrb.report import plot

        plot.save(plot.load_distribution(result, scene), folder, "load_distribution")
        plot.save(plot.stiffness_bars(result, scene)[0], folder, "stiffness")
        pressed = plot.contact_under_spall(file.scene(), result.spalled)
        if bool(pressed.converged):
            plot.save(plot.pressure_map(pressed), folder, "pressure")
        else:
            print(f"difftrb: {path}: no pressure map: {pressed.status}", file=sys.stderr)

    code = _deliver(options, path, record, lambda: run_report.run_text(scene, result, edges, checked), figures)
    if code == EXIT_OK and checked is not None and not checked.kept:
        return _refuse(f"{path}: the audit does not confirm what is promised", EXIT_NO_SOLUTION)
    return code


def _contact(options: Any) -> int:
    import jax

    from difftrb.contact.contact_slopes import approach_and_slopes
    from difftrb.report import remarks, run_report
    from difftrb.scene import scene_file

    file, path = _read(options)
    scene_file.check_contact(file, path)
    _remark(remarks.light_contact_load(file), path)
    started = time.perf_counter()
    with terminal.busy("solving the contact"):
        solution, slopes = jax.block_until_ready(approach_and_slopes(**file.single_contact()))
    record = run_report.contact_json(solution, slopes, time.perf_counter() - started)

    def figures(folder: Path) -> None:
        from difftrb.report import plot

        plot.save(plot.pressure_map(solution), folder, "pressure")

    return _deliver(options, path, record, lambda: run_report.contact_text(solution, slopes), figures)


def _accuracy(options: Any) -> int:
    from difftrb.accuracy import accuracy_report, comparison, ladder
    from difftrb.report import remarks
    from difftrb.scene import scene_file

    if options.accuracy is not None and not 1e-6 <= options.accuracy <= 1.0:
        raise scene_file.SceneError(f"--accuracy = {options.accuracy:g}: must be a number in 1e-06 … 1")
    file, path = _read(options)
    _remark(remarks.light_ring_load(file), path)
    ways, limit = (ladder.FULL, float("inf")) if options.full else (ladder.RUNGS, comparison.LIMIT)
    with terminal.bar("measuring what accuracy costs") as progress:
        measured = comparison.measure(
            file, path, ways, options.accuracy, limit, progress=progress, thorough=options.full
        )

    def figures(folder: Path) -> None:
        from difftrb.accuracy import accuracy_plot
        from difftrb.report import plot

        if any(row.error > 0.0 for row in measured.rows):
            plot.save(accuracy_plot.work_precision(measured), folder, "accuracy")

    record = accuracy_report.accuracy_json(measured)
    return _deliver(options, path, record, lambda: accuracy_report.accuracy_text(measured), figures)


def _fit(options: Any) -> int:
    from difftrb.fits import fit_report, measured
    from difftrb.fits.fitting import fit, prepare_fit
    from difftrb.fits.optimal_design import next_measurements
    from difftrb.report import remarks
    from difftrb.scene import scene_file

    file, path = _read(options)
    scene_file.check_ring(file, path)
    rows = measured.load_measured(options.measured)
    _remark(remarks.light_measured_load(file.bearing, rows), options.measured)
    names = [name.strip() for name in options.parameters.split(",")]
    started = time.perf_counter()
    with terminal.bar("solving contacts for the roller law") as progress:
        scene = prepare_fit(file.scene(), rows, progress)
    _say_picked(scene)
    with terminal.busy("fitting"):
        result = fit(scene, rows, names, options.robust)
        suggestions = next_measurements(result) if bool(result.converged) else ()
    record = fit_report.fit_json(result, suggestions, time.perf_counter() - started)

    def figures(folder: Path) -> None:
        from difftrb.report import plot

        plot.save(fit_report.fit_panels(result), folder, "fit")

    return _deliver(options, path, record, lambda: fit_report.fit_text(result, suggestions), figures)


def _sweep(options: Any) -> int:
    from difftrb.core import devices
    from difftrb.report import remarks
    from difftrb.sweeps import chunks, forecast, sweep_file

    folder: Path = options.out
    if folder is None and not options.dry_run:
        return _refuse("sweep needs --out DIR, or --dry-run", EXIT_BAD_FILE)
    devices.join(options.coordinator, options.processes, options.process)  # before anything is computed
    file = sweep_file.read(options.scene)
    if not {"load.radial", "load.axial", "contact.load"} & set(file.axes):
        _remark((remarks.light_contact_load if file.of_contact else remarks.light_ring_load)(file.scene), options.scene)
    with terminal.bar("preparing the roller law") as progress:
        plan = file.plan(options.batch, progress)
    _say_picked(plan.base)
    if options.dry_run:
        with terminal.busy("measuring a small batch"):
            print(forecast.text(plan, options.devices, folder))
        return EXIT_OK
    with terminal.members("sweeping") as progress:
        ended = chunks.run(plan, folder, file.text, options.resume, options.devices, progress, _say)
    if ended.file is not None:
        try:
            with terminal.busy("drawing"):
                write_folder(folder, lambda scratch: _draw_sweep(ended.shown, scratch))
        except OSError as error:
            reason = f"{error.filename}: {error.strerror or error}: {ended.file.name} is whole, figures are missing"
            return _refuse(f"{reason}; make room or allow writing there, and go on with --resume", EXIT_BAD_FILE)
        print(ended.sentence(folder))
    return EXIT_OK if ended.failed == 0 else EXIT_NO_SOLUTION


def _draw_sweep(swept: Any, folder: Path) -> None:
    from difftrb.report import plot
    from difftrb.sweeps import sweep_plot

    for name in swept.values:
        if not swept.own_dims[name]:
            plot.save(sweep_plot.swept(swept, name), folder, name)


def _say_picked(base: Any) -> None:
    from difftrb.report import run_report

    if (picked := getattr(base, "picked", None)) is not None:
        _say(run_report.picked_text(picked))


def _remark(sentence: str | None, path: str) -> None:
    """What may be wrong with a file that is in order."""
    if sentence is not None:
        _say(f"{path}: {sentence}")


def _say(sentence: str) -> None:
    print(f"difftrb: {sentence}", file=sys.stderr)


def _check(options: Any) -> int:
    from difftrb.report import remarks
    from difftrb.scene import scene_file

    file = scene_file.read(options.scene)
    scene_file.check_ring(file, options.scene)
    _remark(remarks.light_ring_load(file), options.scene)
    spalls = f"{len(file.spall)} spall{'s' if len(file.spall) != 1 else ''}" if file.spall else "healthy"
    print(f"{options.scene}: in order: {file.bearing.rollers} rollers, {spalls}, radial {file.load.radial:g} N, "
          f"axial {file.load.axial:g} N, law {file.contact.law}")  # fmt: skip
    return EXIT_OK


def _example(options: Any) -> int:
    from difftrb.core.files import shown
    from difftrb.fits import measured
    from difftrb.scene import scene_file

    files = {name: scene_file.example(name) for name in scene_file.example_names()} | {"measured": measured.example()}
    if options.name is None:
        for name, text in files.items():
            print(f"{name:16s} {text.splitlines()[0].removeprefix('# ')}")
    elif options.name not in files:
        return _refuse(f"no example named {shown(options.name)}; there are {', '.join(files)}", EXIT_BAD_FILE)
    else:
        print(files[options.name], end="")
    return EXIT_OK


def _deliver(
    options: Any, path: str, record: dict[str, Any], text: Callable[[], Any], figures: Callable[[Path], None]
) -> int:
    """Print the result, write it where asked, and say by the exit code whether it can be trusted."""
    if not record["converged"]:
        if options.json:
            print(json.dumps(record, indent=1))
        return _refuse(f"{path}: {record['status']}", EXIT_NO_SOLUTION)
    if options.out is not None:
        with terminal.busy("drawing"):
            write_folder(options.out, lambda folder: _fill(folder, record, figures))
    if options.json:
        print(json.dumps(record, indent=1))
    else:
        from rich.console import Console

        console = Console(markup=False, highlight=False)
        console.print(text())
        if options.out is not None:
            console.print(f"written to {options.out}: {', '.join(sorted(p.name for p in options.out.iterdir()))}")
    return EXIT_OK


def _fill(folder: Path, record: dict[str, Any], figures: Callable[[Path], None]) -> None:
    figures(folder)
    (folder / "result.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
