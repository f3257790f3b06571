"""Tests lie in rooms as the package does; their kinds are markers: exact, order, gradient, literature, hard."""

from collections.abc import Iterator
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

import difftrb as trb
from difftrb.core import storage
from difftrb.law import samples
from tests.closed_form import closed_form

MAPS = Path("/proc/self/maps")


@pytest.fixture(scope="module", autouse=True)
def _few_programs() -> Iterator[None]:
    """Each compiled program takes some of the 65 530 memory maps Linux grants a process; without, compiling crashes."""
    yield
    if MAPS.exists() and len(MAPS.read_bytes().splitlines()) > 25_000:
        jax.clear_caches()


@pytest.fixture(scope="session")
def bearing() -> trb.TaperedBearing:
    return trb.bearing("32008J")


@pytest.fixture(scope="session")
def contact(bearing: trb.TaperedBearing) -> trb.LineContact:
    return trb.LineContact.of(bearing, "outer", design_load=6500.0)


@pytest.fixture(scope="session")
def power(contact: trb.LineContact) -> trb.PowerLaw:
    """A law fitted once for all tests, for the roller loads of 9000/4500 N."""
    return trb.power_law(contact, (270.0, 1970.0), accuracy=1e-2)


@pytest.fixture(scope="session")
def scene(bearing: trb.TaperedBearing, power: trb.PowerLaw) -> trb.Scene:
    """The main job's bearing, load and spall, with a prepared law."""
    return trb.Scene(bearing, trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),), law=power)


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list]:
    """The solver replaced by the closed form, the cache by an empty folder; the number of solves so far."""
    patch = pytest.MonkeyPatch()
    solves = []
    patch.setattr(samples, "solved", lambda *a: (solves.append(a), closed_form(*a))[1])
    folder = tmp_path_factory.mktemp("cache")
    patch.setattr(storage, "folder", lambda: folder)
    patch.setattr(storage, "keeping", True)  # whatever ran before
    yield solves
    patch.undo()
