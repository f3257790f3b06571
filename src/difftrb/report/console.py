"""What the command line shows: sentences, one result, progress while something takes its time; and its exit codes.

Loads no JAX. Progress is shown on a terminal only.
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from difftrb.core import storage

EXIT_OK, EXIT_NO_SOLUTION, EXIT_BAD_FILE, EXIT_INTERRUPTED, EXIT_PIPE = 0, 1, 2, 130, 141
"""0: all converged. 1: no solution. 2: a bad file or bad arguments."""

Figures = Iterable[tuple[str, Any]]
"""Names and Axes of figures, each drawn when the one before is saved."""
Drawn = Callable[[], Figures]
"""What draws figures: it imports matplotlib, for which a command without them need not wait."""
Page = Callable[[dict[str, str]], str]
"""From the figures' SVG by name to a page."""


def say(sentence: str) -> None:
    """Print a sentence to stderr."""
    print(f"difftrb: {sentence}", file=sys.stderr)


def remark(path: str, *sentences: str | None) -> None:
    """Say what may be wrong with a file that is in order, if anything."""
    for sentence in sentences:
        if sentence is not None:
            say(f"{path}: {sentence}")


def say_picked(base: Any) -> None:
    """Say what the law "auto" became, if the scene `base` has it."""
    if (picked := getattr(base, "picked", None)) is not None:
        from difftrb.report import law_text

        say(law_text.picked_text(picked))


def refuse(reason: object, code: int) -> int:
    """Say why there is no result; returns `code`."""
    say(str(reason))
    return code


def show(text: Any) -> None:
    """Print text or a table."""
    from rich.console import Console

    Console(markup=False, highlight=False).print(text)


def deliver(
    options: Any, path: str, record: dict[str, Any], text: Callable[[], Any], figures: Drawn, page: Page | None = None
) -> int:
    """Print the result, write it where `options` ask, and say by the exit code whether it can be trusted."""
    whole = json.dumps(record, indent=1)
    if not record["converged"]:
        if options.json:
            print(whole)
        return refuse(f"{path}: {record['status']}", EXIT_NO_SOLUTION)
    written: list[str] = []
    if options.out is not None:
        written = draw(options.out, figures, {"result.json": whole + "\n"}, page)
    if options.json:
        print(whole)
        return EXIT_OK
    show(text())
    if options.out is not None:
        show(f"written to {options.out}: {', '.join(written)}")
    return EXIT_OK


def draw(folder: Path, figures: Drawn, texts: dict[str, str] | None = None, page: Page | None = None) -> list[str]:
    """Write figures, `texts` by their file names and the `page` of the figures into a folder, each whole; returns the
    names of the files; raises `OSError`."""
    from difftrb.report import figure_style

    def fill(scratch: Path) -> None:
        for name, ax in figures():
            figure_style.save(ax, scratch, name)
        written = dict(texts or {})
        if page is not None:
            written["report.html"] = page({svg.stem: svg.read_text(encoding="utf-8") for svg in scratch.glob("*.svg")})
        for name, content in written.items():
            (scratch / name).write_text(content, encoding="utf-8")

    with busy("drawing"):
        return storage.write_folder(folder, fill)


@contextlib.contextmanager
def busy(what: str) -> Iterator[None]:
    """A spinner."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


@contextlib.contextmanager
def bar(what: str) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar, to be told how many of how many are done."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(what)
        yield lambda done, of: shown.update(task, completed=done, total=of)


@contextlib.contextmanager
def members(what: str) -> Iterator[Callable[[int, int, int], None] | None]:
    """A progress bar with rate, time left and failures, to be told how many of how many members are done, and how many
    of those have no solution."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeft
    from rich.text import Text

    class Rate(ProgressColumn):
        """Members a second."""

        def render(self, task: Task) -> Text:
            return Text(f"{task.speed:,.0f}/s" if task.speed else "–/s")

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Rate(), TimeLeft(),
               TextColumn("{task.fields[failed]:,} without solution"))  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(what, total=None, failed=0)
        yield lambda done, of, failed: shown.update(task, completed=done, total=of, failed=failed)
