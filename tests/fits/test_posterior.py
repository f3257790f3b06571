"""The posterior and the evidence against what they are: integrals, of which two dimensions can be summed."""

import dataclasses
import functools
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.fits import batched_misfit, fit_report
from difftrb.fits import posterior as posteriors
from difftrb.fits.fit_figure import corner
from difftrb.fits.nested_sampling import Sampled, sampled
from difftrb.fits.spall_count import count_spalls
from difftrb.report import figure_style

pytestmark = pytest.mark.usefixtures("compiled_as_for_users")  # what runs thousands of times

LIGHT, HEAVY = (3000.0, 4500.0), (9000.0, 4500.0)
ROWS = [
    (load, phase, quantity)
    for load, phase in ((HEAVY, "mean"), (HEAVY, 0.0), (LIGHT, 0.0))  # a mean takes five times as long
    for quantity in ("radial", "axial")
]
TRUTH = trb.Spall(4.0, 7.0)


def rows_of(rig: trb.Scene, spall: trb.Spall | None, sigma: float, seed: int) -> list[trb.Measurement]:
    """What a noisy measurement of this spall, or of none, reads."""
    rng, rows = np.random.default_rng(seed), []
    for load, phase, quantity in ROWS:
        at = dataclasses.replace(rig, spalls=(spall or TRUTH,), load=trb.Load(*load), phase=phase)
        loss = 0.0 if spall is None else float(trb.assess(at).loss[0 if quantity == "radial" else 1])
        read = loss + sigma * float(rng.standard_normal())
        rows.append(trb.Measurement(*load, f"{quantity}_loss", read, sigma, None, phase))  # type: ignore[arg-type]
    return rows


@pytest.fixture(scope="module")
def rig(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.prepare(trb.Scene(bearing, trb.Load(*HEAVY), (TRUTH,), "liu2018"))


@pytest.fixture(scope="module")
def fitted(rig: trb.Scene) -> trb.Fit:
    return trb.fit(rig, rows_of(rig, TRUTH, 0.08, 1), starts=64).check()


@pytest.fixture(scope="module")
def drawn(fitted: trb.Fit) -> trb.Posterior:
    return trb.posterior(fitted, live=100, draws=2000)


def test_evidence_and_points_of_a_normal_distribution() -> None:
    """Half of it lies outside of the cube on one side."""
    middle, spread = np.array([0.0, 0.5, 0.7]), np.array([0.02, 0.03, 0.01])
    told: list[tuple[int, int]] = []
    found = sampled(
        lambda points: np.sum(norm.logpdf(points, middle, spread), axis=1), 3, 1000, 0,
        progress=lambda done, of: told.append((done, of)),
    )  # fmt: skip
    assert found.log_evidence == pytest.approx(np.log(0.5), abs=2.0 * found.error)
    assert found.error < 0.1
    assert found.effective > 2500.0
    points = found.drawn(4000, 1)
    np.testing.assert_allclose(np.mean(points, axis=0), middle + spread * [np.sqrt(2.0 / np.pi), 0.0, 0.0], atol=2e-3)
    np.testing.assert_allclose(np.std(points, axis=0)[1:], spread[1:], rtol=0.1)
    assert told[-1][0] == told[-1][1]
    assert all(before[0] <= after[0] for before, after in itertools.pairwise(told))


def test_errors_of_evidence_are_what_it_says() -> None:
    """Forty times, of two curved ridges of different weight: the sum over a grid is exact to all digits."""

    def log_likelihood(points: np.ndarray) -> np.ndarray:
        x, y = points.T
        ridge = y - 0.5 - 2.0 * (x - 0.4) ** 2
        ridges = (np.log(share) - 0.5 * (x - at) ** 2 / 0.06**2 for share, at in ((0.8, 0.25), (0.2, 0.75)))
        return -0.5 * (ridge / 0.01) ** 2 + np.logaddexp(*ridges)

    side = (np.arange(1000) + 0.5) / 1000
    grid = np.stack([axis.ravel() for axis in np.meshgrid(side, side)], axis=1)
    density = np.exp(log_likelihood(grid))
    exact = float(np.log(np.mean(density)))
    right = float(np.sum(density[grid[:, 0] > 0.5]) / np.sum(density))
    every = [sampled(log_likelihood, 2, 200, seed) for seed in range(40)]
    off = np.array([(found.log_evidence - exact) / found.error for found in every])
    assert abs(np.mean(off)) < 0.6  # three standard errors
    assert 0.6 < np.std(off) < 1.7
    shares = [float(np.sum(found.shares[found.points[:, 0] > 0.5])) for found in every]
    assert np.mean(shares) == pytest.approx(right, abs=0.04)


def test_evidence_where_most_of_the_prior_is_level() -> None:
    """A spall between rollers changes nothing: there all points are alike."""
    peak = 1e3
    found = sampled(lambda points: np.where(points[:, 0] < 0.9, 0.0, np.log(peak)), 2, 1000, 0)
    assert found.log_evidence == pytest.approx(np.log(0.9 + 0.1 * peak), abs=0.1)
    assert np.sum(found.shares[found.points[:, 0] > 0.9]) == pytest.approx(0.1 * peak / (0.9 + 0.1 * peak), abs=0.01)


def test_narrow_answers_far_apart_are_all_found() -> None:
    """Three that a hundred-thousandth of the cube holds each, beside a wide one; all weigh the same."""
    middle = np.array([[0.2, 0.3, 0.7], [0.8, 0.6, 0.3], [0.4, 0.9, 0.1], [0.5, 0.5, 0.5]])
    spread = np.array([0.004, 0.006, 0.005, 0.1])

    def log_likelihood(points: np.ndarray) -> np.ndarray:
        far = np.sum((points[:, None] - middle[None]) ** 2, axis=-1) / spread[None] ** 2
        return np.logaddexp.reduce(-0.5 * far - 3.0 * np.log(np.sqrt(2.0 * np.pi) * spread)[None], axis=1) - np.log(4.0)

    shares = []
    for seed in range(6):
        found = sampled(log_likelihood, 3, 200, seed)
        assert abs(found.log_evidence) < 1.0
        nearest = np.argmin(np.linalg.norm(found.points[:, None] - middle[None], axis=-1) / spread[None], axis=1)
        shares.append(np.bincount(nearest, found.shares, 4))
    assert np.min(shares) > 0.02
    np.testing.assert_allclose(np.mean(shares, axis=0), 0.25, atol=0.12)


def test_points_that_miss_what_is_known_are_taken_again_and_then_refused(
    fitted: trb.Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def missing(likelihood: object, dimensions: int, live: int, *_: object) -> Sampled:
        asked.append(live)
        return Sampled(np.full((1, dimensions), 0.5), np.ones(1), 0.0, 0.1, -3.0, 1)

    monkeypatch.setattr(posteriors.nested_sampling, "sampled", missing)
    arguments = fitted.problem, 1.0, 50, 100, 0, 5.0, None
    assert posteriors.posterior_of(*arguments, known=1.0).effective == 1.0
    with pytest.raises(trb.MeasuredError, match=r"live = 50: too few points .* 6 above .*; give more than 200"):
        posteriors.posterior_of(*arguments, known=3.0)
    assert asked == [50, 50, 200]


@pytest.mark.slow
def test_it_is_the_integral_of_two_dimensions(fitted: trb.Fit, drawn: trb.Posterior) -> None:
    """Evidence, means and standard deviations against sums over a grid of the whole cube. There are two answers."""
    side = (np.arange(120) + 0.5) / 120
    points = np.stack([axis.ravel() for axis in np.meshgrid(side, side, indexing="ij")], axis=1)
    coordinates = np.log(points / (1.0 - points))
    told = batched_misfit.rows_at(fitted.problem, coordinates, many=True)
    density = np.exp(posteriors.log_density(fitted.problem, told))
    assert drawn.log_evidence == pytest.approx(np.log(np.mean(density)), abs=2.5 * drawn.error)
    values = np.asarray(fitted.problem.bounds.values(coordinates))
    mean = density @ values / np.sum(density)
    spread = np.sqrt(density @ (values - mean) ** 2 / np.sum(density))
    np.testing.assert_array_less(np.abs(np.mean(drawn.values, axis=0) - mean), 0.2 * spread)
    np.testing.assert_allclose(np.std(drawn.values, axis=0), spread, rtol=0.2)


@pytest.mark.slow
def test_it_weighs_the_answers_that_a_fit_names(fitted: trb.Fit, drawn: trb.Posterior) -> None:
    lengths = np.array([fitted["length"], *(other.values[0] for other in fitted.alternatives)])
    nearest = np.argmin(np.abs(np.log(drawn["length"][:, None] / lengths)), axis=1)
    named = np.array([other.weight for other in fitted.alternatives])
    shares = np.bincount(nearest, minlength=len(lengths)) / len(nearest)
    np.testing.assert_allclose(shares, [1.0 - np.sum(named), *named], atol=0.15)
    low, high = drawn.intervals()[0]
    likely = lengths[shares > 0.05]
    assert low < min(likely) < max(likely) < high
    assert drawn["length"].shape == (2000,)
    assert repr(drawn).splitlines()[1].startswith("  length ")
    with pytest.raises(trb.DifftrbError, match="confidence = 2"):
        drawn.intervals(2)


@pytest.mark.slow
def test_it_goes_on_to_xarray(drawn: trb.Posterior) -> None:
    pytest.importorskip("xarray")
    table = drawn.to_xarray()
    assert table.length.dims == ("chain", "draw")
    assert table.length.attrs["units"] == "mm"
    np.testing.assert_array_equal(table.width.values[0], drawn["width"])


@pytest.mark.slow
def test_what_cannot_be_sampled_gets_one_sentence(fitted: trb.Fit) -> None:
    for more, named in (
        ({"live": 3}, "live = 3: must be a whole number in 50"),
        ({"draws": 1}, "draws = 1"),
        ({"ranges": {"depth": (0.1, 0.2)}}, "'depth' is none of the parameters"),
        ({"ranges": {"length": (9.0, 3.0)}}, "length = 9 … 3: both ends"),
        ({"nuisances": ("speed",)}, "'speed' is not known"),
    ):
        with pytest.raises(trb.DifftrbError, match=named):
            trb.posterior(fitted, **more)


@pytest.mark.slow
def test_what_is_not_known_beside_the_size_makes_it_wider(fitted: trb.Fit, drawn: trb.Posterior) -> None:
    """A housing of unknown softness: longer spalls fit as well. What the prior says cannot be left."""
    wider = trb.posterior(fitted, ("scale",), {"scale": (0.8, 1.0)}, live=50, draws=500)
    assert wider.parameters == ("length", "width", "scale")
    longer, own = (np.std(each["length"][each["length"] > 3.0]) for each in (wider, drawn))
    assert longer > 1.5 * own
    assert wider["scale"].min() >= 0.8
    assert wider["scale"].max() <= 1.0


@pytest.mark.slow
def test_spalls_are_counted(rig: trb.Scene) -> None:
    """None of healthy rows, one of a spall's."""
    none = count_spalls(rig, rows_of(rig, None, 0.05, 2), (0, 1), ("length", "width"), live=50, draws=200)
    one = count_spalls(rig, rows_of(rig, TRUTH, 0.05, 3), (0, 1), ("length", "width"), live=50, draws=200)
    assert (none.likeliest, one.likeliest) == (0, 1)
    assert none.shares[0] > 0.6  # a spall too small to be told is one, too
    assert one.shares[1] > 0.999
    assert none.posteriors[0] is None
    assert repr(one).splitlines()[0] == "SpallCount, likeliest 1"
    for more, named in (
        ({"counts": (0, 3)}, "must be some of 0 … 2"),
        ({"counts": (2,), "parameters": ("length",)}, "angle is missing"),
        ({"parameters": ("scale",)}, "'scale': to count spalls"),
    ):
        with pytest.raises(trb.DifftrbError, match=named):
            count_spalls(rig, rows_of(rig, TRUTH, 0.05, 3), **more)


def test_the_figure_shows_every_pair(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal([4.0, 7.0], [0.1, 0.2], (2000, 2))
    ranges = np.array([[0.1, 14.0], [0.1, 180.0]])
    made = trb.Posterior(("length", "width"), ("mm", "mm"), values, ranges, 1.0, 0.1, 9.0, 9, 1.0)
    ax = corner(made, {"length": 4.0, "width": 7.0})
    panels = [each for each in ax.figure.axes if each.axison]
    assert len(panels) == 3
    figure_style.save(ax, tmp_path, "corner")
    assert (tmp_path / "corner.png").exists()


@pytest.mark.slow
def test_the_command_samples_and_counts(
    tmp_path: Path, rig: trb.Scene, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_report, "posterior", functools.partial(trb.posterior, live=50))
    scene, table = tmp_path / "s.toml", tmp_path / "m.csv"
    scene.write_text(
        'bearing = "32008J"\nload = { radial = 9000, axial = 4500 }\ncontact.law = "liu2018"\n'
        "[[spall]]\nlength = 3\nwidth = 7\n"
    )
    rows = rows_of(rig, TRUTH, 0.08, 1)
    lines = [f"{r.radial},{r.axial},{r.phase},{r.quantity},{r.value},{r.sigma}" for r in rows]
    table.write_text("\n".join(["radial,axial,phase,quantity,value,sigma", *lines]))
    out = tmp_path / "out"
    asked = ["fit", str(scene), str(table), "--parameters", "length", "--posterior", "--spalls", "0"]
    assert cli.main([*asked, "--json", "--out", str(out)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["posterior"]["parameters"]["length"]["prior"][0] > 0.0
    assert [(each["spalls"], each["posterior"]) for each in told["spalls"]] == [(0, None)]
    assert (out / "posterior.png").exists()
    assert cli.main([*asked[:3], "--spalls", "one"]) == 2
    assert "--spalls one: give numbers of spalls" in capsys.readouterr().err
