"""Beyond the paper: stiffness over length and width at once, with its gradient."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

import difftrb as trb
from difftrb.core import geometry
from experiments.paper import common
from experiments.paper.common import HEAVY, Progress, Result

LENGTHS = np.linspace(0.5, 11.0, 22)
PITCH = float(geometry.arc_radius(common.bearing()) * geometry.roller_pitch(common.bearing()))
"""Of the rollers, along the arc on which widths are measured [mm]."""
WIDTHS = 0.25 * PITCH * np.arange(1, 23)
"""With a line wherever one roller more fits into the spall, for there the mean has a corner [mm]."""
CHECKED = ((2.0, 5.0), (4.0, 7.0), (6.0, 20.0), (10.0, 33.0))
BATCH = 11


@jax.jit
def _batch(one: trb.Scene, sizes: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Losses of a batch of sizes, (BATCH, 2) [%], and by length and width, (BATCH, 2, 2) [points per mm]."""

    def loss(size: jax.Array) -> tuple[jax.Array, jax.Array]:
        spall = dataclasses.replace(one.spalls[0], length=size[0], width=size[1])
        value = common.losses(dataclasses.replace(one, spalls=(spall,)))
        return value, value

    slopes, values = jax.vmap(jax.jacfwd(loss, has_aux=True))(sizes)
    return values, slopes


def over(lengths: np.ndarray, widths: np.ndarray, definition: str = "tangent") -> tuple[np.ndarray, np.ndarray]:
    """Losses in the mean over phases [%], shape (lengths, widths, 2), and derivatives, (…, 2 losses, 2 sizes)."""
    one = jax.tree.map(jnp.asarray, common.scene(common.table_law(), 4.0, 7.0, definition=definition, phase="mean"))
    sizes = np.stack(np.meshgrid(lengths, widths, indexing="ij"), axis=-1).reshape(-1, 2)
    filled = np.concatenate([sizes, np.repeat(sizes[-1:], -len(sizes) % BATCH, axis=0)])
    found = [_batch(one, jnp.asarray(batch)) for batch in filled.reshape(-1, BATCH, 2)]
    values, slopes = (np.concatenate([np.asarray(v) for v in each])[: len(sizes)] for each in zip(*found, strict=True))
    shape = lengths.size, widths.size
    return values.reshape(*shape, 2), slopes.reshape(*shape, 2, 2)


def draw(ax: Axes, loss: np.ndarray, slopes: np.ndarray, name: str, levels: list[float]) -> object:
    """Loss as colour and lines, its gradient as arrows (what raises it, per share of each axis' range)."""
    mesh = ax.pcolormesh(WIDTHS, LENGTHS, loss, cmap="viridis", shading="gouraud", rasterized=True)
    lines = ax.contour(WIDTHS, LENGTHS, loss, levels, colors="white", linewidths=0.9)
    ax.clabel(lines, fmt="%g %%", fontsize=7)
    ax.set_xlim(WIDTHS[0], WIDTHS[-1])
    thin = slice(1, 21, 4)  # between the corners
    along, across = (slopes[thin, thin, k] * v for k, v in ((0, np.ptp(LENGTHS)), (1, np.ptp(WIDTHS))))
    size = np.hypot(along, across)
    ax.quiver(
        WIDTHS[thin], LENGTHS[thin], across / np.sqrt(size), along / np.sqrt(size), color="black", width=0.005,
        scale=60.0,
    )  # fmt: skip
    ax.plot(WIDTHS, np.where(LENGTHS.max() > 9.0 / WIDTHS, 9.0 / WIDTHS, np.nan), "--", color="white", lw=1.2)
    ax.text(9.5, 1.05, "9 mm²", color="white", fontsize=8)
    ax.plot([3.0, 7.0], [3.0, 8.0], "x", color="white", ms=6, mew=1.6)
    ax.set_ylim(LENGTHS[0], LENGTHS[-1])
    ax.set_xlabel("spall width [mm]")
    ax.set_title(f"{name} tangent loss, mean over cage phases [%]")
    ax.grid(visible=False)
    return mesh


def run(out: Path, progress: Progress) -> Result:
    """The map, and the gradient against differences of it."""
    loss, slopes = over(LENGTHS, WIDTHS)
    progress(1, 2)
    step = 0.1
    checks = []
    for length, width in CHECKED:
        around = over(length + step * np.array([-1.0, 0.0, 1.0]), width + step * np.array([-1.0, 0.0, 1.0]))
        values, slope = around[0][..., 0], around[1][1, 1, 0]
        by = np.array([values[2, 1] - values[0, 1], values[1, 2] - values[1, 0]]) / (2.0 * step)
        checks.append([length, width, *slope, *by])
    figure, panels = common.axes(1, 2, height=3.5, sharey=True)
    for k, (ax, name, levels) in enumerate(
        zip(panels, ("radial", "axial"), ([1.0, 3.0, 6.0, 12.0, 24.0], [1.0, 2.0, 3.0, 6.0, 12.0]), strict=True)
    ):
        mesh = draw(ax, loss[..., k], slopes[..., k, :], name, levels)
        figure.colorbar(mesh, ax=ax)  # pyright: ignore[reportArgumentType]
    panels[0].set_ylabel("spall length [mm]")
    picture = common.save(figure, out, "stiffness_map")
    by_neighbours = (loss[2:, :, 0] - loss[:-2, :, 0]) / (LENGTHS[2:] - LENGTHS[:-2])[:, None]
    apart = np.abs(slopes[1:-1, :, 0, 0] - by_neighbours)
    i, k = np.unravel_index(apart.argmax(), apart.shape)
    small = over(np.array([3.0]), np.array([3.0]))[0][0, 0]
    text = common.page(
        f"Loss of tangent stiffness of {HEAVY.radial:g}/{HEAVY.axial:g} N over length and width, by the table with its "
        f"ramps, averaged over the cage's phases: {loss[..., 0].size} sizes and their gradients in one batch each. "
        "Arrows: the gradient, in shares of the axes' ranges, lengths as the square root of its size. Crosses: the "
        f"paper's 3 × 3 and 8 × 7 mm. The lines have corners at widths of {PITCH:.1f} mm and its multiples, from which "
        "on one roller more is always in the spall, and where a large spall lifts the first rollers off on the far "
        "side.",
        common.picture(picture, "Loss of radial and axial stiffness over spall length and width, with gradient arrows"),
        f"Largest losses on the map: {loss[..., 0].max():.1f} % radially, {loss[..., 1].max():.1f} % axially. The "
        f"paper's 3 × 3 mm costs {small[0]:.2f} and {small[1]:.2f} %. Along the line of 9 mm² the radial loss is "
        "largest where the spall is long: an area is no measure.",
        "Derivatives of the radial loss [points per mm] against central differences of the map. The mean over phases "
        "is a "
        "sum over 60 of them; where a spall is so large that it moves the end of the load zone, that sum is coarse:",
        common.grid(
            ["length × width [mm]", "by length", "differences", "by width", "differences"],
            [[f"{a:g} × {b:g}", f"{g:.4f}", f"{d:.4f}", f"{h:.4f}", f"{e:.4f}"] for a, b, g, h, d, e in checks],
        ),
        f"Worst on the map: {LENGTHS[i + 1]:g} × {WIDTHS[k]:.1f} mm, by length {slopes[i + 1, k, 0, 0]:.1f}, by "
        f"differences between its neighbours {by_neighbours[i, k]:.1f} points per mm: so large a spall lifts rollers "
        "off on the far side, and the tangent stiffness of one about to lift off at a phase has hardly a derivative.",
    )  # fmt: skip
    numbers = {
        "lengths": LENGTHS, "widths": WIDTHS, "loss": loss, "by_size": slopes, "checks": checks, "loss_3_by_3": small,
    }  # fmt: skip
    below = float(WIDTHS[np.argmax(loss[LENGTHS.searchsorted(8.0), :, 0] > 10.0) - 1])
    claim = common.Claim(
        "the stiffness of roller bearings is insensitive to natural defects", common.ONLY_IF,
        f"the spall is small: radial tangent loss, mean over phases, {small[0]:.1f} % by 3 × 3 mm, below 10 % up to "
        f"8 × {below:.0f} mm, {loss[-1, -1, 0]:.0f} % by {LENGTHS[-1]:g} × {WIDTHS[-1]:.0f} mm",
    )  # fmt: skip
    progress(2, 2)
    return Result("The whole map of stiffness, with its gradient", text, numbers, (claim,), beyond=True)
