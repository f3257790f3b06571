"""Tables of measurements: what is right is read, what is wrong gets one sentence."""

import dataclasses
import math
from pathlib import Path

import jax.numpy as jnp
import pytest

import difftrb as trb
from difftrb.fits import fit_problem
from difftrb.fits.measured import MeasuredError, Measurement, check_loads
from difftrb.fits.measured_table import load_measured, parse

GOOD = """# a comment
radial, axial, quantity, value, sigma, phase, definition, speed_rpm

9000, 4500, radial_loss, 2.4, 0.02, mean, tangent,
3000, 4500, axial_stiffness, 4.6e5, 5e3, 0.1, , 0
"""

# what is changed in a good table, and what the sentence has to name
BAD = {
    "unknown quantity": ("radial_loss", "radial_los", ["line 4", "quantity = 'radial_los'", "'radial_loss'"]),
    "no number": ("2.4", "two", ["line 4", "value = 'two'", "a number", "percent"]),
    "not a number": ("2.4", "nan", ["line 4", "value = nan", "a number"]),
    "empty value": ("2.4", "", ["line 4", "value is empty", "N/mm"]),
    "negative load": ("3000", "-3000", ["line 5", "radial = -3000.0", "0 … 1e+07 N"]),
    "zero sigma": ("0.02", "0", ["line 4", "sigma = 0.0", "leave it empty in all rows"]),
    "degrees": ("0.1", "90", ["line 5", "phase = 90.0", "rad or 'mean'"]),
    "phase in words": ("mean", "average", ["line 4", "phase = 'average'", "'mean'"]),
    "definition": ("tangent", "chord", ["line 4", "definition = 'chord'", "'tangent', 'secant'"]),
    "speed": ("5e3, 0.1, , 0", "5e3, 0.1, , 3000", ["line 5", "speed_rpm = 3000", "must be 0"]),
    "more than everything": ("2.4", "240", ["line 4", "value = 240", "below 100 %"]),
    "stiffness below zero": ("4.6e5", "-4.6e5", ["line 5", "value = -460000", "above 0 N/mm"]),
    "unknown column": ("sigma", "sgima", ["line 2: column 'sgima'", "did you mean sigma"]),
    "missing column": ("axial, q", "q", ["column axial is missing"]),
    "twice": ("sigma, phase", "sigma, sigma", ["column 'sigma' stands twice"]),
    "number of Python": ("3000", "3_000", ["line 5", "radial = '3_000'", "0 … 1e+07 N"]),
    "decimal comma": ("2.4,", "2,4,", ["line 4", "9 cells", "point"]),
    "column without end": ("sigma", "s" * 3000, ["column 'sss", "...", "is not known"]),
    "cell without end": ("2.4", "4" * 40 + "x" * 3000, ["line 4: value = '444", "...: must be"]),
    "quoted over lines": ("mean", '"mean\n"', ["line 5", "CSV", "quote"]),
}


def test_a_table_is_read(tmp_path: Path) -> None:
    file = tmp_path / "m.csv"
    file.write_text("\ufeff" + GOOD, encoding="utf-8")
    first, second = load_measured(file)
    assert first == Measurement(9000.0, 4500.0, "radial_loss", 2.4, 0.02, "tangent", "mean")
    assert second == Measurement(3000.0, 4500.0, "axial_stiffness", 4.6e5, 5e3, None, 0.1)
    assert (first.unit, second.unit, first.is_loss, second.is_loss) == ("%", "N/mm", True, False)


@pytest.mark.parametrize("name", BAD)
def test_bad_tables_get_one_sentence(name: str) -> None:
    old, new, named = BAD[name]
    assert old in GOOD
    with pytest.raises(MeasuredError) as caught:
        parse(GOOD.replace(old, new, 1), "m.csv")
    sentence = str(caught.value)
    assert sentence.startswith("m.csv: ")
    assert "\n" not in sentence
    assert len(sentence) < 400
    for part in named:
        assert part in sentence, sentence


def test_tables_without_rows() -> None:
    empty = {"": "no rows", "radial,axial,quantity,value\n": "no rows", "radial;axial\n1;2": "quantity is missing"}
    for text, named in empty.items():
        with pytest.raises(MeasuredError, match=named):
            parse(text, "m.csv")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    binary = tmp_path / "b.csv"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, named in ((tmp_path / "none.csv", "no such file"), (tmp_path, "directory"), (binary, "UTF-8")):
        with pytest.raises(MeasuredError, match=named):
            load_measured(path)


WIDE = """radial [kN], axial (kN), phase [deg], load_sigma, radial_stiffness [N/µm], radial_stiffness_sigma, axial_loss [1]
9, 4.5, 5, 1, 480, 5,
3, 4.5, , , , , 0.012
"""  # noqa: E501


def test_a_wide_table_in_other_units_is_read() -> None:
    """Every cell that is not empty is a measurement."""
    first, second = parse(WIDE)
    assert (first.radial, first.axial, first.quantity) == (9000.0, 4500.0, "radial_stiffness")
    assert (first.value, first.sigma, first.load_sigma) == (480e3, 5e3, 1.0)
    assert first.phase == pytest.approx(math.radians(5.0))
    assert (second.quantity, second.value, second.sigma, second.phase) == ("axial_loss", 1.2, None, None)


@pytest.mark.parametrize("between", [";", "\t"])
@pytest.mark.parametrize("comma", [",", "."])
def test_a_table_of_a_spreadsheet_may_have_decimal_commas(between: str, comma: str) -> None:
    text = "radial [kN]; axial; radial_loss; radial_loss_sigma\n9; 4,5e3; 1,25; 0,02\n9; 4500; -0,25; 0,02"
    first, second = parse(f"sep={between}\n" + text.replace(",", comma).replace(";", between))
    assert (first.radial, first.axial, first.value, first.sigma) == (9000.0, 4500.0, 1.25, 0.02)
    assert second.value == -0.25


def test_a_column_without_a_name_behind_the_last_one_is_left_out() -> None:
    assert [row.value for row in parse("radial;axial;radial_loss;\n9000;4500;1,5;\n9000;4500;1,6;\n")] == [1.5, 1.6]


@pytest.mark.parametrize("between", [",", ";", "\t"])
def test_a_line_of_separators_is_empty(between: str) -> None:
    """As spreadsheets write below, between and above what was filled in."""
    lines = ";;;", "radial;axial;radial_loss;", ";;;", "9000;4500;1.5;", " ; ;;", ";;;"
    (row,) = parse("\n".join(lines).replace(";", between), "m.csv")
    assert (row.value, row.origin) == (1.5, ("m.csv", 4, "radial_loss"))


def test_a_matrix_is_read() -> None:
    """Stiffness beside the diagonal may be negative."""
    names = ("radial", "axial", *(f"{entry}_stiffness [MN/m]" for entry in ("radial", "lateral", "radial_lateral")))
    text = f"{','.join(names)}\n9e3,4500,480,300,-7\n"
    assert [row.value for row in parse(text)] == [480e3, 300e3, -7e3]
    assert [row.is_coupling for row in parse(text)] == [False, False, True]


@pytest.mark.parametrize(
    ("header", "cells", "named"),
    [
        (
            "radial [kg],axial,quantity,value",
            "1,2,radial_loss,1",
            r"column radial: unit \[kg\] is not known; use",
        ),
        ("radial,axial,value [N/µm],quantity", "1,2,3,radial_loss", r"value in \[N/µm\]: radial_loss is in % or 1"),
        ("radial,axial,radial_loss,value", "1,2,3,4", "either quantity and value, or a column for each quantity"),
        ("radial,axial,radial_loss_sigma,axial_loss", "1,2,3,4", "has no column radial_loss beside it"),
        ("radial,axial,radial_loss", "1,2,x", "^m.csv: line 2: radial_loss = 'x': must be a number"),
        ("radial,axial,radial_loss,axial_loss", "1,2,,", "^m.csv: line 2: holds no value"),
        ("radial,axial,radial_loss,load_sigma", "1,2,3,2", "load_sigma = 2 %: radial_loss_sigma is empty"),
        ("radial,quantity [N]", "1,2", r"column quantity: unit \[N\] is not known; it has none"),
        (
            "radial [kN],axial,radial_loss",
            "1e5,2,3",
            r"^m.csv: line 2: radial = 100000.0 \[kN\]: must be",
        ),
        ("radial;axial;radial_loss", "9000;4.500,0;1,2", "line 2: axial = 4.500,0: numbers have a comma and a point"),
        ("radial;axial;radial_loss", "9000;4.500;1,2", "line 2: axial = 4.500: numbers have a comma and a point"),
        ("radial,axial,radial_loss", "9.000,4.500,1.2", "line 2: radial = 9.000 N may have a point between"),
        ("radial;axial;radial_loss", "9.000;0;1.2", "radial = 9.000 N may have a point between thousands: write 9000"),
        ("radial;axial;radial_loss", "9,000;4,500;1,2", "line 2: radial = 9,000 N may have a comma between thousands"),
        (
            "radial,axial,radial_loss",
            '9000,4500,"1,2"',
            "radial_loss = '1,2': .* write a number alone, with a decimal point",
        ),
        ("radial,axial,radial_loss", "9000,4500,1.6 %", "radial_loss = '1.6 %': .* a unit goes into the first line"),
        ("radial,axial,radial_loss,phase", "9000,4500,1.6,10.6", r"phase = 10.6: .*; in degrees .* phase \[deg\]"),
        ("Radiallast [N],axial,radial_loss", "9000,4500,1.6", "'Radiallast' is not known; known here: radial, axial"),
    ],
)
def test_wide_tables_get_one_sentence(header: str, cells: str, named: str) -> None:
    with pytest.raises(MeasuredError, match=named):
        parse(f"{header}\n{cells}\n", "m.csv")


SEVERAL = """# two quantities a line
radial,axial,radial_loss,radial_loss_sigma,axial_loss,axial_loss_sigma,definition
9000,4500,2.0,0.1,1.0,0.1,
3000,{axial},1.5,0.1,{loss},{sigma},{definition}
"""


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"loss": "240"}, r"line 4: axial_loss = 240 %: a loss must be below 100 %"),
        ({"loss": "x"}, r"line 4: axial_loss = 'x': must be a number"),
        ({"sigma": "0"}, r"line 4: axial_loss_sigma = 0.0: must be a number in 1e-09 … 1e\+10"),
        ({"sigma": ""}, r"line 4: axial_loss_sigma is empty: give it in all rows or in none"),
        ({"axial": "45"}, r"line 4: axial = 45 N is too small"),
    ],
)
def test_what_is_wrong_in_a_wide_table_is_named_as_it_stands_there(
    bearing: trb.TaperedBearing, changed: dict[str, str], sentence: str
) -> None:
    """Measurements were counted, of which a line has several, and nothing said of which file."""
    text = SEVERAL.format(**{"axial": "4500", "loss": "0.8", "sigma": "0.1", "definition": ""} | changed)
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "liu2018")
    with pytest.raises(MeasuredError, match=f"^m.csv: {sentence}"):  # noqa: PT012  # wherever it is found
        rows = parse(text, "m.csv")
        check_loads(scene, rows)
        fit_problem.problem_of(trb.prepare(scene), rows, ("length",), "squares", None)


def test_a_secant_that_does_not_exist_is_named_by_its_column(bearing: trb.TaperedBearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "liu2018")
    wide = parse("radial,axial,axial_loss,radial_loss,definition\n0,4500,1,2,secant\n", "m.csv")
    long = parse("radial,axial,quantity,value,definition\n0,4500,radial_loss,2,secant\n", "m.csv")
    for rows, column in ((wide, "radial_loss"), (long, "quantity = 'radial_loss'")):
        with pytest.raises(MeasuredError, match=f"^m.csv: line 2: {column}: a secant .* needs a radial load"):
            check_loads(scene, rows)


def test_a_table_as_a_whole_is_named(bearing: trb.TaperedBearing) -> None:
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), "liu2018")
    rows = parse("radial,axial,radial_loss,axial_loss\n9000,4500,1,2\n", "m.csv")
    for some, said in ((rows, "2 measured values"), (rows[:1], "1 measured value")):
        with pytest.raises(MeasuredError, match=f"^m.csv: {said} cannot give 2 parameters and their own error"):
            trb.fit(scene, some)
    assert rows[0] == Measurement(9000.0, 4500.0, "radial_loss", 1.0)  # wherever it was read


def test_rows_of_rings_that_are_held_otherwise_need_no_axial_load(bearing):
    """With `Mounting` the axial load is 0 and comes out; a second row holds any load; a plain ring is refused still."""
    row = Measurement(9000.0, 0.0, "radial_loss", 2.0, 0.1)
    plain = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), phase=jnp.asarray(0.0))
    held = dataclasses.replace(plain, load=trb.Load(9000.0, 0.0), effects=(trb.effects.Mounting(preload=0.01),))
    pair = dataclasses.replace(plain, effects=(trb.effects.DoubleRow(preload=0.01),))
    for scene in (held, pair):
        check_loads(scene, [row])
    with pytest.raises(MeasuredError, match="row 1: axial = 0 N is too small"):
        check_loads(plain, [row])


def test_a_phase_in_an_array_is_no_mean(bearing):
    """A spall on a roller has a place at one phase, whatever holds its number."""
    on_roller = trb.Spall(4.0, 7.0, surface="roller")
    scene = trb.Scene(bearing, trb.Load(9000.0, 4500.0), (on_roller,), phase=jnp.asarray(0.0))
    check_loads(scene, [Measurement(9000.0, 4500.0, "radial_loss", 2.0, 0.1)])
