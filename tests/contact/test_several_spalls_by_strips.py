"""Several spalls under one roller by strips: as cells have it, as one where they are one, and their derivatives."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import difftrb as trb
from difftrb.contact import solver, strip_reach
from difftrb.contact.contact_solution import given
from difftrb.core import status

LOAD, WIDE = 3000.0, 30.0
PAIR = trb.Spall(3.0, 1.0, axial_offset=-3.0), trb.Spall(2.5, 1.2, axial_offset=2.5)
OFFSETS = 0.3, -0.4  # a rolling edge of either is in the contact
INSIDE = tuple(dataclasses.replace(spall, width=WIDE) for spall in PAIR)


def approach(contact: trb.LineContact, spalls: Any, offsets: Any, accuracy: float, **how: Any) -> float:
    return float(trb.solve_contact(contact, LOAD, spalls, offsets, accuracy, **how).check().approach)


@pytest.mark.parametrize(("spalls", "offsets"), [(INSIDE, 0.0), (PAIR, OFFSETS)], ids=["out of reach", "edges"])
@pytest.mark.parametrize("tilt", [0.0, 3e-4])
def test_every_accuracy_keeps_its_promise(contact: trb.LineContact, spalls: Any, offsets: Any, tilt: float) -> None:
    finest = approach(contact, spalls, offsets, 1e-4, method="strips", tilt=tilt)
    for accuracy in (1e-2, 1e-3):
        found = approach(contact, spalls, offsets, accuracy, method="strips", tilt=tilt)
        assert found == pytest.approx(finest, rel=accuracy)


def test_cells_say_the_same(contact: trb.LineContact) -> None:
    by_cells = approach(contact, PAIR, OFFSETS, 1e-3, method="cells")
    assert approach(contact, PAIR, OFFSETS, 1e-3) == pytest.approx(by_cells, rel=1e-3)


def test_spalls_are_sorted_merged_and_left_out(contact: trb.LineContact) -> None:
    alone = approach(contact, INSIDE[0], 0.0, 1e-4, method="strips")
    far = dataclasses.replace(PAIR[1], width=0.5)
    assert approach(contact, (far, INSIDE[0]), (4.0, 0.0), 1e-4, method="strips") == alone
    parts = [trb.Spall(2.0, WIDE, axial_offset=middle) for middle in (-2.0, -4.0, -3.3)]
    assert approach(contact, tuple(parts), 0.0, 1e-4, method="strips") == pytest.approx(
        approach(contact, trb.Spall(4.0, WIDE, axial_offset=-3.0), 0.0, 1e-4, method="strips"), rel=1e-12
    )
    there = approach(contact, PAIR, OFFSETS, 1e-3, method="strips")
    assert approach(contact, PAIR[::-1], OFFSETS[::-1], 1e-3, method="strips") == pytest.approx(there, rel=1e-12)


@pytest.mark.parametrize(
    ("spalls", "offsets"),
    [
        ((PAIR[0], dataclasses.replace(PAIR[1], axial_offset=-1.0)), OFFSETS),  # overlap, with edges in reach
        ((PAIR[0], dataclasses.replace(PAIR[1], axial_offset=-0.2)), OFFSETS),  # a ridge
        ((INSIDE[0], dataclasses.replace(INSIDE[1], depth=5e-3)), 0.0),  # a bottom that carries
    ],
    ids=["overlap", "ridge", "bottom"],
)
def test_what_strips_do_not_know_goes_to_cells(contact: trb.LineContact, spalls: Any, offsets: Any) -> None:
    inputs, mirrored, _ = given(contact, LOAD, spalls, offsets, 0.0, "auto")
    assert not strip_reach.judged(inputs, mirrored).fits
    by_strips = trb.solve_contact(contact, LOAD, spalls, offsets, 1e-2, "strips")
    assert int(by_strips.status_code) == status.UNSUITED
    assert bool(trb.solve_contact(contact, LOAD, spalls, offsets, 1e-2).converged)


@pytest.mark.parametrize(
    ("spalls", "offsets", "accuracy", "tilt"),
    [(INSIDE, (0.0, 0.0), 1e-4, 0.0), (INSIDE, (0.0, 0.0), 1e-4, 3e-4), (PAIR, OFFSETS, 1e-3, 3e-4)],
    ids=["out of reach", "tilted", "edges"],
)
def test_gradient_matches_central_differences(
    contact: trb.LineContact, spalls: Any, offsets: Any, accuracy: float, tilt: float
) -> None:
    def at(load: float = LOAD, spalls: Any = spalls, offsets: Any = offsets, tilt: float = tilt) -> np.ndarray:
        found = trb.solve_contact(contact, load, spalls, offsets, accuracy, "strips", tilt).check()
        return np.array([float(found.approach), float(found.moment)])

    _, *rates = solver.approach_and_gradient(contact, LOAD, spalls, offsets, accuracy, "strips", tilt, moment=True)
    step = 2e-3

    def compare(rate: list[Any], before: np.ndarray, after: np.ndarray, size: float) -> None:
        least = [3e-3 * float(at()[0]) / size, 1e-2 * LOAD]  # of derivatives that are next to nothing
        for own, slope, small in zip(rate, (after - before) / (2.0 * step * size), least, strict=True):
            assert float(own) == pytest.approx(slope, rel=2e-2, abs=small)

    compare([rate.load for rate in rates], at(LOAD * (1 - step)), at(LOAD * (1 + step)), LOAD)
    for i, spall in enumerate(spalls):
        for name in ("length", "width", "axial_offset"):
            own = [getattr(rate.spall[i], name) for rate in rates]
            moved = [
                tuple(
                    dataclasses.replace(s, **{name: getattr(s, name) + way * step}) if s is spall else s for s in spalls
                )
                for way in (-1.0, 1.0)
            ]
            compare(own, at(spalls=moved[0]), at(spalls=moved[1]), 1.0)
        places = [tuple(o + way * step * (j == i) for j, o in enumerate(offsets)) for way in (-1.0, 1.0)]
        compare([rate.offset[i] for rate in rates], at(offsets=places[0]), at(offsets=places[1]), 1.0)
    if tilt:
        both = at(tilt=tilt * (1 - step)), at(tilt=tilt * (1 + step))
        compare([rate.tilt for rate in rates], *both, tilt)


def test_a_shallow_spall_between_two_deep_ones_counts(contact: trb.LineContact) -> None:
    """It joins them to one hollow, and its bottom carries."""
    places = (-2.5, 1.5, 0.2), (0.0, 4.0, 4e-3), (2.5, 1.5, 0.2)
    spalls = tuple(trb.Spall(length, WIDE, depth, axial_offset=middle) for middle, length, depth in places)
    inputs, mirrored, _ = given(contact, LOAD, spalls, 0.0, 0.0, "auto")
    found = strip_reach.judged(inputs, mirrored)
    assert [set(parts) for parts in found.beneath.hollows] == [{0, 1, 2}]
    assert not found.fits


def test_land_beyond_the_contact_carries_nothing(contact: trb.LineContact) -> None:
    """Under a light load the second spall and the land before it are beyond the contact's end, in the first one."""
    light, near = 30.0, trb.Spall(3.0, WIDE, axial_offset=3.0)
    both = near, trb.Spall(1.0, WIDE, axial_offset=5.6)
    found = [float(trb.solve_contact(contact, light, s, 0.0, 1e-3, "strips").check().approach) for s in (near, both)]
    assert found[1] == pytest.approx(found[0], rel=1e-5)
