"""Tests by kind, one folder each: exact, order, gradient, literature, hard, scene."""

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

import difftrb as trb  # noqa: E402


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
