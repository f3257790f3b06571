"""The one constant of the line load: how much longer a land acts that ends at a spall's sharp edge.

python experiments/edge_constant.py [PANELS]   (default 64)

The land's end is moved, in half-widths, until the line load's approach equals that of the full solve (strips, the
cells' Galerkin continuum at 1e-5). Loads fall with the design load in proportion: the contact keeps its shape along the
roller while it gets slender, and what is left is a half-infinite line contact cut off by an edge. The error of a roller
without spall, under the same line load, is taken off first: it belongs to the far ends.
"""

from __future__ import annotations

import sys

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

import difftrb as trb  # noqa: E402
from difftrb import line  # noqa: E402

LOADS = (1000.0, 300.0, 100.0, 30.0)  # N
LENGTHS = (2.0, 5.0, 8.0)  # mm
CROWN = 10.0  # design load by load


def approach(contact: trb.LineContact, load: float, spall: trb.Spall | None, edge: float, panels: int) -> float:
    """Of the line load with its land's end moved by `edge` half-widths [mm]."""
    found = line._solve(contact, jnp.asarray(load), spall, jnp.zeros(()), jnp.asarray(edge), True, panels)
    return float(found.check().approach)


def constant(load: float, length: float, panels: int, accuracy: float = 1e-5) -> float:
    """The move with which the line load's approach is the full solve's [half-widths]."""
    contact = trb.LineContact(3.623, 13.66, 113794.5, CROWN * load)
    spall = trb.Spall(length, 7.0)
    alike = load / (1.0 - length / 13.66)  # of a roller without spall and as loaded as the land
    whole = float(trb.solve_contact(contact, alike, None, 0.0, accuracy, "strips").check().approach)
    target = float(trb.solve_contact(contact, load, spall, 0.0, accuracy, "strips").check().approach)
    target *= approach(contact, alike, None, 0.0, panels) / whole
    low, high = 0.0, 0.1
    at_low, at_high = (approach(contact, load, spall, edge, panels) - target for edge in (low, high))
    middle = low - at_low * (high - low) / (at_high - at_low)
    at_middle = approach(contact, load, spall, middle, panels) - target
    return middle - at_middle * (high - middle) / (at_high - at_middle)  # secant: approach is nearly linear in it


def main() -> None:
    """Print the constant for lands ever more slender, and for fewer panels."""
    panels = int(sys.argv[1]) if len(sys.argv) > 1 else 64
    table = Table(title="half-widths by which a land acts longer than it is")
    for heading in ("load N", "panels", *(f"{length:g} mm" for length in LENGTHS)):
        table.add_column(heading, justify="right")
    for load in LOADS:
        for count in (panels // 2, panels):
            found = (f"{constant(load, length, count):.4f}" for length in LENGTHS)
            table.add_row(f"{load:g}", str(count), *found)
    Console().print(table)


if __name__ == "__main__":
    main()
