"""A new fit parameter is one class under `@register`: nothing else in the package knows its name."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest

import difftrb as trb
from difftrb import __main__ as cli
from difftrb.core.geometry import Real
from difftrb.fits import fit_record, parameters
from difftrb.fits.measured import MeasuredError
from difftrb.scene import scene_file

LOADS = ((9000.0, 4500.0), (3000.0, 4500.0), (6000.0, 3000.0))
TRUTH = {"length": 5.0, "axial_factor": 1.2}


class AxialFactor(parameters.Parameter):
    """Of every axial load that was measured, by a gauge that reads wrong: 0.8 … 1.5."""

    name, unit, label = "axial_factor", "N/N", "factor on the axial load"
    low, high, default = 0.8, 1.5, 1.0
    no_effect = "nothing depends on the axial load here: leave axial_factor out"

    def load(self, load: trb.Load, value: Real) -> trb.Load:
        return trb.Load(load.radial, value * load.axial)


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    parameters.register(AxialFactor)
    yield
    del parameters.PARAMETERS[AxialFactor.name]


@pytest.fixture(scope="module")
def rig(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.prepare(trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "liu2018"))


@pytest.fixture(scope="module")
def rows(rig: trb.Scene) -> list[trb.Measurement]:
    """Stiffness and loss by the same law, under more axial load than the rows say."""
    there = dataclasses.replace(rig, spalls=(trb.Spall(TRUTH["length"], 7.0),))
    found = []
    for radial, axial in LOADS:
        load = trb.Load(radial, TRUTH["axial_factor"] * axial)
        told = trb.assess(dataclasses.replace(there, load=load))
        stiff = told.spalled.axial_stiffness
        for quantity, value in (("axial_loss", told.loss[1]), ("axial_stiffness", stiff)):
            found.append(trb.Measurement(radial, axial, quantity, float(value), 1e-3 * float(value)))  # type: ignore[arg-type]
    return found


@pytest.mark.slow
def test_it_is_found(rig: trb.Scene, rows: list[trb.Measurement]) -> None:
    fit = trb.fit(rig, rows, tuple(TRUTH), starts=64, model_error=0.0).check()
    assert fit["length"] == pytest.approx(TRUTH["length"], rel=1e-6)
    assert fit["axial_factor"] == pytest.approx(TRUTH["axial_factor"], rel=1e-6)
    assert fit.determined
    assert fit_record.fit_json(fit, (), 0.0)["parameters"]["axial_factor"]["unit"] == "N/N"
    assert fit.labels == ("length", "factor on the axial load")


def test_the_command_line_fits_it(
    rows: list[trb.Measurement], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, table = tmp_path / "s.toml", tmp_path / "m.csv"
    text = scene_file.example("spall")
    scene.write_text(f'{text}\n[contact]\nlaw = "liu2018"\n', encoding="utf-8")
    lines = [f"{row.radial},{row.axial},{row.quantity},{row.value},{row.sigma}" for row in rows]
    table.write_text("\n".join(["radial,axial,quantity,value,sigma", *lines]), encoding="utf-8")
    asked = ["--no-cache", "fit", str(scene), str(table), "--parameters", "length,axial_factor"]
    assert cli.main(asked) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.strip().startswith("axial_factor "))
    assert "1.2 " in line
    assert line.split()[-2:] == ["N/N", "yes"]
    assert cli.main([*asked[:-1], "axial"]) == 2
    assert "'axial' is not known" in capsys.readouterr().err


BAD = {
    "default outside": ({"default": 3.0}, "default = 3: must be in 0.8 … 1.5 N/N"),
    "range upside down": ({"high": 0.5}, "low = 0.8, high = 0.5: give a range above 0"),
    "size below zero": ({"low": -1.0}, "low = -1, high = 1.5: give a range above 0"),
    "name taken": ({"name": "length"}, "parameter length: there is one of this name"),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_declarations_get_one_sentence(name: str) -> None:
    changed, sentence = BAD[name]
    with pytest.raises(MeasuredError, match=r"^parameter ") as caught:
        parameters.register(type("Wrong", (AxialFactor,), {"name": "wrong"} | changed))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert set(parameters.PARAMETERS) == {
        "length", "width", "depth", "angle", "axial_offset", "crown", "preload", "scale", "reference",
        "load_factor",
        "axial_factor", "length_2", "width_2", "angle_2",
    }  # fmt: skip


def test_a_range_that_scene_and_rows_leave_empty_is_refused(rig: trb.Scene, rows: list[trb.Measurement]) -> None:
    @parameters.register
    class Nowhere(AxialFactor):
        name = "nowhere"
        no_effect = "these rows leave it no range: leave nowhere out"

        def limits(self, scene: trb.Scene, rows: object) -> tuple[float, float]:
            return 1.0, 1.0

    try:
        with pytest.raises(MeasuredError, match="nowhere cannot be fitted: these rows leave it no range"):
            trb.fit(rig, rows, ("length", "nowhere"))
    finally:
        del parameters.PARAMETERS["nowhere"]
