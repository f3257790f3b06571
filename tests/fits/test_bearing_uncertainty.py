"""What an estimated bearing leaves of fitted sizes, against fits with other bearings of the same catalogue line."""

import dataclasses
import io

import numpy as np
import pytest
from rich.console import Console

import difftrb as trb
from difftrb.fits import bearing_uncertainty, fit_report

LOADS = ((4000.0, 2000.0), (8000.0, 4000.0))


@pytest.fixture(scope="module")
def made() -> trb.CatalogueBearing:
    return trb.bearing_from_catalogue(d=30.0, D=62.0, T=17.25, e=0.37, rollers=17, roller_diameter=7.8)


def rows(bearing: trb.TaperedBearing, design_load: float) -> tuple[trb.Measurement, ...]:
    """What another bearing reads of a spall of 3 × 5 mm under LOADS, with an error of 1 %."""
    found = []
    for load in LOADS:
        scene = trb.Scene(bearing, trb.Load(*load), trb.Spall(3.0, 5.0), design_load=design_load)
        for quantity, value in zip(("radial_loss", "axial_loss"), trb.assess(scene).loss, strict=True):
            found.append(trb.Measurement(*load, quantity, float(value), 0.01 * float(value), phase=0.0))
    return tuple(found)


@pytest.mark.gradient
def test_values_move_as_a_fit_to_other_rows_does(made: trb.CatalogueBearing) -> None:
    """Rows of a bearing with a lower crown load, fitted as if they were the estimated bearing's: off by what the values
    would move if that bearing were assumed."""
    scene = trb.Scene(made.bearing, trb.Load(*LOADS[0]), trb.Spall(3.0, 5.0), law="table", design_load=made.design_load)
    own = trb.fit(scene, rows(made.bearing, made.design_load), ["length"])
    other = made.design_load - 0.25 * made.estimates["design_load"].uncertainty
    refitted = trb.fit(scene, rows(made.bearing, other), ["length"])
    moved = bearing_uncertainty.moves(own)(made.bearing, other)
    assert abs(moved[0]) > 0.003
    np.testing.assert_allclose(refitted.values - own.values, -moved, rtol=0.1)


def test_all_that_is_not_known_is_told(made: trb.CatalogueBearing) -> None:
    scene = trb.Scene(made.bearing, trb.Load(*LOADS[0]), trb.Spall(3.0, 5.0), law="table", design_load=made.design_load)
    own = trb.fit(scene, rows(made.bearing, made.design_load), ["length"])
    about = made.uncertainty(bearing_uncertainty.moves(own))
    crown = made.estimates["design_load"].uncertainty
    low, high = (bearing_uncertainty.moves(own)(made.bearing, made.design_load + k * crown) for k in (-0.5, 0.5))
    assert abs(high - low)[0] / 2.0 < about[0] < 1.0
    assert "is not known" in bearing_uncertainty.sentence(own, np.full(1, np.nan))
    assert bearing_uncertainty.sentence(own, about).endswith(f"leaves length ± {about[0]:.2g} mm (k = 2)")
    assert "so that nothing is known of length: measure losses" in bearing_uncertainty.sentence(own, np.full(1, 14.0))


def test_stiffnesses_are_told_in_full(made: trb.CatalogueBearing) -> None:
    """Also where there is little room: digits of a number that is cut are wrong."""
    scene = trb.Scene(made.bearing, trb.Load(*LOADS[0]), trb.Spall(3.0, 5.0), law="table", design_load=made.design_load)
    own = trb.fit(scene, rows(made.bearing, made.design_load), ["length"])
    row = dataclasses.replace(own.rows[0], quantity="radial_stiffness", value=2600670.4)
    told = dataclasses.replace(own, rows=(row, *own.rows[1:]), predicted=np.array([2594747.2, *own.predicted[1:]]))
    console = Console(width=80, file=io.StringIO())
    console.print(fit_report.fit_text(told, ()))
    assert "2,600,670   2,594,747" in console.file.getvalue()  # type: ignore[attr-defined]
