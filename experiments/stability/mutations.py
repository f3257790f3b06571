"""Files that nobody should write: packaged scenes and measurements, changed at random, and whether each gets an answer.

An answer is a file that is accepted, or one sentence that names the file and a key, a column, a line or a byte.
"""

from __future__ import annotations

import collections
import dataclasses
import random
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from difftrb.fits import measured_table
from difftrb.fits.measured_table import COLUMNS, MeasuredError
from difftrb.scene import scene_file
from difftrb.scene.scene_file import SceneError
from difftrb.sweeps import sweep_file

HOSTILE = (
    "nan", "-nan", "inf", "-inf", "1e400", "-1e400", "1e308", "-1e308", "5e-324", "0", "-0.0", "-1", "1e-300", "4e9",
    "9223372036854775808", "-9223372036854775809", "0x7fffffffffffffffffff", "1_000", "1e", ".5", "5.", "+7", "00012",
    "1" + "0" * 400, "1" + "0" * 5000,
)  # fmt: skip
WRONG = (
    "true", "false", '""', '"4.0"', '"nan"', "'text'", '"\\u0000"', '"mean"', '"‮roller"', "[]", "[[]]", "[[[1.0]]]",
    "{}", "{ a = { b = {} } }", "[{}]", "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", '"""\nlong\n"""', "null", "",
    "[1.0, 'two', true]", "\"" + "x" * 5000 + "\"", "[" * 40 + "]" * 40, "[" * 2000 + "]" * 2000,
    "{a=" * 500 + "1" + "}" * 500,
)  # fmt: skip
STRANGE = ("\u0000", "é", "长度", "\u202e", "\ufeff", "\u2028", "\x85", "\x0c", "\r", "\t", "\"", "'", "#", "=",
           "[", "]]", "{", ",", "\U0001f600", "\\", "\x1b[31m")  # fmt: skip
NUMBER = re.compile(r"(?<![\w.\"'])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w\"'])")
ENTRY = re.compile(r"^(\s*)([\w.\"]+)(\s*=\s*)(.*?)(\s*#.*)?$")
HEADING = re.compile(r"^\s*\[+[\w.]+\]+")

Mutation = Callable[[random.Random, str], str]


def _lines(text: str, kind: re.Pattern[str]) -> list[int]:
    """Which lines of a text are entries, or headings."""
    return [i for i, line in enumerate(text.split("\n")) if kind.match(line)]


def _at_a_line(change: Callable[[random.Random, str], str], kind: re.Pattern[str] = ENTRY) -> Mutation:
    """A mutation of one line, an entry or a heading."""

    def mutate(rng: random.Random, text: str) -> str:
        places = _lines(text, kind)
        if not places:
            return text
        lines, i = text.split("\n"), rng.choice(places)
        lines[i] = change(rng, lines[i])
        return "\n".join(lines)

    return mutate


def misspelt(rng: random.Random, word: str) -> str:
    """A word that is not quite that."""
    i = rng.randrange(len(word)) if word else 0
    return rng.choice((
        word[:i] + word[i + 1 :], word[:i] + rng.choice("aeiou_-.") + word[i:], word.upper(), word.capitalize(),
        word + "s", word[::-1], f'"{word}"', f'"{word} "', '""', word.replace("a", "а"), f"{word}.x", "x" * 3000,
        f'"{word}\\n"', f'"\\u202e{word}"',
    ))  # fmt: skip


def _renamed(rng: random.Random, line: str) -> str:
    before, key, between, value, comment = ENTRY.match(line).groups(default="")  # type: ignore[union-attr]
    return f"{before}{misspelt(rng, key)}{between}{value}{comment}"


def _retyped(rng: random.Random, line: str) -> str:
    before, key, between, _, comment = ENTRY.match(line).groups(default="")  # type: ignore[union-attr]
    return f"{before}{key}{between}{rng.choice(WRONG)}{comment}"


def _heading(rng: random.Random, line: str) -> str:
    name = line.strip().strip("[]").split("]")[0]
    return rng.choice((
        "", f"[[{name}]]", f"[{name}]", f"[{misspelt(rng, name)}]", f"[x.{name}]", f"[{name}.{name}]", f"{name} = 3",
        f"[{name}]\n[{name}]", f"[[{name}]]\n[[{name}]]", f"[{name}", f"[{rng.choice(('load', 'spall', 'contact'))}]",
    ))  # fmt: skip


def _number(rng: random.Random, text: str) -> str:
    """One number, anywhere, becomes another."""
    places = list(NUMBER.finditer(text))
    if not places:
        return text
    place = rng.choice(places)
    value = place[0]
    scaled = f"{float(value) * rng.choice((-1.0, 1e-6, 1e-3, 1e3, 1e6, 1e12, 57.3)):.12g}"
    return text[: place.start()] + rng.choice((*HOSTILE, scaled, scaled, scaled)) + text[place.end() :]


def _swapped(kind: re.Pattern[str]) -> Mutation:
    """Two lines change places: entries go to other tables, headings over other entries."""

    def mutate(rng: random.Random, text: str) -> str:
        places = _lines(text, kind)
        if len(places) < 2:
            return text
        lines, (i, k) = text.split("\n"), rng.sample(places, 2)
        lines[i], lines[k] = lines[k], lines[i]
        return "\n".join(lines)

    return mutate


def _truncated(rng: random.Random, text: str) -> str:
    return text[: rng.randrange(len(text) + 1)]


def _strange(rng: random.Random, text: str) -> str:
    i = rng.randrange(len(text) + 1)
    return text[:i] + rng.choice(STRANGE) + text[i:]


def _line_ends(rng: random.Random, text: str) -> str:
    return text.replace("\n", rng.choice(("\r\n", "\r", "\n\n", "\r\r\n", "\u2028")))


def _nothing(rng: random.Random, text: str) -> str:
    return rng.choice(("", "\n", "   \n\t", "# only a comment\n", "\ufeff", "\x00", "{}", "[]", "null", "---\na: 1\n"))


def _marked(rng: random.Random, text: str) -> str:
    return "\ufeff" + text


SCENES: dict[str, Mutation] = {
    "entry dropped": _at_a_line(lambda rng, line: ""),
    "entry twice": _at_a_line(lambda rng, line: f"{line}\n{line}"),
    "key renamed": _at_a_line(_renamed),
    "value of a wrong kind": _at_a_line(_retyped),
    "hostile number": _number,
    "heading changed": _at_a_line(_heading, HEADING),
    "headings swapped": _swapped(HEADING),
    "entries swapped": _swapped(ENTRY),
    "cut short": _truncated,
    "strange character": _strange,
    "line ends": _line_ends,
    "byte order mark": _marked,
    "nothing in it": _nothing,
}


# --------------------------------------------------------------------------------------------- tables of measurements


def _in_a_cell(change: Callable[[random.Random, str], str], header: bool = False) -> Mutation:
    def mutate(rng: random.Random, text: str) -> str:
        lines = text.split("\n")
        places = [i for i, line in enumerate(lines) if line.strip() and line.lstrip()[0] != "#"]
        if len(places) < 2:
            return text
        i = places[0] if header else rng.choice(places[1:])
        cells = lines[i].split(",")
        k = rng.randrange(len(cells))
        cells[k] = change(rng, cells[k])
        lines[i] = ",".join(cells)
        return "\n".join(lines)

    return mutate


def _column(rng: random.Random, text: str) -> str:
    """A column goes, in the first line alone or in all, or stands twice."""
    lines, k = text.split("\n"), rng.randrange(8)
    twice, everywhere, found = rng.random() < 0.5, rng.random() < 0.7, False
    for i, line in enumerate(lines):
        if not line.strip() or line.lstrip()[0] == "#" or (found and not everywhere):
            continue
        cells, found = line.split(","), True
        j = k % len(cells)
        lines[i] = ",".join(cells[: j + twice] + cells[j + (not twice) :] if not twice else [*cells, cells[j]])
    return "\n".join(lines)


def _separators(rng: random.Random, text: str) -> str:
    return text.replace(",", rng.choice((";", "\t", "|", " ", ",,", ", ", "，")))


def _decimal_commas(rng: random.Random, text: str) -> str:
    return text.replace(".", ",")


def _quoted(rng: random.Random, cell: str) -> str:
    return rng.choice((f'"{cell}"', f'"{cell}', f'{cell}"', f'"{cell}\n"', f"'{cell}'", f'"{cell}"x', '""""'))


TABLES: dict[str, Mutation] = {
    "column missing or twice": _column,
    "column renamed": _in_a_cell(misspelt, header=True),
    "wrong separators": _separators,
    "decimal commas": _decimal_commas,
    "cell empty": _in_a_cell(lambda rng, cell: ""),
    "quotes": _in_a_cell(_quoted),
    "cell that is no number": _in_a_cell(lambda rng, cell: rng.choice(WRONG)),
    "hostile cell": _in_a_cell(lambda rng, cell: rng.choice(HOSTILE)),
    "sigma ≤ 0": lambda rng, text: re.sub(r"0\.0\d+", rng.choice(("0", "-0.01", "-0.0", "1e-12")), text, count=1),
    **{name: SCENES[name] for name in ("cut short", "strange character", "line ends", "byte order mark")},
    "nothing in it": _nothing,
}  # fmt: skip

# ------------------------------------------------------------------------------------------------------------- answers

_TEXTS = "\n".join(re.sub(r"#.*", "", scene_file.example(name)) for name in scene_file.example_names())
KEYS = {"bearing", *re.findall(r"(\w+)\s*=", _TEXTS), *re.findall(r"^\[+(\w+)", _TEXTS, re.MULTILINE)}
"""Of packaged scenes."""


@dataclasses.dataclass(frozen=True)
class File:
    """A mutated file: how it was changed, its bytes, and whether it is a scene or a table of measurements."""

    changes: tuple[str, ...]
    content: bytes
    scene: bool


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a file got: "accepted", "refused" or "traceback"; the sentence; whether the sentence will do."""

    verdict: str
    sentence: str
    fair: bool


def files(count: int, seed: int) -> list[File]:
    """Three scenes to one table, with one to three changes each; one in thirty not in UTF-8."""
    rng, made = random.Random(seed), []
    bases = [(scene_file.example(name), True) for name in scene_file.example_names()]
    for k in range(count):
        text, scene = rng.choice(bases) if k % 4 else (measured_table.example(), False)
        ways = SCENES if scene else TABLES
        changes = tuple(rng.choice(list(ways)) for _ in range(rng.choice((1, 1, 1, 2, 3))))
        for change in changes:
            text = ways[change](rng, text)
        content = text.encode("utf-8", "surrogatepass")
        if rng.random() < 1.0 / 30.0:
            place = rng.randrange(len(content) + 1)
            content = content[:place] + rng.choice((b"\xff\xfe", b"\x80", b"\xc3", b"\xed\xa0\x80")) + content[place:]
            changes = (*changes, "bytes")
        made.append(File(changes, content, scene))
    return made


def _read_scene(path: Path) -> None:
    """All that the command line does to a scene file before it computes."""
    file = scene_file.read(path)
    for check in (scene_file.check_contact, scene_file.check_ring):
        try:
            check(file, path)
        except SceneError as error:
            refused = error
        else:
            refused = None
        if refused is not None and check is scene_file.check_ring:
            raise refused
    if b"[sweep]" in path.read_bytes():
        sweep_file.read(path)
    for leaf in jax.tree.leaves(file.scene()):
        assert np.isfinite(np.asarray(leaf, float)).all()


def answer(file: File, path: Path) -> Answer:
    """What the file gets, written to `path`."""
    path.write_bytes(file.content)
    try:
        _read_scene(path) if file.scene else measured_table.load_measured(path)
    except (SceneError, MeasuredError) as error:
        sentence = str(error)
        return Answer("refused", sentence, is_fair(sentence, path, file))
    except BaseException as error:  # whatever it is, it is what is looked for
        if isinstance(error, KeyboardInterrupt):
            raise
        return Answer("traceback", f"{type(error).__name__}: {error}", False)
    return Answer("accepted", "", True)


def is_fair(sentence: str, path: Path, file: File) -> bool:
    """Whether a refusal is one printable line that begins with the file and names a key, a column, a line or a byte."""
    rest = sentence.removeprefix(f"{path}: ")
    if rest == sentence or not rest.isprintable() or len(rest) > 600:
        return False
    words = set(re.findall(r"\w+", rest))
    known = words & (KEYS if file.scene else set(COLUMNS))
    return bool(
        known
        or re.search(
            r"lines? \d+|row \d+|end of document|column .* is not known|separated by commas|UTF-8|no rows", rest
        )
    )


def run(count: int, seed: int = 0, progress: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """Counts of answers, by verdict and by mutation; what is wrong, whole."""
    verdicts, by_change, wrong = collections.Counter(), collections.defaultdict(collections.Counter), []
    with tempfile.TemporaryDirectory() as folder:
        for k, file in enumerate(files(count, seed), 1):
            if progress is not None:
                progress(k, count)
            path = Path(folder) / ("scene.toml" if file.scene else "measured.csv")
            got = answer(file, path)
            verdicts[got.verdict] += 1
            for change in file.changes:
                by_change[f"{'scene' if file.scene else 'table'}: {change}"][got.verdict] += 1
            if got.verdict == "traceback" or not got.fair:
                wrong.append((got, file))
    return {"verdicts": verdicts, "by_change": by_change, "wrong": wrong}
