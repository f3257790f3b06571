"""Where a sweep is kept: a Zarr store, in a folder or behind a URL; without zarr, a folder of .npz files.

What a chunk holds is written before its status: where that is, the chunk is done. Checksums tell what is damaged. So
after any interruption the store says what is left to do, to any number of processes that know nothing of each other.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from difftrb.core import storage
from difftrb.core.status import SweepError
from difftrb.sweeps.swept import Swept, grid_of, labelled, parsed
from difftrb.sweeps.zarr_store import Zarr

MANIFEST, AXES, ZARR = "manifest.json", "axes.npz", "sweep.zarr"
"""Names in a folder: of what is swept and the axes' values beside .npz files; of the Zarr store."""
RESUME, INSTALL = "go on with --resume", "pip install '.[io]'"


class Npz:
    """A folder: a file for every chunk, named after its number, with the sweep's identity; manifest and axes.

    Attributes (of both kinds of store):
      where: the folder or URL. about: the sweep's manifest, empty where nothing is. identity: whose it is.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.where, self.about = folder, str(folder), {}
        with contextlib.suppress(OSError):
            self.about = parsed((folder / MANIFEST).read_bytes())
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
    values, axes = store.coordinates(), zip(store.about["axes"], places, strict=True)
    coordinates = {key: values[key][place] for axis, place in axes for key in axis["keys"]}
    return labelled(store.about, coordinates, {name: np.concatenate(arrays) for name, arrays in parts.items()})


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
