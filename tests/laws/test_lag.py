"""The mean delay from the force to the set-point: a moment is forgiven, a second is not, and what is over is soon forgotten."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.safety_supervisor.lag import LATE_S, MOST_S, TAU_S, step

DT = 0.02


def after(*ages_s: float, lag_s: float = 0.0) -> float:
    for age_s in ages_s:
        lag_s = step(lag_s, age_s, DT)
    return lag_s


@given(st.floats(0.0, 0.2), st.floats(0.001, 0.1))
def test_it_settles_at_the_age_in_whatever_steps(age_s, dt):
    lag_s = 0.0
    for _ in range(round(10.0 * TAU_S / dt) + 1):
        lag_s = step(lag_s, age_s, dt)
    assert lag_s == pytest.approx(age_s, abs=1e-4 * 0.2)
    assert step(step(0.1, age_s, dt), age_s, dt) == pytest.approx(step(0.1, age_s, 2.0 * dt))


def test_a_loop_that_has_time_is_far_from_it():
    """As in a flight on an idle machine: 8 ms, now and then 35 ms, once a stall."""
    assert after(*([0.008] * 9 + [0.035]) * 20) < 0.3 * LATE_S
    assert after(0.1, 0.1, lag_s=0.005) < LATE_S


def test_loops_that_share_a_processor_are_found_out_within_half_a_second():
    """As in a flight beside twenty busy loops: 120 to 160 ms."""
    assert after(*[0.12] * 25, lag_s=0.005) > LATE_S


def test_what_was_silent_for_long_is_not_held_against_it_for_long():
    assert after(*[1000.0] * 500) <= MOST_S
    assert after(*[1000.0] * 500, *[0.005] * 50) < LATE_S
