"""The line load as its panels shrink."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difftrb import line
from difftrb.geometry import LineContact, Spall

CONTACT = LineContact(3.623, 13.66, 113794.5, 3000.0)


@pytest.mark.parametrize("spall", [None, Spall(4.0, 7.0)])
def test_approach_converges_faster_than_first_order(spall: Spall | None) -> None:
    """Root mean square over loads, since the number of loaded panels is whole."""

    def approaches(panels: int) -> np.ndarray:
        loads = jnp.linspace(400.0, 900.0, 6)
        return np.asarray(
            jax.jit(lambda q: jax.lax.map(lambda one: line.line_contact(CONTACT, one, spall, 0.0, panels).approach, q))(
                loads
            )
        )

    fine = approaches(96)
    coarse, middle = (np.sqrt(np.mean((approaches(panels) / fine - 1.0) ** 2)) for panels in (8, 24))
    assert np.log(coarse / middle) / np.log(3.0) > 1.2
    assert middle < 2e-4
