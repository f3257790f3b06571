"""The command line: `difftrb run | contact | …`; `COMMANDS` is the table of all.

Modules are imported by the commands that need them: `--version` and `example` load no JAX.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import difftrb
from difftrb.core import input_errors, jax_config
from difftrb.core.status import DifftrbError
from difftrb.report import console
from difftrb.report.console import EXIT_BAD_FILE, EXIT_INTERRUPTED, EXIT_OK, EXIT_PIPE


def _source(options: Any) -> tuple[str, str]:
    """The scene file's text, and its name."""
    from difftrb.scene import scene_file

    if options.scene is None:
        name = "contact" if options.command.name == "contact" else "spall"
        return scene_file.example(name), name
    return scene_file.text_of(options.scene), options.scene


def _read(options: Any) -> tuple[Any, str]:
    from difftrb.scene import scene_file

    text, path = _source(options)
    return scene_file.parse(text, path), path


def _by(module: str, read: bool = True) -> Callable[[Any], int]:
    """The command that `deliver` of a module carries out for a scene file, which it gets `read`."""

    def run(options: Any) -> int:
        return importlib.import_module(f"difftrb.{module}").deliver(options, *(_read(options) if read else ()))

    return run


def _run(options: Any) -> int:
    from difftrb.report import run_report

    return run_report.deliver(options, *_source(options))


def _explore(options: Any) -> int:
    from difftrb.scene import scene_file

    try:
        from difftrb.report import explorer
    except ImportError:
        return console.refuse("explore needs Bokeh: pip install '.[explore]' in difftrb's folder", EXIT_BAD_FILE)
    file, path = _read(options)
    scene_file.check_ring(file, path)
    console.say(f"http://localhost:{options.port} until Ctrl-C")
    explorer.serve(file.scene(), options.port, options.browser)
    return EXIT_OK


def _check(options: Any) -> int:
    from difftrb.report import remarks
    from difftrb.scene import scene_file

    text, path = _source(options)
    file = scene_file.parse(text, path)
    scene_file.check_ring(file, path)
    sweep = ""
    if scene_file.has_sweep(text):
        from difftrb.sweeps import sweep_file

        plan = sweep_file.parse(text, path).plan(law=False)
        sweep = f", with a sweep of {plan.members:,} members"
    console.remark(path, *remarks.of_ring(file))
    spalls = f"{len(file.spall)} spall{'s' if len(file.spall) > 1 else ''}" if file.spall else "healthy"
    print(f"{path}: in order: {file.bearing.rollers} rollers, {spalls}, radial {file.load.radial:g} N, "
          f"axial {file.load.axial:g} N, law {file.contact.law}{sweep}")  # fmt: skip
    if file.catalogue is not None:
        from difftrb.report import catalogue_uncertainty

        console.show(catalogue_uncertainty.table(file.catalogue))
    return EXIT_OK


def _example(options: Any) -> int:
    texts = input_errors.packaged(".toml") | input_errors.packaged(".csv")
    if options.name is None:
        for name, text in texts.items():
            print(f"{name:16s} {text.splitlines()[0].removeprefix('# ')}")
    elif options.name not in texts:
        name = input_errors.shown(options.name)
        return console.refuse(f"no example named {name}; there are {', '.join(texts)}", EXIT_BAD_FILE)
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


FILE = _option("scene", metavar="SCENE", help="a scene file (TOML); see `difftrb example`")
SCENE = _option("scene", **FILE[1], nargs="?")
JSON = _option("--json", action="store_true", help="print one JSON object instead of text")
OUTPUT = (
    JSON,
    _option("--out", metavar="DIR", type=Path, help="also write figures (PNG and SVG) and result.json there"),
)
COMMANDS = (
    Command("run", _run,
            "Loads, stiffness, its loss by the spall and its gradients (no SCENE: 32008J, spall 4 × 7 mm).", (
        SCENE, JSON,
        _option("--out", metavar="DIR", type=Path,
                help="also write report.html, its figures (PNG and SVG) and result.json there"),
        _option("--mean", action="store_true",
                help="the mean over the cage's turn also where it takes long: effects beyond raceways, law direct"),
        _option("--verify", action="store_true",
                help="solve the rollers' contacts afresh, and say how far off the law is"),
    )),
    Command("contact", _by("report.contact_report"),
            "One roller on its raceway: approach, pressure and derivatives (no SCENE: 32008J).", (SCENE, *OUTPUT)),
    Command("accuracy", _by("accuracy.accuracy_report"),
            "What accuracy costs in time, here and for this scene (no SCENE: that of run).", (
        SCENE, *OUTPUT,
        _option("--full", action="store_true", help="measure every law and setting: some minutes"),
        _option("--accuracy", metavar="X", type=float, help="relative error of stiffness to recommend a law for"),
    )),
    Command("fit", _by("fits.fit_report"),
            "From measured stiffness, or its loss, to the spall's size, with its uncertainty.", (
        _option("scene", metavar="SCENE", help="a scene file with a first guess of the spall; `difftrb example fit`"),
        _option("measured", metavar="MEASURED",
                help="a table (CSV) of loads, phase, quantity, value and sigma; see `difftrb example measured`"),
        _option("--parameters", default="length,width", metavar="NAMES",
                help="what to fit, of length, width, angle, depth, axial_offset, crown, preload, scale, "
                "reference, load_factor, length_2, width_2, angle_2 (default length,width)"),
        _option("--robust", default="squares", help="huber or student where single rows may be far off"),
        _option("--posterior", action="store_true", help="all that the rows leave possible, weighed"),
        _option("--spalls", metavar="N,…", help="how likely rows make so many spalls, say 0,1,2"),
        *OUTPUT,
    )),
    Command("sweep", _by("sweeps.sweep_file", read=False),
            "Many scenes: a scene file's [sweep] names axes, outputs and gradients.", (
        FILE,
        _option("--out", metavar="DIR", help="where sweep.zarr and figures go: a folder, or a URL as s3://bucket/name"),
        _option("--resume", action="store_true", help="go on with the sweep in DIR, also while others compute it"),
        _option("--dry-run", action="store_true", help="say members, memory, disk and time, and compute nothing"),
        _option("--devices", type=int, metavar="N", help="devices, or threads of a CPU, to use (default: all)"),
        _option("--batch", type=int, metavar="N", help="members computed at once (default: by size and platform)"),
        _option("--share", metavar="I/N", help="of N processes on one DIR: where this one begins (default: Slurm's)"),
        _option("--scheduler", metavar="ADDRESS", help="compute on a Dask cluster, say tcp://host:8786, or local"),
    )),
    Command("explore", _explore,
            "A page on this machine with sliders for spall, loads and phase (no SCENE: that of run).", (
        SCENE,
        _option("--port", type=int, default=5006, metavar="N", help="where it is served (default 5006)"),
        _option("--no-browser", dest="browser", action="store_false", help="serve it, and open no browser"),
    )),
    Command("stiffness", _by("report.stiffness_report"),
            "Stiffness over the cage's angle, for rotordynamics (no SCENE: that of run).", (
        SCENE,
        _option("--phases", type=int, metavar="N",
                help="of the cage over one roller pitch (default 64); over its whole turn where rollers differ"),
        _option("--out", metavar="FILE", type=Path, help="write a table: .csv, .json or .npz; or an .fmu"),
        _option("--units", type=str.lower, choices=("mm", "si"), default="mm", help="N/mm (default) or N/m"),
        _option("--speed", type=float, metavar="RPM", help="of the inner ring: times and defect frequencies"),
        _option("--shaft", metavar="R,A", help="radial and axial stiffness of the shaft in series [N/mm]"),
        _option("--housing", metavar="R,A", help="radial and axial stiffness of the housing in series [N/mm]"),
        _option("--slopes", action="store_true", help="derivatives by spall sizes also where they take long: effects"),
        JSON,
    )),
    Command("check", _check, "Check a scene file without computing anything.", (FILE,)),
    Command("example", _example, "Print a packaged scene file; without a NAME, list them.",
            (_option("name", nargs="?", metavar="NAME", help="of the list"),), jax=False),
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


def _is_in_the_way(options: Any) -> bool:
    """Whether there is a file where a folder of results is to be: known before anything is computed."""
    out = getattr(options, "out", None)  # a table's is a file, a sweep looks for itself
    return options.command.name != "stiffness" and isinstance(out, Path) and out.is_file()


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; the exit code: 0 all converged, 1 no solution, 2 a bad file or bad arguments."""
    options = _parser().parse_args(arguments)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal without µ and █ gets question marks, not a traceback
    if options.command.jax:
        with console.busy("starting"):  # to load JAX takes a second or two
            jax_config.set_up_jax(options.cache)
    try:
        if _is_in_the_way(options):
            return console.refuse(f"{options.out}: is a file; name a folder", EXIT_BAD_FILE)
        return options.command.run(options)
    except DifftrbError as error:
        return console.refuse(error, error.exit_code)
    except KeyboardInterrupt:
        goes_on = options.command.name == "sweep" and options.out is not None
        more = "; what is written is kept: --resume goes on" if goes_on else ""
        return console.refuse(f"interrupted{more}", EXIT_INTERRUPTED)
    except BrokenPipeError:  # the reader, say `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE
    except OSError as error:
        return console.refuse(f"{error.filename or 'output'}: {error.strerror or error}", EXIT_BAD_FILE)


if __name__ == "__main__":
    sys.exit(main())
