"""A supervisor that stood still does not take its own absence for the others' silence, and not for long."""

from hypothesis import given
from hypothesis import strategies as st

from services.safety_supervisor.absence import CATCH_UP_S, State, step

DT, STALL_S = 0.02, 0.1


def after(*missed_s: float) -> State:
    state = State()
    for late_s in missed_s:
        state = step(state, late_s, DT + late_s, STALL_S)
    return state


def test_a_punctual_loop_takes_every_age_as_it_is():
    assert after(*[0.0] * 100) == State()
    assert after(*[0.9 * STALL_S] * 100).away_s == 0.0


@given(st.floats(0.11, 10.0))
def test_a_stall_is_taken_off_for_a_moment_and_then_no_more(missed_s):
    turns = round(CATCH_UP_S / DT)
    assert after(missed_s).away_s == missed_s
    assert after(missed_s, *[0.0] * (turns - 2)).away_s == missed_s
    assert after(missed_s, *[0.0] * (turns + 1)).away_s == 0.0


def test_stalls_in_a_row_add_up():
    assert after(0.3, 0.0, 0.3).away_s == 0.6
    assert after(0.3, *[0.0] * 20, 0.3).away_s == 0.3
