"""Measured height maps of a damaged raceway: the grid, reading it, and its height anywhere."""

from __future__ import annotations

import dataclasses
import zipfile
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.files import unreadable
from difftrb.geometry import Real

PITCH = (1e-5, 10.0)
"""Least and largest distance of a map's points [mm]."""
HIGHEST = 10.0
"""Largest height or depth of a map [mm]."""
KEYS = ("height", "pitch_x", "pitch_y")


class HeightMapError(ValueError):
    """A height map that cannot be used; the message is one sentence."""


@dataclasses.dataclass(frozen=True)
class HeightMap:
    """A measured patch of raceway, put where a spall can be. Bilinear between its points; beyond its outermost ones it
    falls to the raceway's height, 0, within one pitch.

    Attributes:
      height: of the surface over the undamaged raceway [mm], negative is below, −10…10; shape (rows along the roller,
        columns along the rolling direction), at least 2 × 2, row 0 at the lowest y.
      pitch_x: distance of its columns [mm], 1e-5…10. pitch_y: distance of its rows [mm], 1e-5…10.
      axial_offset: of its middle from the roller's middle, along the roller [mm], default 0.
      angle: of its middle from the load line [rad], default 0.
      surface: "outer" (default) or "inner" raceway, or "roller".
    """

    height: jax.Array
    pitch_x: Real
    pitch_y: Real
    axial_offset: Real = 0.0
    angle: Real = 0.0
    surface: Literal["outer", "inner", "roller"] = dataclasses.field(default="outer", metadata={"static": True})

    @property
    def extent(self) -> tuple[Real, Real]:
        """Distance of its outermost points along the roller and in the rolling direction [mm]."""
        rows, columns = self.height.shape
        return (rows - 1) * self.pitch_y, (columns - 1) * self.pitch_x


jax.tree_util.register_dataclass(HeightMap)


def height_at(measured: HeightMap, offset: Real, x: jax.Array, y: jax.Array) -> jax.Array:
    """Height [mm] at all pairs of `y`, shape (n,), and `x`, shape (m,) [mm]: shape (n, m).

    `offset` is the distance of the map's middle from the contact's in the rolling direction [mm]. Differentiable by
    everything; at a point of the map the slope is the mean of both sides.
    """
    height = jnp.asarray(measured.height, float)
    rows, columns = height.shape
    along = _hats(y - measured.axial_offset, rows, measured.pitch_y)
    across = _hats(x - offset, columns, measured.pitch_x)
    return along @ height @ across.T


def _hats(distance: jax.Array, count: int, pitch: Real) -> jax.Array:
    """Weights of `count` points about 0 at a `distance` from it: shape (distances, count)."""
    place = distance / pitch + 0.5 * (count - 1)
    away = place[:, None] - jnp.arange(count)[None, :]
    return jnp.maximum(jnp.minimum(1.0 - away, 1.0 + away), 0.0)  # not by |away|, whose slope at 0 is 1 in JAX


def height_map_is_sound(measured: HeightMap) -> jax.Array:
    """Whether all numbers of a map are finite, and its pitches positive."""
    pitches = jnp.stack([jnp.asarray(v, float) for v in (measured.pitch_x, measured.pitch_y)])
    finite = jnp.all(jnp.isfinite(jnp.asarray(measured.height, float)))
    return finite & jnp.all(pitches > 0.0) & jnp.isfinite(jnp.sum(pitches) + measured.angle + measured.axial_offset)


def load_height_map(
    path: str | Path,
    axial_offset: Real = 0.0,
    angle: Real = 0.0,
    surface: Literal["outer", "inner", "roller"] = "outer",
) -> HeightMap:
    """Read a map from a file; lengths in mm. `axial_offset`, `angle`, `surface` as in `HeightMap`.

    `.npz`: arrays `height` (rows along the roller, columns along the rolling direction), `pitch_x`, `pitch_y`.
    `.csv`: one row of the map a line, commas between its heights, after comments `# pitch_x = …`, `# pitch_y = …`.
    HeightMapError (a ValueError) says in one sentence what is wrong with the file.
    """
    path = Path(path)
    readers = {".npz": _read_npz, ".csv": _read_csv}
    if path.suffix.lower() not in readers:
        raise HeightMapError(f"{path}: must be a file .npz or .csv")
    try:
        content = readers[path.suffix.lower()](path)
    except (OSError, UnicodeDecodeError) as error:
        raise HeightMapError(f"{path}: {unreadable(error, 'a height map')}") from None
    height, pitch_x, pitch_y = _checked(content, path)
    return HeightMap(jnp.asarray(height), pitch_x, pitch_y, axial_offset, angle, surface)


def example_map(name: str = "spall_map.npz") -> Path:
    """Where a packaged map lies; HeightMapError if there is none of that name."""
    folder = Path(str(resources.files("difftrb"))) / "scenes"
    if Path(name).name != name or not (folder / name).is_file():
        raise HeightMapError(f"{name}: there is no such file")
    return folder / name


def _read_npz(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except (zipfile.BadZipFile, EOFError, ValueError, AttributeError):
        raise HeightMapError(f"{path}: is not an npz file of plain arrays; write it with numpy.savez") from None


def _read_csv(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = {}
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if line.lstrip().startswith("#"):
            key, equals, value = line.lstrip("# \t").partition("=")
            if equals and key.strip() in KEYS:
                content[key.strip()] = value.strip()
        elif line.strip():
            try:
                rows.append([float(entry) for entry in line.split(",")])
            except ValueError:
                raise HeightMapError(
                    f"{path}: line {number} holds no number; write heights [mm] with commas between"
                ) from None
            if len(rows[-1]) != len(rows[0]):
                raise HeightMapError(
                    f"{path}: line {number} has {len(rows[-1])} heights, the first row {len(rows[0])}; "
                    "give all rows the same number"
                )
    return content | {"height": np.array(rows)}


def _checked(content: dict[str, Any], path: Path) -> tuple[np.ndarray, float, float]:
    """Heights and pitches of a file; refuses what cannot be a map."""
    for key in KEYS:
        if key not in content:
            how = f"a comment '# {key} = …' [mm]" if path.suffix.lower() == ".csv" else f"an array {key!r} [mm]"
            raise HeightMapError(f"{path}: {key} is missing: give {how}")
    pitches = []
    for key in KEYS[1:]:
        try:
            pitch = float(content[key])
        except (TypeError, ValueError):
            pitch = float("nan")
        if not PITCH[0] <= pitch <= PITCH[1]:
            shown = str(content[key])[:40]
            raise HeightMapError(f"{path}: {key} = {shown}: must be a number in {PITCH[0]:g} … {PITCH[1]:g} mm")
        pitches.append(pitch)
    height = np.asarray(content["height"])
    if height.dtype.kind not in "fiu":
        raise HeightMapError(f"{path}: height holds {height.dtype}, not numbers: give heights [mm]")
    if height.ndim != 2 or min(height.shape) < 2:
        raise HeightMapError(f"{path}: height has shape {height.shape}: must be a grid of at least 2 × 2 points")
    height = height.astype(float)
    bad = np.argwhere(~np.isfinite(height))
    if bad.size:
        row, column = bad[0]
        raise HeightMapError(
            f"{path}: height[{row}, {column}] = {height[row, column]} ({len(bad)} such points): must be finite; "
            "fill what was not measured"
        )
    if np.abs(height).max() > HIGHEST:
        row, column = np.unravel_index(np.abs(height).argmax(), height.shape)
        raise HeightMapError(
            f"{path}: height[{row}, {column}] = {height[row, column]:g}: must be in {-HIGHEST:g} … {HIGHEST:g} mm"
        )
    if height.min() == height.max():
        raise HeightMapError(f"{path}: height is {height[0, 0]:g} mm everywhere: a map must not be constant")
    return height, pitches[0], pitches[1]
