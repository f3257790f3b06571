"""Whether the law that `difftrb accuracy` recommends keeps its promise: random scenes, the recommended law's error of
stiffness against contacts solved at 1e-5, ten times finer than what it was recommended by.

python experiments/accuracy_promise.py [SCENES] [SEED]   (default 100 0; seconds a scene, after compiling)
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import track  # noqa: E402
from rich.table import Table  # noqa: E402

import difftrb as trb  # noqa: E402
from difftrb import accuracy, scenefile  # noqa: E402
from difftrb.rungs import STIFFNESS, Row, Rung, recommended  # noqa: E402
from difftrb.scenefile import SceneFile  # noqa: E402

ASKED = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3)
RUNGS = (
    Rung("ring", "direct", 1e-3), Rung("ring", "direct", 1e-4), Rung("ring", "liu2018", 1e-3),
    Rung("ring", "power", 1e-2), Rung("ring", "power", 1e-3), Rung("ring", "direct", 1e-2),
)  # fmt: skip
TRUTH = 1e-5


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Of one scene and one accuracy asked for: the law that was recommended, and its true error [-]."""

    asked: float
    law: str
    error: float


def scenes(count: int, seed: int) -> list[SceneFile]:
    """Scenes of 32008J as in Liu et al. 2018 and about: axial load 4 kN … 8 kN, radial up to twice it, one spall of
    0.5 … 8 mm by 3 … 9 mm at the load line."""
    rng = np.random.default_rng(seed)
    file = scenefile.parse(scenefile.example("spall"))
    found = []
    for _ in range(count):
        axial, share = rng.uniform(4000.0, 8000.0), rng.uniform(0.3, 2.0)
        spall = trb.Spall(rng.uniform(0.5, 8.0), rng.uniform(3.0, 9.0))
        found.append(dataclasses.replace(file, load=trb.Load(share * axial, axial), spall=(spall,)))
    return found


def outcomes(
    file: SceneFile, rungs: Sequence[Rung] = RUNGS, asked: Sequence[float] = ASKED, truth: float = TRUTH
) -> list[Outcome]:
    """One for every accuracy for which a law is recommended."""
    rows = accuracy.measure(file, rungs=rungs, limit=1e9, batch=1).rows
    exact = trb.solve(trb.prepare(dataclasses.replace(file.scene(), law="direct", accuracy=truth))).check()
    known = {name: float(getattr(exact, name)) for name in STIFFNESS}

    def error(row: Row) -> float:
        return max(abs(row.values[name] / value - 1.0) for name, value in known.items() if math.isfinite(value))

    best = [(x, recommended(rows, x)) for x in asked]
    return [Outcome(x, row.rung.name, error(row)) for x, row in best if row is not None]


def main() -> None:
    """Count."""
    count, seed = (int(sys.argv[i]) if len(sys.argv) > i else default for i, default in ((1, 100), (2, 0)))
    every = [o for file in track(scenes(count, seed), "scenes", transient=True) for o in outcomes(file)]
    table = Table(title=f"{count} scenes: true error of stiffness by the law recommended")
    for heading in ("asked", "recommended", "kept", "worst error / asked", "laws"):
        table.add_column(heading, justify="right")
    for asked in ASKED:
        own = [o for o in every if o.asked == asked]
        laws = sorted({o.law for o in own})
        kept = sum(o.error <= asked for o in own)
        worst = max((o.error / asked for o in own), default=math.nan)
        table.add_row(f"{asked:g}", str(len(own)), str(kept), f"{worst:.2f}", ", ".join(laws))
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
