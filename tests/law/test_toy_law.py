"""A law of one's own takes one module: here a linear one, registered by this file alone."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import __main__ as command_line
from difftrb.core import arrays as xp
from difftrb.core import status
from difftrb.core.geometry import Real
from difftrb.law import base, load_curve
from difftrb.scene import scene_file

pytestmark = pytest.mark.exact


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Spring(base.HardWindow):
    """Q = K δ on the land that a spall leaves. `stiffness` is of a healthy roller [N/mm], `length` its own [mm]."""

    stiffness: Real
    length: Real
    name = "toy"
    load_range = (0.0, 1000.0)
    error = 0.0
    status_code = float(status.CONVERGED)

    def at(self, contact: trb.LineContact) -> "Spring":
        return self

    def curves(self, spalls, distances):
        K = self.stiffness * (1.0 - base.lengths_of(spalls) / self.length)
        return base.in_window(load_curve.power(K, xp.ones_like(K)), spalls, distances)

    def judge(self, spalls, distances, rest=None):
        return status.worst(
            base.known_up_to(0.5 * self.length, spalls), base.of_one_deep_spall(spalls, distances, rest)
        )


TOY = base.LawKind(
    "toy",
    "a spring as long as the land",
    make=lambda of: Spring(3e5, of.contact.length),
    longest=lambda roller_length: 0.5 * roller_length,
)


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    base.register(TOY)
    yield
    del base.LAWS["toy"]


@pytest.fixture
def toy(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="toy")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(scene_file.example("healthy") + '[contact]\nlaw = "toy"\n[[spall]]\nlength = 4.0\nwidth = 7.0\n')
    return path


def test_it_is_solved_and_differentiated(toy: trb.Scene) -> None:
    """Springs: the loads are as on half as stiff ones, and stiffness is twice that."""
    r = trb.solve(toy).check()
    assert r.law.name == "toy"
    ready = trb.prepare(toy)
    softer = dataclasses.replace(ready, law=dataclasses.replace(ready.law, stiffness=1.5e5))  # type: ignore[type-var]
    twice = trb.solve(softer)
    np.testing.assert_allclose(twice.loads, r.loads, rtol=1e-9)
    np.testing.assert_allclose(twice.stiffness, 0.5 * r.stiffness, rtol=1e-9, atol=1e-3)

    def stiffness(length: Real) -> jax.Array:
        return trb.solve(dataclasses.replace(toy, spalls=(trb.Spall(length, 7.0),))).stiffness[0, 0]

    by_length = jax.grad(stiffness)(4.0)
    assert float(by_length) < 0.0
    assert float(by_length) == pytest.approx(float(stiffness(4.001) - stiffness(3.999)) / 0.002, rel=1e-5)


def test_files_commands_and_reports_know_it(file: Path, toy: trb.Scene, capsys: pytest.CaptureFixture) -> None:
    assert trb.load_scene(file).law == toy.law
    assert command_line.main(["run", str(file), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["stiffness"]["radial"] == pytest.approx(float(trb.solve(toy).stiffness[0, 0]), rel=1e-9)
    assert any("law 'toy' was made for 0 … 1,000 N" in remark for remark in record["remarks"])


def test_what_it_does_not_know_is_refused_in_one_sentence(toy: trb.Scene, bearing: trb.TaperedBearing) -> None:
    longer = dataclasses.replace(toy, spalls=(trb.Spall(7.0, 7.0),))
    with pytest.raises(trb.SceneError, match=r"spall.0.length = 7: contact.law = 'toy' knows 0 … 6.83 mm"):
        trb.solve(longer)
    prepared = trb.prepare(toy)
    assert "longer than the roller law knows" in trb.solve(dataclasses.replace(prepared, spalls=longer.spalls)).status
    with pytest.raises(trb.SceneError, match="'toy' does not know the inner raceway alone"):
        trb.solve(dataclasses.replace(toy, effects=trb.effects.Raceways()))
    with pytest.raises(trb.SweepError, match="'toy' does not know the depth of a spall"):
        trb.sweep(["radial_stiffness"], toy, {"spall.0.depth": [0.1, 0.2]})


def test_a_name_is_given_once_and_unknown_ones_are_listed() -> None:
    with pytest.raises(ValueError, match="law 'toy' is there already"):
        base.register(TOY)
    assert base.unknown("tow").endswith("use one of direct, liu2018, palmgren, power, table, toy, auto")


def test_formulas_over_jax_alone_are_told_of(toy: trb.Scene) -> None:
    """Numbers go through them; derivatives do not, and one sentence says so."""

    class Stiffer(Spring):
        def curves(self, spalls, distances):
            soft = jnp.log(self.stiffness) if not spalls else jnp.log(self.stiffness - spalls[0].length)
            return base.in_window(load_curve.power(jnp.exp(soft), 1.0), (), distances[:0])

    ready = dataclasses.replace(trb.prepare(toy), law=Stiffer(3e5, 13.66))
    with pytest.raises(trb.SceneError, match=r"law 'toy': formulas over jax.numpy or numpy take no derivatives along"):
        trb.assess(ready)
