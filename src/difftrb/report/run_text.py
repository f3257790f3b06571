"""The result of a run for people (text) and for machines (JSON)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from importlib import metadata
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from difftrb.contact.height_map import HeightMap
from difftrb.core import packaged_bearings, status
from difftrb.report import law_text, remarks
from difftrb.report.catalogue_uncertainty import Estimated
from difftrb.report.tables import house_table, number, plain
from difftrb.ring import effect_base
from difftrb.scene.audit import Audit
from difftrb.scene.edge_stress import EdgeStress
from difftrb.scene.scene import PitchMean, Scene
from difftrb.scene.solution import AXES, Assessment, Solution

BAR = 28
DIRECTIONS = {"radial": 0, "axial": 2}
"""With their places among the axes of stiffness."""


def run_json(
    scene: Scene, result: Assessment, seconds: float, edges: Sequence[EdgeStress] = (), audit: Audit | None = None,
    mean: Assessment | None = None, estimated: Estimated | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The main job's result with the keys of the command line's `--json`; numbers that do not exist are None.

    `scene` is what was solved: bearing, load and spalls [N, mm, rad], by which `law`, in which release of `difftrb`.
    `sensitivity` is by the spall's size, of several spalls a list of one number each; None for a healthy scene.
    With effects there is a key `effects`, with `edges` a key `edge_stress`, with the law "auto" a key `picked`,
    with an `audit` a key of that name. With the `mean` over the cage's turn there is a key `mean`: stiffness,
    healthy, loss and sensitivity. With a bearing that was `estimated` from its catalogue there is a key of that
    name: values and expanded uncertainties. `remarks` are what has to be known before the numbers.
    """
    spalled, healthy = result.spalled, result.healthy
    verdict = status.describe(status.worst(spalled.status_code, healthy.status_code))
    stiffness = _stiffness_record(scene, result)
    place = {"definition": scene.definition, "phase": "mean" if isinstance(scene.phase, PitchMean) else scene.phase}
    return plain({
        "scene": _scene_record(scene, spalled),
        "status": verdict,
        "converged": bool(spalled.converged & healthy.converged),
        "angles": spalled.angles,
        "loads": spalled.loads,
        "displacement": dict(zip(AXES, spalled.displacement, strict=False)),
        **stiffness,
        "stiffness": {**place, **stiffness["stiffness"], "matrix": spalled.stiffness,
                      "axes": AXES[: len(spalled.displacement)]},
        **({} if mean is None else {"mean": _stiffness_record(scene, mean)}),
        "residual": spalled.residual,
        "iterations": spalled.iterations,
        **({"effects": spalled.effects} if scene.effects else {}),
        **({"edge_stress": [edge._asdict() for edge in edges]} if edges else {}),
        **({"picked": dataclasses.asdict(spalled.picked)} if spalled.picked is not None else {}),
        **({"audit": audit.record()} if audit is not None else {}),
        **({"estimated": estimated.record()} if estimated is not None else {}),
        **({"remarks": said} if (said := remarks.of_result(scene, result)) else {}),
        "seconds": seconds,
    })  # fmt: skip


def _scene_record(scene: Scene, solution: Solution) -> dict[str, Any]:
    """What was solved: for a record to be told from others."""
    of = "surface", "row", "length", "width", "depth", "angle", "axial_offset"  # of a height map all but the depth
    return {
        "difftrb": metadata.version("difftrb"),
        "bearing": packaged_bearings.name_of(scene.bearing) or dataclasses.asdict(scene.bearing),
        "load": dataclasses.asdict(scene.load),
        "spalls": [{name: getattr(spall, name, None) for name in of} for spall in scene.spalls],
        "law": solution.law.name,
    }


def _stiffness_record(scene: Scene, result: Assessment) -> dict[str, dict[str, Any]]:
    """Stiffness with and without spalls, what they take of it [%], and its slopes by their sizes."""

    slopes = _slopes(scene, result)

    def slope(row: int) -> dict[str, Any]:
        if not scene.spalls:
            return dict.fromkeys(("length", "width"))
        by_size = {"length": slopes[:, row, 0], "width": slopes[:, row, 1]}
        return {size: by[0] if len(scene.spalls) == 1 else by for size, by in by_size.items()}

    return {
        "stiffness": {"radial": result.spalled.radial_stiffness, "axial": result.spalled.axial_stiffness},
        "healthy": {"radial": result.healthy.radial_stiffness, "axial": result.healthy.axial_stiffness},
        "loss": dict(zip(("radial", "axial"), result.loss, strict=True)),
        "sensitivity": {"radial": slope(0), "axial": slope(1)},
    }


def run_text(
    scene: Scene, result: Assessment, edges: Sequence[EdgeStress] = (), audit: Audit | None = None,
    mean: Assessment | None = None, estimated: Estimated | None = None,
) -> RenderableType:  # fmt: skip
    """The main job's result for people: remarks, stiffness and its losses, sensitivities, the same in the `mean` over
    the cage's turn, a bar of load for every roller, a sentence for every one of `edges`, and the `audit`'s."""
    spalled = result.spalled
    lines = [*_ring_lines(scene, spalled), *(edge.sentence for edge in edges), law_text.law_text(scene)]
    if spalled.picked is not None:
        lines.append(law_text.picked_text(spalled.picked))
    if scene.spalls and not isinstance(scene.phase, PitchMean) and not np.any(result.by_width):
        lines.append(
            "width: no roller stands on a rolling edge at this phase, so stiffness does not change with it; in the "
            f"mean over the cage's turn it does{': --mean' if mean is None else ''}"
        )
    lines.append(
        f"{spalled.status}; unbalanced force {spalled.residual:.1e} of the load after {spalled.iterations} steps"
    )
    if audit is not None:
        lines.append(audit.sentence)
    if estimated is not None:
        lines.append(estimated.sentence)
    first = (Text(f"note: {sentence}") for sentence in remarks.of_result(scene, result))
    tables = _stiffness_tables(scene, result, "" if mean is None else " at this phase")
    if mean is not None:
        tables += _stiffness_tables(scene, mean, " in the mean over the cage's turn")
    of_what = law_text.raceways_text(scene, spalled)
    told = () if of_what is None else (Text(f"{of_what}\n"),)
    return Group(*first, *tables, *told, _load_table(scene, result), *map(Text, lines))


def _stiffness_tables(scene: Scene, result: Assessment, where: str) -> list[Table]:
    """Stiffness in either direction, its loss, and its slopes by the spall's size; of several spalls in a table of
    their own."""
    kind = {"tangent": "tangent dF/du", "secant": "secant F/u"}[scene.definition]
    losses, sizes = ["spalled", "loss [%]"] if scene.spalls else [], ["by length [/mm]", "by width [/mm]"]
    heads = ["healthy", *losses, *(sizes if len(scene.spalls) == 1 else ())]
    table = house_table(f"Stiffness{where}, {kind} [N/mm]", "", *heads)
    for name, cells in stiffness_cells(scene, result).items():
        table.add_row(name, *cells)
    if len(scene.spalls) < 2:
        return [table]
    heads = [f"{name} {size}" for name in DIRECTIONS for size in sizes]
    slopes = house_table(f"Stiffness{where} by the size of each spall [N/mm]", "spall", *heads)
    for number_of, rows in enumerate(slopes_by_spall(scene, result)):
        slopes.add_row(str(number_of), *(cell for row in rows for cell in row))
    return [table, slopes]


def stiffness_cells(scene: Scene, result: Assessment) -> dict[str, list[str]]:
    """By direction: healthy stiffness [N/mm]; with spalls also theirs and the loss [%]; of one spall the slopes by its
    size [N/mm per mm], too."""
    found = {}
    for row, name in enumerate(DIRECTIONS):
        healthy, spalled = (getattr(s, f"{name}_stiffness") for s in (result.healthy, result.spalled))
        found[name] = [number(healthy, ",.0f")]
        if scene.spalls:
            found[name] += [number(spalled, ",.0f"), number(result.loss[row], ".3f")]
        if len(scene.spalls) == 1:
            found[name] += slopes_by_spall(scene, result)[0][row]
    return found


def slopes_by_spall(scene: Scene, result: Assessment) -> list[list[list[str]]]:
    """For every spall, of radial and axial stiffness, its slopes by length and by width [N/mm per mm]; none where it is
    0 because no roller stands on a rolling edge, or not known."""
    return [[[number(v if v else np.nan, ",.1f") for v in row] for row in own] for own in _slopes(scene, result)]


def _slopes(scene: Scene, result: Assessment) -> np.ndarray:
    """The same in numbers, shape (spalls, radial | axial, length | width). NaN of height maps: those of a sampled
    surface with walls may be wrong by factors."""
    by_size = np.moveaxis(np.stack([result.by_length, result.by_width], axis=-1), 1, 0)
    mapped = np.array([isinstance(spall, HeightMap) for spall in scene.spalls], bool)
    return np.where(mapped[:, None, None], np.nan, by_size)


def roller_columns(scene: Scene, result: Assessment) -> dict[str, list[str]]:
    """Of every roller by heading: its place and load, by how much it differs from the healthy one's, and what effects
    say of it."""
    spalled, units = result.spalled, effect_base.units(scene.effects)
    columns = {
        "roller": [str(j) for j in range(len(spalled.loads))],
        "angle [rad]": [f"{angle:.4f}" for angle in spalled.angles],
        "load [N]": [number(load, ",.1f") for load in spalled.loads],
    }
    if scene.spalls:
        columns["against healthy"] = [number(change, "+,.1f") for change in spalled.loads - result.healthy.loads]
    for name, values in spalled.effects.items():
        if values.shape == spalled.loads.shape:
            unit = units.get(name, "")
            shown = ",.1f" if unit == "N" else ",.3f"
            columns[f"{_column(name)} [{unit}]"] = [number(value, shown) for value in values]
    return columns


def _load_table(scene: Scene, result: Assessment) -> Table:
    """Every roller's load; where effects say nothing of it, a bar beside it."""
    columns = roller_columns(scene, result)
    table = house_table("Load distribution", *columns)
    bars: list[Text] = []
    if set(columns) <= {"roller", "angle [rad]", "load [N]", "against healthy"}:
        table.add_column("", no_wrap=True)
        loads = np.asarray(result.spalled.loads)
        bars = [Text("█" * round(BAR * share), style="cyan") for share in loads / max(float(loads.max()), 1e-9)]
    for j, row in enumerate(zip(*columns.values(), strict=True)):
        table.add_row(*row, *bars[j : j + 1])
    return table


def _ring_lines(scene: Scene, solution: Solution) -> list[str]:
    """Of the ring as a whole: the range over phases, displacement, and what effects add."""
    u = np.round(1e3 * np.asarray(solution.displacement), 4) + 0.0  # no −0
    lines = []
    if isinstance(scene.phase, PitchMean):
        low, high = solution.stiffness_span
        lines.append(
            f"means over one roller pitch; stiffness radial {low[0, 0]:,.0f} … {high[0, 0]:,.0f}, axial "
            f"{low[2, 2]:,.0f} … {high[2, 2]:,.0f} N/mm"
        )
    lines.append(f"displacement: radial {u[0]:.3f} µm, lateral {u[1]:.3f} µm, axial {u[2]:.3f} µm")
    if u.size > 3:
        lines.append(f"tilt: about the radial axis {u[3]:.4f} mrad, about the lateral axis {u[4]:.4f} mrad")
        about = [f"{np.asarray(solution.stiffness)[k, k]:.4g} N mm/rad about the {axis} axis"
                 for k, axis in ((3, "radial"), (4, "lateral"))]  # fmt: skip
        lines.append(f"stiffness against tilt: {', '.join(about)}")
    if scene.effects:
        lines.append(f"beyond the plain ring: {'; '.join(each.label for each in scene.effects)}")
    units = effect_base.units(scene.effects)
    for name, value in solution.effects.items():
        if not value.ndim:
            lines.append(f"{name.replace('_', ' ')}: {value:,.5g} {units.get(name, '')}".rstrip())
    return lines


def _column(name: str) -> str:
    """What heads a column of an effect's result for every roller."""
    words = name.removesuffix("_loads").replace("_", " ")
    return f"on {words}" if name.endswith("_loads") else words
