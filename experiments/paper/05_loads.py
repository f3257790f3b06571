"""Figs 15 and 16: load distribution, with speed as the paper's equation has it, and over spall length."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import difftrb as trb
from difftrb.core import geometry
from difftrb.ring import effects
from experiments.paper import common
from experiments.paper.common import FAILS, HEAVY, HOLDS, LENGTHS, LIGHT, ONLY_IF, Claim, Progress, Result

SPEEDS = (0.0, 3000.0, 5000.0, 7100.0)
"""Of the inner ring [rev/min]; the paper does not print its own."""
OTHER_LOADS = ((2000.0, 1000.0), (9000.0, 4500.0), (20000.0, 10000.0), (9000.0, 3000.0), (9000.0, 9000.0))
WIDTH = 7.0


def centrifugal(speed: float) -> float:
    """Centrifugal force of one roller [N] at `speed` of the inner ring [rev/min], the outer one at rest."""
    return float(effects.Centrifugal(speed).force(common.bearing()))


def printed_sums(phase: float = 0.1) -> tuple[float, float]:
    """Σcosφ and Σsinφ over the rollers: all that eq. (5) as printed has of the centrifugal force."""
    angles = phase + float(geometry.roller_pitch(common.bearing())) * np.arange(common.bearing().rollers)
    return float(np.cos(angles).sum()), float(np.sin(angles).sum())


def by_distance(spalled: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """What the roller in the spall and the next six gain [%]; NaN where a healthy bearing loads none."""
    return 100.0 * (spalled / np.where(sound > 0.0, sound, np.nan) - 1.0)[:7]


def turned(angles: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles in −180…180° in order, and the values with them."""
    degrees = np.degrees((angles + np.pi) % (2.0 * np.pi) - np.pi)
    order = np.argsort(degrees)
    return degrees[order], values[order]


def run(out: Path, progress: Progress) -> Result:
    """Both figures."""
    laws = common.four_laws()
    names = ("Table 2 as printed", "ours, half-space, table")
    progress(1, 3)
    figure, panels = common.axes(1, 3, height=3.0)
    fig15 = {}
    for ax, load, unit in zip(panels[:2], (LIGHT, HEAVY), (1.0, 1e3), strict=True):
        for name, style in zip(names, ("o-", "s--"), strict=True):
            solved = trb.solve(common.scene(laws[name], 4.0, WIDTH, load=load)).check()
            fig15[f"{name}, {load.radial:g}/{load.axial:g} N"] = np.asarray(solved.loads)
            ax.plot(
                *turned(np.asarray(solved.angles), np.asarray(solved.loads) / unit), style, ms=3, lw=1.0, label=name
            )
        ax.set_ylim(bottom=0.0)
        ax.set_ylabel(f"roller load [{'N' if unit == 1.0 else 'kN'}]")
        ax.set_title(f"Fig. 15: {load.radial:g}/{load.axial:g} N")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left", ncols=2, fontsize=7)
    every = {
        name: np.array([np.asarray(trb.solve(common.scene(law, length, WIDTH)).loads) for length in LENGTHS])
        for name, law in laws.items()
    }
    angles = np.asarray(trb.solve(common.scene(laws[names[0]], 4.0, WIDTH)).angles)
    for i, length in enumerate(LENGTHS):
        panels[2].plot(*turned(angles, every[names[1]][i] / 1e3), "o-", ms=3, lw=1.0, color=common.COLOURS[i],
                       label=f"{length:g} mm")  # fmt: skip
    panels[2].set_xlim(-100.0, 100.0)
    panels[2].set_ylim(bottom=0.0)
    panels[2].set_ylabel("roller load [kN]")
    panels[2].set_title("Fig. 16: lengths, table")
    panels[2].legend(fontsize=7, loc="lower center", ncols=2)
    for ax in panels:
        ax.set_xlabel("angle from the load line [°]")
        ax.set_xticks([-180, -90, 0, 90, 180] if ax is not panels[2] else [-90, -45, 0, 45, 90])
    picture = common.save(figure, out, "loads")
    progress(2, 3)
    gains = {name: by_distance(loads[-1], loads[0]) for name, loads in every.items()}
    swept = {}
    for radial, axial in OTHER_LOADS:
        for name in names:
            one = common.scene(laws[name], 8.0, WIDTH, load=trb.Load(radial, axial))
            spalled, sound = (np.asarray(trb.solve(s).check().loads) for s in (one, trb.healthy(one)))
            swept[f"{radial:g}/{axial:g} N, {name}"] = by_distance(spalled, sound)
    cos_sum, sin_sum = printed_sums()
    sums = {load.axial: float(trb.solve(common.scene(laws[names[0]], 4.0, WIDTH, load=load)).loads.sum())
            for load in (LIGHT, HEAVY)}  # fmt: skip
    forces = {speed: centrifugal(speed) for speed in SPEEDS}
    sine = np.sin(float(common.bearing().outer_angle))
    emptiest = float(trb.solve(common.scene(laws[names[1]], 8.0, WIDTH, load=LIGHT)).loads[0])
    light = fig15[f"{names[0]}, 120/60 N"][0], fig15[f"{names[1]}, 120/60 N"][0]
    text = common.page(
        "**Fig. 15, speed.** The paper's loads rise with speed. Eq. (5) as printed cannot do that: its centrifugal "
        "term "
        f"is |F_c Σcosφ| = {abs(cos_sum):.0e} F_c and |F_c Σsinφ| = {abs(sin_sum):.0e} F_c for "
        f"{common.bearing().rollers} equal "
        "rollers, and its third row fixes ΣQ = F_z/sinα at every speed:",
        common.grid(
            ["inner ring [rev/min]", "F_c of one roller [N]", "its sum in eq. (5) [N]", "ΣQ, 60 N axial [N]", "4500 N"],
            [[f"{speed:g}", f"{force:.2f}", f"{abs(force * cos_sum):.0e}", f"{60.0 / sine:.1f}",
              f"{4500.0 / sine:.0f}"] for speed, force in forces.items()],
        ),
        f"Our sums at rest: {sums[60.0]:.1f} and {sums[4500.0]:.0f} N. So with the printed convention every curve of "
        f"the "
        "figure is the one at rest, drawn below. (A balance of each roller between outer raceway, inner raceway and "
        "flange is another model than eq. 5.) At the light load Table 2 is used far below its range: the roller in the "
        f"spall gets {light[0]:.1f} N by it and {light[1]:.1f} N by the table.",
        common.picture(picture, "Load distributions at two loads with a 4 × 7 mm spall, and for five spall lengths"),
        "**Fig. 16**, spall 7 mm wide, 9000/4500 N. Load of the roller over the spall [N]:",
        common.grid(
            ["law", *(f"{length:g} mm" for length in LENGTHS)],
            [[name, *(f"{v:.0f}" for v in loads[:, 0])] for name, loads in every.items()],
        ),
        "What rollers gain with 8 mm, by distance from the spall in rollers [%]:",
        common.grid(
            ["law", "in it", "1", "2", "3", "4", "5", "6"],
            [[name, *(f"{v:+.1f}" for v in row)] for name, row in gains.items()]
            + [[name, *(f"{v:+.1f}" for v in row)] for name, row in swept.items()],
        ),
        "Less with distance at every load. (At 9000/3000 N only part of the ring is loaded, and the spall takes its "
        "ends "
        "back: their small loads change most.)",
    )  # fmt: skip
    falls = all((np.diff(row[1:6]) < 0.0).all() for row in gains.values())
    rises = [name for name, row in swept.items() if (np.diff(row[1:6]) > 0.0).all()]
    never_0 = min(loads[:, 0].min() for loads in every.values())
    falling = all((np.diff(loads[:, 0]) < 0.0).all() for loads in every.values())
    printed, table = (gains[name] for name in names)
    claims = (
        Claim("roller loads rise with speed (Fig. 15)", FAILS,
              "by eq. (5) as printed: Σcosφ = Σsinφ = 0, and ΣQ = F_z/sinα at every speed"),
        Claim("the roller in the spall loses load, the more the longer the spall, and never all of it (Fig. 16)",
              (HOLDS if emptiest > 0.0 else ONLY_IF) if never_0 > 0.0 and falling else FAILS,
              f"with 8 mm {printed[0]:.1f} % by Table 2, {table[0]:.1f} % by the table (9000/4500 N); at 120/60 N the "
              f"crown keeps the roller off the land beside the spall: {emptiest:.2g} N of 21 N by the table"),
        Claim("the other rollers gain the more, the further they stand from the spall (text of Fig. 16)",
              FAILS if falls and not rises else ONLY_IF,
              "the less: " + ", ".join(f"{v:+.1f}" for v in printed[1:]) + " % (Table 2), "
              + ", ".join(f"{v:+.1f}" for v in table[1:]) + " % (table)"),
    )  # fmt: skip
    numbers = {
        "centrifugal": {f"{k:g}": v for k, v in forces.items()}, "sums": [cos_sum, sin_sum], "angles": angles,
        "fig_15": fig15, "fig_16": every, "gains": gains, "gains_at_other_loads": swept,
    }  # fmt: skip
    progress(3, 3)
    return Result("Figures 15 and 16: load distribution", text, numbers, claims)
