"""Power laws: printed, fitted, and Palmgren's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb.law import base
from difftrb.law.power import Palmgren

pytestmark = pytest.mark.exact


def loads_over(roller_law: base.Law, lengths: jax.Array, approach: float) -> jax.Array:
    """Loads of rollers in the middle of spalls of these lengths."""

    def one(length: jax.Array) -> jax.Array:
        return base.load_over(roller_law, jnp.asarray(approach), trb.Spall(length, 10.0))[0]

    return jax.vmap(one)(lengths)


@pytest.mark.portable
def test_liu2018_is_table_2_verbatim() -> None:
    K, n = trb.liu2018().coefficients(jnp.array([0.0, 2.0, 4.0, 6.0, 8.0]))
    np.testing.assert_allclose(K, [9.386e5, 9.052e5, 8.270e5, 7.469e5, 6.162e5], rtol=1e-13)
    np.testing.assert_allclose(n, [1.201, 1.215, 1.231, 1.244, 1.262], rtol=1e-13)


def test_liu2018_softens_monotonically_between_its_rows() -> None:
    """But for a rise of less than 1e-5 below 0.1 mm at loads near 10 kN, where the printed digits run out."""
    lengths = jnp.linspace(0.0, 8.0, 161)
    for approach in (1e-3, 5e-3, 2e-2):
        loads = loads_over(trb.liu2018(), lengths, approach)
        assert jnp.all(jnp.diff(loads[2:]) < 0.0)
        assert jnp.all(jnp.diff(loads[:3]) < 1e-5 * loads[0])


def test_fitted_law_keeps_the_error_it_states(contact: trb.LineContact, power: trb.PowerLaw) -> None:
    """On loads and lengths that neither the fit nor its own check has seen."""
    low, high = power.load_range
    for load, length in [(low * 1.1, 3.3), (float(low * high) ** 0.5, 7.1), (high / 1.1, 10.2), (high / 1.7, 0.4)]:
        solution = trb.solve_contact(contact, load, trb.Spall(length, 10.0), accuracy=1e-3)
        predicted = loads_over(power, jnp.array([length]), float(solution.approach))
        assert abs(float(predicted[0] / load) - 1.0) < float(power.error) + 5e-3
    assert 0.01 < float(power.error) < 0.1


def test_fitted_law_over_the_papers_loads_has_the_papers_error(contact: trb.LineContact) -> None:
    """1.5 … 10 kN: about 2.2 %, as in Table 2; K and n of the healthy roller within the clipping's 6 %."""
    fitted = trb.power_law(contact, accuracy=1e-2)
    assert 0.015 < float(fitted.error) < 0.03
    K, n = fitted.coefficients(jnp.zeros(()))
    assert float(K) == pytest.approx(9.386e5, rel=0.08)
    assert float(n) == pytest.approx(1.201, abs=0.01)


def test_a_longer_spall_never_carries_more(power: trb.PowerLaw) -> None:
    lengths = jnp.linspace(0.0, float(power.lengths[-1]), 60)
    loads = loads_over(power, lengths, 5e-3)
    assert jnp.all(jnp.diff(loads) < 0.0)


@pytest.mark.portable
def test_palmgren_inverts_its_approach() -> None:
    from difftrb.contact.gap import palmgren_approach

    load = loads_over(Palmgren(13.66), jnp.array([3.0]), float(palmgren_approach(1234.0, 13.66 - 3.0)))
    assert float(load[0]) == pytest.approx(1234.0, rel=1e-12)


def test_load_is_zero_clear_of_the_raceway(power: trb.PowerLaw) -> None:
    assert [float(v) for v in base.load_over(power, jnp.asarray(-1e-3))] == [0.0, 0.0]


def test_laws_that_do_not_exist_say_so(contact: trb.LineContact, bearing) -> None:
    with pytest.raises(ValueError, match="law = 'hertzian' is unknown"):
        trb.solve(trb.Scene(bearing, trb.Load(9000.0, 4500.0), law="hertzian"))
