"""Results of a sweep: arrays with labels, in memory and in one file with everything.

The file is netCDF where h5netcdf and h5py are installed, else `.npz`. It is written chunk by chunk and read whole.
"""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from difftrb.core import status, storage
from difftrb.core.status import SweepError
from difftrb.sweeps.axes import ZIPPED
from difftrb.sweeps.outputs import STATUS, label_of
from difftrb.sweeps.plan import Plan, column_of

MANIFEST = "manifest.json"
NETCDF, NPZ = WHOLE = "sweep.nc", "sweep.npz"
"""Names of the file with everything, as netCDF and without it."""
RESUME = "go on with --resume"
INSTALL = "pip install 'difftrb[io]'"
Pieces = Callable[..., Iterator[tuple[int, storage.Arrays]]]
"""Begins anew at each call: the first member of every chunk and its columns, or those of the given names."""


@dataclasses.dataclass(frozen=True)
class Swept:
    """Results of a sweep, with labels.

    Attributes:
      dims: names of the dimensions of all arrays: the axes' keys, or "member" for zipped axes.
      coordinates: values by key, shape (count,) each; those of zipped axes all lie along "member".
      values: by name, shape (counts of all axes…, own dimensions…); NaN where the member's status is not 0.
      gradients: derivatives of every value by name and then by key, of the same shape.
      status_code: of every member, see `difftrb.status`.
      units: by name and key. own_dims: names of the values' own dimensions.
      about: what was swept and with which versions, as in `manifest.json`.
    """

    dims: tuple[str, ...]
    coordinates: dict[str, np.ndarray]
    values: dict[str, np.ndarray]
    gradients: dict[str, dict[str, np.ndarray]]
    status_code: np.ndarray
    units: dict[str, str]
    own_dims: dict[str, tuple[str, ...]]
    about: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def counts(self) -> dict[str, int]:
        """How many members ended with which status, by its sentence."""
        return counted(Counter(self.status_code.ravel().tolist()))

    def to_xarray(self) -> Any:
        """An `xarray.Dataset` with units, coordinates and status. Needs xarray: `pip install 'difftrb[io]'`."""
        import xarray  # pyright: ignore[reportMissingImports]

        dim = {key: key if key in self.dims else self.dims[0] for key in self.coordinates}
        variables: dict[str, Any] = {}
        for name, value in self.values.items():
            own = (*self.dims, *self.own_dims[name])
            variables[name] = own, value, _attributes(self.units, name)
            for key, slope in self.gradients[name].items():
                variables[column_of(name, key)] = own, slope, _attributes(self.units, name, key)
        variables[STATUS] = self.dims, self.status_code
        coordinates = {key: (dim[key], values, {"units": self.units.get(key, "")})
                       for key, values in self.coordinates.items()}  # fmt: skip
        return xarray.Dataset(variables, coordinates)


def _attributes(units: Mapping[str, str], name: str, by: str | None = None) -> dict[str, str]:
    """Unit and label of a result, or of its derivative by a key, as netCDF and xarray call them."""
    label = label_of(name) if by is None else f"{label_of(name)} by {by}"
    return {"units": units.get(column_of(name, by), ""), "long_name": label}


def counted(codes: Mapping[int, int]) -> dict[str, int]:
    """Counts by the sentence of the status, the most frequent first."""
    return {status.describe(code): count for code, count in sorted(codes.items(), key=lambda item: -item[1])}


def labelled(plan: Plan, columns: Mapping[str, np.ndarray], about: dict[str, Any] | None = None) -> Swept:
    """`Swept` of columns of all members, in their order."""

    def shaped(name: str) -> np.ndarray:
        return columns[name].reshape(*plan.layout.counts, *columns[name].shape[1:])

    return Swept(
        tuple(axis.name for axis in plan.axes),
        _coordinates(plan),
        {name: shaped(name) for name in plan.names},
        {name: {key: shaped(column_of(name, key)) for key in plan.gradients} for name in plan.names},
        shaped(STATUS),
        plan.all_units,
        plan.own_dims,
        about or {},
    )


def _coordinates(plan: Plan) -> dict[str, np.ndarray]:
    """Values of every key, shape (count,)."""
    return {key: values for axis in plan.axes for key, values in zip(axis.keys, axis.values, strict=True)}


# ------------------------------------------------------------------------------------------------ one file


def has_netcdf() -> bool:
    """Whether `sweep.nc` can be written here; it needs h5netcdf and h5py, which h5netcdf does not install."""
    try:
        import h5netcdf  # noqa: F401  # pyright: ignore[reportMissingImports]
        import h5py  # noqa: F401  # pyright: ignore[reportMissingImports]
    except Exception:  # a damaged or unfit installation raises whatever it meets
        return False
    return True


def write(
    plan: Plan, folder: Path, manifest: dict[str, Any], pieces: Pieces, netcdf: bool
) -> Iterator[tuple[Path, int, storage.Arrays]]:
    """Write `sweep.nc` (`netcdf`) or `sweep.npz` into `folder`; gives its path and every piece once, while it writes.

    The file is there, whole, after the last piece. Raises OSError, or ImportError without the packages.
    """
    path = folder / (NETCDF if netcdf else NPZ)
    with storage.replacing(path) as scratch:
        for first, found in (_netcdf if netcdf else _npz)(plan, scratch, manifest, pieces):
            yield path, first, found


class _Disk(io.FileIO):
    """A file whose writing never fails; `check` raises the first error of the disk.

    HDF5 ends the process by a segmentation fault when a write fails, so it is not told.
    """

    refused: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Write all, or keep the error."""
        whole = memoryview(data).cast("B")
        try:
            left = whole
            while left:
                left = left[super().write(left) :]
        except OSError as error:
            self.refused = self.refused or error
        return len(whole)

    def truncate(self, size: int | None = None, /) -> int:
        """Cut or extend to `size` bytes, or keep the error."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.refused = self.refused or error
            return size or 0

    def check(self) -> None:
        """Raise the error of the disk, if there was one."""
        if self.refused is not None:
            raise self.refused


def _npz(plan: Plan, path: Path, manifest: dict[str, Any], pieces: Pieces) -> Iterator[tuple[int, storage.Arrays]]:
    """Array after array, each put together from all chunks: never more than a chunk in memory."""
    with zipfile.ZipFile(path, "w", allowZip64=True) as file:
        for name, array in (_coordinates(plan) | {"about": np.array(json.dumps(manifest))}).items():
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

    with _Disk(path, "w+") as disk:
        with h5netcdf.File(disk, "w") as file:
            _declare(file, plan, manifest)
            for first, found in pieces():
                for name, array in found.items():
                    start = 0
                    for part in _slabs(first, first + len(array), plan.layout.counts):
                        sizes = [s.stop - s.start for s in part]
                        end = start + int(np.prod(sizes))
                        file.variables[name][part] = array[start:end].reshape(*sizes, *array.shape[1:])
                        start = end
                disk.check()
                yield first, found
        disk.check()


def _declare(file: Any, plan: Plan, manifest: dict[str, Any]) -> None:
    """Dimensions, variables and attributes of a netCDF file, with the coordinates' values."""
    file.dimensions = {axis.name: axis.count for axis in plan.axes}
    for axis in plan.axes:
        for key, values in zip(axis.keys, axis.values, strict=True):
            variable = file.create_variable(key, (axis.name,), float, data=values)
            variable.attrs["units"] = manifest["units"].get(key, "")
    own = plan.own_dims
    for name in plan.names:
        for dim, size in zip(own[name], plan.shapes[name].shape, strict=True):
            if dim not in file.dimensions:
                file.dimensions[dim] = size
    dims = tuple(axis.name for axis in plan.axes)
    for name in plan.names:
        for by in (None, *plan.gradients):
            variable = file.create_variable(column_of(name, by), (*dims, *own[name]), float, fillvalue=np.nan)
            variable.attrs.update(_attributes(manifest["units"], name, by))
    variable = file.create_variable(STATUS, dims, np.int8)
    variable.attrs["long_name"] = "; ".join(f"{code}: {text}" for code, text in manifest["statuses"].items())
    for name in ("scene", "identity", "title"):
        file.attrs[name] = manifest[name]
    file.attrs["about"] = json.dumps({key: manifest[key] for key in ("versions", "platform", "law", "batch")})


def _slabs(first: int, last: int, counts: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Members `first` … `last` − 1 as boxes of places, in their order."""
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
