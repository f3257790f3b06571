"""Where a sweep is kept: a Zarr store, in a folder or behind a URL; without zarr, a folder of .npz files.

What a chunk holds is written before its status: where that is, the chunk is done. Checksums tell what is damaged. So
after any interruption the store says what is left to do, to any number of processes that know nothing of each other.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
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


class Store:
    """What both kinds have in common: a sweep's manifest, `about`, empty where nothing is; whose it is; its chunks."""

    where: str
    about: dict[str, Any]
    identity: str | None

    @cached_property
    def grid(self) -> Grid:
        """The chunks."""
        return Grid(tuple(axis["count"] for axis in self.about["axes"]), tuple(self.about["chunks"]["shape"]))

    def done(self) -> np.ndarray:
        """Which chunks are there, shape (chunks,); damaged ones count."""
        there = np.zeros(self.grid.number, bool)
        there[[chunk for chunk in self._listed() if chunk < len(there)]] = True
        return there

    def _listed(self) -> Iterator[int]:
        raise NotImplementedError

    def coordinates(self) -> storage.Arrays:
        """Values of every key."""
        raise NotImplementedError

    def read(self, chunk: int) -> storage.Arrays | None:
        """A chunk's columns, shape (members, …); None if it is missing or damaged."""
        raise NotImplementedError

    def swept(self, places: Sequence[np.ndarray] | None = None) -> Swept:
        """Results in memory at some `places`, rising, of every axis; default all. Raises `SweepError` if they are not
        finished, or damaged."""
        if not self.about:
            raise SweepError(f"{self.where}: there is no sweep here, or its description is damaged")
        if places is None and not self.done().all():
            raise SweepError(f"{self.where}: the sweep is not finished; {RESUME}")
        grid, parts = self.grid, {name: [] for name in self.about["columns"]}
        places = [np.arange(count) for count in grid.counts] if places is None else places
        for at in product(*(np.unique(place // size) for place, size in zip(places, grid.shape, strict=True))):
            chunk = int(np.ravel_multi_index(at, grid.boxes))
            if (found := self.read(chunk)) is None:
                raise SweepError(f"{self.where}: chunk {chunk} is missing or damaged; {RESUME}")
            box = grid.slices(chunk)
            inside = np.ix_(*(place[slice(*np.searchsorted(place, (part.start, part.stop)))] - part.start
                              for place, part in zip(places, box, strict=True)))  # fmt: skip
            for name, array in found.items():
                shaped = array.reshape(*(part.stop - part.start for part in box), *array.shape[1:])
                parts[name].append(shaped[inside].reshape(-1, *array.shape[1:]))
        keys = [(key, place) for axis, place in zip(self.about["axes"], places, strict=True) for key in axis["keys"]]
        values = self.coordinates()
        columns = {name: np.concatenate(arrays) for name, arrays in parts.items()}
        return labelled(self.about, {key: values[key][place] for key, place in keys}, columns)


class Npz(Store):
    """A folder: a file for every chunk, named after its number, with the sweep's identity; manifest and axes."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.where, self.about = folder, str(folder), {}
        with contextlib.suppress(OSError):
            self.about = _parsed((folder / MANIFEST).read_bytes())
        self.identity = self.about.get("identity")

    def begin(self, about: dict[str, Any], coordinates: storage.Arrays) -> None:
        """Write what is beside the chunks."""
        self.about = about
        storage.write(self.folder / AXES, coordinates)
        with storage.replacing(self.folder / MANIFEST) as scratch:
            scratch.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        storage.remove_leftovers(self.folder, f"*-*{storage.SCRATCH}")

    def coordinates(self) -> storage.Arrays:
        """See `Store.coordinates`."""
        return storage.read(self.folder / AXES) or {}

    def _path(self, chunk: int) -> Path:
        return self.folder / f"chunk_{chunk:06d}.npz"

    def _listed(self) -> Iterator[int]:
        names = (path.stem.removeprefix("chunk_") for path in self.folder.glob("chunk_*.npz"))
        return (int(name) for name in names if name.isdigit())

    def has(self, chunk: int) -> bool:
        """Whether a chunk is there."""
        return self._path(chunk).exists()

    def read(self, chunk: int) -> storage.Arrays | None:
        """See `Store.read`; None, too, for another sweep's."""
        found, whose = storage.read(self._path(chunk)) or {}, (self.about["identity"], chunk)
        if (str(found.pop("identity", "")), int(found.pop("chunk", -1))) != whose:
            return None
        members = len(self.grid.members(chunk))
        shapes = {name: (members, *column["shape"]) for name, column in self.about["columns"].items()}
        return found if {name: array.shape for name, array in found.items()} == shapes else None

    def write(self, chunk: int, columns: Mapping[str, np.ndarray]) -> None:
        """Write a chunk, whole or not at all."""
        extra = {"identity": np.array(self.about["identity"]), "chunk": np.array(chunk)}
        storage.write(self._path(chunk), {**columns, **extra})


class Zarr(Store):
    """A Zarr v3 store: an array with named dimensions and units for every key and column, a shard for every chunk."""

    def __init__(self, where: str) -> None:
        from zarr.storage import FsspecStore, LocalStore

        self.where, self.remote = where, "://" in where
        try:
            with self._told():
                self._store: Any = FsspecStore.from_url(where) if self.remote else LocalStore(where, read_only=True)
        except ValueError as error:
            raise SweepError(f"{where}: {error}") from None
        root, ledger = (_parsed(self._get(key) or b"").get("attributes", {})
                        for key in ("zarr.json", f"{STATUS}/zarr.json"))  # fmt: skip
        self.about = _parsed(root.get("manifest", "{}"))
        self.identity = root.get("identity", ledger.get("identity"))  # of a damaged store, too

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """What a bucket's library raises becomes an `OSError`."""
        try:
            yield
        except (OSError, ImportError, ValueError):
            raise
        except Exception as error:
            if not self.remote:
                raise
            raise OSError(str(error).splitlines()[0] if str(error) else type(error).__name__) from error

    def _ask(self, coroutine: Any) -> Any:
        """What the store answers."""
        from zarr.core.sync import sync

        with self._told():
            return sync(coroutine)

    def _get(self, key: str) -> bytes | None:
        from zarr.core.buffer import default_buffer_prototype

        try:
            found = self._ask(self._store.get(key, default_buffer_prototype()))
        except FileNotFoundError:  # there is no folder
            return None
        return None if found is None else found.to_bytes()

    def _opened(self, names: Iterable[str]) -> dict[str, Any]:
        """Arrays of keys or columns; chunks without a number, too, are written."""
        import zarr

        with self._told(), zarr.config.set({"array.write_empty_chunks": True}):
            mode = "r" if self._store.read_only else "r+"
            group = zarr.open_group(self._store, mode=mode, use_consolidated=False)
            return {name: group[stored(name)] for name in names}

    @cached_property
    def _arrays(self) -> dict[str, Any]:
        """By column."""
        return self._opened(self.about["columns"])

    def coordinates(self) -> storage.Arrays:
        """See `Store.coordinates`."""
        with self._told():
            opened = self._opened(key for axis in self.about["axes"] for key in axis["keys"])
            return {key: np.asarray(array) for key, array in opened.items()}

    def begin(self, about: dict[str, Any], coordinates: storage.Arrays) -> None:
        """Write what is beside the chunks, where it is not there: all processes write the same."""
        import zarr
        from zarr.codecs import Crc32cCodec
        from zarr.storage import MemoryStore

        self.about = about
        self._store = self._store if self.remote else self._store.with_read_only(False)
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
        shape, split = self.grid.shape, self.grid.split
        inner = max(part for part in range(1, INNER + 1) if shape[split] % part == 0)
        parts = (*shape[:split], shape[split] // inner, *shape[split + 1 :])
        for name, column in about["columns"].items():
            own, missing = tuple(column["shape"]), math.nan if column["dtype"] == "float64" else None
            group.create_array(stored(name), shape=(*self.grid.counts, *own), dtype=column["dtype"],
                               chunks=(*parts, *own), shards=(*shape, *own), compressors=[Crc32cCodec()],
                               fill_value=-1 if name == STATUS else missing,
                               dimension_names=dims[name], attributes=attributes[name])  # fmt: skip
        for key in sorted(made, key=len, reverse=True):
            if self._get(key) != made[key].to_bytes():
                self._ask(self._store.set(key, made[key]))
        if not self.remote:
            storage.remove_leftovers(Path(self.where), "*.partial")

    def _key(self, name: str, chunk: int) -> str:
        """Of a chunk's shard."""
        own = (0,) * len(self.about["columns"][name]["shape"])
        return f"{stored(name)}/c/{'/'.join(map(str, (*self.grid.place(chunk), *own)))}"

    def _listed(self) -> Iterator[int]:
        async def listed() -> list[str]:
            return [key async for key in self._store.list_prefix(f"{STATUS}/c/")]

        for key in self._ask(listed()):
            place = key.split("/")[2:]
            if all(number.isdigit() for number in place) and len(place) == len(self.grid.boxes):
                yield int(np.ravel_multi_index([int(number) for number in place], self.grid.boxes))

    def has(self, chunk: int) -> bool:
        """Whether a chunk is there."""
        return self._ask(self._store.exists(self._key(STATUS, chunk)))

    def read(self, chunk: int) -> storage.Arrays | None:
        """See `Store.read`."""
        box, found = self.grid.slices(chunk), {}
        for name, array in self._arrays.items():
            try:
                if not self._ask(self._store.getsize(self._key(name, chunk))):  # read as if it were not there
                    return None
                values = array[box]
            except (FileNotFoundError, ValueError):  # the latter of a checksum, or a length
                return None
            found[name] = values.reshape(-1, *values.shape[len(box) :])
        return found

    def write(self, chunk: int, columns: Mapping[str, np.ndarray]) -> None:
        """Write a chunk, its status last."""
        box = self.grid.slices(chunk)
        sizes = [part.stop - part.start for part in box]
        for name in sorted(columns, key=lambda name: name == STATUS):
            values = columns[name].reshape(*sizes, *columns[name].shape[1:])
            try:
                with self._told():
                    self._arrays[name][box] = values
            except ValueError:  # zarr reads a shard before it writes it, and this one is damaged
                self._ask(self._store.delete(self._key(name, chunk)))
                self._arrays[name][box] = values


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
        return store_of(out).swept()
    except SweepError:
        raise
    except (OSError, ImportError) as error:
        raise SweepError(f"{out}: {getattr(error, 'strerror', None) or error}") from None
    except (ValueError, KeyError, TypeError):  # of descriptions or axes that were cut or changed
        raise SweepError(f"{out}: what describes the sweep is damaged; {RESUME}") from None
