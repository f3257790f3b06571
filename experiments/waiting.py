"""What a person waits for: whole commands, from an empty cache of compiled programs and again, in units of JAX itself.

    python -m experiments.waiting [NAME …]

The unit is a process that imports JAX and compiles a trivial program in float64. Run it with nothing beside.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

UNIT = "import jax; jax.config.update('jax_enable_x64', True); jax.jit(lambda x: x + 1.0)(1.0)"
SCENE = """
import jax
import difftrb as trb
trb.keep_compiled()
jax.config.update("jax_enable_x64", True)
scene = trb.Scene(trb.bearing("32008J"), trb.Load(radial=9000.0, axial=4500.0), (trb.Spall(length=4.0, width=7.0),))
stiffness = lambda s: trb.solve(s).stiffness[0, 0]
"""
DIRECT = """
bearing = "32008J"
[load]
radial = 9000
axial = 4500
[[spall]]
length = 4
width = 7
[contact]
law = "direct"
[stiffness]
phase = "mean"
"""
SWEEP = """
bearing = "32008J"
[load]
radial = 9000
axial = 6000
[[spall]]
length = 4
width = 7
[sweep]
outputs = ["radial_stiffness", "axial_stiffness"]
gradients = ["spall.0.length", "spall.0.width"]
spall.0.length = {from = 0.5, to = 8.0, count = 200}
spall.0.width = {from = 2.0, to = 10.0, count = 100}
"""
CASES: dict[str, tuple[str, ...]] = {
    "run": ("-m", "difftrb", "run"),
    "run --out": ("-m", "difftrb", "run", "--out", "out"),
    "run, direct, mean": ("-m", "difftrb", "run", "direct.toml"),
    "contact": ("-m", "difftrb", "contact"),
    "fit": ("-m", "difftrb", "fit", "fit.toml", "measured.csv"),
    "sweep of 20 000 with gradients": ("-m", "difftrb", "sweep", "sweep.toml", "--out", "swept"),
    "README's snippet": ("-c", f"{SCENE}trb.solve(scene).check(); jax.grad(stiffness)(scene)"),
    "jit(grad(f)) of a user": ("-c", f"{SCENE}jax.jit(jax.grad(stiffness))(scene)"),
    "the same with compiler_options": (
        "-c",
        f"{SCENE}jax.jit(jax.grad(stiffness), compiler_options=trb.compiler_options())(scene)",
    ),
}
"""Arguments of Python."""
TIMES = 3
"""Runs of the unit."""


def seconds(arguments: tuple[str, ...], folder: Path, environment: dict[str, str]) -> float:
    """Of one process, which has to end well."""
    started = time.perf_counter()
    subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, check=True, capture_output=True)
    return time.perf_counter() - started


def main() -> None:
    names = sys.argv[1:] or list(CASES)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, text in (("direct.toml", DIRECT), ("sweep.toml", SWEEP)):
            (folder / name).write_text(text, encoding="utf-8")
        for name, file in (("fit", "fit.toml"), ("measured", "measured.csv")):
            shown = subprocess.run(
                [sys.executable, "-m", "difftrb", "example", name], check=True, capture_output=True, text=True
            )
            (folder / file).write_text(shown.stdout, encoding="utf-8")
        plain = {**os.environ, "TF_CPP_MIN_LOG_LEVEL": "3"}
        unit = float(np.median([seconds(("-c", UNIT), folder, plain) for _ in range(TIMES)]))
        print(f"unit: {unit:.2f} s; units from an empty cache, and again", flush=True)
        for name in names:
            environment = {**plain, "XDG_CACHE_HOME": str(folder / name.replace(" ", "_"))}
            took = []
            for k in range(2):
                arguments = tuple(f"swept{k}" if each == "swept" else each for each in CASES[name])
                took.append(seconds(arguments, folder, environment))
            print(f"{name:32s} {took[0] / unit:6.1f} {took[1] / unit:6.1f}", flush=True)


if __name__ == "__main__":
    main()
