"""A sweep on disk: one file per chunk, written whole or not at all, and at the end one file with everything.

`manifest.json` says what is swept and in which chunks. A chunk's file is named after its number, and holds the
manifest's identity. So after any interruption the files that are there say what is left to do.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np

from difftrb.core import status, storage
from difftrb.core.machine import lanes_of, wait
from difftrb.core.status import SweepError
from difftrb.law.base import Law
from difftrb.scene.scene import Scene
from difftrb.sweeps import gathered, sweeping
from difftrb.sweeps.axes import Axis
from difftrb.sweeps.gathered import MANIFEST, RESUME, WHOLE, Swept, counted, labelled
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.plan import Plan, Program, check_names, front

FORMAT = 2
LISTED = 10_000
"""Values of an axis, at most, that are listed in the manifest."""


@dataclasses.dataclass(frozen=True)
class Ended:
    """What became of a sweep.

    Attributes:
      counts: members by the sentence of their status. computed: chunks that were computed now.
      file: with all results. shown: those of `plan.front`. Both None in processes but the first.
    """

    counts: dict[str, int]
    computed: int
    file: Path | None = None
    shown: Swept | None = None

    @property
    def failed(self) -> int:
        """Members without a solution."""
        return sum(self.counts.values()) - self.counts.get(status.describe(status.CONVERGED), 0)

    def sentence(self, folder: Path | str) -> str:
        """All of it in words; results are in `folder`."""
        members = sum(self.counts.values())
        lines = [f"{members:,} members, {members - self.failed:,} converged, {self.failed:,} without a solution (NaN)"]
        lines += [f"{count:,}: {sentence}" for sentence, count in self.counts.items() if sentence != "converged"]
        lines.append(f"written to {folder}: {self.file.name if self.file else 'chunks'}, manifest.json, figures")
        return "\n".join(lines)


def manifest_of(plan: Plan, text: str = "") -> dict[str, Any]:
    """All about a sweep but its results: axes, units, versions, law, chunks. The same in every process.

    Its identity is a digest of all the rest and of every number that goes in. `text` is the scene file's.
    """
    law = cast(Law, plan.base.law) if isinstance(plan.base, Scene) else None
    dims = plan.own_dims
    about: dict[str, Any] = {
        "format": FORMAT,
        "scene": text,
        "title": plan.title,
        "axes": [{"keys": list(a.keys), "count": a.count, **_values(a)} for a in plan.axes],
        "gradients": list(plan.gradients),
        "outputs": {name: {"dims": dims[name], "shape": plan.shapes[name].shape} for name in plan.names},
        "units": plan.all_units,
        "statuses": {str(code): sentence for code, sentence in status.SENTENCES.items()},
        "versions": {name: metadata.version(name) for name in ("difftrb", "jax", "jaxlib", "numpy")},
        "platform": jax.default_backend(),
        "law": law and {"name": law.name, "error": _number(law.error), "loads": [_number(v) for v in law.load_range]},
        "members": plan.layout.members,
        "batch": plan.batch,
        "chunks": {"count": plan.chunks, "blocks": plan.chunk, "block": plan.layout.size, "first_file": _name(0)},
    }
    about = json.loads(json.dumps(about))  # as it comes back from disk
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    base = dataclasses.replace(plan.base, picked=None) if isinstance(plan.base, Scene) else plan.base  # it holds times
    digest.update(repr(jax.tree.structure(base)).encode())
    for leaf in jax.tree.leaves(base):
        is_number = isinstance(leaf, jax.Array | np.ndarray | float | int)
        digest.update(np.asarray(leaf, float).tobytes() if is_number else repr(leaf).encode())
    return about | {"identity": digest.hexdigest()}


def _values(axis: Axis) -> dict[str, Any]:
    """An axis's values, or a digest of long ones; the file with everything has them all."""
    digest = hashlib.sha256(axis.values.tobytes()).hexdigest()
    return {"values": axis.values.tolist()} if axis.count <= LISTED else {"digest": digest}


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _name(chunk: int) -> str:
    return f"chunk_{chunk:06d}.npz"


def run(
    plan: Plan,
    folder: Path,
    text: str = "",
    resume: bool = False,
    devices: int | None = None,
    progress: Callable[[int, int, int], None] | None = None,
    say: Callable[[str], None] | None = None,
) -> Ended:
    """Compute a sweep into `folder`: chunks, `manifest.json` and, at the end, `sweep.nc` or `sweep.npz`.

    Args:
      plan: from `sweeping.planned`. text: the scene file's, kept in the manifest.
      resume: go on with what is there; damaged files are made again. Without it a folder with a sweep is refused.
      devices: see `machine.lanes_of`.
      progress: told how many of how many members are done in this process, and how many of them have no solution.
      say: told sentences on what is made again.

    With `jax.distributed` every process writes its own chunks, the first one the rest. Raises `SweepError`: what is
    written stays, and stays good.
    """
    manifest = manifest_of(plan, text)
    netcdf, lanes = gathered.has_netcdf(), lanes_of(devices)  # known before anything is written
    _check(plan, folder, manifest, resume)
    wait("sweep: checked")
    mine = range(jax.process_index(), plan.chunks, jax.process_count())
    with _stays_good(folder, plan):
        _begin(folder, manifest)
        left, counts = _left(plan, folder, manifest, mine, say) if resume else (mine, Counter())
    of = plan.layout.members
    if jax.process_count() > 1:
        of = sum(last - first for first, last in map(plan.members, mine))

    def tell() -> None:
        if progress is not None:
            progress(counts.total(), of, counts.total() - counts[status.CONVERGED])

    tell()
    with _stays_good(folder, plan), contextlib.closing(Program(plan, lanes).all(left)) as columns:
        for chunk, found in columns:
            extra = {"identity": np.array(manifest["identity"]), "first": np.array(plan.members(chunk)[0])}
            storage.write(folder / _name(chunk), found | extra)
            counts.update(found[STATUS].tolist())
            tell()
    wait("sweep: computed")
    if jax.process_index():
        return Ended(counted(counts), len(left))
    with _stays_good(folder, plan):
        file, all_counts, shown = _gathered(plan, folder, manifest, netcdf)
    return Ended(counted(all_counts), len(left), file, shown)


def _check(plan: Plan, folder: Path, manifest: dict[str, Any], resume: bool) -> None:
    """Refuse a sweep that cannot be written into `folder`, before anything is computed."""
    check_names(plan)
    _refuse_others(folder, manifest, resume)
    sweeping.check_chunks(plan)
    with _stays_good(folder, plan):
        sweeping.check_disk(plan, folder, _there(folder) if resume else 0)


def _begin(folder: Path, manifest: dict[str, Any]) -> None:
    """Write the manifest, in the first process, and remove this process's files that were left half written."""
    if jax.process_index() == 0:
        folder.mkdir(parents=True, exist_ok=True)
        with storage.replacing(folder / MANIFEST) as scratch:
            scratch.write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    for name, scratch in storage.leftovers(folder):
        chunk = re.fullmatch(r"chunk_(\d+)\.npz", name)
        owner = int(chunk[1]) % jax.process_count() if chunk else 0 if name in (MANIFEST, *WHOLE) else None
        if owner == jax.process_index():
            scratch.unlink()


def _left(
    plan: Plan, folder: Path, manifest: dict[str, Any], mine: Sequence[int], say: Callable[[str], None] | None
) -> tuple[list[int], Counter]:
    """Of the chunks `mine` those that are missing or damaged, and the members of the others by status."""
    left, counts = [], Counter()
    for chunk in mine:
        path = folder / _name(chunk)
        if (found := _read_chunk(path, plan, manifest, chunk)) is not None:
            counts.update(found[STATUS].tolist())
            continue
        if path.exists() and say is not None:
            say(f"{path} is damaged: computed again")
        left.append(chunk)
    return left, counts


def _gathered(plan: Plan, folder: Path, manifest: dict[str, Any], netcdf: bool) -> tuple[Path, Counter, Swept]:
    """Path of the file with everything, the members by status, and the results along the first one or two axes."""

    def pieces(names: Sequence[str] | None = None) -> Iterator[tuple[int, storage.Arrays]]:
        for chunk in range(plan.chunks):
            found = _read_chunk(folder / _name(chunk), plan, manifest, chunk, names)
            if found is None:
                raise SweepError(f"{folder / _name(chunk)}: is missing or damaged; {RESUME}")
            yield plan.members(chunk)[0], found

    plane, members = front(plan)
    file, counts, taken = folder, Counter(), {name: [] for name in plan.shapes}
    for file, first, found in gathered.write(plan, folder, manifest, pieces, netcdf):  # noqa: B007
        counts.update(found[STATUS].tolist())
        low, high = np.searchsorted(members, (first, first + len(found[STATUS])))
        for name, array in found.items():
            taken[name].append(array[members[low:high] - first])
    return file, counts, labelled(plane, {name: np.concatenate(arrays) for name, arrays in taken.items()}, manifest)


def _there(folder: Path) -> int:
    """Number of chunks in a folder, which need not exist; damaged ones count."""
    return sum(1 for _ in folder.glob("chunk_*.npz"))


@contextlib.contextmanager
def _stays_good(folder: Path, plan: Plan) -> Iterator[None]:
    """Errors of the disk, and of packages that are gone, become a `SweepError` that says what is written."""
    try:
        yield
    except (OSError, ImportError) as error:
        there = _there(folder)
        mend = gathered.INSTALL if isinstance(error, ImportError) else "make room or allow writing there"
        what = f"{there} of {plan.chunks} chunks are written and stay good; {mend}, and {RESUME}"
        named = str(getattr(error, "filename", None) or storage.SCRATCH)
        where = folder if named.endswith(storage.SCRATCH) else named
        why = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise SweepError(f"{where}: {why}: {what if there else 'nothing is written'}") from None


def _refuse_others(folder: Path, manifest: dict[str, Any], resume: bool) -> None:
    """Refuse a folder with another sweep and, unless it is resumed, with this one."""
    path = folder / MANIFEST
    if folder.exists() and not folder.is_dir():
        raise SweepError(f"{folder}: is a file; name a folder")
    if path.exists() and not resume:
        raise SweepError(f"{folder}: holds a sweep already; {RESUME}, or name another folder")
    try:
        theirs = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        theirs = {}
    if not isinstance(theirs, dict) or not theirs or theirs.get("identity") == manifest["identity"]:
        return  # a missing or damaged one is written again: chunks hold their identity, too
    words = {"scene": "of another scene file", "axes": "over other axes", "outputs": "of other outputs",
             "gradients": "with other gradients", "versions": "with other versions of difftrb, jax or numpy",
             "platform": "on another platform", "batch": "with another batch"}  # fmt: skip
    what = next((words[key] for key in words if theirs.get(key) != manifest[key]), "of a scene with other numbers")
    raise SweepError(f"{folder}: the sweep there is {what}; undo the change, or name another folder")


def _read_chunk(
    path: Path, plan: Plan, manifest: dict[str, Any], chunk: int, names: Sequence[str] | None = None
) -> storage.Arrays | None:
    """A chunk's columns (or those of `names`); None if it is missing, damaged, or another sweep's."""
    found = storage.read(path, None if names is None else [*names, "identity", "first"])
    first, last = plan.members(chunk)
    if found is None or str(found.pop("identity", "")) != manifest["identity"] or found.pop("first", -1) != first:
        return None
    fits = found.keys() == set(plan.shapes if names is None else names) and all(
        array.shape == (last - first, *plan.shapes[name].shape) for name, array in found.items()
    )
    return found if fits else None


def write_sweep(
    what: Callable[[Any], Any] | Sequence[str],
    base: Any,
    axes: Mapping[str, Any],
    folder: str | Path,
    gradients: Sequence[str] = (),
    *,
    mode: str = "product",
    batch: int | None = None,
    resume: bool = False,
    devices: int | None = None,
    progress: Callable[[int, int, int], None] | None = None,
) -> Ended:
    """`sweep` into files, with memory that does not grow with the number of members; `load_sweep` reads them.

    Arguments as in `sweep` and `run`. A function is known by its name: one that was changed needs another name, or
    another folder. Raises `SweepError` as these do, and before anything is computed if chunks and the file with
    everything, together about twice the results, do not fit into what is free in `folder`.
    """
    return run(sweeping.planned(what, base, axes, gradients, mode, batch), Path(folder), "", resume, devices, progress)
