"""The packaged height map of a spall, as a profilometer would give it: src/difftrb/scenes/spall_map.npz.

python experiments/example_height_map.py [FILE]   (default: the packaged file)

From Liu et al. 2018, Fig. 11 are its size, 2 mm along the roller and 1 mm in the rolling direction, and its depth,
0.2 mm. That paper's spall has vertical walls and sharp corners; what a worn one has instead is assumed here, for want
of a measurement that may be shipped: corners rounded by 0.3 mm, walls of 45°, a bottom that rises by a quarter of the
depth towards the side where rollers enter, and a rim dented by debris, 40 dents 2…4 µm deep and 50…90 µm in radius
within 0.35 mm of the edge, each with a shoulder of a tenth of its depth.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

PACKAGED = Path(__file__).parents[1] / "src" / "difftrb" / "scenes" / "spall_map.npz"
LENGTH, WIDTH, DEPTH = 2.0, 1.0, 0.2  # mm; Liu et al. 2018, Fig. 11
CORNER, MARGIN = 0.3, 0.5  # mm
PITCH_X, PITCH_Y = 0.02, 0.04  # mm
DENTS, RIM = 40, 0.35  # number, mm from the edge


def inside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance into a rectangle with rounded corners [mm], negative outside."""
    away = np.stack([np.abs(x) - (0.5 * WIDTH - CORNER), np.abs(y) - (0.5 * LENGTH - CORNER)])
    outside = np.hypot(*np.maximum(away, 0.0))
    return CORNER - outside - np.minimum(away.max(axis=0), 0.0)


def spall_map() -> np.ndarray:
    """Heights [mm], rows along the roller, rounded to 0.1 µm as an instrument does."""
    columns, rows = round((WIDTH + 2.0 * MARGIN) / PITCH_X) + 1, round((LENGTH + 2.0 * MARGIN) / PITCH_Y) + 1
    x = (PITCH_X * (np.arange(columns) - 0.5 * (columns - 1)))[None, :]
    y = (PITCH_Y * (np.arange(rows) - 0.5 * (rows - 1)))[:, None]
    x, y = np.broadcast_arrays(x, y)
    bottom = DEPTH * (1.0 - 0.25 * np.clip(0.5 - x / WIDTH, 0.0, 1.0))
    height = -np.clip(inside(x, y), 0.0, bottom)
    rng = np.random.default_rng(2018)
    found = 0
    while found < DENTS:
        at = rng.uniform([-0.5 * WIDTH - RIM, -0.5 * LENGTH - RIM], [0.5 * WIDTH + RIM, 0.5 * LENGTH + RIM])
        if not -RIM < inside(*at) < -0.05:
            continue
        depth, radius = rng.uniform(2e-3, 4e-3), rng.uniform(0.05, 0.09)
        r2 = ((x - at[0]) ** 2 + (y - at[1]) ** 2) / radius**2
        height = height - depth * np.exp(-r2) + 0.14 * depth * np.exp(-4.0 * (np.sqrt(r2) - 1.8) ** 2)
        found += 1
    return np.round(height, 4)


def write(path: Path) -> None:
    """Write the map [mm] to an npz file."""
    tenths = np.round(spall_map() * 1e4).astype(np.int16)
    np.savez_compressed(path, height=(tenths * 1e-4).astype(np.float32), pitch_x=PITCH_X, pitch_y=PITCH_Y)


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else PACKAGED
    write(target)
    heights = spall_map()
    print(f"{target}: {heights.shape[0]} × {heights.shape[1]} points, {heights.min():.4f} … {heights.max():.4f} mm, "
          f"{target.stat().st_size} bytes")  # fmt: skip
