"""Where a sweep is computed: devices of this process, threads of a CPU, and processes on one machine or many."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import jax

from difftrb.core.status import SweepError

COORDINATOR, PROCESSES, PROCESS = "JAX_COORDINATOR_ADDRESS", "JAX_NUM_PROCESSES", "JAX_PROCESS_ID"
"""Environment variables for `join`."""


def lanes_of(count: int | None = None) -> list[Any]:
    """Where to compute at once: `count` devices of this process or, on a CPU that JAX sees as fewer, threads of them.

    Default: all devices; on a CPU one lane for every processor. Raises `SweepError` where there are fewer.
    """
    here = jax.local_devices()
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    most = max(len(here), processors) if here[0].platform == "cpu" else len(here)
    if count is not None and not 1 <= count <= most:
        raise SweepError(f"devices = {count}: must be in 1 … {most} here")
    return [here[i % len(here)] for i in range(count or most)]


def accelerator() -> Any:
    """The first device of this process that is no CPU, None if there is none."""
    return next((device for device in jax.local_devices() if device.platform != "cpu"), None)


def join(
    coordinator: str | None = None,
    processes: int | None = None,
    process: int | None = None,
    environment: Mapping[str, str] = os.environ,
) -> None:
    """Make this process one of several that share a sweep; before the first computation. Alone it does nothing.

    Args:
      coordinator: address and port of the first process, "10.0.0.1:1234". processes: how many there are. process: the
        number of this one, from 0. Default: the environment variables above; under Slurm and the like all three are
        found by JAX itself.

    Raises `SweepError` if some are missing or wrong, or the coordinator does not answer.
    """
    coordinator = coordinator or environment.get(COORDINATOR)
    count = processes if processes is not None else _whole(environment, PROCESSES)
    number = process if process is not None else _whole(environment, PROCESS)
    if coordinator is None and count is None and number is None:
        if int(environment.get("SLURM_NTASKS", "1")) > 1 and "SLURM_PROCID" in environment:
            jax.distributed.initialize()
        return
    if coordinator is None or count is None or number is None:
        raise SweepError("several processes need all of --coordinator HOST:PORT, --processes N and --process I "
                         f"(or {COORDINATOR}, {PROCESSES} and {PROCESS})")  # fmt: skip
    if not 0 <= number < count:
        raise SweepError(f"process = {number}: must be in 0 … {count - 1}, for {count} processes")
    if coordinator.count(":") < 1 or not coordinator.rpartition(":")[2].isdigit():
        raise SweepError(f"coordinator = {coordinator!r}: must be HOST:PORT")
    if count > 1:
        try:
            jax.distributed.initialize(coordinator, count, number)
        except RuntimeError as error:
            raise SweepError(f"coordinator = {coordinator!r}: {str(error).splitlines()[0]}") from None


def _whole(environment: Mapping[str, str], name: str) -> int | None:
    text = environment.get(name)
    if text is None:
        return None
    if not text.isdigit():
        raise SweepError(f"{name} = {text!r}: must be a whole number")
    return int(text)


def wait(point: str) -> None:
    """For all processes to come to this point."""
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(f"difftrb {point}")
