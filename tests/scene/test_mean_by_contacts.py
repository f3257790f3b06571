"""The mean over phases where rollers meet several spalls, a bottom or a map: contacts solved at each of its phases."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.core import status
from difftrb.law.direct_states import DirectByStates
from difftrb.ring import phase_quadrature
from difftrb.scene.cage_phases import nearest_phase, phases
from difftrb.scene.prepared_scene import solve_prepared

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("compiled_as_for_users")]
LOAD = trb.Load(9000.0, 4500.0)
SHALLOW = trb.Spall(6.0, 2.0, depth=4e-3)


@pytest.fixture(scope="module")
def mean(bearing: trb.TaperedBearing) -> trb.Scene:
    return trb.prepare(trb.Scene(bearing, LOAD, (SHALLOW,), law="direct", accuracy=1e-2, phase="mean"))


def test_a_bottom_carries_in_the_mean(mean: trb.Scene) -> None:
    """Less is lost than by a deep spall, and what is audited holds."""
    assert isinstance(mean.law, DirectByStates)
    both = trb.assess(mean)
    assert bool(both.spalled.converged)
    deep = trb.assess(dataclasses.replace(mean, law="table", spalls=(dataclasses.replace(SHALLOW, depth=0.2),)))
    assert 0.2 < float(both.loss[0] / deep.loss[0]) < 0.9
    audit = trb.verify(mean, both.spalled)
    assert audit.kept
    assert audit.load_error < 5e-3


def test_every_phase_is_the_scene_at_that_phase(mean: trb.Scene) -> None:
    """Made for all phases together, or for one of them: the same loads, but for what five solves of a state tell less
    than nine."""
    for angle in (0.0, 0.016):
        at = nearest_phase(mean, angle)
        alone = trb.prepare(dataclasses.replace(at, law="direct"))
        assert np.allclose(solve_prepared(at).loads, solve_prepared(alone).loads, rtol=0.0, atol=0.5)


def test_it_is_the_mean_of_its_phases(mean: trb.Scene) -> None:
    each, weights = phases(mean)
    assert weights.sum() == pytest.approx(1.0)
    assert float(jnp.ptp(trb.solve(mean).stiffness_span[:, 0, 0])) > 1e4
    at = [solve_prepared(nearest_phase(mean, float(phase))).stiffness[0, 0] for phase in each[::5]]
    low, high = trb.solve(mean).stiffness_span[:, 0, 0]
    assert float(low) * (1.0 - 1e-12) <= min(map(float, at))
    assert max(map(float, at)) <= float(high) * (1.0 + 1e-12)


def test_derivatives_by_two_routes(mean: trb.Scene) -> None:
    """Reverse mode through the program against differences of numbers; without its spall the healthy mean is left."""

    def stiffness(scene: trb.Scene) -> jax.Array:
        return solve_prepared(scene).stiffness[0, 0]

    by = jax.jit(jax.grad(stiffness))(mean)
    for name, h in (("length", 1e-4), ("depth", 1e-6), ("width", 1e-4)):

        def at(step: float, name: str = name) -> float:
            spall = dataclasses.replace(SHALLOW, **{name: getattr(SHALLOW, name) + step})
            return float(stiffness(dataclasses.replace(mean, spalls=(spall,))))

        wanted = (at(h) - at(-h)) / (2.0 * h)
        assert float(getattr(by.spalls[0], name)) == pytest.approx(wanted, rel=2e-4, abs=1.0)
    whole = dataclasses.replace(mean, spalls=())
    assert float(stiffness(whole)) == pytest.approx(float(trb.assess(mean).healthy.stiffness[0, 0]), rel=1e-9)


def test_another_scene_is_refused(mean: trb.Scene) -> None:
    wider = (dataclasses.replace(SHALLOW, width=2.3),)
    for other in (
        dataclasses.replace(mean, spalls=wider),
        dataclasses.replace(mean, spalls=(SHALLOW, SHALLOW)),
        dataclasses.replace(mean, phase=0.1),
        dataclasses.replace(mean, load=trb.Load(12000.0, 6000.0)),
    ):
        assert int(solve_prepared(other).status_code) == status.OTHER_SCENE


# ------------------------------------------------------------------------------------------------ height maps


def box(length: float, width: float, depth: float) -> trb.HeightMap:
    """As a rectangular spall, with walls as steep as its grid."""
    return trb.HeightMap(jnp.full((120, 160), -depth), width / 160.0, length / 120.0)


@pytest.fixture(scope="module")
def rimmed(bearing: trb.TaperedBearing) -> trb.Scene:
    """A hole whose rim stands 4 µm out of the raceway."""
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, 40), np.linspace(-1.0, 1.0, 40), indexing="ij")
    away = np.hypot(x, y)
    height = -0.05 * (away < 0.6) + 0.004 * np.exp(-(((away - 0.75) / 0.1) ** 2))
    measured = trb.HeightMap(jnp.asarray(height), 0.06, 0.1)
    return trb.prepare(trb.Scene(bearing, LOAD, (measured,), accuracy=1e-2, phase=0.0))


def test_a_map_of_a_spall_is_the_spall(bearing: trb.TaperedBearing) -> None:
    """On lattices contacts over steep walls are known to 4e-3 at 1e-2."""
    at = trb.Scene(bearing, LOAD, (trb.Spall(4.0, 3.0, depth=0.05),), law="table", phase=0.0)
    one = trb.assess(at)
    other = trb.assess(dataclasses.replace(at, law="direct", accuracy=1e-2, spalls=(box(4.0, 3.0, 0.05),)))
    assert bool(other.spalled.converged)
    largest = float(jnp.max(one.spalled.loads))
    assert float(jnp.max(jnp.abs(one.spalled.loads - other.spalled.loads))) < 5e-3 * largest
    assert float(other.loss[0]) == pytest.approx(float(one.loss[0]), rel=0.05)


def test_a_rim_carries(rimmed: trb.Scene) -> None:
    found = trb.solve(rimmed).check()
    assert isinstance(rimmed.law, DirectByStates)
    audit = trb.verify(rimmed, found)
    assert audit.kept
    assert audit.load_error < 5e-3
    flat = dataclasses.replace(rimmed.spalls[0], height=jnp.minimum(rimmed.spalls[0].height, 0.0))
    without = trb.solve(dataclasses.replace(rimmed, law="direct", spalls=(flat,))).check()
    assert float(found.loads[0]) > float(without.loads[0]) + 1.0


@pytest.mark.parametrize("scale", [7.5, -1.0])
def test_a_high_rim_carries_more_than_any_healthy_roller(scale: float, rimmed: trb.Scene) -> None:
    """It was said that the law was not made for such loads."""
    spall = dataclasses.replace(rimmed.spalls[0], scale=scale)
    ready = trb.prepare(dataclasses.replace(rimmed, law="direct", spalls=(spall,)))
    assert trb.verify(ready, trb.solve(ready).check()).load_error < 1e-2


def test_derivatives_of_a_map_by_two_routes(rimmed: trb.Scene) -> None:
    """By the scale of its heights, its place along the roller, and the load."""

    def stiffness(scale: jax.Array, offset: jax.Array, axial: jax.Array) -> jax.Array:
        spall = dataclasses.replace(rimmed.spalls[0], scale=scale, axial_offset=offset)
        load = dataclasses.replace(LOAD, axial=axial)
        return solve_prepared(dataclasses.replace(rimmed, spalls=(spall,), load=load)).stiffness[0, 0]

    at = (1.0, 0.0, 4500.0)
    by = jax.jit(jax.grad(stiffness, argnums=(0, 1, 2)))(*at)
    for k, h in enumerate((1e-4, 1e-4, 0.1)):
        up, down = (stiffness(*(value + side * h * (i == k) for i, value in enumerate(at))) for side in (1.0, -1.0))
        assert float(by[k]) == pytest.approx(float(up - down) / (2.0 * h), rel=1e-4, abs=1.0)


def test_a_map_in_the_mean(rimmed: trb.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where rollers only just reach the rim from beside it; of few phases, for that takes minutes else."""
    monkeypatch.setattr(phase_quadrature, "POINTS_BY_CONTACTS", 1)
    found = trb.assess(dataclasses.replace(rimmed, law="direct", phase="mean"))
    assert found.spalled.status == "converged"
    assert 0.0 < float(found.loss[0]) < 1.0
