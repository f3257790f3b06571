"""Random sets of an experiment, each computed once and kept in a file, a line a set, by any number of processes."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

Record = dict[str, Any]
"""What is kept of a set, with its `seed`."""


def computed(name: str, sets: int, one: Callable[[int], Record], say: Callable[[Record], str] = str) -> list[Record]:
    """All records that are there in the end, by seed. The command line is [SETS] [FOLDER] [k/n] …, by default `sets`
    out 0/1: of n processes the k-th takes every n-th set; a set that is there in FOLDER/NAME.jsonl is not computed
    again. `say`: what is printed of a new one."""
    count, folder, share = (*sys.argv[1:4], *(str(sets), "out", "0/1")[len(sys.argv[1:4]) :])
    part, parts = map(int, share.split("/"))
    file = Path(folder) / f"{name}.jsonl"
    file.parent.mkdir(parents=True, exist_ok=True)
    for seed in range(part, int(count), parts):
        if seed not in {record["seed"] for record in _kept(file)}:
            record = one(seed)
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(record) + "\n")
            print(say(record), flush=True)
    return sorted(_kept(file), key=lambda record: record["seed"])


def _kept(file: Path) -> list[Record]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
