"""The flight is the one that was flown before: whoever changes it on purpose renews the table with `make golden`."""

import pytest

from tests.services import golden

TOLERANCE = 5e-6
"""Other processors round the last bits otherwise; a change of behaviour is larger."""


def test_the_flight_is_the_golden_one(recorded):
    expected, flown = golden.read(), golden.table(recorded)
    assert flown[0] == expected[0], "the table has other columns"
    for before, now in zip(expected[1:], flown[1:], strict=False):
        for name, old, new in zip(expected[0], before, now, strict=True):
            assert same(old, new), f"{name} at {before[0]} s: was {old}, is {new}; if that is meant: make golden"
    assert len(flown) == len(expected), "the flight has another length; if that is meant: make golden"


def same(old: str, new: str) -> bool:
    if old == new:
        return True
    try:
        return float(new) == pytest.approx(float(old), abs=TOLERANCE)
    except ValueError:
        return False
