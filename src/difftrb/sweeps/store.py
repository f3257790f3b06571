"""Where a sweep is kept: a Zarr store, in a folder or behind a URL; without zarr, a folder of .npz files.

What a chunk holds is written before its status: where that is, the chunk is done. Checksums tell what is damaged. So
after any interruption the store says what is left to do, to any number of processes that know nothing of each other.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, wraps
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from difftrb.core import storage
from difftrb.core.status import SweepError
from difftrb.sweeps.boxes import Grid
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.swept import Swept, labelled, labels, stored

MANIFEST, AXES, ZARR = "manifest.json", "axes.npz", "sweep.zarr"
"""Names in a folder: of what is swept and the axes' values beside .npz files; of the Zarr store."""
RESUME, INSTALL = "go on with --resume", "pip install 'difftrb[io]'"
INNER = 16
"""Parts of a chunk, at most, that can be read alone; each has a checksum."""


class Npz:
    """A folder: a file for every chunk, named after its number, with the sweep's identity; manifest and axes.

    Attributes (of both kinds of store):
      where: the folder or URL. about: the sweep's manifest, empty where nothing is. identity: whose it is.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.where, self.about = folder, str(folder), {}
        with contextlib.suppress(OSError):
            self.about = _parsed((folder / MANIFEST).read_bytes())
        self.identity: str | None = self.about.get("identity")

    def begin(self, about: dict[str, Any], coordinates: storage.Arrays) -> None:
        """Write what is beside the chunks."""
        self.about = about
        storage.write(self.folder / AXES, coordinates)
        with storage.replacing(self.folder / MANIFEST) as scratch:
            scratch.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        storage.remove_leftovers(self.folder, f"*-*{storage.SCRATCH}")

    def coordinates(self) -> storage.Arrays:
        """Values of every key."""
        return storage.read(self.folder / AXES) or {}

    def _path(self, chunk: int) -> Path:
        return self.folder / f"chunk_{chunk:06d}.npz"

    def listed(self) -> list[int]:
        """Chunks that are there; damaged ones count."""
        names = (path.stem.removeprefix("chunk_") for path in self.folder.glob("chunk_*.npz"))
        return [int(name) for name in names if name.isdigit()]

    def has(self, chunk: int) -> bool:
        """Whether a chunk is there."""
        return self._path(chunk).exists()

    def read(self, chunk: int) -> storage.Arrays | None:
        """A chunk's columns, shape (members, …); None if it is missing, damaged or another sweep's."""
        found, whose = storage.read(self._path(chunk)) or {}, (self.about["identity"], chunk)
        return found if (str(found.pop("identity", "")), int(found.pop("chunk", -1))) == whose else None

    def write(self, chunk: int, columns: Mapping[str, np.ndarray]) -> None:
        """Write a chunk, whole or not at all."""
        extra = {"identity": np.array(self.about["identity"]), "chunk": np.array(chunk)}
        storage.write(self._path(chunk), {**columns, **extra})


def _told(method: Any) -> Any:
    """What a bucket's library raises becomes an `OSError`."""

    @wraps(method)
    def told(self: Zarr, *given: Any) -> Any:
        try:
            return method(self, *given)
        except (OSError, ImportError, ValueError):
            raise
        except Exception as error:
            if not self.remote:
                raise
            raise OSError(str(error).splitlines()[0] if str(error) else type(error).__name__) from error

    return told


def _ask(coroutine: Any) -> Any:
    """What a Zarr store answers."""
    from zarr.core.sync import sync

    return sync(coroutine)


class Zarr:
    """A Zarr v3 store: an array with named dimensions and units for every key and column, a shard for every chunk."""

    @_told
    def __init__(self, where: str) -> None:
        from zarr.storage import FsspecStore, LocalStore

        self.where, self.remote = where, "://" in where
        try:
            self._store: Any = FsspecStore.from_url(where) if self.remote else LocalStore(where, read_only=True)
        except ValueError as error:
            raise SweepError(f"{where}: {error}") from None
        texts = [self._get(key) or b"" for key in ("zarr.json", f"{STATUS}/zarr.json")]
        root, ledger = (_parsed(text).get("attributes", {}) for text in texts)
        self.about = _parsed(root.get("manifest", "{}"))
        self.identity: str | None = root.get("identity", ledger.get("identity"))  # of a damaged store, too

    def _get(self, key: str) -> bytes | None:
        from zarr.core.buffer import default_buffer_prototype

        try:
            found = _ask(self._store.get(key, default_buffer_prototype()))
        except FileNotFoundError:  # there is no folder
            return None
        return None if found is None else found.to_bytes()

    def _arrays(self, names: Iterable[str]) -> dict[str, Any]:
        """Of keys or columns; chunks without a number, too, are written."""
        import zarr

        with zarr.config.set({"array.write_empty_chunks": True}):
            mode = "r" if self._store.read_only else "r+"
            group = zarr.open_group(self._store, mode=mode, use_consolidated=False)
            return {name: group[stored(name)] for name in names}

    @cached_property
    def _columns(self) -> dict[str, Any]:
        return self._arrays(self.about["columns"])

    @_told
    def coordinates(self) -> storage.Arrays:
        """Values of every key."""
        arrays = self._arrays(key for axis in self.about["axes"] for key in axis["keys"])
        return {key: np.asarray(array) for key, array in arrays.items()}

    @_told
    def begin(self, about: dict[str, Any], coordinates: storage.Arrays) -> None:
        """Write what is beside the chunks, where it is not there: all processes write the same."""
        self.about = about
        self._store = self._store if self.remote else self._store.with_read_only(False)
        made = _descriptions(about, coordinates)
        for key in sorted(made, key=len, reverse=True):
            if self._get(key) != made[key].to_bytes():
                _ask(self._store.set(key, made[key]))
        if not self.remote:
            storage.remove_leftovers(Path(self.where), "*.partial")

    def _key(self, name: str, chunk: int) -> str:
        """Of a chunk's shard."""
        place = grid_of(self.about).place(chunk) + [0] * len(self.about["columns"][name]["shape"])
        return f"{stored(name)}/c/{'/'.join(map(str, place))}"

    @_told
    def listed(self) -> list[int]:
        """Chunks that are there; damaged ones count."""

        async def keys() -> list[str]:
            return [key async for key in self._store.list_prefix(f"{STATUS}/c/")]

        boxes = grid_of(self.about).boxes
        places = [key.split("/")[2:] for key in _ask(keys())]
        return [int(np.ravel_multi_index([int(number) for number in place], boxes)) for place in places
                if len(place) == len(boxes) and all(number.isdigit() for number in place)]  # fmt: skip

    @_told
    def has(self, chunk: int) -> bool:
        """Whether a chunk is there."""
        return _ask(self._store.exists(self._key(STATUS, chunk)))

    @_told
    def read(self, chunk: int) -> storage.Arrays | None:
        """A chunk's columns, shape (members, …); None if it is missing or damaged."""
        box, found = grid_of(self.about).slices(chunk), {}
        for name, array in self._columns.items():
            try:
                if not _ask(self._store.getsize(self._key(name, chunk))):  # read as if it were not there
                    return None
                values = array[box]
            except (FileNotFoundError, ValueError):  # the latter of a checksum, or a length
                return None
            found[name] = values.reshape(-1, *values.shape[len(box) :])
        return found

    @_told
    def write(self, chunk: int, columns: Mapping[str, np.ndarray]) -> None:
        """Write a chunk, its status last."""
        box = grid_of(self.about).slices(chunk)
        sizes = [part.stop - part.start for part in box]
        for name in sorted(columns, key=lambda name: name == STATUS):
            values = columns[name].reshape(*sizes, *columns[name].shape[1:])
            try:
                self._columns[name][box] = values
            except ValueError:  # zarr reads a shard before it writes it, and this one is damaged
                _ask(self._store.delete(self._key(name, chunk)))
                self._columns[name][box] = values


def _descriptions(about: dict[str, Any], coordinates: storage.Arrays) -> dict[str, Any]:
    """All of a Zarr store but its chunks: contents by key."""
    import zarr
    from zarr.codecs import Crc32cCodec
    from zarr.storage import MemoryStore

    made: dict[str, Any] = {}
    texts: dict[str, Any] = {name: about[name] for name in ("title", "scene", "identity")}
    texts["manifest"] = json.dumps(about)
    if any(len(axis["keys"]) > 1 for axis in about["axes"]):
        texts["coordinates"] = " ".join(map(stored, coordinates))
    group = zarr.create_group(MemoryStore(made), attributes=texts)
    dims, attributes = labels(about)
    for key, values in coordinates.items():
        group.create_array(stored(key), data=values, chunks=values.shape, compressors=[Crc32cCodec()],
                           dimension_names=dims[key], attributes=attributes[key])  # fmt: skip
    attributes[STATUS]["identity"] = about["identity"]
    grid = grid_of(about)
    inner = max(part for part in range(1, INNER + 1) if grid.shape[grid.split] % part == 0)
    parts = [size // inner if i == grid.split else size for i, size in enumerate(grid.shape)]
    for name, column in about["columns"].items():
        own, missing = tuple(column["shape"]), math.nan if column["dtype"] == "float64" else None
        group.create_array(stored(name), shape=(*grid.counts, *own), dtype=column["dtype"],
                           chunks=(*parts, *own), shards=(*grid.shape, *own), compressors=[Crc32cCodec()],
                           fill_value=-1 if name == STATUS else missing,
                           dimension_names=dims[name], attributes=attributes[name])  # fmt: skip
    return made


def grid_of(about: Mapping[str, Any]) -> Grid:
    """The chunks of a sweep with this manifest."""
    return Grid(tuple(axis["count"] for axis in about["axes"]), tuple(about["chunks"]["shape"]))


def done_in(store: Npz | Zarr) -> np.ndarray:
    """Which chunks are there, shape (chunks,); damaged ones count."""
    return np.isin(np.arange(grid_of(store.about).number), store.listed())


def swept_in(store: Npz | Zarr, places: Sequence[np.ndarray] | None = None) -> Swept:
    """Results in memory at some `places`, rising, of every axis; default all. Raises `SweepError` if they are not
    finished, or damaged."""
    if not store.about:
        raise SweepError(f"{store.where}: there is no sweep here, or its description is damaged")
    if places is None and not done_in(store).all():
        raise SweepError(f"{store.where}: the sweep is not finished; {RESUME}")
    grid, parts = grid_of(store.about), {name: [] for name in store.about["columns"]}
    places = [np.arange(count) for count in grid.counts] if places is None else places
    for at in product(*(np.unique(place // size) for place, size in zip(places, grid.shape, strict=True))):
        chunk = int(np.ravel_multi_index(at, grid.boxes))
        if (found := store.read(chunk)) is None:
            raise SweepError(f"{store.where}: chunk {chunk} is missing or damaged; {RESUME}")
        box = grid.slices(chunk)
        inside = np.ix_(*(place[slice(*np.searchsorted(place, (part.start, part.stop)))] - part.start
                          for place, part in zip(places, box, strict=True)))  # fmt: skip
        for name, array in found.items():
            shaped = array.reshape(*(part.stop - part.start for part in box), *array.shape[1:])
            parts[name].append(shaped[inside].reshape(-1, *array.shape[1:]))
    keys = [(key, place) for axis, place in zip(store.about["axes"], places, strict=True) for key in axis["keys"]]
    values = store.coordinates()
    columns = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return labelled(store.about, {key: values[key][place] for key, place in keys}, columns)


def _parsed(text: bytes | str) -> dict[str, Any]:
    """A JSON object; empty if it is none."""
    try:
        found = json.loads(text)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def has_zarr() -> bool:
    """Whether Zarr stores can be written here; an installation that is damaged, or too old, is none."""
    try:
        from zarr.storage import FsspecStore  # noqa: F401  # new in zarr 3
    except Exception:
        return False
    return True


def store_of(out: str | Path) -> Npz | Zarr:
    """The store in a folder or behind a URL: Zarr's, or .npz files where some are already, or zarr is not here."""
    out, remote = str(out), "://" in str(out)
    where = f"{out.rstrip('/')}/{ZARR}"
    if not remote and Path(out).exists() and not Path(out).is_dir():
        raise SweepError(f"{out}: is a file; name a folder")
    if not remote and (Path(out) / MANIFEST).exists():
        return Npz(Path(out))
    if has_zarr():
        return Zarr(where)
    if remote or Path(where).exists():
        raise SweepError(f"{where}: is read and written by zarr, which is not here; {INSTALL}")
    return Npz(Path(out))


def load_sweep(out: str | Path) -> Swept:
    """A finished sweep from its folder or URL, all in memory; `xarray.open_zarr` opens what is larger, or not finished.

    Raises `SweepError`.
    """
    try:
        return swept_in(store_of(out))
    except SweepError:
        raise
    except (OSError, ImportError) as error:
        raise SweepError(f"{out}: {getattr(error, 'strerror', None) or error}") from None
    except (ValueError, KeyError, TypeError):  # of descriptions or axes that were cut or changed
        raise SweepError(f"{out}: what describes the sweep is damaged; {RESUME}") from None
