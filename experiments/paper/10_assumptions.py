"""Beyond the paper: what each of its assumptions costs, one at a time."""

from __future__ import annotations

import importlib
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.core import geometry
from experiments.paper import clipped, common
from experiments.paper.common import HEAVY, Progress, Result

SIZES = ((4.0, 7.0), (8.0, 7.0))
ROLLERS = np.geomspace(270.0, 2000.0, 15)
NEAR = np.linspace(1.9, 2.1, 41)
"""Spall lengths [mm] over which the grid's staircase is drawn."""
LOAD = 3000.0
PHASES = 64


@partial(jax.jit, static_argnames=("size",))
def on_cells(lengths: jax.Array, size: tuple[int, int]) -> jax.Array:
    """Approach [mm] at `LOAD` over wide spalls on uniform cells that hold the whole contact."""
    contact = common.contact()
    return jax.lax.map(
        lambda length: clipped.solve(contact, LOAD, trb.Spall(length, 100.0), 0.0, 3.0, size).approach, lengths
    )


def windowed(length: float, width: float) -> np.ndarray:
    """Mean loss over phases [%] by the table, but with a window: in it a roller is as over the spall's middle."""
    half = 0.5 * width / float(geometry.arc_radius(common.bearing()))
    whole = float(geometry.roller_pitch(common.bearing()))
    points, weights = np.polynomial.legendre.leggauss(PHASES)
    places = half * points
    return (
        2.0
        * half
        / whole
        * 0.5
        * weights
        @ common.losses_over(common.table_law(), length, width, phase=places, angle=places)
    )


def run(out: Path, progress: Progress) -> Result:
    """All of them, and one table."""
    contact = common.contact()
    lengths, widths = np.transpose(SIZES)
    truth = common.losses_over(common.table_law(), lengths, widths)
    whole, cut = common.half_space(contact, ROLLERS), np.asarray(clipped.approaches(
        contact, jnp.asarray(ROLLERS), jnp.asarray(common.LENGTHS), clipped.NARROWED, clipped.PAPER_GRID
    ))  # fmt: skip
    near, near_cut = (common.as_law(clipped.power_fit(ROLLERS, v), ROLLERS) for v in (whole, cut))
    progress(1, 4)
    by = {
        "half-space, table": truth,
        "power law fitted to 0.27–2 kN": common.losses_over(near, lengths, widths),
        "power law fitted to 1.5–12 kN": common.losses_over(common.whole_law(), lengths, widths),
        "clipped domain, power law fitted to 0.27–2 kN": common.losses_over(near_cut, lengths, widths),
        "clipped domain, power law fitted to 1.5–12 kN": common.losses_over(common.clipped_law(), lengths, widths),
        "Table 2": common.losses_over(trb.liu2018(), lengths, widths),
        "two contacts in series, power law fitted to 0.27–2 kN": common.losses_over(
            importlib.import_module("experiments.paper.06_length").in_series(ROLLERS), lengths, widths
        ),
    }
    means = common.losses_over(common.table_law(), lengths, widths, phase="mean")
    hard = np.array([windowed(*size) for size in SIZES])
    step = 0.25
    slopes = [
        [(f(length, width + step) - f(length, width - step)) / (2.0 * step) for length, width in SIZES]
        for f in (
            lambda length, width: common.losses_over(common.table_law(), [length], [width], phase="mean")[0],
            windowed,
        )
    ]
    progress(2, 4)
    stairs, fine = np.asarray(on_cells(jnp.asarray(NEAR), (400, 60))), np.array([
        float(trb.solve_contact(contact, LOAD, trb.Spall(float(length), 100.0), accuracy=1e-4).check().approach)
        for length in NEAR
    ])  # fmt: skip
    slope = float(np.asarray(trb.approach_slopes(contact, LOAD, trb.Spall(2.0, 100.0), 0.0)["length"]))
    progress(3, 4)
    figure, (left, right) = common.axes(1, 2, height=3.3)
    left.plot(NEAR, 1e3 * stairs, ".", ms=4, label="400 uniform rows")
    left.plot(NEAR, 1e3 * fine, "-", lw=1.4, label="solve_contact, 1e-4")
    middle = len(NEAR) // 2
    left.plot(NEAR, 1e3 * (fine[middle] + slope * (NEAR - 2.0)), "--", color="black", lw=0.8, label="its gradient")
    left.set_xlabel("spall length [mm]")
    left.set_ylabel(f"approach at {LOAD / 1e3:g} kN [µm]")
    left.legend()
    names, place = list(by), np.arange(len(by))
    for k, (size, colour) in enumerate(zip(SIZES, common.HUES, strict=True)):
        values = [by[name][k, 0] for name in names]
        right.barh(place + (0.2 if k else -0.2), values, 0.38, color=colour, label=f"{size[0]:g} × {size[1]:g} mm")
    right.set_yticks(place, [name.replace(", power", ",\npower").replace("law fitted", "law") for name in names])
    right.invert_yaxis()
    right.tick_params(axis="y", labelsize=7)
    right.set_xlabel("radial secant loss, roller centred [%]")
    right.legend(loc="lower right")
    picture = common.save(figure, out, "assumptions")

    def cells(values: np.ndarray, base: np.ndarray | None = None) -> list[str]:
        texts = []
        for k in range(len(SIZES)):
            for c in range(2):
                change = "" if base is None else f" ({values[k, c] - base[k, c]:+.2f})"
                texts.append(f"{values[k, c]:.2f}{change}")
        return texts

    rows = [["**nothing**: half-space, table, roller centred", *cells(truth)]]
    rows += [
        ["power law, fitted to the rollers' loads", *cells(by["power law fitted to 0.27–2 kN"], truth)],
        ["power law, fitted to 1.5–12 kN", *cells(by["power law fitted to 1.5–12 kN"], truth)],
        ["clipped domain (both by power laws of the rollers' loads)",
         *cells(by["clipped domain, power law fitted to 0.27–2 kN"], by["power law fitted to 0.27–2 kN"])],
        ["clipped domain and power law of 1.5–12 kN: the paper, remade",
         *cells(by["clipped domain, power law fitted to 1.5–12 kN"], truth)],
        ["Table 2 itself", *cells(by["Table 2"], truth)],
        ["inner contact rigid (against both in series, by power laws)", *cells(
            by["power law fitted to 0.27–2 kN"], by["two contacts in series, power law fitted to 0.27–2 kN"]
        )],
        ["**cage phases averaged**: half-space, table, ramp", *cells(means)],
        ["hard window instead of the ramp", *cells(hard, means)],
        ["roller centred instead of the mean of phases", *cells(truth, means)],
    ]  # fmt: skip
    ripple = float(np.abs(stairs / fine - (stairs / fine).mean()).max())
    jump = float(np.abs(np.diff(stairs)).max() / fine.mean())
    flat = float(np.mean(np.abs(np.diff(stairs)) < 1e-12))
    hard_slope, soft_slope = (np.array(v)[:, 0] for v in (slopes[1], slopes[0]))
    text = common.page(
        f"Secant loss, radial and axial, of 4 × 7 and 8 × 7 mm at {HEAVY.radial:g}/{HEAVY.axial:g} N [%]; in brackets "
        "what the assumption changes, in points:",
        common.grid(["assumption", "4 mm radial", "4 mm axial", "8 mm radial", "8 mm axial"], rows),
        common.picture(picture, "Approach over spall length on uniform cells and ours; radial loss by assumption"),
        f"**Staircase grid.** On 400 uniform rows a spall is a whole number of cells: between steps, {100 * flat:.0f} "
        f"% "
        "of the small changes of length drawn, nothing changes, so the derivative by length is 0; at a step the "
        "approach "
        f"jumps by {100 * jump:.2f} %. The true derivative is {slope:.3e} mm/mm. Its bias is small (ripple "
        f"{100 * ripple:.2f} % about the mean).",
        "**Hard window.** It changes the mean loss little, and its mean's derivative by width "
        f"({hard_slope[0]:.3f} and {hard_slope[1]:.3f} points per mm radially, ramp {soft_slope[0]:.3f} and "
        f"{soft_slope[1]:.3f}) is right but for {100 * np.abs(hard_slope / soft_slope - 1).max():.1f} %; at one phase "
        f"it "
        "has none.",
    )  # fmt: skip
    numbers = {
        "sizes": SIZES, "loss": by, "mean": means, "hard_mean": hard, "lengths": NEAR, "uniform": stairs,
        "fine": fine, "slope": slope, "ripple": ripple, "jump": jump, "flat": flat,
        "mean_by_width": {"ramp": soft_slope, "window": hard_slope},
    }  # fmt: skip
    progress(4, 4)
    return Result("What its assumptions cost", text, numbers, beyond=True)
