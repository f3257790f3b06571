"""The table `[sweep]` of a scene file: axes, outputs, gradients, the plan that they make with the scene; and what
`difftrb sweep` does with it."""

from __future__ import annotations

import dataclasses
import os
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from difftrb.contact.contact_solution import ContactSolution
from difftrb.contact.solver import solve_contact
from difftrb.core.bearing_checks import across
from difftrb.core.input_errors import did_you_mean, dotted, shown
from difftrb.core.status import SceneError, SweepError
from difftrb.law.samples import Progress
from difftrb.report import console, remarks
from difftrb.scene import scene_file
from difftrb.scene.file_schema import SceneFile
from difftrb.sweeps import axes as axes_
from difftrb.sweeps import chunk_sharing, outputs, sweeping
from difftrb.sweeps.axes import RANGE_KEYS
from difftrb.sweeps.plan import Plan
from difftrb.sweeps.store import RESUME

SETTINGS = ("outputs", "gradients", "mode", "axes")


@dataclasses.dataclass(frozen=True)
class SweepFile:
    """A scene file with its `[sweep]`, checked; `text` is the whole file's."""

    scene: SceneFile
    axes: dict[str, Any]
    outputs: tuple[str, ...]
    gradients: tuple[str, ...]
    mode: str
    text: str
    path: str

    @property
    def of_contact(self) -> bool:
        """Whether single contacts are swept, and not rings."""
        return outputs.of_contact(self.outputs)

    def plan(self, batch: int | None = None, progress: Progress | None = None, law: bool = True) -> Plan:
        """What is to be computed; the roller law is made now, unless it is to be checked only. Raises `SceneError`."""
        try:
            ring = not self.of_contact
            more: dict[str, Any] = {} if ring else {"solved": _contact, "wrong": _wrong_contact}
            asked = self.outputs, self.scene.scene() if ring else self.scene, self.axes, self.gradients, self.mode
            batch = batch if ring or batch is not None else 1
            return sweeping.plan_sweep(*asked, batch, progress, text=self.text, law=law, **more)
        except (SweepError, SceneError) as error:
            raise SceneError(f"{self.path}: sweep: {error}") from None


def _contact(file: SceneFile) -> ContactSolution:
    return solve_contact(**file.single_contact())


def _wrong_contact(file: SceneFile) -> str | None:
    try:
        scene_file.check_contact(file, "")
    except SceneError as error:
        return str(error).removeprefix(": ")
    return across(file.bearing, file.spall)


def deliver(options: Any) -> int:
    """Sweep what a file asks for into where `options` say, or say what it would take; the exit code."""
    out: str | None = options.out
    if out is None and not options.dry_run:
        return console.refuse("sweep needs --out DIR, or --dry-run", console.EXIT_BAD_FILE)
    share = share_of(options.share)
    file = read(options.scene)
    if not {"load.radial", "load.axial", "contact.load"} & set(file.axes):
        light = remarks.odd_contact_load if file.of_contact else remarks.odd_ring_load
        console.remark(options.scene, light(file.scene))
    if not file.of_contact and not any(key.endswith(".angle") for key in file.axes):
        console.remark(options.scene, remarks.far_angle(file.scene))
    console.remark(options.scene, _idle_width(file))
    with console.bar("preparing the roller law") as progress:
        plan = file.plan(options.batch, progress)
    if not file.of_contact and {"load.radial", "load.axial"} & set(file.axes):
        console.remark(options.scene, remarks.odd_ring_load(_under_the_heaviest(file.scene, plan)))
    console.say_picked(plan.base)
    if options.dry_run:
        print(sweeping.forecast_of_disk(plan, out), flush=True)
        with console.busy("compiling the sweep's program, and measuring a small batch"):
            print(sweeping.forecast(plan, options.devices))
        if options.cache:
            print("compiled  and kept: the sweep itself need not wait for that")
        return console.EXIT_OK
    with console.members("sweeping") as progress:
        ended = chunk_sharing.run(
            plan, str(out), options.resume, options.devices, progress, console.say, share, options.scheduler
        )
    shown: Any = ended.shown
    if shown is not None and "://" not in str(out):
        try:
            from difftrb.sweeps import sweep_plot

            names = [name for name in shown.values if not shown.own_dims[name]]
            console.draw(Path(str(out)), lambda: ((name, sweep_plot.swept(shown, name)) for name in names))
        except OSError as error:
            left = f"{ended.where} is whole, figures are missing; {chunk_sharing.MEND}, and {RESUME}"
            return console.refuse(f"{error.filename}: {error.strerror or error}: {left}", console.EXIT_BAD_FILE)
    print(ended.sentence())
    return console.EXIT_OK if ended.failed == 0 else console.EXIT_NO_SOLUTION


def _under_the_heaviest(scene: SceneFile, plan: Plan) -> SceneFile:
    """The scene under the largest radial and axial load of a sweep."""
    most = {key.removeprefix("load."): float(np.max(values))
            for axis in plan.axes for key, values in zip(axis.keys, axis.values, strict=True)
            if key in ("load.radial", "load.axial")}  # fmt: skip
    return dataclasses.replace(scene, load=dataclasses.replace(scene.load, **most))


def _idle_width(file: SweepFile) -> str | None:
    """The remark on an axis of widths at one phase, where most rollers stand on no edge, if there is one."""
    widths = [key for key in file.axes if key.startswith("spall.") and key.endswith(".width")]
    at_one = not file.of_contact and not isinstance(file.scene.stiffness.phase, str)
    if not widths or not at_one or "stiffness.phase" in file.axes:
        return None
    return f'{widths[0]} acts only where a roller stands on a rolling edge at this phase; take stiffness.phase = "mean"'


def read(path: str | Path) -> SweepFile:
    """Read and check a scene file with a table `[sweep]`. Raises `SceneError`."""
    return parse(scene_file.text_of(path), path)


def load_plan(path: str | Path, batch: int | None = None) -> Plan:
    """What a scene file with a table `[sweep]` asks for, to be computed by `compute_chunk`; `batch` as in `sweep`.

    Raises `SceneError`.
    """
    return read(path).plan(batch)


def parse(text: str, path: str | Path = "scene") -> SweepFile:
    """Check the text of a scene file with a table `[sweep]`; `path` names it in errors. Raises `SceneError`."""
    file = scene_file.parse(text, path)
    table = tomllib.loads(text).get("sweep")
    if not isinstance(table, dict) or not table:
        raise SceneError(f"{path}: [sweep] is missing: name axes, say {axes_.EXAMPLE}")
    try:
        given, gradients = _axes(table), _texts(table, "gradients", ())
        asked = _texts(table, "outputs", outputs.DEFAULT)
    except SweepError as error:
        raise SceneError(f"{path}: sweep: {error}") from None
    found = SweepFile(file, given, asked, gradients, table.get("mode", "product"), text, str(path))
    found.plan(law=False)
    return found


def _texts(table: dict[str, Any], key: str, default: tuple[str, ...]) -> tuple[str, ...]:
    value = table.get(key, default)
    if not isinstance(value, list | tuple) or not all(isinstance(entry, str) for entry in value):
        raise SweepError(f"{key} = {shown(value)}: must be a list of names in quotes")
    return tuple(value)


def _axes(table: dict[str, Any]) -> dict[str, Any]:
    """Axes by dotted key, whether written straight under [sweep], under [sweep.axes], quoted or not."""
    own, found = table.get("axes", {}), {}
    if not isinstance(own, dict):
        raise SweepError(f"axes = {shown(own)}: must be a table")
    for key, spec in (*_flat({key: value for key, value in table.items() if key not in SETTINGS}), *_flat(own)):
        written = dotted(key.split("."))
        if written != key:  # quoted, or cut: no key of a scene has to be
            raise SweepError(f"{written} is not a known key; known here: {axes_.OF_SCENE}")
        if key in found:
            raise SweepError(f"{key} is there twice")
        found[key] = spec
    return found


def _flat(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        key = before + name
        if not before and "." not in name and not isinstance(value, dict):
            raise SweepError(f"{dotted([name])} is not a known key; {did_you_mean(name, SETTINGS, ' and dotted keys')}")
        if isinstance(value, dict) and not set(value) & set(RANGE_KEYS) and value:
            yield from _flat(value, f"{key}.")
        else:
            yield key, value


def share_of(given: str | None, environment: Mapping[str, str] = os.environ) -> tuple[int, int] | None:
    """This process's number and how many there are, from "I/N", by default of a task of a Slurm array or step; None
    alone. Raises `SweepError`."""
    if given is None and "SLURM_ARRAY_TASK_ID" in environment:
        task, first, last, step = (int(environment.get(f"SLURM_ARRAY_TASK_{name}", default))
                                   for name, default in (("ID", 0), ("MIN", 0), ("MAX", 0), ("STEP", 1)))  # fmt: skip
        given = f"{(task - first) // step + 1}/{(last - first) // step + 1}"
    elif given is None and "SLURM_PROCID" in environment:
        given = f"{int(environment['SLURM_PROCID']) + 1}/{environment.get('SLURM_NTASKS', '1')}"
    number, _, many = (given or "1/1").partition("/")
    if not (number.isdecimal() and many.isdecimal() and 1 <= int(number) <= int(many)):
        raise SweepError(f"--share {given}: must be I/N, this process's number and how many there are, say 1/4 … 4/4")
    return (int(number), int(many)) if given and int(many) > 1 else None
