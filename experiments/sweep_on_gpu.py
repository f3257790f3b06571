"""A sweep on a GPU: whether it gives the CPU's numbers, how fast it is, and how near to what the GPU can do.

python -m experiments.sweep_on_gpu same [LAW ...]       values, derivatives and states of 20 000 members by CPU and GPU
python -m experiments.sweep_on_gpu batch [LAW ...]      members computed at once: time and memory of each member
python -m experiments.sweep_on_gpu whole [LAW] [--members N]   a sweep into files, from its first call to its last byte
python -m experiments.sweep_on_gpu roofline [LAW ...]   operations and bytes of a member, by NVIDIA's ncu, beside PEAK

Laws: liu2018 and auto by default. Members are those of `experiments.sweep_at_scale`: stiffness radial and axial, with
derivatives by length and width. Everything is measured after a first call.
"""

from __future__ import annotations

import argparse
import collections
import csv
import ctypes
import resource
import subprocess
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
from difftrb.sweeps import boxes, chunks
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.plan import Plan, Program
from experiments.sweep_at_scale import plan

LAWS = "liu2018", "auto"
PEAK = {"NVIDIA H100": (33.5, 3.35), "NVIDIA H200": (33.5, 4.8), "NVIDIA A100": (9.7, 2.0)}
"""Of a GPU by the start of its name: float64 [10¹² operations a second] outside tensor cores, memory [10¹² bytes a
second], from NVIDIA's data sheets of the SXM cards."""
OPERATIONS = {"dfma": 2, "dadd": 1, "dmul": 1}
COUNTERS = [f"smsp__sass_thread_inst_executed_op_{op}_pred_on.sum" for op in OPERATIONS]
TRAFFIC, DURATION = ["dram__bytes_read.sum", "dram__bytes_write.sum"], "gpu__time_duration.sum"


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
    for power in (10, 12, 14, 16, 18, 20):
        boxes.LARGEST_CHUNK = max(boxes.LARGEST_CHUNK, 2**power)
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
            ended = chunks.run(made, Path(folder))
            seconds = time.perf_counter() - began
            disk = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"{law}: {made.members:,} members, {made.blocks.size} at once, {made.chunks} chunks: {seconds:.2f} s, "
              f"{1e6 * seconds / made.members:.3f} µs a member; {disk / 1e6:.0f} MB of files; "
              f"{ended.failed:,} without a solution; peak {peak:.0f} MB", flush=True)  # fmt: skip


def call(law: str) -> int:
    """What `roofline` counts: one call of the program, after a first one; its members."""
    made, driver = plan(int(1e7), law), ctypes.CDLL("libcuda.so.1")
    program = Program(made, [device()])
    program.calls([0])
    driver.cuProfilerStart()
    program.calls([made.call])
    driver.cuProfilerStop()
    return made.call * made.blocks.size


def roofline(law: str) -> None:
    """Operations, bytes and time of a member, beside the peak."""
    asked = ["ncu", "--csv", "--profile-from-start", "off", "--clock-control", "none", "--metrics",
             ",".join([*COUNTERS, *TRAFFIC, DURATION])]  # fmt: skip
    ran = subprocess.run([*asked, sys.executable, "-m", "experiments.sweep_on_gpu", "call", law],
                         capture_output=True, text=True)  # fmt: skip
    lines = ran.stdout.splitlines()
    if ran.returncode:
        sys.exit("\n".join([*lines[-10:], *ran.stderr.splitlines()[-10:]]))
    members = int(next(line for line in lines if line.startswith("members ")).split()[1])
    table = lines[next(i for i, line in enumerate(lines) if line.startswith('"ID"')) :]
    scale = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "usecond": 1e-6, "nsecond": 1e-9, "msecond": 1e-3, "byte": 1.0,
             "Kbyte": 1e3, "Mbyte": 1e6, "Gbyte": 1e9, "inst": 1.0, "s": 1.0, "second": 1.0}  # fmt: skip
    sums, kernels = collections.Counter[str](), set[str]()
    of_kernel = collections.Counter[str]()
    for row in csv.DictReader(table):
        value = float(row["Metric Value"].replace(",", "")) * scale[row["Metric Unit"]]
        sums[row["Metric Name"]] += value  # type: ignore[assignment]
        kernels.add(row["ID"])
        if row["Metric Name"] == DURATION:
            of_kernel[row["Kernel Name"]] += value  # type: ignore[assignment]
    work = sum(OPERATIONS[op] * sums[counter] for op, counter in zip(OPERATIONS, COUNTERS, strict=True)) / members
    moved, seconds = sum(sums[name] for name in TRAFFIC) / members, sums[DURATION] / members
    kind = device().device_kind
    flops, memory = next((peak for name, peak in PEAK.items() if kind.startswith(name)), (float("nan"),) * 2)
    print(f"{law} on {kind}: {work:.0f} operations and {moved:.0f} bytes a member in {1e9 * seconds:.2f} ns of "
          f"{len(kernels)} kernels a call; {work / seconds / 1e12:.2f} of {flops} · 10¹² operations and "
          f"{moved / seconds / 1e12:.2f} of {memory} · 10¹² bytes a second; at best "
          f"{1e9 * max(work / flops, moved / memory) / 1e12:.2f} ns")  # fmt: skip
    for name, own in of_kernel.most_common(8):
        print(f"  {100 * own / sums[DURATION]:5.1f} % {name}")


def main() -> None:
    """Measure what the command line asks for, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("same", "batch", "whole", "roofline", "call"))
    parser.add_argument("laws", nargs="*", default=LAWS)
    parser.add_argument("--members", type=float, default=1e7)
    options = parser.parse_args()
    if options.what == "call":
        print("members", call(options.laws[0]))
        return
    for law in options.laws:
        if options.what == "whole":
            whole(law, int(options.members))
        else:
            {"same": same, "batch": batches, "roofline": roofline}[options.what](law)


if __name__ == "__main__":
    main()
