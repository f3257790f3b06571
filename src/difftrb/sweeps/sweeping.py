"""Sweeps asked for: checked, forecast, and computed in memory.

What does not fit into memory or on disk is refused before an array of its length is made.
"""

from __future__ import annotations

import contextlib
import math
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from rich import filesize

from difftrb.contact.contact_solution import ContactSolution
from difftrb.core import status
from difftrb.core.machine import free_memory, lanes_of
from difftrb.core.status import SweepError
from difftrb.law.samples import Progress
from difftrb.report.tables import duration
from difftrb.scene import checks
from difftrb.scene.scene import Scene
from difftrb.sweeps import axes as axes_
from difftrb.sweeps import blocks, outputs, shared_law
from difftrb.sweeps.axes import Axis
from difftrb.sweeps.blocks import up
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.plan import Plan, Program
from difftrb.sweeps.swept import Swept, coordinates_of, labelled, manifest_of


def plan_sweep(
    what: Callable[[Any], Any] | Sequence[str],
    base: Any,
    given: Mapping[str, Any],
    gradients: Sequence[str] = (),
    mode: str = "product",
    batch: int | None = None,
    progress: Progress | None = None,
    solved: Callable[[Any], ContactSolution] | None = None,
    text: str = "",
    wrong: Callable[[Any], str | None] = lambda _: None,
    law: bool = True,
) -> Plan:
    """A plan, checked, the roller law of a scene made once for all members; arguments and errors as in `sweep`.

    With `solved`, which gives the single contact of a member, names are those of single contacts. `text` is the scene
    file's. `wrong` says in one sentence what a member that is no scene cannot have. Without `law` a scene is checked
    only: its plan cannot be computed.
    """
    status.require_float64()
    made = axes_.axes_of(given, mode)
    results = 1 if callable(what) or isinstance(what, str) else len(what)
    _check_members([axis.count for axis in made], results * (1 + len(gradients)))
    if isinstance(base, Scene):
        checks.refuse(base)
        wrong = checks.wrong
    units, dims = axes_.check(base, made, gradients), {}
    for member in _ends(base, made):
        if (sentence := wrong(member)) is not None:
            raise SweepError(sentence)
    if callable(what):
        function, title = _by_name(what), getattr(what, "__qualname__", repr(what))
    else:
        names = [what] if isinstance(what, str) else list(what)
        function, title = outputs.function_of(names, solved), " ".join(names)
        units |= {name: outputs.OUTPUTS[name].unit for name in names}
        dims = {name: outputs.OUTPUTS[name].dims for name in names}
    if law and isinstance(base, Scene):
        base = shared_law.with_shared_law(base, made, gradients, progress)
    return Plan(base, made, function, tuple(gradients), units, dims, blocks.of_block(made, batch), title, text)


def _ends(base: Any, made: Sequence[Axis]) -> Iterator[Any]:
    """Members at the ends of every axis, all others as in `base`."""
    for axis in made:
        for k in {int(place) for values in axis.values for place in (values.argmin(), values.argmax())}:
            member = base
            for key, values in zip(axis.keys, axis.values, strict=True):
                member = axes_.replaced(member, key, float(values[k]))
            yield member


def _by_name(function: Callable[[Any], Any]) -> Callable[[Any], dict[str, jax.Array]]:
    """The function with its result in a dict: "value", unless it is one."""

    def named(tree: Any) -> dict[str, jax.Array]:
        found = function(tree)
        results = dict(found) if isinstance(found, Mapping) else {"value": found}
        if not any(jnp.asarray(value).size for name, value in results.items() if name != STATUS):
            raise SweepError("the function returns no number; return an array, or a dict of arrays")
        return results

    return named


def bytes_of_member(plan: Plan) -> int:
    """Bytes of the results of one member."""
    return sum(math.prod(shape.shape) * np.dtype(shape.dtype).itemsize for shape in plan.shapes.values())


def _bytes_of_chunks(plan: Plan) -> int:
    """Bytes of the chunks that are in memory at once while a sweep runs: in parts, and put together."""
    return 3 * blocks.CHUNKS_AT_ONCE * plan.grid.size * bytes_of_member(plan)


def _check_members(counts: Sequence[int], columns: int) -> None:
    """Refuse more members than any sweep can have; `columns` are results and derivatives, one number or more each."""
    if (members := math.prod(counts)) > blocks.MOST:
        disk = f"which take {_in_bytes(members * (8 * columns + 1))} of disk or more"
        raise SweepError(f"{_product(counts)}, {disk}: must be at most {blocks.MOST:,}; give fewer")


def check_chunks(plan: Plan) -> None:
    """Raise `SweepError` if the few chunks that are in memory at once do not fit there."""
    what = f"chunks of {plan.grid.size:,} members with {_in_bytes(bytes_of_member(plan))} each"
    _fit(what, _bytes_of_chunks(plan), free_memory(), "memory", "; give a smaller batch, or smaller results")


def _check_memory(plan: Plan) -> None:
    """Refuse a sweep whose results do not fit into memory."""
    check_chunks(plan)
    each, free, chunks = bytes_of_member(plan), free_memory(), _bytes_of_chunks(plan)
    enough = f", enough for {max(0.0, free - chunks) // each:,.0f}"
    mend = f"{enough}; give fewer, or use difftrb.write_sweep, whose memory does not grow"
    _fit(f"{_product(plan.counts)} of {each} bytes", plan.members * each + chunks, free, "memory", mend)


def check_disk(plan: Plan, out: str, there: int) -> None:
    """Raise `SweepError` if the chunks, of which some are `there`, do not fit into the folder `out`."""
    each = bytes_of_member(plan)
    needed = (1.0 - there / plan.chunks) * plan.members * each
    what = f"{out}: {_product(plan.counts)} of {each} bytes{' still' if there else ''}"
    _fit(what, needed, free_disk(out), "disk", " there; make room, name another folder, or give fewer")


def _fit(what: str, needed: float, free: float, room: str, mend: str) -> None:
    """Refuse what takes more bytes than are free."""
    if needed > free:
        raise SweepError(f"{what} take {_in_bytes(needed)} of {room}, of which {_in_bytes(free)} are free{mend}")


def free_disk(out: str) -> float:
    """Bytes that can be written into a folder, which need not be there yet; infinite behind a URL."""
    if "://" in out:
        return math.inf
    folder = Path(out).absolute()
    return shutil.disk_usage(next(at for at in (folder, *folder.parents) if at.exists())).free


def _in_bytes(count: float) -> str:
    return filesize.decimal(round(count))


def _product(counts: Sequence[int]) -> str:
    return f"{' × '.join(f'{count:,}' for count in counts)}{f' = {math.prod(counts):,}' * (len(counts) > 1)} members"


def forecast_of_disk(plan: Plan, out: str | None = None) -> str:
    """How many members and chunks a sweep has, and what they take on disk, in words. With a folder `out` the text says
    how much room is there."""
    check_chunks(plan)
    each = bytes_of_member(plan)
    room = f"; {_in_bytes(free_disk(out))} are free in {out}" if out and "://" not in out else ""
    counts = " × ".join(map(str, plan.counts))
    return "\n".join([
        f"members   {plan.members:,} = {counts}, in {plan.chunks:,} chunks of {plan.grid.size:,} or fewer",
        f"disk      {_in_bytes(each * plan.members)}: {each} bytes a member{room}",
    ])  # fmt: skip


def forecast(plan: Plan, devices: int | None = None) -> str:
    """What memory and time a sweep will take, in words, from calls made on trial.

    The program is compiled, and called in every lane at once, twice. Time is of this process and all its lanes.
    """
    lanes = lanes_of(devices)
    program, blocks = Program(plan, lanes), plan.blocks.number
    calls = up(blocks, plan.call)

    def timed(numbers: Sequence[int]) -> float:
        started = time.perf_counter()
        program.calls(numbers)
        return time.perf_counter() - started

    first = timed([0])
    call = min(timed([lane * blocks // len(lanes) for lane in range(len(lanes))]) for _ in range(2))
    seconds = calls * call / min(len(lanes), calls)
    of_call = cast(Any, plan.compute).lower(*plan.arguments).compile().memory_analysis()
    scratch = of_call.temp_size_in_bytes + of_call.output_size_in_bytes if of_call is not None else 0
    memory = scratch * len(lanes) + _bytes_of_chunks(plan)
    return "\n".join([
        f"memory    {_in_bytes(memory)} beside JAX itself, whatever the number of members",
        f"time      {duration(seconds)} on {len(lanes)} device{'s' if len(lanes) > 1 else ''}, and "
        f"{duration(max(first - call, 0.0))} to compile; {1e6 * seconds / plan.members:.3g} µs a member",
    ])  # fmt: skip


def sweep(
    what: Callable[[Any], Any] | Sequence[str],
    base: Any,
    axes: Mapping[str, Any],
    gradients: Sequence[str] = (),
    *,
    mode: str = "product",
    batch: int | None = None,
    devices: int | None = None,
    progress: Progress | None = None,
) -> Swept:
    """Compute a function of many scenes, all in memory; `difftrb.write_sweep` does the same into files.

    Args:
      what: names of outputs (`difftrb.sweeps.outputs.OUTPUTS`), or any function of a member that `jit` takes, returning
        an array or a dict of arrays; one called "status_code" is the member's status.
      base: a `Scene`; or, with a function, any tree of dataclasses, dicts and tuples.
      axes: values by dotted key, as in a scene file: {"spall.0.length": [1.0, 2.0], "load.axial": {"from": 4000.0,
        "to": 9000.0, "count": 64, "spacing": "log"}}.
      gradients: keys by which every result is differentiated, whether an axis or not; forward mode.
      mode: "product", all combinations, the last axis changing fastest; "zip", side by side.
      batch: members computed at once. Default: by the number of members and the platform. Give 1 for a function that
        chooses by `lax.cond` or iterates very differently from member to member, such as `solve_contact`.
      devices: how many of this process, or on a CPU how many threads. Default all.
      progress: told how many of how many members are done.

    The law of a scene is made once for all members; "auto" is "table" here (`shared_law.with_shared_law`). A member
    without a solution is NaN, its status says why. Raises `SweepError` for axes, keys or names that cannot be, for ends
    of axes that no scene may have, for more than 1e12 members, and before anything is computed if the results do not
    fit into free memory; `SceneError` for a scene that `solve` would refuse.
    """
    plan = plan_sweep(what, base, axes, gradients, mode, batch)
    _check_memory(plan)
    columns = {name: np.empty((plan.members, *shape.shape), shape.dtype) for name, shape in plan.shapes.items()}
    program, done = Program(plan, lanes_of(devices)), 0
    with contextlib.closing(program.in_turn(lambda chunk: (chunk, program.chunk(chunk)), range(plan.chunks))) as ended:
        for chunk, found in ended:
            members = plan.grid.members(chunk)
            done += len(members)
            for name, array in found.items():
                columns[name][members.start : members.stop] = array
            if progress is not None:
                progress(done, plan.members)
    return labelled(manifest_of(plan), coordinates_of(plan), columns)
