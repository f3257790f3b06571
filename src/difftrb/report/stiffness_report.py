"""What `difftrb stiffness` says, and writes to a file: CSV, JSON or NPZ, in N and mm or in SI, axes and units named; or
an FMU."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from rich.table import Table

from difftrb.core import storage
from difftrb.core.input_errors import named
from difftrb.core.status import SceneError
from difftrb.report import catalogue_uncertainty, console, remarks, tables
from difftrb.scene import scene_file, solution
from difftrb.scene.file_schema import SceneFile
from difftrb.turning import fmu
from difftrb.turning.cage_turn import CageTurn, stiffness
from difftrb.turning.defect_frequencies import DefectFrequencies, defect_frequencies

Units = Literal["mm", "si"]
UNITS = "mm", "si"
KINDS = ".csv", ".json", ".npz", ".fmu"
ROUNDING = 1e-13
"""Share of an array's largest entry below which others are written as 0."""
SHOWN = 3
"""Axes whose own stiffness is shown: radial, lateral, axial."""


def deliver(options: Any, file: SceneFile, path: str) -> int:
    """Solve a scene over its cage's angle, print it and write it where `options` ask; the exit code."""
    scene_file.check_ring(file, path)
    pairs = [springs(one) for one in (options.shaft, options.housing) if one is not None]
    if options.out is not None:
        check_ending(Path(options.out))
    speed: float | None = options.speed
    _check_speed(speed)
    console.remark(path, *remarks.of_ring(file))
    with console.bar("solving the ring over the cage's angle") as progress:
        turn = stiffness(file.scene(), options.phases, slopes=options.slopes or None, progress=progress)
    if not np.all(np.asarray(turn.converged)):
        return console.refuse(f"{path}: {turn.status}", console.EXIT_NO_SOLUTION)
    rigid = [1e30] * (turn.stiffness.shape[-1] - SHOWN)  # against tilt
    turn = turn.in_series(*(np.array([radial, radial, axial, *rigid]) for radial, axial in pairs))
    found = in_units(turn, options.units, speed)
    if options.out is not None:
        write(turn, options.out, options.units, speed)
    if options.json:
        print(json.dumps(record(found), indent=1))
        return console.EXIT_OK
    console.show(text(found))
    if turn.repeats == "turn" and turn.no_orders is not None:
        console.show(f"note: no orders: {turn.no_orders}")
    if found.frequencies is not None and speed is not None:
        console.show(_told(found.frequencies, file, speed))
    if file.catalogue is not None:
        console.show(f"note: {catalogue_uncertainty.told(file.catalogue)}")
    if options.out is not None:
        console.show(f"written to {options.out}")
    return console.EXIT_OK


def _told(frequencies: DefectFrequencies, file: SceneFile, speed: float) -> str:
    """Frequencies in one line; of an estimated bearing with what its catalogue leaves of them."""
    hertz = [f"{name.upper()} {float(value):.4g}" for name, value in vars(frequencies).items()]
    if file.catalogue is not None:
        about = file.catalogue.uncertainty(
            lambda bearing, _: np.array(list(vars(defect_frequencies(bearing, speed)).values()), float)
        )
        hertz = [f"{text} ± {by:.2g}" if by > 0.0 else text for text, by in zip(hertz, about, strict=True)]
    return f"frequencies [Hz] at {speed:g} rev/min: {', '.join(hertz)}"


def springs(given: str) -> tuple[float, float]:
    """ "RADIAL,AXIAL" [N/mm] as two numbers. Raises `SceneError`."""
    try:
        radial, axial = (float(part) for part in given.split(","))
    except ValueError:
        radial = axial = -1.0
    if not (0.0 < radial < np.inf and 0.0 < axial < np.inf):
        raise SceneError(f"a stiffness in series = {given}: give RADIAL,AXIAL in N/mm, both above 0")
    return radial, axial


def text(found: Written) -> Table:
    """Mean, least, largest, and the first orders of every axis' own stiffness, at the phases that were asked for."""
    unit, scale = found.unit["stiffness"][0][0], 1.0
    if unit == "N/m":  # seven columns are to stand beside each other
        unit, scale = "kN/m", 1e-3
    table = tables.house_table(f"Stiffness over the cage's angle, tangent dF/du [{unit}]")
    names = ["mean", "least", "largest", *(f"order {n}" for n in found.orders.get("order", [])[1:4])]
    for heading in ("", *names):
        table.add_column(heading, justify="right" if heading else "left")
    for k, axis in enumerate(found.axes[:SHOWN]):
        own = scale * found.arrays["stiffness"][:, k, k]
        sizes = scale * np.abs(found.orders["stiffness"][1:4, k, k]) if found.orders else []
        table.add_row(axis, *(f"{value:,.0f}" for value in (own.mean(), own.min(), own.max(), *sizes)))
    return table


# ------------------------------------------------------------------------------------------------ files


class Written(NamedTuple):
    """A cage's turn in one system of units: `arrays` by name with phases first, `unit` of every array's entries, names
    of the `axes`, `orders` (complex) if something repeats, and `frequencies` at a speed if there is one."""

    axes: tuple[str, ...]
    arrays: dict[str, np.ndarray]
    unit: dict[str, Any]
    orders: dict[str, np.ndarray]
    frequencies: DefectFrequencies | None
    about: dict[str, Any]


def in_units(turn: CageTurn, units: Units = "mm", speed_rpm: float | None = None) -> Written:
    """See `write`."""
    if units not in UNITS:
        raise SceneError(f"units = {units!r}: must be one of {', '.join(UNITS)}")
    axes = solution.AXES[: turn.stiffness.shape[-1]]
    metre = 1.0 if units == "mm" else 1e-3
    tilts = np.array([name.startswith("about") for name in axes])
    length, force = np.where(tilts, 1.0, metre), np.where(tilts, metre, 1.0)  # of a displacement, of a force or moment
    by = force[:, None] / length[None, :]
    arrays = {"cage": np.asarray(turn.cage), "displacement": np.asarray(turn.displacement) * length,
              "stiffness": np.asarray(turn.stiffness) * by}  # fmt: skip
    unit: dict[str, Any] = {
        "cage": "rad",
        "displacement": [_si(solution.length_of(a), units) for a in axes],
        "stiffness": [[_si(solution.stiffness_of(a, b), units) for b in axes] for a in axes],
    }
    for name, slopes in (("by_length", turn.by_length), ("by_width", turn.by_width)):
        if slopes is not None and slopes.shape[-1]:
            arrays[name] = np.asarray(slopes) * by[:, :, None] / metre
            per = _si("mm", units)
            unit[name] = [[f"{one}/{per}" for one in row] for row in unit["stiffness"]]
    frequencies = None
    if speed_rpm is not None:
        _check_speed(speed_rpm)
        frequencies = defect_frequencies(turn.bearing, speed_rpm)
        arrays = {"time": np.asarray(turn.time(speed_rpm)), **arrays}
        unit["time"] = "s"
    orders = {}
    if turn.no_orders is None:
        found = turn.orders(min(16, len(arrays["cage"]) // 2))
        orders = {"order": np.asarray(found.order), "stiffness": np.asarray(found.stiffness) * by,
                  "displacement": np.asarray(found.displacement) * length}  # fmt: skip
    about = {"units": units, "definition": "tangent", "repeats": turn.repeats, "status": turn.status,
             "converged": bool(np.all(np.asarray(turn.converged))), "speed_rpm": speed_rpm}  # fmt: skip
    return Written(axes, arrays, unit, orders, frequencies, about)


def write(turn: CageTurn, path: str | Path, units: Units = "mm", speed_rpm: float | None = None) -> None:
    """Write a cage's turn to a file that ends with .csv, .json, .npz or .fmu (see `fmu`), whole or not at all.

    `units`: "mm" (N/mm, mm, N mm/rad) or "si" (N/m, m, N m/rad). At a speed [rev/min] there are times [s], and the
    defect frequencies [Hz] in JSON and NPZ. Orders are in JSON (real and imaginary part) and NPZ. Raises `SceneError`
    for another ending, OSError if it cannot be written.
    """
    path = Path(path)
    check_ending(path)
    if path.suffix == ".fmu":
        fmu.write(turn, path, speed_rpm or 0.0)
        return
    found = in_units(turn, units, speed_rpm)
    with storage.replacing(path) as scratch:
        if path.suffix == ".npz":
            with open(scratch, "wb") as file:
                np.savez(file, **_flat(found))  # pyright: ignore[reportArgumentType]
        elif path.suffix == ".json":
            scratch.write_text(json.dumps(record(found), indent=1) + "\n", encoding="utf-8")
        else:
            with open(scratch, "w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows(_rows(found))


def _check_speed(speed_rpm: float | None) -> None:
    if speed_rpm is not None and not speed_rpm > 0.0:
        raise SceneError(f"speed = {speed_rpm:g}: must be above 0 rev/min")


def check_ending(path: Path) -> None:
    """Raises `SceneError` for what cannot be written to."""
    if path.suffix not in KINDS:
        wrong = "is a folder" if path.is_dir() else "cannot be written"
        raise SceneError(f"{named(path)}: {wrong}; name a file that ends with {' or '.join(KINDS)}")


def record(found: Written) -> dict[str, Any]:
    """For JSON: complex numbers as real and imaginary part, NaN as null."""
    orders: dict[str, Any] = {}
    for name, values in found.orders.items():
        parts = {"real": tables.plain(np.real(values)), "imaginary": tables.plain(np.imag(values))}
        orders[name] = parts if np.iscomplexobj(values) else tables.plain(values)
    hertz = None if found.frequencies is None else {k: float(v) for k, v in vars(found.frequencies).items()}
    return {
        **found.about, "axes": list(found.axes), "unit": found.unit, **tables.plain(found.arrays), "orders": orders,
        "defect_frequencies": hertz,
    }  # fmt: skip


def _flat(found: Written) -> dict[str, Any]:
    flat = {**found.arrays, **{f"orders_{name}": values for name, values in found.orders.items()}}
    texts = {"axes": found.axes, "unit": json.dumps(found.unit), "about": json.dumps(found.about)}
    flat |= {name: np.array(text) for name, text in texts.items()}
    if found.frequencies is not None:
        flat |= {name: np.asarray(value) for name, value in vars(found.frequencies).items()}
    return flat


def _rows(found: Written) -> Iterator[list[Any]]:
    """A heading with names and units, then a row for every phase."""
    heading, columns = [], []
    for name, values in found.arrays.items():
        least = ROUNDING * np.nanmax(np.abs(values), initial=0.0)
        rest = np.where(np.abs(values) < least, 0.0, values).reshape(len(values), -1)
        for k, place in enumerate(np.ndindex(*values.shape[1:])):
            axes, unit = [found.axes[i] for i in place[:2]], found.unit[name]
            for i in place[:2]:
                unit = unit[i]
            spall = f"_spall_{place[2]}" if len(place) > 2 else ""
            heading.append(f"{'_'.join([name, *axes])}{spall} [{unit}]")
            columns.append(rest[:, k])
    yield heading
    yield from ([repr(float(v)) for v in row] for row in zip(*columns, strict=True))


def _si(unit: str, units: Units) -> str:
    return unit.replace("mm", "m") if units == "si" else unit
