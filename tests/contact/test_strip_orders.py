"""Strips: what 16 rows of land buy over 6."""

import numpy as np
import pytest

import difftrb as trb
from difftrb.contact.grids import GRIDS

pytestmark = pytest.mark.order

# load [N], spall length, width [mm], offset [mm], approach [mm]: 32008J's outer contact with a crown of 3000 N, spalls
# 0.2 mm deep; Polonsky–Keer on edge-aligned grids up to 640 × 1366 and 80 × 10928, Richardson-extrapolated
SMOOTH = [
    (1e3, 0.0, 1.0, 0.0, 3.023218433e-3),
    (3e3, 0.0, 1.0, 0.0, 7.588983207e-3),
    (1e4, 0.0, 1.0, 0.0, 2.174177485e-2),
]
LENGTH = [
    (1e3, 4.0, 1.0, 0.0, 3.690234545e-3),
    (3e3, 4.0, 1.0, 0.0, 9.046521489e-3),
    (1e4, 4.0, 1.0, 0.0, 2.533746477e-2),
]
WIDTH = [
    (3e3, 2.0, 1.0, 0.36, 7.985099359e-3),
    (3e3, 2.0, 1.0, 0.40, 7.874553700e-3),
    (3e3, 2.0, 1.0, 0.46, 7.734098573e-3),
]


@pytest.mark.parametrize("cases", [SMOOTH, LENGTH, WIDTH], ids=["smooth", "length", "width"])
def test_strips_converge_faster_than_first_order(cases: list[tuple[float, ...]]) -> None:
    contact = trb.LineContact(3.623, 13.66, 2.1e5 / (2.0 * (1.0 - 0.278**2)), 3000.0)

    def error(accuracy: float) -> float:
        off = []
        for load, length, width, offset, truth in cases:
            spall = trb.Spall(length, width) if length else None
            found = trb.solve_contact(contact, load, spall, offset, accuracy, "strips").check().approach
            off.append(float(found) / truth - 1.0)
        return float(np.sqrt(np.mean(np.square(off))))

    coarse, fine = (GRIDS[accuracy].strips.land for accuracy in (1e-2, 1e-4))
    assert error(1e-2) / error(1e-4) > (fine / coarse) ** 1.5
