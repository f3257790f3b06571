"""Fig. 15 with rollers at rest between outer raceway, inner raceway and flange: what speed does to their loads."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

import difftrb as trb
from difftrb.core import geometry
from difftrb.ring import effects
from experiments.paper import common
from experiments.paper.common import HEAVY, LIGHT, ONLY_IF, Claim, Progress, Result

SPEEDS = (0.0, 3000.0, 5000.0, 7100.0)
"""Of the inner ring [rev/min]; the paper does not print its own."""
CONTROLS = {"force": "axial force given", "position": "axial position given"}


def solved(load: trb.Load, speed: float, control: str) -> trb.Solution:
    """4 × 7 mm, Table 2's law on both raceways."""
    law = trb.liu2018()
    acting = effects.SeriesRaceways(None, law), effects.Centrifugal(jnp.asarray(speed), control)  # pyright: ignore[reportArgumentType]
    return trb.solve(dataclasses.replace(common.scene(law, 4.0, 7.0, load=load, definition="tangent"), effects=acting))


def draw(ax: Axes, every: list[trb.Solution], from_rest: bool) -> None:
    """Loads of outer (solid) and inner raceway (dotted) at all speeds, or what they have more than at rest."""
    order = np.argsort(np.asarray(geometry.wrapped(every[0].angles)))
    degrees = np.degrees(np.asarray(geometry.wrapped(every[0].angles)))[order]
    for colour, speed, r in zip(common.COLOURS, SPEEDS, every, strict=False):
        if not bool(r.converged):
            ax.plot([], [], color=colour)
            ax.text(0.03, 0.85, f"{speed:g} rev/min:\nno equilibrium", transform=ax.transAxes, fontsize=7)
            continue
        for name, style, values, rest in (
            ("outer", "o-", r.loads, every[0].loads),
            ("inner", ":", r.effects["inner_loads"], every[0].effects["inner_loads"]),
        ):
            shown = np.asarray(values - rest if from_rest else values)[order]
            ax.plot(degrees, shown, style, ms=2.5, lw=1.1, color=colour, label=f"{speed:g} rev/min, {name}")


def run(out: Path, progress: Progress) -> Result:
    """Loads by speed, at both loads, with either thing held."""
    cases = [(load, control) for load in (LIGHT, HEAVY) for control in CONTROLS]
    figure, panels = common.axes(2, 2, height=2.7, sharex=True)
    numbers, rows = {}, []
    for done, (load, control) in enumerate(cases):
        every = [solved(load, speed, control) for speed in SPEEDS]
        for speed, r in zip(SPEEDS, every, strict=True):
            name = f"{load.radial:g}/{load.axial:g} N, {CONTROLS[control]}, {speed:g} rev/min"
            if not bool(r.converged):
                rows.append([name, "–", "–", "–", "–", "–"])
                continue
            inner, flange = r.effects["inner_loads"], r.effects["flange_loads"]
            axial = float(jnp.sum(r.loads)) * float(np.sin(common.bearing().outer_angle))
            numbers[name] = {"outer": r.loads, "inner": inner, "flange": flange, "axial": axial}
            largest = (float(jnp.max(v)) for v in (r.loads, inner, flange))
            rows.append([
                name, f"{float(r.effects['centrifugal_force']):.1f}", f"{axial:.1f}", *(f"{v:.1f}" for v in largest)
            ])  # fmt: skip
        draw(panels[int(load is HEAVY), int(control == "position")], every, load is HEAVY)
        panels[int(load is HEAVY), int(control == "position")].set_title(
            f"{load.radial:g}/{load.axial:g} N, {CONTROLS[control]}"
        )
        progress(done + 1, len(cases))
    for ax in panels[1]:
        ax.set_xlabel("angle from the load line [°]")
        ax.set_xticks([-180, -90, 0, 90, 180])
    panels[0, 0].set_ylabel("roller load [N]")
    panels[1, 0].set_ylabel("roller load less that at rest [N]")
    handles, labels = panels[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7)
    picture = common.save(figure, out, "speed")
    light = numbers[f"120/60 N, {CONTROLS['position']}, 7100 rev/min"]["axial"]
    heavy = numbers[f"9000/4500 N, {CONTROLS['position']}, 7100 rev/min"]["axial"]
    lone, still = (
        float(jnp.max(numbers[f"120/60 N, {CONTROLS['force']}, {speed} rev/min"]["outer"])) for speed in (5000, 0)
    )
    refused = [row[0] for row in rows if row[1] == "–"]
    text = common.page(
        "Equation (5) as printed cannot raise a load by speed (section 5). A roller at rest between its three contacts "
        "can (Liu et al. 2022, eq. 5), and what it does depends on what holds the rings. Both raceways in series, "
        "Table 2's law on each. Largest loads [N]:",
        common.grid(["", "F_c [N]", "axial force [N]", "outer", "inner", "flange"], rows),
        common.picture(
            picture, "Loads of outer (solid) and inner raceway (dotted) at four speeds, with either thing given"
        ),
        "With a given axial force the sum of the outer loads stays and so, nearly, does each of a fully loaded ring; "
        "the inner ones fall and the flange takes more. With a given position the outer loads rise. Rollers that carry "
        "nothing are thrown against the outer raceway, and their forces press the rings apart: "
        + (f"no equilibrium for {'; '.join(refused)}." if refused else "here there is an equilibrium in every case."),
    )
    claim = Claim(
        "roller loads rise with speed (Fig. 15), by a balance of every roller", ONLY_IF,
        f"the axial position is held, not the force: the axial force then rises from 60 to {light:.1f} N and from 4500 "
        f"to {heavy:.0f} N at 7100 rev/min. With the force given the sum of the outer loads stays; single ones rise "
        f"where most rollers are thrown off the inner raceway ({lone:.0f} N at 120/60 N and 5000 rev/min, "
        f"{still:.0f} N at rest)",
    )  # fmt: skip
    return Result("Figure 15 again: speed, with rollers at rest", text, numbers, (claim,))
