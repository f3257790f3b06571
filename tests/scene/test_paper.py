"""The source paper remade: numbers of docs/paper.md that must not drift, and the scripts behind them in small."""

import importlib
import json
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.law.power import TABLE_2
from experiments.paper import __main__ as paper
from experiments.paper import clipped, common

pytestmark = pytest.mark.literature

DOCS = Path(__file__).parents[2] / "docs"


def script(name: str):
    return importlib.import_module(f"experiments.paper.{name}")


def record(name: str) -> dict:
    """What the page was made from."""
    return json.loads((DOCS / "paper" / f"{name}.json").read_text(encoding="utf-8"))


def still(done: int, total: int) -> None:
    """No bar of progress."""


@pytest.fixture(scope="module")
def remade(contact: trb.LineContact) -> clipped.Fit:
    loads, lengths = jnp.asarray(clipped.LOADS), jnp.asarray(common.LENGTHS)
    approach = clipped.approaches(contact, loads, lengths, clipped.NARROWED, clipped.PAPER_GRID)
    return clipped.power_fit(clipped.LOADS, np.asarray(approach))


@pytest.mark.slow
def test_table_2_comes_out_of_a_clipped_domain(remade: clipped.Fit) -> None:
    """K within 3 %, n within 0.003, the fit's largest error within 0.3 points, all five rows."""
    np.testing.assert_allclose(remade.stiffness, TABLE_2[:, 1], rtol=0.03)
    np.testing.assert_allclose(remade.exponent, TABLE_2[:, 2], atol=0.003)
    np.testing.assert_allclose(remade.error, TABLE_2[:, 3], atol=0.003)
    np.testing.assert_allclose(remade.stiffness, record("01_table2")["numbers"]["clipped"]["stiffness"], rtol=1e-6)


@pytest.mark.slow
def test_the_whole_half_space_is_stiffer(contact: trb.LineContact) -> None:
    """Clipped by whole, of the approach at 3 kN: + 1.6 % without a spall, + 8.9 % with 8 mm."""
    load = np.array([3000.0])
    whole = common.half_space(contact, load, (0.0, 8.0), 1e-2)
    cut = clipped.approaches(contact, jnp.asarray(load), jnp.array([0.0, 8.0]), clipped.NARROWED, (160, 20))
    np.testing.assert_allclose(np.asarray(cut) / whole - 1.0, [[0.016], [0.089]], atol=6e-3)


def test_a_power_law_fits_itself() -> None:
    loads = np.geomspace(100.0, 1000.0, 5)
    fit = clipped.power_fit(loads, (loads / 9e5) ** (1.0 / np.array([[1.2], [1.3]])))
    np.testing.assert_allclose(fit.stiffness, [9e5, 9e5], rtol=1e-9)
    np.testing.assert_allclose(fit.exponent, [1.2, 1.3], rtol=1e-12)
    assert fit.error.max() < 1e-12
    printed = clipped.Fit(TABLE_2[:, 1], TABLE_2[:, 2], TABLE_2[:, 3])
    assert script("01_table2").misses(printed).max() == 0.0


def test_the_rolling_edge_carries_where_the_papers_domain_has_ended() -> None:
    """At D_x = 0.36 mm the edge stands 0.14 mm from the roller's middle, the domain ends at 0.13 mm."""
    pressure = script("03_pressure")
    paper_s, _ = pressure.judged(0.36, pressure.Domain(1.4, (100, 20)))
    whole, one = pressure.judged(0.36, pressure.Domain(3.5, (100, 50)))
    assert paper_s.rolling_peak == 0.0
    assert whole.rolling_peak > 1.0
    assert whole.approach < paper_s.approach - 0.01
    assert whole.over_spall == paper_s.over_spall == 0.0
    assert float(one.residual) < 1e-9


def test_centrifugal_forces_cancel_in_equation_5() -> None:
    """1.9, 5.2, 10.4 N a roller at 3000, 5000, 7100 rev/min; their sum in eq. (5) as printed is nothing."""
    loads = script("05_loads")
    np.testing.assert_allclose([loads.centrifugal(n) for n in (3000.0, 5000.0, 7100.0)], [1.86, 5.16, 10.41], atol=0.01)
    assert np.abs(loads.printed_sums(0.3)).max() < 1e-12


def test_rollers_inside_by_width() -> None:
    width = script("07_width")
    assert [width.inside(w) for w in width.WIDTHS] == [1, 1, 3, 3, 5, 5, 7]


@pytest.mark.parametrize("name", ["05_loads", "07_width"])
def test_scripts_in_small(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole scripts, with the printed laws in place of those from contact solves."""
    monkeypatch.setattr(common, "table_law", trb.liu2018)
    monkeypatch.setattr(common, "four_laws", lambda: dict.fromkeys(
        ("Table 2 as printed", "ours, clipped domain", "ours, half-space, table"), trb.liu2018()
    ))  # fmt: skip
    one = script(name)
    if name == "07_width":
        monkeypatch.setattr(one, "STEPS", np.array([7.0, 14.0, 21.0, 28.0, 35.0, 42.0, 49.0]))
    result = one.run(tmp_path, still)
    common.write(result, tmp_path, name)
    assert {p.suffix for p in tmp_path.iterdir()} == {".png", ".svg", ".json"}
    assert result.claims
    if name == "05_loads":
        gains = result.numbers["gains"]["Table 2 as printed"]
        np.testing.assert_allclose(gains[1:], [7.7, 7.5, 7.1, 6.4, 5.4, 3.8], atol=0.06)
        kept = record(name)["numbers"]["fig_16"]["Table 2 as printed"]
        np.testing.assert_allclose(result.numbers["fig_16"]["Table 2 as printed"], kept, rtol=1e-6)
    else:
        losses = result.numbers["loss"]["Table 2, hard window, roller centred"]
        assert (np.diff(losses[:2], axis=0) == 0.0).all()
        np.testing.assert_allclose(losses[0], [4.19, 1.60], atol=0.01)


@pytest.fixture
def printed_in_series(monkeypatch: pytest.MonkeyPatch):
    """Table 2's law on both raceways, in place of tables of contact solves."""
    monkeypatch.setattr(common, "table_law", lambda raceway="outer": trb.liu2018())
    common.in_series.cache_clear()
    yield
    common.in_series.cache_clear()


@pytest.mark.usefixtures("printed_in_series")
def test_a_spall_costs_the_same_on_any_surface_under_one_roller() -> None:
    """By one law on both raceways. On both at once it costs what it does where one raceway alone is elastic; a roller's
    costs nothing while it faces neither."""
    surfaces = script("12_surfaces")
    size, none = (8.0, 7.0), (0.0, 7.0)
    outer, inner = (surfaces.losses(surface, size, 0.0, 0.0)[0] for surface in surfaces.SURFACES[:2])
    own = surfaces.losses("roller", size, np.array([0.0, np.pi, 0.5 * np.pi]), 0.0)
    np.testing.assert_allclose(own[0], outer, rtol=1e-9)
    np.testing.assert_allclose(own[1], inner, rtol=1e-9)
    np.testing.assert_allclose(own[2], 0.0, atol=1e-9)
    np.testing.assert_allclose(surfaces.losses("inner ring", none, 0.0, 0.0), 0.0, atol=1e-9)
    np.testing.assert_allclose(inner, outer, rtol=0.01)
    both = common.losses_in_series([[8.0, 8.0, 0.0]], [[7.0, 7.0, 7.0]], [[0.0, 0.0, 0.0]])[0]
    np.testing.assert_allclose(both, [7.09, 3.28, 8.78, 3.42], atol=0.005)


def test_contacts_with_a_spall_in_a_turn() -> None:
    """Every roller passes the outer spall or is passed by the inner one; rolling on one apex."""
    passes = script("12_surfaces").passes()
    assert passes["outer ring"] + passes["inner ring"] == pytest.approx(23.0, rel=1e-12)
    assert passes["outer ring"] == pytest.approx(23 * np.sin(0.1949) / (np.sin(0.1949) + np.sin(0.2473)), rel=1e-12)
    assert passes["roller"] == pytest.approx(8.25, abs=0.01)


def test_what_a_spall_costs_by_its_surface() -> None:
    """Both raceways elastic, 8 × 7 mm: no surface differs from another where it stands; an inner one turns away."""
    kept = record("12_surfaces")["numbers"]
    np.testing.assert_allclose(kept["centred"]["outer ring, 8 x 7 mm"], [4.29, 1.98, 5.90, 1.94], rtol=0.01)
    np.testing.assert_allclose(kept["centred"]["inner ring, 8 x 7 mm"], [4.41, 2.04, 6.01, 1.97], rtol=0.01)
    assert kept["surfaces_apart"] < 0.05
    turned = kept["mean_of_turns"]
    assert turned["roller, 8 x 7 mm"][0] < turned["inner ring, 8 x 7 mm"][0] < 0.4 * turned["outer ring, 8 x 7 mm"][0]


def test_several_spalls() -> None:
    """Two that touch are one; apart in a row they sink a roller twice as far as one; under two rollers they add up;
    over one another they rob one roller."""
    kept = record("13_several")["numbers"]
    assert kept["pairs"][0] == pytest.approx(kept["two"], abs=2e-3)
    assert kept["pairs"][-1] - 1.0 == pytest.approx(2.0 * (kept["one"] - 1.0), rel=0.15)
    alone, pair = np.array(kept["alone"]), np.array(kept["pair"])
    np.testing.assert_allclose(pair, alone[0] + alone[1 : 1 + len(pair)], rtol=0.035)
    both, outer, inner = (np.array(kept["passing"][name]) for name in ("both", "outer", "inner"))
    middle = len(both) // 2
    assert both[middle] < 0.96 * (outer + inner)[middle]


def test_page_is_made_of_all_results(tmp_path: Path) -> None:
    claim = common.Claim("the moon is round", common.HOLDS, "nearly")
    row = common.Printed("its distance [km]", "384400", "384000", "384399")
    result = common.Result(
        "A title", common.picture("moon", "the moon"), {"x": np.array([1.0, np.nan])}, (claim,), (row,)
    )
    out = tmp_path / "pictures"
    common.write(result, out, "01_moon")
    assert json.loads((out / "01_moon.json").read_text(encoding="utf-8"))["numbers"] == {"x": [1.0, None]}
    paper.write_page(out, tmp_path / "page.md")
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "| the moon is round | **holds** | nearly |" in text
    assert "### 1. A title\n\n(`experiments/paper/01_moon.py`)\n\n![the moon](pictures/moon.png)" in text
    assert "| its distance [km] | 384400 | 384000 | 384399 |" in text
    assert text.index("## Its tables and figures") < text.index("### 1. A title") < text.index("## Beyond the paper")


def test_page_is_complete() -> None:
    """Every script has its part, every picture is there, every sentence is judged."""
    text = (DOCS / "paper.md").read_text(encoding="utf-8")
    for name in paper.scripts():
        assert record(name)["title"] in text
    pictures = re.findall(r"\]\((paper/\S+\.png)\)", text)
    assert len(pictures) >= 12
    assert all((DOCS / picture).exists() for picture in pictures)
    verdicts = [claim["verdict"] for name in paper.scripts() for claim in record(name)["claims"]]
    assert len(verdicts) >= 15
    assert set(verdicts) <= {common.HOLDS, common.ONLY_IF, common.FAILS}
