"""Figs 18 and 19: load distribution and stiffness over spall width, by a hard window, a ramp, and averaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import difftrb as trb
from difftrb.core import geometry
from experiments.paper import common
from experiments.paper.common import FAILS, HOLDS, ONLY_IF, Claim, Printed, Progress, Result

LENGTH = 4.0
OTHER_LOADS = ((2000.0, 1000.0), (20000.0, 10000.0))
ENTRIES = (15.5, 31.0, 46.8)
"""Widths [mm] at about which rollers come in."""
WIDTHS = tuple(7.0 * k for k in range(1, 8))
STEPS = np.unique(
    np.concatenate([[0.7], np.arange(1.0, 51.0, 0.5), *(w + np.linspace(-0.2, 0.8, 11) for w in ENTRIES)])
)


def inside(width: float) -> int:
    """How many rollers have their contact's middle in a spall of this width [mm], one being centred."""
    arc = float(geometry.arc_radius(common.bearing())) * float(geometry.roller_pitch(common.bearing()))
    return 2 * int(np.floor(0.5 * width / arc)) + 1


def run(out: Path, progress: Progress) -> Result:
    """Both figures."""
    hard, soft = trb.liu2018(), common.table_law()
    loads = {
        name: np.array([
            np.asarray(trb.solve(common.scene(law, length, width)).check().loads)
            for length, width in ((0.0, 7.0), *((LENGTH, width) for width in WIDTHS))
        ]) for name, law in {"Table 2": hard, "table": soft}.items()
    }  # fmt: skip
    progress(1, 4)
    ways: dict[str, tuple[Any, Any]] = {
        "Table 2, hard window, roller centred": (hard, 0.0), "table, ramp, roller centred": (soft, 0.0),
        "Table 2, hard window, mean of phases": (hard, "mean"), "table, ramp, mean of phases": (soft, "mean"),
    }  # fmt: skip
    losses = {}
    for name, (law, phase) in ways.items():
        losses[name] = common.losses_over(law, LENGTH, STEPS, phase=phase)
    swept = {
        (load, name): common.losses_over(law, LENGTH, WIDTHS, phase=phase, load=trb.Load(*load))
        for load in OTHER_LOADS
        for name, (law, phase) in ways.items()
    }
    tangent = {
        name: common.losses_over(law, LENGTH, WIDTHS, phase=phase, definition="tangent")
        for name, (law, phase) in ways.items()
    }
    progress(2, 4)
    figure, panels = common.axes(1, 3, height=3.1)
    angles = np.degrees(np.asarray(trb.solve(common.scene(hard, LENGTH, 7.0)).angles))
    angles = (angles + 180.0) % 360.0 - 180.0
    order = np.argsort(angles)
    for k in (0, 1, 3, 5, 7):
        label = "healthy" if k == 0 else f"{WIDTHS[k - 1]:g} mm"
        panels[0].plot(angles[order], loads["table"][k][order] / 1e3, "o-", ms=3, lw=1.0, label=label)
    panels[0].set_xlim(-100.0, 100.0)
    panels[0].set_xticks([-90, -45, 0, 45, 90])
    panels[0].set_ylim(bottom=0.0)
    panels[0].set_xlabel("angle from the load line [°]")
    panels[0].set_ylabel("roller load [kN]")
    panels[0].set_title("Fig. 18: by width, table law")
    panels[0].legend(fontsize=7, loc="lower center", ncols=2)
    for ax, column, title in zip(panels[1:], (0, 1), ("radial", "axial"), strict=True):
        for name, colour, style in zip(ways, (*common.HUES, *common.HUES), ("--", "-", ":", "-."), strict=True):
            ax.plot(STEPS, losses[name][:, column], style, color=colour, lw=1.2, label=name)
        ax.set_xlabel("spall width [mm]")
        ax.set_ylabel(f"loss of {title} secant stiffness [%]")
        ax.set_ylim(bottom=0.0)
        ax.set_title(f"Fig. 19: {title}")
    figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=7)
    picture = common.save(figure, out, "width")
    progress(3, 4)
    at = [int(np.argmin(np.abs(STEPS - width))) for width in WIDTHS]
    rows = []
    for k, width in enumerate(WIDTHS, 1):
        rows.append([
            f"{width:g}", inside(width), f"{loads['Table 2'][k, 0]:.0f}", f"{loads['table'][k, 0]:.0f}",
            *(" / ".join(f"{v:.2f}" for v in losses[name][at[k - 1]]) for name in ways),
        ])  # fmt: skip
    steps = [abs(np.diff(losses[name][:, 0])).max() for name in list(ways)[:2]]
    text = common.page(
        f"Spall {LENGTH:g} mm long, 9000/4500 N. Rollers inside, load of the centred roller [N] (healthy: "
        f"{loads['Table 2'][0, 0]:.0f} by Table 2, {loads['table'][0, 0]:.0f} by the table), and secant loss radial / "
        "axial [%]:",
        common.grid(["b_d [mm]", "inside", "load, Table 2", "table", *ways], rows),
        "The same as tangent stiffness, radial / axial [%]:",
        common.grid(
            ["b_d [mm]", *ways],
            [[f"{width:g}", *(" / ".join(f"{v:.2f}" for v in tangent[name][k]) for name in ways)]
             for k, width in enumerate(WIDTHS)],
        ),
        "The paper does not print its load; secant losses at other loads, radial / axial [%]:",
        common.grid(
            ["load [N]", "b_d [mm]", *ways],
            [
                [f"{r:g}/{a:g}", f"{width:g}", *(" / ".join(f"{v:.2f}" for v in swept[(r, a), n][k]) for n in ways)]
                for r, a in OTHER_LOADS
                for k, width in list(enumerate(WIDTHS))[::3]
            ],
        ),
        common.picture(picture, "Load distribution for five widths, and losses over width four ways"),
        "The paper's figure 19 cannot be compared number by number; this is it, computed. With the paper's hard window "
        "and a centred roller stiffness is a staircase: its derivative by width is zero between the steps, "
        f"{steps[0]:.1f} points of radial loss high. With the ramp the steps are as wide as the contact's ramp "
        "is long, still steps. Averaged over the cage's phase the loss grows smoothly, and so has a gradient by width.",
    )  # fmt: skip
    climb = {name: np.diff(v[1:, 0]) for name, v in loads.items()}
    climbs = all((d > -1e-6 * 1600.0).all() for d in climb.values())
    recovered = [(v[-1, 0] - v[1, 0]) / (v[0, 0] - v[1, 0]) for v in loads.values()]
    grows = all((np.diff(losses[name], axis=0) > -1e-6).all() for name in list(ways)[2:])
    claims = (
        Claim("loads inside the defect climb back towards healthy as it widens (Fig. 18)", HOLDS if climbs else ONLY_IF,
              f"of what the centred roller lost, {100 * recovered[0]:.0f} % (Table 2) or {100 * recovered[1]:.0f} % "
              "(table) is back at 49 mm"),
        Claim("stiffness falls with width (Fig. 19)", ONLY_IF if grows else FAILS,
              "smoothly in the mean over cage phases; with a roller centred in steps, as rollers come in"
              if grows else "not even in the mean over cage phases"),
    )  # fmt: skip
    numbers = {
        "widths": WIDTHS, "tangent_loss": tangent, "loads": loads, "steps": STEPS, "loss": losses,
        "recovered": recovered, "loss_at_loads": {f"{r:g}/{a:g} N; {n}": v for ((r, a), n), v in swept.items()},
    }  # fmt: skip
    progress(4, 4)
    radius = float(geometry.arc_radius(common.bearing()))
    ours = common.listed([width / radius for width in (WIDTHS[0], WIDTHS[-1])], 2)
    printed = Printed("angle of a spall 7 and 49 mm wide [rad]", "0.24, 1.71", ours, ours)
    return Result("Figures 18 and 19: width", text, numbers, claims, (printed,))
