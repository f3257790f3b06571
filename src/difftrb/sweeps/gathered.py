"""All of a sweep in one file: netCDF where h5netcdf and h5py are installed, else `.npz`; written chunk by chunk, read
whole."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from difftrb.core import storage
from difftrb.core.messages import shown
from difftrb.core.status import SweepError
from difftrb.sweeps.axes import ZIPPED
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.plan import Plan, own_dims
from difftrb.sweeps.sweep_result import Swept, column_of

MANIFEST = "manifest.json"
NETCDF, NPZ = WHOLE = "sweep.nc", "sweep.npz"
"""The file with everything, with xarray's netCDF and without."""
RESUME = "go on with --resume"
INSTALL = "pip install 'difftrb[io]'"
OWN_NAMES = ("identity", "first", "about", "file", "allow_pickle", STATUS)
"""What results and keys in files cannot be called: what stands beside them, and what `np.savez` calls its arguments."""
Pieces = Callable[..., Iterator[tuple[int, storage.Arrays]]]
"""From the start: the first member of every chunk and its columns, or those of the names that are given."""


def has_netcdf() -> bool:
    """Whether `sweep.nc` can be written here. h5netcdf alone cannot: it leaves h5py to who installs it."""
    try:
        import h5netcdf  # noqa: F401  # pyright: ignore[reportMissingImports]
        import h5py  # noqa: F401  # pyright: ignore[reportMissingImports]
    except Exception:  # a damaged or unfit installation raises whatever it meets
        return False
    return True


def check_names(plan: Plan) -> None:
    """Refuse results and keys of a function's own that cannot stand in a file, or not beside each other. Raises
    `SweepError`."""
    keys = [key for axis in plan.axes for key in axis.keys]
    dims = {dim for own in own_dims(plan).values() for dim in own}
    for name in (*keys, *(name for name in plan.shapes if name != STATUS)):
        if name in OWN_NAMES or not name.isprintable() or "/" in name or not name.strip("."):
            raise SweepError(f"{shown(name)}: cannot be a name in a file, or has a meaning there; name it otherwise")
    for name in plan.shapes:
        if name in keys:
            raise SweepError(f"{shown(name)}: this result is named as an axis; name it otherwise")
    for name in sorted(dims):
        if name in keys:
            raise SweepError(f"{shown(name)}: this axis is named as a dimension of a result; name it otherwise")


def write(
    plan: Plan, folder: Path, manifest: dict[str, Any], pieces: Pieces, netcdf: bool
) -> Iterator[tuple[Path, int, storage.Arrays]]:
    """Write `sweep.nc` (`netcdf`) or `sweep.npz` into `folder`; gives its name, and every one of the pieces once as it
    goes by.

    The file is there, whole, when all of them have gone by. Raises OSError, or ImportError without the packages.
    """
    path = folder / (NETCDF if netcdf else NPZ)
    with storage.replacing(path) as scratch:
        for first, found in (_netcdf if netcdf else _npz)(plan, scratch, manifest, pieces):
            yield path, first, found


class _Disk(io.FileIO):
    """A file whose writing never fails: what the disk refuses first is kept in `refused` for who asks by `check`.

    HDF5 ends the process by a segmentation fault when a write fails, so it is not told.
    """

    refused: OSError | None = None

    def write(self, data: Any, /) -> int:
        """All of it, or nothing that counts."""
        whole = memoryview(data).cast("B")
        try:
            left = whole
            while left:
                left = left[super().write(left) :]
        except OSError as error:
            self.refused = self.refused or error
        return len(whole)

    def truncate(self, size: int | None = None, /) -> int:
        """To `size` bytes."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.refused = self.refused or error
            return size or 0

    def check(self) -> None:
        """Raise what the disk refused."""
        if self.refused is not None:
            raise self.refused


def _npz(plan: Plan, path: Path, manifest: dict[str, Any], pieces: Pieces) -> Iterator[tuple[int, storage.Arrays]]:
    """Array after array, each put together from all chunks: never more than a chunk in memory."""
    with zipfile.ZipFile(path, "w", allowZip64=True) as file:
        small = {key: values for axis in plan.axes for key, values in zip(axis.keys, axis.values, strict=True)}
        for name, array in (small | {"about": np.array(json.dumps(manifest))}).items():
            with file.open(f"{name}.npy", "w") as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)
        for name, shape in plan.shapes.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                header = {"descr": np.lib.format.dtype_to_descr(np.dtype(shape.dtype)), "fortran_order": False,
                          "shape": (*plan.layout.counts, *shape.shape)}  # fmt: skip
                np.lib.format.write_array_header_1_0(entry, header)
                for first, found in pieces(None if name == STATUS else [name]):
                    entry.write(found[name].tobytes())
                    if name == STATUS:
                        yield first, found


def _netcdf(plan: Plan, path: Path, manifest: dict[str, Any], pieces: Pieces) -> Iterator[tuple[int, storage.Arrays]]:
    import h5netcdf  # pyright: ignore[reportMissingImports]

    units = manifest["units"]
    with _Disk(path, "w+") as disk:
        with h5netcdf.File(disk, "w") as file:
            file.dimensions = {axis.name: axis.count for axis in plan.axes}
            for axis in plan.axes:
                for key, values in zip(axis.keys, axis.values, strict=True):
                    variable = file.create_variable(key, (axis.name,), float, data=values)
                    variable.attrs["units"] = units.get(key, "")
            own = own_dims(plan)
            for name in plan.names:
                for dim, size in zip(own[name], plan.shapes[name].shape, strict=True):
                    if dim not in file.dimensions:
                        file.dimensions[dim] = size
            dims = tuple(axis.name for axis in plan.axes)
            for name in plan.names:
                for column in (name, *(column_of(name, key) for key in plan.gradients)):
                    variable = file.create_variable(column, (*dims, *own[name]), float, fillvalue=np.nan)
                    variable.attrs["units"] = units.get(column, "")
            variable = file.create_variable(STATUS, dims, np.int8)
            variable.attrs["long_name"] = "; ".join(f"{code}: {text}" for code, text in manifest["statuses"].items())
            for name in ("scene", "identity", "title"):
                file.attrs[name] = manifest[name]
            file.attrs["about"] = json.dumps({key: manifest[key] for key in ("versions", "platform", "law", "batch")})
            for first, found in pieces():
                for name, array in found.items():
                    start = 0
                    for part in _slabs(first, first + len(array), plan.layout.counts):
                        size = int(np.prod([s.stop - s.start for s in part]))
                        shape = (*(s.stop - s.start for s in part), *array.shape[1:])
                        file.variables[name][part] = array[start : start + size].reshape(shape)
                        start += size
                disk.check()
                yield first, found
        disk.check()


def _slabs(first: int, last: int, counts: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """The members `first` … `last` − 1, last axis fastest, as boxes of places, in their order."""
    if len(counts) == 1:
        if last > first:
            yield (slice(first, last),)
        return
    behind = int(np.prod(counts[1:]))
    (i, begun), (j, over) = divmod(first, behind), divmod(last, behind)
    if begun:
        for rest in _slabs(begun, over if i == j else behind, counts[1:]):
            yield slice(i, i + 1), *rest
        i += 1
    if j > i:
        yield slice(i, j), *(slice(0, count) for count in counts[1:])
    if over and j >= i:
        for rest in _slabs(0, over, counts[1:]):
            yield slice(j, j + 1), *rest


def _read(path: Path, identity: str) -> storage.Arrays | None:
    """What `write` wrote; None if it is damaged, or another sweep's. Raises `SweepError` without the packages."""
    if path.name == NPZ:
        found = storage.read(path)
        same = found is not None and json.loads(str(found.pop("about", "{}"))).get("identity") == identity
        return found if same else None
    if not has_netcdf():
        raise SweepError(f"{path}: is read by h5netcdf and h5py, which are not both here; {INSTALL}")
    import h5netcdf  # pyright: ignore[reportMissingImports]

    try:
        with h5netcdf.File(path, "r") as file:
            same = file.attrs.get("identity") == identity
            return {name: variable[...] for name, variable in file.variables.items()} if same else None
    except (OSError, RuntimeError, KeyError, ValueError):  # of a file cut or changed
        return None


def load_sweep(folder: str | Path) -> Swept:
    """A finished sweep, all in memory, from its `sweep.nc` or `sweep.npz` and its manifest. Raises `SweepError`."""
    folder = Path(folder)
    try:
        about = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        identity = about["identity"]
    except (OSError, ValueError, KeyError, TypeError):
        raise SweepError(f"{folder}: there is no sweep here, or its {MANIFEST} is damaged") from None
    there = [folder / name for name in reversed(WHOLE) if (folder / name).exists()]
    if not there:
        raise SweepError(f"{folder}: the sweep is not finished; {RESUME}")
    found = next((found for path in there if (found := _read(path, identity)) is not None), None)
    if found is None:
        raise SweepError(f"{there[0]}: is damaged, or another sweep's; {RESUME}")
    axes, outputs = about["axes"], about["outputs"]
    keys = [key for axis in axes for key in axis["keys"]]
    return Swept(
        tuple(axis["keys"][0] if len(axis["keys"]) == 1 else ZIPPED for axis in axes),
        {key: found[key] for key in keys},
        {name: found[name] for name in outputs},
        {name: {key: found[column_of(name, key)] for key in about["gradients"]} for name in outputs},
        found[STATUS],
        about["units"],
        {name: tuple(output["dims"]) for name, output in outputs.items()},
        about,
    )
