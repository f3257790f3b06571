"""Where the stress intensity at a spall's ends is refused."""

import pytest

import difftrb as trb

pytestmark = pytest.mark.hard


@pytest.mark.parametrize(
    ("load", "spall", "offset", "expected"),
    [
        (2500.0, trb.Spall(4.0, 7.0), 3.4, "cannot"),  # a rolling edge in the contact
        (2500.0, trb.Spall(4.0, 7.0, 0.003), 0.0, "cannot"),  # the roller reaches the bottom
        (2500.0, trb.Spall(13.5, 7.0), 0.0, "cannot"),  # hardly any land
        (-1.0, trb.Spall(4.0, 7.0), 0.0, "outside its range"),
        (float("nan"), trb.Spall(4.0, 7.0), 0.0, "outside its range"),
        (2500.0, trb.Spall(4.0, 7.0), 0.1, "converged"),
    ],
)
def test_status_says_where_it_does_not_hold(
    contact: trb.LineContact, load: float, spall: trb.Spall, offset: float, expected: str
) -> None:
    assert expected in trb.edge_intensity(contact, load, spall, offset, 32, 16).status


def test_grid_that_is_too_coarse_is_refused(contact: trb.LineContact) -> None:
    with pytest.raises(ValueError, match="land = 8 is out of range: at least 32"):
        trb.edge_intensity(contact, 2500.0, trb.Spall(4.0, 7.0), land=8)
    with pytest.raises(ValueError, match="columns = 8 is out of range: at least 16"):
        trb.edge_intensity(contact, 2500.0, trb.Spall(4.0, 7.0), columns=8)
