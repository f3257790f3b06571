"""The page of a run: one HTML file with everything in it, drawings, numbers, errors and where they come from.

It needs no network, no script and no other file; figures are drawn into it as SVG.
"""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import json
import math
import platform
import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import difftrb
from difftrb.core import packaged_bearings
from difftrb.report import figure_style, law_text, run_text
from difftrb.report.catalogue_uncertainty import Estimated
from difftrb.report.tables import number
from difftrb.ring import effect_base, effects
from difftrb.scene.audit import Audit
from difftrb.scene.edge_stress import EdgeStress
from difftrb.scene.scene import PitchMean, Scene
from difftrb.scene.solution import Assessment

NEVER = ("lubricant film and friction", "forces of the cage", "bending of rings, shaft and housing",
         "inertia of shaft and rotor: the ring is at rest at every phase")  # fmt: skip
"""What no scene can ask for."""
SOURCE = "Liu, Zhu, Yan, Wang and Hong (2018), Tribology International 122, 169–178, doi 10.1016/j.triboint.2018.02.028"
CAPTIONS = {
    "bearing": (
        "The bearing, to scale",
        "Section through the spall, view along the axis at the rollers' middles, and the outer raceway unrolled. "
        "Angles start at the load line, which points down.",
    ),
    "load_distribution": (
        "Load distribution",
        "Load of every roller on the outer raceway, healthy and with the spall.",
    ),
    "pressure": (
        "Pressure at the spall",
        "Contacts of the rollers at the spall. At a sharp edge pressure has no limit; the colours end where a "
        "hundredth of the contact is beyond.",
    ),
    "stiffness": (
        "Stiffness over the cage's turn",
        "Every phase is a ring at rest. Where no roller is in the spall the bearing is as stiff as without it.",
    ),
    "loss": (
        "Loss over the spall's length and width",
        "In the mean over the cage's turn. White arrows point where the loss rises, in units of the axes' ranges; the "
        "coloured one is the exact gradient at this spall.",
    ),
}
STYLE = """
:root { color-scheme: light; --ink: #1d2733; --soft: #5b6875; --line: #d8dee4; --blue: #4477AA; --red: #C8434F; }
* { box-sizing: border-box; }
body { margin: 0; font: 16px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
body { color: var(--ink); background: #fff; }
main, header { max-width: 1080px; margin: 0 auto; padding: 0 1.25rem; }
header { padding-top: 1.5rem; }
h1 { font-size: 1.7rem; margin: 0 0 .25rem; } h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; }
p, figcaption, li { max-width: 75ch; } .soft, figcaption { color: var(--soft); font-size: .93rem; }
nav a { margin-right: 1rem; color: var(--blue); }
a:focus-visible, summary:focus-visible { outline: 3px solid var(--blue); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(210px, 1fr)); gap: .8rem; margin: 1.2rem 0; }
.card { border: 1px solid var(--line); border-radius: 8px; padding: .7rem .9rem; }
.card b { display: block; font-size: 1.55rem; font-weight: 600; } .card span { color: var(--soft); font-size: .9rem; }
.note { border-left: 4px solid var(--red); padding: .3rem .8rem; background: #fdf3f4; }
figure { margin: 0 0 1rem; } figure svg { width: 100%; height: auto; max-width: 100%; }
figure.narrow svg { max-width: 460px; } figure.middle svg { max-width: 800px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; } .wide { overflow-x: auto; }
th, td { padding: .25rem .8rem; text-align: right; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; } caption { text-align: left; font-weight: 600; padding: .4rem 0; }
pre { background: #f5f7f9; border: 1px solid var(--line); padding: .8rem; overflow-x: auto; font-size: .87rem; }
.two { display: grid; grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); gap: 0 2rem; }
summary { cursor: pointer; font-weight: 600; padding: .3rem 0; }
@media print { nav { display: none; } figure { break-inside: avoid; } }
"""


class Run(NamedTuple):
    """What a run has found, and of what: `path` and `text` are the scene file's, `record` is the JSON; the rest as in
    `run_text.run_json`."""

    path: str
    text: str
    scene: Scene
    record: Mapping[str, Any]
    result: Assessment
    mean: Assessment | None = None
    edges: Sequence[EdgeStress] = ()
    audit: Audit | None = None
    estimated: Estimated | None = None


def page(run: Run, figures: Mapping[str, str], missing: Sequence[str] = ()) -> str:
    """The page: `figures` are SVG texts by name, `missing` says in sentences which are not there and why."""
    scene, spalled = run.scene, run.result.spalled
    title = f"{_bearing(run)}: {_spalls(scene)}"
    about = f"{Path(run.path).name}: {_where(scene)}. {spalled.status}; difftrb {difftrb.__version__}."
    notes = run.record.get("remarks", [])
    parts = [
        f"<header><h1>{escape(title)}</h1>",
        f'<p class="soft">{escape(about)}</p>',
        _contents(figures, scene),
        "</header><main>",
        *(f'<p class="note">{escape(note)}</p>' for note in notes),
        _cards(run),
        _drawn("bearing", figures, "", scene),
        f'<section id="numbers"><h2>Stiffness</h2>{_stiffness_table(run)}</section>',
        _drawn("load_distribution", figures, "narrow", scene),
        _drawn("pressure", figures, "middle", scene),
        _drawn("stiffness", figures, "", scene),
        _drawn("loss", figures, "", scene),
        *(f'<p class="soft">{_with_code(sentence)}</p>' for sentence in missing),
        _acting(scene),
        _errors(run),
        _loads(run),
        _provenance(run),
        "</main>",
    ]
    record = json.dumps(run.record).replace("</", "<\\/")
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n<link rel="icon" href="data:,">\n'
        f"<style>{STYLE}</style>\n</head>\n<body>\n" + "\n".join(parts) + "\n"
        f'<script type="application/json" id="result">{record}</script>\n</body>\n</html>\n'
    )


# ------------------------------------------------------------------------------------------------ words


def _bearing(run: Run) -> str:
    """By its name, its boundary dimensions, or its rollers: what a scene knows."""
    of = run.scene.bearing
    if run.estimated is not None:
        line = run.estimated.catalogue.catalogue
        return f"Bearing {line.d:g} × {line.D:g} × {line.T:g} mm"
    name = packaged_bearings.name_of(of)
    return f"Bearing {name}" if name else f"Bearing of {of.rollers} rollers {float(of.roller_length):.3g} mm long"


def _spalls(scene: Scene) -> str:
    if not scene.spalls:
        return "a healthy bearing"
    sizes = [f"{spall.length:g} × {spall.width:g} mm on {law_text.PLACES[spall.surface]}" for spall in scene.spalls]
    return f"spall{'s' if len(sizes) > 1 else ''} {', '.join(sizes)}"


def _where(scene: Scene) -> str:
    phase = f"{'in the ' if isinstance(scene.phase, PitchMean) else ''}{figure_style.phase_of(scene)}"
    return f"{figure_style.loads_of(scene)}; {phase}; {scene.definition} stiffness"


def _with_code(sentence: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(sentence))


# ------------------------------------------------------------------------------------------------ parts


def _heading(name: str, scene: Scene) -> str:
    return "Pressure under the rollers" if name == "pressure" and not scene.spalls else CAPTIONS[name][0]


def _contents(figures: Mapping[str, str], scene: Scene) -> str:
    found = {name: _heading(name, scene) for name in CAPTIONS if name in figures}
    first = {"bearing": found.pop("bearing")} if "bearing" in found else {}
    more = {"acting": "What acts", "errors": "How exact", "provenance": "Where it comes from"}
    parts = {**first, "numbers": "Stiffness", **found, **more}
    links = "".join(f'<a href="#{name}">{escape(words)}</a>' for name, words in parts.items())
    return f'<nav aria-label="Contents">{links}</nav>'


def _cards(run: Run) -> str:
    scene, record = run.scene, run.record
    shown: list[tuple[str, Any]] = [("in the mean over the cage's turn", record["mean"])] if "mean" in record else []
    at = "in the mean over the cage's turn" if isinstance(scene.phase, PitchMean) else "at this phase"
    cards = []
    for where, values in [*shown, (at, record)]:
        for name in ("radial", "axial"):
            stiffness = number(values["stiffness"][name], ",.0f")
            big = f"{number(values['loss'][name], '.2f')} %" if scene.spalls else f"{stiffness} N/mm"
            small = (
                f"of {name} stiffness lost {where}: {stiffness} N/mm" if scene.spalls else f"{name} stiffness {where}"
            )
            cards.append(f'<div class="card"><b>{big}</b><span>{escape(small)}</span></div>')
    of_what = law_text.raceways_text(scene, run.result.spalled)
    told = [] if of_what is None else [of_what]
    if run.estimated is not None:
        told.append(run.estimated.sentence)
    notes = "".join(f'<p class="soft">{escape(each)}</p>' for each in told)
    return f'<div class="cards">{"".join(cards)}</div>{notes}'


def _stiffness_table(run: Run) -> str:
    at, one = "mean" if isinstance(run.scene.phase, PitchMean) else "this phase", len(run.scene.spalls) == 1
    rows: list[list[str]] = []
    slopes: list[list[str]] = []
    for where, result in ((at, run.result), ("mean over the cage's turn", run.mean)):
        if result is None:
            continue
        every = run_text.slopes_by_spall(run.scene, result)
        for row, (name, cells) in enumerate(run_text.stiffness_cells(run.scene, result).items()):
            rows.append([f"{name}, {where}", *cells])
            slopes += [[f"{name}, {where}", str(k), *own[row]] for k, own in enumerate(every)]
    by = "by length [N/mm per mm]", "by width [N/mm per mm]"
    losses = ("with spall [N/mm]", "loss [%]") if run.scene.spalls else ()
    heads = ("", "healthy [N/mm]", *losses, *(by if one else ()))
    kind = f"{run.scene.definition.capitalize()} stiffness"
    found = table(heads, rows, f"{kind} and its derivatives by the spall's size" if one else kind)
    if len(run.scene.spalls) < 2:
        return found
    return found + table(("", "spall", *by), slopes, f"{kind}: its derivatives by the size of each spall")


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> str:
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><caption>{escape(caption)}</caption><tr>{head}</tr>{body}</table></div>'


def _drawn(name: str, figures: Mapping[str, str], kind: str, scene: Scene) -> str:
    if name not in figures:
        return ""
    heading, words = _heading(name, scene), CAPTIONS[name][1]
    drawing = _inlined(figures[name], name, heading)
    return (
        f'<section id="{name}"><h2>{escape(heading)}</h2><figure class="{kind}">{drawing}'
        f"<figcaption>{escape(words)}</figcaption></figure></section>"
    )


def _inlined(svg: str, name: str, heading: str) -> str:
    """An SVG file's text to stand in a page: without its head, its ids told apart from other figures'."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'(\bid="|xlink:href="#|href="#(?<!xlink:href="#)|url\(#)', rf"\g<1>{name}-", body)
    return body.replace("<svg", f'<svg role="img" aria-label="{escape(heading)}"', 1)


def _acting(scene: Scene) -> str:
    both = effect_base.among(scene.effects, effects.Raceways) is not None
    raceways = "both raceways" if both else "the outer raceway"
    acting = [f"contact of the rollers with {raceways}; {law_text.law_text(scene)}"]
    for spall in scene.spalls:
        at = f"{spall.angle:g} rad ({math.degrees(spall.angle):.4g}°)"
        acting.append(
            f"a spall on {law_text.PLACES[spall.surface]}: {spall.length:g} mm along the roller, "
            f"{spall.width:g} mm across it, {spall.depth:g} mm deep, at {at}, {spall.axial_offset:g} mm off the middle"
        )
    for effect in scene.effects:
        kind = next(kind for kind in effects.registered() if isinstance(effect, kind))
        fields = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
        values = [f"{name} = {_plain(getattr(effect, name))}" for name in fields if getattr(effect, name) is not None]
        acting.append(f"{effect.label}{': ' if values else ''}{', '.join(values)}")
    absent = [kind for kind in effects.registered() if not any(isinstance(effect, kind) for effect in scene.effects)]
    idle = [f"{kind.label} (effects.{kind.key})" for kind in absent]
    lists = [f"<div><h3>{head}</h3>{_list(every)}</div>"
             for head, every in (("Acts", acting), ("Does not act, for the scene does not name it", idle),
                                 ("Is not in the model", NEVER))]  # fmt: skip
    return f'<section id="acting"><h2>What acts and what does not</h2><div class="two">{"".join(lists)}</div></section>'


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def _errors(run: Run) -> str:
    spalled = run.result.spalled
    lines = [] if run.estimated is None else [run.estimated.sentence]
    lines.append(law_text.law_text(run.scene))
    if spalled.picked is not None:
        lines.append(law_text.picked_text(spalled.picked))
    lines.append(
        f"unbalanced force {float(spalled.residual):.1e} of the load after {int(spalled.iterations)} steps of Newton's "
        "method"
    )
    lines += [edge.sentence for edge in run.edges]
    lines.append(
        run.audit.sentence if run.audit is not None else
        "not audited: with --verify the rollers' contacts are solved afresh, and the page says how far loads and "
        "stiffness are off"
    )  # fmt: skip
    return f'<section id="errors"><h2>How exact it is</h2>{_list(lines)}</section>'


def _list(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def _loads(run: Run) -> str:
    columns = run_text.roller_columns(run.scene, run.result)
    made = table(tuple(columns), list(zip(*columns.values(), strict=True)), "Loads on the outer raceway")
    return f"<details><summary>Loads of all rollers</summary>{made}</details>"


def _provenance(run: Run) -> str:
    digest = hashlib.sha256(run.text.encode()).hexdigest()
    versions = {name: metadata.version(name) for name in ("difftrb", "jax", "numpy", "scipy")}
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    lines = [
        f"Made {now} by difftrb run, solved in {run.record['seconds']:.2g} s, on "
        f"{platform.system()} {platform.machine()}, "
        f"Python {platform.python_version()}, {', '.join(f'{name} {version}' for name, version in versions.items())}.",
        f"Model and default bearing: {SOURCE}.",
        f"Scene file {Path(run.path).name}, SHA-256 {digest[:16]}…; all numbers of the result are in this page as JSON "
        "(the element with id “result”) and in result.json.",
    ]
    paragraphs = "".join(f"<p>{escape(line)}</p>" for line in lines)
    return (
        f'<section id="provenance"><h2>Where it comes from</h2>{paragraphs}'
        f"<details><summary>The scene file</summary><pre>{escape(run.text)}</pre></details></section>"
    )
