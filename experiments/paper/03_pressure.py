"""Figs 10–12: where a roller and a spall's edges touch while it passes, and the pressure there.

On the paper's cells (400 × 40 over ±1.4 Hertz half widths), and on cells of the same size over a domain that holds the
whole contact. Pressure at a sharp edge has no limit: every peak is that of its grid.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.patches import Rectangle

import difftrb as trb
from difftrb.contact import gap
from experiments.paper import clipped, common
from experiments.paper.common import FAILS, HOLDS, ONLY_IF, Claim, Progress, Result

LOAD = 3000.0
LENGTH, WIDTH = 2.0, 1.0
PLACES = (0.6, 0.54, 0.5, 0.46, 0.36, 0.0)
"""Places D_x of the spall's middle in Fig. 11 [mm]; also to the other side."""


class Domain(NamedTuple):
    """Half width of a domain by Hertz's, and its cells (rows, columns)."""

    reach: float
    size: tuple[int, int]


PAPER = Domain(1.4, (400, 40))
WHOLE = Domain(3.5, (400, 100))
FINER = Domain(3.5, (800, 200))


@partial(jax.jit, static_argnames=("domain",))
def pressed(offset: jax.Array, depth: jax.Array, domain: Domain) -> clipped.Uniform:
    """The contact with the spall's middle at `offset` [mm]; depth 0 is healthy."""
    spall = trb.Spall(LENGTH, WIDTH, depth)
    return clipped.solve(common.contact(), LOAD, spall, offset, domain.reach, domain.size)


class Seen(NamedTuple):
    """A contact beside its healthy self: approach, peak pressure and loaded area by the healthy ones; peak on the land
    beside the spall's ends (axial edges) and elsewhere, and on the rolling edges' side; pressure over the spall."""

    approach: float
    peak: float
    area: float
    axial_peak: float
    rolling_peak: float
    over_spall: float


def judged(offset: float, domain: Domain) -> tuple[Seen, clipped.Uniform]:
    """One place of the spall on one domain."""
    healthy = pressed(jnp.asarray(0.0), jnp.asarray(0.0), domain)
    one = pressed(jnp.asarray(offset), jnp.asarray(common.DEPTH), domain)
    top = float(healthy.pressure.max())
    share = np.asarray(one.pressure) / top
    along = np.abs(np.asarray(one.cells.y)) < 0.5 * LENGTH
    across = np.abs(np.asarray(one.cells.x) - offset) < 0.5 * WIDTH
    hollow = along[:, None] & across[None, :]
    return Seen(
        float(one.approach / healthy.approach), float(share.max()),
        float((one.pressure > 0).sum() / (healthy.pressure > 0).sum()),
        float(share[~along].max()), float(share[along].max()), float(share[hollow].max(initial=0.0)),
    ), one  # fmt: skip


def maps(solved: dict[str, list[clipped.Uniform]], tops: dict[str, float], out: Path) -> str:
    """Pressure at every place, on both domains."""
    figure, panels = common.axes(len(PLACES), 2, height=1.25, sharex=True, sharey=True)
    for column, (name, row) in enumerate(solved.items()):
        for ax, place, one in zip(panels[:, column], PLACES, row, strict=True):
            share = np.asarray(one.pressure) / tops[name]
            mesh = ax.pcolormesh(
                np.asarray(one.cells.lines), np.asarray(one.cells.borders), np.ma.masked_where(share <= 0.0, share).T,
                vmin=0.0, vmax=2.0, cmap="viridis", rasterized=True,
            )  # fmt: skip
            corner = -0.5 * LENGTH, place - 0.5 * WIDTH
            ax.add_patch(Rectangle(corner, LENGTH, WIDTH, fill=False, ls="--", lw=0.8))
            ax.set_xlim(-4.0, 4.0)
            ax.set_ylim(-0.3, 0.3)
            ax.grid(visible=False)
            ax.text(3.9, 0.17, f"$D_x$ = {place:g} mm", ha="right", fontsize=8)
        panels[0, column].set_title(name)
        panels[-1, column].set_xlabel("along the roller, y [mm]")
    figure.supylabel("rolling direction, x [mm]", fontsize=9)
    figure.colorbar(mesh, ax=panels, extend="max", label="pressure by the healthy peak", shrink=0.6)
    return common.save(figure, out, "pressure_maps")


def section(solved: dict[str, list[clipped.Uniform]], out: Path) -> str:
    """Pressure along the roller with the spall in the middle, and one place where a rolling edge is in the contact."""
    figure, panels = common.axes(1, 2, height=2.7, sharey=True)
    for ax, place in zip(panels, (0.0, 0.5), strict=True):
        for (name, row), style in zip(solved.items(), ("--", "-"), strict=True):
            one = row[PLACES.index(place)]
            middle = np.asarray(one.pressure)[:, one.cells.x.size // 2 - 1]
            ax.plot(np.asarray(one.cells.y), middle, style, lw=1.2, label=name)
        ax.axvspan(-1.0, 1.0, color="#BBBBBB", alpha=0.4, label="spall")
        ax.set_xlabel("along the roller, y [mm]")
        ax.set_title(f"$D_x$ = {place:g} mm, " + ("at x = 0" if place == 0.0 else "beside the rolling edge"))
    panels[0].set_ylabel("pressure [MPa]")
    panels[0].legend(loc="upper center", fontsize=7)
    return common.save(figure, out, "pressure_section")


def run(out: Path, progress: Progress) -> Result:
    """Every place on every grid."""
    domains = {"the paper's domain, ±1.4 b": PAPER, "whole contact, same cells": WHOLE, "cells half as large": FINER}
    seen: dict[str, list[Seen]] = {name: [] for name in domains}
    solved: dict[str, list[clipped.Uniform]] = {name: [] for name in list(domains)[:2]}
    for k, (name, domain) in enumerate(domains.items()):
        for place in PLACES:
            values, one = judged(place, domain)
            seen[name].append(values)
            if name in solved:
                solved[name].append(one)
        progress(k + 1, len(domains) + 1)
    back = pressed(jnp.asarray(-0.46), jnp.asarray(common.DEPTH), WHOLE)
    ahead = solved["whole contact, same cells"][PLACES.index(0.46)]
    mirror = float(jnp.abs(back.pressure[:, ::-1] - ahead.pressure).max() / ahead.pressure.max())
    tops = {name: float(pressed(jnp.asarray(0.0), jnp.asarray(0.0), domains[name]).pressure.max()) for name in solved}
    pictures = [maps(solved, tops, out), section(solved, out)]
    paper, whole, finer = seen.values()
    rows = [
        [
            f"±{place:g}" if place else "0", f"{p.peak:.2f}", f"{w.peak:.2f}", f"{f.peak:.2f}", f"{w.axial_peak:.2f}",
            f"{w.rolling_peak:.2f}", f"{p.area:.3f}", f"{w.area:.3f}", f"{p.approach:.4f}", f"{w.approach:.4f}",
        ]
        for place, p, w, f in zip(PLACES, paper, whole, finer, strict=True)
    ]  # fmt: skip
    contact = common.contact()
    half_width = float(gap.line_half_width(LOAD / contact.length, contact.radius, contact.modulus))
    sunk = float(pressed(jnp.asarray(0.0), jnp.asarray(common.DEPTH), WHOLE).approach)
    lets_go = float(np.sqrt(2.0 * float(contact.radius) * sunk))
    at_036, at_0 = whole[PLACES.index(0.36)], whole[PLACES.index(0.0)]
    worst_over = max(v.over_spall for v in paper + whole + finer)
    text = common.page(
        f"Q = {LOAD / 1e3:g} kN, spall 2 × 1 × {common.DEPTH:g} mm. Everything by its healthy value on the same grid; "
        "peaks on 400 × 40 cells over ±1.4 b (the paper's), on 400 × 100 cells of the same size over ±3.5 b, and on "
        "cells half as large in both directions; *at the ends*: on the land beyond the spall's ends; *beside*: on the "
        "land before and behind it.",
        common.grid(
            ["D_x [mm]", "peak, ±1.4 b", "peak, whole", "half cells", "at the ends", "beside", "area, ±1.4 b",
             "area, whole", "δ/δ₀, ±1.4 b", "δ/δ₀, whole"],
            rows,
        ),
        common.picture(pictures[0], "Pressure on the raceway at six places of the spall, on two domains"),
        common.picture(pictures[1], "Pressure along the roller with the spall in the middle and at its edge"),
        f"Fig. 10's limits (b_d ± b_c)/2 = {0.5 + half_width:.3f} and {0.5 - half_width:.3f} mm are those of a contact "
        f"of Hertz's width, b = {half_width:.4f} mm. The outer one is right. The inner one is not: over the spall the "
        f"roller sinks δ below the land, so the rolling edge lets go of it only when it is up to √(2Rδ) = "
        f"{lets_go:.2f} mm from the roller's middle, not b. At D_x = 0.36 mm the edge still carries "
        f"{at_036.rolling_peak:.2f} of the healthy peak; the paper's domain ends before it, and shows nothing there "
        f"({paper[PLACES.index(0.36)].rolling_peak:.2f}).",
        f"Over the spall the pressure is {worst_over:g}; the roller stays at least "
        f"{1e3 * (common.DEPTH - sunk):.0f} µm above its bottom. Mirrored places give mirrored pressures to "
        f"{mirror:.0e}.",
    )  # fmt: skip
    growth = f"{finer[PLACES.index(0.5)].peak:.2f} on cells half as large against {whole[PLACES.index(0.5)].peak:.2f}"
    claims = (
        Claim("outside ±0.594 mm the roller does not feel the spall (Fig. 10)",
              HOLDS if abs(whole[0].approach - 1.0) < 1e-4 else FAILS,
              f"δ/δ₀ − 1 = {whole[0].approach - 1:.0e} at D_x = 0.6 mm"),
        Claim("within ±0.406 mm only the axial edges carry, so nothing changes any more (Figs 10, 11, 13)",
              FAILS if at_036.rolling_peak > 0.05 else HOLDS,
              f"the rolling edge still carries at 0.36 mm (δ/δ₀ {at_036.approach:.3f} there, {at_0.approach:.3f} in "
              "the middle); the paper's domain ends before it"),
        Claim("the peak pressure rises as the contact area falls (Fig. 11)",
              ONLY_IF, f"on one grid: peaks at sharp edges have no limit ({growth})"),
        Claim("the roller never touches the spall's bottom (Fig. 12)",
              HOLDS if worst_over == 0.0 else FAILS, f"pressure over the spall {worst_over:g} at every place"),
    )  # fmt: skip
    numbers = {
        "places": PLACES, **{name: [v._asdict() for v in rows] for name, rows in seen.items()}, "mirror": mirror,
        "hertz_half_width": half_width, "edge_lets_go_at": lets_go,
    }  # fmt: skip
    return Result("Figures 10–12: a roller passes the spall", text, numbers, claims)
