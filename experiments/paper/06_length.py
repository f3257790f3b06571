"""Fig. 17: radial and axial stiffness over spall length, by load, definition of stiffness and law."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import difftrb as trb
from experiments.paper import clipped, common
from experiments.paper.common import FAILS, HEAVY, HOLDS, LENGTHS, ONLY_IF, Claim, Progress, Result

STEPS = np.linspace(0.0, 8.0, 33)
LOADS = ((1000.0, 500.0), (2000.0, 1000.0), (9000.0, 4500.0), (20000.0, 10000.0), (9000.0, 3000.0), (9000.0, 9000.0))
RISING = np.geomspace(300.0, 30000.0, 25)
"""Radial loads [N] at which the axial one is half as large."""
WIDTH = 7.0
PRINTED = np.array([8.7, 3.5])


def in_series(loads: np.ndarray) -> trb.PowerLaw:
    """Power laws of a spalled outer and a healthy inner contact one behind the other."""
    inner = common.half_space(common.contact("inner"), loads, (0.0,))
    return common.as_law(clipped.power_fit(loads, common.half_space(common.contact(), loads) + inner), loads)


def run(out: Path, progress: Progress) -> Result:
    """Losses over length, and over load."""
    laws = {"Table 2": trb.liu2018(), "table": common.table_law()}
    progress(1, 5)
    curves = {
        (name, definition): common.losses_over(law, STEPS, WIDTH, definition=definition)
        for name, law in laws.items() for definition in ("secant", "tangent")
    }  # fmt: skip
    progress(2, 5)
    swept = {}
    for radial, axial in LOADS:
        for (name, law), definition in ((i, d) for i in laws.items() for d in ("secant", "tangent")):
            swept[radial, axial, name, definition] = common.losses_over(
                law, LENGTHS, WIDTH, load=trb.Load(radial, axial), definition=definition
            )
    rising = {
        name: np.array([
            common.losses_over(law, [8.0], WIDTH, load=trb.Load(q, 0.5 * q))[0] for q in RISING
        ]) for name, law in laws.items()
    }  # fmt: skip
    progress(3, 5)
    rollers = np.geomspace(270.0, 2000.0, 15)
    extra = {
        "outer contact alone, power law fitted to 0.27–2 kN": common.as_law(
            clipped.power_fit(rollers, common.half_space(common.contact(), rollers)), rollers
        ),
        "outer and healthy inner contact in series, same loads": in_series(rollers),
    }
    both = {
        name: np.concatenate([common.losses_over(law, [8.0], WIDTH, definition=d)[0] for d in ("secant", "tangent")])
        for name, law in extra.items()
    }
    progress(4, 5)
    figure, panels = common.axes(1, 3, height=3.1)
    for ax, column, title in zip(panels[:2], (0, 1), ("radial", "axial"), strict=True):
        for (name, definition), values in curves.items():
            colour, style = common.HUES[name == "table"], "-" if definition == "secant" else "--"
            ax.plot(STEPS, values[:, column], style, color=colour, lw=1.3, label=f"{name}, {definition}")
        ax.plot([8.0], [PRINTED[column]], **common.PAPER, label="text of the paper")
        ax.set_xlabel("spall length [mm]")
        ax.set_ylabel(f"loss of {title} stiffness [%]")
        ax.set_xticks(LENGTHS)
        ax.set_ylim(bottom=0.0)
    panels[0].legend(fontsize=7)
    for name, values in rising.items():
        for column, style in ((0, "-"), (1, "--")):
            label = f"{name}, {('radial', 'axial')[column]}"
            panels[2].semilogx(
                RISING / 1e3, values[:, column], style, color=common.HUES[name == "table"], lw=1.3, label=label
            )
    panels[2].set_xticks([0.3, 1.0, 3.0, 10.0, 30.0], ["0.3", "1", "3", "10", "30"])
    panels[2].minorticks_off()
    panels[2].set_xlabel("radial load (axial: half) [kN]")
    panels[2].set_ylabel("secant loss by 8 × 7 mm [%]")
    panels[2].set_ylim(bottom=0.0)
    panels[2].legend(fontsize=7)
    picture = common.save(figure, out, "stiffness_over_length")
    rows = []
    for radial, axial in LOADS:
        cells = [swept[radial, axial, n, d][-1] for n in laws for d in ("secant", "tangent")]
        rows.append([f"{radial:g}/{axial:g}", *(f"{a:.2f} / {b:.2f}" for a, b in cells)])
    rows.append(["the paper's text (load not given)", "8.7 / 3.5", "", "", ""])
    spread = {name: values[:, 0] for name, values in rising.items()}
    text = common.page(
        "Spall 7 mm wide, roller centred. Losses by 8 mm at different loads, radial / axial [%]; *Table 2*: the "
        "paper's laws, *table*: half-space contacts:",
        common.grid(["load [N]", "Table 2, secant", "Table 2, tangent", "table, secant", "table, tangent"], rows),
        common.picture(picture, "Losses over spall length and over load"),
        "(Negative: at 9000/3000 N the axial displacement is so small that its ratio to the load says nothing.) "
        f"The paper's 8.7 and 3.5 % are met by secant stiffness at {HEAVY.radial:g}/{HEAVY.axial:g} N, with Table 2. "
        f"From {RISING[0]:g} to {RISING[-1]:g} N Table 2 lets the radial loss vary between "
        f"{spread['Table 2'].min():.1f} "
        f"and {spread['Table 2'].max():.1f} %: a power law has hardly a scale of load. The half-space has one, the "
        f"crown's: {spread['table'].min():.1f} to {spread['table'].max():.1f} %, the lighter the load the more.",
        "Only the outer contact is elastic in the paper. With the healthy inner one behind it, secant radial / axial, "
        "tangent radial / axial [%]:",
        common.grid(["law", "secant", "tangent"],
                    [[name, f"{v[0]:.2f} / {v[1]:.2f}", f"{v[2]:.2f} / {v[3]:.2f}"] for name, v in both.items()]),
    )  # fmt: skip
    not_falling = {
        f"{('radial', 'axial')[c]} {d} at {r:g}/{a:g} N"
        for (r, a, _, d), v in swept.items() for c in (0, 1) if (np.diff(v[:, c]) < -1e-9).any()
    }  # fmt: skip
    claims = (
        Claim("both stiffnesses fall the longer the spall (Fig. 17)", ONLY_IF if not_falling else HOLDS,
              f"at {len(LOADS)} loads by both laws and definitions"
              + (f", except: {', '.join(sorted(not_falling))}, where the displacement is nearly 0" if not_falling
                 else "")),
        Claim("the trend does not depend on the load (Fig. 17)",
              ONLY_IF if np.ptp(spread["Table 2"]) < 3.0 < np.ptp(spread["table"]) else FAILS,
              "loads are near the design load: with 8 mm the radial secant loss is "
              f"{spread['table'][0]:.0f} % at {RISING[0]:g} N and {spread['table'][-1]:.1f} % at {RISING[-1]:g} N "
              f"(Table 2: {spread['Table 2'][0]:.1f} and {spread['Table 2'][-1]:.1f} %)"),
    )  # fmt: skip
    numbers = {
        "lengths": STEPS, "loss": {f"{n}, {d}": v for (n, d), v in curves.items()},
        "loss_at_loads": {f"{r:g}/{a:g} N, {n}, {d}": v for (r, a, n, d), v in swept.items()},
        "radial_load": RISING, "loss_over_load": rising, "series": both,
    }  # fmt: skip
    progress(5, 5)
    return Result("Figure 17: stiffness over spall length", text, numbers, claims)
