"""What every accuracy of a contact is solved on."""

from __future__ import annotations

import dataclasses
from numbers import Real

from difftrb.contact.contact_cells import Resolution
from difftrb.contact.contact_solution import Defect
from difftrb.contact.strip_plan import Fineness
from difftrb.contact.strip_waves import Frequencies
from difftrb.core import status


@dataclasses.dataclass(frozen=True)
class ContactGrid:
    """What one accuracy is solved on: cells, over one spall or several, strips where these can describe the contact, a
    lattice (rows, columns)."""

    cells: Resolution
    several: Resolution
    strips: Fineness
    lattice: tuple[int, int]

    def cells_over(self, spall: Defect) -> Resolution:
        """For what a roller stands over."""
        return self.several if isinstance(spall, tuple) else self.cells


# Relative accuracy of the approach, and the grids measured to meet it: experiments/accuracy_of_contact.py and
# accuracy_of_strips.py. Cells over several spalls follow the rolling edges of one evenly, those of the others by single
# columns: they need many columns, and few rows. Strips with edges have nearly as many waves as their highest frequency:
# fewer do not follow how two slivers see one another from three half-widths apart. Columns: accuracy; cells, over
# several spalls; strips, their frequencies without and with rolling edges, nodes of their kernel; lattice.
GRIDS = {
    accuracy: ContactGrid(
        Resolution(*cells),
        Resolution(*several),
        Fineness(*strips, Frequencies(*inner), Frequencies(*edges), nodes),
        lattice,
    )
    for accuracy, cells, several, strips, inner, edges, nodes, lattice in (
        (1e-2, (16, 12, 6), (48, 12, 4), (7, 3, 2, 1, 8), (4, 8, 10, 9.0), (4, 8, 38, 38.0), 10, (256, 32)),
        (1e-3, (32, 20, 8), (96, 20, 4), (11, 4, 2, 2, 12), (4, 8, 12, 12.0), (4, 10, 74, 76.0), 12, (512, 48)),
        (1e-4, (64, 64, 16), (128, 40, 6), (16, 6, 2, 2, 16), (4, 12, 12, 12.0), (4, 12, 160, 166.0), 14, (1024, 64)),
        (3e-5, (64, 64, 16), (160, 64, 8), (24, 8, 2, 2, 20), (4, 14, 18, 18.0), (5, 14, 300, 312.0), 16, (1024, 64)),
        (1e-5, (64, 64, 16), (160, 64, 8), (32, 14, 2, 2, 20), (6, 18, 26, 26.0), (5, 14, 300, 312.0), 16, (1024, 64)),
    )
}


def grid_for(accuracy: float) -> ContactGrid:
    """The cheapest grid measured to reach a relative `accuracy` of the approach."""
    return GRIDS[accuracy_met(accuracy)]


def accuracy_met(accuracy: float) -> float:
    """The accuracy that `grid_for` was measured at."""
    known = isinstance(accuracy, Real) and accuracy <= max(GRIDS)
    enough = [a for a in GRIDS if a <= accuracy * (1.0 + 1e-9)] if known else []
    if not enough:
        raise status.SceneError(f"accuracy = {accuracy!r} is out of range: {min(GRIDS):g} … {max(GRIDS):g}")
    return max(enough)
