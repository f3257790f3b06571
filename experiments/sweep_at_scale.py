"""What a sweep costs: time, memory, devices, processes, interruptions, and what larger machines would take.

python experiments/sweep_at_scale.py scale [LAW] [--members N] [--over bearings]   a tenth and all of N (1e6), 1 and 2
                                                                 devices
python experiments/sweep_at_scale.py on-paper [LAW] [--members N]   of one device's measure: 1e9 and 1e12 members
python experiments/sweep_at_scale.py batch [LAW] [--over bearings]             members computed at once, one core
python experiments/sweep_at_scale.py processes [LAW] [--members N]   two processes on one store, timed against one
                                                                 of two threads, five times in turn
python experiments/sweep_at_scale.py kills [TIMES]               kill -9 of one of two at random moments, resume
python experiments/sweep_at_scale.py kills-of-a-worker, -of-the-scheduler, -of-all [TIMES]   the same of Dask's
python experiments/sweep_at_scale.py contacts [--out DIR]        Fig. 13 of the paper as a surface: 4096 solves

`scale` sweeps length × width × phase × load, stiffness radial and axial with derivatives by length and width, into
files, or over bearings: length × width × a roller's diameter × crown, derivatives by all four; every figure is of a
fresh process whose law and program are in the cache.
Its last lines are the cost of larger sweeps and machines, from these measurements.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import random
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import difftrb as trb
from difftrb.core import jax_config
from difftrb.core.machine import lanes_of
from difftrb.report import figure_style
from difftrb.scene import scene_file
from difftrb.sweeps import chunk_sharing, sweep_plot, sweeping
from difftrb.sweeps.blocks import LARGEST_CHUNK
from difftrb.sweeps.plan import Plan, Program
from difftrb.sweeps.store import done_in, store_of
from difftrb.sweeps.swept import coordinates_of, labelled, manifest_of

NAMES, SIZES = ("radial_stiffness", "axial_stiffness"), ("spall.0.length", "spall.0.width")
FILE = f"""{scene_file.example("spall")}
[contact]
law = "liu2018"
[sweep]
gradients = ["spall.0.length", "spall.0.width"]
spall.0.length = {{from = 0.5, to = 8.0, count = 40}}
spall.0.width = {{from = 2.0, to = 10.0, count = 25}}
stiffness.phase = {{from = 0.0, to = 0.27, count = 20}}
load.axial = {{from = 2000.0, to = 6000.0, count = 20, spacing = "log"}}
"""


GAIN = 35.0
"""Cores that a GPU is as fast as: an H200 takes 0.11 µs a member with its files (experiments/sweep_on_gpu.py whole), a
core 3.9 by `liu2018`."""
OVER: dict[str, dict[str, dict[str, float]]] = {
    "loads": {
        "stiffness.phase": {"from": 0.0, "to": 0.27, "count": 50},
        "load.axial": {"from": 4000.0, "to": 6000.0, "count": 40},
    },
    "bearings": {
        "bearing.roller_large_diameter": {"from": 6.82, "to": 6.87, "count": 50},
        "contact.design_load": {"from": 5000.0, "to": 9000.0, "count": 40},
    },
}
"""What is swept beside a spall's sizes."""


def plan(members: int, law: str, batch: int | None = None, over: str = "loads") -> Plan:
    """About `members` of them: 20 widths × 50 × 40 of what `OVER` says, and lengths to make up the number."""
    scene = trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 6000.0), (trb.Spall(4.0, 7.0),), law=law)
    lengths = max(1, round(25 * members / 1e6))
    axes = {
        "spall.0.length": {"from": 0.5, "to": 8.0, "count": lengths} if lengths > 1 else [4.0],
        "spall.0.width": {"from": 3.0, "to": 10.0, "count": 20},
        **OVER[over],
    }
    return sweeping.plan_sweep(NAMES, scene, axes, SIZES if over == "loads" else tuple(axes), batch=batch)


def child(members: int, law: str, devices: int, over: str = "loads") -> dict[str, float]:
    """Measured in this process: seconds of `chunk_sharing.run`, all and since the first chunk was there; megabytes."""
    jax_config.set_up_jax(cache=True)
    made = plan(members, law, over=over)
    marks: list[tuple[float, float, int]] = []

    def mark(done: int, of: int, failed: int) -> None:
        marks.append((time.perf_counter(), time.process_time(), done))

    with tempfile.TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        started = time.perf_counter()
        ended = chunk_sharing.run(made, Path(folder), devices=devices, progress=mark)
        seconds = time.perf_counter() - started
        disk = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    (first, worked, had), (last, worked_at_last, done) = marks[1], marks[-1]
    return {
        "members": made.members,
        "failed": ended.failed,
        "seconds": seconds,
        "steady": 1e6 * (last - first) / max(1, done - had),
        "processor": 1e6 * (worked_at_last - worked) / max(1, done - had),
        "before": before / 1e3,
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
        "disk": disk,
        "chunks": made.chunks,
        "columns": len(made.shapes),
    }


def fresh(*arguments: Any) -> dict[str, float]:
    """`child` in a process of its own."""
    running = [sys.executable, __file__, "child", *map(str, arguments)]
    return json.loads(subprocess.run(running, check=True, capture_output=True, text=True).stdout.splitlines()[-1])


def scale(law: str, members: int, over: str) -> None:
    """Time, memory, devices, and what follows for larger machines."""
    fresh(max(members // 100, 1), law, 2, over)  # the law, into the cache
    rows = {}
    for count, devices in ((members // 10, 2), (members, 2), (members, 1)):
        fresh(count, law, devices, over)  # compiles
        rows[count, devices] = row = fresh(count, law, devices, over)
        print(
            f"{law}, {row['members']:,} members over {over}, {devices} devices: {row['seconds']:.2f} s; "
            f"{row['steady']:.2f} µs a member once running, "
            f"{row['processor']:.2f} µs of processor time; peak {row['peak']:.0f} MB ({row['before']:.0f} at the "
            f"start); {row['failed']:,} without a solution",
            flush=True,
        )
    two, one, small = rows[members, 2], rows[members, 1], rows[members // 10, 2]
    more = two["peak"] - small["peak"]
    print(f"two devices {one['steady'] / two['steady']:.2f} times one; ten times the members, {more:+.0f} MB")
    print("\n".join(larger(one)))


MACHINES = {
    "10 cores": (10, 1.0, 0.04),
    "1000 cores": (1000, 1.0, 0.04),
    "8 GPUs": (8, GAIN, 2.5),
    "64 GPUs": (64, GAIN, 2.5),
}
"""How many there are, how many cores each is as fast as, and what an hour of one costs [$]: about what clouds ask."""
LIMITS = {"bytes a second": 1e9, "files a second": 1e3, "files": 1e8}
"""What a shared disk of a cluster bears, about: what breaks first is what comes nearest to, or farthest beyond, it."""


def larger(one: dict[str, float], sizes: Sequence[float] = (1e9, 1e12)) -> list[str]:
    """A table, on paper, of what one core was measured to take: larger sweeps on larger machines."""
    core, size = one["steady"] * 1e-6, one["disk"] / one["members"]
    files = one["columns"] / LARGEST_CHUNK  # of a member: a shard for every column of a chunk
    lines = [f"| {core * 1e6:.1f} µs and {size:.0f} bytes a member | hours | $ | TB | files | first at its limit |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    for members in sizes:
        for name, (count, gain, price) in MACHINES.items():
            hours = members * core / (count * gain) / 3600.0
            rate = count * gain / core
            asked = {"bytes a second": rate * size, "files a second": rate * files, "files": members * files}
            worst = max(asked, key=lambda what: asked[what] / LIMITS[what])
            figures = hours, hours * count * price, members * size / 1e12, members * files
            lines.append(
                f"| {members:.0e} on {name} | {' | '.join(f'{each:.3g}' for each in figures)} "
                f"| {worst}: {asked[worst]:.2g} of about {LIMITS[worst]:.0e} |"
            )
    return lines


def batches(law: str, over: str) -> None:
    """Microseconds a member by members computed at once, on one core: pin it with taskset."""
    for batch in (64, 128, 256, 1024, 4096):
        made = plan(40_000, law, batch, over)
        program = Program(made, lanes_of(1))
        program.calls([0])
        times = []
        for _ in range(3):
            started = time.perf_counter()
            count = max(1, min(8, made.blocks.number // made.call))
            program.calls(range(0, count * made.call, made.call))
            times.append(time.perf_counter() - started)
        members = count * made.call * made.blocks.size
        print(f"{law}: {made.blocks.size:6d} at once: {1e6 * min(times) / members:.2f} µs a member", flush=True)


def command(file: Path, out: Path, *more: str) -> list[str]:
    """The command line that sweeps."""
    return [sys.executable, "-m", "difftrb", "sweep", str(file), "--out", str(out), *more]


def same(one: Path, other: Path) -> list[str]:
    """Names of files of results whose bytes differ, or that only one folder has; but for what a killed process was
    writing, which sweeps remove once it is old."""

    def bytes_of(folder: Path) -> dict[str, bytes]:
        return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*")
                if path.is_file() and path.suffix not in (".png", ".svg", ".partial")}  # fmt: skip

    here, there = bytes_of(one), bytes_of(other)
    return sorted(name for name in here.keys() | there.keys() if here.get(name) != there.get(name))


def by_one(folder: Path, text: str) -> tuple[Path, float]:
    """A scene file in `folder`, swept into `one` if it was not; its name, and seconds."""
    file, started = folder / "scene.toml", time.perf_counter()
    if not (folder / "one").exists():
        file.write_text(text, encoding="utf-8")
        subprocess.run(command(file, folder / "one"), capture_output=True)
    return file, time.perf_counter() - started


def started(file: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    """A process that sweeps."""
    return subprocess.Popen(command(file, out, *more), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def processes(folder: Path, text: str = FILE) -> tuple[list[str], float]:
    """What differs between a sweep by one process and by two that know nothing of each other; seconds of the two."""
    file, _ = by_one(folder, text)
    began = time.perf_counter()
    both = [started(file, folder / "two", "--share", f"{i}/2", "--devices", "1") for i in (1, 2)]
    for process in both:
        process.wait(300)
    return same(folder / "one", folder / "two"), time.perf_counter() - began


def beside_one(folder: Path, law: str, members: float, times: int = 5) -> str:
    """`processes` of about so many members, in turn with one process of two threads; programs are kept already."""
    text = FILE.replace('"liu2018"', f'"{law}"').replace("count = 20}", f"count = {max(1, round(members / 2e4))}}}", 1)
    seconds, differing = list[tuple[float, float]](), list[str]()
    for _ in range(times + 1):  # the first compiles
        _, one = by_one(folder, text)
        differing, two = processes(folder, text)
        seconds.append((one, two))
        for name in ("one", "two"):
            shutil.rmtree(folder / name)
    one, two = (statistics.median(each[k] for each in seconds[1:]) for k in (0, 1))
    return (
        f"differing between one process and two: {differing or 'nothing'}; one of two threads took {one:.1f} s, the "
        f"two {two:.1f} s, {statistics.median(b / a for a, b in seconds[1:]):.2f} times as long"
    )


def there(out: Path) -> int:
    """How many chunks are in a folder that need not be there."""
    return int(done_in(store_of(out)).sum()) if out.exists() and store_of(out).about else 0


def kills(folder: Path, times: int, text: str = FILE, longest: float | None = None) -> tuple[list[str], list[int]]:
    """What differs between a sweep and one of two processes of which one was killed at `times` random moments; the
    number of chunks that were there after each. The other finishes without being told."""
    file, _ = by_one(folder, text)
    left, differing = list[int](), set[str]()
    if longest is None:  # as long as one takes that need not compile
        began = time.perf_counter()
        started(file, folder / "timed").wait(300)
        longest = time.perf_counter() - began
    for k in range(times):
        out = folder / f"killed-{k}"
        one, other = (started(file, out, "--share", f"{i}/2") for i in (1, 2))
        time.sleep(random.uniform(0.3, 1.0) * longest)
        one.send_signal(signal.SIGKILL)
        one.wait()
        left.append(there(out))
        other.wait(300)
        differing.update(same(folder / "one", out))
        shutil.rmtree(out)
    return sorted(differing), left


def cluster(folder: Path) -> tuple[str, list[subprocess.Popen[bytes]]]:
    """A Dask scheduler and two workers, which no nanny starts again: its address, and the processes, it first."""
    told, quiet = folder / "scheduler.json", {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    told.unlink(missing_ok=True)
    dask = [sys.executable, "-m", "dask"]
    asked = [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(told)]
    made = [subprocess.Popen(asked, **quiet)]  # type: ignore[call-overload]
    while not told.exists() or not told.read_text():
        time.sleep(0.1)
    one = [*dask, "worker", "--scheduler-file", str(told), "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    made += [subprocess.Popen(one, cwd=folder, **quiet) for _ in range(2)]  # type: ignore[call-overload]
    return json.loads(told.read_text())["address"], made


DONE = 0, 1
"""How a sweep ends that is whole; 1 where members have no solution."""


def kills_on_dask(folder: Path, times: int, whom: str, text: str = FILE) -> tuple[list[str], list[str]]:
    """What differs between a sweep and one by Dask's workers of which one, the scheduler, or all and the command itself
    are killed at random moments; what was there then, how the command ended, and whether it had to be resumed."""
    file, _ = by_one(folder, text)
    told, differing, out = list[str](), set[str](), folder / "killed"

    for _ in range(times):
        address, (scheduler, *workers) = cluster(folder)
        asked = command(file, out, "--scheduler", address)
        driver = subprocess.Popen(asked, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        try:
            while not there(out) and driver.poll() is None:
                time.sleep(0.1)
            time.sleep(random.uniform(0.0, 3.0))
            killed = {"worker": workers[:1], "scheduler": [scheduler], "all": [driver, scheduler, *workers]}[whom]
            for process in killed:
                process.send_signal(signal.SIGKILL)
            chunks_then, (_, said) = there(out), driver.communicate(timeout=300)
            last = said.decode().strip().splitlines()[-1:]
            told.append(": ".join([f"{chunks_then} chunks; command ended {driver.returncode}", *last]))
        finally:
            for process in (driver, scheduler, *workers):
                process.kill()
                process.wait()
        if driver.returncode not in DONE or not done_in(store_of(out)).all():  # a worker may have written the last one
            ended = subprocess.run(command(file, out, "--resume"), capture_output=True, timeout=300, check=False)
            told[-1] += "; resumed" if ended.returncode in DONE else f"; --resume ended {ended.returncode}"
        differing.update(same(folder / "one", out))
        shutil.rmtree(out)
    return sorted(differing), told


def contacts(side: int = 64, accuracy: float = 1e-3, devices: int | None = None) -> tuple[trb.Swept, float, float]:
    """Approach over D_x and length (Fig. 13: 3 kN, width 1 mm), side² contacts; seconds to compile and to compute."""
    base = {"contact": trb.LineContact.of(trb.bearing("32008J")), "spall": trb.Spall(2.0, 1.0), "offset": 0.0}

    def solved(tree: dict[str, Any]) -> trb.ContactSolution:
        return trb.solve_contact(tree["contact"], 3000.0, tree["spall"], tree["offset"], accuracy)

    axes = {"offset": np.linspace(-0.7, 0.7, side), "spall.length": np.linspace(0.5, 8.0, side)}
    made = sweeping.plan_sweep("approach", base, axes, batch=1, solved=solved)
    made = dataclasses.replace(made, units=made.units | {"offset": "mm"})
    program = Program(made, lanes_of(devices))
    started = time.perf_counter()
    program.calls([0])
    compiled = time.perf_counter()
    columns = [program.chunk(number) for number in range(made.chunks)]
    seconds = time.perf_counter() - compiled
    whole = {name: np.concatenate([c[name] for c in columns]) for name in columns[0]}
    return labelled(manifest_of(made), coordinates_of(made), whole), compiled - started, seconds


def main() -> None:
    """Measure what the command line asks for, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    of_dask = {f"kills-of-{who}": who.split("-")[-1] for who in ("a-worker", "the-scheduler", "all")}
    parser.add_argument(
        "what", choices=("scale", "on-paper", "batch", "processes", "kills", *of_dask, "contacts", "child")
    )
    parser.add_argument("more", nargs="*")
    parser.add_argument("--members", type=float, default=1e6)
    parser.add_argument("--over", choices=tuple(OVER), default="loads")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    more: list[str] = options.more
    if options.what == "child":
        print(json.dumps(child(int(more[0]), more[1], int(more[2]), more[3])))
    elif options.what == "scale":
        scale(more[0] if more else "liu2018", int(options.members), options.over)
    elif options.what == "on-paper":
        law = more[0] if more else "table"
        fresh(int(options.members), law, 1, options.over)  # compiles
        print("\n".join(larger(fresh(int(options.members), law, 1, options.over))))
    elif options.what == "batch":
        batches(more[0] if more else "liu2018", options.over)
    elif options.what == "contacts":
        swept, compiling, seconds = contacts()
        print(f"{swept.status_code.size} contacts in {seconds:.2f} s ({compiling:.1f} s to compile); {swept.counts}")
        if options.out:
            options.out.mkdir(parents=True, exist_ok=True)
            figure_style.save(sweep_plot.sweep_map(swept, "approach"), options.out, "fig13_surface")
    else:
        folder = Path(tempfile.mkdtemp())
        try:
            if options.what == "processes":
                print(beside_one(folder, more[0] if more else "liu2018", options.members))
            elif options.what in of_dask:
                differing, told = kills_on_dask(folder, int(more[0]) if more else 10, of_dask[options.what])
                print("\n".join([*told, f"differing in the end: {differing or 'nothing'}"]))
            else:
                differing, left = kills(folder, int(more[0]) if more else 10)
                print(f"after kills there were {left} chunks; differing in the end: {differing or 'nothing'}")
        finally:
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
