"""A new output is one file: it declares itself, and sweeps, sweep files, results and figures know it."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.scene import scene_file
from difftrb.sweeps import chunk_sharing, outputs, sweep_file, sweep_plot
from difftrb.sweeps.outputs import Output

TOYS = (
    Output("loaded_rollers", "rollers", "rollers that carry", lambda s: jnp.sum(s.loads > 0.0)),
    Output("load_parts", "kN", "shares of the load", lambda s: 1e-3 * s.loads, ("roller",)),
    Output("load_gain", "%", "gain of the peak load", lambda s, healthy: 100.0 * (jnp.max(s.loads) / jnp.max(
        healthy.loads) - 1.0), against_healthy=True),
    Output("crookedness", "", "crookedness", lambda s: s.loads),
    Output("flatness", "mm/MPa", "flatness", lambda s: s.contact_width / s.peak_pressure, source="contact"),
)  # fmt: skip
NAMES = ["loaded_rollers", "load_parts", "load_gain"]
FILE = f"""{scene_file.example("spall")}
[contact]
law = "liu2018"
[sweep]
outputs = ["peak_load", "loaded_rollers", "load_parts", "load_gain"]
load.axial = [4000, 5000]
"""


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The toys are outputs during a test."""
    monkeypatch.setattr(outputs, "OUTPUTS", dict(outputs.OUTPUTS))
    for toy in TOYS:
        outputs.register(toy)


@pytest.fixture(scope="module")
def scene() -> trb.Scene:
    return trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), trb.liu2018())


def test_a_sweep_knows_it(scene: trb.Scene) -> None:
    swept = trb.sweep([*NAMES, "peak_load"], scene, {"load.axial": [4000.0, 5000.0]}, ["load.axial"])
    assert [swept.units[name] for name in NAMES] == ["rollers", "kN", "%"]
    assert swept.units["load_parts_by_load.axial"] == "kN per N"
    assert swept.own_dims["load_parts"] == ("roller",)
    loads = 1e3 * swept.values["load_parts"]
    np.testing.assert_allclose(loads.max(1), swept.values["peak_load"], rtol=1e-12)
    np.testing.assert_array_equal((loads > 0.0).sum(1), swept.values["loaded_rollers"])
    assert sweep_plot.swept(swept, "load_gain").get_ylabel() == "gain of the peak load [%]"


def test_a_sweep_file_knows_it(tmp_path: Path) -> None:
    plan = sweep_file.parse(FILE).plan()
    assert chunk_sharing.run(plan, tmp_path / "out").failed == 0
    swept = trb.load_sweep(tmp_path / "out")
    assert set(swept.values) == {"peak_load", *NAMES}
    assert swept.units["loaded_rollers"] == "rollers"
    xarray = pytest.importorskip("xarray")
    parts = xarray.open_zarr(tmp_path / "out" / "sweep.zarr", consolidated=False)["load_parts"]
    assert parts.attrs == {"units": "kN", "long_name": "shares of the load"}
    assert parts.dims == ("load_axial", "roller")


def test_an_output_of_a_contact_is_one_of_a_sweep_file() -> None:
    text = scene_file.example("contact") + '[sweep]\noutputs = ["flatness"]\ncontact.offset = [0.0]\n'
    assert sweep_file.parse(text).plan().units["flatness"] == "mm/MPa"


def test_what_is_not_registered_is_refused(scene: trb.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    words = "outputs: 'noise' is unknown; use some of radial_stiffness, .*, loaded_rollers, load_parts, load_gain"
    with pytest.raises(trb.SweepError, match=words):
        trb.sweep("noise", scene, {"load.axial": [4000.0]})
    with pytest.raises(scene_file.SceneError, match=words):
        sweep_file.parse(FILE.replace("peak_load", "noise"))
    monkeypatch.delitem(outputs.OUTPUTS, "load_gain")
    with pytest.raises(trb.SweepError, match="outputs: 'load_gain' is unknown"):
        trb.sweep("load_gain", scene, {"load.axial": [4000.0]})


@pytest.mark.parametrize("name", ["peak_load", "approach", "a b", "loaded_rollers"])
def test_a_name_that_is_taken_or_cannot_be_one_is_refused(name: str) -> None:
    with pytest.raises(trb.SweepError, match=f"'{name}': is the name of an output already, or cannot be one"):
        outputs.register(Output(name, "", "", lambda s: s.residual))


def test_an_output_has_the_dimensions_that_it_declares(scene: trb.Scene) -> None:
    words = r"outputs: crookedness has shape \(23,\), but declares as its dimensions: none"
    with pytest.raises(trb.SweepError, match=words):
        trb.sweep("crookedness", scene, {"load.axial": [4000.0]})
