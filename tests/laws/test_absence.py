"""A supervisor that stood still does not take its own absence for the others' silence, and not for long."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from services.config import load
from services.faults.catalogue import every
from services.safety_supervisor.absence import CATCH_UP_S, State, step

DT, STALL_S = 0.02, 0.1
LOST_S = load("demo").safety_supervisor.limits.robot_lost_s
PROMISED_S = next(fault.within_s for fault in every() if fault.name == "kill_tracker_in_takeoff")


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


@given(st.lists(st.tuples(st.floats(0.11, 1.0), st.integers(0, 15)), min_size=1, max_size=4))
def test_who_stalls_on_and_on_finds_out_the_silent_in_time(rhythm):
    """As promised, whatever the rhythm; but for the stalls at both ends, within which nobody can act."""
    turns = [missed_s for late_s, punctual in rhythm for missed_s in (late_s, *[0.0] * punctual)]
    latest_s = PROMISED_S + 2.0 * (max(turns) + DT)
    state, silent_s = State(), 0.0
    for missed_s in itertools.cycle(turns):
        state, silent_s = step(state, missed_s, DT + missed_s, STALL_S), silent_s + DT + missed_s
        if silent_s - state.away_s > LOST_S:
            break
        assert silent_s < latest_s
