"""The table and the direct law on a contact with a closed form, which stands in for the solver: only interpolation
is at work, so tolerances are tight; and the direct law on the solver itself."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import curve, gap, nodes, status, store, table
from difftrb.law import curve_over


def half_width(contact, load):
    return jnp.sqrt(4.0 * load * contact.radius / (jnp.pi * contact.modulus * contact.length))


def levels(contact, load, spall):
    """Approach on a healthy raceway and over the middle of the spall."""
    healthy = (
        load**0.9 * contact.length**-0.8 * (1.0 + 0.02 * jnp.log(load / contact.design_load) ** 2) / contact.modulus
    )
    if spall is None:
        return healthy, healthy
    land = 1.0 - spall.length / contact.length
    crown = gap.crown_at(jnp.maximum(0.5 * spall.length - jnp.abs(spall.axial_offset), 0.0), contact)
    return healthy, healthy * land**-0.8 + crown


def reach(contact, load, spall):
    return jnp.sqrt(1.5 * contact.radius * levels(contact, load, spall)[1])


def approach(contact, load, spall, distance):
    """What the closed form gives; an edge lets the roller down along a smooth step."""
    healthy, full = levels(contact, load, spall)
    if spall is None:
        return healthy
    low, high = -half_width(contact, load), reach(contact, load, spall)
    t = jnp.clip((0.5 * spall.width - jnp.abs(distance) - low) / (high - low), 0.0, 1.0)
    return healthy + (full - healthy) * t**3 * (10.0 - 15.0 * t + 6.0 * t * t)


def closed_form(contact, case, accuracy):
    arguments = contact, case.spall, jnp.asarray(float(case.distance))
    value, slopes = jax.value_and_grad(lambda c, s, d: approach(c, case.load, s, d), (0, 1, 2))(*arguments)
    return nodes.Node(
        float(value), np.array(nodes.inputs(*slopes)), status.CONVERGED, float(half_width(contact, case.load)),
        float(reach(contact, case.load, case.spall)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def closed(tmp_path_factory):
    """The solver replaced by the closed form, the cache by an empty folder; the number of solves so far."""
    patch = pytest.MonkeyPatch()
    solves = []
    patch.setattr(nodes, "solved", lambda *a: (solves.append(a), closed_form(*a))[1])
    folder = tmp_path_factory.mktemp("cache")
    patch.setattr(store, "folder", lambda: folder)
    yield solves
    patch.undo()


@pytest.fixture(scope="module")
def law(closed, contact: trb.LineContact) -> table.TableLaw:
    return table.table_law(trb.LineContact(*map(float, dataclasses.astuple(contact))), 1650.0, (trb.Spall(4.0, 7.0),))


def q_over(law, spall, distance, delta, load):
    return curve.load(curve_over(law, spall, distance, load), delta)[0]


@pytest.mark.parametrize("length", [0.7, 4.0, 9.7])
def test_table_is_the_closed_form(law, length: float) -> None:
    """Beside the spall, on its ramp, in its middle."""
    spall = trb.Spall(length, 7.0)
    for load in (100.0, 700.0, 3000.0):
        for over in (-0.2, -0.04, 0.02, 0.09, 0.16, 1.0):
            delta = approach(law.contact, load, spall, 3.5 - over)
            assert float(q_over(law, spall, 3.5 - over, delta, load)) == pytest.approx(load, rel=3e-3)
    assert float(law.error) < 3e-3
