"""Results of a sweep: arrays with labels."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from difftrb.core import status
from difftrb.sweeps.outputs import STATUS


def column_of(name: str, by: str | None = None) -> str:
    """Name under which a result, or its derivative by a key, is stored."""
    return name if by is None else f"{name}_by_{by}"


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
        variables = {}
        for name, value in self.values.items():
            own = (*self.dims, *self.own_dims[name])
            variables[name] = own, value, {"units": self.units.get(name, "")}
            for key, slope in self.gradients[name].items():
                unit = {"units": self.units.get(column_of(name, key), "")}
                variables[column_of(name, key)] = own, slope, unit
        variables[STATUS] = self.dims, self.status_code
        coordinates = {key: (dim[key], values, {"units": self.units.get(key, "")})
                       for key, values in self.coordinates.items()}  # fmt: skip
        return xarray.Dataset(variables, coordinates)


def counted(codes: Mapping[int, int]) -> dict[str, int]:
    """Counts by the sentence of the status, the most frequent first."""
    return {status.describe(code): count for code, count in sorted(codes.items(), key=lambda item: -item[1])}
