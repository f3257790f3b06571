"""Results of a sweep: arrays with labels, and what is said about them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import Any, cast

import jax
import numpy as np

from difftrb.core import status
from difftrb.core.input_errors import shown
from difftrb.core.status import SweepError
from difftrb.law.base import Law
from difftrb.scene.scene import PitchMean, Scene
from difftrb.sweeps.blocks import Grid
from difftrb.sweeps.outputs import STATUS, label_of
from difftrb.sweeps.plan import Plan, column_of

FORMAT = 3
LISTED = 10_000
"""Values of an axis, at most, that are listed in a manifest."""
SHOWN = 500
"""Values of an axis in a figure, at most."""
OWN_NAMES = ("identity", "chunk", "file", "allow_pickle", "c", STATUS)
"""Names that results and keys cannot have: what stands beside them in files, and arguments of `np.savez`."""


@dataclasses.dataclass(frozen=True, repr=False)
class Swept:
    """Results of a sweep, with labels.

    Attributes:
      dims: names of the dimensions of all arrays: the axes' keys, or "member" for zipped axes.
      coordinates: values by key, shape (count,) each; those of zipped axes all lie along "member".
      values: by name, shape (counts of all axes…, own dimensions…); NaN where the member's status is not 0.
      gradients: derivatives of every value by name and then by key, of the same shape.
      status_code: of every member, see `difftrb.status`.
      units: by name and key. own_dims: names of the values' own dimensions.
      about: what was swept and with which versions, as it stands in a store.
    """

    dims: tuple[str, ...]
    coordinates: dict[str, np.ndarray]
    values: dict[str, np.ndarray]
    gradients: dict[str, dict[str, np.ndarray]]
    status_code: np.ndarray
    units: dict[str, str]
    own_dims: dict[str, tuple[str, ...]]
    about: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __repr__(self) -> str:
        """On a few lines: axes, values, and how members ended."""
        axes = " × ".join(f"{name} ({count})" for name, count in zip(self.dims, self.status_code.shape, strict=True))
        lines = [f"Swept: {axes}", f"  values: {', '.join(self.values)}"]
        by = next(iter(self.gradients.values()), {})
        lines += [f"  with gradients by {', '.join(by)}"] if by else []
        return "\n".join([*lines, *(f"  {count:,}: {sentence}" for sentence, count in self.counts.items())])

    @property
    def counts(self) -> dict[str, int]:
        """How many members ended with which status, by its sentence."""
        return counted(by_code(self.status_code))

    def to_xarray(self) -> Any:
        """An `xarray.Dataset`, as `xarray.open_zarr` gives it. Needs xarray: `pip install '.[io]'`."""
        import xarray  # pyright: ignore[reportMissingImports]

        columns = {STATUS: self.status_code} | self.values | {
            column_of(name, key): slope for name, slopes in self.gradients.items() for key, slope in slopes.items()
        }  # fmt: skip
        dims, attributes = labels(self.about)
        data, coordinates = ({stored(name): (dims[name], array, attributes[name]) for name, array in arrays.items()}
                             for arrays in (columns, self.coordinates))  # fmt: skip
        return xarray.Dataset(data, coordinates)


def parsed(text: bytes | str) -> dict[str, Any]:
    """A JSON object, such as a manifest; empty if it is none."""
    try:
        found = json.loads(text)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def grid_of(about: Mapping[str, Any]) -> Grid:
    """The chunks of a sweep with this manifest."""
    return Grid(tuple(axis["count"] for axis in about["axes"]), tuple(about["chunks"]["shape"]))


def keys_of(about: Mapping[str, Any]) -> list[str]:
    """Keys of all axes."""
    return [key for axis in about["axes"] for key in axis["keys"]]


def stored(name: str) -> str:
    """Name of a key or column in files and datasets: without dots, so that it is an attribute there."""
    return name.replace(".", "_")


def labels(about: Mapping[str, Any]) -> tuple[dict[str, tuple[str, ...]], dict[str, dict[str, Any]]]:
    """Of all coordinates and columns, by name, as datasets call them: dimensions, and attributes (unit, words)."""
    axes, units = tuple(stored(axis["name"]) for axis in about["axes"]), about["units"]
    dims: dict[str, tuple[str, ...]] = {}
    for axis in about["axes"]:
        dims |= dict.fromkeys(axis["keys"], (stored(axis["name"]),))
    attributes = {key: {"units": units.get(key, "")} for key in dims}
    for name, column in about["columns"].items():
        of, by = column["of"]
        dims[name] = (*axes, *column["dims"])
        attributes[name] = {"units": units.get(name, ""), "long_name": label_of(of) + (f" by {by}" if by else "")}
    codes = "; ".join(f"{code}: {text}" for code, text in about["statuses"].items())
    return dims, attributes | {STATUS: {"long_name": codes}}


def by_code(codes: np.ndarray) -> Counter[int]:
    """How many members have which status, of any shape."""
    each, members = np.unique(codes, return_counts=True)
    return Counter(dict(zip(each.tolist(), members.tolist(), strict=True)))


def counted(codes: Counter[int]) -> dict[str, int]:
    """Counts by the sentence of the status, the most frequent first."""
    return {status.describe(code): count for code, count in codes.most_common()}


def labelled(about: dict[str, Any], coordinates: dict[str, np.ndarray], columns: Mapping[str, np.ndarray]) -> Swept:
    """`Swept` of columns of all members of these coordinates, in their order, shape (members, …)."""
    counts = [len(coordinates[axis["keys"][0]]) for axis in about["axes"]]
    shaped = {name: array.reshape(*counts, *array.shape[1:]) for name, array in columns.items()}
    names = [name for name, column in about["columns"].items() if name != STATUS and column["of"][1] is None]
    return Swept(
        tuple(axis["name"] for axis in about["axes"]),
        coordinates,
        {name: shaped[name] for name in names},
        {name: {key: shaped[column_of(name, key)] for key in about["gradients"]} for name in names},
        shaped[STATUS],
        about["units"],
        {name: tuple(about["columns"][name]["dims"]) for name in names},
        about,
    )


def coordinates_of(plan: Plan) -> dict[str, np.ndarray]:
    """Values of every key, shape (count,)."""
    return {key: values for axis in plan.axes for key, values in zip(axis.keys, axis.values, strict=True)}


def manifest_of(plan: Plan) -> dict[str, Any]:
    """All about a sweep but its results: axes, columns, units, versions, law, chunks. The same in every process.

    Its identity is a digest of all the rest and of every number that goes in.
    """
    law = cast(Law, plan.base.law) if isinstance(plan.base, Scene) else None
    slopes = {column_of(name, key): (name, key) for name in plan.shapes for key in plan.gradients if name != STATUS}
    units = plan.units | {column: f"{plan.units.get(name) or '1'} per {plan.units.get(key) or '1'}"
                          for column, (name, key) in slopes.items() if column in plan.shapes}  # fmt: skip
    columns = {}
    for column, shape in plan.shapes.items():
        of, by = slopes.get(column, (column, None))
        dims = () if of == STATUS else plan.dims.get(of) or tuple(f"{of}_{i}" for i in range(len(shape.shape)))
        columns[column] = {"of": (of, by), "dims": dims, "shape": shape.shape, "dtype": str(shape.dtype)}
    about: dict[str, Any] = {
        "format": FORMAT,
        "scene": plan.text,
        "title": plan.title,
        "at": _at(plan),
        "axes": [{"name": axis.name, "keys": axis.keys, "count": axis.count}
                 | ({"values": axis.values.tolist()} if axis.count <= LISTED
                    else {"digest": hashlib.sha256(axis.values.tobytes()).hexdigest()}) for axis in plan.axes],
        "gradients": plan.gradients,
        "columns": columns,
        "units": units,
        "statuses": {str(code): sentence for code, sentence in status.SENTENCES.items()},
        "versions": {name: metadata.version(name) for name in ("difftrb", "jax", "jaxlib", "numpy")},
        "platform": jax.default_backend(),
        "law": law and {"name": law.name, "error": _number(law.error), "loads": [_number(v) for v in law.load_range]},
        "members": plan.members,
        "batch": plan.batch,
        "chunks": {"count": plan.chunks, "shape": plan.grid.shape, "block": plan.blocks.shape},
    }  # fmt: skip
    about = json.loads(json.dumps(about))  # as it comes back from disk
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    base = dataclasses.replace(plan.base, picked=None) if isinstance(plan.base, Scene) else plan.base  # it holds times
    digest.update(repr(jax.tree.structure(base)).encode())
    for leaf in jax.tree.leaves(base):
        is_number = isinstance(leaf, jax.Array | np.ndarray | float | int)
        digest.update(np.asarray(leaf, float).tobytes() if is_number else repr(leaf).encode())
    return about | {"identity": digest.hexdigest()}


def _at(plan: Plan) -> dict[str, Any]:
    """The loads and the phase that all members of a sweep of scenes have, by their keys: what figures say of it."""
    if not isinstance(plan.base, Scene):
        return {}
    load, phase = plan.base.load, plan.base.phase
    own = {"load.radial": _number(load.radial), "load.axial": _number(load.axial),
           "stiffness.phase": "mean" if isinstance(phase, PitchMean) else _number(phase)}  # fmt: skip
    moving = {key for axis in plan.axes for key in axis.keys}
    return {key: value for key, value in own.items() if key not in moving}


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def front(counts: Sequence[int]) -> list[np.ndarray]:
    """Places on every axis of what figures show: at most `SHOWN` on the first one or two with several values, the
    middle of others."""
    many = [i for i, count in enumerate(counts) if count > 1][:2]
    return [np.linspace(0, n - 1, min(n, SHOWN)).round().astype(int) if i in many else np.array([n // 2])
            for i, n in enumerate(counts)]  # fmt: skip


def check_names(about: Mapping[str, Any]) -> None:
    """Raise `SweepError` for names of results and keys that cannot stand in a file, or not beside each other."""
    keys = keys_of(about)
    columns = [name for name in about["columns"] if name != STATUS]
    for name in (*keys, *columns):
        if name in OWN_NAMES or not name.isprintable() or "/" in name or not name.strip("._"):
            raise SweepError(f"{shown(name)}: cannot be a name in a file, or has a meaning there; name it otherwise")
    taken: dict[str, str] = {}
    dims = sorted({dim for column in about["columns"].values() for dim in column["dims"]})
    for what, names in (("an axis", keys), ("a result", columns), ("a dimension of a result", dims)):
        for name in names:
            if stored(name) in taken:
                raise SweepError(f"{shown(name)}: {what} is named as {taken[stored(name)]}; name it otherwise")
            taken[stored(name)] = what
