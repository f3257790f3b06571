"""Contacts where geometry degenerates, and where a grid could cut something off."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import contact_cells, projected_gradient
from difftrb.contact import solver as contacts
from difftrb.core import status
from difftrb.law import samples

pytestmark = pytest.mark.hard

LENGTH = 13.66


@pytest.fixture(scope="module")
def random_cases() -> dict[str, np.ndarray]:
    """Loads over six decades; spalls of any size, depth and place, over the roller's end too; crowns from none up."""
    rng = np.random.default_rng(1)
    n = 120
    width = 10 ** rng.uniform(-1.5, 1.0, n)
    return {
        "load": 10 ** rng.uniform(-1, 5, n),
        "length": rng.uniform(0.05, LENGTH, n),
        "width": width,
        "depth": 10 ** rng.uniform(-4, 0, n),
        "offset": rng.uniform(-1, 1, n) * (width / 2 + 0.2),
        "axial_offset": np.where(rng.random(n) < 0.5, 0.0, rng.uniform(-8, 8, n)),
        "design_load": np.where(rng.random(n) < 0.2, 0.0, 10 ** rng.uniform(1, 5, n)),
        "radius": rng.choice([3.6235, 2.867], n),
    }


@pytest.mark.slow
def test_random_contacts_converge_with_finite_gradients(random_cases: dict[str, np.ndarray]) -> None:
    names = list(random_cases)

    def solved(v: jax.Array):
        a = dict(zip(names, v, strict=True))
        c = trb.LineContact(a["radius"], LENGTH, 113794.0, a["design_load"])
        spall = trb.Spall(a["length"], a["width"], a["depth"], 0.0, a["axial_offset"])
        s = trb.solve_contact(c, a["load"], spall, a["offset"], 1e-2, "cells")
        return s.approach, (s.status_code, s.residual, jnp.min(s.force), jnp.sum(s.force) / a["load"])

    cases = jnp.stack([jnp.asarray(random_cases[name]) for name in names], axis=1)
    (approach, (codes, residual, least, total)), slopes = jax.jit(
        lambda c: jax.lax.map(jax.value_and_grad(solved, has_aux=True), c)
    )(cases)
    codes = np.asarray(codes)
    good = codes == status.CONVERGED
    assert set(codes[~good]) <= {status.UNRESOLVED}, [status.SENTENCES[c] for c in set(codes[~good])]
    assert good.mean() > 0.93  # the rest are spalls narrower than a cell, and say so
    assert float(residual.max()) <= projected_gradient.TOLERANCE
    assert float(least.min()) >= 0.0
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)
    assert (np.asarray(approach)[good] > 0.0).all()
    assert np.isfinite(np.asarray(slopes)).all()
    assert (np.asarray(slopes)[good, names.index("load")] > 0.0).all()


def test_vanishing_spalls_join_the_healthy_contact(contact: trb.LineContact) -> None:
    healthy = float(trb.solve_contact(contact, 2000.0, accuracy=1e-2).approach)
    for length in (0.0, 1e-6, 1e-3, 1e-2):
        s = trb.solve_contact(contact, 2000.0, trb.Spall(length, 7.0), accuracy=1e-2).check()
        assert float(s.approach) == pytest.approx(healthy, rel=2e-3)


@pytest.mark.slow
def test_a_spall_without_width_is_no_spall(contact: trb.LineContact) -> None:
    """Its two edges are one line: once a lattice of pitch 0, and NaN."""
    healthy = float(trb.solve_contact(contact, 2000.0, accuracy=1e-2, method="cells").approach)
    for width in (0.0, 1e-300, 1e-6):
        for spall in (trb.Spall(2.0, width), (trb.Spall(2.0, width), trb.Spall(0.0, 1.0))):
            s = trb.solve_contact(contact, 2000.0, spall, accuracy=1e-2, method="cells")
            assert bool(s.converged) == (width == 0.0), s.status
            assert float(s.approach) == pytest.approx(healthy, rel=2e-3)


def test_a_spall_as_long_as_the_roller_lets_it_down_to_the_bottom(contact: trb.LineContact) -> None:
    s = trb.solve_contact(contact, 2000.0, trb.Spall(LENGTH, 7.0, 0.05), accuracy=1e-2).check()
    healthy = trb.solve_contact(contact, 2000.0, accuracy=1e-2)
    assert float(s.approach) == pytest.approx(0.05 + float(healthy.approach), rel=2e-2)


@pytest.mark.parametrize("offset", [0.5, 0.5 - 1e-12, 0.5 + 1e-12, 0.4056, 0.5944, 3.0, 0.0])
def test_edges_anywhere_in_the_contact(contact: trb.LineContact, offset: float) -> None:
    s = trb.solve_contact(contact, 3000.0, trb.Spall(2.0, 1.0), offset, 1e-2).check()
    for value in trb.approach_slopes(contact, 3000.0, trb.Spall(2.0, 1.0), offset, 1e-2).values():
        assert np.isfinite(float(value))  # type: ignore[arg-type]
    assert 8.0e-3 < float(s.approach) < 8.8e-3


@pytest.mark.parametrize("offset", [1.0, -1.0, 1000.0])
def test_a_spall_that_is_nowhere_near(contact: trb.LineContact, offset: float) -> None:
    """Once a strip of no width and NaN: cells then solved it, and inside `jit` their derivatives were NaN, too."""
    healthy = trb.solve_contact(contact, 3000.0, accuracy=1e-2)
    spall = trb.Spall(2.0, 1.0)
    s, (_, by_load, by_spall, by_offset, _) = contacts.approach_and_gradient(
        contact, 3000.0, spall, offset, 1e-2, "strips"
    )
    assert float(s.check().approach) == pytest.approx(float(healthy.approach), rel=2e-3)
    assert float(by_load) > 0.0
    assert float(by_spall.length) == pytest.approx(0.0, abs=1e-4 * float(s.approach))
    assert float(by_offset) == float(by_spall.width) == 0.0


@pytest.mark.parametrize(("load", "beyond"), [(18.4, 0.0815), (21.7, 0.0801), (18.4, 0.085)])
def test_an_edge_just_out_of_reach_of_a_light_load_over_a_long_spall(
    contact: trb.LineContact, load: float, beyond: float
) -> None:
    """The roller has sunk through its crown, many half-widths deep: an edge out there must not be taken as nearer."""
    spall = trb.Spall(7.2468, 2.0)
    over = trb.solve_contact(contact, load, spall, 0.0, 1e-4).check()
    beside = trb.solve_contact(contact, load, spall, 1.0 - beyond, 1e-4, "strips").check()
    assert float(beside.approach) == pytest.approx(float(over.approach), rel=1e-4)


@pytest.mark.parametrize(
    ("load", "length", "beyond", "approach"),
    [(1370.6, 7.545, 0.13929, 0.0060478), (1002.0, 7.9888, 0.15497, 0.0054289)],
)
def test_a_sliver_of_land_beyond_an_edge(
    contact: trb.LineContact, load: float, length: float, beyond: float, approach: float
) -> None:
    """Against cells of 96 columns, 80 + 24 rows: where strips rested without load they once ended 0.6 % off."""
    beside = trb.solve_contact(contact, load, trb.Spall(length, 2.0), 1.0 - beyond, 1e-4, "strips").check()
    assert float(beside.approach) == pytest.approx(approach, rel=4e-4)


def test_spall_over_the_rollers_end(contact: trb.LineContact) -> None:
    inside, over, beyond = (
        float(trb.solve_contact(contact, 2000.0, trb.Spall(3.0, 7.0, axial_offset=a), accuracy=1e-2).check().approach)
        for a in (4.0, 6.0, 9.0)
    )
    healthy = float(trb.solve_contact(contact, 2000.0, accuracy=1e-2).approach)
    assert inside > over > beyond
    assert beyond == pytest.approx(healthy, rel=2e-3)


@pytest.mark.parametrize("load", [float("nan"), -5.0, 0.0])
def test_loads_that_are_no_loads_are_flagged(contact: trb.LineContact, load: float) -> None:
    s = trb.solve_contact(contact, load, accuracy=1e-2)
    assert not bool(s.converged)
    with pytest.raises(trb.SolveError):
        s.check()


def test_sizes_that_are_no_sizes_are_flagged(contact: trb.LineContact) -> None:
    nan = float("nan")
    for spall, offset in [(trb.Spall(-2.0, 1.0), 0.0), (trb.Spall(2.0, 1.0, -0.002), 0.0), (trb.Spall(2.0, 1.0), nan)]:
        assert "not a number" in trb.solve_contact(contact, 1000.0, spall, offset, 1e-2).status
    crown = trb.LineContact(contact.radius, contact.length, contact.modulus, -1.0)
    assert "not a number" in trb.solve_contact(crown, 1000.0, accuracy=1e-2).status


def test_a_domain_that_cuts_the_contact_is_noticed(contact: trb.LineContact, monkeypatch) -> None:
    """Forced to half its size, as in the source paper, the domain is reported, not believed."""
    whole = contact_cells.domain
    monkeypatch.setattr(contact_cells, "domain", lambda *a: (0.4 * whole(*a)[0], *whole(*a)[1:]))
    s = trb.solve_contact(contact, 3000.0, accuracy=1e-2, method="cells")
    assert "border" in s.status


def test_a_spall_narrower_than_a_cell_is_said(contact: trb.LineContact) -> None:
    s = trb.solve_contact(contact, 3000.0, trb.Spall(2.0, 0.01), accuracy=1e-2, method="cells")
    assert "narrower than one cell" in s.status


@pytest.mark.parametrize("accuracy", [0.0, 1e-6, 0.5, float("nan")])
def test_accuracy_out_of_range_is_refused(contact: trb.LineContact, accuracy: float) -> None:
    with pytest.raises(ValueError, match="out of range"):
        trb.solve_contact(contact, 1000.0, accuracy=accuracy)


def test_an_unknown_method_is_refused(contact: trb.LineContact) -> None:
    for function in (trb.solve_contact, trb.approach_slopes):
        with pytest.raises(ValueError, match="method = 'sieve' is unknown; use 'auto', 'strips', 'cells', 'lattice'"):
            function(contact, 1000.0, method="sieve")  # type: ignore[arg-type]


def test_arrays_in_place_of_numbers_are_refused(contact: trb.LineContact) -> None:
    pair, three = np.ones(2), dataclasses.replace(contact, radius=np.ones(3))
    spalls = trb.Spall(1.0, 1.0), trb.Spall(pair, 1.0)
    for words, arguments in {
        r"load has shape \(1,\): a contact takes one number; use jax.vmap": (contact, np.array([3000.0])),
        r"contact.radius has shape \(3,\)": (three, 3000.0),
        r"spall.length has shape \(2,\)": (contact, 3000.0, spalls[1]),
        r"spall.1.length has shape \(2,\)": (contact, 3000.0, spalls),
    }.items():
        with pytest.raises(trb.SceneError, match=words):
            trb.solve_contact(*arguments)


@pytest.mark.slow
def test_cells_are_solved_by_threads_side_by_side(contact: trb.LineContact) -> None:
    """Batched LAPACK calls of two programs that run at once (jax 0.10.1) wait for each other forever."""
    spall = trb.Spall(11.6, 1000.0)
    cases = [samples.Case(load, spall) for load in np.geomspace(500.0, 5000.0, 12)]
    alone = samples.solved(contact, cases[0], 1e-4)
    with ThreadPoolExecutor(2) as pool:
        together = [pool.submit(samples.solved, contact, case, 1e-4) for case in cases]
        approaches = [one.result(timeout=120.0).approach for one in together]
    assert approaches[0] == alone.approach
    assert (np.diff(approaches) > 0.0).all()
