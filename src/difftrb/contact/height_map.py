"""Measured height maps of a damaged raceway: the grid, reading it, and its height anywhere."""

from __future__ import annotations

import dataclasses
import io
import os
import zipfile
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from annotated_types import Interval, Unit

from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import Real, Spall
from difftrb.core.input_errors import named, opened, shown, text_of

PITCH = (1e-5, 10.0)
"""Least and largest distance of a map's points [mm]."""
HIGHEST = 10.0
"""Largest height or depth of a map [mm]."""
MOST = 4096
"""Most points of a map in either direction: four for every cell of the finest lattice along the roller."""
LARGEST = {".npz": 8 * MOST**2 + 100_000, ".csv": 64_000_000}
"""Bytes of a file that is read: all points of the largest map as they are, or 8 million as text."""
PART = 1_000_000
"""Bytes that are read of an .npz file at once."""
KEYS = ("height", "pitch_x", "pitch_y")
PLACES = 6
"""Within a map between which the phases of a mean are laid: of holes and rims the walls are kinks."""
OUTSIDE = 1e-3
"""Share of all that a map falls and rises along the rolling direction that counts as flat, at either end."""


class HeightMapError(status.DifftrbError, ValueError):
    """A height map that cannot be used; the message is one sentence."""


@dataclasses.dataclass(frozen=True)
class HeightMap:
    """A measured patch of raceway, put where a spall can be. Bilinear between its points; beyond its outermost ones it
    falls to the raceway's height, 0, within one pitch.

    Attributes:
      height: of the surface over the undamaged raceway [mm], negative is below, −10…10; shape (rows along the roller,
        columns along the rolling direction), 2 × 2 to 4096 × 4096, row 0 at the lowest y, column 0 at the smallest
        angle.
      pitch_x: distance of its columns [mm], 1e-5…10. pitch_y: distance of its rows [mm], 1e-5…10.
      axial_offset: of its middle from the roller's middle, along the roller [mm], default 0.
      angle: of its middle from the load line [rad], default 0.
      surface: "outer" (default) or "inner" raceway, or "roller".
      scale: factor on all heights [-], −100…100, default 1; to see what a deeper one would do.
      row: 1 (default), or 2 with the effect `double_row`.
    """

    height: jax.Array
    pitch_x: Annotated[Real, Interval(ge=PITCH[0], le=PITCH[1]), Unit("mm")]
    pitch_y: Annotated[Real, Interval(ge=PITCH[0], le=PITCH[1]), Unit("mm")]
    axial_offset: Annotated[Real, Interval(ge=-1000.0, le=1000.0), Unit("mm")] = 0.0
    angle: Annotated[Real, Interval(ge=-6.2832, le=6.2832), Unit("rad")] = 0.0
    surface: Literal["outer", "inner", "roller"] = dataclasses.field(default="outer", metadata={"static": True})
    scale: Annotated[Real, Interval(ge=-100.0, le=100.0), Unit("-")] = 1.0
    row: Annotated[int, Interval(ge=1, le=2)] = dataclasses.field(default=1, metadata={"static": True})

    @property
    def length(self) -> Real:
        """Over which the raceway is another one, along the roller [mm]: a pitch more than `extent` at either end."""
        return (self.height.shape[0] + 1) * self.pitch_y

    @property
    def width(self) -> Real:
        """As `length`, in the rolling direction."""
        return (self.height.shape[1] + 1) * self.pitch_x

    @property
    def depth(self) -> Real:
        """Of its deepest point below the raceway [mm], without derivatives; 0 without one."""
        return xp.maximum(-(xp.fixed(self.scale) * xp.fixed(self.height)).min(), 0.0)

    @property
    def rim(self) -> Real:
        """How high it stands out of the raceway [mm], without derivatives."""
        return xp.maximum((xp.fixed(self.scale) * xp.fixed(self.height)).max(), 0.0)

    @property
    def walls(self) -> Any:
        """As `Spall.walls`, shape (2 + PLACES,): where it ends and begins to fall or rise, and places between, closer
        where it does so more."""
        height, columns = xp.fixed(self.height), self.height.shape[1]
        of = xp.module_of(height)
        steps = of.max(of.abs(of.diff(height, axis=1, prepend=0.0, append=0.0)), axis=0)
        told = of.concatenate([of.zeros(1), of.cumsum(steps)]) / of.maximum(of.sum(steps), 1e-300)
        at = of.arange(columns + 2.0)
        share = of.linspace(0.0, 1.0, PLACES + 2)
        rises = of.interp(of.clip(share, OUTSIDE, 1.0 - OUTSIDE), told, at)
        even = rises[0] + (rises[-1] - rises[0]) * share
        places = 0.5 * (rises + even) - 0.5 * (columns + 1)
        return of.concatenate([places[-1:], places[:-1]]) * self.pitch_x

    ends = Spall.ends

    @property
    def off_middle(self) -> Any:
        """As `Spall.off_middle`: its heights count, too."""
        height = xp.numbers(self.height) if xp.are_numbers(self.height) else self.height
        return (self.axial_offset != 0.0) | xp.module_of(height).any(height != height[::-1])

    def turned_over(self) -> HeightMap:
        """As `Spall.turned_over`."""
        return dataclasses.replace(self, height=self.height[:, ::-1])

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
    height = measured.scale * jnp.asarray(measured.height, float)
    rows, columns = height.shape
    along = _hats(y - measured.axial_offset, rows, measured.pitch_y)
    across = _hats(x - offset, columns, measured.pitch_x)
    return along @ height @ across.T


def _hats(distance: jax.Array, count: int, pitch: Real) -> jax.Array:
    """Weights of `count` points about 0 at a `distance` from it: shape (distances, count)."""
    place = distance / pitch + 0.5 * (count - 1)
    away = place[:, None] - jnp.arange(count)[None, :]
    return jnp.maximum(jnp.minimum(1.0 - away, 1.0 + away), 0.0)  # not by |away|, whose slope at 0 is 1 in JAX


def height_map_is_valid(measured: HeightMap) -> jax.Array:
    """Whether all numbers of a map are finite, and its pitches positive."""
    pitches = jnp.stack([jnp.asarray(v, float) for v in (measured.pitch_x, measured.pitch_y)])
    finite = jnp.all(jnp.isfinite(jnp.asarray(measured.height, float)))
    place = measured.angle + measured.axial_offset + measured.scale
    return finite & jnp.all(pitches > 0.0) & jnp.isfinite(jnp.sum(pitches) + place)


def resized(spall: Spall | HeightMap, length: Any, width: Any) -> Any:
    """A spall of another length and width [mm]; a map is stretched to them."""
    if isinstance(spall, Spall):
        return dataclasses.replace(spall, length=length, width=width)
    rows, columns = spall.height.shape
    return dataclasses.replace(spall, pitch_y=length / (rows + 1), pitch_x=width / (columns + 1))


def load_height_map(
    path: str | Path,
    axial_offset: Real = 0.0,
    angle: Real = 0.0,
    surface: Literal["outer", "inner", "roller"] = "outer",
) -> HeightMap:
    """Read a map from a file; lengths in mm. `axial_offset`, `angle`, `surface` as in `HeightMap`.

    `.npz`: arrays `height` (rows along the roller, columns along the rolling direction), `pitch_x`, `pitch_y`, as
    `numpy.savez` or `savez_compressed` writes them; at most 134 MB.
    `.csv`: one row of the map a line, commas between its heights, after comments `# pitch_x = …`, `# pitch_y = …`; at
    most 64 MB.
    HeightMapError (a ValueError) says in one sentence what is wrong with the file. Sizes are judged before heights are
    read: what is no map, or too large for one, takes neither time nor memory.
    """
    kind = os.path.splitext(path)[1].lower()
    if kind not in LARGEST:
        raise HeightMapError(f"{named(path)}: must be a file .npz or .csv")
    content = (_read_npz if kind == ".npz" else _read_csv)(path)
    height, pitch_x, pitch_y = _checked(content, path)
    return HeightMap(jnp.asarray(height), pitch_x, pitch_y, axial_offset, angle, surface)


def example_map(name: str = "spall_map.npz") -> Path:
    """Where a packaged map lies; HeightMapError if there is none of that name."""
    folder = Path(str(resources.files("difftrb"))) / "scenes"
    if Path(name).name != name or not (folder / name).is_file():
        raise HeightMapError(f"{name}: there is no such file")
    return folder / name


class _InParts(io.BufferedReader):
    """A file of which no more than a part is read at once: what an archive says of its own sizes may be a lie."""

    def read(self, size: int | None = -1, /) -> bytes:
        content = super().read(PART + 1 if size is None or not 0 <= size <= PART else size)
        if len(content) > PART:
            raise zipfile.BadZipFile
        return content


def _read_npz(path: str | Path) -> dict[str, Any]:
    with opened(path, "a height map", LARGEST[".npz"], HeightMapError) as file:
        try:
            with _InParts(file.raw) as parts, zipfile.ZipFile(parts) as archive:
                names = archive.namelist()
                return {key: _member(archive, key, path) for key in KEYS if f"{key}.npy" in names}
        except (HeightMapError, OSError):
            raise
        except Exception:  # of all that zipfile and numpy raise on what is none of theirs there is no list
            raise HeightMapError(f"{path}: is not an npz file of plain arrays; write it with numpy.savez") from None


def _member(archive: zipfile.ZipFile, key: str, path: str | Path) -> np.ndarray:
    """One array of an archive, of which first only the header is read."""
    about = archive.getinfo(f"{key}.npy")
    if about.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others inflate without a limit
        raise zipfile.BadZipFile
    with archive.open(about) as member:
        if np.lib.format.read_magic(member) != (1, 0):  # later ones have headers of any length, for other arrays
            raise zipfile.BadZipFile
        shape, _, dtype = np.lib.format.read_array_header_1_0(member)
    if dtype.hasobject:
        raise zipfile.BadZipFile
    if dtype.kind not in "fiu":
        raise HeightMapError(f"{path}: {key} holds {shown(str(dtype))}, not numbers: give numbers [mm]")
    if key == "height":
        _check_shape(shape, path)
    elif any(n != 1 for n in shape):
        raise HeightMapError(f"{path}: {key} has shape {shown(shape)}: must be one number [mm]")
    with archive.open(about) as member:
        found = np.lib.format.read_array(member, allow_pickle=False)
    return found if key == "height" else found.ravel()[0]


def _check_shape(shape: tuple[int, ...], path: str | Path) -> None:
    if len(shape) != 2 or min(shape) < 2:
        raise HeightMapError(f"{path}: height has shape {shown(shape)}: must be a grid of at least 2 × 2 points")
    if max(shape) > MOST:
        raise HeightMapError(
            f"{path}: height has shape {shown(shape)}: must be a grid of at most {MOST} × {MOST} points, finer "
            "than which no lattice is; leave points out, or cut the map to the spall"
        )


def _read_csv(path: str | Path) -> dict[str, Any]:
    content: dict[str, Any] = {}
    rows: list[np.ndarray] = []
    text = text_of(path, "a height map", HeightMapError, LARGEST[".csv"])
    for number, line in enumerate(io.StringIO(text), 1):
        if line.lstrip().startswith("#"):
            key, equals, value = line.lstrip("# \t").partition("=")
            if equals and key.strip() in KEYS:
                content[key.strip()] = value.strip()
        elif line.strip():
            _check_shape((max(len(rows) + 1, 2), max(line.count(",") + 1, 2)), path)  # before it takes memory
            try:
                rows.append(np.array([float(entry) for entry in line.split(",")]))
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


def _checked(content: dict[str, Any], path: str | Path) -> tuple[np.ndarray, float, float]:
    """Heights and pitches of a file; refuses what cannot be a map."""
    for key in KEYS:
        if key not in content:
            how = f"a comment '# {key} = …' [mm]" if str(path).lower().endswith(".csv") else f"an array {key!r} [mm]"
            raise HeightMapError(f"{path}: {key} is missing: give {how}")
    pitches = []
    for key in KEYS[1:]:
        try:
            pitch = float(content[key])
        except (TypeError, ValueError):
            pitch = float("nan")
        if not PITCH[0] <= pitch <= PITCH[1]:
            value = str(content[key])[:40]
            raise HeightMapError(f"{path}: {key} = {value}: must be a number in {PITCH[0]:g} … {PITCH[1]:g} mm")
        pitches.append(pitch)
    height = content["height"].astype(float)
    _check_shape(height.shape, path)
    bad = ~np.isfinite(height)
    if bad.any():
        row, column = np.unravel_index(bad.argmax(), height.shape)
        raise HeightMapError(
            f"{path}: height[{row}, {column}] = {height[row, column]} ({bad.sum()} such points): must be finite; "
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
