"""Scene files: what is right is read, what is wrong gets one sentence."""

import dataclasses
from pathlib import Path

import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.scene import scene_file

GOOD = scene_file.example("spall")

# what is changed in a good file, and what the sentence has to name
BAD = {
    "unknown key": ("length = 4.0", "lenght = 4.0", ["spall.0.lenght", "did you mean length"]),
    "unknown table": ("[load]", "[loads]", ["loads", "did you mean load"]),
    "negative size": ("length = 4.0", "length = -4.0", ["spall.0.length = -4.0", "0.01 … 1000 mm"]),
    "zero size": ("width = 7.0", "width = 0.0", ["spall.0.width = 0.0", "0.01 … 1000 mm"]),
    "metres": ("length = 4.0", "length = 0.004", ["spall.0.length = 0.004", "mm"]),
    "micrometres": ("length = 4.0", "length = 4000.0", ["spall.0.length = 4000.0", "mm"]),
    "degrees": ("angle = 0.0", "angle = 90.0", ["spall.0.angle = 90.0", "rad"]),
    "longer than the roller": ("length = 4.0", "length = 14.0", ["spall.0.length = 14", "13.66 mm"]),
    "longer than the law knows": ("length = 4.0", "length = 12.0", ["spall.0.length = 12", "11.611 mm"]),
    "beside the roller": (
        "axial_offset = 0.0",
        "axial_offset = -9.0",
        ["axial_offset = -9", "-8.83 … 8.83 mm"],
    ),
    "a key of the file": (
        "length = 4.0",
        'bearing = "a"',
        ["spall.0.bearing is", "above the first heading"],
    ),
    "with its unit": ("radial = 9000.0", 'radial = "9 kN"', ["load.radial = '9 kN'", "without quotes and unit"]),
    "a direction": ("radial = 9000.0", "radial = -9000.0", ["load.radial = -9000.0", "give loads by their size"]),
    "names of effects": ("[load]", 'effects = ["life"]\n[load]', ["effects = ['life']", "say [effects.life]"]),
    "not a number": ("length = 4.0", "length = nan", ["spall.0.length = nan", "0.01 … 1000 mm"]),
    "infinite": ("radial = 9000.0", "radial = inf", ["load.radial = inf", "0 … 1e+07 N"]),
    "text": ("length = 4.0", 'length = "4"', ["spall.0.length = '4'", "a number"]),
    "truth": ("radial = 9000.0", "radial = true", ["load.radial = True", "a number"]),
    "missing key": ("width = 7.0", "", ["spall.0.width is missing", "mm"]),
    "missing table": (
        "[load]\nradial = 9000.0               # N, along the load line\naxial = 4500.0 ",
        "",
        ["load is missing"],
    ),
    "negative load": ("radial = 9000.0", "radial = -1.0", ["load.radial = -1.0", "0 … 1e+07 N"]),
    "unknown bearing": ('"32008J"', '"6205"', ["bearing = '6205'", "32008J"]),
    "bearing of a wrong kind": ('"32008J"', "32008", ["bearing = 32008", "32008J"]),
    "unknown surface": ('"outer"', '"top"', ["spall.0.surface = 'top'", "'outer', 'inner', 'roller'"]),
    "one spall as a table": ("[[spall]]", "[spall]", ["[[spall]]"]),
    "unknown law": ("[load]", '[contact]\nlaw = "hooke"\n[load]', ["contact.law = 'hooke'", "power"]),
    "accuracy": ("[load]", "[contact]\naccuracy = 1e-9\n[load]", ["contact.accuracy = 1e-09", "1e-05 … 0.1"]),
    "accuracy of the contact alone": (
        "[load]",
        '[contact]\nlaw = "direct"\naccuracy = 1e-5\n[load]',
        ["contact.accuracy = 1e-05", "0.0001 … 0.01 for the ring", "`difftrb contact`"],
    ),
    "speed of another kind": (
        "[load]",
        "[effects]\ncentrifugal = { speed_rpm = -1.0 }\n[load]",
        ["effects.centrifugal.speed_rpm = -1.0", "0 … 100000 rev/min"],
    ),
    "effect that is unknown": ("[load]", "[effects]\ncentrifugel = {}\n[load]", ["did you mean centrifugal"]),
    "key of an effect": (
        "[load]",
        "[effects]\ncentrifugal = { rpm = 1.0 }\n[load]",
        ["effects.centrifugal.rpm is not a known"],
    ),
    "effect without its key": (
        "[load]",
        "[effects]\ncentrifugal = {}\n[load]",
        ["effects.centrifugal.speed_rpm is missing"],
    ),
    "effect named twice": ("[load]", "[effects]\nlife = {}\nlife = {}\n[load]", ["'life' is named twice"]),
    "effects that exclude each other": (
        "[load]",
        "[effects]\ntilt = {}\nthrough = {}\n[load]",
        ["effects.tilt and effects.through exclude each other"],
    ),
    "one deviation in words": (
        "[load]",
        "[effects]\ndiameters = { deviations = [0.0, 'x'] }\n[load]",
        ["effects.diameters.deviations.1 = 'x'", "a number in"],
    ),
    "deviations as a number": (
        "[load]",
        "[effects]\ndiameters = { deviations = 0.0 }\n[load]",
        ["deviations = 0.0: must be a list, each a number"],
    ),
    "too few deviations": (
        "[load]",
        "[effects]\ndiameters = { deviations = [0.0] }\n[load]",
        ["1 entries for 23 rollers"],
    ),
    "an effect that needs a law": (
        "[load]",
        '[contact]\nlaw = "power"\n[effects]\ntilt = {}\n[load]',
        ["contact.law = 'palmgren'", "'auto'"],
    ),
    "phase in words": (
        "[load]",
        '[stiffness]\nphase = "average"\n[load]',
        ["stiffness.phase = 'average'", "or 'mean'"],
    ),
    "phase too far": ("[load]", "[stiffness]\nphase = 7.0\n[load]", ["stiffness.phase = 7.0", "6.2832 rad or 'mean'"]),
    "too little axial load": ("axial = 4500.0", "axial = 2000.0", ["load.axial = 2000 N", "2272"]),
    "no axial load": ("axial = 4500.0", "axial = 0.0", ["load.axial = 0 N", "2272"]),
    "no load at all": (
        "radial = 9000.0               # N, along the load line\naxial = 4500.0",
        "radial = 0\naxial = 0",
        ["load.axial = 0 N and load.radial = 0 N"],
    ),
    "map of no name": ("length = 4.0", "height_map = 4.0", ["spall.0.height_map = 4.0", ".npz or .csv"]),
    "map with a tab in its name": ("length = 4.0", 'height_map = "a\\tb"', ["height_map = 'a\\tb': must be the name"]),
    "map with a width": ("length = 4.0", 'height_map = "spall_map.npz"', ["spall.0.width = 7.0", "has its own size"]),
    "capital letter": ("radial = 9000.0", "Radial = 9000.0", ["load.Radial is not a known key", "did you mean radial"]),
    "capital table": ("[load]", "[Load]", ["Load is not a known key", "did you mean load"]),
    "capital in a spall": ("width = 7.0", "Width = 7.0", ["spall.0.Width is not a known key", "did you mean width"]),
    "all in capitals": ("width = 7.0", "WIDTH = 7.0", ["spall.0.WIDTH is not a known key", "did you mean width"]),
    "a key of nothing": ("width = 7.0", '"" = 7.0', ["'spall.0.' is not a known key"]),
    "a key with a blank": ("width = 7.0", '"width " = 7.0', ["'spall.0.width ' is not a known key"]),
    "a key without end": ("width = 7.0", "x" * 3000 + " = 7.0", [f"spall.0.{'x' * 49}... is not a known key"]),
    "a name without end": ('"32008J"', f'"{"x" * 3000}"', ["xxx... is unknown; use 32008J"]),
    "spall that is a number": ("[[spall]]", "spall = 3\n[contact]", ["is not a known key"]),
    "two shapes": (
        "[[spall]]",
        '[contact]\nlaw = "power"\n[[spall]]\nlength = 2.0\nwidth = 3.0\n[[spall]]',
        ["one width, depth and axial offset"],
    ),
    "a number without end": ("9000.0", "1" + "0" * 5000, ["is not TOML that can be read"]),
    "nested without end": ("[load]", "x = " + "[" * 3000 + "]" * 3000 + "\n[load]", ["read"]),
    "effects that are no table": ('bearing = "32008J"', 'bearing = "32008J"\neffects = 0', ["effects"]),
    "not TOML": ("[load]", "[load", ["is not TOML"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_get_one_sentence(name: str, tmp_path: Path) -> None:
    old, new, words = BAD[name]
    assert old in GOOD
    path = tmp_path / "scene.toml"
    body = GOOD.split("\n", 1)[1]  # without the comment, which names the bearing too
    path.write_text(body.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(scene_file.SceneError) as caught:
        trb.load_scene(path)
    sentence = str(caught.value)
    assert sentence.startswith(str(path))
    assert "\n" not in sentence.removeprefix(str(path))
    assert len(sentence.removeprefix(str(path))) < 400
    for word in words:
        assert word in sentence, sentence


TILTED = """bearing = "32008J"
contact.law = "palmgren"
load = { radial = 1000.0, axial = 4500.0 }
effects.tilt = { moment_radial = 110000.0 }
"""


@pytest.mark.parametrize("phase", ["0.07", '"mean"'])
def test_moments_that_nothing_holds(phase: str) -> None:
    """At most 120353 N mm are held at phase 0.07 (linear programming over all slices)."""
    text = TILTED + f"stiffness.phase = {phase}\n"
    file = scene_file.parse(text)
    scene_file.check_ring(file, "scene")
    assert bool(trb.solve(file.scene()).converged)
    more = scene_file.parse(text.replace("110000", "125000"))
    with pytest.raises(
        scene_file.NoEquilibriumError, match=r"and the moments of effects\.tilt it must exceed 4[67]\d\d"
    ):
        scene_file.check_ring(more, "scene")
    assert int(trb.solve(more.scene()).status_code) == status.NO_EQUILIBRIUM
    pair = scene_file.parse(
        TILTED.replace("radial = 1000.0, axial = 4500.0", "radial = 0.0, axial = 0.0").replace(
            "tilt = { ", "double_row = { spacing = 30.0, "
        )
    )
    scene_file.check_ring(pair, "scene")  # rows press against each other
    with pytest.raises(scene_file.NoEquilibriumError, match="there is nothing to hold"):
        scene_file.check_ring(
            scene_file.parse(TILTED.replace("radial = 1000.0, axial = 4500.0", "radial=0, axial=0")), ""
        )


def test_a_byte_order_mark_does_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(GOOD, encoding="utf-8-sig")
    assert trb.load_scene(path) == scene_file.parse(GOOD).scene()


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(scene_file.SceneError, match="no such file"):
        trb.load_scene(tmp_path / "none.toml")
    with pytest.raises(scene_file.SceneError, match="is a directory"):
        trb.load_scene(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(scene_file.SceneError, match="UTF-8"):
        trb.load_scene(tmp_path / "binary.toml")


OWN = scene_file.example("other_bearing")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("modulus = 2.08e5", "modulus = 208.0", "bearing.modulus = 208.0: must be a number in 1000 … 1e+06 N/mm²"),
        (
            "outer_angle = 0.2793",
            "outer_angle = 16.0",
            "bearing.outer_angle = 16.0: must be a number in 0.01 … 1.5 rad; in degrees? 16° are 0.2793 rad",
        ),
        ("modulus = 2.08e5", "modulus = '2.08e5'", "N/mm²; write it without quotes"),
        ("modulus = 2.08e5", "modulus = 2,08e5", "write decimals with a point"),
        ("outer_angle = 0.2793", "outer_angle = 0.35", "must be inner_angle + 2 roller_angle"),
        ("roller_large_diameter = 10.3", "roller_large_diameter = 9.0", "must be larger than"),
        ("roller_large_diameter = 10.3", "roller_large_diameter = 11.3", "does not fit the roller's diameters"),
        ("rollers = 19", "rollers = 19.5", "bearing.rollers = 19.5: must be a whole number in 3 … 400"),
        ("rollers = 19", "rollers = 2", "bearing.rollers = 2: must be a whole number in 3 … 400"),
        ("rollers = 19", "balls = 19", "bearing.balls is not a known key"),
        ("[load]", '[contact]\nlaw = "liu2018"\n[load]', "holds for the bearing 32008J only"),
        ("modulus = 2.08e5", "Modulus = 2.08e5", "bearing.Modulus is not a known key; did you mean modulus?"),
    ],
)
def test_bearings_of_ones_own_are_checked(old: str, new: str, words: str, tmp_path: Path) -> None:
    assert old in OWN
    path = tmp_path / "scene.toml"
    path.write_text(OWN.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(scene_file.SceneError) as caught:
        trb.load_scene(path)
    assert words in str(caught.value)


@pytest.mark.parametrize("name", scene_file.example_names())
def test_examples_are_in_order(name: str) -> None:
    file = scene_file.parse(scene_file.example(name), name)
    scene_file.check_ring(file, name)
    assert scene_file.example(name).startswith("# ")


def test_a_file_becomes_the_scene_it_describes(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(
        'bearing = "32008J"\n[load]\nradial = 9000\naxial = 4500.0\n[[spall]]\nlength = 4\nwidth = 7.0\n'
        '[contact]\nlaw = "liu2018"\n[stiffness]\ndefinition = "secant"\nphase = 0.1\n',
        encoding="utf-8",
    )
    scene = trb.load_scene(path)
    expected = trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="liu2018",
                         definition="secant", phase=0.1)  # fmt: skip
    assert scene == expected


MAP = """bearing = "32008J"
[load]
radial = 9000.0
axial = 4500.0
[[spall]]
height_map = "own.csv"
axial_offset = 0.4
"""


def test_height_maps_lie_beside_the_scene_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(MAP, encoding="utf-8")
    with pytest.raises(scene_file.SceneError) as caught:
        scene_file.read(path)
    assert str(caught.value) == (
        f"{path}: spall.0.height_map = 'own.csv': {tmp_path / 'own.csv'}: there is no such file"
    )
    (tmp_path / "own.csv").write_text("# pitch_x = 0.1\n# pitch_y = 0.2\n0,-0.1\n0,0\n", encoding="utf-8")
    (spall,) = scene_file.read(path).spall
    assert isinstance(spall, trb.HeightMap)
    assert spall.height.shape == (2, 2)
    assert (spall.pitch_y, spall.axial_offset, spall.surface) == (0.2, 0.4, "outer")
    assert trb.load_scene(path).spalls[0].width == pytest.approx(0.3)
    path.write_text(MAP + '[contact]\nlaw = "table"\n', encoding="utf-8")
    with pytest.raises(scene_file.SceneError, match=r"height_map: contact.law = 'table' knows rectangular spalls"):
        trb.load_scene(path)
    path.write_text(MAP.replace("axial_offset = 0.4", "axial_offset = 4000.0"), encoding="utf-8")
    with pytest.raises(scene_file.SceneError, match=r"spall.0.axial_offset = 4000.0: must be a number in -1000 … 1000"):
        scene_file.read(path)


def test_mean_phase_and_laws_from_contact_solves_are_read(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    text = scene_file.example("spall")
    path.write_text(text + '[contact]\nlaw = "table"\n[stiffness]\nphase = "mean"\n', encoding="utf-8")
    scene = trb.load_scene(path)
    assert scene == dataclasses.replace(scene, law="table", phase="mean")
    path.write_text(text + '[contact]\nlaw = "direct"\n[stiffness]\nphase = "mean"\n', encoding="utf-8")
    assert trb.load_scene(path) == dataclasses.replace(scene, law="direct")
