"""Mutated files and random scenes in small; in full by `python -m experiments.stability files scenes contacts`."""

import dataclasses

import numpy as np
import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.scene import scene_file
from experiments.stability import mutations, random_contacts, scenes
from experiments.stability.scenes import KINDS

pytestmark = pytest.mark.hard


def test_mutated_files_are_accepted_or_refused_in_one_sentence() -> None:
    found = mutations.run(400, 1)
    assert not found["wrong"], found["wrong"][0]
    assert found["verdicts"]["accepted"] > 10
    assert found["verdicts"]["refused"] > 200
    assert len(found["by_change"]) == len(mutations.SCENES) + len(mutations.TABLES) + 2  # and bytes that are no text


def test_what_is_unfair_is_noticed(tmp_path) -> None:
    """The judge itself: a sentence without a file, without a key, over two lines, without end."""
    path, file = tmp_path / "scene.toml", mutations.File((), b"", True)
    assert mutations.is_fair(f"{path}: load.radial = -1.0: must be a number", path, file)
    for sentence in ("load.radial is wrong", f"{path}: it is wrong", f"{path}: load\n", f"{path}: load {'x' * 700}"):
        assert not mutations.is_fair(sentence, path, file)


@pytest.fixture(scope="module")
def counts() -> dict:
    """One kind of scene: the programs of the others take as long to compile again."""
    kinds = scenes.KINDS
    scenes.KINDS = kinds[:1]
    try:
        return scenes.run(500, seed=7)
    finally:
        scenes.KINDS = kinds


def test_random_scenes_are_solved_or_flagged(counts: dict) -> None:
    assert counts["scenes"] == 500
    refused = sum(counts["statuses"].get(status.describe(code), 0) for code in (status.BOTTOM, status.SEVERAL))
    assert counts["converged"] + refused >= 499
    assert counts["converged"] > 100
    assert counts["nan_values"] == counts["nan_gradients"] == counts["unflagged"] == 0


@pytest.mark.parametrize("kind", KINDS)
def test_random_scenes_are_such_as_a_file_may_hold(kind: scenes.Kind) -> None:
    many = scenes.random_scenes(kind, 20, 3)
    for k in range(20):

        def at(value, k=k):
            return float(np.asarray(value)[k])

        bearing = dataclasses.replace(
            many.bearing, **{f.name: at(getattr(many.bearing, f.name)) for f in dataclasses.fields(many.bearing)
                             if f.name not in ("rollers", "arc_radius")}
        )  # fmt: skip
        spalls = [
            {f: at(getattr(s, f)) for f in ("length", "width", "depth", "angle", "axial_offset")} for s in many.spalls
        ]
        content = {
            "bearing": {k: v for k, v in dataclasses.asdict(bearing).items() if v is not None},
            "load": {"radial": at(many.load.radial), "axial": at(many.load.axial)},
            "contact": {"law": kind.law}, "stiffness": {"phase": at(many.phase), "definition": kind.definition},
            "spall": [s | {"length": max(s["length"], 0.01), "width": max(s["width"], 0.01)} for s in spalls],
        }  # fmt: skip
        scene_file.check_ring(scene_file.from_content(content, "scene"), "scene")


def test_scenes_that_are_not_in_equilibrium_are_noticed() -> None:
    """The check itself, by loads that are a little off."""
    scene = trb.Scene(trb.bearing("32008J"), trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law="liu2018")
    r = trb.solve(scene)
    stacked = scenes.jax.tree.map(lambda v: np.asarray(v)[None], (scene.bearing, scene.load))
    many = dataclasses.replace(scene, bearing=stacked[0], load=stacked[1])
    result = scenes.jax.tree.map(lambda v: np.asarray(v)[None], r)
    assert float(scenes.kkt(many, result)[0]) < 1e-12
    off = dataclasses.replace(result, loads=result.loads * (1.0 + 1e-6))
    assert float(scenes.kkt(many, off)[0]) > 1e-7


@pytest.mark.slow
def test_random_contacts_are_solved_or_flagged() -> None:
    found = random_contacts.run(50, seed=3)
    assert found["nan_values"] == found["nan_gradients"] == found["unflagged"] == 0
    assert found["converged"] > 40
