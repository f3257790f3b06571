"""The figure of pressure in contacts: of one, or of those at a spall."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from difftrb.contact.contact_solution import ContactSolution
from difftrb.contact.height_map import HeightMap
from difftrb.contact.solver import pressure_patches
from difftrb.contact.strip_model import Patch
from difftrb.core import geometry
from difftrb.core.geometry import Raceway
from difftrb.report.figure_style import SPALLED
from difftrb.ring import effect_base, roller_places
from difftrb.ring.effects import Raceways
from difftrb.scene.scene import Scene, raceway_contact
from difftrb.scene.solution import RollersAt, Solution, rollers_at

MOST = 3
"""Rollers at a spall whose contacts are drawn."""
FINE = 1e-4
"""Accuracy of contacts that are drawn: their rows are dense enough to look at."""


class DrawnContact(NamedTuple):
    """One roller's contact with a raceway: its number, the solution, and its pressure point by point, if it has
    that."""

    roller: int
    solution: ContactSolution
    patches: tuple[Patch, ...]
    raceway: Raceway = "outer"


def contacts_at_spall(scene: Scene, solution: Solution) -> list[DrawnContact]:
    """The contacts of the up to `MOST` most loaded rollers that meet a spall, with every raceway that gives way, roller
    by roller; of the most loaded roller if none does. Each with the load, the tilt and all spalls in its reach that it
    has in `solution`. Of two rows, the one whose rollers at spalls carry more; of a second one the outer contacts
    alone."""
    every = {row: _met(scene, solution, row) for row in {1} | {spall.row for spall in scene.spalls}}
    row = max(every, key=lambda row: (float(np.max(_loads_at(solution, row, every[row]))), -row))
    at_spalls = _loads_at(solution, row, every[row])
    rollers = [int(j) for j in np.argsort(-at_spalls, kind="stable")[:MOST] if at_spalls[j] > 0.0]
    rollers.sort(key=lambda j: float(geometry.wrapped(solution.angles[j])))
    accuracy = min(scene.accuracy, FINE)
    found = []
    for j, raceway in itertools.product(rollers or [int(np.argmax(solution.loads_of(row)))], every[row]):
        load = solution.loads_of(row)[j] if raceway == "outer" else solution.effects["inner_loads"][j]
        own = [(near.spall, -float(near.distances[j])) for near in every[row][raceway] if near.meeting[j]]
        under = (tuple(spall for spall, _ in own), [offset for _, offset in own]) if own else (None, 0.0)
        tilt = _tilts(solution, raceway, row)[j]
        contact = raceway_contact(scene, raceway)
        found.append(DrawnContact(j, *pressure_patches(contact, load, *under, accuracy, float(tilt)), raceway))
    return found


Met = dict[Raceway, list[RollersAt]]
"""By raceway: the rollers beside each of its spalls."""


def _met(scene: Scene, solution: Solution, row: int) -> Met:
    """What the rollers of one row meet on every raceway that gives way."""
    series = effect_base.among(scene.effects, Raceways) is not None and row == 1
    found: Met = {"outer": [], "inner": []} if series else {"outer": []}
    spalls = tuple(spall for spall in scene.spalls if spall.row == row)
    for raceway, met in found.items():
        for spall in roller_places.spalls_on(spalls, raceway):
            met.append(rollers_at(scene, solution, spall, raceway))
    return found


def _loads_at(solution: Solution, row: int, met: Met) -> np.ndarray:
    """Loads of a row's rollers that meet a spall, 0 of others [N]."""
    loads = np.asarray(solution.loads_of(row))
    reached = [near.meeting for every in met.values() for near in every]
    return np.where(np.any(reached, axis=0), loads, 0.0) if reached else np.zeros(loads.shape)


def _tilts(solution: Solution, raceway: Raceway, row: int) -> np.ndarray:
    """Of the rollers against a raceway [rad]; those of a second row are not told."""
    upright = np.zeros(len(np.asarray(solution.loads_of(row))))
    if row != 1:
        return upright
    own = np.asarray(solution.effects.get("roller_tilts", upright))
    return 1e-3 * (own if raceway == "outer" else np.asarray(solution.effects.get("inner_tilts", -own)))


def pressures(found: list[DrawnContact]) -> Any:
    """Contact pressure of rollers at the spall, one below the other, on one scale; with both raceways side by side."""
    across = len({one.raceway for one in found})
    size = (8.5 if across == 1 else 13.0, 0.7 + 2.5 * len(found) / across)
    _, axes = plt.subplots(len(found) // across, across, figsize=size, layout="constrained", squeeze=False)
    top = max(scale_of(one) for one in found)
    for ax, one in zip(axes.ravel(), found, strict=True):
        pressure_map(one.solution, ax, one.patches, top)
        where = f", {one.raceway} raceway" if across > 1 else ""
        ax.set_title(f"Roller {one.roller}{where}: {ax.get_title()}", fontsize=10 if across == 1 else 9)
    limits = np.array([ax.get_xlim() for ax in axes.ravel()])
    if across > 1:  # the same places along the roller above each other
        plt.setp(axes, xlim=(limits.min(), limits.max()))
    return axes[-1, 0]


def scale_of(one: DrawnContact) -> float:
    """Where the colours of a contact end [N/mm²], so that only a hundredth of its area is beyond: at a sharp edge there
    is no largest pressure."""
    values, areas = np.asarray(one.solution.pressure).ravel(), np.asarray(one.solution.cells.area).ravel()
    if one.patches:
        values = np.concatenate([patch.pressure.ravel() for patch in one.patches])
        sizes = (np.gradient(patch.y)[:, None] * np.gradient(patch.x, axis=1) for patch in one.patches)
        areas = np.abs(np.concatenate([size.ravel() for size in sizes]))
    order = np.argsort(values)
    order = order[values[order] > 0.0]
    share = np.cumsum(areas[order])
    return float(values[order][np.searchsorted(share, 0.99 * share[-1])]) if order.size else 1.0


def on_grid(patches: tuple[Patch, ...], points: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressure on so many points along the roller and across it: both their positions [mm], shapes (along,) and
    (across,), and values [N/mm²], shape (across, along); NaN where nothing is carried."""
    ends = np.concatenate([patch.y[[0, -1]] for patch in patches])
    reach = 1.25 * max(float(np.abs(patch.x).max()) for patch in patches)
    along, across = np.linspace(ends.min(), ends.max(), points[0]), np.linspace(-reach, reach, points[1])
    values = np.full((points[1], points[0]), np.nan)
    for patch in patches:
        for i in np.flatnonzero((along >= patch.y[0]) & (along <= patch.y[-1])):
            k = min(int(np.searchsorted(patch.y, along[i], side="right")), len(patch.y) - 1)
            share = (along[i] - patch.y[k - 1]) / (patch.y[k] - patch.y[k - 1])
            x, pressure = ((1.0 - share) * rows[k - 1] + share * rows[k] for rows in (patch.x, patch.pressure))
            inside = (across >= x[0]) & (across <= x[-1])
            values[inside, i] = np.interp(across[inside], x, pressure)
    return along, across, values


def pressure_map(
    solution: ContactSolution, ax: Axes | None = None, patches: tuple[Patch, ...] = (), limit: float | None = None
) -> Axes:
    """Contact pressure over the roller's length and the rolling direction, which is stretched: from point to point if
    there are `patches` (`pressure_patches`), else by cells.

    The colour scale ends at `limit` [N/mm²], by default where few points are beyond: at a sharp edge there is no finite
    one.
    """
    if ax is None:
        _, ax = plt.subplots(figsize=(8.0, 3.2), layout="constrained")
    solution = jax.device_get(solution)
    top = scale_of(DrawnContact(0, solution, patches)) if limit is None else limit
    look = {"cmap": "viridis", "vmin": 0.0, "vmax": top, "rasterized": True}
    if patches:
        for patch in patches:
            y = np.broadcast_to(patch.y[:, None], patch.x.shape)
            mesh = ax.pcolormesh(y, patch.x, patch.pressure, shading="gouraud", **look)
        along = np.concatenate([patch.y for patch in patches])
        across = np.concatenate([patch.x.ravel() for patch in patches])
        lines, reach = np.array([along.min(), along.max()]), 1.25 * float(np.abs(across).max())
    else:
        mesh, lines, reach = _by_cells(solution, ax, look)
    ax.figure.colorbar(mesh, ax=ax, label="pressure [N/mm²]", extend="max")
    for i, (spall, offset) in enumerate(solution.spalls):
        length, width = spall.extent if isinstance(spall, HeightMap) else (spall.length, spall.width)
        corner = (float(spall.axial_offset - 0.5 * length), float(offset - 0.5 * width))
        over = patches and not isinstance(spall, HeightMap)  # nothing is carried there
        outline = {"facecolor": "#EDEDED", "alpha": 1.0 if over else 0.35, "edgecolor": SPALLED, "linewidth": 1.2}
        label = None if i else "spall" if len(solution.spalls) == 1 else "spalls"
        ax.add_patch(Rectangle(corner, float(length), float(width), zorder=2 if over else 0, label=label, **outline))
    if solution.spalls:
        ax.legend(loc="upper right", frameon=True, framealpha=0.9, edgecolor="none", fontsize=9)
    ax.set_xlim(lines[0] - 0.3, lines[1] + 0.3)
    ax.set_ylim(-reach, reach)
    ax.set_xlabel("along the roller, y [mm]")
    ax.set_ylabel("rolling direction, x [mm]")
    box = ax.get_window_extent()
    stretch = (lines[1] - lines[0]) / (2.0 * reach) * box.height / box.width
    ax.text(0.01, 0.02, f"not to scale: x stretched about {float(f'{stretch:.1g}'):g} times", fontsize=8, color="0.35",
            transform=ax.transAxes, va="bottom")  # fmt: skip
    place = ", ".join(f"{float(offset) + 0.0:.3g}" for _, offset in solution.spalls)
    middle = "spall's middle" if len(solution.spalls) == 1 else "spalls' middles"
    place = f", {place} mm from the {middle}" if solution.spalls else ""
    ax.set_title(f"{float(solution.load):,.0f} N{place}, approach {1e3 * float(solution.approach):.3f} µm", fontsize=10)
    return ax


def _by_cells(solution: ContactSolution, ax: Axes, look: dict[str, Any]) -> tuple[Any, np.ndarray, float]:
    """The cells of a solution; where loaded ones begin and end along the roller, and how far to look across it [mm]."""
    cells = solution.cells
    x_lines, lines, pressure = np.asarray(cells.borders), np.asarray(cells.lines), np.asarray(solution.pressure)
    if cells.mirrored:
        lines = np.concatenate([-lines[:0:-1], lines])
        pressure = np.concatenate([pressure[::-1], pressure])
    loaded = pressure > 0.0
    mesh = ax.pcolormesh(lines, x_lines, np.ma.masked_where(~loaded, pressure).T, shading="flat", **look)
    rows, columns = loaded.any(axis=1), loaded.any(axis=0)
    reach = 1.3 * float(np.max(np.abs(np.asarray(cells.x)[columns]))) if columns.any() else float(x_lines[-1])
    return mesh, np.array([lines[:-1][rows].min(), lines[1:][rows].max()]), reach
