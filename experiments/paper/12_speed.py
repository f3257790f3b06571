"""Fig. 15 with rollers at rest between outer raceway, inner raceway and flange: what speed does to their loads."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import difftrb as trb
from difftrb import effects
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


def run(out: Path, progress: Progress) -> Result:
    """Loads by speed, at both loads, with either thing held."""
    cases = [(load, control) for load in (LIGHT, HEAVY) for control in CONTROLS]
    figure, panels = common.axes(1, 2, height=3.2)
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
        if control == "position":
            ax, unit = panels[0 if load is LIGHT else 1], 1.0 if load is LIGHT else 1e3
            for colour, speed, r in zip(common.COLOURS, SPEEDS, every, strict=False):
                degrees = np.degrees((np.asarray(r.angles) + np.pi) % (2.0 * np.pi) - np.pi)
                order = np.argsort(degrees)
                ax.plot(degrees[order], np.asarray(r.loads)[order] / unit, "o-", ms=2.5, lw=1.0, color=colour,
                        label=f"{speed:g} rev/min, outer")  # fmt: skip
                ax.plot(degrees[order], np.asarray(r.effects["inner_loads"])[order] / unit, ":", lw=1.2, color=colour)
            ax.set_xlabel("angle from the load line [°]")
            ax.set_xticks([-180, -90, 0, 90, 180])
            ax.set_ylabel(f"roller load [{'N' if load is LIGHT else 'kN'}]")
            ax.set_title(f"{load.radial:g}/{load.axial:g} N at rest, then held")
        progress(done + 1, len(cases))
    panels[1].legend(fontsize=7, loc="lower center")
    picture = common.save(figure, out, "speed")
    light = numbers[f"120/60 N, {CONTROLS['position']}, 7100 rev/min"]["axial"]
    heavy = numbers[f"9000/4500 N, {CONTROLS['position']}, 7100 rev/min"]["axial"]
    refused = [row[0] for row in rows if row[1] == "–"]
    text = common.page(
        "Equation (5) as printed cannot raise a load by speed (section 5). A roller at rest between its three contacts "
        "can (Liu et al. 2022, eq. 5), and what it does depends on what holds the rings. Both raceways in series, "
        "Table 2's law on each. Largest loads [N]:",
        common.grid(["", "F_c [N]", "axial force [N]", "outer", "inner", "flange"], rows),
        common.picture(picture, "Loads of outer (solid) and inner raceway (dotted) at four speeds, rings held"),
        "With a given axial force the sum of the outer loads stays and so, nearly, does each of a fully loaded ring; "
        "the inner ones fall and the flange takes more. With a given position the outer loads rise. Rollers that carry "
        "nothing are thrown against the outer raceway, and their forces press the rings apart: "
        + (f"no equilibrium for {'; '.join(refused)}." if refused else "here there is an equilibrium in every case."),
    )
    claim = Claim(
        "roller loads rise with speed (Fig. 15), by a balance of every roller", ONLY_IF,
        f"the axial position is held, not the force: the axial force then rises from 60 to {light:.1f} N and from 4500 "
        f"to {heavy:.0f} N at 7100 rev/min",
    )  # fmt: skip
    return Result("Figure 15 again: speed, with rollers at rest", text, numbers, (claim,))
