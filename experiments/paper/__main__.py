"""Run the numbered scripts one after the other, and write the page of all that have ever run."""

from __future__ import annotations

import argparse
import importlib
import json
import time
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from experiments.paper import common

HERE = Path(__file__).parent
ROOT = HERE.parent.parent


def scripts() -> list[str]:
    """Names of the numbered scripts, in order."""
    return sorted(path.stem for path in HERE.glob("[0-9][0-9]_*.py"))


def write_page(out: Path, page: Path) -> None:
    """The page from the results in `out`."""
    files = sorted(out.glob("[0-9][0-9]_*.json"))
    results = [json.loads(path.read_text(encoding="utf-8")) for path in files]
    folder = out.relative_to(page.parent).as_posix() if out.is_relative_to(page.parent) else out.as_posix()
    claims = [[c["sentence"], f"**{c['verdict']}**", c["ours"]] for result in results for c in result["claims"]]
    printed = [list(row.values()) for result in results for row in result["printed"]]
    parts = [
        "# The source paper, reproduced",
        "Liu, Zhu, Yan, Wang, Hong (2018), A novel method to model effects of natural defect on roller bearing, "
        "*Tribology International* 122, 169–178, [doi](https://doi.org/10.1016/j.triboint.2018.02.028): its tables, "
        "figures and sentences beside what this package computes. Made by `python -m experiments.paper`, which also "
        f"writes every picture as SVG and every number as JSON ([{folder}]({folder})). Bearing 32008J (Table 1); loads "
        "radial/axial; a spall at the load line with a roller over its middle unless said otherwise; loss: share of "
        "stiffness that the spall costs. Figure 8, the geometry, is [the drawing of axes](axes.png).",
        "## Its numbers",
        "*By its way*: clipped domain, power law, hard window; *half-space*: the whole contact, tables, ramps.",
        common.grid(["", "the paper", "ours, by its way", "ours, half-space"], printed),
        "## Its sentences",
        common.grid(["the paper says", "", "ours"], claims),
    ]
    for heading, beyond in (("## Its tables and figures", False), ("## Beyond the paper", True)):
        parts.append(heading)
        for path, result in zip(files, results, strict=True):
            if result["beyond"] == beyond:
                title = f"### {int(path.stem[:2])}. {result['title']}"
                source = f"(`experiments/paper/{path.stem}.py`)"
                parts += [title, source, result["page"].replace("{folder}", folder)]
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m experiments.paper", description=__doc__)
    parser.add_argument("numbers", nargs="*", type=int, metavar="NUMBER", help="of the scripts to run; default: all")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "paper", help="folder for figures and numbers")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "paper.md", help="the page to write")
    options = parser.parse_args(arguments)
    wanted = [name for name in scripts() if not options.numbers or int(name[:2]) in options.numbers]
    if not wanted:
        parser.error(f"there is no script of that number; there are {', '.join(name[:2] for name in scripts())}")
    common.set_up()
    out, page = options.out.resolve(), options.page.resolve()
    whole = time.perf_counter()
    columns = TextColumn("{task.description:14}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns) as bars:
        for name in wanted:
            bar = bars.add_task(name, total=None)
            result = importlib.import_module(f"experiments.paper.{name}").run(
                out, lambda done, total, bar=bar: bars.update(bar, completed=done, total=total)
            )
            common.write(result, out, name)
            bars.update(bar, completed=bars.tasks[bar].total or 1, total=bars.tasks[bar].total or 1)
            bars.stop_task(bar)
    write_page(out, page)
    print(f"{page}: {time.perf_counter() - whole:.0f} s")


if __name__ == "__main__":
    main()
