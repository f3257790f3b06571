"""Figs 13 and 14: approach over the spall's place, and over the load."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.contact import gap
from difftrb.law import table
from difftrb.law.base import load_over
from experiments.paper import clipped, common
from experiments.paper.common import FAILS, HOLDS, LENGTHS, ONLY_IF, Claim, Printed, Progress, Result

LOAD, LENGTH, WIDTH = 3000.0, 2.0, 1.0
PLACES = np.concatenate([np.linspace(0.0, 0.2, 3), np.linspace(0.24, 0.66, 43), [0.75]])
LOADS = np.concatenate([np.geomspace(20.0, 1000.0, 8), np.linspace(1500.0, 12000.0, 15)])
THRESHOLD = 0.01
"""Share of the whole rise of the approach at which a ramp counts as begun, or as ended."""


@partial(jax.jit, static_argnames=("size",))
def _by_uniform(places: jax.Array, reach: float, size: tuple[int, int]) -> jax.Array:
    contact = common.contact()

    def one(place: jax.Array, depth: float = common.DEPTH) -> jax.Array:
        return clipped.solve(contact, LOAD, trb.Spall(LENGTH, WIDTH, depth), place, reach, size).approach

    return jax.lax.map(one, places) / one(jnp.asarray(0.0), 0.0)


def by_half_space(places: np.ndarray, length: float, load: float) -> np.ndarray:
    """δ/δ₀ at these places of the spall's middle [mm] on the whole half-space."""
    contact = common.contact()
    sound = float(trb.solve_contact(contact, load).check().approach)
    spall = trb.Spall(length, WIDTH, common.DEPTH)
    return np.array([float(trb.solve_contact(contact, load, spall, p).check().approach) for p in places]) / sound


@jax.jit
def carried(law: table.TableLaw, approach: jax.Array, length: jax.Array) -> jax.Array:
    """Load [N] of a roller in the middle of a wide spall by the table."""
    return load_over(law, approach, trb.Spall(length, 50.0, common.DEPTH))[0]


def ramp(places: np.ndarray, ratio: np.ndarray) -> tuple[float, float]:
    """Where δ/δ₀ begins to rise as the spall comes nearer, and where it ends to: D_x [mm]."""
    share = (ratio - 1.0) / (ratio[0] - 1.0)
    begins = float(np.interp(-THRESHOLD, -share, places))
    return begins, float(np.interp(-(1.0 - THRESHOLD), -share, places))


def run(out: Path, progress: Progress) -> Result:
    """Both figures."""
    contact = common.contact()
    b = float(gap.line_half_width(LOAD / contact.length, contact.radius, contact.modulus))
    ratios = {
        "domain ±0.7 b": np.asarray(_by_uniform(jnp.asarray(PLACES), clipped.NARROWED, (400, 20))),
        "domain ±1.4 b (the paper's words)": np.asarray(_by_uniform(jnp.asarray(PLACES), 1.4, (400, 40))),
        "half-space": by_half_space(PLACES, LENGTH, LOAD),
    }
    progress(1, 4)
    ramps = {name: ramp(PLACES, ratio) for name, ratio in ratios.items()}
    others = {
        (length, load): ramp(PLACES, by_half_space(PLACES, length, load))
        for length, load in ((4.0, 3000.0), (2.0, 1000.0), (2.0, 8000.0))
    }
    progress(2, 4)
    figure, (left, right) = common.axes(1, 2, height=3.1)
    for (name, ratio), style in zip(ratios.items(), ("-.", "--", "-"), strict=True):
        left.plot(np.r_[-PLACES[::-1], PLACES], np.r_[ratio[::-1], ratio], style, lw=1.3, label=name)
    for limit in (0.5 * WIDTH - b, 0.5 * WIDTH + b):
        for side in (-1.0, 1.0):
            label = "paper's ramp" if limit < 0.5 and side < 0 else None
            left.axvline(side * limit, color="black", lw=0.7, ls=":", label=label)
    left.set_xlabel("place of the spall's middle, $D_x$ [mm]")
    left.set_ylabel("approach by healthy, δ/δ₀")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=2, fontsize=7)
    whole, cut = common.half_space(contact, LOADS), np.asarray(clipped.approaches(
        contact, jnp.asarray(LOADS), jnp.asarray(LENGTHS), clipped.NARROWED, clipped.PAPER_GRID
    ))  # fmt: skip
    progress(3, 4)
    printed = trb.liu2018()
    K, n = (np.asarray(v) for v in printed.coefficients(jnp.asarray(LENGTHS)))
    table2 = (LOADS / K[:, None]) ** (1.0 / n[:, None])
    for i, length in enumerate(LENGTHS):
        right.plot(LOADS / 1e3, 1e3 * whole[i], "-", color=common.COLOURS[i], lw=1.3, label=f"{length:g} mm")
        right.plot(LOADS / 1e3, 1e3 * cut[i], "--", color=common.COLOURS[i], lw=1.0)
        right.plot(LOADS[8::3] / 1e3, 1e3 * table2[i, 8::3], **common.PAPER | {"ms": 4, "mew": 1.0})
    right.plot([], [], "--", color="black", label="clipped")
    right.plot([], [], **common.PAPER, label="Table 2")
    right.set_xlabel("roller load [kN]")
    right.set_ylabel("approach [µm]")
    right.legend(title="spall length", ncols=2, fontsize=7)
    picture = common.save(figure, out, "approach")
    fitted = LOADS >= 1500.0
    rise = np.diff(np.log(whole), axis=1) / np.diff(np.log(LOADS))
    smooth = common.table_law()
    off_table = max(
        abs(float(carried(smooth, jnp.asarray(d), jnp.asarray(length))) / q - 1.0)
        for length, row in zip(LENGTHS[1:], whole[1:], strict=True)
        for d, q in zip(row, LOADS, strict=True)
        if q < 6500.0
    )
    lines = [np.polyval(np.polyfit(LOADS[fitted], row[fitted], 1), LOADS[fitted]) for row in whole]
    straight = [
        np.abs(line - row[fitted]).max() / row.max() for line, row in zip(lines, whole, strict=True)
    ]  # of the largest approach
    far, near = ramps["half-space"]
    rows = [[name, f"{ratio[0]:.4f}", f"{begins:.3f}", f"{ends:.3f}"] for (name, ratio), (begins, ends) in
            zip(ratios.items(), ramps.values(), strict=True)]  # fmt: skip
    rows.append(["the paper: (b_d ± b_c)/2", "", f"{0.5 * WIDTH + b:.3f}", f"{0.5 * WIDTH - b:.3f}"])
    rows += [[f"half-space, l_d {length:g} mm, {load / 1e3:g} kN", "", f"{begins:.3f}", f"{ends:.3f}"]
             for (length, load), (begins, ends) in others.items()]  # fmt: skip
    at = [int(np.argmin(np.abs(LOADS - q))) for q in (20.0, 1000.0, 3000.0, 12000.0)]
    text = common.page(
        f"Fig. 13 at {LOAD / 1e3:g} kN, spall {LENGTH:g} × {WIDTH:g} mm. Where the approach begins to rise and where "
        f"it "
        f"has ended to ({100 * THRESHOLD:g} and {100 - 100 * THRESHOLD:g} % of the rise):",
        common.grid(["domain", "δ/δ₀ in the middle", "rise begins at D_x [mm]", "has ended at [mm]"], rows),
        common.picture(picture, "Approach over the spall's place, and over load for five spall lengths"),
        "Plateau, ramp, plateau, ramp, plateau as in the paper. On the half-space the ramp is "
        f"{(far - near) / (2.0 * b):.2f} times as long, even between these shares: its outer end is where the paper "
        f"has it, its inner end is where the sunk roller lets go of the rolling edge. "
        "With the paper's domain the approach jumps where the edge leaves the domain.",
        "Fig. 14, approach in µm (half-space / clipped / Table 2):",
        common.grid(
            ["roller load [kN]", *(f"{length:g} mm" for length in LENGTHS)],
            [[f"{LOADS[k] / 1e3:.3g}", *(f"{1e3 * whole[i, k]:.3f} / {1e3 * cut[i, k]:.3f} / {1e3 * table2[i, k]:.3f}"
             for i in range(len(LENGTHS)))] for k in at],
        ),
        f"From 1.5 kN on, straight lines miss δ(Q) by up to {100 * max(straight):.1f} % of its largest value. No one "
        f"power holds for all "
        f"loads: d log δ/d log Q lies between {rise.min():.3f} and {rise.max():.3f}, 1/n of Table 2 is "
        f"{1 / n.max():.3f}…{1 / n.min():.3f}. The smooth table meets these contacts to {100 * off_table:.2g} % of "
        "the load.",
    )  # fmt: skip
    ordered = bool((np.diff(whole, axis=0) > 0.0).all())
    claims = (
        Claim("the approach changes only while 0.406 < \\|D_x\\| < 0.594 mm (Fig. 13)",
              FAILS if near < 0.5 * WIDTH - 1.2 * b else HOLDS, f"it does from {near:.2f} to {far:.2f} mm"),
        Claim("δ is nearly proportional to Q and larger for longer spalls (Fig. 14)",
              ONLY_IF if ordered and max(straight) < 0.05 else FAILS,
              f"always larger; a straight line from 1.5 kN on misses by {100 * max(straight):.1f} % of the largest δ "
              f"and "
              "does not start at 0"),
    )  # fmt: skip
    numbers = {
        "places": PLACES, "ratio": ratios, "ramp": ramps, "loads": LOADS, "half_space": whole, "clipped": cut,
        "table_2": table2, "ramp_of_others": {f"{length:g} mm, {load:g} N": v for (length, load), v in others.items()},
        "off_straight": straight, "off_table": off_table,
    }  # fmt: skip
    words = list(ramps)[1]  # the domain that the paper names
    printed = tuple(
        Printed(f"\\|D_x\\| at which the approach {what} [mm] (Figs 10, 13)", f"{0.5 * WIDTH + side * b:.3f}",
                f"{ramps[words][k]:.3f}", f"{ramps['half-space'][k]:.3f}")
        for k, (what, side) in enumerate((("begins to rise", 1.0), ("has risen", -1.0)))
    )  # fmt: skip
    return Result("Figures 13 and 14: the approach", text, numbers, claims, printed)
