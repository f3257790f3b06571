"""Every hazard of the list that the page docs/stability.md is made from: what it ends as, and its derivatives."""

import pytest

from experiments.stability import cases
from experiments.stability.cases import Found
from experiments.stability.hazards import CONTACTS, RINGS

pytestmark = [pytest.mark.hard, pytest.mark.slow]

OFF = 1e-3
"""Of a derivative from a difference over 1e-5 of an input; where a hundredth of that is met, too, the page says."""


@pytest.fixture(scope="module")
def found() -> dict[str, Found]:
    """All contacts in one batch, all rings in one for every number of rollers."""
    rows = [(f"contact: {f.name}", f) for f in cases.contacts()] + [(f"ring: {f.name}", f) for f in cases.rings()]
    assert len(dict(rows)) == len(rows)
    return dict(rows)


@pytest.mark.parametrize("name", [f"contact: {h.name}" for h in CONTACTS] + [f"ring: {h.name}" for h in RINGS])
def test_hazard(found: dict[str, Found], name: str) -> None:
    one = found[name]
    assert one.will_do, one
    if one.status == 0:
        assert one.residual <= 1e-9
        assert one.finite, one
        assert one.error < OFF, one
