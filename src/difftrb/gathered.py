"""All of a sweep in one file: netCDF where h5netcdf is installed, else `.npz`; written chunk by chunk, read whole."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterator
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np

from difftrb import store
from difftrb.axes import ZIPPED, SweepError
from difftrb.outputs import STATUS
from difftrb.plan import Plan, own_dims
from difftrb.swept import Swept, column_of

MANIFEST = "manifest.json"
NETCDF, NPZ = WHOLE = "sweep.nc", "sweep.npz"
"""The file with everything, with xarray's netCDF and without."""
RESUME = "go on with --resume"
Pieces = Callable[..., Iterator[tuple[int, store.Arrays]]]
"""From the start: the first member of every chunk and its columns, or those of the names that are given."""


def write(
    plan: Plan, folder: Path, manifest: dict[str, Any], pieces: Pieces
) -> Iterator[tuple[Path, int, store.Arrays]]:
    """Write `sweep.nc` or `sweep.npz` into `folder`; gives its name, and every one of the pieces once as it goes by.

    The file is there, whole, when all of them have gone by.
    """
    to_netcdf = util.find_spec("h5netcdf") is not None
    path = folder / (NETCDF if to_netcdf else NPZ)
    with store.replacing(path) as scratch:
        for first, found in (_netcdf if to_netcdf else _npz)(plan, scratch, manifest, pieces):
            yield path, first, found


def _npz(plan: Plan, path: Path, manifest: dict[str, Any], pieces: Pieces) -> Iterator[tuple[int, store.Arrays]]:
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


def _netcdf(plan: Plan, path: Path, manifest: dict[str, Any], pieces: Pieces) -> Iterator[tuple[int, store.Arrays]]:
    import h5netcdf  # pyright: ignore[reportMissingImports]

    units = manifest["units"]
    with h5netcdf.File(path, "w") as file:
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
            yield first, found


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


def load_sweep(folder: str | Path) -> Swept:
    """A finished sweep, all in memory, from its `sweep.nc` or `sweep.npz` and its manifest. Raises `SweepError`."""
    folder = Path(folder)
    try:
        about = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise SweepError(f"{folder}: there is no sweep here, or its {MANIFEST} is damaged") from None
    if (folder / NPZ).exists():
        found = store.read(folder / NPZ)
    elif (folder / NETCDF).exists():
        import h5netcdf  # pyright: ignore[reportMissingImports]

        with h5netcdf.File(folder / NETCDF, "r") as file:
            found = {name: variable[...] for name, variable in file.variables.items()}
    else:
        raise SweepError(f"{folder}: the sweep is not finished; {RESUME}")
    if found is None:
        raise SweepError(f"{folder / 'sweep.npz'}: is damaged; {RESUME}")
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
