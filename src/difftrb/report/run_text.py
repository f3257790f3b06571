"""Results for people (text) and for machines (JSON)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from difftrb.contact import gap
from difftrb.contact.contact_solution import ContactSolution
from difftrb.core import status
from difftrb.core.geometry import Real
from difftrb.law import base as laws
from difftrb.law.base import LAWS, Law
from difftrb.report import remarks
from difftrb.report.catalogue_uncertainty import Estimated
from difftrb.ring import effect_base
from difftrb.ring.effects import Raceways
from difftrb.scene.audit import Audit
from difftrb.scene.edge_stress import EdgeStress
from difftrb.scene.scene import Picked, PitchMean, Scene, raceway_contact
from difftrb.scene.solution import AXES, Assessment, Solution

BAR = 28
CONTACT_INPUTS = ("load", "length", "width", "offset", "radius", "design_load")


def run_json(
    scene: Scene, result: Assessment, seconds: float, edges: Sequence[EdgeStress] = (), audit: Audit | None = None,
    mean: Assessment | None = None, estimated: Estimated | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The main job's result with the keys of the command line's `--json`; numbers that do not exist are None.

    `sensitivity` is by the first spall's size; None for a healthy scene. With effects there is a key `effects`, with
    `edges` a key `edge_stress`, with the law "auto" a key `picked`, with an `audit` a key of that name. With the `mean`
    over the cage's turn there is a key `mean`: stiffness, healthy, loss and sensitivity. With a bearing that was
    `estimated` from its catalogue there is a key of that name: values and expanded uncertainties. `remarks` are what
    has to be known before the numbers.
    """
    spalled, sound = result.spalled, result.healthy
    verdict = status.describe(status.worst(spalled.status_code, sound.status_code))
    stiffness = _stiffness_record(scene, result)
    place = {"definition": scene.definition, "phase": "mean" if isinstance(scene.phase, PitchMean) else scene.phase}
    return plain({
        "status": verdict,
        "converged": bool(spalled.converged & sound.converged),
        "angles": spalled.angles,
        "loads": spalled.loads,
        "displacement": dict(zip(AXES, spalled.displacement, strict=False)),
        **stiffness,
        "stiffness": {**place, **stiffness["stiffness"], "matrix": spalled.stiffness},
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


def _stiffness_record(scene: Scene, result: Assessment) -> dict[str, dict[str, Any]]:
    """Stiffness with and without spalls, what they take of it [%], and its slopes by the first one's size."""
    slopes = np.stack([result.by_length, result.by_width], axis=-1)  # (radial | axial, spall, length | width)

    def slope(row: int) -> dict[str, Any]:
        return {size: slopes[row, 0, i] if scene.spalls else None for i, size in enumerate(("length", "width"))}

    return {
        "stiffness": {"radial": result.spalled.radial_stiffness, "axial": result.spalled.axial_stiffness},
        "healthy": {"radial": result.healthy.radial_stiffness, "axial": result.healthy.axial_stiffness},
        "loss": dict(zip(("radial", "axial"), result.loss, strict=True)),
        "sensitivity": {"radial": slope(0), "axial": slope(1)},
    }


def contact_json(solution: ContactSolution, slopes: dict[str, Any], seconds: float) -> dict[str, Any]:
    """A single contact's result; `slopes` are derivatives of the approach [mm per unit of the input], by the sizes of
    several spalls one each."""
    return plain({
        "status": solution.status,
        "converged": bool(solution.converged),
        "approach": solution.approach,
        "peak_pressure": solution.peak_pressure,
        "contact_width": solution.contact_width,
        "loaded_fraction": solution.loaded_fraction,
        "residual": solution.residual,
        "iterations": solution.iterations,
        "unknowns": solution.unknowns,
        "sensitivity": slopes,
        "accuracy": solution.accuracy,
        "seconds": seconds,
    })  # fmt: skip


def plain(value: Any) -> Any:
    """`value` with arrays as lists and NaN as None, ready for strict JSON."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, jax.Array | np.ndarray | np.integer):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def run_text(
    scene: Scene, result: Assessment, edges: Sequence[EdgeStress] = (), audit: Audit | None = None,
    mean: Assessment | None = None, estimated: Estimated | None = None,
) -> RenderableType:  # fmt: skip
    """The main job's result for people: remarks, stiffness and its losses, sensitivities, the same in the `mean` over
    the cage's turn, a bar of load for every roller, a sentence for every one of `edges`, and the `audit`'s."""
    spalled = result.spalled
    lines = [*_ring_lines(scene, spalled), *(edge.sentence for edge in edges), law_text(spalled.law)]
    if spalled.picked is not None:
        lines.append(picked_text(spalled.picked))
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
    tables = [_stiffness_table(scene, result, "" if mean is None else " at this phase")]
    if mean is not None:
        tables.append(_stiffness_table(scene, mean, " in the mean over the cage's turn"))
    of_what = raceways_text(scene, spalled)
    told = () if of_what is None else (Text(f"{of_what}\n"),)
    return Group(*first, *tables, *told, _load_table(scene, result), *map(Text, lines))


def _stiffness_table(scene: Scene, result: Assessment, where: str) -> Table:
    """Stiffness in either direction, its loss, and its slopes by the first spall's size; none where it is 0 because no
    roller stands on a rolling edge."""
    kind = {"tangent": "tangent dF/du", "secant": "secant F/u"}[scene.definition]
    columns = ["spalled", "loss [%]", "by length [/mm]", "by width [/mm]"] if scene.spalls else []
    table = house_table(f"Stiffness{where}, {kind} [N/mm]", "", "healthy", *columns)
    for row, name in enumerate(("radial", "axial")):
        if not scene.spalls:
            table.add_row(name, number(getattr(result.healthy, f"{name}_stiffness"), ",.0f"))
            continue
        values = [getattr(s, f"{name}_stiffness") for s in (result.healthy, result.spalled)]
        by_size = [v[row, 0] for v in (result.by_length, result.by_width)]
        slopes = [number(v if v else np.nan, ",.1f") for v in map(float, by_size)]
        table.add_row(name, *(number(v, ",.0f") for v in values), number(result.loss[row], ".3f"), *slopes)
    return table


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


def raceways_text(scene: Scene, solution: Solution) -> str | None:
    """What the stiffness is of, and about what is left of it and of its loss where the inner raceway gives way, too.
    None where both do."""
    if not bool(solution.converged) or effect_base.among(scene.effects, Raceways):
        return None
    share = outer_share(scene, float(np.max(solution.loads)))
    return (
        "stiffness is that of the contacts with the outer raceway alone, as in the paper; both raceways in series make "
        f"about {share:.2f} of it{', and of its loss in per cent' if scene.spalls else ''}: effects.raceways"
    )


def outer_share(scene: Scene, load: float) -> float:
    """About which share of a roller's approach is the outer raceway's, under a load [N]: by the compliances of two long
    cylinders (Johnson 1985, section 5.6)."""
    compliance = []
    for raceway in ("outer", "inner"):
        contact = raceway_contact(scene, raceway)
        half_width = float(gap.half_width(contact, load))
        compliance.append(math.log(2.0 * float(contact.length) / half_width))
    return compliance[0] / sum(compliance)


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


def number(value: Any, style: str) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    text = format(float(value), style)
    return text if text.strip("-+0.,") else format(0.0, style)  # no −0.000


def law_text(law: Law) -> str:
    """One sentence on the roller law: what it is, its range and error."""
    kind = LAWS.get(law.name)  # None: a law of the user's own
    text = f"law: {law.name}" if kind is None else f"law: {law.name}, {kind.summary}"
    low, high = (float(v) for v in law.load_range)
    if math.isfinite(high):
        text += f"; made for {low:.0f} … {high:.0f} N on the most loaded roller"
    error = float(law.error)
    if not math.isfinite(error):
        return f"{text}; error not known"
    off = f"{100.0 * error:.2g} %"
    return text + (
        f"; nine in ten loads are off by less than {off}" if law.name == "table" else f"; loads off by up to {off}"
    )


def picked_text(picked: Picked) -> str:
    """One sentence on what the law "auto" became."""
    way, kept = _way(picked.law, picked.accuracy), picked.error <= picked.asked
    asked = f"stiffness and peak load within {picked.asked:g}"
    off = f"{'nine in ten are' if picked.law == 'table' else 'they are'} off by up to {number(picked.error, '.1e')}"
    text = f"picked: {way}, for {asked}; {off}"
    if not kept:
        text = f"picked: {way}; {off}, more than asked: no law is known to keep {asked} here"
    if picked.finer is None:
        return text
    finer = picked.finer
    return text + f"; finer: {_way(finer.law, finer.accuracy)}, in {finer.seconds:.2g} s or more"


def _way(law: str, accuracy: Real) -> str:
    """A law and, where it solves contacts, how exactly."""
    return f"{law} {accuracy:g}" if laws.LAWS[law].solves else law


def contact_text(solution: ContactSolution, slopes: dict[str, Any]) -> RenderableType:
    """A single contact's result for people."""
    table = house_table("Contact")
    table.show_header = False
    table.add_row("load", f"{solution.load:,.1f} N (contact.load, of one roller; not load.radial)")
    table.add_row("approach", f"{1e3 * solution.approach:.4f} µm")
    table.add_row("peak pressure", f"{solution.peak_pressure:,.0f} MPa (a cell's mean; singular at a sharp edge)")
    table.add_row("contact width", f"{solution.contact_width:.4f} mm")
    table.add_row("loaded length", f"{100.0 * solution.loaded_fraction:.1f} % of the roller")
    units = {"load": "N"} | dict.fromkeys(CONTACT_INPUTS[1:5], "mm") | {"design_load": "N"}
    derivatives = house_table("Derivative of the approach")
    derivatives.add_column("by")
    derivatives.add_column("", justify="right")
    for name, value in slopes.items():
        each = "–" if value is None else ", ".join(number(1e3 * v, "+.5g") for v in np.atleast_1d(np.asarray(value)))
        derivatives.add_row(name, each if each == "–" else f"{each} µm/{units[name]}")
    rows, columns = solution.force.shape
    last = (
        f"{solution.status}; {rows} × {columns} cells, settled to {solution.residual:.1e} of the approach after "
        f"{solution.iterations} steps; accuracy asked for {solution.accuracy:g}"
    )
    return Group(table, derivatives, Text(last))


def house_table(title: str, *headings: str, words: tuple[str, ...] = ("", "unit")) -> Table:
    """An empty table of the house; under `headings` of `words` these stand left, numbers right."""
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False,
                  min_width=min(len(title), 60))  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="left" if heading in words else "right")
    return table
