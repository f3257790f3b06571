"""Height maps that are no maps, and maps that are hard to stand on."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import cell_solve, contact_cells, contact_extent
from difftrb.contact.height_map import load_height_map
from difftrb.core import status

pytestmark = pytest.mark.hard

GOOD = {"height": np.array([[0.0, -0.1, 0.0], [0.0, -0.2, 0.0]]), "pitch_x": 0.1, "pitch_y": 0.2}
NAN = np.array([[0.0, 1.0], [np.nan, 2.0]])
# what replaces an entry of a good file, and what the sentence has to name
BAD = {
    "no heights": ({"height": None}, "height is missing: give"),
    "no pitch": ({"pitch_y": None}, "pitch_y is missing: give"),
    "pitch of nothing": ({"pitch_x": 0.0}, "pitch_x = 0.0: must be a number in 1e-05 … 10 mm"),
    "pitch below nothing": ({"pitch_y": -0.1}, "pitch_y = -0.1: must be a number in 1e-05 … 10 mm"),
    "pitch that is no number": ({"pitch_x": np.nan}, "pitch_x = nan: must be a number in"),
    "one row": ({"height": np.array([[1.0, 2.0, 3.0]])}, "height has shape (1, 3): must be a grid of at least 2 × 2"),
    "not measured": ({"height": NAN}, "height[1, 0] = nan (1 such points): must be finite"),
    "flat": ({"height": np.full((3, 3), 0.1)}, "height is 0.1 mm everywhere: a map must not be constant"),
    "micrometres": ({"height": 1e3 * GOOD["height"]}, "height[1, 1] = -200: must be in -10 … 10 mm"),
}


def write(folder: Path, kind: str, content: dict) -> Path:
    path = folder / f"map.{kind}"
    content = {key: value for key, value in content.items() if value is not None}
    if kind == "npz":
        np.savez(path, **content)
        return path
    lines = [f"# {key} = {value}" for key, value in content.items() if key != "height"]
    lines += [",".join(map(str, row)) for row in content.get("height", [])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", ["npz", "csv"])
def test_good_files_are_read(tmp_path: Path, kind: str) -> None:
    m = load_height_map(write(tmp_path, kind, GOOD), axial_offset=0.5, surface="inner")
    np.testing.assert_array_equal(m.height, GOOD["height"])
    assert (m.pitch_x, m.pitch_y, m.axial_offset, m.angle, m.surface) == (0.1, 0.2, 0.5, 0.0, "inner")


@pytest.mark.parametrize("kind", ["npz", "csv"])
@pytest.mark.parametrize("name", BAD)
def test_bad_files_get_one_sentence(tmp_path: Path, kind: str, name: str) -> None:
    change, words = BAD[name]
    path = write(tmp_path, kind, GOOD | change)
    if (kind, name) == ("csv", "no heights"):
        words = "height has shape (0,): must be a grid"
    with pytest.raises(trb.HeightMapError) as caught:
        load_height_map(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}: ")
    assert words in sentence
    assert "\n" not in sentence


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    contents = {
        "none.npz": (None, "there is no such file"),
        "text.npz": (b"0.1, 0.2", "is not an npz file of plain arrays"),
        "empty.npz": (b"", "is not an npz file of plain arrays"),
        "map.txt": (b"0.1, 0.2", "must be a file .npz or .csv"),
        "ragged.csv": (b"# pitch_x = 1\n0,1\n0,1,2\n", "line 3 has 3 heights, the first row 2"),
        "words.csv": (b"0,1\n0,one\n", "line 2 holds no number"),
        "binary.csv": (b"\xff\xfe\x00", "is not a text file in UTF-8"),
    }
    for name, (content, words) in contents.items():
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(trb.HeightMapError, match=words):
            load_height_map(tmp_path / name)
    objects = tmp_path / "objects.npz"
    np.savez(objects, height=np.array([[{}]], dtype=object), pitch_x=1.0, pitch_y=1.0)
    with pytest.raises(trb.HeightMapError, match="plain arrays"):
        load_height_map(objects)
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(trb.HeightMapError, match="is a directory"):
        load_height_map(tmp_path / "folder.csv")
    with pytest.raises(trb.HeightMapError, match="no such file"):
        trb.example_map("../spall_map.npz")


def test_spikes_carry_the_roller(contact: trb.LineContact) -> None:
    """Two bumps of 30 µm hold a light roller off the raceway; a single one in a heavy contact takes a part."""
    height = np.zeros((61, 21))
    height[[5, -6], 10] = 0.03
    bumps = trb.HeightMap(jnp.asarray(height), 0.05, 0.2)
    light = trb.solve_contact(contact, 5.0, bumps, 0.0, 1e-2).check()
    assert float(light.approach) < -0.02
    places = np.abs(np.asarray(light.cells.y)[np.asarray(light.force > 0.0).any(axis=1)])
    np.testing.assert_allclose(places, 5.0, atol=0.2)
    heavy = trb.solve_contact(contact, 20000.0, bumps, 0.0, 1e-2).check()
    healthy = trb.solve_contact(contact, 20000.0, None, 0.0, 1e-2, "lattice").check()
    assert float(heavy.approach) < float(healthy.approach)
    assert float(heavy.peak_pressure) > 1.5 * float(healthy.peak_pressure)


def test_the_roller_touches_the_bottom_of_a_shallow_map(contact: trb.LineContact) -> None:
    deep = load_height_map(trb.example_map())
    shallow = trb.HeightMap(0.01 * deep.height, deep.pitch_x, deep.pitch_y)
    s = trb.solve_contact(contact, 3000.0, shallow, 0.0, 1e-2).check()
    pit = s.force[jnp.abs(s.cells.y) < 0.5]
    assert float(jnp.min(jnp.sum(pit, axis=1))) > 0.0
    without = trb.solve_contact(contact, 3000.0, deep, 0.0, 1e-2).check()
    assert float(s.approach) < float(without.approach)
    assert float(jnp.sum(without.force[jnp.abs(without.cells.y) < 0.5])) == 0.0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_heights_that_are_no_numbers_are_flagged(contact: trb.LineContact, value: float) -> None:
    m = load_height_map(trb.example_map())
    broken = trb.HeightMap(m.height.at[3, 4].set(value), m.pitch_x, m.pitch_y)
    assert "not a number" in trb.solve_contact(contact, 3000.0, broken, 0.0, 1e-2).status
    nowhere = trb.HeightMap(m.height, 0.0, m.pitch_y)
    assert "not a number" in trb.solve_contact(contact, 3000.0, nowhere, 0.0, 1e-2).status


@pytest.mark.slow
def test_a_lattice_that_cuts_the_contact_is_noticed(contact: trb.LineContact, monkeypatch) -> None:
    whole = {name: getattr(contact_extent, name) for name in ("domain", "domain_of_any")}
    m = load_height_map(trb.example_map())
    for cut in (lambda x, low, high: (0.4 * x, low, high), lambda x, low, high: (x, 0.6 * low, high)):
        for name, found in whole.items():
            monkeypatch.setattr(contact_cells, name, lambda *a, cut=cut, found=found: cut(*found(*a)))
        cell_solve.solve.clear_cache()
        try:
            for case in ((None, 0.0), (m, 0.5)):
                s = trb.solve_contact(contact, 3000.0, *case, 1e-2, "lattice")
                assert int(s.status_code) == status.TOUCHES_BORDER
        finally:
            cell_solve.solve.clear_cache()


def test_a_rim_may_press_before_the_raceway(contact: trb.LineContact) -> None:
    """A ridge of 20 µm beside the roller's middle, under a load that sinks it by less: the lattice reaches out to it,
    and the roller stands above the raceway."""
    x = np.linspace(-0.1, 0.1, 21)
    ridge = trb.HeightMap(jnp.asarray(np.tile(0.02 * (1.0 - (x / 0.11) ** 2), (30, 1))), 0.01, 0.5)
    approaches = []
    for away in (0.0, 0.25, 0.33, 0.6):
        s = trb.solve_contact(contact, 200.0, ridge, away, 1e-2)
        assert s.status == "converged"
        approaches.append(float(s.approach))
    healthy = float(trb.solve_contact(contact, 200.0).approach)
    assert approaches == sorted(approaches)
    assert approaches[0] < -0.015
    assert approaches[-1] == pytest.approx(healthy, rel=1e-2)


def test_flat_margins_move_no_wall() -> None:
    """Phases of a mean are laid between the walls of what is in a map, not between its borders."""

    def pit(margin: int) -> trb.HeightMap:
        height = np.zeros((17, 9 + 2 * margin))
        height[1:-1, margin + 1 : margin + 8] = -0.02
        return trb.HeightMap(jnp.asarray(height), 0.25, 0.5)

    walls = np.asarray(pit(0).walls)
    assert np.allclose(walls, pit(12).walls, atol=1e-9)
    assert np.all(np.abs(np.abs(walls[:2]) - 1.0) < 1e-3)
    assert np.all(np.diff(walls[2:]) > 0.0)
    assert np.allclose(walls, -np.asarray(pit(3).walls)[[1, 0, *range(len(walls) - 1, 1, -1)]], atol=1e-9)


@pytest.mark.slow
def test_a_roller_that_drops_in_meets_the_wall(contact: trb.LineContact) -> None:
    """Under light loads it stands aside, on the wall's upper edge, far beyond a healthy contact's width."""
    height = np.zeros((17, 13))
    height[1:-1, 1:-1] = -0.05
    pit = trb.HeightMap(jnp.asarray(height), 0.25, 0.6)
    for load, away in ((10.0, 1.42), (50.0, 1.40), (200.0, 1.36), (1000.0, 1.30)):
        assert trb.solve_contact(contact, load, pit, away, 1e-2).status == "converged"


def test_what_does_not_fit_together_is_refused(contact: trb.LineContact) -> None:
    m, spall = load_height_map(trb.example_map()), trb.Spall(2.0, 1.0)
    with pytest.raises(ValueError, match="method = 'cells' does not take height maps; use 'lattice'"):
        trb.solve_contact(contact, 100.0, m, method="cells")
    with pytest.raises(ValueError, match="method = 'strips' takes at most one spall inside jit"):
        jax.jit(lambda load: trb.solve_contact(contact, load, (spall, spall), method="strips"))(100.0)
    with pytest.raises(ValueError, match=r"offset has shape \(3,\) for 2 spalls"):
        trb.solve_contact(contact, 100.0, (spall, spall), (0.0, 0.1, 0.2))
    with pytest.raises(ValueError, match="one spall has one offset"):
        trb.solve_contact(contact, 100.0, spall, (0.0, 0.1))
