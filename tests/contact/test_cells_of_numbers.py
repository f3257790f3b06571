"""Contacts of numbers on cells: laid by numpy with all derivatives, pressed by a program that knows no spalls."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import cell_solve, contact_cells
from difftrb.contact import gap as gaps
from difftrb.contact.contact_solution import Defect, given
from difftrb.contact.grids import grid_for
from difftrb.contact.solver import approach_and_gradient
from difftrb.core import arrays as xp
from difftrb.core.taylor import Taylor, parameters

pytestmark = pytest.mark.gradient

CASES: dict[str, tuple[Defect, float | tuple[float, ...], float]] = {
    "healthy": (None, 0.0, 0.0),
    "edge, tilted": (trb.Spall(4.0, 0.3, axial_offset=1.0), 0.1, 1e-4),
    "longer than the roller": (trb.Spall(14.0, 7.0), 3.49, 0.0),
    "two": ((trb.Spall(3.0, 0.3, axial_offset=-3.5), trb.Spall(3.0, 0.2, axial_offset=3.5)), (0.1, 0.12), 2e-4),
    "touching": ((trb.Spall(4.0, 5.0), trb.Spall(2.0, 5.0)), (2.45, -2.45), 0.0),
    "three": ((trb.Spall(4.0, 0.1), trb.Spall(2.0, 0.2), trb.Spall(3.0, 0.15)), (0.05, -0.08, -0.02), 0.0),
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * isinstance(defect, tuple))
                                  for name, (defect, *_) in CASES.items()])  # fmt: skip
def test_expansions_have_the_derivatives_of_the_program(contact: trb.LineContact, name: str) -> None:
    """Of every line and gap, by every number of the contact."""
    spall, offset, tilt = CASES[name]
    inputs, mirrored, _ = given(contact, 1000.0, spall, offset, tilt, "cells")
    leaves, form = jax.tree.flatten(inputs)

    def laid(leaves: list) -> list:
        stage = contact_cells.stage(form.unflatten(leaves), grid_for(1e-2).cells, mirrored)
        return [stage.cells.pitch, stage.cells.x, stage.cells.lines, stage.cells.borders, stage.gap]

    seeds = parameters(leaves)
    expanded, plain = laid(seeds), laid(leaves)
    by_program = jax.jit(jax.jacfwd(laid))([jnp.asarray(leaf) for leaf in leaves])
    for own, number, slopes in zip(expanded, plain, by_program, strict=True):
        np.testing.assert_allclose(xp.value(own), number, rtol=1e-13, atol=1e-15)
        every = np.concatenate([np.moveaxis(np.asarray(s).reshape(*own.shape, -1), -1, 0) for s in slopes])
        by = own.by if isinstance(own, Taylor) and own.by is not None else 0.0 * every
        np.testing.assert_allclose(by, every, rtol=1e-9, atol=1e-10 * np.abs(every).max())


def test_the_program_knows_no_spall(contact: trb.LineContact) -> None:
    """One for all contacts of as many cells; what it holds is the half-space and its projected gradient."""
    bed, level = _bed(contact, trb.Spall(4.0, 7.0), 3.45)
    lowered = jax.jit(lambda bed, level: cell_solve._program(bed, level, None, True, 1)).lower(bed, level)
    assert lowered.as_text().count("\n") < 2_600  # 2 100
    for spall, offset in ((trb.Spall(4.0, 7.0), 3.45), (trb.Spall(6.0, 5.0), 0.0), (trb.Spall(2.0, 0.1), 0.0)):
        again, _ = _bed(contact, spall, offset)
        assert [np.shape(part) for part in again] == [np.shape(part) for part in bed]


def _bed(contact: trb.LineContact, spall: Defect, offset: float) -> tuple[cell_solve.Bed, Any]:
    inputs, mirrored, _ = given(contact, 1000.0, spall, offset, 0.0, "cells")
    stage = contact_cells.stage(inputs, grid_for(1e-2).cells, mirrored)
    return cell_solve._bed(stage.cells, stage.gap - np.min(stage.gap), inputs), gaps.first_level(
        stage.cells, contact.radius
    )


@pytest.mark.slow
def test_numbers_and_programs_agree(contact: trb.LineContact) -> None:
    spall = trb.Spall(4.0, 7.0, axial_offset=0.5)
    solution, by = approach_and_gradient(contact, 1000.0, spall, 3.45, 1e-2, "cells")

    def approach(contact: trb.LineContact, load: float, spall: trb.Spall, offset: float) -> jax.Array:
        return trb.solve_contact(contact, load, spall, offset, 1e-2, "cells").approach

    value, slopes = jax.jit(jax.value_and_grad(approach, argnums=(0, 1, 2, 3)))(contact, 1000.0, spall, 3.45)
    assert float(solution.approach) == pytest.approx(float(value), rel=1e-11)
    for own, wanted in zip(jax.tree.leaves(tuple(by)), jax.tree.leaves(slopes), strict=True):
        assert float(own) == pytest.approx(float(wanted), rel=1e-8, abs=1e-16)
