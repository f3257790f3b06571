"""How many steps of projected gradient a contact takes, over grids, loads and spalls.

python experiments/iterations_of_contact.py [--fine]   (--fine adds 128 columns × 64 rows; a minute more)

Two measures, both relative to the approach: its own error against the exact forces of that grid (the first step from
which on it stays below), and the largest violation of the contact conditions in any cell (the first step that meets
it). From the solver's own start, by its own steps; it goes on to `projected_gradient.GOAL`. A step applies the
influence once, and once more where it ends on forces that would be tension.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import difftrb as trb
from difftrb.contact import gap as gaps
from difftrb.contact import halfspace, projected_gradient
from difftrb.contact.contact_cells import Resolution, stage
from difftrb.contact.contact_solution import Inputs

GRIDS = (Resolution(16, 8, 4), Resolution(32, 16, 8), Resolution(64, 28, 12))
FINE = Resolution(128, 48, 16)
LOADS = (300.0, 3000.0, 10000.0)  # [N]
SPALLS = {  # length, width, offset [mm]
    "healthy": (0.0, 7.0, 0.0),
    "wide": (4.0, 7.0, 0.0),
    "edge in the middle": (4.0, 7.0, 3.5),
    "edge off the middle": (4.0, 7.0, 3.55),
    "narrow": (4.0, 0.08, 0.0),
}
GOALS = (1e-4, 1e-6)
STEPS = 150


class Steps(NamedTuple):
    """Steps until approach error and worst violation meet every goal, shape (cases, goals); `STEPS` + 1: not met."""

    approach: np.ndarray
    violation: np.ndarray


def cases() -> np.ndarray:
    """Load [N], length, width and offset [mm], shape (loads · spalls, 4)."""
    return np.array([(load, *spall) for load in LOADS for spall in SPALLS.values()])


def histories(contact: trb.LineContact, grid: Resolution, rows: np.ndarray, count: int) -> tuple[np.ndarray, ...]:
    """Relative approach error and worst violation after every step, shape (cases, count)."""

    def one(case: jax.Array) -> tuple[jax.Array, jax.Array]:
        spall = trb.Spall(case[1], case[2])
        cells, gap, _ = stage(Inputs(contact, case[0], spall, case[3]), grid, True)
        matrix = halfspace.influence(cells, jnp.asarray(contact.modulus))
        guess = projected_gradient.first_guess(cells.area, gap, gaps.first_level(cells, contact.radius))
        exact = projected_gradient.press_from(guess, matrix, gap, case[0])[1]
        s = projected_gradient.scaled(guess, matrix, gap, case[0])
        step, start = projected_gradient.descent(s.W, s.gap, s.share)

        def record(
            state: projected_gradient.Descent, _: None
        ) -> tuple[projected_gradient.Descent, tuple[jax.Array, jax.Array]]:
            state = step(state)
            approach, violation = projected_gradient.violation(state.force, state.lifted + s.gap)
            return state, (jnp.abs(approach * s.length / exact - 1.0), violation)

        return jax.lax.scan(record, start, None, length=count)[1]

    approach, violation = jax.jit(lambda r: jax.lax.map(one, r))(jnp.asarray(rows))
    return np.asarray(approach), np.asarray(violation)


def steps(contact: trb.LineContact, grid: Resolution, rows: np.ndarray, count: int = STEPS) -> Steps:
    """Steps that every case takes on a grid."""
    approach, violation = histories(contact, grid, rows, count)

    def lasting(error: np.ndarray, goal: float) -> np.ndarray:
        missed = error > goal
        return np.where(missed.any(axis=1), count + 1 - np.argmax(missed[:, ::-1], axis=1), 1)

    def first(error: np.ndarray, goal: float) -> np.ndarray:
        met = error <= goal
        return np.where(met.any(axis=1), np.argmax(met, axis=1) + 1, count + 1)

    return Steps(
        np.stack([lasting(approach, goal) for goal in GOALS], axis=1),
        np.stack([first(violation, goal) for goal in GOALS], axis=1),
    )


def main() -> None:
    """Measure all and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fine", action="store_true", help=f"also {FINE.columns} × {FINE.land + FINE.spall}")
    grids = (*GRIDS, FINE) if parser.parse_args().fine else GRIDS
    contact, rows = trb.LineContact.of(trb.bearing("32008J")), cases()
    table = Table(title=f"steps of projected gradient: worst of loads of {', '.join(f'{q:g}' for q in LOADS)} N")
    for heading in ("grid", "spall", *(f"{what} {goal:g}" for what in ("approach", "violation") for goal in GOALS)):
        table.add_column(heading, justify="left" if heading in ("grid", "spall") else "right")
    for grid in track(grids, description="grids", transient=True):
        found = np.concatenate(steps(contact, grid, rows), axis=1).reshape(len(LOADS), len(SPALLS), -1)
        name = f"{grid.columns} × {grid.land + grid.spall}"
        for spall, worst in zip((*SPALLS, "all"), (*found.max(axis=0), found.max(axis=(0, 1))), strict=True):
            table.add_row(
                name, spall, *(f"> {STEPS}" if n > STEPS else str(n) for n in worst), end_section=spall == "all"
            )
    Console().print(table)


if __name__ == "__main__":
    main()
