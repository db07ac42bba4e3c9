"""The stand-in's clock comparison: as little believed at first, and as much later, as PX4's."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.simulator.timesync import WINDOW, ROUND_TRIP_MAX_us, Timesync


def compared(lead_us: float, answers: int, seed: int = 0) -> tuple[Timesync, float]:
    """After so many answers of a companion whose clock leads; and the vehicle's time then."""
    sync, now_us, dice = Timesync(), 1e6, random.Random(seed)
    for _ in range(answers):
        there_us, back_us = dice.uniform(200.0, 2000.0), dice.uniform(200.0, 2000.0)
        sync.take(now_us + there_us + back_us, now_us + there_us + lead_us, now_us)
        now_us += 1e4
    return sync, now_us


@given(lead_us=st.floats(-1e10, 1e10), age_us=st.floats(0.0, 1e6), seed=st.integers(0, 100))
def test_an_age_is_known_to_a_fraction_of_the_round_trip(lead_us: float, age_us: float, seed: int):
    sync, now_us = compared(lead_us, WINDOW, seed)
    assert sync.age_s(now_us - age_us + lead_us, now_us) == pytest.approx(age_us * 1e-6, abs=2e-4)


def test_a_stamp_is_not_believed_before_the_window_is_full():
    sync, now_us = compared(5e6, WINDOW - 1)
    assert not sync.converged
    assert sync.age_s(now_us - 1e5 + 5e6, now_us) == 0.0


def test_slow_answers_do_not_count_and_a_clock_that_jumps_is_compared_anew():
    sync, now_us = compared(0.0, WINDOW)
    before = sync.answers
    sync.take(now_us + ROUND_TRIP_MAX_us + 1.0, now_us, now_us)
    assert sync.answers == before
    for _ in range(11):
        sync.take(now_us + 1000.0, now_us + 3e6, now_us)
    assert not sync.converged
