"""The documentation: tables say what is declared, links lead somewhere, and the tutorials' code runs."""

import dataclasses
import importlib.util
import re
import shlex
import warnings
from pathlib import Path
from typing import get_type_hints

import pytest

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.law import base as laws
from difftrb.ring import effects

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = sorted(DOCS.glob("**/*.md"))
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))


def text_of(name: str) -> str:
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def rows_below(text: str, heading: str) -> list[list[str]]:
    """Cells of the rows of the table that begins with this heading."""
    lines = text[text.index(heading) :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def declared():
    spec = importlib.util.spec_from_file_location("declared", DOCS / "declared.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.portable
def test_tables_are_as_declared() -> None:
    """`python docs/declared.py` has nothing to write; every table is in some page."""
    module = declared()
    pages = [page.read_text(encoding="utf-8") for page in PAGES]
    for page, text in zip(PAGES, pages, strict=True):
        assert module.filled(text) == text, page
    for name in module.DECLARED:
        assert any(f"<!-- declared: {name} -->" in text for text in pages), name


@pytest.mark.portable
def test_laws() -> None:
    """The table by hand has all there are, in the words of their declaration; so has the README's short one."""
    rows = {name.strip("`"): what for name, what, *_ in rows_below(text_of("laws"), "| law | what it is | error")}
    assert set(rows) == set(laws.names())
    for name, kind in laws.LAWS.items():
        assert rows[name].startswith(f"{kind.summary}: "), name
    short = rows_below(README.read_text(encoding="utf-8"), "| law | when")
    assert {name for names, _ in short for name in re.findall(r"`(\w+)`", names)} == set(laws.names())


@pytest.mark.portable
def test_effects() -> None:
    text = text_of("effects")
    rows = {name.strip("`"): what for name, what, *_ in rows_below(text, "| `effects.` |")}
    kinds = {kind.key: kind for kind in effects.registered()}
    assert set(rows) == set(kinds)
    for key, kind in kinds.items():
        fields = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
        assert set(re.findall(r"`(\w+)`", rows[key])) - set(kinds) - set(laws.LAWS) == fields, key
        for name, hint in get_type_hints(kind, include_extras=True).items():
            if name in fields:
                assert all(unit in rows[key] for unit in re.findall(r"unit='([^']*)'", repr(hint))), (key, name)
        for other in kind.excludes:
            assert re.search(rf"`{key}` excludes[^;]*`{other}`", text.replace("\n", " ")), (key, other)


@pytest.mark.portable
def test_commands() -> None:
    """The page of commands, and the README, name every command; the page its options, too, or it says `--help`."""
    page, readme = text_of("commands"), README.read_text(encoding="utf-8")
    for command in cli.COMMANDS:
        assert f"difftrb {command.name}" in page
        assert re.search(rf"`(difftrb )?{command.name}\b", readme), command.name


def test_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 120


@pytest.mark.parametrize("page", [README, *PAGES], ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_page_has_a_place_on_the_site(page: Path) -> None:
    if page.stem != "index":
        assert f"\n{page.relative_to(DOCS).with_suffix('').as_posix()}\n" in text_of("index")


def test_public_names_are_in_the_api() -> None:
    """Those of effects, FMU and ROSS in rooms of their own."""
    text = text_of("api")
    assert {name for name in trb.__all__ if f"difftrb.{name}\n" not in text} <= {"effects", "fmu", "ross"}


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of every block of Python or of commands."""
    return re.findall(r"```(python|sh)\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def run(line: str, capsys) -> None:
    """One line of a shell: a command of difftrb, and where its output goes."""
    words = shlex.split(line.partition("  #")[0])
    assert words[0] == "difftrb", line
    target = words[words.index(">") + 1] if ">" in words else None
    capsys.readouterr()
    assert cli.main(["--no-cache", *words[1 : words.index(">") if target else None]]) == 0, line
    if target:
        Path(target).write_text(capsys.readouterr().out, encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_tutorials_run(page: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    """Block after block, in one namespace and one empty folder; what a tutorial asserts, holds."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    found = blocks(page)
    assert found
    if any("import ross" in text for _, text in found):
        if not importlib.util.find_spec("ross"):
            pytest.skip("ROSS is not installed")
        warnings.simplefilter("default")  # its own
    for kind, text in found:
        if kind == "python":
            exec(compile(text, str(page), "exec"), names)
        else:
            for line in filter(None, text.splitlines()):
                run(line, capsys)


def test_the_readmes_snippet_runs(capsys) -> None:
    exec(compile(next(text for kind, text in blocks(README) if kind == "python"), "README.md", "exec"), {})
    assert capsys.readouterr().out


def test_the_readmes_output_is_what_run_prints(capsys) -> None:
    """Line by line, but for blanks at their ends."""
    shown = re.findall(r"```\n(Stiffness.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)[0]
    assert cli.main(["--no-cache", "run"]) == 0
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    for line in shown.rstrip().splitlines():
        assert line.rstrip() in printed, line
