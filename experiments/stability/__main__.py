"""Run what is asked for, keep its numbers, and write the page from all numbers there are."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from difftrb.core import status
from experiments.paper import common
from experiments.stability import cases, mutations, random_contacts, scenes

ROOT = Path(__file__).parent.parent.parent
Told = Callable[[int, int], None]


def hazards(out: Path, told: Told, small: bool) -> dict[str, Any]:
    """Every hazard."""
    found = {"contacts": cases.contacts()}
    told(1, 2)
    found["rings"] = cases.rings()
    told(2, 2)
    return {name: [dataclasses.asdict(f) for f in rows] for name, rows in found.items()}


def over_load_and_length(out: Path, told: Told, small: bool) -> dict[str, Any]:
    """The map."""
    return random_contacts.over_load_and_length(out, told, 8 if small else 1)


def contacts(out: Path, told: Told, small: bool) -> dict[str, Any]:
    """Random contacts."""
    return random_contacts.run(50 if small else 600, 0, told)


def rings(out: Path, told: Told, small: bool) -> dict[str, Any]:
    """Random scenes."""
    return scenes.run(400 if small else 100_000, 0, progress=told)


def files(out: Path, told: Told, small: bool) -> dict[str, Any]:
    """Mutated files."""
    found = mutations.run(300 if small else 10_000, 0, told)
    return found | {"wrong": [answer.sentence for answer, _ in found["wrong"]]}


STEPS: dict[str, Callable[[Path, Told, bool], dict[str, Any]]] = {
    "hazards": hazards, "map": over_load_and_length, "contacts": contacts, "scenes": rings, "files": files,
}  # fmt: skip


def _row(found: dict[str, Any]) -> list[str]:
    good, error = found["status"] == status.CONVERGED, found["error"]
    sides = ", ".join(found["one_sided"])
    checked = "–" if error is None else f"{error:.0e} ({found['where']})"
    return [
        found["name"], status.describe(found["status"]).split(":")[0], f"{found['residual']:.0e}" if good else "–",
        str(found["iterations"]) if good else "–", checked, sides,
    ]  # fmt: skip


HEADS = ("hazard", "what happens", "residual", "iterations", "derivatives off by (worst)", "one-sided by")


def _counts(found: dict[str, Any], what: str) -> str:
    failed = "; ".join(f"{n} {sentence.split(':')[0]}" for sentence, n in found["statuses"].items()) or "none"
    return common.grid(
        [what, "converged", "others, all flagged", "NaN in values", "NaN in derivatives",
         "converged beyond 1e-9", "largest violation", "most iterations"],
        [[found[what], found["converged"], failed, found["nan_values"], found["nan_gradients"], found["unflagged"],
          f"{found['kkt']:.0e}", found["iterations"]]],
    )  # fmt: skip


def page(numbers: dict[str, Any], folder: str) -> str:
    """The page, from whatever has been run."""
    parts = [
        "# Hard cases",
        "What happens where numbers, loads and files are as bad as they can be. Made by `python -m "
        "experiments.stability`; the hazards are one list, `experiments/stability/hazards.py`, which "
        "`tests/scene/test_hazards.py` holds.",
    ]
    if "hazards" in numbers:
        parts += [
            "## One contact",
            f"By cells at accuracy 1e-2; 3 kN, a spall of 4 × 7 × 0.2 mm in 32008J unless the hazard says otherwise. "
            f"Residual: largest violation of the contact conditions by the approach. Derivatives of the approach by "
            f"{', '.join(cases.NUMBERS)} against central differences; where an input has a kink or ends, against the "
            f"side the derivative belongs to. Measured by the derivative or by {cases.FLOOR:g} of approach / input.",
            common.grid(HEADS, [_row(f) for f in numbers["hazards"]["contacts"]]),
            "## A ring",
            "9000/4500 N, a spall of 4 × 7 mm at the load line, law `liu2018`, unless the hazard says otherwise. "
            "Residual: unbalanced force by the load. Derivatives of the sum of radial and axial displacement by "
            f"{', '.join(cases.RING_NUMBERS)}.",
            common.grid(HEADS, [_row(f) for f in numbers["hazards"]["rings"]]),
        ]
    if "map" in numbers:
        found = numbers["map"]
        low, middle, high = found["iterations"]
        parts += [
            "## Over load and length",
            f"![Iterations and violation of the contact conditions over load and length]({folder}/map.png)",
            f"{found['converged']} of {found['contacts']} contacts converge, in {low} to {high} applications of the "
            f"influence matrix (median {middle}); the largest violation is {found['kkt']:.0e} of the approach.",
        ]
    if "contacts" in numbers:
        parts += ["## Random contacts", _counts(numbers["contacts"], "contacts"),
                  "Loads 1e-3 … 1e5 N, spalls of any length from 0 to twice the roller's, 0.01 … 1000 mm wide, 1 nm … "
                  "10 mm deep, on and off the middle; radii, moduli and crowns over three decades and more. The "
                  "violation is computed anew from forces and gap."]  # fmt: skip
    if "scenes" in numbers:
        kinds = "; ".join(
            f"{k.rollers} rollers, {k.spalls} spall{'s' if k.spalls > 1 else ''}, {k.law}, {k.definition}"
            for k in scenes.KINDS
        )
        parts += ["## Random scenes", _counts(numbers["scenes"], "scenes"),
                  f"In batches, with derivatives by every number of the scene. Of each kind as many: {kinds}. Under "
                  "`palmgren` every bearing has a geometry of its own. The violation (balance of forces, pull, load "
                  "across a gap) is computed in numpy from loads and displacements."]  # fmt: skip
    if "files" in numbers:
        found = numbers["files"]
        verdicts = found["verdicts"]
        parts += [
            "## Mutated files",
            f"{sum(verdicts.values())} packaged scenes and tables of measurements with one to three changes: "
            f"{verdicts.get('accepted', 0)} accepted, {verdicts.get('refused', 0)} refused, "
            f"{verdicts.get('traceback', 0)} tracebacks; {len(found['wrong'])} refusals that are no printable line "
            "with the file and a key, a column or a line.",
            common.grid(["change", "accepted", "refused", "tracebacks"],
                        [[name, *(n.get(verdict, 0) for verdict in ("accepted", "refused", "traceback"))]
                         for name, n in sorted(found["by_change"].items())]),
        ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def _plain(value: Any) -> Any:
    """For JSON: NaN is null."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def main(arguments: list[str] | None = None) -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m experiments.stability", description=__doc__)
    parser.add_argument("steps", nargs="*", metavar="STEP", help=f"of {', '.join(STEPS)}; default: all")
    parser.add_argument("--small", action="store_true", help="few of everything, to see that it runs")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "stability", help="folder for figure and numbers")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "stability.md", help="the page to write")
    options = parser.parse_args(arguments)
    unknown = set(options.steps) - set(STEPS)
    if unknown:
        parser.error(f"there is no {', '.join(sorted(unknown))}; there are {', '.join(STEPS)}")
    common.set_up()
    out, page_path = options.out.resolve(), options.page.resolve()
    out.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    columns = TextColumn("{task.description:10}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns) as bars:
        for name in options.steps or STEPS:
            bar = bars.add_task(name, total=None)
            found = STEPS[name](
                out, lambda done, of, bar=bar: bars.update(bar, completed=done, total=of), options.small
            )
            text = json.dumps(_plain(found), indent=1, ensure_ascii=False, allow_nan=False)
            (out / f"{name}.json").write_text(text + "\n", encoding="utf-8")
            bars.stop_task(bar)
    kept = {name: out / f"{name}.json" for name in STEPS}
    numbers = {name: json.loads(path.read_text(encoding="utf-8")) for name, path in kept.items() if path.exists()}
    folder = out.relative_to(page_path.parent) if out.is_relative_to(page_path.parent) else out
    page_path.write_text(page(numbers, folder.as_posix()), encoding="utf-8")
    print(f"{page_path}: {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
