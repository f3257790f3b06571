"""Sentences of the paper that no figure shows: small spalls, length or width, depth, inner raceway, the window."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb.core import geometry
from experiments.paper import clipped, common
from experiments.paper.common import FAILS, HOLDS, LENGTHS, ONLY_IF, Claim, Printed, Progress, Result

LOADS = ((2000.0, 1000.0), (9000.0, 4500.0), (20000.0, 10000.0))
DEPTHS = (0.001, 0.002, 0.003, 0.004, 0.006, 0.01, 0.05, 0.2)
"""[mm]"""
ROLLERS = np.geomspace(270.0, 2000.0, 8)
"""Loads of rollers at 9000/4500 N [N]."""
PHASES = 96


def by_phase(law: Any, length: float, width: float) -> np.ndarray:
    """Radial and axial secant loss at cage phases over one pitch, shape (PHASES, 2) [%]."""
    pitch = float(geometry.roller_pitch(common.bearing()))
    return common.losses_over(law, length, width, phase=pitch * ((np.arange(PHASES) + 0.5) / PHASES - 0.5))


def shallow(depths: tuple[float, ...], length: float) -> np.ndarray:
    """Approach over the middle of wide spalls of these depths [mm] by the healthy one, at `ROLLERS`: shape (depths,
    loads). By cells, for the roller may reach the bottom."""
    contact = common.contact()
    sound = common.half_space(contact, ROLLERS, (0.0,))[0]
    return np.asarray(_shallow(contact, jnp.asarray(depths), jnp.asarray(length), jnp.asarray(ROLLERS))) / sound


@jax.jit
def _shallow(contact: trb.LineContact, depths: jax.Array, length: jax.Array, loads: jax.Array) -> jax.Array:
    def one(case: tuple[jax.Array, jax.Array]) -> jax.Array:
        spall = trb.Spall(length, 100.0, case[0])
        return trb.solve_contact(contact, case[1], spall, 0.0, 1e-3, "cells").approach

    cases = [v.ravel() for v in jnp.meshgrid(depths, loads, indexing="ij")]
    return jax.lax.map(one, tuple(cases)).reshape(depths.size, loads.size)


def run(out: Path, progress: Progress) -> Result:
    """One part for each sentence."""
    printed, table = trb.liu2018(), common.table_law()
    laws = {"Table 2": printed, "table": table}
    small = {
        (name, definition, load): common.losses_over(
            law, [3.0], 3.0, load=trb.Load(*load), definition=definition
        )[0]
        for name, law in laws.items() for definition in ("secant", "tangent") for load in LOADS
    }  # fmt: skip
    small_mean = {name: common.losses_over(law, [3.0], 3.0, phase="mean")[0] for name, law in laws.items()}
    progress(1, 5)
    sizes = [(2.0, 7.0), (4.0, 7.0), (8.0, 7.0), (4.0, 3.5), (4.0, 14.0)]
    grown = {phase: common.losses_over(table, *np.transpose(sizes), phase=phase)[:, 0] for phase in (0.0, "mean")}
    progress(2, 5)
    deep = shallow(DEPTHS, 4.0)
    progress(3, 5)
    inner, outer = (common.half_space(common.contact(raceway), ROLLERS) for raceway in ("inner", "outer"))
    raceways = {
        name: common.losses_over(common.as_law(clipped.power_fit(ROLLERS, v), ROLLERS), LENGTHS, 7.0)
        for name, v in (("outer", outer), ("inner", inner))
    }
    progress(4, 5)
    window = {
        (length, width): (by_phase(printed, length, width), by_phase(table, length, width))
        for length, width in ((8.0, 3.0), (8.0, 7.0))
    }
    figure, panels = common.axes(1, 3, height=2.9)
    for load, row in zip(ROLLERS[::3], deep.T[::3], strict=True):
        panels[0].semilogx(1e3 * np.array(DEPTHS), row, "o-", ms=3, lw=1.2, label=f"{load:.0f} N")
    panels[0].set_xlabel("depth of the spall [µm]")
    panels[0].set_ylabel("approach by healthy (4 mm long)")
    panels[0].legend(title="roller load")
    for i, (name, values) in enumerate((("outer", outer), ("inner", inner))):
        for k, style in ((0, "--"), (-1, "-")):
            panels[1].plot(LENGTHS, values[:, k] / values[0, k], style, marker="os"[i], ms=3, color=common.HUES[i],
                           lw=1.2, label=f"{name}, {ROLLERS[k]:.0f} N")  # fmt: skip
    panels[1].set_xlabel("spall length [mm]")
    panels[1].set_ylabel("approach by healthy")
    panels[1].set_xticks(LENGTHS)
    panels[1].legend()
    angle = 360.0 / common.bearing().rollers * ((np.arange(PHASES) + 0.5) / PHASES - 0.5)
    hard, soft = window[8.0, 7.0]
    panels[2].plot(angle, hard[:, 0], "--", lw=1.2, label="Table 2, hard window")
    panels[2].plot(angle, soft[:, 0], "-", lw=1.2, label="table, ramp")
    panels[2].set_xlabel("cage phase [°]")
    panels[2].set_ylabel("radial secant loss by 8 × 7 mm [%]")
    panels[2].set_ylim(bottom=0.0)
    panels[2].legend(loc="lower center", fontsize=7, bbox_to_anchor=(0.5, 0.1))
    picture = common.save(figure, out, "sentences")
    over = [v for v in small.values() if v.max() > 3.0]
    factors = {phase: (v[2] / v[0], v[4] / v[3]) for phase, v in grown.items()}
    gain_inner, gain_outer = inner[4] / inner[0] - 1.0, outer[4] / outer[0] - 1.0
    matters = [depth for depth, row in zip(DEPTHS, deep, strict=True) if np.abs(row / deep[-1] - 1.0).max() > 1e-3]
    means = {size: (a.mean(axis=0), b.mean(axis=0)) for size, (a, b) in window.items()}
    text = common.page(
        "**A spall of 3 × 3 mm** (9 mm², larger than the criterion of 6.5 mm²). Loss, radial / axial [%], a roller "
        "centred:",
        common.grid(
            ["law", *(f"{d}, {r:g}/{a:g} N" for d in ("secant", "tangent") for r, a in LOADS),
             "secant, mean of phases"],
            [[name, *(" / ".join(f"{v:.2f}" for v in small[name, d, load]) for d in ("secant", "tangent")
                      for load in LOADS), " / ".join(f"{v:.2f}" for v in small_mean[name])] for name in laws],
        ),
        "**Length or width.** Radial secant loss [%] by the table, 9000/4500 N:",
        common.grid(
            ["", *(f"{length:g} × {width:g} mm" for length, width in sizes)],
            [[name, *(f"{v:.2f}" for v in grown[phase])]
             for phase, name in ((0.0, "roller centred"), ("mean", "mean of phases"))],
        ),
        f"Four times the length multiplies the loss by {factors[0.0][0]:.1f} (centred) and {factors['mean'][0]:.1f} "
        f"(mean), four times the width by {factors[0.0][1]:.1f} and {factors['mean'][1]:.1f}.",
        "**Depth, inner raceway, window.**",
        common.picture(picture, "Approach over depth; over length on both raceways; losses over the cage's phase"),
        f"One contact on the inner raceway is like one on the outer: 8 mm raise the inner approach by "
        f"{100 * gain_inner[-1]:.1f} %, the outer by {100 * gain_outer[-1]:.1f} % at {ROLLERS[-1]:.0f} N "
        f"({100 * gain_inner[0]:.0f} and {100 * gain_outer[0]:.0f} % at {ROLLERS[0]:.0f} N); radial secant loss with "
        f"each as the only elastic contact {raceways['inner'][-1, 0]:.2f} and {raceways['outer'][-1, 0]:.2f} %. The "
        "bearing with both, and its inner ring turning: section 12.",
        common.grid(
            ["8 mm long, mean loss over phases, radial / axial [%]", "hard window, Table 2", "ramp, table",
             "largest loss, hard", "ramp"],
            [[f"{width:g} mm wide", *(" / ".join(f"{v:.2f}" for v in m) for m in means[length, width]),
              *(f"{v[:, 0].max():.2f}" for v in window[length, width])] for length, width in window],
        ),
    )  # fmt: skip
    at_own = [small[name, "secant", (9000.0, 4500.0)] for name in laws]
    ramp_cost = max(float(np.abs(a - b).max()) for a, b in means.values())
    claims = (
        Claim("a spall of 9 mm² (3 × 3 mm) costs less than 3 % radially and axially", ONLY_IF if over else HOLDS,
              "as tangent stiffness, or in the mean over cage phases; secant radial with a roller centred is "
              f"{at_own[0][0]:.2f} % (Table 2) and {at_own[1][0]:.2f} % (table) at 9000/4500 N, "
              f"{small['table', 'secant', LOADS[0]][0]:.2f} % at 2000/1000 N"),
        Claim("the length of the defect is the main factor of stiffness",
              ONLY_IF if factors["mean"][1] > 0.5 * factors["mean"][0] else HOLDS,
              f"a roller is centred and only one fits: four times the width then does nothing (× "
              f"{factors[0.0][1]:.2f}); "
              f"in the mean over phases length × 4 multiplies the loss by {factors['mean'][0]:.1f}, width × 4 by "
              f"{factors['mean'][1]:.1f}"),
        Claim("the depth of the defect is irrelevant", ONLY_IF if matters else HOLDS,
              f"the spall is deeper than the roller sinks: from {1e3 * min(d for d in DEPTHS if d not in matters):g} "
              f"µm "
              f"on at these loads; with 1 µm the rise of the approach is {100 * (deep[0, -1] - 1):.1f} % instead of "
              f"{100 * (deep[-1, -1] - 1):.1f} % at {ROLLERS[-1]:.0f} N"),
        Claim("a rectangular window for rollers in the defect is enough", ONLY_IF if ramp_cost < 1.0 else FAILS,
              f"the spall is much wider than the contact and no derivative by width is asked for: means over phases "
              f"differ by up to {ramp_cost:.2f} points (laws included), but the derivative by width is 0 at nearly "
              f"every "
              "phase"),
    )  # fmt: skip
    numbers = {
        "small": {f"{n}, {d}, {q[0]:g}/{q[1]:g} N": v for (n, d, q), v in small.items()}, "small_mean": small_mean,
        "sizes": sizes, "grown": {str(k): v for k, v in grown.items()}, "depths": DEPTHS, "rollers": ROLLERS,
        "by_depth": deep, "inner": inner, "outer": outer, "loss_by_raceway": raceways,
        "by_phase": {f"{a:g} x {b:g} mm": [v.tolist() for v in pair] for (a, b), pair in window.items()},
    }  # fmt: skip
    progress(5, 5)
    printed = Printed("loss by 3 × 3 mm, radial / axial [%]", "both < 3", *(f"{a:.2f} / {b:.2f}" for a, b in at_own))
    return Result("Sentences without a figure", text, numbers, claims, (printed,))
