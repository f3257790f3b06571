"""What a sweep will take: members, files, memory and time, from a block that is computed on trial."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import jax

from difftrb.core.machine import lanes_of
from difftrb.sweeps import sizes
from difftrb.sweeps.plan import Plan
from difftrb.sweeps.sweeping import Program


class Forecast(NamedTuple):
    """See `text`. `member` is bytes on disk of one member, `memory` bytes beside those of JAX itself; `compile` and
    `seconds` are of this process and all its lanes, `call` of one part of a chunk in one lane."""

    members: int
    chunks: int
    lanes: int
    member: int
    memory: int
    compile: float
    call: float
    seconds: float


def forecast(plan: Plan, devices: int | None = None) -> Forecast:
    """Compile the program and compute one part of a chunk in every lane at once, twice."""
    lanes = lanes_of(devices)
    sizes.check_chunks(plan)
    program = Program(plan, lanes)
    parts = -(-plan.layout.blocks // plan.part)
    started = time.perf_counter()
    program.parts([0])
    first = time.perf_counter() - started
    again = []
    for _ in range(2):
        started = time.perf_counter()
        program.parts([lane * parts // len(lanes) for lane in range(len(lanes))])
        again.append(time.perf_counter() - started)
    call = min(again)
    share = -(-plan.chunks // jax.process_count()) / plan.chunks
    return Forecast(
        members=plan.layout.members,
        chunks=plan.chunks,
        lanes=len(lanes),
        member=sizes.of_member(plan),
        memory=program.scratch() * len(lanes) + sizes.of_chunks(plan),
        compile=first - call,
        call=call,
        seconds=share * parts * call / min(len(lanes), parts),
    )


def text(plan: Plan, devices: int | None = None, folder: Path | None = None) -> str:
    """The forecast for people; with a `folder`, how much room is there."""
    f = forecast(plan, devices)
    room = "" if folder is None else f"; {sizes.text(sizes.free_disk(folder))} are free in {folder}"
    counts = " × ".join(str(axis.count) for axis in plan.axes)
    return "\n".join([
        f"members   {f.members:,} = {counts}, in {f.chunks:,} files of {plan.chunk * plan.layout.size:,} or fewer",
        f"disk      {sizes.text(2 * f.member * f.members)}: {f.member} bytes a member, in chunks and in one file{room}",
        f"memory    {sizes.text(f.memory)} beside JAX itself, whatever the number of members",
        f"time      {_duration(f.seconds)} on {f.lanes} device{'s' if f.lanes > 1 else ''}, and "
        f"{_duration(f.compile)} to compile; {1e6 * f.seconds / f.members:.3g} µs a member",
    ])  # fmt: skip


def _duration(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.2g} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
