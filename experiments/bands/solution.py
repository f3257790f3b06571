"""What a contact by bands comes back with: how fine it was solved, its pressure on cells, how it is judged."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from difftrb.contact import strip_model
from difftrb.contact.contact_solution import Found, Inputs, verdict
from difftrb.contact.gap import Cells
from difftrb.contact.strip_fourier import Frequencies, Layout
from difftrb.core import status
from experiments.bands import contact as bands
from experiments.bands.reach import spall_edges
from experiments.bands.rows import Fineness

SETTLED = 0.2  # share of the asked-for accuracy that misplaced boundaries may take

# Columns: accuracy; land, hollow, bands, centred, settled at most; frequencies without and with rolling edges; nodes.
FINENESS = {
    accuracy: Fineness(*sizes, SETTLED * accuracy, Frequencies(*inner), Frequencies(*edges), nodes)
    for accuracy, sizes, inner, edges, nodes in (
        (1e-2, (7, 3, 2, 1, 3), (4, 8, 10, 9.0), (4, 8, 24, 30.0), 10),
        (1e-3, (11, 4, 2, 2, 4), (4, 8, 12, 12.0), (4, 10, 28, 40.0), 10),
        (1e-4, (18, 5, 2, 2, 6), (4, 12, 12, 12.0), (4, 10, 54, 90.0), 13),
        (1e-5, (32, 8, 3, 2, 8), (6, 18, 26, 25.0), (5, 14, 80, 120.0), 16),
    )
}


def solve(inputs: Inputs, mirrored: bool, edges: int, accuracy: float, cells: Cells) -> Found:
    """By bands of a relative `accuracy` of the approach, one of FINENESS; pressure is laid on `cells`.

    `edges`: how many rolling edges of the spall may be in reach. Not suited: spalls whose bottom is in reach.
    """
    fine = FINENESS[accuracy]
    found, groups, plan = bands.solve(inputs, mirrored, edges, fine)
    settled, reach = found.settled, found.reach
    layout = Layout(
        rows=tuple(plan.rows.tolist()), outlines=tuple(plan.outline_of.tolist()), sides=tuple(plan.sides.tolist()),
        modes=len(plan.orders), even=plan.even, frequencies=fine.edge_frequencies,
    )  # fmt: skip
    on = settled.active[plan.outline_of]
    loads, ends = jnp.where(on[:, None], settled.loads, 0.0), settled.ends[plan.outline_of]
    if edges == 1:
        turned = inputs.offset < 0.0  # the nearer edge was looked at from its left
        ends = jnp.where(turned, -ends[:, ::-1], ends)
        loads = jnp.where(turned, loads * (-1.0) ** np.array(plan.orders)[None], loads)
    if plan.even:
        ends = ends[:, 1:]
    images = 2.0 if mirrored else 1.0
    force = (
        images * reach.line_load * reach.unit * strip_model._on_cells(layout, groups, loads, ends, cells, reach.unit)
    )
    force, _ = strip_model._pressing(force)
    width = reach.unit * strip_model._width(layout, on, ends)
    code = verdict(found.approach, found.error, SETTLED * accuracy)
    code = jnp.where(found.still & (found.approach > 0.0), code, status.worst(code, jnp.asarray(status.NOT_CONVERGED)))
    if inputs.spall is not None:
        low, high = spall_edges(inputs)
        within = (high < reach.top) & (low > -reach.bottom) if edges else jnp.asarray(True)
        code = jnp.where(within & (inputs.spall.depth > found.approach), code, status.UNSUITED)  # type: ignore[union-attr]
    passes = jnp.asarray(fine.centred + fine.settled)
    return Found(found.approach, force, width, found.error, passes, loads.size, code)
