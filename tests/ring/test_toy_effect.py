"""An effect of somebody else: one class in one file, registered at run time, acts wherever the package's own do."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from annotated_types import Interval, Unit

import difftrb as trb
from difftrb.__main__ import main
from difftrb.core import arrays as xp
from difftrb.core.geometry import Real
from difftrb.ring import effect_base as register_of
from difftrb.ring import effects
from difftrb.ring.ring import Equilibrium
from difftrb.scene import scene_file

LIU = trb.liu2018()
FILE = """bearing = "32008J"
[load]
radial = 9000.0
axial = 4500.0
[[spall]]
length = 4.0
width = 7.0
[contact]
law = "liu2018"
[effects]
toy = { amount = %s }
"""


@dataclasses.dataclass(frozen=True)
class Toy(effects.Effect):
    """All rollers too thick by one amount.

    Attributes:
      amount: of the normal approach [mm], −0.1…0.1.
    """

    key = "toy"
    label = "rollers too thick"
    presses = True
    excludes = {"diameters": "rollers have one diameter"}  # noqa: RUF012
    units = {"squeeze": "µm"}  # noqa: RUF012

    amount: Annotated[Real, Interval(ge=-0.1, le=0.1), Unit("mm")]

    def terms(self, terms: effects.Terms, of: effects.Ring) -> effects.Terms:
        """Thicker rollers."""
        return terms.thicker(xp.asarray(self.amount))

    def results(self, rest: Equilibrium, terms: effects.Terms, of: effects.Ring) -> effects.Results:
        """`squeeze` [µm]."""
        return {"squeeze": 1e3 * xp.asarray(self.amount)}


@pytest.fixture(autouse=True, scope="module")
def _registered() -> Iterator[None]:
    """For these tests alone."""
    effects.register(Toy)
    yield
    del register_of._REGISTER["toy"]


def scene(*acting: effects.Effect) -> trb.Scene:
    return trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), LIU, effects=acting)


def test_a_mean_over_one_pitch_of_rollers_that_differ_is_said() -> None:
    thicker = (effects.Diameters((2e-3,) + (0.0,) * 22),)
    assert effects.remarks(thicker, ()) == ()
    (remark,) = effects.remarks(thicker, (), mean=True)
    assert "`difftrb stiffness`" in remark
    assert effects.remarks((Toy(2e-3),), (), mean=True) == ()


def test_it_is_solved_as_equal_diameters_are() -> None:
    alike = trb.solve(scene(effects.Diameters((2e-3,) * 23))).check()
    toy = trb.solve(scene(effects.Life(), Toy(2e-3))).check()
    np.testing.assert_allclose(toy.loads, alike.loads, rtol=1e-12)
    assert float(toy.effects["squeeze"]) == 2.0
    assert "basic_life" in toy.effects


def test_it_is_differentiated() -> None:
    def axial(amount: Real) -> jax.Array:
        return trb.solve(scene(Toy(amount))).displacement[2]

    # all rollers thicker by one amount moves the ring along its axis, by amount / sinα
    slope = jax.grad(axial)(1e-3)
    assert float(slope) == pytest.approx(-1.0 / float(jnp.sin(trb.bearing("32008J").outer_angle)), rel=1e-9)


def test_files_and_reports_know_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "toy.toml"
    path.write_text(FILE % "0.002", encoding="utf-8")
    assert trb.load_scene(path).effects == (Toy(0.002),)
    assert getattr(effects, "Toy") is Toy  # noqa: B009
    assert main(["--no-cache", "run", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["effects"] == {"squeeze": 2.0}
    assert main(["--no-cache", "run", str(path)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "beyond the plain ring: rollers too thick" in told
    assert "squeeze: 2 µm" in told


@pytest.mark.parametrize("amount", [0.5, "x"])
def test_it_is_refused_out_of_range_in_one_sentence(amount: float | str) -> None:
    words = re.escape(f"effects.toy.amount = {amount!r}: must be a number in -0.1 … 0.1 mm")
    with pytest.raises(trb.SceneError, match=words):
        scene_file.parse(FILE % repr(amount))
    with pytest.raises(trb.SceneError, match=words):
        trb.solve(scene(Toy(amount)))  # type: ignore[arg-type]
    with pytest.raises(trb.SceneError, match=r"toy and effects\.diameters exclude each other: rollers have one"):
        scene(Toy(0.0), effects.Diameters((0.0,) * 23))


def test_what_is_half_declared_is_not_registered() -> None:
    with pytest.raises(ValueError, match=r"Nameless.key = None: must be a plain name"):
        effects.register(dataclasses.dataclass(frozen=True)(type("Nameless", (effects.Effect,), {})))
    same = {"key": "life", "label": "another"}
    with pytest.raises(ValueError, match=r"Other.key = 'life' is that of Life"):
        effects.register(dataclasses.dataclass(frozen=True)(type("Other", (effects.Effect,), same)))
    free = {"key": "free", "label": "no range", "__annotations__": {"amount": float}}
    with pytest.raises(ValueError, match=r"Free.amount has no range"):
        effects.register(dataclasses.dataclass(frozen=True)(type("Free", (effects.Effect,), free)))
    unknown = dataclasses.dataclass(frozen=True)(type("Unknown", (effects.Effect,), {"key": "unknown"}))
    with pytest.raises(trb.SceneError, match=r"effects.0 = .* is not known; register its class"):
        scene(unknown())
