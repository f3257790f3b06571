"""Where a line load does not describe the contact, and batches that must not stumble."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difftrb as trb
from difftrb import status

CONTACT = trb.LineContact(3.623, 13.66, 113794.5, 3000.0)


@pytest.mark.parametrize(
    ("load", "spall", "design_load", "code"),
    [
        (6000.0, None, 3000.0, status.UNSUITED),  # the roller's ends act as edges
        (1000.0, None, 0.0, status.UNSUITED),  # a straight roller
        (3000.0, trb.Spall(8.0, 7.0), 3000.0, status.UNSUITED),
        (1000.0, trb.Spall(4.0, 0.2), 3000.0, status.UNSUITED),  # rolling edges in reach
        (1000.0, trb.Spall(4.0, 7.0, 0.001), 3000.0, status.UNSUITED),  # its bottom in reach
        (10.0, trb.Spall(13.6, 7.0), 3000.0, status.UNSUITED),  # hardly any land
        (1000.0, trb.Spall(4.0, 7.0, 0.2, 0.0, 5.0), 3000.0, status.UNSUITED),  # over the roller's end
        (-5.0, None, 3000.0, status.BAD_INPUT),
        (float("nan"), None, 3000.0, status.BAD_INPUT),
        (1000.0, trb.Spall(-1.0, 7.0), 3000.0, status.BAD_INPUT),
        (1000.0, trb.Spall(0.05, 7.0), 3000.0, status.CONVERGED),
    ],
)
def test_status_says_where_it_does_not_hold(
    load: float, spall: trb.Spall | None, design_load: float, code: int
) -> None:
    contact = trb.LineContact(3.623, 13.66, 113794.5, design_load)
    assert int(trb.line_contact(contact, load, spall).status_code) == code


def test_a_rolling_edge_in_reach_is_refused() -> None:
    spall = trb.Spall(4.0, 7.0)
    assert int(trb.line_contact(CONTACT, 1000.0, spall, 3.4).status_code) == status.UNSUITED
    near, middle = (trb.line_contact(CONTACT, 1000.0, spall, offset).check() for offset in (3.0, 0.0))
    assert float(near.approach) == float(middle.approach)


def test_too_few_panels_are_refused() -> None:
    with pytest.raises(ValueError, match="panels = 4 is out of range: at least 8"):
        trb.line_contact(CONTACT, 1000.0, None, 0.0, 4)


def test_a_batch_converges_and_is_smooth() -> None:
    """Loads over two decades, in one map: all converge, and the law has no steps where a panel joins in."""
    loads = jnp.geomspace(20.0, 2500.0, 400)

    def one(load: jax.Array) -> tuple[jax.Array, jax.Array]:
        found = trb.line_contact(CONTACT, load, trb.Spall(4.0, 7.0))
        return found.approach, found.status_code

    approaches, codes = jax.jit(lambda q: jax.lax.map(one, q))(loads)
    assert (codes == status.CONVERGED).all()
    slopes = np.diff(np.log(approaches)) / np.diff(np.log(loads))
    assert (np.abs(np.diff(slopes)) < 2e-3).all()
