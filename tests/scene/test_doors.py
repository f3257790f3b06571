"""Scenes made in Python: what a file would refuse is refused here, in the same sentence, or is right."""

import dataclasses
import math
import re
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.fits import measured_table
from difftrb.law import direct_curves
from difftrb.ring import effects
from difftrb.scene import checks, scene_file

BEARING = trb.bearing("32008J")
LOAD = trb.Load(9000.0, 4500.0)
SPALL = trb.Spall(4.0, 7.0)
LIU = trb.liu2018()
NAN = math.nan


def scene(*spalls, bearing=BEARING, load=LOAD, law=LIU, **more) -> trb.Scene:
    return trb.Scene(bearing, load, spalls, law=law, **more)


def bearing(**changed) -> trb.TaperedBearing:
    return dataclasses.replace(BEARING, **changed)


def refused(made: trb.Scene, calls=("solve", "assess", "prepare")) -> str:
    """The one sentence with which everything refuses the scene."""
    said = set()
    for name in calls:
        with pytest.raises(trb.SceneError) as caught:
            getattr(trb, name)(made)
        said.add(str(caught.value))
    with pytest.raises(trb.SceneError) as caught:
        trb.sweep(["peak_load"], made, {"load.axial": [4500.0, 4600.0]})
    said.add(str(caught.value))
    (sentence,) = said
    assert "\n" not in sentence
    return sentence


# a scene made in Python, and the file that says the same: both are refused by one sentence
AS_FILES = {
    "another bearing than the law's": (scene(bearing=bearing(modulus=2.0e5), law="liu2018"), {}),
    "no common apex": (scene(bearing=bearing(outer_angle=0.3)), {}),
    "roller angle and diameters": (scene(bearing=bearing(roller_large_diameter=7.0)), {}),
    "larger small end": (scene(bearing=bearing(roller_large_diameter=6.0)), {}),
    "40 rollers where 26 fit": (scene(bearing=bearing(rollers=40)), {}),
    "2 rollers": (scene(bearing=bearing(rollers=2)), {}),
    "Poisson's ratio": (scene(bearing=bearing(poisson=0.6)), {}),
    "modulus in GPa": (scene(bearing=bearing(modulus=210.0)), {}),
    "negative load": (scene(load=trb.Load(-1.0, 4500.0)), {}),
    "load beyond all": (scene(load=trb.Load(9000.0, 1e8)), {}),
    "longer than the roller": (scene(trb.Spall(15.0, 7.0), law="direct"), {"contact": {"law": "direct"}}),
    "longer than palmgren knows": (scene(trb.Spall(13.6, 7.0), law="palmgren"), {"contact": {"law": "palmgren"}}),
    "longer than the table knows": (scene(trb.Spall(12.0, 7.0), law="table"), {"contact": {"law": "table"}}),
    "longer than Table 2": (scene(trb.Spall(9.0, 7.0), law="liu2018"), {}),
    "wider than its circumference": (scene(trb.Spall(4.0, 700.0)), {}),
    "wider than the inner raceway": (
        scene(trb.Spall(4.0, 150.0, surface="inner"), law="power", effects=effects.Raceways()),
        {"contact": {"law": "power"}, "effects": {"raceways": {}}},
    ),
    "angle in degrees": (scene(trb.Spall(4.0, 7.0, angle=90.0)), {}),
    "unknown surface": (scene(trb.Spall(4.0, 7.0, surface="top")), {}),  # type: ignore[arg-type]
    "unknown law": (scene(law="hooke"), {"contact": {"law": "hooke"}}),
    "two shapes": (
        scene(SPALL, trb.Spall(4.0, 3.0), law="power"),
        {"contact": {"law": "power"}},
    ),
    "accuracy": (scene(law="power", accuracy=0.5e-4), {"contact": {"law": "power", "accuracy": 0.5e-4}}),
    "accuracy of auto": (scene(law="auto", accuracy=5e-4), {"contact": {"law": "auto", "accuracy": 5e-4}}),
    "design load": (scene(design_load=-1.0), {"contact": {"law": "liu2018", "design_load": -1.0}}),
    "unknown definition": (scene(definition="Secant"), {"stiffness": {"definition": "Secant"}}),  # type: ignore[arg-type]
    "phase in degrees": (scene(phase=7.0), {"stiffness": {"phase": 7.0}}),
    "speed": (
        scene(effects=(effects.Centrifugal(-1.0),)),
        {"effects": {"centrifugal": {"speed_rpm": -1.0}}},
    ),
    "control": (
        scene(effects=(effects.Centrifugal(1.0, "speed"),)),  # type: ignore[arg-type]
        {"effects": {"centrifugal": {"speed_rpm": 1.0, "control": "speed"}}},
    ),
    "half a slice": (
        scene(law="palmgren", effects=effects.Tilt(slices=2.5)),  # type: ignore[arg-type]
        {"contact": {"law": "palmgren"}, "effects": {"tilt": {"slices": 2.5}}},
    ),
    "one slice": (
        scene(law="palmgren", effects=effects.Tilt(slices=1)),
        {"contact": {"law": "palmgren"}, "effects": {"tilt": {"slices": 1}}},
    ),
    "deviation in µm": (
        scene(effects=effects.Diameters((2.0,) * 23)),
        {"effects": {"diameters": {"deviations": [2.0] * 23}}},
    ),
    "words for a number": (scene(load=trb.Load("9000", 4500.0)), {}),  # type: ignore[arg-type]
    "a truth for a number": (scene(load=trb.Load(True, 4500.0)), {}),
}


def as_file(made: trb.Scene, more: dict) -> dict:
    """A scene as a file would have it."""

    def table(value) -> dict:
        return {key: entry for key, entry in dataclasses.asdict(value).items() if entry is not None}

    law = {} if more.get("contact") else {"contact": {"law": "liu2018"}}
    return {"bearing": table(made.bearing), "load": table(made.load), "spall": [table(s) for s in made.spalls],
            **law, **more}  # fmt: skip


@pytest.mark.parametrize("name", AS_FILES)
def test_what_files_refuse_is_refused_in_the_same_sentence(name: str) -> None:
    made, more = AS_FILES[name]
    with pytest.raises(trb.SceneError) as caught:
        scene_file.check_ring(scene_file.from_content(as_file(made, more), "a.toml"), "a.toml")
    assert str(caught.value) == f"a.toml: {refused(made)}"


def test_a_spall_in_python_may_shrink_to_nothing_but_not_below() -> None:
    """From a file 0.01 mm is the least: there a smaller number has another unit."""
    assert checks.wrong(scene(trb.Spall(0.0, 0.0, 0.0))) is None
    for spall, key in (
        (trb.Spall(-1.0, 7.0), "length"),
        (trb.Spall(4.0, -1.0), "width"),
        (trb.Spall(4.0, 7.0, -1.0), "depth"),
    ):
        most = 10 if key == "depth" else 1000
        assert refused(scene(spall)) == f"spall.0.{key} = -1.0: must be a number in 0 … {most} mm"


WORDS = {
    "a bearing that is none": (scene(bearing=6205), "bearing = 6205: must be a name"),
    "no load": (scene(load=None), "load = None: must be a Load"),
    "loads in a pair": (scene(load=(9000.0, 4500.0)), r"load = \(9000.0, 4500.0\): must be a Load"),
    "an empty load": (scene(load=trb.Load(None, 4500.0)), r"load.radial = None: must be a number in 0 … 1e\+07 N"),
    "a spall that is none": (scene(4.0), r"spall.0 = 4.0: must be a Spall"),
    "a map's file": (scene(trb.example_map()), r".*must be a Spall, say .* or a height map, load_height_map\(path\)"),
    "a law that is none": (scene(law=3), r"contact.law = 3: must be one of"),
    "accuracy in words": (scene(law="power", accuracy="high"), r"contact.accuracy = 'high': must be a number"),
    "many phases": (
        scene(phase=np.linspace(0.0, 0.1, 3)),
        r"stiffness.phase has shape \(3,\): .* jax.vmap .* difftrb.sweep with stiffness.phase as an axis",
    ),
    "many lengths": (scene(trb.Spall(jnp.ones(2), 7.0)), r"spall.0.length has shape \(2,\)"),
    "a complex load": (scene(load=trb.Load(9000.0 + 1j, 4500.0)), r"load.radial = .*: must be a number"),
    "a modulus that is no number": (scene(bearing=bearing(modulus=NAN)), "bearing.modulus = nan: must be"),
    "a load that is no number, where contacts are solved": (
        scene(law="direct", load=trb.Load(NAN, 4500.0)), "load.radial = nan: must be",
    ),
    "a whole number without end": (scene(load=trb.Load(10**400, 4500.0)), r"load.radial = 1000"),
}  # fmt: skip


@pytest.mark.parametrize("name", WORDS)
def test_what_no_file_can_hold_gets_one_sentence(name: str) -> None:
    made, words = WORDS[name]
    assert re.match(words, refused(made))


def test_a_height_map_needs_contact_solves() -> None:
    """In a file and in Python, by the same sentences."""
    height = trb.HeightMap(jnp.array([[0.0, 0.0], [-0.1, 0.0]]), 0.1, 0.1)
    text = scene_file.example("map").replace("[contact]", '[contact]\nlaw = "table"')
    with pytest.raises(trb.SceneError) as caught:
        scene_file.check_ring(scene_file.parse(text, "map"), "map")
    assert str(caught.value) == f"map: {refused(dataclasses.replace(scene(height), law='table'))}"
    assert refused(dataclasses.replace(scene(height), law="table")).endswith("use 'auto' or 'direct'")
    with pytest.raises(trb.SceneError, match=r"spall.0.height_map: needs numbers: prepare the scene first"):
        jax.jit(trb.solve)(dataclasses.replace(scene(height), law="auto"))
    both = dataclasses.replace(scene(height), law="auto", effects=(effects.Through(),))
    assert "effects.through takes rectangular spalls" in refused(both)
    checks.refuse(dataclasses.replace(both, effects=(effects.Tilt(),)))  # which goes by contacts


def test_sweeps_and_fits_take_no_map() -> None:
    height = trb.HeightMap(jnp.array([[0.0, 0.0], [-0.1, 0.0]]), 0.1, 0.1)
    with_map = dataclasses.replace(scene(height), law="auto")
    words = "contacts on a height map are solved for one scene at a time"
    with pytest.raises(trb.SceneError, match=words):
        trb.sweep(["radial_stiffness"], with_map, {"load.axial": [4500.0, 5000.0]})
    with pytest.raises(trb.SceneError, match=words):
        trb.fit(with_map, [trb.Measurement(9000.0, 4500.0, "radial_loss", 1.0, 0.1)])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"pitch_x": 0.0}, r"spall.0.pitch_x = 0.0: must be a number in 1e-05 … 10 mm"),
        ({"scale": float("nan")}, r"spall.0.scale = nan: must be"),
        ({"row": 2}, r"spall.0.row = 2: needs the effect double_row"),
        ({"height": jnp.zeros(3)}, r"spall.0.height: must be an array of heights"),
        ({"height": [[0.0, 0.0], [-0.1, 0.0]]}, r"spall.0.height: must be an array of heights"),
        (
            {"height": jnp.full((3, 3), -10.1)},
            r"spall.0.height: must be a grid of at least 2 × 2 heights in -10 … 10 mm",
        ),
        ({"height": jnp.full((3, 3), jnp.nan)}, r"spall.0.height: must be a grid"),
    ],
)
def test_numbers_of_a_map_are_judged(changed: dict, words: str) -> None:
    height = dataclasses.replace(trb.HeightMap(jnp.zeros((3, 3)), 0.1, 0.1), **changed)
    assert re.match(words, refused(dataclasses.replace(scene(height), law="direct")))


def test_names_one_spall_and_lists_are_taken() -> None:
    whole = trb.Scene(BEARING, LOAD, (SPALL,), effects=(effects.Life(),))
    assert trb.Scene("32008J", LOAD, SPALL, effects=effects.Life()) == whole
    assert trb.Scene("32008J", LOAD, [SPALL], effects=[effects.Life()]) == whole
    with pytest.raises(trb.SceneError, match=r"bearing = '6205' is unknown; use 32008J, or a TaperedBearing"):
        trb.Scene("6205", LOAD)
    with pytest.raises(trb.SceneError, match=r"effects.0 = 'tilt': must be one of difftrb.effects"):
        trb.Scene(BEARING, LOAD, effects=("tilt",))


def test_there_is_one_error() -> None:
    assert trb.SceneError is scene_file.SceneError is status.SceneError
    assert issubclass(trb.SceneError, ValueError)


def test_whole_numbers_are_differentiated_by() -> None:
    """JAX refuses to before any of this is called: they become floats when they are given."""
    whole = trb.Scene(
        bearing(roller_length=np.int64(14), roller_angle=np.float32(0.0262)), trb.Load(9000, np.int32(4500)),
        (trb.Spall(4, jnp.asarray(7)),), law=LIU, design_load=6500, phase=np.asarray(0), effects=effects.Centrifugal(0),
    )  # fmt: skip
    assert all(jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating) for leaf in jax.tree.leaves(whole))
    plain = trb.Scene(BEARING, trb.Load(9000, 4500), trb.Spall(4, 7), law=LIU)
    by = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(plain)
    same = jax.grad(lambda s: trb.solve(s).stiffness[0, 0])(scene(SPALL))
    assert float(by.load.radial) == float(same.load.radial) != 0.0
    assert trb.LineContact(4, 14, 100_000, 0) == trb.LineContact(4.0, 14.0, 1e5, 0.0)
    assert isinstance(trb.LineContact(4, 14, 100_000, 0).radius, float)
    assert isinstance(bearing(rollers=np.int64(20)).rollers, np.integer)


def test_trees_of_anything_are_rebuilt() -> None:
    made = scene(SPALL, effects=(effects.Life(5e4), effects.Centrifugal(1000.0)), phase="mean")
    for leaf in (object(), None, True, 3, "text", types.SimpleNamespace()):
        other = jax.tree.map(lambda _, leaf=leaf: leaf, made)
        assert other.load.radial is leaf
        assert other.spalls[0].width is leaf
        assert other.effects[1].load_rating is leaf
    axes = dataclasses.replace(jax.tree.map(lambda _: None, made), load=jax.tree.map(lambda _: 0, LOAD))
    many = dataclasses.replace(made, load=trb.Load(jnp.array([8e3, 9e3]), jnp.array([4e3, 4.5e3])))
    assert jax.vmap(lambda s: s.load.radial + s.load.axial, in_axes=(axes,))(many).shape == (2,)
    assert jax.tree_util.tree_flatten_with_path(LOAD)[0][0][0] == (jax.tree_util.GetAttrKey("radial"),)


def test_traced_numbers_are_for_the_status() -> None:
    """What would be refused if it were known ends as a status, and spoils nothing beside it."""

    def solved(length, poisson, depth, radial, width):
        made = scene(trb.Spall(length, width, depth), bearing=bearing(poisson=poisson), load=trb.Load(radial, 4500.0))
        s = trb.solve(made)
        return s.stiffness[0, 0], s.status_code

    rows = jnp.array([
        [4.0, 0.278, 0.2, 9000.0, 7.0], [9.0, 0.278, 0.2, 9000.0, 7.0], [4.0, 0.6, 0.2, 9000.0, 7.0],
        [4.0, 0.278, -0.2, 9000.0, 7.0], [4.0, 0.278, 11.0, 9000.0, 7.0], [4.0, 0.278, 0.2, -1.0, 7.0],
        [NAN, 0.278, 0.2, 9000.0, 7.0], [4.0, 0.278, 0.2, 9000.0, 175.0],
    ])  # fmt: skip
    (values, codes), slopes = jax.vmap(jax.value_and_grad(solved, argnums=(0, 3), has_aux=True))(*rows.T)
    bad = status.BAD_INPUT
    assert list(np.asarray(codes)) == [0, status.UNKNOWN_LENGTH, bad, bad, bad, bad, bad, bad]
    assert np.isfinite(float(values[0]))
    assert np.isnan(np.asarray(values[1:])).all()
    assert all(np.isfinite(float(slope[0])) for slope in slopes)


def test_many_traced_at_once_are_told_of_vmap() -> None:
    with pytest.raises(trb.SceneError, match=r"stiffness.phase has shape \(3,\)"):
        jax.jit(lambda p: trb.solve(scene(phase=p)).loads)(jnp.zeros(3))


def test_as_many_rollers_as_fit_are_taken() -> None:
    """32008J: sin(π/n) must exceed tan(roller's taper)/sin(its axis' angle) = 0.1194, so n ≤ 26."""
    share = math.tan(float(BEARING.roller_angle)) / math.sin(float(BEARING.outer_angle - BEARING.roller_angle))
    most = math.floor(math.pi / math.asin(share))
    assert most == 26
    assert checks.wrong(scene(bearing=bearing(rollers=most))) is None
    assert f"at most {most} fit" in refused(scene(bearing=bearing(rollers=most + 1)))


def test_axes_that_leave_the_ranges_are_refused_before_anything_is_computed() -> None:
    for key, end, words in (
        (
            "spall.0.width",
            700.0,
            "spall.0.width = 700: must be at most 97 % of once round the outer raceway, 174.686 mm",
        ),
        ("spall.0.length", 15.0, "spall.0.length = 15: must be at most the roller's length, 13.66 mm"),
        ("bearing.outer_angle", 0.3, "must be inner_angle"),
    ):
        with pytest.raises(trb.SweepError, match=re.escape(words)):
            trb.sweep(["peak_load"], scene(SPALL), {key: {"from": 4.0, "to": end, "count": 3}} if end > 1.0 else
                      {key: [0.2473, end]})  # fmt: skip


@pytest.mark.parametrize("sigma", [0.0, -0.1, NAN, math.inf, "0.1", True])
def test_a_row_needs_a_sigma_above_zero(sigma) -> None:
    row = trb.Measurement(9000.0, 4500.0, "radial_loss", 3.0, sigma)
    with pytest.raises(trb.MeasuredError) as caught:
        trb.fit(scene(SPALL), [row] * 3)
    assert re.match(r"measurements: row 1: sigma = .*: must be a number in 1e-09 … 1e\+10", str(caught.value))


@pytest.mark.parametrize("sigma", ["0", "-0.1", "nan", "inf", "x"])
def test_a_sigma_of_a_file_is_above_zero(sigma: str) -> None:
    with pytest.raises(trb.MeasuredError, match=r"^measured: line 2: sigma = .*: must be a number in 1e-09"):
        measured_table.parse(f"radial,axial,quantity,value,sigma\n9000,4500,radial_loss,3.0,{sigma}\n")


@pytest.mark.parametrize(
    ("changed", "words"),
    [({"quantity": "loss"}, "quantity = 'loss': must be one of"), ({"value": NAN}, "value = nan: must be a number"),
     ({"radial": -1.0}, "radial = -1.0: must be a number"), ({"phase": "average"}, "phase = 'average': must be")],
)  # fmt: skip
def test_rows_are_checked_as_files_are(changed: dict, words: str) -> None:
    row = dataclasses.replace(trb.Measurement(9000.0, 4500.0, "radial_loss", 3.0, 0.1), **changed)
    with pytest.raises(trb.MeasuredError, match=f"measurements: row 1: {words}"):
        trb.fit(scene(SPALL), [row] * 3)


# ------------------------------------------------------------------------------------------------ a prepared law


def test_a_law_for_one_scene_ends_where_contacts_do(monkeypatch) -> None:
    """Of 1.1 roller lengths "direct" said that it had converged, stiffer than the healthy bearing."""
    from tests.closed_form import closed_form

    monkeypatch.setattr("difftrb.law.samples.solved", closed_form)
    contact = trb.LineContact.of(BEARING)
    for length, code in ((11.6, status.CONVERGED), (11.62, status.UNKNOWN_LENGTH), (12.5, status.UNKNOWN_LENGTH)):
        law = direct_curves.without_edges(contact, 2000.0, (trb.Spall(length, 7.0),))
        assert int(law.judge((trb.Spall(length, 7.0),), jnp.full((1, 1), 20.0))) == code


def test_what_is_no_scene_or_bearing_is_said() -> None:
    for call in (trb.solve, trb.assess, trb.prepare):
        for given in ("scene.toml", BEARING):
            with pytest.raises(trb.SceneError, match=r"^scene = .*: must be a Scene; read a file's by"):
                call(given)  # type: ignore[arg-type]
    made = trb.bearing_from_catalogue(30.0, 62.0, 17.25, e=0.37)
    with pytest.raises(trb.SceneError, match=r"^bearing = .*; of a catalogue's give its \.bearing"):
        trb.defect_frequencies(made, 3000.0)  # type: ignore[arg-type]


def test_replace_does_not_take_spalls_for_a_spalls_number() -> None:
    one = scene(SPALL)
    assert one.replace(spalls=()).spalls == ()
    for given in ((), SPALL, (SPALL,), True):
        with pytest.raises(trb.SceneError, match=r"^spall = .*: must be the number of a spall, from 0; spalls = …"):
            one.replace(spall=given)  # type: ignore[arg-type]
    with pytest.raises(trb.SceneError, match=r"^spall = 0: says whose values to replace, and none is given"):
        one.replace(spall=0)
    assert one.replace(spall=0, length=2.0) == one.replace(length=2.0)


def test_a_spall_is_replaced_by_what_it_is() -> None:
    """Beside a rectangular spall a map has its own names; either says what it lacks."""
    both = (trb.Spall(4.0, 7.0), trb.HeightMap(jnp.zeros((3, 3)), 0.1, 0.1, angle=1.0))
    made = trb.Scene("32008J", trb.Load(9000.0, 4500.0), both)
    assert made.replace(spall=1, scale=2.0).spalls[1].scale == 2.0
    assert made.replace(spall=0, length=3.0).spalls[0].length == 3.0
    with pytest.raises(trb.SceneError, match="scale: spall 0 is a Spall, which has none"):
        made.replace(spall=0, scale=2.0)
