"""What computes here: cores, memory, time, a yardstick; and the devices and threads of a sweep."""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.core.status import SweepError


def yardstick_work() -> Callable[[], Any]:
    """A fixed piece of work on JAX's device: a product of two matrices of 512 × 512 in float64 and a Fourier transform
    of one, there and back."""
    a = jnp.asarray(np.random.default_rng(0).normal(size=(512, 512)))
    work = jax.jit(lambda a: (a @ a, jnp.fft.irfft2(jnp.fft.rfft2(a))))
    return lambda: work(a)


def yardstick() -> float:
    """Seconds, the least of 9, of `yardstick_work`."""
    return min(_times(yardstick_work(), 9, math.inf)[1])


def _times(function: Callable[[], Any], repeats: int, budget: float) -> tuple[Any, list[float]]:
    """What a function returns, and the seconds it takes after a first call, until a `budget` of them is spent."""
    result = jax.block_until_ready(function())
    times: list[float] = []
    while len(times) < repeats and (not times or sum(times) < budget):
        started = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - started)
    return result, times


def timed(function: Callable[[], Any], repeats: int = 7) -> tuple[Any, float]:
    """What a function returns, and the median of its seconds after a first call, for a second."""
    result, times = _times(function, repeats, 1.0)
    return result, float(np.median(times))


def importing() -> float:
    """Seconds that a process of its own takes to import `difftrb.solve`; NaN if it cannot."""
    code = "import time; t = time.perf_counter(); from difftrb import solve; print(time.perf_counter() - t)"
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    return float(there.stdout) if there.returncode == 0 else math.nan


def memory() -> float:
    """Largest memory of this process so far [MiB]."""
    try:
        import resource
    except ImportError:  # Windows
        return math.nan
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest / (2**20 if sys.platform == "darwin" else 2**10)


def free_memory() -> float:
    """Bytes that this process can still take: what the system has left, or less where its control group ends; infinite
    where neither is known."""
    found = math.inf
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        found = 1024.0 * float(next(line for line in lines if line.startswith("MemAvailable")).split()[1])
    with contextlib.suppress(OSError, ValueError, StopIteration):
        groups = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
        name = next(line for line in groups if line.startswith("0::"))[3:].strip("/")
        for group in (here := Path("/sys/fs/cgroup") / name, *here.parents):
            with contextlib.suppress(OSError, ValueError):  # "max": as much as there is
                found = min(found, float((group / "memory.max").read_text(encoding="ascii")))
    return found


def cores() -> int:
    """How many processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def lanes_of(count: int | None = None) -> list[Any]:
    """Where to compute at once: `count` devices of this process or, on a CPU that JAX sees as fewer, threads of them.

    Default: all devices; on a CPU one lane for every core. Raises `SweepError` where there are fewer.
    """
    here = jax.local_devices()
    most = max(len(here), cores()) if here[0].platform == "cpu" else len(here)
    if count is not None and not 1 <= count <= most:
        raise SweepError(f"devices = {count}: must be in 1 … {most} here")
    return [here[i % len(here)] for i in range(count or most)]


def accelerator() -> Any:
    """The first device of this process that is no CPU, None if there is none."""
    return next((device for device in jax.local_devices() if device.platform != "cpu"), None)
