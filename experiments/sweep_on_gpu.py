"""A sweep on a GPU: whether it gives the CPU's numbers, and how fast it is.

python -m experiments.sweep_on_gpu same [LAW ...]       values, derivatives and states of 20 000 members by CPU and GPU
python -m experiments.sweep_on_gpu batch [LAW ...]      members computed at once: time and memory of each member
python -m experiments.sweep_on_gpu whole [LAW] [--members N]   a sweep into files, from its first call to its last byte

Laws: liu2018 and auto by default. Members are those of `experiments.sweep_at_scale`: stiffness radial and axial, with
derivatives by length and width. Everything is measured after a first call.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

from difftrb.core import status
from difftrb.core.machine import accelerator
from difftrb.sweeps import chunk_sharing
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.plan import Plan, Program
from experiments.sweep_at_scale import plan

LAWS = "liu2018", "auto"


def device() -> Any:
    """The GPU."""
    found = accelerator()
    if found is None:
        sys.exit("JAX sees no GPU here: install jax[cuda13] or jax[cuda12]")
    return found


def same(law: str) -> None:
    """20 000 members by both, by one plan."""
    made = plan(20_000, law, 1000)
    columns = list[dict[str, np.ndarray]]()
    for lane in (jax.local_devices(backend="cpu")[0], device()):
        began = time.perf_counter()
        program = Program(made, [lane])
        program.calls([0])
        compiled = time.perf_counter() - began
        parts = [program.chunk(number) for number in range(made.chunks)]
        columns.append({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
        print(f"{law}: {lane.device_kind}: {compiled:.1f} s to trace, compile and run once", flush=True)
    one, other = columns
    for name, values in one.items():
        if name == STATUS:
            print(f"  states that differ: {int(np.sum(values != other[name]))} of {len(values)}; not converged "
                  f"{int(np.sum(values != status.CONVERGED))}")  # fmt: skip
            continue
        apart = np.abs(values - other[name]) / max(np.nanmax(np.abs(values)), 1e-300)
        print(f"  {name}: apart by {np.nanmax(apart):.1e} of the largest, median {np.nanmedian(apart):.1e}; "
              f"NaN in {int(np.isnan(values).sum())} and {int(np.isnan(other[name]).sum())}", flush=True)  # fmt: skip


def a_member(made: Plan, lane: Any, times: int = 3) -> tuple[float, float]:
    """Microseconds of a member with its results fetched, the least of some calls; bytes that it needs there."""
    blocks, values = jax.device_put(made.arguments, lane)
    jitted: Any = made.compute
    program = jitted.lower(blocks, values).compile()
    needed: Any = program.memory_analysis()
    seconds = []
    for _ in range(times + 1):  # the first loads it
        began = time.perf_counter()
        jax.device_get(program(blocks, values))
        seconds.append(time.perf_counter() - began)
    return 1e6 * min(seconds) / (made.call * made.blocks.size), needed.temp_size_in_bytes / made.blocks.size


def batches(law: str) -> None:
    """By members computed at once."""
    for power in (10, 12, 14, 16, 18):
        made = plan(16 * 2**power, law, 2**power)
        micro, needed = a_member(made, device())
        print(f"{law}: {made.blocks.size:7d} at once, {made.call} blocks a call: {micro:.4f} µs and {needed:.0f} bytes "
              "a member", flush=True)  # fmt: skip


def whole(law: str, members: int) -> None:
    """Into files, once a first sweep has compiled it."""
    made = plan(members, law)
    for _ in range(2):
        with tempfile.TemporaryDirectory() as folder:
            began = time.perf_counter()
            ended = chunk_sharing.run(made, Path(folder))
            seconds = time.perf_counter() - began
            disk = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"{law}: {made.members:,} members, {made.blocks.size} at once, {made.chunks} chunks: {seconds:.2f} s, "
              f"{1e6 * seconds / made.members:.3f} µs a member; {disk / 1e6:.0f} MB of files; "
              f"{ended.failed:,} without a solution; peak {peak:.0f} MB", flush=True)  # fmt: skip


def main() -> None:
    """Measure what the command line asks for, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("same", "batch", "whole"))
    parser.add_argument("laws", nargs="*", default=LAWS)
    parser.add_argument("--members", type=float, default=1e7)
    options = parser.parse_args()
    for law in options.laws:
        if options.what == "whole":
            whole(law, int(options.members))
        else:
            (same if options.what == "same" else batches)(law)


if __name__ == "__main__":
    main()
