"""What does not fit is not determined: with no row to spare, and beside rows that count for little."""

import dataclasses
import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

import difftrb as trb
from difftrb.fits import (
    fit_problem,
    fit_remarks,
    fit_report,
    fit_result,
    fitting,
    least_squares,
    profile_intervals,
    search,
    suspects,
)
from difftrb.fits.fit_problem import Problem
from difftrb.fits.least_squares import Least
from difftrb.fits.measured import MeasuredError, Measurement
from difftrb.fits.profile_intervals import Limits, Profiles


@pytest.fixture(scope="module")
def guess(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(3.0, 5.0),), law="liu2018")  # compiles soonest


def _rows(*told: tuple[float, str, float, float], phase: float | str = "mean") -> list[Measurement]:
    return [
        Measurement(radial, 4500.0, quantity, value, sigma, None, phase)  # type: ignore[arg-type]
        for radial, quantity, value, sigma in told
    ]


@pytest.mark.hard
def test_as_many_rows_as_parameters_may_contradict_the_model(guess: trb.Scene) -> None:
    """Bounds keep both parameters from an axial loss five times the radial one: length was called determined."""
    found = trb.fit(guess, _rows((9000.0, "radial_loss", 1.0, 0.01), (9000.0, "axial_loss", 5.0, 0.05)))
    assert found.freedom == 0
    assert found.chi2 > 1000.0
    assert not found.explained
    assert not found.determined_each.any()
    assert any("where so many parameters could meet every row" in remark for remark in found.remarks)
    assert any("none checks the fit" in remark for remark in found.remarks)


@pytest.mark.hard
@pytest.mark.parametrize("robust", ["huber", "student"])
def test_a_robust_fit_that_misses_most_rows_is_refuted(guess: trb.Scene, robust: str) -> None:
    """All axial losses twice as large as they are: six of eight rows "counted for little", length was determined."""
    truth = guess.replace(spall=0, length=4.0, width=7.0)
    told = []
    for radial in (9000.0, 3000.0):
        for phase in (0.0, "mean"):
            loss = np.asarray(trb.assess(truth.replace(load=trb.Load(radial, 4500.0), phase=phase)).loss)
            for quantity, value, factor in (("radial_loss", loss[0], 1.0), ("axial_loss", loss[1], 2.0)):
                sigma = 0.01 * factor * float(value)
                told += _rows((radial, quantity, factor * float(value), sigma), phase=phase)
    found = trb.fit(guess, told, robust=robust)
    assert not found.explained
    assert not found.reliable
    assert not found.determined_each.any()
    assert any("even in the two thirds of the rows" in remark for remark in found.remarks)


@pytest.mark.hard
@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ({"parameters": "length"}, "give a list of names"),
        ({"parameters": (1,)}, "1 is no name"),
        ({"starts": 0}, "starts = 0: must be a whole number, at least 1"),
        ({"starts": 1.5}, "starts = 1.5: must be"),
        ({"model_error": "a"}, "model_error = 'a': must be"),
        ({"rows": [3]}, "give a list of Measurement"),
        ({"rows": None}, "give a list of Measurement"),
    ],
)
def test_wrong_arguments_are_said(guess: trb.Scene, asked: dict, sentence: str) -> None:
    rows = asked.pop("rows", _rows((9000.0, "radial_loss", 1.0, 0.01)))
    with pytest.raises(MeasuredError, match=sentence):
        trb.fit(guess, rows, **asked)


def _of_means(guess: trb.Scene, quantities: tuple[str, ...], factor: float, error: float) -> list[Measurement]:
    """Of a spall of 4 × 7 mm in the mean over phases, all values wrong by a factor; relative error of each as told."""
    truth, told = guess.replace(spall=0, length=4.0, width=7.0), []
    for radial in (9000.0, 6000.0, 3000.0):
        found = trb.assess(truth.replace(load=trb.Load(radial, 4500.0), phase="mean"))
        stiffness = np.diagonal(np.asarray(found.spalled.stiffness))[[0, 2]]
        by_name = dict(zip(("radial_loss", "axial_loss"), np.asarray(found.loss).tolist(), strict=True))
        by_name |= dict(zip(("radial_stiffness", "axial_stiffness"), stiffness.tolist(), strict=True))
        told += _rows(*((radial, name, factor * by_name[name], error * by_name[name]) for name in quantities))
    return told


@pytest.mark.parametrize("robust", ["squares", "student"])
def test_no_spall_is_needed_as_residuals_count(guess: trb.Scene, robust: str) -> None:
    """The healthy bearing was judged by plain squares beside a fit by what counts: one outlier, and a robust fit never
    said it."""
    noise = 0.02 * np.random.default_rng(4).standard_normal(8)
    noise[3] = 0.3 if robust == "student" else noise[3]
    told = [(radial, f"{way}_loss", 0.0, 0.02) for radial in (9000.0, 6000.0, 5000.0, 3000.0)
            for way in ("radial", "axial")]  # fmt: skip
    rows = [dataclasses.replace(row, value=float(v)) for row, v in zip(_rows(*told), noise, strict=True)]
    found = trb.fit(guess, rows, robust=robust, starts=64)
    assert any(remark.startswith("no spall is needed") for remark in found.remarks), found.remarks


def test_pieces_of_an_interval() -> None:
    """Those that overlap are one; what is open stays so at its own end."""
    ends = np.array([[3.0, 4.0, 0, 0], [1.0, 2.0, 1, 0], [1.5, 2.5, 0, 0], [3.5, 3.6, 0, 1]])
    np.testing.assert_array_equal(fitting._united(ends), [[1.0, 2.5, 1, 0], [3.0, 4.0, 0, 0]])
    np.testing.assert_array_equal(fitting._united(ends[:1]), ends[:1])


def test_a_law_for_one_spall_is_refused_prepared_too(bearing: trb.TaperedBearing) -> None:
    """By its name alone it was; prepared it ended in "no spall has a solution … check their unit"."""
    rows = _rows((9000.0, "radial_loss", 1.0, 0.01), (9000.0, "axial_loss", 0.5, 0.01))
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(3.0, 5.0),), law="direct", accuracy=1e-2)
    for each in (scene, trb.prepare(scene)):
        with pytest.raises(MeasuredError, match="'direct' holds for one spall; fit with"):
            trb.fit(each, rows)


def test_names_of_files_are_no_rows(guess: trb.Scene) -> None:
    with pytest.raises(MeasuredError, match=r"say load_measured\('rows.csv'\)"):
        trb.count_spalls(guess, "rows.csv")  # type: ignore[arg-type]


@pytest.mark.hard
def test_an_error_that_all_rows_share_is_no_misfit(guess: trb.Scene) -> None:
    """All stiffnesses 1 % too large, known to 0.1 % each: with an error of 1 % that the model may have that is no
    contradiction. It was counted in χ², and not where the fit was refuted."""
    rows = _of_means(guess, ("radial_stiffness", "axial_stiffness"), 1.01, 1e-3)
    found = trb.fit(guess, rows, ("length",), model_error=0.01)
    assert fit_result.tail(float(np.sum(found.residuals**2)), found.freedom) < fit_result.UNLIKELY
    assert found.chi2 < 5.0
    assert found.explained


@pytest.mark.hard
def test_which_unit_it_may_be(guess: trb.Scene) -> None:
    """What explains next to nothing of that is not named beside it."""
    found = trb.fit(guess, _of_means(guess, ("radial_stiffness", "axial_stiffness"), 1e3, 1e-3), ("length",))
    large = [remark for remark in found.remarks if "times what the model gives" in remark]
    small = dataclasses.replace(found, rows=tuple(dataclasses.replace(r, value=1e-6 * r.value) for r in found.rows))
    for told, unit in ((large, "N/m"), (fit_remarks._beyond_the_model(small, found.predicted), "N/µm")):
        assert len(told) == 6
        assert all(said.endswith(f"check the unit (N/mm, not {unit})") for said in told)
        assert not any("e+" in said.partition(" is ")[2] for said in told)
    assert not any(said.count(f"{found.chi2:.3g}") > 1 for said in found.doubts)


def _of_two(bearing: trb.TaperedBearing, names: tuple[str, ...], depth: float = 0.2) -> Problem:
    spalls = trb.Spall(3.0, 5.0), trb.Spall(2.0, 3.0, depth, angle=0.4)
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), spalls, "table")
    rows = _rows(*((9000.0, name, 3.0, 0.1) for name in ("radial_loss", "axial_loss")), phase=0.1)
    return fit_problem.problem_of(fit_problem.prepare_fit(scene, rows), rows, names, "squares", 0.0)[0]


@pytest.mark.hard
def test_two_spalls_with_each_other_s_names_are_one_answer(bearing: trb.TaperedBearing) -> None:
    """It was said to be another answer, as good; what differs in what is not sought, or is sought of one, is one."""
    names = ("length", "width", "angle", "length_2", "width_2", "angle_2")
    problem, other = _of_two(bearing, names), [3, 4, 5, 0, 1, 2]
    assert search.exchange(problem) == other
    assert search.exchange(_of_two(bearing, names, depth=0.3)) is None
    assert search.exchange(_of_two(bearing, names[:-2] + names[-1:])) is None
    assert search.exchange(_of_two(bearing, (names[0], names[3]))) is None
    points = problem.bounds.coordinates(np.array([[4.0, 6.0, 0.1, 2.0, 3.0, 0.5]]))
    normal = np.arange(36.0).reshape(1, 6, 6)
    none = np.zeros(1)
    found = Least(points[:, other], none, normal[:, other][:, :, other], (), none, none)
    named = search.once_round(problem, found)
    np.testing.assert_array_equal(named.points, points)
    np.testing.assert_allclose(named.normal, normal, rtol=1e-12)


@pytest.mark.hard
def test_two_spalls_each_elsewhere(bearing: trb.TaperedBearing) -> None:
    """Points that are tried beside one that was found leave one of the two spalls where it is."""
    problem = _of_two(bearing, ("length", "width", "angle", "length_2", "angle_2"))
    here = np.linspace(-1.0, 1.0, 10).reshape(2, 5)
    found = search._with_one_elsewhere(problem, here)
    assert found.shape == (4 * search.ELSEWHERE, 5)
    for point, of_point in zip(here, np.split(found, 2), strict=True):
        second, first = np.split(of_point, 2)[::-1]
        np.testing.assert_array_equal(first[:, 3:], np.tile(point[3:], (search.ELSEWHERE, 1)))
        np.testing.assert_array_equal(second[:, :3], np.tile(point[:3], (search.ELSEWHERE, 1)))
        assert np.ptp(first[:, :3], axis=0).min() > 0.9
        assert np.ptp(second[:, 3:], axis=0).min() > 0.9


def test_a_cliff_has_no_standard_error() -> None:
    """Beside intervals of 0.09 rad some said 4 rad, or 2e-5: the slope at the optimum is not that on the way."""
    ends = np.array([[-2.1, 1.9], [-20.0, 2.0], [-0.1, 2.0], [-np.inf, 2.0], [-np.inf, 20.0]])
    profiles = Profiles(ends, ends, ends, np.isinf(ends), ends[..., None], ends[:, 0], 0.0)
    problem: Any = SimpleNamespace(prior=np.full(5, 9.0), bounds=SimpleNamespace(rate=lambda u: -2.0 + 0.0 * u))
    told = profile_intervals.standard_errors(problem, np.zeros(5), np.eye(5), profiles, Limits(4.0, 9.0))
    np.testing.assert_array_equal(told, [2.0, np.nan, np.nan, 2.0, np.nan])


def test_a_profile_leaves_a_bound() -> None:
    """From a length at the end of its range no slope leads away: the width's profile stayed there, and a width of 1.56
    mm was called determined, 1.52 … 1.79, where 4.4 fitted as well."""
    known = profile_intervals.KnownCosts(np.array([[0.5, 1.0]]), np.array([3.0]))
    free, at = np.array([[True, False]]), np.array([[9.0, 1.0]])
    starts = profile_intervals.starts_of(np.array([9.0, 0.0]), np.eye(2), known, free, at)
    np.testing.assert_array_equal(starts[:, 0], [[7.0, 1.0], [0.5, 1.0], [profile_intervals.INSIDE, 1.0]])
    assert len(profile_intervals.starts_of(np.array([6.0, 0.0]), np.eye(2), known, free, at)) == 2


def _missed(freedom: int, common: float = 0.0) -> Any:
    """What is asked of a fit of one length that misses its rows."""
    problem = SimpleNamespace(common=common, by_squares=True)
    return SimpleNamespace(
        explained=False, residuals=np.array([1.0, -9.0]), misfit=(25.0 * freedom, freedom), freedom=freedom,
        robust="squares", parameters=("length",), problem=problem,
    )  # fmt: skip


def test_a_misfit_says_by_which_errors_it_counts() -> None:
    """Beside "49.7 times their sigma" a row stood at +493.9 sigma: χ² holds an error that all rows may share, too, the
    table the row's own alone."""
    (alone,), (shared,) = (fit_remarks._about_misfit(_missed(2, common)) for common in (0.0, 0.025))
    assert "by 5.0 times their sigma (" in alone
    assert "worst in row 2 (-9.0 sigma)" in alone
    assert "by 5.0 times what sigma and an error of 2.5 % that the model may have in all rows let expect (" in shared
    assert "worst in row 2 (-9.0 of its own sigma alone)" in shared


def test_one_degree_of_freedom_is_one() -> None:
    """It was "of 1 degrees of freedom"."""
    for freedom, words in ((1, "of 1 degree of freedom"), (2, "of 2 degrees of freedom")):
        (sentence,) = fit_remarks._about_misfit(_missed(freedom))
        assert words in sentence


@pytest.mark.parametrize("count", [4, 6, 12])
def test_few_sets_of_good_rows_get_a_suspect(count: int) -> None:
    """Where sigma was estimated: of so many rows of two parameters with normal errors. Each row is left aside, and each
    of five more parameters is fitted by the better of two directions, as in two basins: two thirds of all had one."""
    rng, cried, sets = np.random.default_rng(count), 0, 300
    for _ in range(sets):
        own, errors = rng.standard_normal((count, 2)), rng.standard_normal(count)
        fit: Any = SimpleNamespace(sigma_estimated=True, freedom=count - 2, chi2=_left(own, errors))
        directions = rng.standard_normal((5, 2, count))
        rows = [_left(np.column_stack([own, one]), errors) for one in np.eye(count)]
        more = [min(_left(np.column_stack([own, one]), errors) for one in both) for both in directions]
        cried += any(suspects._gains(fit, chi2, suspects.ALONE) for chi2 in rows) or any(
            suspects._gains(fit, chi2, suspects.ADDED / len(more), suspects.SEARCHED) for chi2 in more
        )
    assert cried <= 0.05 * sets


def _left(columns: np.ndarray, errors: np.ndarray) -> float:
    """Sum of squares of errors that no combination of columns takes away."""
    return float(np.sum((errors - columns @ np.linalg.lstsq(columns, errors)[0]) ** 2))


@pytest.mark.slow
@pytest.mark.parametrize(("count", "seed"), [(4, 114), (6, 107)])
def test_good_rows_get_no_suspect(guess: trb.Scene, count: int, seed: int) -> None:
    """Of a healthy bearing that was stiffer, "perhaps", each."""
    rng, rows = np.random.default_rng(seed), []
    truth = guess.replace(spall=0, length=float(rng.uniform(2.0, 7.0)), width=float(rng.uniform(4.0, 11.0)))
    grid = [(radial, phase, k) for radial in (9000.0, 3000.0, 6000.0) for phase in (0.0, "mean", 0.1) for k in (0, 1)]
    for number in rng.permutation(len(grid))[:count]:
        radial, phase, k = grid[number]
        loss = float(trb.assess(truth.replace(load=trb.Load(radial, 4500.0), phase=phase)).loss[k])
        value = loss * (1.0 + 0.02 * rng.standard_normal()) + 0.005 * rng.standard_normal()
        rows += _rows((radial, ("radial_loss", "axial_loss")[k], value, 1.0), phase=phase)
    found = trb.fit(guess, [dataclasses.replace(row, sigma=None) for row in rows], starts=128)
    assert found.sigma_estimated
    assert found.doubts == ()


@pytest.mark.hard
@pytest.mark.parametrize(
    ("names", "known"),
    [
        (("length", "width"), "near this answer length × width^"),
        (("length", "width", "angle"), "only which of their values go together is known"),
    ],
)
def test_one_row_and_several_parameters_are_one_sentence(guess: trb.Scene, names: tuple[str, ...], known: str) -> None:
    """Each was said to be open, that no row checks the fit, how parameters are correlated (-0.5, all of them), and the
    angle's interval, of more than a turn, to be "< 3.562"."""
    found = trb.fit(guess, _rows((9000.0, "radial_loss", 2.8, 0.05)), names, starts=64, model_error=0.0)
    (sentence,) = found.remarks
    assert sentence.startswith(f"1 measured value cannot give {len(names)} parameters: {known}")
    assert sentence.endswith(f"measure at least {len(names)} more")  # one of them to check
    assert not found.determined_each.any()
    console = Console(width=200, file=io.StringIO())
    console.print(fit_report.fit_text(found, ()))
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert "correlation" not in shown
    assert "-0.00" not in shown
    if "angle" in names:
        assert found.interval_in_words(2) == "any"


def test_the_likeliest_answers_have_their_interval() -> None:
    """Of narrow answers that fit best, and of many wide ones."""
    assert fitting._among_likeliest(np.array([0.02, 0.9, 0.08])).tolist() == [False, True, True]
    assert fitting._among_likeliest(np.array([0.96, 0.04])).tolist() == [True, False]
    assert fitting._among_likeliest(np.array([1.0])).tolist() == [True]


@pytest.mark.exact
def test_an_answer_at_a_bound_weighs_as_much_as_one_inside(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coordinates are crowded there: such answers had hardly any weight, and others were called likelier."""
    monkeypatch.setattr(fit_result, "basin_spacings", lambda _: np.array([2.0]))
    points = np.array([[0.0], [-10.0]])
    share = least_squares.shares_of(points)
    normal = 1e4 * (share * (1.0 - share))[..., None] ** 2
    found: Any = SimpleNamespace(points=points, cost=np.array([3.0, 3.0]), normal=normal)
    none: Any = None
    np.testing.assert_allclose(fit_result.weights(none, found, [0, 1], 1.0), 0.5, rtol=1e-9)
    assert float(fit_result.curvature(none, found, 1)[0, 0]) == pytest.approx(1e4 + 4.0, rel=1e-9)
