"""Beyond the paper: several spalls, in a row along the roller, around the ring, and on both raceways."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.core import geometry
from experiments.paper import common
from experiments.paper.common import HEAVY, Progress, Result

LOAD = 3000.0
APART = (2.0, 2.2, 2.5, 3.0, 4.0, 6.0, 8.0)
"""Distance of the middles of two spalls of 2 mm, one behind the other along the roller [mm]."""
LENGTH, WIDTH = 4.0, 7.0
"""Of the spalls around the ring [mm]."""
STEPS = tuple(range(1, 12))
"""Rollers from one spall to the next."""
PASSING = np.radians(np.linspace(-42.0, 42.0, 169))
"""Places of the inner spall while it passes the outer one [rad]."""


def approach(spall: trb.Spall | tuple[trb.Spall, ...] | None) -> float:
    """Of one contact by cells, to 1e-2 [mm]."""
    return float(trb.solve_contact(common.contact(), LOAD, spall, accuracy=1e-2, method="cells").check().approach)


def in_a_row(length: float, *apart: float) -> float:
    """Approach over wide spalls of `length`, their middles at ±half of `apart`, or one in the middle [mm]."""
    places = [sign * 0.5 * apart[0] for sign in (-1.0, 1.0)] if apart else [0.0]
    spalls = tuple(trb.Spall(length, 50.0, common.DEPTH, axial_offset=place) for place in places)
    return approach(spalls if apart else spalls[0])


@jax.jit
def _around(one: trb.Scene, lengths: jax.Array, angles: jax.Array) -> jax.Array:
    def at(state: tuple[jax.Array, jax.Array]) -> jax.Array:
        spalls = tuple(
            dataclasses.replace(spall, length=length, angle=angle)
            for spall, length, angle in zip(one.spalls, *state, strict=True)
        )
        return common.losses(dataclasses.replace(one, spalls=spalls))

    return jax.lax.map(at, (lengths, angles))


def around(rows: list[list[int]]) -> np.ndarray:
    """Secant loss [%] of spalls under rollers so many pitches from the one at the load line, three at most: shape
    (rows, 2)."""
    law = common.table_law()
    one = dataclasses.replace(common.scene(law, LENGTH, WIDTH), spalls=(trb.Spall(LENGTH, WIDTH, common.DEPTH),) * 3)
    pitch = float(geometry.roller_pitch(common.bearing()))
    lengths = np.array([[LENGTH * (k < len(row)) for k in range(3)] for row in rows])
    angles = pitch * np.array([row + [0] * (3 - len(row)) for row in rows])
    return np.asarray(_around(jax.tree.map(jnp.asarray, one), jnp.asarray(lengths), jnp.asarray(angles)))


def passing(outer: float, inner: float) -> np.ndarray:
    """Loss [%] over `PASSING` with spalls of these lengths on the outer ring, at the load line, and the inner one."""
    angles = PASSING[:, None] * np.array([0.0, 1.0, 0.0])
    return common.losses_in_series([[outer, inner, 0.0]], np.full((1, 3), WIDTH), angles)


def run(out: Path, progress: Progress) -> Result:
    """In a row, around the ring, on both raceways."""
    healthy = approach(None)
    one, two = (in_a_row(length) / healthy for length in (2.0, 4.0))
    pairs = [in_a_row(2.0, apart) / healthy for apart in APART]
    progress(1, 3)
    rows = [[k] for k in range(2 * max(STEPS) + 1)]
    rows += [[0, step] for step in STEPS] + [[0, step, 2 * step] for step in STEPS]
    every = around(rows)
    alone = every[: 2 * max(STEPS) + 1]
    pair, triple = every[alone.shape[0] :].reshape(2, len(STEPS), 2)
    sums = [np.array([alone[[k * step for k in range(count)]].sum(axis=0) for step in STEPS]) for count in (2, 3)]
    progress(2, 3)
    both, outer, inner = passing(LENGTH, LENGTH), passing(LENGTH, 0.0), passing(0.0, LENGTH)
    figure, (left, middle, right) = common.axes(1, 3, height=3.2)
    left.plot(APART, pairs, "o-", ms=4, lw=1.2, label="two of 2 mm")
    for value, name, style in ((one, "one of 2 mm", ":"), (two, "one of 4 mm", "--")):
        left.axhline(value, color="black", lw=0.9, ls=style, label=name)
    left.set_xlabel("middles apart along the roller [mm]")
    left.set_ylabel("approach by healthy, δ/δ₀")
    left.set_title("in a row")
    left.legend(fontsize=7, loc="center right")
    for (name, values, sum_), colour, style in zip(
        (("two", pair, sums[0]), ("three", triple, sums[1])), common.HUES, ("o", "s"), strict=True
    ):
        middle.plot(STEPS, values[:, 0], style, color=colour, ms=4, label=name)
        middle.plot(STEPS, sum_[:, 0], "-", color=colour, lw=0.9, label=f"{name}: sum of each alone")
    middle.set_xticks(STEPS[::2])
    middle.set_xlabel("rollers from one spall to the next")
    middle.set_ylabel("loss of radial secant stiffness [%]")
    middle.set_title(f"around the outer ring, {LENGTH:g} × {WIDTH:g} mm")
    middle.set_ylim(0.0, 1.4 * float(triple.max()))
    middle.legend(fontsize=7, loc="upper right")
    degrees = np.degrees(PASSING)
    right.plot(degrees, both[:, 0], "-", color=common.HUES[1], lw=1.4, label="both")
    right.plot(degrees, outer[:, 0] + inner[:, 0], "--", color="black", lw=1.0, label="sum of each alone")
    right.plot(degrees, inner[:, 0], ":", color=common.HUES[0], lw=1.4, label="inner alone")
    right.set_xticks([-40, -20, 0, 20, 40])
    right.set_xlabel("angle of the inner spall [°]")
    right.set_ylabel("loss of radial tangent stiffness [%]")
    right.set_title("inner passes outer, cage still")
    right.set_ylim(0.0, 1.5 * float(both[:, 0].max()))
    right.legend(fontsize=7, loc="upper center")
    picture = common.save(figure, out, "several_spalls")
    table = [
        [name, step, *(f"{v:.2f}" for v in (*values[k], *sum_[k]))]
        for name, values, sum_ in (("two", pair, sums[0]), ("three", triple, sums[1]))
        for k, step in enumerate(STEPS) if step in (1, 2, 4, 11)
    ]  # fmt: skip
    meet = int(np.argmin(np.abs(PASSING)))
    off = [float(np.abs(v[:, 0] / s[:, 0] - 1.0).max()) for v, s in ((pair, sums[0]), (triple, sums[1]))]
    text = common.page(
        common.picture(picture, "Spalls in a row, around the ring, and an inner one that passes an outer one"),
        f"**In a row** along the roller, 2 mm each, {LOAD / 1e3:g} kN, contact solves to 1e-2: touching, they are one "
        f"of 4 mm (δ/δ₀ {pairs[0]:.3f}, one of 4 mm {two:.3f}); a narrow bridge between them carries at once "
        f"({pairs[1]:.3f} with 0.2 mm of land, {pairs[2]:.3f} with 0.5 mm), and {APART[-1]:g} mm apart they are at "
        f"{pairs[-1]:.3f}, which is twice the rise of one of 2 mm alone ({one:.3f}).",
        f"**Around the outer ring**, {LENGTH:g} × {WIDTH:g} mm each, table law, {HEAVY.radial:g}/{HEAVY.axial:g} N, "
        f"the first at the load line, a roller over the middle of each. Secant loss [%], and the sum of what each "
        f"costs alone (one at the load line: {alone[0][0]:.2f} / {alone[0][1]:.2f}):",
        common.grid(["spalls", "rollers apart", "radial", "axial", "sum, radial", "axial"], table),
        f"Spalls under different rollers add up: sums miss by {100 * off[0]:.1f} % (two) and {100 * off[1]:.1f} % "
        "(three) of the loss at most.",
        f"**On both rings**, in series as in section 12: when the inner spall stands over the outer one with the "
        f"roller at the load line between them they cost {both[meet, 0]:.2f} % (radial, tangent), less than the sum "
        f"of {outer[meet, 0]:.2f} and {inner[meet, 0]:.2f} % alone: it is one roller that both rob of its load. "
        "Elsewhere they add up. (Peaks: two rollers stand in the inner spall at once.)",
    )  # fmt: skip
    numbers = {
        "apart": APART, "pairs": pairs, "one": one, "two": two, "steps": STEPS, "alone": alone, "pair": pair,
        "three": triple, "passing_angle": PASSING,
        "passing": {"both": both[:, 0], "outer": outer[:, 0], "inner": inner[:, 0]},
    }  # fmt: skip
    progress(3, 3)
    return Result("Several spalls", text, numbers, beyond=True)
