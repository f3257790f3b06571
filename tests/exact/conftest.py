"""Fixtures of exact tests."""

from collections.abc import Iterator

import pytest

from difftrb import nodes, store
from tests.closed_form import closed_form


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list]:
    """The solver replaced by the closed form, the cache by an empty folder; the number of solves so far."""
    patch = pytest.MonkeyPatch()
    solves = []
    patch.setattr(nodes, "solved", lambda *a: (solves.append(a), closed_form(*a))[1])
    folder = tmp_path_factory.mktemp("cache")
    patch.setattr(store, "folder", lambda: folder)
    patch.setattr(store, "keeping", True)  # whatever ran before
    yield solves
    patch.undo()
