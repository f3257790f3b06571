"""A sweep in a Zarr v3 store, in a folder or behind a URL."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Mapping
from functools import cached_property, wraps
from pathlib import Path
from typing import Any

import numpy as np

from difftrb.core import storage
from difftrb.core.status import SweepError
from difftrb.sweeps.outputs import STATUS
from difftrb.sweeps.swept import grid_of, keys_of, labels, parsed, stored

INNER = 16
"""Parts of a chunk, at most, that can be read alone; each has a checksum."""


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


_OPENING = threading.Lock()
"""Zarr's settings are one for all threads: of two that open arrays at once, one would find them set back."""


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
        root, ledger = (parsed(text).get("attributes", {}) for text in texts)
        self.about = parsed(root.get("manifest", "{}"))
        self.identity: str | None = root.get("identity", ledger.get("identity"))  # of a damaged store, too

    def _get(self, key: str) -> bytes | None:
        from zarr.core.buffer import default_buffer_prototype

        try:
            found = _ask(self._store.get(key, default_buffer_prototype()))
        except FileNotFoundError:  # there is no folder
            return None
        return None if found is None else found.to_bytes()

    @cached_property
    def _arrays(self) -> dict[str, Any]:
        """By key or column; chunks without a number, too, are written: whatever opens an array keeps that setting."""
        import zarr

        with _OPENING, zarr.config.set({"array.write_empty_chunks": True}):
            mode = "r" if self._store.read_only else "r+"
            group = zarr.open_group(self._store, mode=mode, use_consolidated=False)
            return {name: group[stored(name)] for name in (*keys_of(self.about), *self.about["columns"])}

    @_told
    def coordinates(self) -> storage.Arrays:
        """Values of every key."""
        return {key: np.asarray(self._arrays[key]) for key in keys_of(self.about)}

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
        box, arrays, found = grid_of(self.about).slices(chunk), self._arrays, {}
        for name in self.about["columns"]:
            try:
                if not _ask(self._store.getsize(self._key(name, chunk))):  # read as if it were not there
                    return None
                values = arrays[name][box]
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
                self._arrays[name][box] = values
            except ValueError:  # zarr reads a shard before it writes it, and this one is damaged
                _ask(self._store.delete(self._key(name, chunk)))
                self._arrays[name][box] = values


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
