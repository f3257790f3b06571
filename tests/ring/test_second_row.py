"""Spalls on a second row: what they do is what one on the first row does, seen in a mirror."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.ring import effects

PURE = trb.Load(9000.0, 0.0)
"""Radial alone, so that both rows are mirror images."""
FIRST, SECOND = (trb.Spall(4.0, 7.0, angle=0.02, row=row) for row in (1, 2))


def scene(bearing, spalls, law: str, load=PURE, phase=0.05, **more) -> trb.Scene:
    return trb.Scene(bearing, load, spalls, law, phase=phase, effects=(effects.DoubleRow(0.01, **more),))


@pytest.mark.slow
@pytest.mark.exact
@pytest.mark.parametrize(("law", "phase"), [("liu2018", "mean"), ("table", 0.05), ("direct", 0.05)])
def test_it_is_the_mirror_image_of_one_on_the_first_row(bearing, law: str, phase) -> None:
    first, second = (
        trb.solve(scene(bearing, (spall,), law, phase=phase, spacing=30.0)).check() for spall in (FIRST, SECOND)
    )
    largest = float(jnp.max(first.loads))
    np.testing.assert_allclose(second.effects["second_row_loads"], first.loads, atol=1e-9 * largest)
    np.testing.assert_allclose(second.loads, first.effects["second_row_loads"], atol=1e-9 * largest)
    assert np.max(np.abs(np.asarray(second.loads - first.loads))) > 1e-2 * largest  # the rows are not alike
    np.testing.assert_allclose(first.both_stiffnesses, second.both_stiffnesses, rtol=1e-9)
    if law != "liu2018":  # derivatives by the table: below
        return
    found = [trb.assess(scene(bearing, (spall,), law, phase=phase, spacing=30.0)) for spall in (FIRST, SECOND)]
    for name in ("loss", "by_length", "by_width"):
        one, other = (np.asarray(getattr(each, name)) for each in found)
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9)
    assert float(found[0].loss[0]) > 0.5


@pytest.mark.slow
@pytest.mark.exact
def test_one_on_each_row_at_the_same_angle_is_under_no_common_roller(bearing) -> None:
    both, one, none = (
        trb.solve(scene(bearing, spalls, "liu2018")).check() for spalls in ((FIRST, SECOND), (FIRST,), ())
    )
    np.testing.assert_allclose(both.loads, both.effects["second_row_loads"], rtol=1e-9)
    lost = [float(1.0 - each.radial_stiffness / none.radial_stiffness) for each in (both, one)]
    assert lost[0] == pytest.approx(2.0 * lost[1], rel=0.1)


@pytest.mark.slow
@pytest.mark.exact
def test_contacts_solved_afresh_confirm_both(bearing) -> None:
    ready = trb.prepare(scene(bearing, (FIRST, SECOND), "direct"))
    audit = trb.verify(ready)
    assert audit.load_error < 1e-3
    assert {each.spalls for each in audit.rollers} >= {(0,), (1,)}
    assert max(each.roller for each in audit.rollers) >= bearing.rollers  # of both rows


@pytest.mark.slow
@pytest.mark.gradient
def test_derivatives_are_differences(bearing) -> None:
    wide = trb.prepare(scene(bearing, (SECOND,), "table", trb.Load(9000.0, 1500.0), 0.11))

    def stiffness(v: jax.Array) -> jax.Array:
        return trb.solve(wide.replace(spalls=(trb.Spall(v[0], v[1], angle=v[2], row=2),))).radial_stiffness

    at, both = jnp.array([4.0, 7.0, 0.02]), jax.jit(jax.value_and_grad(stiffness))
    _, slopes = both(at)
    for i, step in enumerate((1e-4, 1e-4, 1e-5)):
        ahead, behind = (both(at.at[i].add(side * step))[0] for side in (1.0, -1.0))
        assert float(slopes[i]) == pytest.approx(float(ahead - behind) / (2.0 * step), rel=1e-4, abs=0.1)
    assert float(slopes[0]) < -1e3


def test_it_needs_a_second_row(bearing) -> None:
    with pytest.raises(trb.SceneError, match=r"spall\.0\.row = 2: needs the effect double_row"):
        trb.solve(trb.Scene(bearing, PURE, (SECOND,), "liu2018"))
