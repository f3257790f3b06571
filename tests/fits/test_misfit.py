"""What does not fit is not determined: with no row to spare, and beside rows that count for little."""

import numpy as np
import pytest

import difftrb as trb
from difftrb.fits.measured import MeasuredError, Measurement


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
