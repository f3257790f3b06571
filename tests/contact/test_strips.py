"""The strips' parts against plain quadrature, and their answer against the cells'."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import k0

import difftrb as trb
from difftrb.contact import strip_kernel, strip_model, strip_plan, strip_reach
from difftrb.contact.contact_solution import given
from difftrb.contact.grids import GRIDS
from difftrb.contact.solver import approach_and_gradient
from difftrb.contact.strip_model import Way
from difftrb.contact.strip_rows import Rows
from difftrb.core.taylor import Taylor

pytestmark = pytest.mark.exact


def gauss(a: float, b: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * (b - a) * x + 0.5 * (a + b), 0.5 * (b - a) * w


@pytest.mark.parametrize("order", [1, 2, 4])
def test_integrals_of_k0(order: int) -> None:
    """∫₀ᶻ (z−s)ⁿ⁻¹/(n−1)! K₀(s) ds, the logarithm at 0 taken by s = z u⁴; z on both sides of the split."""
    u, w = gauss(0.0, 1.0, 60)
    for z in (1e-3, 0.7, 3.99, 4.01, 11.0):
        kernel = (1.0 - u**4) ** (order - 1) / float(np.prod(np.arange(1, order))) * 4.0 * u**3
        expected = z**order * np.sum(w * kernel * k0(z * u**4))
        for of in (np.asarray, jnp.asarray):
            assert float(strip_kernel.integrals_k0(order, of(z))[0]) == pytest.approx(expected, rel=1e-9)
    z, h = np.asarray(2.5), 1e-5
    assert float(strip_kernel.integrals_k0(0, z)[0]) == pytest.approx(k0(2.5), rel=1e-11)

    def slope(n: int) -> float:
        return float(strip_kernel.integrals_k0(n, Taylor(z, by=np.ones(1)))[0].by[0])

    assert slope(1) == pytest.approx(k0(2.5), rel=1e-11)
    by_difference = (k0(2.5 + h) - k0(2.5 - h)) / (2 * h)
    assert slope(0) == pytest.approx(by_difference, rel=1e-8)


def test_products_of_rows() -> None:
    """∬ hat hat' (K₀(κ|y−y'|) + K₀(κ(y+y'))) by nested Gauss rules graded towards y' = y."""
    land = np.array([10.0, 10.02, 10.1, 10.3, 11.5, 16.0, 20.0, 20.5, 20.6])
    hollow = np.array([0.0, 3.0, 6.0, 8.0, 9.0, 9.6, 9.9, 9.97, 10.0])
    groups = Rows(land, False, "low"), Rows(hollow, True, "high")
    kappa = np.array([0.01, 0.5, 3.0])
    found = strip_kernel.products(groups, kappa, True)
    hats = [(land, i) for i in range(8)] + [(hollow, i) for i in range(9)]
    assert found.shape == (17, 17, 3)

    def value(hat: tuple[np.ndarray, int], y: np.ndarray) -> np.ndarray:
        return np.interp(y, hat[0], np.eye(9)[hat[1]], left=0.0, right=0.0)

    def panels(hat: tuple[np.ndarray, int]) -> list[tuple[float, float]]:
        lines, i = hat
        return [(lines[j], lines[j + 1]) for j in (i - 1, i) if 0 <= j < 8]

    def integral(one: tuple[np.ndarray, int], other: tuple[np.ndarray, int], k: float) -> float:
        total = 0.0
        u, v = gauss(0.0, 1.0, 24)
        for a, b in panels(one):
            for y, w in zip(*gauss(a, b, 24), strict=True):
                for c, d in panels(other):
                    inner = [(c, y), (d, y)] if c < y < d else [(c, d) if abs(d - y) < abs(c - y) else (d, c)]
                    for far, near in inner:
                        s = near + (far - near) * u**4
                        kernel = k0(k * np.maximum(np.abs(y - s), 1e-300)) + k0(k * (y + s))
                        total += w * value(one, np.array([y]))[0] * abs(far - near) * np.sum(
                            v * 4.0 * u**3 * value(other, s) * kernel
                        )  # fmt: skip
        return total

    for i, j in [(0, 0), (0, 1), (4, 5), (0, 16), (0, 15), (1, 16), (8, 8), (8, 9), (15, 16), (0, 7), (4, 9)]:
        expected = [integral(hats[i], hats[j], k) for k in kappa]
        size = np.sqrt(found[i, i] * found[j, j])  # thin hats far apart are taken as points: small beside this
        np.testing.assert_allclose(found[i, j] / size, expected / size, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("accuracy", [1e-3, 1e-5])
def test_products_of_thin_rows_far_apart(accuracy: float) -> None:
    """Beside a spall's two ends rows may be 1e-4 as long as others are far: differences of K₀'s antiderivatives lost
    all their digits there, and strips converged to states that were off by 1e-3, as rounding fell."""
    fine, ends = GRIDS[accuracy].strips, tuple(map(np.asarray, (-8.0, -1.0, -20.0, 20.0)))
    groups, _ = strip_plan.groups_of(ends, False, 0, fine)
    kappa = fine.frequencies.rule()[0][::6]
    found = strip_kernel.products(groups, kappa, False)
    rules = []
    for group in groups:
        lines, (first, last) = np.asarray(group.lines), group.borders
        for i in range(0 if first else 1, lines.size - (0 if last else 1)):
            x, w = gauss(0.0, 1.0, 10)
            parts = [(lines[j], lines[i] - lines[j]) for j in (i - 1, i + 1) if 0 <= j < lines.size]
            rules.append((
                np.concatenate([start + size * x for start, size in parts]),
                np.concatenate([abs(size) * w * x for _, size in parts]),
            ))  # fmt: skip
    assert found.shape[0] == len(rules)
    half = len(rules) // 2
    for i in (*range(3), *range(half - 3, half + 3)):
        for j, (y, weight) in enumerate(rules):
            own, weights = rules[i]
            if np.min(np.abs(own[:, None] - y)) < 0.5 * max(np.ptp(own), np.ptp(y)):
                continue  # the rule is not exact so near
            pair = np.outer(weights, weight)
            expected = np.sum(pair[..., None] * k0(np.abs(own[:, None] - y)[..., None] * kappa), axis=(0, 1))
            np.testing.assert_allclose(found[i, j], expected, rtol=3e-6, atol=3e-6 * float(np.sum(pair)))


@pytest.mark.parametrize(
    ("spall", "offset"),
    [
        (None, 0.0),
        (trb.Spall(5.0, 7.0), 0.3),
        (trb.Spall(3.0, 1.0), 0.52),  # a rolling edge in the contact
        (trb.Spall(3.0, 0.12), 0.0),  # narrower than the contact
        (trb.Spall(4.0, 7.0, axial_offset=1.5), 0.0),
    ],
)
def test_strips_and_cells_agree(spall: trb.Spall | None, offset: float) -> None:
    contact = trb.LineContact(3.623, 13.66, 113794.5, 3000.0)
    strips = trb.solve_contact(contact, 2500.0, spall, offset, 1e-2, "strips").check()
    cells = trb.solve_contact(contact, 2500.0, spall, offset, 1e-3, "cells").check()
    assert float(strips.approach) == pytest.approx(float(cells.approach), rel=1e-3)
    assert float(jnp.sum(strips.force)) == pytest.approx(2500.0, rel=1e-9)
    # the longest row lies at the spall's end, where the contact bulges: coarse rows see less of it
    assert float(strips.contact_width) == pytest.approx(float(cells.contact_width), rel=0.15)
    assert int(strips.unknowns) < 150


SLIVERS = (
    (4683.0, 7.44, 1.787, 1.5488662687e-02), (1140.0, 7.75, 1.870, 5.3331256861e-03),
    (3735.0, 2.92, 1.825, 1.0572018885e-02), (1048.0, 7.76, 1.809, 6.0499778444e-03),
    (432.0, 6.13, 1.894, 2.6510343735e-03), (1942.0, 7.53, 1.765, 9.1822547572e-03),
    (2216.0, 7.77, 1.846, 8.5538523861e-03),
)  # fmt: skip
"""Load [N], length of a spall 4 mm wide and its offset [mm], approach [mm] by strips far finer than any here:
Fineness(36, 14, 5, 2, 3, Frequencies(6, 18, 32, 32.0), Frequencies(6, 18, 200, 300.0)); known to 5e-5."""


@pytest.mark.parametrize(("accuracy", "median", "worst"), [(1e-3, 6e-4, 2e-3), (1e-4, 2e-4, 6e-4)])
def test_slivers_of_land(contact: trb.LineContact, accuracy: float, median: float, worst: float) -> None:
    """A rolling edge so far out that the roller meets the land beyond it in a sliver, which ends along the spall.
    Where strips of this accuracy do not settle, finer ones do."""
    errors = []
    for load, length, offset, truth in SLIVERS:
        s = trb.solve_contact(contact, load, trb.Spall(length, 4.0), offset, accuracy).check()
        errors.append(abs(float(s.approach) / truth - 1.0))
    assert np.median(errors) < median
    assert max(errors) < worst


def test_finer_strips_do_where_these_do_not(contact: trb.LineContact, monkeypatch: pytest.MonkeyPatch) -> None:
    """Strips of 1e-3 that are given too few passes."""
    grid = GRIDS[1e-3]
    monkeypatch.setitem(GRIDS, 1e-3, dataclasses.replace(grid, strips=dataclasses.replace(grid.strips, settled=1)))
    load, length, offset, truth = SLIVERS[4]
    case = load, trb.Spall(length, 4.0), offset, 1e-3
    assert not bool(trb.solve_contact(contact, *case, method="strips").converged)
    found = trb.solve_contact(contact, *case).check()
    assert found.accuracy < 1e-3
    assert float(found.approach) == pytest.approx(truth, rel=3e-4)


def test_strips_know_where_they_end() -> None:
    straight = trb.LineContact(3.623, 13.66, 113794.5, 0.0)
    crowned = trb.LineContact(3.623, 13.66, 113794.5, 3000.0)
    assert "method 'cells'" in trb.solve_contact(straight, 1000.0, None, 0.0, 1e-2, "strips").status
    shallow = trb.Spall(5.0, 7.0, depth=0.002)
    assert "method 'cells'" in trb.solve_contact(crowned, 3000.0, shallow, 0.0, 1e-2, "strips").status
    assert bool(trb.solve_contact(crowned, 3000.0, shallow, 0.0, 1e-2).converged)


@pytest.mark.slow
def test_inside_jit_the_choice_is_the_same(contact: trb.LineContact) -> None:
    """Strips out of reach of an edge, strips at an edge, cells where the roller reaches the bottom."""

    def approach(case: jax.Array) -> jax.Array:
        return trb.solve_contact(contact, 2500.0, trb.Spall(4.0, 7.0, case[1]), case[0], 1e-2).approach

    cases = jnp.array([[0.0, 0.2], [3.5, 0.2], [0.0, 0.003]])
    together = jax.jit(lambda c: jax.lax.map(approach, c))(cases)
    for (offset, depth), found in zip(np.asarray(cases), together, strict=True):
        one = trb.solve_contact(contact, 2500.0, trb.Spall(4.0, 7.0, float(depth)), float(offset), 1e-2)
        assert float(found) == pytest.approx(float(one.approach), rel=1e-8)


@pytest.mark.parametrize(
    ("spall", "offset", "tilt"),
    [(None, 0.0, 3e-4), (trb.Spall(4.0, 7.0, axial_offset=1.5), 0.0, -4e-4), (trb.Spall(3.0, 1.0), 0.52, 2e-4)],
)
def test_tilted_strips_and_cells_agree(
    contact: trb.LineContact, spall: trb.Spall | None, offset: float, tilt: float
) -> None:
    strips, cells = (
        trb.solve_contact(contact, 2500.0, spall, offset, accuracy, method, tilt).check()
        for accuracy, method in ((1e-4, "strips"), (1e-3, "cells"))
    )
    assert float(strips.approach) == pytest.approx(float(cells.approach), rel=5e-4)
    assert float(strips.moment) == pytest.approx(float(cells.moment), rel=1e-2)
    assert float(strips.moment) * tilt < 0.0  # the end where the gap is less carries more


def test_moment_and_approach_are_of_one_energy(contact: trb.LineContact) -> None:
    """∂M/∂load = ∂δ/∂tilt, both second derivatives of it; and that is what differences of the approach say."""
    spall, tilt, h = trb.Spall(3.0, 1.0), 2e-4, 1e-5

    def solved(load: float, tilt: float) -> trb.ContactSolution:
        return trb.solve_contact(contact, load, spall, 0.52, 1e-4, "strips", tilt).check()

    _, by = approach_and_gradient(contact, 2500.0, spall, 0.52, 1e-4, "strips", tilt)
    assert by.tilt is not None
    by_tilt = float(by.tilt)
    ahead, behind = (float(solved(2500.0, tilt + side * h).approach) for side in (1.0, -1.0))
    assert by_tilt == pytest.approx((ahead - behind) / (2.0 * h), rel=2e-2)
    more, less = (float(solved(2500.0 + side * 25.0, tilt).moment) for side in (1.0, -1.0))
    assert by_tilt == pytest.approx((more - less) / 50.0, rel=2e-2)


def test_slivers_on_both_edges_of_a_narrow_spall_see_one_another(contact: trb.LineContact) -> None:
    """Three half-widths apart: with frequencies too few for that the approach swayed with the width by up to 4e-3, and
    its derivative by half of it."""
    widths = np.linspace(0.31, 0.36, 6)
    solved = [approach_and_gradient(contact, 2882.04, trb.Spall(5.41949, w), 0.0, 1e-4) for w in widths.tolist()]
    approach = np.array([float(solution.check().approach) for solution, _ in solved])
    slopes = np.array([float(by.spall.width) for _, by in solved])  # type: ignore[union-attr]
    cells = [
        float(trb.solve_contact(contact, 2882.04, trb.Spall(5.41949, w), 0.0, 1e-4, "cells").check().approach)
        for w in (0.31, 0.36)
    ]
    np.testing.assert_allclose(approach[[0, -1]], cells, rtol=1e-3)
    curve = np.polynomial.Polynomial.fit(widths, approach, 3)
    np.testing.assert_allclose(approach, curve(widths), rtol=1e-4)
    np.testing.assert_allclose(slopes, curve.deriv()(widths), rtol=5e-2)


@pytest.mark.slow
def test_derivatives_where_strips_do_not_suit(contact: trb.LineContact) -> None:
    """Without a crown, cells: what strips make of it once took their derivatives along as NaN."""
    straight = trb.LineContact(contact.radius, contact.length, contact.modulus, 0.0)

    def approach(load: jax.Array) -> jax.Array:
        return trb.solve_contact(straight, load, None, 0.0, 1e-2).approach

    by_cells = trb.approach_slopes(straight, 3000.0, None, 0.0, 1e-2, "cells")["load"]
    assert by_cells is not None
    assert float(jax.jit(jax.grad(approach))(3000.0)) == pytest.approx(float(by_cells), rel=1e-9)


def test_slivers_too_thin_for_the_waves_are_solved_again() -> None:
    """Rows that just touch beyond an edge, 1.5 µm wide: with the waves of 1e-4 the approach was 3e-4 off, and said
    nothing."""
    contact = trb.LineContact(1.26407, 12.61986, 113794.5, 7554.02)
    case = contact, 2809.72, trb.Spall(8.341433, 1.715352), 0.6684583
    inputs, mirrored, _ = given(*case, 0.0, "strips")
    beneath = strip_reach.judged(inputs, mirrored).beneath
    way = Way(mirrored, beneath._replace(edges=int(beneath.edges)), GRIDS[1e-4].strips, 5e-6, True)
    once, truth = strip_model.solve_numbers(inputs, way), float(trb.solve_contact(*case, 1e-5).check().approach)
    assert abs(float(once.approach) / truth - 1.0) > 2e-4
    assert float(once.settled.unresolved) > 1e-4
    again = trb.solve_contact(*case, 1e-4).check()
    assert float(again.approach) == pytest.approx(truth, rel=1e-4)
    assert float(again.residual) < 1e-4


def test_a_tilted_roller_whose_middle_stands_off_meets_an_edge() -> None:
    """Its approach is negative: the unit of length was the root of it, and strips were NaN."""
    contact, spall = trb.LineContact(8.56879, 12.1677, 113794.5, 1879.13), trb.Spall(0.706, 0.2541, axial_offset=-2.616)
    strips, cells = (
        float(trb.solve_contact(contact, 143.783, spall, -0.102881, 1e-3, way, 4.99634e-4).check().approach)
        for way in ("strips", "cells")
    )
    assert strips < 0.0
    assert strips == pytest.approx(cells, rel=2e-3)
