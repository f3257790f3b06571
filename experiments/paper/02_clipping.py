"""What the clipped domain does further down: to the approach, to roller loads, to the bearing's losses."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np

import difftrb as trb
from experiments.paper import clipped, common
from experiments.paper.common import HEAVY, HOLDS, LENGTHS, ONLY_IF, Claim, Printed, Progress, Result

LOADS = np.array([1000.0, 3000.0, 8000.0])
PRINTED = np.array([8.7, 3.5])
"""The paper's largest losses, radial and axial [%], of a spall 8 mm long."""
STEPS = np.linspace(0.0, 8.0, 33)


def run(out: Path, progress: Progress) -> Result:
    """Approach, loads and losses with each set of laws."""
    contact = common.contact()
    cut = np.asarray(clipped.approaches(
        contact, jnp.asarray(LOADS), jnp.asarray(LENGTHS), clipped.NARROWED, clipped.PAPER_GRID
    ))  # fmt: skip
    softer = cut / common.half_space(contact, LOADS) - 1.0
    progress(1, 4)
    laws = common.four_laws()
    progress(2, 4)
    in_spall = {
        name: [float(trb.solve(common.scene(law, length, 7.0)).loads[0]) for length in LENGTHS]
        for name, law in laws.items()
    }
    loss = {
        definition: {name: common.losses_over(law, STEPS, 7.0, definition=definition) for name, law in laws.items()}
        for definition in ("secant", "tangent")
    }
    progress(3, 4)
    figure, panels = common.axes(1, 3, height=3.2)
    for load, row, style in zip(LOADS, softer.T, ("o-", "s--", "^:"), strict=True):
        panels[0].plot(LENGTHS, 100.0 * row, style, ms=4, lw=1.2, label=f"{load / 1e3:g} kN")
    panels[0].set_ylabel("more approach by clipping [%]")
    panels[0].set_ylim(bottom=0.0)
    panels[0].legend(title="roller load")
    for ax, column, name in zip(panels[1:], (0, 1), ("radial", "axial"), strict=True):
        for (label, values), style in zip(loss["secant"].items(), ("-", "--", "-.", ":"), strict=True):
            ax.plot(STEPS, values[:, column], style, lw=1.4, label=label)
        ax.plot([8.0], [PRINTED[column]], **common.PAPER, label="text of the paper")
        ax.set_ylabel(f"loss of {name} secant stiffness [%]")
        ax.set_ylim(bottom=0.0)
    figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower right", ncols=3, fontsize=7)
    for ax in panels:
        ax.set_xlabel("spall length [mm]")
        ax.set_xticks(LENGTHS)
    picture = common.save(figure, out, "clipping")
    rows = []
    for name in laws:
        secant, tangent = (loss[definition][name][-1] for definition in ("secant", "tangent"))
        loads = in_spall[name]
        rows.append([
            name, f"{loads[0]:.0f}", f"{loads[2]:.0f}", f"{loads[4]:.0f}", f"{100 * (loads[4] / loads[0] - 1):.1f} %",
            *(f"{v:.2f}" for v in (*secant, *tangent)),
        ])  # fmt: skip
    rows.append(["the paper's text", "", "", "", "", f"{PRINTED[0]}", f"{PRINTED[1]}", "", ""])
    printed, cut_off, power, truth = (each[-1] for each in loss["secant"].values())
    text = common.page(
        "Approach of a clipped contact by that of the whole half-space, less 1 (a domain that ends inside the contact "
        "is softer, the more so the longer the spall):",
        common.grid(
            ["roller load", *(f"{length:g} mm" for length in LENGTHS)],
            [[f"{q / 1e3:g} kN", *(common.percent(v, 1) for v in row)] for q, row in zip(LOADS, softer.T, strict=True)],
        ),
        f"Bearing at {HEAVY.radial:g}/{HEAVY.axial:g} N, spall 7 mm wide: load of the roller over a spall of 0, 4 and "
        "8 mm [N], what it loses with 8 mm, and the losses of stiffness with 8 mm [%]:",
        common.grid(
            ["law", "0 mm", "4 mm", "8 mm", "", "secant radial", "axial", "tangent radial", "axial"], rows
        ),
        common.picture(picture, "Approach by clipping, and losses of stiffness over spall length with four laws"),
        f"Two errors nearly cancel. Clipping takes the radial loss from {power[0]:.2f} % to {cut_off[0]:.2f} % "
        "(secant, power laws fitted to the same loads). The power law itself, fitted to loads above those that the "
        f"rollers carry here, takes it from {truth[0]:.2f} % to {power[0]:.2f} %; axially from {truth[1]:.2f} % to "
        f"{power[1]:.2f} %. The smooth table of half-space contacts has neither; its error is "
        f"{100 * float(laws['ours, half-space, table'].error):.2g} % of a load.",
    )  # fmt: skip
    progress(4, 4)
    claim = Claim(
        "a spall of 8 mm costs 8.7 % of radial and 3.5 % of axial stiffness (Fig. 17)",
        HOLDS if np.abs(truth - PRINTED).max() < 0.2 else ONLY_IF,
        f"with its own clipped laws, as secant stiffness and at {HEAVY.radial:g}/{HEAVY.axial:g} N: {printed[0]:.2f} "
        f"and {printed[1]:.2f} %; with the half-space {truth[0]:.2f} and {truth[1]:.2f} %",
    )
    row = Printed(
        "loss by 8 × 7 mm, radial / axial [%] (Fig. 17)", f"{PRINTED[0]} / {PRINTED[1]}",
        f"{cut_off[0]:.2f} / {cut_off[1]:.2f}; by Table 2 itself {printed[0]:.2f} / {printed[1]:.2f}",
        f"{truth[0]:.2f} / {truth[1]:.2f}",
    )  # fmt: skip
    numbers = {
        "loads": LOADS, "lengths": LENGTHS, "softer": softer.T, "load_in_spall": in_spall,
        "loss_at_8mm": {d: {name: v[-1] for name, v in each.items()} for d, each in loss.items()},
        "laws": {name: common.numbers(law) for name, law in laws.items()},
    }  # fmt: skip
    return Result("What the clipped domain does further down", text, numbers, (claim,), (row,))
