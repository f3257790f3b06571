"""What else a fit can ask for than length and width: found where the data tell it, named where they do not."""

import dataclasses
import functools
import operator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.fits import parameters, predicted
from difftrb.fits.conditions import Conditions, conditions
from difftrb.fits.fitting import fit
from difftrb.fits.measured import MeasuredError, Measurement
from difftrb.law import load_curve
from difftrb.law.roller_curves import RollerCurves, spalls_under

pytestmark = pytest.mark.usefixtures("compiled_as_for_users")  # what runs thousands of times

LOADS = ((9000.0, 4500.0), (3000.0, 4500.0), (6000.0, 3000.0))
FEW = 128
"""Points that are scanned in place of 8192."""
LEAST = 24
"""The same where any answer will do, for none is determined."""
QUANTITIES = ("radial_stiffness", "axial_stiffness", "radial_loss", "axial_loss")


@partial(jax.tree_util.register_dataclass, data_fields=["contact"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Formula:
    """A law in closed form that depends on everything, each in its own way: what a fit could find, it can find here."""

    contact: trb.LineContact
    name = "formula"
    hard = False
    load_range = (1.0, 1e5)
    error = 0.0
    status_code = float(status.CONVERGED)

    def at(self, contact: trb.LineContact) -> "Formula":
        return Formula(contact)

    def curves(self, spalls: tuple[trb.Spall, ...], distances: jax.Array) -> RollerCurves:
        crown = xp.log(self.contact.design_load / 6500.0)
        each = [load_curve.power(9.4e5 * xp.exp(-0.1 * crown), 1.2 + 0.02 * crown)]
        for spall in spalls:
            land = 1.0 - spall.length / self.contact.length
            over = load_curve.power(9.4e5 * xp.exp(-0.1 * crown) * land, 1.2 + 0.02 * crown + 0.2 * spall.depth)
            each.append(dataclasses.replace(over, shift=xp.asarray(2e-4 * (3.0 + spall.axial_offset))))
        return RollerCurves(load_curve.chosen(load_curve.joined(*each), spalls_under(spalls, distances)))

    def judge(self, spalls: tuple[trb.Spall, ...], distances: jax.Array, rest: object = None) -> jax.Array:
        known = [(s.length < 0.8 * self.contact.length) & (abs(s.axial_offset) < 3.0) & (s.depth < 0.5) for s in spalls]
        return xp.where(functools.reduce(operator.and_, known, np.asarray(True)), status.CONVERGED, status.OTHER_SCENE)

    def ramp(self, number: int, spall: trb.Spall, approach: jax.Array) -> tuple[jax.Array, jax.Array]:
        return xp.zeros_like(approach), xp.zeros_like(approach)


def rows(phase: float | str) -> list[Measurement]:
    """Three loads, stiffness and loss in both directions, each to 1e-4 of itself."""
    return [
        Measurement(radial, axial, quantity, 1.0, 1e-4, None, phase)
        for radial, axial in LOADS
        for quantity in QUANTITIES
    ]


def rough(phase: float | str) -> list[Measurement]:
    """Losses to 5 %, and of stiffness itself next to nothing."""
    return [dataclasses.replace(row, sigma=0.05 if row.is_loss else 1e3) for row in rows(phase)]


@partial(jax.jit, static_argnames="names")
def _predicted(scene: trb.Scene, at: Conditions, names: tuple[str, ...], values: jax.Array) -> jax.Array:
    return predicted.predicted(parameters.named(names), scene, at, values)[0]


def measured(scene: trb.Scene, blank: list[Measurement], truth: dict[str, float]) -> list[Measurement]:
    """What the rows are for the truth; sigma, so far relative, in their units."""
    ready, values = trb.prepare(scene), jnp.array(list(truth.values()))
    true = _predicted(ready, conditions(ready, blank), tuple(truth), values)
    return [
        dataclasses.replace(row, value=float(v), sigma=row.sigma * float(v)) for row, v in zip(blank, true, strict=True)
    ]


@pytest.fixture(scope="module")
def liu(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 9.0, angle=0.3),), "liu2018")


@pytest.fixture(scope="module")
def formula(bearing: trb.TaperedBearing) -> trb.Scene:
    law = Formula(trb.LineContact.of(bearing, "outer", 6500.0))
    spall = trb.Spall(4.0, 7.0, depth=0.2, axial_offset=0.5)
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (spall,), law)


TURNED = {"length": 5.0, "angle": 0.6, "preload": 400.0, "scale": 0.8}
SHAPED = {"length": 5.0, "depth": 0.1, "axial_offset": -1.0, "crown": 9000.0}


@pytest.mark.slow
def test_place_preload_and_scale_are_found(liu: trb.Scene) -> None:
    found = fit(liu, measured(liu, rows("mean"), TURNED), tuple(TURNED), starts=FEW, model_error=0.0).check()
    mirrored = np.abs(found.values)  # the load line is a line of symmetry
    np.testing.assert_allclose(mirrored, list(TURNED.values()), rtol=1e-6)
    (rival,) = (remark for remark in found.remarks if "another answer" in remark)
    assert not found.determined
    assert "angle" in rival
    assert "measure the" in rival  # means are as symmetric as the load; at one phase rollers stand unevenly about it


@pytest.mark.slow
def test_losses_alone_do_not_tell_the_scale(liu: trb.Scene) -> None:
    found = fit(liu, measured(liu, rough("mean"), TURNED), tuple(TURNED), starts=LEAST, model_error=0.0)
    assert not found.determined
    assert any("scale is not" in remark and "measure the" in remark for remark in found.remarks)


@pytest.mark.slow
def test_depth_axial_offset_and_crown_are_found(formula: trb.Scene) -> None:
    found = fit(formula, measured(formula, rows(0.0), SHAPED), tuple(SHAPED), starts=FEW, model_error=0.0).check()
    np.testing.assert_allclose(found.values, list(SHAPED.values()), rtol=1e-6)
    assert found.problem.bounds.high[2] == pytest.approx(3.0, rel=1e-6)  # where the law ends
    assert found.determined


@pytest.mark.slow
def test_losses_alone_do_not_tell_the_shape(formula: trb.Scene) -> None:
    found = fit(formula, measured(formula, rough(0.0), SHAPED), tuple(SHAPED), starts=LEAST, model_error=0.0)
    assert not found.determined
    for name in ("axial_offset", "crown"):
        assert any(f"{name} is not" in remark.lower() for remark in found.remarks), name


@pytest.mark.parametrize("name", ["depth", "axial_offset", "crown"])
def test_a_frozen_law_does_not_know(liu: trb.Scene, name: str) -> None:
    with pytest.raises(MeasuredError, match=f"{name} cannot be fitted"):
        fit(liu, rows("mean"), ("length", name))


@pytest.mark.parametrize("width", [2.0, 3.0])
def test_spalls_on_the_other_raceway_do_not_narrow_a_range(bearing: trb.TaperedBearing, width: float) -> None:
    """One on the inner raceway was judged as if on the outer one: narrow, it left 0.0027 … 0.27 mm of length."""
    inner = trb.Spall(3.0, width, angle=-0.8, surface="inner")
    upright = (trb.effects.Raceways(rollers="upright"),)
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(3.0, 4.0), inner), "table", effects=upright)
    length, second = (parameters.PARAMETERS[name].limits(trb.prepare(scene), ()) for name in ("length", "length_2"))
    assert length == pytest.approx((0.0085 * bearing.roller_length, 0.85 * bearing.roller_length), rel=1e-3)
    assert second == pytest.approx(length, rel=1e-3)


@pytest.mark.parametrize("design_load", [3000.0, 6500.0])
def test_a_crown_may_be_larger_than_the_scenes(bearing: trb.TaperedBearing, design_load: float) -> None:
    """Its limit was the scene's own, for the longest spall that the law takes is a hair longer with it."""
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), trb.Spall(4.0, 7.0), law="table", design_load=design_load)
    low, high = parameters.PARAMETERS["crown"].limits(trb.prepare(scene), ())
    assert (low, high) == pytest.approx((0.25 * design_load, 4.0 * design_load), rel=1e-6)


def test_values_are_told_with_their_units() -> None:
    """A dash for "no unit" is for tables."""
    assert parameters.PARAMETERS["scale"].in_words(0.5) == "scale 0.5"
    assert parameters.PARAMETERS["length"].in_words(4.12345, 4) == "length 4.123 mm"


def test_the_docstring_of_fit_names_all_parameters() -> None:
    """As the command line's help does (`test_command_line`)."""
    assert [name for name in parameters.PARAMETERS if f'"{name}"' not in (fit.__doc__ or "")] == []
