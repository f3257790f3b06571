"""Whether the law "auto" keeps its promise: random scenes × accuracies, the true error of radial stiffness, axial
stiffness and peak load of what was picked, against contacts solved at 1e-5, ten times finer than the finest it takes.

python experiments/accuracy_promise.py [SCENES] [SEED] [FILE]   (default 100 0; a second a scene, after compiling, but
minutes for each of the last tenth)
python experiments/accuracy_promise.py --order [SCENES] [SEED]  (default 9 0)

With a FILE every scene is written there when it is done, and not computed again. With --order the question is another:
whether stiffness and peak load come closer by a known factor as contacts get ten times as exact, so that they could be
extrapolated. What is printed is the change by every step of ten over that by the step before, and how near to the
finest what is extrapolated from the others comes.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb
from difftrb.core import geometry
from difftrb.scene.auto_law import LADDER, apart, main_values
from difftrb.scene.scene import Picked, named

ASKED = (1e-1, 1e-2, 3e-3, 1e-3)
TRUTH = 1e-5


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Of one scene and one accuracy asked for: the accuracy of the contacts that was picked, the error it is said to
    have and the true one [-]; NaN where there is no truth."""

    asked: float
    accuracy: float
    said: float
    error: float


def scenes(count: int, seed: int) -> Iterator[trb.Scene]:
    """Scenes of 32008J: axial load 0.5 kN … 20 kN, radial up to twice it, one spall of 0.5 … 9 mm by 1 … 12 mm in the
    load zone, every second one off the roller's middle, at any cage phase, the last tenth in the mean over phases."""
    bearing = trb.bearing("32008J")
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        axial = float(np.exp(rng.uniform(np.log(500.0), np.log(20000.0))))
        spall = trb.Spall(
            float(rng.uniform(0.5, 9.0)),
            float(rng.uniform(1.0, 12.0)),
            angle=float(rng.uniform(-0.6, 0.6)),
            axial_offset=float(rng.uniform(-2.0, 2.0)) if i % 2 else 0.0,
        )
        phase = "mean" if 10 * i >= 9 * count else float(rng.uniform(0.0, geometry.roller_pitch(bearing)))
        load = trb.Load(float(rng.uniform(0.0, 2.0)) * axial, axial)
        yield trb.Scene(bearing, load, (spall,), law="auto", phase=phase)


def outcomes(scene: trb.Scene, asked: Sequence[float] = ASKED, truth: float = TRUTH) -> list[Outcome]:
    """One for every accuracy asked for."""
    exact = main_values(trb.solve(named(scene, "direct", truth)))
    found = []
    for x in asked:
        solution = trb.solve(dataclasses.replace(scene, accuracy=x))
        picked = solution.picked
        assert isinstance(picked, Picked)
        error = apart(main_values(solution), exact)
        found.append(Outcome(x, float(picked.accuracy), float(picked.error), error))
    return found


def refined(scene: trb.Scene, accuracies: Sequence[float] = (*LADDER, TRUTH)) -> np.ndarray:
    """What is promised by contacts of each accuracy, shape (accuracies, 3)."""
    return np.array([main_values(trb.solve(named(scene, "direct", a))) for a in accuracies])


def order(count: int, seed: int) -> None:
    """Print how steps follow each other, and whether what is extrapolated from all but the last is nearer to it."""
    every = [refined(scene) for scene in track(scenes(count, seed), "scenes", count, transient=True)]
    values = np.concatenate([one.T for one in every])  # (scenes × what is promised, accuracies)
    change = np.diff(values[np.all(np.isfinite(values), axis=1)])
    ratio = change[:, 1:] / change[:, :-1]
    least, middle, most = np.quantile(ratio, (0.0, 0.5, 1.0))
    print(f"{ratio.size} steps in {count} scenes: by {least:.2g} … {most:.2g} of the step before, in the middle "
          f"{middle:.2g}; {np.sum(ratio < 0.0)} turn round, {np.sum(np.abs(ratio) > 1.0)} are larger")  # fmt: skip
    for name, factor in (("a tenth a step", 0.1), ("as the two before", ratio[:, -2])):
        more = change[:, -2] * factor / (1.0 - factor)
        nearer = np.abs(change[:, -1] - more) < np.abs(change[:, -1])
        print(f"extrapolated, {name}: nearer to the finest in {np.sum(nearer)} of {nearer.size}, median distance by "
              f"that without {np.median(np.abs(change[:, -1] - more) / np.abs(change[:, -1])):.2g}")  # fmt: skip


def main() -> None:
    """Count."""
    if "--order" in sys.argv:
        sys.argv.remove("--order")
        order(*(int(sys.argv[i]) if len(sys.argv) > i else default for i, default in ((1, 9), (2, 0))))
        return
    count, seed = (int(sys.argv[i]) if len(sys.argv) > i else default for i, default in ((1, 100), (2, 0)))
    kept = Path(sys.argv[3]) if len(sys.argv) > 3 else None
    lines = kept.read_text(encoding="utf-8").splitlines() if kept is not None and kept.exists() else []
    every = [[Outcome(**o) for o in json.loads(line)] for line in lines]
    for number, scene in enumerate(track(scenes(count, seed), "scenes", count, transient=True)):
        if number < len(lines):
            continue
        every.append(outcomes(scene))
        if kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps([dataclasses.asdict(o) for o in every[-1]]) + "\n")
    table = Table(title=f"{len(every)} scenes: true error of stiffness and peak load by what 'auto' picked")
    for heading in ("asked", "with a truth", "said to be kept", "kept", "worst / asked", "worst / said", "contacts at"):
        table.add_column(heading, justify="right")
    for asked in ASKED:
        own = [o for scene in every for o in scene if o.asked == asked and math.isfinite(o.error)]
        said = [o for o in own if o.said <= asked]
        worst = (max((o.error / getattr(o, by) for o in own), default=math.nan) for by in ("asked", "said"))
        ways = [f"{sum(o.accuracy == a for o in own)} × {a:g}" for a in sorted({o.accuracy for o in own}, reverse=True)]
        table.add_row(f"{asked:g}", str(len(own)), str(len(said)), str(sum(o.error <= asked for o in own)),
                      *(f"{w:.2f}" for w in worst), ", ".join(ways))  # fmt: skip
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
