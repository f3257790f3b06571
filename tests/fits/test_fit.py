"""The road backwards: what was put in comes out, what cannot come out is said."""

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.core import status
from difftrb.fits import (
    batched_misfit,
    fit_record,
    fit_report,
    fit_result,
    least_squares,
    optimal_design,
    predicted,
    profile_intervals,
    search,
    suspects,
    undetermined,
)
from difftrb.fits.batched_misfit import evaluated, solved
from difftrb.fits.conditions import conditions
from difftrb.fits.fit_problem import problem_of
from difftrb.fits.fitting import fit
from difftrb.fits.measured import MeasuredError, Measurement
from difftrb.fits.measured_table import example, parse
from difftrb.fits.predicted import rows_of
from difftrb.law import base as laws
from difftrb.report import console
from difftrb.scene import scene_file
from difftrb.scene.auto_law import by_table
from experiments.speed_of_fit import ours, scipys

pytestmark = pytest.mark.usefixtures("compiled_as_for_users")
TRUTH = {"length": 5.0, "width": 9.0}
LOADS = ((9000.0, 4500.0), (3000.0, 4500.0))
FEW = 64
"""Points that are scanned in place of 512."""
BLANK = tuple(
    Measurement(radial, axial, quantity, 1.0, 1.0, None, phase)
    for radial, axial in LOADS
    for phase in (0.0, "mean")
    for quantity in ("radial_loss", "axial_loss")
)


@pytest.fixture(scope="module")
def rig(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "liu2018"))


@pytest.fixture(scope="module")
def exact(rig: trb.Scene) -> np.ndarray:
    """What the rows of BLANK are without noise."""
    spall = trb.Spall(TRUTH["length"], TRUTH["width"])
    losses = [
        trb.assess(dataclasses.replace(rig, spalls=(spall,), load=trb.Load(*load), phase=phase)).loss
        for load in LOADS
        for phase in (0.0, "mean")
    ]
    return np.concatenate(losses)


def measured(values: np.ndarray, sigma: float | None = 0.01) -> list[Measurement]:
    return [
        dataclasses.replace(row, value=float(v), sigma=None if sigma is None else sigma * abs(float(v)))
        for row, v in zip(BLANK, values, strict=True)
    ]


def noisy(exact: np.ndarray, seed: int) -> list[Measurement]:
    """Rows with noise of 1 %, whose sigma is of the exact values."""
    rows = measured(exact)
    noise = np.random.default_rng(seed).standard_normal(len(exact))
    return [
        dataclasses.replace(row, value=row.value + row.sigma * float(e)) for row, e in zip(rows, noise, strict=True)
    ]


@pytest.fixture
def no_suspects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds less of each fit that the data contradict."""
    monkeypatch.setattr(suspects, "wanted", lambda _: False)


@pytest.fixture(scope="module")
def noisy_fit(rig: trb.Scene, exact: np.ndarray) -> trb.Fit:
    return fit(rig, noisy(exact, 1), model_error=0.0).check()


def test_exact_data_give_the_spall_back(rig: trb.Scene, exact: np.ndarray) -> None:
    found = fit(rig, measured(exact)).check()
    np.testing.assert_allclose(found.values, [TRUTH["length"], TRUTH["width"]], rtol=1e-7)
    np.testing.assert_allclose(found.predicted, exact, rtol=1e-7)
    assert found.determined
    assert found["width"] == found.values[1]
    assert (found.intervals[:, 0] < found.values).all()
    assert (found.intervals[:, 1] > found.values).all()
    assert "converged" in fit_record.fit_json(found, (), 0.0)["status"]


def test_a_fit_prints_on_a_few_lines(noisy_fit: trb.Fit) -> None:
    first, *lines = repr(noisy_fit).splitlines()
    assert first.startswith("Fit of 8 rows, χ² ")
    assert first.endswith(": converged")
    assert [line.split()[0] for line in lines[:2]] == ["length", "width"]
    assert len(lines) == 2 + len(noisy_fit.remarks)


def test_a_name_of_old_still_serves(noisy_fit: trb.Fit) -> None:
    with pytest.warns(DeprecationWarning, match="Fit.place is called Fit.point"):
        assert noisy_fit.place is noisy_fit.point


def test_it_is_the_least_squares_of_scipy(noisy_fit: trb.Fit) -> None:
    problem = noisy_fit.problem
    starts = search.scan_points(problem, 16)
    theirs = scipys(problem, starts, lambda u: evaluated(problem, u[None]).residual[0])
    np.testing.assert_allclose(ours(problem, starts), theirs, rtol=1e-6)
    np.testing.assert_allclose(noisy_fit.values, theirs, rtol=1e-6)


def test_slopes_equal_central_differences(noisy_fit: trb.Fit) -> None:
    problem, u, step = noisy_fit.problem, noisy_fit.point, 1e-5
    points = np.concatenate([u + step * np.eye(2), u - step * np.eye(2)])
    told = np.asarray(solved(problem, points, np.ones_like(points, bool), 0, 0).beside[0])
    slopes = (told[:2] - told[2:]).T / (2.0 * step) / np.asarray(problem.sigma)[:, None]
    np.testing.assert_allclose(noisy_fit.normal, slopes.T @ slopes, rtol=1e-6)


@pytest.mark.slow
def test_values_follow_the_data(rig: trb.Scene, exact: np.ndarray, noisy_fit: trb.Fit) -> None:
    slopes = noisy_fit.by_data()
    rows, k, step = noisy(exact, 1), 2, 1e-3
    ends = [
        fit(
            rig,
            [*rows[:k], dataclasses.replace(rows[k], value=rows[k].value + e), *rows[k + 1 :]],
            model_error=0.0,
            starts=FEW,
        )
        for e in (step, -step)
    ]
    differences = (ends[0].values - ends[1].values) / (2.0 * step)
    np.testing.assert_allclose(slopes[:, k], differences, rtol=1e-4, atol=5e-5 * float(np.abs(differences).max()))


@pytest.mark.slow
def test_intervals_cover(rig: trb.Scene, exact: np.ndarray) -> None:
    fits = [fit(rig, noisy(exact, seed), model_error=0.0, starts=8) for seed in range(10, 22)]
    truth = np.array([TRUTH["length"], TRUTH["width"]])
    scores = np.array([(f.values - truth) / f.standard_errors for f in fits])
    assert 0.4 < np.mean(scores**2) < 2.0  # 24 values: chance 1 in 1000 on either side
    inside = np.array([(f.intervals[:, 0] < truth) & (truth < f.intervals[:, 1]) for f in fits])
    assert np.mean(inside) >= 0.8


@pytest.mark.parametrize(("axial", "alike"), [(4500.0, True), (2600.0, False)])
def test_kinks_are_placed_by_one_ring_where_all_phases_have_that(rig: trb.Scene, axial: float, alike: bool) -> None:
    """In a narrow load zone rings lie differently: placed by the one at phase 0, a loss in the mean was 4 % off."""
    rows = [Measurement(9000.0, axial, "radial_loss", 1.0, 0.1, None, "mean")]
    (blocks,) = conditions(dataclasses.replace(rig, load=trb.Load(9000.0, axial)), rows).blocks
    assert (blocks.healthy_ring is not None) == alike


@pytest.mark.parametrize(
    ("effect", "alike"),
    [
        (trb.effects.Raceways(), True),
        (trb.effects.DoubleRow(0.02), True),
        (trb.effects.Diameters((1e-3,) * 3 + (0.0,) * 20), False),
    ],
)
def test_effects_that_leave_rings_alike_have_kinks_placed_by_one(effect: trb.effects.Effect, alike: bool) -> None:
    """Fits with both raceways solved six rounds of rings for their kinks, more than for all else. Losses are the
    same to a part in a thousand."""
    spall = trb.Spall(5.0, 5.0, angle=0.2)
    scene = trb.Scene(
        trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (spall,), "table", phase="mean", effects=(effect,)
    )
    ready, rows = trb.prepare(scene), [Measurement(9000.0, 4500.0, "radial_loss", 1.0, 0.1, None, "mean")]
    (blocks,) = conditions(ready, rows).blocks
    assert (blocks.healthy_ring is not None) == alike
    (told,) = rows_of((), ready, rows, np.zeros(0))
    assert told == pytest.approx(float(trb.assess(ready).loss[0]), rel=1e-3)


def test_an_error_of_the_model_widens_intervals(rig: trb.Scene, exact: np.ndarray, noisy_fit: trb.Fit) -> None:
    wider = fit(rig, measured(exact))  # the law's own error, 2.5 % by the paper
    shifted = fit(rig, measured(1.025 * exact), model_error=0.0)
    assert wider.standard_errors[0] == pytest.approx(abs(shifted["length"] - TRUTH["length"]), rel=0.05)
    assert wider.standard_errors[0] > 3.0 * noisy_fit.standard_errors[0]


def test_an_error_of_the_model_pulls_nowhere(noisy_fit: trb.Fit) -> None:
    """Peelle's puzzle: 1.0 and 1.5, each known to 10 %, both to 20 %, are best told by something in between."""
    measured = jnp.where(jnp.arange(len(BLANK)) % 2 == 0, 1.0, 1.5)
    problem = dataclasses.replace(noisy_fit.problem, measured=measured, sigma=0.1 * measured, common=0.2)
    told = jnp.linspace(0.5, 2.0, 301)
    squares = jax.vmap(lambda t: jnp.sum(predicted.weighted_residuals(problem, jnp.full(len(BLANK), t)) ** 2))(told)
    assert 1.1 < float(told[jnp.argmin(squares)]) < 1.3


ENTRY = {"radial": (0, 0), "axial": (2, 2), "lateral": (1, 1), "radial_axial": (0, 2), "radial_lateral": (0, 1),
         "lateral_axial": (1, 2)}  # fmt: skip


def test_every_entry_of_the_matrix_is_the_solutions(rig: trb.Scene) -> None:
    """Rows of a whole matrix at phases and in the mean, as a stiffness and as a loss, of a spall off the load line."""
    spall = trb.Spall(5.0, 9.0, angle=0.3)
    rows, told = [], []
    for load, phase in (((9000.0, 4500.0), 0.1), ((3000.0, 4500.0), "mean")):
        at = dataclasses.replace(rig, spalls=(spall,), load=trb.Load(*load), phase=phase)
        found = trb.assess(at)
        ours, healthy = np.asarray(found.spalled.stiffness), np.asarray(found.healthy.stiffness)
        for name, entry in ENTRY.items():
            rows.append(Measurement(*load, f"{name}_stiffness", 1.0, 1.0, None, phase))  # type: ignore[arg-type]
            told.append(ours[entry])
            if entry[0] == entry[1]:
                rows.append(Measurement(*load, f"{name}_loss", 1.0, 1.0, None, phase))  # type: ignore[arg-type]
                told.append(100.0 * (1.0 - ours[entry] / healthy[entry]))
    problem, _ = problem_of(rig, tuple(rows), ("length", "width", "angle"), "squares", 0.0)
    point = problem.bounds.coordinates(np.array([[5.0, 9.0, 0.3]]))
    values = evaluated(problem, point).beside[0][0]
    scale = np.where([row.is_loss for row in rows], 1.0, 1e5)
    np.testing.assert_allclose(values / scale, np.array(told) / scale, atol=2e-3)


@pytest.mark.slow
def test_errors_of_loads_widen_their_rows(rig: trb.Scene, exact: np.ndarray, noisy_fit: trb.Fit) -> None:
    """By what the row changes with its loads, here told by two solutions."""
    rows = [dataclasses.replace(row, load_sigma=3.0 if k == 0 else 0.0) for k, row in enumerate(noisy(exact, 1))]
    found = fit(rig, rows, model_error=0.0, starts=FEW)
    spall, losses = found.scene.spalls, []
    for factor in (0.99, 1.01):
        load = trb.Load(9000.0 * factor, 4500.0 * factor)
        losses.append(float(trb.assess(dataclasses.replace(rig, spalls=spall, load=load, phase=0.0)).loss[0]))
    change = (losses[1] - losses[0]) / 0.02 * 0.03
    assert found.sigma[0] == pytest.approx(np.hypot(rows[0].sigma, change), rel=1e-3)
    np.testing.assert_array_equal(found.sigma[1:], noisy_fit.sigma[1:])


@pytest.mark.slow
@pytest.mark.usefixtures("no_suspects")
def test_what_data_do_not_determine_is_said(rig: trb.Scene, exact: np.ndarray) -> None:
    rows = [dataclasses.replace(row, sigma=1e3 * row.sigma) if row.phase == 0.0 else row for row in noisy(exact, 3)]
    found = fit(rig, rows, model_error=0.0)
    assert not found.determined
    sentence = next(r for r in found.remarks if "is determined to" in r)
    assert sentence.startswith("near this answer")
    assert "length × width" in sentence or "width × length" in sentence
    assert "length is not" in sentence
    assert "with roller 0 at 0 rad" in sentence
    assert found.correlation[0, 1] < -0.99
    widths = found.ridge(np.stack([found.point - 0.05, found.point + 0.05], 1))
    assert widths.min() > -1e-9


@pytest.mark.slow
@pytest.mark.usefixtures("no_suspects")
def test_sigma_is_estimated_when_none_is_given(rig: trb.Scene, exact: np.ndarray, noisy_fit: trb.Fit) -> None:
    rows = [dataclasses.replace(row, sigma=None) for row in noisy(exact, 1)]
    found = fit(rig, rows, model_error=0.0, starts=FEW)
    assert found.sigma_estimated
    assert any("no sigma was given" in r for r in found.remarks)
    assert np.sum(found.residuals**2) == pytest.approx(found.freedom, rel=1e-6)
    np.testing.assert_allclose(found.values, noisy_fit.values, rtol=2e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("no_suspects")
def test_an_outlier_is_left_aside_on_request(rig: trb.Scene, exact: np.ndarray) -> None:
    rows = noisy(exact, 1)
    rows[0] = dataclasses.replace(rows[0], value=1.4 * rows[0].value)
    plain = fit(rig, rows, model_error=0.0, starts=FEW)
    assert any("misses the data" in r and "row 1" in r for r in plain.remarks)
    for way in ("huber", "student"):
        found = fit(rig, rows, robust=way, starts=FEW)
        assert abs(found["length"] - 5.0) < 0.3 * abs(plain["length"] - 5.0), way
        assert any(r.startswith("row 1 stands") for r in found.remarks), way


@pytest.mark.slow
@pytest.mark.usefixtures("no_suspects")
def test_wrong_data_get_sentences(rig: trb.Scene, exact: np.ndarray) -> None:
    cases = {
        "row 1: radial_loss = -": -exact[0],
        "more than the model can give": 60.0,
    }
    for sentence, value in cases.items():
        rows = noisy(exact, 1)
        rows[0] = dataclasses.replace(rows[0], value=float(value))
        assert any(sentence in r for r in fit(rig, rows, model_error=0.0, starts=FEW).remarks), sentence
    same = [dataclasses.replace(row, value=3.0, sigma=0.01) for row in BLANK]
    assert any("all 4 values of radial_loss are 3" in r for r in fit(rig, same, model_error=0.0, starts=FEW).remarks)


def test_the_next_measurement_shrinks_the_interval(noisy_fit: trb.Fit) -> None:
    among = optimal_design.candidates(noisy_fit)
    assert len(among) > 12
    first, second = optimal_design.next_measurements(noisy_fit, among, count=2)
    assert first.gain >= second.gain > 1.0
    assert second.errors["length"] <= first.errors["length"] < noisy_fit.standard_errors[0]
    for name in TRUTH:
        (best,) = optimal_design.next_measurements(noisy_fit, among, count=1, parameter=name)
        assert best.errors[name] <= first.errors[name] + 1e-12


def test_rows_without_a_roller_at_the_spall_tell_no_error_in_proportion(noisy_fit: trb.Fit) -> None:
    """Half of the rows at a phase may see no spall: the error to expect of a loss became 1e8 %, and no measurement
    told two answers apart."""
    among = optimal_design.candidates(noisy_fit)
    seen = noisy_fit.predicted.copy()
    seen[::2] = 1e-15
    blind = dataclasses.replace(noisy_fit, predicted=seen)
    usual, found = (optimal_design.next_measurements(each, among, count=1)[0] for each in (noisy_fit, blind))
    assert found.row.sigma == pytest.approx(usual.row.sigma, rel=0.5)
    assert found.gain == pytest.approx(usual.gain, rel=0.5)


def test_bounded_coordinates_go_both_ways() -> None:
    some = least_squares.Bounds(jnp.array([0.1, -3.0]), jnp.array([10.0, 3.0]), (True, False))
    values = jnp.array([2.0, 0.5])
    np.testing.assert_allclose(some.values(some.coordinates(values)), values, rtol=1e-12)
    assert float(some.values(jnp.array([50.0, -50.0]))[0]) == pytest.approx(10.0)


def test_limits_of_intervals() -> None:
    assert profile_intervals.limit_of(None) == pytest.approx(3.841, rel=1e-3)
    assert profile_intervals.limit_of(6) == pytest.approx(2.447**2, rel=1e-3)  # Student's t, tables
    assert fit_result.tail(9.488, 4) == pytest.approx(0.05, rel=1e-3)


@pytest.mark.parametrize(("rises", "end"), [
    ({1.0: 1.0, 2.0: 4.0, 3.0: 9.0, 4.0: 16.0}, 1.9600),  # of a normal likelihood
    ({0.1: 3.0, 0.2: 6.0, 3.0: 7.0, 4.0: 16.0}, 3.2620),  # a spike on a plain that ends at 4
    ({0.1: 3.0, 0.2: 6.0, 3.0: 7.0, 4.0: 8.0}, np.inf),  # on one without an end
])  # fmt: skip
def test_an_interval_does_not_end_where_a_little_noise_decides(rises: dict[float, float], end: float) -> None:
    """A best fit may owe its place to a kink that a row's error has made; what is a little higher all round counts."""
    limits = profile_intervals.limits_of(None, 1.0)
    for way in (1.0, -1.0):
        held = [profile_intervals.Held(way * at, rise, np.zeros(1)) for at, rise in {0.0: 0.0, **rises}.items()]
        side = profile_intervals.Side(held[0], 0.0)
        side.extend(held[1:])
        assert profile_intervals._end(side, limits) == pytest.approx(way * end, rel=1e-3)


def test_an_interval_goes_on_over_a_rise_within_one_basin() -> None:
    """Not over one that is farther away than basins are."""
    limits, rises = profile_intervals.limits_of(None, 1.0), {0.01: 300.0, 0.02: 1.5, 0.04: 3.0, 0.06: 1e4}
    ends = []
    for reach in (0.0, 0.05):
        side = profile_intervals.Side(profile_intervals.Held(0.0, 0.0, np.zeros(1)), reach)
        side.extend(profile_intervals.Held(at, rise, np.zeros(1)) for at, rise in rises.items())
        ends.append(profile_intervals._end(side, limits))
    assert ends[0] < 0.01
    assert 0.04 < ends[1] < 0.06


def test_a_kink_along_one_coordinate_does_not_hold_back_the_others() -> None:
    """The full step always leaves the floor of x between walls; y has far to go all the same."""

    def walled(u: np.ndarray) -> least_squares.Evaluated:
        x, y = u.T
        beyond, zero = np.abs(x) > 0.2, np.zeros_like(x)
        residual = np.stack([np.exp(y) - 20.0, 100.0 * np.where(beyond, np.abs(x) - 0.2, 0.0), 0.3 * (x - 1.0)], 1)
        slopes = [[zero, np.exp(y)], [np.where(beyond, 100.0 * np.sign(x), 0.0), zero], [zero + 0.3, zero]]
        return least_squares.Evaluated(residual, np.stack([np.stack(row, 1) for row in slopes], 1), ())

    found = least_squares.minimum(walled, np.array([[0.0, 0.5]]), np.ones((1, 2), bool), 25)
    assert found.points[0, 1] == pytest.approx(np.log(20.0), rel=1e-6)
    assert found.points[0, 0] == pytest.approx(0.2, abs=0.01)


@pytest.mark.slow
def test_a_place_that_the_data_do_not_tell_has_a_wide_interval(rig: trb.Scene, exact: np.ndarray) -> None:
    """By a hard window the angle changes nothing at one phase while roller 0 is over the spall, ± 0.1 rad, and next to
    nothing in the mean. The profile, straight from 0 to a far point behind a cliff, gave ± 0.004."""
    as_wide = dataclasses.replace(rig, spalls=(trb.Spall(4.0, TRUTH["width"]),))
    found = fit(as_wide, measured(exact), ("length", "angle"), starts=128, model_error=0.0)
    low, high = found.intervals[1]
    assert -0.13 < low < -0.05
    assert 0.05 < high < 0.13


def test_levenberg_marquardt_alone() -> None:
    def rosenbrock(u: np.ndarray) -> least_squares.Evaluated:
        x, y = u.T
        residual = np.stack([10.0 * (y - x**2), 1.0 - x], 1)
        slopes = np.stack([np.stack([-20.0 * x, np.full_like(x, 10.0)], 1), np.tile([-1.0, 0.0], (len(u), 1))], 1)
        return least_squares.Evaluated(residual, slopes, (u,))

    free = np.array([[True, True], [True, False], [True, True]])
    starts = np.array([[-1.2, 1.0], [3.0, 4.0], [-1.21, 1.0]])
    found = least_squares.minimum(rosenbrock, starts, free, 60)
    np.testing.assert_allclose(found.points[::2], 1.0, rtol=1e-7)
    assert found.points[1, 1] == 4.0
    assert found.converged.all()
    met = least_squares.minimum(rosenbrock, starts, free, 60, enough=least_squares.Enough(meet=np.full(2, 0.02)))
    np.testing.assert_array_equal(met.points[0], met.points[2])
    np.testing.assert_allclose(met.points[0], 1.0, rtol=1e-7)
    assert met.converged.all()
    assert min(met.steps[0], met.steps[2]) < 3 < max(met.steps[0], met.steps[2])


def test_levenberg_marquardt_where_residuals_bend_and_jump() -> None:
    """Gauss and Newton overshoot where a large residual bends, and a jump stops what is beside it: steps shortened by a
    parabola, each coordinate in its turn, come there all the same."""

    def bends(u: np.ndarray) -> least_squares.Evaluated:
        x, y = u.T
        wall = np.where(x > 0.7, 50.0, 0.0)
        residual = np.stack([3.0 + x**2 + wall, 10.0 * (y - 1.0)], 1)
        slopes = np.stack([np.stack([2.0 * x, 0.0 * x], 1), np.tile([0.0, 10.0], (len(u), 1))], 1)
        return least_squares.Evaluated(residual, slopes, (u,))

    starts = np.array([[0.6, -1.0], [-0.3, 3.0], [0.65, 1.0], [0.5, 1.0]])
    free = np.array([[True, True], [True, True], [True, True], [False, True]])
    found = least_squares.minimum(bends, starts, free, 25, enough=least_squares.Enough(1e-9))
    np.testing.assert_allclose(found.points[:3], [[0.0, 1.0]] * 3, atol=1e-4)
    np.testing.assert_allclose(found.points[3], [0.5, 1.0])
    assert found.converged.all()
    assert found.steps.max() < 20
    apart = least_squares.minimum(bends, starts, free, 25, enough=least_squares.Enough(meet=np.full(2, 9.0)))
    assert apart.points[3, 0] == 0.5  # what is held does not meet what moves


def test_cases_far_behind_end_early() -> None:
    def slopes_down(u: np.ndarray) -> least_squares.Evaluated:
        residual = np.stack([100.0 + 0.1 * u[:, 0], u[:, 1]], 1)
        return least_squares.Evaluated(residual, np.tile(np.diag([0.1, 1.0]), (len(u), 1, 1)), (u,))

    both = np.ones((2, 2), bool)
    starts = np.array([[5.0, 0.0], [-5.0, 1.0]])
    whole = least_squares.minimum(slopes_down, starts, both, 30)
    early = least_squares.minimum(slopes_down, starts, both, 30, enough=least_squares.Enough(behind=0.5))
    assert early.steps[0] < whole.steps[0]
    assert early.cost.min() == pytest.approx(whole.cost.min())


@pytest.mark.slow
@pytest.mark.parametrize(("length", "width", "angle"), [(5.86, 7.67, 0.17), (5.95, 3.17, -0.44)])
def test_narrow_basins_are_found(bearing: trb.TaperedBearing, length: float, width: float, angle: float) -> None:
    """Rows at several phases tell the angle to a milliradian. Least squares that compared losses by their difference
    ended 20 … 3000 above the truth's χ², though a point of the scan stood beside it."""
    world = trb.Scene(bearing, trb.Load(*LOADS[0]), (trb.Spall(length, width, angle=angle),))
    noise = np.random.default_rng(5).standard_normal(14)
    turned = [
        Measurement(*LOADS[0], q, 1.0, 1.0, None, p) for p in (0.1, 0.2, 0.3) for q in ("radial_loss", "axial_loss")
    ]
    rows = []
    for k, row in enumerate((*BLANK, *turned)):
        losses = trb.assess(world.replace(load=trb.Load(row.radial, row.axial), phase=row.phase)).loss
        value = float(losses[0 if row.quantity == "radial_loss" else 1])
        sigma = 0.01 * value + 1e-3
        rows.append(dataclasses.replace(row, value=value + sigma * noise[k], sigma=sigma))
    found = fit(world.replace(length=3.0, width=5.0, angle=0.0), rows, ("length", "width", "angle"))
    assert found.chi2 < np.sum(noise**2) + 0.1
    np.testing.assert_allclose(found.values, [length, width, angle], rtol=0.03, atol=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [3.0, np.pi, -3.08])
def test_spalls_are_found_where_the_angle_begins_anew(bearing: trb.TaperedBearing, angle: float) -> None:
    """At half a turn from the load line: a scan of −0.9 π … 0.9 π had none there, and called another spall determined;
    an interval that ended at π did not hold −π."""
    world = trb.Scene(bearing, trb.Load(3000.0, 6000.0), (trb.Spall(5.0, 6.0, angle=angle),))
    rng, rows = np.random.default_rng(7), []
    for phase in np.linspace(0.0, 2.0 * np.pi / bearing.rollers, 6, endpoint=False):
        rings = [trb.solve(each.replace(phase=float(phase))) for each in (world, world.replace(spalls=()))]
        for k, quantity in enumerate(("radial_loss", "lateral_loss", "axial_loss")):
            spalled, healthy = (float(ring.stiffness[k, k]) for ring in rings)
            loss = 100.0 * (1.0 - spalled / healthy) + 0.02 * rng.standard_normal()
            rows.append(Measurement(3000.0, 6000.0, quantity, loss, 0.02, None, float(phase)))
    found = fit(world.replace(length=3.0, width=5.0, angle=0.0), rows, ("length", "width", "angle"))
    assert found.explained
    assert found["length"] == pytest.approx(5.0, abs=0.1)
    low, high = found.intervals[2]
    assert any(low - 0.01 < angle + turn < high + 0.01 for turn in (-2.0 * np.pi, 0.0, 2.0 * np.pi))
    assert -np.pi <= found["angle"] <= np.pi
    for other in found.alternatives:  # the same spall is no other answer
        away = np.mod(other.values[2] - found["angle"] + np.pi, 2.0 * np.pi) - np.pi
        assert abs(away) > 1e-3 or abs(other.values[1] / found["width"] - 1.0) > 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [101, 105])
def test_an_interval_holds_a_wide_minimum_behind_a_narrow_one(bearing: trb.TaperedBearing, seed: int) -> None:
    """Where a roller just reaches an edge: the interval ended 0.5 µm from a minimum 0.5 µm wide, and did not hold 3."""
    world = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 3.0, angle=0.5),), "table")
    rng, rows = np.random.default_rng(seed), []
    pitch = 2.0 * np.pi / bearing.rollers
    for phase in (*np.linspace(0.0, pitch, 9)[:-1].tolist(), "mean"):
        spalled, healthy = (
            trb.solve(each.replace(phase=phase)).stiffness for each in (world, world.replace(spalls=()))
        )
        losses = [100.0 * (1.0 - float(spalled[k, k] / healthy[k, k])) for k in (0, 2)]
        beside = () if phase == "mean" else (float(spalled[0, 1]),)
        told = dict(zip(("radial_loss", "axial_loss", "radial_lateral_stiffness"), (*losses, *beside), strict=False))
        for quantity, value in told.items():
            sigma = max(0.01 * abs(value), 0.01)
            noise = sigma * rng.standard_normal()
            rows.append(Measurement(9000.0, 4500.0, quantity, value + noise, sigma, None, phase))
    found = fit(world.replace(length=3.0, width=3.0), rows)
    assert found.explained
    for (low, high), truth in zip(found.intervals, (4.0, 3.0), strict=True):
        assert low < truth < high


def test_light_loads_that_the_law_does_not_know_are_not_advised(noisy_fit: trb.Fit) -> None:
    """Half of the lightest load is below a table's range: it made all advice "nan"."""
    among = [*BLANK, Measurement(90.0, 45.0, "radial_loss", 1.0, 1.0, None, 0.0)]
    table = dataclasses.replace(noisy_fit.problem, scene=by_table(noisy_fit.scene.replace(law="table")))
    values, slopes = predicted.other_rows_and_slopes(table, among, noisy_fit.point)
    assert np.isnan(values[-1])
    assert np.isfinite(values[:-1]).all()
    assert np.isfinite(slopes[:-1]).all()
    light = dataclasses.replace(noisy_fit, problem=table)
    advised = optimal_design.next_measurements(light, among, count=9)
    assert len(advised) == len(BLANK)
    assert all(np.isfinite(list(each.errors.values())).all() for each in advised)
    assert optimal_design.next_measurements(light, among[-1:]) == ()


def test_rows_by_numbers_are_those_of_the_program(noisy_fit: trb.Fit) -> None:
    """What may be measured next is told by numpy, with all slopes; means by a rule of more points."""
    single = [row for row in noisy_fit.rows if row.phase != "mean"]
    points, known = np.stack([noisy_fit.point, noisy_fit.point + 0.3]), set(batched_misfit._compiled)
    read = [predicted.other_rows_and_slopes(noisy_fit.problem, noisy_fit.rows, point) for point in points]
    values, slopes = map(np.stack, zip(*read, strict=True))
    plain = predicted.other_rows(noisy_fit.problem, noisy_fit.rows, points)
    np.testing.assert_allclose(plain, values, rtol=1e-12)
    assert len(optimal_design.next_measurements(noisy_fit)) == 3
    assert batched_misfit._compiled == known
    expected, rates = batched_misfit._plainly(noisy_fit.problem, points)
    own = [row in single for row in noisy_fit.rows]
    np.testing.assert_allclose(values[:, own], expected[:, own], rtol=1e-12)
    np.testing.assert_allclose(slopes[:, own], rates[:, own], atol=1e-12 * np.abs(rates).max())
    np.testing.assert_allclose(values, expected, rtol=2e-3)
    np.testing.assert_allclose(slopes, rates, atol=2e-3 * np.abs(rates).max())


@pytest.mark.slow
def test_measurements_that_may_be_made_share_the_fits_program(bearing: trb.TaperedBearing) -> None:
    """Of effects that numpy does not solve: many rows had one of their own, as long to compile as the fit's."""
    turning = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(5.0, 9.0),), "liu2018",
                        effects=(trb.effects.Centrifugal(3000.0),))  # fmt: skip
    phases = [row for row in BLANK if row.phase != "mean"]
    values = trb.assess(turning).loss
    rows = [dataclasses.replace(row, value=float(v), sigma=0.05) for row, v in zip(phases[:2], values, strict=True)]
    found = fit(turning, 10 * rows, ("length",), starts=FEW)
    known = set(batched_misfit._compiled)
    assert len(optimal_design.next_measurements(found)) == 3
    assert batched_misfit._compiled == known


def test_an_interval_that_ends_with_the_range_does_not_determine(rig: trb.Scene, exact: np.ndarray) -> None:
    """A spall as long as the law knows: a longer one would read as this one."""
    longest = float(laws.kind("liu2018").longest(float(rig.bearing.roller_length)))
    spalled = dataclasses.replace(rig, spalls=(trb.Spall(0.99 * longest, 9.0),))
    values = [
        trb.assess(dataclasses.replace(spalled, load=trb.Load(*load), phase=phase)).loss
        for load in LOADS
        for phase in (0.0, "mean")
    ]
    found = fit(rig, measured(np.concatenate(values), 0.02), starts=FEW)
    length = found.parameters.index("length")
    assert found.open[length, 1]
    assert not found.determined_each[length]
    assert any("mm and more" in sentence for sentence in found.remarks)


def test_a_width_that_the_range_of_lengths_holds_is_not_determined(bearing: trb.TaperedBearing) -> None:
    """Losses in the mean alone tell a product of length and width. Where lengths end at what the law knows, widths do:
    1.61 … 2.25 mm were called determined for 4.37, at 11.4 mm for 6.03."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(7.5, 2.0),), law="liu2018", phase="mean")
    rows = []
    for load in LOADS:
        for name, loss in zip(("radial_loss", "axial_loss"), trb.assess(scene.replace(load=trb.Load(*load))).loss,
                              strict=True):  # fmt: skip
            rows.append(Measurement(*load, name, float(loss), 0.01 * float(loss), None, "mean"))
    found = fit(scene.replace(spalls=(trb.Spall(5.0, 4.0),)), rows, starts=FEW)
    low, high = found.intervals[1]
    assert found.open[0, 1]
    assert high / low < 1.5
    assert not found.determined_each.any()
    assert any("fit as well with length in the range that is searched" in sentence for sentence in found.remarks)


def test_where_the_bearing_lies_beyond_what_is_searched_nothing_is_determined() -> None:
    """A preload of 2500 N, searched up to 1000, was called determined (> 560 N), and a length 20 % too short with it;
    what to measure next was said to tell it to 4 mN."""
    scene = trb.Scene(trb.bearing("32008J"), trb.Load(3000.0, 1000.0), (trb.Spall(4.0, 7.0),), law="table")
    rows, noise = [], np.random.default_rng(2)
    for phase in (0.0, "mean"):
        for name, loss in zip(("radial_loss", "axial_loss"), trb.assess(scene.replace(axial=3500.0, phase=phase)).loss,
                              strict=True):  # fmt: skip
            sigma = 0.02 * float(loss)
            value = float(loss) + sigma * noise.standard_normal()
            rows.append(Measurement(3000.0, 1000.0, name, value, sigma, None, phase))
    found = fit(scene, rows, ("length", "preload"), starts=FEW)
    assert found["preload"] == pytest.approx(1000.0)
    assert found.open[1, 1]
    assert not found.determined_each.any()
    assert any("preload may lie beyond the range that is searched" in sentence for sentence in found.remarks)
    assert all(np.isnan(s.errors["preload"]) for s in optimal_design.next_measurements(found))


BAD = {
    "no rows": ({"rows": []}, "no rows"),
    "unknown parameter": ({"parameters": ("size",)}, "'size' is not known"),
    "twice": ({"parameters": ("length", "length")}, "each once"),
    "frozen crown": ({"parameters": ("length", "crown")}, "crown cannot be fitted.*frozen"),
    "unknown way": ({"robust": "median"}, "robust = 'median'"),
    "model error": ({"model_error": -1.0}, "model_error = -1.0"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_fitted_is_refused(name: str, rig: trb.Scene, exact: np.ndarray) -> None:
    changed, sentence = BAD[name]
    with pytest.raises(MeasuredError, match=sentence):
        fit(rig, **({"rows": measured(exact)} | changed))


@pytest.mark.parametrize("radial", [20.0, 2e6])
def test_loads_that_the_law_does_not_know_are_refused(bearing: trb.TaperedBearing, radial: float) -> None:
    """By the reason: it was said that nothing depends on the length."""
    rows = [Measurement(radial, 0.5 * radial, f"{way}_loss", 1.0, 0.1, phase=0.0) for way in ("radial", "axial")]
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(3.0, 4.0),))
    with pytest.raises(MeasuredError, match="no spall has a solution under these loads: rollers carry"):
        fit(scene, rows, ("length",), starts=FEW)


def test_a_spall_on_a_roller_has_no_mean(bearing: trb.TaperedBearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(3.0, 4.0, surface="roller"),),
                      effects=(trb.effects.Raceways(rollers="upright"),))  # fmt: skip
    rows = [Measurement(9000.0, 4500.0, "radial_loss", 1.0, 0.1, phase=phase) for phase in (0.0, "mean")]
    with pytest.raises(MeasuredError, match="row 2: phase = mean: a spall on a roller"):
        fit(scene, rows, ("length",))


def test_rows_that_do_not_fit_together_are_refused(rig: trb.Scene, exact: np.ndarray) -> None:
    rows = measured(exact)

    def first(**changed: object) -> list[Measurement]:
        return [dataclasses.replace(rows[0], **changed), *rows[1:]]

    for wrong, sentence in (
        (first(sigma=None), "row 1: sigma is empty"),
        (first(axial=1000.0), "row 1: axial = 1000 N is too small"),
        (first(radial=0.0, definition="secant"), "row 1.*needs a radial load"),
        (first(speed_rpm=100.0), "row 1: speed_rpm = 100"),
        (measured(exact, None)[:2], "2 measured values cannot give 2 parameters"),
    ):
        with pytest.raises(MeasuredError, match=sentence):
            fit(rig, wrong)
    with pytest.raises(MeasuredError, match="no \\[\\[spall\\]\\]"):
        fit(dataclasses.replace(rig, spalls=()), rows)
    with pytest.raises(MeasuredError, match="'direct'"):
        fit(dataclasses.replace(rig, law="direct"), rows)


SCENE = f"""{scene_file.example("spall")}
[contact]
law = "liu2018"
"""


def test_a_fit_that_is_stopped_says_what_it_has_found(
    noisy_fit: trb.Fit, exact: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """It said "iteration limit" alone, though it knew which row was off."""
    scene, table = tmp_path / "scene.toml", tmp_path / "rows.csv"
    scene.write_text(SCENE, encoding="utf-8")
    lines = [f"{r.radial},{r.axial},{r.quantity},{r.value},{r.sigma},{r.phase}" for r in noisy(exact, 1)]
    table.write_text("\n".join(["radial,axial,quantity,value,sigma,phase", *lines]), encoding="utf-8")
    stopped = dataclasses.replace(noisy_fit, status_code=np.asarray(status.NOT_CONVERGED), remarks=("row 3 is off",))
    monkeypatch.setattr(fit_report, "fit", lambda *_, **__: stopped)
    assert cli.main(["--no-cache", "fit", str(scene), str(table)]) == console.EXIT_NO_SOLUTION
    told = capsys.readouterr()
    assert "row 3 is off" in told.out
    assert "rows.csv: least squares were still coming down" in " ".join(told.err.split())


@pytest.mark.portable
def test_the_command_line_fits(exact: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, table = tmp_path / "s.toml", tmp_path / "m.csv"
    scene.write_text(SCENE, encoding="utf-8")
    rows = [f"{r.radial},{r.axial},{r.quantity},{r.value},{r.sigma},{r.phase}" for r in measured(exact)]
    table.write_text("\n".join(["radial,axial,quantity,value,sigma,phase", *rows]), encoding="utf-8")
    folder = tmp_path / "out"
    assert cli.main(["--no-cache", "fit", str(scene), str(table), "--json", "--out", str(folder)]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["converged"]
    assert record["parameters"]["length"]["value"] == pytest.approx(5.0, rel=1e-6)
    assert record["next_measurements"][0]["gain"] > 1.0
    assert {p.name for p in folder.iterdir()} == {"fit.png", "fit.svg", "result.json"}
    assert cli.main(["--no-cache", "fit", str(scene), str(table), "--parameters", "size"]) == 2
    assert "'size' is not known" in capsys.readouterr().err
    table.write_text("radial,axial,quantity,value,sigma\n9000,45,radial_loss,3,0.1\n", encoding="utf-8")
    assert cli.main(["--no-cache", "fit", str(scene), str(table)]) == 2
    assert f"{table}: line 2: axial = 45 N is too small" in capsys.readouterr().err
    table.write_text("radial,axial\n", encoding="utf-8")
    assert cli.main(["--no-cache", "fit", str(scene), str(table)]) == 2
    assert f"{table}: line 1: column quantity is missing" in capsys.readouterr().err


def test_the_packaged_measurements_are_in_order() -> None:
    rows = parse(example())
    assert len(rows) == 8
    assert all(row.sigma is not None for row in rows)


# ------------------------------------------------------------------------------------- what is wrong is found and named


@pytest.mark.slow
def test_what_may_be_wrong_is_tried_and_named(rig: trb.Scene, exact: np.ndarray) -> None:
    """One row off, an axial load that was not measured, a healthy bearing that was stiffer: each is found, with the
    size that it hides."""
    pressed = [dataclasses.replace(row, axial=row.axial + 1500.0) for row in BLANK]
    problem = fit(rig, measured(exact), model_error=0.0).problem
    there = problem.bounds.coordinates(np.array([[5.0, 9.0]]))
    (preloaded,) = predicted.other_rows(problem, pressed, there)
    for sentence, values in {
        "row 3 is off": np.where(np.arange(8) == 2, 1.25, 1.0) * exact,
        "an axial load acts that was not measured (preload 1.5e+03 N)": preloaded,
        "so that all losses are off (reference 1.01)": 100.0 - (100.0 - exact) / 1.01,
    }.items():
        found = fit(rig, measured(values), model_error=0.0, starts=FEW)
        assert not found.explained, sentence
        assert not found.determined, sentence
        told = [remark for remark in found.remarks if remark.startswith("perhaps") and sentence in remark]
        assert len(told) == 1, (sentence, found.remarks)
        assert "explains the data" in told[0]
        assert "length 5 mm, width 9 mm" in told[0]


@pytest.mark.slow
def test_fractions_are_found(rig: trb.Scene, exact: np.ndarray) -> None:
    """Of 1 % noise: a smaller spall does not lose as these do over loads and phases."""
    rows = [
        dataclasses.replace(row, value=0.01 * float(v), sigma=1e-4 * float(v))
        for row, v in zip(BLANK, exact, strict=True)
    ]
    found = fit(rig, rows, model_error=0.0, starts=FEW)
    assert not found.determined
    assert any("losses are given as fractions" in doubt for doubt in found.doubts)
    assert set(found.doubts) <= set(found.remarks)
    assert not found.reliable


@pytest.mark.slow
@pytest.mark.usefixtures("no_suspects")
def test_a_misfit_widens_intervals(rig: trb.Scene, exact: np.ndarray) -> None:
    rows = [dataclasses.replace(row, sigma=0.2 * row.sigma) for row in noisy(exact, 1)]
    plain, small = (fit(rig, some, model_error=0.0, starts=FEW) for some in (noisy(exact, 1), rows))
    assert small.limit == pytest.approx(plain.limit * small.chi2 / small.freedom)
    assert not small.explained
    assert not small.determined


def test_a_healthy_bearing_needs_no_spall(rig: trb.Scene, exact: np.ndarray) -> None:
    noise = 0.02 * np.random.default_rng(4).standard_normal(8)
    rows = [dataclasses.replace(row, value=float(v), sigma=0.02) for row, v in zip(BLANK, noise, strict=True)]
    found = fit(rig, rows, model_error=0.0, starts=FEW)
    assert any(remark.startswith("no spall is needed") for remark in found.remarks)
    assert not found.determined
    assert not (found.standard_errors > 1e3).any()


MIRRORED = (4.7366, 4.7714, -0.2501)
"""Length [mm], width [mm], angle [rad] of a spall whose losses [%] contact solves gave, with noise of 1 %; by load [N],
direction and phase. All rows are symmetric about the load line, so the angle's sign is not told."""
OF_MIRRORED = """radial,axial,quantity,value,sigma,phase
9000,4500,radial_loss,3.22904,0.032,0.0
9000,4500,axial_loss,1.54978,0.01543,0.0
9000,4500,radial_loss,1.9182,0.01888,mean
9000,4500,axial_loss,0.896483,0.009037,mean
3000,4500,radial_loss,1.83594,0.01873,0.0
3000,4500,axial_loss,0.87666,0.008701,0.0
3000,4500,radial_loss,1.1178,0.01105,mean
3000,4500,axial_loss,0.510004,0.005064,mean
"""


@pytest.mark.slow
def test_mirror_images_are_alternatives(bearing: trb.TaperedBearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(3.0, 5.0),))  # one program for narrow basins, too
    found = fit(scene, parse(OF_MIRRORED), ("length", "width", "angle")).check()
    (other,) = found.alternatives
    np.testing.assert_allclose(other.values, found.values * [1.0, 1.0, -1.0], rtol=1e-3)
    assert other.weight == pytest.approx(0.5, abs=0.01)
    assert found.determined_each.tolist() == [True, True, False]
    for k in (0, 1):
        assert found.intervals[k, 0] < MIRRORED[k] < found.intervals[k, 1]
    low, high = np.sort(np.abs(found.own_intervals[2]))
    assert low < abs(MIRRORED[2]) < high
    one, two = found.pieces[2]  # its interval is of both images
    np.testing.assert_allclose(one, -two[::-1], atol=0.03)  # of a profile, and of a normal distribution
    np.testing.assert_array_equal(found.intervals[2], [one[0], two[1]])
    assert found.interval_in_words(2) == " or ".join(f"{low:.4g} … {high:.4g}" for low, high in (one, two))
    point = dataclasses.replace(found, pieces=(np.array([[1.0, 1.5], [1.9721, 1.97212]]), *found.pieces[1:]))
    assert point.interval_in_words(0) == "1 … 1.5 or 1.972"
    assert any("another answer fits nearly as well" in remark and "sigma" in remark for remark in found.remarks)
    # the lowest χ² of a narrow basin may be less likely than the others
    wider = dataclasses.replace(found, alternatives=(other._replace(weight=0.3), other._replace(weight=0.6)))
    first, second = undetermined.of_alternatives(wider)
    assert "likelier than the one in the table" in first
    assert "weight 60 %" in first
    assert "weight 30 %" in second
    # mirror images are as likely as each other but for rounding; and where none explains the data none fits well
    (alike,) = undetermined.of_alternatives(dataclasses.replace(found, alternatives=(other._replace(weight=0.501),)))
    assert "likelier" not in alike
    off = dataclasses.replace(found, chi2=445.0, limit=300.0, alternatives=(other._replace(weight=0.9, chi2=554.0),))
    (missed,) = undetermined.of_alternatives(off)
    assert "another answer is not ruled out: " in missed
